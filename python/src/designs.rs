//! What a planned measurement can show: the Cramer-Rao bound of a scene.

use std::path::PathBuf;

use numpy::{PyArray1, PyArray2};
use periscope::bound::design::Design;
use periscope::bound::pulses::{NoBound, Samples, Under, pulses_bound};
use periscope::bound::{self, Use};
use periscope::simulate::Scene;
use periscope::simulate::wall::WallScene;
use periscope::wall_outlook::WallOutlook;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::arrays::{Each, Vector, finite, matrix, number, positive, require, vector};
use crate::failure::{UndeterminedError, of_scene, of_simulation};
use crate::interrupt::{interruptible, interruptible_run};
use crate::profiles::Response;

fn order(bounces: Option<usize>) -> PyResult<()> {
    let strange = bounces.filter(|bounces| !(1..=5).contains(bounces));
    require(strange.is_none(), || format!("bounces is {}; light is followed over 1 to 5", strange.unwrap_or_default()))
}

/// The outlook of a scene, or of a relay wall, as a JSON text; `periscope.design` reads it.
///
/// Parameters
/// ----------
/// scene : path
/// bounces : int, optional
/// threshold_sigma : float
#[pyfunction]
pub fn design_json(py: Python<'_>, scene: PathBuf, bounces: Option<usize>, threshold_sigma: f64) -> PyResult<String> {
    order(bounces)?;
    let threshold_sigma = positive("threshold_sigma", threshold_sigma)?;
    if WallScene::is_in(&scene).map_err(of_scene)? {
        require(bounces.is_none(), || "bounces has no meaning for a wall: first light has three bounces".to_owned())?;
        let wall = WallScene::load(&scene).map_err(of_scene)?;
        let outlooks = interruptible(py, |cancel| WallOutlook::all(&wall, threshold_sigma, cancel))?;
        return serde_json::to_string(&outlooks).map_err(|error| PyValueError::new_err(error.to_string()));
    }
    let scene = Scene::load(&scene).map_err(of_scene)?;
    let design = interruptible_run(py, |_| Design::new(scene, bounces, threshold_sigma))?.map_err(of_simulation)?;
    Ok(design.object().to_string())
}

/// A pulse of a mean profile, and how well its time can be known.
#[pyclass(frozen, get_all, module = "periscope")]
pub struct PulseBound {
    /// Sensor.
    sensor: String,
    /// Vertical range, where the instrument has several.
    range: Option<String>,
    /// Patch or view lit.
    lit: i32,
    /// Patch or view seen.
    seen: i32,
    /// Patches in the order in which light meets them.
    path: Vec<i32>,
    /// Time of flight, ps.
    time_ps: f64,
    /// Signal-to-noise ratio of the matched filter in the mean of all shots.
    snr: f64,
    /// Bound of the time's standard deviation, with all else in the profile unknown; None where the pulse is too weak,
    /// or not resolved from another.
    time_sd_ps: Option<f64>,
}

/// The Cramer-Rao bound of a scene: the best precision of any unbiased estimator.
#[pyclass(frozen, get_all, module = "periscope")]
pub struct Bounds {
    /// Patches about which there is information, ascending; shape (patches,).
    patch: Py<PyArray1<i32>>,
    /// Bound of each patch's standard deviation, m: root of the sum of its variances; NaN where it is not determined;
    /// shape (patches,).
    sd_m: Py<PyArray1<f64>>,
    /// Bound of the covariance, m^2, `dimensions` rows a patch, without `free_rotations`.
    covariance_m2: Py<PyArray2<f64>>,
    /// Coordinates of a patch: 3, or 2 in flatland.
    dimensions: usize,
    /// Rotations about the stations that no time determines.
    free_rotations: usize,
    /// Onsets that determine each patch; shape (patches,).
    onsets: Py<PyArray1<i64>>,
    /// Pulses of all captures of the scene.
    pulses: Vec<Py<PulseBound>>,
}

