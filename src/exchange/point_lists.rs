//! Captures as `counts` with lists of points: what a lab's own program writes to HDF5, MAT or `.npz`.
//!
//! | array | axes | what |
//! |---|---|---|
//! | `counts` | point, bin; or lit, seen, bin | the histograms |
//! | `lit_m` | point, 3 | lit points |
//! | `seen_m` | point, 3 | seen points; absent: those that are lit |
//! | `lit_normals`, `seen_normals` | point, 3 | normals, if they are known |
//! | `dt_ps` | | width of a bin |
//! | `start_ps` | as `counts` without bins, or none | time at which the first bin begins, pair by pair or for all |
//! | `laser_m`, `sensor_m` | 3 | where both are, times lead from the laser to the sensor; else from wall to wall |
//!
//! Axes stand as the program that wrote the file shows them: points first, bins last. Point i is lit with point i seen,
//! unless only one is lit, or `counts` has an axis for each. Another order is refused by the numbers of points.

use super::capture::{Capture, Grid, Histograms, Pair, strides};
use super::read::Defaults;
use super::y_tal::{point, single};
use super::z_nlos::reversed;
use crate::formats::array::{Array, Arrays};

/// Names of the arrays that are read.
pub(super) const NAMES: [&str; 9] =
    ["counts", "lit_m", "seen_m", "lit_normals", "seen_normals", "dt_ps", "start_ps", "laser_m", "sensor_m"];

/// Reads the arrays of a file. `is_matlab`: their axes are in reverse order.
pub(super) fn read(mut arrays: Arrays, defaults: &Defaults, is_matlab: bool) -> Result<Capture, String> {
    let counts = arrays.remove("counts").ok_or("has no counts")?;
    let grid = |positions: &str, normals: &str| -> Result<Option<Grid>, String> {
        let upright = |name: &str| arrays.get(name).map(|a| if is_matlab { reversed(a) } else { a.clone() });
        let Some(array) = upright(positions) else { return Ok(None) };
        let grid = Grid::new(positions, &array, upright(normals).as_ref())?;
        let axes = vec![grid.spots.len()];
        Ok(Some(Grid { axes, ..grid }))
    };
    let lit = grid("lit_m", "lit_normals")?
        .ok_or("has counts, but no list `lit_m` of lit points; write x, y and z of each")?;
    let seen = grid("seen_m", "seen_normals")?.unwrap_or_else(|| lit.clone());
    let order = Order::of(&counts, lit.spots.len(), seen.spots.len(), is_matlab)?;
    let pairs = order.pairs(lit.spots.len(), seen.spots.len());
    let starts_ps = starts_ps(&arrays, &order, defaults, is_matlab)?;
    let dt_ps = defaults.dt_ps.or(single(&arrays, "dt_ps")?);
    let dt_ps = dt_ps.ok_or("does not say how wide a bin is; write `dt_ps`, or add --dt-ps")?;
    let (laser_m, sensor_m) = (point(&arrays, "laser_m")?, point(&arrays, "sensor_m")?);
    if laser_m.is_some() != sensor_m.is_some() {
        return Err("has one of `laser_m` and `sensor_m`; write both, or none for times from wall to wall".to_owned());
    }
    let pair = |(index, (lit, seen)): (usize, (usize, usize))| Pair {
        lit,
        seen,
        start_ps: starts_ps[index % starts_ps.len()],
        offset: order.offset(index),
    };
    Ok(Capture {
        format: "point-list",
        dt_ps,
        laser_m,
        sensor_m,
        with_legs: laser_m.is_some(),
        pairs: pairs.into_iter().enumerate().map(pair).collect(),
        lit,
        seen,
        histograms: Histograms { bins: order.bins, stride: order.stride, parts: vec![0], array: counts },
    })
}

/// In which order the numbers of `counts` are stored.
struct Order {
    /// Length and stride of the axes that count points.
    points: Vec<(usize, usize)>,
    bins: usize,
    stride: usize,
}

impl Order {
    fn of(counts: &Array, lits: usize, seens: usize, is_matlab: bool) -> Result<Self, String> {
        let mut axes: Vec<(usize, usize)> = counts.axes.iter().copied().zip(strides(&counts.axes)).collect();
        if is_matlab {
            axes.reverse();
        }
        let lengths: Vec<usize> = axes.iter().map(|(length, _)| *length).collect();
        let list = if lits == 1 || lits == seens { seens } else { lits };
        let is_list = lits == seens || lits == 1 || seens == 1;
        let fits = match lengths[..] {
            [points, bins] => bins > 0 && is_list && points == list,
            [lit, seen, bins] => bins > 0 && [lit, seen] == [lits, seens],
            _ => false,
        };
        let last = axes.pop().filter(|_| fits && lits > 0 && seens > 0);
        let (bins, stride) = last.ok_or_else(|| {
            format!(
                "has counts with axes {lengths:?}, and lists of {lits} lit and {seens} seen points; \
                 points come first and bins last, as (point, bin) or (lit, seen, bin): store it so"
            )
        })?;
        Ok(Self { points: axes, bins, stride })
    }

