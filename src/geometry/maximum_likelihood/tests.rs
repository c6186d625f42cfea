use super::*;
use crate::Point;
use crate::loss::Loss;
use crate::{classical, dense, iso_embed, procrustes, room};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Metres of path in a picosecond.
const C: f64 = 2.997_924_58e-4;

pub(super) fn observations(points: &[Point], sd_m: f64, rng: &mut ChaCha8Rng) -> Vec<Observation> {
    let origin = Node::Station(0);
    let mut paths: Vec<Vec<Node>> = (0..points.len()).map(|i| vec![origin, Node::Patch(i), origin]).collect();
    paths.extend(
        (0..points.len()).flat_map(|i| (0..i).map(move |j| vec![origin, Node::Patch(i), Node::Patch(j), origin])),
    );
    let measure = |nodes: Vec<Node>| {
        let noise: f64 = StandardNormal.sample(rng);
        let length_m = way_m(&nodes, &[Point::origin()], points) + sd_m * noise;
        Observation { delay: Some(0), ..Observation::new(nodes, length_m, sd_m.max(1e-6)) }
    };
    paths.into_iter().map(measure).collect()
}

/// Length of a path, written anew.
fn way_m(nodes: &[Node], stations: &[Point], points: &[Point]) -> f64 {
    let at = |node: &Node| match node {
        Node::Station(station) => stations[*station],
        Node::Patch(patch) => points[*patch],
    };
    nodes.windows(2).map(|ends| nalgebra::distance(&at(&ends[0]), &at(&ends[1]))).sum()
}

pub(super) fn problem(start: Vec<Point>, observations: Vec<Observation>, delay_sd_m: f64) -> Problem {
    Problem::new(start, 3, &[Point::origin()], observations).with_common_delay(delay_sd_m)
}

/// Distances of the onsets by T2, over p0 and all patches.
fn distances(count: usize, observations: &[Observation]) -> Mat<f64> {
    let first: Vec<f64> = observations[..count].iter().map(|o| o.length_m).collect();
    let pair = |i: usize, j: usize| {
        let (i, j) = (i.max(j), i.min(j));
        observations[count + i * (i - 1) / 2 + j].length_m - (first[i] + first[j]) / 2.0
    };
    Mat::from_fn(count + 1, count + 1, |i, j| match (i.min(j), i.max(j)) {
        (i, j) if i == j => 0.0,
        (0, j) => first[j - 1] / 2.0,
        (i, j) => pair(j - 1, i - 1),
    })
}

/// Fisher matrix of all coordinates by numerical differentiation of lengths written anew: independent of the code under
/// test.
fn fisher(points: &[Point], sd_m: f64) -> Mat<f64> {
    let lengths = |x: &[f64]| -> Vec<f64> {
        let p = |i: usize| Vector3::new(x[3 * i], x[3 * i + 1], x[3 * i + 2]);
        let n = x.len() / 3;
        let mut l: Vec<f64> = (0..n).map(|i| 2.0 * p(i).norm()).collect();
        l.extend(
            (0..n)
                .flat_map(|i| (0..i).map(move |j| (i, j)))
                .map(|(i, j)| p(i).norm() + (p(i) - p(j)).norm() + p(j).norm()),
        );
        l
    };
    let x: Vec<f64> = points.iter().flat_map(|p| [p.x, p.y, p.z]).collect();
    let columns: Vec<Vec<f64>> = (0..x.len())
        .map(|k| {
            let (mut up, mut down) = (x.clone(), x.clone());
            up[k] += 1e-5;
            down[k] -= 1e-5;
            lengths(&up).iter().zip(lengths(&down)).map(|(a, b)| (a - b) / 2e-5 / sd_m).collect()
        })
        .collect();
    Mat::from_fn(x.len(), x.len(), |i, j| columns[i].iter().zip(&columns[j]).map(|(a, b)| a * b).sum())
}

