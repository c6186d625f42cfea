//! Pulses as `nnls`, `pencil` and `richardson_lucy` return them, and their refinement by least squares.
//!
//! They take the profile and the response that [`periscope_signal::sparse`] takes, but without a baseline.
//!
//! Refinement: Gauss-Newton on times and amplitudes, `J = [h(t - t_k), -a_k h'(t - t_k)]`, with the step halved until
//! chi2 falls. The number of pulses stays. From a start near the optimum it ends at the maximum of the likelihood,
//! whose covariance is `(J^T W J)^-1`.

use periscope_signal::regression::{Regression, least_squares};
use periscope_signal::response::Response;
use periscope_signal::sparse::Profile;

/// Gauss-Newton steps after which a refinement ends.
const STEPS: usize = 40;
/// Largest move of a pulse in one step, in widths of the response.
const STEP_WIDTHS: f64 = 0.32;
/// Halvings of a step after which it is given up.
const HALVINGS: usize = 12;
/// A drop of chi2 below this ends the refinement.
const PROMISE: f64 = 1e-6;

/// A pulse whose amplitude is worth this many times the evidence asked for, to first order, is not tried without. (Its
/// neighbours fitted again would make up for a part of it.)
const WALD: f64 = 4.0;

/// Pulses of a profile by rising time.
#[derive(Clone, Debug, PartialEq)]
pub struct Pulses {
    /// Arrivals, ps: where time 0 of the response lies.
    pub times_ps: Vec<f64>,
    /// Factors of the response, V for a response whose maximum is 1.
    pub amplitudes_v: Vec<f64>,
    /// Covariance of the times, ps^2, row-major; `None` where the method has none, or two pulses cannot be resolved.
    pub covariance_ps2: Option<Vec<f64>>,
    /// Sum of squared residuals over their variances.
    pub chi2: f64,
}

impl Pulses {
    /// Pulses at `times_ps`, sorted, their amplitudes by least squares without a bound; `covariance_ps2` is left empty.
    /// `None` if two pulses cannot be resolved.
    #[must_use]
    pub fn at(profile: &Profile, response: &Response, mut times_ps: Vec<f64>) -> Option<Self> {
        times_ps.sort_by(f64::total_cmp);
        if times_ps.is_empty() {
            return Some(Self::none(profile));
        }
        let rows = Rows::new(profile, response, &times_ps);
        let columns: Vec<Vec<f64>> = times_ps.iter().map(|t| rows.column(profile, response, *t).0).collect();
        let fit = rows.least_squares(&columns)?;
        Some(Self { times_ps, amplitudes_v: fit.values, covariance_ps2: None, chi2: fit.chi2 })
    }

    /// Pulses with given amplitudes, sorted by time; `covariance_ps2` is left empty.
    ///
    /// # Panics
    /// If there is not an amplitude for each time.
    #[must_use]
    pub fn with_amplitudes(profile: &Profile, response: &Response, times_ps: &[f64], amplitudes_v: &[f64]) -> Self {
        assert_eq!(times_ps.len(), amplitudes_v.len(), "an amplitude for each time");
        let mut order: Vec<usize> = (0..times_ps.len()).collect();
        order.sort_by(|i, j| times_ps[*i].total_cmp(&times_ps[*j]));
        let mut residual = profile.mean_v.to_vec();
        for (time_ps, a) in times_ps.iter().zip(amplitudes_v) {
            for n in response.reach(*time_ps, profile.t0_ps, profile.dt_ps, residual.len()) {
                residual[n] -= a * response.value(profile.t0_ps + n as f64 * profile.dt_ps - time_ps);
            }
        }
        Self {
            times_ps: order.iter().map(|k| times_ps[*k]).collect(),
            amplitudes_v: order.iter().map(|k| amplitudes_v[*k]).collect(),
            covariance_ps2: None,
            chi2: residual.iter().zip(profile.sd_v).map(|(r, sd)| (r / sd).powi(2)).sum(),
        }
    }

    /// No pulse.
    #[must_use]
    pub fn none(profile: &Profile) -> Self {
        let chi2 = profile.mean_v.iter().zip(profile.sd_v).map(|(y, sd)| (y / sd).powi(2)).sum();
        Self { times_ps: Vec::new(), amplitudes_v: Vec::new(), covariance_ps2: Some(Vec::new()), chi2 }
    }

    /// Standard deviation of time `k`, ps.
    #[must_use]
    pub fn time_sd_ps(&self, k: usize) -> Option<f64> {
        self.covariance_ps2.as_ref().map(|c| c[k * (self.times_ps.len() + 1)].sqrt())
    }

