//! The methods of `deconvolve` and `detect` beside one another, from files to onsets.

use periscope::pipeline::run::Settings;
use periscope::simulate::Format;
use periscope::tables::{Onset, Stir, TruePath};

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

/// For each true onset the nearest found one: error and stated standard deviation, ps.
fn errors(truth: &[Onset], found: &[Onset]) -> Vec<(f64, f64)> {
    let nearest = |truth: &Onset| {
        let of_profile = found.iter().filter(|onset| (onset.lit, onset.seen) == (truth.lit, truth.seen));
        let error = |onset: &Onset| onset.time_ps - truth.time_ps;
        let nearest = of_profile.min_by(|a, b| error(a).abs().total_cmp(&error(b).abs()))?;
        Some((error(nearest), nearest.time_sd_ps.hypot(nearest.jitter_ps)))
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

/// 36 profiles of one pulse each, signal-to-noise ratios of the mean from 50 to 600.
#[test]
fn every_method_finds_the_onsets_and_the_right_ones_as_well_as_sparse() {
    let lab = Lab::of(PHOTODIODE, 3, Format::Trc);
    let truth: Vec<Onset> = lab.truth();
    let sparse = onsets(&lab, "sparse", &[]);
    let best_ps = scatter_ps(&errors(&truth, &sparse));
    for (method, most) in [("nnls", 1.15), ("pencil", 1.15), ("richardson-lucy", 8.0)] {
        let found = onsets(&lab, method, &[&format!("stir.method={method}")]);
        let errors = errors(&truth, &found);
        let (scatter, stated) = (scatter_ps(&errors), rms(errors.iter().map(|(_, sd)| *sd)));
        let profiles: Vec<Stir> = lab.rows(method, "stir");
        let chi2 = profiles.iter().filter_map(|stir| stir.chi2_dof).sum::<f64>() / 36.0;
        eprintln!(
            "{method}: {} onsets, scatter {scatter:.2} ps of sparse's {best_ps:.2}, stated {stated:.2}, chi2/dof {chi2:.3}",
            found.len()
        );
        assert_eq!(errors.len(), truth.len(), "{method}");
        assert!(scatter < most * best_ps, "{method}: {scatter} ps");
        assert!(found.iter().all(|onset| onset.evidence.is_some_and(|evidence| evidence > 20.0)), "{method}");
        if method != "richardson-lucy" {
            assert!(found.len() <= truth.len() + 1, "{method}: {} onsets", found.len());
            assert!((0.7..1.4).contains(&(stated / scatter)), "{method}: {stated} stated, {scatter} found");
        }
    }
    for (method, most_ps) in
        [("leading-edge", 12.0), ("constant-fraction", 12.0), ("first-response", 60.0), ("aic", 60.0)]
    {
        let settings = ["stir.method=wiener".to_owned(), format!("onsets.method={method}")];
        let found = onsets(&lab, method, &[&settings[0], &settings[1]]);
        let errors = errors(&truth, &found);
        let scatter = scatter_ps(&errors);
        eprintln!("{method}: {} onsets, scatter {scatter:.2} ps", found.len());
        assert_eq!(errors.len(), truth.len(), "{method}");
        assert!(scatter < most_ps, "{method}: {scatter} ps");
        // Ranks count within a profile; the methods' onsets do not know of one another.
        for onset in &found {
            let of_profile = found.iter().filter(|other| (other.lit, other.seen) == (onset.lit, onset.seen)).count();
            assert!(onset.covariance.len() == of_profile && onset.rank as usize <= of_profile, "{method}");
        }
    }
}

/// Patches of 25 mm spread their light by tens of picoseconds: one impulse of that width each, timed at its centroid, instead of two.
#[test]
fn light_of_extended_patches_is_one_onset_of_the_right_width() {
    let lab = Lab::of(&PHOTODIODE.replace("size_m = 0.005", "size_m = 0.025"), 4, Format::Trc);
    let truth: Vec<Onset> = lab.truth();
    let paths: Vec<TruePath> = lab.truth();
    let points = onsets(&lab, "points", &[]);
    let found = onsets(&lab, "extended", &["stir.extent_max_ps=120"]);
    let errors = errors(&truth, &found);
    // About the mean: the latency's error is common to all.
    let weight: f64 = errors.iter().map(|(_, sd)| sd.powi(-2)).sum();
    let mean = errors.iter().map(|(error, sd)| error / (sd * sd)).sum::<f64>() / weight;
    let normalised = errors.iter().map(|(error, sd)| ((error - mean) / sd).powi(2)).sum::<f64>() / 35.0;
    let widened: Vec<&Onset> =
        found.iter().filter(|onset| onset.flags.iter().any(|flag| **flag == *"extended")).collect();
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
        found.len(),
        widened.len(),
        rms(widths.iter().copied())
    );
    assert!(widened.len() >= 34 && rms(widths.iter().copied()) < 3.0, "{widths:?}");
    assert!(points.len() > 36 && found.len() == 36, "{} and {}", points.len(), found.len());
}
