use super::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};

/// A sum without common errors.
fn sum(lit: PatchId, seen: PatchId, length_m: f64) -> Sum {
    Sum { lit, seen, length: Length { length_m, variance_m2: 1e-6 }, common_m: Vec::new() }
}

/// All pairs of patches 1 to `count`, each once, with noise.
fn all(count: PatchId, rng: &mut ChaCha8Rng) -> Vec<Sum> {
    let pairs = (1..=count).flat_map(|i| (i..=count).map(move |k| (i, k)));
    pairs.map(|(i, k)| sum(i, k, f64::from(i + k) + rng.random_range(-0.01..0.01))).collect()
}

#[test]
fn with_all_pairs_of_equal_variance_it_is_the_closed_form() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for count in [1, 2, 3, 8, 20] {
        let sums = all(count, &mut rng);
        let outcome = invert(&sums);
        let of = |patch: PatchId| {
            let ends = |sum: &Sum| f64::from(i32::from(sum.lit == patch) + i32::from(sum.seen == patch));
            sums.iter().map(|sum| ends(sum) * sum.length.length_m).sum::<f64>()
        };
        let total: f64 = (1..=count).map(of).sum();
        let v = f64::from(count);
        for (n, patch) in (1..=count).enumerate() {
            let expected = (of(patch) - total / (2.0 * v + 2.0)) / (v + 2.0);
            assert!((outcome.ranges_m[n] - expected).abs() < 1e-12);
            let variance_m2 = 1e-6 * (1.0 - 1.0 / (2.0 * v + 2.0)) / (v + 2.0);
            assert!((outcome.covariance_m2[(n, n)] - variance_m2).abs() < 1e-15);
        }
        assert!(outcome.open.is_empty() && outcome.degrees_of_freedom as PatchId == count * (count - 1) / 2);
    }
}

