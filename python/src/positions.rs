//! Maximum-likelihood positions from times of flight.

use numpy::{PyArray1, PyArray2};
use periscope::geometry::loss::Loss;
use periscope::geometry::maximum_likelihood::{self, Anchor, Node, Observation, Problem, Solution};
use periscope::geometry::{Error, Point, placement};
use periscope::units::{path_m, time_ps as flight_ps};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::arrays::{
    Each, Rows, Vector, dimensions as space, finite, matrix, number, points, positive, require, rows_of_points, vector,
};
use crate::failure::of_geometry;
use crate::interrupt::interruptible;

/// Positions of patches, with covariance.
#[pyclass(frozen, get_all, module = "periscope")]
pub struct Positions {
    /// Position of each patch, m; shape (patches, 3).
    points_m: Py<PyArray2<f64>>,
    /// Covariance, m^2; coordinate k of patch i is row 3 i + k; shape (3 patches, 3 patches). NaN for patches in
    /// `open`.
    covariance_m2: Py<PyArray2<f64>>,
    /// Measured less predicted time of each path, ps; shape (paths,).
    residual_ps: Py<PyArray1<f64>>,
    /// Delay common to all times, ps, and its standard deviation; None where none is fitted.
    delay_ps: Option<(f64, f64)>,
    /// Sum of squared standardised residuals, priors included.
    chi2: f64,
    /// Measurements and priors less unknowns.
    degrees_of_freedom: i64,
    /// Factor on variances where the model does not explain the measurements, else 1. The covariance includes it.
    misfit: f64,
    /// Patches that can move freely; they have no covariance.
    open: Vec<usize>,
    /// Patches that are joined by paths, largest part first.
    parts: Vec<Vec<usize>>,
    /// Rotations of each part that no measurement determines.
    free_rotations: Vec<usize>,
    /// Whether the covariance is that of all coordinates together: up to 1000 patches. Beyond, patches have blocks of
    /// their own, and those between patches are 0.
    is_exact: bool,
}

impl Positions {
    fn of(py: Python<'_>, solution: &Solution, group_index: f64) -> PyResult<Self> {
        let patches = solution.points.len();
        let side = 3 * patches;
        let mut covariance = vec![f64::NAN; side * side];
        let is_open = |patch: usize| solution.open.contains(&patch);
        for a in (0..patches).filter(|a| !is_open(*a)) {
            for b in (0..patches).filter(|b| !is_open(*b)) {
                let block = solution.patch_covariance_m2(a, b);
                for (i, k) in (0..9).map(|n| (n / 3, n % 3)) {
                    covariance[(3 * a + i) * side + 3 * b + k] = block[(i, k)];
                }
            }
        }
        let residuals = solution.residuals_m.iter().map(|residual_m| flight_ps(*residual_m, group_index)).collect();
        let delay = |delay_m: &f64| {
            let sd_m = solution.delay_variance_m2(0).sqrt();
            (flight_ps(*delay_m, group_index), flight_ps(sd_m, group_index))
        };
        Ok(Self {
            points_m: rows_of_points(py, &solution.points)?,
            covariance_m2: matrix(py, covariance, side, side)?,
            residual_ps: vector(py, residuals),
            delay_ps: solution.delays_m.first().map(delay),
            chi2: solution.chi2,
            degrees_of_freedom: solution.degrees_of_freedom,
            misfit: solution.misfit,
            open: solution.open.clone(),
            parts: solution.parts.clone(),
            free_rotations: solution.free_rotations.clone(),
            is_exact: solution.is_exact(),
        })
    }
}

