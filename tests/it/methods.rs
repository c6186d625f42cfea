//! The methods of `deconvolve` and `detect`, and those of `periscope-comparison`, next to one another, from files to
//! onsets.

use periscope::pipeline::run::Settings;
use periscope::signal::averaged_response::averaged_response;
use periscope::signal::response::Response;
use periscope::signal::sparse;
use periscope::simulate::Format;
use periscope::tables::{Calibration, Onset, Profile, Stir, TruePath};
use periscope_comparison::baseline;
use periscope_comparison::nnls::{self, NnlsOptions};
use periscope_comparison::pencil::{self, PencilOptions};
use periscope_comparison::pulses::Pulses;
use periscope_comparison::richardson_lucy::{self, RichardsonLucyOptions};

use crate::accuracy::PHOTODIODE;
use crate::lab::{ALL_VISIBLE, Lab};

/// The pipeline up to onsets.
fn up_to_onsets() -> &'static str {
    ALL_VISIBLE.split("[labels]").next().unwrap()
}

fn onsets(lab: &Lab, out: &str, settings: &[&str]) -> Vec<Onset> {
    let settings: Vec<String> = settings.iter().map(|setting| (*setting).to_owned()).collect();
    lab.run_with(out, up_to_onsets(), &settings, &Settings::default()).unwrap();
    lab.rows(out, "onsets")
}

/// For each true onset the nearest detected one: error and stated standard deviation, ps.
fn errors(truth: &[Onset], detected: &[Onset]) -> Vec<(f64, f64)> {
    let timed = |onset: &Onset| Timed {
        capture: (onset.lit, onset.seen),
        time_ps: onset.time_ps,
        sd_ps: onset.time_sd_ps.hypot(onset.jitter_ps),
        evidence: onset.evidence.unwrap_or(0.0),
    };
    errors_of(truth, &detected.iter().map(timed).collect::<Vec<_>>())
}

fn errors_of(truth: &[Onset], detected: &[Timed]) -> Vec<(f64, f64)> {
    let nearest = |truth: &Onset| {
        let of_profile = detected.iter().filter(|pulse| pulse.capture == (truth.lit, truth.seen));
        let error = |pulse: &Timed| pulse.time_ps - truth.time_ps;
        let nearest = of_profile.min_by(|a, b| error(a).abs().total_cmp(&error(b).abs()))?;
        Some((error(nearest), nearest.sd_ps))
    };
    truth.iter().filter_map(nearest).collect()
}

fn rms(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let count = values.clone().count() as f64;
    (values.map(|value| value * value).sum::<f64>() / count).sqrt()
}

/// Errors about their mean, which holds the latency's error and, of edges, how far they lie before the pulse's time.
fn scatter_ps(errors: &[(f64, f64)]) -> f64 {
    let mean = errors.iter().map(|(error, _)| error).sum::<f64>() / errors.len() as f64;
    rms(errors.iter().map(|(error, _)| error - mean))
}

/// An onset, or a pulse of a method of comparison.
struct Timed {
    capture: (i32, i32),
    time_ps: f64,
    sd_ps: f64,
    evidence: f64,
}

/// Pulses that a method has of a record without baseline in white noise, for a threshold of chi-square.
type Method = fn(&sparse::Profile, &Response, f64) -> Pulses;

const COMPARED: [(&str, Method); 3] = [
    ("nnls", |record, response, evidence_min| {
        let options = NnlsOptions { merge_steps: 1.5, ..NnlsOptions::default() };
        nnls::fit(record, response, &options).pruned(record, response, evidence_min)
    }),
    ("pencil", |record, response, evidence_min| {
        pencil::fit(record, response, &PencilOptions::default()).pruned(record, response, evidence_min)
    }),
    ("richardson-lucy", |record, response, _| {
        let positive = richardson_lucy::positive(response, record.dt_ps);
        let pulses = richardson_lucy::fit(record, &positive, &RichardsonLucyOptions::default());
        pulses.with_covariance(record, response)
    }),
];

/// The pulses of all profiles by a method of comparison. `raw` are the profiles in times of flight, as `deconvolve`
/// with method `none` leaves them, `profiles` what they were made of.
fn compared(method: Method, raw: &[Stir], profiles: &[Profile], calibration: &Calibration) -> Vec<Timed> {
    let upwards: Vec<f64> = calibration.response.iter().map(|value| f64::from(*value)).collect();
    let whole = Response::new(calibration.response_t0_ps, calibration.step_ps, &upwards);
    let mut all = Vec::new();
    for (stir, profile) in raw.iter().zip(profiles) {
        assert_eq!((stir.lit, stir.seen), (profile.lit, profile.seen));
        let phase_shots = profile.phase_shots.as_ref().unwrap();
        let response = averaged_response(&whole, profile.dt_ps, phase_shots, 1e-4);
        let samples: Vec<f64> = stir.profile.iter().map(|sample| f64::from(*sample)).collect();
        let sd_v: Vec<f64> = profile.se_v().to_f64();
        let record = sparse::Profile {
            mean_v: &samples,
            sd_v: &sd_v,
            acf: &[1.0],
            slow_v2: &[],
            jitter: None,
            t0_ps: stir.t0_ps,
            dt_ps: stir.dt_ps,
        };
        let samples = baseline::remove(&record, &response);
        let record = sparse::Profile { mean_v: &samples, ..record };
        let pulses = method(&record, &response, sparse::evidence_min_of(&record, &response, 1e-4));
        for (k, (_, evidence)) in pulses.judged(&record, &response).into_iter().enumerate() {
            let sd_ps = pulses.time_sd_ps(k).map_or(f64::INFINITY, |sd_ps| sd_ps.hypot(stir.jitter_ps));
            all.push(Timed { capture: (stir.lit, stir.seen), time_ps: pulses.times_ps[k], sd_ps, evidence });
        }
    }
    all
}

