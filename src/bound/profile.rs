//! The information in the samples of one capture about the times of its pulses.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::banded::Banded;
use crate::campaign::Role;
use crate::simulate::transport::Light;
use crate::simulate::{Laboratory, Pulse, Setting, Shooting};
use crate::units::PatchId;

/// Sub-sample phases among which shots are divided.
const PHASES: usize = 4;
/// Step of numerical derivatives in time.
const STEP_PS: f64 = 1.0;
/// Chi-square between two pulses and a single one from which they count as separate: they are resolved in 99 of 100
/// cases at a threshold of 20.
const APART: f64 = 46.0;

/// A pulse of a profile.
#[derive(Clone, Debug)]
pub struct PulseBound {
    /// Patches in the order in which the light meets them.
    pub path: Vec<PatchId>,
    /// Time of flight.
    pub time_ps: f64,
    /// Matched-filter signal-to-noise ratio of the average, with everything else known.
    pub snr: f64,
    /// Bound of the time's standard deviation, with everything else in the profile unknown and the reference pulse's
    /// error included. `None` where the pulse is not resolved from another, or is below the threshold.
    pub time_sd_ps: Option<f64>,
}

/// The bound of one capture.
#[derive(Clone, Debug)]
pub struct ProfileBound {
    /// Sensor.
    pub sensor: String,
    /// Vertical range, where the instrument has several.
    pub range: Option<String>,
    /// Patch or view lit.
    pub lit: PatchId,
    /// Patch or view seen.
    pub seen: PatchId,
    /// All pulses, in order of time.
    pub pulses: Vec<PulseBound>,
    /// Pulses above the threshold, as indices of `pulses`.
    pub detected: Vec<usize>,
    /// Unresolved neighbours among the detected pulses: the earlier of each pair.
    pub blends: Vec<usize>,
    /// Information (1/ps^2) on the times of the detected pulses and, last, on the relative width of the response.
    /// Amplitudes, baseline and the reference pulse's error are marginalised.
    pub information: DMatrix<f64>,
}

/// Bounds of all scene captures.
pub(super) fn all(laboratory: &Laboratory, threshold_sigma: f64) -> Vec<ProfileBound> {
    let scene = laboratory.shootings.par_iter().filter(|shooting| shooting.role == Role::Scene);
    scene.map(|shooting| profile(laboratory, shooting, threshold_sigma)).collect()
}

/// Information of a response capture on (time, relative width).
pub(super) fn response(laboratory: &Laboratory, shooting: &Shooting) -> DMatrix<f64> {
    let samples = Samples::new(laboratory, shooting);
    let signal = laboratory.signal(shooting, &shooting.light);
    let columns = [
        Column::Time(&signal),
        Column::Height(&signal),
        Column::Baseline,
        width_column(laboratory, shooting, &[&shooting.light]),
    ];
    let information = samples.information(&columns);
    let remaining = eliminate(&information, &[0, 3]);
    with_common_error(&remaining, 1, reference_variance_ps2(laboratory, shooting))
}

fn profile(laboratory: &Laboratory, shooting: &Shooting, threshold_sigma: f64) -> ProfileBound {
    let samples = Samples::new(laboratory, shooting);
    let mut paths: Vec<_> = shooting.paths.iter().collect();
    paths.sort_by(|a, b| a.1.centroid_ps().total_cmp(&b.1.centroid_ps()));
    let signals: Vec<Pulse> = paths.iter().map(|(_, light)| laboratory.signal(shooting, light)).collect();
    let snrs: Vec<f64> =
        signals.iter().map(|signal| samples.information(&[Column::Height(signal)])[(0, 0)].sqrt()).collect();
    let mut pulses: Vec<PulseBound> = paths
        .iter()
        .zip(&snrs)
        .map(|((path, light), snr)| PulseBound {
            path: (*path).clone(),
            time_ps: light.centroid_ps(),
            snr: *snr,
            time_sd_ps: None,
        })
        .collect();
    // A pulse outside the record has no information at all.
    let detected: Vec<usize> = (0..pulses.len()).filter(|&k| snrs[k] >= threshold_sigma && snrs[k] > 0.0).collect();
    let count = detected.len();
    let mut columns: Vec<Column> = detected.iter().map(|&k| Column::Time(&signals[k])).collect();
    columns.extend(detected.iter().map(|&k| Column::Height(&signals[k])));
    columns.push(Column::Baseline);
    let lights: Vec<&Light> = detected.iter().map(|&k| paths[k].1).collect();
    columns.push(width_column(laboratory, shooting, &lights));
    let full = samples.information(&columns);
    let blends = blends(&detected, &full);
    let times_and_width: Vec<usize> = (0..count).chain([2 * count + 1]).collect();
    let remaining = eliminate(&full, &times_and_width);
    let information = with_common_error(&remaining, count, reference_variance_ps2(laboratory, shooting));
    // Response captures determine the width far better than one profile, so a single profile's own bound takes it as
    // known.
    let times = information.view((0, 0), (count, count)).into_owned();
    if let Some(covariance) = inverse(&times) {
        for (i, &k) in detected.iter().enumerate() {
            let variance = covariance[(i, i)];
            pulses[k].time_sd_ps = (variance > 0.0 && variance.is_finite()).then(|| variance.sqrt());
        }
    }
    ProfileBound {
        sensor: shooting.sensor.clone(),
        range: shooting.setting.name.clone(),
        lit: shooting.lit,
        seen: shooting.seen,
        pulses,
        detected,
        blends,
        information,
    }
}

