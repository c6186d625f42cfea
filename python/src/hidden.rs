//! Searches for hidden patches.

use numpy::{PyArray1, PyArray2};
use periscope::geometry::hidden::{self, Arrival, Hidden, Surface, facing};
use periscope::geometry::{Point, faint};
use periscope::signal::sparse::{Given, Open, Profile, matched};
use periscope::units::path_m;
use pyo3::prelude::*;

use crate::arrays::{
    Each, Rows, Vector, dimensions as space, finite, matrix, number, place, points, positive, require, vector,
};
use crate::failure::UndeterminedError;
use crate::interrupt::{FEW, interruptible, interruptible_unless};
use crate::profiles::Response;

/// A hidden patch.
#[pyclass(frozen, get_all, module = "periscope")]
pub struct HiddenPatch {
    /// Position, m; shape (3,).
    point_m: Py<PyArray1<f64>>,
    /// Its covariance, m^2, visible patches taken as exact; shape (3, 3).
    covariance_m2: Py<PyArray2<f64>>,
    /// Log of the Bayes factor of this patch over none. Chance exceeds `-log(alpha)` with a probability of at most
    /// alpha.
    evidence: f64,
    /// Share of the profiles that show it, or could have recorded it.
    seen: f64,
    /// Signal-to-noise ratio in all profiles together; None where arrivals were searched.
    snr: Option<f64>,
    /// Position of its mirror image in the wall, where the arrivals do not rule it out.
    mirror_m: Option<[f64; 3]>,
}

#[pymethods]
impl HiddenPatch {
    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let point: Vec<f64> = self.point_m.extract(py)?;
        Ok(format!("<HiddenPatch at {point:.3?} m, evidence {:.1}>", self.evidence))
    }
}

/// Visible patches, and what light goes through.
struct Scene {
    foci: Vec<hidden::Focus>,
    dimensions: usize,
    index: f64,
}

