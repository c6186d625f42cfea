//! Whitening of noise that is correlated from sample to sample.
//!
//! Noise of covariance `C = D R D` (D: sd of each sample, R: Toeplitz matrix of the autocorrelation) is divided by its
//! sd and passed through the filter of its prediction errors: `e_n = (u_n - sum_j phi_mj u_{n-j}) / sqrt(v_m)`,
//! `u_n = y_n / sd_n`. Every sample takes the predictor of the order m that the samples before it allow, up to the
//! order p of the process. For an autoregressive process of order p that is `C^-1/2` by Cholesky exactly: the errors
//! are white from the first sample on, and sums of their squares are chi2. Behind a sample to be ignored (sd infinite)
//! the filter starts anew: what the samples before it say about those behind it is given up.
//!
//! Predictors: Levinson-Durbin recursion (Durbin, Rev. Inst. Int. Stat. 28, 233 (1960)). An autocorrelation that was
//! estimated need not be one. The recursion ends before the first partial correlation beyond `PARTIAL_MAX`. Up to there
//! the sequence is positive definite and the filter's inverse stable; the filter is that of the process of largest
//! entropy with these lags (Burg). Where the number of samples behind an estimate is known,
//! [`super::noise::autoregressive`] chooses the order better beforehand.

use periscope_cancel::Cancel;

/// Partial correlations beyond this end the recursion: noise with less than 1/500 of new variance in each sample is
/// more likely a wrong estimate.
const PARTIAL_MAX: f64 = 0.999;
/// Partial correlations at the end that are smaller than this are rounding: they would lengthen the filter for nothing.
const PARTIAL_MIN: f64 = 1e-3;
/// Samples between two looks at the token.
const BLOCK: usize = 1 << 16;

/// Predictors of orders 0, 1, .. of a stationary process of variance 1.
#[derive(Clone, Debug, PartialEq)]
pub struct Predictors {
    /// Of each order: `phi_1, phi_2, ..`, the weight of the sample 1, 2, .. before.
    pub coefficients: Vec<Vec<f64>>,
    /// Variance of each order's error.
    pub variances: Vec<f64>,
}

impl Predictors {
    /// Predictors of the process with autocorrelation `acf` (lags 0, 1, ..; scaled to 1 at lag 0; nothing stands for
    /// white noise), as long as it is one.
    ///
    /// # Panics
    /// If lag 0 is not positive, or a lag is not finite.
    #[must_use]
    pub fn new(acf: &[f64]) -> Self {
        assert!(acf.iter().all(|r| r.is_finite()), "an autocorrelation is finite");
        assert!(acf.first().is_none_or(|r| *r > 0.0), "an autocorrelation is positive at lag 0");
        let mut predictors = Self { coefficients: vec![Vec::new()], variances: vec![1.0] };
        for order in 1..acf.len() {
            let (shorter, variance) = (&predictors.coefficients[order - 1], predictors.variances[order - 1]);
            let predicted: f64 = shorter.iter().enumerate().map(|(j, phi)| phi * acf[order - 1 - j]).sum();
            let partial = (acf[order] - predicted) / acf[0] / variance;
            if partial.abs() > PARTIAL_MAX {
                break;
            }
            let mut longer: Vec<f64> = shorter.iter().zip(shorter.iter().rev()).map(|(a, b)| a - partial * b).collect();
            longer.push(partial);
            predictors.coefficients.push(longer);
            predictors.variances.push(variance * (1.0 - partial * partial));
        }
        predictors
    }

    /// Without the highest orders as long as their last coefficient, the partial correlation, is at most `least`.
    #[must_use]
    pub fn significant(mut self, least: f64) -> Self {
        while self.coefficients.last().and_then(|phi| phi.last()).is_some_and(|partial| partial.abs() <= least) {
            self.coefficients.pop();
            self.variances.pop();
        }
        self
    }

    /// The highest order.
    #[must_use]
    pub fn order(&self) -> usize {
        self.coefficients.len() - 1
    }
}

