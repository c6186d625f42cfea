//! Whole pipelines on real recordings, where present: what alignment by the sub-sample trigger time is worth, and
//! reflections on a line. docs/real-files.md holds what they print: `cargo test --release --test it real_files --
//! --nocapture`.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use periscope::campaign::Campaign;
use periscope::formats::{self, Source};
use periscope::pipeline::plan::Plan;
use periscope::pipeline::progress::{Progress, Style};
use periscope::pipeline::run::{self, Settings};
use periscope::pipeline::spec::Spec;
use periscope::store::Shelf;
use periscope::tables::{Onset, Profile, Row};

use crate::scope_samples::samples;

fn mean_and_sd(values: &[f64]) -> (f64, f64) {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    (mean, (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (values.len() - 1) as f64).sqrt())
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let half = values.len() / 2;
    if values.len() % 2 == 1 { values[half] } else { f64::midpoint(values[half - 1], values[half]) }
}

/// A campaign of this repository with raw files from elsewhere, run: rows of a view.
fn rows<R: Row>(name: &str, raw: &Path, pipeline: &str, edit: impl Fn(String) -> String, view: &str) -> Vec<R> {
    let folder = tempfile::tempdir().unwrap();
    let campaign = folder.path().join("campaign");
    fs::create_dir_all(campaign.join("raw")).unwrap();
    for entry in
        fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines/campaigns").join(name)).unwrap().flatten()
    {
        fs::write(campaign.join(entry.file_name()), edit(fs::read_to_string(entry.path()).unwrap())).unwrap();
    }
    for entry in fs::read_dir(raw).unwrap().flatten() {
        fs::copy(entry.path(), campaign.join("raw").join(entry.file_name())).unwrap();
    }
    let spec = Spec::parse(name, pipeline, &[]).unwrap();
    let campaigns = [Campaign::load(&campaign).unwrap()];
    let shelf = Shelf::open(&folder.path().join("out")).unwrap();
    let mut plan = Plan::new(&spec, &campaigns, &shelf, None).unwrap();
    let outcome = run::run(&mut plan, &Settings::default(), &Progress::new(Style::Silent)).unwrap();
    assert_eq!(outcome.rejects, 0, "{:?}", shelf.batches("rejects"));
    shelf.batches(view).unwrap().iter().flat_map(|batch| R::rows(batch).unwrap()).collect()
}

/// Time at which samples first reach `level` upwards, by linear interpolation.
fn crossing(samples: &[f64], level: f64) -> f64 {
    let above = samples.iter().position(|sample| *sample >= level).expect("a pulse reaches it");
    above as f64 - (samples[above] - level) / (samples[above] - samples[above - 1])
}

/// 20 segments of one pulser: the crossing of 1 V scatters by the sampling unless each segment's own trigger time is
/// used.
#[test]
fn the_trigger_time_of_each_segment_takes_the_sampling_out_of_a_sequence() {
    let Some(folder) = samples() else { return };
    let mut source = Source::open(&folder.join("lecroy/wr64xi_pulse_sequence_20seg.trc")).unwrap();
    let records = formats::records(&mut source).unwrap();
    let (mut with, mut without) = (Vec::new(), Vec::new());
    for record in &records {
        let dt_ps = record.head.dt_s.unwrap() * 1e12;
        let at_ps = crossing(&source.values(record).unwrap(), 1.0) * dt_ps;
        without.push(at_ps);
        with.push(at_ps + record.t0_s.unwrap() * 1e12);
    }
    // Of these 20 segments themselves, not of pulses in general: divided by 20.
    let spread = |times: &[f64]| mean_and_sd(times).1 * (19.0_f64 / 20.0).sqrt();
    let (with, without) = (spread(&with), spread(&without));
    eprintln!("| 20 segments, crossing of 1 V | sd with trigger times {with:.0} ps | without {without:.0} ps |");
    assert!((with - 72.0).abs() < 1.0 && (without - 217.0).abs() < 1.0, "{with} {without}");
}

/// 60 triggers of a scintillation counter: their trigger times spread over one sample of 50 ps, which a rise of 4 ns
/// does not feel.
#[test]
fn triggers_of_a_slow_pulse_average_alike_with_and_without_their_trigger_times() {
    let Some(folder) = samples() else { return };
    let raw = folder.join("campaign-lead-counter-lecroy-ascii");
    let pipeline = "[traces]\nstage = 'ingest'\n[profiles]\nstage = 'average'\nfrom = 'traces'\nparams = { baseline_ps = 15000.0, reject_outliers = false }\n";
    let mut rise = BTreeMap::new();
    for (name, edit) in [("aligned", ""), ("plain", "t0_ps = -20000.0\n")] {
        let profile: Profile = rows("lead-counter", &raw, pipeline, |text| text + edit, "profiles").remove(0);
        assert_eq!(profile.shots, 60);
        let pulse: Vec<f64> = profile.mean_v().to_f64().iter().map(|value| -value).collect();
        let top = pulse.iter().copied().fold(0.0, f64::max);
        let (low, high) = (crossing(&pulse, 0.1 * top), crossing(&pulse, 0.9 * top));
        let error_v = profile.se_v().to_f64()[low as usize..=high as usize + 1].iter().copied().fold(0.0, f64::max);
        eprintln!(
            "| 60 triggers, {name} | height {top:.3} V | rise 10 to 90 % {:.1} ps | largest standard error on the edge {:.2} mV, before the pulse {:.3} mV |",
            (high - low) * profile.dt_ps,
            1e3 * error_v,
            1e3 * profile.noise_v / 60_f64.sqrt()
        );
        rise.insert(name, (high - low) * profile.dt_ps);
    }
    // A spread of 50 ps / sqrt(12) widens the rise by well below a picosecond; what differs is which samples the edges
    // fall between.
    assert!((rise["aligned"] - rise["plain"]).abs() < 5.0, "{rise:?}");
}