impl Scene {
    fn new(
        visible_m: &Rows<'_>,
        pairs: &[(usize, usize)],
        (source_m, normals): ([f64; 3], Option<Rows<'_>>),
        dimensions: usize,
        group_index: f64,
    ) -> PyResult<Self> {
        let (visible, dimensions) = (points("visible_m", visible_m)?, space(dimensions)?);
        let strange = pairs.iter().find(|(lit, seen)| (*lit).max(*seen) >= visible.len());
        require(strange.is_none(), || format!("pairs name {strange:?}; visible_m has {} rows", visible.len()))?;
        require(!pairs.is_empty(), || "pairs is empty; name the lit and the seen patch of each profile".to_owned())?;
        if !facing::spans(&visible, dimensions) {
            return Err(UndeterminedError::new_err(
                "the visible patches lie in one line: a hidden patch may turn about it; add a patch off that line",
            ));
        }
        let normals = match normals {
            Some(rows) => points("normals", &rows)?.iter().map(|normal| Some(normal.coords)).collect(),
            None => vec![None; visible.len()],
        };
        let count = normals.len();
        require(count == visible.len(), || format!("normals has {count} rows for {} patches", visible.len()))?;
        let source = place("source_m", source_m)?;
        let foci = facing::fronts(&visible, &normals, source, dimensions);
        Ok(Self { foci, dimensions, index: positive("group_index", group_index)? })
    }
}

/// Finds hidden patches from times of third bounces, whose number and labels are not known.
///
/// Light over a lit patch a, a hidden patch q and a seen patch b takes the time of `|q - a| + |q - b|`. Each profile
/// has such times among others. Patches are searched in all of space and accepted by their evidence.
///
/// Parameters
/// ----------
/// visible_m : array_like, shape (patches, 3)
///     Positions of the visible patches.
/// pairs : sequence of (int, int)
///     Lit and seen patch of each profile, as rows of `visible_m`.
/// time_ps : sequence of array_like
///     For each profile its arrivals: times from the lit patch to the seen one. Take off the ways from the laser and to
///     the sensor, and leave out times that visible patches explain.
/// time_sd_ps : float or sequence of array_like
///     Standard deviations.
/// span_ps : (float, float)
///     First and last time that the records hold, on the same clock.
/// source_m : (float, float, float)
///     Position of the laser: patches behind the walls that it lights are not searched.
/// normals : array_like, shape (patches, 3), optional
///     Normals of the visible patches; by default that of the one plane on which all lie.
/// dimensions : {3, 2}
/// false_alarm : float
///     Probability that a patch is found where there is none.
/// count : int, optional
///     Number of hidden patches, if it is known.
/// blend_ps : float
///     Times nearer than this may be one arrival; 0: each has its own.
/// group_index : float
///     Group index of the medium.
///
/// Returns
/// -------
/// list of HiddenPatch
///     The surest first.
///
/// Raises
/// ------
/// UndeterminedError
///     If the visible patches lie in one line.
///
/// Notes
/// -----
/// Source: Kirmani et al., ICCV 2009, section 4.3, without its labelling by order. The method and its limits:
/// docs/guide/stages/label.md of the project.
#[pyfunction]
#[pyo3(signature = (
    visible_m, pairs, time_ps, time_sd_ps, span_ps, *, source_m=[0.0; 3], normals=None, dimensions=3, false_alarm=1e-3,
    count=None, blend_ps=0.0, group_index=1.0
))]
pub fn find_hidden(
    py: Python<'_>,
    visible_m: Rows<'_>,
    pairs: Vec<(usize, usize)>,
    time_ps: Vec<Vector<'_>>,
    time_sd_ps: Spread<'_>,
    span_ps: (f64, f64),
    source_m: [f64; 3],
    normals: Option<Rows<'_>>,
    dimensions: usize,
    false_alarm: f64,
    count: Option<usize>,
    blend_ps: f64,
    group_index: f64,
) -> PyResult<Vec<HiddenPatch>> {
    let Scene { foci, dimensions, index } =
        Scene::new(&visible_m, &pairs, (source_m, normals), dimensions, group_index)?;
    require(false_alarm > 0.0 && false_alarm < 1.0, || format!("false_alarm is {false_alarm}; it is a probability"))?;
    require(number("blend_ps", blend_ps)? >= 0.0, || "blend_ps must not be negative".to_owned())?;
    require(time_ps.len() == pairs.len(), || format!("time_ps has {} lists for {} pairs", time_ps.len(), pairs.len()))?;
    let span_m = [path_m(number("span_ps", span_ps.0)?, index), path_m(number("span_ps", span_ps.1)?, index)];
    require(span_m[0] < span_m[1], || "span_ps must rise".to_owned())?;
    let mut profiles = Vec::with_capacity(pairs.len());
    for (n, ((lit, seen), times)) in pairs.iter().zip(&time_ps).enumerate() {
        let times_ps = finite(&format!("time_ps[{n}]"), times)?;
        let sds_ps = time_sd_ps.of(n, times_ps.len())?;
        let arrival =
            |(time_ps, sd_ps): (&f64, &f64)| Arrival { length_m: path_m(*time_ps, index), sd_m: path_m(*sd_ps, index) };
        let arrivals = times_ps.iter().zip(&sds_ps).map(arrival).collect();
        profiles.push(hidden::Profile::new([*lit, *seen], arrivals, Vec::new(), span_m));
    }
    let blend_m = path_m(blend_ps, index);
    let solution = interruptible(py, |cancel| {
        let cancel = cancel.clone();
        hidden::find(&profiles, &hidden::Room { foci, dimensions, false_alarm, count, blend_m, cancel })
    })?;
    let patches = solution.patches.iter().zip(&solution.rivals).filter(|(one, _)| one.surface == Surface::Patch);
    patches.map(|(one, rival)| of_arrivals(py, one, rival.as_ref())).collect()
}

fn of_arrivals(py: Python<'_>, one: &Hidden, rival: Option<&Hidden>) -> PyResult<HiddenPatch> {
    Ok(HiddenPatch {
        point_m: vector(py, one.point.coords.as_slice().to_vec()),
        covariance_m2: matrix(py, one.covariance.as_slice().to_vec(), 3, 3)?,
        evidence: one.evidence,
        seen: one.seen,
        snr: None,
        mirror_m: rival.map(|rival| rival.point.coords.into()),
    })
}

/// Standard deviations of lists of times: one for all, or a list for each.
#[derive(FromPyObject)]
pub enum Spread<'py> {
    All(f64),
    Every(Vec<Vector<'py>>),
}

