//! Captures at several vertical ranges: what clips in one is taken from another, and no capture is lost.

use std::fs;

use nalgebra::{DMatrix, DVector};
use periscope::pipeline::run::Settings;
use periscope::signal::averaged_response::averaged_response;
use periscope::signal::response::Response;
use periscope::simulate::Format;
use periscope::tables::{Calibration, Profile, Reject, Stir, TruePath};

use crate::averaging::{impulses, rms};
use crate::lab::Lab;

/// First bounces off a white and a nearly black patch in one view: no range holds both.
pub const TWO_RANGES: &str = r#"
[campaign]
name = "ranges"
[sensors.s1]
latency_ps = 1250.0
[patches.1]
position_m = [0.2, 0.0, 0.6]
normal = [-0.316228, 0.0, -0.948683]
size_m = 0.005
reflectance = 0.9
[patches.2]
position_m = [-0.2, 0.1, 1.1]
normal = [0.178174, -0.089087, -0.979958]
size_m = 0.005
reflectance = 0.15
[views.7]
patches = [1, 2]
[laser]
pulse_j = 4.483e-9
wavelength_nm = 810.0
repetition_hz = 10e6
[optics]
lens_m = 0.1
[instrument]
response = { kind = "emg", sigma_ps = 33.0, tau_ps = 112.0 }
responsivity_a_w = 0.45
load_ohm = 5000.0
dt_ps = 50.0
samples = 320
t0_ps = -1000.0
full_scale_v = 0.04
noise_v = 0.0003
jitter_ps = 80.0
rate_hz = 1000.0
reference = { fwhm_ps = 200.0, height_v = 0.1 }
[instrument.ranges.fine]
full_scale_v = 0.04
noise_v = 0.0003
[instrument.ranges.coarse]
full_scale_v = 1.0
noise_v = 0.006
latency_ps = 12.0
[instrument.flaws]
recovery = { ratio = 0.05, tau_ps = 150.0 }
[captures]
shots = 400
lit = [7]
seen = [7]
bounces = 1
ranges = "all"
response_shots = 1000
first_bounce_od = 2.5
path_m = 1.0
path_sd_m = 0.0001
"#;

#[test]
fn a_bounce_that_clips_the_sensitive_range_is_taken_from_the_other() {
    let pulls: Vec<[f64; 2]> = (1..=12).map(heights_pulls).collect();
    let of = |k: usize| rms(pulls.iter().map(|pulls| pulls[k]));
    eprintln!("height of the strong bounce off by {:.3} of its sd, of the weak one by {:.3}", of(0), of(1));
    // 12 draws: an rms of 1 is known to 20 %.
    assert!(of(0) < 1.6 && of(1) < 1.6, "{pulls:?}");
}

/// Errors of the heights of strong and weak bounce in a merged profile, over their standard deviations.
fn heights_pulls(seed: u64) -> [f64; 2] {
    let lab = Lab::of(TWO_RANGES, seed, Format::Trc);
    lab.run("out", impulses(), &Settings::default()).unwrap();
    let rejects: Vec<Reject> = lab.rows("out", "rejects");
    assert!(rejects.iter().all(|reject| &*reject.stage != "profiles"), "{rejects:?}");
    let profile = lab.rows::<Profile>("out", "profiles").remove(0);
    let mut paths: Vec<TruePath> = lab.truth();
    paths.sort_by(|a, b| a.time_ps.total_cmp(&b.time_ps));
    // The truth has each path once a range.
    paths.dedup_by(|a, b| a.path == b.path);
    let heights: Vec<f64> = paths.iter().map(|path| path.height_v.unwrap()).collect();
    assert!(heights[0] > 0.3 && (0.01..0.03).contains(&heights[1]), "the scene is not what it should be: {heights:?}");
    assert!(profile.range.as_deref() == Some("fine") && profile.shots >= 390 && profile.clipped < 5, "{profile:?}");
    assert!(profile.se_v().iter().all(|se| se.is_finite()) && profile.gain_sd < 0.02 && profile.jitter_ps < 2.0);
    // The sensitive range's noise, but for the strong bounce and its surroundings.
    let loud = profile.se_v().iter().filter(|se| **se > 3e-5).count();
    assert!((20..80).contains(&loud), "{loud} samples from the coarse range");
    // The true response as averaging leaves it, at the true times; weights as the profile says.
    let truth: Vec<Calibration> = lab.truth();
    let truth = &truth[0];
    let response = Response::new(truth.response_t0_ps, truth.step_ps, &truth.response.to_f64());
    let response = averaged_response(&response, profile.dt_ps, profile.phase_shots.as_ref().unwrap(), 1e-4);
    // Heights, heights times delays, baseline.
    let column = |n: usize, k: usize| {
        let time_ps = profile.t0_ps + n as f64 * profile.dt_ps - 1250.0;
        let (value, slope) = response.value_and_slope(time_ps - paths[k % 2].time_ps);
        [value, value, -slope, -slope, 1.0][k]
    };
    let samples = profile.samples();
    let weighted = DMatrix::from_fn(samples, 5, |n, k| column(n, k) / f64::from(profile.se_v()[n]));
    let right = DVector::from_fn(samples, |n, _| f64::from(profile.mean_v()[n]) / f64::from(profile.se_v()[n]));
    let covariance = (weighted.transpose() * &weighted).try_inverse().unwrap();
    let fit = &covariance * weighted.transpose() * &right;
    let chi2 = (&weighted * &fit - &right).norm_squared() / (samples - 5) as f64;
    let delay_ps = fit[2] / fit[0];
    eprintln!("chi2 {chi2:.3}; the strong bounce {delay_ps:.3} ps late, {:.3} ps known", profile.jitter_ps);
    // The strong bounce is 1,600 standard errors high, so the residual of shifting the coarse range near half the
    // sample rate, 0.3 %, is visible.
    assert!((0.7..2.0).contains(&chi2) && delay_ps.abs() < 4.0 * profile.jitter_ps, "{chi2} {delay_ps}");
    std::array::from_fn(|k| (fit[k] - heights[k]) / covariance[(k, k)].sqrt().hypot(profile.gain_sd * heights[k]))
}

