//! One profile from captures of the same light at several vertical ranges of the oscilloscope.
//!
//! A range that resolves the weak bounces clips on the strong one. Where no range clips,
//! `y_i(t) = offset_i + gain_i * y_0(t - delay_i)` with noise on both sides; gain and offset are the maximum likelihood
//! line through points with errors in both coordinates (York, Evensen, Martinez and De Basabe Delgado, Am. J. Phys. 72,
//! 367 (2004)): plain regression would find the gain too small by the share of noise in the light's power. The variance
//! of the gain takes from the places' scatter along the line what noise adds to it. The delay, if asked for, follows
//! from the residual's product with the slope, and is removed by a band-limited shift. Then, at each sample, the mean
//! of all ranges that are valid there, weighted by their variances, on the scale of the first.
//!
//! Where too little light is seen in both to fit the scale, a [`Prior`] of the link takes part: volts per code that the
//! oscilloscope states, and the delay from a calibration of both ranges. Where light fits the scale better than the
//! prior knows it, the prior has no part.
//!
//! Give the most sensitive range first: it is not shifted, so clipping does not spread in it through the filter of the
//! shift. Samples near a clipped stretch and in its recovery are left out by a margin; how long an amplifier recovers
//! must be known. Not modelled: a gain that depends on level or frequency, noise correlated between samples (in a
//! shifted range it is, slightly), jitter.

use super::Error;
use super::regression::least_squares;
use super::resample;

/// Fewer samples that all ranges share say nothing of a gain.
const SHARED_MIN: usize = 8;
/// Steps after which a fit is taken as it is.
const STEPS: usize = 50;
/// A fit has settled when gain and delay change by less than this share of their standard deviations.
const SETTLED: f64 = 1e-4;

/// A fitted gain that is known to this part of itself, and lies this many standard deviations from the stated one,
/// contradicts it: somebody has stated a wrong one.
const CONTRADICTING_SD: f64 = 0.1;
const CONTRADICTING_SIGMA: f64 = 5.0;

/// An averaged profile of one range.
#[derive(Clone, Copy, Debug)]
pub struct RangeProfile<'a> {
    /// Mean of each sample, V.
    pub mean_v: &'a [f64],
    /// Standard error of each mean, V.
    pub se_v: &'a [f64],
    /// Whether a sample is clipped.
    pub clipped: &'a [bool],
    /// What is known beforehand of its link to the first range.
    pub prior: Option<Prior>,
}

/// What is known beforehand of how one range follows from the first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prior {
    /// Factor of the first range's light; 1 where both are in volts.
    pub gain: f64,
    /// Standard deviation of the gain.
    pub gain_sd: f64,
    /// How much later than the first this range shows the light, ps.
    pub delay_ps: f64,
    /// Standard deviation of the delay, ps.
    pub delay_sd_ps: f64,
}

impl Prior {
    /// Whether a fitted gain is taken as it is: it is better known than this, or certainly not this.
    fn yields_to(&self, fitted: &Link) -> bool {
        let is_known = fitted.gain_sd < CONTRADICTING_SD * fitted.gain;
        let is_other = (fitted.gain - self.gain).abs() > CONTRADICTING_SIGMA * fitted.gain_sd.hypot(self.gain_sd);
        fitted.gain_sd <= self.gain_sd || is_known && is_other
    }
}

/// What is asked of a merger.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MergeOptions {
    /// Samples left out before a clipped one.
    pub margin_before: usize,
    /// Samples left out behind a clipped one: the recovery of the amplifier.
    pub margin_after: usize,
    /// Time between samples, ps, if the ranges may differ in delay; `None` if they do not.
    pub delay_dt_ps: Option<f64>,
}

/// How one range follows from the first.
#[derive(Clone, Debug, PartialEq)]
pub struct Link {
    /// Factor of the first range's light.
    pub gain: f64,
    /// Standard deviation of the gain.
    pub gain_sd: f64,
    /// Value of this range where the first is 0, V.
    pub offset_v: f64,
    /// Standard deviation of the offset, V.
    pub offset_sd_v: f64,
    /// Covariance of gain and offset, V.
    pub gain_offset_v: f64,
    /// How much later than the first this range shows the light, ps; 0 if not fitted.
    pub delay_ps: f64,
    /// Standard deviation of the delay, ps; 0 if not fitted.
    pub delay_sd_ps: f64,
    /// Squared residuals over their variances, summed over the samples that both ranges have.
    pub chi2: f64,
    /// These samples less the unknowns.
    pub dof: usize,
}

