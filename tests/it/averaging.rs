//! Profiles of simulated captures, compared with the truth.

use std::f64::consts::PI;
use std::fs;

use nalgebra::{DMatrix, DVector};
use periscope::campaign::Campaign;
use periscope::pipeline::run::Settings;
use periscope::signal::average::{PHASES, PhaseSums};
use periscope::signal::averaged_response::averaged_response;
use periscope::signal::codes::Codes;
use periscope::signal::reference::fit_pulse;
use periscope::signal::response::Response;
use periscope::simulate::Format;
use periscope::tables::{Calibration, Impulse, Onset, Patch, PatchCovariance, Profile, Reject, Stir, TruePath};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::accuracy::{PHOTODIODE, SCENE, study};
use crate::lab::{ALL_VISIBLE, AVERAGES, Lab, chain, write_table};
use crate::missed;

const NO_REFERENCE: &str = include_str!("../../pipelines/scenes/no-reference.toml");

/// The pipeline as far as impulses.
fn impulses() -> &'static str {
    ALL_VISIBLE.split_once("[onsets]").unwrap().0
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    values.sum::<f64>() / count
}

fn rms(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    mean(values.map(|value| value * value)).sqrt()
}

/// A capture of 50 shots at a signal-to-noise ratio of 80 shows the trigger's jitter of 4 ps. At 10 it does not, and so
/// none is claimed.
#[test]
fn jitter_that_no_reference_tells_is_seen_in_the_noise() {
    for (snr, least_claims) in [(80.0, 64), (10.0, 0)] {
        let lab = Lab::of(&NO_REFERENCE.replace("snr = 10.0", &format!("snr = {snr:?}")), 1, Format::Trc);
        lab.run("out", impulses(), &Settings::default()).unwrap();
        let profiles: Vec<Profile> = lab.rows("out", "profiles");
        let jitter_ps: Vec<f64> =
            profiles.iter().map(|profile| profile.jitter_ps * f64::from(profile.shots).sqrt()).collect();
        let model = |profile: &Profile| profile.noise_model.as_ref().unwrap()[0].sqrt() / profile.noise_v;
        let noise = mean(profiles.iter().map(model));
        let (jitters, energies) = (
            jitter_ps.iter().filter(|jitter_ps| **jitter_ps > 0.0).count(),
            profiles.iter().filter(|profile| profile.gain_sd > 0.0).count(),
        );
        let jitter_ps = rms(jitter_ps.iter().copied());
        eprintln!(
            "SNR {snr}: jitter {jitter_ps:.3} ps in {jitters} of {}, noise {noise:.4}, energy in {energies}",
            profiles.len()
        );
        assert!(
            jitters >= least_claims && (snr > 10.0 || energies <= 8) && (noise - 1.0).abs() < 0.03,
            "{jitters} {energies} {noise}"
        );
        assert!(snr < 80.0 || (jitter_ps / 4.0 - 1.0).abs() < 0.1, "{jitter_ps} ps");
    }
}

/// Error bars of positions against the trigger alone, given the jitter that the calibration's noise model has.
#[test]
fn positions_without_reference_know_their_jitter() {
    let (mut normalised, seeds) = (0.0, 4);
    for seed in 0..seeds {
        let lab = Lab::of(NO_REFERENCE, seed, Format::Trc);
        lab.run("first", ALL_VISIBLE, &Settings::default()).unwrap();
        let rows: Vec<Calibration> = lab.rows("first", "calibration");
        let stated = rows.into_iter().map(|row| Calibration { noise_model: Some(vec![0.0, 0.0, 0.0, 16.0]), ..row });
        let path = lab.path("calibration.parquet");
        write_table(&path, &stated.collect::<Vec<_>>());
        let import =
            format!("[calibration]\nstage = 'import'\nparams = {{ table = 'calibration', path = {path:?} }}\n");
        let scene = ALL_VISIBLE.split_once("[traces]").unwrap().1.replace(", session = \"session\"", "");
        let pipeline = format!("{import}[traces]{scene}");
        lab.run("out", &pipeline, &Settings::default()).unwrap();
        let truth: Vec<Patch> = lab.truth();
        let covariances: Vec<PatchCovariance> = lab.rows("out", "patches.patch_covariances");
        let missed = missed::missed(&lab.rows("out", "patches"), &covariances, &truth);
        normalised += missed.normalised / missed::degrees_of_freedom(&truth) as f64 / seeds as f64;
    }
    eprintln!("NSE/dof {normalised:.3}");
    assert!((0.6..1.5).contains(&normalised), "{normalised}");
}

