use nalgebra::{DMatrix, DVector, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::*;

/// Diffuser, barcode and sensors of the demo's kind, onsets of all strips in one profile a scan.
struct Scene {
    dimensions: usize,
    lit: Vec<Point>,
    exits: [Point; 2],
    strips: [Point; 2],
    surfaces: [Surface; 2],
    anchor_sd_m: f64,
    delay_sd_m: f64,
    onset_sd_m: f64,
}

const STATION: [f64; 3] = [0.1, 0.0, 0.0];

impl Scene {
    fn flat(scans: usize) -> Self {
        let lit = |k: usize| Point::new(0.23 + 0.44 * k as f64 / (scans as f64 - 1.0), 1.0, 0.0);
        Self {
            dimensions: 2,
            lit: (0..scans).map(lit).collect(),
            exits: [Point::new(-0.05, 1.0, 0.0), Point::new(0.95, 1.0, 0.0)],
            strips: [Point::new(0.68, 0.4125, 0.0), Point::new(0.72, 0.3875, 0.0)],
            surfaces: [Surface::Diffuse; 2],
            anchor_sd_m: 0.0,
            delay_sd_m: 0.0,
            onset_sd_m: 3e-4,
        }
    }

    fn space() -> Self {
        let corner = |k: usize| Point::new(0.23 + 0.22 * (k % 3) as f64, 1.0, 0.2 * (k / 3) as f64 - 0.1);
        Self {
            dimensions: 3,
            lit: (0..6).map(corner).collect(),
            strips: [Point::new(0.68, 0.4125, 0.01), Point::new(0.72, 0.3875, -0.01)],
            ..Self::flat(2)
        }
    }

    /// Measured with errors drawn, or none.
    fn problem(&self, mut rng: Option<&mut ChaCha8Rng>) -> Problem {
        let mut normal = || -> f64 { rng.as_mut().map_or(0.0, |rng| StandardNormal.sample(*rng)) };
        let delays_m = [normal() * self.delay_sd_m, normal() * self.delay_sd_m];
        let n = self.dimensions;
        let mut anchor = |at: Point, sd_m: f64, normal_of: Option<Vector3<f64>>| {
            let off = Vector3::from_fn(|k, _| if k < n { sd_m * normal() } else { 0.0 });
            Anchor { at: at + off, sd_m, normal: normal_of }
        };
        let down = Some(-Vector3::y());
        let mut anchors: Vec<Anchor> = self.lit.iter().map(|at| anchor(*at, self.anchor_sd_m, down)).collect();
        anchors.extend(self.exits.iter().map(|at| anchor(*at, self.anchor_sd_m, down)));
        let (own, other) = (anchors.len(), anchors.len() + 1);
        anchors.push(anchor(Point::origin(), 0.0, None));
        anchors.push(anchor(Point::from(STATION), 0.0, None));
        let mut records = Vec::new();
        for (k, lit) in self.lit.iter().enumerate() {
            let first = 2.0 * lit.coords.norm() + delays_m[0] + self.onset_sd_m * normal();
            records.push(ProfileOnsets {
                lit: k,
                station: own,
                delay: 0,
                bounce: Bounce::First,
                lengths_m: vec![first],
                covariance_m2: DMatrix::from_element(1, 1, self.onset_sd_m.powi(2)),
                heights: vec![1.0],
            });
            // Close pulses: errors that are opposed.
            let (common, apart) = (0.5 * self.onset_sd_m * normal(), self.onset_sd_m * normal());
            let errors = [common + apart, common - apart];
            let length_m = |s: usize| {
                let legs = [Point::origin(), *lit, self.strips[s], self.exits[s], Point::from(STATION)];
                let way_m: f64 = legs.windows(2).map(|leg| (leg[1] - leg[0]).norm()).sum();
                let normal = self.surfaces[s].normal(self.strips[s], &self.lit, self.exits[s]);
                way_m + self.surfaces[s].shift_m(self.strips[s], normal, *lit, self.exits[s]) + delays_m[1] + errors[s]
            };
            let variance = self.onset_sd_m.powi(2);
            records.push(ProfileOnsets {
                lit: k,
                station: other,
                delay: 1,
                bounce: Bounce::Third,
                lengths_m: vec![length_m(0), length_m(1)],
                covariance_m2: DMatrix::from_row_slice(2, 2, &[1.25, -0.75, -0.75, 1.25]) * variance,
                heights: vec![1.0; 2],
            });
        }
        let strips =
            (0..2).map(|s| Strip { exit: self.lit.len() + s, surface: self.surfaces[s], is_central: false }).collect();
        Problem {
            dimensions: self.dimensions,
            source: Point::origin(),
            anchors,
            delays_sd_m: vec![self.delay_sd_m; 2],
            strips,
            records,
            apart_max_m: Some(0.06),
            along: Some(Vector3::x()),
            cancel: Cancel::never(),
        }
    }

    fn errors(&self, solution: &Solution) -> DVector<f64> {
        let n = self.dimensions;
        DVector::from_fn(2 * n, |r, _| solution.points[r / n][r % n] - self.strips[r / n][r % n])
    }

    /// Squared error over covariance, a coordinate.
    fn normalised(&self, solution: &Solution) -> f64 {
        let places: Vec<usize> = (0..2).flat_map(|s| (0..self.dimensions).map(move |k| 3 * s + k)).collect();
        let covariance = solution.covariance_m2.select_rows(&places).select_columns(&places);
        let errors = self.errors(solution);
        errors.dot(&covariance.cholesky().unwrap().solve(&errors)) / errors.len() as f64
    }
}

#[test]
fn exact_lengths_give_exact_places_in_flatland_and_in_space() {
    for scene in [Scene::flat(2), Scene::flat(5), Scene::space()] {
        let solutions = solve(&scene.problem(None)).unwrap();
        assert!(scene.errors(&solutions[0]).amax() < 1e-9, "{:?}", solutions[0].points);
        assert!(solutions[0].chi2 < 1e-9);
        assert!(solutions[0].labels.iter().all(|(_, onsets)| *onsets == [0, 1]));
    }
}

/// Each assignment by itself, from the true places: none is likelier than what was found.
#[test]
fn no_assignment_is_likelier() {
    let scene = Scene { anchor_sd_m: 5e-4, delay_sd_m: 1e-3, ..Scene::flat(5) };
    for seed in 0..5 {
        let problem = scene.problem(Some(&mut ChaCha8Rng::seed_from_u64(seed)));
        let best = &solve(&problem).unwrap()[0];
        let scans: Vec<usize> = (0..5).map(|k| 2 * k + 1).collect();
        let naive = (0..32_usize).filter_map(|bits| {
            let labels: Vec<(usize, Vec<usize>)> = scans
                .iter()
                .enumerate()
                .map(|(k, scan)| (*scan, if bits >> k & 1 == 0 { vec![0, 1] } else { vec![1, 0] }))
                .collect();
            let fit = fit(&problem, &labels, &State::new(&problem, scene.strips.to_vec()))?;
            problem.admits(&fit.state.strips).then_some(fit.chi2)
        });
        let least = naive.fold(f64::INFINITY, f64::min);
        assert!((best.chi2 - least).abs() < 1e-5, "seed {seed}: {} {least}", best.chi2);
    }
}

#[test]
fn covariances_have_the_size_of_the_errors() {
    let glossy = Surface::Glossy { size_m: 0.012, lobe_rad: 0.2, normal: Some(Vector3::new(-0.3, 0.954, 0.0)) };
    let cases = [
        Scene { anchor_sd_m: 5e-4, delay_sd_m: 1e-3, ..Scene::flat(2) },
        Scene { anchor_sd_m: 1e-3, delay_sd_m: 1e-3, ..Scene::flat(5) },
        Scene { anchor_sd_m: 5e-4, surfaces: [glossy; 2], ..Scene::flat(2) },
        Scene { anchor_sd_m: 5e-4, ..Scene::space() },
    ];
    for (n, scene) in cases.iter().enumerate() {
        let draws = 200;
        let mean = (0..draws)
            .map(|seed| {
                scene.normalised(&solve(&scene.problem(Some(&mut ChaCha8Rng::seed_from_u64(seed)))).unwrap()[0])
            })
            .sum::<f64>()
            / draws as f64;
        // Five standard errors of the mean of chi-square over its degrees of freedom.
        let coordinates = 2.0 * scene.dimensions as f64;
        let bound = 5.0 * (2.0 / (coordinates * draws as f64)).sqrt();
        assert!((mean - 1.0).abs() < bound, "case {n}: {mean}");
    }
}

/// As many scans as dimensions fit with every assignment; what is known of distances and order decides, and nothing is
/// guessed without.
#[test]
fn what_labels_leave_open_is_reported() {
    let mut problem = Scene::flat(2).problem(None);
    assert_eq!(solve(&problem).unwrap().len(), 1);
    problem.along = None;
    assert_eq!(solve(&problem).unwrap().len(), 2);
    problem.apart_max_m = None;
    let solutions = solve(&problem).unwrap();
    assert!(solutions.len() > 2 && solutions.iter().all(|solution| solution.chi2 < 1e-6));
    problem.anchors.iter_mut().for_each(|anchor| anchor.normal = None);
    assert!(solve(&problem).unwrap().len() > solutions.len());
}

/// A third strip in the middle, undeclared: its onset in every profile reveals it, over either exit.
#[test]
fn strips_are_placed_beside_something_between() {
    for scans in [2, 5] {
        for through in [0, 1] {
            let scene = Scene { anchor_sd_m: 5e-4, ..Scene::flat(scans) };
            let middle = nalgebra::center(&scene.strips[0], &scene.strips[1]) + Vector3::new(1e-3, -1e-3, 0.0);
            let mut problem = scene.problem(Some(&mut ChaCha8Rng::seed_from_u64(through as u64)));
            for record in problem.records.iter_mut().filter(|record| record.bounce == Bounce::Third) {
                let legs = [Point::origin(), scene.lit[record.lit], middle, scene.exits[through], Point::from(STATION)];
                let way_m: f64 = legs.windows(2).map(|leg| (leg[1] - leg[0]).norm()).sum();
                // Onsets in order of time.
                let rank = record.lengths_m.iter().filter(|length_m| **length_m < way_m).count();
                record.lengths_m.insert(rank, way_m);
                record.covariance_m2 = record.covariance_m2.clone().insert_row(rank, 0.0).insert_column(rank, 0.0);
                record.covariance_m2[(rank, rank)] = scene.onset_sd_m.powi(2);
                record.heights.insert(rank, 1.0);
            }
            let solutions = solve(&problem).unwrap();
            assert!(scene.errors(&solutions[0]).amax() < 5e-3, "{scans} {through}: {:?}", solutions[0].points);
            assert!(scene.normalised(&solutions[0]) < 5.0);
            assert_eq!(solutions[0].labels[0].1.len(), 2);
        }
    }
}

/// A weak onset of something else in one scan: two scans fit any two of three onsets exactly, and the light that is
/// left over decides.
#[test]
fn a_stray_is_not_taken_for_a_strip() {
    for later_m in [-0.015, 0.01, 0.03] {
        let scene = Scene::flat(2);
        let mut problem = scene.problem(None);
        let record = problem.records.iter_mut().find(|record| record.bounce == Bounce::Third).unwrap();
        record.lengths_m.push(record.lengths_m[0] + later_m);
        record.covariance_m2 = record.covariance_m2.clone().insert_row(2, 0.0).insert_column(2, 0.0);
        record.covariance_m2[(2, 2)] = scene.onset_sd_m.powi(2);
        record.heights.push(0.2);
        let solutions = solve(&problem).unwrap();
        assert!(scene.errors(&solutions[0]).amax() < 1e-9, "{later_m}: {:?}", solutions[0].points);
    }
}

#[test]
fn what_cannot_be_placed_is_refused() {
    let mut problem = Scene::flat(2).problem(None);
    problem.records.truncate(2);
    assert_eq!(solve(&problem).unwrap_err(), Unsolved::TooFew { scans: 1, needed: 2 });
    let mut problem = Scene::flat(5).problem(None);
    problem.dimensions = 3;
    assert_eq!(solve(&problem).unwrap_err(), Unsolved::InLine);
    let mut problem = Scene::flat(2).problem(None);
    problem.apart_max_m = Some(0.01);
    assert_eq!(solve(&problem).unwrap_err(), Unsolved::NoPlace);
}

/// The mean way against a fine square grid, and against the mirror law where the glint is on the strip.
#[test]
fn the_glint_moves_with_the_lit_point() {
    let (centre, normal, size_m, lobe_rad) = (Point::new(0.5, 0.0, 0.0), Vector3::y(), 0.03, 0.1);
    let surface = Surface::Glossy { size_m, lobe_rad, normal: Some(normal) };
    for x in [0.4, 0.5, 0.8] {
        let (lit, exit) = (Point::new(x, 1.0, 0.0), Point::new(0.5, 0.8, 0.0));
        let (mut weights, mut ways_m) = (0.0, 0.0);
        for k in 0..300 * 300 {
            let place = |k: usize| size_m * ((k as f64 + 0.5) / 300.0 - 0.5);
            let at = centre + Vector3::new(place(k % 300), 0.0, place(k / 300));
            if (at - centre).norm() > 0.5 * size_m {
                continue;
            }
            let (to_lit, to_exit) = ((lit - at).normalize(), (exit - at).normalize());
            let angle = (Vector3::new(-to_lit.x, to_lit.y, -to_lit.z)).angle(&to_exit);
            let weight = (-0.5 * (angle / lobe_rad).powi(2)).exp();
            weights += weight;
            ways_m += weight * ((lit - at).norm() + (exit - at).norm());
        }
        let naive_m = ways_m / weights - (lit - centre).norm() - (exit - centre).norm();
        let shift_m = surface.shift_m(centre, normal, lit, exit);
        assert!((shift_m - naive_m).abs() < 0.02 * naive_m.abs() + 1e-6, "{x}: {shift_m} {naive_m}");
    }
    // Where the surface is unknown, the light may come from either rim.
    let unknown = Surface::Unknown { size_m: 0.02 };
    let (lit, exit) = (Point::new(0.9, 1.0, 0.0), Point::new(0.5, 1.0, 0.0));
    let rim = |side: f64| {
        let at = centre + side * 0.01 * Vector3::x();
        (lit - at).norm() + (exit - at).norm()
    };
    let sd_m = unknown.variance_m2(centre, normal, lit, exit).sqrt();
    assert!((sd_m - 0.5 * (rim(1.0) - rim(-1.0)).abs()).abs() < 1e-4);
}