#[pymethods]
impl Bounds {
    fn __len__(&self, py: Python<'_>) -> PyResult<usize> {
        self.patch.bind(py).len()
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        Ok(format!("<Bounds of {} patches from {} pulses>", self.__len__(py)?, self.pulses.len()))
    }
}

/// The Cramer-Rao bound of a scene: of the time of each pulse, and of all positions together.
///
/// It shares no code with the estimators. Amplitudes, baselines, delays and the width of the response are unknown.
///
/// Parameters
/// ----------
/// scene : str or os.PathLike
///     Scene description (TOML), as for `simulate`.
/// bounces : int
///     Highest order of bounces whose times enter the positions, 1 to 5; hidden patches need 3.
/// threshold_sigma : float
///     Signal-to-noise ratio from which a pulse counts as an onset.
///
/// Returns
/// -------
/// Bounds
///
/// Raises
/// ------
/// CampaignError
///     If the scene contradicts itself.
///
/// See Also
/// --------
/// design : what the bound means for a planned measurement, and what changes would bring.
#[pyfunction]
#[pyo3(signature = (scene, *, bounces=2, threshold_sigma=5.0))]
pub fn bounds(py: Python<'_>, scene: PathBuf, bounces: usize, threshold_sigma: f64) -> PyResult<Bounds> {
    order(Some(bounces))?;
    let using = Use { bounces, threshold_sigma: positive("threshold_sigma", threshold_sigma)? };
    let mut scene = Scene::load(&scene).map_err(of_scene)?;
    scene.captures.bounces = scene.captures.bounces.max(bounces);
    let bound = interruptible_run(py, |_| bound::Bound::new(&scene, using))?.map_err(of_simulation)?;
    let pulses = bound.profiles.iter().flat_map(|profile| {
        profile.pulses.iter().map(|pulse| PulseBound {
            sensor: profile.sensor.clone(),
            range: profile.range.clone(),
            lit: profile.lit,
            seen: profile.seen,
            path: pulse.path.clone(),
            time_ps: pulse.time_ps,
            snr: pulse.snr,
            time_sd_ps: pulse.time_sd_ps,
        })
    });
    let pulses = pulses.map(|pulse| Py::new(py, pulse)).collect::<PyResult<_>>()?;
    let all = &bound.coordinates;
    let side = all.covariance.nrows();
    let sds = all.patches.iter().map(|patch| all.sd_m(*patch).unwrap_or(f64::NAN)).collect();
    Ok(Bounds {
        patch: vector(py, all.patches.clone()),
        sd_m: vector(py, sds),
        covariance_m2: matrix(py, all.covariance.transpose().as_slice().to_vec(), side, side)?,
        dimensions: all.dimensions,
        free_rotations: all.turns,
        onsets: vector(py, all.onsets.iter().map(|onsets| *onsets as i64).collect()),
        pulses,
    })
}

/// The Cramer-Rao bound of pulses in a mean profile.
#[pyclass(frozen, get_all, module = "periscope")]
pub struct TimeBound {
    /// Least standard deviation of the time of each pulse, ps; shape (pulses,).
    time_sd_ps: Py<PyArray1<f64>>,
    /// Least covariance of the times, ps^2; shape (pulses, pulses).
    covariance_ps2: Py<PyArray2<f64>>,
    /// Least standard deviation of each amplitude, in its unit; shape (pulses,).
    amplitude_sd: Py<PyArray1<f64>>,
}

