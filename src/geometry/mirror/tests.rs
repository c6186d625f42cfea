use nalgebra::{DMatrix, Matrix3, Vector3};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::*;

/// Standard deviations of what is known and measured.
const DIFFUSER_SD_M: f64 = 0.001;
const DIRECTION_SD_RAD: f64 = 0.002;
const LENGTH_SD_M: f64 = 0.0006;

/// A true arrangement.
struct Truth {
    dimensions: usize,
    mirror: Mirror,
    source: Point,
    sensor: Point,
    directions: Vec<Vector3<f64>>,
    /// Ways from the mirror to the diffuser.
    onward_m: Vec<f64>,
}

impl Truth {
    /// A mirror half a metre from the source, and some beams within a few hundredths of a radian of its middle.
    fn draw(dimensions: usize, scans: usize, rng: &mut impl Rng) -> Self {
        let z = |value: f64| if dimensions == 3 { value } else { 0.0 };
        let mut aside = |most: f64| -> f64 { rng.random_range(-most..most) };
        let normal = Vector3::new(0.5 + aside(0.2), 0.8, z(aside(0.4))).normalize();
        let source = Point::new(aside(0.1), aside(0.1), z(aside(0.1)));
        let sensor = Point::new(-0.3 + aside(0.1), 0.1, z(aside(0.2)));
        let mirror = Mirror { normal, offset_m: normal.dot(&source.coords) + 0.4 + aside(0.1) };
        let mut direction = |_| Vector3::new(aside(0.15), 1.0, z(aside(0.15))).normalize();
        let directions = (0..scans).map(&mut direction).collect();
        let onward_m = (0..scans).map(|_| 0.45 + aside(0.15)).collect();
        Self { dimensions, mirror, source, sensor, directions, onward_m }
    }

    fn points(&self) -> Vec<Point> {
        let point = |u: &Vector3<f64>| self.source + u * self.mirror.meets(self.source, *u).unwrap();
        self.directions.iter().map(point).collect()
    }

    fn diffuser(&self) -> Vec<Point> {
        let beams = self.points().into_iter().zip(&self.directions).zip(&self.onward_m);
        beams.map(|((point, u), onward_m)| point + self.mirror.turned(*u) * *onward_m).collect()
    }

    /// Length of each path, leg by leg.
    fn lengths_m(&self) -> Vec<f64> {
        let legs = |(m, d): (Point, Point)| (m - self.source).norm() + (d - m).norm() + (self.sensor - d).norm();
        self.points().into_iter().zip(self.diffuser()).map(legs).collect()
    }

    /// Without errors, known as well as drawn ones are.
    fn exact(&self) -> Experiment {
        let scan = |((direction, diffuser), length_m): ((&Vector3<f64>, Point), f64)| Scan {
            direction: *direction,
            direction_sd_rad: DIRECTION_SD_RAD,
            diffuser,
            diffuser_covariance_m2: Matrix3::identity() * DIFFUSER_SD_M.powi(2),
            arrivals: vec![Arrival { sensor: 1, length_m, sd_m: LENGTH_SD_M, delay: None }],
        };
        let exactly = |position: Point| Station { position, sd_m: 0.0 };
        Experiment {
            dimensions: self.dimensions,
            stations: vec![exactly(self.source), exactly(self.sensor)],
            scans: self.directions.iter().zip(self.diffuser()).zip(self.lengths_m()).map(scan).collect(),
            delay_covariance_m2: Matrix::zeros(0, 0),
            cancel: Cancel::never(),
        }
    }
}

/// The same with a delay common to all, and stations known to an error.
fn with_priors(mut experiment: Experiment, delay_sd_m: f64, station_sd_m: f64) -> Experiment {
    experiment.delay_covariance_m2 = Matrix::from_fn(1, 1, |_, _| delay_sd_m * delay_sd_m);
    experiment.scans.iter_mut().flat_map(|scan| &mut scan.arrivals).for_each(|arrival| arrival.delay = Some(0));
    experiment.stations.iter_mut().for_each(|station| station.sd_m = station_sd_m);
    experiment
}

