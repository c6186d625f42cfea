use std::path::Path;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::campaign::Campaign;
use crate::stages::range::{Context, Range};
use crate::stages::stage::{Apply, Outcome, Stage};
use crate::tables::{Delay, PatchCovariance, Row};
use crate::units;

/// Standard deviation of an onset.
const SD_PS: f64 = 5.0;
const CAMPAIGN: &str = "[campaign]\nname = 'c'\ngroup_index = 1.0\n[stations.laser]\nposition_m = [0.0, 0.0, 0.0]\n[stations.aside]\nposition_m = [0.3, -0.1, 0.2]\n\
                        [sensors.aside]\nstation = 'aside'\n[sensors.near]\nstation = 'laser'\n[patches.6]\nrole = 'mirror'\n";

/// Patches 1 to 5 visible, 6 a mirror, 8 and 9 hidden.
fn scene() -> BTreeMap<PatchId, Point> {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let mut place = || Point::new(rng.random_range(-1.0..1.0), rng.random_range(0.6..2.2), rng.random_range(-0.9..0.9));
    [1, 2, 3, 4, 5, 6, 8, 9].map(|patch| (patch, place())).into()
}

fn sensor(name: &str) -> Point {
    if name == "aside" { Point::new(0.3, -0.1, 0.2) } else { Point::origin() }
}

fn label(points: &BTreeMap<PatchId, Point>, name: &str, path: &[PatchId], late_ps: f64) -> Label {
    let (end, way_m) = path
        .iter()
        .fold((Point::origin(), 0.0), |(at, way_m), patch| (points[patch], way_m + (points[patch] - at).norm()));
    Label {
        campaign: "c".into(),
        sensor: name.into(),
        lit: path[0],
        seen: path[path.len() - 1],
        rank: 1,
        time_ps: units::time_ps(way_m + (sensor(name) - end).norm(), 1.0) + late_ps,
        time_sd_ps: SD_PS,
        width_ps: Some(0.0),
        bounces: path.len() as i32,
        path: Some(path.to_vec()),
        probability: 1.0,
        ..Label::default()
    }
}

fn labels(name: &str, late_ps: f64, paths: &[&[PatchId]]) -> Vec<Label> {
    paths.iter().map(|path| label(&scene(), name, path, late_ps)).collect()
}

fn context(beside: BesideTables) -> Context {
    let range = Range::default();
    range.context(range.fields(&[Campaign::parse(Path::new("c"), CAMPAIGN).unwrap()]), &beside).unwrap()
}

fn ranged(context: &Context, labels: &[Label]) -> Outcome<Distance> {
    Range::default().apply(context, labels.to_vec()).unwrap()
}

/// Whether all distances of this many third bounces are right to so much.
fn assert_right(rows: &[Distance], count: usize, off_m: f64) {
    let points = scene();
    let hidden: Vec<&Distance> = rows.iter().filter(|row| row.bounces == 3).collect();
    assert_eq!(hidden.len(), count, "{hidden:?}");
    for row in hidden {
        assert!((row.distance_m - (points[&row.a] - points[&row.b]).norm()).abs() < off_m, "{row:?}");
    }
}

/// The covariance that is claimed of every two distances, against what each of `moved` makes of the distances in place
/// of `rows`: one standard deviation of each independent error.
fn assert_claimed(outcome: &Outcome<Distance>, moved: &[Vec<Distance>]) {
    let rows = &outcome.rows;
    let claimed: BTreeMap<_, f64> = Covariance::rows(&outcome.sides[0])
        .unwrap()
        .into_iter()
        .map(|row| (((row.a1, row.b1), (row.a2, row.b2)), row.cov_m2))
        .collect();
    let mut shared = 0;
    for (n, a) in rows.iter().enumerate() {
        for (m, b) in rows.iter().enumerate().skip(n) {
            let error = |moved: &[Distance], k: usize| moved[k].distance_m - rows[k].distance_m;
            let expected: f64 = moved.iter().map(|moved| error(moved, n) * error(moved, m)).sum();
            let cov_m2 =
                if n == m { a.sd_m * a.sd_m } else { claimed.get(&((a.a, a.b), (b.a, b.b))).copied().unwrap_or(0.0) };
            shared += usize::from(n != m && cov_m2 != 0.0);
            assert!((cov_m2 - expected).abs() < 1e-3 * a.sd_m * b.sd_m, "{a:?} {b:?}: {cov_m2} {expected}");
        }
    }
    assert!(shared > rows.len() && shared == claimed.len(), "{shared} {}", claimed.len());
}

