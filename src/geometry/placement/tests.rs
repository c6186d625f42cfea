use super::*;
use crate::maximum_likelihood::Ray;
use crate::{procrustes, room};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use room::{Information, Way};

const SD_M: f64 = 0.0075;

/// Noisy lengths of some paths.
fn measured(truth: &[Point], stations: &[Point], ways: &[Way], sd_m: f64, seed: u64) -> Problem {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let observation = |way: &Way| {
        let noise: f64 = StandardNormal.sample(&mut rng);
        let inner = way.patches.iter().map(|&patch| Node::Patch(patch));
        let ends = [Node::Station(way.source), Node::Station(way.sensor)];
        Observation::new(
            std::iter::once(ends[0]).chain(inner).chain([ends[1]]).collect(),
            way.length_m(truth, stations) + sd_m * noise,
            sd_m,
        )
    };
    Problem::new(vec![Point::origin(); truth.len()], 3, stations, ways.iter().map(observation).collect())
}

/// All first bounces, and the second bounces over some pairs, each measured one way around.
fn ways(count: usize, sensors: &[usize], pairs: &[(usize, usize)]) -> Vec<Way> {
    let over =
        |patches: Vec<usize>| sensors.iter().map(move |&sensor| Way { source: 0, patches: patches.clone(), sensor });
    let first = (0..count).flat_map(|patch| over(vec![patch]));
    first.chain(pairs.iter().flat_map(|&(a, b)| over(vec![a, b]))).collect()
}

/// Source and sensor in one point.
fn colocated(truth: &[Point], missing: f64, sd_m: f64, seed: u64) -> (Problem, Vec<(usize, usize)>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed + 1000);
    let mut pairs = room::all_pairs(truth.len());
    pairs.retain(|_| !rng.random_bool(missing));
    (measured(truth, &[Point::origin()], &ways(truth.len(), &[0], &pairs), sd_m, seed), pairs)
}

fn without(problem: &mut Problem, unwanted: impl Fn(&[usize]) -> bool) {
    problem.observations.retain(|o| !unwanted(&patches(o).collect::<Vec<_>>()));
}

fn rms_m(solution: &[Point], truth: &[Point]) -> f64 {
    procrustes::rotation(solution, truth, Point::origin(), true).rms_m
}

fn plain_rms_m(solution: &[Point], truth: &[Point]) -> f64 {
    (solution.iter().zip(truth).map(|(a, b)| (a - b).norm_squared()).sum::<f64>() / truth.len() as f64).sqrt()
}

#[test]
fn four_pairs_of_five_may_be_missing() {
    let truth = room::rectangles();
    let mut within = 0;
    for seed in 0..20 {
        let (problem, pairs) = colocated(&truth, 0.8, SD_M, seed);
        let placed = place(&problem);
        let bound_m = room::bound_m(&truth, &pairs, [SD_M, SD_M], 0.0);
        within += usize::from(bound_m.is_finite() && rms_m(&placed.points, &truth) < 2.0 * bound_m);
        assert_eq!(placed.degrees_of_freedom, 49 + pairs.len() as i64 - 144);
    }
    assert!(within >= 17, "{within} of 20");
}

#[test]
fn a_patch_with_two_neighbours_has_a_twin_and_its_mirror_image_is_one_of_the_two() {
    let truth = room::rectangles();
    let (mut problem, _) = colocated(&truth, 0.5, 1e-4, 3);
    let kept: Vec<Vec<usize>> = problem
        .observations
        .iter()
        .map(|o| patches(o).collect())
        .filter(|p: &Vec<_>| p.len() == 2 && p.contains(&10))
        .take(2)
        .collect();
    without(&mut problem, |p| p.len() == 2 && p.contains(&10) && !kept.iter().any(|k| k == p));
    let placed = place(&problem);
    let others = alternatives(&problem, &placed.points, &[]);
    assert_eq!(others.len(), 1, "{others:?}");
    assert!(others[0].kind == Kind::Flip && others[0].patches == [10] && others[0].more.abs() < 1e-3);
    assert!(rms_m(&placed.points, &truth).min(rms_m(&others[0].points, &truth)) < 0.001);
}

