use super::*;
use crate::dense;
use faer::Mat;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};

/// T2 for three patches, order of unknowns d01 d12 d13 d02 d23 d03, as it must be.
const RIGHT: [[f64; 6]; 6] = [
    [2.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [1.0, 1.0, 0.0, 1.0, 0.0, 0.0],
    [1.0, 0.0, 1.0, 0.0, 0.0, 1.0],
    [0.0, 0.0, 0.0, 2.0, 0.0, 0.0],
    [0.0, 0.0, 0.0, 1.0, 1.0, 1.0],
    [0.0, 0.0, 0.0, 0.0, 0.0, 2.0],
];
/// The onsets of its right-hand side, as bounces (superscript) and patches (subscript): O^1_1, O^2_12, O^2_13, O^1_2,
/// O^2_23, O^1_3.
const RIGHT_ONSETS: [(i32, &[PatchId]); 6] =
    [(1, &[1]), (2, &[1, 2]), (2, &[1, 3]), (1, &[2]), (2, &[2, 3]), (1, &[3])];

/// The same as the paper prints it: row four gives the first bounce of patch 2 the length 2 `d23`.
const PRINTED: [[f64; 6]; 6] = [
    [2.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [1.0, 1.0, 0.0, 1.0, 0.0, 0.0],
    [1.0, 0.0, 1.0, 0.0, 0.0, 1.0],
    [0.0, 0.0, 0.0, 0.0, 2.0, 0.0],
    [0.0, 0.0, 0.0, 1.0, 1.0, 1.0],
    [0.0, 0.0, 0.0, 0.0, 0.0, 2.0],
];
/// Its right-hand side as printed: the fourth and sixth onset, O^2_1 and O^3_1, have the bounces where the patch should
/// stand, and the other way round.
const PRINTED_ONSETS: [(i32, &[PatchId]); 6] =
    [(1, &[1]), (2, &[1, 2]), (2, &[1, 3]), (2, &[1]), (2, &[2, 3]), (3, &[1])];

const TRUTH: [f64; 6] = [1.9, 0.8, 1.1, 2.3, 0.7, 2.6];

fn solve_square(rows: &[[f64; 6]; 6], right: &[f64]) -> Vec<f64> {
    // Normal equations: small and well-conditioned enough for a reference.
    let matrix = Mat::from_fn(6, 6, |i, j| (0..6).map(|k| rows[k][i] * rows[k][j]).sum());
    let right: Vec<f64> = (0..6).map(|i| (0..6).map(|k| rows[k][i] * right[k]).sum()).collect();
    dense::solve(&matrix, &right).unwrap()
}

/// The unknowns, as pairs of patches.
const UNKNOWNS: [(PatchId, PatchId); 6] = [(0, 1), (1, 2), (1, 3), (0, 2), (2, 3), (0, 3)];

/// Path lengths from p0 over the patches of each onset and back.
fn onsets(d: &[f64; 6]) -> [f64; 6] {
    let leg = |a: PatchId, b: PatchId| d[UNKNOWNS.iter().position(|pair| *pair == (a.min(b), a.max(b))).unwrap()];
    RIGHT_ONSETS.map(|(_, path)| {
        let ends = leg(0, path[0]) + leg(0, path[path.len() - 1]);
        ends + path.windows(2).map(|step| leg(step[0], step[1])).sum::<f64>()
    })
}

fn closed(o: &[f64], variance_m2: f64) -> Distances {
    let length = |k: usize| Length { length_m: o[k], variance_m2 };
    invert(
        &[(1, length(0)), (2, length(3)), (3, length(5))],
        &[((1, 2), length(1)), ((3, 1), length(2)), ((2, 3), length(4))],
    )
}

/// In the order of the unknowns above.
fn values(distances: &Distances) -> [f64; 6] {
    UNKNOWNS.map(|(a, b)| distances.distances.iter().find(|d| (d.a, d.b) == (a, b)).unwrap().distance_m)
}

#[test]
fn the_closed_form_is_the_solution_of_t2() {
    let o = onsets(&TRUTH);
    let solved = solve_square(&RIGHT, &o);
    let outcome = values(&closed(&o, 1e-6));
    for k in 0..6 {
        assert!((solved[k] - TRUTH[k]).abs() < 1e-9 && (outcome[k] - TRUTH[k]).abs() < 1e-12);
    }
}

/// An onset of n bounces names n patches; two of the printed ones do not. With the right onsets the printed matrix,
/// invertible too, swaps `d02` and `d23`, which puts `d12` off by their difference.
#[test]
fn the_printed_matrix_gives_three_wrong_distances() {
    let misprinted = |onsets: [(i32, &[PatchId]); 6]| -> Vec<usize> {
        (0..6).filter(|&k| onsets[k].0 != crate::path::bounces(onsets[k].1)).collect()
    };
    assert_eq!((misprinted(RIGHT_ONSETS), misprinted(PRINTED_ONSETS)), (vec![], vec![3, 5]));
    let wrong = solve_square(&PRINTED, &onsets(&TRUTH));
    let [d01, d12, d13, d02, d23, d03] = TRUTH;
    let expected = [d01, d12 + d02 - d23, d13, d23, d02, d03];
    assert!(wrong.iter().zip(expected).all(|(wrong, expected)| (wrong - expected).abs() < 1e-9), "{wrong:?}");
}

/// Some pattern of onsets among `count` patches, some twice or both ways, each missing with this chance: lengths that
/// agree, with variances of their own.
fn pattern(
    rng: &mut ChaCha8Rng,
    count: PatchId,
    missing: f64,
) -> (Vec<(PatchId, Length)>, Vec<((PatchId, PatchId), Length)>) {
    let length = |rng: &mut ChaCha8Rng| Length {
        length_m: rng.random_range(4.0..4.0001),
        variance_m2: rng.random_range(1e-6..4e-6),
    };
    let (mut first, mut second) = (Vec::new(), Vec::new());
    for i in 1..=count {
        for _ in 0..2 {
            if !rng.random_bool(missing) {
                first.push((i, length(rng)));
            }
        }
        for j in (1..=count).filter(|j| *j != i) {
            if !rng.random_bool(missing) {
                second.push(((i, j), length(rng)));
            }
        }
    }
    (first, second)
}

/// All covariances that are claimed, variances on the diagonal.
fn claimed(outcome: &Distances) -> Mat<f64> {
    let size = outcome.distances.len();
    let mut claimed = Mat::from_fn(size, size, |i, j| if i == j { outcome.distances[i].variance_m2 } else { 0.0 });
    for &(i, j, value) in &outcome.covariances {
        (claimed[(i, j)], claimed[(j, i)]) = (value, value);
    }
    claimed
}

#[test]
fn covariances_are_those_of_many_draws() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (first, second) = pattern(&mut rng, 6, 0.3);
    let exact = invert(&first, &second);
    let (size, claimed, draws) = (exact.distances.len(), claimed(&exact), 20_000);
    let mut drawn: Mat<f64> = Mat::zeros(size, size);
    for _ in 0..draws {
        let mut noisy = |length: &Length| {
            let z: f64 = StandardNormal.sample(&mut rng);
            Length { length_m: length.length_m + z * length.variance_m2.sqrt(), ..*length }
        };
        let first: Vec<_> = first.iter().map(|(patch, length)| (*patch, noisy(length))).collect();
        let second: Vec<_> = second.iter().map(|(pair, length)| (*pair, noisy(length))).collect();
        let noisy = invert(&first, &second);
        let error = |k: usize| noisy.distances[k].distance_m - exact.distances[k].distance_m;
        let errors: Vec<f64> = (0..size).map(error).collect();
        for (i, j) in (0..size).flat_map(|i| (0..size).map(move |j| (i, j))) {
            drawn[(i, j)] += errors[i] * errors[j] / f64::from(draws);
        }
    }
    assert!(size > 15 && exact.covariances.len() > size, "{size} distances");
    for (i, j) in (0..size).flat_map(|i| (0..size).map(move |j| (i, j))) {
        // Standard deviation of a covariance estimated from `draws` draws.
        let sd = ((claimed[(i, i)] * claimed[(j, j)] + claimed[(i, j)].powi(2)) / f64::from(draws)).sqrt();
        let (drawn, claimed) = (drawn[(i, j)], claimed[(i, j)]);
        assert!((drawn - claimed).abs() < 5.0 * sd, "{i} {j}: drawn {drawn} claimed {claimed}");
    }
}

#[test]
fn a_common_delay_cancels_between_patches_and_reciprocal_onsets_are_averaged() {
    let delay = 0.0375 * 2.0;
    let o = onsets(&TRUTH).map(|o| o + delay);
    let outcome = values(&closed(&o, 1e-6));
    assert!((outcome[1] - TRUTH[1]).abs() < 1e-12 && (outcome[0] - TRUTH[0] - delay / 2.0).abs() < 1e-12);
    let length = |length_m: f64, variance_m2: f64| Length { length_m, variance_m2 };
    let first = [(1, length(2.0, 1e-6)), (2, length(2.0, 1e-6))];
    let both = invert(&first, &[((1, 2), length(3.0, 1e-6)), ((2, 1), length(3.003, 2e-6))]);
    let pair = both.distances.last().unwrap();
    assert!((pair.distance_m - 1.001).abs() < 1e-12 && both.disagreeing.is_empty() && pair.onsets == 4);
    let apart = invert(&first, &[((1, 2), length(3.0, 1e-6)), ((2, 1), length(3.1, 1e-6))]);
    assert_eq!(apart.disagreeing.len(), 1);
    assert!(apart.distances.last().unwrap().variance_m2 > 0.1 * 0.1);
    let lonely = invert(&first[..1], &[((1, 2), length(3.0, 1e-6))]);
    assert_eq!((lonely.skipped, lonely.distances.len()), (vec![(1, 2)], 1));
}

/// Two to eight patches, all onsets or some: the weighted least-squares solution of the rows of T2 that are there,
/// solved densely.
#[test]
fn any_pattern_of_onsets_gives_the_weighted_least_squares_solution_and_its_covariance() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for (count, missing) in (2..=8).flat_map(|count| [0.0, 0.2, 0.5, 0.7].map(|missing| (count, missing))) {
        let (first, second) = pattern(&mut rng, count, missing);
        let outcome = invert(&first, &second);
        let column = |a: PatchId, b: PatchId| outcome.distances.iter().position(|d| (d.a, d.b) == (a.min(b), a.max(b)));
        // Rows of T2: coefficients by distance, right-hand side.
        let mut rows: Vec<(Vec<(usize, f64)>, Length)> =
            first.iter().map(|(i, length)| (vec![(column(0, *i).unwrap(), 2.0)], *length)).collect();
        for ((i, j), length) in &second {
            let Some(across) = column(*i, *j) else {
                assert!(outcome.skipped.contains(&(*i.min(j), *i.max(j))));
                assert!(column(0, *i).is_none() || column(0, *j).is_none());
                continue;
            };
            rows.push((vec![(column(0, *i).unwrap(), 1.0), (across, 1.0), (column(0, *j).unwrap(), 1.0)], *length));
        }
        let size = outcome.distances.len();
        if missing == 0.0 {
            assert_eq!(size as PatchId, count * (count + 1) / 2);
        }
        if size == 0 {
            continue;
        }
        let (mut normal, mut right) = (Mat::zeros(size, size), vec![0.0; size]);
        for (row, length) in &rows {
            for (i, a) in row {
                right[*i] += a * length.length_m / length.variance_m2;
                for (j, b) in row {
                    normal[(*i, *j)] += a * b / length.variance_m2;
                }
            }
        }
        let (solution, covariance) = (dense::solve(&normal, &right).unwrap(), dense::inverse(&normal).unwrap());
        let claimed = claimed(&outcome);
        for i in 0..size {
            assert!((outcome.distances[i].distance_m - solution[i]).abs() < 1e-9);
            for j in 0..size {
                assert!((claimed[(i, j)] - covariance[(i, j)]).abs() < 1e-12, "{i} {j}");
            }
        }
    }
}

#[test]
fn lengths_are_those_that_the_distances_were_made_of() {
    let o = onsets(&TRUTH);
    let distances = closed(&o, 1e-6);
    let (first, second) = lengths(&distances.distances);
    let expected = [(1, o[0]), (2, o[3]), (3, o[5])];
    for ((patch, length), (expected_patch, expected_m)) in first.iter().zip(expected) {
        assert!(*patch == expected_patch && (length.length_m - expected_m).abs() < 1e-12);
        assert!((length.variance_m2 - 1e-6).abs() < 1e-15);
    }
    let expected = [((1, 2), o[1]), ((1, 3), o[2]), ((2, 3), o[4])];
    for ((pair, length), (expected_pair, expected_m)) in second.iter().zip(expected) {
        assert!(*pair == expected_pair && (length.length_m - expected_m).abs() < 1e-12);
        assert!((length.variance_m2 - 1e-6).abs() < 1e-15);
    }
    // Not from T2: too sure for its first bounces.
    let mut sure = distances.distances;
    sure[4].variance_m2 = 1e-8;
    assert_eq!(lengths(&sure).1[1].1.variance_m2, 1e-8);
}