const FIRST_AND_SECOND: [&[PatchId]; 8] = [&[1], &[2], &[2], &[3], &[4], &[1, 2], &[2, 1], &[3, 4]];
const OVER_HIDDEN: [&[PatchId]; 11] = [
    &[1, 8, 1],
    &[1, 8, 2],
    &[2, 8, 1],
    &[2, 8, 3],
    &[3, 8, 3],
    &[4, 8, 1],
    &[1, 9, 2],
    &[2, 9, 4],
    &[4, 9, 1],
    &[3, 9, 2],
    &[3, 9, 4],
];

#[test]
fn legs_from_first_bounces_give_ranges_free_of_delay_and_all_covariances() {
    let labels = [labels("near", 40.0, &FIRST_AND_SECOND), labels("near", 40.0, &OVER_HIDDEN)].concat();
    let context = context(BesideTables::default());
    let outcome = ranged(&context, &labels);
    assert_right(&outcome.rows, 8, 1e-9);
    assert!(outcome.rejections.is_empty(), "{:?}", outcome.rejections);
    let later = |n: usize| {
        let mut labels = labels.clone();
        labels[n].time_ps += SD_PS;
        ranged(&context, &labels).rows
    };
    assert_claimed(&outcome, &(0..labels.len()).map(later).collect::<Vec<_>>());
    // Third bounces among visible patches and over mirrors are not used, nor those of sensors apart.
    let unused = [labels.clone(), self::labels("near", 0.0, &[&[1, 4, 2], &[1, 6, 2], &[3, 6, 3]])].concat();
    assert_eq!(ranged(&context, &unused).rows, outcome.rows);
    let apart = ranged(&context, &[labels, self::labels("aside", 0.0, &OVER_HIDDEN)].concat());
    assert_eq!(apart.rows, outcome.rows);
    assert!(apart.rejections.len() == 1 && apart.rejections[0].reason.contains("its 11 onsets"));
}

fn patch(patch: PatchId, kind: &str, point: Point, own: &Matrix3<f64>) -> Patch {
    Patch { onsets: 1, ..covariances::patch_row(patch, kind, point, Some(own)) }
}

/// Errors of patches 1 to 4, alike in all: what each of `errors_m`, of variance 1, moves each patch by.
fn places(points: &BTreeMap<PatchId, Point>, errors_m: &[[Vector3<f64>; 4]], delays_ps: [f64; 2]) -> BesideTables {
    let block =
        |a: usize, b: usize| -> Matrix3<f64> { errors_m.iter().map(|error| error[a] * error[b].transpose()).sum() };
    let patches: Vec<Patch> =
        (0..4).map(|n| patch(n as PatchId + 1, "visible", points[&(n as PatchId + 1)], &block(n, n))).collect();
    let between = |a: usize, b: usize| {
        let block = block(a, b);
        PatchCovariance {
            a: a as PatchId + 1,
            b: b as PatchId + 1,
            cov_xx_m2: block[(0, 0)],
            cov_xy_m2: block[(0, 1)],
            cov_xz_m2: block[(0, 2)],
            cov_yx_m2: block[(1, 0)],
            cov_yy_m2: block[(1, 1)],
            cov_yz_m2: block[(1, 2)],
            cov_zx_m2: block[(2, 0)],
            cov_zy_m2: block[(2, 1)],
            cov_zz_m2: block[(2, 2)],
            alternative: 0,
        }
    };
    let pairs: Vec<PatchCovariance> = (0..4).flat_map(|b| (0..b).map(move |a| between(a, b))).collect();
    let delay = |(sensor, delay_ps): (&str, f64)| Delay {
        campaign: "c".into(),
        sensor: sensor.into(),
        range: None,
        delay_ps,
        sd_ps: 3.0,
        prior_sd_ps: 10.0,
        ..Delay::default()
    };
    let delays: Vec<Delay> = ["near", "aside"].into_iter().zip(delays_ps).map(delay).collect();
    BesideTables::from([
        ("patches".to_owned(), vec![Patch::to_batch(&patches)]),
        ("covariances".to_owned(), vec![PatchCovariance::to_batch(&pairs)]),
        ("delays".to_owned(), vec![Delay::to_batch(&delays)]),
    ])
}

