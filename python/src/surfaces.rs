//! Surfaces around the corner: first light at a wall, points with normals, shapes, and the surface between points.

use numpy::{PyArray1, PyArray2, PyArray3};
use periscope::cancel::Cancel;
use periscope::geometry::Point;
use periscope::geometry::first_return::{self, Face, Kind, Lit, Place, Return, Scan, wall_normal};
use periscope::geometry::height_field::{self, height_fields};
use periscope::geometry::shapes::{self, Sighting};
use periscope::signal::edge::{self, Background, Bins, FirstReturn, Noise, Rises, Window};
use periscope::units::{path_m, time_ps as flight_ps};
use pyo3::prelude::*;
use rayon::prelude::*;

use crate::arrays::{Each, Rows, blocks, matrix, place, points, positive, require, rows_of_points, vector};
use crate::failure::UndeterminedError;
use crate::interrupt::interruptible;
use crate::profiles::Response;

/// Laws by which light begins: the surface goes on, ends in an edge, in a corner.
const LAWS: usize = 3;

/// First light in histograms, timed under three laws: the surface goes on about its nearest point (a step of light), or
/// that point lies on an edge, or on a corner.
#[pyclass(frozen, module = "periscope")]
pub struct FirstReturns {
    /// Row of each histogram that has first light; shape (returns,).
    #[pyo3(get)]
    place: Py<PyArray1<i64>>,
    /// Time of first light under each law, ps; shape (returns, 3).
    #[pyo3(get)]
    time_ps: Py<PyArray2<f64>>,
    /// Standard deviation of `time_ps`, with height, slope and background free; shape (returns, 3).
    #[pyo3(get)]
    time_sd_ps: Py<PyArray2<f64>>,
    /// Logarithm of the likelihood of each law; shape (returns, 3).
    #[pyo3(get)]
    log_likelihood: Py<PyArray2<f64>>,
    timed: Timed,
}

/// Histograms with first light, and what they are timed by.
struct Timed {
    records: Vec<Record>,
    rises: Rises,
    background: Background,
    dt_ps: f64,
}

struct Record {
    place: usize,
    first_ps: f64,
    values: Vec<f64>,
    noise: Noise,
    start_ps: f64,
    returns: [FirstReturn; LAWS],
}

impl Record {
    fn bins(&self, dt_ps: f64) -> Bins<'_> {
        Bins { first_ps: self.first_ps, dt_ps, values: &self.values, noise: self.noise }
    }

    fn window<'a>(&'a self, timed: &'a Timed) -> Option<Window<'a>> {
        Window::about(&self.bins(timed.dt_ps), &timed.rises, timed.background, self.start_ps)
    }
}

#[pymethods]
impl FirstReturns {
    fn __len__(&self) -> usize {
        self.timed.records.len()
    }

    fn __repr__(&self) -> String {
        format!("<FirstReturns of {} histograms>", self.timed.records.len())
    }
}

