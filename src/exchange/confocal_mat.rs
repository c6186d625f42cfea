//! Confocal scans as MAT-files of the light-cone transform and f-k migration: `rect_data` or `meas` (x, y, time).
//!
//! The points form a square on the plane z = 0 about the origin, ends included; hidden objects are at z > 0. `width` is
//! half of its side. Times of `rect_data` count from the light's arrival at each point; those of `meas` from the
//! laser's trigger, and `tofgrid` (ps) is the delay of each point; where a start time is given and no `tofgrid`, they
//! count from the light's arrival too. Source: the demonstration scripts of O'Toole,
//! Lindell and Wetzstein (Nature 555:338, 2018) and of Lindell, Wetzstein and O'Toole (ACM TOG 38:116, 2019).

use super::capture::{Capture, Grid, Histograms, Pair, Spot};
use super::read::Defaults;
use super::y_tal::single;
use crate::formats::array::Arrays;

/// Names of the arrays that are read.
pub(super) const NAMES: [&str; 4] = ["rect_data", "meas", "width", "tofgrid"];

/// Reads the arrays of a file, and those of the file with `tofgrid`.
pub(super) fn read(mut arrays: Arrays, defaults: &Defaults, delays: Option<&Arrays>) -> Result<Capture, String> {
    let is_raw = !arrays.contains_key("rect_data");
    let data = arrays.remove(if is_raw { "meas" } else { "rect_data" }).ok_or("has no rect_data")?;
    let Order { format, sides: [ys, xs], bins, stride, apart } = Order::of(&data.axes)?;
    if bins == 0 || xs < 2 || ys < 2 {
        return Err(format!(
            "is a scan of {xs} x {ys} points and {bins} bins; two points on each side and one bin are the least"
        ));
    }
    let dt_ps = defaults.dt_ps.ok_or("does not say how wide a bin is; add --dt-ps")?;
    let half_m = match (defaults.wall_m, single(&arrays, "width")?) {
        (Some(wall_m), _) => 0.5 * wall_m,
        (None, Some(width)) => width,
        (None, None) => return Err("does not say how large the scanned square is; add --wall-m, its side".to_owned()),
    };
    if !(half_m > 0.0 && half_m.is_finite()) {
        return Err(format!(
            "has a square of half a side of {half_m} m; it must be positive: correct --wall-m, or `width`"
        ));
    }
    let late_ps = match arrays.get("tofgrid").or_else(|| delays?.get("tofgrid")) {
        Some(late) if late.axes == [ys, xs] => late.values(),
        // Rectified: the times of all points count from the same moment, such as a `tofgrid` of 0 says.
        Some(late) if late.count() == 1 => vec![late.values()[0]; xs * ys],
        Some(late) => return Err(format!("has {xs} x {ys} points, but tofgrid has axes {:?}", late.axes)),
        None if delays.is_some() => return Err("has its delays in a file without `tofgrid`; correct --tof".to_owned()),
        None if is_raw && defaults.start_ps.is_none() => {
            return Err(
                "holds `meas`, whose times count from the laser's trigger; add --tof with the file of `tofgrid`, or --start-ps 0 if they count from the light's arrival at each point"
                    .to_owned(),
            );
        }
        None => vec![0.0; xs * ys],
    };
    let along = |place: usize, count: usize| half_m * (2.0 * place as f64 / (count - 1) as f64 - 1.0);
    let spot =
        |y: usize, x: usize| Spot { position_m: [along(x, xs), along(y, ys), 0.0], normal: Some([0.0, 0.0, 1.0]) };
    let spots = (0..ys).flat_map(|y| (0..xs).map(move |x| spot(y, x))).collect();
    let grid = Grid { axes: vec![ys, xs], spots };
    let start_ps = defaults.start_ps.unwrap_or(0.0);
    let pair = |(place, late_ps): (usize, &f64)| Pair {
        lit: place,
        seen: place,
        start_ps: start_ps - late_ps,
        offset: place * apart,
    };
    Ok(Capture {
        format,
        pairs: late_ps.iter().enumerate().map(pair).collect(),
        lit: grid.clone(),
        seen: grid,
        dt_ps,
        laser_m: None,
        sensor_m: None,
        with_legs: false,
        histograms: Histograms { bins, stride, parts: vec![0], array: data },
    })
}

/// In which order the numbers of a scan are stored.
#[derive(Debug, PartialEq)]
struct Order {
    format: &'static str,
    /// Points along y and x.
    sides: [usize; 2],
    bins: usize,
    /// Numbers from one bin to the next, and from one point to the next.
    stride: usize,
    apart: usize,
}

impl Order {
    /// MATLAB's first axis comes last: (time, y, x). Other programs write (y, x, time) as it is; the sides of the
    /// scanned square are equal, which distinguishes the two.
    fn of(axes: &[usize]) -> Result<Self, String> {
        let [first, middle, last] = axes[..] else {
            return Err(format!("has {} axes of numbers; a scan has three: x, y and time", axes.len()));
        };
        if first == middle && middle != last {
            let format = "confocal MAT (axes y, x, time)";
            return Ok(Self { format, sides: [first, middle], bins: last, stride: 1, apart: last });
        }
        if first == last && middle != last {
            let problem = "has its time between x and y; store it with the axes x, y, time";
            return Err(format!("is an array of {first} x {middle} x {last} numbers, and {problem}"));
        }
        Ok(Self { format: "confocal MAT", sides: [middle, last], bins: first, stride: middle * last, apart: 1 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::array::Array;

    /// The same scan of 2 x 2 points and 3 bins, stored by MATLAB and by a program that keeps the order of its axes.
    #[test]
    fn equal_sides_show_which_axis_is_time() {
        let counts = |point: usize, bin: usize| (10 * point + bin) as f64;
        let by_time: Vec<f64> = (0..3).flat_map(|bin| (0..4).map(move |point| counts(point, bin))).collect();
        let by_point: Vec<f64> = (0..4).flat_map(|point| (0..3).map(move |bin| counts(point, bin))).collect();
        let defaults = Defaults { dt_ps: Some(4.0), wall_m: Some(0.4), ..Defaults::default() };
        for (axes, values) in [([3, 2, 2], by_time), ([2, 2, 3], by_point)] {
            let arrays = Arrays::from([("rect_data".to_owned(), Array::of(&axes, &values))]);
            let capture = read(arrays, &defaults, None).unwrap();
            assert_eq!((capture.pairs.len(), capture.bins()), (4, 3));
            for (point, pair) in capture.pairs.iter().enumerate() {
                let histogram = capture.histogram(pair);
                assert_eq!(histogram, [0, 1, 2].map(|bin| counts(point, bin)), "{axes:?} {point}");
            }
        }
        // A scan that is rectified already says so by a single delay.
        let scan = [("meas", Array::of(&[3, 2, 2], &[1.0; 12])), ("tofgrid", Array::of(&[1, 1], &[0.0]))];
        let scan: Arrays = scan.into_iter().map(|(name, array)| (name.to_owned(), array)).collect();
        assert!(read(scan, &defaults, None).unwrap().pairs.iter().all(|pair| pair.start_ps == 0.0));
        assert!(Order::of(&[2, 3, 2]).unwrap_err().contains("between x and y"));
        assert!(Order::of(&[2, 3]).unwrap_err().contains("three"));
    }
}
