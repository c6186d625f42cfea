//! `detect`: which features of a deconvolved profile are arrivals of light (paper section 4.1, onsets).
//!
//! | method | onset | takes |
//! |---|---|---|
//! | `impulses` | time of an impulse that `deconvolve` found; refers to the centroid of the light | `impulses` |
//! | `leading-edge` | crossing of `fraction` of the profile's maximum, walking back from it | `profile` |
//! | `constant-fraction` | zero of the delayed profile less `fraction` of itself | `profile` |
//!
//! The paper's own "first non-zero response" is a threshold, whose time walks with amplitude; an edge at a fraction does not. Edge methods see
//! one onset a profile: that of its maximum. An onset needs a signal-to-noise ratio of `threshold_sigma`.
//!
//! Takes `stir`; writes `onsets`. Flags: `blended` (its time is strongly correlated with a neighbour's), `misfit` (the fit of its profile
//! leaves more than noise), `at-edge` (near an end of the record). Not modelled yet: extended bounces, saturated arrivals.
//!
//! ```toml
//! [onsets]
//! stage = "detect"
//! from = "stir"
//! params = { method = "impulses", threshold_sigma = 5.0 }
//! ```

use serde::{Deserialize, Serialize};

use super::stage::{Apply, BesideTables, Grain, Outcome, Stage, StageError};
use crate::campaign::Campaign;
use crate::signal::onset::{self, Crossing};
use crate::tables::{Name, Onset, Stir};

/// Correlation of two times beyond which both are called blended.
const BLENDED: f64 = 0.5;
/// Chi-square per degree of freedom beyond which a fit is called a misfit.
const MISFIT: f64 = 1.5;
/// An onset closer to an end of the record than this many samples is at its edge.
const EDGE_SAMPLES: f64 = 2.0;

/// Parameters of `detect`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Detect {
    method: Method,
    /// Least signal-to-noise ratio.
    threshold_sigma: f64,
    /// Fraction of the maximum, for edge methods.
    fraction: f64,
    /// Delay of the discriminator, for `constant-fraction`.
    delay_ps: f64,
}

/// How onsets are found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Method {
    Impulses,
    LeadingEdge,
    ConstantFraction,
}

impl Default for Detect {
    fn default() -> Self {
        Self { method: Method::Impulses, threshold_sigma: 5.0, fraction: 0.5, delay_ps: 100.0 }
    }
}

impl Stage for Detect {
    const KIND: &'static str = "detect";
    const VERSION: u32 = 1;
    const GRAIN: Grain = Grain::Capture;
    type Input = Stir;
    type Output = Onset;
    type Fields = ();
    type Context = ();

    fn fields(&self, _: &[Campaign]) {}

    fn context(&self, (): (), _: &BesideTables) -> Result<(), StageError> {
        if !(self.fraction > 0.0 && self.fraction < 1.0) {
            return Err(StageError::Refused(format!("params.fraction = {} must lie between 0 and 1", self.fraction)));
        }
        if self.threshold_sigma < 0.0 || self.threshold_sigma.is_nan() {
            return Err(StageError::Refused(format!(
                "params.threshold_sigma = {} must not be negative",
                self.threshold_sigma
            )));
        }
        Ok(())
    }
}

impl Apply for Detect {
    fn apply(&self, (): &(), group: Vec<Stir>) -> Result<Outcome<Onset>, StageError> {
        let mut onsets = Vec::new();
        for stir in &group {
            match self.method {
                Method::Impulses => onsets.extend(self.impulses(stir)),
                Method::LeadingEdge | Method::ConstantFraction => onsets.extend(self.edge(stir)?),
            }
        }
        Ok(Outcome::rows(onsets))
    }
}

