//! An echo: a second, weaker pulse of the same shape behind the main one, as a mismatched cable makes it.
//!
//! A response that was calibrated with the echo in it explains the echo away. So only its *core* is fitted: from where
//! it rises above a hundredth of its maximum to where it first falls below that again. The residual of the best fit is
//! searched with the core as matched filter (Turin, *An introduction to matched filters*, 1960). A tail that falls as
//! an exponential goes on behind the core: the search begins where its continuation is well below the noise. Not
//! modelled: echoes that overlap the core, and tails that are slower than the core's own end.

use super::pulse_fit::MeanRecord;
use super::reference::fit_pulse;
use super::response::Response;

/// Share of the maximum where the core ends.
const CORE_SHARE: f64 = 0.01;
/// Shares of the maximum between which the decay of the tail is taken.
const DECAY_SHARES: (f64, f64) = (0.3, 0.03);
/// Share of the standard deviation of an amplitude that the tail may still make up where the search begins.
const TAIL_SHARE: f64 = 0.2;
/// Fewer samples outside the core say nothing of the baseline.
const OUTSIDE_MIN: usize = 16;
/// Level, in standard deviations, at which positions are counted as independent.
const LEVEL: f64 = 4.0;

/// The core of a response.
#[derive(Clone, Debug)]
pub struct Core {
    /// The core as a response.
    pub response: Response,
    start_ps: f64,
    end_ps: f64,
    decay_ps: f64,
}

/// The largest echo of a record.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Echo {
    /// Its amplitude over that of the main pulse.
    pub ratio: f64,
    /// Standard deviation of the ratio.
    pub ratio_sd: f64,
    /// How far it lies behind the main pulse.
    pub delay_ps: f64,
    /// Independent positions among which it is the largest.
    pub trials: f64,
}

impl Core {
    /// Core of a calibrated response; `None` for a step, which has none.
    #[must_use]
    pub fn of(response: &Response, step_ps: f64) -> Option<Self> {
        if response.is_step() {
            return None;
        }
        let (first_ps, last_ps) = response.support_ps();
        let (peak_ps, height) = (response.peak_ps(), response.height());
        let above = |time_ps: f64, share: f64| response.value(time_ps) > share * height;
        let after = |share: f64| {
            let mut time_ps = peak_ps;
            while time_ps + step_ps <= last_ps && above(time_ps, share) {
                time_ps += step_ps;
            }
            time_ps
        };
        let mut start_ps = peak_ps;
        while start_ps - step_ps >= first_ps && above(start_ps, CORE_SHARE) {
            start_ps -= step_ps;
        }
        let end_ps = after(CORE_SHARE);
        let decay_ps = (after(DECAY_SHARES.1) - after(DECAY_SHARES.0)) / (DECAY_SHARES.0 / DECAY_SHARES.1).ln();
        let count = ((end_ps - start_ps) / step_ps).round() as usize + 1;
        if count < 4 {
            return None;
        }
        let values: Vec<f64> = (0..count).map(|i| response.value(start_ps + i as f64 * step_ps)).collect();
        Some(Self { response: Response::new(start_ps, step_ps, &values), start_ps, end_ps, decay_ps })
    }
}

