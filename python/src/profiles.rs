//! From shots to a mean profile: averages, noise, responses, and counts freed of pile-up.

use numpy::{AllowTypeChange, PyArray1, PyArrayLikeDyn, PyReadonlyArray2, PyUntypedArrayMethods};
use periscope::signal::average::{PHASES, PhaseSums};
use periscope::signal::codes::Codes;
use periscope::signal::oversample::{self, Shot};
use periscope::signal::sparse::Unpiled;
use periscope::signal::{averaged_response, noise, response};
use periscope::waveform::CodeType;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::arrays::{Each, Integers, Rows, Vector, finite, number, positive, require, vector};
use crate::failure::of_signal;
use crate::interrupt::{ONCE, interruptible, interruptible_unless};
use crate::plots::plot;

/// Samples of a response beyond which its step is a mistake.
const MOST_SAMPLES: f64 = 1e6;

/// The mean of shots.
#[pyclass(frozen, get_all, module = "periscope")]
pub struct Mean {
    /// Mean of each sample, in the unit of the shots; shape (samples,).
    values: Py<PyArray1<f64>>,
    /// Time of its first sample, ps.
    t0_ps: f64,
    /// Time between samples, ps; None where `average` was not given it.
    dt_ps: Option<f64>,
    /// Shots that went into it.
    shots: u64,
    /// Shots at each of the 64 sub-sample positions of `dt_ps / 64`; shape (64,). `Response.averaged` takes it.
    phase_shots: Py<PyArray1<i32>>,
}

#[pymethods]
impl Mean {
    /// Draws the mean over time. Needs matplotlib.
    ///
    /// Parameters
    /// ----------
    /// ax : matplotlib.axes.Axes, optional
    ///     Where to; by default a new figure.
    ///
    /// Returns
    /// -------
    /// matplotlib.axes.Axes
    #[pyo3(signature = (ax=None))]
    fn plot<'py>(slf: &Bound<'py, Self>, ax: Option<Bound<'py, PyAny>>) -> PyResult<Bound<'py, PyAny>> {
        plot(slf, "mean", ax)
    }
}

