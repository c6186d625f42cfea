//! Noise of a record: standard deviation and autocorrelation, from stretches without light.

/// What stretches of noise say.
#[derive(Clone, Debug, PartialEq)]
pub struct Noise {
    /// Standard deviation of a sample.
    pub sd: f64,
    /// Autocorrelation at lags 0, 1, 2... (1 at lag 0); shorter than asked for where stretches are.
    pub acf: Vec<f64>,
}

/// Noise of stretches of samples, each with its own mean removed; `lags` autocorrelations. Stretches of fewer than two samples do not count.
///
/// The mean that is removed takes part of the variance with it, for white noise one part in the stretch's length at every lag: that part is
/// given back.
#[must_use]
pub fn estimate(stretches: &[Vec<f64>], lags: usize) -> Noise {
    let stretches: Vec<Vec<f64>> =
        stretches.iter().filter(|stretch| stretch.len() >= 2).map(|stretch| centred(stretch)).collect();
    let shortest = stretches.iter().map(Vec::len).min().unwrap_or(0);
    if shortest == 0 {
        return Noise { sd: 0.0, acf: Vec::new() };
    }
    let covariance = |lag: usize| {
        let products: f64 = stretches.iter().map(|s| dot(&s[..s.len() - lag], &s[lag..])).sum();
        let pairs: usize = stretches.iter().map(|s| s.len() - lag).sum();
        products / pairs as f64
    };
    let lost = 1.0 / shortest as f64;
    let variance = covariance(0) / (1.0 - lost);
    let given_back = variance * lost;
    let acf = (0..lags.min(shortest))
        .map(|lag| if lag == 0 || variance == 0.0 { 1.0 } else { (covariance(lag) + given_back) / variance })
        .collect();
    Noise { sd: variance.sqrt(), acf }
}

/// Sum of products in eight interleaved parts, which the processor can take side by side; the order of additions is fixed.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    const LANES: usize = 8;
    let mut sums = [0.0; LANES];
    let (a_parts, b_parts) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest: f64 = a_parts.remainder().iter().zip(b_parts.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in a_parts.zip(b_parts) {
        for lane in 0..LANES {
            sums[lane] += a[lane] * b[lane];
        }
    }
    sums.iter().sum::<f64>() + rest
}

fn centred(stretch: &[f64]) -> Vec<f64> {
    let mean = stretch.iter().sum::<f64>() / stretch.len() as f64;
    stretch.iter().map(|value| value - mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn white_and_smoothed_noise_are_told() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let white: Vec<Vec<f64>> =
            (0..300).map(|_| (0..40).map(|_| StandardNormal.sample(&mut rng)).collect()).collect();
        let noise = estimate(&white, 4);
        assert!((noise.sd - 1.0).abs() < 0.02, "{noise:?}");
        assert!(noise.acf[1..].iter().all(|r| r.abs() < 0.03) && noise.acf[0] == 1.0, "{noise:?}");
        let smoothed: Vec<Vec<f64>> = white.iter().map(|s| s.windows(2).map(|w| w[0] + w[1]).collect()).collect();
        let noise = estimate(&smoothed, 4);
        assert!(
            (noise.sd - 2_f64.sqrt()).abs() < 0.04 && (noise.acf[1] - 0.5).abs() < 0.04 && noise.acf[2].abs() < 0.04,
            "{noise:?}"
        );
    }

    #[test]
    fn nothing_is_said_of_nothing() {
        assert_eq!(estimate(&[], 4), Noise { sd: 0.0, acf: vec![] });
        assert_eq!(estimate(&[vec![1.0]], 4).sd, 0.0);
    }
}
