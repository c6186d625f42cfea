//! Captures of the Zaragoza data set (Z-NLOS): HDF5 with `data`, by colour and bounce, and times as path lengths in
//! metres.
//!
//! `data` has its axes in one of two orders, which their lengths distinguish, as in y-tal: (colour, time, bounce, sy,
//! sx, ly, lx), or the reverse of place and time: (ly, lx, sy, sx, bounce, time, colour). Confocal captures have no
//! laser axes. All bounces and colours are summed, as a sensor would do. Source: `tal/io/format.py` of y-tal 0.20; the
//! tests compare with its reading of a file.

use super::capture::{Capture, Grid, Histograms, Pair, strides};
use super::y_tal::{need, point};
use crate::formats::array::{Array, Arrays};
use crate::units;

/// Names of the arrays that are read.
pub(super) const NAMES: [&str; 9] = [
    "data",
    "cameraPosition",
    "cameraGridPositions",
    "cameraGridNormals",
    "laserPosition",
    "laserGridPositions",
    "laserGridNormals",
    "deltaT",
    "t0",
];

/// Bounces that a file stores one by one.
const BOUNCES: usize = 6;

/// The meaning of each axis of `data`. Points: first and second axis of their grid.
struct Order {
    colour: usize,
    time: usize,
    bounce: usize,
    seen: [usize; 2],
    lit: Option<[usize; 2]>,
}

impl Order {
    fn of(axes: &[usize]) -> Option<Self> {
        let front = Self { colour: 0, time: 1, bounce: 2, seen: [4, 3], lit: None };
        match axes {
            [_, _, _, _, BOUNCES, _, _] => {
                Some(Self { colour: 6, time: 5, bounce: 4, seen: [3, 2], lit: Some([1, 0]) })
            }
            [_, _, BOUNCES, _, _, _, _] => Some(Self { lit: Some([6, 5]), ..front }),
            [a, b, _, _, _] if a == b => Some(Self { colour: 4, time: 3, bounce: 2, seen: [0, 1], lit: None }),
            [_, _, _, a, b] if a == b => Some(front),
            _ => None,
        }
    }
}

/// Reads the arrays of a file.
pub(super) fn read(mut arrays: Arrays) -> Result<Capture, String> {
    let data = arrays.remove("data").ok_or("has no data")?;
    let order = Order::of(&data.axes).ok_or_else(|| {
        format!("data has axes {:?}, which is no order of (colour, time, bounce, sensor grid[, laser grid])", data.axes)
    })?;
    let (seen, lit) = (grid(&arrays, "cameraGrid")?, grid(&arrays, "laserGrid")?);
    let stride = strides(&data.axes);
    let of_seen = offsets(&data.axes, &stride, order.seen);
    let of_lit = order.lit.map(|axes| offsets(&data.axes, &stride, axes));
    let start_ps = units::time_ps(need(&arrays, "t0")?, 1.0);
    let fits = seen.spots.len() == of_seen.len() && lit.spots.len() == of_lit.as_ref().map_or(of_seen.len(), Vec::len);
    if !fits || data.count() == 0 {
        return Err(format!(
            "data has axes {:?}, but the grids hold {} seen and {} lit points",
            data.axes,
            seen.spots.len(),
            lit.spots.len()
        ));
    }
    let pairs = match of_lit {
        None => of_seen
            .iter()
            .enumerate()
            .map(|(place, offset)| Pair { lit: place, seen: place, start_ps, offset: *offset })
            .collect(),
        Some(of_lit) => {
            let of_lit = of_lit.into_iter().enumerate();
            let with = |(lit, from): (usize, usize)| {
                of_seen.iter().enumerate().map(move |(seen, offset)| Pair {
                    lit,
                    seen,
                    start_ps,
                    offset: from + offset,
                })
            };
            of_lit.flat_map(with).collect()
        }
    };
    let bounces = |colour: usize| (0..data.axes[order.bounce]).map(move |bounce| (colour, bounce));
    let parts = (0..data.axes[order.colour]).flat_map(bounces);
    let parts = parts.map(|(colour, bounce)| colour * stride[order.colour] + bounce * stride[order.bounce]).collect();
    Ok(Capture {
        format: "Z-NLOS",
        dt_ps: units::time_ps(need(&arrays, "deltaT")?, 1.0),
        laser_m: point(&arrays, "laserPosition")?,
        sensor_m: point(&arrays, "cameraPosition")?,
        with_legs: true,
        pairs,
        lit,
        seen,
        histograms: Histograms { bins: data.axes[order.time], stride: stride[order.time], parts, array: data },
    })
}

/// Offsets into `data` of the points of a grid, by its first and second axis.
fn offsets(axes: &[usize], stride: &[usize], [first, second]: [usize; 2]) -> Vec<usize> {
    let row = |a: usize| (0..axes[second]).map(move |b| a * stride[first] + b * stride[second]);
    (0..axes[first]).flat_map(row).collect()
}

/// Positions and normals. If x, y and z are on the first axis, all axes are in reverse order.
fn grid(arrays: &Arrays, name: &str) -> Result<Grid, String> {
    let positions = format!("{name}Positions");
    let array = arrays.get(&positions).ok_or_else(|| format!("has no {positions}"))?;
    let upright = |array: &Array| if array.axes.first() == Some(&3) { reversed(array) } else { array.clone() };
    Grid::new(&positions, &upright(array), arrays.get(&format!("{name}Normals")).map(upright).as_ref())
}

/// An array with its axes in reverse order.
pub(super) fn reversed(array: &Array) -> Array {
    let stride = strides(&array.axes);
    let axes: Vec<usize> = array.axes.iter().rev().copied().collect();
    let values = array.values();
    let of = |place: usize| {
        let mut rest = place;
        // The last axis of the result is the first of the array.
        let at = array.axes.iter().zip(&stride).map(|(length, stride)| {
            let along = rest % length;
            rest /= length;
            along * stride
        });
        values[at.sum::<usize>()]
    };
    Array::of(&axes, &(0..values.len()).map(of).collect::<Vec<f64>>())
}