/// Times the first light of an extended hidden thing in each histogram of a wall.
///
/// Parameters
/// ----------
/// histograms : array_like, shape (histograms, bins)
///     Photon counts, or levels with `sd`. Leave out the light of the wall itself.
/// response : Response
///     Impulse response of laser and detector.
/// dt_ps : float
///     Width of a bin.
/// t0_ps : float or array_like, shape (histograms,)
///     Time of the middle of bin 0, from the lit point to the seen one: without the ways from the laser and to the
///     sensor.
/// sd : float or array_like, shape (histograms,), optional
///     Standard deviation of a level; by default the histograms are photon counts.
/// threshold_sigma : float
///     Standard deviations by which light rises at its first return.
///
/// Returns
/// -------
/// FirstReturns
///
/// Notes
/// -----
/// Light that rises again behind the first, of things farther away, is found by campaigns alone (`run`). The method
/// and its limits: docs/surfaces.md of the project.
#[pyfunction]
#[pyo3(signature = (histograms, response, *, dt_ps, t0_ps=Each::All(0.0), sd=None, threshold_sigma=5.0))]
pub fn first_returns(
    py: Python<'_>,
    histograms: Rows<'_>,
    response: &Bound<'_, Response>,
    dt_ps: f64,
    t0_ps: Each<'_>,
    sd: Option<Each<'_>>,
    threshold_sigma: f64,
) -> PyResult<FirstReturns> {
    let array = histograms.as_array();
    let (count, dt_ps) = (array.nrows(), positive("dt_ps", dt_ps)?);
    require(array.iter().all(|value| value.is_finite()), || "histograms has values that are not finite".to_owned())?;
    let starts_ps = t0_ps.values("t0_ps", count)?;
    require(starts_ps.iter().all(|start_ps| start_ps.is_finite()), || {
        "t0_ps has values that are not finite".to_owned()
    })?;
    let sds = sd.map(|sd| sd.standard_deviations("sd", count)).transpose()?;
    let threshold = positive("threshold_sigma", threshold_sigma)?;
    let noise = |n: usize| sds.as_ref().map_or(Noise::Counts, |sds| Noise::Gauss { sd: sds[n] });
    let rows: Vec<(f64, Vec<f64>, Noise)> =
        (0..count).map(|n| (starts_ps[n], array.row(n).to_vec(), noise(n))).collect();
    let response = &response.get().0;
    let width_ps = response.width_ps();
    require(response.height() > 0.0 && !response.is_step(), || "response must be a pulse above 0".to_owned())?;
    let timed = interruptible(py, |cancel| {
        let rises = Rises::behind(response, [width_ps, dt_ps]);
        times(rows, rises, dt_ps, threshold, cancel)
    })?;
    let of = |value: fn(&FirstReturn) -> f64| {
        let values = timed.records.iter().flat_map(|record| record.returns.iter().map(value)).collect();
        matrix(py, values, timed.records.len(), LAWS)
    };
    Ok(FirstReturns {
        place: vector(py, timed.records.iter().map(|record| record.place as i64).collect()),
        time_ps: of(|one| one.time_ps)?,
        time_sd_ps: of(|one| one.sd_ps)?,
        log_likelihood: of(|one| one.log_likelihood)?,
        timed,
    })
}

