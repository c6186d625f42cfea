//! Profiles of simulated captures, compared with the truth.

use std::f64::consts::PI;
use std::fs;

use periscope::campaign::Campaign;
use periscope::pipeline::run::Settings;
use periscope::signal::average::{PHASES, PhaseSums};
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
pub fn impulses() -> &'static str {
    ALL_VISIBLE.split_once("[onsets]").unwrap().0
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    values.sum::<f64>() / count
}

pub fn rms(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    mean(values.map(|value| value * value)).sqrt()
}

/// A capture of 50 shots at a signal-to-noise ratio of 80 shows the trigger's jitter of 4 ps. At 10 it does not, and so
/// none is claimed.
#[test]
fn jitter_that_no_reference_shows_is_seen_in_the_noise() {
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
        assert!((profile.dt_ps * profile.samples() as f64 - period_ps).abs() < 1e-6, "{}", profile.dt_ps);
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
        assert!(profile.mean_v.is_none() && profile.se_v.is_none(), "what counts say stands in their columns alone");
        let signal: f64 = profile.mean_v().to_f64().iter().sum();
        assert!((signal + profile.baseline_v * counts.len() as f64 - total).abs() < 1e-3 * total);
        assert!(profile.cycles == Some(400_000) && profile.phase_shots.is_none() && profile.jitter_ps == 0.0);
        let se = |n: usize| f64::from(counts[n]).max(profile.baseline_v).max(1.0).sqrt();
        assert!(profile.se_v().iter().enumerate().all(|(n, se_v)| (f64::from(*se_v) / se(n) - 1.0).abs() < 1e-6));
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