/// Trace of the pseudo-inverse without its three rotations: the mean squared error after Procrustes alignment that no
/// estimator goes below.
fn bound_rms(points: &[Point], sd_m: f64) -> f64 {
    let (values, _) = dense::symmetric_eigen(&fisher(points, sd_m));
    assert!(values[2] < 1e-3 * values[3], "three rotations, and only three: {:?}", &values[..5]);
    (values[3..].iter().map(|value| 1.0 / value).sum::<f64>() / points.len() as f64).sqrt()
}

/// Coordinate errors after alignment about p0, tangent to first order.
fn errors(solution: &[Point], truth: &[Point]) -> Vec<f64> {
    let fit = procrustes::rotation(solution, truth, Point::origin(), true);
    solution
        .iter()
        .zip(truth)
        .flat_map(|(f, t)| {
            let e = procrustes::turn(&fit.matrix, Point::origin(), *f) - t;
            [e.x, e.y, e.z]
        })
        .collect()
}

#[test]
fn noiseless_lengths_give_the_room_back() {
    let (truth, mut rng) = (room::rectangles(), ChaCha8Rng::seed_from_u64(1));
    let start = truth.iter().map(|p| p + Vector3::from_fn(|_, _| rng.random_range(-0.05..0.05))).collect();
    let solution = solve(&problem(start, observations(&truth, 0.0, &mut rng), 1e-3)).unwrap();
    assert!(errors(&solution.points, &truth).iter().all(|e| e.abs() < 1e-8));
    assert_eq!((solution.free_rotations.as_slice(), solution.parts.len()), ([3].as_slice(), 1));
    assert!(solution.open.is_empty() && solution.is_exact());
}

#[test]
fn it_attains_the_bound_where_the_papers_method_does_not() {
    let (truth, mut rng) = (room::rectangles(), ChaCha8Rng::seed_from_u64(2));
    let seeds = 60;
    for sd_ps in [100.0, 25.0] {
        let sd_m = sd_ps * C;
        let (bound, information) = (bound_rms(&truth, sd_m), fisher(&truth, sd_m));
        let (mut ours, mut paper, mut nse) = (0.0, 0.0, 0.0);
        for _ in 0..seeds {
            let observations = observations(&truth, sd_m, &mut rng);
            let matrix = distances(truth.len(), &observations);
            let solution = solve(&problem(classical::embed(&matrix, 3), observations, 1e-6)).unwrap();
            let e = errors(&solution.points, &truth);
            ours += e.iter().map(|e| e * e).sum::<f64>();
            paper += errors(&iso_embed::embed(&matrix, 3), &truth).iter().map(|e| e * e).sum::<f64>();
            nse +=
                (0..e.len()).map(|i| (0..e.len()).map(|j| e[i] * information[(i, j)] * e[j]).sum::<f64>()).sum::<f64>();
            assert!((solution.chi2 / solution.degrees_of_freedom as f64 - 1.0).abs() < 0.25);
        }
        let rms = |squares: f64| (squares / f64::from(seeds) / truth.len() as f64).sqrt();
        let (ours, paper, dof) = (rms(ours) / bound, rms(paper) / bound, (3 * truth.len() - 3) as f64);
        let nse = nse / f64::from(seeds) / dof;
        eprintln!("{sd_ps} ps: rms / bound {ours:.3}, IsoEmbed {paper:.2}, normalised squared error / dof {nse:.3}");
        assert!(ours < 1.08 && ours > 0.92, "rms over bound {ours}");
        assert!(paper > 2.0, "IsoEmbed over bound {paper}");
        assert!((nse - 1.0).abs() < 0.1, "normalised squared error over dof {nse}");
    }
}

#[test]
fn its_covariance_is_the_bound() {
    let (truth, mut rng) = (room::rectangles(), ChaCha8Rng::seed_from_u64(3));
    let sd_m = 10.0 * C;
    let solution = solve(&problem(truth.clone(), observations(&truth, sd_m, &mut rng), 1e-6)).unwrap();
    let trace: f64 = (0..truth.len()).map(|i| solution.patch_covariance_m2(i, i).trace()).sum();
    let ratio = (trace / truth.len() as f64).sqrt() / bound_rms(&truth, sd_m);
    assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
}

