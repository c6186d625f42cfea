//! `detect`: which features of a deconvolved profile are arrivals of light (paper section 4.1, onsets).
//!
//! | method | onset | takes |
//! |---|---|---|
//! | `impulses` | time of an impulse that `deconvolve` found; refers to the centroid of the light | `impulses` |
//! | `leading-edge` | crossing of `fraction` of the profile's maximum, walking back from it | `profile` |
//! | `constant-fraction` | zero of the delayed profile less `fraction` of itself | `profile` |
//! | `first-response` | the paper's "first non-zero response": the first sample above `threshold_sigma` | `profile` |
//! | `aic` | where noise ends and signal begins by Akaike's criterion, within `window_ps` before each response's maximum | `profile` |
//!
//! A threshold walks with amplitude by tens of picoseconds, and Akaike's criterion almost as much; an edge at a
//! fraction does not. Edges at a fraction see one onset a profile: that of its maximum. `first-response` and `aic` see
//! as many as there are responses: after each, the profile must fall below `rearm_sigma` before the next. An onset
//! needs a signal-to-noise ratio of `threshold_sigma`. An impulse is an onset also where chi-square would rise by
//! `threshold_sigma` squared without it: blended light may be certain to be there while its share, and so its
//! amplitude, is not. Of blended impulses none of which is certain, all are onsets. `aic` has no standard deviation of
//! its own: its error is that of rounding to a sample, and of noise over the mean slope up to the maximum.
//!
//! With `sampled`, edges are not interpolated between samples, as when a person reads the screen of an oscilloscope.
//!
//! Takes `stir`; writes `onsets`. Not modelled yet: saturated arrivals. Flags:
//! - `blended`: its time is strongly correlated with a neighbour's, or its light divides uncertainly between both;
//! - `misfit`: the fit leaves more than noise in the samples that it reaches;
//! - `moving-baseline`: the baseline of its profile moves the same way in every shot;
//! - `at-edge`: near an end of the record;
//! - `extended`: its light is spread in time. `earliest_ps` is where it would begin if it were spread evenly, as by one
//!   flat patch; after two patches it begins up to 0.7 widths before that.
//!
//! ```toml
//! [onsets]
//! stage = "detect"
//! from = "stir"
//! params = { method = "impulses", threshold_sigma = 5.0 }
//! ```

use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::stage::{Apply, BesideTables, Grain, Outcome, Stage, StageError};
use crate::campaign::Campaign;
use crate::parameter::{Condition, Conflict, NonNegative, Positive, Share};
use crate::signal::largest::largest;
use crate::signal::onset::{self, Crossing};
use crate::tables::{Impulse, Name, Onset, Stir};

/// Correlation of two times beyond which both are called blended.
const BLENDED: f64 = 0.5;
/// An impulse is called a misfit if its chi-square exceeds its mean under noise by this many standard deviations.
const MISFIT_SIGMA: f64 = 3.0;
/// Light that is spread evenly begins this many standard deviations before its centroid: the root of 3.
const EARLIEST_WIDTHS: f64 = 1.732_050_807_568_877_2;
/// An onset closer to an end of the record than this many samples is at its edge.
const EDGE_SAMPLES: f64 = 2.0;

/// Parameters of `detect`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Detect {
    method: Method,
    /// Least signal-to-noise ratio.
    threshold_sigma: NonNegative,
    /// Fraction of the maximum, for edge methods.
    fraction: Share,
    /// Delay of the discriminator, for `constant-fraction`.
    delay_ps: Positive,
    /// Signal-to-noise ratio below which a profile must fall between two onsets, for `first-response` and `aic`.
    rearm_sigma: Positive,
    /// How long before its maximum a response may begin, for `aic`.
    window_ps: Positive,
    /// Whether edges are read off at samples, as on an oscilloscope's screen: at the first one beyond the edge.
    #[serde(skip_serializing_if = "is_false")]
    sampled: bool,
}

