//! The paper's Figs. 5 and 6 from scope files: hidden patches on a plane, which the solver does not know;
//! `benches/reproduction.rs` runs more seeds.

use std::fs;
use std::path::Path;

use nalgebra::{DMatrix, Vector3};
use periscope::pipeline::run::{RunError, Settings};
use periscope::pipeline::spec::Definition;
use periscope::simulate::Scene;
use periscope::tables::{Calibration, Onset, Patch, Plane};
use periscope::units::{path_m, time_ps};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::corner::{self, Scored};
use crate::lab::{Lab, one_look, point_onset, write_table};
use crate::missed::{aligning, position};

/// Nine hidden patches.
pub const SCENE: &str = include_str!("../../pipelines/scenes/hidden-plane.toml");
const PIPELINE: &str = include_str!("../../pipelines/scene.toml");

/// Hidden patches of one seed, and the plane with most of them.
pub struct Drawn {
    pub scored: Scored,
    /// Number of patches on it, and the root of their mean squared distance from it.
    pub plane: Option<(usize, f64)>,
}

/// Simulates, runs and compares.
pub fn drawn(seed: u64) -> Drawn {
    let (lab, scored) = corner::compared(SCENE, PIPELINE, seed);
    let planes: Vec<Plane> = lab.rows("out", "planes");
    Drawn { scored, plane: planes.first().map(|plane| (plane.patches.len(), plane.rms_m)) }
}

/// A plane of nine patches 20 to 25 cm apart, for onsets with the paper's Gaussian noise, at the scale of a room: at
/// 100 ps the bound is about 3 cm at any scale.
const SCALE: f64 = 2.5;
const PAPER_SCENE: &str = include_str!("../../pipelines/scenes/paper-hidden-plane.toml");
const DELAY_PS: f64 = 250.0;
/// What a calibration leaves of it.
const DELAY_SD_PS: f64 = 5.0;
/// Group index of the campaign: that of air.
const INDEX: f64 = 1.000_277;
const VISIBLE: usize = 8;
/// A hidden patch is found where it comes nearer than half the distance of its neighbours.
const NEAR_M: f64 = 0.1 * SCALE;

/// What one method made of onsets with the paper's noise.
pub struct Noisy {
    /// Distance of each hidden patch from the nearest that was found; those beyond `NEAR_M` are none.
    pub errors_m: Vec<Option<f64>>,
    pub extra: usize,
    /// Whether the run reported that it reached no solution.
    pub refused: bool,
    /// Root of the mean squared distance from the plane nearest to those that were found.
    pub off_plane_m: Option<f64>,
}

fn paper_points() -> Vec<Vector3<f64>> {
    let scene = Scene::parse(Path::new("scene.toml"), PAPER_SCENE).unwrap();
    scene.patches.values().map(|disk| SCALE * Vector3::from(disk.position_m)).collect()
}

/// Patches of the light of each profile: first, second and third bounces.
fn paths(count: usize) -> Vec<Vec<usize>> {
    let profiles = (0..VISIBLE).flat_map(|lit| (0..VISIBLE).map(move |seen| (lit, seen)));
    let of_profile = |(lit, seen): (usize, usize)| {
        let direct = if lit == seen { vec![lit] } else { vec![lit, seen] };
        let via = (0..count).filter(move |via| *via != lit && *via != seen);
        std::iter::once(direct).chain(via.map(move |via| vec![lit, via, seen]))
    };
    profiles.flat_map(of_profile).collect()
}

fn length_m(points: &[Vector3<f64>], path: &[usize]) -> f64 {
    let inner: f64 = path.windows(2).map(|leg| (points[leg[0]] - points[leg[1]]).norm()).sum();
    points[path[0]].norm() + inner + points[path[path.len() - 1]].norm()
}

