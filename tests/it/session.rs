//! What changes through a session: drift of the delay, pick-up, power; and pairs explained together.

use periscope::pipeline::run::Settings;
use periscope::simulate::Format;
use periscope::tables::{Calibration, Label, Onset, Session, Stir, TrueCapture};

use crate::accuracy::PHOTODIODE;
use crate::lab::{ALL_VISIBLE, Lab};

/// The pipeline up to onsets.
fn up_to_onsets() -> &'static str {
    ALL_VISIBLE.split("[labels]").next().unwrap()
}

/// The same without what `track` finds.
fn without_session() -> String {
    up_to_onsets().replace(", session = \"session\"", "")
}

/// Errors of the onsets, minus their mean if `about_mean` (the latency's error is common to all): rms, and rms over the
/// stated standard deviations.
fn errors(lab: &Lab, out: &str, about_mean: bool) -> (f64, f64, usize) {
    let truth: Vec<Onset> = lab.truth();
    let rows: Vec<Onset> = lab.rows(out, "onsets");
    let error = |onset: &Onset| {
        let of_profile = truth.iter().filter(|truth| (truth.lit, truth.seen) == (onset.lit, onset.seen));
        let truth = of_profile
            .min_by(|a, b| (a.time_ps - onset.time_ps).abs().total_cmp(&(b.time_ps - onset.time_ps).abs()))?;
        Some((onset.time_ps - truth.time_ps, onset.time_sd_ps.hypot(onset.jitter_ps)))
    };
    let errors: Vec<(f64, f64)> = rows.iter().filter_map(error).collect();
    let count = errors.len() as f64;
    let weight: f64 = errors.iter().map(|(_, sd)| sd.powi(-2)).sum();
    let mean = if about_mean { errors.iter().map(|(error, sd)| error / (sd * sd)).sum::<f64>() / weight } else { 0.0 };
    let rms = (errors.iter().map(|(error, _)| (error - mean).powi(2)).sum::<f64>() / count).sqrt();
    let pull = (errors.iter().map(|(error, sd)| ((error - mean) / sd).powi(2)).sum::<f64>() / count).sqrt();
    (rms, pull, rows.len())
}

/// A delay that drifts by 12 ps an hour through two hours of captures, with a fiducial every ten minutes.
#[test]
fn drift_is_taken_off_with_its_error() {
    let scene = PHOTODIODE
        .replace("path_sd_m = 0.0001", "path_sd_m = 0.0001\noverhead_s = 200.0\n[[captures.fiducials]]\npath_m = 1.2\nattenuation_od = 4.8\nshots = 200\nruns = 14\nevery_s = 600.0")
        .replace("[captures]", "[instrument.flaws]\ndelay_ps_per_h = 12.0\n[captures]");
    let lab = Lab::of(&scene, 5, Format::Trc);
    lab.run("followed", up_to_onsets(), &Settings::default()).unwrap();
    lab.run("not", &without_session(), &Settings::default()).unwrap();
    let session: Vec<Session> = lab.rows("followed", "session");
    let row = &session[0];
    let (drift_ps, sd_ps) = (row.drift_ps.as_ref().unwrap(), row.drift_sd_ps.as_ref().unwrap());
    eprintln!("{} fiducials from {:?}, drift {drift_ps:.2?} ps, sd {sd_ps:.2?}", row.fiducials, row.drift_from);
    let step_h = row.drift_step_s.unwrap() / 3600.0;
    // The response was captured within minutes of the first fiducial.
    for (knot, (drift_ps, sd_ps)) in drift_ps.iter().zip(sd_ps).enumerate() {
        let truth_ps = 12.0 * step_h * knot as f64;
        assert!(
            (drift_ps - truth_ps).abs() < 4.0 * sd_ps + 0.1,
            "knot {knot}: {drift_ps} of {truth_ps} ps, sd {sd_ps}"
        );
    }
    let (followed, not) = (errors(&lab, "followed", true), errors(&lab, "not", true));
    eprintln!("rms {:.2} ps, {:.2} of stated; without {:.2} ps, {:.2}", followed.0, followed.1, not.0, not.1);
    assert!(followed.0 < 0.6 * not.0, "{followed:?} {not:?}");
    assert!((0.75..1.3).contains(&followed.1), "{followed:?}");
}