/// First light of histograms: first time, values and noise of each.
fn times(rows: Vec<(f64, Vec<f64>, Noise)>, rises: Rises, dt_ps: f64, threshold: f64, cancel: &Cancel) -> Timed {
    let bins = |row: usize| Bins { first_ps: rows[row].0, dt_ps, values: &rows[row].1, noise: rows[row].2 };
    let start = |row: usize| Some((row, edge::first_rise(&bins(row), rises.sigma_ps(), threshold)?));
    let starts: Vec<(usize, f64)> = (0..rows.len()).into_par_iter().filter_map(start).collect();
    let before: Vec<(Bins<'_>, f64)> = starts.iter().map(|(row, start_ps)| (bins(*row), *start_ps)).collect();
    let background = Background::before(&before, rises.sigma_ps());
    let first = |(row, start_ps): &(usize, f64)| {
        cancel.check();
        let window = Window::about(&bins(*row), &rises, background, *start_ps)?;
        let [step, edge, corner] = window.first_returns();
        Some((*row, *start_ps, [step?, edge?, corner?]))
    };
    let timed: Vec<(usize, f64, [FirstReturn; LAWS])> = starts.par_iter().filter_map(first).collect();
    let mut rows: Vec<Option<(f64, Vec<f64>, Noise)>> = rows.into_iter().map(Some).collect();
    let record = |(place, start_ps, returns): (usize, f64, [FirstReturn; LAWS])| {
        let (first_ps, values, noise) = rows[place].take().expect("a histogram has one first return");
        Record { place, first_ps, values, noise, start_ps, returns }
    };
    let records = timed.into_iter().map(record).collect();
    Timed { records, rises, background, dt_ps }
}

/// Points of hidden surfaces, with covariances and normals.
#[pyclass(frozen, module = "periscope")]
pub struct SurfacePoints {
    /// Row of the wall's point that each is nearest to; shape (points,).
    #[pyo3(get)]
    place: Py<PyArray1<i64>>,
    /// Position, m; shape (points, 3).
    #[pyo3(get)]
    points_m: Py<PyArray2<f64>>,
    /// Its covariance, m^2; shape (points, 3, 3). Errors of neighbours are common in part.
    #[pyo3(get)]
    covariance_m2: Py<PyArray3<f64>>,
    /// Unit vector away from the surface; its normal where `kind` is "smooth"; shape (points, 3).
    #[pyo3(get)]
    normals: Py<PyArray2<f64>>,
    /// Covariance of `normals`; shape (points, 3, 3).
    #[pyo3(get)]
    normal_covariance: Py<PyArray3<f64>>,
    /// What part of the surface each is: "smooth", "edge", "corner" or "unknown".
    #[pyo3(get)]
    kind: Vec<&'static str>,
    /// Curvatures of smooth points, larger one first, 1/m: positive where convex towards the wall, else NaN; shape
    /// (points, 2).
    #[pyo3(get)]
    curvature_per_m: Py<PyArray2<f64>>,
    /// Points of the wall that entered each; shape (points,).
    #[pyo3(get)]
    wall_points: Py<PyArray1<i64>>,
    /// Chi-square of their first returns over its degrees of freedom; shape (points,).
    #[pyo3(get)]
    misfit: Py<PyArray1<f64>>,
    /// Probability that light of the neighbourhood comes from edges that lengths do not show; shape (points,).
    #[pyo3(get)]
    edges: Py<PyArray1<f64>>,
    /// First light as shapes and surfaces are fitted to it; none with a lit point apart.
    sightings: Vec<Sighting>,
}

#[pymethods]
impl SurfacePoints {
    fn __len__(&self) -> usize {
        self.kind.len()
    }

    fn __repr__(&self) -> String {
        format!("<SurfacePoints: {} points>", self.kind.len())
    }

    /// Planes, spheres and cylinders on which the points lie. Only shapes that are sure are listed.
    ///
    /// Returns
    /// -------
    /// list of Shape
    ///     The one with most points first.
    fn shapes(&self, py: Python<'_>) -> PyResult<Vec<Shape>> {
        let shapes = interruptible(py, |cancel| shapes::shapes(&self.sightings, cancel))?;
        shapes.iter().map(|shape| Shape::of(py, shape)).collect()
    }

    /// Surfaces between the points, as heights over a grid.
    ///
    /// Returns
    /// -------
    /// list of HeightField
    ///     The one with most points first; none where no smooth surface explains first light.
    fn height_fields(&self, py: Python<'_>) -> PyResult<Vec<HeightField>> {
        let fields = interruptible(py, |cancel| height_fields(&self.sightings, cancel))?;
        fields.iter().map(|field| HeightField::of(py, field)).collect()
    }
}

/// Points of a hidden surface from first light at the points of a wall.
///
/// A field of lengths is fitted to neighbouring points of the wall; its value and gradient give the point of the
/// surface and its normal. Where flat faces show, first light is timed again under the law that their edges set.
///
/// Parameters
/// ----------
/// returns : FirstReturns
///     First light, of 16 histograms or more.
/// seen_m : array_like, shape (histograms, 3)
///     The seen point of each histogram, in the order of `first_returns`. They span a plane.
/// lit_m : (float, float, float), optional
///     The lit point; by default each seen point is lit itself.
/// front_m : (float, float, float)
///     A point on the lit side of the wall, such as the laser.
/// group_index : float
///     Group index of the medium.
///
/// Returns
/// -------
/// SurfacePoints
///
/// Raises
/// ------
/// UndeterminedError
///     If the points of the wall lie in one line.
///
/// Notes
/// -----
/// Source: Tsai et al., The Geometry of First-Returning Photons, CVPR 2017; Xin et al., A Theory of Fermat Paths, CVPR
/// 2019. docs/surfaces.md of the project has the accuracy.
#[pyfunction]
#[pyo3(signature = (returns, seen_m, *, lit_m=None, front_m=[0.0; 3], group_index=1.0))]
pub fn surface_points(
    py: Python<'_>,
    returns: &Bound<'_, FirstReturns>,
    seen_m: Rows<'_>,
    lit_m: Option<[f64; 3]>,
    front_m: [f64; 3],
    group_index: f64,
) -> PyResult<SurfacePoints> {
    let (wall, index) = (points("seen_m", &seen_m)?, positive("group_index", group_index)?);
    let timed = &returns.get().timed;
    let last = timed.records.last().map_or(0, |record| record.place + 1);
    require(last <= wall.len(), || format!("seen_m has {} rows; histogram {} has first light", wall.len(), last - 1))?;
    let lit = lit_m.map(|lit| place("lit_m", lit)).transpose()?;
    let inwards = wall_normal(&wall, &place("front_m", front_m)?).ok_or_else(|| {
        UndeterminedError::new_err("the points of the wall lie in one line; give points that span a plane")
    })?;
    let returned = |first: &FirstReturn| Return {
        length_m: path_m(first.time_ps, index),
        sd_m: path_m(first.sd_ps, index),
        common_m: path_m(first.common_ps, index),
        log_likelihood: first.log_likelihood,
    };
    let places =
        timed.records.iter().map(|one| Place { seen: wall[one.place], returns: one.returns.each_ref().map(returned) });
    let sigma_m = path_m(timed.rises.sigma_ps(), index);
    let scan = Scan { lit: lit.map_or(Lit::Same, Lit::One), inwards, sigma_m, places: places.collect(), least: 0 };
    let result = interruptible(py, |cancel| {
        let window = |one| Record::window(one, timed);
        let windows: Vec<Option<Window<'_>>> = timed.records.iter().map(window).collect();
        let again = |place: usize, laws: &[Vec<Face>], length_m: f64| {
            let face = |face: &Face| edge::Face { weight: face.weight, ends: face.ends };
            let laws: Vec<Vec<edge::Face>> = laws.iter().map(|faces| faces.iter().map(face).collect()).collect();
            let Some(window) = &windows[place] else { return vec![None; laws.len()] };
            let first = window.first_returns_near(&laws, flight_ps(length_m, index));
            first.iter().map(|first| first.as_ref().map(returned)).collect()
        };
        first_return::surface_points(&scan, again, cancel)
    })?;
    let places: Vec<usize> = result.iter().map(|point| timed.records[point.place].place).collect();
    rows(py, &result, &places, |place| wall[place], lit.is_none())
}

fn rows(
    py: Python<'_>,
    result: &[first_return::SurfacePoint],
    places: &[usize],
    seen: impl Fn(usize) -> Point,
    is_confocal: bool,
) -> PyResult<SurfacePoints> {
    let sighting = |(point, place): (&first_return::SurfacePoint, &usize)| Sighting {
        seen: seen(*place),
        light: point.light,
        point: point.point,
        covariance_m2: point.covariance_m2,
        part: point.kind,
        edges: point.edges,
    };
    let sightings = result.iter().zip(places).filter(|_| is_confocal).map(sighting).collect();
    let each = |value: &dyn Fn(&first_return::SurfacePoint) -> Vec<f64>| result.iter().flat_map(value).collect();
    let curvatures = |point: &first_return::SurfacePoint| point.curvatures_per_m.unwrap_or([f64::NAN; 2]).to_vec();
    Ok(SurfacePoints {
        place: vector(py, places.iter().map(|place| *place as i64).collect()),
        points_m: rows_of_points(py, &result.iter().map(|point| point.point).collect::<Vec<_>>())?,
        covariance_m2: blocks(py, each(&|point| point.covariance_m2.as_slice().to_vec()))?,
        normals: matrix(py, each(&|point| point.normal.as_slice().to_vec()), result.len(), 3)?,
        normal_covariance: blocks(py, each(&|point| point.normal_covariance.as_slice().to_vec()))?,
        kind: result.iter().map(|point| part(point.kind)).collect(),
        curvature_per_m: matrix(py, each(&curvatures), result.len(), 2)?,
        wall_points: vector(py, result.iter().map(|point| point.places as i64).collect()),
        misfit: vector(py, result.iter().map(|point| point.misfit).collect()),
        edges: vector(py, result.iter().map(|point| point.edges).collect()),
        sightings,
    })
}

fn part(kind: Kind) -> &'static str {
    match kind {
        Kind::Smooth => "smooth",
        Kind::Edge => "edge",
        Kind::Corner => "corner",
        Kind::Unknown => "unknown",
    }
}