    /// The same with the covariance of a least-squares fit at these pulses, `(J^T W J)^-1`.
    #[must_use]
    pub fn with_covariance(self, profile: &Profile, response: &Response) -> Self {
        let covariance_ps2 = if self.times_ps.is_empty() {
            Some(Vec::new())
        } else {
            self.linearised(profile, response).map(|fit| time_block(&fit))
        };
        Self { covariance_ps2, ..self }
    }

    /// Of each pulse, the standard deviation of its amplitude (V) in the least-squares fit at these pulses, and its
    /// evidence: by how much chi2 rises without it when the others are fitted again. Where two pulses cannot be
    /// resolved, each has the standard deviation that it would have alone.
    #[must_use]
    pub fn judged(&self, profile: &Profile, response: &Response) -> Vec<(f64, f64)> {
        let fit = self.linearised(profile, response);
        let judge = |k: usize| {
            let alone = || self.alone(k).linearised(profile, response).map_or(f64::INFINITY, |fit| fit.sd(0));
            let sd_v = fit.as_ref().map_or_else(alone, |fit| fit.sd(k));
            let mut others_ps = self.times_ps.clone();
            others_ps.remove(k);
            let start = Self::at(profile, response, others_ps);
            let refined = start.clone().and_then(|start| start.refined(profile, response));
            let without = refined.or(start).map_or(f64::INFINITY, |pulses| pulses.chi2);
            (sd_v, (without - self.chi2).max(0.0))
        };
        (0..self.times_ps.len()).map(judge).collect()
    }

    /// Pulse `k` without the others; chi2 stays theirs together.
    ///
    /// # Panics
    /// If there is no such pulse.
    #[must_use]
    pub fn alone(&self, k: usize) -> Self {
        let (times_ps, amplitudes_v) = (vec![self.times_ps[k]], vec![self.amplitudes_v[k]]);
        Self { times_ps, amplitudes_v, covariance_ps2: None, chi2: self.chi2 }
    }

    /// The least-squares fit next to these pulses, with its covariance. `None` if two pulses coincide or an amplitude
    /// is not positive.
    #[must_use]
    pub fn refined(self, profile: &Profile, response: &Response) -> Option<Self> {
        if self.times_ps.is_empty() {
            return Some(Self::none(profile));
        }
        let step_max_ps = STEP_WIDTHS * response.width_ps();
        let mut best = Self::at(profile, response, self.times_ps)?;
        for _ in 0..STEPS {
            let Some(trial) = best.stepped(profile, response, step_max_ps) else { break };
            let drop = best.chi2 - trial.chi2;
            best = trial;
            if drop < PROMISE {
                break;
            }
        }
        let positive = best.amplitudes_v.iter().all(|a| *a > 0.0);
        Some(best.with_covariance(profile, response)).filter(|best| positive && best.covariance_ps2.is_some())
    }

    /// Refined pulses with those taken out, or merged with their neighbour, whose loss raises chi2 by less than
    /// `evidence_min`, the least first. Where [`Pulses::refined`] finds no fit, the two nearest pulses are merged
    /// first.
    #[must_use]
    pub fn pruned(mut self, profile: &Profile, response: &Response, evidence_min: f64) -> Self {
        let mut best = loop {
            match self.clone().refined(profile, response) {
                Some(refined) => break refined,
                None => self = self.with_nearest_merged(profile, response),
            }
        };
        loop {
            let candidates = best.with_one_less(profile, response, WALD * evidence_min);
            let fewer = candidates.into_iter().filter_map(|times_ps| {
                let start = Self::at(profile, response, times_ps)?;
                start.refined(profile, response)
            });
            match fewer.min_by(|a, b| a.chi2.total_cmp(&b.chi2)) {
                Some(fewer) if fewer.chi2 - best.chi2 < evidence_min => best = fewer,
                _ => return best,
            }
        }
    }

    /// Trials with one pulse less. One trial for each pulse whose amplitude, squared over its variance, is below
    /// `evidence_max`: without it. One for each two neighbours within a width of the response: both at their centroid.
    fn with_one_less(&self, profile: &Profile, response: &Response, evidence_max: f64) -> Vec<Vec<f64>> {
        let count = self.times_ps.len();
        let fit = self.linearised(profile, response);
        let evidence = |k: usize| fit.as_ref().map_or(0.0, |fit| fit.values[k].powi(2) / fit.covariance[k][k]);
        let without = |k: usize| {
            let mut times_ps = self.times_ps.clone();
            times_ps.remove(k);
            times_ps
        };
        let near = |k: &usize| self.times_ps[k + 1] - self.times_ps[*k] < response.width_ps();
        let weak = (0..count).filter(|k| evidence(*k) < evidence_max).map(without);
        weak.chain((1..count).map(|k| k - 1).filter(near).map(|k| self.merged(k).0)).collect()
    }