#[test]
fn permuting_patches_permutes_the_answer_and_a_rerun_is_the_same_to_a_bit() {
    let (truth, mut rng) = (room::rectangles(), ChaCha8Rng::seed_from_u64(4));
    let straight = problem(truth.clone(), observations(&truth, 0.003, &mut rng), 0.01);
    let flip = |node: &Node| {
        if let Node::Patch(p) = node { Node::Patch(truth.len() - 1 - p) } else { *node }
    };
    let mut flipped = straight.clone();
    flipped.start.reverse();
    flipped.observations.iter_mut().for_each(|o| o.nodes = o.nodes.iter().map(flip).collect());
    let (a, b) = (solve(&straight).unwrap(), solve(&flipped).unwrap());
    let mut back = b.points.clone();
    back.reverse();
    assert!(errors(&a.points, &back).iter().all(|e| e.abs() < 1e-7));
    assert_eq!(solve(&straight).unwrap().points, a.points);
}

#[test]
fn a_gross_outlier_hardly_moves_a_robust_solution() {
    let (truth, mut rng) = (room::rectangles(), ChaCha8Rng::seed_from_u64(5));
    let clean = problem(truth.clone(), observations(&truth, 0.003, &mut rng), 1e-6);
    let mut spoilt = clean.clone();
    spoilt.observations[700].length_m += 1.0;
    let clean = solve(&clean).unwrap();
    let moved = |problem: &Problem| {
        errors(&solve(problem).unwrap().points, &clean.points).iter().fold(0.0_f64, |most, e| most.max(e.abs()))
    };
    let robust = moved(&spoilt);
    spoilt.loss = Loss::Squared;
    let plain = moved(&spoilt);
    assert!(robust < 0.003 && plain > 10.0 * robust, "robust {robust}, plain {plain}");
}

#[test]
fn a_delay_is_held_by_its_prior_and_found_where_the_prior_is_wide() {
    let (truth, mut rng) = (room::rectangles(), ChaCha8Rng::seed_from_u64(6));
    let sd_m = 0.1 * C;
    let delayed = |mut observations: Vec<Observation>| {
        observations.iter_mut().for_each(|o| o.length_m += 250.0 * C);
        observations
    };
    let observations = delayed(observations(&truth, sd_m, &mut rng));
    let wide = solve(&problem(truth.clone(), observations.clone(), 1.0)).unwrap();
    assert!((wide.delays_m[0] - 250.0 * C).abs() < 2.0 * C, "{}", wide.delays_m[0] / C);
    let tight = solve(&problem(truth.clone(), observations, 1e-7)).unwrap();
    assert!(tight.delays_m[0].abs() < 1.0 * C && tight.chi2 > 10.0 * wide.chi2);
}

#[test]
fn separate_stations_leave_one_rotation_or_none_and_anchors_none() {
    let (truth, mut rng) = (room::rectangles(), ChaCha8Rng::seed_from_u64(7));
    let mut problem = problem(truth.clone(), observations(&truth, 0.0, &mut rng), 1e-6);
    let stations = [Point::origin(), Point::new(0.5, 0.0, 0.0), Point::new(0.0, 0.4, 0.1)];
    problem.stations = stations.map(|position| Station { position, sd_m: 0.0 }).to_vec();
    let measure = |problem: &mut Problem, count: usize| {
        for (n, o) in problem.observations.iter_mut().enumerate() {
            *o.nodes.last_mut().unwrap() = Node::Station(n % count);
            o.length_m = way_m(&o.nodes, &stations, &truth);
            o.sd_m = 0.001;
        }
    };
    measure(&mut problem, 2);
    assert_eq!(solve(&problem).unwrap().free_rotations, [1]);
    measure(&mut problem, 3);
    assert_eq!(solve(&problem).unwrap().free_rotations, [0]);
    measure(&mut problem, 1);
    problem.anchors = [0, 20, 44].map(|patch| Anchor { patch, position: truth[patch], sd_m: 0.002 }).to_vec();
    let solution = solve(&problem).unwrap();
    assert_eq!(solution.free_rotations, [0]);
    assert!(solution.points.iter().zip(&truth).all(|(a, b)| (a - b).norm() < 1e-7));
}

