//! The Cramer-Rao calculator against a Fisher matrix of finite differences on the simulator's mean: every patch is
//! moved, every height, baseline, delay, width and path length changed, and nothing is known but how the samples
//! follow.

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::{DMatrix, DVector};
use periscope::bound::{Bound, Use};
use periscope::campaign::Role;
use periscope::simulate::transport::Light;
use periscope::simulate::{Laboratory, Scene, Shooting};

use crate::missed::pseudo_inverse;

const PHASES: usize = 4;
const LIGHT_M_PER_PS: f64 = 2.997_924_58e-4;

/// Samples of a capture at all phases, one after the other.
fn mean(laboratory: &Laboratory, shooting: &Shooting) -> Vec<f64> {
    let instrument = &laboratory.scene.instrument;
    let start_ps = |phase: usize| instrument.t0_ps + instrument.dt_ps * phase as f64 / PHASES as f64;
    (0..PHASES).flat_map(|phase| laboratory.mean_v(shooting, start_ps(phase))).collect()
}

/// A capture whose paths have these strengths.
fn with_strengths(shooting: &Shooting, strengths: &BTreeMap<Vec<i32>, f64>) -> Shooting {
    let mut changed = shooting.clone();
    for (path, light) in &mut changed.paths {
        let factor = strengths[path] / light.total();
        light.0.iter_mut().for_each(|(_, strength)| *strength *= factor);
    }
    changed.light = Light(changed.paths.values().flat_map(|light| light.0.iter().copied()).collect());
    changed
}

fn difference(more: &[f64], less: &[f64], step: f64) -> Vec<f64> {
    more.iter().zip(less).map(|(more, less)| (more - less) / (2.0 * step)).collect()
}

/// Covariance of a shot's samples: a Gaussian low-pass over white noise, and the converter's rounding.
fn covariance(scene: &Scene, shooting: &Shooting) -> DMatrix<f64> {
    let instrument = &scene.instrument;
    let variance_v2 = shooting.setting.noise_v.powi(2);
    let rounding_v2 = shooting.setting.gain_v().powi(2) / 12.0;
    // A Gaussian of the bandwidth B passes exp(-ln 2 / 2 (f / B)^2); its autocorrelation is a Gaussian of standard
    // deviation sqrt(ln 2) / (2 pi B) * sqrt 2.
    let reach_ps = instrument
        .noise_bandwidth_ghz
        .map(|bandwidth| std::f64::consts::LN_2.sqrt() * 2_f64.sqrt() / (std::f64::consts::TAU * 1e-3 * bandwidth));
    DMatrix::from_fn(instrument.samples, instrument.samples, |i, j| {
        let lag_ps = i.abs_diff(j) as f64 * instrument.dt_ps;
        let correlation = match reach_ps {
            None => f64::from(i == j),
            Some(reach_ps) => (-0.5 * (lag_ps / reach_ps).powi(2)).exp(),
        };
        variance_v2 * correlation + if i == j { rounding_v2 } else { 0.0 }
    })
}

/// Error that the reference pulse, a Gaussian, leaves in the mean of all shots.
fn reference_variance_ps2(scene: &Scene, shooting: &Shooting) -> f64 {
    let (instrument, reference) = (&scene.instrument, scene.instrument.reference.unwrap());
    let sigma = reference.fwhm_ps / (8.0 * 2_f64.ln()).sqrt();
    // Height 1; noise as on the signal, but for its size.
    let noise_v2 = 1.0 / reference.snr.unwrap().powi(2);
    let rounding_v2 = (1.0 / (0.6 * 256.0_f64)).powi(2) / 12.0;
    let signal_v2 = shooting.setting.noise_v.powi(2);
    let rounding_signal_v2 = shooting.setting.gain_v().powi(2) / 12.0;
    let noise = covariance(scene, shooting).map_with_location(|i, j, value| {
        let correlated = value - if i == j { rounding_signal_v2 } else { 0.0 };
        correlated * noise_v2 / signal_v2 + if i == j { rounding_v2 } else { 0.0 }
    });
    let column = |of: &dyn Fn(f64) -> f64| -> Vec<f64> {
        let start_ps = |phase: usize| instrument.t0_ps + instrument.dt_ps * phase as f64 / PHASES as f64;
        let times = |phase: usize| (0..instrument.samples).map(move |n| start_ps(phase) + n as f64 * instrument.dt_ps);
        (0..PHASES).flat_map(times).map(of).collect()
    };
    let pulse = |t: f64| (-0.5 * (t / sigma).powi(2)).exp();
    let columns = [column(&|t| t / (sigma * sigma) * pulse(t)), column(&pulse), column(&|_| 1.0)];
    let shots = shooting.shots as f64 * (1.0 - scene.captures.bad_shots);
    1.0 / of_capture(&columns, 1, &[], &noise, shots)[(0, 0)]
}

