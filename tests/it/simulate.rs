//! Campaigns that the simulator leaves: what stands in the files is what the truth says.

use std::fs;
use std::path::Path;

use periscope::campaign::{Campaign, Role};
use periscope::formats;
use periscope::pipeline::run::Settings;
use periscope::signal::codes::Codes;
use periscope::simulate::{Format, Laboratory, Scene};
use periscope::tables::{Patch, Trace, TrueCapture, TruePath};

use crate::lab::{ALL_VISIBLE, Lab};

const PHOTODIODE: &str = include_str!("../../pipelines/scenes/photodiode.toml");
const TINY: &str = include_str!("../../pipelines/scenes/tiny.toml");

/// Volts of every shot of a file.
fn volts(lab: &Lab, file: &str) -> Vec<Vec<f64>> {
    let mut source = formats::Source::open(&lab.campaign().join(file)).unwrap();
    let records = formats::records(&mut source).unwrap();
    records.iter().map(|record| source.values(record).unwrap()).collect()
}

fn mean_and_sd(shots: &[Vec<f64>], at: usize) -> (f64, f64) {
    let count = shots.len() as f64;
    let mean = shots.iter().map(|shot| shot[at]).sum::<f64>() / count;
    let squares = shots.iter().map(|shot| (shot[at] - mean).powi(2)).sum::<f64>();
    (mean, (squares / (count - 1.0)).sqrt())
}

/// Heights, noise and shot noise in the files are those of the truth: no trigger jitter, one sampling phase, an endless
/// gain of light.
#[test]
fn heights_and_noise_are_those_that_the_truth_derives() {
    let text = PHOTODIODE
        .replace("jitter_ps = 80.0", "jitter_ps = 0.0")
        .replace("shots = 400", "shots = 3000")
        .replace("full_scale_v = 0.04\nnoise_v = 0.0003", "full_scale_v = 40.0\nnoise_v = 0.004")
        .replace("first_bounce_od = 4.8", "first_bounce_od = 2.0")
        .replace("bits = 8", "bits = 16")
        .replace("load_ohm = 5000.0", "load_ohm = 50000.0");
    let lab = Lab::of(&text, 3, Format::Trc);
    let captures: Vec<TrueCapture> = lab.truth();
    let first = captures.iter().find(|capture| &*capture.role == "scene" && capture.lit == capture.seen).unwrap();
    let shots = volts(&lab, &format!("{}_C1.trc", first.file));
    let count = shots[0].len();
    let (_, dark_sd) = mean_and_sd(&shots, 5);
    let recorded = 0.004_f64.hypot(40.0 / 65536.0 / 12_f64.sqrt());
    assert!((dark_sd / recorded - 1.0).abs() < 0.1, "{dark_sd} {recorded}");
    // The sample phase moves the maximum about; where the mean is highest the sample stands within half a step of it.
    let (height, at) = (0..count).map(|n| (mean_and_sd(&shots, n).0, n)).max_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
    let truth = first.height_v.unwrap();
    assert!((height / truth - 1.0).abs() < 0.1, "{height} {truth}");
    // Electrons: at a fixed ratio of height to area, relative fluctuation by counting. The spread by sampling phase is
    // larger on the edges, so it is taken from the sum over the pulse, which phases do not change.
    let sums: Vec<Vec<f64>> = shots.iter().map(|shot| vec![shot[at - 10..at + 60].iter().sum::<f64>()]).collect();
    let (sum, sum_sd) = mean_and_sd(&sums, 0);
    let electrons = {
        let paths: Vec<TruePath> = lab.truth();
        let path =
            paths.iter().find(|path| path.lit == first.lit && path.seen == first.lit && path.bounces == 1).unwrap();
        path.energy_j.unwrap() * 0.45 / 1.602_176_634e-19
    };
    let expected = sum / electrons.sqrt();
    assert!((sum_sd / expected - 1.0).abs() < 0.1, "{sum_sd} {expected}: {electrons} electrons");
}

