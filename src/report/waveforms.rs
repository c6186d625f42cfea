//! Chosen profiles: the mean of their shots with its error band, the curve that their impulses draw, and the labels of
//! their onsets.

use std::collections::{BTreeMap, BTreeSet};

use super::arrivals::{Arrivals, doubt};
use super::campaigns::Campaigns;
use super::curve::{Curve, Explanation};
use super::sources::Sources;
use super::spread;
use crate::history::HistoryError;
use crate::history::behind::{CaptureKey, OnsetBehind};
use crate::priors::calibration::Sensors;
use crate::table;
use crate::tables::stir::Impulse;
use crate::tables::{Calibration, Name, Profile, Row, Session};

/// Profiles at most.
const PROFILES: usize = 200;
/// Of these, those with the onsets to doubt most.
const DOUBTED: usize = 60;
/// Points of a curve at most.
const POINTS: usize = 330;
/// Of these, from each stretch.
const EXTREMES: usize = 3;
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
        /// Standard deviation of a baseline that moves.
        ground_v: f64,
        /// Width of the response over that of the response captures.
        response_width: Option<f64>,
        /// Its standard deviation.
        response_width_sd: Option<f64>,
    }
}

table! {
    /// How well a profile is explained.
    "stir": Misfit, MisfitColumns {
        /// Chi-square over degrees of freedom.
        chi2_dof: Option<f64>,
    }
}

/// One sample that is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Time of flight.
    pub time_ps: f64,
    /// Mean of all shots.
    pub mean_v: f64,
    /// Its standard error; infinite for a sample that every range clipped.
    pub se_v: f64,
    /// The fitted curve, where `stir` has pulses and the calibration of their sensor is kept.
    pub fitted_v: Option<f64>,
}

impl Point {
    /// What the curve leaves, in standard errors.
    pub fn residual(&self) -> Option<f64> {
        self.fitted_v.map(|fitted_v| (self.mean_v - fitted_v) / self.se_v).filter(|_| self.se_v.is_finite())
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
    /// Whether its samples are photons a bin, not volts.
    pub is_counted: bool,
    /// Chi-square of the deconvolution over its degrees of freedom.
    pub chi2_dof: Option<f64>,
    /// The same of the curve that is drawn.
    pub drawn_chi2_dof: Option<f64>,
    /// Samples; a long record is thinned to the extremes of each stretch.
    pub points: Vec<Point>,
    /// Impulses that explain it.
    pub impulses: Vec<Impulse>,
    /// Whether it was explained together with its reciprocal profile, in whose row the impulses stand.
    pub is_reciprocal: bool,
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
    /// Chi-square over degrees of freedom of each profile that was explained by pulses, ascending.
    pub chi2_dofs: Vec<f64>,
}

/// What a curve needs besides profile and pulses.
struct Instrument<'a> {
    sensors: Sensors,
    sessions: Vec<Session>,
    campaigns: &'a Campaigns,
}

impl Waveforms {
    /// Reads profiles with the onsets to doubt most, and others evenly spread.
    ///
    /// # Errors
    /// When a table cannot be read.
    pub fn of(sources: &Sources<'_>, campaigns: &Campaigns, arrivals: &Arrivals) -> Result<Self, HistoryError> {
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
        // Profiles that were explained together have their pulses in one row.
        let reciprocal = |key: &CaptureKey| (key.0.clone(), key.1.clone(), key.3, key.2);
        let numbers: BTreeSet<i32> = wanted.iter().flat_map(|key| [key.2, key.3]).collect();
        let near = [("lit", &numbers)];
        let key = |row: &Explained| (row.campaign.clone(), row.sensor.clone(), row.lit, row.seen);
        let explained: BTreeMap<CaptureKey, Explained> = sources
            .rows_near(&near, |row: &Explained| wanted.contains(&key(row)) || wanted.contains(&reciprocal(&key(row))))?
            .into_iter()
            .map(|row| (key(&row), row))
            .collect();
        let key = |row: &Profile| (row.campaign.clone(), row.sensor.clone(), row.lit, row.seen);
        let averaged = sources.rows_near(&near, |row: &Profile| &*row.role == SCENE && wanted.contains(&key(row)))?;
        let instrument = Instrument {
            sensors: Sensors::new(&sources.rows_behind(Explained::TABLE, |_: &Calibration| true)?),
            sessions: sources.rows(|_: &Session| true)?,
            campaigns,
        };
        let waveform = |row: Profile| {
            let capture = key(&row);
            let onsets = arrivals.by_capture.get(&capture).cloned().unwrap_or_default();
            let own = explained.get(&capture);
            let other = explained.get(&reciprocal(&capture));
            Waveform::new(&row, (own, other), &instrument, (capture.clone(), onsets))
        };
        let mut chosen: Vec<Waveform> = averaged.into_iter().map(waveform).collect();
        chosen.sort_by(|a, b| a.capture.cmp(&b.capture));
        let misfits = sources.rows(|row: &Misfit| row.chi2_dof.is_some())?;
        let mut chi2_dofs: Vec<f64> = misfits.into_iter().filter_map(|row| row.chi2_dof).collect();
        chi2_dofs.sort_by(f64::total_cmp);
        Ok(Self { heading: sources.heading("profiles"), all: keys.len(), chosen, chi2_dofs })
    }
}

