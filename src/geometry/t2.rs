//! Distances from first and second onsets: the inverse of the paper's distance transform T2 (section 4.1), in closed form.
//!
//! With source and camera in one point, c `O_i` = 2 `d_0i` and c `O_ij` = `d_0i` + `d_ij` + `d_0j`, hence
//!
//! ```text
//! d_0i = c O_i / 2        d_ij = c (O_ij - (O_i + O_j) / 2)
//! ```
//!
//! T2 is square: once reciprocal onsets are averaged, this is also the weighted least-squares solution. A delay common to all onsets
//! cancels in every `d_ij` and stays in `d_0i`. The matrix that the paper prints has its fourth row wrong (it says 2 `d_23` for `O_2`); so are the
//! labels `O_1^2` and `O_1^3` of its right-hand side. A distance may come out negative or against the triangle inequality; it is kept, since
//! clipping would bias what follows.
//!
//! Any pattern of onsets will do: `d_0i` needs `O_i`, `d_ij` needs `O_ij` (or `O_ji`), `O_i` and `O_j`. Nothing else gives them: as many unknowns as onsets
//! are left, so a pair without one of its first bounces is skipped here, and a fit to coordinates ([`super::maximum_likelihood`]) still uses it.
//! Distances with variances and covariances hold all that the onsets said; [`lengths`] takes them back.
//!
//! With source and sensor apart, c `O_i` = `|s - p_i| + |p_i - k|` is a sum that no first bounce takes apart, and T2 does not close: what is known are
//! path lengths, an ellipsoid a patch, and they go to the fit as they are.

use std::collections::BTreeMap;

use crate::units::PatchId;

/// Reciprocal onsets further apart than this many standard deviations are not the same path.
pub const RECIPROCITY_SIGMA: f64 = 4.0;

/// A measured path length with its variance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Length {
    /// Length.
    pub length_m: f64,
    /// Variance.
    pub variance_m2: f64,
}

/// Distance of two patches; `a` < `b`, patch 0 is source and camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distance {
    /// Smaller patch.
    pub a: PatchId,
    /// Larger patch.
    pub b: PatchId,
    /// Distance.
    pub distance_m: f64,
    /// Variance.
    pub variance_m2: f64,
    /// Bounces of the path that gave it.
    pub bounces: i32,
    /// Onsets that went into it.
    pub onsets: i32,
}

/// What T2 gives.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Distances {
    /// Distances, sorted by patches.
    pub distances: Vec<Distance>,
    /// Covariances between distances (positions in `distances`, first before second) that share an onset.
    pub covariances: Vec<(usize, usize, f64)>,
    /// Pairs whose second onset has no first onsets to go with it.
    pub skipped: Vec<(PatchId, PatchId)>,
    /// Pairs whose reciprocal onsets disagree, and by how many standard deviations; their variance covers the disagreement.
    pub disagreeing: Vec<(PatchId, PatchId, f64)>,
}

/// Inverse-variance mean of measurements of one length, and the largest deviation of two of them in standard deviations. When they disagree beyond
/// [`RECIPROCITY_SIGMA`], the variance of the mean is raised to the disagreement's square.
fn mean(lengths: &[Length]) -> (Length, f64) {
    let weight: f64 = lengths.iter().map(|length| 1.0 / length.variance_m2).sum();
    let length_m = lengths.iter().map(|length| length.length_m / length.variance_m2).sum::<f64>() / weight;
    let pairs = lengths.iter().enumerate().flat_map(|(i, a)| lengths[i + 1..].iter().map(move |b| (a, b)));
    let (mut worst, mut gap_m) = (0.0_f64, 0.0_f64);
    for (a, b) in pairs {
        let gap = (a.length_m - b.length_m).abs();
        worst = worst.max(gap / (a.variance_m2 + b.variance_m2).sqrt());
        gap_m = gap_m.max(gap);
    }
    let variance_m2 = if worst > RECIPROCITY_SIGMA { (1.0 / weight).max(gap_m * gap_m) } else { 1.0 / weight };
    (Length { length_m, variance_m2 }, worst)
}