/// Cramer-Rao bound of the hidden patches, with all paths known and the delay as calibrated: root mean square error, by
/// finite differences of path lengths.
pub fn noisy_bound_m(noise_ps: f64) -> f64 {
    let (points, step_m) = (paper_points(), 1e-6);
    let (paths, unknowns) = (paths(points.len()), 3 * points.len() + 1);
    let mut jacobian = DMatrix::from_element(paths.len(), unknowns, 1.0);
    for k in 0..unknowns - 1 {
        let moved = |by_m: f64| {
            let mut moved = points.clone();
            moved[k / 3][k % 3] += by_m;
            moved
        };
        let (ahead, behind) = (moved(step_m), moved(-step_m));
        for (row, path) in paths.iter().enumerate() {
            jacobian[(row, k)] = (length_m(&ahead, path) - length_m(&behind, path)) / (2.0 * step_m);
        }
    }
    let sd_m = path_m(noise_ps, INDEX);
    let mut information = jacobian.transpose() * jacobian / (sd_m * sd_m);
    information[(unknowns - 1, unknowns - 1)] += path_m(DELAY_SD_PS, INDEX).powi(-2);
    // The rotation about the laser is undetermined. The solution is rotated onto the visible patches, so theirs counts
    // as known.
    for axis in [Vector3::x(), Vector3::y(), Vector3::z()] {
        let mut turn = DMatrix::zeros(unknowns, 1);
        for (n, point) in points[..VISIBLE].iter().enumerate() {
            turn.fixed_view_mut::<3, 1>(3 * n, 0).copy_from(&axis.cross(point));
        }
        information += &turn * turn.transpose() * 1e12;
    }
    let covariance = information.try_inverse().expect("turns were the only freedom");
    let hidden = 3 * VISIBLE..3 * points.len();
    (hidden.clone().map(|k| covariance[(k, k)]).sum::<f64>() / (hidden.len() / 3) as f64).sqrt()
}

/// The pipeline from its labels on, over onsets that are given; `rank`: with the paper's labels by order of arrival.
pub fn noisy(seed: u64, noise_ps: f64, rank: bool) -> Noisy {
    let points = paper_points();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    // `detect` has taken the calibrated latency off; its error is common to all.
    let error: f64 = StandardNormal.sample(&mut rng);
    let mut onsets: Vec<Onset> = Vec::new();
    for path in paths(points.len()) {
        let noise: f64 = StandardNormal.sample(&mut rng);
        let time_ps = time_ps(length_m(&points, &path), INDEX) + DELAY_SD_PS * error + noise_ps * noise;
        onsets.push(onset(path[0], path[path.len() - 1], time_ps, noise_ps));
    }
    onsets.sort_by(|a, b| (a.lit, a.seen).cmp(&(b.lit, b.seen)).then(a.time_ps.total_cmp(&b.time_ps)));
    for profile in onsets.chunk_by_mut(|a, b| (a.lit, a.seen) == (b.lit, b.seen)) {
        profile.iter_mut().zip(1..).for_each(|(onset, rank)| onset.rank = rank);
    }
    let lab = Lab::bulk(0);
    fs::write(lab.campaign().join("campaign.toml"), "[campaign]\nname = 'noisy'\n[sensors.s1]\n").unwrap();
    write_table(&lab.path("onsets.parquet"), &onsets);
    write_table(&lab.path("calibration.parquet"), &[calibration()]);
    let whole = Definition::parse("scene", PIPELINE).unwrap().to_toml();
    let from = whole.find("[anchors]").expect("anchors come before labels");
    let solved = one_look(&whole[from..]);
    let by_rank = solved.replace("bounces = 5", "bounces = 3, hidden = \"rank\"");
    assert_ne!(by_rank, solved);
    let solved = if rank { by_rank } else { solved };
    let import = |heading: &str, table: &str| {
        let path = lab.path(&format!("{table}.parquet"));
        format!("[{heading}]\nstage = 'import'\nparams = {{ table = '{table}', path = '{}' }}\n", path.display())
    };
    let import = import("onsets", "onsets") + &import("scene_calibration", "calibration");
    if let Err(error) = lab.run("out", &(import + &solved), &Settings::default()) {
        assert!(matches!(error, RunError::Stage { .. }), "{error}");
        return Noisy { errors_m: vec![None; points.len() - VISIBLE], extra: 0, refused: true, off_plane_m: None };
    }
    let patches: Vec<Patch> =
        lab.rows::<Patch>("out", "patches").into_iter().filter(|patch| patch.alternative == 0).collect();
    let (visible, hidden): (Vec<&Patch>, Vec<&Patch>) = patches.iter().partition(|patch| patch.patch <= VISIBLE as i32);
    let visible: Vec<Vector3<f64>> = visible.into_iter().map(position).collect();
    let turn = aligning(&visible, &points[..VISIBLE]);
    let mut rest: Vec<Vector3<f64>> = hidden.into_iter().map(|patch| turn * position(patch)).collect();
    let mut right = Vec::new();
    let error_m = |point: &Vector3<f64>| {
        let nearest = (0..rest.len()).min_by(|&a, &b| (rest[a] - point).norm().total_cmp(&(rest[b] - point).norm()))?;
        let error_m = (rest[nearest] - point).norm();
        (error_m < NEAR_M).then(|| {
            right.push(rest.remove(nearest));
            error_m
        })
    };
    let errors_m = points[VISIBLE..].iter().map(error_m).collect();
    Noisy { errors_m, extra: rest.len(), refused: false, off_plane_m: off_plane_m(&right) }
}