/// Two groups that share no pair hang on two patches: one may fold over, with all its patches.
#[test]
fn a_group_that_hangs_on_two_patches_may_fold_over() {
    let truth: Vec<Point> = room::rectangles().into_iter().step_by(7).take(7).collect();
    let groups: [&[usize]; 2] = [&[0, 1, 2, 3, 4], &[3, 4, 5, 6]];
    let is_within = |(a, b): &(usize, usize)| groups.iter().any(|group| group.contains(a) && group.contains(b));
    let pairs: Vec<(usize, usize)> = room::all_pairs(truth.len()).into_iter().filter(is_within).collect();
    let problem = measured(&truth, &[Point::origin()], &ways(truth.len(), &[0], &pairs), 1e-4, 11);
    let placed = place(&problem);
    let others = alternatives(&problem, &placed.points, &[]);
    assert!(others.iter().any(|other| other.patches == [5, 6] && other.more.abs() < 1e-3), "{others:?}");
    let all = others.iter().map(|other| &other.points).chain([&placed.points]);
    assert!(all.map(|points| rms_m(points, &truth)).fold(f64::INFINITY, f64::min) < 0.001);
}

/// A patch with one neighbour has places all around: none of them is an alternative, and they hide no other.
#[test]
fn places_of_a_patch_that_can_move_are_no_alternatives() {
    let truth = [0, 3, 11, 20, 27, 33, 39, 46].map(|n| room::rectangles()[n]);
    let groups: [&[usize]; 3] = [&[0, 1, 2, 3, 4], &[3, 4, 5, 6], &[0, 7]];
    let is_within = |(a, b): &(usize, usize)| groups.iter().any(|group| group.contains(a) && group.contains(b));
    let pairs: Vec<(usize, usize)> = room::all_pairs(truth.len()).into_iter().filter(is_within).collect();
    let problem = measured(&truth, &[Point::origin()], &ways(truth.len(), &[0], &pairs), 1e-4, 12);
    let placed = place(&problem);
    let others = alternatives(&problem, &placed.points, &[7]);
    assert!(others.iter().all(|other| !other.patches.contains(&7)), "{others:?}");
    assert!(others.len() < 8 && others.iter().any(|other| other.patches == [5, 6]), "{others:?}");
}

#[test]
fn complete_lengths_need_one_start_and_permuting_patches_permutes_the_answer() {
    let truth = room::rectangles();
    let (problem, _) = colocated(&truth, 0.3, 0.002, 4);
    let placed = place(&problem);
    assert!(placed.starts == 1 && alternatives(&problem, &placed.points, &[]).is_empty());
    let mut flipped = problem.clone();
    for node in flipped.observations.iter_mut().flat_map(|o| &mut o.nodes) {
        if let Node::Patch(patch) = node {
            *patch = truth.len() - 1 - *patch;
        }
    }
    let mut flipped = place(&flipped).points;
    flipped.reverse();
    assert!(rms_m(&flipped, &placed.points) < 1e-5);
}

#[test]
fn growth_from_a_seed_alone_finds_the_room_and_a_patch_that_sees_none_stays_on_its_sphere() {
    let truth = room::rectangles();
    let (mut problem, _) = colocated(&truth, 0.6, 1e-4, 5);
    without(&mut problem, |p| p.len() == 2 && p.contains(&7));
    let measurements = Measurements::new(&problem);
    let mut grown = measurements.grow(measurements.sprout(&measurements.seeds()[0], 0)).points();
    assert!((2.0 * grown[7].coords.norm() - problem.observations[7].length_m).abs() < 1e-6);
    let mut others = truth.clone();
    grown.remove(7);
    others.remove(7);
    assert!(rms_m(&grown, &others) < 0.01, "{}", rms_m(&grown, &others));
}

#[test]
fn a_patch_at_its_mirror_image_is_moved_back() {
    let truth = room::rectangles();
    let (problem, _) = colocated(&truth, 0.7, 0.001, 6);
    let measurements = Measurements::new(&problem);
    let settled = |points: Vec<Point>| measurements.settle(points.into_iter().map(Some).collect(), STEPS);
    let right = settled(truth.clone());
    let mut start = right.points();
    // Through the plane of the origin and the vertical edge of the wall.
    let normal = truth[0].coords.cross(&Vector3::z()).normalize();
    let height = normal.dot(&start[30].coords);
    start[30] -= 2.0 * normal * height;
    assert!(measurements.repair(settled(start)).loss < right.loss + 1e-3);
}

#[test]
fn flatland_is_placed_in_its_plane() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let truth: Vec<Point> =
        (0..12).map(|_| Point::new(rng.random_range(-2.0..2.0), rng.random_range(1.0..3.0), 0.0)).collect();
    let (mut problem, _) = colocated(&truth, 0.5, 1e-4, 8);
    problem.dimensions = 2;
    let placed = place(&problem);
    assert!(placed.points.iter().all(|p| p.z == 0.0));
    assert!(rms_m(&placed.points, &truth) < 0.001, "{}", rms_m(&placed.points, &truth));
}