/// Averages shots, moved onto one time grid.
///
/// Codes are summed as integers and each sub-sample position is delayed once, by a band-limited filter. So the result
/// does not depend on the order of the shots, and integer codes lose nothing.
///
/// Parameters
/// ----------
/// shots : array_like, shape (shots, samples)
///     Codes or values: 8, 16 or 32 bit integers, or floats.
/// t0_ps : array_like, shape (shots,), optional
///     Time of sample 0 of each shot after the event to align: `Waveforms.t0_ps` for the trigger. It is rounded to 1/64
///     sample. Without it, sample n of all shots is one time.
/// dt_ps : float, optional
///     Time between samples; needed with `t0_ps`.
///
/// Returns
/// -------
/// Mean
///     The mean of the times that all shots cover.
///
/// Raises
/// ------
/// ValueError
///     If a value is not finite, the type is another, or no time is covered by all shots.
///
/// Notes
/// -----
/// Source: averaging of exposures in Kirmani, Hutchison, Davis and Raskar, *Looking Around the Corner using Transient
/// Imaging*, ICCV 2009, section 5.
#[pyfunction]
#[pyo3(signature = (shots, t0_ps=None, dt_ps=None))]
pub fn average(
    py: Python<'_>,
    shots: &Bound<'_, PyAny>,
    t0_ps: Option<Vector<'_>>,
    dt_ps: Option<f64>,
) -> PyResult<Mean> {
    let (code_type, bytes) = codes(shots)?;
    let (count, samples) = (bytes.shape()[0], bytes.shape()[1] / code_type.bytes());
    require(count > 0 && samples > 0, || format!("shots has shape ({count}, {samples}); give at least one sample"))?;
    let starts_ps = t0_ps.map(|starts| finite("t0_ps", &starts)).transpose()?.unwrap_or_else(|| vec![0.0; count]);
    require(starts_ps.len() == count, || format!("t0_ps has {} values for {count} shots", starts_ps.len()))?;
    let is_aligned = starts_ps.iter().all(|start_ps| *start_ps == starts_ps[0]);
    let given_ps = dt_ps.map(|dt_ps| positive("dt_ps", dt_ps)).transpose()?;
    let dt_ps = match given_ps {
        Some(dt_ps) => dt_ps,
        None if is_aligned => 1.0,
        None => return Err(PyValueError::new_err("t0_ps differs between shots; give dt_ps too")),
    };
    // Shots that share no time would spread the sums over all times between them.
    let is_apart = starts_ps.iter().any(|start_ps| ((start_ps - starts_ps[0]) / dt_ps).abs() >= samples as f64);
    require(!is_apart, || "no time is covered by all shots; check t0_ps and dt_ps".to_owned())?;
    let bytes = bytes.as_slice()?;
    let rows = || bytes.chunks_exact(samples * code_type.bytes());
    let codes = |row| Codes::of(code_type.name(), row).expect("the crates name types alike");
    require(rows().all(|row| codes(row).is_finite()), || "shots has values that are not finite".to_owned())?;
    let sums = interruptible_unless(count * samples <= ONCE, py, |cancel| {
        let mut sums = PhaseSums::new(samples);
        for (row, start_ps) in rows().zip(&starts_ps) {
            cancel.check();
            sums.add(codes(row), ((start_ps - starts_ps[0]) / dt_ps * PHASES as f64).round() as i64);
        }
        sums
    })?;
    let mean = sums.finish().ok_or_else(|| PyValueError::new_err("no time is covered by all shots; check t0_ps"))?;
    let phase_shots = sums.phase_shots().into_iter().map(|shots| shots as i32).collect();
    Ok(Mean {
        values: vector(py, mean.mean),
        t0_ps: starts_ps[0] + mean.first_position as f64 * dt_ps,
        dt_ps: given_ps,
        shots: sums.shots(),
        phase_shots: vector(py, phase_shots),
    })
}

/// The bytes of codes, little-endian and row by row, with their type.
fn codes<'py>(shots: &Bound<'py, PyAny>) -> PyResult<(CodeType, PyReadonlyArray2<'py, u8>)> {
    let numpy = shots.py().import("numpy")?;
    let array = numpy.call_method1("asarray", (shots,))?;
    let dtype = array.getattr("dtype")?;
    let kind: String = dtype.getattr("kind")?.extract()?;
    let bits = 8 * dtype.getattr("itemsize")?.extract::<usize>()?;
    let code_type = CodeType::parse(&format!("{kind}{bits}")).ok_or_else(|| {
        let problem = format!("shots has type {dtype}; convert it to 8, 16 or 32 bit integers, or to floats");
        PyValueError::new_err(problem)
    })?;
    let dimensions: usize = array.getattr("ndim")?.extract()?;
    require(dimensions == 2, || format!("shots has {dimensions} dimensions; give an array [shot, sample]"))?;
    let array = numpy.call_method1("ascontiguousarray", (array, dtype.call_method1("newbyteorder", ("<",))?))?;
    Ok((code_type, array.call_method1("view", ("u1",))?.extract()?))
}

/// Noise of samples without signal.
#[pyclass(frozen, get_all, module = "periscope")]
pub struct Noise {
    /// Standard deviation of a sample, in the unit of the samples.
    sd: f64,
    /// Autocorrelation at lags 0, 1, ..; shape (lags,).
    acf: Py<PyArray1<f64>>,
}