#[test]
fn two_rays_and_an_anchor_fix_the_frame_and_an_uncertain_station_is_found() {
    let (truth, mut rng) = (room::rectangles(), ChaCha8Rng::seed_from_u64(11));
    let mut problem = problem(truth.clone(), observations(&truth, 0.0, &mut rng), 1e-6);
    let sensor = Point::new(0.3, 0.1, 0.2);
    problem.stations.push(Station { position: sensor + Vector3::new(0.002, -0.003, 0.001), sd_m: 0.005 });
    for (n, o) in problem.observations.iter_mut().enumerate().filter(|(n, _)| n % 2 == 1) {
        *o.nodes.last_mut().unwrap() = Node::Station(1);
        o.length_m = way_m(&o.nodes, &[Point::origin(), sensor], &truth);
        o.sd_m = if n % 3 == 0 { 1e-5 } else { 2e-5 };
    }
    let ray = |patch: usize| Ray { patch, from: 0, direction: truth[patch].coords.normalize(), sd_rad: 1e-4 };
    problem.rays = vec![ray(3), ray(30)];
    let solution = solve(&problem).unwrap();
    assert_eq!(solution.free_rotations, [0]);
    let off_m = (solution.stations[1] - sensor).norm();
    assert!(off_m < 1e-6, "{off_m}");
    assert!(solution.points.iter().zip(&truth).all(|(a, b)| (a - b).norm() < 1e-5));
    assert!(solution.station_covariance_m2(1).trace().sqrt() < 1e-3);
}

/// Every fourth path is longer by an error of its own kind; two of four kinds are drawn from a wide prior. Errors of
/// patches keep their size, and are as large as without such errors where the lengths tell them.
#[test]
fn common_errors_are_estimated_and_part_of_all_errors() {
    let truth = room::rectangles();
    let (mut squares, mut coordinates, draws) = (0.0, 0.0, 20);
    for seed in 0..draws {
        let mut rng = ChaCha8Rng::seed_from_u64(300 + seed);
        let mut problem = problem(truth.clone(), observations(&truth, 1e-4, &mut rng), 1e-3);
        problem.anchors = (0..4).map(|patch| Anchor { patch, position: truth[patch], sd_m: 1e-5 }).collect();
        let errors: Vec<f64> = (0..4).map(|_| StandardNormal.sample(&mut rng)).collect();
        for (n, observation) in problem.observations.iter_mut().enumerate() {
            let each_m = 1e-3 * (1.0 + (n % 7) as f64);
            observation.common = vec![(n % 4, each_m)];
            observation.length_m += errors[n % 4] * each_m;
        }
        let solution = solve(&problem).unwrap();
        let off = solution.common.iter().zip(&errors).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 0.1, "errors of ten times the noise are estimated: {off}");
        for (patch, at) in truth.iter().enumerate().skip(4) {
            let error = solution.points[patch] - at;
            let inverse = solution.patch_covariance_m2(patch, patch).try_inverse().unwrap();
            squares += error.dot(&(inverse * error));
            coordinates += 3.0;
        }
    }
    let ratio: f64 = squares / coordinates;
    assert!((0.8..1.25).contains(&ratio), "squared errors over their variances: {ratio}");
}

#[test]
fn the_laser_period_is_found_from_paths_with_unequal_turns() {
    let (truth, mut rng) = (room::rectangles(), ChaCha8Rng::seed_from_u64(12));
    let mut problem = problem(truth.clone(), observations(&truth, 1e-4, &mut rng), 1e-3);
    let late_m = 3e-4;
    for o in &mut problem.observations {
        o.turns = (o.length_m / 3.2).floor() as i32;
        o.length_m -= f64::from(o.turns) * late_m;
    }
    problem.period_sd_m = 1e-3;
    let solution = solve(&problem).unwrap();
    let sd_m = solution.period_variance_m2().unwrap().sqrt();
    assert!((solution.period_m - late_m).abs() < 4.0 * sd_m && sd_m < 1e-4, "{} {sd_m}", solution.period_m);
}

