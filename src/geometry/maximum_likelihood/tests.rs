use super::*;
use crate::geometry::{classical, iso_embed, procrustes, room};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Metres of path in a picosecond.
const C: f64 = 2.997_924_58e-4;

fn observations(points: &[Point], sd_m: f64, rng: &mut ChaCha8Rng) -> Vec<Observation> {
    let origin = Node::Station(Point::origin());
    let mut paths: Vec<Vec<Node>> = (0..points.len()).map(|i| vec![origin, Node::Patch(i), origin]).collect();
    paths.extend(
        (0..points.len()).flat_map(|i| (0..i).map(move |j| vec![origin, Node::Patch(i), Node::Patch(j), origin])),
    );
    let place = Place { points: points.to_vec(), delays_m: vec![0.0] };
    let measure = |nodes: Vec<Node>| {
        let mut observation = Observation { nodes, length_m: 0.0, sd_m: sd_m.max(1e-6), delay: Some(0) };
        let noise: f64 = StandardNormal.sample(rng);
        observation.length_m = predicted_m(&observation, &place) + sd_m * noise;
        observation
    };
    paths.into_iter().map(measure).collect()
}

fn problem(start: Vec<Point>, observations: Vec<Observation>, delay_sd_m: f64) -> Problem {
    Problem { start, dimensions: 3, observations, anchors: Vec::new(), delay_sd_m: vec![delay_sd_m], robust: true }
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

/// Fisher matrix of all coordinates by numerical differentiation of lengths written anew: independent of the code under test.
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

/// Trace of the pseudo-inverse without its three rotations: the mean squared error after Procrustes alignment that no estimator goes below.
fn bound_rms(points: &[Point], sd_m: f64) -> f64 {
    let (values, _) = dense::symmetric_eigen(&fisher(points, sd_m));
    assert!(values[2] < 1e-3 * values[3], "three rotations, and only three: {:?}", &values[..5]);
    (values[3..].iter().map(|value| 1.0 / value).sum::<f64>() / points.len() as f64).sqrt()
}

/// Coordinate errors after alignment about p0, tangent to first order.
fn errors(found: &[Point], truth: &[Point]) -> Vec<f64> {
    let fit = procrustes::rotation(found, truth, Point::origin(), true);
    found
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
    assert_eq!(solution.free_rotations, 3);
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
    let trace: f64 = (0..3 * truth.len()).map(|i| solution.covariance[(i, i)]).sum();
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
    spoilt.robust = false;
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
    let ends = [
        Node::Station(Point::origin()),
        Node::Station(Point::new(0.5, 0.0, 0.0)),
        Node::Station(Point::new(0.0, 0.4, 0.1)),
    ];
    let place = Place { points: truth.clone(), delays_m: vec![0.0] };
    let measure = |problem: &mut Problem, stations: usize| {
        for (n, o) in problem.observations.iter_mut().enumerate() {
            *o.nodes.last_mut().unwrap() = ends[n % stations];
            o.length_m = predicted_m(o, &place);
            o.sd_m = 0.001;
        }
    };
    measure(&mut problem, 2);
    assert_eq!(solve(&problem).unwrap().free_rotations, 1);
    measure(&mut problem, 3);
    assert_eq!(solve(&problem).unwrap().free_rotations, 0);
    measure(&mut problem, 1);
    problem.anchors = [0, 20, 44].map(|patch| Anchor { patch, position: truth[patch], sd_m: 0.002 }).to_vec();
    let solution = solve(&problem).unwrap();
    assert_eq!(solution.free_rotations, 0);
    assert!(solution.points.iter().zip(&truth).all(|(a, b)| (a - b).norm() < 1e-7));
}

#[test]
fn too_few_paths_are_refused_and_the_poorest_patch_is_named() {
    let (truth, mut rng) = (room::rectangles(), ChaCha8Rng::seed_from_u64(8));
    let mut problem = problem(truth.clone(), observations(&truth, 0.001, &mut rng), 1e-6);
    problem.observations.retain(|o| !o.nodes.contains(&Node::Patch(7)) || o.nodes.len() == 3);
    let Err(Unsolved::Undetermined(poorest)) = solve(&problem) else { panic!("should be undetermined") };
    assert_eq!(poorest[0], (7, 1));
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
    assert_eq!(solution.free_rotations, 1);
    assert!(errors(&solution.points, &truth).iter().all(|e| e.abs() < 1e-7));
    assert!(solution.points.iter().all(|p| p.z == 0.0));
}

#[test]
fn derivatives_are_those_of_the_lengths() {
    let (truth, mut rng) = (room::rectangles(), ChaCha8Rng::seed_from_u64(10));
    let problem = problem(truth.clone(), observations(&truth, 0.0, &mut rng), 1.0);
    let place = Place { points: truth, delays_m: vec![0.1] };
    let mut terms = Vec::new();
    for observation in problem.observations.iter().step_by(97) {
        gradient(observation, &place, &problem, &mut terms);
        for k in 0..problem.unknowns() {
            let analytic: f64 = terms.iter().filter(|(i, _)| *i == k).map(|(_, value)| value).sum();
            let mut step = vec![0.0; problem.unknowns()];
            step[k] = 1e-6;
            let up = predicted_m(observation, &place.moved(&step, 3));
            step[k] = -1e-6;
            let down = predicted_m(observation, &place.moved(&step, 3));
            assert!(((up - down) / 2e-6 - analytic).abs() < 1e-7);
        }
    }
}
