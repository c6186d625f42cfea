//! Which impulses explain a record, by each of the methods that find impulses.

use serde::{Deserialize, Serialize};

use crate::signal::nnls::{self, NnlsOptions};
use crate::signal::noise;
use crate::signal::pencil::{self, PencilOptions};
use crate::signal::pulses::Pulses;
use crate::signal::response::Response;
use crate::signal::richardson_lucy::{self, RichardsonLucyOptions};
use crate::signal::sparse::{self, Pulse, SparseFit, SparseOptions, Unpiled};
use crate::tables::Impulse;

/// False impulses a record of noise alone, where the pipeline asks for no evidence of its own.
const FALSE_IMPULSES: f64 = 1e-4;
/// Atoms of `nnls` no more grid steps apart than this are one impulse; closer ones are left to the pruning.
const MERGE_STEPS: f64 = 1.5;
/// Fine steps in a sample of the response without its negative parts.
const POSITIVE_STEPS: f64 = 16.0;

/// How the response is undone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Method {
    Sparse,
    Nnls,
    Pencil,
    RichardsonLucy,
    Wiener,
    None,
}

/// What is asked of an explanation.
#[derive(Clone, Copy, Debug)]
pub(super) struct Asked {
    pub(super) evidence: Option<f64>,
    pub(super) impulses_max: usize,
    pub(super) signed: bool,
    pub(super) extent_max_ps: f64,
}

/// A mean record, turned upwards, and the response that its pulses have in it.
pub(super) struct Record<'a> {
    pub(super) samples: &'a [f64],
    /// Standard deviation of each sample; infinite for one to be ignored.
    pub(super) sd_v: &'a [f64],
    /// Autocorrelation of the noise.
    pub(super) acf: &'a [f64],
    pub(super) t0_ps: f64,
    pub(super) dt_ps: f64,
    pub(super) response: &'a Response,
}

/// Impulses of a record, all amplitudes as in the record turned upwards.
pub(super) struct Explained {
    pub(super) impulses: Vec<Impulse>,
    /// Covariance of the times, ps^2, row by row.
    pub(super) covariance_ps2: Vec<f64>,
    pub(super) chi2_dof: f64,
}

/// Records of the same light by maximum likelihood off the grid, as the first of them sees it.
pub(super) fn jointly(records: &[Record], asked: Asked) -> Explained {
    let profiles: Vec<(sparse::Profile, &Response)> =
        records.iter().map(|record| (record.profile(), record.response)).collect();
    Explained::of(&sparse::fit_joint(&profiles, &asked.options(), false)[0])
}

impl Asked {
    fn options(self) -> SparseOptions {
        let Self { evidence, impulses_max, signed, extent_max_ps } = self;
        SparseOptions { evidence_min: evidence, pulses_max: impulses_max, baseline: true, signed, extent_max_ps }
    }
}

impl Explained {
    fn of(fit: &SparseFit) -> Self {
        let count = fit.pulses.len();
        let impulse = |(k, pulse): (usize, &Pulse)| Impulse {
            time_ps: pulse.time_ps,
            time_sd_ps: fit.covariance_ps2[k * count + k].sqrt(),
            amplitude_v: pulse.amplitude_v,
            amplitude_sd_v: pulse.amplitude_sd_v,
            // A Gaussian and the tail behind it together.
            width_ps: pulse.width_ps.hypot(pulse.tail_ps),
            evidence: pulse.evidence,
            misfit_sigma: pulse.misfit_sigma,
        };
        let impulses = fit.pulses.iter().enumerate().map(impulse).collect();
        Self { impulses, covariance_ps2: fit.covariance_ps2.clone(), chi2_dof: fit.chi2_per_dof }
    }
}

