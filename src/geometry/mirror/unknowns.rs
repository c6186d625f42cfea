//! The unknowns of a mirror experiment, and how what is measured depends on them.

use nalgebra::{Matrix3, Vector3};

use super::{Experiment, Mirror, Scan};
use crate::dense::Definite;
use crate::{Matrix, Point};

/// Values of all unknowns.
pub(super) struct State {
    pub(super) mirror: Mirror,
    directions: Vec<Vector3<f64>>,
    /// From the source to the diffuser.
    folded_m: Vec<f64>,
    stations: Vec<Point>,
    delays_m: Vec<f64>,
}

impl State {
    /// This mirror, all else as measured.
    pub(super) fn new(experiment: &Experiment, mirror: Mirror) -> Self {
        Self {
            mirror,
            directions: experiment.scans.iter().map(|scan| scan.direction).collect(),
            folded_m: experiment.scans.iter().map(|scan| experiment.folded_m(scan).0).collect(),
            stations: experiment.stations.iter().map(|station| station.position).collect(),
            delays_m: vec![0.0; experiment.delay_covariance_m2.nrows()],
        }
    }
}

/// How a place (or a direction) moves with each unknown that it depends on.
pub(super) type Slopes = Vec<(usize, Vector3<f64>)>;

/// Places of the unknowns: tilts and offset of the mirror; angles and folded length of each scan; coordinates of
/// stations with an error; delays.
pub(super) struct Layout<'a> {
    pub(super) experiment: &'a Experiment,
    /// First place of each station that has any.
    stations: Vec<Option<usize>>,
    delays: usize,
    /// Inverse of the delays' prior covariance.
    delay_information: Option<Matrix>,
}

impl<'a> Layout<'a> {
    pub(super) fn new(experiment: &'a Experiment) -> Self {
        assert!(!experiment.scans.is_empty(), "a mirror without scans");
        let mut next = experiment.dimensions * (1 + experiment.scans.len());
        let place = |sd_m: f64| {
            let place = next;
            (sd_m > 0.0).then(|| {
                next += experiment.dimensions;
                place
            })
        };
        let stations = experiment.stations.iter().map(|station| station.sd_m).map(place).collect();
        let covariance = &experiment.delay_covariance_m2;
        let information = || Definite::new(covariance).expect("delays have a prior standard deviation each").inverse();
        let delay_information = (covariance.nrows() > 0).then(information);
        Self { experiment, stations, delays: next, delay_information }
    }

    pub(super) fn count(&self) -> usize {
        self.delays + self.experiment.delay_covariance_m2.nrows()
    }

    /// Place of the mirror's offset.
    pub(super) fn offset(&self) -> usize {
        self.experiment.dimensions - 1
    }

    /// How the mirror's normal turns.
    pub(super) fn normal(&self, state: &State) -> Slopes {
        self.aside(state.mirror.normal).into_iter().enumerate().collect()
    }

    /// First place of a scan.
    fn scan(&self, scan: usize) -> usize {
        self.experiment.dimensions * (1 + scan)
    }

    /// Directions at right angles to one, those in which it can turn.
    fn aside(&self, direction: Vector3<f64>) -> Vec<Vector3<f64>> {
        if self.experiment.dimensions == 2 {
            return vec![Vector3::new(-direction.y, direction.x, 0.0)];
        }
        let first = direction.cross(&Vector3::ith(direction.iamin(), 1.0)).normalize();
        vec![first, direction.cross(&first)]
    }

