//! Derivatives against differences, information against the scatter of fits, and searches of points, of surfaces and of
//! nothing.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal, Poisson};

use super::background::Level;
use super::extent::extents;
use super::fit::{Fit, Free, place_covariance, tail};
use super::model::{Dot, Model, SHARED};
use super::normal::{Normal as Sums, Shine};
use super::rounds::{search, settle};
use super::scores::{Line, Traces, add_squared};
use super::split::split;
use super::volume::Lattice;
use super::*;

const STEP_M: f64 = 0.0024;
const BINS: usize = 500;
/// Path length at which the histograms begin.
const GATE_M: f64 = 0.24;
const SIGMA_M: f64 = 0.0076;

fn response(after_m: f64) -> f64 {
    let tail = if after_m > 0.0 { 0.05 * (1.0 - (-after_m / 0.01).exp()) * (-after_m / 0.15).exp() } else { 0.0 };
    (-0.5 * (after_m / SIGMA_M).powi(2)).exp() + tail
}

fn pulse() -> Pulse {
    let step_m = 0.001;
    let values: Vec<f64> = (-40..900).map(|n| response(f64::from(n) * step_m)).collect();
    Pulse::new(-40.0 * step_m, step_m, &values, STEP_M)
}

fn gap_m(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

/// Histograms of a wall of 8 x 8 points, whose `seen` points lie apart from the lit ones by so much. Rates are made
/// here.
fn histograms(dots: &[([f64; 3], f64)], apart_m: f64, noise: Noise, seed: u64) -> Vec<Histogram> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let whole: f64 = (-100..1500).map(|n| response(f64::from(n) * STEP_M)).sum();
    let along = |n: usize| 0.6 * n as f64 / 7.0 - 0.3;
    let of_point = |n: usize| {
        let lit = [along(n % 8), along(n / 8), 0.0];
        let seen = [lit[0] + apart_m, lit[1], 0.0];
        let mut draw = |bin: usize| {
            let at_m = GATE_M + (bin as f64 + 0.5) * STEP_M;
            let mut rate = 0.2 + 20.0 * (-at_m / 0.08).exp();
            for (place, photons) in dots {
                let legs_m = [gap_m(lit, *place), gap_m(*place, seen)];
                let law = (0.25 / (legs_m[0] * legs_m[1])).powi(2);
                rate += photons * law * response(at_m - legs_m[0] - legs_m[1]) / whole;
            }
            let value = match noise {
                Noise::Counts => Poisson::new(rate).unwrap().sample(&mut rng),
                Noise::Gauss { sd } => rate + Normal::new(0.0, sd).unwrap().sample(&mut rng),
            };
            value as f32
        };
        let values = (0..BINS).map(&mut draw).collect();
        Histogram { lit: lit.into(), seen: seen.into(), first_m: GATE_M, values, ends: [[0.0; 2]; 2] }
    };
    (0..64).map(of_point).collect()
}

fn problem(histograms: Vec<Histogram>, noise: Noise) -> Problem {
    let front = (Point::new(0.0, 0.0, 1.0), 0.65);
    Problem::new(histograms, (STEP_M, pulse(), noise), front, 0.01, Cancel::never()).unwrap()
}

const DOTS: [([f64; 3], f64); 3] =
    [([0.1, -0.05, 0.45], 200.0), ([-0.12, 0.1, 0.5], 150.0), ([0.06, -0.02, 0.47], 180.0)];