/// Mean time and integral of the reference pulses scatter by their standard errors; the simulator's pulses are at the
/// trigger.
#[test]
fn the_reference_pulse_is_timed_and_measured() {
    let lab = Lab::of(SCENE, 1, Format::Trc);
    lab.run("out", impulses(), &Settings::default()).unwrap();
    let profiles: Vec<Profile> = lab.rows("out", "profiles");
    let time = |profile: &Profile| (profile.reference_ps.unwrap(), profile.reference_sd_ps.unwrap());
    let area = |profile: &Profile| (profile.reference_v_ps.unwrap(), profile.reference_sd_v_ps.unwrap());
    let scatter = |of: &dyn Fn(&Profile) -> (f64, f64)| {
        let centre = mean(profiles.iter().map(|profile| of(profile).0));
        (centre, rms(profiles.iter().map(|profile| (of(profile).0 - centre) / of(profile).1)))
    };
    let (time, area) = (scatter(&time), scatter(&area));
    let left_ps = mean(profiles.iter().map(|profile| profile.jitter_ps * f64::from(profile.shots).sqrt()));
    eprintln!(
        "left {left_ps:.2} ps; time {:.2} ps, scatter {:.3}; area {:.2} V ps, scatter {:.3}",
        time.0, time.1, area.0, area.1
    );
    assert!((1.0..2.0).contains(&left_ps) && time.0.abs() < 3.0, "{left_ps} {time:?}");
    // 144 captures: a scatter of 1 is known to 6 %. The area under a Gaussian of 200 ps, 0.6 V high.
    assert!((0.8..1.25).contains(&time.1) && (0.8..1.25).contains(&area.1), "{time:?} {area:?}");
    assert!((area.0 / (0.6 * 200.0 * (PI / 4.0 / 2_f64.ln()).sqrt()) - 1.0).abs() < 0.01, "{area:?}");
}

/// Records that begin just before their light: it stands in the tenth that is the baseline otherwise. The baseline is
/// taken where the record is dark; bounces are found, and their errors are right.
#[test]
fn light_in_the_first_tenth_is_no_baseline() {
    let scene = NO_REFERENCE.replace("snr = 10.0", "snr = 28.3").replace("jitter_ps = 4.0", "jitter_ps = 0.0");
    let (mut pulls, mut found, mut captures) = (Vec::new(), 0, 0);
    for seed in 1..=3 {
        let lab = Lab::of(&scene, seed, Format::Trc);
        lab.run("whole", impulses(), &Settings::default()).unwrap();
        let truth: Vec<Onset> = lab.truth();
        crop_to_light(&lab, &truth);
        lab.run("out", impulses(), &Settings::default()).unwrap();
        let rejects: Vec<Reject> = lab.rows("out", "rejects");
        assert!(rejects.iter().all(|reject| &*reject.stage != "profiles"), "{rejects:?}");
        let (whole, cropped): (Vec<Profile>, Vec<Profile>) =
            (lab.rows("whole", "profiles"), lab.rows("out", "profiles"));
        let acf = |profiles: &[Profile]| mean(profiles.iter().map(|profile| f64::from(profile.noise_acf[1])));
        let noise = |profiles: &[Profile]| mean(profiles.iter().map(|profile| profile.noise_v));
        let (acf, noise) = (acf(&cropped) - acf(&whole), noise(&cropped) / noise(&whole));
        eprintln!(
            "neighbouring samples correlate by {acf:.3} more than in whole records; noise is {noise:.3} of theirs"
        );
        assert!(acf.abs() < 0.05 && (noise - 1.0).abs() < 0.03, "{acf} {noise}");
        let mut errors = Vec::new();
        for stir in lab.rows::<Stir>("out", "stir") {
            let truth = truth.iter().find(|onset| (onset.lit, onset.seen) == (stir.lit, stir.seen)).unwrap();
            let near = |impulse: &&Impulse| (impulse.time_ps - truth.time_ps).abs() < 30.0;
            captures += 1;
            errors
                .extend(stir.impulses.iter().find(near).map(|found| (found.time_ps - truth.time_ps, found.time_sd_ps)));
        }
        found += errors.len();
        let weight: f64 = errors.iter().map(|(_, sd)| sd.powi(-2)).sum();
        let centre = errors.iter().map(|(error, sd)| error / (sd * sd)).sum::<f64>() / weight;
        // The mean that is taken off has a share in every error.
        let kept = (1.0 - 1.0 / errors.len() as f64).sqrt();
        pulls.extend(errors.iter().map(|(error, sd)| (error - centre) / (sd * kept)));
    }
    let pull = rms(pulls.iter().copied());
    eprintln!("{found} of {captures} bounces found, rms / sd {pull:.3}");
    // 132 draws: an rms of 1 is known to 6 %.
    assert!(found == captures && captures > 120 && (0.9..1.1).contains(&pull), "{found} of {captures}: {pull}");
}

