//! Small things that a wall shows, through files: captures made here, converted, and run by the built-in pipeline.
//! `benches/accuracy.rs` runs the study over many seeds.

use std::path::Path;

use periscope::store::Shelf;
use periscope::tables::{JointSearch, Patch, Row};

use crate::relay_scene::{Capture, Dot, FWHM_PS, Law, dots, letter, periscope, plate, twins};

/// Hidden patches farther than this from each true place are made up.
const NEAR_M: f64 = 0.01;
const PIPELINE: &str = include_str!("../../pipelines/locate.toml");

/// What came of one campaign.
#[derive(Clone, Debug)]
pub struct Outcome {
    pub search: JointSearch,
    /// True places with a hidden patch, and hidden patches without a true place.
    pub hits: usize,
    pub extra: usize,
    /// Squared errors of all coordinates, those of the bound, and coordinates within their intervals of 95 %.
    pub squares_m2: f64,
    pub bound_m2: f64,
    pub inside: usize,
}

/// Runs the built-in pipeline without its image.
fn run(folder: &Path, out: &str, threads: &str) -> (Vec<Patch>, JointSearch) {
    let pipeline = PIPELINE.split("[voxels]").next().unwrap();
    std::fs::write(folder.join("pipeline.toml"), pipeline).unwrap();
    periscope(folder, &["run", "pipeline.toml", "--campaign", "campaign", "--out", out, "--threads", threads]);
    let shelf = Shelf::look(&folder.join(out)).unwrap();
    let patches = shelf.batches("patches").unwrap().iter().flat_map(|batch| Patch::rows(batch).unwrap()).collect();
    let searches: Vec<JointSearch> =
        shelf.batches("patches.searches").unwrap().iter().flat_map(|batch| JointSearch::rows(batch).unwrap()).collect();
    assert_eq!(searches.len(), 1);
    (patches, searches[0].clone())
}

/// Writes a capture into a folder and converts it.
fn convert(folder: &Path, capture: &Capture, hidden: &[Dot]) {
    capture.write(&folder.join("scan.mat"), hidden);
    let (fwhm, dt) = (FWHM_PS.to_string(), capture.dt_ps.to_string());
    periscope(folder, &["convert", "scan.mat", "--out", "campaign", "--fwhm-ps", &fwhm, "--dt-ps", &dt]);
}

/// One campaign, from its files to its verdict.
pub fn outcome(capture: &Capture, hidden: &[Dot]) -> Outcome {
    let folder = tempfile::tempdir().unwrap();
    convert(folder.path(), capture, hidden);
    let (patches, search) = run(folder.path(), "results", "2");
    let mut hidden_patches: Vec<Patch> = patches.into_iter().filter(|patch| &*patch.kind == "hidden").collect();
    // Anchors of the wall are patches too.
    hidden_patches.retain(|patch| patch.z_m.abs() > 0.05);
    judge(capture, hidden, hidden_patches, search)
}

fn judge(capture: &Capture, hidden: &[Dot], mut patches: Vec<Patch>, search: JointSearch) -> Outcome {
    let mut outcome = Outcome { search, hits: 0, extra: 0, squares_m2: 0.0, bound_m2: 0.0, inside: 0 };
    let bounds_m = if patches.is_empty() { Vec::new() } else { capture.bound_m(hidden) };
    for ((place, _), bound_m) in hidden.iter().zip(bounds_m.chunks(3)) {
        let off_m = |patch: &Patch| [patch.x_m - place[0], patch.y_m - place[1], patch.z_m - place[2]];
        let gap_m = |patch: &Patch| off_m(patch).iter().map(|off_m| off_m * off_m).sum::<f64>().sqrt();
        let nearest = (0..patches.len()).min_by(|a, b| gap_m(&patches[*a]).total_cmp(&gap_m(&patches[*b])));
        let Some(nearest) = nearest.filter(|n| gap_m(&patches[*n]) < NEAR_M) else { continue };
        let patch = patches.swap_remove(nearest);
        let variances_m2 = [patch.cov_xx_m2, patch.cov_yy_m2, patch.cov_zz_m2].map(Option::unwrap);
        for ((off_m, variance_m2), bound_m) in off_m(&patch).iter().zip(variances_m2).zip(bound_m) {
            outcome.squares_m2 += off_m * off_m;
            outcome.bound_m2 += bound_m * bound_m;
            outcome.inside += usize::from(off_m * off_m < 1.96_f64.powi(2) * variance_m2);
        }
        outcome.hits += 1;
    }
    outcome.extra = patches.len();
    outcome
}