/// Errors drawn for all that has some.
fn drawn(exact: &Experiment, rng: &mut ChaCha8Rng) -> Experiment {
    let mut experiment = exact.clone();
    let mut normal = || -> f64 { StandardNormal.sample(rng) };
    let dimensions = exact.dimensions;
    let mut shake = |point: &mut Point, sd_m: f64| (0..dimensions).for_each(|k| point[k] += sd_m * normal());
    for scan in &mut experiment.scans {
        shake(&mut scan.diffuser, DIFFUSER_SD_M);
        // A direction is a point of the unit sphere.
        let mut end = Point::from(scan.direction);
        shake(&mut end, scan.direction_sd_rad);
        scan.direction = end.coords.normalize();
    }
    experiment.stations.iter_mut().for_each(|station| shake(&mut station.position, station.sd_m));
    let late_m =
        if exact.delay_covariance_m2.nrows() > 0 { exact.delay_covariance_m2[(0, 0)].sqrt() * normal() } else { 0.0 };
    let arrivals = experiment.scans.iter_mut().flat_map(|scan| &mut scan.arrivals);
    arrivals.for_each(|arrival| arrival.length_m += arrival.sd_m * normal() + late_m);
    experiment
}

#[test]
fn without_errors_all_methods_but_the_papers_are_exact() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for draw in 0..200 {
        let dimensions = 2 + draw % 2;
        let truth = Truth::draw(dimensions, dimensions + 1, &mut rng);
        let exact = truth.exact();
        let solution = solve(&exact).unwrap();
        let far_m = |points: &[Point], truth: &[Point]| {
            points.iter().zip(truth).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max)
        };
        assert!(far_m(&solution.points, &truth.points()) < 1e-9, "{:?}", solution.points);
        assert!(far_m(&solution.diffuser, &truth.diffuser()) < 1e-9 && solution.chi2 < 1e-9);
        assert!((solution.mirror.normal - truth.mirror.normal).norm() < 1e-9);
        let (mirror, contradiction) = virtual_source(&exact)[0];
        assert!((mirror.offset_m - truth.mirror.offset_m).abs() < 1e-6 && contradiction < 1e-6);
        for (distance_m, point) in per_ray(&exact).into_iter().zip(truth.points()) {
            assert!((distance_m.unwrap() - (point - truth.source).norm()).abs() < 1e-9);
        }
    }
}

/// The paper's assumption holds for a mirror bent about the source, and costs what distances differ by.
#[test]
fn equal_distances_are_right_where_distances_are_equal_and_between_them_where_not() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for _ in 0..100 {
        let truth = Truth::draw(2, 3, &mut rng);
        let mut bent = truth.exact();
        for scan in &mut bent.scans {
            let (point, [arrival]) = (truth.source + scan.direction * 0.5, &mut scan.arrivals[..]) else { panic!() };
            arrival.length_m = 0.5 + (scan.diffuser - point).norm() + (truth.sensor - scan.diffuser).norm();
        }
        assert!((equal_distances(&bent).unwrap() - 0.5).abs() < 1e-9);
        let distances_m = truth.points().into_iter().map(|point| (point - truth.source).norm());
        let (least_m, most_m) = distances_m.fold((f64::INFINITY, 0.0_f64), |(a, b), z| (a.min(z), b.max(z)));
        let common_m = equal_distances(&truth.exact()).unwrap();
        assert!(common_m > least_m && common_m < most_m, "{common_m} of {least_m} to {most_m}");
    }
}

/// With few scans beams decide what lengths leave open, and the joint fit leaves nothing open.
#[test]
fn one_scan_two_scans_and_diffuser_points_in_line_are_enough() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for _ in 0..50 {
        let one = Truth::draw(3, 1, &mut rng);
        let solution = solve(&one.exact()).unwrap();
        assert!((solution.points[0] - one.points()[0]).norm() < 1e-9 && solution.degrees_of_freedom == 0);
        assert!((solution.mirror.normal - one.mirror.normal).norm() < 1e-9);
        assert!(virtual_source(&one.exact()).is_empty());
        let two = Truth::draw(2, 2, &mut rng);
        let mirrors = virtual_source(&two.exact());
        assert!(mirrors.len() == 2 && mirrors[1].1 > 100.0, "{mirrors:?}");
        assert!((mirrors[0].0.normal - two.mirror.normal).norm() < 1e-6);
        let mut line = Truth::draw(2, 4, &mut rng);
        let points = line.points();
        for (n, onward_m) in line.onward_m.iter_mut().enumerate() {
            // All diffuser points at x = -0.3.
            *onward_m = (-0.3 - points[n].x) / line.mirror.turned(line.directions[n]).x;
        }
        let mirrors = virtual_source(&line.exact());
        assert!(mirrors.len() == 2 && mirrors[1].1 > 100.0, "{mirrors:?}");
        assert!((mirrors[0].0.normal - line.mirror.normal).norm() < 1e-6);
        assert!((solve(&line.exact()).unwrap().mirror.normal - line.mirror.normal).norm() < 1e-9);
    }
}