impl Instrument<'_> {
    /// The curve through a profile; `None` where its sensor is not calibrated, or no pulses were fitted.
    fn curve(&self, row: &Profile, explained: &Explained, is_reciprocal: bool) -> Option<Curve> {
        let chi2_dof = explained.chi2_dof?;
        let campaign = self.campaigns.by_name.get(&*row.campaign);
        let dead_time_ps = campaign.and_then(|campaign| campaign.sensors.get(&*row.sensor)?.dead_time_ps);
        let period_ps = campaign.and_then(|campaign| campaign.repetition_ps);
        let sensor = self.sensors.of(row)?;
        let [corrected, _] = sensor.1.width;
        let width = explained.response_width.zip(explained.response_width_sd);
        let explanation = Explanation {
            impulses: &explained.impulses,
            chi2_dof,
            width: width.map(|(factor, sd)| [factor / corrected, sd]),
            ground_v: explained.ground_v,
            is_reciprocal,
        };
        let of_campaign = (period_ps, dead_time_ps.unwrap_or(0.0));
        Curve::of(row, sensor, &self.sessions, of_campaign, &explanation)
    }
}

impl Waveform {
    fn new(
        row: &Profile,
        (explained, other): (Option<&Explained>, Option<&Explained>),
        instrument: &Instrument<'_>,
        (capture, onsets): (CaptureKey, Vec<OnsetBehind>),
    ) -> Self {
        // A row without pulses and without a chi-square of its own is explained by that of its reciprocal profile.
        let is_reciprocal = row.lit > row.seen
            && explained.is_some_and(|own| own.chi2_dof.is_none() && own.impulses.is_empty())
            && other.is_some_and(|other| other.chi2_dof.is_some());
        let explaining = if is_reciprocal { other } else { explained };
        let curve = explaining.and_then(|explaining| instrument.curve(row, explaining, is_reciprocal));
        // Times of the mean have the sensor's latency in them; those of the deconvolution have not.
        let t0_ps = explained.map_or(row.t0_ps, |explained| explained.t0_ps);
        let impulses = match (&curve, explained) {
            (Some(curve), _) => curve.impulses.clone(),
            (None, Some(explained)) => explained.impulses.clone(),
            (None, None) => Vec::new(),
        };
        let times_ps: Vec<f64> = impulses.iter().map(|impulse| impulse.time_ps).collect();
        let samples: Vec<Point> = match &curve {
            Some(curve) => (0..curve.measured_v.len()).map(|n| fitted(curve, n)).collect(),
            None => measured(row, t0_ps),
        };
        Self {
            points: thinned(&samples, row.dt_ps, &times_ps),
            onsets,
            capture,
            shots: row.shots,
            rejected: row.rejected,
            acquired_at: row.acquired_at.clone(),
            is_counted: row.counts.is_some(),
            chi2_dof: explained.and_then(|explained| explained.chi2_dof),
            is_reciprocal,
            drawn_chi2_dof: curve.map(|curve| curve.chi2_dof),
            impulses,
        }
    }
}