/// The whitening filter of a record: a lower triangular band matrix W with `W C W^T = 1`.
#[derive(Clone, Debug)]
pub struct Whitener {
    /// `1 / sd` of each sample; 0 for a sample to be ignored.
    weights: Vec<f64>,
    /// Order of each sample's predictor.
    orders: Vec<usize>,
    /// Of each order: `1, -phi_1, -phi_2, ..`, over the sd of the error.
    taps: Vec<Vec<f64>>,
    /// Polled once a block.
    cancel: Cancel,
}

impl Whitener {
    /// Filter for samples of the given sds (infinite: to be ignored) and autocorrelation (lags 0, 1, ..; `&[1.0]` or
    /// nothing: white).
    ///
    /// # Panics
    /// If an sd is not positive, or the autocorrelation not positive at lag 0 or not finite.
    #[must_use]
    pub fn new(sd: &[f64], acf: &[f64]) -> Self {
        assert!(sd.iter().all(|sd| *sd > 0.0), "the sds must be positive");
        let taps = Self::taps_of(acf);
        let weights: Vec<f64> = sd.iter().map(|sd| 1.0 / sd).collect();
        let mut before = 0;
        let orders = weights
            .iter()
            .map(|weight| {
                if *weight == 0.0 {
                    before = 0;
                    return 0;
                }
                let order = before;
                before = (order + 1).min(taps.len() - 1);
                order
            })
            .collect();
        Self { weights, orders, taps, cancel: Cancel::never() }
    }

    /// The same, which a cancel ends while it works on a long record.
    #[must_use]
    pub fn ended_by(self, cancel: &Cancel) -> Self {
        Self { cancel: cancel.clone(), ..self }
    }

    /// Filter taps of each order.
    fn taps_of(acf: &[f64]) -> Vec<Vec<f64>> {
        let predictors = Predictors::new(acf).significant(PARTIAL_MIN);
        let scaled = |(phi, variance): (&Vec<f64>, &f64)| {
            let sd = variance.sqrt();
            std::iter::once(1.0 / sd).chain(phi.iter().map(|phi| -phi / sd)).collect()
        };
        predictors.coefficients.iter().zip(&predictors.variances).map(scaled).collect()
    }

    /// Number of samples before one that its whitened value depends on, at most.
    #[must_use]
    pub fn order(&self) -> usize {
        self.taps.len() - 1
    }

    /// Taps of the filter far from the beginning, for samples of sd 1: of the sample itself, the one before it, ..
    #[must_use]
    pub fn stationary_taps(&self) -> &[f64] {
        &self.taps[self.order()]
    }

    /// `1 / sd` of each sample; 0 for one to be ignored.
    #[must_use]
    pub fn weights(&self) -> &[f64] {
        &self.weights
    }

    /// For each sample, the first of the run of samples up to it that have its sd and its predictor.
    #[must_use]
    pub fn run_starts(&self) -> Vec<usize> {
        let mut start = 0;
        (0..self.weights.len())
            .map(|n| {
                if n > 0 && (self.weights[n] != self.weights[n - 1] || self.orders[n] != self.orders[n - 1]) {
                    start = n;
                }
                start
            })
            .collect()
    }

    /// `W y` for a whole record.
    ///
    /// # Panics
    /// If `record` has another length than the filter.
    #[must_use]
    pub fn apply(&self, record: &[f64]) -> Vec<f64> {
        assert_eq!(record.len(), self.weights.len(), "one value a sample");
        if self.order() == 0 {
            return self.scaled(record);
        }
        let mut whitened: Vec<[f64; 1]> = record.iter().map(|value| [*value]).collect();
        self.apply_from(0, &mut whitened);
        whitened.into_iter().map(|[value]| value).collect()
    }

    /// `W y`, and `W^T y`, for white noise.
    fn scaled(&self, record: &[f64]) -> Vec<f64> {
        record.iter().zip(&self.weights).map(|(value, weight)| value * weight).collect()
    }

