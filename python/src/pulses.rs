//! Deconvolution into pulses.

use numpy::{PyArray1, PyArray2, PyArrayMethods};
use periscope::signal::sparse::{self, Baseline, Profile, Pulse, SparseFit, SparseOptions};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::arrays::{Each, Integers, Vector, finite, matrix, number, positive, require, vector};
use crate::interrupt::{FEW, interruptible_unless};
use crate::plots::plot;
use crate::profiles::{Response, unpiled};

/// Pulses of a profile, by rising time.
#[pyclass(frozen, get_all, module = "periscope")]
pub struct Pulses {
    /// Arrival of each pulse, ps: where time 0 of the response lies; shape (pulses,).
    time_ps: Py<PyArray1<f64>>,
    /// Standard deviation of `time_ps`; shape (pulses,).
    time_sd_ps: Py<PyArray1<f64>>,
    /// Covariance of the times, ps^2; shape (pulses, pulses).
    covariance_ps2: Py<PyArray2<f64>>,
    /// Factor of the response, in the unit of the profile; shape (pulses,).
    amplitude: Py<PyArray1<f64>>,
    /// Standard deviation of `amplitude`; shape (pulses,).
    amplitude_sd: Py<PyArray1<f64>>,
    /// Standard deviation of the spread in time of the light of each pulse, ps; 0 for a point; shape (pulses,).
    width_ps: Py<PyArray1<f64>>,
    /// Standard deviation of `width_ps`; shape (pulses,).
    width_sd_ps: Py<PyArray1<f64>>,
    /// Time constant of the exponential tail of the light, ps; 0 for none; shape (pulses,).
    tail_ps: Py<PyArray1<f64>>,
    /// Rise of chi2 when the pulse is taken out and its neighbours are fitted again; shape (pulses,).
    evidence: Py<PyArray1<f64>>,
    /// Chi2 per degree of freedom of the samples that the pulse reaches; shape (pulses,).
    pulse_chi2_per_dof: Py<PyArray1<f64>>,
    /// Constant under the pulses, in the unit of the profile.
    baseline: f64,
    /// Chi2 per degree of freedom of the profile.
    chi2_per_dof: f64,
    /// Threshold that was applied to the evidence.
    evidence_min: f64,
}

impl Pulses {
    fn of(py: Python<'_>, fit: SparseFit) -> PyResult<Self> {
        let count = fit.pulses.len();
        let each = |value: fn(&Pulse) -> f64| vector(py, fit.pulses.iter().map(value).collect());
        Ok(Self {
            time_ps: each(|pulse| pulse.time_ps),
            time_sd_ps: vector(py, (0..count).map(|k| fit.time_sd_ps(k)).collect()),
            amplitude: each(|pulse| pulse.amplitude_v),
            amplitude_sd: each(|pulse| pulse.amplitude_sd_v),
            width_ps: each(|pulse| pulse.width_ps),
            width_sd_ps: each(|pulse| pulse.width_sd_ps),
            tail_ps: each(|pulse| pulse.tail_ps),
            evidence: each(|pulse| pulse.evidence),
            pulse_chi2_per_dof: each(|pulse| pulse.chi2_per_dof),
            covariance_ps2: matrix(py, fit.covariance_ps2, count, count)?,
            baseline: fit.baseline_v,
            chi2_per_dof: fit.chi2_per_dof,
            evidence_min: fit.evidence_min,
        })
    }
}

#[pymethods]
impl Pulses {
    /// Draws each pulse as a line of its amplitude, with standard deviations. Needs matplotlib.
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
        plot(slf, "pulses", ax)
    }

    fn __len__(&self, py: Python<'_>) -> PyResult<usize> {
        self.time_ps.bind(py).len()
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let (times, sds) = (self.time_ps.bind(py).to_vec()?, self.time_sd_ps.bind(py).to_vec()?);
        let pulses: Vec<String> = times.iter().zip(sds).map(|(time, sd)| format!("{time:.2} ± {sd:.2}")).collect();
        Ok(format!("<Pulses at ({}) ps>", pulses.join(", ")))
    }
}

/// What the caller asks of a fit.
fn options(
    baseline: &str,
    evidence_min: Option<f64>,
    pulses_max: usize,
    signed: bool,
    extent_max_ps: f64,
) -> PyResult<SparseOptions> {
    let baseline = match baseline {
        "none" => Baseline::None,
        "constant" => Baseline::Constant,
        "line" => Baseline::Line,
        other => {
            let problem = format!("baseline is {other:?}; give \"none\", \"constant\" or \"line\"");
            return Err(PyValueError::new_err(problem));
        }
    };
    let evidence_min = evidence_min.map(|least| positive("evidence_min", least)).transpose()?;
    require(number("extent_max_ps", extent_max_ps)? >= 0.0, || "extent_max_ps must not be negative".to_owned())?;
    Ok(SparseOptions { evidence_min, pulses_max, baseline, signed, extent_max_ps, ..SparseOptions::default() })
}

