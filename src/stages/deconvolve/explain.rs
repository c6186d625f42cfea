//! Which impulses explain a record.

use serde::{Deserialize, Serialize};

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

/// Impulses of a record, all amplitudes as in the record turned upwards.
pub(super) struct Explained {
    pub(super) impulses: Vec<Impulse>,
    /// Covariance of the times, ps^2, row by row.
    pub(super) covariance_ps2: Vec<f64>,
    pub(super) chi2_dof: f64,
}

/// Profiles of the same light by maximum likelihood off the grid, as the first of them sees it. Each comes with the
/// response that its pulses have in it.
pub(super) fn jointly(profiles: &[(sparse::Profile, &Response)], options: &SparseOptions) -> Explained {
    Explained::of(&sparse::fit_joint(profiles, options, false)[0])
}

/// Photon counts by their likelihood; of the profile only its time axis matters.
pub(super) fn counts(
    unpiled: &Unpiled,
    (profile, response): (sparse::Profile, &Response),
    options: &SparseOptions,
) -> Explained {
    Explained::of(&sparse::fit_counts(unpiled, profile.t0_ps, profile.dt_ps, response, options))
}

impl Explained {
    fn of(fit: &SparseFit) -> Self {
        let impulse = |(k, pulse): (usize, &Pulse)| Impulse {
            time_ps: pulse.time_ps,
            time_sd_ps: fit.time_sd_ps(k),
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
