//! The paper's Fig. 4 from scope files: patches of 3 cm on three rectangles, whose coplanar pairs exchange no light;
//! `benches/accuracy.rs` runs it over hundreds of seeds for docs/accuracy.md.

use std::collections::BTreeMap;
use std::path::Path;

use periscope::bound::{Bound, Use};
use periscope::pipeline::run::Settings;
use periscope::simulate::{Format, Laboratory, Scene};
use periscope::tables::{Label, Patch, PatchCovariance, Plane, TruePath};

use crate::lab::Lab;
use crate::missed;

/// All 49 patches.
pub const SCENE: &str = include_str!("../../pipelines/scenes/rectangles.toml");
const PIPELINE: &str = include_str!("../../pipelines/scene.toml");

/// What some seeds gave.
#[derive(Default)]
pub struct Study {
    pub bound_m: f64,
    pub degrees_of_freedom: f64,
    /// Mean squared position error of each seed, footprints taken as points, and predicted.
    pub first_m2: Vec<f64>,
    pub squares_m2: Vec<f64>,
    /// Normalised squared error of each seed.
    pub normalised: Vec<f64>,
    /// Labels of direct reflections that determine distances before any patch is known, with the wrong ones; labels of
    /// the known scene by bounces, likewise.
    pub blind: (usize, usize),
    pub labels: BTreeMap<i32, (usize, usize)>,
    /// For each seed: root mean square distance of patches from their planes, and angles between planes minus a right
    /// angle.
    pub planarity_m: Vec<f64>,
    pub tilts_rad: Vec<(f64, f64)>,
}

/// Labels with a path, and those whose light did not take it, by bounces.
fn judged(labels: &[Label], truth: &[TruePath]) -> BTreeMap<i32, (usize, usize)> {
    let times: BTreeMap<(i32, i32, &[i32]), f64> =
        truth.iter().map(|path| ((path.lit, path.seen, path.path.as_slice()), path.time_ps)).collect();
    let mut counts: BTreeMap<i32, (usize, usize)> = BTreeMap::new();
    for label in labels.iter().filter(|label| label.alternative == 0) {
        let Some(path) = label.path.as_deref() else { continue };
        let is_right = times
            .get(&(label.lit, label.seen, path))
            .is_some_and(|time_ps| (label.time_ps - time_ps).abs() < 6.0 * label.time_sd_ps + 3.0);
        let count = counts.entry(label.bounces).or_default();
        count.0 += 1;
        count.1 += usize::from(!is_right);
    }
    counts
}

/// Simulates, runs and measures each seed.
pub fn study(text: &str, seeds: std::ops::Range<u64>) -> Study {
    let scene = Scene::parse(Path::new("scene.toml"), text).unwrap();
    let count = scene.patches.len() as f64;
    let mut study =
        Study { bound_m: Bound::new(&scene, Use::default()).unwrap().coordinates.rms_m(), ..Study::default() };
    let laboratory = Laboratory::new(&scene, 0).unwrap();
    for seed in seeds {
        let lab = Lab::recorded(&laboratory.reseeded(seed), seed, Format::Trc);
        lab.run("out", PIPELINE, &Settings::default()).unwrap();
        let truth: Vec<Patch> = lab.truth();
        let patches: Vec<Patch> = lab.rows("out", "patches");
        let missed = missed::missed(&patches, &lab.rows::<PatchCovariance>("out", "patches.patch_covariances"), &truth);
        study.degrees_of_freedom = missed::degrees_of_freedom(&truth) as f64;
        study.squares_m2.push(missed.squares_m2 / count);
        study.normalised.push(missed.normalised);
        study.first_m2.push(missed::squares_m2(&lab.rows("out", "first"), &truth) / count);
        let paths: Vec<TruePath> = lab.truth();
        for (labels, wrong) in judged(&lab.rows("out", "first_labels"), &paths).values() {
            study.blind.0 += labels;
            study.blind.1 += wrong;
        }
        for (bounces, (labels, wrong)) in judged(&lab.rows("out", "labels"), &paths) {
            let sum = study.labels.entry(bounces).or_default();
            sum.0 += labels;
            sum.1 += wrong;
        }
        let (rms_mm, nse) = (1e3 * (missed.squares_m2 / count).sqrt(), missed.normalised / study.degrees_of_freedom);
        let labels = (study.blind, &study.labels);
        eprintln!("seed {seed}: {rms_mm:.4} mm, NSE / dof {nse:.3}; labels and wrong ones so far {labels:?}");
        let planes: Vec<Plane> = lab.rows("out", "planes");
        assert_eq!(planes.len(), 3, "seed {seed}");
        let squares: f64 = planes.iter().map(|plane| plane.rms_m.powi(2) * plane.patches.len() as f64).sum();
        study.planarity_m.push((squares / count).sqrt());
        let off = |plane: &Plane| Some((plane.tilt_rad? - std::f64::consts::FRAC_PI_2, plane.tilt_sd_rad?));
        study.tilts_rad.extend(planes.iter().filter_map(off));
    }
    study
}

/// Of the 49 patches those on a coarser grid: 9, 5 and 5. Coplanar pairs are there as in the whole.
fn some_patches() -> String {
    let kept = [1, 3, 5, 11, 13, 15, 21, 23, 25, 26, 29, 32, 38, 41, 42, 43, 45, 48, 49];
    let (patches, rest) = SCENE.split_at(SCENE.find("\n# The hardware").expect("it follows the patches"));
    let (head, patches) = patches.split_at(patches.find("[patches.1]").expect("there are patches"));
    let is_kept = |block: &&str| kept.iter().any(|patch| block.starts_with(&format!("{patch}]")));
    let blocks: Vec<String> =
        patches.split("[patches.").filter(is_kept).map(|block| format!("[patches.{block}")).collect();
    format!("{head}{}{rest}", blocks.concat())
}

/// Two seeds, 108 degrees of freedom of the normalised error (one standard deviation: 14 %).
#[test]
fn coplanar_patches_of_three_centimetres_reach_the_bound() {
    let study = study(&some_patches(), 0..2);
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let ratio = mean(&study.squares_m2).sqrt() / study.bound_m;
    let first = mean(&study.first_m2).sqrt() / study.bound_m;
    let nse = mean(&study.normalised) / study.degrees_of_freedom;
    eprintln!(
        "rms over bound {ratio:.3}, footprints as points {first:.2}; NSE/dof {nse:.3}; blind labels {:?}, labels {:?}, planarity {:.1} um",
        study.blind,
        study.labels,
        1e6 * mean(&study.planarity_m)
    );
    assert!(ratio < 1.6 && first > 1.1 * ratio, "rms over bound {ratio}, as points {first}");
    assert!((0.5..1.6).contains(&nse), "normalised squared error over degrees of freedom {nse}");
    assert_eq!(study.blind.1, 0, "wrong labels without known patches");
    assert!(study.labels[&2].0 > 400 && study.labels[&1].1 + study.labels[&2].1 == 0);
    assert!(study.tilts_rad.iter().all(|(off, sd)| off.abs() < 4.0 * sd), "{:?}", study.tilts_rad);
}
