//! Records longer than the laser's period, folded into one period.
//!
//! All light repeats with the laser. Sample `b` of a circular profile of `B` samples is the mean of the record at
//! `t0 + (b / B + r) T` over the repetitions `r`, weighted by their variances. The period is in general no whole number
//! of samples, so the record is interpolated. Interpolation is band-limited ([`super::resample`]) where the filter's
//! reach lies within the record; a place that no such repetition covers is taken from the line between two samples.
//! Errors follow the weights; neighbouring samples share a little of their noise.
//!
//! The period by maximum likelihood: repetitions `r` sampled with a period that is wrong by `d` differ from their mean
//! by `-r d s'(t)`. Hence `d = -sum w (r - mean r) e s' / sum w (r - mean r)^2 s'^2` over all samples and repetitions;
//! the period is corrected by it until it settles. It starts from the period at which the folded profile has most
//! energy. Not modelled: jitter of the laser, drift of its period, aliases of the response.

use super::resample;

/// Steps after which a period that has not settled is none.
const STEPS: usize = 30;
/// A period has settled when it changes by less than this share of its standard deviation: a sample that enters or
/// leaves the last repetition changes it by as much.
const SETTLED: f64 = 0.05;
/// Phases of a sample at which the filter is tabulated; between them it is linear to 1e-5.
const PHASES: usize = 512;
/// Trials across the shift, in samples of the folded profile, that the last repetition makes during the search.
const TRIALS_A_SAMPLE: f64 = 1.0;

/// A record with light that repeats.
#[derive(Clone, Copy, Debug)]
pub struct PulseTrain<'a> {
    /// Samples, V.
    pub mean_v: &'a [f64],
    /// Standard deviation of each, V; infinite for a sample to be ignored.
    pub sd_v: &'a [f64],
    /// Time between samples, ps.
    pub dt_ps: f64,
}

/// One period: sample `b` at the record's start plus `b * step_ps`, circular.
#[derive(Clone, Debug, PartialEq)]
pub struct Folded {
    /// Mean of each sample, V; 0 where no repetition has it.
    pub mean_v: Vec<f64>,
    /// Standard error of each, V; infinite where no repetition has it.
    pub se_v: Vec<f64>,
    /// Time between samples, ps: the period over their number.
    pub step_ps: f64,
}

/// A period with its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Period {
    /// The period, ps.
    pub period_ps: f64,
    /// Its standard deviation, ps.
    pub sd_ps: f64,
}

/// Folds `record` into one period, as many samples as fit it best at the record's own step.
///
/// # Panics
/// If lengths differ, an sd is not positive, or the record is shorter than a period or the period than two samples.
#[must_use]
pub fn fold(record: &PulseTrain, period_ps: f64) -> Folded {
    check(record, period_ps);
    fold_with(record, period_ps, &filter())
}

/// Taps at each phase of a sample.
fn filter() -> Vec<[f64; resample::TAPS]> {
    let mut filter: Vec<_> = (0..PHASES).map(|p| resample::taps(p as f64 / PHASES as f64)).collect();
    // A whole sample further they are those of no fraction, each one tap on; the outermost is 0.
    let none = filter[0];
    filter.push(std::array::from_fn(|k| none[(k + 1) % resample::TAPS]));
    filter
}

fn fold_with(record: &PulseTrain, period_ps: f64, filter: &[[f64; resample::TAPS]]) -> Folded {
    let repetitions = Repetitions::new(record, period_ps, filter);
    let folded: Vec<Option<(f64, f64)>> = (0..repetitions.samples).map(|b| mean(&repetitions.at(b))).collect();
    Folded {
        mean_v: folded.iter().map(|m| m.map_or(0.0, |(mean, _)| mean)).collect(),
        se_v: folded.iter().map(|m| m.map_or(f64::INFINITY, |(_, variance)| variance.sqrt())).collect(),
        step_ps: period_ps / repetitions.samples as f64,
    }
}