impl Detect {
    fn impulses(&self, stir: &Stir) -> Vec<Onset> {
        let count = stir.impulses.len();
        let snr = |k: usize| stir.impulses[k].amplitude_v.abs() / stir.impulses[k].amplitude_sd_v;
        let kept: Vec<usize> = (0..count).filter(|&k| snr(k) >= self.threshold_sigma).collect();
        let end_ps = stir.t0_ps + stir.profile.len() as f64 * stir.dt_ps;
        let onset = |(rank, &k): (usize, &usize)| {
            let impulse = &stir.impulses[k];
            let covariance: Vec<f64> = kept.iter().map(|&other| stir.impulse_cov[k * count + other]).collect();
            let correlated = kept.iter().zip(&covariance).any(|(&other, cov)| {
                other != k && cov.abs() > BLENDED * impulse.time_sd_ps * stir.impulses[other].time_sd_ps
            });
            let margin_ps = EDGE_SAMPLES * stir.dt_ps;
            let at_edge = impulse.time_ps < stir.t0_ps + margin_ps || impulse.time_ps > end_ps - margin_ps;
            let misfit = stir.chi2_dof.is_some_and(|chi2_dof| chi2_dof > MISFIT);
            Onset {
                rank: rank as i32 + 1,
                time_ps: impulse.time_ps,
                time_sd_ps: impulse.time_sd_ps,
                earliest_ps: None,
                amplitude: impulse.amplitude_v,
                amplitude_sd: Some(impulse.amplitude_sd_v),
                width_ps: impulse.width_ps,
                snr: snr(k),
                evidence: Some(impulse.evidence),
                covariance,
                flags: flags(&[("blended", correlated), ("misfit", misfit), ("at-edge", at_edge)]),
                ..blank(stir)
            }
        };
        kept.iter().enumerate().map(onset).collect()
    }

    fn edge(&self, stir: &Stir) -> Result<Option<Onset>, StageError> {
        let profile = stir.profile.to_f64();
        let peak = profile.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let snr = if stir.profile_noise > 0.0 { peak / stir.profile_noise } else { f64::INFINITY };
        if !(peak > 0.0 && snr >= self.threshold_sigma) {
            return Ok(None);
        }
        let crossing: Option<Crossing> = match self.method {
            Method::ConstantFraction => {
                let delay = self.delay_ps / stir.dt_ps;
                if delay < 1.0 {
                    return Err(StageError::Refused(format!(
                        "params.delay_ps = {} is less than one sample of {} ps",
                        self.delay_ps, stir.dt_ps
                    )));
                }
                onset::constant_fraction(&profile, self.fraction, delay, stir.profile_noise)
            }
            _ => onset::leading_edge(&profile, self.fraction, stir.profile_noise),
        };
        Ok(crossing.map(|crossing| {
            let time_ps = stir.t0_ps + crossing.position * stir.dt_ps;
            let sd_ps = crossing.sd * stir.dt_ps;
            let at_edge = crossing.position < EDGE_SAMPLES || crossing.position > profile.len() as f64 - EDGE_SAMPLES;
            Onset {
                rank: 1,
                time_ps,
                time_sd_ps: sd_ps,
                earliest_ps: Some(time_ps),
                amplitude: peak,
                snr,
                covariance: vec![sd_ps * sd_ps],
                flags: flags(&[("at-edge", at_edge)]),
                ..blank(stir)
            }
        }))
    }
}

fn flags(flags: &[(&str, bool)]) -> Vec<Name> {
    flags.iter().filter(|(_, set)| *set).map(|(name, _)| Name::from(*name)).collect()
}

/// An onset of this profile with nothing known but its key.
fn blank(stir: &Stir) -> Onset {
    Onset {
        campaign: stir.campaign.clone(),
        sensor: stir.sensor.clone(),
        lit: stir.lit,
        seen: stir.seen,
        rank: 0,
        time_ps: 0.0,
        time_sd_ps: 0.0,
        earliest_ps: None,
        amplitude: 0.0,
        amplitude_sd: None,
        width_ps: 0.0,
        snr: 0.0,
        evidence: None,
        covariance: Vec::new(),
        jitter_ps: stir.jitter_ps,
        flags: Vec::new(),
    }
}
