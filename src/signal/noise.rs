//! Noise of a record: standard deviation and autocorrelation, from stretches without light.

use super::sums::sum;
use super::whiten::Predictors;
use super::widest::widest;

/// What stretches of noise say.
#[derive(Clone, Debug, PartialEq)]
pub struct Noise {
    /// Standard deviation of a sample.
    pub sd: f64,
    /// Autocorrelation at lags 0, 1, 2... (1 at lag 0); shorter than asked for where stretches are.
    pub acf: Vec<f64>,
}

/// Noise of stretches of samples, each with its own mean removed; `lags` autocorrelations. Stretches of fewer than two
/// samples do not count.
///
/// The mean that is removed takes its own variance with it at every lag: that part is given back, on the supposition
/// that nothing is correlated beyond `lags` and half a stretch.
#[must_use]
pub fn estimate(stretches: &[Vec<f64>], lags: usize) -> Noise {
    let stretches: Vec<&Vec<f64>> = stretches.iter().filter(|stretch| stretch.len() >= 2).collect();
    let shortest = stretches.iter().map(|stretch| stretch.len()).min().unwrap_or(0);
    if shortest == 0 {
        return Noise { sd: 0.0, acf: Vec::new() };
    }
    let lags = lags.clamp(1, shortest);
    let mean = |stretch: &[f64]| sum(stretch) / stretch.len() as f64;
    let centred = lagged_means(&stretches, lags, mean);
    let length = stretches.iter().map(|stretch| stretch.len()).sum::<usize>() / stretches.len();
    of_covariances(&undo_centring(&centred, length))
}

/// Noise of stretches of mean 0 that lack a part of the autocovariance `lacking` at lags 0, 1, ..; as many
/// autocorrelations, or fewer where stretches are shorter.
#[must_use]
pub fn estimate_of_rest(stretches: &[Vec<f64>], lacking: &[f64]) -> Noise {
    let stretches: Vec<&Vec<f64>> = stretches.iter().filter(|stretch| !stretch.is_empty()).collect();
    let shortest = stretches.iter().map(|stretch| stretch.len()).min().unwrap_or(0);
    let means = lagged_means(&stretches, lacking.len().min(shortest), |_| 0.0);
    of_covariances(&means.iter().zip(lacking).map(|(mean, lacking)| mean + lacking).collect::<Vec<_>>())
}

fn of_covariances(covariances: &[f64]) -> Noise {
    let variance = covariances.first().map_or(0.0, |variance| variance.max(0.0));
    let correlation =
        |(lag, covariance): (usize, &f64)| if lag == 0 || variance == 0.0 { 1.0 } else { covariance / variance };
    Noise { sd: variance.sqrt(), acf: covariances.iter().enumerate().map(correlation).collect() }
}

/// Means of the products of all samples, less the `middle` of their stretch, with those so many lags later.
fn lagged_means(stretches: &[&Vec<f64>], lags: usize, middle: impl Fn(&[f64]) -> f64) -> Vec<f64> {
    let mut products = vec![0.0; lags];
    let mut rooms = <[Vec<f64>; LANES]>::default();
    stretches.iter().for_each(|stretch| add_lagged_products(&mut products, stretch, middle(stretch), &mut rooms));
    let pairs = |lag: usize| stretches.iter().map(|stretch| stretch.len() - lag).sum::<usize>();
    products.iter().enumerate().map(|(lag, sum)| sum / pairs(lag) as f64).collect()
}