fn check(record: &PulseTrain, period_ps: f64) {
    let len = record.mean_v.len();
    assert!(record.dt_ps > 0.0 && record.sd_v.len() == len, "a record has a step, and an sd for each sample");
    assert!(record.sd_v.iter().all(|sd| *sd > 0.0), "the sds must be positive");
    assert!(period_ps >= 2.0 * record.dt_ps, "a period has at least two samples");
    assert!(period_ps <= len as f64 * record.dt_ps, "a record to be folded holds a period");
}

/// Weighted mean of the values of the repetitions, and its variance.
fn mean(values: &[Value]) -> Option<(f64, f64)> {
    let weight: f64 = values.iter().map(|v| 1.0 / v.variance).sum();
    (weight > 0.0).then(|| (values.iter().map(|v| v.mean / v.variance).sum::<f64>() / weight, 1.0 / weight))
}

/// The record at one place of one repetition.
struct Value {
    repetition: f64,
    mean: f64,
    variance: f64,
}

/// The record at the places of a folded profile.
struct Repetitions<'a> {
    record: &'a PulseTrain<'a>,
    /// Samples of the folded profile.
    samples: usize,
    /// Period in samples of the record.
    period: f64,
    filter: &'a [[f64; resample::TAPS]],
}

impl<'a> Repetitions<'a> {
    fn new(record: &'a PulseTrain<'a>, period_ps: f64, filter: &'a [[f64; resample::TAPS]]) -> Self {
        let period = period_ps / record.dt_ps;
        Self { record, samples: period.round() as usize, period, filter }
    }

    /// Place `b` in all repetitions: band-limited ones, or, if there are none, those on the line.
    fn at(&self, b: usize) -> Vec<Value> {
        let start = b as f64 / self.samples as f64 * self.period;
        let last = (self.record.mean_v.len() - 1) as f64;
        let count = ((last - start) / self.period).floor() as i64 + 1;
        let places = (0..count.max(0)).map(|r| (r as f64, start + r as f64 * self.period));
        let all = |interpolate: &dyn Fn(f64) -> Option<(f64, f64)>| -> Vec<Value> {
            let value =
                |(repetition, place)| interpolate(place).map(|(mean, variance)| Value { repetition, mean, variance });
            places.clone().filter_map(value).collect()
        };
        let band_limited = all(&|place| self.band_limited(place));
        if band_limited.is_empty() { all(&|place| self.on_line(place)) } else { band_limited }
    }

    fn band_limited(&self, place: f64) -> Option<(f64, f64)> {
        let whole = place.ceil();
        let fraction = whole - place;
        if fraction == 0.0 {
            return self.weighted(whole as usize, &[1.0]);
        }
        let first = (whole as usize).checked_sub(resample::TAPS / 2)?;
        let phase = fraction * PHASES as f64;
        let (before, part) = (phase as usize, phase.fract());
        let (a, b) = (&self.filter[before], &self.filter[before + 1]);
        let taps: [f64; resample::TAPS] = std::array::from_fn(|k| a[k] + part * (b[k] - a[k]));
        self.weighted(first, &taps)
    }

    fn on_line(&self, place: f64) -> Option<(f64, f64)> {
        let first = (place as usize).min(self.record.mean_v.len() - 2);
        let fraction = place - first as f64;
        self.weighted(first, &[1.0 - fraction, fraction])
    }

    /// Weighted sum of the samples from `first` on and its variance, if the record has them all.
    fn weighted(&self, first: usize, weights: &[f64]) -> Option<(f64, f64)> {
        let samples = self.record.mean_v.get(first..first + weights.len())?;
        let sds = &self.record.sd_v[first..first + weights.len()];
        let mean = samples.iter().zip(weights).map(|(v, w)| v * w).sum();
        let variance = sds.iter().zip(weights).filter(|(_, w)| **w != 0.0).map(|(sd, w)| (sd * w).powi(2)).sum::<f64>();
        variance.is_finite().then_some((mean, variance))
    }
}

