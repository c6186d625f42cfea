//! From maxima to echoes: fits, evidence, errors.

use super::edge;
use super::maxima;
use super::model::{Fit, Model, Part, regression};
use super::outgoing::Outgoing;
use super::{EchoOptions, Stretch};
use crate::fft::RealFft;
use crate::pulse_fit::MeanRecord;

/// Parameters of an echo: strength, place, variance.
const PARAMETERS: usize = 3;
/// Variance of the widening where a fit begins, in variances of the outgoing pulse.
const FIRST_WIDENING: f64 = 0.4;
/// Standard deviations of chance beyond which an autocorrelation counts.
const CHANCE: f64 = 2.0;

/// An echo. Times are in samples after the first one, heights in units of the samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Echo {
    /// Time of the outgoing pulse's maximum, moved onto the echo. The widening is symmetric about it.
    pub time: f64,
    /// Standard deviation of the time.
    pub time_sd: f64,
    /// Height of the fitted echo.
    pub height: f64,
    /// Standard deviation of the height, for its width as it is.
    pub height_sd: f64,
    /// Standard deviation of the Gaussian that widens the outgoing pulse.
    pub width: f64,
    /// Standard deviation of the width. Where the width is not significant: its upper limit.
    pub width_sd: f64,
    /// Time and standard deviation of the leading edge at half of the height; `None` where the record begins later.
    pub edge: Option<(f64, f64)>,
}

/// The echoes of a stretch.
#[derive(Clone, Debug, PartialEq)]
pub struct Echoes {
    /// In order of time.
    pub echoes: Vec<Echo>,
    /// Level of the record.
    pub level: f64,
    /// Standard deviation of what the fit leaves.
    pub noise: f64,
    /// Samples of which that has the independent values.
    pub independent: f64,
}

/// What a fit leaves: its size and how much of it is independent.
struct Noise {
    sd: f64,
    acf: Vec<f64>,
    independent: f64,
}

/// Finds the echoes of a stretch. `None` where fewer samples count than a level and an echo have parameters.
#[must_use]
pub fn decompose(
    stretch: &Stretch<'_>,
    outgoing: &Outgoing,
    options: &EchoOptions,
    fft: &mut RealFft,
) -> Option<Echoes> {
    let (maxima, level) = maxima::find(stretch, outgoing.sigma, options);
    let mut model = Model::new(stretch.samples, outgoing, fft);
    let count = model.count();
    if count < PARAMETERS + 2 {
        return None;
    }
    let variance = FIRST_WIDENING * outgoing.sigma * outgoing.sigma;
    let part = |maximum: &maxima::Maximum| Part { strength: maximum.height, place: maximum.place, variance };
    // Each echo needs samples of its own.
    let most = (count - 2) / PARAMETERS;
    let mut strongest = maxima;
    strongest.sort_by(|a, b| b.height.total_cmp(&a.height));
    strongest.truncate(most);
    let mut fit = model.fit(level, strongest.iter().map(part).collect());
    loop {
        let noise = noise(&fit, count, stretch.step);
        if let Some(fewer) = without_the_least(&mut model, &fit, &noise, count, stretch.step) {
            fit = fewer;
            continue;
        }
        let mut echoes: Vec<Echo> = errors(&fit, &noise, outgoing, stretch)?;
        let is_weak = |echo: &Echo| echo.height < options.threshold_sigma * echo.height_sd;
        // Where the fit is so bad that no echo is significant, the last one is held against the fast noise alone.
        let fast = Noise { sd: maxima::fast_noise(stretch), acf: vec![1.0], ..noise };
        let is_noise = echoes.len() != 1 || errors(&fit, &fast, outgoing, stretch)?.iter().all(is_weak);
        let weakest = (0..echoes.len()).filter(|k| is_noise && is_weak(&echoes[*k])).min_by(|a, b| {
            (echoes[*a].height / echoes[*a].height_sd).total_cmp(&(echoes[*b].height / echoes[*b].height_sd))
        });
        if let Some(weakest) = weakest {
            fit = refit(&mut model, &fit, weakest);
            continue;
        }
        echoes.sort_by(|a, b| a.time.total_cmp(&b.time));
        return Some(Echoes { echoes, level: fit.level, noise: noise.sd, independent: noise.independent });
    }
}

