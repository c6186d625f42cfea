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

#[cfg(test)]
mod tests {
    use super::*;

    fn row(range: Option<&str>, time_ps: f64, width_sd_ps: Option<f64>) -> Prediction {
        let (campaign, sensor, range) = ("c".into(), "s1".into(), range.map(Into::into));
        Prediction { campaign, sensor, lit: 1, seen: 2, range, time_ps, width_sd_ps, ..Prediction::default() }
    }

    /// A profile has the rows of its own sensor, pair and range, each in the period that it records.
    #[test]
    fn a_profile_has_its_own_predictions_in_its_period() {
        let predictions = Predictions::new(vec![
            row(Some("fine"), 12_500.0, Some(2.0)),
            row(Some("coarse"), 3000.0, None),
            Prediction { seen: 1, ..row(Some("fine"), 4000.0, None) },
        ]);
        let flight = FlightProfile {
            mean_v: Vec::new(),
            sd_v: Vec::new(),
            acf: Vec::new(),
            slow_v2: Vec::new(),
            jitter: None,
            t0_ps: 1000.0,
            dt_ps: 50.0,
            drift_sd_ps: 0.0,
        };
        let times_ps = |range: Option<&str>, period_ps: Option<f64>| -> Vec<f64> {
            let (campaign, sensor, range) = ("c".into(), "s1".into(), range.map(Into::into));
            let profile = Profile { campaign, sensor, lit: 1, seen: 2, range, ..Profile::default() };
            predictions.of(&profile, &flight, period_ps).iter().map(|pulse| pulse.time_ps).collect()
        };
        assert_eq!(times_ps(Some("fine"), None), [12_500.0]);
        assert_eq!(times_ps(Some("fine"), Some(10_000.0)), [2500.0]);
        assert_eq!(times_ps(Some("coarse"), Some(10_000.0)), [3000.0]);
        assert_eq!(times_ps(None, None), [0.0; 0]);
        let unknown = Predictions::new(vec![row(None, 3000.0, None)]).0.into_values().next().unwrap();
        assert!(unknown[0].width_sd_ps.is_infinite(), "of a width that is not known anything goes: {unknown:?}");
    }
}
