//! The vectors of all patches at once: each depends on its neighbours', since a pulse has the widths of two or three.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use periscope_cancel::Cancel;

use super::{ALIKE, Fit, LINEAR, TIGHTER};

/// Steps while gross errors still count, and to the minimum.
const STEPS_EACH: usize = 4;
const STEPS_LAST: usize = 40;
/// So many steps that lower the loss by less than this lead nowhere.
const IDLE: usize = 3;
const IDLE_LOSS: f64 = 1e-4;
/// No coordinate counts as less certain than this share of the usual one, in damping and in covariances.
const LEAST: f64 = 1e-3;
const LEAST_KNOWN: f64 = 1e-9;
const DAMPING_MAX: f64 = 1e8;

/// What is left of all pulses, linearised: the normal matrix of all open vectors and the common variance, and its
/// right-hand side.
struct Linearised {
    normal: DMatrix<f64>,
    slope: DVector<f64>,
}

impl Linearised {
    /// The usual diagonal element of a vector's coordinate.
    fn usual(&self) -> f64 {
        let coordinates = self.normal.nrows() - 1;
        self.normal.diagonal().rows(0, coordinates).sum() / coordinates.max(1) as f64
    }

    /// The step of Levenberg and Marquardt; `None` where the matrix is not positive.
    fn step(mut self, damping: f64) -> Option<DVector<f64>> {
        let least = LEAST * self.usual();
        let common = self.normal.nrows() - 1;
        for n in 0..=common {
            let own = if n < common { self.normal[(n, n)].max(least) } else { self.normal[(n, n)] };
            self.normal[(n, n)] += damping * own.max(f64::MIN_POSITIVE);
        }
        Some(self.normal.cholesky()?.solve(&self.slope))
    }
}

impl Fit<'_> {
    /// Levenberg-Marquardt over the vectors of all `open` patches and the common variance, gross errors counting less
    /// in each round.
    pub(super) fn settle_together(&mut self, open: &[usize], cancel: &Cancel) {
        loop {
            self.linear = f64::max(LINEAR, TIGHTER * self.linear);
            self.set_usual();
            let is_last = self.linear <= LINEAR;
            self.descend_together(open, if is_last { STEPS_LAST } else { STEPS_EACH }, cancel);
            if is_last {
                return;
            }
        }
    }

    pub(super) fn descend_together(&mut self, open: &[usize], steps: usize, cancel: &Cancel) {
        let (mut loss, mut damping, mut idle) = (self.total(open), 1e-3, 0);
        for _ in 0..steps {
            cancel.check();
            let Some(step) = self.linearised(open).step(damping) else {
                damping *= 10.0;
                continue;
            };
            let before = (self.vectors_m.clone(), self.common_m2);
            for (at, &patch) in open.iter().enumerate() {
                self.vectors_m[patch] += Vector3::new(step[3 * at], step[3 * at + 1], step[3 * at + 2]);
            }
            self.common_m2 = f64::max(0.0, self.common_m2 + step[3 * open.len()]);
            let next = self.total(open);
            if next < loss {
                idle = if loss - next < IDLE_LOSS { idle + 1 } else { 0 };
                (loss, damping) = (next, f64::max(1e-9, 0.2 * damping));
            } else {
                (self.vectors_m, self.common_m2) = before;
                damping *= 5.0;
            }
            if idle >= IDLE || damping > DAMPING_MAX {
                return;
            }
        }
    }

    /// Covariance of the vector of each open patch, with those of all others and the common variance unknown too;
    /// `None` where nothing determines them.
    pub(super) fn covariances_m2(&self, open: &[usize]) -> Option<Vec<Matrix3<f64>>> {
        let mut linearised = self.linearised(open);
        let least = LEAST_KNOWN * linearised.usual();
        for n in 0..3 * open.len() {
            linearised.normal[(n, n)] += least;
        }
        let covariance_m2 = linearised.normal.cholesky()?.inverse();
        Some((0..open.len()).map(|at| covariance_m2.fixed_view::<3, 3>(3 * at, 3 * at).into_owned()).collect())
    }

    fn linearised(&self, open: &[usize]) -> Linearised {
        let common = 3 * open.len();
        let (mut normal, mut slope) = (DMatrix::zeros(common + 1, common + 1), DVector::zeros(common + 1));
        let no_patch = self.vectors_m.len();
        let mut row: Vec<(usize, f64)> = Vec::new();
        for pulse in self.spreads {
            let residual = self.residual(pulse, no_patch, Vector3::zeros());
            let weight = self.weight(pulse, residual);
            row.clear();
            for bounce in &pulse.bounces {
                let Ok(at) = open.binary_search(&bounce.patch) else { continue };
                let (g, own_m) = (bounce.slope(), self.vectors_m[bounce.patch]);
                let gradient = 2.0 * (g.norm_squared() * own_m - own_m.dot(&g) * g) / pulse.sd_m2;
                row.extend((0..3).map(|axis| (3 * at + axis, gradient[axis])));
            }
            row.push((common, 1.0 / pulse.sd_m2));
            for &(i, a) in &row {
                slope[i] += weight * residual * a;
                row.iter().for_each(|&(k, b)| normal[(i, k)] += weight * a * b);
            }
        }
        for (at, &patch) in open.iter().enumerate() {
            let own_m = self.vectors_m[patch];
            let (of_sides, towards) = self.side_equations(patch, own_m);
            for i in 0..3 {
                slope[3 * at + i] += towards[i];
                (0..3).for_each(|k| normal[(3 * at + i, 3 * at + k)] += of_sides[(i, k)]);
            }
            let Some(along) = own_m.try_normalize(0.0).filter(|_| self.usual_m > 0.0) else { continue };
            let gradient = along / (ALIKE * self.usual_m);
            for i in 0..3 {
                slope[3 * at + i] -= self.longer(own_m) * gradient[i];
                (0..3).for_each(|k| normal[(3 * at + i, 3 * at + k)] += gradient[i] * gradient[k]);
            }
        }
        if let Some((held, at)) = self.held.and_then(|held| Some((held, open.binary_search(&held.patch).ok()?))) {
            let gradient = held.axis / held.sd_m;
            for i in 0..3 {
                slope[3 * at + i] += held.short(&self.vectors_m) * gradient[i];
                (0..3).for_each(|k| normal[(3 * at + i, 3 * at + k)] += gradient[i] * gradient[k]);
            }
        }
        Linearised { normal, slope }
    }
}
