use super::*;
use crate::tables::Row;
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::path::Path;

/// A grid of patches on a rectangle: its middle, two edges from there, patches along each.
struct Wall(Vector3<f64>, [Vector3<f64>; 2], [usize; 2]);

impl Wall {
    /// Away from the origin.
    fn normal(&self) -> Vector3<f64> {
        let normal = self.1[0].cross(&self.1[1]).normalize();
        if normal.dot(&self.0) < 0.0 { -normal } else { normal }
    }

    fn points(&self) -> Vec<Point> {
        let Self(middle, [u, v], [m, n]) = self;
        let along = |k: usize, count: usize| 2.0 * k as f64 / (count - 1) as f64 - 1.0;
        let places = (0..*m).flat_map(|i| (0..*n).map(move |j| (i, j)));
        places.map(|(i, j)| Point::from(middle + u * along(i, *m) + v * along(j, *n))).collect()
    }
}

/// 37 patches on three walls, none at right angles.
fn walls() -> [Wall; 3] {
    let v = Vector3::new;
    [
        Wall(v(-0.3, 2.6, 0.1), [v(0.9, 0.2, 0.0), v(0.0, 0.3, 0.8)], [4, 4]),
        Wall(v(1.4, 1.6, 0.0), [v(-0.1, 0.6, 0.0), v(0.1, 0.0, 0.8)], [4, 3]),
        Wall(v(-0.2, 1.2, -1.2), [v(0.8, 0.0, 0.1), v(0.0, 0.4, -0.1)], [3, 3]),
    ]
}

/// Patches with errors of their own, and a small rotation about the origin that all of them share.
struct Scene {
    truth: Vec<Point>,
    turn_sd_rad: f64,
}

impl Scene {
    fn new(turn_sd_rad: f64) -> Self {
        Self { truth: walls().iter().flat_map(Wall::points).collect(), turn_sd_rad }
    }

    /// Root of a patch's own covariance: it leans along its sight line and differs from patch to patch.
    fn own(&self, a: usize) -> Matrix3<f64> {
        let sight = self.truth[a].coords.normalize();
        (Matrix3::identity() + 1.5 * sight * sight.transpose()) * (0.001 + 0.0005 * (a % 3) as f64)
    }

    fn covariance(&self, a: usize, b: usize) -> Matrix3<f64> {
        let turn = |a: usize| self.truth[a].coords.cross_matrix() * self.turn_sd_rad;
        turn(a) * turn(b).transpose() + if a == b { self.own(a) * self.own(a).transpose() } else { Matrix3::zeros() }
    }

    /// Rows with errors drawn.
    fn rows(&self, rng: &mut ChaCha8Rng) -> Vec<Patch> {
        let mut normals = || Vector3::from_fn(|_, _| StandardNormal.sample(rng));
        let turn: Vector3<f64> = normals() * self.turn_sd_rad;
        let row = |(a, point): (usize, &Point)| {
            let at = point.coords + turn.cross(&point.coords) + self.own(a) * normals();
            let cov = self.covariance(a, a);
            Patch { onsets: 1, ..covariances::patch_row(a as i32 + 1, "visible", at.into(), Some(&cov)) }
        };
        self.truth.iter().enumerate().map(row).collect()
    }

    /// The table of covariances between patches.
    fn beside(&self) -> BesideTables {
        let count = self.truth.len();
        let row = |(a, b): (usize, usize)| {
            let cov = self.covariance(a, b);
            PatchCovariance {
                a: a as i32 + 1,
                b: b as i32 + 1,
                cov_xx_m2: cov[(0, 0)],
                cov_xy_m2: cov[(0, 1)],
                cov_xz_m2: cov[(0, 2)],
                cov_yx_m2: cov[(1, 0)],
                cov_yy_m2: cov[(1, 1)],
                cov_yz_m2: cov[(1, 2)],
                cov_zx_m2: cov[(2, 0)],
                cov_zy_m2: cov[(2, 1)],
                cov_zz_m2: cov[(2, 2)],
                alternative: 0,
            }
        };
        let pairs = (0..count).flat_map(|a| (a + 1..count).map(move |b| (a, b)));
        let rows: Vec<PatchCovariance> = pairs.map(row).collect();
        BesideTables::from([("covariances".to_owned(), vec![PatchCovariance::to_batch(&rows)])])
    }
}