/// Whether a parameter is left as it was before there was one.
#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde asks so")]
fn is_false(value: &bool) -> bool {
    !value
}

/// How onsets are found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Method {
    Impulses,
    LeadingEdge,
    ConstantFraction,
    FirstResponse,
    Aic,
}

impl Default for Detect {
    fn default() -> Self {
        Self {
            method: Method::Impulses,
            threshold_sigma: NonNegative::new(5.0),
            fraction: Share::new(0.5),
            delay_ps: Positive::new(100.0),
            rearm_sigma: Positive::new(2.0),
            window_ps: Positive::new(1000.0),
            sampled: false,
        }
    }
}

impl Stage for Detect {
    const KIND: &'static str = "detect";
    const VERSION: u32 = 11;
    const GRAIN: Grain = Grain::Capture;
    const CONDITIONS: &'static [Condition] = &[
        Condition("fraction", "method", &["leading-edge", "constant-fraction"]),
        Condition("delay_ps", "method", &["constant-fraction"]),
        Condition("rearm_sigma", "method", &["first-response", "aic"]),
        Condition("window_ps", "method", &["aic"]),
        Condition("sampled", "method", &["leading-edge", "constant-fraction", "first-response", "aic"]),
    ];
    type Input = Stir;
    type Output = Onset;
    type Fields = ();
    type Context = ();

    fn conflict(&self) -> Option<Conflict> {
        let rearms = self.rearm_sigma.get() <= self.threshold_sigma.get();
        (matches!(self.method, Method::FirstResponse | Method::Aic) && !rearms).then(|| {
            Conflict("rearm_sigma", format!("must be at most `threshold_sigma`, {}", self.threshold_sigma.get()))
        })
    }

    fn fields(&self, _: &[Campaign]) {}

    fn context(&self, (): (), _: &BesideTables) -> Result<(), StageError> {
        Ok(())
    }
}

impl Apply for Detect {
    fn apply(&self, (): &(), group: Vec<Stir>) -> Result<Outcome<Onset>, StageError> {
        let mut onsets = Vec::new();
        for stir in &group {
            match self.method {
                Method::Impulses => onsets.extend(self.impulses(stir)),
                Method::LeadingEdge | Method::ConstantFraction | Method::FirstResponse | Method::Aic => {
                    onsets.extend(self.edges(stir)?);
                }
            }
        }
        Ok(Outcome::rows(onsets))
    }
}

impl Detect {
    fn impulses(&self, stir: &Stir) -> Vec<Onset> {
        let count = stir.impulses.len();
        let kept = self.certain(stir);
        let end_ps = stir.t0_ps + stir.profile.len() as f64 * stir.dt_ps;
        let onset = |(rank, &k): (usize, &usize)| {
            let impulse = &stir.impulses[k];
            let covariance: Vec<f64> = kept.iter().map(|&other| stir.impulse_cov[k * count + other]).collect();
            let variance = |k: usize| stir.impulse_cov[k * count + k];
            let correlated = kept
                .iter()
                .zip(&covariance)
                .any(|(&other, cov)| other != k && cov.powi(2) > BLENDED.powi(2) * variance(k) * variance(other));
            let margin_ps = EDGE_SAMPLES * stir.dt_ps;
            let at_edge = impulse.time_ps < stir.t0_ps + margin_ps || impulse.time_ps > end_ps - margin_ps;
            let extended = impulse.width_ps > 0.0;
            let misfit = impulse.misfit_sigma > MISFIT_SIGMA;
            let pair = impulse.pair;
            Onset {
                rank: rank as i32 + 1,
                time_ps: impulse.time_ps,
                time_sd_ps: impulse.time_sd_ps,
                own_time_ps: impulse.own_time_ps,
                own_variance_ps2: impulse.own_variance_ps2,
                earliest_ps: extended.then_some(impulse.time_ps - EARLIEST_WIDTHS * impulse.width_ps),
                amplitude: impulse.amplitude_v,
                amplitude_sd: Some(impulse.amplitude_sd_v.hypot(stir.gain_sd * impulse.amplitude_v)),
                width_ps: impulse.width_ps,
                width_sd_ps: impulse.width_sd_ps,
                width_kurtosis: impulse.width_kurtosis,
                pair_first_ps: pair.map(|pair| pair.first_ps),
                pair_second_ps: pair.map(|pair| pair.second_ps),
                pair_first_sd_ps: pair.map(|pair| pair.first_sd_ps),
                pair_second_sd_ps: pair.map(|pair| pair.second_sd_ps),
                pair_correlation: pair.map(|pair| pair.correlation),
                pair_first_amplitude: pair.map(|pair| pair.first_amplitude_v),
                pair_second_amplitude: pair.map(|pair| pair.second_amplitude_v),
                pair_gain: pair.map(|pair| pair.gain),
                snr: snr(impulse),
                evidence: Some(impulse.evidence),
                covariance,
                flags: flags(&[
                    ("blended", correlated || snr(impulse) < self.threshold_sigma.get()),
                    ("extended", extended),
                    ("misfit", misfit),
                    ("moving-baseline", stir.ground_v > 0.0),
                    ("at-edge", at_edge),
                ]),
                ..blank(stir)
            }
        };
        kept.iter().enumerate().map(onset).collect()
    }

