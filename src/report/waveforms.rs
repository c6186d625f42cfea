//! Chosen profiles: the mean of their shots with its error band, the impulses that explain it, and the labels of their
//! onsets.

use std::collections::{BTreeMap, BTreeSet};

use super::arrivals::{Arrivals, doubt};
use super::sources::Sources;
use super::spread;
use crate::history::HistoryError;
use crate::history::behind::{CaptureKey, OnsetBehind};
use crate::table;
use crate::tables::stir::Impulse;
use crate::tables::{Name, Samples};

/// Profiles at most.
const PROFILES: usize = 200;
/// Of these, those with the onsets to doubt most.
const DOUBTED: usize = 60;
/// Points of a curve at most.
const POINTS: usize = 320;
/// Margin before the first and after the last onset, as a share of the time between them.
const MARGIN: f64 = 0.15;
/// Least margin, in samples.
const LEAST_BESIDE: f64 = 25.0;

/// Role of the captures that are shown.
const SCENE: &str = "scene";

table! {
    /// Which profiles there are.
    "profiles": Key, KeyColumns {
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
    }
}

table! {
    /// A mean profile.
    "profiles": Averaged, AveragedColumns {
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
        /// Shots averaged.
        shots: i32,
        /// Rejected shots.
        rejected: i32,
        /// Time of sample 0 since the reference pulse.
        t0_ps: f64,
        /// Time between samples.
        dt_ps: f64,
        /// Mean signal.
        mean_v: Samples,
        /// Its standard error.
        se_v: Samples,
        /// Wall-clock time of the first shot.
        acquired_at: Option<Name>,
    }
}

table! {
    /// How a profile is explained.
    "stir": Explained, ExplainedColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Patch lit.
        lit: i32,
        /// Patch seen.
        seen: i32,
        /// Time of sample 0, latency removed.
        t0_ps: f64,
        /// Impulses.
        impulses: Vec<Impulse>,
        /// Chi-square over degrees of freedom.
        chi2_dof: Option<f64>,
    }
}

/// One profile.
pub struct Waveform {
    /// Which.
    pub capture: CaptureKey,
    /// Shots averaged.
    pub shots: i32,
    /// Rejected shots.
    pub rejected: i32,
    /// Wall-clock time of the first shot.
    pub acquired_at: Option<Name>,
    /// Chi-square of the deconvolution over its degrees of freedom.
    pub chi2_dof: Option<f64>,
    /// Time of flight, mean and standard error; a long record is thinned to the extremes of each stretch.
    pub points: Vec<(f64, f64, f64)>,
    /// Impulses that explain it.
    pub impulses: Vec<Impulse>,
    /// Its onsets.
    pub onsets: Vec<OnsetBehind>,
}

/// The chosen ones.
#[derive(Default)]
pub struct Waveforms {
    /// Heading of the table of mean profiles.
    pub heading: Option<String>,
    /// Profiles of the scene that there are.
    pub all: usize,
    /// In the order of the table.
    pub chosen: Vec<Waveform>,
}

impl Waveforms {
    /// Reads profiles with the onsets to doubt most, and others evenly spread.
    ///
    /// # Errors
    /// When a table cannot be read.
    pub fn of(sources: &Sources<'_>, arrivals: &Arrivals) -> Result<Self, HistoryError> {
        let keys = sources.rows(|row: &Key| &*row.role == SCENE)?;
        let keys: Vec<CaptureKey> = keys.into_iter().map(|row| (row.campaign, row.sensor, row.lit, row.seen)).collect();
        let worst = |capture: &CaptureKey| {
            arrivals.by_capture.get(capture).into_iter().flatten().map(doubt).fold(0.0, f64::max)
        };
        let mut by_doubt: Vec<(f64, &CaptureKey)> = keys.iter().map(|key| (worst(key), key)).collect();
        by_doubt.sort_by(|a, b| b.0.total_cmp(&a.0));
        let (doubted, rest) = by_doubt.split_at(DOUBTED.min(by_doubt.len()));
        let mut rest: Vec<&CaptureKey> = rest.iter().map(|(_, key)| *key).collect();
        rest.sort();
        let mut wanted: BTreeSet<CaptureKey> = doubted.iter().map(|(_, key)| (*key).clone()).collect();
        wanted.extend(spread(&rest, PROFILES - DOUBTED).into_iter().cloned());
        let numbers: BTreeSet<i32> = wanted.iter().map(|key| key.2).collect();
        let near = [("lit", &numbers)];
        let key = |row: &Explained| (row.campaign.clone(), row.sensor.clone(), row.lit, row.seen);
        let explained: BTreeMap<CaptureKey, Explained> = sources
            .rows_near(&near, |row: &Explained| wanted.contains(&key(row)))?
            .into_iter()
            .map(|row| (key(&row), row))
            .collect();
        let key = |row: &Averaged| (row.campaign.clone(), row.sensor.clone(), row.lit, row.seen);
        let averaged = sources.rows_near(&near, |row: &Averaged| &*row.role == SCENE && wanted.contains(&key(row)))?;
        let waveform = |row: Averaged| {
            let capture = key(&row);
            let onsets = arrivals.by_capture.get(&capture).cloned().unwrap_or_default();
            let explained = explained.get(&capture);
            Waveform::new(row, explained, capture, onsets)
        };
        let mut chosen: Vec<Waveform> = averaged.into_iter().map(waveform).collect();
        chosen.sort_by(|a, b| a.capture.cmp(&b.capture));
        Ok(Self { heading: sources.heading("profiles"), all: keys.len(), chosen })
    }
}

