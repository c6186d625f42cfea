//! Onsets and captures that contribute to a row.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;

use super::HistoryError;
use super::ancestry::{Ancestry, Table};
use super::exposures::Exposures;
pub use super::exposures::{CaptureKey, RawRecords};
use crate::table;
use crate::tables::{Label, Name, Onset, Residual};
use crate::units::PatchId;

/// An onset that contributes to a row. Values that no table has are null.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OnsetBehind {
    /// Campaign.
    pub campaign: Name,
    /// Sensor.
    pub sensor: Name,
    /// Patch that the laser lit.
    pub lit: PatchId,
    /// Patch that the sensor saw.
    pub seen: PatchId,
    /// Rank in its profile.
    pub rank: i32,
    /// 0 for the onset as a whole, 1 and 2 for the two pulses that it is read as.
    pub part: i32,
    /// Path of its label; null: unexplained.
    pub path: Option<Vec<PatchId>>,
    /// Time of flight, as detected.
    pub time_ps: Option<f64>,
    /// Its standard deviation.
    pub time_sd_ps: Option<f64>,
    /// Laser periods that the label adds to it.
    pub turns: Option<i32>,
    /// Measured minus predicted time.
    pub residual_ps: Option<f64>,
    /// Residual over its own standard deviation, or over that of the time if the former is unknown.
    pub pull: Option<f64>,
    /// Whether the solution uses it.
    pub used: Option<bool>,
    /// Probability of the label.
    pub probability: Option<f64>,
    /// Signal-to-noise ratio.
    pub snr: Option<f64>,
    /// Special conditions.
    pub flags: Vec<Name>,
}

impl OnsetBehind {
    fn new(campaign: &Name, sensor: &Name, lit: PatchId, seen: PatchId, rank: i32) -> Self {
        Self {
            campaign: campaign.clone(),
            sensor: sensor.clone(),
            lit,
            seen,
            rank,
            part: 0,
            path: None,
            time_ps: None,
            time_sd_ps: None,
            turns: None,
            residual_ps: None,
            pull: None,
            used: None,
            probability: None,
            snr: None,
            flags: Vec::new(),
        }
    }

    /// From its residual.
    #[must_use]
    pub fn of_residual(row: &Residual) -> Self {
        Self {
            path: Some(row.path.clone()),
            residual_ps: Some(row.residual_ps),
            pull: Some(row.studentised.unwrap_or(row.standardised)),
            used: Some(row.used),
            part: row.part,
            ..Self::new(&row.campaign, &row.sensor, row.lit, row.seen, row.rank)
        }
    }

    /// From its label.
    #[must_use]
    pub fn of_label(row: &Label) -> Self {
        let part = row.part;
        Self { part, ..Self::new(&row.campaign, &row.sensor, row.lit, row.seen, row.rank) }.labelled(row)
    }

    /// From its detection.
    #[must_use]
    pub fn of_onset(row: &Onset) -> Self {
        Self::new(&row.campaign, &row.sensor, row.lit, row.seen, row.rank).detected(row)
    }

    /// Adds values of the label, where there are none yet.
    #[must_use]
    pub fn labelled(mut self, row: &Label) -> Self {
        self.path = self.path.or_else(|| row.path.clone());
        self.turns = Some(row.turns);
        self.probability = Some(row.probability);
        if row.part > 0 {
            (self.time_ps, self.time_sd_ps) = (Some(row.time_ps), Some(row.time_sd_ps));
        }
        self.residual_ps = self.residual_ps.or(row.residual_ps);
        self.pull = self.pull.or_else(|| row.residual_ps.map(|residual_ps| residual_ps / row.time_sd_ps));
        self
    }

    /// Adds values of the detection.
    #[must_use]
    pub fn detected(mut self, row: &Onset) -> Self {
        // A part has a time of its own, which its label knows.
        if self.part == 0 || self.time_ps.is_none() {
            (self.time_ps, self.time_sd_ps) = (Some(row.time_ps), Some(row.time_sd_ps));
        }
        self.snr = Some(row.snr);
        self.flags.clone_from(&row.flags);
        self
    }