    /// The impulses that are certain by their amplitude or their evidence, and blended ones of which none is.
    fn certain(&self, stir: &Stir) -> Vec<usize> {
        let count = stir.impulses.len();
        // What a misfit adds to chi-square is no evidence, wherever in the record it lies.
        let misfit = |impulse: &Impulse| stir.chi2_dof.unwrap_or(1.0).max(impulse.misfit_factor);
        let threshold = self.threshold_sigma.get();
        let is_certain = |k: usize| {
            let impulse = &stir.impulses[k];
            snr(impulse) >= threshold || impulse.evidence >= misfit(impulse) * threshold.powi(2)
        };
        let variance = |k: usize| stir.impulse_cov[k * count + k];
        let is_blended = |k: usize, other: usize| {
            let shared = stir.impulse_cov[k * count + other].powi(2);
            k != other && shared > BLENDED.powi(2) * variance(k) * variance(other)
        };
        // A misfit splits a strong pulse into two that are worth little each: the pulse as a whole is certain.
        let holds_all_light = |k: usize| {
            let mut blended = (0..count).filter(|&other| is_blended(k, other)).peekable();
            blended.peek().is_some() && !blended.any(is_certain)
        };
        (0..count).filter(|&k| is_certain(k) || holds_all_light(k)).collect()
    }

