//! The whole chain against the Cramer-Rao bound; `benches/accuracy.rs` runs it over hundreds of seeds for
//! docs/accuracy.md.

use std::path::Path;

use periscope::bound::{Bound, Use};
use periscope::pipeline::run::Settings;
use periscope::simulate::{Format, Scene};
use periscope::tables::{Onset, Patch, PatchCovariance, Stir};

use crate::lab::{ALL_VISIBLE, Lab};
use crate::missed;

/// The demo's scene.
pub const SCENE: &str = include_str!("../../pipelines/scenes/all-visible.toml");
/// One whose signal-to-noise ratios are derived.
pub const PHOTODIODE: &str = include_str!("../../pipelines/scenes/photodiode.toml");

/// What some seeds of one scene gave.
pub struct Study {
    pub seeds: usize,
    /// Root of the mean squared position error, and of the bound's.
    pub rms_m: f64,
    pub bound_m: f64,
    /// The paper's Algorithm 1 and classical scaling on the same onsets.
    pub paper_rms_m: f64,
    pub start_rms_m: f64,
    /// Normalised squared error of each seed.
    pub normalised: Vec<f64>,
    pub degrees_of_freedom: f64,
    /// Onset errors: root mean square about their seed's mean, bound, and share of true onsets found.
    pub onset_rms_ps: f64,
    pub onset_bound_ps: f64,
    pub onsets_found: f64,
    pub false_onsets: usize,
    /// Onset errors about their seed's mean, over the standard deviations stated.
    pub pulls: Vec<f64>,
}

/// Simulates, runs and measures each seed.
pub fn study(text: &str, seeds: std::ops::Range<u64>) -> Study {
    let scene = Scene::parse(Path::new("scene.toml"), text).unwrap();
    let count = scene.patches.len();
    let mut study = Study {
        seeds: (seeds.end - seeds.start) as usize,
        rms_m: 0.0,
        bound_m: 0.0,
        paper_rms_m: 0.0,
        start_rms_m: 0.0,
        normalised: Vec::new(),
        degrees_of_freedom: 0.0,
        onset_rms_ps: 0.0,
        onset_bound_ps: 0.0,
        onsets_found: 0.0,
        false_onsets: 0,
        pulls: Vec::new(),
    };
    for seed in seeds {
        let lab = Lab::of(text, seed, Format::Trc);
        lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
        let truth: Vec<Patch> = lab.truth();
        let missed = missed::missed(
            &lab.rows("out", "patches"),
            &lab.rows::<PatchCovariance>("out", "patches.patch_covariances"),
            &truth,
        );
        study.degrees_of_freedom = missed::degrees_of_freedom(&truth) as f64;
        study.rms_m += missed.squares_m2;
        study.normalised.push(missed.normalised);
        study.paper_rms_m += missed::squares_m2(&lab.rows("out", "paper"), &truth);
        study.start_rms_m += missed::squares_m2(&lab.rows("out", "start"), &truth);
        onsets(&lab, &mut study);
    }
    let places = (study.seeds * count) as f64;
    for sum in [&mut study.rms_m, &mut study.paper_rms_m, &mut study.start_rms_m] {
        *sum = (*sum / places).sqrt();
    }
    let profiles = (study.seeds * count * count) as f64;
    study.onset_rms_ps = (study.onset_rms_ps / (profiles - study.seeds as f64)).sqrt();
    study.onsets_found /= profiles;
    let bound = Bound::new(&scene, Use::default()).unwrap();
    let onset_sds =
        bound.profiles.iter().flat_map(|profile| profile.pulses.iter().filter_map(|pulse| pulse.time_sd_ps));
    study.onset_bound_ps = (onset_sds.map(|sd_ps| sd_ps * sd_ps).sum::<f64>() / (count * count) as f64).sqrt();
    study.bound_m = bound.coordinates.rms_m();
    study
}

/// Compares onsets with the true ones: within 20 standard deviations of a true one they count as it, else as false.
fn onsets(lab: &Lab, study: &mut Study) {
    let onsets: Vec<Onset> = lab.rows("out", "onsets");
    let mut errors = Vec::new();
    for truth in lab.truth::<Onset>() {
        let near = |onset: &&Onset| {
            (onset.lit, onset.seen) == (truth.lit, truth.seen)
                && (onset.time_ps - truth.time_ps).abs() < 20.0 * onset.time_sd_ps
        };
        let error = |onset: &Onset| (onset.time_ps - truth.time_ps, onset.time_sd_ps.hypot(onset.jitter_ps));
        errors.extend(onsets.iter().find(near).map(error));
    }
    // The latency's error is common to all; the bound knows it as a delay.
    let mean = errors.iter().map(|(error, _)| error).sum::<f64>() / errors.len() as f64;
    study.onset_rms_ps += errors.iter().map(|(error, _)| (error - mean).powi(2)).sum::<f64>();
    // The mean that is taken off has a share in every error: one of their number.
    let kept = (1.0 - 1.0 / errors.len() as f64).sqrt();
    study.pulls.extend(errors.iter().map(|(error, sd_ps)| (error - mean) / (sd_ps * kept)));
    study.onsets_found += errors.len() as f64;
    study.false_onsets += onsets.len() - errors.len();
}