/// A merged profile, on the scale and at the times of the first range.
#[derive(Clone, Debug, PartialEq)]
pub struct Merged {
    /// Mean of each sample, V; the first range's where no range is valid.
    pub mean_v: Vec<f64>,
    /// Standard error that each sample has for itself, V; infinite where no range is valid.
    pub se_v: Vec<f64>,
    /// Links of the second and further ranges to the first.
    pub links: Vec<Link>,
    /// Share of each further range in each sample.
    pub shares: Vec<Vec<f64>>,
}

impl Merged {
    /// Standard deviation that the errors of all gains and offsets make at sample `n`, V. It is common to all samples
    /// (`shares` and `links` give its correlation), so it is not part of `se_v`.
    ///
    /// # Panics
    /// If there is no such sample.
    #[must_use]
    pub fn scale_sd_v(&self, n: usize) -> f64 {
        let variance = |(link, share): (&Link, &Vec<f64>)| {
            let v = self.mean_v[n];
            let line = (v * link.gain_sd).powi(2) + link.offset_sd_v.powi(2) + 2.0 * v * link.gain_offset_v;
            (share[n] / link.gain).powi(2) * line
        };
        self.links.iter().zip(&self.shares).map(variance).sum::<f64>().max(0.0).sqrt()
    }
}

/// Merges `ranges` onto the first.
///
/// # Errors
/// [`Error::NoCommonSamples`] if a range shares too few valid samples with the first to determine its gain.
///
/// # Panics
/// If there is no range, lengths differ, a standard error is not positive, or `delay_dt_ps` is not positive.
pub fn merge(ranges: &[RangeProfile], options: &MergeOptions) -> Result<Merged, Error> {
    let (first, others) = ranges.split_first().expect("there is a range");
    let len = first.mean_v.len();
    for range in ranges {
        let equal = range.mean_v.len() == len && range.se_v.len() == len && range.clipped.len() == len;
        assert!(equal, "all ranges have the same samples");
        assert!(range.se_v.iter().all(|se| *se > 0.0), "the standard errors must be positive");
    }
    assert!(options.delay_dt_ps.is_none_or(|dt_ps| dt_ps > 0.0), "the sample step must be positive");
    let first = Trace {
        mean_v: first.mean_v.to_vec(),
        se_v: first.se_v.to_vec(),
        valid: valid(first.clipped, options.margin_before, options.margin_after),
    };
    let mut scaled = Vec::with_capacity(others.len());
    let mut links = Vec::with_capacity(others.len());
    for (n, range) in others.iter().enumerate() {
        let (link, mut trace) = link(&first, range, options).ok_or(Error::NoCommonSamples { range: n + 1 })?;
        trace.mean_v.iter_mut().for_each(|v| *v = (*v - link.offset_v) / link.gain);
        trace.se_v.iter_mut().for_each(|se| *se /= link.gain);
        links.push(link);
        scaled.push(trace);
    }
    Ok(weighted_mean(&first, &scaled, links))
}

/// A profile and which of its samples count.
#[derive(Clone)]
struct Trace {
    mean_v: Vec<f64>,
    se_v: Vec<f64>,
    valid: Vec<bool>,
}

/// Samples outside of clipped stretches and their margins.
#[must_use]
pub fn valid(clipped: &[bool], before: usize, after: usize) -> Vec<bool> {
    let len = clipped.len();
    let mut valid = vec![true; len];
    let next = |from: usize, is_clipped: bool| {
        clipped[from..].iter().position(|clipped| *clipped == is_clipped).map_or(len, |n| from + n)
    };
    let mut start = next(0, true);
    while start < len {
        let end = next(start, false);
        valid[start.saturating_sub(before)..(end + after).min(len)].fill(false);
        start = next(end, true);
    }
    valid
}

