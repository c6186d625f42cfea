//! Whether a third pulse stands between two that blend.
//!
//! Two pulses of open times imitate a third between them, the better the closer they are. At a distance d and a
//! Gaussian response of sd s, the residual of the third is of the order `(d / 2 s)^4`: a fit of two pulses looks good
//! whether or not a third is there. So two fits are compared by their likelihood ratio: one with nothing between, one
//! with at least a stated share of the weaker pulse. Times and amplitudes of both pulses are free in either fit
//! (profile likelihood, see Murphy and van der Vaart, J. Am. Stat. Assoc. 95, 449 (2000)). Nothing is linearised over
//! the distances that times move: a strong third pulse moves its neighbours by tens of picoseconds.
//!
//! What the model may lack comes in as light with a prior: the spread in time of each pulse's light, and strays at
//! known places.

use super::regression::{Regression, least_squares};
use super::response::Response;
use super::sparse::Profile;
use super::whiten::Whitener;

/// Steps at most, and how often one is halved.
const STEPS: usize = 60;
const HALVINGS: i32 = 12;
/// A step that lowers chi-square by less is the last.
const SETTLED: f64 = 1e-6;
/// Column of a third pulse that is open, behind both pulses and a constant.
const THIRD: usize = 3;

/// Two pulses of a profile, and what else the profile may hold near them.
#[derive(Clone, Debug)]
pub struct Pair<'a> {
    /// Their times, about.
    pub times_ps: [f64; 2],
    /// Their amplitudes, about, V.
    pub heights_v: [f64; 2],
    /// When light of the place between arrives: 0 with the first, 1 with the second.
    pub place: f64,
    /// Amplitude over that of the weaker of both, from which something counts.
    pub share_least: f64,
    /// Standard deviation about 0 of the variance in time of each pulse's light, ps^2; 0 for points.
    pub spread_sd_ps2: f64,
    /// Further light.
    pub strays: &'a [Stray],
}

/// Light that comes some time after one of both pulses, and is a small share of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stray {
    /// The pulse: 0 or 1.
    pub of: usize,
    /// How much later it comes.
    pub later_ps: f64,
    /// Standard deviation of its amplitude about 0, over the pulse's.
    pub share_sd: f64,
}

/// What a profile says of something between two pulses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Between {
    /// Least chi-square with nothing between.
    pub free_chi2: f64,
    /// Least chi-square with at least the share between.
    pub occupied_chi2: f64,
    /// The likeliest share, of any sign.
    pub share: f64,
    /// Its standard deviation.
    pub share_sd: f64,
}

/// Judges a profile; `None` where it does not hold both pulses.
///
/// # Panics
/// As [`super::sparse::fit`], and when heights are not positive.
#[must_use]
pub fn between(profile: &Profile, response: &Response, pair: &Pair) -> Option<Between> {
    assert!(pair.heights_v.iter().all(|height_v| *height_v > 0.0), "pulses have a height");
    let model = PairModel::new(profile, response, pair);
    let free = model.fit(Third::None, pair.times_ps)?;
    let open = model.fit(Third::Open, free.times_ps)?;
    let Share { value: share, sd: share_sd } = open.share?;
    // The least share of the weaker is the least share of either.
    let tied = || [0, 1].into_iter().filter_map(|of| model.fit(Third::Share(of), free.times_ps));
    let occupied_chi2 =
        if share >= pair.share_least { open.chi2 } else { tied().map(|fit| fit.chi2).min_by(f64::total_cmp)? };
    Some(Between { free_chi2: free.chi2, occupied_chi2, share, share_sd })
}

/// What is between.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Third {
    None,
    /// Of any amplitude.
    Open,
    /// The least share of one of both pulses.
    Share(usize),
}

/// A fit.
struct Fit {
    times_ps: [f64; 2],
    chi2: f64,
    /// Of a third that is open.
    share: Option<Share>,
}

/// The third's amplitude over that of the weaker of both.
struct Share {
    value: f64,
    sd: f64,
}

impl Share {
    fn of(whole: &Regression) -> Self {
        let (values, covariance) = (&whole.values, &whole.covariance);
        let weaker = usize::from(values[1] < values[0]);
        let value = values[THIRD] / values[weaker];
        let variance = covariance[THIRD][THIRD] - 2.0 * value * covariance[THIRD][weaker]
            + value * value * covariance[weaker][weaker];
        Self { value, sd: variance.sqrt() / values[weaker] }
    }
}