/// Information on the first `kept` unknowns of a capture whose columns these are, with priors on the others.
fn of_capture(
    columns: &[Vec<f64>],
    kept: usize,
    priors: &[(usize, f64)],
    noise: &DMatrix<f64>,
    shots: f64,
) -> DMatrix<f64> {
    let inverse = noise.clone().cholesky().unwrap().inverse();
    let samples = noise.nrows();
    let mut information = DMatrix::zeros(columns.len(), columns.len());
    for phase in 0..PHASES {
        let part = DMatrix::from_fn(samples, columns.len(), |i, c| columns[c][phase * samples + i]);
        information += part.transpose() * &inverse * part * (shots / PHASES as f64);
    }
    for (at, variance) in priors {
        information[(*at, *at)] += 1.0 / variance;
    }
    let (own, rest) = (kept, columns.len() - kept);
    let nuisance = information.view((own, own), (rest, rest)).into_owned();
    let cross = information.view((0, own), (own, rest)).into_owned();
    information.view((0, 0), (own, own)) - &cross * nuisance.try_inverse().unwrap() * cross.transpose()
}

/// Standard deviation of each patch by finite differences.
fn by_differences(text: &str) -> Vec<f64> {
    let parse = |text: &str| Scene::parse(Path::new("scene.toml"), text).unwrap();
    let scene = parse(text);
    let patches: Vec<i32> = scene.patches.keys().copied().collect();
    let moved = |patch: i32, axis: usize, step: f64| {
        let mut moved = scene.clone();
        moved.patches.get_mut(&patch).unwrap().position_m[axis] += step;
        moved
    };
    let stretched = |factor: f64| {
        parse(
            &text
                .replace("sigma_ps = 33.0", &format!("sigma_ps = {}", 33.0 * factor))
                .replace("tau_ps = 112.0", &format!("tau_ps = {}", 112.0 * factor)),
        )
    };
    let (step_m, width_step) = (1e-4, 0.01);
    let nominal = Laboratory::new(&scene, 0).unwrap();
    let scenes: Vec<[Scene; 2]> = patches
        .iter()
        .flat_map(|patch| (0..3).map(|axis| [moved(*patch, axis, step_m), moved(*patch, axis, -step_m)]))
        .collect();
    let labs: Vec<[Laboratory; 2]> =
        scenes.iter().map(|pair| pair.each_ref().map(|scene| Laboratory::new(scene, 0).unwrap())).collect();
    let wide = [stretched(1.0 + width_step), stretched(1.0 - width_step)];
    let wide = wide.each_ref().map(|scene| Laboratory::new(scene, 0).unwrap());
    let coordinates = 3 * patches.len();
    // Coordinates, then delay and width.
    let mut information = DMatrix::zeros(coordinates + 2, coordinates + 2);
    for (number, shooting) in nominal.shootings.iter().enumerate() {
        let strengths: BTreeMap<Vec<i32>, f64> =
            shooting.paths.iter().map(|(path, light)| (path.clone(), light.total())).collect();
        let at = |laboratory: &Laboratory| mean(laboratory, &with_strengths(&laboratory.shootings[number], &strengths));
        let later = |step_ps: f64| {
            let mut later = shooting.clone();
            later.latency_ps += step_ps;
            mean(&nominal, &later)
        };
        let delay = difference(&later(1.0), &later(-1.0), 1.0);
        let width = if shooting.role == Role::Response {
            difference(
                &mean(&wide[0], &wide[0].shootings[number]),
                &mean(&wide[1], &wide[1].shootings[number]),
                width_step,
            )
        } else {
            difference(&at(&wide[0]), &at(&wide[1]), width_step)
        };
        let height = mean(&nominal, shooting);
        let baseline = vec![1.0; height.len()];
        let noise = covariance(&scene, shooting);
        let shots = shooting.shots as f64 * (1.0 - scene.captures.bad_shots);
        let reference = reference_variance_ps2(&scene, shooting);
        if shooting.role == Role::Response {
            let path_ps = (scene.captures.path_sd_m / LIGHT_M_PER_PS * scene.group_index).powi(2);
            let columns = [delay.clone(), width, height, baseline, delay.clone(), delay];
            let said = of_capture(&columns, 2, &[(4, reference), (5, path_ps)], &noise, shots);
            let mut block = information.view_mut((coordinates, coordinates), (2, 2));
            block += said;
            continue;
        }
        let mut columns: Vec<Vec<f64>> =
            labs.iter().map(|[more, less]| difference(&at(more), &at(less), step_m)).collect();
        columns.extend([delay.clone(), width]);
        for path in strengths.keys() {
            let mut scaled = [strengths.clone(), strengths.clone()];
            let strength = strengths[path];
            scaled[0].insert(path.clone(), 1.01 * strength);
            scaled[1].insert(path.clone(), 0.99 * strength);
            // A change of one strength must not be undone by the amplification to one height.
            let total: f64 = strengths.values().sum();
            let [more, less] = scaled.each_ref().map(|strengths| {
                let factor = strengths.values().sum::<f64>() / total;
                let mean = mean(&nominal, &with_strengths(shooting, strengths));
                mean.into_iter().map(|value| value * factor).collect::<Vec<f64>>()
            });
            columns.push(difference(&more, &less, 0.01));
        }
        columns.extend([baseline, delay]);
        let last = columns.len() - 1;
        information += of_capture(&columns, coordinates + 2, &[(last, reference)], &noise, shots);
    }
    let (own, rest) =
        (information.view((0, 0), (coordinates, coordinates)), information.view((coordinates, coordinates), (2, 2)));
    let cross = information.view((0, coordinates), (coordinates, 2));
    let alone = own - cross * rest.into_owned().try_inverse().unwrap() * cross.transpose();
    let all = pseudo_inverse(&alone, 3);
    let variances = DVector::from_fn(coordinates, |i, _| all[(i, i)]);
    (0..patches.len()).map(|k| variances.rows(3 * k, 3).sum().sqrt()).collect()
}