/// A range's link to the first, by its light or by what is known beforehand, and the range at the first's times.
fn link(first: &Trace, range: &RangeProfile, options: &MergeOptions) -> Option<(Link, Trace)> {
    let fitted = fitted_link(first, range, options);
    match &range.prior {
        Some(prior) if !fitted.as_ref().is_some_and(|(link, _)| prior.yields_to(link)) => {
            let fitted = fitted.map(|(link, _)| link);
            prior_link(first, range, options, prior, fitted.as_ref())
        }
        _ => fitted,
    }
}

/// A link by what is known beforehand together with what little its light says. The offset follows from the samples
/// that both ranges have, light or none.
fn prior_link(
    first: &Trace,
    range: &RangeProfile,
    options: &MergeOptions,
    prior: &Prior,
    fitted: Option<&Link>,
) -> Option<(Link, Trace)> {
    let (gain, gain_sd) = combined((prior.gain, prior.gain_sd), fitted.map(|link| (link.gain, link.gain_sd)));
    let (delay_ps, delay_sd_ps) =
        combined((prior.delay_ps, prior.delay_sd_ps), fitted.map(|link| (link.delay_ps, link.delay_sd_ps)));
    let shifted = advanced(range, options.delay_dt_ps.map_or(0.0, |dt_ps| delay_ps / dt_ps), options);
    let shared: Vec<usize> = (0..first.mean_v.len()).filter(|n| first.valid[*n] && shifted.valid[*n]).collect();
    if shared.len() < SHARED_MIN {
        return None;
    }
    let weight = |n: usize| {
        let (x, y) = variances(first, &shifted, n);
        1.0 / (y + gain * gain * x)
    };
    let sum = |f: &dyn Fn(usize) -> f64| shared.iter().map(|n| weight(*n) * f(*n)).sum::<f64>();
    let total = sum(&|_| 1.0);
    let (x_mean, y_mean) = (sum(&|n| first.mean_v[n]) / total, sum(&|n| shifted.mean_v[n]) / total);
    let (offset_v, gain_variance) = (y_mean - gain * x_mean, gain_sd * gain_sd);
    let link = Link {
        gain,
        gain_sd,
        offset_v,
        offset_sd_v: (1.0 / total + x_mean * x_mean * gain_variance).sqrt(),
        gain_offset_v: -x_mean * gain_variance,
        delay_ps,
        delay_sd_ps,
        chi2: sum(&|n| (shifted.mean_v[n] - offset_v - gain * first.mean_v[n]).powi(2)),
        dof: shared.len() - 1,
    };
    Some((link, shifted))
}

/// Mean of two values weighted by their variances, with its standard deviation.
fn combined(prior: (f64, f64), fitted: Option<(f64, f64)>) -> (f64, f64) {
    let weight = |sd: f64| sd.powi(-2);
    let Some(fitted) = fitted.filter(|fitted| fitted.1 > 0.0 && prior.1 > 0.0) else { return prior };
    let total = weight(prior.1) + weight(fitted.1);
    ((weight(prior.1) * prior.0 + weight(fitted.1) * fitted.0) / total, total.sqrt().recip())
}

/// A range's link to the first by the light that both see, and the range at the first's times.
fn fitted_link(first: &Trace, range: &RangeProfile, options: &MergeOptions) -> Option<(Link, Trace)> {
    let mut delay = 0.0; // samples
    let mut previous_gain = f64::NAN;
    let mut last = None;
    for _ in 0..STEPS {
        let shifted = advanced(range, delay, options);
        let line = line(first, &shifted)?;
        let step = options.delay_dt_ps.map_or(Some((0.0, 0.0)), |_| delay_step(first, &shifted, &line))?;
        let settled = (line.gain - previous_gain).abs() < SETTLED * line.gain_sd && step.0.abs() <= SETTLED * step.1;
        previous_gain = line.gain;
        let dt_ps = options.delay_dt_ps.unwrap_or(0.0);
        let dof = line.dof - usize::from(options.delay_dt_ps.is_some());
        last = Some((Link { delay_ps: delay * dt_ps, delay_sd_ps: step.1 * dt_ps, dof, ..line }, shifted));
        if settled {
            break;
        }
        delay += step.0.clamp(-1.0, 1.0);
    }
    last.filter(|(link, _)| link.gain > 0.0 && link.gain_sd.is_finite())
}