#[test]
fn a_patch_without_neighbours_is_a_part_of_its_own_and_one_with_a_neighbour_too_few_is_open() {
    let (truth, mut rng) = (room::rectangles(), ChaCha8Rng::seed_from_u64(8));
    let mut problem = problem(truth.clone(), observations(&truth, 0.001, &mut rng), 1e-6);
    problem.observations.retain(|o| {
        let has = |patch: usize| o.nodes.contains(&Node::Patch(patch));
        o.nodes.len() == 3 || !has(7) && (!has(9) || has(30))
    });
    let solution = solve(&problem).unwrap();
    assert_eq!((solution.parts.len(), solution.parts[1].as_slice()), (2, [7].as_slice()));
    assert_eq!(solution.free_rotations, [3, 2]);
    assert_eq!(solution.open, [9]);
    let sd_m = |patch: usize| solution.patch_covariance_m2(patch, patch).trace().sqrt();
    assert!((0..49).filter(|patch| ![7, 9].contains(patch)).all(|patch| sd_m(patch) < 0.01));
    assert!((solution.chi2 / solution.degrees_of_freedom as f64 - 1.0).abs() < 0.2);
}

/// First bounces of all, and second ones of some pairs, without noise.
fn of_pairs(truth: &[Point], has: impl Fn(usize, usize) -> bool) -> Problem {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let mut kept = observations(truth, 0.0, &mut rng);
    kept.retain(|observation| {
        let patches: Vec<usize> = observation.nodes.iter().filter_map(Node::patch).collect();
        patches.len() < 2 || has(patches[1], patches[0])
    });
    let start = truth.iter().map(|p| p + Vector3::from_fn(|_, _| rng.random_range(-1e-3..1e-3))).collect();
    problem(start, kept, 1e-6)
}

/// 5 to 7 turn about the line through the laser and patch 4. In a ring nothing is rigid but each pair.
#[test]
fn of_bodies_that_turn_about_one_another_the_largest_is_determined() {
    let truth = [0, 3, 11, 20, 27, 33, 39, 46].map(|n| room::rectangles()[n]);
    let solution = solve(&of_pairs(&truth, |a, b| b <= 4 || a >= 4)).unwrap();
    assert_eq!((solution.open.as_slice(), solution.free_rotations.as_slice()), ([5, 6, 7].as_slice(), [3].as_slice()));
    let sd_m = |patch: usize| solution.patch_covariance_m2(patch, patch).trace().sqrt();
    assert!((0..5).all(|patch| sd_m(patch) > 0.0 && sd_m(patch) < 1e-3));
    let solution = solve(&of_pairs(&truth, |a, b| b == a + 1 || (a, b) == (0, 7))).unwrap();
    assert_eq!(solution.open.len(), 6, "{:?}", solution.open);
    assert_eq!(solution.unplaced(), solution.open);
}

#[test]
fn two_halves_that_do_not_see_each_other_are_two_parts() {
    let (truth, mut rng) = (room::rectangles(), ChaCha8Rng::seed_from_u64(13));
    let mut problem = problem(truth.clone(), observations(&truth, 0.001, &mut rng), 1e-6);
    problem.observations.retain(|o| match o.nodes[..] {
        [_, Node::Patch(a), Node::Patch(b), _] => (a % 2 == 0) == (b % 2 == 0),
        _ => true,
    });
    let solution = solve(&problem).unwrap();
    assert_eq!((solution.parts[0].len(), solution.parts[1].len()), (25, 24));
    assert_eq!(solution.free_rotations, [3, 3]);
    assert!(solution.open.is_empty());
    assert!((solution.chi2 / solution.degrees_of_freedom as f64 - 1.0).abs() < 0.2);
}

#[test]
fn correlated_delays_move_together() {
    let (truth, mut rng) = (room::rectangles(), ChaCha8Rng::seed_from_u64(14));
    let mut problem = problem(truth.clone(), observations(&truth, 1e-4, &mut rng), 1e-3);
    // First bounces at a range of their own; both ranges share most of their delay's error.
    problem.observations[..49].iter_mut().for_each(|o| o.delay = Some(1));
    problem.delay_covariance_m2 = Mat::from_fn(2, 2, |i, k| if i == k { 1.01e-4 } else { 1.0e-4 });
    problem.observations.iter_mut().for_each(|o| o.length_m += 0.01);
    let solution = solve(&problem).unwrap();
    let (a, b) = (solution.delays_m[0], solution.delays_m[1]);
    assert!((a - 0.01).abs() < 4.0 * solution.delay_variance_m2(0).sqrt(), "{a}");
    assert!((a - b).abs() < 4e-3, "{a} {b}");
}

