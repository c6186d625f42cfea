//! Hidden patches from scope files to coordinates, at random places around the corner; `benches/accuracy.rs` runs it
//! over a hundred seeds for docs/accuracy.md.

use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use periscope::bound::{Bound, Use};
use periscope::pipeline::run::Settings;
use periscope::simulate::{Format, Laboratory, Scene};
use periscope::tables::Patch;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::lab::Lab;
use crate::missed::{aligning, position};

const PIPELINE: &str = include_str!("../../pipelines/scene.toml");
/// The demo's: eight visible patches and a door, whose hidden patches are left out.
const SCENE: &str = include_str!("../../pipelines/scenes/around-the-corner.toml");
const VISIBLE: i32 = 8;
/// Hidden patches are square, so large, and at least so far apart.
const SIZE_M: f64 = 0.02;
const APART_M: f64 = 0.12;
/// Part of space behind the door where they are, and where they face.
const LOW_M: [f64; 3] = [0.55, 0.5, -0.3];
const HIGH_M: [f64; 3] = [0.9, 0.85, 0.3];
const FACED_M: [f64; 3] = [-0.2, 0.95, -0.02];

/// A hidden patch of one scene.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Distance of the estimated patch from the true one, and its stated standard deviation; `None`: not found.
    pub found_m: Option<(f64, f64)>,
    /// Squared error over the stated covariance, a coordinate: 1 on average where that is right.
    pub squared: Option<f64>,
    /// Bound of its position's standard deviation.
    pub bound_m: f64,
}

impl Place {
    /// Whether it was found within 2 mm beyond three bounds and half the patch.
    pub fn is_right(&self) -> bool {
        self.found_m.is_some_and(|(error_m, _)| error_m < 0.002 + 3.0 * self.bound_m + 0.5 * SIZE_M)
    }
}

/// One scene: its hidden patches, and how many were found that are none.
pub struct Scored {
    pub places: Vec<Place>,
    pub extra: usize,
    /// Every true patch, and its estimated position after a rotation onto the truth.
    pub points: Vec<(Vector3<f64>, Option<Vector3<f64>>)>,
}

/// The scene's text with hidden patches at random places and a quieter instrument: third bounces have signal-to-noise
/// ratios of some 20.
fn scene(hidden: usize, seed: u64) -> String {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut places: Vec<Vector3<f64>> = Vec::new();
    while places.len() < hidden {
        let place = Vector3::from_fn(|axis, _| rng.random_range(LOW_M[axis]..HIGH_M[axis]));
        if places.iter().all(|other| (other - place).norm() > APART_M) {
            places.push(place);
        }
    }
    let from = SCENE.find("[patches.9]").expect("the first hidden patch");
    let to = SCENE.find("[surfaces.door]").expect("what hides them");
    let patch = |(n, at): (usize, &Vector3<f64>)| {
        let normal = (Vector3::from(FACED_M) - at).normalize();
        let (id, [x, y, z], [u, v, w]) = (VISIBLE as usize + 1 + n, <[f64; 3]>::from(*at), <[f64; 3]>::from(normal));
        format!(
            "[patches.{id}]\nposition_m = [{x:.5}, {y:.5}, {z:.5}]\nnormal = [{u:.6}, {v:.6}, {w:.6}]\nsize_m = {SIZE_M}\nrole = \"hidden\"\n"
        )
    };
    let patches: String = places.iter().enumerate().map(patch).collect();
    let strong = [
        ("shots = 200\n", "shots = 2000\n"),
        ("noise_v = 0.001\n", "noise_v = 0.00025\n"),
        ("bits = 12\n", "bits = 14\n"),
    ];
    let rest = strong.iter().fold(SCENE[to..].to_owned(), |text, (from, to)| {
        assert!(text.contains(from), "the scene has changed");
        text.replace(from, to)
    });
    format!("{}{patches}{rest}", &SCENE[..from])
}

/// Simulates scope files of a scene of this kind, runs the pipeline and compares.
pub fn scored(hidden: usize, seed: u64) -> Scored {
    compared(&scene(hidden, seed), PIPELINE, seed).1
}

