//! Alternatives of `patches`: which of them is in place, and how likely each place is.

use std::collections::{BTreeMap, BTreeSet};

use crate::tables::{Patch, PatchCovariance, SceneOdds};
use crate::units::PatchId;

/// Patches as `label` placed them: the alternatives that it took become the best places, and these the alternatives.
pub fn taken(mut rows: Vec<Patch>, scenes: &[SceneOdds]) -> Vec<Patch> {
    scenes.iter().filter(|scene| scene.taken).for_each(|scene| exchange(&mut rows, &mut [], scene.alternative));
    rows
}

/// Exchanges the places of an alternative with the best ones of the same patches, and their covariances.
pub fn exchange(rows: &mut [Patch], between: &mut [PatchCovariance], alternative: i32) {
    let moved = moved(rows, alternative);
    let exchanged = |number: i32| match number {
        0 => alternative,
        number if number == alternative => 0,
        number => number,
    };
    for row in rows.iter_mut().filter(|row| moved.contains(&row.patch)) {
        row.alternative = exchanged(row.alternative);
    }
    for row in between.iter_mut().filter(|row| moved.contains(&row.a) || moved.contains(&row.b)) {
        row.alternative = exchanged(row.alternative);
    }
}

/// Patches that an alternative moves.
pub fn moved(rows: &[Patch], alternative: i32) -> BTreeSet<PatchId> {
    rows.iter().filter(|row| row.alternative == alternative).map(|row| row.patch).collect()
}

/// Fills in the share of the likelihood that each place has among those of its patch.
pub fn share_likelihood(rows: &mut [Patch]) {
    let mut largest = BTreeMap::<PatchId, f64>::new();
    for row in rows.iter() {
        if let Some(log_likelihood) = row.log_likelihood {
            let most = largest.entry(row.patch).or_insert(log_likelihood);
            *most = most.max(log_likelihood);
        }
    }
    let weight = |row: &Patch| Some((row.log_likelihood? - largest[&row.patch]).exp());
    let mut totals = BTreeMap::<PatchId, f64>::new();
    for row in rows.iter() {
        *totals.entry(row.patch).or_default() += weight(row).unwrap_or(0.0);
    }
    let shares: Vec<Option<f64>> = rows.iter().map(|row| Some(weight(row)? / totals[&row.patch])).collect();
    rows.iter_mut().zip(shares).for_each(|(row, share)| row.probability = share);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point;
    use crate::priors::covariances;

    fn row(patch: PatchId, alternative: i32, x_m: f64, log_likelihood: f64) -> Patch {
        let row = covariances::patch_row(patch, "visible", Point::new(x_m, 0.0, 0.0), None);
        Patch { alternative, log_likelihood: Some(log_likelihood), ..row }
    }

    #[test]
    fn a_taken_alternative_and_the_best_place_exchange_their_numbers() {
        let scene = SceneOdds { alternative: 2, patches: vec![5], taken: true, log_likelihood: -9.0 };
        let rows = vec![row(4, 0, 1.0, 0.0), row(5, 0, 2.0, 0.0), row(5, 1, 3.0, 0.0), row(5, 2, 4.0, 0.0)];
        let rows = taken(rows, &[scene]);
        let numbers: Vec<(f64, i32)> = rows.iter().map(|row| (row.x_m, row.alternative)).collect();
        assert_eq!(numbers, [(1.0, 0), (2.0, 2), (3.0, 1), (4.0, 0)]);
    }

    #[test]
    fn places_of_one_patch_share_its_probability() {
        let mut rows = vec![row(4, 0, 1.0, -7.0), row(5, 0, 2.0, -7.0), row(5, 1, 3.0, -7.0 - 3.0_f64.ln())];
        share_likelihood(&mut rows);
        let shares: Vec<f64> = rows.iter().map(|row| row.probability.expect("each has a likelihood")).collect();
        assert!((shares[0] - 1.0).abs() < 1e-12 && (shares[1] - 0.75).abs() < 1e-12, "{shares:?}");
        assert!((shares[2] - 0.25).abs() < 1e-12, "{shares:?}");
    }
}