#[test]
fn light_that_nothing_turned_has_no_mirror() {
    let mut exact = Truth::draw(2, 2, &mut ChaCha8Rng::seed_from_u64(4)).exact();
    let source = exact.stations[0].position;
    for scan in &mut exact.scans {
        scan.diffuser = source + scan.direction;
        scan.arrivals[0].length_m = 1.0 + (scan.diffuser - exact.stations[1].position).norm();
    }
    assert_eq!(solve(&exact).unwrap_err(), Unsolved::Straight);
    exact.scans.iter_mut().for_each(|scan| scan.arrivals[0].length_m -= 0.1);
    assert!(per_ray(&exact).iter().all(Option::is_none) && equal_distances(&exact).is_none());
}

/// Covariance of the mirror points by finite differences of another model: onward ways in place of folded lengths, legs
/// in place of images.
fn bound(truth: &Truth, delay_sd_m: Option<f64>) -> DMatrix<f64> {
    let (dimensions, scans) = (truth.dimensions, truth.directions.len());
    let count = dimensions + scans * dimensions + usize::from(delay_sd_m.is_some());
    let aside = |v: Vector3<f64>, k: usize| {
        let first = if dimensions == 2 { Vector3::z().cross(&v) } else { v.cross(&Vector3::x()).normalize() };
        if k == 0 { first } else { v.cross(&first) }
    };
    let at = |unknowns: &[f64]| -> (Vec<f64>, Vec<f64>) {
        let turned = |v: Vector3<f64>, by: &[f64]| {
            (v + by.iter().enumerate().map(|(k, by)| aside(v, k) * *by).sum::<Vector3<f64>>()).normalize()
        };
        let (of_mirror, of_scans) = unknowns.split_at(dimensions);
        let scan = |n: usize| &of_scans[n * dimensions..(n + 1) * dimensions];
        let moved = Truth {
            mirror: Mirror {
                normal: turned(truth.mirror.normal, &of_mirror[..dimensions - 1]),
                offset_m: truth.mirror.offset_m + of_mirror[dimensions - 1],
            },
            directions: (0..scans).map(|n| turned(truth.directions[n], &scan(n)[..dimensions - 1])).collect(),
            onward_m: (0..scans).map(|n| truth.onward_m[n] + scan(n)[dimensions - 1]).collect(),
            ..*truth
        };
        let delay_m = delay_sd_m.map_or(0.0, |_| unknowns[count - 1]);
        let mut measured: Vec<f64> =
            moved.lengths_m().iter().map(|length_m| (length_m + delay_m) / LENGTH_SD_M).collect();
        measured.extend(moved.diffuser().iter().flat_map(|d| d.iter().map(|x| x / DIFFUSER_SD_M).collect::<Vec<_>>()));
        measured
            .extend(moved.directions.iter().flat_map(|u| u.iter().map(|x| x / DIRECTION_SD_RAD).collect::<Vec<_>>()));
        measured.extend(delay_sd_m.map(|sd_m| delay_m / sd_m));
        (measured, moved.points().iter().flat_map(|point| point.iter().copied().collect::<Vec<_>>()).collect())
    };
    let step = 1e-6;
    let columns: Vec<(Vec<f64>, Vec<f64>)> = (0..count)
        .map(|k| {
            let by = |sign: f64| at(&(0..count).map(|n| if n == k { sign * step } else { 0.0 }).collect::<Vec<_>>());
            let (ahead, behind) = (by(1.0), by(-1.0));
            let slope = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b) / (2.0 * step)).collect();
            (slope(&ahead.0, &behind.0), slope(&ahead.1, &behind.1))
        })
        .collect();
    let measured = DMatrix::from_fn(columns[0].0.len(), count, |i, k| columns[k].0[i]);
    let points = DMatrix::from_fn(columns[0].1.len(), count, |i, k| columns[k].1[i]);
    let fisher = measured.transpose() * &measured;
    &points * fisher.try_inverse().unwrap() * points.transpose()
}