#[pymethods]
impl Positions {
    /// Standard deviation of each coordinate, m; shape (patches, 3).
    #[getter]
    fn sd_m(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f64>>> {
        let variances = self.covariance_m2.bind(py).call_method0("diagonal")?.extract::<Vec<f64>>()?;
        let patches = variances.len() / 3;
        matrix(py, variances.into_iter().map(f64::sqrt).collect(), patches, 3)
    }

    fn __len__(&self, py: Python<'_>) -> PyResult<usize> {
        self.points_m.bind(py).len()
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let (count, chi2, dof) = (self.__len__(py)?, self.chi2, self.degrees_of_freedom);
        Ok(format!("<Positions of {count} patches, chi2 {chi2:.3} for {dof} degrees of freedom>"))
    }
}

/// A patch of known position: its number, where it is (m), and the standard deviation of each coordinate (m).
type Fixed = (usize, [f64; 3], f64);

/// The most likely positions of patches, from times of flight over them.
///
/// Levenberg-Marquardt from a start that is searched for, or given. The covariance is the Cramer-Rao bound at the
/// solution, without the rotations that no time determines.
///
/// Parameters
/// ----------
/// paths : sequence of sequences of int
///     Patches of each path, in the order in which light meets them: (0,) and (0, 1) are a first and a second bounce.
///     Patches count from 0, as rows of the result.
/// time_ps : array_like, shape (paths,)
///     Time of flight from source to sensor.
/// time_sd_ps : float or array_like, shape (paths,)
///     Standard deviations.
/// stations_m : array_like, shape (stations, 3), optional
///     Where light leaves and arrives; by default one station at the origin.
/// source, sensor : sequence of int, optional
///     Station where each path begins and ends; by default station 0.
/// start_m : array_like, shape (patches, 3), optional
///     Where the search begins. Without it, positions are searched for from nothing.
/// dimensions : {3, 2}
///     2 keeps z where it starts.
/// delay_sd_ps : float, optional
///     Fit a delay common to all times, of this prior standard deviation.
/// anchors : sequence of (int, (float, float, float), float)
///     Patches of known position: patch, position in m, standard deviation in m.
/// loss : {"huber", "squared", "redescending"}
///     Loss of standardised residuals: "huber" bears a few gross errors, "redescending" many.
/// group_index : float
///     Group index of the medium.
///
/// Returns
/// -------
/// Positions
///     What the times leave free, such as a rotation or a mirror image about the stations, is arbitrary.
///     `free_rotations` and `open` name rotations and patches.
///
/// Raises
/// ------
/// UndeterminedError
///     If no minimum is reached, or too few times determine a patch.
///
/// Notes
/// -----
/// docs/geometry.md and docs/accuracy.md of the project compare it with the bound.
#[pyfunction]
#[pyo3(signature = (
    paths, time_ps, time_sd_ps, *, stations_m=None, source=None, sensor=None, start_m=None, dimensions=3,
    delay_sd_ps=None, anchors=Vec::new(), loss="huber", group_index=1.0
))]
pub fn solve_positions(
    py: Python<'_>,
    paths: Vec<Vec<usize>>,
    time_ps: Vector<'_>,
    time_sd_ps: Each<'_>,
    stations_m: Option<Rows<'_>>,
    source: Option<Vec<usize>>,
    sensor: Option<Vec<usize>>,
    start_m: Option<Rows<'_>>,
    dimensions: usize,
    delay_sd_ps: Option<f64>,
    anchors: Vec<Fixed>,
    loss: &str,
    group_index: f64,
) -> PyResult<Positions> {
    let index = positive("group_index", group_index)?;
    let times_ps = finite("time_ps", &time_ps)?;
    let sds_ps = time_sd_ps.standard_deviations("time_sd_ps", times_ps.len())?;
    let stations = stations_m.map(|rows| points("stations_m", &rows)).transpose()?;
    let stations = stations.unwrap_or_else(|| vec![Point::origin()]);
    let start = start_m.map(|rows| points("start_m", &rows)).transpose()?;
    let is_searched = start.is_none();
    let start = start.unwrap_or_else(|| vec![Point::origin(); patches(&paths)]);
    let ends = Ends { stations: stations.len(), source, sensor };
    let nodes = ends.nodes(&paths, start.len(), times_ps.len())?;
    let lengths = times_ps.iter().zip(&sds_ps).map(|(time_ps, sd_ps)| (path_m(*time_ps, index), path_m(*sd_ps, index)));
    let observation = |(nodes, (length_m, sd_m))| Observation::new(nodes, length_m, sd_m);
    let observations = nodes.into_iter().zip(lengths).map(observation).collect();
    let mut problem = Problem::new(start, space(dimensions)?, &stations, observations);
    problem.loss = named_loss(loss)?;
    problem.anchors =
        anchors.into_iter().map(|anchor| anchor_of(anchor, problem.start.len())).collect::<PyResult<_>>()?;
    if let Some(sd_ps) = delay_sd_ps {
        problem = problem.with_common_delay(path_m(positive("delay_sd_ps", sd_ps)?, index));
    }
    let solution = interruptible(py, |cancel| {
        problem.cancel = cancel.clone();
        if is_searched {
            problem.start = placement::place(&problem).points;
        }
        maximum_likelihood::solve(&problem)
    })?;
    Positions::of(py, &solution.map_err(|error| of_geometry(Error::from(error)))?, index)
}