/// Scenes of a cell of the study, by their seeds.
pub fn scene(kind: &str, count: usize, photons: f64, seed: u64) -> (Capture, Vec<Dot>) {
    let capture = Capture { seed, ..Capture::default() };
    let rough = Capture { relief_m: 0.001, jitter_ps: 5.0, ..capture };
    let shift = 0.01 * (seed % 7) as f64;
    match kind {
        "dots" => (capture, dots(count, photons, 0.04, 1000 + seed)),
        "retroreflective dots" => {
            let capture = Capture { law: Law::Retroreflective, ..capture };
            (capture, dots(count, photons, 0.04, 2000 + seed))
        }
        "twins 12 mm apart" => (capture, twins(&dots(count / 2, photons, 0.1, 3000 + seed), 0.012, seed)),
        "dots, relief 1 mm, jitter 5 ps" => (rough, dots(count, photons, 0.04, 4000 + seed)),
        "plate 20 cm" => (capture, plate([shift - 0.03, 0.0, 0.45 + shift], 0.2, photons)),
        "plate 6 cm" => (capture, plate([shift - 0.03, 0.02, 0.45 + shift], 0.06, photons)),
        "letter 20 cm" => (capture, letter([shift - 0.03, 0.0, 0.45 + shift], 0.2, photons)),
        "nothing" => (capture, Vec::new()),
        kind => panic!("no scene is called {kind}"),
    }
}

#[test]
fn dots_lie_at_their_places_within_their_error_bars() {
    let (mut hits, mut inside) = (0, 0);
    for (kind, count) in [("dots", 9), ("retroreflective dots", 4), ("dots, relief 1 mm, jitter 5 ps", 5)] {
        let (capture, hidden) = scene(kind, count, 300.0, 1);
        let outcome = outcome(&capture, &hidden);
        println!("{kind}: {outcome:?}");
        assert_eq!(&*outcome.search.verdict, "points", "{}", outcome.search.reason);
        assert_eq!((outcome.hits, outcome.extra), (count, 0));
        hits += outcome.hits;
        inside += outcome.inside;
    }
    // 54 coordinates: two and a half standard deviations below 95 %.
    assert!(inside as f64 > 0.88 * (3 * hits) as f64, "{inside} of {}", 3 * hits);
}

#[test]
fn an_extended_object_is_no_set_of_points() {
    for kind in ["plate 20 cm", "letter 20 cm", "plate 6 cm"] {
        let (capture, hidden) = scene(kind, 0, 3000.0, 1);
        let outcome = outcome(&capture, &hidden);
        println!("{kind}: {outcome:?}");
        assert_ne!(&*outcome.search.verdict, "points", "{kind}");
        assert_eq!(outcome.extra, 0);
    }
}

#[test]
fn an_empty_scene_with_a_tail_has_nothing() {
    for seed in 0..3 {
        let (capture, hidden) = scene("nothing", 0, 0.0, seed);
        let outcome = outcome(&capture, &hidden);
        assert_eq!(&*outcome.search.verdict, "nothing", "{outcome:?}");
        assert!(outcome.search.largest < outcome.search.threshold && &*outcome.search.response == "wall");
    }
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (capture, hidden) = scene("dots", 3, 300.0, 5);
    convert(folder.path(), &capture, &hidden);
    let bytes = |out: &str, threads: &str| {
        let (patches, search) = run(folder.path(), out, threads);
        format!("{:?} {:?}", Patch::to_batch(&patches), JointSearch::to_batch(&[search]))
    };
    assert_eq!(bytes("one", "1"), bytes("two", "3"));
}