/// The range earlier by `delay` samples.
fn advanced(range: &RangeProfile, delay: f64, options: &MergeOptions) -> Trace {
    let len = range.mean_v.len();
    let mut valid = valid(range.clipped, options.margin_before, options.margin_after);
    if delay == 0.0 {
        return Trace { mean_v: range.mean_v.to_vec(), se_v: range.se_v.to_vec(), valid };
    }
    // A delay by `fraction`, then an advance by whole samples.
    let whole = delay.ceil();
    let fraction = whole - delay;
    let mut filtered = vec![0.0; len];
    resample::delay(range.mean_v, fraction, &mut filtered);
    let taps = resample::taps(fraction);
    let half = resample::TAPS as i64 / 2;
    let whole = whole as i64;
    let mut variance = vec![0.0; len];
    if fraction > 0.0 {
        // What the filter reaches of a clipped stretch, and beyond the ends, is not known.
        let wide = (options.margin_before + half as usize, options.margin_after + half as usize);
        valid = self::valid(range.clipped, wide.0, wide.1);
        for n in 0..len {
            let at = |k: usize| range.se_v[(n as i64 - half + k as i64).clamp(0, len as i64 - 1) as usize];
            variance[n] = taps.iter().enumerate().map(|(k, tap)| (tap * at(k)).powi(2)).sum();
        }
        let inside = half as usize..len.saturating_sub(half as usize);
        valid.iter_mut().enumerate().for_each(|(n, valid)| *valid &= inside.contains(&n));
    } else {
        variance.iter_mut().zip(range.se_v).for_each(|(variance, se)| *variance = se * se);
    }
    let from = |n: usize| usize::try_from(n as i64 + whole).ok().filter(|m| *m < len);
    Trace {
        mean_v: (0..len).map(|n| from(n).map_or(0.0, |m| filtered[m])).collect(),
        se_v: (0..len).map(|n| from(n).map_or(f64::INFINITY, |m| variance[m].sqrt())).collect(),
        valid: (0..len).map(|n| from(n).is_some_and(|m| valid[m])).collect(),
    }
}

/// The line `y = offset + gain x` through points with errors in both coordinates.
fn line(first: &Trace, other: &Trace) -> Option<Link> {
    let shared: Vec<usize> = (0..first.mean_v.len()).filter(|n| first.valid[*n] && other.valid[*n]).collect();
    if shared.len() < SHARED_MIN {
        return None;
    }
    let sum = |f: &dyn Fn(usize) -> f64| shared.iter().map(|n| f(*n)).sum::<f64>();
    let mut gain = first_gain(&shared, first, other);
    for _ in 0..STEPS {
        let weight = |n: usize| {
            let (x, y) = variances(first, other, n);
            1.0 / (y + gain * gain * x)
        };
        let total = sum(&weight);
        let (x, y) = (&first.mean_v, &other.mean_v);
        let (x_mean, y_mean) = (sum(&|n| weight(n) * x[n]) / total, sum(&|n| weight(n) * y[n]) / total);
        // Where the point lies on the line, along x.
        let place = |n: usize| {
            let (x_variance, y_variance) = variances(first, other, n);
            weight(n) * ((x[n] - x_mean) * y_variance + gain * (y[n] - y_mean) * x_variance)
        };
        let new = sum(&|n| weight(n) * place(n) * (y[n] - y_mean)) / sum(&|n| weight(n) * place(n) * (x[n] - x_mean));
        let place_mean = sum(&|n| weight(n) * place(n)) / total;
        // Scatter of the places about the line's centre, and the part of it that is noise: York's `1 / scatter` is
        // right where there is none.
        let scatter = sum(&|n| weight(n) * (place(n) - place_mean).powi(2));
        let noise = sum(&|n| {
            let (x_variance, y_variance) = variances(first, other, n);
            weight(n).powi(2) * x_variance * y_variance
        });
        if !new.is_finite() || scatter <= noise {
            return None;
        }
        let gain_variance = scatter / (scatter - noise).powi(2);
        let centre = x_mean + place_mean;
        let offset_v = y_mean - new * x_mean;
        let done = (new - gain).abs() < 1e-3 * SETTLED * gain_variance.sqrt();
        if done {
            return Some(Link {
                gain: new,
                gain_sd: gain_variance.sqrt(),
                offset_v,
                offset_sd_v: (1.0 / total + centre * centre * gain_variance).sqrt(),
                gain_offset_v: -centre * gain_variance,
                delay_ps: 0.0,
                delay_sd_ps: 0.0,
                chi2: sum(&|n| weight(n) * (y[n] - offset_v - new * x[n]).powi(2)),
                dof: shared.len() - 2,
            });
        }
        gain = new;
    }
    None
}