/// Cuts every record of the scene some samples before its light.
fn crop_to_light(lab: &Lab, truth: &[Onset]) {
    let path = lab.campaign().join("campaign.toml");
    let text = fs::read_to_string(&path).unwrap();
    let rule = text.find("role = \"scene\"").expect("a rule for the scene");
    let files = rule + text[rule..].find("files = ").expect("a pattern");
    let end = files + text[files..].find('\n').unwrap();
    fs::write(&path, format!("{}table = \"captures.csv\"{}", &text[..files], &text[end..])).unwrap();
    let latency_ps = lab.truth::<Calibration>()[0].latency_ps;
    let row = |Onset { lit, seen, time_ps, .. }: &Onset| {
        // Records begin 1 ns before the trigger, to a sample.
        let at = ((time_ps + latency_ps + 1000.0) / 20.0) as i64 - 12;
        format!("raw/scene/s1_L{lit}_P{seen}_C1.trc,s1,{lit},{seen},\"[{at}, {}]\"", at + 220)
    };
    let rows: Vec<String> = truth.iter().map(row).collect();
    let table = format!("file,sensor,lit,seen,samples\n{}\n", rows.join("\n"));
    fs::write(lab.campaign().join("captures.csv"), table).unwrap();
}

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
    assert!(profile.se_v.iter().all(|se| se.is_finite()) && profile.gain_sd < 0.02 && profile.jitter_ps < 2.0);
    // The sensitive range's noise, but for the strong bounce and its surroundings.
    let loud = profile.se_v.iter().filter(|se| **se > 3e-5).count();
    assert!((20..80).contains(&loud), "{loud} samples from the coarse range");
    // The true response as averaging leaves it, at the true times; weights as the profile says.
    let truth: Vec<Calibration> = lab.truth();
    let truth = &truth[0];
    let response = Response::new(truth.response_t0_ps, truth.step_ps, &truth.response.to_f64());
    let response = averaged_response(&response, profile.dt_ps, profile.phase_shots.as_ref().unwrap());
    // Heights, heights times delays, baseline.
    let column = |n: usize, k: usize| {
        let time_ps = profile.t0_ps + n as f64 * profile.dt_ps - 1250.0;
        let (value, slope) = response.value_and_slope(time_ps - paths[k % 2].time_ps);
        [value, value, -slope, -slope, 1.0][k]
    };
    let samples = profile.mean_v.len();
    let weighted = DMatrix::from_fn(samples, 5, |n, k| column(n, k) / f64::from(profile.se_v[n]));
    let right = DVector::from_fn(samples, |n, _| f64::from(profile.mean_v[n]) / f64::from(profile.se_v[n]));
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
            assert!(merged.se_v[40] < 0.2 * alone.se_v[40] && merged.gain_sd <= 0.021, "{name}: {merged:?}");
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

