//! Classical timing of one pulse a row.

use numpy::{AllowTypeChange, PyArray1, PyArrayLikeDyn};
use periscope::signal::onset::{self, Crossing, Noise};
use pyo3::prelude::*;

use crate::arrays::{number, positive, require, vector};
use crate::interrupt::{ONCE, interruptible_unless};

/// An array of profiles: one, or a row each.
type Profiles<'py> = PyArrayLikeDyn<'py, f64, AllowTypeChange>;

/// Onsets: one for each row of the samples.
#[pyclass(frozen, get_all, module = "periscope")]
pub struct Onsets {
    /// Time of each onset, ps; NaN where a row has none; shape (profiles,).
    time_ps: Py<PyArray1<f64>>,
    /// Standard deviation of `time_ps`, to first order: noise over slope; shape (profiles,).
    time_sd_ps: Py<PyArray1<f64>>,
    /// Level that was crossed, in the unit of the samples; shape (profiles,).
    level: Py<PyArray1<f64>>,
}

#[pymethods]
impl Onsets {
    fn __len__(&self, py: Python<'_>) -> PyResult<usize> {
        self.time_ps.bind(py).len()
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        Ok(format!("<Onsets of {} profiles>", self.__len__(py)?))
    }
}

/// The onset of each row.
fn onsets(
    py: Python<'_>,
    samples: &Profiles<'_>,
    (dt_ps, t0_ps): (f64, f64),
    find: impl Fn(&[f64]) -> Option<Crossing> + Sync,
) -> PyResult<Onsets> {
    let (dt_ps, t0_ps) = (positive("dt_ps", dt_ps)?, number("t0_ps", t0_ps)?);
    let array = samples.as_array();
    let shape = array.shape();
    require(matches!(shape, [.., width] if shape.len() <= 2 && *width > 0), || {
        format!("samples has shape {shape:?}; give (samples,) or (profiles, samples)")
    })?;
    let all: Vec<f64> = array.iter().copied().collect();
    require(all.iter().all(|value| value.is_finite()), || "samples has values that are not finite".to_owned())?;
    let width = shape[shape.len() - 1];
    let crossings: Vec<Option<Crossing>> = interruptible_unless(all.len() <= ONCE, py, |cancel| {
        let row = |row| {
            cancel.check();
            find(row)
        };
        all.chunks_exact(width).map(row).collect()
    })?;
    let each = |value: &dyn Fn(&Crossing) -> f64| {
        vector(py, crossings.iter().map(|one| one.as_ref().map_or(f64::NAN, value)).collect())
    };
    Ok(Onsets {
        time_ps: each(&|one| t0_ps + one.position * dt_ps),
        time_sd_ps: each(&|one| one.sd * dt_ps),
        level: each(&|one| one.level),
    })
}

fn noise(sd: f64, per_level: f64) -> PyResult<Noise> {
    let holds = sd >= 0.0 && per_level >= 0.0 && sd.is_finite() && per_level.is_finite();
    require(holds, || format!("noise_sd is {sd} and noise_per_level {per_level}; they must not be negative"))?;
    Ok(Noise { sd, per_level })
}

fn share(fraction: f64) -> PyResult<f64> {
    require(fraction > 0.0 && fraction < 1.0, || format!("fraction is {fraction}; it must lie between 0 and 1"))?;
    Ok(fraction)
}

/// Leading edge: the last crossing of a fraction of the maximum before it.
///
/// Parameters
/// ----------
/// samples : array_like, shape (samples,) or (profiles, samples)
///     Rows that hold one pulse each, baseline removed.
/// dt_ps : float
///     Time between samples.
/// t0_ps : float
///     Time of sample 0.
/// fraction : float
///     Of the maximum, between 0 and 1.
/// noise_sd : float
///     Standard deviation of a sample without signal.
/// noise_per_level : float
///     Variance that each unit of signal adds: 1 for photon counts.
///
/// Returns
/// -------
/// Onsets
#[pyfunction]
#[pyo3(signature = (samples, *, dt_ps, t0_ps=0.0, fraction=0.5, noise_sd=0.0, noise_per_level=0.0))]
pub fn leading_edge(
    py: Python<'_>,
    samples: Profiles<'_>,
    dt_ps: f64,
    t0_ps: f64,
    fraction: f64,
    noise_sd: f64,
    noise_per_level: f64,
) -> PyResult<Onsets> {
    let (fraction, noise) = (share(fraction)?, noise(noise_sd, noise_per_level)?);
    onsets(py, &samples, (dt_ps, t0_ps), |row| onset::leading_edge(row, fraction, noise))
}

/// Constant fraction discriminator: where the pulse, delayed, crosses a fraction of itself. It does not walk with
/// amplitude.
///
/// Parameters
/// ----------
/// samples : array_like, shape (samples,) or (profiles, samples)
///     Rows that hold one pulse each, baseline removed.
/// delay_ps : float
///     Delay of the discriminator, at least a sample; about the rise time of the pulse.
/// dt_ps : float
///     Time between samples.
/// t0_ps : float
///     Time of sample 0.
/// fraction : float
///     Between 0 and 1.
/// noise_sd : float
///     Standard deviation of a sample without signal.
/// noise_per_level : float
///     Variance that each unit of signal adds: 1 for photon counts.
///
/// Returns
/// -------
/// Onsets
///     Times on the rising edge of the pulse.
///
/// Notes
/// -----
/// Source: Gedcke and McDonald, Nucl. Instrum. Methods 58, 253 (1968).
#[pyfunction]
#[pyo3(signature = (samples, delay_ps, *, dt_ps, t0_ps=0.0, fraction=0.5, noise_sd=0.0, noise_per_level=0.0))]
pub fn constant_fraction(
    py: Python<'_>,
    samples: Profiles<'_>,
    delay_ps: f64,
    dt_ps: f64,
    t0_ps: f64,
    fraction: f64,
    noise_sd: f64,
    noise_per_level: f64,
) -> PyResult<Onsets> {
    let (fraction, noise) = (share(fraction)?, noise(noise_sd, noise_per_level)?);
    let delay = number("delay_ps", delay_ps)? / positive("dt_ps", dt_ps)?;
    require(delay >= 1.0, || format!("delay_ps is {delay_ps}; give a sample of {dt_ps} ps at least"))?;
    onsets(py, &samples, (dt_ps, t0_ps), |row| onset::constant_fraction(row, fraction, delay, noise))
}

/// First upward crossing of a fixed level. It walks with amplitude.
///
/// Parameters
/// ----------
/// samples : array_like, shape (samples,) or (profiles, samples)
///     Rows, baseline removed.
/// level : float
///     In the unit of the samples.
/// dt_ps : float
///     Time between samples.
/// t0_ps : float
///     Time of sample 0.
/// noise_sd : float
///     Standard deviation of a sample.
///
/// Returns
/// -------
/// Onsets
#[pyfunction]
#[pyo3(signature = (samples, level, *, dt_ps, t0_ps=0.0, noise_sd=0.0))]
pub fn threshold_crossing(
    py: Python<'_>,
    samples: Profiles<'_>,
    level: f64,
    dt_ps: f64,
    t0_ps: f64,
    noise_sd: f64,
) -> PyResult<Onsets> {
    let (level, noise) = (number("level", level)?, noise(noise_sd, 0.0)?);
    onsets(py, &samples, (dt_ps, t0_ps), |row| onset::threshold(row, level, noise.sd))
}