/// Estimates the noise of stretches without signal: standard deviation and autocorrelation.
///
/// The mean of each stretch is removed, and what that takes from the variance is given back.
///
/// Parameters
/// ----------
/// samples : array_like, shape (samples,) or (stretches, samples)
///     Samples without signal, each row a stretch.
/// lags : int
///     Lags of the autocorrelation; fewer where the stretches are shorter.
///
/// Returns
/// -------
/// Noise
///
/// See Also
/// --------
/// autoregressive_acf : smooths the autocorrelation for `deconvolve`.
/// quietest : finds such a stretch.
#[pyfunction]
#[pyo3(signature = (samples, lags=32))]
pub fn estimate_noise(
    py: Python<'_>,
    samples: PyArrayLikeDyn<'_, f64, AllowTypeChange>,
    lags: usize,
) -> PyResult<Noise> {
    let array = samples.as_array();
    let dimensions = array.ndim();
    require(dimensions == 1 || dimensions == 2, || format!("samples has {dimensions} dimensions; give 1 or 2"))?;
    require(array.iter().all(|value| value.is_finite()), || "samples has values that are not finite".to_owned())?;
    let width = array.shape()[dimensions - 1];
    require(width >= 2 && lags > 0, || format!("{width} samples and {lags} lags; give 2 samples and 1 lag at least"))?;
    let all: Vec<f64> = array.iter().copied().collect();
    let estimate =
        py.detach(|| noise::estimate(&all.chunks_exact(width).map(<[f64]>::to_vec).collect::<Vec<_>>(), lags));
    Ok(Noise { sd: estimate.sd, acf: vector(py, estimate.acf) })
}

/// The autocorrelation of the autoregressive process that describes an estimated one best.
///
/// It is always a valid autocorrelation, and free of the scatter of lags that the estimate does not determine.
///
/// Parameters
/// ----------
/// acf : array_like, shape (lags,)
///     The estimate, as `estimate_noise` gives it.
/// samples : int
///     Number of samples behind the estimate.
///
/// Returns
/// -------
/// numpy.ndarray, shape (lags,)
///
/// Notes
/// -----
/// The order has the smallest Bayesian information criterion (Schwarz, Ann. Stat. 6, 461, 1978).
#[pyfunction]
pub fn autoregressive_acf(py: Python<'_>, acf: Vector<'_>, samples: usize) -> PyResult<Py<PyArray1<f64>>> {
    let acf = finite("acf", &acf)?;
    require(acf.first().is_some_and(|first| *first > 0.0), || "acf must be above 0 at lag 0".to_owned())?;
    Ok(vector(py, py.detach(|| noise::autoregressive(&acf, samples))))
}

/// Start of the stretch of `width` samples that vary least.
///
/// Parameters
/// ----------
/// samples : array_like, shape (samples,)
/// width : int
///     Samples of the stretch.
///
/// Returns
/// -------
/// int
#[pyfunction]
pub fn quietest(samples: Vector<'_>, width: usize) -> PyResult<usize> {
    let samples = finite("samples", &samples)?;
    require((1..=samples.len()).contains(&width), || format!("width is {width} of {} samples", samples.len()))?;
    Ok(noise::quietest(&samples, width))
}

/// Impulse response of a sensor: a cubic spline through values on an even grid.
///
/// Parameters
/// ----------
/// t0_ps : float
///     Time of the first value. Time 0 is the arrival of the pulse.
/// step_ps : float
///     Time between values; finer than the samples of the record.
/// values : array_like, shape (values,)
///     With a maximum of 1, amplitudes of pulses have the unit of the record.
#[pyclass(frozen, module = "periscope")]
pub struct Response(pub response::Response);

#[pymethods]
impl Response {
    #[new]
    fn new(t0_ps: f64, step_ps: f64, values: Vector<'_>) -> PyResult<Self> {
        let values = finite("values", &values)?;
        require(values.len() >= 2, || format!("a response has {} values; give 2 at least", values.len()))?;
        let (t0_ps, step_ps) = (number("t0_ps", t0_ps)?, positive("step_ps", step_ps)?);
        Ok(Self(response::Response::new(t0_ps, step_ps, &values)))
    }