/// Light of the pulse before fills what precedes the trigger: one period, cut open where it is dark.
#[test]
fn records_longer_than_the_lasers_period_are_one_period() {
    let scene = PHOTODIODE
        .replace("repetition_hz = 10e6", "repetition_hz = 93.68e6")
        .replace("samples = 320", "samples = 228")
        .replace("jitter_ps = 80.0", "jitter_ps = 40.0")
        // Some light comes a period later.
        .replace("latency_ps = 1250.0", "latency_ps = 4250.0");
    let lab = Lab::of(&scene, 3, Format::Trc);
    // The record is longer than a period, but ends before the next trigger: the simulator's campaign gives no period
    // then.
    let path = lab.campaign().join("campaign.toml");
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.replace("[campaign]\n", "[campaign]\nrepetition_ps = 10674.637062340\n")).unwrap();
    lab.run("out", impulses(), &Settings::default()).unwrap();
    let period_ps = 1e12 / 93.68e6;
    let (profiles, stirs): (Vec<Profile>, Vec<Stir>) = (lab.rows("out", "profiles"), lab.rows("out", "stir"));
    let mut pulls = Vec::new();
    let mut wrapped = 0;
    for (profile, stir) in profiles.iter().zip(&stirs) {
        assert!((profile.dt_ps * profile.mean_v.len() as f64 - period_ps).abs() < 1e-6, "{}", profile.dt_ps);
        let truth: Vec<Onset> = lab.truth();
        let truth = truth.iter().find(|onset| (onset.lit, onset.seen) == (stir.lit, stir.seen)).unwrap();
        let largest = stir.impulses.iter().max_by(|a, b| a.amplitude_v.total_cmp(&b.amplitude_v)).unwrap();
        let error_ps = largest.time_ps - truth.time_ps;
        let turns = (error_ps / period_ps).round();
        wrapped += usize::from(truth.time_ps + 4250.0 > 10_674.64);
        pulls.push((error_ps - turns * period_ps, largest.time_sd_ps.hypot(profile.jitter_ps)));
        // In the middle, far from both ends.
        let place = (largest.time_ps - stir.t0_ps) / period_ps;
        assert!((0.2..0.8).contains(&place), "{} {}: at {place}", stir.lit, stir.seen);
    }
    let weight: f64 = pulls.iter().map(|(_, sd)| sd.powi(-2)).sum();
    let centre = pulls.iter().map(|(error, sd)| error / (sd * sd)).sum::<f64>() / weight;
    let pull = rms(pulls.iter().map(|(error, sd)| (error - centre) / sd));
    let beside = stirs.iter().map(|stir| stir.impulses.len() - 1).sum::<usize>();
    eprintln!("{} profiles, {wrapped} wrapped, {beside} false impulses, pull {pull:.3}", profiles.len());
    assert!(wrapped > 3 && beside <= 2 && (0.7..1.4).contains(&pull), "{wrapped} {beside} {pull}");
}

/// The photodiode's scene before a photon counter.
fn counter() -> String {
    let counts = "[instrument.counts]\nefficiency = 6e-5\ndark_hz = 2e5\n[captures]\nshots = 400000";
    let scene = PHOTODIODE.replace("latency_ps = 1250.0", "latency_ps = 1250.0\nkind = 'counts'");
    scene.replace("[captures]\nshots = 400", counts).replace("first_bounce_od = 4.8", "first_bounce_od = 5.0")
}

#[test]
fn photon_histograms_are_counts_with_poisson_errors() {
    let lab = Lab::of(&counter(), 1, Format::Trc);
    let scenes = AVERAGES.replace("stage = 'ingest'", "stage = 'ingest'\nparams = { roles = ['scene'] }");
    lab.run("out", &scenes, &Settings::default()).unwrap();
    let profiles: Vec<Profile> = lab.rows("out", "profiles");
    let paths: Vec<TruePath> = lab.truth();
    let mut pulls = Vec::new();
    for profile in &profiles {
        let counts = profile.counts.as_ref().unwrap();
        let total: f64 = counts.iter().copied().map(f64::from).sum();
        let signal: f64 = profile.mean_v.to_f64().iter().sum();
        assert!((signal + profile.baseline_v * counts.len() as f64 - total).abs() < 1e-3 * total);
        assert!(profile.cycles == Some(400_000) && profile.phase_shots.is_none() && profile.jitter_ps == 0.0);
        let se = |n: usize| f64::from(counts[n]).max(profile.baseline_v).max(1.0).sqrt();
        assert!((0..counts.len()).all(|n| (f64::from(profile.se_v[n]) / se(n) - 1.0).abs() < 1e-6));
        let of_capture = paths.iter().filter(|path| (path.lit, path.seen) == (profile.lit, profile.seen));
        let expected: f64 = of_capture.map(|path| path.snr * path.snr).sum();
        // Of its own scatter, and of the baseline's, from 32 bins.
        let variance = total + (counts.len() as f64).powi(2) * profile.baseline_v / 32.0;
        pulls.push((signal - expected) / variance.sqrt());
    }
    let expected: Vec<f64> = paths.iter().map(|path| path.snr * path.snr).collect();
    eprintln!("{} profiles, pull {:.3}, expected {:?}", profiles.len(), rms(pulls.iter().copied()), &expected[..4]);
    assert!((0.7..1.3).contains(&rms(pulls.iter().copied())), "{pulls:?}");
    let path = lab.campaign().join("campaign.toml");
    fs::write(&path, fs::read_to_string(&path).unwrap().replace("cycles = 400000\n", "")).unwrap();
    assert!(Campaign::load(&lab.campaign()).is_ok());
    let error = chain(lab.run("out", &scenes, &Settings::default()).unwrap_err());
    assert!(error.contains("give `cycles` in [sensors.s1] of campaign.toml"), "{error}");
}

