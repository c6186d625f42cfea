//! Size and direction of patches, from how wide they make pulses.
//!
//! A patch spreads the light of a path over the path lengths of its points. Of a disk of diameter `s` and normal `n`
//! the variance is
//!
//! ```text
//! s^2 / 16 (|g|^2 - (n . g)^2) = |v x g|^2,     v = s / 4 n,
//! ```
//!
//! with `g` the gradient of the path's length by the place of the patch; those of several bounces add up. Paths in many
//! directions tell all three coordinates of `v`, but for its sign, which does not matter. So `v` of all patches are
//! fitted to the widths of all pulses, all at once; of many patches, patch by patch in turns. Which way one patch faces
//! decides what its neighbours are told, so that minima are many: [`search`] looks for the least. A patch sends light
//! to the side that it is lit from. So directions with the two legs of a bounce on different sides count against a
//! normal ([`sides`]), but no more than widths may outweigh, since light goes through some things. Where it goes
//! through most patches, it may go through all. Patches of one campaign are about as large as one another (within 30
//! %). A width that all pulses have in common is that of the response, which was not as calibrated: its variance is
//! fitted too. Pulses that blend are wider than their patches make them: large residuals count little.
//!
//! A patch has a footprint where that explains the widths better than a point by 25 of chi-square. Where one in four
//! has one, all do, since they are alike: the error of such a footprint is larger, that of a point would be none. A
//! pulse that is wider than its patches make it is more than the light of its path. One that shows no width has less
//! than its samples can tell from none.

mod profile;
mod search;
mod sides;
mod together;

use nalgebra::{Matrix3, Vector3};
use periscope_cancel::Cancel;

use super::Footprint;
use profile::Held;

/// Drop of chi-square that a footprint must be worth: three parameters, and four standard deviations.
const EVIDENCE: f64 = 25.0;
/// Steps of one patch in one round.
const STEPS: usize = 12;
/// A squared residual over its variance counts less from this on, of a pulse that is too narrow from so many times as
/// much; in the first rounds beyond so many times more, by a factor less in each, so that nothing far off is forgotten
/// before anything fits.
const LINEAR: f64 = 9.0;
const NARROW: f64 = 3.0;
const LINEAR_FIRST: f64 = 1e6;
const TIGHTER: f64 = 0.3;
/// Sizes are alike: their standard deviation about the middle one, as a share of it.
const ALIKE: f64 = 0.3;
/// Where one of so many patches is no point, none is.
const ALIKE_FROM: usize = 4;
/// Up to so many patches are fitted at once.
const TOGETHER: usize = 64;
/// Up to so many patches have several starts, and are turned one by one; more tie one another.
const CERTAIN: usize = 16;
/// Mean of what the squared residual of a normal variable counts.
const BY_CHANCE: f64 = 0.86;
/// Errors, as shares of sizes, are no smaller than what the shape of a patch and its light are off a disk's. Where
/// patches are not fitted at once, they are larger than the widths of a patch's own pulses tell, since those of its
/// neighbours join them.
const NEIGHBOURS: f64 = 1.5;
const LEAST_SD: f64 = 0.02;
const MOST_SD: f64 = 0.5;
/// Pulses of one patch that count; more tell no more than that.
const PULSES: usize = 256;
/// A patch on a path, with unit vectors from it to where the light comes from and to where it goes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounce {
    /// Position of the patch among all.
    pub patch: usize,
    /// Both directions.
    pub legs: [Vector3<f64>; 2],
}

impl Bounce {
    /// What the path's length falls by as the patch moves: its gradient but for the sign.
    fn slope(&self) -> Vector3<f64> {
        self.legs[0] + self.legs[1]
    }
}

/// How wide one pulse is, and what its path would make of the size of its patches.
#[derive(Clone, Debug, PartialEq)]
pub struct Spread {
    /// In the order of the path.
    pub bounces: Vec<Bounce>,
    /// Variance of the path's length that the pulse shows.
    pub variance_m2: f64,
    /// Standard deviation of that variance, positive.
    pub sd_m2: f64,
    /// Whether the pulse shows no width, and the variance is the most that would show none.
    pub is_limit: bool,
}