/// Reflections of 13 devices, 10 sweeps each, against the step of the matched load.
#[test]
fn reflections_on_a_line_repeat_as_their_standard_deviations_say() {
    let Some(folder) = samples() else { return };
    let pipeline = include_str!("../../pipelines/tdr.toml");
    let onsets: Vec<Onset> = rows("tdr", &folder.join("campaign-tdr"), pipeline, |text| text, "onsets");
    let labels = include_str!("../../pipelines/campaigns/tdr/campaign.toml");
    let labels: Vec<&str> =
        labels.lines().filter_map(|line| line.strip_prefix("label = ")).map(|label| label.trim_matches('"')).collect();
    let profiles = onsets.chunk_by(|a, b| (a.lit, a.seen) == (b.lit, b.seen));
    let mut devices: BTreeMap<i32, Vec<(f64, f64)>> = BTreeMap::new();
    let mut incident: BTreeMap<i32, Vec<f64>> = BTreeMap::new();
    for profile in profiles {
        incident.entry(profile[0].lit).or_default().push(profile[0].time_ps);
        // The strongest reflection, where it stands well above the mismatch of connectors.
        let strongest = profile[1..]
            .iter()
            .filter(|onset| onset.amplitude.abs() > 0.03)
            .max_by(|a, b| a.amplitude.abs().total_cmp(&b.amplitude.abs()));
        let Some(reflection) = strongest else {
            continue;
        };
        let covariance = profile[0].covariance[reflection.rank as usize - 1];
        let variance = profile[0].time_sd_ps.powi(2) + reflection.time_sd_ps.powi(2) - 2.0 * covariance;
        devices.entry(profile[0].lit).or_default().push((reflection.time_ps - profile[0].time_ps, variance));
    }
    devices.retain(|_, sweeps| sweeps.len() == 10);
    assert!(devices.len() >= 7, "{devices:?}");
    // The part of the spread that the reported deviations leave: for each device, the median over the others.
    let spread = |sweeps: &[(f64, f64)]| mean_and_sd(&sweeps.iter().map(|(time_ps, _)| *time_ps).collect::<Vec<_>>());
    let reported =
        |sweeps: &[(f64, f64)]| sweeps.iter().map(|(_, variance)| variance).sum::<f64>() / sweeps.len() as f64;
    let excess: BTreeMap<i32, f64> =
        devices.iter().map(|(device, sweeps)| (*device, spread(sweeps).1.powi(2) - reported(sweeps))).collect();
    eprintln!(
        "| device | incident edge, sd (ps) | reflection after it (ps) | electrical length (mm) | sd over 10 sweeps (ps) | reported sd (ps) | jitter from the others (ps) | reduced chi-square |"
    );
    eprintln!("|---|---|---|---|---|---|---|---|");
    let mut total = 0.0;
    for (device, sweeps) in &devices {
        let (mean, sd) = spread(sweeps);
        let others: Vec<f64> = excess.iter().filter(|(other, _)| *other != device).map(|(_, excess)| *excess).collect();
        let jitter2 = median(others).max(0.0);
        let chi2 = sd * sd / (reported(sweeps) + jitter2);
        total += chi2;
        eprintln!(
            "| {} | {:.2} | {mean:.2} | {:.3} | {sd:.2} | {:.2} | {:.2} | {chi2:.2} |",
            labels[*device as usize - 1],
            mean_and_sd(&incident[device]).1,
            0.5 * mean * 0.299_792_458,
            reported(sweeps).sqrt(),
            jitter2.sqrt()
        );
    }
    for (device, times) in incident.iter().filter(|(device, _)| !devices.contains_key(device)) {
        let label = labels[*device as usize - 1];
        eprintln!("| {label} | {:.2} | none above 15 % of the incident step | | | | | |", mean_and_sd(times).1);
    }
    eprintln!(
        "mean reduced chi-square {:.2} of {} devices, 9 degrees of freedom each",
        total / devices.len() as f64,
        devices.len()
    );
    // An open and the open end of a through differ by less than a reflection of another kind: the standards' own order.
    let after = |label: &str| spread(&devices[&(labels.iter().position(|name| *name == label).unwrap() as i32 + 1)]).0;
    assert!(after("m_m_sma_open") > after("m_m_sma_short") && after("m_m_sma_open") < after("bnc_tee_open"));
    assert!(devices.values().all(|sweeps| spread(sweeps).1 < 10.0), "every device repeats to 10 ps, less than a point");
}