#[test]
fn the_gradient_is_that_of_differences() {
    let problem = problem(histograms(&DOTS, 0.05, Noise::Counts, 1), Noise::Counts);
    let dot =
        |place: [f64; 3], log_photons| Dot { place: place.into(), log_photons, slopes: [0.05, -0.1], reference_m: 0.5 };
    let dots = vec![dot([0.103, -0.051, 0.452], 5.2), dot([-0.118, 0.1, 0.498], 5.1)];
    let shared: [f64; SHARED] = [-3.6, 0.02, -0.01, 0.03, 0.01, -0.02, 0.05, 0.03, -0.06, 0.05, -0.1, 0.2, -0.1];
    let model = Model { dots, shared, unsure: 1.0, wander_m: 0.0 };
    let shine = Shine::new(&problem, &model, true);
    let shape = tail(&problem, (&model, &shine));
    let levels: Vec<Level> = vec![[1.0, 0.2, 0.0]; 64];
    let at = Sums::new(&problem, &shape, (&model, &shine), &levels);
    for n in 0..model.unknowns() {
        let end = |sign: f64| {
            let mut step = vec![0.0; model.unknowns()];
            step[n] = sign * 2e-4;
            let moved = model.moved(&step);
            let shine = Shine::new(&problem, &moved, false);
            Sums::new(&problem, &shape, (&moved, &shine), &at.levels).log_likelihood
        };
        let slope = (end(1.0) - end(-1.0)) / 4e-4;
        let scale = at.fisher[(n, n)].sqrt();
        assert!((slope - at.gradient[n]).abs() < 0.02 * scale + 0.03 * slope.abs(), "{n}: {slope}, {}", at.gradient[n]);
    }
}

/// A model of dots at their places.
fn model_of(dots: &[([f64; 3], f64)]) -> Model {
    let dot = |(place, photons): &([f64; 3], f64)| Dot {
        place: (*place).into(),
        log_photons: photons.ln(),
        slopes: [0.0; 2],
        reference_m: 0.5,
    };
    Model { dots: dots.iter().map(dot).collect(), ..Model::default() }
}

/// The likeliest model with dots near these places.
fn fit_of(problem: &Problem, dots: &[([f64; 3], f64)]) -> Fit {
    let model = model_of(dots);
    let shape = tail(problem, (&model, &Shine::new(problem, &model, false)));
    Fit::new(problem, shape, model, &vec![[1.0, 0.2, 0.0]; problem.histograms.len()]).climb(problem, Free::All)
}

/// Light of two dots 12 mm apart as one point: 6 mm from its middle.
#[test]
fn the_size_of_a_point_shows_in_its_pulses() {
    let near = |[x, y, z]: [f64; 3], off: f64| [x + off, y, z];
    for seed in 0..4 {
        let (small, pair) = ([-0.12, 0.1, 0.5], [0.1, -0.05, 0.45]);
        let dots = [(small, 2000.0), (near(pair, 0.006), 1000.0), (near(pair, -0.006), 1000.0)];
        let problem = problem(histograms(&dots, 0.0, Noise::Counts, seed), Noise::Counts);
        let fit = fit_of(&problem, &[(small, 2000.0), (pair, 2000.0)]);
        let [dot, twins] = extents(&problem, &fit)[..] else { panic!("two points") };
        assert!(dot.square_m2.abs() < 4.0 * dot.sd_m2 && dot.sd_m2 < 5e-6, "{dot:?}");
        // The score at size 0 sees less of it than there is, and the common width takes a part.
        assert!((1.2e-5..5e-5).contains(&twins.square_m2), "{twins:?}");
        assert!(twins.square_m2 > 4.0 * twins.sd_m2, "{twins:?}");
    }
}

/// Light that is later than the response says: the common delay takes it up, or widens the error bars.
#[test]
fn a_common_delay_is_in_the_error_bars() {
    let (mut square, mut count) = (0.0, 0.0);
    for seed in 0..4 {
        let bright = DOTS.map(|(place, photons)| (place, 15.0 * photons));
        let mut histograms = histograms(&bright, 0.0, Noise::Counts, 300 + seed);
        // By 1 ps.
        histograms.iter_mut().for_each(|one| one.first_m += 3e-4);
        let outcome = joint_search(&problem(histograms, Noise::Counts));
        assert_eq!(outcome.verdict, Verdict::Points, "{outcome:?}");
        for (place, _) in bright {
            let off = |point: &HiddenPoint| point.place - Point::from(place);
            let point = outcome.points.iter().min_by(|a, b| off(a).norm().total_cmp(&off(b).norm())).unwrap();
            let off = off(point);
            square += off.dot(&(point.covariance_m2.try_inverse().unwrap() * off));
            count += 3.0;
        }
    }
    // Without the delay 0.15 mm of depth are ten standard deviations, and the mean is 30.
    let mean: f64 = square / count;
    assert!(mean < 4.0, "{mean}");
}