fn campaign(dimensions: u8) -> Vec<Campaign> {
    let text = format!("[campaign]\nname = 'c'\ndimensions = {dimensions}\n[sensors.s1]\n");
    vec![Campaign::parse(Path::new("c"), &text).unwrap()]
}

fn planes_of(surface: &Surface, beside: &BesideTables, rows: Vec<Patch>) -> (Vec<Plane>, Vec<String>) {
    let context = surface.context(surface.fields(&campaign(3)), beside).unwrap();
    let Outcome { rows, rejections, .. } = surface.apply(&context, rows).unwrap();
    (rows, rejections.into_iter().map(|rejection| rejection.reason).collect())
}

fn normal(plane: &Plane) -> Vector3<f64> {
    Vector3::new(plane.normal_x, plane.normal_y, plane.normal_z)
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt()
}

/// 200 draws each, without and with a rotation that all patches share: errors of normals, offsets and tilts are as
/// large as the rows say.
#[test]
fn walls_are_found_with_errors_as_large_as_stated() {
    let walls = walls();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for turn_sd_rad in [0.0, 0.001] {
        let scene = Scene::new(turn_sd_rad);
        let beside = scene.beside();
        let (mut offsets, mut tilts, mut chi2, mut whole) = (Vec::new(), Vec::new(), 0.0, 0);
        // Of each wall: covariance of the normal's error, and the mean of its stated largest part.
        let mut normals = [(Matrix3::zeros(), 0.0); 3];
        let draws = 200;
        for _ in 0..draws {
            let (planes, reasons) = planes_of(&Surface::default(), &beside, scene.rows(&mut rng));
            assert!(reasons.is_empty(), "{reasons:?}");
            let sizes: Vec<usize> = planes.iter().map(|plane| plane.patches.len()).collect();
            whole += usize::from(sizes == [16, 12, 9]);
            assert_eq!(sizes.len(), 3, "{sizes:?}");
            for (n, (plane, wall)) in planes.iter().zip(&walls).enumerate() {
                let error = normal(plane) - wall.normal();
                normals[n].0 += error * error.transpose() / f64::from(draws);
                normals[n].1 += plane.normal_sd_rad.powi(2) / f64::from(draws);
                offsets.push((plane.offset_m - wall.normal().dot(&wall.0)) / plane.offset_sd_m);
                chi2 += plane.chi2 / f64::from(plane.degrees_of_freedom) / 3.0 / f64::from(draws);
                assert_eq!(plane.degrees_of_freedom as usize, plane.patches.len() - 3);
                let angle = walls[0].normal().angle(&wall.normal());
                let tilt = plane.tilt_rad.zip(plane.tilt_sd_rad);
                assert_eq!(tilt.is_some(), n > 0);
                tilts.extend(tilt.map(|(tilt, sd)| (tilt - angle.min(std::f64::consts::PI - angle)) / sd));
            }
        }
        let largest = normals.map(|(drawn, stated)| (drawn.symmetric_eigenvalues().max() / stated).sqrt());
        let (offset, tilt) = (rms(&offsets), rms(&tilts));
        eprintln!(
            "common turn {turn_sd_rad} rad: {whole} of {draws} whole; errors over stated: normals {largest:.2?}, offset {offset:.2}, tilt {tilt:.2}; \
             chi2/dof {chi2:.2}"
        );
        assert!(whole > draws as usize * 9 / 10, "{whole}");
        assert!(largest.iter().all(|ratio| (0.85..1.2).contains(ratio)), "{largest:?}");
        assert!((0.9..1.12).contains(&offset) && (0.88..1.14).contains(&tilt), "{offset} {tilt}");
        // An error that all share does not bend a wall.
        assert!(if turn_sd_rad == 0.0 { (0.93..1.05).contains(&chi2) } else { chi2 < 0.95 }, "{chi2}");
    }
}