    /// Values at times (ps) after the arrival of the pulse; 0 outside of the support.
    fn value(&self, py: Python<'_>, time_ps: Vector<'_>) -> Py<PyArray1<f64>> {
        vector(py, time_ps.as_array().iter().map(|time_ps| self.0.value(*time_ps)).collect())
    }

    /// First and last time (ps) at which it may differ from 0.
    #[getter]
    fn support_ps(&self) -> (f64, f64) {
        self.0.support_ps()
    }

    /// Full width at half maximum, ps; of a step, its height over its steepest slope.
    #[getter]
    fn width_ps(&self) -> f64 {
        self.0.width_ps()
    }

    /// Time of the maximum, ps; of a step, of its steepest rise.
    #[getter]
    fn peak_ps(&self) -> f64 {
        self.0.peak_ps()
    }

    /// Largest value.
    #[getter]
    fn height(&self) -> f64 {
        self.0.height()
    }

    /// The response of the mean that `average` makes: each shot was moved by a filter, which widens it a little.
    ///
    /// Parameters
    /// ----------
    /// dt_ps : float
    ///     Time between samples of the shots.
    /// phase_shots : array_like, shape (64,)
    ///     `Mean.phase_shots`.
    /// negligible : float, default 1e-4
    ///     Ends below this share of the maximum are cut off. Give less where a pulse exceeds the noise of a sample by
    ///     more than 1,000.
    ///
    /// Returns
    /// -------
    /// Response
    #[pyo3(signature = (dt_ps, phase_shots, negligible=1e-4))]
    fn averaged(&self, dt_ps: f64, phase_shots: Integers<'_>, negligible: f64) -> PyResult<Self> {
        let shots: Vec<i32> = phase_shots.as_array().iter().map(|shots| *shots as i32).collect();
        let is_count = shots.len() == PHASES && shots.iter().all(|n| *n >= 0) && shots.iter().any(|n| *n > 0);
        require(is_count, || format!("phase_shots are {PHASES} counts of shots, as Mean.phase_shots has them"))?;
        let (dt_ps, negligible) = (positive("dt_ps", dt_ps)?, positive("negligible", negligible)?);
        require(negligible < 1.0, || format!("negligible is {negligible}; give a share below 1"))?;
        let (first_ps, last_ps) = self.0.support_ps();
        require(last_ps - first_ps <= MOST_SAMPLES * dt_ps, || {
            format!(
                "dt_ps is {dt_ps}, of which the response has more than {MOST_SAMPLES}; give the time between samples of its shots"
            )
        })?;
        Ok(Self(averaged_response::averaged_response(&self.0, dt_ps, &shots, negligible)))
    }

    fn __repr__(&self) -> String {
        let (first_ps, last_ps) = self.0.support_ps();
        format!("<Response of width {:.4} ps, from {first_ps:.4} to {last_ps:.4} ps>", self.0.width_ps())
    }
}

/// A response with the times of the shots that it was estimated from.
#[pyclass(frozen, get_all, module = "periscope")]
pub struct ResponseEstimate {
    /// The response, with maximum 1 at time 0.
    response: Py<Response>,
    /// Height of the pulse, in the unit of the shots.
    height: f64,
    /// Time of the maximum in each shot, ps, on the clock of `t0_ps`; NaN where a shot has no pulse; shape (shots,).
    time_ps: Py<PyArray1<f64>>,
    /// Standard deviation of `time_ps`; shape (shots,).
    time_sd_ps: Py<PyArray1<f64>>,
}

