use std::fmt::Write;
use std::path::Path;

use super::*;
use crate::units::{PatchId, time_ps};

/// Mirror points on the line x + 2 y = 1, in beams from the origin, and where these land.
const POINTS: [[f64; 2]; 3] = [[0.0, 0.5], [0.1, 0.45], [0.2, 0.4]];
const ONWARD_M: [f64; 3] = [0.4, 0.5, 0.3];
const SD_PS: f64 = 1.0;

/// Where each beam lands.
fn diffuser() -> Vec<Point> {
    let image = Point::new(0.4, 0.8, 0.0);
    let landed = |(point, onward_m): (&[f64; 2], f64)| {
        let point = Point::new(point[0], point[1], 0.0);
        point + (point - image).normalize() * onward_m
    };
    POINTS.iter().zip(ONWARD_M).map(landed).collect()
}

/// The campaign, mirror points 1 to 3, diffuser points 11 to 13; `more` are keys of `[campaign]`.
fn campaign(more: &str) -> String {
    let mut text = format!("[campaign]\nname = 'c'\ngroup_index = 1.0\ndimensions = 2\n{more}[sensors.s1]\n");
    for (n, ([x, y], d)) in POINTS.iter().zip(diffuser()).enumerate() {
        let (one, ten) = (n + 1, n + 11);
        write!(
            text,
            "[patches.{one}]\nrole = 'mirror'\nray = {{ from = 'laser', direction = [{x}, {y}, 0.0], sd_rad = 0.001 }}\n\
             [patches.{ten}]\nposition_m = [{}, {}, 0.0]\nsd_m = 0.0005\n",
            d.x, d.y
        )
        .unwrap();
    }
    text
}

fn context(campaign: &str) -> Result<Context, StageError> {
    let campaign = Campaign::parse(Path::new("c"), campaign).unwrap();
    let reflect = Reflect::default();
    reflect.context(reflect.fields(&[campaign]), &BesideTables::default())
}

fn onset(lit: PatchId, seen: PatchId, time_ps: f64, amplitude: f64) -> Onset {
    Onset {
        campaign: "c".into(),
        sensor: "s1".into(),
        lit,
        seen,
        rank: 1,
        time_ps,
        time_sd_ps: SD_PS,
        amplitude,
        snr: 100.0,
        covariance: vec![SD_PS * SD_PS],
        ..Onset::default()
    }
}

/// The light of all scans, and some that was scattered before it came to another diffuser point or, earlier and weaker,
/// to the same.
fn onsets() -> Vec<Onset> {
    let all = POINTS.iter().zip(ONWARD_M).zip(diffuser()).enumerate();
    all.flat_map(|(n, ((point, onward_m), diffuser))| {
        let time_ps = time_ps(point[0].hypot(point[1]) + onward_m + diffuser.coords.norm(), 1.0);
        let (lit, seen) = (n as PatchId + 1, n as PatchId + 11);
        let other = 11 + (n as PatchId + 1) % 3;
        [
            onset(lit, seen, time_ps - 300.0, 0.01),
            onset(lit, seen, time_ps, 1.0),
            onset(lit, other, time_ps + 500.0, 0.1),
        ]
    })
    .collect()
}

/// Patches of the best alternative that lie farther than a tenth of a millimetre from where they should.
fn astray(patches: &[Patch]) -> Vec<PatchId> {
    let at = |patch: PatchId| match patch {
        1..=3 => Point::new(POINTS[patch as usize - 1][0], POINTS[patch as usize - 1][1], 0.0),
        _ => diffuser()[patch as usize - 11],
    };
    let is_off = |row: &&Patch| (Point::new(row.x_m, row.y_m, row.z_m) - at(row.patch)).norm() > 1e-4;
    patches.iter().filter(|row| row.alternative == 0).filter(is_off).map(|row| row.patch).collect()
}

#[test]
fn every_method_but_the_papers_finds_the_mirror_and_joint_knows_how_well() {
    let context = context(&campaign("")).unwrap();
    for method in [Method::Joint, Method::VirtualSource, Method::PerRay, Method::EqualDistances] {
        let outcome = Reflect { method }.apply(&context, onsets()).unwrap();
        assert!(outcome.rejections.is_empty(), "{:?}", outcome.rejections);
        let rows = outcome.rows;
        let expected = [(1, "mirror"), (2, "mirror"), (3, "mirror"), (11, "visible"), (12, "visible"), (13, "visible")];
        assert_eq!(rows.iter().map(|row| (row.patch, &*row.kind)).collect::<Vec<_>>(), expected);
        let is_joint = method == Method::Joint;
        assert_eq!(astray(&rows), if method == Method::EqualDistances { vec![1, 2, 3] } else { vec![] }, "{method:?}");
        assert!(rows[..3].iter().all(|row| row.sd_m.is_some() == is_joint && row.onsets == 1));
        assert!(rows[3..].iter().all(|row| row.sd_m.is_some()));
        let [covariances, planes, ambiguities] = &outcome.sides[..] else { panic!("three side tables") };
        let pairs = PatchCovariance::rows(covariances).unwrap();
        assert!(pairs.iter().all(|pair| pair.a < pair.b) && pairs.len() == if is_joint { 15 } else { 0 });
        assert!(Ambiguity::rows(ambiguities).unwrap().is_empty());
        let planes = Plane::rows(planes).unwrap();
        assert_eq!(planes.len(), usize::from(is_joint));
        for plane in planes {
            let root = 5_f64.sqrt();
            assert!((plane.normal_x - 1.0 / root).hypot(plane.normal_y - 2.0 / root) < 1e-6 && plane.normal_z == 0.0);
            assert!((plane.offset_m - 1.0 / root).abs() < 1e-6 && plane.offset_sd_m > 1e-5 && plane.offset_sd_m < 1e-3);
            assert!(rows[0].chi2_dof.unwrap() < 1e-3 && plane.patches == [1, 2, 3]);
        }
    }
}