/// A cable that was touched: the delay is not followed across the jump, and the jump is reported.
#[test]
fn a_jump_is_reported_and_not_smoothed() {
    let scene = PHOTODIODE
        .replace("path_sd_m = 0.0001", "path_sd_m = 0.0001\n[[captures.fiducials]]\npath_m = 1.2\nattenuation_od = 4.8\nshots = 100\nruns = 20\nevery_s = 600.0")
        .replace("[captures]", "[instrument.flaws]\ndelay_ps_per_h = 1.0\n[captures]");
    let lab = Lab::of(&scene, 6, Format::Trc);
    let profiles = "[t]\nstage = 'ingest'\nparams = { roles = ['response', 'fiducial'] }\n[c]\nstage = 'calibrate'\nfrom = 't'\n\
        [p]\nstage = 'average'\nfrom = 't'\nwith = { calibration = 'c' }\n";
    let track = "[session]\nstage = 'track'\nfrom = 'p'\nwith = { calibration = 'c' }\nparams = { jump_sigma = 0.5 }\n";
    lab.run("out", &format!("{profiles}{track}"), &Settings::default()).unwrap();
    let session: Vec<Session> = lab.rows("out", "session");
    assert!(session[0].drift_ps.is_none());
    let rejects: Vec<periscope::tables::Reject> = lab.rows("out", "rejects");
    assert!(rejects.iter().any(|row| row.reason.contains("jumps by")), "{rejects:?}");
}

/// Ringing in step with the laser, three times the noise of the mean: off with it.
#[test]
fn pick_up_is_taken_off() {
    let scene = PHOTODIODE.replace("path_sd_m = 0.0001", "path_sd_m = 0.0001\nblocked_shots = 4000").replace(
        "[captures]",
        "[instrument.flaws]\npickup = { volts = 0.0002, frequency_ghz = 0.35, decay_ps = 4000.0 }\n[captures]",
    );
    let lab = Lab::of(&scene, 7, Format::Trc);
    lab.run("off", up_to_onsets(), &Settings::default()).unwrap();
    lab.run("in", &without_session(), &Settings::default()).unwrap();
    let session: Vec<Session> = lab.rows("off", "session");
    assert!(session[0].pickup_v.is_some());
    let (off, with) = (errors(&lab, "off", true), errors(&lab, "in", true));
    eprintln!(
        "{} onsets, rms {:.2} ps, {:.2} of stated; with the pick-up {} onsets, {:.2} ps, {:.2}",
        off.2, off.0, off.1, with.2, with.0, with.1
    );
    assert!(off.2 == 36 && (0.75..1.3).contains(&off.1), "{off:?}");
    assert!(with.2 > 36 || with.1 > 1.5, "the pick-up does no harm: {with:?}");
    // Where there is none, none is reported.
    let quiet =
        Lab::of(&PHOTODIODE.replace("path_sd_m = 0.0001", "path_sd_m = 0.0001\nblocked_shots = 4000"), 7, Format::Trc);
    quiet.run("out", up_to_onsets(), &Settings::default()).unwrap();
    assert!(quiet.rows::<Session>("out", "session")[0].pickup_v.is_none());
}

/// The laser's energy is that of its reference pulse: about 1 for a laser that does not fluctuate.
#[test]
fn power_is_measured_by_the_reference_pulse() {
    let lab = Lab::tiny();
    lab.run("out", up_to_onsets(), &Settings::default()).unwrap();
    let stir: Vec<Stir> = lab.rows("out", "stir");
    assert!(
        stir.iter().all(|row| row.power_ratio.is_some_and(|ratio| (ratio - 1.0).abs() < 0.02)),
        "{:?}",
        stir.iter().map(|row| row.power_ratio).collect::<Vec<_>>()
    );
}

/// Reciprocal profiles together: one row of impulses a pair, better timed by the root of 2.
#[test]
fn pairs_are_explained_together() {
    let lab = Lab::of(PHOTODIODE, 8, Format::Trc);
    lab.run("alone", up_to_onsets(), &Settings::default()).unwrap();
    lab.run_with("joint", up_to_onsets(), &["stir.joint=true".to_owned()], &Settings::default()).unwrap();
    let (alone, joint) = (errors(&lab, "alone", true), errors(&lab, "joint", true));
    eprintln!("alone {alone:?}, joint {joint:?}");
    assert_eq!((alone.2, joint.2), (36, 21));
    assert!((0.7..1.35).contains(&joint.1), "{joint:?}");
    let sd = |out: &str| -> f64 {
        let onsets: Vec<Onset> = lab.rows(out, "onsets");
        let pairs: Vec<f64> = onsets.iter().filter(|o| o.lit < o.seen).map(|o| o.time_sd_ps).collect();
        pairs.iter().sum::<f64>() / pairs.len() as f64
    };
    let gain = sd("alone") / sd("joint");
    assert!((1.3..1.5).contains(&gain), "{gain}");
}

/// The photodiode's scene at two vertical ranges, each capture at that which suits it.
fn two_ranges() -> String {
    PHOTODIODE.replace(
        "full_scale_v = 0.04\nnoise_v = 0.0003",
        "full_scale_v = 0.04\nnoise_v = 0.0003\nranges.fine = { full_scale_v = 0.02, noise_v = 0.0002, latency_ps = 7.0 }\nranges.coarse = { full_scale_v = 0.2, noise_v = 0.001 }",
    )
}