/// Onsets of the right-hand side as bounces (superscript) and patches (subscript): a third bounce less first bounces,
/// or half of them.
type Right = [(i32, &'static [PatchId], &'static [(i32, &'static [PatchId])]); 4];
const RIGHT: Right = [
    (3, &[1, 2, 1], &[(1, &[1])]),
    (3, &[1, 2, 4], &[(1, &[1]), (1, &[4])]),
    (3, &[1, 3, 1], &[(1, &[1])]),
    (3, &[1, 3, 4], &[(1, &[1]), (1, &[4])]),
];
/// As the paper prints it.
const PRINTED: Right = [
    (3, &[1, 2, 1], &[(1, &[1])]),
    (2, &[1, 2, 4], &[(1, &[1]), (1, &[4])]),
    (3, &[1, 3, 1], &[(1, &[3])]),
    (23, &[1, 3, 4], &[(1, &[1]), (1, &[4])]),
];
/// The matrix, of `d_21`, `d_24`, `d_31`, `d_34`, as printed.
const PAPER: [[f64; 4]; 4] = [[2.0, 0.0, 0.0, 0.0], [1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 2.0, 0.0], [0.0, 0.0, 1.0, 1.0]];

/// The paper's example: patches 1 and 4 visible, 2 and 3 hidden. An onset of n bounces names n patches, and hidden ones
/// have no first bounce: three printed rows break that, and no more. The matrix is right, but leaves out the sums over
/// patch 4 alone; with them the variance of `d_24` falls to a sixth.
#[test]
fn the_papers_t3_has_three_misprints_and_leaves_sums_out() {
    let misprinted = |rows: &Right| -> Vec<usize> {
        let is_wrong = |&(bounces, path, less): &(i32, &[PatchId], &[(i32, &[PatchId])])| {
            let hidden = less.iter().any(|(_, patch)| [2, 3].contains(&patch[0]));
            bounces != crate::path::bounces(path) || hidden
        };
        (0..4).filter(|&row| is_wrong(&rows[row])).collect()
    };
    assert_eq!((misprinted(&RIGHT), misprinted(&PRINTED)), (vec![], vec![1, 2, 3]));

    let truth = [0.9, 1.3, 1.7, 0.6];
    let right = |row: usize| -> f64 { (0..4).map(|k| PAPER[row][k] * truth[k]).sum() };
    for (of_patch, hidden) in [0, 2].into_iter().enumerate() {
        let path = |row: usize| RIGHT[row].1;
        let rows = [2 * of_patch, 2 * of_patch + 1];
        let sums = rows.map(|row| sum(path(row)[0], path(row)[2], right(row)));
        let literal = invert(&sums);
        assert!((0..2).all(|k| (literal.ranges_m[k] - truth[hidden + k]).abs() < 1e-12));
        let full = invert(&[sums[0].clone(), sums[1].clone(), sum(4, 4, 2.0 * truth[hidden + 1])]);
        assert!((0..2).all(|k| (full.ranges_m[k] - truth[hidden + k]).abs() < 1e-12));
        let variances = |ranges: &Ranges| [0, 1].map(|k| ranges.covariance_m2[(k, k)] / 1e-6);
        let (literal, full) = (variances(&literal), variances(&full));
        assert!((literal[0] - 0.25).abs() < 1e-9 && (literal[1] - 1.25).abs() < 1e-9, "{literal:?}");
        assert!(full.iter().all(|variance| (variance - 5.0 / 24.0).abs() < 1e-9), "{full:?}");
    }
}

/// Some pattern of sums among `count` patches, some both ways, each missing with this chance, with variances and common
/// errors of their own.
fn pattern(rng: &mut ChaCha8Rng, count: PatchId, missing: f64, errors: usize) -> Vec<Sum> {
    let mut sums = Vec::new();
    for (lit, seen) in (1..=count).flat_map(|lit| (1..=count).map(move |seen| (lit, seen))) {
        if rng.random_bool(missing) {
            continue;
        }
        let length = Length {
            length_m: f64::from(lit + seen) + rng.random_range(-0.001..0.001),
            variance_m2: rng.random_range(1e-6..4e-6),
        };
        let common_m = (0..errors).map(|_| rng.random_range(-0.002..0.002)).collect();
        sums.push(Sum { lit, seen, length, common_m });
    }
    sums
}

/// Weighted least squares by the full covariance of the sums, its minimum-norm solution; what the sums leave open of
/// each range (the squares of its components in the null space), covariance, and chi-square.
fn naive(sums: &[Sum], patches: &[PatchId]) -> (Vec<f64>, Vec<f64>, Matrix, f64) {
    let covariance = Matrix::from_fn(sums.len(), sums.len(), |n, m| {
        let common: f64 = sums[n].common_m.iter().zip(&sums[m].common_m).map(|(a, b)| a * b).sum();
        common + if n == m { sums[n].length.variance_m2 } else { 0.0 }
    });
    let weights = dense::inverse(&covariance).unwrap();
    let ends = |sum: &Sum, patch: PatchId| f64::from(i32::from(sum.lit == patch) + i32::from(sum.seen == patch));
    let rows = Matrix::from_fn(sums.len(), patches.len(), |n, k| ends(&sums[n], patches[k]));
    let lengths = Matrix::from_fn(sums.len(), 1, |n, _| sums[n].length.length_m);
    let normal = rows.transpose() * &weights * &rows;
    let (values, vectors) = dense::symmetric_eigen(&normal);
    let size = patches.len();
    let most = values.iter().copied().fold(0.0, f64::max);
    let is_null = |k: &usize| values[*k] < 1e-9 * most;
    let nulls: Vec<usize> = (0..size).filter(is_null).collect();
    let open = (0..size).map(|i| nulls.iter().map(|&k| vectors[(i, k)].powi(2)).sum()).collect();
    let kept: Vec<usize> = (0..size).filter(|k| !is_null(k)).collect();
    let inverse =
        Matrix::from_fn(size, size, |i, j| kept.iter().map(|&k| vectors[(i, k)] * vectors[(j, k)] / values[k]).sum());
    let solution = &inverse * rows.transpose() * &weights * &lengths;
    let residuals = &lengths - &rows * &solution;
    let chi2 = (residuals.transpose() * &weights * &residuals)[(0, 0)];
    ((0..size).map(|i| solution[(i, 0)]).collect(), open, inverse, chi2)
}

#[test]
fn any_pattern_of_sums_gives_the_generalised_least_squares_solution_or_says_what_is_open() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let (mut closed, mut open) = (0, 0);
    for (count, missing, errors) in (2..=8).flat_map(|count| {
        [0.0, 0.5, 0.8, 0.9].into_iter().flat_map(move |missing| [0, 1, 5].map(|errors| (count, missing, errors)))
    }) {
        let sums = pattern(&mut rng, count, missing, errors);
        let mut patches: Vec<PatchId> = sums.iter().flat_map(|sum| [sum.lit, sum.seen]).collect();
        patches.sort_unstable();
        patches.dedup();
        let outcome = invert(&sums);
        if patches.is_empty() {
            assert!(outcome.patches.is_empty() && outcome.open.is_empty());
            continue;
        }
        let (solution, nulls, covariance, chi2) = naive(&sums, &patches);
        let place = |patch: PatchId| patches.binary_search(&patch).unwrap();
        for patch in outcome.open.iter().flatten() {
            open += 1;
            assert!(nulls[place(*patch)] > 1e-6 && !outcome.patches.contains(patch));
        }
        assert_eq!(outcome.patches.len() + outcome.open.iter().flatten().count(), patches.len());
        for (n, a) in outcome.patches.iter().enumerate() {
            closed += 1;
            assert!(nulls[place(*a)] < 1e-9);
            assert!((outcome.ranges_m[n] - solution[place(*a)]).abs() < 1e-9);
            for (m, b) in outcome.patches.iter().enumerate() {
                assert!((outcome.covariance_m2[(n, m)] - covariance[(place(*a), place(*b))]).abs() < 1e-12);
            }
        }
        assert!((outcome.chi2 - chi2).abs() < 1e-6 * (1.0 + chi2), "{} {chi2}", outcome.chi2);
    }
    assert!(closed > 100 && open > 20, "{closed} {open}");
}

#[test]
fn disjoint_lit_and_seen_patches_leave_ranges_open_until_a_cycle_closes() {
    let range_m = |patch: PatchId| 1.0 + 0.1 * f64::from(patch);
    let pair = |(lit, seen): (PatchId, PatchId)| sum(lit, seen, range_m(lit) + range_m(seen));
    let disjoint: Vec<Sum> =
        (1..=3).flat_map(|lit| (4..=6).map(move |seen| (lit, seen))).chain([(8, 9)]).map(pair).collect();
    let outcome = invert(&disjoint);
    assert!(outcome.patches.is_empty() && outcome.ranges_m.is_empty());
    assert_eq!(outcome.open, [vec![1, 2, 3, 4, 5, 6], vec![8, 9]]);
    assert_eq!((outcome.degrees_of_freedom, outcome.chi2 < 1e-12), (4, true));
    let closed = invert(&[disjoint, vec![pair((5, 6))]].concat());
    assert_eq!(
        (closed.patches.as_slice(), closed.open.as_slice()),
        ([1, 2, 3, 4, 5, 6].as_slice(), [vec![8, 9]].as_slice())
    );
    for (patch, outcome_m) in closed.patches.iter().zip(&closed.ranges_m) {
        assert!((outcome_m - range_m(*patch)).abs() < 1e-9);
    }
}

/// Two hidden patches seen over the same four visible ones. One of their legs is off by 4 mm, another by 2 mm, all by 1
/// mm.
#[test]
fn claimed_errors_are_those_of_many_draws_also_between_hidden_patches() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let legs_m = |lit: PatchId, seen: PatchId| -> Vec<f64> {
        let ends = |patch: PatchId| f64::from(i32::from(lit == patch) + i32::from(seen == patch));
        vec![0.004 * ends(1), 0.002 * ends(3), 0.001]
    };
    let exact = |seed: u64| -> Vec<Sum> {
        let mut sums = pattern(&mut ChaCha8Rng::seed_from_u64(seed), 4, 0.3, 0);
        for sum in &mut sums {
            sum.length.length_m = f64::from(sum.lit + sum.seen);
            sum.common_m = legs_m(sum.lit, sum.seen);
        }
        sums
    };
    let scenes = [exact(10), exact(11)];
    let [first, second] = scenes.each_ref().map(|sums| invert(sums));
    assert_eq!((&first.patches, &second.patches), (&vec![1, 2, 3, 4], &vec![1, 2, 3, 4]));
    let between = dense::product(first.common_m.as_ref(), second.common_m.transpose());
    let claimed = Matrix::from_fn(8, 8, |i, k| match (i / 4, k / 4) {
        (0, 0) => first.covariance_m2[(i, k)],
        (1, 1) => second.covariance_m2[(i - 4, k - 4)],
        (0, _) => between[(i, k - 4)],
        _ => between[(k, i - 4)],
    });
    let weights = dense::inverse(&claimed).unwrap();
    let draws = 2000;
    let (mut drawn, mut within, mut chi2) = (Matrix::zeros(8, 8), 0, 0.0);
    for _ in 0..draws {
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let common: Vec<f64> = (0..3).map(|_| normal()).collect();
        let mut noisy = |sums: &[Sum]| {
            let mut sums = sums.to_vec();
            for sum in &mut sums {
                sum.length.length_m += sum.length.variance_m2.sqrt() * normal();
                sum.length.length_m += sum.common_m.iter().zip(&common).map(|(a, b)| a * b).sum::<f64>();
            }
            invert(&sums)
        };
        let outcome = [noisy(&scenes[0]), noisy(&scenes[1])];
        chi2 += outcome[0].chi2 / f64::from(draws);
        let error = |i: usize| outcome[i / 4].ranges_m[i % 4] - (i % 4 + 1) as f64;
        let mut squares = 0.0;
        for (i, k) in (0..8).flat_map(|i| (0..8).map(move |k| (i, k))) {
            drawn[(i, k)] += error(i) * error(k) / f64::from(draws);
            squares += error(i) * weights[(i, k)] * error(k);
        }
        // Quantile 0.95 of chi-square with eight degrees of freedom.
        within += i32::from(squares < 15.507);
    }
    for (i, k) in (0..8).flat_map(|i| (0..8).map(move |k| (i, k))) {
        let sd = ((claimed[(i, i)] * claimed[(k, k)] + claimed[(i, k)].powi(2)) / f64::from(draws)).sqrt();
        assert!((drawn[(i, k)] - claimed[(i, k)]).abs() < 5.0 * sd, "{i} {k}: {} {}", drawn[(i, k)], claimed[(i, k)]);
    }
    let coverage = f64::from(within) / f64::from(draws);
    assert!((coverage - 0.95).abs() < 0.02, "{coverage}");
    let freedom = first.degrees_of_freedom as f64;
    assert!((chi2 - freedom).abs() < 5.0 * (2.0 * freedom / f64::from(draws)).sqrt(), "{chi2} {freedom}");
}