/// Onsets come modulo the laser's period; a path is no shorter than the straight one.
#[test]
fn periods_are_added_until_light_could_have_come() {
    let period_ps = 3000.0;
    let context = context(&campaign("repetition_ps = 3000.0\n")).unwrap();
    let folded = |onset: Onset| Onset { time_ps: onset.time_ps.rem_euclid(period_ps), ..onset };
    let rows = Reflect::default().apply(&context, onsets().into_iter().map(folded).collect()).unwrap().rows;
    assert!(rows.len() == 6 && astray(&rows).is_empty());
}

#[test]
fn what_is_missing_is_named() {
    let reasons = |text: &str, onsets: Vec<Onset>, method: Method| -> (Vec<PatchId>, String) {
        let outcome = Reflect { method }.apply(&context(text).unwrap(), onsets).unwrap();
        let mirrors = outcome.rows.iter().filter(|row| &*row.kind == "mirror").map(|row| row.patch).collect();
        (mirrors, outcome.rejections.into_iter().map(|rejection| rejection.reason + "\n").collect())
    };
    let text = campaign("");
    let no_ray = text.replace("ray = { from = 'laser', direction = [0.1, 0.45, 0.0], sd_rad = 0.001 }", "");
    let (mirrors, reason) = reasons(&no_ray, onsets(), Method::Joint);
    assert!(
        mirrors == [1, 3] && reason.contains("mirror point 2 has no ray from the laser; give patches.2"),
        "{reason}"
    );
    let lost =
        text.replace(&format!("position_m = [{}, {}, 0.0]\nsd_m = 0.0005\n", diffuser()[2].x, diffuser()[2].y), "");
    let (mirrors, reason) = reasons(&lost, onsets(), Method::Joint);
    assert!(
        mirrors == [1, 2] && reason.contains("diffuser point 13, where the beam over mirror point 3 lands"),
        "{reason}"
    );
    let dark = onsets().into_iter().filter(|onset| onset.lit == 2).collect();
    let (mirrors, reason) = reasons(&text, dark, Method::VirtualSource);
    assert!(
        mirrors.is_empty() && reason.contains("mirror point 1 has no onset") && reason.contains("1 scans are too few"),
        "{reason}"
    );
    let (mirrors, reason) = reasons(&text, Vec::new(), Method::Joint);
    assert!(mirrors.is_empty() && reason.contains("no scan of the mirror is left"), "{reason}");
    let both = onsets().into_iter().map(|onset| Onset { seen: if onset.lit == 2 { 11 } else { onset.seen }, ..onset });
    let (mirrors, reason) = reasons(&text, both.collect(), Method::Joint);
    assert!(mirrors == [1, 3] && reason.contains("shows in diffuser point 11, like another"), "{reason}");
    let early = onsets().into_iter().map(|onset| Onset { time_ps: 0.3 * onset.time_ps, ..onset }).collect();
    let (mirrors, reason) = reasons(&text, early, Method::PerRay);
    assert!(mirrors.is_empty() && reason.contains("mirror point 3: no place on its ray"), "{reason}");
    let refused = context("[campaign]\nname = 'c'\n[sensors.s1]\n").err().unwrap().to_string();
    assert!(refused.contains("no patch of role `mirror`"), "{refused}");
}

/// A diffuser point that an earlier stage knows, with its own covariance.
#[test]
fn diffuser_points_may_come_from_an_earlier_stage() {
    let far = campaign("").replace(&format!("[{}, {}, 0.0]", diffuser()[0].x, diffuser()[0].y), "[-0.4, 0.2, 0.0]");
    let alone = Reflect::default().apply(&context(&far).unwrap(), onsets()).unwrap();
    assert!(!astray(&alone.rows).is_empty() && alone.rows[0].chi2_dof.unwrap() > 10.0);
    let earlier = Reflect::default().apply(&context(&campaign("")).unwrap(), onsets()).unwrap().rows;
    let beside = BesideTables::from([("patches".to_owned(), vec![Patch::to_batch(&earlier[3..4])])]);
    let reflect = Reflect::default();
    let fields = reflect.fields(&[Campaign::parse(Path::new("c"), &far).unwrap()]);
    let rows = reflect.apply(&reflect.context(fields, &beside).unwrap(), onsets()).unwrap().rows;
    assert!(astray(&rows).is_empty());
}
