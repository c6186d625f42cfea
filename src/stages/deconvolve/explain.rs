//! Which impulses explain a record.

use serde::{Deserialize, Serialize};

use crate::signal::response::Response;
use crate::signal::sparse::{self, Pair, Pulse, SparseFit, SparseOptions, Unpiled};
use crate::tables::{Impulse, ImpulsePair};

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
    /// Standard deviation of a baseline that moves.
    pub(super) ground_v: f64,
    /// Width of the response over the calibration's, and its standard deviation.
    pub(super) width: Option<[f64; 2]>,
}

/// Profiles of the same light by maximum likelihood off the grid, as the first of them sees it. Each comes with the
/// response that its pulses have in it.
pub(super) fn jointly(profiles: &[(sparse::Profile, &Response)], options: &SparseOptions) -> Explained {
    Explained::of(&sparse::fit_joint(profiles, options, false)[0], !options.predictions.is_empty())
}

/// Photon counts by their likelihood; of the profile only its time axis matters.
pub(super) fn counts(
    unpiled: &Unpiled,
    (profile, response): (sparse::Profile, &Response),
    options: &SparseOptions,
) -> Explained {
    let fit = sparse::fit_counts(unpiled, profile.t0_ps, profile.dt_ps, response, options);
    Explained::of(&fit, !options.predictions.is_empty())
}

impl Explained {
    fn of(fit: &SparseFit, are_predicted: bool) -> Self {
        let impulse = |pulse: &Pulse| Impulse {
            time_ps: pulse.time_ps,
            time_sd_ps: pulse.time_sd_ps,
            amplitude_v: pulse.amplitude_v,
            amplitude_sd_v: pulse.amplitude_sd_v,
            // A Gaussian and the tail behind it together.
            width_ps: pulse.width_ps.hypot(pulse.tail_ps),
            evidence: pulse.evidence,
            misfit_sigma: pulse.misfit_sigma,
            misfit_factor: pulse.misfit_factor,
            width_sd_ps: width_sd_ps(pulse),
            width_kurtosis: (pulse.width_ps > 0.0).then_some(pulse.kurtosis),
            width_tilt: (pulse.width_ps > 0.0).then_some(pulse.tilt),
            tail_ps: (pulse.tail_ps > 0.0).then_some(pulse.tail_ps),
            own_time_ps: are_predicted.then_some(pulse.own_time_ps),
            own_variance_ps2: are_predicted.then_some(pulse.own_variance_ps2 + pulse.tail_ps * pulse.tail_ps),
            pair: pulse.pair.as_ref().map(pair),
        };
        let impulses = fit.pulses.iter().map(impulse).collect();
        Self {
            impulses,
            covariance_ps2: fit.covariance_ps2.clone(),
            chi2_dof: fit.chi2_per_dof,
            ground_v: fit.ground_v,
            width: fit.width,
        }
    }
}

/// Of a Gaussian and the tail behind it together; `None` for a point.
fn width_sd_ps(pulse: &Pulse) -> Option<f64> {
    let width_ps = pulse.width_ps.hypot(pulse.tail_ps);
    let parts = (pulse.width_ps * pulse.width_sd_ps).hypot(pulse.tail_ps * pulse.tail_sd_ps);
    (width_ps > 0.0).then(|| parts / width_ps)
}

fn pair(pair: &Pair) -> ImpulsePair {
    let [of_first, of_both, of_second] = pair.covariance_ps2;
    ImpulsePair {
        first_ps: pair.times_ps[0],
        second_ps: pair.times_ps[1],
        first_sd_ps: of_first.sqrt(),
        second_sd_ps: of_second.sqrt(),
        correlation: of_both / (of_first * of_second).sqrt(),
        first_amplitude_v: pair.amplitudes_v[0],
        second_amplitude_v: pair.amplitudes_v[1],
        gain: pair.gain,
    }
}