/// The Cramer-Rao bound of the times of pulses in a mean profile: no unbiased estimator is more precise.
///
/// All times and amplitudes are unknown, and what lies under the pulses. The response is known.
///
/// Parameters
/// ----------
/// time_ps : array_like, shape (pulses,)
///     Arrival of each pulse: where time 0 of the response lies.
/// amplitude : float or array_like, shape (pulses,)
///     Factor of the response, as of `Pulses.amplitude`.
/// response : Response
///     Impulse response of the sensor.
/// sd : float or array_like, shape (samples,)
///     Standard deviation of each sample of the mean, in the unit of the amplitudes. Infinite: the sample is ignored.
/// samples : int
///     Samples of the profile. Sample n lies at `t0_ps + n * dt_ps`.
/// dt_ps : float
///     Time between samples.
/// t0_ps : float
///     Time of sample 0.
/// acf : array_like, shape (lags,), optional
///     Autocorrelation of the noise from lag 0 on; without it, the noise is white.
/// baseline : {"line", "constant", "none"}
///     What is unknown under the pulses.
///
/// Returns
/// -------
/// TimeBound
///
/// Raises
/// ------
/// UndeterminedError
///     If the samples do not determine the times: pulses coincide, lie outside of the record, or have no amplitude.
/// ValueError
///     If an argument has values that are not finite, or `acf` is not that of any noise.
///
/// See Also
/// --------
/// deconvolve : estimates the times.
/// bounds : the bound of a whole scene.
///
/// Notes
/// -----
/// Source: Kay, *Fundamentals of Statistical Signal Processing: Estimation Theory*, section 3.9 (Fisher information of
/// Gaussian samples). It shares no code with `deconvolve`.
#[pyfunction]
#[pyo3(signature = (time_ps, amplitude, response, sd, *, samples, dt_ps, t0_ps=0.0, acf=None, baseline="line"))]
pub fn time_bound(
    py: Python<'_>,
    time_ps: Vector<'_>,
    amplitude: Each<'_>,
    response: &Bound<'_, Response>,
    sd: Each<'_>,
    samples: usize,
    dt_ps: f64,
    t0_ps: f64,
    acf: Option<Vector<'_>>,
    baseline: &str,
) -> PyResult<TimeBound> {
    let times_ps = finite("time_ps", &time_ps)?;
    require(!times_ps.is_empty() && samples > 0, || "give at least one pulse and one sample".to_owned())?;
    let amplitudes = amplitude.values("amplitude", times_ps.len())?;
    require(amplitudes.iter().all(|value| value.is_finite()), || {
        "amplitude has values that are not finite".to_owned()
    })?;
    let sd = sd.standard_deviations("sd", samples)?;
    let acf = acf.map(|acf| finite("acf", &acf)).transpose()?.unwrap_or_default();
    let under = match baseline {
        "none" => Under::Nothing,
        "constant" => Under::Constant,
        "line" => Under::Line,
        other => {
            let problem = format!("baseline is {other:?}; give \"none\", \"constant\" or \"line\"");
            return Err(PyValueError::new_err(problem));
        }
    };
    let (t0_ps, dt_ps) = (number("t0_ps", t0_ps)?, positive("dt_ps", dt_ps)?);
    let pulses: Vec<(f64, f64)> = times_ps.into_iter().zip(amplitudes).collect();
    let response = &response.get().0;
    let bound = interruptible(py, |_| {
        let samples = Samples { t0_ps, dt_ps, sd: &sd, acf: &acf };
        pulses_bound(&samples, &|after_ps| response.value_and_slope(after_ps), &pulses, under)
    })?;
    let bound = bound.map_err(|error| match error {
        NoBound::Undetermined => UndeterminedError::new_err(error.to_string()),
        NoBound::Autocorrelation => PyValueError::new_err(format!("acf: {error}; pass it through autoregressive_acf")),
    })?;
    let count = pulses.len();
    Ok(TimeBound {
        time_sd_ps: vector(py, (0..count).map(|k| bound.covariance_ps2[(k, k)].sqrt()).collect()),
        covariance_ps2: matrix(py, bound.covariance_ps2.as_slice().to_vec(), count, count)?,
        amplitude_sd: vector(py, bound.amplitude_sd),
    })
}
