//! Hidden patches too weak for an onset in any single profile; `benches/faint.rs` runs the same over hundreds of seeds
//! for docs/accuracy.md.

use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use periscope::bound::{Bound, Use};
use periscope::geometry::{Point, procrustes};
use periscope::pipeline::run::Settings;
use periscope::simulate::{Format, Scene};
use periscope::tables::{Decision, Hypothesis, Patch};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::lab::Lab;

const SCENE: &str = include_str!("../../pipelines/scenes/faint.toml");
const PIPELINE: &str = include_str!("../../pipelines/scene.toml");
const VISIBLE: usize = 8;
/// The hidden patch of the scene, without its number.
const PLACE: &str =
    "position_m = [0.62, 0.80, 0.02]\nnormal = [-0.974437, 0.221463, -0.037779]\nsize_m = 0.04\nreflectance = 0.1";
/// Reflectance at which signal-to-noise ratios are asked for before they are set.
const REFLECTANCE: f64 = 0.1;

/// A scene with one hidden patch.
pub struct Drawn {
    pub scene: String,
    pub hidden: Point,
    /// Largest matched-filter signal-to-noise ratio of its light in one profile.
    pub largest_snr: f64,
}

/// The scene with its hidden patch somewhere else, and darker. The signal-to-noise ratio of its light is `snr`, in the
/// root mean square over the profiles of pairs. Profiles of one patch lit and seen are attenuated for the first bounce
/// and show nothing of it. Fewer shots with less noise are the same, and quicker.
pub fn draw(snr: f64, seed: u64) -> Drawn {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut between = |low: f64, high: f64| -> f64 { rng.random_range(low..high) };
    let hidden = Vector3::new(between(0.45, 0.95), between(0.5, 1.0), between(-0.35, 0.35));
    let tilt = Vector3::new(between(-0.3, 0.3), between(-0.3, 0.3), between(-0.3, 0.3));
    let normal = ((Vector3::new(-0.3, 1.0, 0.0) - hidden).normalize() + tilt).normalize();
    let text = |reflectance: f64| {
        let place = format!(
            "position_m = {:?}\nnormal = {:?}\nsize_m = 0.04\nreflectance = {reflectance:?}",
            hidden.as_slice(),
            normal.as_slice()
        );
        let scene = SCENE
            .replace(PLACE, &place)
            .replace("shots = 200\n", "shots = 50\n")
            .replace("noise_v = 0.001\nbits = 12\n", "noise_v = 0.0005\nbits = 14\n");
        assert!(scene != SCENE, "the scene has other lines than these");
        scene
    };
    let scene = Scene::parse(Path::new("scene.toml"), &text(REFLECTANCE)).unwrap();
    let bound = Bound::new(&scene, Use { bounces: 2, threshold_sigma: f64::INFINITY }).unwrap();
    let pairs = bound.profiles.iter().filter(|profile| profile.lit != profile.seen);
    let snrs: Vec<f64> = pairs
        .flat_map(|profile| &profile.pulses)
        .filter(|pulse| pulse.path.len() == 3 && pulse.path[1] == 9)
        .map(|pulse| pulse.snr)
        .collect();
    let usual = (snrs.iter().map(|snr| snr * snr).sum::<f64>() / snrs.len() as f64).sqrt();
    let largest_snr = snrs.iter().copied().fold(0.0, f64::max) * snr / usual;
    Drawn { scene: text(REFLECTANCE * snr / usual), hidden: Point::from(hidden), largest_snr }
}

/// Patches beyond the eighth, turned as the visible ones tell. Covariances stand as matrices.
fn turned(patches: &[Patch], truth: &[Patch]) -> Vec<Placed> {
    let point = |patch: &Patch| Point::new(patch.x_m, patch.y_m, patch.z_m);
    let points: Vec<Point> = patches[..VISIBLE].iter().map(point).collect();
    let targets: Vec<Point> = truth[..VISIBLE].iter().map(point).collect();
    let turn = procrustes::rotation(&points, &targets, Point::origin(), true).matrix;
    let placed = |patch: &Patch| {
        let [xx, xy, xz] = [patch.cov_xx_m2, patch.cov_xy_m2, patch.cov_xz_m2].map(Option::unwrap);
        let [yy, yz, zz] = [patch.cov_yy_m2, patch.cov_yz_m2, patch.cov_zz_m2].map(Option::unwrap);
        let covariance_m2 = turn * Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz) * turn.transpose();
        Placed { point: turn * point(patch), covariance_m2 }
    };
    patches[VISIBLE..].iter().map(placed).collect()
}