#[test]
fn covariances_are_the_cramer_rao_bound() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for draw in 0..40 {
        let truth = Truth::draw(2 + draw % 2, 1 + draw % 5, &mut rng);
        let delay_sd_m = (draw % 3 == 0).then_some(0.0005);
        let exact = delay_sd_m.map_or(truth.exact(), |sd_m| with_priors(truth.exact(), sd_m, 0.0));
        let (solution, bound) = (solve(&exact).unwrap(), bound(&truth, delay_sd_m));
        let scans = truth.directions.len();
        for (a, b) in (0..scans).flat_map(|a| (0..scans).map(move |b| (a, b))) {
            let other = bound.fixed_view::<3, 3>(3 * a, 3 * b);
            assert!(
                (solution.covariance_m2(a, b) - other).norm() < 1e-4 * bound.norm(),
                "{truth:?}",
                truth = truth.mirror
            );
        }
    }
}

#[test]
fn claimed_errors_are_those_of_many_draws() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    for (dimensions, scans) in [(2, 3), (3, 3), (3, 6)] {
        let truth = Truth::draw(dimensions, scans, &mut rng);
        let exact = with_priors(truth.exact(), 0.0005, 0.0004);
        let draws = 1000;
        let (mut points, mut diffuser, mut normals, mut chi2) = (0.0, 0.0, 0.0, 0.0);
        for _ in 0..draws {
            let solution = solve(&drawn(&exact, &mut rng)).unwrap();
            // In flatland nothing is uncertain along z; the others are independent enough for one inverse each.
            let square = |error: Vector3<f64>, place: usize| {
                let mut own = solution.covariance_m2(place, place);
                own[(2, 2)] += if dimensions == 2 { 1.0 } else { 0.0 };
                error.dot(&(own.try_inverse().unwrap() * error)) / dimensions as f64
            };
            let mean = |solution: &[Point], truth: Vec<Point>, first: usize| {
                let errors = solution.iter().zip(truth).enumerate();
                errors.map(|(n, (point, truth))| square(point - truth, first + n)).sum::<f64>() / scans as f64
            };
            points += mean(&solution.points, truth.points(), 0) / f64::from(draws);
            diffuser += mean(&solution.diffuser, truth.diffuser(), scans) / f64::from(draws);
            let turn = solution.mirror.normal - truth.mirror.normal;
            normals += turn.norm_squared() / solution.normal_covariance().trace() / f64::from(draws);
            chi2 += solution.chi2 / solution.degrees_of_freedom as f64 / f64::from(draws);
        }
        for mean in [points, diffuser, normals, chi2] {
            assert!((mean - 1.0).abs() < 0.12, "{dimensions} {scans}: {points} {diffuser} {normals} {chi2}");
        }
    }
}

#[test]
fn several_sensors_add_up() {
    let truth = Truth::draw(2, 3, &mut ChaCha8Rng::seed_from_u64(7));
    let one = truth.exact();
    let mut both = one.clone();
    both.stations.push(Station { position: Point::new(-0.5, 0.6, 0.0), sd_m: 0.0 });
    for (scan, truth_m) in both.scans.iter_mut().zip(truth.lengths_m()) {
        let apart = |station: usize| (scan.diffuser - both.stations[station].position).norm();
        let length_m = truth_m - apart(1) + apart(2);
        scan.arrivals.push(Arrival { sensor: 2, length_m, ..scan.arrivals[0] });
    }
    let (one, both) = (solve(&one).unwrap(), solve(&both).unwrap());
    assert!((one.points[0] - both.points[0]).norm() < 1e-9);
    assert!(both.degrees_of_freedom == one.degrees_of_freedom + 3);
    assert!((0..3).all(|n| both.covariance_m2(n, n).trace() < one.covariance_m2(n, n).trace()));
    assert!(both.offset_sd_m() < one.offset_sd_m());
}