struct PairModel<'a> {
    pair: &'a Pair<'a>,
    response: &'a Response,
    whitener: Whitener,
    t0_ps: f64,
    dt_ps: f64,
    constant: Vec<f64>,
    /// Whitened samples, then zeros that the light with a prior is measured against.
    right: Vec<f64>,
    sd: Vec<f64>,
}

impl<'a> PairModel<'a> {
    fn new(profile: &Profile, response: &'a Response, pair: &'a Pair<'a>) -> Self {
        let whitener = Whitener::new(profile.sd_v, profile.acf);
        let priors = 2 * usize::from(pair.spread_sd_ps2 > 0.0) + pair.strays.len();
        let mut right = whitener.apply(profile.mean_v);
        let mut constant = whitener.apply(&vec![1.0; profile.mean_v.len()]);
        let rows = right.len() + priors;
        [&mut right, &mut constant].into_iter().for_each(|column| column.resize(rows, 0.0));
        Self {
            pair,
            response,
            whitener,
            t0_ps: profile.t0_ps,
            dt_ps: profile.dt_ps,
            constant,
            right,
            sd: vec![1.0; rows],
        }
    }

    fn samples(&self) -> usize {
        self.right.len() - 2 * usize::from(self.pair.spread_sd_ps2 > 0.0) - self.pair.strays.len()
    }

    /// A whitened column of light: a function of the time since its arrival.
    fn column(&self, time_ps: f64, value: impl Fn(f64) -> f64) -> Vec<f64> {
        let samples: Vec<f64> =
            (0..self.samples()).map(|n| value(self.t0_ps + n as f64 * self.dt_ps - time_ps)).collect();
        let mut column = self.whitener.apply(&samples);
        column.resize(self.right.len(), 0.0);
        column
    }

    fn pulse(&self, time_ps: f64) -> Vec<f64> {
        self.column(time_ps, |after_ps| self.response.value(after_ps))
    }

    fn slope(&self, time_ps: f64) -> Vec<f64> {
        self.column(time_ps, |after_ps| -self.response.value_and_slope(after_ps).1)
    }

    fn third_ps(&self, times_ps: [f64; 2]) -> f64 {
        times_ps[0] + self.pair.place * (times_ps[1] - times_ps[0])
    }

    /// Light whose amplitudes are unknown: both pulses, a constant, the third where it is open, and what has a prior.
    fn light(&self, third: Third, times_ps: [f64; 2]) -> Vec<Vec<f64>> {
        let mut columns = times_ps.map(|time_ps| self.pulse(time_ps)).to_vec();
        columns.push(self.constant.clone());
        let between = || self.pulse(self.third_ps(times_ps));
        match third {
            Third::None => {}
            Third::Open => columns.push(between()),
            Third::Share(of) => add(&mut columns[of], &between(), self.pair.share_least),
        }
        let mut with_prior: Vec<(Vec<f64>, f64)> = Vec::new();
        if self.pair.spread_sd_ps2 > 0.0 {
            // Light of a variance v in time: v / 2 of the response's curvature.
            let widened = |(time_ps, height_v): (f64, f64)| {
                let column = self.column(time_ps, |after_ps| self.response.curvature(after_ps));
                (column, 0.5 * self.pair.spread_sd_ps2 * height_v)
            };
            with_prior.extend(times_ps.into_iter().zip(self.pair.heights_v).map(widened));
        }
        with_prior.extend(self.pair.strays.iter().map(|stray| {
            (self.pulse(times_ps[stray.of] + stray.later_ps), stray.share_sd * self.pair.heights_v[stray.of])
        }));
        for (k, (mut column, sd)) in with_prior.into_iter().enumerate() {
            column[self.samples() + k] = 1.0 / sd;
            columns.push(column);
        }
        columns
    }

    /// Amplitudes for given times; `None` where they do not come out positive.
    fn amplitudes(&self, third: Third, times_ps: [f64; 2]) -> Option<Regression> {
        let fit = least_squares(&self.light(third, times_ps), &self.right, &self.sd)?;
        (fit.values[0] > 0.0 && fit.values[1] > 0.0).then_some(fit)
    }

