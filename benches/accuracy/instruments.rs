//! Tables of instruments that are not kind, for docs/error-bars.md: delays that drift, and claims record by record.

use std::ops::Range;
use std::path::Path;

use super::score::Rate;
use super::{claims, drift, lab};

/// Delays that drift through a day; of these cells all or those named, counted from 0.
pub fn print_drift(seeds: Range<u64>, only: &[usize]) {
    let text = |name: &str| {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines").join(name);
        std::fs::read_to_string(path).expect("a file of ours")
    };
    let scenes = [
        ("all-visible", lab::ALL_VISIBLE.to_owned(), 144),
        ("photodiode", lab::ALL_VISIBLE.to_owned(), 36),
        ("around-the-corner", text("scene.toml"), 64),
    ];
    let drifts = [(0.0, 0.0), (20.0, 0.0), (0.0, 20.0), (14.0, 14.0), (60.0, 0.0), (5.0, 0.0)];
    println!(
        "| scene | walk, line (ps a day) | times in files | campaigns solved | refused | drift said [95 %] | patches | rms error (mm) | rms error / stated: of all, median [least, most] | patches within 95 % | misfit, median |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    let cells = scenes.iter().flat_map(|scene| drifts.iter().map(move |drift| (scene, *drift)));
    let cells = cells.flat_map(|cell| [true, false].map(|has_times| (cell, has_times))).enumerate();
    for (_, ((scene, (walk_ps, line_ps)), has_times)) in cells.filter(|(n, _)| only.is_empty() || only.contains(n)) {
        let (name, pipeline, captures) = scene;
        let text = text(&format!("scenes/{name}.toml"));
        let text = drift::scene(&text, *captures, drift::Drift { walk_ps, line_ps });
        let outcomes: Vec<drift::Outcome> =
            seeds.clone().filter_map(|seed| drift::outcome(&text, pipeline, seed, has_times)).collect();
        let refused = (seeds.end - seeds.start) as usize - outcomes.len();
        if outcomes.is_empty() {
            println!(
                "| {name} | {walk_ps}, {line_ps} | {} | 0 | {refused} | - |",
                if has_times { "yes" } else { "no" }
            );
            continue;
        }
        let sum = |value: fn(&drift::Outcome) -> f64| outcomes.iter().map(value).sum::<f64>();
        let patches = outcomes.iter().map(|one| one.patches).sum::<usize>();
        let mut ratios: Vec<f64> = outcomes.iter().map(drift::Outcome::ratio).collect();
        ratios.sort_by(f64::total_cmp);
        println!(
            "| {name} | {walk_ps}, {line_ps} | {} | {} | {refused} | {} | {patches} | {:.3} | {:.2}, {:.2} [{:.2}, {:.2}] | {} | {:.2} |",
            if has_times { "yes" } else { "no" },
            outcomes.len(),
            Rate::of(outcomes.iter().map(|one| one.fit.drift_ps.is_some())),
            1e3 * (sum(|one| one.squares_m2) / patches as f64).sqrt(),
            (sum(|one| one.squares_m2) / sum(|one| one.stated_m2)).sqrt(),
            drift::median(ratios.clone()),
            ratios[0],
            ratios[ratios.len() - 1],
            Rate { hits: outcomes.iter().map(|one| one.inside).sum(), of: patches },
            drift::median(outcomes.iter().map(|one| one.fit.misfit).collect()),
        );
    }
}

/// Instruments that are not kind; of these cells all or those named, counted from 0.
pub fn print_claims(records: usize, first_seed: u64, only: &[usize]) {
    println!(
        "| instrument | SNR | records | missed pulses | records with a false onset | rms / bound | in 95 % interval | flag `misfit` | bound / bound in white noise |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    let cells = claims::Instrument::all()
        .into_iter()
        .flat_map(|instrument| [10.0, 50.0, 200.0].map(|snr| (instrument.clone(), snr)));
    for (n, (instrument, snr)) in cells.enumerate().filter(|(n, _)| only.is_empty() || only.contains(n)) {
        let claims = claims::claims(&instrument, snr, records, first_seed + n as u64);
        let claims::Claims { missed, false_onsets, ratio, within, flagged, lost } = claims;
        println!(
            "| {} | {snr} | {records} | {missed} | {false_onsets} | {ratio} | {within} | {flagged:.2} | {lost:.2} |",
            instrument.name
        );
    }
}
