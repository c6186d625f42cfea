//! Captures of y-tal (`tal.io`): HDF5 with `H`, `H_format`, grids of points, and times as path lengths in metres.
//!
//! Bin i holds the light of paths from `t_start + i delta_t` to `t_start + (i + 1) delta_t`. `H` is (T, Sx, Sy), (T,
//! Lx, Ly, Sx, Sy), (T, Si) or (T, Li, Si). Without laser axes, either one point is lit for all, or point i is lit for
//! seen point i: confocal if both are the same. Source: the documentation of `NLOSCaptureData` and `HFormat` in y-tal
//! 0.20.

use super::capture::{Capture, Grid, Histograms, Pair};
use crate::formats::array::{Array, Arrays};
use crate::units;

/// Names of the arrays that are read.
pub(super) const NAMES: [&str; 11] = [
    "H",
    "H_format",
    "sensor_xyz",
    "sensor_grid_xyz",
    "sensor_grid_normals",
    "laser_xyz",
    "laser_grid_xyz",
    "laser_grid_normals",
    "delta_t",
    "t_start",
    "t_accounts_first_and_last_bounces",
];

/// Reads the arrays of a file.
pub(super) fn read(mut arrays: Arrays) -> Result<Capture, String> {
    let of_length = |length_m: f64| units::time_ps(length_m, 1.0);
    let h = arrays.remove("H").ok_or("has no H")?;
    let lit = grid(&arrays, "laser_grid_xyz", "laser_grid_normals")?;
    let seen = grid(&arrays, "sensor_grid_xyz", "sensor_grid_normals")?;
    let format = need(&arrays, "H_format")?;
    let is_exhaustive = match format as i64 {
        1 | 3 => false,
        2 | 4 => true,
        _ => {
            return Err(format!("H_format is {format}; write 1 (T_Sx_Sy), 2 (T_Lx_Ly_Sx_Sy), 3 (T_Si) or 4 (T_Li_Si)"));
        }
    };
    let with_legs = single(&arrays, "t_accounts_first_and_last_bounces")?
        .ok_or("does not say whether times include the ways to the wall; set t_accounts_first_and_last_bounces and write it again")?;
    let start_ps = of_length(single(&arrays, "t_start")?.unwrap_or(0.0));
    let (lits, seens) = (lit.spots.len(), seen.spots.len());
    let pairs: Vec<(usize, usize)> = match (is_exhaustive, lits) {
        (true, _) => (0..lits).flat_map(|lit| (0..seens).map(move |seen| (lit, seen))).collect(),
        (false, 1) => (0..seens).map(|seen| (0, seen)).collect(),
        (false, _) if lits == seens => (0..seens).map(|place| (place, place)).collect(),
        (false, _) => {
            return Err(format!(
                "lights {lits} points and sees {seens}, but H has no axis for the lit ones; set H_format"
            ));
        }
    };
    let [bins, points @ ..] = h.axes.as_slice() else { return Err("has an H without axes".to_owned()) };
    if points.iter().product::<usize>() != pairs.len() || *bins == 0 || points.is_empty() {
        return Err(format!(
            "H has axes {:?}, but the grids make {} pairs of points; times come first",
            h.axes,
            pairs.len()
        ));
    }
    // A grid as a list says nothing of the order of its axes.
    let grids: Vec<usize> = if is_exhaustive { [&lit.axes[..], &seen.axes].concat() } else { seen.axes.clone() };
    if grids.len() == points.len() && grids != points {
        return Err(format!(
            "has an H with axes {:?}, but the grids of points have the axes {grids:?}; times come first, then the axes \
             of the grids in their order",
            h.axes
        ));
    }
    let pair = |(offset, (lit, seen)): (usize, (usize, usize))| Pair { lit, seen, start_ps, offset };
    Ok(Capture {
        format: "y-tal",
        dt_ps: of_length(need(&arrays, "delta_t")?),
        laser_m: point(&arrays, "laser_xyz")?,
        sensor_m: point(&arrays, "sensor_xyz")?,
        with_legs: with_legs != 0.0,
        histograms: Histograms { bins: *bins, stride: pairs.len(), parts: vec![0], array: h },
        pairs: pairs.into_iter().enumerate().map(pair).collect(),
        lit,
        seen,
    })
}

fn grid(arrays: &Arrays, positions: &str, normals: &str) -> Result<Grid, String> {
    Grid::new(positions, arrays.get(positions).ok_or_else(|| format!("has no {positions}"))?, arrays.get(normals))
}

/// A single number, if it exists.
pub(super) fn single(arrays: &Arrays, name: &str) -> Result<Option<f64>, String> {
    let number = |array: &Array| match array.values()[..] {
        [value] if value.is_finite() => Ok(value),
        _ => Err(format!("{name} is no single finite number; write one")),
    };
    arrays.get(name).map(number).transpose()
}

/// A single number that must exist.
pub(super) fn need(arrays: &Arrays, name: &str) -> Result<f64, String> {
    single(arrays, name)?.ok_or_else(|| format!("has no {name}; write it"))
}

/// A position, if it exists.
pub(super) fn point(arrays: &Arrays, name: &str) -> Result<Option<[f64; 3]>, String> {
    let point = |array: &Array| match array.values()[..] {
        [x, y, z] if [x, y, z].iter().all(|coordinate| coordinate.is_finite()) => Ok([x, y, z]),
        _ => Err(format!("{name} is no point of three finite coordinates; write x, y and z")),
    };
    arrays.get(name).map(point).transpose()
}
