//! A capture of non-line-of-sight imaging: time histograms of pairs of points, one lit and one seen.

use crate::formats::array::Array;

/// Histograms with their points.
#[derive(Clone, Debug)]
pub struct Capture {
    /// Original format.
    pub format: &'static str,
    /// Points that the laser lit.
    pub lit: Grid,
    /// Points that the sensor saw.
    pub seen: Grid,
    /// Pairs of them, in the stored order.
    pub pairs: Vec<Pair>,
    /// Width of a bin.
    pub dt_ps: f64,
    /// Position of the laser, if the file gives it.
    pub laser_m: Option<[f64; 3]>,
    /// Position of the sensor, if the file gives it.
    pub sensor_m: Option<[f64; 3]>,
    /// Whether times include the paths from the laser to the lit point and from the seen point to the sensor.
    pub with_legs: bool,
    pub(super) histograms: Histograms,
}

/// Points in the order of the file.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    /// Lengths of the grid's axes; one axis: a list.
    pub axes: Vec<usize>,
    /// The points; the last axis is contiguous.
    pub spots: Vec<Spot>,
}

/// A point on a wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spot {
    /// Position.
    pub position_m: [f64; 3],
    /// Unit vector towards the lit side, if the file gives it.
    pub normal: Option<[f64; 3]>,
}

/// A histogram's points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// Index of the lit point in its grid.
    pub lit: usize,
    /// Index of the seen point.
    pub seen: usize,
    /// Time at which its first bin begins.
    pub start_ps: f64,
    /// Index of its first number in the array.
    pub(super) offset: usize,
}

/// Layout of the histograms in an array.
#[derive(Clone, Debug)]
pub(super) struct Histograms {
    pub array: Array,
    /// Bins of each.
    pub bins: usize,
    /// Distance from a bin to the next.
    pub stride: usize,
    /// Offsets of the components to be summed, such as colours, from the first.
    pub parts: Vec<usize>,
}

impl Capture {
    /// The histogram of a pair.
    #[must_use]
    pub fn histogram(&self, pair: &Pair) -> Vec<f64> {
        let Histograms { array, bins, stride, parts } = &self.histograms;
        let mut sum = vec![0.0; *bins];
        for part in parts {
            let values = array.strided(pair.offset + part, *stride, *bins);
            sum.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
        }
        sum
    }

    /// Bins of each histogram.
    #[must_use]
    pub fn bins(&self) -> usize {
        self.histograms.bins
    }

    /// Whether each point is lit and seen by itself.
    #[must_use]
    pub fn is_confocal(&self) -> bool {
        let same = |pair: &Pair| self.lit.spots[pair.lit].position_m == self.seen.spots[pair.seen].position_m;
        self.pairs.iter().all(same)
    }
}

impl Grid {
    /// From an array of positions, with x, y and z on its last axis, and one of normals.
    pub(super) fn new(name: &str, positions: &Array, normals: Option<&Array>) -> Result<Self, String> {
        let axes = match positions.axes.split_last() {
            Some((3, axes)) if positions.count() > 0 => axes.to_vec(),
            _ => return Err(format!("{name} has axes {:?}; the last one must hold x, y and z", positions.axes)),
        };
        if normals.is_some_and(|normals| normals.axes != positions.axes) {
            return Err(format!(
                "{name} has not as many normals as points; write them alike, or leave the normals out"
            ));
        }
        let threes = |array: &Array| -> Vec<[f64; 3]> {
            array.values().chunks_exact(3).map(|point| [point[0], point[1], point[2]]).collect()
        };
        let points = threes(positions);
        if points.iter().flatten().any(|coordinate| !coordinate.is_finite()) {
            return Err(format!("{name} holds coordinates that are no finite numbers; correct them"));
        }
        let normals =
            normals.map_or_else(|| vec![None; points.len()], |array| threes(array).into_iter().map(unit).collect());
        let spots = points.into_iter().zip(normals).map(|(position_m, normal)| Spot { position_m, normal }).collect();
        Ok(Self { axes, spots })
    }

    /// Whether a point stays if only every `every`-th of each axis does.
    pub(super) fn keeps(&self, place: usize, every: usize) -> bool {
        let mut rest = place;
        self.axes.iter().rev().all(|length| {
            let along = rest % length;
            rest /= length;
            along.is_multiple_of(every)
        })
    }
}

/// A direction as unit vector; `None` if it has no length.
fn unit(direction: [f64; 3]) -> Option<[f64; 3]> {
    let length = direction.iter().map(|x| x * x).sum::<f64>().sqrt();
    (length.is_finite() && length > 0.0).then(|| direction.map(|x| x / length))
}

/// Distance from a number to the next along each axis.
pub(super) fn strides(axes: &[usize]) -> Vec<usize> {
    let mut strides = vec![1; axes.len()];
    for axis in (1..axes.len()).rev() {
        strides[axis - 1] = strides[axis] * axes[axis];
    }
    strides
}