/// Inverts T2 for any pattern of measured and missing onsets. `first` are lengths c `O_i` by patch, `second` are lengths c `O_ij` by (lit, seen).
/// Several measurements of one length are averaged, reciprocal ones included.
#[must_use]
pub fn invert(first: &[(PatchId, Length)], second: &[((PatchId, PatchId), Length)]) -> Distances {
    let mut onsets: BTreeMap<PatchId, Vec<Length>> = BTreeMap::new();
    for (patch, length) in first {
        onsets.entry(*patch).or_default().push(*length);
    }
    let mut pairs: BTreeMap<(PatchId, PatchId), Vec<Length>> = BTreeMap::new();
    for ((lit, seen), length) in second {
        pairs.entry((*lit.min(seen), *lit.max(seen))).or_default().push(*length);
    }
    let mut result = Distances::default();
    let first: BTreeMap<PatchId, Length> = onsets.iter().map(|(patch, lengths)| (*patch, mean(lengths).0)).collect();
    for (patch, Length { length_m, variance_m2 }) in &first {
        let onsets = onsets[patch].len() as i32;
        result.distances.push(Distance {
            a: 0,
            b: *patch,
            distance_m: length_m / 2.0,
            variance_m2: variance_m2 / 4.0,
            bounces: 1,
            onsets,
        });
    }
    for ((a, b), lengths) in &pairs {
        let (Some(i), Some(j)) = (first.get(a), first.get(b)) else {
            result.skipped.push((*a, *b));
            continue;
        };
        let (length, deviation) = mean(lengths);
        if deviation > RECIPROCITY_SIGMA {
            result.disagreeing.push((*a, *b, deviation));
        }
        result.distances.push(Distance {
            a: *a,
            b: *b,
            distance_m: length.length_m - (i.length_m + j.length_m) / 2.0,
            variance_m2: length.variance_m2 + (i.variance_m2 + j.variance_m2) / 4.0,
            bounces: 2,
            onsets: lengths.len() as i32 + 2,
        });
    }
    result.covariances = covariances(&result.distances, &first);
    result
}

/// T2 itself: path lengths of first bounces, and of second bounces with both their first, that distances from [`invert`] were made of. A second bounce's variance
/// is what its distance's has beyond the first bounces'; where that is nothing, since the distance was not made by T2, it is the distance's.
#[must_use]
pub fn lengths(distances: &[Distance]) -> (Vec<(PatchId, Length)>, Vec<((PatchId, PatchId), Length)>) {
    let to_p0 = distances.iter().filter(|distance| distance.a == 0);
    let ranges: BTreeMap<PatchId, Length> =
        to_p0.map(|d| (d.b, Length { length_m: d.distance_m, variance_m2: d.variance_m2 })).collect();
    let twice = |range: &Length| Length { length_m: 2.0 * range.length_m, variance_m2: 4.0 * range.variance_m2 };
    let first = ranges.iter().map(|(patch, range)| (*patch, twice(range))).collect();
    let path = |distance: &Distance| {
        let (i, j) = (ranges.get(&distance.a)?, ranges.get(&distance.b)?);
        let own = distance.variance_m2 - i.variance_m2 - j.variance_m2;
        // What rounding leaves of a difference is not a variance.
        let variance_m2 = if own > 1e-9 * distance.variance_m2 { own } else { distance.variance_m2 };
        let length_m = distance.distance_m + i.length_m + j.length_m;
        Some(((distance.a, distance.b), Length { length_m, variance_m2 }))
    };
    (first, distances.iter().filter_map(path).collect())
}