/// The largest echo in a record whose samples see the core as `seen` (what averaging leaves of it). `None` without a
/// main pulse, or when too little of the record is left behind it.
///
/// # Panics
/// When the step or the noise of the record is not positive.
#[must_use]
pub fn largest(record: &MeanRecord<'_>, core: &Core, seen: &Response) -> Option<Echo> {
    assert!(record.dt_ps > 0.0 && record.noise > 0.0, "a record has a step and noise");
    let dt_ps = record.dt_ps;
    let main = fit_pulse(record.samples, dt_ps, seen)?;
    // The filter's taps for an echo between two samples and on a sample: their places relative to it, in samples.
    let taps = |fraction: f64| {
        let first = (core.start_ps / dt_ps - fraction).ceil() as i64;
        let last = (core.end_ps / dt_ps - fraction).floor() as i64;
        let values: Vec<f64> = (first..=last).map(|n| seen.value((n as f64 + fraction) * dt_ps)).collect();
        (first, values)
    };
    let filters = [taps(0.0), taps(0.5)];
    let power = |taps: &[f64]| taps.iter().map(|tap| tap * tap).sum::<f64>();
    let (sum, square) = (filters[0].1.iter().sum::<f64>(), power(&filters[0].1));
    if square == 0.0 {
        return None;
    }
    let ratio_noise = record.sd_of_sum(&filters[0].1) / square / main.amplitude.abs();
    let begin_ps = main.time_ps + begin_ps(core, ratio_noise);
    let end_ps = record.samples.len() as f64 * dt_ps;
    let residual: Vec<f64> = (0..record.samples.len())
        .map(|n| record.samples[n] - main.amplitude * seen.value(n as f64 * dt_ps - main.time_ps))
        .collect();
    let outside = |n: usize| {
        let time_ps = n as f64 * dt_ps;
        time_ps < main.time_ps + 2.0 * core.start_ps || time_ps > begin_ps + core.start_ps
    };
    let quiet: Vec<f64> = (0..residual.len()).filter(|&n| outside(n)).map(|n| residual[n]).collect();
    if quiet.len() < OUTSIDE_MIN {
        return None;
    }
    let floor = quiet.iter().sum::<f64>() / quiet.len() as f64;
    let mut best: Option<(f64, f64)> = None;
    for (fraction, (first, taps)) in [0.0, 0.5].iter().zip(&filters) {
        let square = power(taps);
        // An echo at place n - fraction: its tap k meets sample n + first + k.
        let from = (begin_ps / dt_ps + fraction).ceil() as i64;
        let to = ((end_ps - core.end_ps) / dt_ps).floor() as i64;
        for n in from..to {
            let at = n + first;
            let Some(samples) = usize::try_from(at).ok().and_then(|at| residual.get(at..at + taps.len())) else {
                continue;
            };
            let matched: f64 = samples.iter().zip(taps).map(|(value, tap)| (value - floor) * tap).sum();
            let ratio = matched / square / main.amplitude;
            if best.is_none_or(|(most, _)| ratio.abs() > most.abs()) {
                best = Some((ratio, (n as f64 - fraction) * dt_ps - main.time_ps));
            }
        }
    }
    let (ratio, delay_ps) = best?;
    // The floor that was taken off takes part of the filter's noise with it.
    let together: f64 = record.acf.iter().enumerate().map(|(lag, r)| if lag == 0 { *r } else { 2.0 * r }).sum();
    let taken = (record.noise / square / main.amplitude * sum).powi(2) * together.max(0.0) / quiet.len() as f64;
    let ratio_sd = (ratio_noise * ratio_noise - taken).max(0.25 * ratio_noise * ratio_noise).sqrt();
    let searched_ps = (end_ps - core.end_ps - begin_ps).max(0.0);
    Some(Echo { ratio, ratio_sd, delay_ps, trials: trials(seen, core, dt_ps, searched_ps) })
}

/// How far behind the main pulse an echo is first sought: where it lies clear of the core, and the tail's continuation
/// adds little to it.
fn begin_ps(core: &Core, ratio_sd: f64) -> f64 {
    let step_ps = (core.end_ps - core.start_ps) / 256.0;
    let grid = || (0..=256).map(|i| core.start_ps + f64::from(i) * step_ps);
    let square: f64 = grid().map(|u_ps| core.response.value(u_ps).powi(2)).sum();
    let height = core.response.height();
    // What the filter at the core's end makes of a tail that has the height 1 there.
    let gain: f64 = grid().map(|u_ps| core.response.value(u_ps) * (-u_ps / core.decay_ps).exp()).sum::<f64>() / square;
    let below = (CORE_SHARE * height * gain / (TAIL_SHARE * ratio_sd)).ln();
    (core.end_ps + core.decay_ps * below).max(core.end_ps - core.start_ps)
}