    pub(super) fn moved(&self, state: &State, step: impl Fn(usize) -> f64) -> State {
        let turned = |direction: Vector3<f64>, place: usize| {
            let aside = self.aside(direction).into_iter().enumerate();
            (direction + aside.map(|(k, aside)| aside * step(place + k)).sum::<Vector3<f64>>()).normalize()
        };
        let last = self.experiment.dimensions - 1;
        let station = |(station, place): (&Point, &Option<usize>)| {
            let by = |place: usize| Vector3::from_fn(|k, _| if k <= last { step(place + k) } else { 0.0 });
            station + place.map_or_else(Vector3::zeros, by)
        };
        let scans = || (0..state.directions.len()).map(|scan| (scan, self.scan(scan)));
        State {
            mirror: Mirror { normal: turned(state.mirror.normal, 0), offset_m: state.mirror.offset_m + step(last) },
            directions: scans().map(|(scan, place)| turned(state.directions[scan], place)).collect(),
            folded_m: scans().map(|(scan, place)| state.folded_m[scan] + step(place + last)).collect(),
            stations: state.stations.iter().zip(&self.stations).map(station).collect(),
            delays_m: state.delays_m.iter().enumerate().map(|(n, delay_m)| delay_m + step(self.delays + n)).collect(),
        }
    }

    /// Where a scan meets the diffuser.
    pub(super) fn diffuser(&self, state: &State, scan: usize) -> (Point, Slopes) {
        let Mirror { normal, offset_m } = state.mirror;
        let (direction, folded_m) = (state.directions[scan], state.folded_m[scan]);
        let end = state.stations[0] + direction * folded_m;
        let beyond_m = normal.dot(&end.coords) - offset_m;
        let (last, place) = (self.experiment.dimensions - 1, self.scan(scan));
        let tilt = |aside: Vector3<f64>| -2.0 * (normal * aside.dot(&end.coords) + aside * beyond_m);
        let mut slopes: Slopes = self.aside(normal).into_iter().map(tilt).enumerate().collect();
        slopes.push((last, 2.0 * normal));
        let angle = |(k, aside): (usize, Vector3<f64>)| (place + k, folded_m * state.mirror.turned(aside));
        slopes.extend(self.aside(direction).into_iter().enumerate().map(angle));
        slopes.push((place + last, state.mirror.turned(direction)));
        slopes.extend(self.source(|axis| state.mirror.turned(axis)));
        (state.mirror.image(end), slopes)
    }

    /// Where a scan meets the mirror; `None` where it does not on its way.
    pub(super) fn point(&self, state: &State, scan: usize) -> Option<(Point, Slopes)> {
        let (normal, direction) = (state.mirror.normal, state.directions[scan]);
        let meets_m = state.mirror.meets(state.stations[0], direction);
        let distance_m = meets_m.filter(|distance_m| *distance_m < state.folded_m[scan])?;
        let point = state.stations[0] + direction * distance_m;
        // Along the beam by as much as the mirror comes nearer.
        let along = direction / normal.dot(&direction);
        let tilt = |aside: Vector3<f64>| -along * aside.dot(&point.coords);
        let mut slopes: Slopes = self.aside(normal).into_iter().map(tilt).enumerate().collect();
        slopes.push((self.offset(), along));
        let off = |aside: Vector3<f64>| aside - along * normal.dot(&aside);
        let angles = self.aside(direction).into_iter().enumerate();
        slopes.extend(angles.map(|(k, aside)| (self.scan(scan) + k, distance_m * off(aside))));
        slopes.extend(self.source(off));
        Some((point, slopes))
    }

    /// Slopes along the source's axes, where it has an error.
    fn source(&self, slope: impl Fn(Vector3<f64>) -> Vector3<f64>) -> Slopes {
        let axes = |place: usize| (0..self.experiment.dimensions).map(move |k| (place + k, Vector3::ith(k, 1.0)));
        self.stations[0].into_iter().flat_map(axes).map(|(place, axis)| (place, slope(axis))).collect()
    }

    /// Takes errors of a scan's diffuser point to uncorrelated ones of variance 1, row by row.
    fn whitener(&self, scan: &Scan) -> Matrix3<f64> {
        let mut covariance_m2 = scan.diffuser_covariance_m2;
        if self.experiment.dimensions == 2 {
            covariance_m2.fill_row(2, 0.0);
            covariance_m2.fill_column(2, 0.0);
            covariance_m2[(2, 2)] = 1.0;
        }
        let cholesky = covariance_m2.cholesky().expect("a diffuser point is uncertain in all directions");
        cholesky.l().try_inverse().expect("a Cholesky factor has an inverse")
    }