    fn edges(&self, stir: &Stir) -> Result<Vec<Onset>, StageError> {
        let profile = stir.profile.to_f64();
        let peak = largest(&profile, f64::NEG_INFINITY, |sample| sample);
        // A profile without any noise still has the rounding of its f32 samples.
        let noise = stir.profile_noise.max(f64::from(f32::EPSILON) * peak);
        if !(peak > 0.0 && peak >= self.threshold_sigma.get() * noise) {
            return Ok(Vec::new());
        }
        // Noise is Poisson's where light is counted: as much for each count of signal as for one of background.
        let per_level = stir.background.map_or(0.0, |background| noise * noise / background);
        let by_level = onset::Noise { sd: noise, per_level };
        let at_maximum = |crossing: Option<Crossing>| {
            crossing.map(|Crossing { position, sd, .. }| Edge { position, sd, height: peak }).into_iter().collect()
        };
        let edges: Vec<Edge> = match self.method {
            Method::ConstantFraction => {
                let delay = self.delay_ps.get() / stir.dt_ps;
                if delay < 1.0 {
                    return Err(StageError::Refused(format!(
                        "params.delay_ps = {} is less than one sample of {} ps",
                        self.delay_ps.get(),
                        stir.dt_ps
                    )));
                }
                at_maximum(onset::constant_fraction(&profile, self.fraction.get(), delay, by_level))
            }
            Method::FirstResponse => self.responses(&profile, noise).into_iter().map(|(_, edge)| edge).collect(),
            Method::Aic => self.beginnings(&profile, noise, self.window_ps.get() / stir.dt_ps),
            Method::LeadingEdge => at_maximum(onset::leading_edge(&profile, self.fraction.get(), by_level)),
            Method::Impulses => unreachable!("impulses are no edges"),
        };
        let edges: Vec<Edge> = if self.sampled { edges.into_iter().map(Edge::at_sample).collect() } else { edges };
        let count = edges.len();
        let onset = |(k, edge): (usize, &Edge)| {
            let time_ps = stir.t0_ps + edge.position * stir.dt_ps;
            let sd_ps = edge.sd * stir.dt_ps;
            let at_edge = edge.position < EDGE_SAMPLES || edge.position > profile.len() as f64 - EDGE_SAMPLES;
            Onset {
                rank: k as i32 + 1,
                time_ps,
                time_sd_ps: sd_ps,
                earliest_ps: Some(time_ps),
                amplitude: edge.height,
                snr: edge.height / noise,
                covariance: (0..count).map(|other| if other == k { sd_ps * sd_ps } else { 0.0 }).collect(),
                flags: flags(&[("at-edge", at_edge)]),
                ..blank(stir)
            }
        };
        Ok(edges.iter().enumerate().map(onset).collect())
    }

    /// Every response: the samples from its first one to where it falls below the level of re-arming, and its edge.
    fn responses(&self, profile: &[f64], noise: f64) -> Vec<(Range<usize>, Edge)> {
        let crossings = onset::responses(profile, self.threshold_sigma.get(), self.rearm_sigma.get(), noise);
        let response = |Crossing { position, sd, .. }: Crossing| {
            let first = position as usize;
            let low = profile[first..].iter().position(|sample| *sample < self.rearm_sigma.get() * noise);
            let reach = first..low.map_or(profile.len(), |low| first + low);
            let height = profile[reach.clone()].iter().copied().fold(f64::NEG_INFINITY, f64::max);
            (reach, Edge { position, sd, height })
        };
        crossings.into_iter().map(response).collect()
    }

    /// Where every response begins by Akaike's criterion; what is left of the response before it does not count.
    fn beginnings(&self, profile: &[f64], noise: f64, window: f64) -> Vec<Edge> {
        let mut start = 0;
        let mut edges = Vec::new();
        for (reach, Edge { height, .. }) in self.responses(profile, noise) {
            let stretch = &profile[start..reach.end];
            if let Some(place) = onset::akaike(stretch, window.ceil() as usize, noise) {
                let peak = stretch.iter().position(|sample| *sample == height).unwrap_or(stretch.len());
                let slope = height / (peak as f64 - place).max(1.0);
                let sd = (1.0 / 12.0 + (noise / slope).powi(2)).sqrt();
                edges.push(Edge { position: start as f64 + place, sd, height });
            }
            start = reach.end;
        }
        edges
    }
}

/// Amplitude over its standard deviation.
fn snr(impulse: &Impulse) -> f64 {
    impulse.amplitude_v.abs() / impulse.amplitude_sd_v
}

/// An onset of a profile, in samples.
struct Edge {
    position: f64,
    sd: f64,
    /// Largest sample of its response.
    height: f64,
}

impl Edge {
    /// Read off at the first sample beyond it, which rounding makes uncertain.
    fn at_sample(self) -> Self {
        Self { position: self.position.ceil(), sd: self.sd.hypot((1.0_f64 / 12.0).sqrt()), ..self }
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
        range: stir.range.clone(),
        acquired_at: stir.acquired_at.clone(),
        jitter_ps: stir.jitter_ps,
        power_ratio: stir.power_ratio,
        response_width: stir.response_width,
        response_width_sd: stir.response_width_sd,
        ..Onset::default()
    }
}

#[cfg(test)]
mod tests;