#[test]
fn without_the_normal_matrix_the_solution_is_the_same() {
    let (truth, mut rng) = (room::rectangles(), ChaCha8Rng::seed_from_u64(15));
    let mut problem = problem(truth.clone(), observations(&truth, 0.003, &mut rng), 0.003);
    problem.stations.push(Station { position: Point::new(0.2, 0.1, 0.0), sd_m: 0.002 });
    for o in problem.observations.iter_mut().step_by(3) {
        *o.nodes.last_mut().unwrap() = Node::Station(1);
        o.length_m = way_m(&o.nodes, &[Point::origin(), Point::new(0.2, 0.1, 0.0)], &truth);
    }
    let (dense, free) =
        (solve_by(&problem, Means::Dense).unwrap(), solve_by(&problem, Means::MatrixFree(Matrix::Normal)).unwrap());
    assert!(!free.is_exact() && (dense.loss - free.loss).abs() < 1e-6 * dense.loss);
    let turned = procrustes::rotation(&free.points, &dense.points, Point::origin(), false);
    assert!(turned.rms_m < 1e-6, "{}", turned.rms_m);
    let ratio = |a: f64, b: f64| (a / b).sqrt();
    let delay = ratio(free.delay_variance_m2(0), dense.delay_variance_m2(0));
    assert!((delay - 1.0).abs() < 0.02, "{delay}");
    let trace = |solution: &Solution| (0..49).map(|i| solution.patch_covariance_m2(i, i).trace()).sum::<f64>();
    let patches = ratio(trace(&free), trace(&dense));
    assert!((patches - 1.0).abs() < 0.15, "{patches}");
}

/// Where each patch is paired with a few near ones only, steps that take paths for straight overshoot near the minimum.
#[test]
fn a_scene_of_near_pairs_settles_in_few_steps() {
    let mut rng = ChaCha8Rng::seed_from_u64(18);
    let place = |rng: &mut ChaCha8Rng| Point::new(rng.random_range(-1.0..1.0), 2.6, rng.random_range(-0.8..0.8));
    let truth: Vec<Point> = (0..400).map(|_| place(&mut rng)).collect();
    let mut observations = observations(&truth, 6e-4, &mut rng);
    let apart_m = |o: &Observation| match o.nodes[1..o.nodes.len() - 1] {
        [Node::Patch(a), Node::Patch(b)] => nalgebra::distance(&truth[a], &truth[b]),
        _ => 0.0,
    };
    observations.retain(|o| apart_m(o) < 0.15);
    let mut problem = problem(truth.clone(), observations, 6e-4);
    problem.start.iter_mut().flat_map(|p| p.iter_mut()).for_each(|x| *x += rng.random_range(-0.005..0.005));
    let rows = Rows::new(&problem);
    let (_, loss, settled) = descend(&rows, Means::MatrixFree(Matrix::Normal), 30, SETTLED_MATRIX_FREE_M);
    assert!(settled);
    let dense = solve_by(&problem, Means::Dense).unwrap();
    // Patches with few neighbours turn freely about them, so objectives are compared instead of positions.
    assert!((dense.loss - loss).abs() < 1e-9 * dense.loss, "{} {loss}", dense.loss);
}