impl Waveform {
    fn new(row: Averaged, explained: Option<&Explained>, capture: CaptureKey, onsets: Vec<OnsetBehind>) -> Self {
        // Times of the mean have the sensor's latency in them; those of the deconvolution have not.
        let t0_ps = explained.map_or(row.t0_ps, |explained| explained.t0_ps);
        let impulses = explained.map(|explained| explained.impulses.clone()).unwrap_or_default();
        let times_ps: Vec<f64> = impulses.iter().map(|impulse| impulse.time_ps).collect();
        Self {
            points: thinned(&row, t0_ps, &times_ps),
            onsets,
            capture,
            shots: row.shots,
            rejected: row.rejected,
            acquired_at: row.acquired_at,
            chi2_dof: explained.and_then(|explained| explained.chi2_dof),
            impulses,
        }
    }
}

impl Waveforms {
    /// The profile with the most labelled onsets, or with the most onsets; the first of equals.
    pub fn telling(&self) -> Option<&Waveform> {
        let labels_and_onsets = |waveform: &&Waveform| {
            (waveform.onsets.iter().filter(|onset| onset.path.is_some()).count(), waveform.onsets.len())
        };
        self.chosen.iter().rev().filter(|waveform| !waveform.points.is_empty()).max_by_key(labels_and_onsets)
    }
}

/// Points around the impulses; of a stretch too long to show all samples its lowest and its highest.
fn thinned(row: &Averaged, t0_ps: f64, impulses_ps: &[f64]) -> Vec<(f64, f64, f64)> {
    let point = |i: usize| (t0_ps + i as f64 * row.dt_ps, f64::from(row.mean_v[i]), f64::from(row.se_v[i]));
    let first_ps = impulses_ps.iter().copied().fold(f64::INFINITY, f64::min);
    let last_ps = impulses_ps.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let margin_ps = (MARGIN * (last_ps - first_ps)).max(LEAST_BESIDE * row.dt_ps);
    let shown = |i: usize| {
        impulses_ps.is_empty() || (first_ps - margin_ps..=last_ps + margin_ps).contains(&(t0_ps + i as f64 * row.dt_ps))
    };
    let samples: Vec<usize> = (0..row.mean_v.len().min(row.se_v.len())).filter(|&i| shown(i)).collect();
    if samples.len() <= POINTS {
        return samples.into_iter().map(point).collect();
    }
    let stretch = (2 * samples.len()).div_ceil(POINTS);
    samples.chunks(stretch).flat_map(|stretch| extremes(&row.mean_v, stretch)).map(point).collect()
}

/// The lowest and the highest of some samples, in their order.
fn extremes(mean_v: &[f32], samples: &[usize]) -> BTreeSet<usize> {
    let by_mean = |a: &&usize, b: &&usize| mean_v[**a].total_cmp(&mean_v[**b]);
    let (low, high) = (samples.iter().min_by(by_mean).copied(), samples.iter().max_by(by_mean).copied());
    low.into_iter().chain(high).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(mean_v: Vec<f32>) -> Averaged {
        let name = Name::from("s1");
        Averaged {
            campaign: name.clone(),
            sensor: name.clone(),
            lit: 1,
            seen: 2,
            role: name,
            shots: 1,
            rejected: 0,
            t0_ps: 0.0,
            dt_ps: 10.0,
            se_v: vec![0.5; mean_v.len()].into(),
            mean_v: mean_v.into(),
            acquired_at: None,
        }
    }

    #[test]
    fn a_long_record_keeps_its_extremes_in_their_order() {
        let mut mean_v = vec![0.0; 10_000];
        (mean_v[5003], mean_v[5001]) = (7.0, -3.0);
        let points = thinned(&row(mean_v), 100.0, &[]);
        assert!(points.len() <= POINTS && points.is_sorted_by(|a, b| a.0 < b.0));
        assert!(points.contains(&(100.0 + 50_010.0, -3.0, 0.5)) && points.contains(&(100.0 + 50_030.0, 7.0, 0.5)));
    }

    #[test]
    fn only_the_surroundings_of_impulses_are_shown() {
        let points = thinned(&row(vec![0.0; 10_000]), 0.0, &[2000.0, 2100.0]);
        assert_eq!((points[0].0, points.last().unwrap().0, points.len()), (1750.0, 2350.0, 61));
    }
}