/// Error of the strong bounce's time, its standard deviation, and the profile, of the whole campaign or of the range
/// that does not clip alone.
fn strong_bounce(scene: &str, seed: u64, alone: bool) -> (f64, f64, Profile) {
    let lab = Lab::of(scene, seed, Format::Trc);
    if alone {
        let path = lab.campaign().join("campaign.toml");
        let exclude = "[[exclude]]\nmatch = { role = 'scene', range = 'fine' }\nreason = 'alone'\n";
        fs::write(&path, fs::read_to_string(&path).unwrap() + exclude).unwrap();
    }
    lab.run("out", impulses(), &Settings::default()).unwrap();
    let rejects: Vec<Reject> = lab.rows("out", "rejects");
    assert!(rejects.iter().all(|reject| &*reject.stage != "profiles"), "{rejects:?}");
    let profile = lab.rows::<Profile>("out", "profiles").remove(0);
    let impulses = lab.rows::<Stir>("out", "stir").remove(0).impulses;
    let largest = impulses.iter().max_by(|a, b| a.amplitude_v.total_cmp(&b.amplitude_v)).unwrap();
    let paths: Vec<TruePath> = lab.truth();
    let first_ps = paths.iter().map(|path| path.time_ps).fold(f64::INFINITY, f64::min);
    (largest.time_ps - first_ps, largest.time_sd_ps.hypot(profile.jitter_ps), profile)
}

/// The sensitive range clips on the first bounce, and all light ends before it has recovered, or nearly so. What both
/// ranges see does not say how they scale; what is stated does, and no capture is lost.
#[test]
fn ranges_that_share_no_light_are_merged_by_what_is_stated() {
    let dark = TWO_RANGES.replace("reflectance = 0.15", "reflectance = 0.0001");
    let near = TWO_RANGES.replace("[-0.2, 0.1, 1.1]", "[-0.133990, 0.066993, 0.736928]");
    for (name, scene) in [("dark", dark), ("within recovery", near)] {
        let draws: Vec<[(f64, f64, Profile); 2]> =
            (1..=16).map(|seed| [false, true].map(|alone| strong_bounce(&scene, seed, alone))).collect();
        let rms_ps = |k: usize| rms(draws.iter().map(|draw| draw[k].0));
        let pull = rms(draws.iter().map(|draw| draw[0].0 / draw[0].1.hypot(0.4)));
        let gain_sd = draws.iter().map(|draw| draw[0].2.gain_sd).fold(0.0, f64::max);
        eprintln!(
            "{name}: strong bounce off by {:.3} ps merged (pull {pull:.2}), {:.3} ps from the coarse range alone; gain known to {gain_sd:.4}",
            rms_ps(0),
            rms_ps(1)
        );
        for [(.., merged), (.., alone)] in &draws {
            assert!([merged, alone].iter().all(|profile| profile.range.as_deref() == Some("coarse")), "{name}");
            // Dark samples have the sensitive range's noise, except for those that its shift by 12 ps costs.
            assert!(merged.se_v()[40] < 0.2 * alone.se_v()[40] && merged.gain_sd <= 0.021, "{name}: {merged:?}");
        }
        assert!(rms_ps(0) <= 1.1 * rms_ps(1) + 0.02, "{name}");
    }
}

/// Without a calibration of both ranges their delay is unknown: the range that is whole stands alone, and the table of
/// rejects says why.
#[test]
fn a_range_that_is_whole_is_never_lost() {
    let dark = TWO_RANGES.replace("reflectance = 0.15", "reflectance = 0.0001");
    let lab = Lab::of(&dark, 1, Format::Trc);
    let path = lab.campaign().join("campaign.toml");
    let exclude = "[[exclude]]\nmatch = { role = 'response', range = 'fine' }\nreason = 'not taken'\n";
    fs::write(&path, fs::read_to_string(&path).unwrap() + exclude).unwrap();
    lab.run("out", impulses(), &Settings::default()).unwrap();
    let rejects: Vec<Reject> = lab.rows("out", "rejects");
    assert!(
        rejects.iter().any(|reject| reject.reason.contains("is averaged from its vertical range coarse alone")
            && reject.reason.contains("capture the response at each range")),
        "{rejects:?}"
    );
    let profiles: Vec<Profile> = lab.rows("out", "profiles");
    assert!(profiles.len() == 1 && profiles[0].range.as_deref() == Some("coarse"), "{profiles:?}");
    assert_eq!(lab.rows::<Stir>("out", "stir").len(), 1);
}
