//! What a planned measurement can show: the Cramer-Rao bound of a scene.

use std::path::PathBuf;

use numpy::{PyArray1, PyArray2};
use periscope::bound::design::Design;
use periscope::bound::{self, Use};
use periscope::simulate::Scene;
use pyo3::prelude::*;

use crate::arrays::{matrix, positive, require, vector};
use crate::failure::{of_scene, of_simulation};
use crate::interrupt::interruptible_run;

fn order(bounces: Option<usize>) -> PyResult<()> {
    let strange = bounces.filter(|bounces| !(1..=5).contains(bounces));
    require(strange.is_none(), || format!("bounces is {}; light is followed over 1 to 5", strange.unwrap_or_default()))
}

/// The outlook of a scene as a JSON text; `periscope.design` reads it.
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