/// 3 % of shots without light, or with four times as much, cost little if the others reveal them: 144 captures of 1,000
/// shots, jitter 100 ps.
#[test]
fn bad_shots_cost_little() {
    let scene = SCENE.replace("shots = 100\n", "shots = 1000\n").replace("jitter_ps = 80.0", "jitter_ps = 100.0");
    assert!(scene.contains("shots = 1000\n") && scene.contains("bad_shots = 0.02"));
    let rms_ps = |bad: &str| study(&scene.replace("bad_shots = 0.02", bad), 0..1).onset_rms_ps;
    let (clean, bad) = (rms_ps("bad_shots = 0.0"), rms_ps("bad_shots = 0.03"));
    eprintln!("onset rms {clean:.4} ps clean, {bad:.4} ps with bad shots: ratio {:.3}", bad / clean);
    // Each rms is known to 6 %.
    assert!(bad < 1.3 * clean, "{bad} {clean}");
}

/// Noise of the mean over that of one shot and the root of their number, for noise in codes; `codes` samples at levels
/// spread over a code.
fn noise_law(noise: f64, shots: usize, samples: usize) -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(shots as u64);
    let level: Vec<f64> = (0..samples).map(|_| rng.random_range(-0.5..0.5)).collect();
    let mut sums = PhaseSums::new(samples);
    let mut bytes = Vec::with_capacity(2 * samples);
    for _ in 0..shots {
        bytes.clear();
        for level in &level {
            let normal: f64 = StandardNormal.sample(&mut rng);
            bytes.extend(((level + noise * normal).round() as i16).to_le_bytes());
        }
        sums.add(Codes::I16(&bytes), 0);
    }
    let mean = sums.finish().unwrap().mean;
    rms(mean.iter().zip(&level).map(|(mean, level)| mean - level)) / (noise / (shots as f64).sqrt())
}

/// The converter adds its rounding, 1/12 of a code squared, and where noise is small against a code, a bias that
/// averaging does not remove: of rms `exp(-2 pi^2 noise^2) / (pi sqrt 2)` codes (the first harmonic of the rounding's
/// sawtooth).
#[test]
fn noise_falls_with_the_root_of_the_shots_but_for_what_the_converter_adds() {
    for noise in [0.5, 0.6, 1.0] {
        for (shots, samples) in [(100, 4000), (10_000, 2000), (100_000, 1000)] {
            let bias = (-2.0 * PI * PI * noise * noise).exp() / (PI * 2_f64.sqrt());
            let expected = (1.0 + 1.0 / (12.0 * noise * noise) + shots as f64 * (bias / noise).powi(2)).sqrt();
            let ratio = noise_law(noise, shots, samples);
            eprintln!("noise {noise} codes, {shots} shots: {ratio:.3} of noise / sqrt shots, expected {expected:.3}");
            assert!((ratio / expected - 1.0).abs() < 0.08, "{noise} {shots}: {ratio} {expected}");
        }
    }
}

/// Shots with a jitter of 100 ps are aligned by reference pulses of SNR 30. A pulse of 250 ps keeps its width to less
/// than 1 %.
#[test]
fn alignment_leaves_no_blur() {
    let gaussian = |t_ps: f64| (-0.5 * (t_ps / 106.2).powi(2)).exp();
    let template =
        Response::new(-500.0, 6.25, &(0..161).map(|i| gaussian(f64::from(i) * 6.25 - 500.0)).collect::<Vec<_>>());
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
    let (dt_ps, mut sums) = (50.0, PhaseSums::new(100));
    for _ in 0..1000 {
        let late_ps = 100.0 * normal();
        let reference: Vec<f64> =
            (0..60).map(|n| gaussian(f64::from(n) * dt_ps - 1500.0 - late_ps) + normal() / 30.0).collect();
        let fit = fit_pulse(&reference, dt_ps, &template).unwrap();
        let codes: Vec<u8> = (0..100)
            .flat_map(|n| ((20_000.0 * gaussian(f64::from(n) * dt_ps - 2500.0 - late_ps)).round() as i16).to_le_bytes())
            .collect();
        sums.add(Codes::I16(&codes), ((1500.0 - fit.time_ps) / dt_ps * PHASES as f64).round() as i64);
    }
    let mean = sums.finish().unwrap().mean;
    let moment = |power: i32, centre: f64| {
        mean.iter().enumerate().map(|(n, v)| v * (n as f64 * dt_ps - centre).powi(power)).sum::<f64>()
    };
    let centre = moment(1, 0.0) / moment(0, 0.0);
    let width_ps = (moment(2, centre) / moment(0, 0.0)).sqrt();
    eprintln!("width {width_ps:.3} ps of 106.2");
    assert!((width_ps / 106.2 - 1.0).abs() < 0.01, "{width_ps}");
}