    /// Lit and seen point of each histogram.
    fn pairs(&self, lits: usize, seens: usize) -> Vec<(usize, usize)> {
        match self.points[..] {
            [(points, _)] => (0..points).map(|i| (i.min(lits - 1), i.min(seens - 1))).collect(),
            _ => (0..lits).flat_map(|lit| (0..seens).map(move |seen| (lit, seen))).collect(),
        }
    }

    /// Where the histogram of a pair begins.
    fn offset(&self, pair: usize) -> usize {
        let (mut offset, mut rest) = (0, pair);
        for (length, stride) in self.points.iter().rev() {
            offset += rest % length * stride;
            rest /= length;
        }
        offset
    }
}

/// Times at which first bins begin: one for all, or one a pair.
fn starts_ps(arrays: &Arrays, order: &Order, defaults: &Defaults, is_matlab: bool) -> Result<Vec<f64>, String> {
    let Some(array) = arrays.get("start_ps").filter(|array| array.count() != 1) else {
        return Ok(vec![single(arrays, "start_ps")?.or(defaults.start_ps).unwrap_or(0.0)]);
    };
    let array = if is_matlab { reversed(array) } else { array.clone() };
    let long = |axes: &mut dyn Iterator<Item = usize>| axes.filter(|length| *length != 1).collect::<Vec<usize>>();
    let wanted = long(&mut order.points.iter().map(|(length, _)| *length));
    if long(&mut array.axes.iter().copied()) != wanted {
        let problem = format!("has start_ps with axes {:?}, where counts has {wanted:?} points", array.axes);
        return Err(format!("{problem}; write one time a histogram, in the same order, or one for all"));
    }
    Ok(array.values())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(count: usize) -> Array {
        let coordinates = (0..count).flat_map(|i| [0.1 * i as f64, 0.0, 0.0]);
        Array::of(&[count, 3], &coordinates.collect::<Vec<f64>>())
    }

    fn file(arrays: Vec<(&str, Array)>) -> Arrays {
        arrays.into_iter().map(|(name, array)| (name.to_owned(), array)).collect()
    }

    /// As MATLAB's files have it.
    fn of_matlab(arrays: &Arrays) -> Arrays {
        arrays.iter().map(|(name, array)| (name.clone(), reversed(array))).collect()
    }

    /// Two lit and three seen points, four bins: the number of a bin is 100 lit + 10 seen + bin.
    fn all_pairs() -> Arrays {
        let counts: Vec<f64> = (0..24).map(|n| f64::from(100 * (n / 12) + 10 * (n / 4 % 3) + n % 4)).collect();
        let starts: Vec<f64> = (0..6).map(|n| f64::from(10 * (n / 3) + n % 3)).collect();
        file(vec![
            ("counts", Array::of(&[2, 3, 4], &counts)),
            ("lit_m", points(2)),
            ("seen_m", points(3)),
            ("start_ps", Array::of(&[2, 3], &starts)),
            ("dt_ps", Array::of(&[], &[16.0])),
        ])
    }

    #[test]
    fn each_pair_has_its_histogram_and_its_start() {
        let arrays = all_pairs();
        for (arrays, is_matlab) in [(arrays.clone(), false), (of_matlab(&arrays), true)] {
            let capture = read(arrays, &Defaults::default(), is_matlab).unwrap();
            assert_eq!((capture.pairs.len(), capture.bins(), capture.dt_ps), (6, 4, 16.0));
            for pair in &capture.pairs {
                let first = (100 * pair.lit + 10 * pair.seen) as f64;
                assert_eq!(capture.histogram(pair), [first, first + 1.0, first + 2.0, first + 3.0], "{is_matlab}");
                assert_eq!(pair.start_ps, (10 * pair.lit + pair.seen) as f64);
            }
        }
    }

    #[test]
    fn a_list_of_points_is_lit_and_seen_one_by_one() {
        let counts = Array::of(&[3, 2], &[0.0, 1.0, 10.0, 11.0, 20.0, 21.0]);
        let arrays = file(vec![("counts", counts), ("lit_m", points(3))]);
        let defaults = Defaults { dt_ps: Some(4.0), start_ps: Some(7.0), ..Defaults::default() };
        let capture = read(arrays.clone(), &defaults, false).unwrap();
        assert!(capture.is_confocal() && capture.pairs.iter().all(|pair| pair.start_ps == 7.0));
        assert_eq!(capture.histogram(&capture.pairs[2]), [20.0, 21.0]);
        assert!(read(arrays, &Defaults::default(), false).unwrap_err().contains("--dt-ps"));
    }

    #[test]
    fn another_order_of_axes_is_refused() {
        let turned = |axes: &[usize], starts: &[usize]| {
            let mut arrays = all_pairs();
            arrays.insert("counts".to_owned(), Array::of(axes, &[0.0; 24]));
            arrays.insert("start_ps".to_owned(), Array::of(starts, &[0.0; 6]));
            read(arrays, &Defaults::default(), false).unwrap_err()
        };
        for axes in [[4, 2, 3], [3, 2, 4], [2, 4, 3]] {
            let error = turned(&axes, &[2, 3]);
            assert!(error.contains("lists of 2 lit and 3 seen points") && error.contains("bins last"), "{error}");
        }
        assert!(turned(&[2, 3, 4], &[3, 2]).contains("start_ps with axes [3, 2]"));
        assert!(read(of_matlab(&all_pairs()), &Defaults::default(), false).is_err());
    }
}
