//! A pulse shape on a grid finer than the samples, from many shots that hit the samples at different sub-sample times.
//!
//! Every sample of every shot is one value of the same pulse at a known time; a least-squares spline with knots every
//! half sample runs through them all ([`super::spline_fit`]). The shape holds what rises above its noise: the pulse
//! with its tail, and whatever comes later that is certain, such as an echo in the cable; between them it is zero.
//! Where the times of the shots do not spread over a sample, the shots are averaged on their own grid and interpolated
//! band-limited instead. Source: equivalent-time sampling.

use std::f64::consts::TAU;

use super::reference::fit_pulse;
use super::resample;
use super::response::Response;
use super::spline_fit::SplineFit;

/// Fine steps in a sample.
pub const STEPS: usize = 8;
/// Distance of the spline's knots, in samples.
const KNOTS: f64 = 0.5;
/// Rounds of fitting times and renewing the shape.
const ROUNDS: usize = 5;
/// Share of a record at its start that is taken as baseline.
const BASELINE_SHARE: f64 = 0.1;
/// A pulse begins where the mean record has left its first value by this share of the largest deviation.
const RISE_SHARE: f64 = 0.25;
/// The shape is cut where it stays below this many of its standard errors.
const CUT_SIGMA: f64 = 3.0;
/// Behind the pulse, a stretch belongs to the shape if it rises to this many standard errors: an echo.
const FAR_SIGMA: f64 = 6.0;
/// A cell of the fine grid that fewer samples hit has no line of its own.
const HITS_MIN: f64 = 3.0;

/// One shot: samples, and the time of its sample 0.
#[derive(Clone, Debug)]
pub struct Shot {
    /// Samples.
    pub samples: Vec<f64>,
    /// Time of sample 0, in the frame in which the pulses of all shots coincide (or nearly so).
    pub t0_ps: f64,
}

/// A pulse shape on a fine grid, its maximum 1 at time 0; of a step, the steepest rise lies there.
#[derive(Clone, Debug, PartialEq)]
pub struct Shape {
    /// Time of the first value; the maximum is at time 0.
    pub t0_ps: f64,
    /// Fine step.
    pub step_ps: f64,
    /// Values, maximum 1.
    pub values: Vec<f64>,
    /// Where the maximum lay in the frame of the shots.
    pub peak_ps: f64,
    /// Height of the maximum in the unit of the samples; negative for a negative pulse.
    pub height: f64,
}

impl Shape {
    /// As a spline.
    #[must_use]
    pub fn response(&self) -> Response {
        Response::new(self.t0_ps, self.step_ps, &self.values)
    }
}

/// Shape of the pulse in shots whose frames are right. `None` when there is no pulse.
///
/// # Panics
/// When there are no shots, or their lengths differ.
#[must_use]
pub fn shape(shots: &[Shot], dt_ps: f64) -> Option<Shape> {
    let samples = shots.first().expect("a shape needs shots").samples.len();
    assert!(shots.iter().all(|shot| shot.samples.len() == samples), "shots have equal lengths");
    let baseline = quiet(shots, samples);
    let floors: Vec<f64> =
        shots.iter().map(|shot| shot.samples[..baseline].iter().sum::<f64>() / baseline as f64).collect();
    let start_ps = shots.iter().map(|shot| shot.t0_ps).fold(f64::NEG_INFINITY, f64::max);
    let end_ps = shots.iter().map(|shot| shot.t0_ps).fold(f64::INFINITY, f64::min) + (samples - 1) as f64 * dt_ps;
    let step_ps = dt_ps / STEPS as f64;
    let count = ((end_ps - start_ps) / step_ps).floor();
    if count < (4 * STEPS) as f64 {
        return None;
    }
    let grid = Grid { start_ps, step_ps, count: count as usize + 1 };
    let values = if spread_over_a_sample(shots, dt_ps) {
        regress(shots, &floors, dt_ps, &grid)?
    } else {
        interpolate(shots, &floors, dt_ps, &grid)
    };
    let noise = noise_of(&values[..(baseline * STEPS).min(values.len() / 4).max(2)]);
    cut(&grid, values, noise)
}

/// Number of samples at the start of the records that count as baseline: a tenth, or half of what precedes the pulse
/// where that is less.
fn quiet(shots: &[Shot], samples: usize) -> usize {
    let mean = |n: usize| shots.iter().map(|shot| shot.samples[n]).sum::<f64>() / shots.len() as f64;
    let start = mean(0);
    let deviations: Vec<f64> = (0..samples).map(|n| (mean(n) - start).abs()).collect();
    let most = deviations.iter().copied().fold(0.0, f64::max);
    let rise = deviations.iter().position(|deviation| *deviation > RISE_SHARE * most).unwrap_or(samples);
    ((samples as f64 * BASELINE_SHARE) as usize).min(rise / 2).max(1)
}