#[test]
fn very_few_patches_are_placed_as_far_as_their_paths_allow() {
    for count in 1..6 {
        let truth: Vec<Point> = room::rectangles().into_iter().step_by(9).take(count).collect();
        for stations in [[Point::origin(), Point::origin()], [Point::origin(), Point::new(0.5, 0.0, 0.0)]] {
            let problem = measured(&truth, &stations, &ways(count, &[1], &room::all_pairs(count)), 1e-4, 12);
            let placed = place(&problem);
            assert!(placed.loss < 12.0, "{count} patches: {placed:?}");
        }
    }
}

#[test]
fn separate_stations_that_span_space_leave_nothing_free() {
    let truth = room::rectangles();
    let stations = [Point::origin(), Point::new(0.5, 0.1, 0.0), Point::new(-0.5, 0.0, 0.2), Point::new(0.1, -0.2, 0.5)];
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let mut pairs = room::all_pairs(truth.len());
    pairs.retain(|_| rng.random_bool(0.3));
    let mut problem = measured(&truth, &stations, &ways(truth.len(), &[1, 2, 3], &pairs), 0.002, 9);
    // Gross outliers, three in a hundred.
    problem.observations.iter_mut().step_by(33).for_each(|o| o.length_m *= 1.05);
    let placed = place(&problem);
    let (right, loss) = maximum_likelihood::approach(&Problem { start: truth, ..problem.clone() }, STEPS, SETTLED_M);
    assert!(plain_rms_m(&placed.points, &right.points) < 1e-4 && placed.loss < loss + SAME);
    assert!(alternatives(&problem, &placed.points, &[]).is_empty());
}

/// Root of the mean squared error after the best turn about the x axis; `mirrored` first in the plane of x and z.
fn rms_about_x_m(solution: &[Point], truth: &[Point], mirrored: bool) -> f64 {
    let sign = if mirrored { -1.0 } else { 1.0 };
    let (mut sine, mut cosine) = (0.0, 0.0);
    for (f, t) in solution.iter().zip(truth) {
        cosine += sign * f.y * t.y + f.z * t.z;
        sine += sign * f.y * t.z - f.z * t.y;
    }
    let (sine, cosine) = (sine / sine.hypot(cosine), cosine / sine.hypot(cosine));
    let turned = |p: &Point| Point::new(p.x, cosine * sign * p.y - sine * p.z, sine * sign * p.y + cosine * p.z);
    plain_rms_m(&solution.iter().map(turned).collect::<Vec<_>>(), truth)
}

#[test]
fn one_separate_sensor_attains_the_bound() {
    let truth = room::rectangles();
    let stations = [Point::origin(), Point::new(0.3, 0.0, 0.0)];
    let (mut squares, mut bounds) = (0.0, 0.0);
    for seed in 0..30 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        // Each way around is measured or not on its own.
        let mut pairs = room::all_pairs(truth.len());
        pairs.extend(room::all_pairs(truth.len()).into_iter().map(|(a, b)| (b, a)));
        pairs.retain(|_| rng.random_bool(0.5));
        let ways = ways(truth.len(), &[1], &pairs);
        let problem = measured(&truth, &stations, &ways, SD_M, seed);
        let placed = place(&problem);
        let rms_m = |mirrored| rms_about_x_m(&placed.points, &truth, mirrored);
        squares += rms_m(false).min(rms_m(true)).powi(2);
        let information = Information::of_ways(&truth, &stations, &ways, &vec![SD_M; ways.len()], 0.0);
        bounds += room::bound_of_m(&information.of_positions(), 1).powi(2);
        assert!(alternatives(&problem, &placed.points, &[]).is_empty());
    }
    let ratio = (squares / bounds).sqrt();
    // Two angles make most of the error, so that a mean over 30 scenes is known to some 10 %.
    assert!((ratio - 1.0).abs() < 0.25, "{ratio}");
}

#[test]
fn stations_in_one_point_have_the_fisher_matrix_of_one_station() {
    let truth = room::rectangles();
    let pairs = room::all_pairs(truth.len());
    let one = room::fisher(&truth, &pairs, [SD_M, SD_M], 0.003);
    let stations = [Point::origin(), Point::origin()];
    let ways = ways(truth.len(), &[1], &pairs);
    let two = Information::of_ways(&truth, &stations, &ways, &vec![SD_M; ways.len()], 0.003).of_positions();
    let largest = (0..147).fold(0.0, |most: f64, i| most.max(one[(i, i)]));
    assert!((0..147).all(|i| (0..147).all(|k| (one[(i, k)] - two[(i, k)]).abs() < 1e-9 * largest)));
}

