//! What any unbiased estimator could know at best, from the formulas of the responses.

use nalgebra::DMatrix;

use super::draw::{DT_PS, LEN};
use super::shape::Shape;

/// Drop of chi2 that a threshold of 20 passes in 99 % of draws: `(sqrt(20) + 2.326)^2`.
const DROP_99: f64 = 46.0;

/// Cramer-Rao bound of the standard deviations of the times of `pulses` (time, amplitude) in white noise of `sd`;
/// amplitudes and baseline are unknown too. Infinite where pulses cannot be resolved to working precision.
pub fn time_sds_ps(shape: &Shape, pulses: &[(f64, f64)], sd: f64, len: usize) -> Vec<f64> {
    time_sds_weighted_ps(shape, pulses, &vec![1.0 / (sd * sd); len])
}

/// The same with the information in the mean of each sample.
pub fn time_sds_weighted_ps(shape: &Shape, pulses: &[(f64, f64)], weights: &[f64]) -> Vec<f64> {
    let times = pulses.iter().map(|(at, a)| column(weights.len(), |t| -a * shape.at(t - at)[1]));
    let amplitudes = pulses.iter().map(|(at, _)| column(weights.len(), |t| shape.at(t - at)[0]));
    let baseline = vec![1.0; weights.len()];
    let inverse = inverse_information(&times.chain(amplitudes).chain([baseline]).collect::<Vec<_>>(), weights);
    (0..pulses.len()).map(|k| inverse.as_ref().map_or(f64::INFINITY, |inverse| inverse[(k, k)].sqrt())).collect()
}

/// Distance of two equal pulses of height 1 that are resolved in 99 % of draws in noise of `1 / snr`. Two differ from
/// one twice as high by `d^2 / 4 h''`, less what a shift, another height and a baseline can imitate of it. So the drop
/// of chi2 grows with the fourth power of the distance.
pub fn resolution_limit_ps(shape: &Shape, snr: f64) -> f64 {
    const PHASES: usize = 10;
    let energy = |phase: usize| {
        let at = 0.5 * LEN as f64 * DT_PS + DT_PS * phase as f64 / PHASES as f64;
        let derivative = |i: usize| column(LEN, |t| shape.at(t - at)[i]);
        let columns = [derivative(2), derivative(0), derivative(1), vec![1.0; LEN]];
        1.0 / inverse_information(&columns, &[1.0; LEN]).expect("four different columns")[(0, 0)]
    };
    let energy = (0..PHASES).map(energy).sum::<f64>() / PHASES as f64;
    2.0 * (DROP_99 / energy).powf(0.25) / snr.sqrt()
}

fn column(len: usize, value: impl Fn(f64) -> f64) -> Vec<f64> {
    (0..len).map(|n| value(n as f64 * DT_PS)).collect()
}

/// Inverse of `J^T W J`, its columns scaled to one size meanwhile. `None` if it has none.
fn inverse_information(columns: &[Vec<f64>], weights: &[f64]) -> Option<DMatrix<f64>> {
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).zip(weights).map(|((a, b), w)| a * b * w).sum::<f64>();
    let sizes: Vec<f64> = columns.iter().map(|c| product(c, c).sqrt()).collect();
    let n = columns.len();
    let scaled = DMatrix::from_fn(n, n, |i, j| product(&columns[i], &columns[j]) / (sizes[i] * sizes[j]));
    let inverse = scaled.cholesky()?.inverse();
    Some(DMatrix::from_fn(n, n, |i, j| inverse[(i, j)] / (sizes[i] * sizes[j])))
}