/// Times of the pulse in shots whose trigger jitters, and its shape: times and shape are estimated in turn.
///
/// Gives for each shot the time of the pulse's maximum in the shot's own frame with its standard deviation; `None`
/// where a shot has no pulse.
///
/// # Panics
/// When there are no shots, or their lengths differ.
#[must_use]
pub fn shape_and_times(shots: &[Shot], dt_ps: f64) -> Option<(Shape, Vec<Option<(f64, f64)>>)> {
    // The first guess of each time is its own highest sample; errors of half a sample widen the first shape, and the
    // rounds take that off again.
    let mut times: Vec<Option<(f64, f64)>> =
        shots.iter().map(|shot| Some((highest(&shot.samples) as f64 * dt_ps + shot.t0_ps, 0.0))).collect();
    let mut latest = None;
    for _ in 0..ROUNDS {
        let pairs = shots.iter().zip(&times).filter_map(|(shot, time)| Some((shot, (*time)?.0)));
        let aligned: Vec<Shot> =
            pairs.map(|(shot, time_ps)| Shot { samples: shot.samples.clone(), t0_ps: shot.t0_ps - time_ps }).collect();
        if aligned.is_empty() {
            return None;
        }
        let shape = shape(&aligned, dt_ps)?;
        let template = shape.response();
        times = shots
            .iter()
            .map(|shot| {
                fit_pulse(&shot.samples, dt_ps, &template).map(|fit| (shot.t0_ps + fit.time_ps, fit.time_sd_ps))
            })
            .collect();
        latest = Some(shape);
    }
    latest.map(|shape| (shape, times))
}

/// The fine grid.
struct Grid {
    start_ps: f64,
    step_ps: f64,
    count: usize,
}

fn highest(samples: &[f64]) -> usize {
    let mut sorted = samples.to_vec();
    let half = sorted.len() / 2;
    let median = *sorted.select_nth_unstable_by(half, f64::total_cmp).1;
    (0..samples.len()).max_by(|&a, &b| (samples[a] - median).abs().total_cmp(&(samples[b] - median).abs())).unwrap_or(0)
}

/// Whether every eighth of a sample is hit by its share of the shots.
fn spread_over_a_sample(shots: &[Shot], dt_ps: f64) -> bool {
    let mut hits = [0.0; STEPS];
    for shot in shots {
        hits[((shot.t0_ps / dt_ps).rem_euclid(1.0) * STEPS as f64) as usize % STEPS] += 1.0;
    }
    let needed = HITS_MIN.max(shots.len() as f64 / (8 * STEPS) as f64);
    hits.iter().all(|hits| *hits >= needed)
}

/// A least-squares spline through all samples, with knots every half sample: what the shots' sub-sample times resolve,
/// and no more noise than that.
fn regress(shots: &[Shot], floors: &[f64], dt_ps: f64, grid: &Grid) -> Option<Vec<f64>> {
    let place = |n: usize| grid.start_ps + n as f64 * grid.step_ps;
    let mut fit = SplineFit::new(grid.start_ps, place(grid.count - 1), KNOTS * dt_ps);
    for (shot, floor) in shots.iter().zip(floors) {
        shot.samples.iter().enumerate().for_each(|(i, sample)| fit.add(shot.t0_ps + i as f64 * dt_ps, sample - floor));
    }
    fit.values((0..grid.count).map(place))
}

/// The mean of the shots on the sample grid of the first, interpolated band-limited.
fn interpolate(shots: &[Shot], floors: &[f64], dt_ps: f64, grid: &Grid) -> Vec<f64> {
    let samples = shots[0].samples.len();
    let (mut mean, mut delayed) = (vec![0.0; samples], vec![0.0; samples]);
    for (shot, floor) in shots.iter().zip(floors) {
        // Value of the shot at the first shot's sample i: its own sample i - offset.
        let offset = (shot.t0_ps - shots[0].t0_ps) / dt_ps;
        let (whole, fraction) = (offset.floor(), offset - offset.floor());
        resample::delay(&shot.samples, fraction, &mut delayed);
        for (i, sum) in mean.iter_mut().enumerate() {
            let at = (i as f64 - whole).clamp(0.0, (samples - 1) as f64) as usize;
            *sum += delayed[at] - floor;
        }
    }
    mean.iter_mut().for_each(|sum| *sum /= shots.len() as f64);
    let fine: Vec<Vec<f64>> = (0..STEPS)
        .map(|k| {
            // Values at i + k / STEPS: a delay by the rest of a sample, read one sample further on.
            let mut fine = vec![0.0; samples];
            resample::delay(&mean, if k == 0 { 0.0 } else { 1.0 - k as f64 / STEPS as f64 }, &mut fine);
            fine
        })
        .collect();
    let value = |n: usize| {
        let place = (grid.start_ps - shots[0].t0_ps) / grid.step_ps + n as f64;
        // The grid of the first shot is met to within rounding, since only then this path is taken for equal times;
        // else the nearest fine step serves.
        let step = place.round().max(0.0) as usize;
        let (i, k) = (step / STEPS, step % STEPS);
        fine[k][(i + usize::from(k > 0)).min(samples - 1)]
    };
    (0..grid.count).map(value).collect()
}