/// Estimates the impulse response of a sensor from shots of one short pulse.
///
/// Its grid is eight times finer than the samples: trigger jitter moves the pulse between them, and shape and times are
/// estimated in turn (equivalent-time sampling).
///
/// Parameters
/// ----------
/// shots : array_like, shape (shots, samples)
///     Values, such as `Waveforms.volts()`. The record must begin before the pulse.
/// dt_ps : float
///     Time between samples.
/// t0_ps : float or array_like, shape (shots,)
///     Time of sample 0 of each shot.
///
/// Returns
/// -------
/// ResponseEstimate
///
/// Raises
/// ------
/// UndeterminedError
///     If the shots show no pulse.
#[pyfunction]
#[pyo3(signature = (shots, dt_ps, t0_ps=Each::All(0.0)))]
pub fn estimate_response(py: Python<'_>, shots: Rows<'_>, dt_ps: f64, t0_ps: Each<'_>) -> PyResult<ResponseEstimate> {
    let array = shots.as_array();
    let (count, width) = array.dim();
    require(count > 0 && width > 0, || format!("shots has shape ({count}, {width}); give at least one sample"))?;
    require(array.iter().all(|value| value.is_finite()), || "shots has values that are not finite".to_owned())?;
    let dt_ps = positive("dt_ps", dt_ps)?;
    let starts_ps = t0_ps.values("t0_ps", count)?;
    let shot =
        |(samples, t0_ps): (&[f64], &f64)| Ok(Shot { samples: samples.to_vec(), t0_ps: number("t0_ps", *t0_ps)? });
    let values: Vec<f64> = array.iter().copied().collect();
    let shots: Vec<Shot> = values.chunks_exact(width).zip(&starts_ps).map(shot).collect::<PyResult<_>>()?;
    let estimate = interruptible(py, |_| oversample::shape_and_times(&shots, dt_ps))?;
    let (shape, times) = estimate.ok_or_else(|| {
        crate::failure::UndeterminedError::new_err("the shots show no pulse; check their scale, or give longer records")
    })?;
    let of_each = |part: fn((f64, f64)) -> f64| times.iter().map(|time| time.map_or(f64::NAN, part)).collect();
    Ok(ResponseEstimate {
        response: Py::new(py, Response(shape.response()))?,
        height: shape.height,
        time_ps: vector(py, of_each(|(time_ps, _)| time_ps)),
        time_sd_ps: vector(py, of_each(|(_, sd_ps)| sd_ps)),
    })
}

/// Frees a histogram of single photons of pile-up.
///
/// A detector that counts at most one photon in a dead time loses those that follow.
///
/// Parameters
/// ----------
/// counts : array_like of int, shape (bins,)
///     Photons counted in each bin.
/// cycles : int
///     Laser pulses.
/// dead_bins : int
///     Bins after each count in which the detector is dead.
///
/// Returns
/// -------
/// photons : numpy.ndarray, shape (bins,)
///     Photons that all laser pulses bring to each bin.
/// ready : numpy.ndarray, shape (bins,)
///     Laser pulses for which the detector was ready in each bin; 0 where the bin determines nothing.
///
/// Raises
/// ------
/// UndeterminedError
///     If more photons fall into a dead time than there are laser pulses.
///
/// Notes
/// -----
/// Source: Coates, J. Phys. E 1, 878 (1968).
#[pyfunction]
#[pyo3(signature = (counts, cycles, dead_bins=0))]
pub fn correct_pile_up(
    py: Python<'_>,
    counts: Integers<'_>,
    cycles: u64,
    dead_bins: usize,
) -> PyResult<(Py<PyArray1<f64>>, Py<PyArray1<f64>>)> {
    let unpiled = unpiled(&counts, cycles, dead_bins)?;
    Ok((vector(py, unpiled.counts), vector(py, unpiled.ready)))
}

/// A histogram freed of pile-up.
pub fn unpiled(counts: &Integers<'_>, cycles: u64, dead_bins: usize) -> PyResult<Unpiled> {
    let count = |count: &i64| {
        u32::try_from(*count).map_err(|_| PyValueError::new_err(format!("{count} is no number of photons in a bin")))
    };
    let counts: Vec<u32> = counts.as_array().iter().map(count).collect::<PyResult<_>>()?;
    require(!counts.is_empty() && cycles > 0, || "a histogram has a bin and a laser pulse at least".to_owned())?;
    Unpiled::new(&counts, cycles, dead_bins).map_err(of_signal)
}
