//! Onsets that scatter more than their standard deviations say: which kind of them does, and by how much.
//!
//! Onsets of one kind share their causes of error: the shape of a patch's light, other light in the same pulse, a pulse
//! that is read as two. Of each kind the squared residuals are compared with what noise leaves of them, the sum of the
//! redundancies (the share of an onset's information that others check). Beyond the 99.9 % point of chi-square their
//! ratio is the factor on the variances of that kind (variance components: Foerstner, 1979), and all is solved again,
//! so that the other kinds count the more.

use crate::geometry::maximum_likelihood::{Problem, Solution, by_chance};
use crate::tables::{Label, ONSET_KINDS};

/// A residual counts no more than this many standard deviations: a wrong label says nothing of the others.
const MOST: f64 = 3.0;
/// Where nearly all onsets of a kind contradict the others, nothing more can be said of variances.
const INSIDE_MIN: f64 = 0.1;

/// Position of an onset's kind.
pub const fn kind(label: &Label) -> usize {
    match (label.part, label.bounces) {
        (1.., _) => 3,
        (_, ..=1) => 0,
        (_, 2) => 1,
        (_, _) => 2,
    }
}

/// What the onsets of one kind leave.
#[derive(Clone, Copy, Default)]
struct Kind {
    squares: f64,
    redundancy: f64,
    onsets: f64,
    inside: f64,
}

impl Kind {
    /// The factor, with the correction of an M-estimator for residuals that count less.
    fn factor(self) -> f64 {
        let is_chance = self.redundancy < 1.0 || self.squares <= by_chance(self.redundancy);
        let inside = (self.inside / self.onsets).max(INSIDE_MIN);
        if is_chance { 1.0 } else { self.squares / self.redundancy / (inside * inside) }
    }
}

/// Factors on the variances of all kinds, 1 where chance explains their residuals; `kinds` are those of the problem's
/// observations. All 1 of solutions without predicted variances.
pub fn factors(problem: &Problem, solution: &Solution, kinds: &[usize]) -> [f64; ONSET_KINDS.len()] {
    let mut all = [Kind::default(); ONSET_KINDS.len()];
    let Some(predicted_m2) = &solution.predicted_variance_m2 else { return [1.0; ONSET_KINDS.len()] };
    for (n, (observation, kind)) in problem.observations.iter().zip(kinds).enumerate() {
        let (own_m2, size) = (observation.sd_m * observation.sd_m, (solution.residuals_m[n] / observation.sd_m).abs());
        let of_kind = &mut all[*kind];
        of_kind.squares += size.min(MOST).powi(2);
        of_kind.redundancy += (1.0 - predicted_m2[n] / own_m2).clamp(0.0, 1.0);
        of_kind.onsets += 1.0;
        of_kind.inside += f64::from(u8::from(size <= MOST));
    }
    all.map(Kind::factor)
}