/// Number of patches that paths name.
fn patches(paths: &[Vec<usize>]) -> usize {
    paths.iter().flatten().max().map_or(0, |patch| patch + 1)
}

fn named_loss(name: &str) -> PyResult<Loss> {
    match name {
        "huber" => Ok(Loss::Huber),
        "squared" => Ok(Loss::Squared),
        "redescending" => Ok(Loss::Redescending),
        other => {
            let problem = format!("loss is {other:?}; give \"huber\", \"squared\" or \"redescending\"");
            Err(PyValueError::new_err(problem))
        }
    }
}

fn anchor_of((patch, [x, y, z], sd_m): Fixed, patches: usize) -> PyResult<Anchor> {
    require(patch < patches, || format!("anchors name patch {patch}; there are {patches} patches"))?;
    let coordinate = |value| number("the position of an anchor", value);
    let position = Point::new(coordinate(x)?, coordinate(y)?, coordinate(z)?);
    Ok(Anchor { patch, position, sd_m: positive("the standard deviation of an anchor", sd_m)? })
}

/// Stations of paths.
struct Ends {
    stations: usize,
    source: Option<Vec<usize>>,
    sensor: Option<Vec<usize>>,
}

impl Ends {
    /// The nodes of each path, all of which are there.
    fn nodes(self, paths: &[Vec<usize>], patches: usize, times: usize) -> PyResult<Vec<Vec<Node>>> {
        require(!paths.is_empty() && patches > 0, || "there are no paths over patches".to_owned())?;
        require(paths.len() == times, || format!("there are {} paths and {times} times", paths.len()))?;
        let source = self.source.unwrap_or_else(|| vec![0; times]);
        let sensor = self.sensor.unwrap_or_else(|| vec![0; times]);
        require(source.len() == times && sensor.len() == times, || format!("source and sensor need {times} stations"))?;
        let is_there = source.iter().chain(&sensor).all(|station| *station < self.stations);
        require(is_there, || format!("source or sensor names a station beyond the {} given", self.stations))?;
        let ends = source.into_iter().zip(sensor);
        let nodes = |(path, (source, sensor)): (&Vec<usize>, (usize, usize))| {
            require(!path.is_empty(), || "a path meets no patch".to_owned())?;
            let strange = path.iter().find(|patch| **patch >= patches);
            require(strange.is_none(), || format!("a path names patch {strange:?}; there are {patches} patches"))?;
            let over = path.iter().map(|patch| Node::Patch(*patch));
            Ok(std::iter::once(Node::Station(source)).chain(over).chain([Node::Station(sensor)]).collect())
        };
        paths.iter().zip(ends).map(nodes).collect()
    }
}