fn compare(text: &str, bounces: usize) {
    let scene = Scene::parse(Path::new("scene.toml"), text).unwrap();
    // All pulses count in the finite differences.
    let bound = Bound::new(&scene, Use { bounces, threshold_sigma: 0.0 }).unwrap().coordinates;
    let reference = by_differences(text);
    for (patch, reference_m) in bound.patches.iter().zip(reference) {
        let sd_m = bound.sd_m(*patch).unwrap();
        eprintln!("patch {patch}: bound {:.5} mm, by differences {:.5} mm", 1e3 * sd_m, 1e3 * reference_m);
        assert!((sd_m / reference_m - 1.0).abs() < 0.01);
    }
}

const TINY: &str = include_str!("../../pipelines/scenes/tiny.toml");

#[test]
fn the_bound_is_that_of_finite_differences() {
    compare(TINY, 2);
}

#[test]
fn the_bound_is_that_of_finite_differences_in_correlated_noise() {
    compare(&TINY.replace("snr = 20.0", "noise_bandwidth_ghz = 6.0\nsnr = 20.0"), 2);
}

/// Third bounces among visible patches, as strong as first ones through the large patches, blended here and there.
#[test]
fn the_bound_is_that_of_finite_differences_with_third_bounces() {
    let large = TINY.replace("size_m = 0.001", "size_m = 0.02").replace("[captures]", "[captures]\nbounces = 3");
    let large = large.replace("samples = 320", "samples = 420");
    compare(&large, 3);
}