/// Deconvolves a mean profile into pulses, by maximum likelihood.
///
/// Pulses are added while each lowers chi2 by more than the threshold, and all are fitted together.
///
/// Parameters
/// ----------
/// mean : array_like, shape (samples,)
///     Profile, as a rule in V. Sample n lies at `t0_ps + n * dt_ps`.
/// sd : float or array_like, shape (samples,)
///     Standard deviation of each sample of `mean`. Infinite: the sample is ignored.
/// response : Response
///     Impulse response of the sensor.
/// dt_ps : float
///     Time between samples.
/// t0_ps : float
///     Time of sample 0.
/// acf : array_like, shape (lags,), optional
///     Autocorrelation of the noise from lag 0 on; without it, the noise is white. Pass an estimate through
///     `autoregressive_acf` first.
/// baseline : {"line", "constant", "none"}
///     What is fitted under the pulses.
/// evidence_min : float, optional
///     Drop of chi2 that a pulse must be worth. By default a record of noise shows 1e-4 false pulses.
/// pulses_max : int
///     Most pulses.
/// signed : bool
///     Whether amplitudes may be negative, as of reflections on a line.
/// extent_max_ps : float
///     Largest standard deviation of the spread in time of one pulse's light, as extended surfaces give; 0 for points.
///
/// Returns
/// -------
/// Pulses
///     Times, amplitudes, widths, covariance and evidence.
///
/// Notes
/// -----
/// The method and its limits: docs/time-resolution.md of the project. Two pulses are separated at a fifth of the width
/// of the response.
#[pyfunction]
#[pyo3(signature = (
    mean, sd, response, *, dt_ps, t0_ps=0.0, acf=None, baseline="line", evidence_min=None, pulses_max=64, signed=false,
    extent_max_ps=0.0
))]
pub fn deconvolve(
    py: Python<'_>,
    mean: Vector<'_>,
    sd: Each<'_>,
    response: &Bound<'_, Response>,
    dt_ps: f64,
    t0_ps: f64,
    acf: Option<Vector<'_>>,
    baseline: &str,
    evidence_min: Option<f64>,
    pulses_max: usize,
    signed: bool,
    extent_max_ps: f64,
) -> PyResult<Pulses> {
    let mean = finite("mean", &mean)?;
    require(!mean.is_empty(), || "mean has no samples".to_owned())?;
    let sd = sd.standard_deviations("sd", mean.len())?;
    let acf = acf.map(|acf| finite("acf", &acf)).transpose()?.unwrap_or_default();
    require(acf.first().is_none_or(|first| *first > 0.0), || "acf must be above 0 at lag 0".to_owned())?;
    let (t0_ps, dt_ps) = (number("t0_ps", t0_ps)?, positive("dt_ps", dt_ps)?);
    let options = options(baseline, evidence_min, pulses_max, signed, extent_max_ps)?;
    let response = &response.get().0;
    let fit = interruptible_unless(mean.len() <= FEW, py, |cancel| {
        let profile = Profile { mean_v: &mean, sd_v: &sd, acf: &acf, slow_v2: &[], jitter: None, t0_ps, dt_ps };
        sparse::fit(&profile, response, &SparseOptions { cancel: cancel.clone(), ..options })
    })?;
    Pulses::of(py, fit)
}

/// Fits pulses to a histogram of single photons, by maximum likelihood.
///
/// Pile-up is corrected, and the variance of each bin follows from the fit.
///
/// Parameters
/// ----------
/// counts : array_like of int, shape (bins,)
///     Photons counted in each bin. Bin n lies at `t0_ps + n * dt_ps`.
/// response : Response
///     Impulse response of laser and detector.
/// cycles : int
///     Laser pulses.
/// dt_ps : float
///     Width of a bin.
/// t0_ps : float
///     Time of bin 0.
/// dead_bins : int
///     Bins after each count in which the detector is dead.
/// baseline : {"constant", "line", "none"}
///     What is fitted under the pulses: dark counts and ambient light are constant.
/// evidence_min, pulses_max, extent_max_ps
///     As of `deconvolve`.
///
/// Returns
/// -------
/// Pulses
///     Amplitudes and baseline in photons a bin.
///
/// Raises
/// ------
/// UndeterminedError
///     If more photons fall into a dead time than there are laser pulses.
///
/// Notes
/// -----
/// Source: Coates, J. Phys. E 1, 878 (1968); McCullagh and Nelder, *Generalized Linear Models*, section 2.5.
#[pyfunction]
#[pyo3(signature = (
    counts, response, *, cycles, dt_ps, t0_ps=0.0, dead_bins=0, baseline="constant", evidence_min=None, pulses_max=64,
    extent_max_ps=0.0
))]
pub fn deconvolve_counts(
    py: Python<'_>,
    counts: Integers<'_>,
    response: &Bound<'_, Response>,
    cycles: u64,
    dt_ps: f64,
    t0_ps: f64,
    dead_bins: usize,
    baseline: &str,
    evidence_min: Option<f64>,
    pulses_max: usize,
    extent_max_ps: f64,
) -> PyResult<Pulses> {
    let histogram = unpiled(&counts, cycles, dead_bins)?;
    let (t0_ps, dt_ps) = (number("t0_ps", t0_ps)?, positive("dt_ps", dt_ps)?);
    let options = options(baseline, evidence_min, pulses_max, false, extent_max_ps)?;
    let response = &response.get().0;
    let fit = interruptible_unless(histogram.counts.len() <= FEW, py, |cancel| {
        let options = SparseOptions { cancel: cancel.clone(), ..options };
        sparse::fit_counts(&histogram, t0_ps, dt_ps, response, &options)
    })?;
    Pulses::of(py, fit)
}