/// A hidden patch that was found.
pub struct Placed {
    pub point: Point,
    pub covariance_m2: Matrix3<f64>,
}

impl Placed {
    /// Squared distance from the truth over its covariance, and in m^2.
    pub fn squares(&self, truth: &Point) -> (f64, f64) {
        let off = self.point - truth;
        (off.dot(&(self.covariance_m2.try_inverse().unwrap() * off)), off.norm_squared())
    }
}

/// What came of a scene, turned to lie as it does.
pub struct Seen {
    /// Patches that `label` found among onsets, and `search` in all profiles.
    pub by_label: usize,
    pub patches: Vec<Placed>,
    pub hypotheses: Vec<Hypothesis>,
    pub decisions: Vec<Decision>,
}

impl Seen {
    /// Whether a place that is likelier than not is named, with the shots that would show it.
    pub fn is_declined(&self) -> bool {
        self.decisions.iter().any(|row| {
            &*row.what == "weak patches" && row.runner_up.is_some() && row.would_change.contains("shots per capture")
        })
    }
}

pub fn run(scene: &str, seed: u64) -> Seen {
    let lab = Lab::of(scene, seed, Format::Trc);
    lab.run("out", PIPELINE, &Settings::default()).unwrap();
    let labels: Vec<Hypothesis> = lab.rows("out", "labels.hypotheses");
    let mut patches: Vec<Patch> = lab.rows("out", "all_patches");
    patches.retain(|patch| patch.alternative == 0);
    let patches = turned(&patches, &lab.truth());
    let by_label = labels.iter().filter(|row| row.patch.is_some() && row.alternative == 0).count();
    let decisions = lab.rows("out", "decisions");
    Seen { by_label, patches, hypotheses: lab.rows("out", "all_patches.hypotheses"), decisions }
}

/// Where `label` finds nothing among onsets, the search in all profiles finds the patch, to its covariance.
#[test]
fn a_patch_too_weak_for_onsets_is_found_in_all_profiles_together() {
    let drawn = draw(2.0, 7);
    assert!(drawn.largest_snr < 5.0, "no single profile shows it");
    let seen = run(&drawn.scene, 7);
    assert_eq!((seen.by_label, seen.patches.len()), (0, 1), "{:?}", seen.hypotheses);
    let (normalised, square_m2) = seen.patches[0].squares(&drawn.hidden);
    assert!(normalised < 16.0 && square_m2.sqrt() < 0.04, "{normalised} {square_m2}");
    let hypothesis = &seen.hypotheses[0];
    assert!(hypothesis.patch == Some(9) && hypothesis.evidence > hypothesis.evidence_needed);
    // Errors of visible patches and of delays, which all profiles share, are the patch's too: here they are small.
    let gained = seen.patches[0].covariance_m2.trace() / hypothesis.sd_m.powi(2);
    assert!(gained > 1.0 + 1e-9 && gained < 1.05, "{gained}");
}

/// Nothing is found where nothing is, and what is not sure enough is declined, with what would show it.
#[test]
fn light_that_shows_no_patch_is_declined() {
    let seen = run(&draw(0.0, 8).scene, 8);
    assert!(seen.by_label == 0 && seen.patches.is_empty(), "{:?}", seen.hypotheses);
    let seen = run(&draw(1.1, 0).scene, 0);
    let [row] = seen.hypotheses.as_slice() else { panic!("{:?}", seen.hypotheses) };
    assert!(row.patch.is_none() && row.evidence > 0.0 && row.evidence < row.evidence_needed, "{row:?}");
    assert!(row.shots_needed.unwrap() > 50.0, "{row:?}");
    assert!(seen.is_declined(), "{:?}", seen.decisions);
}