impl Spread<'_> {
    fn of(&self, n: usize, count: usize) -> PyResult<Vec<f64>> {
        let sds_ps = match self {
            Self::All(sd_ps) => vec![*sd_ps; count],
            Self::Every(lists) => {
                let missing = || pyo3::exceptions::PyValueError::new_err(format!("time_sd_ps has no list {n}"));
                finite("time_sd_ps", lists.get(n).ok_or_else(missing)?)?
            }
        };
        require(sds_ps.len() == count, || format!("time_sd_ps[{n}] has {} values for {count} times", sds_ps.len()))?;
        let is_positive = sds_ps.iter().all(|sd_ps| *sd_ps > 0.0 && sd_ps.is_finite());
        require(is_positive, || "time_sd_ps must be finite and above 0".to_owned())?;
        Ok(sds_ps)
    }
}

/// Matched filter for one more pulse, too weak for a fit of its own.
///
/// What the given pulses, a line, and slow noise could explain does not count.
///
/// Parameters
/// ----------
/// mean : array_like, shape (samples,)
///     Profile. Sample n lies at `t0_ps + n * dt_ps`.
/// sd : float or array_like, shape (samples,)
///     Standard deviation of each sample of `mean`. Infinite: the sample is ignored.
/// response : Response
///     Impulse response of the sensor.
/// at_ps : array_like, shape (times,)
///     Times at which the pulse may arrive.
/// dt_ps : float
///     Time between samples.
/// t0_ps : float
///     Time of sample 0.
/// acf : array_like, shape (lags,), optional
///     Autocorrelation of the noise from lag 0 on; without it, the noise is white.
/// given_ps : array_like, shape (pulses,), optional
///     Arrivals of pulses that are known, such as `Pulses.time_ps`; their amplitudes and times are fitted along.
/// width_ps : float
///     Standard deviation of the spread in time of the pulse's light.
///
/// Returns
/// -------
/// scores : numpy.ndarray, shape (times,)
///     Amplitude of the pulse over its standard deviation.
/// gains : numpy.ndarray, shape (times,)
///     One over that standard deviation; 0 where nothing can be said. `search_hidden` takes both.
#[pyfunction]
#[pyo3(signature = (mean, sd, response, at_ps, *, dt_ps, t0_ps=0.0, acf=None, given_ps=None, width_ps=0.0))]
pub fn matched_filter(
    py: Python<'_>,
    mean: Vector<'_>,
    sd: Each<'_>,
    response: &Bound<'_, Response>,
    at_ps: Vector<'_>,
    dt_ps: f64,
    t0_ps: f64,
    acf: Option<Vector<'_>>,
    given_ps: Option<Vector<'_>>,
    width_ps: f64,
) -> PyResult<(Py<PyArray1<f64>>, Py<PyArray1<f64>>)> {
    let (mean, at_ps) = (finite("mean", &mean)?, finite("at_ps", &at_ps)?);
    require(!mean.is_empty(), || "mean has no samples".to_owned())?;
    let sd = sd.standard_deviations("sd", mean.len())?;
    let acf = acf.map(|acf| finite("acf", &acf)).transpose()?.unwrap_or_default();
    require(acf.first().is_none_or(|first| *first > 0.0), || "acf must be above 0 at lag 0".to_owned())?;
    let (t0_ps, dt_ps) = (number("t0_ps", t0_ps)?, positive("dt_ps", dt_ps)?);
    require(number("width_ps", width_ps)? >= 0.0, || "width_ps must not be negative".to_owned())?;
    let given_ps = given_ps.map(|times| finite("given_ps", &times)).transpose()?.unwrap_or_default();
    let given: Vec<Given> =
        given_ps.iter().map(|time_ps| Given { time_ps: *time_ps, width_ps: 0.0, open: Open::Time }).collect();
    let response = &response.get().0;
    let result = interruptible_unless(mean.len().max(at_ps.len()) <= FEW, py, |cancel| {
        let profile = Profile { mean_v: &mean, sd_v: &sd, acf: &acf, slow_v2: &[], jitter: None, t0_ps, dt_ps };
        matched(&profile, response, &given, width_ps, at_ps.iter().copied(), cancel)
    })?;
    Ok((vector(py, result.scores), vector(py, result.gains)))
}

