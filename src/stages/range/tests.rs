use super::*;
use crate::tables::Patch;
use crate::units;
use std::path::Path;

/// Labels of one sensor over these paths, source and sensor at the origin or the sensor `apart_m` aside along x; patch
/// i at (0, 0, i) m.
fn labels(sensor: &str, apart_m: f64, paths: &[&[PatchId]]) -> Vec<Label> {
    let label = |path: &&[PatchId]| {
        let (lit, seen) = (path[0], path[path.len() - 1]);
        let legs: f64 = path.windows(2).map(|leg| f64::from((leg[0] - leg[1]).abs())).sum();
        Label {
            campaign: "c".into(),
            sensor: sensor.into(),
            lit,
            seen,
            rank: 1,
            time_ps: units::time_ps(f64::from(lit) + legs + f64::from(seen).hypot(apart_m), 1.0),
            time_sd_ps: 1.0,
            width_ps: Some(0.0),
            bounces: path.len() as i32,
            path: Some(path.to_vec()),
            probability: 1.0,
            ..Label::default()
        }
    };
    paths.iter().map(label).collect()
}

/// What `range` takes from the campaign of these sensors, by station, and of visible patches 1 to 4.
fn context(sensors: &[(&str, &str)]) -> Result<Context, StageError> {
    context_with(sensors, "")
}

/// The same, with more lines under `[patches.4]`.
fn context_with(sensors: &[(&str, &str)], of_patch_4: &str) -> Result<Context, StageError> {
    let sensor = |(name, station): &(&str, &str)| format!("[sensors.{name}]\nstation = '{station}'\n");
    let text = format!(
        "[campaign]\nname = 'c'\ngroup_index = 1.0\n[stations.laser]\nposition_m = [0.0, 0.0, 0.0]\n[stations.aside]\nposition_m = [0.3, 0.0, 0.0]\n{}{of_patch_4}{}",
        [1, 2, 3, 4].map(|patch| format!("[patches.{patch}]\nrole = 'visible'\n")).concat(),
        sensors.iter().map(sensor).collect::<String>()
    );
    let range = Range::default();
    range.context(range.fields(&[Campaign::parse(Path::new("c"), &text).unwrap()]), &BesideTables::default())
}

fn reasons(outcome: &Outcome<Distance>) -> Vec<&str> {
    outcome.rejections.iter().map(|rejection| rejection.reason.as_str()).collect()
}

#[test]
fn sensors_apart_from_the_laser_are_left_out_and_reported() {
    let paths: [&[PatchId]; 9] = [&[1], &[2], &[3], &[4], &[1, 2], &[2, 3], &[4, 3], &[4, 1, 2], &[1, 4]];
    let alone = labels("near", 0.0, &paths);
    let both = [alone.clone(), labels("aside", 0.3, &paths)].concat();
    let context = context(&[("aside", "aside"), ("near", "laser")]).unwrap();
    let (alone, both) = (Range {}.apply(&context, alone).unwrap(), Range {}.apply(&context, both).unwrap());
    assert_eq!((&alone.rows, alone.rows.len()), (&both.rows, 8));
    for row in &both.rows {
        assert!((row.distance_m - f64::from(row.b - row.a)).abs() < 1e-9, "{row:?}");
    }
    assert!(reasons(&alone).is_empty(), "{:?}", reasons(&alone));
    let [reason] = reasons(&both)[..] else { panic!("{:?}", reasons(&both)) };
    assert!(
        reason.contains("sensor aside") && reason.contains("its 9 onsets") && reason.contains("`refine`"),
        "{reason}"
    );
}

#[test]
fn a_campaign_without_a_sensor_at_the_laser_is_refused() {
    let refused = context(&[("left", "aside"), ("right", "aside")]).unwrap_err().to_string();
    assert!(
        refused.contains("`left` of campaign `c`") && refused.contains("leave out `range` and `embed`"),
        "{refused}"
    );
    let stranger = Range {}.apply(&context(&[("near", "laser")]).unwrap(), labels("other", 0.0, &[&[1]]));
    let refused = stranger.err().unwrap().to_string();
    assert!(refused.contains("`other`") && refused.contains("add [sensors.other]"), "{refused}");
}