/// Unresolved neighbours: one pulse instead of two costs less than [`APART`] in chi-square. That follows from the
/// variance of the weaker pulse's height, with the stronger's height and time unknown.
fn blends(detected: &[usize], full: &DMatrix<f64>) -> Vec<usize> {
    let count = detected.len();
    // Information on the height of pulse `own` that no change of height and time of pulse `other` can imitate.
    let alone = |own: usize, other: usize| {
        let chosen = [count + own, other, count + other];
        let three = DMatrix::from_fn(3, 3, |r, c| full[(chosen[r], chosen[c])]);
        eliminate(&three, &[0])[(0, 0)]
    };
    (1..count).filter(|&i| alone(i, i - 1).min(alone(i - 1, i)) < APART).map(|i| detected[i - 1]).collect()
}

/// Variance of the reference pulse's error in the mean of all shots, which all pulses of a profile share.
fn reference_variance_ps2(laboratory: &Laboratory, shooting: &Shooting) -> f64 {
    if shooting.counts {
        return 0.0;
    }
    let instrument = &laboratory.scene.instrument;
    let Some((pulse, setting)) = laboratory.reference_signal() else {
        // Without a reference pulse, the trigger's jitter remains.
        return instrument.jitter_ps * instrument.jitter_ps / laboratory.good_shots(shooting);
    };
    let samples = Samples::analog(laboratory, &setting, None, laboratory.good_shots(shooting));
    let information = samples.information(&[Column::Time(&pulse), Column::Height(&pulse), Column::Baseline]);
    1.0 / eliminate(&information, &[0])[(0, 0)]
}

/// A direction in which a profile can change.
enum Column<'a> {
    /// A pulse's time.
    Time(&'a Pulse),
    /// A pulse's height, in units of itself.
    Height(&'a Pulse),
    /// The baseline.
    Baseline,
    /// The response's relative width: wide minus narrow, over twice the step.
    Width(Pulse, Pulse, f64),
}

impl Column<'_> {
    fn value(&self, time_ps: f64) -> f64 {
        match self {
            Self::Time(signal) => {
                -(signal.value(time_ps + STEP_PS) - signal.value(time_ps - STEP_PS)) / (2.0 * STEP_PS)
            }
            Self::Height(signal) => signal.value(time_ps),
            Self::Baseline => 1.0,
            Self::Width(wide, narrow, step) => (wide.value(time_ps) - narrow.value(time_ps)) / (2.0 * step),
        }
    }
}

/// Change of pulses with the response's relative width, with their maxima in place.
fn width_column<'a>(laboratory: &Laboratory, shooting: &Shooting, lights: &[&Light]) -> Column<'a> {
    let step = 1e-3;
    let stretched = |factor: f64| laboratory.stretched(shooting, lights, factor);
    Column::Width(stretched(1.0 + step), stretched(1.0 - step), step)
}

/// The samples of a capture: their times at each phase, their number, and their noise.
struct Samples {
    times: Vec<(Vec<f64>, Banded)>,
    shots: f64,
}

impl Samples {
    fn new(laboratory: &Laboratory, shooting: &Shooting) -> Self {
        let (t0_ps, dt_ps) = (laboratory.scene.instrument.t0_ps, laboratory.scene.instrument.dt_ps);
        if shooting.counts {
            // Bins have fixed times. Their variance is the expectation, at least the dark count.
            let dark = laboratory.dark_counts(shooting).max(1e-9);
            let expected = laboratory.signal(shooting, &shooting.light);
            return Self {
                times: vec![phase(laboratory, t0_ps + 0.5 * dt_ps, &[0.0], dark, Some(&expected))],
                shots: 1.0,
            };
        }
        let shot_v2 = laboratory.shot_noise_v2(shooting);
        Self::analog(laboratory, &shooting.setting, shot_v2.as_ref(), laboratory.good_shots(shooting))
    }