#[test]
fn legs_from_known_patches_serve_sensors_apart_and_their_errors_travel() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut shift = || Vector3::from_fn(|_, _| rng.random_range(-0.0005..0.0005));
    let errors_m: Vec<[Vector3<f64>; 4]> = (0..12).map(|_| [shift(), shift(), shift(), shift()]).collect();
    let points = scene();
    let labels = [labels("near", 20.0, &OVER_HIDDEN), labels("aside", -30.0, &OVER_HIDDEN)].concat();
    let with = |points: &BTreeMap<PatchId, Point>, delays_ps: [f64; 2], labels: &[Label]| {
        ranged(&context(places(points, &errors_m, delays_ps)), labels)
    };
    let outcome = with(&points, [20.0, -30.0], &labels);
    assert_right(&outcome.rows, 8, 1e-9);
    assert!(outcome.rejections.is_empty(), "{:?}", outcome.rejections);
    let mut moved: Vec<Vec<Distance>> = Vec::new();
    for n in 0..labels.len() {
        let mut labels = labels.clone();
        labels[n].time_ps += SD_PS;
        moved.push(with(&points, [20.0, -30.0], &labels).rows);
    }
    for error_m in &errors_m {
        let mut points = points.clone();
        // So little that legs are straight, and its effect scaled up again.
        (0..4).for_each(|n| *points.get_mut(&(n as PatchId + 1)).unwrap() += 1e-3 * error_m[n]);
        let mut rows = with(&points, [20.0, -30.0], &labels).rows;
        for (row, exact) in rows.iter_mut().zip(&outcome.rows) {
            row.distance_m = exact.distance_m + 1e3 * (row.distance_m - exact.distance_m);
        }
        moved.push(rows);
    }
    moved.push(with(&points, [23.0, -30.0], &labels).rows);
    moved.push(with(&points, [20.0, -27.0], &labels).rows);
    assert_claimed(&outcome, &moved);
    // Patch 5 is not among those given.
    let lost = with(&points, [20.0, -30.0], &[labels, self::labels("near", 20.0, &[&[5, 8, 5], &[5, 9, 1]])].concat());
    assert_eq!(lost.rows, outcome.rows);
    let [reason] = &lost.rejections[..] else { panic!("{:?}", lost.rejections) };
    assert!(reason.reason.contains("patch 5 has no position") && reason.reason.contains("2 third bounces"));
}

#[test]
fn what_the_sums_leave_open_or_contradict_is_reported() {
    let context = context(BesideTables::default());
    let paths: [&[PatchId]; 9] = [&[1], &[2], &[3], &[4], &[1, 8, 3], &[1, 8, 4], &[2, 8, 3], &[2, 8, 4], &[5, 8, 1]];
    let mut labels = labels("near", 0.0, &paths);
    let outcome = ranged(&context, &labels);
    assert_right(&outcome.rows, 0, 0.0);
    let reasons: Vec<&str> = outcome.rejections.iter().map(|rejection| rejection.reason.as_str()).collect();
    let [lost, open] = reasons[..] else { panic!("{reasons:?}") };
    assert!(lost.contains("patch 5 has no first bounce") && lost.contains("1 third bounces"), "{lost}");
    assert!(open.contains("hidden patch 8") && open.contains("patches 1, 2, 3, 4 open") && open.contains("`refine`"));
    labels.push(label(&scene(), "near", &[3, 8, 4], 0.0));
    assert_right(&ranged(&context, &labels).rows, 4, 1e-9);
    labels.push(label(&scene(), "near", &[3, 8, 3], 300.0));
    let outcome = ranged(&context, &labels);
    let unlikely = &outcome.rejections.last().unwrap().reason;
    assert!(unlikely.contains("hidden patch 8") && unlikely.contains("2 degrees of freedom"), "{unlikely}");
}

#[test]
fn patches_without_covariance_are_refused() {
    let mut start = patch(1, "visible", Point::origin(), &Matrix3::identity());
    start.cov_xx_m2 = None;
    let beside = BesideTables::from([("patches".to_owned(), vec![Patch::to_batch(&[start])])]);
    let refused = Places::new(&beside).unwrap_err().to_string();
    assert!(refused.contains("give patches from `refine`"), "{refused}");
}