/// The fit without one of its parts.
fn refit(model: &mut Model<'_>, fit: &Fit, part: usize) -> Fit {
    let mut parts = fit.parts.clone();
    parts.remove(part);
    model.fit(fit.level, parts)
}

/// The fit without the part that is missed least, where the BIC prefers it. Of several parts only: one alone is judged
/// by its significance.
fn without_the_least(model: &mut Model<'_>, fit: &Fit, noise: &Noise, count: usize, step: f64) -> Option<Fit> {
    if fit.parts.len() < 2 {
        return None;
    }
    let fewer = (0..fit.parts.len()).map(|part| refit(model, fit, part));
    let best = fewer.min_by(|a, b| a.sum_of_squares.total_cmp(&b.sum_of_squares))?;
    let independent = noise.independent;
    let gain = independent * (variance(&best, count, step) / variance(fit, count, step)).ln();
    (gain < PARAMETERS as f64 * independent.ln()).then_some(best)
}

/// Mean square of what a fit leaves; at least that of rounding.
fn variance(fit: &Fit, count: usize, step: f64) -> f64 {
    (fit.sum_of_squares / count as f64).max(step * step / 12.0)
}

fn noise(fit: &Fit, count: usize, step: f64) -> Noise {
    let acf = autocorrelation(&fit.residuals, count);
    let independent = count as f64 / (2.0 * acf.iter().map(|r| r * r).sum::<f64>() - 1.0);
    let parameters = (1 + PARAMETERS * fit.parts.len()) as f64;
    // With less than one degree of freedom left, noise is all that is left.
    let freedom = (independent - parameters).max(1.0);
    let sd = (variance(fit, count, step) * independent / freedom).sqrt();
    Noise { sd, acf, independent }
}

/// Autocorrelation of residuals at lags 0, 1, ..., up to the first that chance explains.
fn autocorrelation(residuals: &[f64], count: usize) -> Vec<f64> {
    let product = |lag: usize| residuals[lag..].iter().zip(residuals).map(|(a, b)| a * b).sum::<f64>();
    let all = product(0);
    let chance = CHANCE / (count as f64).sqrt();
    let mut acf = vec![1.0];
    if all > 0.0 {
        acf.extend((1..residuals.len() / 2).map(|lag| product(lag) / all).take_while(|r| *r > chance));
    }
    acf
}

/// The echoes of a fit with their errors; `None` where parameters cannot be distinguished.
fn errors(fit: &Fit, noise: &Noise, outgoing: &Outgoing, stretch: &Stretch<'_>) -> Option<Vec<Echo>> {
    if fit.parts.is_empty() {
        return Some(Vec::new());
    }
    let solved = regression(fit)?;
    let record = MeanRecord { samples: stretch.samples, dt_ps: 1.0, noise: noise.sd, acf: &noise.acf };
    let sd = |k: usize| record.sd_of_sum(&solved.influence(&fit.columns, 1.0, k));
    let foot = maxima::quiet_level(stretch, outgoing.sigma) - fit.level;
    let echo = |k: usize, part: &Part| {
        let first = 1 + PARAMETERS * k;
        let curve = &fit.curves[k];
        let height = curve.iter().copied().fold(0.0, f64::max);
        let alone: Vec<f64> = stretch
            .samples
            .iter()
            .zip(curve.iter().zip(&fit.residuals))
            .map(|(sample, (curve, residual))| if sample.is_finite() { curve + residual } else { f64::NAN })
            .collect();
        let edge = edge::edge(curve, &alone, foot, outgoing.sigma);
        let (width, variance_sd) = (part.variance.sqrt(), sd(first + 2));
        Echo {
            time: part.place,
            time_sd: sd(first + 1),
            height,
            height_sd: sd(first) * height / part.strength,
            width,
            width_sd: if part.variance > variance_sd { 0.5 * variance_sd / width } else { variance_sd.sqrt() },
            edge: edge.map(|edge| (edge.place, record.sd_of_sum(&edge.influence))),
        }
    };
    Some(fit.parts.iter().enumerate().map(|(k, part)| echo(k, part)).collect())
}