/// Groups by hand keep their order; the middle patch of a wall, moved out of it, is the farthest, on the side it was
/// moved to.
#[test]
fn groups_may_be_given_by_hand() {
    let scene = Scene::new(0.0);
    let mut rows = scene.rows(&mut ChaCha8Rng::seed_from_u64(2));
    let out = walls()[2].normal() * -0.02;
    let moved = &mut rows[32];
    (moved.x_m, moved.y_m, moved.z_m) = (moved.x_m + out.x, moved.y_m + out.y, moved.z_m + out.z);
    // Exactly in line.
    for (row, at) in rows.iter_mut().zip(&scene.truth).take(4) {
        (row.x_m, row.y_m, row.z_m) = (at.x, at.y, at.z);
    }
    let groups = vec![(29..=37).rev().collect(), (1..=16).collect(), vec![1, 2, 3, 4], vec![17, 18, 99]];
    let (planes, reasons) = planes_of(&Surface { groups: Some(groups), ..Surface::default() }, &scene.beside(), rows);
    assert_eq!(
        planes.iter().map(|plane| plane.patches.clone()).collect::<Vec<_>>(),
        [(29..=37).collect::<Vec<i32>>(), (1..=16).collect()]
    );
    assert_eq!((planes[0].plane, planes[1].plane), (1, 2));
    assert!(planes[0].farthest == 33 && (-0.03..-0.01).contains(&planes[0].farthest_m), "{:?}", planes[0]);
    assert!(planes[0].chi2 > 30.0 && planes[0].rms_m < 0.01 && planes[1].chi2 < 30.0, "{planes:?}");
    assert!(reasons.len() == 3, "{reasons:?}");
    assert!(reasons[0].contains("the 4 patches of group 3") && reasons[0].contains("in line"), "{reasons:?}");
    assert!(
        reasons[1].contains("patch 99 of group 4") && reasons[2].contains("the 2 patches of group 4"),
        "{reasons:?}"
    );
}

#[test]
fn patches_without_covariance_and_alternatives_are_left_out() {
    let scene = Scene::new(0.0);
    let mut rows = scene.rows(&mut ChaCha8Rng::seed_from_u64(3));
    let image = Patch { x_m: -rows[0].x_m, alternative: 1, ..rows[0].clone() };
    rows[1].cov_yz_m2 = None;
    rows[2] = Patch { cov_xx_m2: Some(0.0), cov_xy_m2: Some(0.0), cov_xz_m2: Some(0.0), ..rows[2].clone() };
    rows.push(image);
    let (planes, reasons) = planes_of(&Surface::default(), &BesideTables::default(), rows.clone());
    assert_eq!(planes[0].patches, [vec![1], (4..=16).collect()].concat());
    assert!(reasons.len() == 2 && reasons[0].contains("patch 2 has no covariance"), "{reasons:?}");
    // Four patches in space have no plane.
    let (planes, reasons) =
        planes_of(&Surface::default(), &BesideTables::default(), [0, 5, 20, 33].map(|n| rows[n].clone()).to_vec());
    assert!(planes.is_empty() && reasons.len() == 1 && reasons[0].contains("no 4 of the 4 patches"), "{reasons:?}");
}

#[test]
fn what_cannot_be_asked_is_refused() {
    let surface = Surface::default();
    let context = surface.context(surface.fields(&campaign(2)), &BesideTables::default());
    let text = context.err().unwrap().to_string();
    assert!(text.contains("campaign `c` is in flatland"), "{text}");
    let groups = |group: Vec<i32>| Surface { groups: Some(vec![vec![1, 2, 3], group]), ..Surface::default() };
    for (group, fix) in
        [(vec![4, 5, 6, 4], "group 2 names a patch twice"), (vec![4, 5], "group 2 has fewer than 3 patches")]
    {
        let Conflict(key, why) = groups(group).conflict().unwrap();
        assert!(key == "groups" && why.contains(fix), "{key}: {why}");
    }
}
