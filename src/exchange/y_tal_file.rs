//! Captures as files that y-tal reads: the arrays of its own HDF5 format, without those that it makes do without.

use std::io::{self, Write};

use super::capture::{Capture, Grid};
use crate::formats::array::{Array, Arrays};
use crate::formats::hdf5;
use crate::units;
use crate::waveform::CodeType;

/// Numbers of y-tal's enumerations.
const T_SX_SY: i32 = 1;
const T_LX_LY_SX_SY: i32 = 2;
const T_SI: i32 = 3;
const T_LI_SI: i32 = 4;
const N_3: i32 = 1;
const X_Y_3: i32 = 2;

/// Writes a capture. Its histograms must all begin at one time, and its pairs be all those of lit and seen points, or
/// each point with itself.
///
/// # Errors
/// When `out` cannot be written.
///
/// # Panics
/// When the capture is not such.
pub fn write(out: &mut impl Write, capture: &Capture) -> io::Result<()> {
    let (lit, seen, bins) = (&capture.lit, &capture.seen, capture.bins());
    let start_ps = capture.pairs[0].start_ps;
    assert!(capture.pairs.iter().all(|pair| pair.start_ps == start_ps), "histograms begin at one time");
    let is_exhaustive = lit.spots.len() > 1 && !capture.is_confocal();
    let points: Vec<usize> =
        if is_exhaustive { [lit.axes.clone(), seen.axes.clone()].concat() } else { seen.axes.clone() };
    assert_eq!(points.iter().product::<usize>(), capture.pairs.len(), "as many pairs as points");
    let format = match (is_exhaustive, lit.axes.len().max(seen.axes.len())) {
        (false, 1) => T_SI,
        (false, _) => T_SX_SY,
        (true, 1) => T_LI_SI,
        (true, _) => T_LX_LY_SX_SY,
    };
    let length_m = |time_ps: f64| units::path_m(time_ps, 1.0);
    let mut arrays = Arrays::from([
        ("H".to_owned(), histograms(capture, &[&[bins], points.as_slice()].concat())),
        ("H_format".to_owned(), enumerator(format)),
        ("delta_t".to_owned(), Array::of(&[], &[length_m(capture.dt_ps)])),
        ("t_start".to_owned(), Array::of(&[], &[length_m(start_ps)])),
        ("t_accounts_first_and_last_bounces".to_owned(), flag(capture.with_legs)),
    ]);
    for (name, grid, station_m) in [("laser", lit, capture.laser_m), ("sensor", seen, capture.sensor_m)] {
        let axes = [grid.axes.as_slice(), &[3]].concat();
        let positions: Vec<f64> = grid.spots.iter().flat_map(|spot| spot.position_m).collect();
        arrays.insert(format!("{name}_grid_xyz"), Array::of(&axes, &positions));
        let normals: Option<Vec<[f64; 3]>> = grid.spots.iter().map(|spot| spot.normal).collect();
        arrays.insert(
            format!("{name}_grid_normals"),
            normals.map_or_else(null, |normals| Array::of(&axes, normals.as_flattened())),
        );
        arrays.insert(format!("{name}_grid_format"), enumerator(if grid.axes.len() == 1 { N_3 } else { X_Y_3 }));
        arrays.insert(format!("{name}_xyz"), station_m.map_or_else(null, |station_m| Array::of(&[3], &station_m)));
    }
    hdf5::write(out, &arrays)
}

/// What h5py calls `Empty`, and y-tal `None`.
fn null() -> Array {
    Array { axes: Vec::new(), code_type: CodeType::F64, codes: Vec::new() }
}

pub(super) fn enumerator(number: i32) -> Array {
    Array { axes: vec![1], code_type: CodeType::I32, codes: number.to_le_bytes().to_vec() }
}

fn flag(flag: bool) -> Array {
    Array { axes: Vec::new(), code_type: CodeType::U8, codes: vec![u8::from(flag)] }
}

/// All histograms, times first.
fn histograms(capture: &Capture, axes: &[usize]) -> Array {
    let (bins, count) = (capture.bins(), capture.pairs.len());
    let mut codes = vec![0; bins * count * size_of::<f32>()];
    for (place, pair) in capture.pairs.iter().enumerate() {
        for (bin, value) in capture.histogram(pair).into_iter().enumerate() {
            let at = (bin * count + place) * size_of::<f32>();
            codes[at..at + size_of::<f32>()].copy_from_slice(&(value as f32).to_le_bytes());
        }
    }
    Array { axes: axes.to_vec(), code_type: CodeType::F32, codes }
}

impl Grid {
    /// Points in a list; those that fill a rectangle row by row as a grid.
    pub(super) fn listed(spots: Vec<super::Spot>) -> Self {
        let axes = rows(&spots).unwrap_or_else(|| vec![spots.len()]);
        Self { axes, spots }
    }
}

/// How far a coordinate may be off its grid, as a share of the step.
const OFF: f64 = 1e-3;

/// Lengths of the axes of a grid of equal steps that the points fill row by row.
fn rows(spots: &[super::Spot]) -> Option<Vec<usize>> {
    let step =
        |a: usize, b: usize| -> [f64; 3] { std::array::from_fn(|i| spots[b].position_m[i] - spots[a].position_m[i]) };
    let off = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    let first = (spots.len() > 3).then(|| step(0, 1))?;
    let slack = OFF * first.iter().map(|x| x.abs()).fold(0.0, f64::max);
    let run = 1 + (1..spots.len()).take_while(|&i| off(step(i - 1, i), first) <= slack).count();
    if run < 2 || run == spots.len() || !spots.len().is_multiple_of(run) {
        return None;
    }
    let across = step(0, run);
    let is_grid = (0..spots.len()).all(|i| {
        let (row, column) = ((i / run) as f64, (i % run) as f64);
        let expected: [f64; 3] = std::array::from_fn(|k| row * across[k] + column * first[k]);
        off(step(0, i), expected) <= slack
    });
    is_grid.then(|| vec![spots.len() / run, run])
}
