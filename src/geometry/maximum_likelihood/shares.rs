//! Errors that observations share without being unknowns: onsets of one profile, both pulses of a blended pair.
//!
//! A covariance among observations is written as independent errors, each of which several observations have
//! ([`Observation::shared`]). So some of the observations can be left out, and the standard deviations of others
//! enlarged by errors of their own, without the rest becoming wrong. Residuals are taken to independent ones by the
//! Cholesky factor of the covariance of each group of observations that share errors.

use faer::Mat;

use super::Observation;
use super::groups::Groups;
use crate::dense;

/// Correlations below this change no position by a percent of its standard deviation.
const CORRELATED: f64 = 0.05;
/// Least share of a variance that is of its observation alone.
const OWN_MIN: f64 = 1e-3;

/// A covariance as independent errors: of each observation the numbers of the errors that it shares, and what one
/// standard deviation of each adds, in the unit of the standard deviations. Observations that correlate with none by
/// 0.05 share none.
///
/// With the correlations `C = V L V'` of a group and the least eigenvalue `l`, the shares are `V (L - l)^(1/2)`, and
/// the part `l` of each variance is the observation's own. Where a matrix is no covariance (`l < 0`), the nearest one
/// that is made so takes its place.
///
/// # Panics
/// When the matrix is not square, or a variance is not positive.
#[must_use]
pub fn shares(covariance: &Mat<f64>) -> Vec<Vec<(usize, f64)>> {
    let count = covariance.nrows();
    let sds: Vec<f64> = (0..count).map(|n| covariance[(n, n)].sqrt()).collect();
    assert!(sds.iter().all(|sd| *sd > 0.0), "variances are positive");
    let correlation = |a: usize, b: usize| 0.5 * (covariance[(a, b)] + covariance[(b, a)]) / (sds[a] * sds[b]);
    let mut groups = Groups::new(count);
    for a in 0..count {
        (0..a).filter(|&b| correlation(a, b).abs() > CORRELATED).for_each(|b| groups.join(a, b));
    }
    let (mut all, mut next) = (vec![Vec::new(); count], 0);
    for group in groups.sets().into_iter().filter(|group| group.len() > 1) {
        let matrix =
            Mat::from_fn(group.len(), group.len(), |i, j| if i == j { 1.0 } else { correlation(group[i], group[j]) });
        let (values, vectors) = dense::symmetric_eigen(&matrix);
        let own = values[0].max(OWN_MIN);
        let sizes: Vec<f64> = values.iter().map(|value| (value - own).max(0.0).sqrt()).collect();
        for (i, &n) in group.iter().enumerate() {
            let of_errors: Vec<f64> = sizes.iter().enumerate().map(|(k, size)| vectors[(i, k)] * size).collect();
            let variance: f64 = of_errors.iter().map(|share| share * share).sum();
            let scale = sds[n] * ((1.0 - own) / variance.max(1.0 - own)).sqrt();
            let shared = of_errors.iter().enumerate().filter(|(_, share)| **share != 0.0);
            all[n] = shared.map(|(k, share)| (next + k, scale * share)).collect();
        }
        next += group.len();
    }
    all
}

/// Takes residuals of observations, as lengths, to independent ones of variance 1.
pub(super) struct Whitener {
    /// Of each observation that shares errors, the observations whose residuals are added up, itself the last, and
    /// their factors. Empty for one that shares none; without any that does, for none at all.
    terms: Vec<Vec<(usize, f64)>>,
}

impl Whitener {
    pub(super) fn new(observations: &[Observation]) -> Self {
        let groups = sharing(observations);
        let mut terms = if groups.is_empty() { Vec::new() } else { vec![Vec::new(); observations.len()] };
        for group in groups {
            let covariance = Mat::from_fn(group.len(), group.len(), |i, j| {
                let (a, b) = (&observations[group[i]], &observations[group[j]]);
                if i == j { a.sd_m * a.sd_m } else { product(&a.shared, &b.shared) }
            });
            let factored = dense::Definite::new(&covariance).expect("shares are less than the whole error");
            let mut inverse = Mat::identity(group.len(), group.len());
            factored.whiten(&mut inverse);
            for (i, &n) in group.iter().enumerate() {
                terms[n] = (0..=i).map(|j| (group[j], inverse[(i, j)])).filter(|(_, factor)| *factor != 0.0).collect();
            }
        }
        Self { terms }
    }

    /// The observations whose residuals make that of one which shares errors, and their factors.
    pub(super) fn terms(&self, observation: usize) -> Option<&[(usize, f64)]> {
        self.terms.get(observation).map(Vec::as_slice).filter(|terms| !terms.is_empty())
    }
}

/// Observations that share errors, directly or over others, in ascending order.
fn sharing(observations: &[Observation]) -> Vec<Vec<usize>> {
    let errors = observations.iter().flat_map(|observation| &observation.shared).map(|(error, _)| error + 1);
    let Some(count) = errors.max() else { return Vec::new() };
    let mut first_with = vec![None; count];
    let mut groups = Groups::new(observations.len());
    for (n, observation) in observations.iter().enumerate() {
        for (error, _) in &observation.shared {
            groups.join(n, *first_with[*error].get_or_insert(n));
        }
    }
    groups.sets().into_iter().filter(|group| group.len() > 1).collect()
}

/// Sum of the products of two observations' shares of the same errors.
fn product(a: &[(usize, f64)], b: &[(usize, f64)]) -> f64 {
    let pairs = a.iter().flat_map(|a| b.iter().map(move |b| (a, b)));
    pairs.filter(|((one, _), (other, _))| one == other).map(|((_, a), (_, b))| a * b).sum()
}

#[cfg(test)]
mod tests;