/// Two vertical ranges have a response and a latency each.
#[test]
fn every_range_is_calibrated() {
    let lab = Lab::of(&two_ranges(), 9, Format::Trc);
    let pipeline = up_to_onsets().split("[session_traces]").next().unwrap();
    lab.run("out", pipeline, &Settings::default()).unwrap();
    let mut rows: Vec<Calibration> = lab.rows("out", "calibration");
    let truth: Vec<Calibration> = lab.truth();
    rows.sort_by(|a, b| a.range.cmp(&b.range));
    assert_eq!(rows.len(), 2);
    for row in &rows {
        let truth = truth.iter().find(|truth| truth.range == row.range).unwrap();
        let error_ps = row.latency_ps - truth.latency_ps;
        eprintln!(
            "{:?}: latency off by {error_ps:.2} ps, sd {:.2}; width {:.2} of {:.2} ps",
            row.range, row.latency_sd_ps, row.width_ps, truth.width_ps
        );
        // Of the error, the path's is common to both: the difference between ranges is known far better.
        assert!(error_ps.abs() < 4.0 * row.latency_sd_ps, "{error_ps} ps");
        assert!((row.width_ps / truth.width_ps - 1.0).abs() < 0.01);
    }
    let difference = rows[1].latency_ps - rows[0].latency_ps;
    assert!((difference - 7.0).abs() < 0.5, "{difference}");
}

/// Every onset and label says at which range its capture was taken, also where a pair was explained together.
#[test]
fn the_range_goes_with_the_onset_to_its_label() {
    // First bounces as high as 0.1 V, second ones of half a millivolt.
    let lab = Lab::of(&two_ranges().replace("first_bounce_od = 4.8", "first_bounce_od = 3.0"), 9, Format::Trc);
    let (pipeline, _) = ALL_VISIBLE.split_once("[distances]").unwrap();
    let captures: Vec<TrueCapture> = lab.truth();
    for joint in [false, true] {
        let out = format!("joint-{joint}");
        lab.run_with(&out, pipeline, &[format!("stir.joint={joint}")], &Settings::default()).unwrap();
        let labels: Vec<Label> = lab.rows(&out, "labels");
        assert!(labels.len() >= if joint { 21 } else { 36 }, "{} labels", labels.len());
        for label in &labels {
            let is_of = |capture: &&TrueCapture| (capture.lit, capture.seen) == (label.lit, label.seen);
            assert_eq!(label.range, captures.iter().find(is_of).unwrap().range, "{} {}", label.lit, label.seen);
        }
        let fine = labels.iter().filter(|label| label.range.as_deref() == Some("fine")).count();
        assert!(fine > 0 && fine < labels.len(), "{fine} of {}: the scene is not what it should be", labels.len());
    }
    // The truth has it too.
    for onset in lab.truth::<Onset>() {
        let is_of = |capture: &&TrueCapture| (capture.lit, capture.seen) == (onset.lit, onset.seen);
        assert_eq!(onset.range, captures.iter().find(is_of).unwrap().range, "{} {}", onset.lit, onset.seen);
    }
}

/// A photon counter from its histograms to onsets: calibrated, freed of pile-up, timed as its standard deviations say.
#[test]
fn photon_counts_are_timed() {
    let counts =
        "[instrument.counts]\nefficiency = 6e-5\ndark_hz = 2e5\ndead_time_ps = 40000.0\n[captures]\nshots = 20000000";
    let scene = PHOTODIODE
        .replace("latency_ps = 1250.0", "latency_ps = 1250.0\nkind = 'counts'")
        .replace("[captures]\nshots = 400", counts)
        .replace("response_shots = 2000", "response_shots = 20000000")
        .replace("dt_ps = 50.0\nsamples = 320", "dt_ps = 20.0\nsamples = 800")
        .replace("first_bounce_od = 4.8", "first_bounce_od = 5.0");
    let lab = Lab::of(&scene, 10, Format::Npy);
    lab.run("out", up_to_onsets(), &Settings::default()).unwrap();
    let rows: Vec<Onset> = lab.rows("out", "onsets");
    let (rms, pull, count) = errors(&lab, "out", true);
    eprintln!("{count} onsets of 36 profiles, rms {rms:.2} ps, {pull:.2} of stated");
    // The response's own photons, 60 times those of a profile, are not in the error bars of 0.15 ps.
    assert!((36..=40).contains(&count), "{count} onsets");
    assert!((0.7..1.7).contains(&pull), "{pull}");
    assert!(rows.iter().all(|onset| onset.evidence.is_some_and(|evidence| evidence > 15.0)));
}
