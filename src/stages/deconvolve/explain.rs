//! Which impulses explain a record.

use serde::{Deserialize, Serialize};

use crate::cancel::Cancel;
use crate::signal::response::Response;
use crate::signal::sparse::{self, Pulse, SparseFit, SparseOptions, Unpiled};
use crate::tables::Impulse;

/// How the response is undone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Method {
    Sparse,
    Wiener,
    None,
}

/// What is asked of an explanation.
#[derive(Clone, Debug)]
pub(super) struct Asked {
    pub(super) evidence: Option<f64>,
    pub(super) impulses_max: usize,
    pub(super) signed: bool,
    pub(super) extent_max_ps: f64,
    pub(super) cancel: Cancel,
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
        let Self { evidence: evidence_min, impulses_max: pulses_max, signed, extent_max_ps, cancel } = self;
        SparseOptions { evidence_min, pulses_max, baseline: true, signed, extent_max_ps, cancel }
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
}