/// Standard deviation about the mean.
fn noise_of(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (values.len() - 1) as f64).sqrt()
}

/// Cuts the shape out where it rises above noise, with tapered margins, and scales it to a maximum of 1 at time 0.
fn cut(grid: &Grid, mut values: Vec<f64>, noise: f64) -> Option<Shape> {
    let strongest = (0..values.len()).max_by(|&a, &b| values[a].abs().total_cmp(&values[b].abs()))?;
    let sign = values[strongest].signum();
    if values[strongest].abs() <= 2.0 * CUT_SIGMA * noise {
        return None;
    }
    values.iter_mut().for_each(|value| *value *= sign);
    let floor = (CUT_SIGMA * noise).max(1e-6 * values[strongest]);
    // Two samples in a row below the floor end the pulse; one margin of two samples stays on either side.
    let run = 2 * STEPS;
    let loud = |stretch: &[f64]| stretch.iter().any(|value| value.abs() > floor);
    let mut start = strongest;
    while start >= run && loud(&values[start - run..start]) {
        start -= 1;
    }
    let end_of = |mut end: usize| {
        while end + run <= values.len() && loud(&values[end..end + run]) {
            end += 1;
        }
        end
    };
    let mut stretches = vec![(start, end_of(strongest + 1))];
    let mut at = stretches[0].1;
    while let Some(far) = (at..values.len()).find(|&n| values[n].abs() > FAR_SIGMA * noise) {
        let mut begin = far;
        while begin >= at + run && loud(&values[begin - run..begin]) {
            begin -= 1;
        }
        at = end_of(far + 1);
        stretches.push((begin, at));
    }
    // A shape that has not decayed where the record ends is a step: it is kept to the end, without taper.
    let step = at + run > values.len();
    let (start, end) = (start.saturating_sub(run), if step { values.len() } else { at + run });
    mask(&mut values, &stretches, run, step);
    let spline = Response::new(0.0, grid.step_ps, &values[start..end]);
    let peak_ps = spline.peak_ps();
    let height = spline.height();
    let kept = values[start..end].iter().map(|value| value / height).collect();
    Some(Shape {
        t0_ps: -peak_ps,
        step_ps: grid.step_ps,
        values: kept,
        peak_ps: grid.start_ps + start as f64 * grid.step_ps + peak_ps,
        height: height * sign,
    })
}

