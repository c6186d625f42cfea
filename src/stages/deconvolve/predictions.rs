//! Light that the table `predictions` has for each profile.

use std::collections::BTreeMap;

use crate::priors::flight_profile::FlightProfile;
use crate::signal::sparse;
use crate::tables::{Name, Prediction, Profile};
use crate::units::PatchId;

/// Of each profile: campaign, sensor, lit, seen, vertical range.
type Key = (Name, Name, PatchId, PatchId, Option<Name>);

/// Rows of the table, by profile.
pub struct Predictions(BTreeMap<Key, Vec<sparse::Prediction>>);

impl Predictions {
    pub fn new(rows: Vec<Prediction>) -> Self {
        let mut of_profiles = BTreeMap::<Key, Vec<sparse::Prediction>>::new();
        for row in rows {
            let pulse = sparse::Prediction {
                time_ps: row.time_ps,
                time_sd_ps: row.time_sd_ps,
                width_ps: row.width_ps,
                width_sd_ps: row.width_sd_ps.unwrap_or(f64::INFINITY),
            };
            of_profiles.entry((row.campaign, row.sensor, row.lit, row.seen, row.range)).or_default().push(pulse);
        }
        Self(of_profiles)
    }

    /// Those of a profile, in its period.
    pub fn of(&self, profile: &Profile, flight: &FlightProfile, period_ps: Option<f64>) -> Vec<sparse::Prediction> {
        let Profile { campaign, sensor, lit, seen, range, .. } = profile;
        let pulses = self.0.get(&(campaign.clone(), sensor.clone(), *lit, *seen, range.clone()));
        let in_period = |pulse: &sparse::Prediction| {
            let after_ps = pulse.time_ps - flight.t0_ps;
            let after_ps = period_ps.map_or(after_ps, |period_ps| after_ps.rem_euclid(period_ps));
            sparse::Prediction { time_ps: flight.t0_ps + after_ps, ..*pulse }
        };
        pulses.into_iter().flatten().map(in_period).collect()
    }
}