fn onset(lit: usize, seen: usize, time_ps: f64, time_sd_ps: f64) -> Onset {
    point_onset("noisy", [lit as i32 + 1, seen as i32 + 1], 0, [time_ps, time_sd_ps])
}

/// Only the latency counts where onsets are given.
fn calibration() -> Calibration {
    Calibration {
        campaign: "noisy".into(),
        sensor: "s1".into(),
        shots: 1,
        step_ps: 50.0,
        response: vec![1.0].into(),
        latency_ps: DELAY_PS,
        latency_sd_ps: DELAY_SD_PS,
        ..Calibration::default()
    }
}

/// Root of the mean squared distance of points from the plane nearest to them; `None` for fewer than four.
fn off_plane_m(points: &[Vector3<f64>]) -> Option<f64> {
    let count = points.len() as f64;
    let middle = points.iter().sum::<Vector3<f64>>() / count;
    let scatter: nalgebra::Matrix3<f64> =
        points.iter().map(|point| (point - middle) * (point - middle).transpose()).sum();
    (points.len() > 3).then(|| (scatter.symmetric_eigenvalues().min().max(0.0) / count).sqrt())
}

/// A quarter of the paper's noise: the search finds all nine patches near their bound; labels by order of arrival do
/// not.
#[test]
fn from_noisy_onsets_hidden_patches_are_found_near_their_bound() {
    let noise_ps = 25.0;
    let (search, paper, bound_m) = (noisy(1, noise_ps, false), noisy(1, noise_ps, true), noisy_bound_m(noise_ps));
    let near = |noisy: &Noisy| -> Vec<f64> { noisy.errors_m.iter().flatten().copied().collect() };
    let (errors_m, by_rank_m) = (near(&search), near(&paper));
    let rms_m = (errors_m.iter().map(|error_m| error_m * error_m).sum::<f64>() / errors_m.len() as f64).sqrt();
    eprintln!(
        "bound {bound_m:.4} m; rms {rms_m:.4} m of {}, {} more, off their plane {:?} m; by order of arrival {by_rank_m:?}, {} more",
        errors_m.len(),
        search.extra,
        search.off_plane_m,
        paper.extra
    );
    assert!(errors_m.len() == 9 && search.extra == 0 && !search.refused && rms_m < 2.0 * bound_m, "{errors_m:?}");
    assert!(search.off_plane_m.is_some_and(|off_m| off_m < 2.0 * bound_m) && by_rank_m.len() < 9);
}

/// All are found, at a third of a millimetre rms and as sure as they say, though third bounces of two patches may blend
/// in all profiles: a second look at these knows what to look for (`predict`). Those on a plane are as flat as their
/// errors allow. Visible patches stand where second bounces of 100,000 times their noise say, though none of these is a
/// point of light.
#[test]
fn patches_on_a_hidden_plane_are_found_and_flat() {
    let drawn = drawn(1);
    eprintln!("{:?}, {} more, plane {:?}", drawn.scored.places, drawn.scored.extra, drawn.plane);
    let right = drawn.scored.places.iter().filter(|place| place.is_right()).count();
    assert!(right == 9 && drawn.scored.extra == 0, "{:?}", drawn.scored.places);
    let (visible, hidden) = drawn.scored.points.split_at(VISIBLE);
    let error_m = |(truth, found): &(Vector3<f64>, Option<Vector3<f64>>)| found.map(|found| (found - truth).norm());
    let squares_m2 = |points: &[(Vector3<f64>, Option<Vector3<f64>>)]| -> f64 {
        points.iter().map(|point| error_m(point).expect("all are placed").powi(2)).sum()
    };
    let [visible_m, hidden_m] = [visible, hidden].map(|points| (squares_m2(points) / points.len() as f64).sqrt());
    eprintln!("rms of visible patches {:.3} mm, of hidden ones {:.3} mm", 1e3 * visible_m, 1e3 * hidden_m);
    assert!(visible_m < 3e-5 && hidden_m < 4.5e-4, "{visible_m} {hidden_m}");
    let squared = drawn.scored.places.iter().filter_map(|place| place.squared).sum::<f64>() / 9.0;
    assert!(squared < 1.6, "{squared} of what covariances state");
    assert!(drawn.plane.is_some_and(|(patches, rms_m)| patches >= 8 && rms_m < 5e-4), "{:?}", drawn.plane);
}