    /// Hands out residuals in standard deviations, with the slopes of what is predicted; all but the delays' priors.
    fn rows(&self, state: &State, mut each: impl FnMut(f64, &[(usize, f64)])) {
        let dimensions = self.experiment.dimensions;
        for (n, scan) in self.experiment.scans.iter().enumerate() {
            let (diffuser, slopes) = self.diffuser(state, n);
            let along = |way: Vector3<f64>, sd: f64| -> Vec<(usize, f64)> {
                slopes.iter().map(|(place, slope)| (*place, way.dot(slope) / sd)).collect()
            };
            let off = scan.diffuser - diffuser;
            for whitener in self.whitener(scan).row_iter().take(dimensions) {
                each((whitener * off).x, &along(whitener.transpose(), 1.0));
            }
            for (k, aside) in self.aside(state.directions[n]).into_iter().enumerate() {
                let sd_rad = scan.direction_sd_rad;
                each(scan.direction.dot(&aside) / sd_rad, &[(self.scan(n) + k, 1.0 / sd_rad)]);
            }
            for arrival in &scan.arrivals {
                let arm = diffuser - state.stations[arrival.sensor];
                let mut slopes = along(arm.normalize(), arrival.sd_m);
                slopes.push((self.scan(n) + dimensions - 1, 1.0 / arrival.sd_m));
                let sensor = self.stations[arrival.sensor].into_iter();
                slopes.extend(
                    sensor
                        .flat_map(|place| (0..dimensions).map(move |k| (place + k, k)))
                        .map(|(place, k)| (place, -arm[k] / (arm.norm() * arrival.sd_m))),
                );
                slopes.extend(arrival.delay.map(|delay| (self.delays + delay, 1.0 / arrival.sd_m)));
                let delay_m = arrival.delay.map_or(0.0, |delay| state.delays_m[delay]);
                let predicted_m = state.folded_m[n] + arm.norm() + delay_m;
                each((arrival.length_m - predicted_m) / arrival.sd_m, &slopes);
            }
        }
        for (n, (station, place)) in self.experiment.stations.iter().zip(&self.stations).enumerate() {
            let off = station.position - state.stations[n];
            let axes = place.iter().flat_map(|place| (0..dimensions).map(move |k| (place + k, k)));
            axes.for_each(|(place, k)| each(off[k] / station.sd_m, &[(place, 1.0 / station.sd_m)]));
        }
    }

    pub(super) fn chi2(&self, state: &State) -> f64 {
        let mut chi2 = 0.0;
        self.rows(state, |residual, _| chi2 += residual * residual);
        if let Some(information) = &self.delay_information {
            let delays = state.delays_m.iter().enumerate();
            chi2 += delays
                .flat_map(|(i, a)| state.delays_m.iter().enumerate().map(move |(k, b)| a * b * information[(i, k)]))
                .sum::<f64>();
        }
        chi2
    }

    /// Fisher matrix and right-hand side of a Gauss-Newton step.
    pub(super) fn normal_equations(&self, state: &State) -> (Matrix, Vec<f64>) {
        let (mut fisher, mut right) = (Matrix::zeros(self.count(), self.count()), vec![0.0; self.count()]);
        self.rows(state, |residual, slopes| {
            for (i, a) in slopes {
                right[*i] += a * residual;
                slopes.iter().for_each(|(k, b)| fisher[(*i, *k)] += a * b);
            }
        });
        if let Some(information) = &self.delay_information {
            for i in 0..state.delays_m.len() {
                for (k, delay_m) in state.delays_m.iter().enumerate() {
                    fisher[(self.delays + i, self.delays + k)] += information[(i, k)];
                    right[self.delays + i] -= information[(i, k)] * delay_m;
                }
            }
        }
        (fisher, right)
    }
}