/// Silences what lies outside of the stretches, with margins that fade over `run` values; after the last one only if
/// the shape ends there.
fn mask(values: &mut [f64], stretches: &[(usize, usize)], run: usize, step: bool) {
    let fade = |distance: usize| {
        if distance < run { 0.5 + 0.5 * (TAU / 2.0 * (distance as f64 + 0.5) / run as f64).cos() } else { 0.0 }
    };
    let last = stretches[stretches.len() - 1].1;
    for (n, value) in values.iter_mut().enumerate() {
        if step && n >= last {
            continue;
        }
        let weight = |(start, end): &(usize, usize)| match n {
            _ if n < *start => fade(start - 1 - n),
            _ if n >= *end => fade(n - end),
            _ => 1.0,
        };
        *value *= stretches.iter().map(weight).fold(0.0, f64::max);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    /// Gaussian of 250 ps full width.
    fn g250(t: f64) -> f64 {
        (-0.5 * (t / 106.2).powi(2)).exp()
    }

    /// Exponentially modified Gaussian (sigma 33 ps, tau 112 ps), by quadrature; not normalised.
    fn e(t: f64) -> f64 {
        (0..600)
            .map(|k| f64::from(k) * 2.0)
            .map(|s| (-s / 112.0).exp() * (-0.5 * ((t - s) / 33.0).powi(2)).exp())
            .sum::<f64>()
            * 2.0
    }

    fn shots(pulse: fn(f64) -> f64, count: usize, jitter_ps: f64, snr: f64) -> Vec<Shot> {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let top = (-100..400).map(|t| pulse(f64::from(t))).fold(0.0, f64::max);
        (0..count)
            .map(|_| {
                let normal = |rng: &mut ChaCha8Rng| -> f64 { StandardNormal.sample(rng) };
                let at_ps = 2500.0 + jitter_ps * normal(&mut rng);
                let t0_ps = if jitter_ps > 0.0 { rng.random_range(0.0..50.0) } else { 0.0 };
                let samples = (0..120)
                    .map(|n| pulse(f64::from(n) * 50.0 + t0_ps - at_ps) / top + 0.3 + normal(&mut rng) / snr)
                    .collect();
                Shot { samples, t0_ps }
            })
            .collect()
    }

    /// Shape error and width error against the truth, both relative.
    fn errors(shape: &Shape, pulse: fn(f64) -> f64) -> (f64, f64) {
        let fine: Vec<f64> = (-4000..8000).map(|i| pulse(f64::from(i) * 0.1)).collect();
        let top = fine.iter().copied().fold(0.0, f64::max);
        let peak_ps = (fine.iter().position(|v| *v == top).unwrap() as f64 - 4000.0) * 0.1;
        let above: Vec<usize> = (0..fine.len()).filter(|&i| fine[i] > top / 2.0).collect();
        let width_ps = above.len() as f64 * 0.1;
        let response = shape.response();
        // The maximum of a noisy shape is badly defined, a pulse's place is not: compare at the best shift.
        let rms = |shift: f64| {
            let grid = (-60..120).map(|i| f64::from(i) * 6.25);
            let squares: f64 = grid.map(|t| (response.value(t + shift) - pulse(t + peak_ps) / top).powi(2)).sum();
            (squares / 180.0).sqrt()
        };
        let best = (-100..=100).map(|i| rms(f64::from(i) * 0.2)).fold(f64::INFINITY, f64::min);
        (best, response.width_ps() / width_ps - 1.0)
    }

    #[test]
    fn five_hundred_jittered_shots_give_the_shape_to_a_percent() {
        for (name, pulse) in [("G250", g250 as fn(f64) -> f64), ("E", e)] {
            let shots = shots(pulse, 500, 70.0, 30.0);
            let (shape, times) = shape_and_times(&shots, 50.0).unwrap();
            let (rms, width) = errors(&shape, pulse);
            eprintln!("{name}: shape rms {rms:.4}, width {width:+.4}");
            assert!(rms < 0.01 && width.abs() < 0.01, "{name}: shape rms {rms}, width {width}");
            assert!(times.iter().all(Option::is_some));
        }
    }

    /// A diffusion tail of nanoseconds and an echo at -40 dB are part of the response.
    #[test]
    fn tails_and_echoes_belong_to_the_shape() {
        fn pulse(t: f64) -> f64 {
            g250(t) + 0.01 * g250(t - 1800.0)
        }
        let decay = |t: f64| if t > 0.0 { 0.02 * (-t / 1000.0).exp() } else { 0.0 };
        let mut shots = shots(pulse, 4000, 70.0, 30.0);
        let (shape, _) = shape_and_times(&shots, 50.0).unwrap();
        let response = shape.response();
        let error = |t: f64| response.value(t) - pulse(t);
        let echo: Vec<f64> = (-20..=20).map(|i| error(1800.0 + 10.0 * f64::from(i))).collect();
        let rms = (echo.iter().map(|e| e * e).sum::<f64>() / echo.len() as f64).sqrt();
        eprintln!("echo of 0.0100 at 1800 ps: rms error {rms:.5}");
        assert!(rms < 0.001, "{rms}");
        assert!(response.value(900.0).abs() < 1e-12);
        for shot in &mut shots {
            for (n, sample) in shot.samples.iter_mut().enumerate() {
                *sample += decay(n as f64 * 50.0 + shot.t0_ps - 2500.0);
            }
        }
        let (shape, _) = shape_and_times(&shots, 50.0).unwrap();
        let response = shape.response();
        let tail: Vec<f64> = (0..10).map(|i| response.value(600.0 + 50.0 * f64::from(i))).collect();
        let truth: Vec<f64> = (0..10).map(|i| decay(600.0 + 50.0 * f64::from(i))).collect();
        let (sum, true_sum) = (tail.iter().sum::<f64>(), truth.iter().sum::<f64>());
        eprintln!("tail: {sum:.4} of {true_sum:.4}");
        assert!((sum / true_sum - 1.0).abs() < 0.1, "{tail:?}");
    }

    #[test]
    fn shots_without_jitter_fall_back_to_their_own_grid() {
        let shots = shots(g250, 500, 0.0, 30.0);
        let shape = shape(&shots, 50.0).unwrap();
        let (rms, width) = errors(&shape, g250);
        assert!(rms < 0.01 && width.abs() < 0.01, "shape rms {rms}, width {width}");
        assert!(
            (shape.peak_ps - 2500.0).abs() < 5.0 && (shape.height - 1.0).abs() < 0.02,
            "{} {}",
            shape.peak_ps,
            shape.height
        );
    }

    #[test]
    fn noise_has_no_shape() {
        assert!(shape(&shots(|_| 1e-9, 50, 70.0, 1e-3), 50.0).is_none());
    }
}
