//! The state of a fit between its changes, and how well it fits.

use super::column::Column;
use super::linear::Cholesky;
use super::model::Model;
use super::place::Place;
use super::projection::Projection;

/// Standard deviations of chi2 that a misfit must exceed.
const MISFIT_SIGMA: f64 = 3.0;

/// Pulses that fit whole records best, near where they were started.
pub(super) struct State {
    pub(super) fit: Projection,
    /// Records less pulses, whitened, and freed of what lies under them.
    pub(super) residuals: Vec<Vec<f64>>,
    pub(super) baselines_v: Vec<f64>,
    /// Factor of the information matrix.
    pub(super) factor: Cholesky,
}

/// Chi2 of samples, its degrees of freedom, and its variance if the model is right.
pub(super) struct Misfit {
    pub(super) chi2: f64,
    pub(super) freedom: f64,
    pub(super) variance: f64,
}

impl Misfit {
    pub(super) fn plus(self, other: Self) -> Self {
        Self {
            chi2: self.chi2 + other.chi2,
            freedom: self.freedom + other.freedom,
            variance: self.variance + other.variance,
        }
    }

    /// Chi2 per degree of freedom.
    pub(super) fn per_dof(&self) -> f64 {
        self.chi2 / self.freedom.max(1.0)
    }

    /// Factor of a standard deviation: the root of chi2 per degree of freedom, where noise alone does not explain it.
    /// (Multiplying by whatever exceeds 1 would widen every second interval of a right model.)
    pub(super) fn inflation(&self) -> f64 {
        if self.sigma() > MISFIT_SIGMA { self.per_dof().sqrt() } else { 1.0 }
    }

    /// By how many of its standard deviations chi2 exceeds its degrees of freedom.
    pub(super) fn sigma(&self) -> f64 {
        (self.chi2 - self.freedom.max(1.0)) / self.variance.max(2.0).sqrt()
    }
}

impl State {
    pub(super) fn pulses(&self) -> usize {
        self.fit.places.len()
    }

    pub(super) fn time_ps(&self, k: usize) -> f64 {
        self.fit.places[k].time_ps
    }

    pub(super) fn place(&self, k: usize) -> Place {
        self.fit.places[k]
    }

    /// Amplitude of pulse `k` in group `g` of records.
    pub(super) fn amplitude_of(&self, g: usize, k: usize) -> f64 {
        self.fit.groups[g].amplitudes[k]
    }

    /// Sum of the amplitudes of pulse `k` over the groups.
    pub(super) fn amplitude(&self, k: usize) -> f64 {
        self.fit.groups.iter().map(|group| group.amplitudes[k]).sum()
    }

    pub(super) fn baseline_v(&self, r: usize) -> f64 {
        self.baselines_v[r]
    }

    pub(super) fn columns(&self, model: &Model, r: usize) -> &[Column] {
        let both = self.fit.groups.iter().zip(&model.groups);
        let columns =
            both.filter(|(_, range)| range.contains(&r)).map(|(group, range)| &group.columns[r - range.start]);
        columns.into_iter().next().expect("each record is in a group")
    }

    /// Covariance of all unknowns, row-major, and their number: amplitude of pulse k in group g at `g * K + k`, then
    /// the parameters of the places.
    pub(super) fn covariance(&self) -> (Vec<f64>, usize) {
        (self.factor.inverse(), self.fit.unknowns())
    }

    /// Standard deviation of the time of pulse `k`, to first order.
    pub(super) fn time_sd_ps(&self, k: usize) -> f64 {
        let mut column = vec![0.0; self.fit.unknowns()];
        column[self.time_unknown(k)] = 1.0;
        self.factor.solve_lower(&mut column);
        column.iter().map(|v| v * v).sum::<f64>().sqrt()
    }

    /// Place of the time of pulse `k` among the unknowns; those of its shape follow it.
    pub(super) fn time_unknown(&self, k: usize) -> usize {
        self.fit.time_unknown(k)
    }
}