/// Finds the likeliest place of one hidden patch whose light is too weak for an onset in any profile, from all profiles
/// together.
///
/// Parameters
/// ----------
/// visible_m : array_like, shape (patches, 3)
///     Positions of the visible patches.
/// pairs : sequence of (int, int)
///     Lit and seen patch of each profile, as rows of `visible_m`.
/// scores, gains : array_like, shape (profiles, times)
///     Of `matched_filter`, at `first_ps + n * step_ps`: times from the lit patch to the seen one. Take off the ways
///     from the laser and to the sensor, and give it the pulses of all visible patches.
/// first_ps, step_ps : float
///     First time, and the step between times: a twelfth of the response's width is fine enough.
/// response_width_ps : float
///     Full width at half maximum of the response.
/// source_m : (float, float, float)
///     Position of the laser: patches behind the walls that it lights are not searched.
/// normals : array_like, shape (patches, 3), optional
///     Normals of the visible patches; by default that of the one plane on which all lie.
/// dimensions : {3, 2}
/// group_index : float
///     Group index of the medium.
///
/// Returns
/// -------
/// HiddenPatch or None
///     None where the profiles speak for no place. The patch is sure at a false alarm of alpha if its `evidence`
///     exceeds `-log(alpha)`.
///
/// Raises
/// ------
/// UndeterminedError
///     If the visible patches lie in one line.
///
/// Notes
/// -----
/// The kernel of stage `search`; docs/guide/stages/search.md of the project has the likelihood and its limits.
#[pyfunction]
#[pyo3(signature = (
    visible_m, pairs, scores, gains, *, first_ps, step_ps, response_width_ps, source_m=[0.0; 3], normals=None,
    dimensions=3, group_index=1.0
))]
pub fn search_hidden(
    py: Python<'_>,
    visible_m: Rows<'_>,
    pairs: Vec<(usize, usize)>,
    scores: Rows<'_>,
    gains: Rows<'_>,
    first_ps: f64,
    step_ps: f64,
    response_width_ps: f64,
    source_m: [f64; 3],
    normals: Option<Rows<'_>>,
    dimensions: usize,
    group_index: f64,
) -> PyResult<Option<HiddenPatch>> {
    let Scene { foci, dimensions, index } =
        Scene::new(&visible_m, &pairs, (source_m, normals), dimensions, group_index)?;
    let (scores, gains) = (scores.as_array(), gains.as_array());
    let shape = scores.dim();
    require(shape == gains.dim() && shape.0 == pairs.len() && shape.1 > 1, || {
        format!("scores has shape {shape:?} and gains {:?}, for {} pairs", gains.dim(), pairs.len())
    })?;
    let is_sound = scores.iter().all(|one| one.is_finite()) && gains.iter().all(|one| one.is_finite() && *one >= 0.0);
    require(is_sound, || "scores must be finite, and gains finite and not negative".to_owned())?;
    let low_m = path_m(number("first_ps", first_ps)?, index);
    let step_m = path_m(positive("step_ps", step_ps)?, index);
    let width_m = path_m(positive("response_width_ps", response_width_ps)?, index);
    let profile = |(n, (lit, seen)): (usize, &(usize, usize))| faint::Profile {
        foci: [*lit, *seen],
        low_m,
        step_m,
        scores: scores.row(n).to_vec(),
        gains: gains.row(n).to_vec(),
    };
    let profiles: Vec<faint::Profile> = pairs.iter().enumerate().map(profile).collect();
    let best = interruptible(py, |cancel| {
        faint::likeliest(&profiles, &faint::Room { foci, dimensions, width_m, cancel: cancel.clone() })
    })?;
    let patch = |best: faint::Faint| {
        let Point { coords } = best.point;
        Ok(HiddenPatch {
            point_m: vector(py, coords.as_slice().to_vec()),
            covariance_m2: matrix(py, best.covariance.as_slice().to_vec(), 3, 3)?,
            evidence: best.evidence,
            seen: best.seen,
            snr: Some(best.snr),
            mirror_m: None,
        })
    };
    best.map(patch).transpose()
}