    /// What a sample changes by with either time, for given amplitudes.
    fn slopes(&self, third: Third, times_ps: [f64; 2], values: &[f64]) -> [Vec<f64>; 2] {
        let third_v = self.third_v(third, values);
        let shares = [1.0 - self.pair.place, self.pair.place];
        [0, 1].map(|of| {
            let mut slope = vec![0.0; self.right.len()];
            add(&mut slope, &self.slope(times_ps[of]), values[of]);
            if third_v != 0.0 {
                add(&mut slope, &self.slope(self.third_ps(times_ps)), third_v * shares[of]);
            }
            slope
        })
    }

    fn third_v(&self, third: Third, values: &[f64]) -> f64 {
        match third {
            Third::None => 0.0,
            Third::Open => values[THIRD],
            Third::Share(of) => self.pair.share_least * values[of],
        }
    }

    /// Least squares over times and amplitudes: Gauss and Newton on the times, all amplitudes solved for at each.
    fn fit(&self, third: Third, start_ps: [f64; 2]) -> Option<Fit> {
        let mut times_ps = start_ps;
        let mut linear = self.amplitudes(third, times_ps)?;
        let mut share = None;
        for _ in 0..STEPS {
            let mut columns = self.light(third, times_ps);
            let lights = columns.len();
            columns.extend(self.slopes(third, times_ps, &linear.values));
            let whole = least_squares(&columns, &self.right, &self.sd)?;
            if third == Third::Open {
                share = Some(Share::of(&whole));
            }
            let step_ps = [whole.values[lights], whole.values[lights + 1]];
            let lower = (0..HALVINGS).find_map(|halvings| {
                let moved_ps = [0, 1].map(|of| times_ps[of] + step_ps[of] * 0.5_f64.powi(halvings));
                let next = self.amplitudes(third, moved_ps)?;
                (next.chi2 < linear.chi2).then_some((moved_ps, next))
            });
            let Some((moved_ps, next)) = lower else { break };
            let less = linear.chi2 - next.chi2;
            (times_ps, linear) = (moved_ps, next);
            if less < SETTLED {
                break;
            }
        }
        Some(Fit { times_ps, chi2: linear.chi2, share })
    }
}