#[test]
fn stations_in_a_plane_leave_the_mirror_image_of_the_whole() {
    let truth = room::rectangles();
    let stations = [Point::origin(), Point::new(0.5, 0.0, 0.0), Point::new(-0.1, 0.0, 0.4)];
    let problem = measured(&truth, &stations, &ways(truth.len(), &[1, 2], &room::all_pairs(truth.len())), 1e-4, 10);
    let placed = place(&problem);
    let others = alternatives(&problem, &placed.points, &[]);
    assert_eq!(others.len(), 1, "{:?}", others.iter().map(|o| (&o.patches, o.more)).collect::<Vec<_>>());
    assert!(others[0].kind == Kind::Mirror && others[0].patches.len() == 49 && others[0].more.abs() < 1e-6);
    assert!(plain_rms_m(&placed.points, &truth).min(plain_rms_m(&others[0].points, &truth)) < 0.001);
}

#[test]
fn second_bounces_alone_place_lit_and_seen_patches() {
    let truth: Vec<Point> = room::rectangles().into_iter().step_by(3).take(16).collect();
    let stations = [Point::origin(), Point::new(0.5, 0.0, 0.0)];
    let over =
        |a: usize| (0..16).filter(move |b| b % 2 == 1).map(move |b| Way { source: 0, patches: vec![a, b], sensor: 1 });
    let ways: Vec<Way> = (0..16).step_by(2).flat_map(over).collect();
    let problem = measured(&truth, &stations, &ways, 1e-4, 11);
    let placed = place(&problem);
    assert!(placed.loss < 40.0, "{}", placed.loss);
}

/// The rectangles with pairs of one wall closed and a third of all pairs missing: where the captured pairs do not give
/// it away, the shortest detour is taken for the direct path.
fn with_hidden_detours(truth: &[Point], seed: u64) -> (Problem, Vec<bool>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let wall = |patch: usize| {
        if patch < 25 {
            0
        } else if patch < 41 {
            1
        } else {
            2
        }
    };
    let captured: std::collections::BTreeSet<(usize, usize)> =
        room::all_pairs(truth.len()).into_iter().filter(|_| !rng.random_bool(1.0 / 3.0)).collect();
    let is_open = |a: usize, b: usize| wall(a) != wall(b);
    let has = |a: usize, b: usize| captured.contains(&(a.min(b), a.max(b)));
    let (mut all, mut wrong) = (ways(truth.len(), &[0], &[]), vec![false; truth.len()]);
    let mut problem_ways = Vec::new();
    for &(a, b) in &captured {
        if is_open(a, b) {
            problem_ways.push((vec![a, b], vec![a, b]));
            continue;
        }
        let over = (0..truth.len()).filter(|&k| is_open(a, k) && is_open(k, b));
        let length = |k: usize| (truth[a] - truth[k]).norm() + (truth[k] - truth[b]).norm();
        let via = over.min_by(|&k, &l| length(k).total_cmp(&length(l))).expect("another wall");
        if !(has(a, via) && has(via, b)) {
            problem_ways.push((vec![a, b], vec![a, via, b]));
        }
    }
    let taken = |(labels, true_path): &(Vec<usize>, Vec<usize>)| (labels.clone(), true_path.clone());
    let labels: Vec<(Vec<usize>, Vec<usize>)> = problem_ways.iter().map(taken).collect();
    all.extend(labels.iter().map(|(_, path)| Way { source: 0, patches: path.clone(), sensor: 0 }));
    wrong.extend(labels.iter().map(|(labels, path)| labels != path));
    let mut problem = measured(truth, &[Point::origin()], &all, SD_M, seed);
    for (observation, (labels, _)) in problem.observations[truth.len()..].iter_mut().zip(&labels) {
        observation.nodes = vec![Node::Station(0), Node::Patch(labels[0]), Node::Patch(labels[1]), Node::Station(0)];
    }
    (problem, wrong)
}