fn fitted(curve: &Curve, n: usize) -> Point {
    Point {
        time_ps: curve.t0_ps + n as f64 * curve.dt_ps,
        mean_v: curve.measured_v[n],
        se_v: curve.sd_v[n],
        fitted_v: Some(curve.fitted_v[n]),
    }
}

/// Samples without a curve. Of photons the number that was counted: what `average` takes for background may be light.
fn measured(row: &Profile, t0_ps: f64) -> Vec<Point> {
    let counted = |count: &i32| (f64::from(*count), f64::from(*count).max(1.0).sqrt());
    let samples: Vec<(f64, f64)> = match &row.counts {
        Some(counts) => counts.iter().map(counted).collect(),
        None => row.mean_v().to_f64().into_iter().zip(row.se_v().to_f64()).collect(),
    };
    let point = |(n, (mean_v, se_v)): (usize, (f64, f64))| Point {
        time_ps: t0_ps + n as f64 * row.dt_ps,
        mean_v,
        se_v,
        fitted_v: None,
    };
    samples.into_iter().enumerate().map(point).collect()
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

/// Samples around the impulses; of a stretch too long to show all of them its lowest, its highest and that farthest
/// from the curve.
fn thinned(samples: &[Point], dt_ps: f64, impulses_ps: &[f64]) -> Vec<Point> {
    let first_ps = impulses_ps.iter().copied().fold(f64::INFINITY, f64::min);
    let last_ps = impulses_ps.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let margin_ps = (MARGIN * (last_ps - first_ps)).max(LEAST_BESIDE * dt_ps);
    let shown = |point: &&Point| {
        impulses_ps.is_empty() || (first_ps - margin_ps..=last_ps + margin_ps).contains(&point.time_ps)
    };
    let near: Vec<Point> = samples.iter().filter(shown).copied().collect();
    if near.len() <= POINTS {
        return near;
    }
    let stretch = (EXTREMES * near.len()).div_ceil(POINTS);
    near.chunks(stretch).flat_map(|stretch| extremes(stretch).into_iter().map(|n| stretch[n])).collect()
}

/// The lowest and the highest of some samples, and that with the largest residual, in their order.
fn extremes(samples: &[Point]) -> BTreeSet<usize> {
    let by = |value: fn(&Point) -> f64| {
        (0..samples.len()).max_by(|a, b| value(&samples[*a]).total_cmp(&value(&samples[*b])))
    };
    let residual = |point: &Point| point.residual().map_or(0.0, f64::abs);
    [by(|point| -point.mean_v), by(|point| point.mean_v), by(residual)].into_iter().flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(mean_v: &[f64]) -> Vec<Point> {
        let point = |(n, mean_v): (usize, &f64)| Point {
            time_ps: 100.0 + 10.0 * n as f64,
            mean_v: *mean_v,
            se_v: 0.5,
            fitted_v: Some(0.0),
        };
        mean_v.iter().enumerate().map(point).collect()
    }

    #[test]
    fn a_long_record_keeps_its_extremes_in_their_order() {
        let mut mean_v = vec![0.0; 10_000];
        (mean_v[5003], mean_v[5001]) = (7.0, -3.0);
        let mut samples = samples(&mean_v);
        // The largest residual is neither the lowest nor the highest of its stretch.
        (samples[5002].mean_v, samples[5002].fitted_v) = (1.0, Some(-10.0));
        let points = thinned(&samples, 10.0, &[]);
        assert!(points.len() <= POINTS && points.is_sorted_by(|a, b| a.time_ps < b.time_ps));
        for n in [5001, 5002, 5003] {
            assert!(points.contains(&samples[n]), "{n}");
        }
        assert_eq!(samples[5002].residual(), Some(22.0));
    }

    #[test]
    fn only_the_surroundings_of_impulses_are_shown() {
        let points = thinned(&samples(&vec![0.0; 10_000]), 10.0, &[2000.0, 2100.0]);
        assert_eq!((points[0].time_ps, points.last().unwrap().time_ps, points.len()), (1750.0, 2350.0, 61));
    }
}