/// Histograms that are late or early each by itself: the shift is unknown, and error bars hold.
#[test]
fn shifts_of_single_histograms_are_in_the_fit() {
    let (mut square, mut count, mut wander, mut right) = (0.0, 0.0, 0.0, 0);
    for seed in 0..6 {
        let bright = DOTS.map(|(place, photons)| (place, 15.0 * photons));
        let mut histograms = histograms(&bright, 0.0, Noise::Counts, 400 + seed);
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        // 5 ps: four times what noise leaves of a point in a histogram.
        let shift = Normal::new(0.0, 0.0015).unwrap();
        histograms.iter_mut().for_each(|one| one.first_m += shift.sample(&mut rng));
        let problem = problem(histograms, Noise::Counts);
        let (fit, misfit) = settle(&problem, fit_of(&problem, &bright), 5.0);
        wander += fit.model.wander_m / 6.0;
        right += usize::from(misfit.factor == 1.0);
        let covariance = fit.covariance().unwrap();
        for (k, (place, _)) in bright.iter().enumerate() {
            let off = fit.model.dots[k].place - Point::from(*place);
            square += off.dot(&(place_covariance(&covariance, k).try_inverse().unwrap() * off));
            count += 3.0;
        }
    }
    // 54 squares that the mean of all shifts makes dependent. Where shifts are not in the fit, arrivals vary by ten
    // times their noise in all draws, and the factor on all variances is as large.
    let mean: f64 = square / count;
    assert!((0.3..1.8).contains(&mean) && (0.0011..0.0019).contains(&wander), "{mean}, {wander} m");
    assert!(right >= 4, "arrivals are within noise in {right} of 6 draws");
}

/// Sums on the grid of squared depths are those at the places themselves.
#[test]
fn sums_over_squared_depths_are_those_at_the_places() {
    let problem = problem(histograms(&DOTS, 0.0, Noise::Counts, 8), Noise::Counts);
    let shape = tail(&problem, (&Model::default(), &Shine::new(&problem, &Model::default(), false)));
    let fit = Fit::new(&problem, shape, Model::default(), &vec![[1.0, 0.2, 0.0]; 64]).climb(&problem, Free::Photons);
    let traces = Traces::new(&problem, &fit);
    let (step_m2, count) = (4e-4, 1000);
    let squared = traces.squared(&problem, step_m2, 2 * count).expect("a confocal scan");
    let (along, depths_m) = (Vector3::z(), vec![0.0; count]);
    for (place, _) in DOTS {
        let foot = Point::new(place[0], place[1], 0.0);
        let (mut sums, mut terms, mut places) = (vec![0.0; count], vec![0; count], vec![0.0; count]);
        let mut line =
            Line { foot, along, depths_m: &depths_m, sums: &mut sums, terms: &mut terms, places: &mut places };
        add_squared(&squared, step_m2, &mut line);
        let most = (0..count).max_by(|a, b| sums[*a].total_cmp(&sums[*b])).unwrap();
        let depth_m = ((most + 1) as f64 * step_m2).sqrt();
        assert!((depth_m - place[2]).abs() < 0.006, "{depth_m} is not {}", place[2]);
        let own = f64::from(sums[most]) / f64::from(terms[most]).sqrt();
        let [there, _] = traces.at(&Point::new(place[0], place[1], depth_m));
        assert!((own - there).abs() < 0.1 * there, "{own} is not {there}");
        // From the far corners of the wall light comes behind the end.
        assert!((56..=64).contains(&terms[most]), "{}", terms[most]);
    }
}