    /// Its capture.
    #[must_use]
    pub fn capture(&self) -> CaptureKey {
        (self.campaign.clone(), self.sensor.clone(), self.lit, self.seen)
    }

    /// Its capture, rank and part.
    #[must_use]
    pub fn id(&self) -> (CaptureKey, i32, i32) {
        (self.capture(), self.rank, self.part)
    }

    /// Its capture and rank, which both parts share.
    #[must_use]
    pub fn whole(&self) -> (CaptureKey, i32) {
        (self.capture(), self.rank)
    }
}

/// Adds the values in `labels` and `onsets`, if these tables exist.
pub(super) fn complete(
    ancestry: &Ancestry,
    onsets: Vec<OnsetBehind>,
    labels: Option<&Table>,
    detected: Option<&Table>,
) -> Result<Vec<OnsetBehind>, HistoryError> {
    let wholes: BTreeSet<_> = onsets.iter().map(OnsetBehind::whole).collect();
    let labels = match labels {
        None => Vec::new(),
        Some(table) => {
            let wanted = |row: &Label| row.alternative == 0 && wholes.contains(&OnsetBehind::of_label(row).whole());
            ancestry.rows(table, wanted)?
        }
    };
    let detected = match detected {
        None => Vec::new(),
        Some(table) => ancestry.rows(table, |row: &Onset| wholes.contains(&OnsetBehind::of_onset(row).whole()))?,
    };
    let mut by_whole: BTreeMap<_, Vec<&Label>> = BTreeMap::new();
    for row in &labels {
        by_whole.entry(OnsetBehind::of_label(row).whole()).or_default().push(row);
    }
    let detected: BTreeMap<_, _> = detected.iter().map(|row| (OnsetBehind::of_onset(row).whole(), row)).collect();
    let add = |onset: OnsetBehind| {
        let rows = by_whole.get(&onset.whole()).map_or(&[][..], |rows| &rows[..]);
        // An onset as a whole that is read as two stands for both.
        let of_part = |part: i32| rows.iter().find(|row| row.part == part);
        let labelled: Vec<OnsetBehind> = match of_part(onset.part) {
            Some(row) => vec![onset.clone().labelled(row)],
            None if onset.part > 0 || rows.is_empty() => vec![onset.clone()],
            None => rows.iter().map(|row| OnsetBehind { part: row.part, ..onset.clone() }.labelled(row)).collect(),
        };
        let row = detected.get(&onset.whole());
        labelled.into_iter().map(move |onset| row.map_or_else(|| onset.clone(), |row| onset.clone().detected(row)))
    };
    Ok(onsets.into_iter().flat_map(|onset| add(onset).collect::<Vec<_>>()).collect())
}

/// A capture that contributes to a row. Values that no table has are null.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CaptureBehind {
    /// Campaign.
    pub campaign: Name,
    /// Sensor.
    pub sensor: Name,
    /// Patch that the laser lit.
    pub lit: PatchId,
    /// Patch that the sensor saw.
    pub seen: PatchId,
    /// Averaged shots.
    pub shots: Option<i32>,
    /// Rejected shots.
    pub rejected: Option<i32>,
    /// Standard deviation of the noise of one shot.
    pub noise_v: Option<f64>,
    /// Time error that all arrivals of the profile share.
    pub jitter_ps: Option<f64>,
    /// Chi-square of the deconvolution over its degrees of freedom.
    pub chi2_dof: Option<f64>,
    /// Wall-clock time of the first shot.
    pub acquired_at: Option<Name>,
    /// Its raw records.
    pub raw: Vec<RawRecords>,
}