/// What widths show.
#[derive(Clone, Debug, PartialEq)]
pub struct Sizes {
    /// Of each patch; `None` for a point.
    pub footprints: Vec<Option<Footprint>>,
    /// Of each pulse, the variance of its length beyond that of its patches and the response; negative where it is
    /// narrower. A pulse that shows no width has none.
    pub excess_m2: Vec<f64>,
}

/// Footprints of as many patches as are `given`, those that are known held as they are, and what pulses are wider.
///
/// # Panics
/// When a pulse names a patch that is not there.
#[must_use]
pub fn from_widths(spreads: &[Spread], given: &[Option<Footprint>], cancel: &Cancel) -> Sizes {
    if spreads.is_empty() {
        return Sizes { footprints: given.to_vec(), excess_m2: Vec::new() };
    }
    let of_patch = pulses_of_patches(spreads, given.len());
    let open: Vec<usize> = (0..given.len()).filter(|&patch| given[patch].is_none()).collect();
    let start_m = given.iter().map(|footprint| footprint.map(|one| 0.25 * one.size_m * one.normal.normalize()));
    let vectors_m: Vec<Vector3<f64>> = start_m.map(Option::unwrap_or_default).collect();
    let start = Fit {
        spreads,
        vectors_m,
        of_patch,
        common_m2: 0.0,
        usual_m: 0.0,
        linear: LINEAR * LINEAR_FIRST,
        is_translucent: false,
        held: None,
    };
    let mut fit = start.best_of_starts(&open, cancel);
    let mut covariances_m2 = None;
    if open.len() <= TOGETHER {
        fit = fit.searched(&open, cancel);
        let through = open.iter().filter(|&&patch| fit.through(patch, fit.vectors_m[patch]) > 0.0).count();
        if 2 * through > open.len() {
            fit.is_translucent = true;
            fit = fit.searched(&open, cancel);
        }
        covariances_m2 = fit.covariances_m2(&open);
        // What widens all pulses alike may be the response alone.
        let mut points = fit.clone();
        open.iter().for_each(|&patch| points.vectors_m[patch] = Vector3::zeros());
        points.usual_m = 0.0;
        (0..STEPS).for_each(|_| points.improve_common(&[]));
        if points.total(&open) < fit.total(&open) + EVIDENCE {
            fit = points;
        }
    }
    let gain = |&patch: &usize| fit.chi2(patch, Vector3::zeros()) - fit.chi2(patch, fit.vectors_m[patch]);
    let is_evident: Vec<bool> = open.iter().map(|patch| gain(patch) > EVIDENCE).collect();
    let are_some = ALIKE_FROM * is_evident.iter().filter(|evident| **evident).count() >= open.len();
    let mut footprints = given.to_vec();
    for (at, &patch) in open.iter().enumerate() {
        let vector_m = fit.vectors_m[patch];
        let normal = vector_m.try_normalize(0.0).filter(|_| is_evident[at] || are_some);
        let size_m = 4.0 * vector_m.norm();
        footprints[patch] = normal.map(|normal| {
            let errors = fit.relative_errors(patch, covariances_m2.as_ref().map(|all| all[at]));
            let errors = if open.len() <= CERTAIN { fit.profiled(&open, patch, &errors, cancel) } else { errors };
            Footprint { normal, size_m, errors_m: size_m * errors }
        });
    }
    // Also the sizes that are not certain make pulses wider.
    let none = given.len();
    let excess = |pulse: &Spread| {
        let seen_m2 = if pulse.is_limit { 0.0 } else { pulse.variance_m2 };
        seen_m2 - pulse.variance_m2 + fit.left_m2(pulse, none, Vector3::zeros())
    };
    let excess_m2 = spreads.iter().map(excess).collect();
    Sizes { footprints, excess_m2 }
}