/// Fits at the truth of many draws scatter as the inverse Fisher matrix says.
#[test]
fn fits_scatter_as_their_information_says() {
    let (mut squares, mut count) = (0.0, 0.0);
    for seed in 0..12 {
        let problem = problem(histograms(&DOTS, 0.0, Noise::Counts, 100 + seed), Noise::Counts);
        let fit = fit_of(&problem, &DOTS);
        let covariance = fit.covariance().unwrap();
        for (k, (place, _)) in DOTS.iter().enumerate() {
            let off = fit.model.dots[k].place - Point::from(*place);
            squares += off.dot(&(place_covariance(&covariance, k).try_inverse().unwrap() * off));
            count += 3.0;
        }
    }
    // 108 squares of unit variance: 0.14 is one standard deviation of their mean.
    let mean: f64 = squares / count;
    assert!((0.65..1.4).contains(&mean), "{mean}");
}

#[test]
fn points_are_located_in_counts_and_in_gaussian_noise() {
    for (noise, apart_m) in [(Noise::Counts, 0.0), (Noise::Counts, 0.1), (Noise::Gauss { sd: 1.0 }, 0.0)] {
        let outcome = joint_search(&problem(histograms(&DOTS, apart_m, noise, 3), noise));
        assert_eq!(outcome.verdict, Verdict::Points, "{outcome:?}");
        assert_eq!(outcome.points.len(), 3, "{outcome:?}");
        for (place, _) in DOTS {
            let near = outcome.points.iter().filter(|point| (point.place - Point::from(place)).norm() < 0.005);
            assert_eq!(near.count(), 1, "{place:?}: {outcome:?}");
        }
    }
}

/// A plate of 400 dots.
fn plate(pitch_m: f64, corner_m: f64, photons: f64) -> Vec<([f64; 3], f64)> {
    let at = |n: i32| pitch_m * f64::from(n) + corner_m;
    (0..400).map(|n| ([at(n % 20), at(n / 20) + 0.03, 0.45], photons)).collect()
}

#[test]
fn a_plate_is_an_extended_object() {
    let dots = plate(0.01, -0.1, 2.0);
    let outcome = joint_search(&problem(histograms(&dots, 0.0, Noise::Counts, 4), Noise::Counts));
    assert_eq!(outcome.verdict, Verdict::ExtendedObject, "{outcome:?}");
}

/// Points of a faint plate, of which nothing is left once they are split: no points are no verdict "points".
#[test]
fn a_split_that_leaves_nothing_does_not_count() {
    let problem = problem(histograms(&plate(0.01, -0.095, 0.18), 0.0, Noise::Counts, 14), Noise::Counts);
    let outcome = joint_search(&problem);
    assert!(outcome.verdict != Verdict::Points && !outcome.points.is_empty(), "{outcome:?}");
    let lattice = Lattice::new(&problem);
    let whole = search(&problem, &lattice, [outcome.threshold; 2], Model::default());
    let split = split(&problem, whole.fit.clone(), outcome.threshold);
    assert!(split.model.dots.len() > whole.fit.model.dots.len());
    let (left, _) = settle(&problem, split, outcome.threshold);
    assert!(left.model.dots.is_empty(), "another plate is needed: {} points are left", left.model.dots.len());
}

