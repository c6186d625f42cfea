//! Response, arrival and noise from shots of voltages.

use super::{Estimate, Reference, Shots};
use crate::signal::median::upper_median;
use crate::signal::noise;
use crate::signal::noise_model::{self, Spread};
use crate::signal::oversample::{self, Shape, Shot};
use crate::signal::reference::{PulseFit, fit_pulse, integral};
use crate::signal::response::Response;

/// Robust standard deviations within which times and amplitudes of single shots lie.
const STRAY_SIGMA: f64 = 5.0;
/// Groups of the jackknife that gives the width's standard deviation.
const GROUPS: usize = 8;
/// Fewer shots in a group have no shape of their own.
const GROUP_SHOTS: usize = 8;
/// Share of a record at its start that is taken as baseline.
const BASELINE_SHARE: f64 = 0.1;
/// Lags of the noise autocorrelation.
const ACF_LAGS: usize = 16;

/// Shape of the reference pulse. `None` without references, or where they show no pulse.
pub(super) fn template(references: &[Shot], dt_ps: f64) -> Option<Shape> {
    let template = (!references.is_empty()).then(|| oversample::shape_and_times(references, dt_ps)).flatten();
    template.map(|(shape, _)| shape)
}

/// What the shots of a range say, and its reference pulse if it has one.
pub(super) fn estimate(range: &Shots, template: Option<&Shape>) -> Result<(Estimate, Option<Reference>), String> {
    let no_pulse = |what: &str| format!("its {what} shows no pulse; check channel, vertical range and `samples`");
    let dt_ps = range.first.dt_ps;
    let (shots, reference) = if range.references.is_empty() {
        (range.signals.clone(), None)
    } else {
        let shape = template.ok_or_else(|| no_pulse("reference channel"))?;
        let (shots, integral_v_ps) = aligned(range, &shape.response());
        (shots, Some(Reference { shape: shape.clone(), integral_v_ps }))
    };
    if shots.is_empty() {
        return Err(no_pulse("reference channel"));
    }
    let rough = oversample::shape(&shots, dt_ps).ok_or_else(|| no_pulse("response"))?;
    let shots = without_strays(shots, dt_ps, &rough.response());
    let shape = oversample::shape(&shots, dt_ps).ok_or_else(|| no_pulse("response"))?;
    let quiet: Vec<Vec<f64>> = shots.iter().map(|shot| shot.samples[..quiet(shot)].to_vec()).collect();
    let noise = noise::estimate(&quiet, ACF_LAGS);
    let estimate = Estimate {
        arrival_ps: arrival(&shots, dt_ps, &shape, noise.sd),
        width_sd_ps: width_sd_ps(&shots, dt_ps),
        noise_model: noise_model(&shots, dt_ps, &shape),
        noise_acf: Some(noise.acf),
        shots: shots.len(),
        shape,
    };
    Ok((estimate, reference))
}

/// Signals in the frame of their reference pulses, and the mean integral of these. Shots whose reference shows no pulse
/// are left out.
fn aligned(range: &Shots, template: &Response) -> (Vec<Shot>, f64) {
    let dt_ps = range.first.dt_ps;
    let (mut shots, mut sum) = (Vec::new(), 0.0);
    for (signal, reference) in range.signals.iter().zip(&range.references) {
        let Some(fit) = fit_pulse(&reference.samples, dt_ps, template) else { continue };
        let zero_ps = reference.t0_ps + fit.time_ps;
        shots.push(Shot { samples: signal.samples.clone(), t0_ps: signal.t0_ps - zero_ps });
        sum += integral(&reference.samples, dt_ps, template, &fit);
    }
    let mean = sum / shots.len().max(1) as f64;
    (shots, mean)
}

/// Number of samples at the start of a shot that are its baseline.
fn quiet(shot: &Shot) -> usize {
    ((shot.samples.len() as f64 * BASELINE_SHARE) as usize).clamp(2.min(shot.samples.len()), shot.samples.len())
}

/// Shots whose pulse lies where, and is as high as, that of most: one without light has its time anywhere. Where single
/// shots are too noisy to be fitted, all.
fn without_strays(shots: Vec<Shot>, dt_ps: f64, template: &Response) -> Vec<Shot> {
    let fits: Vec<Option<PulseFit>> = shots.iter().map(|shot| fit_pulse(&shot.samples, dt_ps, template)).collect();
    if 2 * fits.iter().flatten().count() <= shots.len() {
        return shots;
    }
    let values = |value: &dyn Fn(&Shot, &PulseFit) -> (f64, f64)| -> Vec<Option<(f64, f64)>> {
        shots.iter().zip(&fits).map(|(shot, fit)| fit.as_ref().map(|fit| value(shot, fit))).collect()
    };
    let on_time = within(&values(&|shot, fit| (shot.t0_ps + fit.time_ps, fit.time_sd_ps)));
    let as_high = within(&values(&|_, fit| (fit.amplitude, fit.amplitude_sd)));
    let good = on_time.into_iter().zip(as_high).map(|(on_time, as_high)| on_time && as_high);
    shots.into_iter().zip(good).filter_map(|(shot, good)| good.then_some(shot)).collect()
}