/// Simulates scope files of a scene and runs a pipeline into `out`. The visible patches define a rotation onto the
/// truth, after which the hidden ones are compared.
pub fn compared(scene: &str, pipeline: &str, seed: u64) -> (Lab, Scored) {
    let scene = Scene::parse(Path::new("scene.toml"), scene).unwrap();
    let laboratory = Laboratory::new(&scene, 0).unwrap();
    let lab = Lab::recorded(&laboratory, seed, Format::Trc);
    lab.run("out", pipeline, &Settings::default()).unwrap();
    let truth: Vec<Patch> = lab.truth();
    let patches: Vec<Patch> =
        lab.rows::<Patch>("out", "patches").into_iter().filter(|patch| patch.alternative == 0).collect();
    let placed = |truth: &Patch| patches.iter().find(|patch| patch.patch == truth.patch).map(position);
    let visible: Vec<(Vector3<f64>, Option<Vector3<f64>>)> =
        truth.iter().filter(|truth| truth.patch <= VISIBLE).map(|truth| (position(truth), placed(truth))).collect();
    let (targets, from): (Vec<_>, Vec<_>) =
        visible.iter().filter_map(|(truth, place)| Some((*truth, (*place)?))).unzip();
    let turn = aligning(&from, &targets);
    let mut rest: Vec<&Patch> = patches.iter().filter(|patch| patch.patch > VISIBLE).collect();
    let bound = Bound::of(&laboratory, Use { bounces: 3, ..Use::default() });
    let mut points: Vec<(Vector3<f64>, Option<Vector3<f64>>)> =
        visible.into_iter().map(|(truth, place)| (truth, place.map(|place| turn * place))).collect();
    let place = |truth: &Patch| {
        let error_m = |patch: &Patch| (turn * position(patch) - position(truth)).norm();
        let nearest = (0..rest.len()).min_by(|&a, &b| error_m(rest[a]).total_cmp(&error_m(rest[b])));
        let patch = nearest.filter(|&n| error_m(rest[n]) < 0.5 * APART_M).map(|n| rest.remove(n));
        points.push((position(truth), patch.map(|patch| turn * position(patch))));
        let found_m = patch.map(|patch| (error_m(patch), patch.sd_m.expect("refined")));
        let squared = patch.map(|patch| {
            let error = position(patch) - turn.transpose() * position(truth);
            let inverse = covariance_m2(patch).try_inverse().expect("refined");
            error.dot(&(inverse * error)) / 3.0
        });
        Place { found_m, squared, bound_m: bound.coordinates.sd_m(truth.patch).unwrap_or(f64::INFINITY) }
    };
    let places = truth.iter().filter(|patch| patch.patch > VISIBLE).map(place).collect();
    let extra = rest.len();
    (lab, Scored { places, extra, points })
}

/// Covariance of a position, in the frame of the solution.
fn covariance_m2(patch: &Patch) -> Matrix3<f64> {
    let [xx, xy, xz] = [patch.cov_xx_m2, patch.cov_xy_m2, patch.cov_xz_m2].map(|value| value.expect("refined"));
    let [yy, yz, zz] = [patch.cov_yy_m2, patch.cov_yz_m2, patch.cov_zz_m2].map(|value| value.expect("refined"));
    Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
}

/// Four hidden patches, and nothing else.
#[test]
fn hidden_patches_at_random_places_are_found_from_scope_files() {
    let scored = scored(4, 0);
    eprintln!("{:?}, {} more", scored.places, scored.extra);
    let off_m = |(truth, place): &(Vector3<f64>, Option<Vector3<f64>>)| {
        place.map_or(f64::INFINITY, |place| (place - truth).norm())
    };
    assert!(scored.points[..VISIBLE as usize].iter().all(|point| off_m(point) < 0.001), "{:?}", scored.points);
    assert!(scored.extra == 0 && scored.places.iter().all(Place::is_right), "{:?}", scored.places);
}