/// Six seeds: 198 degrees of freedom of the normalised error (one standard deviation: 10 %), 216 positions.
#[test]
fn positions_reach_the_bound_and_their_covariances_are_of_the_right_size() {
    let study = study(SCENE, 0..6);
    let ratio = study.rms_m / study.bound_m;
    let nse = study.normalised.iter().sum::<f64>() / study.seeds as f64 / study.degrees_of_freedom;
    eprintln!(
        "rms {:.4} mm, bound {:.4} mm, ratio {ratio:.3}; NSE/dof {nse:.3}; onsets {:.4} ps, bound {:.4} ps; found {:.4}, false {}; Algorithm 1 {:.4} mm, start {:.4} mm",
        study.rms_m * 1e3,
        study.bound_m * 1e3,
        study.onset_rms_ps,
        study.onset_bound_ps,
        study.onsets_found,
        study.false_onsets,
        study.paper_rms_m * 1e3,
        study.start_rms_m * 1e3
    );
    assert!(ratio < 1.35, "rms over bound {ratio}");
    assert!((0.7..1.35).contains(&nse), "normalised squared error over degrees of freedom {nse}");
    assert!(study.onsets_found == 1.0 && study.false_onsets <= 2);
}

/// Impulses in addition to the one of each profile, and squared errors of the onsets over their variances, on average
/// over seeds; the latency's error, common to all onsets of a seed, is taken out.
fn impulses(text: &str, seeds: std::ops::Range<u64>) -> (usize, f64) {
    let (mut beside, mut normalised, count) = (0, 0.0, seeds.end - seeds.start);
    for seed in seeds {
        let lab = Lab::of(text, seed, Format::Trc);
        lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
        let profiles: Vec<Stir> = lab.rows("out", "stir");
        beside += profiles.iter().map(|stir| stir.impulses.len().saturating_sub(1)).sum::<usize>();
        let onsets: Vec<Onset> = lab.rows("out", "onsets");
        let errors: Vec<(f64, f64)> = lab
            .truth::<Onset>()
            .iter()
            .map(|truth| {
                let of_profile = onsets.iter().filter(|onset| (onset.lit, onset.seen) == (truth.lit, truth.seen));
                let nearest = of_profile.max_by(|a, b| a.snr.total_cmp(&b.snr)).expect("strong pulses");
                (nearest.time_ps - truth.time_ps, nearest.time_sd_ps.powi(2) + nearest.jitter_ps.powi(2))
            })
            .collect();
        let weight: f64 = errors.iter().map(|(_, variance)| 1.0 / variance).sum();
        let mean = errors.iter().map(|(error, variance)| error / variance).sum::<f64>() / weight;
        let squares: f64 = errors.iter().map(|(error, variance)| (error - mean).powi(2) / variance).sum();
        normalised += squares / (errors.len() - 1) as f64;
    }
    (beside, normalised / count as f64)
}

/// The front end of an oscilloscope of 6 GHz, sampled every 50 ps, correlates the noise of neighbouring samples by
/// 0.28; one of 3 GHz by 0.73. Before a response as slow as the second Gaussian both have more noise than white noise
/// of their sd (1.5 and 2.5 times its power): taken for white, errors squared are larger by as much and every fifth
/// record has a false impulse at 3 GHz. 210 degrees of freedom each: one standard deviation is 10 %.
#[test]
fn correlated_noise_is_no_light_and_error_bars_have_the_right_size() {
    let slow =
        PHOTODIODE.replace(r#"kind = "emg", sigma_ps = 33.0, tau_ps = 112.0"#, r#"kind = "gaussian", fwhm_ps = 250.0"#);
    assert!(slow != PHOTODIODE);
    for bandwidth_ghz in [6.0, 3.0] {
        let noise = format!("noise_v = 0.0003\nnoise_bandwidth_ghz = {bandwidth_ghz:?}");
        let (beside, normalised) = impulses(&slow.replace("noise_v = 0.0003", &noise), 0..6);
        eprintln!("{bandwidth_ghz} GHz: {beside} false impulses, squared errors over variances {normalised:.3}");
        assert!(beside <= 1, "{bandwidth_ghz} GHz: {beside} false impulses in 216 records");
        assert!((0.7..1.35).contains(&normalised), "{bandwidth_ghz} GHz: {normalised}");
    }
}