#[test]
fn csv_campaigns_hold_the_same_light() {
    let text = TINY.replace("response_shots = 400", "response_shots = 64").replace("shots = 24", "shots = 16");
    let lab = Lab::of(&text.replace("bad_shots = 0.02", "bad_shots = 0.0"), 2, Format::Csv);
    lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    let (patches, truth): (Vec<Patch>, Vec<Patch>) = (lab.rows("out", "patches"), lab.truth());
    assert_eq!(patches.len(), truth.len());
    let apart = |rows: &[Patch], a: usize, b: usize| {
        let at = |k: usize| [rows[k].x_m, rows[k].y_m, rows[k].z_m];
        at(a).iter().zip(at(b)).map(|(p, q)| (p - q).powi(2)).sum::<f64>().sqrt()
    };
    assert!((apart(&patches, 0, 2) - apart(&truth, 0, 2)).abs() < 2e-3);
}

/// The same shots in each binary format: the same light to the rounding of volts and times.
#[test]
fn every_binary_format_holds_the_same_shots() {
    let text = TINY.replace("response_shots = 400", "response_shots = 8");
    let labs = [(Format::Trc, "trc"), (Format::Wfm, "wfm"), (Format::Bin, "bin")].map(|(format, extension)| {
        let lab = Lab::of(&text, 3, format);
        let traces = "[traces]\nstage = 'ingest'\nparams = { roles = ['scene', 'response'], codes = 'none' }\n";
        assert_eq!(lab.run("out", traces, &Settings::default()).unwrap().rejects, 0, "{extension}");
        let rows: Vec<Trace> = lab.rows("out", "traces");
        assert!(rows.iter().all(|row| row.file.ends_with(extension)));
        (extension, rows)
    });
    let [(_, trc), rest @ ..] = &labs;
    for (extension, rows) in rest {
        assert_eq!(rows.len(), trc.len(), "{extension}");
        for (row, trc) in rows.iter().zip(trc) {
            let volts = |row: &Trace| {
                let codes = Codes::of(&row.code_type, row.codes.as_ref().unwrap()).unwrap().to_f64();
                codes.into_iter().map(|code| row.gain_v * code + row.offset_v).collect::<Vec<_>>()
            };
            assert_eq!((row.shot, row.segment, row.is_reference), (trc.shot, trc.segment, trc.is_reference));
            assert!((row.t0_ps - trc.t0_ps).abs() < 1e-6, "{extension}: {} and {} ps", row.t0_ps, trc.t0_ps);
            let missed = volts(row).iter().zip(volts(trc)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(missed < 1e-6, "{extension}: {missed} V");
        }
    }
}

/// Records across the laser's period: the signal repeats, and campaign.toml says so.
#[test]
fn light_folds_at_the_lasers_period() {
    let text = PHOTODIODE.replace("repetition_hz = 10e6", "repetition_hz = 200e6");
    let scene = Scene::parse(Path::new("scene.toml"), &text).unwrap();
    let laboratory = Laboratory::new(&scene, 1).unwrap();
    let shooting = laboratory.shootings.iter().find(|shooting| shooting.role == Role::Scene).unwrap();
    let volts = laboratory.mean_v(shooting, -1000.0);
    let period = 100; // 5 ns in steps of 50 ps
    let height = volts.iter().copied().fold(0.0, f64::max);
    for n in 0..volts.len() - period {
        assert!((volts[n] - volts[n + period]).abs() < 1e-6 * height, "sample {n}");
    }
    let lab = Lab::of(
        &text.replace("shots = 400", "shots = 2").replace("response_shots = 2000", "response_shots = 2"),
        1,
        Format::Npy,
    );
    assert_eq!(Campaign::load(&lab.campaign()).unwrap().repetition_ps, Some(5000.0));
}

#[test]
fn photon_counters_leave_histograms() {
    let text = PHOTODIODE
        .replace("[sensors.s1]", "[sensors.s1]\nkind = \"counts\"")
        .replace(
            "responsivity_a_w = 0.45",
            "responsivity_a_w = 0.45\ncounts = { efficiency = 0.3, dark_hz = 1e6, dead_time_ps = 0.0 }",
        )
        .replace("shots = 400", "shots = 1000000")
        .replace("response_shots = 2000", "response_shots = 1000")
        .replace("first_bounce_od = 4.8", "first_bounce_od = 9.0")
        .replace("ambient_w = 1e-9", "ambient_w = 0.0");
    let lab = Lab::of(&text, 4, Format::Trc);
    let campaign = Campaign::load(&lab.campaign()).unwrap();
    assert_eq!(campaign.sensors["s1"].cycles, Some(1_000_000));
    let histogram = &volts_of_counts(&lab, "raw/counts/od9/s1_L1_P1_C1.npy");
    let paths: Vec<TruePath> = lab.truth();
    let energy_j = paths.iter().find(|path| path.path == [1]).unwrap().energy_j.unwrap();
    let photons = energy_j / (1.986_445_857e-25 / 810e-9);
    let expected = 1e6 * photons * 0.3 + 1e6 * 1e6 * 320.0 * 50e-12;
    let total: f64 = histogram.iter().sum();
    assert!((total - expected).abs() < 5.0 * expected.sqrt() + 2e-3 * expected, "{total} {expected}");
}

/// An array without scale: codes are counts.
fn volts_of_counts(lab: &Lab, file: &str) -> Vec<f64> {
    volts(lab, file).remove(0)
}

/// Every range in turn, each with its own latency; drift through the day; lost shots.
#[test]
fn ranges_drift_and_losses_are_in_the_files_and_in_the_truth() {
    let text = PHOTODIODE.replace("[captures]\n", "[instrument.ranges.fine]\nfull_scale_v = 0.04\nnoise_v = 0.0003\nlatency_ps = 12.0\n\
        [instrument.ranges.coarse]\nfull_scale_v = 0.4\nnoise_v = 0.003\n[instrument.flaws]\ndelay_ps_per_h = 2.0\n[captures]\nranges = \"all\"\n\
        lost_shots = 0.1\noverhead_s = 60.0\n")
        .replace("shots = 400", "shots = 50")
        .replace("response_shots = 2000", "response_shots = 50");
    let lab = Lab::of(&text, 5, Format::Trc);
    let captures: Vec<TrueCapture> = lab.truth();
    assert_eq!(captures.iter().filter(|capture| &*capture.role == "scene").count(), 72);
    for capture in &captures {
        let fine = capture.range.as_deref() == Some("fine");
        let expected = 1250.0 + if fine { 12.0 } else { 0.0 } + 2.0 * capture.start_s / 3600.0;
        assert!((capture.latency_ps - expected).abs() < 1e-9, "{capture:?}");
    }
    assert!(captures.last().unwrap().start_s > 3600.0);
    let kept = volts(&lab, "raw/scene/fine/s1_L1_P2_C1.trc").len();
    assert!((30..50).contains(&kept) && volts(&lab, "raw/scene/fine/s1_L1_P2_C2.trc").len() == kept);
    let campaign = fs::read_to_string(lab.campaign().join("campaign.toml")).unwrap();
    assert!(campaign.contains("range = \"fine\"") && campaign.contains("attenuation_od"), "{campaign}");
}

#[test]
fn equal_seeds_give_equal_files_and_scenes_that_cannot_be_are_refused() {
    let text = TINY.replace("response_shots = 400", "response_shots = 8").replace("shots = 24", "shots = 2");
    let [a, b, c] = [1, 1, 2].map(|seed| Lab::of(&text, seed, Format::Trc));
    let bytes = |lab: &Lab| fs::read(lab.campaign().join("raw/scene/s1_L1_P2_C1.trc")).unwrap();
    assert!(bytes(&a) == bytes(&b) && bytes(&a) != bytes(&c));
    for (from, to, fix) in [
        ("snr = 20.0", "", "[laser] is missing"),
        (
            "[captures]",
            "[laser]\npulse_j = 1e-9\nwavelength_nm = 800.0\nrepetition_hz = 1e6\n[captures]",
            "take it out to have it derived",
        ),
        ("[captures]", "[captures]\nbounces = 6", "1 to 5"),
        ("[captures]", "[captures]\nlit = [9]", "neither patch nor view"),
        (
            "[captures]",
            "[surfaces.s]\ncorner_m = [0.0, 0.0, 1.0]\nedges_m = [[1.0, 0.0, 0.0], [1.0, 1.0, 0.0]]\n[captures]",
            "right angles",
        ),
        ("snr = 50.0 }", "}", "either `snr` or `height_v`"),
        ("shots = 24", "shots = 24\nfirst_bounce_od = 1.0", "all signals have one height"),
    ] {
        let error =
            Scene::parse(Path::new("s.toml"), &text.replace("shots = 2\n", "shots = 24\n").replacen(from, to, 1))
                .unwrap_err();
        assert!(error.to_string().contains(fix), "{error}");
    }
}