/// Variances of sample `n` in both ranges.
fn variances(first: &Trace, other: &Trace, n: usize) -> (f64, f64) {
    (first.se_v[n].powi(2), other.se_v[n].powi(2))
}

/// A gain to start from: root of the ratio of the powers, noise included: the line's iteration takes it from there.
fn first_gain(shared: &[usize], first: &Trace, other: &Trace) -> f64 {
    let mean = |values: &[f64]| shared.iter().map(|n| values[*n]).sum::<f64>() / shared.len() as f64;
    let (x_mean, y_mean) = (mean(&first.mean_v), mean(&other.mean_v));
    let power = |trace: &Trace, mean: f64| {
        shared.iter().map(|n| (trace.mean_v[*n] - mean).powi(2)).sum::<f64>().max(f64::MIN_POSITIVE)
    };
    (power(other, y_mean) / power(first, x_mean)).sqrt()
}

/// By how many samples more the other range is late, and the standard deviation of that: least squares of the line's
/// residual on `x`, 1 and `-gain x'`.
fn delay_step(first: &Trace, other: &Trace, line: &Link) -> Option<(f64, f64)> {
    let valid = |n: usize| first.valid[n] && other.valid[n];
    let neighbours = |n: &usize| valid(*n) && first.valid[n - 1] && first.valid[n + 1];
    let shared: Vec<usize> = (1..first.mean_v.len().saturating_sub(1)).filter(neighbours).collect();
    if shared.len() < SHARED_MIN {
        return None;
    }
    let x = &first.mean_v;
    let column = |f: &dyn Fn(usize) -> f64| shared.iter().map(|n| f(*n)).collect::<Vec<f64>>();
    let slope = column(&|n| -line.gain * (x[n + 1] - x[n - 1]) / 2.0);
    let columns = [column(&|n| x[n]), vec![1.0; shared.len()], slope];
    let residual = column(&|n| other.mean_v[n] - line.offset_v - line.gain * x[n]);
    let sd = column(&|n| (other.se_v[n].powi(2) + (line.gain * first.se_v[n]).powi(2)).sqrt());
    let fit = least_squares(&columns, &residual, &sd)?;
    Some((fit.values[2], fit.sd(2)))
}

fn weighted_mean(first: &Trace, others: &[Trace], links: Vec<Link>) -> Merged {
    let len = first.mean_v.len();
    let weight = |trace: &Trace, n: usize| if trace.valid[n] { trace.se_v[n].powi(-2) } else { 0.0 };
    let (mut mean_v, mut se_v) = (first.mean_v.clone(), vec![f64::INFINITY; len]);
    let mut shares = vec![vec![0.0; len]; others.len()];
    for n in 0..len {
        let total = weight(first, n) + others.iter().map(|trace| weight(trace, n)).sum::<f64>();
        if total > 0.0 {
            let sum: f64 = others.iter().map(|trace| weight(trace, n) * trace.mean_v[n]).sum();
            mean_v[n] = (weight(first, n) * first.mean_v[n] + sum) / total;
            se_v[n] = total.sqrt().recip();
            shares.iter_mut().zip(others).for_each(|(share, trace)| share[n] = weight(trace, n) / total);
        }
    }
    Merged { mean_v, se_v, links, shares }
}

#[cfg(test)]
mod tests;