/// The pulses of each patch, thinned where they are many.
fn pulses_of_patches(spreads: &[Spread], patches: usize) -> Vec<Vec<usize>> {
    let mut of_patch = vec![Vec::new(); patches];
    for (n, spread) in spreads.iter().enumerate() {
        spread.bounces.iter().for_each(|bounce| of_patch[bounce.patch].push(n));
    }
    for pulses in &mut of_patch {
        pulses.dedup();
        let step = pulses.len().div_ceil(PULSES).max(1);
        *pulses = pulses.iter().copied().step_by(step).collect();
    }
    of_patch
}

/// Vectors of all patches, and the pulses that they are fitted to.
#[derive(Clone)]
struct Fit<'a> {
    spreads: &'a [Spread],
    vectors_m: Vec<Vector3<f64>>,
    /// Pulses of each patch.
    of_patch: Vec<Vec<usize>>,
    /// Variance that all pulses have in common.
    common_m2: f64,
    /// Length of the middle vector.
    usual_m: f64,
    /// Squared residuals count as their logarithms beyond this.
    linear: f64,
    /// Whether light goes through patches.
    is_translucent: bool,
    /// A coordinate that does not settle.
    held: Option<Held>,
}

impl Fit<'_> {
    /// What is minimised: chi-square of all pulses, of sizes beside one another, and bounces with legs on both sides.
    fn total(&self, open: &[usize]) -> f64 {
        let no_patch = self.vectors_m.len();
        let of_pulse = |pulse: &Spread| self.robust(self.residual(pulse, no_patch, Vector3::zeros())).0;
        let own = |&patch: &usize| {
            let vector_m = self.vectors_m[patch];
            self.longer(vector_m).powi(2) + self.through(patch, vector_m)
        };
        let of_held = self.held.map_or(0.0, |held| held.short(&self.vectors_m).powi(2));
        self.spreads.iter().map(of_pulse).sum::<f64>() + open.iter().map(own).sum::<f64>() + of_held
    }

    fn set_usual(&mut self) {
        let mut lengths_m: Vec<f64> = self.vectors_m.iter().map(Vector3::norm).collect();
        lengths_m.sort_by(f64::total_cmp);
        self.usual_m = lengths_m.get(lengths_m.len() / 2).copied().unwrap_or_default();
    }

    /// What is left of a pulse's variance, in its standard deviations, with another vector for one patch. Below a limit
    /// nothing is.
    fn residual(&self, pulse: &Spread, patch: usize, vector_m: Vector3<f64>) -> f64 {
        let residual = self.left_m2(pulse, patch, vector_m) / pulse.sd_m2;
        if pulse.is_limit { residual.min(0.0) } else { residual }
    }

    fn left_m2(&self, pulse: &Spread, patch: usize, vector_m: Vector3<f64>) -> f64 {
        let of_bounce = |bounce: &Bounce| {
            let own_m = if bounce.patch == patch { vector_m } else { self.vectors_m[bounce.patch] };
            own_m.cross(&bounce.slope()).norm_squared()
        };
        let predicted_m2: f64 = pulse.bounces.iter().map(of_bounce).sum();
        pulse.variance_m2 - self.common_m2 - predicted_m2
    }

    fn chi2(&self, patch: usize, vector_m: Vector3<f64>) -> f64 {
        let of_pulse = |&n: &usize| self.robust(self.residual(&self.spreads[n], patch, vector_m)).0;
        self.of_patch[patch].iter().map(of_pulse).sum()
    }

    /// How much longer a vector is than the middle one, in standard deviations; 0 where there is no middle one.
    fn longer(&self, vector_m: Vector3<f64>) -> f64 {
        if self.usual_m > 0.0 { (vector_m.norm() / self.usual_m - 1.0) / ALIKE } else { 0.0 }
    }

    /// The part of [`Self::total`] that depends on one patch.
    fn loss(&self, patch: usize, vector_m: Vector3<f64>) -> f64 {
        self.chi2(patch, vector_m) + self.longer(vector_m).powi(2) + self.through(patch, vector_m)
    }

    /// All bounces of a patch.
    fn bounces(&self, patch: usize) -> impl Iterator<Item = &Bounce> {
        let of_pulses = self.of_patch[patch].iter().flat_map(|&n| &self.spreads[n].bounces);
        of_pulses.filter(move |bounce| bounce.patch == patch)
    }

    /// Where the light of a patch comes from and goes to, on average.
    fn front(&self, patch: usize) -> Vector3<f64> {
        self.bounces(patch).map(Bounce::slope).sum()
    }

    /// Length of the vector that explains the mean variance of a patch's pulses that others leave, for slopes at
    /// random.
    fn start_m(&self, patch: usize) -> f64 {
        let mut left_m2 = 0.0;
        for &n in &self.of_patch[patch] {
            let pulse = &self.spreads[n];
            left_m2 += self.residual(pulse, patch, Vector3::zeros()) * pulse.sd_m2;
        }
        let slopes: f64 = self.bounces(patch).map(|bounce| bounce.slope().norm_squared()).sum();
        (1.5 * left_m2.max(0.0) / f64::max(slopes, f64::MIN_POSITIVE)).sqrt()
    }

    /// Weight of a residual; of none where a limit says nothing.
    fn weight(&self, pulse: &Spread, residual: f64) -> f64 {
        if pulse.is_limit && residual >= 0.0 { 0.0 } else { self.robust(residual).1 }
    }

    /// Errors of a vector as shares of its length, the columns of [`Footprint::errors_m`]: of the inverse Fisher
    /// matrix, widened by what the patch's pulses scatter. `covariance_m2` is that among all patches, where it is
    /// known.
    fn relative_errors(&self, patch: usize, covariance_m2: Option<Matrix3<f64>>) -> Matrix3<f64> {
        let at_m = self.vectors_m[patch];
        let unknown = MOST_SD * Matrix3::identity();
        let alone = || Some(NEIGHBOURS * NEIGHBOURS * self.normal_equations(patch, at_m).0.try_inverse()?);
        let Some(covariance_m2) = covariance_m2.or_else(alone).filter(|_| at_m.norm() > 0.0) else { return unknown };
        // Blends are wider than any normal makes them, and a few of them turn it.
        let seen = self.of_patch[patch].iter().map(|&n| &self.spreads[n]).filter(|pulse| !pulse.is_limit);
        let squares: Vec<f64> = seen.map(|pulse| self.robust(self.residual(pulse, patch, at_m)).0).collect();
        let mean = squares.iter().sum::<f64>() / f64::max(1.0, squares.len() as f64);
        let scatter = f64::max(1.0, mean / BY_CHANCE);
        let principal = (scatter / at_m.norm_squared() * covariance_m2).symmetric_eigen();
        let sds = principal.eigenvalues.map(|variance| variance.max(0.0).sqrt().clamp(LEAST_SD, MOST_SD));
        principal.eigenvectors * Matrix3::from_diagonal(&sds)
    }

    /// Normal matrix of a patch's vector and its right-hand side, sizes of others beside it included.
    fn normal_equations(&self, patch: usize, at_m: Vector3<f64>) -> (Matrix3<f64>, Vector3<f64>) {
        let (mut normal, mut slope) = (Matrix3::zeros(), Vector3::zeros());
        for &n in &self.of_patch[patch] {
            let pulse = &self.spreads[n];
            let residual = self.residual(pulse, patch, at_m);
            let weight = self.weight(pulse, residual);
            let of_bounce = |bounce: &Bounce| {
                let g = bounce.slope();
                2.0 * (g.norm_squared() * at_m - at_m.dot(&g) * g) / pulse.sd_m2
            };
            let own = pulse.bounces.iter().filter(|bounce| bounce.patch == patch);
            let gradient: Vector3<f64> = own.map(of_bounce).sum();
            normal += weight * gradient * gradient.transpose();
            slope += weight * residual * gradient;
        }
        if let Some(along) = at_m.try_normalize(0.0).filter(|_| self.usual_m > 0.0) {
            let gradient = along / (ALIKE * self.usual_m);
            normal += gradient * gradient.transpose();
            slope -= self.longer(at_m) * gradient;
        }
        let (of_sides, towards) = self.side_equations(patch, at_m);
        (normal + of_sides, slope + towards)
    }

    /// Levenberg-Marquardt from a start: loss and vector reached.
    fn descend(&self, patch: usize, start_m: Vector3<f64>) -> (f64, Vector3<f64>) {
        let (mut at_m, mut loss, mut damping) = (start_m, self.loss(patch, start_m), 1e-2);
        for _ in 0..STEPS {
            let (normal, slope) = self.normal_equations(patch, at_m);
            let damped = normal + Matrix3::identity() * (damping * normal.trace().max(f64::MIN_POSITIVE));
            let Some(step_m) = damped.cholesky().map(|root| root.solve(&slope)) else { break };
            let next = self.loss(patch, at_m + step_m);
            if next < loss {
                (at_m, loss, damping) = (at_m + step_m, next, 0.2 * damping);
            } else {
                damping *= 10.0;
            }
        }
        (loss, at_m)
    }

    /// The common variance, with the one factor on the sizes of all `open` patches, that fit best: what widens all
    /// pulses may be either. Neither is negative.
    fn improve_common(&mut self, open: &[usize]) {
        let none = self.vectors_m.len(); // no patch
        let is_open: Vec<bool> = (0..none).map(|patch| open.binary_search(&patch).is_ok()).collect();
        // Sums of the normal equations of `left = common + factor shape`.
        let (mut one, mut shape, mut shape2, mut left, mut left_shape) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for pulse in self.spreads {
            let residual = self.residual(pulse, none, Vector3::zeros());
            let weight = self.weight(pulse, residual) / (pulse.sd_m2 * pulse.sd_m2);
            let of_open = pulse.bounces.iter().filter(|bounce| is_open[bounce.patch]);
            let own_m2: f64 =
                of_open.map(|bounce| self.vectors_m[bounce.patch].cross(&bounce.slope()).norm_squared()).sum();
            let left_m2 = residual * pulse.sd_m2 + self.common_m2 + own_m2;
            one += weight;
            shape += weight * own_m2;
            shape2 += weight * own_m2 * own_m2;
            left += weight * left_m2;
            left_shape += weight * left_m2 * own_m2;
        }
        let alone = |sum: f64, square: f64| if square > 0.0 { f64::max(0.0, sum / square) } else { 0.0 };
        let determinant = one * shape2 - shape * shape;
        let (common_m2, factor) = if determinant > 1e-12 * one * shape2 {
            ((shape2 * left - shape * left_shape) / determinant, (one * left_shape - shape * left) / determinant)
        } else {
            (alone(left, one), 0.0)
        };
        let (common_m2, factor) = match (common_m2 < 0.0, factor < 0.0) {
            (true, _) => (0.0, alone(left_shape, shape2)),
            (false, true) => (alone(left, one), 0.0),
            (false, false) => (common_m2, factor),
        };
        self.common_m2 = common_m2;
        open.iter().for_each(|&patch| self.vectors_m[patch] *= factor.sqrt());
    }

    /// What a residual counts, and its weight: a pulse that is wider than its patches make it has other light in it,
    /// and the wider it is the less it says; few are narrower but by chance.
    fn robust(&self, residual: f64) -> (f64, f64) {
        let square = residual * residual;
        if residual > 0.0 {
            let kept = self.linear / (self.linear + square);
            return (kept * square, kept * kept);
        }
        let linear = f64::max(self.linear, NARROW * LINEAR);
        (linear * (square / linear).ln_1p(), linear / (linear + square))
    }
}

#[cfg(test)]
mod tests;