/// Number of independent positions: times the chance at one of them, it is the expected number of excursions of the
/// filter's output beyond [`LEVEL`]. Source: Rice, *Mathematical analysis of random noise*, 1944.
fn trials(seen: &Response, core: &Core, dt_ps: f64, searched_ps: f64) -> f64 {
    let step_ps = dt_ps / 16.0;
    let count = ((core.end_ps - core.start_ps) / step_ps) as usize;
    let (mut square, mut slopes) = (0.0, 0.0);
    for i in 0..=count {
        let (value, slope) = seen.value_and_slope(core.start_ps + i as f64 * step_ps);
        square += value * value;
        slopes += slope * slope;
    }
    let positions = 2.0 * searched_ps / dt_ps;
    let excursions = searched_ps * (slopes / square).sqrt() * LEVEL / std::f64::consts::TAU.sqrt();
    (1.0 + excursions.min(positions)).ceil()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tails;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    const DT_PS: f64 = 50.0;

    fn gaussian(t_ps: f64) -> f64 {
        (-0.5 * (t_ps / 106.2).powi(2)).exp()
    }

    /// A Gaussian edge of 33 ps with a decay of 112 ps, by quadrature; its maximum is 1, at 0.
    fn decaying(t_ps: f64) -> f64 {
        const MODE_PS: f64 = 41.1;
        let value = |t_ps: f64| {
            let terms = (0..1500).map(|k| f64::from(k) * 2.0);
            terms.map(|s| (-s / 112.0).exp() * (-0.5 * ((t_ps - s) / 33.0).powi(2)).exp()).sum::<f64>()
        };
        value(t_ps + MODE_PS) / value(MODE_PS)
    }

    fn response(shape: fn(f64) -> f64) -> Response {
        let values: Vec<f64> = (-96..=320).map(|i| shape(f64::from(i) * 6.25)).collect();
        Response::new(-600.0, 6.25, &values)
    }

    fn record(shape: &Response, echo: Option<(f64, f64)>, noise: f64, rng: &mut ChaCha8Rng) -> Vec<f64> {
        let at_ps = 1500.0 + rng.random_range(0.0..50.0);
        (0..300)
            .map(|n| {
                let t_ps = f64::from(n) * DT_PS - at_ps;
                let normal: f64 = StandardNormal.sample(rng);
                let second = echo.map_or(0.0, |(ratio, delay_ps)| ratio * shape.value(t_ps - delay_ps));
                shape.value(t_ps) + second + 0.01 + noise * normal
            })
            .collect()
    }

    fn search(samples: &[f64], core: &Core, noise: f64) -> Echo {
        largest(&MeanRecord { samples, dt_ps: DT_PS, noise, acf: &[1.0] }, core, &core.response).unwrap()
    }

    #[test]
    fn an_echo_is_found_with_its_ratio_and_delay() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for shape in [response(gaussian), response(decaying)] {
            let core = Core::of(&shape, 6.25).unwrap();
            for ratio in [0.02, -0.03] {
                let samples = record(&shape, Some((ratio, 6000.0)), 1e-3, &mut rng);
                let echo = search(&samples, &core, 1e-3);
                assert!((echo.ratio - ratio).abs() < 4.0 * echo.ratio_sd + 0.03 * ratio.abs(), "{echo:?}");
                assert!((echo.delay_ps - 6000.0).abs() < 30.0, "{echo:?}");
            }
        }
    }

    #[test]
    fn noise_and_tails_are_an_echo_as_rarely_as_the_trials_say() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for (name, shape) in [("Gaussian", response(gaussian)), ("decaying", response(decaying))] {
            let core = Core::of(&shape, 6.25).unwrap();
            for noise in [1e-2, 1e-3, 1e-4] {
                let draws = 1500;
                let chance = |echo: Echo| tails::normal(echo.ratio / echo.ratio_sd) * echo.trials;
                let alarms = (0..draws)
                    .filter(|_| chance(search(&record(&shape, None, noise, &mut rng), &core, noise)) < 0.05)
                    .count();
                let rate = alarms as f64 / f64::from(draws);
                eprintln!("{name}, noise {noise}: {rate:.3}");
                assert!((0.01..0.075).contains(&rate), "{name}, noise {noise}: {rate}");
            }
        }
    }
}
