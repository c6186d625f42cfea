//! The plan of a measurement: a scene, which bounces its geometry uses, and what these can show.

use serde_json::{Value, json};

use super::Use;
use super::outlook::{Change, Outlook};
use crate::campaign::keys::PatchRole;
use crate::simulate::{Scene, SimulateError};

/// A scene with its outlook.
pub struct Design {
    /// The scene; light is followed over one order of bounces more than the geometry uses.
    pub scene: Scene,
    /// Highest order of bounces that the geometry uses.
    pub bounces: usize,
    /// Signal-to-noise ratio from which a pulse counts as an onset.
    pub threshold_sigma: f64,
    /// What it can show.
    pub outlook: Outlook,
}

impl Design {
    /// Bounces up to this order, 1 to 5; by default 2, or 3 where the scene has hidden patches.
    ///
    /// # Errors
    /// When the first light of a capture arrives outside the record.
    ///
    /// # Panics
    /// If the order is another, or the threshold is not positive.
    pub fn new(mut scene: Scene, bounces: Option<usize>, threshold_sigma: f64) -> Result<Self, SimulateError> {
        let bounces = bounces.unwrap_or_else(|| usual_bounces(&scene));
        assert!((1..=5).contains(&bounces) && threshold_sigma > 0.0, "bounces 1 to 5, and a positive threshold");
        // One order more than the geometry uses shows which pulses are too weak, and which blend.
        scene.captures.bounces = scene.captures.bounces.max(bounces).max(3);
        let outlook = Outlook::new(&scene, Use { bounces, threshold_sigma })?;
        Ok(Self { scene, bounces, threshold_sigma, outlook })
    }

    /// What `design --format json` prints.
    #[must_use]
    pub fn object(&self) -> Value {
        let Self { scene, outlook, .. } = self;
        let change = |row: &Change| json!({"change": row.what, "visible_sd_m": row.visible_m, "hidden_sd_m": row.hidden_m, "onsets": row.onsets, "hours": row.hours});
        json!({
            "scene": scene.name,
            "snr_was_set": scene.instrument.snr.is_some(),
            "pulses": outlook.pulses,
            "hours": outlook.hours,
            "patches": outlook.patches.iter().map(|row| json!({
                "patch": row.patch, "kind": row.kind, "sd_m": row.sd_m, "covariance_m2": row.covariance_m2,
                "chance": row.chance, "onsets": row.onsets, "snr_strongest": row.snr,
                "shots_strongest": finite(row.shots), "hours_strongest": finite(row.hours),
            })).collect::<Vec<_>>(),
            "bounces": outlook.orders.iter().map(|row| json!({
                "order": row.bounces, "paths": row.paths, "found": row.onsets, "snr_least": row.snr[0],
                "snr_median": row.snr[1], "snr_most": row.snr[2], "shots_median": finite(row.shots[0]),
                "shots_strongest": finite(row.shots[1]), "hours_median": finite(row.hours[0]),
                "hours_strongest": finite(row.hours[1]),
            })).collect::<Vec<_>>(),
            "blends": outlook.blends.iter().map(|row| json!({
                "sensor": row.sensor, "lit": row.lit, "seen": row.seen, "paths": row.paths, "apart_ps": row.apart_ps,
            })).collect::<Vec<_>>(),
            "ambiguities": outlook.ambiguities,
            "changes": outlook.changes.iter().map(change).collect::<Vec<_>>(),
        })
    }
}

fn usual_bounces(scene: &Scene) -> usize {
    let has_hidden = scene.patches.values().any(|disk| disk.role == PatchRole::Hidden);
    if has_hidden { 3 } else { 2 }
}

/// JSON has no infinity: a value that no number of shots reaches becomes null.
fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}
