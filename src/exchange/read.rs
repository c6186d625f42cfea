//! Reads files of captures; their content decides the format.

use std::path::Path;

use super::{Capture, ExchangeError, confocal_mat, point_lists, y_tal, z_nlos};
use crate::formats::array::Arrays;
use crate::formats::hdf5::{self, Hdf5};
use crate::formats::npz::{self, Npz};
use crate::formats::{FormatError, Input, Reader, Source, mat5};

/// Bytes that identify a format. MATLAB writes this many, minus eight, before HDF5.
const HEAD_BYTES: u64 = 520;

/// Values for what a file does not contain.
#[derive(Clone, Debug, Default)]
pub struct Defaults<'a> {
    /// Width of a bin.
    pub dt_ps: Option<f64>,
    /// Side of the scanned square.
    pub wall_m: Option<f64>,
    /// Time at which the first bin begins.
    pub start_ps: Option<f64>,
    /// File with the delay of each point, `tofgrid`.
    pub delays: Option<&'a Path>,
    /// Most bytes of an array, as it is in memory; `None`: any number.
    pub most_bytes: Option<u64>,
}

/// Reads a capture.
///
/// # Errors
/// When the file cannot be read, has another format, or lacks a value that `defaults` does not give either.
pub fn read(path: &Path, defaults: &Defaults) -> Result<Capture, ExchangeError> {
    let unfit = |problem: String| ExchangeError::Unfit { path: path.to_owned(), problem };
    let (arrays, names, is_matlab) = arrays(path, defaults.most_bytes)?;
    let has = |name: &str| arrays.contains_key(name);
    let capture = if has("H") {
        y_tal::read(arrays)
    } else if has("data") && has("cameraGridPositions") {
        z_nlos::read(arrays)
    } else if has("rect_data") || has("meas") {
        let delays =
            defaults.delays.map(|path| self::arrays(path, defaults.most_bytes)).transpose()?.map(|(arrays, ..)| arrays);
        confocal_mat::read(arrays, defaults, delays.as_ref())
    } else if has("counts") && has("lit_m") {
        point_lists::read(arrays, defaults, is_matlab)
    } else {
        Err(format!(
            "holds {names:?}: neither a capture of y-tal (H), nor of Z-NLOS (data, cameraGridPositions), nor a confocal MAT-file (rect_data or meas), \
             nor counts with a list of points (counts, lit_m); \
             write what y-tal can convert in its own format first (docs/interoperation.md)"
        ))
    };
    let capture = capture.map_err(unfit)?;
    if !(capture.dt_ps.is_finite() && capture.dt_ps > 0.0)
        || capture.pairs.iter().any(|pair| !pair.start_ps.is_finite())
    {
        return Err(unfit(format!("has bins of {} ps; a positive width and a finite start are needed", capture.dt_ps)));
    }
    if capture.with_legs && (capture.laser_m.is_none() || capture.sensor_m.is_none()) {
        let problem = "has times that include the ways from the laser and to the sensor, but does not say where these are; set laser_xyz and sensor_xyz";
        return Err(unfit(problem.to_owned()));
    }
    Ok(capture)
}

/// The arrays that any of the formats needs, the names of all arrays, and whether MATLAB wrote them: with their axes in
/// reverse order.
fn arrays(path: &Path, most_bytes: Option<u64>) -> Result<(Arrays, Vec<String>, bool), ExchangeError> {
    let failed = |source: FormatError| ExchangeError::Read { path: path.to_owned(), source };
    let most_bytes = most_bytes.unwrap_or(u64::MAX);
    let wanted = |name: &str| {
        let names = [&y_tal::NAMES[..], &z_nlos::NAMES, &confocal_mat::NAMES, &point_lists::NAMES];
        names.concat().contains(&name)
    };
    let mut source = Source::open(path).map_err(failed)?;
    let length = source.length();
    let head = source.bytes("the head", 0, length.min(HEAD_BYTES)).map_err(failed)?;
    if Npz.recognises(&head) {
        let (arrays, names) = npz::arrays(&mut source, wanted, most_bytes).map_err(failed)?;
        return Ok((arrays, names, false));
    }
    if mat5::recognises(&head) {
        let (arrays, names) = mat5::arrays(&mut source, wanted, most_bytes).map_err(failed)?;
        return Ok((arrays, names, true));
    }
    let is_matlab = head.get(512..).is_some_and(|head| Hdf5.recognises(head));
    if !Hdf5.recognises(&head) && !is_matlab {
        let problem =
            "is neither HDF5 nor a MAT-file of version 5 to 7.3, nor a file of numpy.savez; give a capture such as y-tal writes".to_owned();
        return Err(ExchangeError::Unfit { path: path.to_owned(), problem });
    }
    let (arrays, names) = hdf5::arrays(&mut source, wanted, most_bytes).map_err(failed)?;
    Ok((arrays, names, is_matlab))
}
