//! Patches in place, and which of their alternatives all onsets support.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Matrix3, Vector3};

use crate::cancel::Cancel;
use crate::geometry::Point;
use crate::geometry::footprint::Footprints;
use crate::geometry::labelling::{Comparison, Options, Scene, SensorProfiles};
use crate::priors::{covariances, scenes};
use crate::stages::stage::StageError;
use crate::tables::{Patch, PatchCovariance, SceneOdds};
use crate::units::PatchId;

/// Most alternatives that are compared, the likeliest first.
const COMPARED: usize = 32;
/// An alternative whose log-likelihood is higher by less is no better.
const BETTER: f64 = 1e-6;

/// Patches as they were given, with what shapes paths over them.
#[derive(Clone)]
pub(super) struct PlacedPatches {
    pub(super) rows: Vec<Patch>,
    pub(super) between: Vec<PatchCovariance>,
    pub(super) footprints: Footprints,
    pub(super) normals: BTreeMap<PatchId, Vector3<f64>>,
}

impl PlacedPatches {
    /// With the best places.
    pub(super) fn scene(&self) -> Scene {
        let best = self.between.iter().filter(|row| row.alternative == 0);
        let between_m2 = best.map(|row| ((row.a, row.b), covariances::between(row))).collect();
        Scene::new(&best_places(&self.rows), &between_m2, self.footprints.clone(), self.normals.clone())
    }

    /// The scene that explains the arrivals best, and what the alternatives are against it. Alternatives are taken one
    /// by one, each time the one that helps most: those of different patches are independent choices.
    pub(super) fn likeliest(
        &self,
        sensors: &[SensorProfiles],
        options: &Options,
        cancel: &Cancel,
    ) -> (Scene, Vec<SceneOdds>) {
        let (mut chosen, mut scene) = (self.clone(), self.scene());
        let mut left = self.alternatives();
        if left.is_empty() {
            return (scene, Vec::new());
        }
        let comparison = Comparison::new(sensors, &scene, options, cancel);
        let mut best = comparison.log_likelihood(&scene);
        let mut taken: Vec<i32> = Vec::new();
        loop {
            let odds = |&number: &i32| comparison.log_likelihood(&chosen.with(number).scene()) - best;
            let of_left: Vec<(i32, f64)> = left.iter().map(|number| (*number, odds(number))).collect();
            let likeliest = of_left.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1));
            if let Some((number, more)) = likeliest.filter(|(_, more)| *more > BETTER) {
                (chosen, best) = (chosen.with(number), best + more);
                scene = chosen.scene();
                left.retain(|other| *other != number);
                taken.push(number);
                continue;
            }
            let of_taken = taken.iter().map(|number| (*number, true, odds(number)));
            let of_left = of_left.into_iter().map(|(number, log_likelihood)| (number, false, log_likelihood));
            let row = |(alternative, taken, log_likelihood)| {
                let patches = scenes::moved(&self.rows, alternative).into_iter().collect();
                SceneOdds { alternative, patches, taken, log_likelihood }
            };
            return (scene, of_taken.chain(of_left).map(row).collect());
        }
    }

    /// Numbers of alternatives whose places have a covariance, the likeliest first.
    fn alternatives(&self) -> Vec<i32> {
        let best: BTreeSet<PatchId> = scenes::moved(&self.rows, 0);
        let mut numbers: BTreeMap<i32, f64> = BTreeMap::new();
        for row in self.rows.iter().filter(|row| row.alternative > 0) {
            numbers.entry(row.alternative).or_insert(row.log_likelihood.unwrap_or(0.0));
        }
        for row in self.rows.iter().filter(|row| covariances::of_patch(row).is_none() || !best.contains(&row.patch)) {
            numbers.remove(&row.alternative);
        }
        let mut numbers: Vec<(i32, f64)> = numbers.into_iter().collect();
        numbers.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        numbers.into_iter().take(COMPARED).map(|(number, _)| number).collect()
    }

    /// With an alternative in place of the best.
    fn with(&self, alternative: i32) -> Self {
        let mut other = self.clone();
        scenes::exchange(&mut other.rows, &mut other.between, alternative);
        other
    }
}

/// The same, refused where no patch has a covariance.
pub(super) fn places(rows: &[Patch]) -> Result<BTreeMap<PatchId, (Point, Matrix3<f64>)>, StageError> {
    let places = best_places(rows);
    if places.is_empty() {
        let text = "with patches: no patch has a covariance, so its onsets cannot be weighted: these are start values (give patches from `refine`), or too few pairs determine them (`rejects` has the missing ones)";
        return Err(StageError::Refused(text.to_owned()));
    }
    Ok(places)
}

/// Places of the best alternative, with their covariances.
fn best_places(rows: &[Patch]) -> BTreeMap<PatchId, (Point, Matrix3<f64>)> {
    let place = |row: &Patch| {
        let covariance_m2 = covariances::of_patch(row)?;
        Some((row.patch, (Point::new(row.x_m, row.y_m, row.z_m), covariance_m2)))
    };
    rows.iter().filter(|row| row.alternative == 0).filter_map(place).collect()
}