impl Record<'_> {
    fn profile(&self) -> sparse::Profile<'_> {
        let Self { samples: mean_v, sd_v, acf, t0_ps, dt_ps, .. } = *self;
        sparse::Profile { mean_v, sd_v, acf, t0_ps, dt_ps }
    }

    /// Photon counts, by their likelihood.
    pub(super) fn counts(&self, unpiled: &Unpiled, asked: Asked) -> Explained {
        Explained::of(&sparse::fit_counts(unpiled, self.t0_ps, self.dt_ps, self.response, &asked.options()))
    }

    /// By a method of comparison: noise taken as white, the baseline removed before.
    pub(super) fn compared(&self, method: Method, asked: Asked) -> Explained {
        let samples = self.without_baseline();
        let response = self.response;
        let record = sparse::Profile { mean_v: &samples, acf: &[1.0], ..self.profile() };
        let evidence_min = asked.evidence.unwrap_or_else(|| sparse::evidence_min_of(&record, response, FALSE_IMPULSES));
        let pulses = match method {
            Method::Pencil => {
                let options = PencilOptions { pulses_max: asked.impulses_max, ..PencilOptions::default() };
                pencil::fit(&record, response, &options).pruned(&record, response, evidence_min)
            }
            Method::RichardsonLucy => {
                let options = RichardsonLucyOptions::default();
                richardson_lucy::fit(&record, &self.positive_response(), &options).with_covariance(&record, response)
            }
            _ => {
                let options = NnlsOptions { merge_steps: MERGE_STEPS, ..NnlsOptions::default() };
                nnls::fit(&record, response, &options).pruned(&record, response, evidence_min)
            }
        };
        explained(&pulses, &record, response)
    }

    /// The samples less the mean of those that no light reaches.
    fn without_baseline(&self) -> Vec<f64> {
        let (first_ps, last_ps) = self.response.support_ps();
        let peak_ps = self.response.peak_ps();
        let before = ((peak_ps - first_ps) / self.dt_ps).ceil() as usize;
        let after = ((last_ps - peak_ps) / self.dt_ps).ceil() as usize;
        let baseline_v = noise::quiet_mean(self.samples, self.usual_sd_v(), before, after).unwrap_or(0.0);
        self.samples.iter().map(|sample| sample - baseline_v).collect()
    }

    /// The median of the samples' standard deviations.
    fn usual_sd_v(&self) -> f64 {
        let mut sorted = self.sd_v.to_vec();
        let half = sorted.len() / 2;
        *sorted.select_nth_unstable_by(half, f64::total_cmp).1
    }

    /// The response without the ringing below zero that averaging gives it, which light on a grid must not have.
    fn positive_response(&self) -> Response {
        let (first_ps, last_ps) = self.response.support_ps();
        let step_ps = self.dt_ps / POSITIVE_STEPS;
        let count = ((last_ps - first_ps) / step_ps).floor().max(1.0) as usize + 1;
        let value = |i: usize| self.response.value(first_ps + i as f64 * step_ps).max(0.0);
        Response::new(first_ps, step_ps, &(0..count).map(value).collect::<Vec<_>>())
    }
}

fn explained(pulses: &Pulses, record: &sparse::Profile, response: &Response) -> Explained {
    let count = pulses.times_ps.len();
    let alone_ps2 = |k: usize| {
        let sd_ps = pulses.alone(k).with_covariance(record, response).time_sd_ps(0);
        sd_ps.map_or(f64::INFINITY, |sd_ps| sd_ps * sd_ps)
    };
    // Where two pulses cannot be told apart, each counts as if it were alone.
    let covariance_ps2 = pulses.covariance_ps2.clone().unwrap_or_else(|| {
        let variances: Vec<f64> = (0..count).map(alone_ps2).collect();
        (0..count * count).map(|e| if e / count == e % count { variances[e / count] } else { 0.0 }).collect()
    });
    let dof = record.mean_v.len().saturating_sub(2 * count + 1).max(1) as f64;
    let impulse = |(k, (amplitude_sd_v, evidence)): (usize, (f64, f64))| Impulse {
        time_ps: pulses.times_ps[k],
        time_sd_ps: covariance_ps2[k * count + k].sqrt(),
        amplitude_v: pulses.amplitudes_v[k],
        amplitude_sd_v,
        width_ps: 0.0,
        evidence,
        misfit_sigma: (pulses.chi2 - dof) / (2.0 * dof).sqrt(),
    };
    let impulses = pulses.judged(record, response).into_iter().enumerate().map(impulse).collect();
    Explained { impulses, covariance_ps2, chi2_dof: pulses.chi2 / dof }
}