/// The period of the light in `record`, sought from `start_ps - search_ps` to `start_ps + search_ps`. `None` if the
/// record holds fewer than two periods, or no light that determines the period.
///
/// # Panics
/// As [`fold`], for the longest period sought; or if `search_ps` is negative.
#[must_use]
pub fn refine_period(record: &PulseTrain, start_ps: f64, search_ps: f64) -> Option<Period> {
    assert!(search_ps >= 0.0, "a range to search is not negative");
    check(record, start_ps + search_ps);
    let repetitions = record.mean_v.len() as f64 * record.dt_ps / start_ps;
    if repetitions < 2.0 {
        return None;
    }
    let filter = filter();
    // A trial moves the last repetition by a sample at most.
    let trials = (TRIALS_A_SAMPLE * search_ps * repetitions / record.dt_ps).ceil() as i64;
    let trial_ps = |i: i64| start_ps + if trials > 0 { search_ps * i as f64 / trials as f64 } else { 0.0 };
    let energy = |period_ps: f64| {
        let folded = fold_with(record, period_ps, &filter);
        let light = folded.mean_v.iter().zip(&folded.se_v);
        // The mean is what a wrong period leaves untouched.
        let total = folded.mean_v.iter().sum::<f64>() / folded.mean_v.len() as f64;
        light.map(|(v, se)| ((v - total) / se).powi(2)).sum::<f64>()
    };
    let best = (-trials..=trials).map(|i| (trial_ps(i), energy(trial_ps(i)))).max_by(|a, b| a.1.total_cmp(&b.1));
    let mut period_ps = best?.0;
    for _ in 0..STEPS {
        let (step_ps, sd_ps) = step(record, period_ps, &filter)?;
        period_ps += step_ps.clamp(-record.dt_ps, record.dt_ps);
        if (period_ps - start_ps).abs() > search_ps + record.dt_ps {
            return None;
        }
        if step_ps.abs() < SETTLED * sd_ps {
            return Some(Period { period_ps, sd_ps });
        }
    }
    None
}

/// Correction of a period and its standard deviation, ps. `None` where noise makes up all of the slope.
fn step(record: &PulseTrain, period_ps: f64, filter: &[[f64; resample::TAPS]]) -> Option<(f64, f64)> {
    let repetitions = Repetitions::new(record, period_ps, filter);
    let samples = repetitions.samples;
    let values: Vec<Vec<Value>> = (0..samples).map(|b| repetitions.at(b)).collect();
    let means: Vec<Option<(f64, f64)>> = values.iter().map(|v| mean(v)).collect();
    let two_steps_ps = 2.0 * period_ps / samples as f64;
    let (mut product, mut power, mut noise) = (0.0, 0.0, 0.0);
    for (b, values) in values.iter().enumerate() {
        let neighbours = (means[(b + samples - 1) % samples], means[(b + 1) % samples]);
        let (Some((mean, variance)), (Some(before), Some(after))) = (means[b], neighbours) else { continue };
        let slope = (after.0 - before.0) / two_steps_ps;
        let centre = values.iter().map(|v| v.repetition / v.variance).sum::<f64>() * variance;
        let moment =
            |f: &dyn Fn(&Value) -> f64| values.iter().map(|v| (v.repetition - centre) / v.variance * f(v)).sum::<f64>();
        let spread = moment(&|v| v.repetition - centre);
        product -= slope * moment(&|v| v.mean - mean);
        power += slope * slope * spread;
        noise += (before.1 + after.1) / two_steps_ps.powi(2) * spread;
    }
    let information = power - noise;
    (information > 0.0).then(|| (product / information, information.sqrt().recip()))
}

/// Where to cut a circular record open: in the middle of its longest run of dark samples; at its first dark one, or at
/// 0, if it has no run.
#[must_use]
pub fn opening(is_dark: &[bool]) -> usize {
    let count = is_dark.len();
    let Some(light) = is_dark.iter().position(|dark| !dark) else {
        return 0;
    };
    // From a light sample once around, so that no run is cut in two.
    let (mut longest, mut start, mut run) = (0, light, 0);
    for k in 1..=count {
        run = if is_dark[(light + k) % count] { run + 1 } else { 0 };
        if run > longest {
            (longest, start) = (run, light + k + 1 - run);
        }
    }
    (start + longest / 2) % count
}

#[cfg(test)]
mod tests;