/// 36 profiles of one pulse each, signal-to-noise ratios of the mean from 50 to 600.
#[test]
fn methods_of_comparison_find_the_onsets_that_sparse_finds() {
    let lab = Lab::of(PHOTODIODE, 3, Format::Trc);
    let truth: Vec<Onset> = lab.truth();
    let best_ps = scatter_ps(&errors(&truth, &onsets(&lab, "sparse", &[])));
    onsets(&lab, "raw", &["stir.method=none"]);
    let (raw, profiles, calibration) =
        (lab.rows("raw", "stir"), lab.rows("raw", "profiles"), lab.rows("raw", "calibration"));
    for ((name, method), most) in COMPARED.into_iter().zip([1.15, 1.15, 8.0]) {
        let pulses = compared(method, &raw, &profiles, &calibration[0]);
        let errors = errors_of(&truth, &pulses);
        let (scatter, stated) = (scatter_ps(&errors), rms(errors.iter().map(|(_, sd)| *sd)));
        eprintln!(
            "{name}: {} pulses, scatter {scatter:.2} ps of sparse's {best_ps:.2}, stated {stated:.2}",
            pulses.len()
        );
        assert_eq!(errors.len(), truth.len(), "{name}");
        assert!(scatter < most * best_ps, "{name}: {scatter} ps");
        if name != "richardson-lucy" {
            assert!(pulses.iter().all(|pulse| pulse.evidence > 20.0), "{name}");
            assert!(pulses.len() <= truth.len() + 1, "{name}: {} pulses", pulses.len());
            assert!((0.7..1.4).contains(&(stated / scatter)), "{name}: {stated} stated, {scatter} measured");
        }
    }
}

/// The same profiles, by the methods of `detect` that need no impulses.
#[test]
fn every_method_of_detect_finds_the_onsets() {
    let lab = Lab::of(PHOTODIODE, 3, Format::Trc);
    let truth: Vec<Onset> = lab.truth();
    for (method, most_ps) in
        [("leading-edge", 12.0), ("constant-fraction", 12.0), ("first-response", 60.0), ("aic", 60.0)]
    {
        let settings = ["stir.method=wiener".to_owned(), format!("onsets.method={method}")];
        let rows = onsets(&lab, method, &[&settings[0], &settings[1]]);
        let errors = errors(&truth, &rows);
        let scatter = scatter_ps(&errors);
        eprintln!("{method}: {} onsets, scatter {scatter:.2} ps", rows.len());
        assert_eq!(errors.len(), truth.len(), "{method}");
        assert!(scatter < most_ps, "{method}: {scatter} ps");
        // Ranks count within a profile; the methods' onsets do not know of one another.
        for onset in &rows {
            let of_profile = rows.iter().filter(|other| (other.lit, other.seen) == (onset.lit, onset.seen)).count();
            assert!(onset.covariance.len() == of_profile && onset.rank as usize <= of_profile, "{method}");
        }
    }
}

/// Patches of 25 mm spread their light by tens of picoseconds: one impulse of that width each, timed at its centroid,
/// instead of two.
#[test]
fn light_of_extended_patches_is_one_onset_of_the_right_width() {
    let lab = Lab::of(&PHOTODIODE.replace("size_m = 0.005", "size_m = 0.025"), 4, Format::Trc);
    let truth: Vec<Onset> = lab.truth();
    let paths: Vec<TruePath> = lab.truth();
    let points = onsets(&lab, "points", &[]);
    let rows = onsets(&lab, "extended", &["stir.extent_max_ps=120"]);
    let errors = errors(&truth, &rows);
    // About the mean: the latency's error is common to all.
    let weight: f64 = errors.iter().map(|(_, sd)| sd.powi(-2)).sum();
    let mean = errors.iter().map(|(error, sd)| error / (sd * sd)).sum::<f64>() / weight;
    let normalised = errors.iter().map(|(error, sd)| ((error - mean) / sd).powi(2)).sum::<f64>() / 35.0;
    let widened: Vec<&Onset> =
        rows.iter().filter(|onset| onset.flags.iter().any(|flag| **flag == *"extended")).collect();
    let mut widths = Vec::new();
    for onset in &widened {
        let of_profile = paths.iter().filter(|path| (path.lit, path.seen) == (onset.lit, onset.seen));
        let path = of_profile.min_by(|a, b| a.time_ps.total_cmp(&b.time_ps)).unwrap();
        widths.push(onset.width_ps - path.width_ps);
        // One patch begins where light spread evenly would; two after one another up to 0.72 widths before.
        let late = (onset.earliest_ps.unwrap() - path.earliest_ps) / path.width_ps;
        assert!((-0.5..0.9).contains(&late), "{} {}: {late} widths late", onset.lit, onset.seen);
    }
    eprintln!(
        "{} onsets of points, {} of extended light, {} widened; squared errors over variances {normalised:.2}; widths off by {:.1} ps",
        points.len(),
        rows.len(),
        widened.len(),
        rms(widths.iter().copied())
    );
    assert!(widened.len() >= 34 && rms(widths.iter().copied()) < 3.0, "{widths:?}");
    assert!(points.len() > 36 && rows.len() == 36, "{} and {}", points.len(), rows.len());
}