table! {
    /// Columns of a profile that describe its capture.
    "profiles": ProfileRow, ProfileRowColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Patch lit.
        lit: i32,
        /// Patch seen.
        seen: i32,
        /// Role.
        role: Name,
        /// Averaged shots.
        shots: i32,
        /// Rejected shots.
        rejected: i32,
        /// Noise of one shot.
        noise_v: f64,
        /// Residual time error of the alignment.
        jitter_ps: f64,
        /// Time of the first shot.
        acquired_at: Option<Name>,
    }
}

table! {
    /// Quality of the deconvolution of a profile.
    "stir": StirRow, StirRowColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Patch lit.
        lit: i32,
        /// Patch seen.
        seen: i32,
        /// Chi-square over degrees of freedom.
        chi2_dof: Option<f64>,
    }
}

/// Keys of the captures of the scene in a table `profiles`.
pub(super) fn scene_captures(ancestry: &Ancestry, profiles: &Table) -> Result<BTreeSet<CaptureKey>, HistoryError> {
    let rows = ancestry.rows(profiles, |row: &ProfileRow| &*row.role == "scene")?;
    Ok(rows.into_iter().map(|row| (row.campaign, row.sensor, row.lit, row.seen)).collect())
}

/// Describes captures, in the order of the tables. `from` is the table whose ancestors have the information.
pub(super) fn captures(
    exposures: &Exposures<'_>,
    keys: &BTreeSet<CaptureKey>,
    from: &Table,
    remarks: &mut Vec<String>,
) -> Result<Vec<CaptureBehind>, HistoryError> {
    let ancestry = exposures.ancestry;
    let profiles = at_or_above(ancestry, from, "profiles");
    let mut averaged = BTreeMap::new();
    if let Some(table) = &profiles {
        let key = |row: &ProfileRow| (row.campaign.clone(), row.sensor.clone(), row.lit, row.seen);
        let rows = ancestry.rows(table, |row: &ProfileRow| &*row.role == "scene" && keys.contains(&key(row)))?;
        averaged.extend(rows.into_iter().map(|row| (key(&row), row)));
    }
    let mut explained = BTreeMap::new();
    if let Some(table) = at_or_above(ancestry, from, "stir") {
        let key = |row: &StirRow| (row.campaign.clone(), row.sensor.clone(), row.lit, row.seen);
        let rows = ancestry.rows(&table, |row: &StirRow| keys.contains(&key(row)))?;
        explained.extend(rows.into_iter().map(|row| (key(&row), row.chi2_dof)));
    }
    let mut raw: BTreeMap<CaptureKey, Vec<RawRecords>> = BTreeMap::new();
    if let Some(traces) = ancestry.nearest(profiles.as_ref().unwrap_or(from), "traces") {
        for (key, records) in exposures.of_captures(&traces, keys, remarks)? {
            raw.entry(key).or_default().push(records);
        }
    }
    let capture = |key: &CaptureKey| {
        let averaged = averaged.get(key);
        CaptureBehind {
            campaign: key.0.clone(),
            sensor: key.1.clone(),
            lit: key.2,
            seen: key.3,
            shots: averaged.map(|row| row.shots),
            rejected: averaged.map(|row| row.rejected),
            noise_v: averaged.map(|row| row.noise_v),
            jitter_ps: averaged.map(|row| row.jitter_ps),
            chi2_dof: explained.get(key).copied().flatten(),
            acquired_at: averaged.and_then(|row| row.acquired_at.clone()),
            raw: raw.remove(key).unwrap_or_default(),
        }
    };
    let mut in_order: Vec<&CaptureKey> = keys.iter().collect();
    in_order.sort_by_key(|(campaign, sensor, lit, seen)| {
        (campaign.clone(), sensor.clone(), *lit.min(seen), *lit.max(seen), *lit)
    });
    Ok(in_order.into_iter().map(capture).collect())
}

/// The table itself, or its nearest ancestor with this name.
pub(super) fn at_or_above(ancestry: &Ancestry, table: &Table, name: &str) -> Option<Table> {
    if table.name == name { Some(table.clone()) } else { ancestry.nearest(table, name) }
}