/// Distances that share the first onset `O_i`: `d_0i` enters with weight 1/2, every `d_ij` with -1/2.
fn covariances(distances: &[Distance], first: &BTreeMap<PatchId, Length>) -> Vec<(usize, usize, f64)> {
    let mut users: BTreeMap<PatchId, Vec<(usize, f64)>> = BTreeMap::new();
    for (n, distance) in distances.iter().enumerate() {
        if distance.bounces == 1 {
            users.entry(distance.b).or_default().push((n, 0.5));
        } else {
            users.entry(distance.a).or_default().push((n, -0.5));
            users.entry(distance.b).or_default().push((n, -0.5));
        }
    }
    let mut covariances = BTreeMap::new();
    for (patch, users) in users {
        for (k, (n, weight)) in users.iter().enumerate() {
            for (m, other) in &users[k + 1..] {
                *covariances.entry((*n.min(m), *n.max(m))).or_insert(0.0) += weight * other * first[&patch].variance_m2;
            }
        }
    }
    covariances.into_iter().map(|((n, m), covariance)| (n, m, covariance)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::dense;
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
    /// Row four as the paper prints it: twice `d_23` for the first bounce of patch 2.
    const PRINTED_ROW_4: [f64; 6] = [0.0, 0.0, 0.0, 0.0, 2.0, 0.0];
    const TRUTH: [f64; 6] = [1.9, 0.8, 1.1, 2.3, 0.7, 2.6];

    fn solve_square(rows: &[[f64; 6]; 6], right: &[f64]) -> Vec<f64> {
        // Normal equations: small and well-conditioned enough for a reference.
        let matrix = Mat::from_fn(6, 6, |i, j| (0..6).map(|k| rows[k][i] * rows[k][j]).sum());
        let right: Vec<f64> = (0..6).map(|i| (0..6).map(|k| rows[k][i] * right[k]).sum()).collect();
        dense::solve(&matrix, &right).unwrap()
    }

    fn onsets(d: &[f64; 6]) -> [f64; 6] {
        std::array::from_fn(|i| (0..6).map(|j| RIGHT[i][j] * d[j]).sum())
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
        [(0, 1), (1, 2), (1, 3), (0, 2), (2, 3), (0, 3)]
            .map(|(a, b)| distances.distances.iter().find(|d| (d.a, d.b) == (a, b)).unwrap().distance_m)
    }

    #[test]
    fn the_closed_form_is_the_solution_of_t2_and_the_printed_matrix_is_not() {
        let o = onsets(&TRUTH);
        let solved = solve_square(&RIGHT, &o);
        let found = values(&closed(&o, 1e-6));
        for k in 0..6 {
            assert!((solved[k] - TRUTH[k]).abs() < 1e-9 && (found[k] - TRUTH[k]).abs() < 1e-12);
        }
        let mut printed = RIGHT;
        printed[3] = PRINTED_ROW_4;
        let wrong = solve_square(&printed, &o);
        let worst = (0..6).map(|k| (wrong[k] - TRUTH[k]).abs()).fold(0.0, f64::max);
        assert!(worst > 0.1, "the misprint should matter: {wrong:?}");
    }

    #[test]
    fn covariances_are_those_of_many_draws() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let (sd, draws) = (0.01, 40_000);
        let o = onsets(&TRUTH);
        let claimed = closed(&o, sd * sd);
        let mut squares = vec![vec![0.0; 6]; 6];
        for _ in 0..draws {
            let noisy: Vec<f64> = o
                .iter()
                .map(|o| {
                    let z: f64 = StandardNormal.sample(&mut rng);
                    o + sd * z
                })
                .collect();
            let drawn = closed(&noisy, sd * sd);
            let errors: Vec<f64> =
                drawn.distances.iter().zip(&claimed.distances).map(|(a, b)| a.distance_m - b.distance_m).collect();
            for i in 0..6 {
                for j in 0..6 {
                    squares[i][j] += errors[i] * errors[j] / f64::from(draws);
                }
            }
        }
        for i in 0..6 {
            for j in i..6 {
                let claim = if i == j {
                    claimed.distances[i].variance_m2
                } else {
                    claimed.covariances.iter().find(|(a, b, _)| (*a, *b) == (i, j)).map_or(0.0, |c| c.2)
                };
                assert!(
                    (squares[i][j] - claim).abs() < 0.03 * sd * sd,
                    "{i} {j}: drawn {} claimed {claim}",
                    squares[i][j]
                );
            }
        }
    }

    #[test]
    fn a_common_delay_cancels_between_patches_and_reciprocal_onsets_are_averaged() {
        let delay = 0.0375 * 2.0;
        let o = onsets(&TRUTH).map(|o| o + delay);
        let found = values(&closed(&o, 1e-6));
        assert!((found[1] - TRUTH[1]).abs() < 1e-12 && (found[0] - TRUTH[0] - delay / 2.0).abs() < 1e-12);
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

    /// Any pattern of onsets, some of them twice or both ways: the weighted least-squares solution of the rows of T2 that are there.
    #[test]
    fn any_pattern_of_onsets_gives_the_weighted_least_squares_solution_and_its_covariance() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for _ in 0..30 {
            let length = |rng: &mut ChaCha8Rng| Length {
                length_m: rng.random_range(4.0..4.0001),
                variance_m2: rng.random_range(1e-6..4e-6),
            };
            let (mut first, mut second) = (Vec::new(), Vec::new());
            for i in 1..=5 {
                for _ in 0..rng.random_range(0..3) {
                    first.push((i, length(&mut rng)));
                }
                for j in (1..=5).filter(|j| *j != i) {
                    if rng.random_bool(0.5) {
                        second.push(((i, j), length(&mut rng)));
                    }
                }
            }
            let found = invert(&first, &second);
            let column =
                |a: PatchId, b: PatchId| found.distances.iter().position(|d| (d.a, d.b) == (a.min(b), a.max(b)));
            // Rows of T2: coefficients by distance, right-hand side.
            let mut rows: Vec<(Vec<(usize, f64)>, Length)> =
                first.iter().map(|(i, length)| (vec![(column(0, *i).unwrap(), 2.0)], *length)).collect();
            for ((i, j), length) in &second {
                let Some(across) = column(*i, *j) else {
                    assert!(found.skipped.contains(&(*i.min(j), *i.max(j))));
                    assert!(column(0, *i).is_none() || column(0, *j).is_none());
                    continue;
                };
                rows.push((vec![(column(0, *i).unwrap(), 1.0), (across, 1.0), (column(0, *j).unwrap(), 1.0)], *length));
            }
            let size = found.distances.len();
            let (mut normal, mut right) = (Mat::zeros(size, size), vec![0.0; size]);
            for (row, length) in &rows {
                for (i, a) in row {
                    right[*i] += a * length.length_m / length.variance_m2;
                    for (j, b) in row {
                        normal[(*i, *j)] += a * b / length.variance_m2;
                    }
                }
            }
            if size == 0 {
                continue;
            }
            let (solution, covariance) = (dense::solve(&normal, &right).unwrap(), dense::inverse(&normal).unwrap());
            let mut claimed =
                Mat::from_fn(size, size, |i, j| if i == j { found.distances[i].variance_m2 } else { 0.0 });
            for &(i, j, value) in &found.covariances {
                (claimed[(i, j)], claimed[(j, i)]) = (value, value);
            }
            for i in 0..size {
                assert!((found.distances[i].distance_m - solution[i]).abs() < 1e-9);
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
}