/// Covariances at lags 0, 1, .. from those of stretches of `length` samples whose means were removed: the fixed point
/// of `c = centred + loss(c)`. The loss is the smaller the shorter the correlation, so that the iteration contracts.
///
/// With m the mean of a stretch of L samples, the covariance at a lag k loses the mean over n of
/// `cov(x_n, m) + cov(x_{n + k}, m) - var(m)`. Let `s(n)` be the sum of the covariances up to lag n; it is constant
/// beyond the last correlated lag. Let `u(n)` be the sum of the first n values of `s`. Then
/// `L cov(x_n, m) = s(n) + s(L - 1 - n) - c_0`, and the loss is
/// `2/L ((u(L) + u(L - k) - u(k)) / (L - k) - u(L) / L) - c_0 / L`.
fn undo_centring(centred: &[f64], length: usize) -> Vec<f64> {
    const ROUNDS: usize = 60;
    /// Share of the variance: far less than any estimate knows.
    const SETTLED: f64 = 1e-13;
    let correlated = centred.len().min(length / 2).max(1);
    let mut covariances = centred.to_vec();
    let (mut up_to, mut sums) = (Vec::with_capacity(correlated + 1), Vec::with_capacity(correlated + 1));
    let samples = length as f64;
    for _ in 0..ROUNDS {
        running_sums(&mut up_to, covariances[..correlated].iter().copied());
        running_sums(&mut sums, up_to[1..].iter().copied());
        let u = |n: usize| sums[n.min(correlated)] + n.saturating_sub(correlated) as f64 * up_to[correlated];
        let (variance, whole) = (covariances[0], u(length));
        let mut moved = 0.0_f64;
        for (lag, (c, centred)) in covariances.iter_mut().zip(centred).enumerate() {
            let rest = length - lag;
            let both = (whole + u(rest) - u(lag)) / rest as f64 - whole / samples;
            let next = centred + (2.0 * both - variance) / samples;
            moved = moved.max((next - *c).abs());
            *c = next;
        }
        if moved <= SETTLED * variance.abs() {
            break;
        }
    }
    covariances
}

/// Sums of the first 0, 1, 2, .. values.
fn running_sums(sums: &mut Vec<f64>, values: impl Iterator<Item = f64>) {
    sums.clear();
    sums.push(0.0);
    for value in values {
        sums.push(sums[sums.len() - 1] + value);
    }
}

/// Autocorrelation of the autoregressive process that describes an estimated one best: always a valid one, and without
/// the scatter of lags that say nothing. `samples`: number of samples N behind the estimate.
///
/// The order m has the smallest Bayesian information criterion `N ln v_m + m ln N` (Schwarz, Ann. Stat. 6, 461 (1978)),
/// `v_m` the variance of the error of prediction, among those whose `v_m` is known: lags that are wrong by
/// `1 / sqrt(N)` make it wrong by `|a|^2 / sqrt(N)`, a the filter `1, -phi_1, .., -phi_m`. No order exceeds
/// `N^(1/3) / 2` (Berk, Ann. Stat. 2, 489 (1974): spectra are consistent if m grows more slowly than `N^(1/3)`): an
/// estimate that is nearly none otherwise tempts to the highest, which kills the lowest frequencies. Up to lag m the
/// result is the estimate, behind it the process's continuation.
#[must_use]
pub fn autoregressive(acf: &[f64], samples: usize) -> Vec<f64> {
    let predictors = Predictors::new(acf);
    let n = samples.max(1) as f64;
    let criterion = |m: &usize| n * predictors.variances[*m].ln() + *m as f64 * n.ln();
    let is_reliable = |m: &usize| {
        let squared = 1.0 + predictors.coefficients[*m].iter().map(|phi| phi * phi).sum::<f64>();
        predictors.variances[*m] > squared / n.sqrt()
    };
    let order = (0..=predictors.order())
        .take_while(|m| *m as f64 <= 0.5 * n.cbrt() && is_reliable(m))
        .min_by(|a, b| criterion(a).total_cmp(&criterion(b)))
        .unwrap_or(0);
    let coefficients = &predictors.coefficients[order];
    let mut smooth: Vec<f64> = acf.iter().take(order + 1).map(|r| r / acf[0]).collect();
    while smooth.len() < acf.len() {
        let next = coefficients.iter().zip(smooth.iter().rev()).map(|(phi, r)| phi * r).sum();
        smooth.push(next);
    }
    smooth
}