/// Patches 1 and 2 lit, 2 to 4 seen: only 2 has a first bounce.
#[test]
fn every_patch_without_first_bounce_is_reported_once() {
    let paths: [&[PatchId]; 5] = [&[2], &[1, 2], &[1, 3], &[2, 3], &[2, 5]];
    let context = context(&[("near", "laser")]).unwrap();
    let outcome = Range {}.apply(&context, labels("near", 0.0, &paths)).unwrap();
    assert_eq!(outcome.rows.iter().map(|row| (row.a, row.b)).collect::<Vec<_>>(), [(0, 2)]);
    let expected = [
        ["patch 1 has no first bounce", "pairs lost: 2", "`refine` still uses them"],
        ["patch 3 has no first bounce", "pairs lost: 2", "capture lit 3, seen 3"],
        ["patch 4 stands in campaign.toml, but no bounce", "capture lit 4, seen 4", "or take it out"],
        ["patch 5 has no first bounce", "pairs lost: 1", "`refine` still uses them"],
    ];
    let reasons = reasons(&outcome);
    assert_eq!(reasons.len(), expected.len(), "{reasons:?}");
    for (reason, parts) in reasons.iter().zip(expected) {
        assert!(parts.iter().all(|part| reason.contains(part)), "{reason}");
    }
}

/// An anchor whose own light was gated away: it has no distance, and needs none.
#[test]
fn anchors_without_a_bounce_are_no_fault() {
    let paths: [&[PatchId]; 7] = [&[1], &[2], &[3], &[1, 2], &[1, 3], &[2, 3], &[1, 4]];
    let sensor = [("near", "laser")];
    let of_patch_4 = |more: &str| {
        let context = context_with(&sensor, more).unwrap();
        let outcome = Range {}.apply(&context, labels("near", 0.0, &paths)).unwrap();
        reasons(&outcome).iter().map(ToString::to_string).collect::<Vec<_>>()
    };
    assert_eq!(of_patch_4("position_m = [0.0, 0.0, 4.0]\n"), Vec::<String>::new());
    assert_eq!(of_patch_4("").len(), 1, "without a position it is one");
}

/// Patch 4 has its own bounce and one pair: what is missing is named here, and not where its position is asked for.
#[test]
fn a_patch_with_too_few_pairs_is_named_with_those_that_are_missing() {
    let paths: [&[PatchId]; 8] = [&[1], &[2], &[3], &[4], &[1, 2], &[1, 3], &[2, 3], &[4, 1]];
    let with = |more: &str| {
        let context = context_with(&[("near", "laser")], more).unwrap();
        let outcome = Range {}.apply(&context, labels("near", 0.0, &paths)).unwrap();
        reasons(&outcome).iter().map(ToString::to_string).collect::<Vec<_>>()
    };
    let [reason] = &with("")[..] else { panic!("{:?}", with("")) };
    for part in ["patch 4 has distances to 2 others", "(4, 2) (2, 4) (4, 3) (3, 4)", "capture at least 1 of them"] {
        assert!(reason.contains(part), "{reason}");
    }
    let given = ["position_m = [0.0, 0.0, 4.0]\n", "ray = { from = 'laser', direction = [0.0, 0.0, 1.0] }\n"];
    given.iter().for_each(|more| assert_eq!(with(more), Vec::<String>::new()));
}

/// With `patches`, of which 4 has no place: it is named unless later light shows it.
#[test]
fn a_visible_patch_that_stays_open_is_named_with_the_pairs_that_are_missing() {
    let row = |patch: PatchId| Patch {
        patch,
        kind: "visible".into(),
        z_m: f64::from(patch),
        cov_xx_m2: (patch != 4).then_some(1e-6),
        cov_xy_m2: Some(0.0),
        cov_xz_m2: Some(0.0),
        cov_yy_m2: Some(1e-6),
        cov_yz_m2: Some(0.0),
        cov_zz_m2: Some(1e-6),
        ..Patch::default()
    };
    let rows: Vec<Patch> = (1..=4).map(row).collect();
    let with = |paths: &[&[PatchId]]| {
        let beside = BesideTables::from([("patches".to_owned(), vec![Patch::to_batch(&rows)])]);
        let text = "[campaign]\nname = 'c'\ngroup_index = 1.0\n[sensors.near]\n";
        let range = Range::default();
        let campaign = Campaign::parse(Path::new("c"), text).unwrap();
        let context = range.context(range.fields(&[campaign]), &beside).unwrap();
        let outcome = range.apply(&context, labels("near", 0.0, paths)).unwrap();
        reasons(&outcome).iter().map(ToString::to_string).collect::<Vec<_>>()
    };
    let [reason] = &with(&[&[1], &[2], &[3], &[4], &[1, 2], &[4, 1]])[..] else { panic!("one is open") };
    for part in ["patch 4 stays open", "pairs with light: 1)", "(4, 2) (2, 4) (4, 3) (3, 4);"] {
        assert!(reason.contains(part), "{reason}");
    }
    assert_eq!(with(&[&[1], &[2], &[3], &[4], &[1, 2], &[4, 1], &[2, 4, 3]]), Vec::<String>::new());
}
