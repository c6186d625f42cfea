//! Solutions as rows.

use nalgebra::Matrix3;

use super::model::Model;
use crate::geometry::Point;
use crate::geometry::bistatic::{Bounce, Solution};
use crate::priors::{covariances, scenes};
use crate::tables::{Label, Patch, PatchCovariance};
use crate::units::PatchId;

impl Model {
    /// Diffuser points and strips of the best solution, strips of the others.
    pub(super) fn patches(&self, solutions: &[Solution]) -> Vec<Patch> {
        let mut rows = Vec::new();
        for (alternative, solution) in solutions.iter().enumerate() {
            let row = |patch: PatchId, kind: &str, at: Point, cov_m2: Matrix3<f64>, onsets: usize| Patch {
                // Rounding may leave the variances of an exact patch below zero.
                sd_m: Some(cov_m2.trace().max(0.0).sqrt()),
                onsets: onsets as i32,
                chi2_dof: (solution.degrees_of_freedom > 0).then(|| solution.chi2 / solution.degrees_of_freedom as f64),
                alternative: alternative as i32,
                log_likelihood: Some(-0.5 * solution.cost),
                ..covariances::patch_row(patch, kind, at, Some(&cov_m2))
            };
            if alternative == 0 {
                rows.extend(self.points.iter().zip(&solution.anchors).enumerate().map(|(n, (patch, (at, cov)))| {
                    let firsts = self.problem.records.iter();
                    let onsets = firsts.filter(|record| record.bounce == Bounce::First && record.lit == n).count();
                    row(*patch, "visible", *at, *cov, onsets)
                }));
            }
            rows.extend(self.strips.iter().zip(&solution.points).enumerate().map(|(n, (patch, at))| {
                row(*patch, "hidden", *at, solution.covariance_of(n, n), solution.labels.len())
            }));
        }
        scenes::share_likelihood(&mut rows);
        rows
    }

    /// Covariances between the strips of the best solution.
    pub(super) fn covariances(&self, solutions: &[Solution]) -> Vec<PatchCovariance> {
        let mut rows = Vec::new();
        let Some(best) = solutions.first() else { return rows };
        for a in 0..self.strips.len() {
            for b in a + 1..self.strips.len() {
                rows.push(covariances::row(self.strips[a], self.strips[b], &best.covariance_of(a, b)));
            }
        }
        rows
    }

    /// What each onset is, by every solution.
    pub(super) fn labels(&self, solutions: &[Solution]) -> Vec<Label> {
        let weights: Vec<f64> = solutions.iter().map(|other| (-0.5 * (other.cost - solutions[0].cost)).exp()).collect();
        let total: f64 = weights.iter().sum();
        let mut rows = Vec::new();
        for (alternative, (solution, weight)) in solutions.iter().zip(&weights).enumerate() {
            for (record, strips) in &solution.labels {
                for (strip, onset) in strips.iter().enumerate() {
                    let (onset, turns) = &self.onsets[*record][*onset];
                    let of = &self.problem.records[*record];
                    let exit = self.problem.strips[strip].exit;
                    rows.push(Label {
                        campaign: onset.campaign.clone(),
                        sensor: onset.sensor.clone(),
                        lit: onset.lit,
                        seen: onset.seen,
                        range: onset.range.clone(),
                        acquired_at: onset.acquired_at.clone(),
                        rank: onset.rank,
                        part: 0,
                        time_ps: self.medium.time_ps(of.lengths_m[strips[strip]]),
                        time_sd_ps: onset.time_sd_ps.hypot(onset.jitter_ps),
                        covariance: if alternative == 0 { covariances::of_onset_ps2(onset) } else { Vec::new() },
                        width_ps: Some(onset.width_ps),
                        width_sd_ps: onset.width_sd_ps,
                        own_variance_ps2: onset.own_variance_ps2,
                        width_kurtosis: onset.width_kurtosis,
                        snr: onset.snr,
                        turns: *turns,
                        bounces: 3,
                        path: Some(vec![self.points[of.lit], self.strips[strip], self.points[exit]]),
                        residual_ps: None,
                        probability: weight / total,
                        alternative: alternative as i32,
                    });
                }
            }
        }
        rows.sort_by(|a, b| {
            let key = |row: &Label| (row.alternative, row.sensor.clone(), row.lit, row.seen, row.rank);
            key(a).cmp(&key(b))
        });
        rows
    }
}
