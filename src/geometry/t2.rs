//! Distances from first and second onsets: the inverse of the paper's distance transform T2 (section 4.1), in closed
//! form.
//!
//! With source and camera in one point, c `O_i` = 2 `d_0i` and c `O_ij` = `d_0i` + `d_ij` + `d_0j`, hence
//!
//! ```text
//! d_0i = c O_i / 2        d_ij = c (O_ij - (O_i + O_j) / 2)
//! ```
//!
//! T2 is square: once reciprocal onsets are averaged, this is also the weighted least-squares solution. A delay common
//! to all onsets cancels in every `d_ij` and stays in `d_0i`. The matrix that the paper prints has its fourth row wrong
//! (2 `d_23` for `O_2`). That swaps `d_02` and `d_23` and puts `d_12` off by their difference. The labels `O_1^2` and
//! `O_1^3` of its right-hand side must read `O_2^1` and `O_3^1`. A distance may come out negative or against the
//! triangle inequality; it is kept, since clipping would bias what follows.
//!
//! Any pattern of onsets will do: `d_0i` needs `O_i`, `d_ij` needs `O_ij` (or `O_ji`), `O_i` and `O_j`. Nothing else
//! gives them, as there are as many unknowns as onsets. A pair without one of its first bounces is skipped here; a fit
//! to coordinates ([`super::maximum_likelihood`]) still uses it. Distances with variances and covariances hold all the
//! information of the onsets; [`lengths`] takes them back.
//!
//! With source and sensor apart, c `O_i` = `|s - p_i| + |p_i - k|` is a sum that no first bounce takes apart, and T2
//! does not close: what is known are path lengths, an ellipsoid a patch, and they go to the fit as they are.

use std::collections::BTreeMap;

use crate::units::PatchId;

/// Reciprocal onsets further apart than this many standard deviations are not the same path: 1 in 16,000 of equal paths
/// lies beyond.
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
    /// Pairs whose reciprocal onsets disagree, and by how many standard deviations; their variance covers the
    /// disagreement.
    pub disagreeing: Vec<(PatchId, PatchId, f64)>,
}

impl Distances {
    /// The distance of two patches, in either order.
    #[must_use]
    pub fn between(&self, a: PatchId, b: PatchId) -> Option<&Distance> {
        let pair = (a.min(b), a.max(b));
        let place = self.distances.binary_search_by_key(&pair, |distance| (distance.a, distance.b));
        place.ok().map(|n| &self.distances[n])
    }
}

/// Inverse-variance mean of measurements of one length, and the largest deviation of two of them in standard
/// deviations. When they disagree beyond
/// [`RECIPROCITY_SIGMA`], the variance of the mean is raised to the disagreement's square.
#[must_use]
pub fn mean(lengths: &[Length]) -> (Length, f64) {
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

/// Inverts T2 for any pattern of measured and missing onsets. `first` are lengths c `O_i` by patch, `second` are
/// lengths c `O_ij` by (lit, seen). Several measurements of one length are averaged, reciprocal ones included.
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

/// T2 itself: path lengths of first bounces, and of second bounces with both their first, that distances from
/// [`invert`] were made of. A second bounce's variance is what its distance's has beyond the first bounces'; where that
/// is nothing, since the distance was not made by T2, it is the distance's.
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
mod tests;