    /// `W y` in place for P records side by side that are zero before sample `first` and behind their end: pass as many
    /// zeros behind the end as the filter's order for all of the result.
    ///
    /// # Panics
    /// If the columns reach beyond the record.
    pub fn apply_from<const P: usize>(&self, first: usize, columns: &mut [[f64; P]]) {
        for (column, weight) in columns.iter_mut().zip(&self.weights[first..]) {
            for value in column.iter_mut() {
                *value *= weight;
            }
        }
        if self.order() == 0 {
            return;
        }
        // From the end backwards: a sample depends on those before it only.
        let mut end = columns.len();
        while end > 0 {
            self.cancel.check();
            let start = end.saturating_sub(BLOCK);
            for i in (start..end).rev() {
                let taps = &self.taps[self.orders[first + i]];
                let mut sum = [0.0; P];
                for (tap, column) in taps.iter().zip(columns[..=i].iter().rev()) {
                    for p in 0..P {
                        sum[p] += tap * column[p];
                    }
                }
                columns[i] = sum;
            }
            end = start;
        }
    }

    /// `W^T z` for a whole whitened record.
    ///
    /// # Panics
    /// If `whitened` has another length than the filter.
    #[must_use]
    pub fn transpose(&self, whitened: &[f64]) -> Vec<f64> {
        assert_eq!(whitened.len(), self.weights.len(), "one value a sample");
        if self.order() == 0 {
            return self.scaled(whitened);
        }
        let mut record = vec![0.0; whitened.len()];
        for start in (0..whitened.len()).step_by(BLOCK) {
            self.cancel.check();
            let block = start..(start + BLOCK).min(whitened.len());
            for (n, (value, order)) in block.clone().zip(whitened[block.clone()].iter().zip(&self.orders[block])) {
                for (j, tap) in self.taps[*order].iter().enumerate() {
                    record[n - j] += tap * value;
                }
            }
        }
        for (value, weight) in record.iter_mut().zip(&self.weights) {
            *value *= weight;
        }
        record
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Autocorrelation of `x_n = 0.9 x_{n-1} - 0.5 x_{n-2} + e_n`, by its own recursion.
    fn second_order(lags: usize) -> Vec<f64> {
        let mut acf = vec![1.0, 0.9 / 1.5];
        while acf.len() < lags {
            let l = acf.len();
            acf.push(0.9 * acf[l - 1] - 0.5 * acf[l - 2]);
        }
        acf
    }

    #[test]
    fn the_recursion_finds_the_process_and_its_order() {
        let predictors = Predictors::new(&second_order(9)).significant(PARTIAL_MIN);
        assert_eq!(predictors.order(), 2);
        assert!((predictors.coefficients[2][0] - 0.9).abs() < 1e-12);
        assert!((predictors.coefficients[2][1] + 0.5).abs() < 1e-12);
        // v_2 = 1 - phi_1 r_1 - phi_2 r_2
        let expected = 1.0 - 0.9 * 0.6 + 0.5 * (0.9 * 0.6 - 0.5);
        assert!((predictors.variances[2] - expected).abs() < 1e-12);
        assert_eq!(Predictors::new(&[]).order(), 0);
        assert_eq!(Predictors::new(&[3.0]).order(), 0);
    }

    /// `W C W^T` for the covariance `C = D R D`, column by column, is the unit matrix: between ignored samples.
    #[test]
    fn the_covariance_becomes_the_unit_matrix() {
        let mut rng = ChaCha8Rng::seed_from_u64(31);
        let (n, gap) = (30, 12);
        let sd: Vec<f64> = (0..n).map(|i| if i == gap { f64::INFINITY } else { rng.random_range(0.5..2.0) }).collect();
        let acf = second_order(n);
        let whitener = Whitener::new(&sd, &acf);
        assert_eq!(whitener.order(), 2);
        let together = |i: usize, j: usize| i != gap && j != gap && (i < gap) == (j < gap);
        // The two stretches are taken as independent, as the filter does.
        let covariance = |i: usize, j: usize| if together(i, j) { sd[i] * sd[j] * acf[i.abs_diff(j)] } else { 0.0 };
        let half: Vec<Vec<f64>> =
            (0..n).map(|j| whitener.apply(&(0..n).map(|i| covariance(i, j)).collect::<Vec<_>>())).collect();
        for i in 0..n {
            let row = whitener.apply(&(0..n).map(|j| half[j][i]).collect::<Vec<_>>());
            for (j, value) in row.iter().enumerate() {
                let expected = f64::from(u8::from(i == j && i != gap));
                assert!((value - expected).abs() < 1e-10, "{i} {j}: {value}");
            }
        }
    }

    #[test]
    fn parts_and_transpose_agree_with_the_whole() {
        let mut rng = ChaCha8Rng::seed_from_u64(32);
        let n = 40;
        let mut sd = vec![0.7; n];
        sd[21] = f64::INFINITY;
        let whitener = Whitener::new(&sd, &second_order(5));
        let mut draw = |range: std::ops::Range<usize>| -> Vec<f64> {
            (0..n).map(|i| if range.contains(&i) { rng.random_range(-1.0..1.0) } else { 0.0 }).collect()
        };
        let (x, z) = (draw(15..20), draw(0..n));
        let whole = whitener.apply(&x);
        let mut part: Vec<[f64; 1]> = x[15..22].iter().map(|v| [*v]).collect();
        whitener.apply_from(15, &mut part);
        for (i, value) in whole.iter().enumerate() {
            let expected = if (15..22).contains(&i) { part[i - 15][0] } else { 0.0 };
            assert!((value - expected).abs() < 1e-15, "{i}");
        }
        let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
        assert!((dot(&whole, &z) - dot(&x, &whitener.transpose(&z))).abs() < 1e-12);
    }

    #[test]
    fn white_noise_is_only_scaled() {
        let whitener = Whitener::new(&[0.3, 2.0, f64::INFINITY], &[1.0, 1e-4, -3e-4]);
        assert_eq!(whitener.order(), 0);
        assert_eq!(whitener.apply(&[1.0, 1.0, 1.0]), [1.0 / 0.3, 0.5, 0.0]);
        assert_eq!(whitener.transpose(&[1.0, 1.0, 1.0]), [1.0 / 0.3, 0.5, 0.0]);
        let sd = [1.0, 1.0, 1.0, 2.0, f64::INFINITY, 2.0, 2.0];
        assert_eq!(Whitener::new(&sd, &[]).run_starts(), [0, 0, 0, 3, 4, 5, 5]);
        assert_eq!(Whitener::new(&sd, &[1.0, 0.5]).run_starts(), [0, 1, 1, 3, 4, 5, 6]);
    }

    /// What is no autocorrelation is used as far as it is one: the response `g` of the inverse filter to an impulse has
    /// the energy of a stationary process of variance 1, `sum g^2 = 1 / v`.
    #[test]
    fn what_is_no_autocorrelation_gives_a_stable_filter() {
        let mut rng = ChaCha8Rng::seed_from_u64(33);
        let mut cut = 0;
        for _ in 0..300 {
            let acf: Vec<f64> = std::iter::once(1.0).chain((1..12).map(|_| rng.random_range(-0.9..0.9))).collect();
            let predictors = Predictors::new(&acf);
            cut += usize::from(predictors.order() < 11);
            let phi = &predictors.coefficients[predictors.order()];
            let mut impulse = vec![1.0_f64];
            while impulse.len() < 20_000 {
                impulse.push(phi.iter().zip(impulse.iter().rev()).map(|(p, x)| p * x).sum());
            }
            let energy: f64 = impulse.iter().map(|g| g * g).sum();
            let ratio = energy * predictors.variances[predictors.order()];
            assert!((0.5..1.0 + 1e-9).contains(&ratio), "{ratio}: {acf:?}");
        }
        assert!(cut > 200, "{cut}");
    }
}