fn add(sum: &mut [f64], column: &[f64], factor: f64) {
    sum.iter_mut().zip(column).for_each(|(sum, value)| *sum += factor * value);
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    const COUNT: usize = 60;
    const DT_PS: f64 = 50.0;

    fn gaussian(sigma_ps: f64) -> Response {
        let values: Vec<f64> = (-120..=120).map(|i| (-0.5 * (f64::from(i) * 5.0 / sigma_ps).powi(2)).exp()).collect();
        Response::new(-600.0, 5.0, &values)
    }

    /// Two pulses 200 ps apart, and a third between, under a response of 250 ps; noise of 1.
    fn record(heights_v: [f64; 3], seed: u64) -> Vec<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let response = gaussian(106.0);
        let light = |time_ps: f64| -> f64 {
            [1400.0, 1500.0, 1600.0]
                .iter()
                .zip(heights_v)
                .map(|(at, height_v)| height_v * response.value(time_ps - at))
                .sum()
        };
        let mut noise = || -> f64 { StandardNormal.sample(&mut rng) };
        (0..COUNT).map(|n| 3.0 + light(DT_PS * n as f64) + noise()).collect()
    }

    fn profile<'a>(mean_v: &'a [f64], sd_v: &'a [f64]) -> Profile<'a> {
        Profile { mean_v, sd_v, acf: &[1.0], slow_v2: &[], jitter: None, t0_ps: 0.0, dt_ps: DT_PS }
    }

    fn pair(height_v: f64) -> Pair<'static> {
        Pair {
            times_ps: [1400.0, 1600.0],
            heights_v: [height_v; 2],
            place: 0.5,
            share_least: 1.0 / 3.0,
            spread_sd_ps2: 0.0,
            strays: &[],
        }
    }

    /// Least squares over a fine grid of both times, and of the third's share of either, by columns written out.
    #[test]
    fn both_hypotheses_are_the_best_of_their_kind() {
        let (response, sd_v) = (gaussian(106.0), vec![1.0; COUNT]);
        for (seed, third_v) in [(1, 0.0), (2, 12.0), (3, 60.0)] {
            let mean_v = record([100.0, third_v, 140.0], seed);
            let estimate = between(&profile(&mean_v, &sd_v), &response, &pair(100.0)).unwrap();
            let chi2 = |of: Option<usize>, times_ps: [f64; 2]| {
                let pulse =
                    |at_ps: f64| (0..COUNT).map(|n| response.value(DT_PS * n as f64 - at_ps)).collect::<Vec<_>>();
                let mut columns = vec![pulse(times_ps[0]), pulse(times_ps[1]), vec![1.0; COUNT]];
                let between = pulse(0.5 * (times_ps[0] + times_ps[1]));
                of.iter().for_each(|of| add(&mut columns[*of], &between, 1.0 / 3.0));
                least_squares(&columns, &mean_v, &sd_v).unwrap().chi2
            };
            // A coarse grid, and finer ones about its best.
            let least = |of: Option<usize>| {
                let (mut best, mut at_ps) = (f64::INFINITY, [1400.0, 1600.0]);
                for step_ps in [4.0, 0.4, 0.04] {
                    let centre_ps = at_ps;
                    for (a, b) in (-15..=15).flat_map(|a| (-15..=15).map(move |b| (f64::from(a), f64::from(b)))) {
                        let times_ps = [centre_ps[0] + step_ps * a, centre_ps[1] + step_ps * b];
                        let here = chi2(of, times_ps);
                        if here < best {
                            (best, at_ps) = (here, times_ps);
                        }
                    }
                }
                best
            };
            let is_least = |estimate: f64, naive: f64| (naive - 1e-2..naive + 1e-6).contains(&estimate);
            assert!(is_least(estimate.free_chi2, least(None)), "{estimate:?}");
            if estimate.share < 1.0 / 3.0 {
                assert!(is_least(estimate.occupied_chi2, least(Some(0)).min(least(Some(1)))), "{estimate:?}");
            } else {
                assert!(estimate.occupied_chi2 <= estimate.free_chi2 + 1e-6, "{estimate:?}");
            }
        }
    }

    /// Errors of the share are as large as its standard deviation, which blended pulses make a tenth of the weaker at
    /// an SNR of 100.
    #[test]
    fn shares_have_the_errors_that_they_are_said_to_have() {
        let (response, sd_v) = (gaussian(106.0), vec![1.0; COUNT]);
        for share in [0.0, 0.5] {
            let draws = 300;
            let errors: Vec<f64> = (0..draws)
                .map(|seed| {
                    let mean_v = record([300.0, 300.0 * share, 300.0], seed);
                    let estimate = between(&profile(&mean_v, &sd_v), &response, &pair(300.0)).unwrap();
                    assert!(estimate.share_sd > 0.02 && estimate.share_sd < 0.08, "{estimate:?}");
                    (estimate.share - share) / estimate.share_sd
                })
                .collect();
            let square = errors.iter().map(|error| error * error).sum::<f64>() / draws as f64;
            // Five standard errors of a mean square.
            assert!((square - 1.0).abs() < 5.0 * (2.0 / draws as f64).sqrt(), "share {share}: {square}");
        }
    }

    /// Spread light and strays do not pass for a third pulse where they are allowed for.
    #[test]
    fn what_the_model_lacks_is_not_taken_for_a_pulse() {
        let (response, sd_v) = (gaussian(106.0), vec![1.0; COUNT]);
        let wide = gaussian(106.0_f64.hypot(15.0));
        let light = |time_ps: f64| {
            2000.0 * (wide.value(time_ps - 1400.0) + wide.value(time_ps - 1600.0))
                + 40.0 * response.value(time_ps - 1700.0)
        };
        let mean_v: Vec<f64> = (0..COUNT).map(|n| light(DT_PS * n as f64)).collect();
        let stray = Stray { of: 1, later_ps: 100.0, share_sd: 0.02 };
        let judged = |spread_sd_ps2: f64, strays: &[Stray]| {
            let pair = Pair { spread_sd_ps2, strays, ..pair(2000.0) };
            between(&profile(&mean_v, &sd_v), &response, &pair).unwrap()
        };
        let (blind, warned) = (judged(0.0, &[]), judged(300.0, &[stray]));
        assert!((blind.share / blind.share_sd).abs() > 5.0, "{blind:?}");
        assert!((warned.share / warned.share_sd).abs() < 2.0, "{warned:?}");
    }
}