    /// Samples at all phases, from an oscilloscope at this setting.
    fn analog(laboratory: &Laboratory, setting: &Setting, shot_v2: Option<&Pulse>, shots: f64) -> Self {
        let instrument = &laboratory.scene.instrument;
        let acf: Vec<f64> = laboratory.noise_acf().iter().map(|acf| acf * setting.noise_v * setting.noise_v).collect();
        let rounding_v2 = setting.gain_v() * setting.gain_v() / 12.0;
        let start_ps = |k: usize| instrument.t0_ps + instrument.dt_ps * k as f64 / PHASES as f64;
        let times = (0..PHASES).map(|k| phase(laboratory, start_ps(k), &acf, rounding_v2, shot_v2)).collect();
        Self { times, shots }
    }

    /// Fisher information of Gaussian samples on changes along these columns.
    fn information(&self, columns: &[Column]) -> DMatrix<f64> {
        let mut sum = DMatrix::zeros(columns.len(), columns.len());
        for (times, noise) in &self.times {
            let mut matrix = DMatrix::zeros(times.len(), columns.len());
            for (c, column) in columns.iter().enumerate() {
                let mut values: Vec<f64> = times.iter().map(|time_ps| column.value(*time_ps)).collect();
                noise.whiten(&mut values);
                matrix.set_column(c, &DVector::from_vec(values));
            }
            sum += matrix.tr_mul(&matrix);
        }
        sum * (self.shots / self.times.len() as f64)
    }
}

/// Sample times from `start_ps`, and the noise: correlated, white, and shot noise over time.
fn phase(laboratory: &Laboratory, start_ps: f64, acf: &[f64], white: f64, shot: Option<&Pulse>) -> (Vec<f64>, Banded) {
    let instrument = &laboratory.scene.instrument;
    let times: Vec<f64> = (0..instrument.samples).map(|n| start_ps + n as f64 * instrument.dt_ps).collect();
    let extra = |time_ps: &f64| white + shot.map_or(0.0, |shot| shot.value(*time_ps).max(0.0));
    let noise = Banded::new(acf, &times.iter().map(extra).collect::<Vec<f64>>());
    (times, noise)
}

/// Information on the unknowns to keep, with the others unknown too (Schur's complement).
pub(super) fn eliminate(information: &DMatrix<f64>, keep: &[usize]) -> DMatrix<f64> {
    // Unknowns without any information are uncorrelated with the rest.
    let is_informative = |i: &usize| information[(*i, *i)] > 0.0;
    let others: Vec<usize> = (0..information.nrows()).filter(|i| !keep.contains(i)).filter(is_informative).collect();
    let block = |rows: &[usize], columns: &[usize]| {
        DMatrix::from_fn(rows.len(), columns.len(), |r, c| information[(rows[r], columns[c])])
    };
    let own = block(keep, keep);
    if others.is_empty() {
        return own;
    }
    let cross = block(keep, &others);
    match inverse(&block(&others, &others)) {
        Some(inverse) => &own - &cross * inverse * cross.transpose(),
        // Unresolved heights leave no information on their times.
        None => DMatrix::zeros(keep.len(), keep.len()),
    }
}

/// Information on times (the first `times` unknowns) and others, when all times share an error of this variance.
fn with_common_error(information: &DMatrix<f64>, times: usize, variance_ps2: f64) -> DMatrix<f64> {
    let shared = DVector::from_fn(information.nrows(), |i, _| if i < times { 1.0 } else { 0.0 });
    let pulled = information * &shared;
    let total = shared.dot(&pulled);
    if variance_ps2 == 0.0 || total == 0.0 {
        return information.clone();
    }
    information - &pulled * pulled.transpose() / (1.0 / variance_ps2 + total)
}

/// Inverse of a symmetric positive definite matrix, scaled to a diagonal of ones first; `None` if it is singular to
/// working precision.
pub(super) fn inverse(matrix: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let scale: Vec<f64> = (0..matrix.nrows()).map(|i| matrix[(i, i)].sqrt()).collect();
    if scale.iter().any(|scale| !(*scale > 0.0 && scale.is_finite())) {
        return None;
    }
    let scaled = DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |i, j| matrix[(i, j)] / (scale[i] * scale[j]));
    let factor = scaled.cholesky()?;
    let smallest = factor.l_dirty().diagonal().iter().copied().fold(f64::INFINITY, f64::min);
    if smallest < 1e-7 {
        return None;
    }
    let inverse = factor.inverse();
    Some(DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |i, j| inverse[(i, j)] / (scale[i] * scale[j])))
}