/// A quarter of the lengths are too long. A few patches whose wrong lengths happen to agree may end elsewhere.
#[test]
fn hidden_detours_are_outvoted() {
    let truth = room::rectangles();
    for seed in 0..3 {
        let (problem, wrong) = with_hidden_detours(&truth, seed);
        let count = wrong.iter().filter(|wrong| **wrong).count();
        assert!(count > 140, "{count} of {}", wrong.len());
        let placed = place(&problem);
        let fit = procrustes::rotation(&placed.points, &truth, Point::origin(), true);
        let off_m = |n: usize| (procrustes::turn(&fit.matrix, Point::origin(), placed.points[n]) - truth[n]).norm();
        let far = (0..truth.len()).filter(|&n| off_m(n) > 0.15).count();
        eprintln!("seed {seed}: {count} of {} wrong, {far} patches far off, rms {:.3} m", wrong.len(), fit.rms_m);
        assert!(far <= 5, "seed {seed}: {far}");
    }
}

#[test]
fn weak_third_bounces_beside_the_others_attain_the_bound() {
    let (truth, origin, delay_sd_m) = (room::rectangles(), [Point::origin()], 0.3);
    let (mut squares, mut normalised) = (0.0, 0.0);
    for seed in 0..10 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut ways = ways(truth.len(), &[0], &room::all_pairs(truth.len()));
        let mut sds_m = vec![SD_M; ways.len()];
        // Also back to the patch that was lit.
        let third = |_| [0; 3].map(|_: usize| rng.random_range(0..truth.len()));
        let thirds = (0..2000).map(third).filter(|[a, b, c]| a != b && b != c);
        ways.extend(thirds.map(|patches| Way { source: 0, patches: patches.to_vec(), sensor: 0 }));
        sds_m.resize(ways.len(), 10.0 * SD_M);
        let mut problem = measured(&truth, &origin, &ways, 0.0, seed).with_common_delay(delay_sd_m);
        let delay_m = delay_sd_m * rng.sample::<f64, _>(StandardNormal);
        for (observation, sd_m) in problem.observations.iter_mut().zip(&sds_m) {
            observation.length_m += delay_m + sd_m * rng.sample::<f64, _>(StandardNormal);
            observation.sd_m = *sd_m;
        }
        let start = place(&problem).points;
        let solution = maximum_likelihood::solve(&Problem { start, ..problem }).unwrap();
        let fit = procrustes::rotation(&solution.points, &truth, Point::origin(), true);
        let information = Information::of_ways(&truth, &origin, &ways, &sds_m, delay_sd_m);
        let delay_ratio = solution.delay_variance_m2(0).sqrt() / information.delay_sd_m(3);
        assert!((delay_ratio - 1.0).abs() < 0.05, "{delay_ratio}");
        let fisher = information.of_positions();
        squares += (fit.rms_m / room::bound_of_m(&fisher, 3)).powi(2) / 10.0;
        let turned = solution.points.iter().map(|point| procrustes::turn(&fit.matrix, Point::origin(), *point));
        let errors: Vec<f64> = turned.zip(&truth).flat_map(|(a, b)| <[f64; 3]>::from(a - b)).collect();
        let row = |i: usize| (0..errors.len()).map(|k| fisher[(i, k)] * errors[k]).sum::<f64>();
        normalised += (0..errors.len()).map(|i| errors[i] * row(i)).sum::<f64>() / 144.0 / 10.0;
    }
    // The delay makes most of the error of positions, hence the wide margin; all 144 degrees of freedom together are
    // known to 4 %.
    assert!((0.8..1.25).contains(&squares.sqrt()), "{}", squares.sqrt());
    assert!((normalised - 1.0).abs() < 0.12, "{normalised}");
}

#[test]
fn rays_fix_the_frame_and_the_covariance_is_the_bound() {
    let (truth, origin, sd_rad) = (room::rectangles(), [Point::origin()], 0.002);
    let ways = ways(truth.len(), &[0], &room::all_pairs(truth.len()));
    let mut problem = measured(&truth, &origin, &ways, 1e-3, 14);
    let ray = |(patch, point): (usize, &Point)| Ray { patch, from: 0, direction: point.coords.normalize(), sd_rad };
    problem.rays = truth.iter().enumerate().map(ray).collect();
    let start = place(&problem).points;
    let solution = maximum_likelihood::solve(&Problem { start, ..problem }).unwrap();
    let information = Information::of_ways(&truth, &origin, &ways, &vec![1e-3; ways.len()], 0.0);
    let bound_m = room::bound_of_m(&information.with_rays(&truth, origin[0], sd_rad).of_positions(), 0);
    let trace_m2: f64 = (0..truth.len()).map(|i| solution.patch_covariance_m2(i, i).trace()).sum();
    let ratio = (trace_m2 / truth.len() as f64).sqrt() / bound_m;
    assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
    assert!(plain_rms_m(&solution.points, &truth) < 2.0 * bound_m);
}