/// A plane, sphere or cylinder on which points of a hidden surface lie.
#[pyclass(frozen, get_all, module = "periscope")]
pub struct Shape {
    /// "plane", "sphere" or "cylinder".
    kind: &'static str,
    /// Middle of a sphere; of a plane and an axis the point next to the middle of the points on it, m; shape (3,).
    at_m: Py<PyArray1<f64>>,
    /// Its covariance, m^2; across planes and axes alone; shape (3, 3).
    covariance_m2: Py<PyArray2<f64>>,
    /// Normal of a plane, towards the wall; direction of a cylinder's axis; None for a sphere.
    axis: Option<Py<PyArray1<f64>>>,
    /// Covariance of `axis`; shape (3, 3).
    axis_covariance: Py<PyArray2<f64>>,
    /// Radius of a sphere or cylinder, m, and its standard deviation.
    radius_m: Option<(f64, f64)>,
    /// Points on it, as positions in `SurfacePoints`; shape (members,).
    members: Py<PyArray1<i64>>,
    /// Logarithm of how much likelier its kind is than the next one.
    evidence: f64,
    /// Chi-square of the lengths over its degrees of freedom.
    misfit: f64,
    /// Root of the mean square of what lengths are off, m.
    rms_m: f64,
}

impl Shape {
    fn of(py: Python<'_>, shape: &shapes::Shape) -> PyResult<Self> {
        let [at, axis] = shape.covariances();
        let kind = match shape.kind() {
            shapes::Kind::Plane => "plane",
            shapes::Kind::Sphere => "sphere",
            shapes::Kind::Cylinder => "cylinder",
        };
        Ok(Self {
            kind,
            at_m: vector(py, shape.at().coords.as_slice().to_vec()),
            covariance_m2: matrix(py, at.as_slice().to_vec(), 3, 3)?,
            axis: shape.axis().map(|axis| vector(py, axis.as_slice().to_vec())),
            axis_covariance: matrix(py, axis.as_slice().to_vec(), 3, 3)?,
            radius_m: shape.radius_m().map(|[radius_m, sd_m]| (radius_m, sd_m)),
            members: vector(py, shape.members.iter().map(|member| *member as i64).collect()),
            evidence: shape.evidence,
            misfit: shape.misfit,
            rms_m: shape.rms_m,
        })
    }
}