/// Compared with differences of the slope, whose derivatives they are.
#[test]
fn products_are_second_derivatives() {
    let (truth, mut rng) = (room::rectangles(), ChaCha8Rng::seed_from_u64(17));
    let mut problem = problem(truth.clone(), observations(&truth, 0.05, &mut rng), 1.0);
    problem.stations.push(Station { position: Point::new(0.2, 0.1, 0.3), sd_m: 0.01 });
    for o in problem.observations.iter_mut().step_by(3) {
        *o.nodes.last_mut().unwrap() = Node::Station(1);
        o.sd_m = 0.02;
    }
    problem.loss = Loss::Squared;
    let rows = Rows::new(&problem);
    let values = Values::start(&problem);
    let vector: Vec<f64> = (0..rows.layout.size).map(|_| StandardNormal.sample(&mut rng)).collect();
    let slope = |by: f64| {
        let step: Vec<f64> = vector.iter().map(|value| by * value).collect();
        let (values, mut sum, mut terms) = (values.moved(&step, &rows.layout), vec![0.0; rows.layout.size], Vec::new());
        for n in 0..rows.count {
            let residual = rows.residual(&values, n, Some(&mut terms));
            terms.iter().for_each(|&(i, a)| sum[i] -= a * residual);
        }
        sum
    };
    let (up, down) = (slope(1e-6), slope(-1e-6));
    let product = matrix_free::product(&rows, &values, Matrix::Bent, &vector);
    let straight = matrix_free::product(&rows, &values, Matrix::Normal, &vector);
    let largest = product.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
    let off = |product: &[f64]| {
        let off =
            product.iter().zip(up.iter().zip(&down)).map(|(value, (up, down))| (value - (up - down) / 2e-6).abs());
        off.fold(0.0, f64::max) / largest
    };
    assert!(off(&product) < 1e-6 && off(&straight) > 1e-3, "{} {}", off(&product), off(&straight));
}

#[test]
fn flatland_stays_flat() {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let truth: Vec<Point> =
        room::rectangles().iter().take(10).map(|p| Point::new(p.x + 0.3 * p.z, p.y + p.z * p.x, 0.0)).collect();
    let mut problem = problem(truth.clone(), observations(&truth, 0.0, &mut rng), 1e-6);
    problem.dimensions = 2;
    problem.start.iter_mut().for_each(|p| p.x += rng.random_range(-0.02..0.02));
    let solution = solve(&problem).unwrap();
    assert_eq!(solution.free_rotations, [1]);
    assert!(errors(&solution.points, &truth).iter().all(|e| e.abs() < 1e-7));
    assert!(solution.points.iter().all(|p| p.z == 0.0));
}

#[test]
fn derivatives_are_those_of_the_residuals() {
    let (truth, mut rng) = (room::rectangles(), ChaCha8Rng::seed_from_u64(10));
    let mut problem = problem(truth.clone(), observations(&truth, 0.001, &mut rng), 1.0);
    problem.observations.truncate(60);
    problem.observations.iter_mut().for_each(|o| o.turns = 1);
    problem.observations[50..].iter_mut().for_each(|o| o.shared = vec![(0, 0.7 * o.sd_m)]);
    problem.period_sd_m = 0.1;
    problem.stations.push(Station { position: Point::new(0.2, 0.1, 0.3), sd_m: 0.01 });
    problem.anchors = vec![Anchor { patch: 4, position: truth[4], sd_m: 0.1 }];
    problem.rays = vec![Ray { patch: 5, from: 1, direction: Vector3::new(0.0, 0.6, 0.8), sd_rad: 0.1 }];
    problem.delay_covariance_m2 = Mat::from_fn(2, 2, |i, k| if i == k { 2.0 } else { 1.0 });
    let rows = Rows::new(&problem);
    let values = Values::start(&problem);
    let mut terms = Vec::new();
    for n in (0..rows.count).filter(|n| *n >= 50 || n % 7 == 0) {
        rows.residual(&values, n, Some(&mut terms));
        for k in 0..rows.layout.size {
            let analytic: f64 = terms.iter().filter(|(i, _)| *i == k).map(|(_, value)| value).sum();
            let mut step = vec![0.0; rows.layout.size];
            step[k] = 1e-6;
            let up = rows.residual(&values.moved(&step, &rows.layout), n, None);
            step[k] = -1e-6;
            let down = rows.residual(&values.moved(&step, &rows.layout), n, None);
            // What is predicted grows where the residual falls.
            assert!(((down - up) / 2e-6 - analytic).abs() < 1e-3 * (1.0 + analytic.abs()), "{n} {k}");
        }
    }
}