/// Which values lie within [`STRAY_SIGMA`] robust standard deviations of their median; the values' own standard
/// deviation is a floor.
fn within(values: &[Option<(f64, f64)>]) -> Vec<bool> {
    let fitted = || values.iter().flatten();
    let middle = |mut values: Vec<f64>| upper_median(&mut values);
    let median = middle(fitted().map(|(value, _)| *value).collect());
    let deviation = middle(fitted().map(|(value, _)| (value - median).abs()).collect());
    let own = middle(fitted().map(|(_, sd)| *sd).collect());
    let limit = STRAY_SIGMA * (1.4826 * deviation).max(own);
    values.iter().map(|value| value.is_some_and(|(value, _)| (value - median).abs() <= limit)).collect()
}

/// Mean time of the response in the shots, and its standard deviation from their spread. Where single shots are too
/// noisy to be fitted, it is the maximum of the shape. That is as good as its width over the signal-to-noise ratio of
/// the mean.
fn arrival(shots: &[Shot], dt_ps: f64, shape: &Shape, noise_v: f64) -> (f64, f64) {
    let template = shape.response();
    let fit = |shot: &Shot| {
        let fit = fit_pulse(&shot.samples, dt_ps, &template)?;
        Some((shot.t0_ps + fit.time_ps, fit.time_sd_ps))
    };
    let fits: Vec<(f64, f64)> = shots.iter().filter_map(fit).collect();
    if 2 * fits.len() <= shots.len() {
        let snr = shape.height.abs() * (shots.len() as f64).sqrt() / noise_v;
        return (shape.peak_ps, template.width_ps() / snr);
    }
    let count = fits.len() as f64;
    let mean = fits.iter().map(|(time_ps, _)| time_ps).sum::<f64>() / count;
    let spread = fits.iter().map(|(time_ps, _)| (time_ps - mean).powi(2)).sum::<f64>();
    let sd = if fits.len() > 1 { (spread / (count - 1.0) / count).sqrt() } else { fits[0].1 };
    (mean, sd)
}

/// Standard deviation of the width by a jackknife that leaves out every eighth shot in turn; `None` with too few shots.
fn width_sd_ps(shots: &[Shot], dt_ps: f64) -> Option<f64> {
    if shots.len() < GROUPS * GROUP_SHOTS {
        return None;
    }
    let without = |group: usize| -> Vec<Shot> {
        shots.iter().enumerate().filter(|(i, _)| i % GROUPS != group).map(|(_, shot)| shot.clone()).collect()
    };
    let widths: Vec<f64> = (0..GROUPS)
        .map(|group| oversample::shape(&without(group), dt_ps).map(|shape| shape.response().width_ps()))
        .collect::<Option<_>>()?;
    let groups = GROUPS as f64;
    let mean = widths.iter().sum::<f64>() / groups;
    Some(((groups - 1.0) / groups * widths.iter().map(|width| (width - mean).powi(2)).sum::<f64>()).sqrt())
}

/// Noise by level and slope, from what the shots leave of the shape; `None` with too few shots.
fn noise_model(shots: &[Shot], dt_ps: f64, shape: &Shape) -> Option<Vec<f64>> {
    let (response, cells) = (shape.response(), shape.values.len());
    let (mut squares, mut hits) = (vec![0.0; cells], vec![0_u32; cells]);
    for shot in shots {
        let baseline = &shot.samples[..quiet(shot)];
        let floor = baseline.iter().sum::<f64>() / baseline.len() as f64;
        for (n, sample) in shot.samples.iter().enumerate() {
            let time_ps = shot.t0_ps + n as f64 * dt_ps - shape.peak_ps;
            let cell = ((time_ps - shape.t0_ps) / shape.step_ps).round();
            if cell >= 0.0 && (cell as usize) < cells {
                squares[cell as usize] += (sample - floor - shape.height * response.value(time_ps)).powi(2);
                hits[cell as usize] += 1;
            }
        }
    }
    // All cells are hit about as often; those that are hardly hit at all say nothing.
    let usual = f64::from(hits.iter().sum::<u32>()) / hits.iter().filter(|hits| **hits > 0).count().max(1) as f64;
    if usual < 2.0 {
        return None;
    }
    let variance = |(square, hits): (&f64, &u32)| {
        if 2.0 * f64::from(*hits) < usual { f64::NAN } else { square / f64::from(*hits) }
    };
    let variance_v2: Vec<f64> = squares.iter().zip(&hits).map(variance).collect();
    let mean_v: Vec<f64> = shape.values.iter().map(|value| shape.height * value).collect();
    let spread = Spread { mean_v: &mean_v, variance_v2: &variance_v2, shots: usual as usize, dt_ps: shape.step_ps };
    noise_model::fit(&spread).map(|model| model.values.to_vec())
}