    /// Times and amplitudes with pulses `k` and `k + 1` at their centroid.
    fn merged(&self, k: usize) -> (Vec<f64>, Vec<f64>) {
        let (mut times_ps, mut amplitudes_v) = (self.times_ps.clone(), self.amplitudes_v.clone());
        let (early_ps, early_v) = (times_ps.remove(k), amplitudes_v.remove(k));
        let share = early_v / (early_v + amplitudes_v[k]);
        // Amplitudes of opposite sign have no centroid between them.
        times_ps[k] += if (0.0..=1.0).contains(&share) { share * (early_ps - times_ps[k]) } else { 0.0 };
        amplitudes_v[k] += early_v;
        (times_ps, amplitudes_v)
    }

    /// The two nearest pulses merged; a pulse alone goes.
    fn with_nearest_merged(&self, profile: &Profile, response: &Response) -> Self {
        let gap_ps = |k: usize| self.times_ps[k + 1] - self.times_ps[k];
        let nearest = (1..self.times_ps.len()).map(|k| k - 1).min_by(|i, j| gap_ps(*i).total_cmp(&gap_ps(*j)));
        nearest.map_or_else(
            || Self::none(profile),
            |k| {
                let (times_ps, amplitudes_v) = self.merged(k);
                Self::with_amplitudes(profile, response, &times_ps, &amplitudes_v)
            },
        )
    }

    /// One Gauss-Newton step, halved until chi2 falls.
    fn stepped(&self, profile: &Profile, response: &Response, step_max_ps: f64) -> Option<Self> {
        let count = self.times_ps.len();
        let fit = self.linearised(profile, response)?;
        let step = |k: usize| fit.values[count + k].clamp(-step_max_ps, step_max_ps);
        (0..HALVINGS).find_map(|halvings| {
            let factor = 0.5_f64.powi(halvings as i32);
            let times_ps = (0..count).map(|k| self.times_ps[k] + factor * step(k)).collect();
            Self::at(profile, response, times_ps).filter(|trial| trial.chi2 < self.chi2)
        })
    }

    /// Amplitudes, then shifts of the times. `None` without pulses, or if two cannot be resolved.
    fn linearised(&self, profile: &Profile, response: &Response) -> Option<Regression> {
        if self.times_ps.is_empty() {
            return None;
        }
        let rows = Rows::new(profile, response, &self.times_ps);
        let pairs: Vec<(Vec<f64>, Vec<f64>)> =
            self.times_ps.iter().map(|t| rows.column(profile, response, *t)).collect();
        let (mut columns, slopes): (Vec<_>, Vec<_>) = pairs.into_iter().unzip();
        for (mut slope, a) in slopes.into_iter().zip(&self.amplitudes_v) {
            slope.iter_mut().for_each(|s| *s *= -a);
            columns.push(slope);
        }
        rows.least_squares(&columns)
    }
}

/// The samples that pulses reach: of a long record the few that a fit is about.
struct Rows {
    samples: Vec<usize>,
    mean_v: Vec<f64>,
    sd_v: Vec<f64>,
    /// Chi2 of the other samples, which no pulse changes.
    other_chi2: f64,
}

impl Rows {
    fn new(profile: &Profile, response: &Response, times_ps: &[f64]) -> Self {
        let len = profile.mean_v.len();
        let mut reached = vec![false; len];
        for time_ps in times_ps {
            reached[response.reach(*time_ps, profile.t0_ps, profile.dt_ps, len)].fill(true);
        }
        let samples: Vec<usize> = (0..len).filter(|n| reached[*n]).collect();
        let others = (0..len).filter(|n| !reached[*n]);
        Self {
            mean_v: samples.iter().map(|n| profile.mean_v[*n]).collect(),
            sd_v: samples.iter().map(|n| profile.sd_v[*n]).collect(),
            other_chi2: others.map(|n| (profile.mean_v[n] / profile.sd_v[n]).powi(2)).sum(),
            samples,
        }
    }

    /// Response and its slope.
    fn column(&self, profile: &Profile, response: &Response, time_ps: f64) -> (Vec<f64>, Vec<f64>) {
        let after_ps = |n: &usize| profile.t0_ps + *n as f64 * profile.dt_ps - time_ps;
        self.samples.iter().map(|n| response.value_and_slope(after_ps(n))).unzip()
    }

    /// The fit, its chi2 that of the whole record.
    fn least_squares(&self, columns: &[Vec<f64>]) -> Option<Regression> {
        let fit = least_squares(columns, &self.mean_v, &self.sd_v)?;
        Some(Regression { chi2: fit.chi2 + self.other_chi2, ..fit })
    }
}

fn time_block(fit: &Regression) -> Vec<f64> {
    let count = fit.values.len() / 2;
    (0..count * count).map(|e| fit.covariance[count + e / count][count + e % count]).collect()
}

#[cfg(test)]
mod tests;