#[pymethods]
impl Shape {
    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let at: Vec<f64> = self.at_m.extract(py)?;
        Ok(format!("<Shape: {} at {at:.3?} m, {} points>", self.kind, self.members.bind(py).len()?))
    }
}

/// A hidden surface between points, as nodes of a grid.
#[pyclass(frozen, get_all, module = "periscope")]
pub struct HeightField {
    /// Unit vector along which heights are measured, towards the wall; shape (3,).
    axis: Py<PyArray1<f64>>,
    /// Distance of nodes across it, m.
    spacing_m: f64,
    /// Nodes that first light shows, m; shape (nodes, 3).
    points_m: Py<PyArray2<f64>>,
    /// Their standard deviation along the normal, m; shape (nodes,).
    sd_m: Py<PyArray1<f64>>,
    /// Unit normals, towards the wall; shape (nodes, 3).
    normals: Py<PyArray2<f64>>,
    /// Root of the sum of the variances of the normal's two angles; shape (nodes,).
    normal_sd_rad: Py<PyArray1<f64>>,
    /// Column and row of each node in the grid; shape (nodes, 2).
    grid: Py<PyArray2<i64>>,
    /// Size of curvatures that the lengths make likeliest, 1/m.
    bend_per_m: f64,
    /// Points that it was fitted to, as positions in `SurfacePoints`; shape (members,).
    members: Py<PyArray1<i64>>,
    /// Chi-square of their lengths over their number.
    misfit: f64,
}

impl HeightField {
    fn of(py: Python<'_>, field: &height_field::HeightField) -> PyResult<Self> {
        let nodes = &field.nodes;
        let normals = nodes.iter().flat_map(|node| [node.normal.x, node.normal.y, node.normal.z]).collect();
        Ok(Self {
            axis: vector(py, field.axis.as_slice().to_vec()),
            spacing_m: field.spacing_m,
            points_m: rows_of_points(py, &nodes.iter().map(|node| node.point).collect::<Vec<_>>())?,
            sd_m: vector(py, nodes.iter().map(|node| node.sd_m).collect()),
            normals: matrix(py, normals, nodes.len(), 3)?,
            normal_sd_rad: vector(py, nodes.iter().map(|node| node.normal_sd_rad).collect()),
            grid: matrix(py, nodes.iter().flat_map(|node| node.place.map(i64::from)).collect(), nodes.len(), 2)?,
            bend_per_m: field.bend_per_m,
            members: vector(py, field.members.iter().map(|member| *member as i64).collect()),
            misfit: field.misfit,
        })
    }
}

#[pymethods]
impl HeightField {
    fn __len__(&self, py: Python<'_>) -> PyResult<usize> {
        self.sd_m.bind(py).len()
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        Ok(format!("<HeightField of {} nodes>", self.__len__(py)?))
    }
}
