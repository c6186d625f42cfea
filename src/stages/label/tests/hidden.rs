//! Hidden patches behind and in front of walls.

use super::*;
use crate::stages::stage::Rejection;
use crate::tables::Row;

const HIDDEN: [f64; 3] = [0.3, 1.0, 0.2];
const SD_PS: f64 = 25.0;

/// Visible patches 1 to 8 near the wall y = 2 m, exactly `relief_m` off it to either side in turn. The laser is at the origin.
fn wall(relief_m: f64) -> Vec<Point> {
    let at = [(-0.8, -0.5), (-0.5, 0.6), (-0.1, -0.2), (0.2, 0.5), (0.5, -0.6), (0.8, 0.1), (1.1, 0.7), (1.2, -0.3)];
    let side = |n: usize| if n.is_multiple_of(2) { relief_m } else { -relief_m };
    at.iter().enumerate().map(|(n, (x, z))| Point::new(*x, 2.0 + side(n), *z)).collect()
}

fn beside(points: &[Point]) -> BesideTables {
    let patch = |(n, point): (usize, &Point)| Patch {
        patch: n as i32 + 1,
        kind: "visible".into(),
        x_m: point.x,
        y_m: point.y,
        z_m: point.z,
        cov_xx_m2: Some(1e-8),
        cov_xy_m2: Some(0.0),
        cov_xz_m2: Some(0.0),
        cov_yy_m2: Some(1e-8),
        cov_yz_m2: Some(0.0),
        cov_zz_m2: Some(1e-8),
        sd_m: Some(1.7e-4),
        onsets: 1,
        chi2_dof: None,
        alternative: 0,
        log_likelihood: None,
    };
    let patches: Vec<Patch> = points.iter().enumerate().map(patch).collect();
    BesideTables::from([("patches".to_owned(), vec![Patch::to_batch(&patches)])])
}

/// Labels, hypotheses and what was set aside, of a scene with one hidden patch.
fn searched(points: &[Point], campaign: &Campaign) -> (Vec<Label>, Vec<Hypothesis>, Vec<Rejection>) {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let capture = Capture { sd_ps: SD_PS, ..PLAIN };
    let mut onsets = Vec::new();
    for lit in 1..=points.len() {
        for seen in 1..=points.len() {
            let (a, b) = (points[lit - 1], points[seen - 1]);
            let over = Point::from(HIDDEN);
            let ends_m = a.coords.norm() + b.coords.norm();
            for (n, between_m) in [(a - b).norm(), (a - over).norm() + (b - over).norm()].into_iter().enumerate() {
                let noise: f64 = StandardNormal.sample(&mut rng);
                let time_ps = units::time_ps(ends_m + between_m, 1.0) + SD_PS * noise;
                onsets.push(capture.onset((lit as i32, seen as i32), n as i32 + 1, time_ps, 10.0));
            }
        }
    }
    let stage = LabelOnsets { bounces: 3, ..LabelOnsets::default() };
    let known = stage.context(stage.fields(std::slice::from_ref(campaign)), &beside(points)).unwrap();
    let outcome = stage.apply(&known, onsets).unwrap();
    (outcome.rows, Hypothesis::rows(&outcome.sides[0]).unwrap(), outcome.rejections)
}

fn apart_m(row: &Hypothesis, at: [f64; 3]) -> f64 {
    (Point::new(row.x_m, row.y_m, row.z_m) - Point::from(at)).norm()
}

/// The onsets tell the two places apart the better the rougher the wall is.
#[test]
fn of_two_places_on_either_side_of_a_wall_the_laser_s_is_chosen_and_the_other_told() {
    let [x, y, z] = HIDDEN;
    for relief_m in [0.0, 0.0012] {
        let (_, hypotheses, rejections) = searched(&wall(relief_m), &PLAIN.campaign());
        assert!(rejections.is_empty());
        let found: Vec<&Hypothesis> = hypotheses.iter().filter(|row| row.patch == Some(9)).collect();
        assert!(apart_m(found[0], HIDDEN) < 0.02, "{hypotheses:?}");
        if relief_m == 0.0 {
            // Flat: what lies behind is no choice.
            assert_eq!(found.len(), 1);
        } else {
            assert!(found.len() == 2 && apart_m(found[1], [x, 4.0 - y, z]) < 0.03, "{hypotheses:?}");
            assert_eq!((found[0].alternative, found[1].alternative), (0, 1));
            assert!((found[0].evidence - found[1].evidence).abs() < 9.0);
        }
    }
    let (_, hypotheses, _) = searched(&wall(0.1), &PLAIN.campaign());
    let found: Vec<&Hypothesis> = hypotheses.iter().filter(|row| row.patch == Some(9)).collect();
    assert!(found.len() == 1 && apart_m(found[0], HIDDEN) < 0.02, "{hypotheses:?}");
}

#[test]
fn about_visible_patches_in_line_nothing_is_looked_for_and_that_is_said() {
    let line: Vec<Point> = (0..8).map(|n| Point::new(-0.8 + 0.25 * f64::from(n), 2.0, 0.1 * f64::from(n))).collect();
    let (labels, hypotheses, rejections) = searched(&line, &PLAIN.campaign());
    assert!(hypotheses.is_empty());
    assert!(rejections.len() == 1 && rejections[0].reason.contains("lie in one line"), "{rejections:?}");
    let direct = labels.iter().filter(|label| label.path.as_ref().is_some_and(|path| path.len() <= 2)).count();
    assert!(direct > 50, "{direct} of 64");
}

/// A floor that nobody declared throws light from each patch to each other.
#[test]
fn a_floor_is_a_plane_and_no_patches() {
    let points = wall(0.3);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let capture = Capture { sd_ps: SD_PS, ..PLAIN };
    let mut onsets = Vec::new();
    for lit in 1..=points.len() {
        for seen in 1..=points.len() {
            let (a, b) = (points[lit - 1], points[seen - 1]);
            let below = Point::new(a.x, a.y, -3.0 - a.z);
            for (n, between_m) in [(a - b).norm(), (below - b).norm()].into_iter().enumerate() {
                let noise: f64 = StandardNormal.sample(&mut rng);
                let time_ps = units::time_ps(a.coords.norm() + between_m + b.coords.norm(), 1.0) + SD_PS * noise;
                onsets.push(capture.onset((lit as i32, seen as i32), n as i32 + 1, time_ps, 10.0));
            }
        }
    }
    let stage = LabelOnsets { bounces: 3, ..LabelOnsets::default() };
    let known = stage.context(stage.fields(&[PLAIN.campaign()]), &beside(&points)).unwrap();
    let outcome = stage.apply(&known, onsets).unwrap();
    let hypotheses = Hypothesis::rows(&outcome.sides[0]).unwrap();
    let planes: Vec<&Hypothesis> = hypotheses.iter().filter(|row| &*row.kind == "plane").collect();
    assert!(planes.len() == 1 && hypotheses.iter().all(|row| row.patch.is_none()), "{hypotheses:?}");
    let (height_m, up) = (planes[0].z_m, planes[0].normal_z.expect("a plane has a normal"));
    assert!((height_m + 1.5).abs() < 0.02 && up > 0.999, "{planes:?}");
}