/// Start of the stretch of `width` samples that vary least.
///
/// # Panics
/// If there are fewer samples than that, or `width` is 0.
#[must_use]
pub fn quietest(samples: &[f64], width: usize) -> usize {
    assert!(width > 0 && samples.len() >= width, "a stretch lies within the samples");
    let (mut sums, mut squares) = (Vec::with_capacity(samples.len() + 1), Vec::with_capacity(samples.len() + 1));
    // About the mean of all: differences of sums lose nothing that counts.
    let middle = samples.iter().sum::<f64>() / samples.len() as f64;
    running_sums(&mut sums, samples.iter().map(|sample| sample - middle));
    running_sums(&mut squares, samples.iter().map(|sample| (sample - middle) * (sample - middle)));
    let variance = |start: usize| {
        let sum = sums[start + width] - sums[start];
        squares[start + width] - squares[start] - sum * sum / width as f64
    };
    (0..=samples.len() - width).min_by(|a, b| variance(*a).total_cmp(&variance(*b))).unwrap_or(0)
}

/// Samples, and lags, that the processor takes side by side; the order of additions is fixed.
const LANES: usize = 4;

/// Adds to each sum, of lag 0, 1, .., the products of all samples about `middle` with those as much later. `rooms` are
/// used again from stretch to stretch.
fn add_lagged_products(sums: &mut [f64], stretch: &[f64], middle: f64, rooms: &mut [Vec<f64>; LANES]) {
    let steps = stretch.len().div_ceil(LANES);
    // Each from one sample later on: from one memory alone, lanes of neighbouring lags would be shuffled into place.
    for (later, room) in rooms.iter_mut().enumerate() {
        room.clear();
        room.extend(stretch[later.min(stretch.len())..].iter().map(|value| value - middle));
        // What lies beyond the end adds nothing.
        room.resize(LANES * steps + sums.len() + LANES, 0.0);
    }
    let [early, ..] = rooms.each_ref().map(|room| room.as_chunks::<LANES>().0);
    let early = &early[..steps];
    for (group, sums) in sums.chunks_mut(LANES).enumerate() {
        let [a, b, c, d] = rooms.each_ref().map(|room| &room.as_chunks::<LANES>().0[group..group + steps]);
        let mut lanes = [[0.0; LANES]; LANES];
        widest(
            #[inline(always)]
            || {
                let mut own = lanes;
                for ((((early, a), b), c), d) in early.iter().zip(a).zip(b).zip(c).zip(d) {
                    for lane in 0..LANES {
                        own[0][lane] += early[lane] * a[lane];
                        own[1][lane] += early[lane] * b[lane];
                        own[2][lane] += early[lane] * c[lane];
                        own[3][lane] += early[lane] * d[lane];
                    }
                }
                lanes = own;
            },
        );
        sums.iter_mut().zip(lanes).for_each(|(sum, lanes)| *sum += lanes.iter().sum::<f64>());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn white_and_smoothed_noise_are_recognised() {
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

    /// `x_n = phi x_{n-1} + e_n` of variance 1, from its stationary state on.
    fn first_order(phi: f64, len: usize, rng: &mut ChaCha8Rng) -> Vec<f64> {
        let mut draw = || -> f64 { StandardNormal.sample(rng) };
        let mut x = draw();
        (0..len)
            .map(|_| {
                let this = x;
                x = phi * x + (1.0 - phi * phi).sqrt() * draw();
                this
            })
            .collect()
    }

    /// Short stretches: what their means take of slow noise is given back, in the variance and at every lag.
    #[test]
    fn removed_means_do_not_bias_correlated_noise() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let stretches: Vec<Vec<f64>> = (0..4000).map(|_| first_order(0.7, 40, &mut rng)).collect();
        let noise = estimate(&stretches, 16);
        assert!((noise.sd - 1.0).abs() < 0.01, "{}", noise.sd);
        for (lag, r) in noise.acf.iter().enumerate() {
            assert!((r - 0.7_f64.powi(lag as i32)).abs() < 0.015, "{lag}: {r}");
        }
    }

    /// Against the definition: every product of two samples about the mean of their stretch, by the covariances of
    /// samples.
    #[test]
    fn what_centring_takes_is_given_back() {
        let covariances = [2.0, 1.1, -0.3, 0.2, 0.05, -0.1];
        let length = 48;
        let of = |a: usize, b: usize| covariances.get(a.abs_diff(b)).copied().unwrap_or(0.0);
        let with_mean = |n: usize| (0..length).map(|k| of(n, k)).sum::<f64>() / length as f64;
        let variance = (0..length).map(with_mean).sum::<f64>() / length as f64;
        let centred = |lag: usize| {
            let products = (0..length - lag).map(|n| of(n, n + lag) - with_mean(n) - with_mean(n + lag) + variance);
            products.sum::<f64>() / (length - lag) as f64
        };
        let centred: Vec<f64> = (0..covariances.len()).map(centred).collect();
        let back = undo_centring(&centred, length);
        assert!(back.iter().zip(&covariances).all(|(a, b)| (a - b).abs() < 1e-11), "{back:?}");
    }

    #[test]
    fn the_autoregressive_process_is_recognised_and_continued() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let (mut raw, mut smooth) = ([0.0; 16], [0.0; 16]);
        for _ in 0..200 {
            let stretches: Vec<Vec<f64>> = (0..16).map(|_| first_order(0.5, 40, &mut rng)).collect();
            let noise = estimate(&stretches, 16);
            let model = autoregressive(&noise.acf, 640);
            assert_eq!((model.len(), model[0]), (16, 1.0));
            for lag in 0..16 {
                let truth = 0.5_f64.powi(lag as i32);
                raw[lag] += (noise.acf[lag] - truth).powi(2);
                smooth[lag] += (model[lag] - truth).powi(2);
            }
        }
        assert!(smooth[8..].iter().sum::<f64>() < 0.5 * raw[8..].iter().sum::<f64>(), "{smooth:?} {raw:?}");
        // An exact one of order 1 stays what it is; nothing stays nothing; too few samples say nothing.
        let exact = [1.0, 0.5, 0.25, 0.125];
        assert!(autoregressive(&exact, 1000).iter().zip(&exact).all(|(a, b)| (a - b).abs() < 1e-12));
        assert_eq!(autoregressive(&[], 10), Vec::<f64>::new());
        assert_eq!(autoregressive(&[2.0, 0.2], 2), [1.0, 0.0]);
    }

    #[test]
    fn the_quietest_stretch_is_where_no_light_is() {
        let samples: Vec<f64> =
            (0..100).map(|n| 5.0 + 30.0 * (-0.5 * ((f64::from(n) - 20.0) / 8.0).powi(2)).exp()).collect();
        assert!(quietest(&samples, 20) > 60 && quietest(&samples, 100) == 0);
    }

    /// Lags side by side, on lengths that are no multiple of what is taken at once.
    #[test]
    fn products_are_those_of_all_pairs() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        for (len, lags) in (1..40).flat_map(|len| (1..=len).map(move |lags| (len, lags))) {
            let values: Vec<f64> = (0..len).map(|_| StandardNormal.sample(&mut rng)).collect();
            let mut sums = vec![0.5; lags];
            add_lagged_products(&mut sums, &values, 0.25, &mut Default::default());
            for (lag, sum) in sums.iter().enumerate() {
                let products = values.iter().zip(&values[lag..]).map(|(early, late)| (early - 0.25) * (late - 0.25));
                assert!((sum - 0.5 - products.sum::<f64>()).abs() < 1e-12, "{len} samples, lag {lag}");
            }
        }
    }

    #[test]
    fn nothing_is_said_of_nothing() {
        assert_eq!(estimate(&[], 4), Noise { sd: 0.0, acf: vec![] });
        assert_eq!(estimate(&[vec![1.0]], 4).sd, 0.0);
    }
}