/// Two points 12 mm apart: in no histogram does the response separate them.
#[test]
fn a_point_that_is_two_is_split() {
    let dots = [([0.05, 0.02, 0.45], 300.0), ([0.058, 0.025, 0.4575], 300.0), ([-0.12, 0.1, 0.5], 300.0)];
    let outcome = joint_search(&problem(histograms(&dots, 0.0, Noise::Counts, 6), Noise::Counts));
    assert_eq!((outcome.verdict, outcome.points.len()), (Verdict::Points, 3), "{outcome:?}");
    for (place, _) in dots {
        let near = outcome.points.iter().filter(|point| (point.place - Point::from(place)).norm() < 0.004);
        assert_eq!(near.count(), 1, "{place:?}: {outcome:?}");
    }
}

/// Without its tail the response leaves light behind a bright point.
#[test]
fn the_tail_of_a_response_is_no_point() {
    let step_m = 0.001;
    let narrow: Vec<f64> = (-40..=40).map(|n| (-0.5 * (f64::from(n) * step_m / SIGMA_M).powi(2)).exp()).collect();
    let pulse = Pulse::new(-40.0 * step_m, step_m, &narrow, STEP_M);
    for seed in 0..3 {
        let histograms = histograms(&[([0.05, 0.02, 0.45], 3000.0)], 0.0, Noise::Counts, seed);
        let outcome = joint_search(&Problem { pulse: pulse.clone(), ..problem(histograms, Noise::Counts) });
        assert!(outcome.verdict != Verdict::Points || outcome.points.len() == 1, "{outcome:?}");
    }
}

#[test]
fn the_wall_shows_its_response_with_the_tail() {
    for first_m in [-0.06, 0.0] {
        let at_m = |bin: usize| first_m + bin as f64 * STEP_M;
        let hidden = |at_m: f64| 2e3 * (-0.5 * ((at_m - 0.9) / SIGMA_M).powi(2)).exp();
        let sum: Vec<f64> = (0..900).map(|n| 1e6 * response(at_m(n)) + 200.0 + hidden(at_m(n))).collect();
        let gate = ((0.1 - first_m) / STEP_M) as usize;
        let wall = WallSum { sum: &sum, first_m, step_m: STEP_M, gate, width_m: 2.355 * SIGMA_M, noise: Noise::Counts };
        let [wall, truth] = [wall.pulse(STEP_M).unwrap(), pulse()];
        for n in -30..300 {
            let [own, other] = [&wall, &truth].map(|pulse| pulse.at(f64::from(n) * STEP_M));
            assert!((own - other).abs() < 0.03 * other + 0.01 * truth.at(0.0), "{n}: {own} is not {other}");
        }
    }
    let flat =
        WallSum { sum: &[5.0; 400], first_m: 0.0, step_m: STEP_M, gate: 100, width_m: 0.02, noise: Noise::Counts };
    assert!(flat.pulse(STEP_M).is_none());
}

#[test]
fn noise_alone_shows_nothing() {
    for seed in 0..4 {
        let outcome = joint_search(&problem(histograms(&[], 0.0, Noise::Counts, seed), Noise::Counts));
        assert_eq!((outcome.verdict, outcome.points.len()), (Verdict::Nothing, 0), "{outcome:?}");
        assert!(outcome.largest < outcome.threshold);
    }
}

#[test]
fn few_histograms_and_points_in_line_are_no_problem_to_solve() {
    let new = |histograms| {
        let front = (Point::new(0.0, 0.0, 1.0), 0.65);
        Problem::new(histograms, (STEP_M, pulse(), Noise::Counts), front, 0.01, Cancel::never())
    };
    let all = histograms(&[], 0.0, Noise::Counts, 1);
    assert!(new(all[..15].to_vec()).is_none());
    let line: Vec<Histogram> = (0..64).map(|n| all[n % 8].clone()).collect();
    assert!(new(line).is_none());
}

#[test]
fn a_search_ends_when_it_is_cancelled() {
    let cancel = Cancel::new();
    cancel.cancel();
    let problem = Problem { cancel, ..problem(histograms(&DOTS, 0.0, Noise::Counts, 1), Noise::Counts) };
    assert!(Cancel::catch(|| joint_search(&problem)).is_err());
}
