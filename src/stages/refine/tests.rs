mod drift;
mod shared;

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::*;
use crate::cancel::Cancel;
use crate::geometry::footprint::{Footprint, Footprints};
use crate::geometry::{Point, procrustes};
use crate::priors::delays::Latencies;
use crate::stages::refine::context::Rival;
use crate::tables::{Calibration, Name};
use crate::units::{PatchId, time_ps};

/// Standard deviation of an onset.
const SD_PS: f64 = 2.0;
const CAMPAIGN: &str = "[campaign]\nname = 'c'\ngroup_index = 1.0\n[sensors.s1]\n";

/// Twelve patches all around the stations' front, none coplanar with three others.
fn room() -> Vec<Point> {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut place = || Point::new(rng.random_range(-1.0..1.0), rng.random_range(0.6..2.2), rng.random_range(-0.9..0.9));
    (0..12).map(|_| place()).collect()
}

struct Day<'a> {
    points: &'a [Point],
    source: Point,
    sensor: Point,
    rng: ChaCha8Rng,
    labels: Vec<Label>,
}

impl<'a> Day<'a> {
    fn new(points: &'a [Point], seed: u64) -> Self {
        let rng = ChaCha8Rng::seed_from_u64(seed);
        Self { points, source: Point::origin(), sensor: Point::origin(), rng, labels: Vec::new() }
    }

    /// An onset of this path, late by so much.
    fn add(&mut self, path: &[PatchId], sensor: &str, range: Option<&str>, late_ps: f64) {
        let way_m = self.way_m(path);
        let noise: f64 = StandardNormal.sample(&mut self.rng);
        self.labels.push(Label {
            campaign: "c".into(),
            sensor: sensor.into(),
            lit: path[0],
            seen: path[path.len() - 1],
            range: range.map(Name::from),
            rank: 1,
            time_ps: time_ps(way_m, 1.0) + late_ps + SD_PS * noise,
            time_sd_ps: SD_PS,
            width_ps: Some(0.0),
            snr: 100.0,
            bounces: path.len() as i32,
            path: Some(path.to_vec()),
            probability: 1.0,
            ..Label::default()
        });
    }

    /// Length of a path.
    fn way_m(&self, path: &[PatchId]) -> f64 {
        let at = |patch: &PatchId| self.points[*patch as usize - 1];
        let (end, way_m) =
            path.iter().fold((self.source, 0.0), |(from, way_m), patch| (at(patch), way_m + (at(patch) - from).norm()));
        way_m + (self.sensor - end).norm()
    }

    /// First bounces, and second bounces of those pairs that are `open`.
    fn all(mut self, open: impl Fn(PatchId, PatchId) -> bool) -> Self {
        let count = self.points.len() as PatchId;
        for a in 1..=count {
            self.add(&[a], "s1", None, 0.0);
            (1..=count).filter(|&b| b != a && open(a, b)).for_each(|b| self.add(&[a, b], "s1", None, 0.0));
        }
        self
    }
}

fn context(campaign: &str, calibration: Vec<Calibration>) -> Context {
    let campaign = Campaign::parse(Path::new("c"), campaign).unwrap();
    let fields = Refine::default().fields(&[campaign]);
    let latencies = Latencies::new(&calibration);
    let (start, rivals, planes) = (BTreeMap::new(), Vec::new(), Vec::new());
    Context {
        fields,
        start,
        rivals,
        latencies,
        planes,
        widths_ps: BTreeMap::new(),
        calibrated_at: BTreeMap::new(),
        cancel: Cancel::never(),
    }
}

fn latency(range: Option<&str>, sd_ps: f64, common_sd_ps: f64) -> Calibration {
    Calibration {
        campaign: "c".into(),
        sensor: "s1".into(),
        range: range.map(Name::from),
        shots: 1,
        step_ps: 1.0,
        response: vec![1.0_f32].into(),
        latency_sd_ps: sd_ps,
        latency_common_sd_ps: Some(common_sd_ps),
        width_ps: 1.0,
        ..Calibration::default()
    }
}

/// What the stage writes, as rows.
struct SolutionRows {
    patches: Vec<Patch>,
    delays: Vec<Delay>,
    stations: Vec<Station>,
    suspects: Vec<Suspect>,
    fit: Fit,
    ambiguities: Vec<Ambiguity>,
    footprints: Vec<PatchFootprint>,
}

fn refined(context: &Context, labels: Vec<Label>) -> SolutionRows {
    let outcome = Refine::default().apply(context, labels).unwrap();
    assert!(outcome.rejections.is_empty());
    let [_, delays, stations, _, suspects, fits, ambiguities, footprints] = &outcome.sides[..] else {
        panic!("eight side tables")
    };
    SolutionRows {
        patches: outcome.rows,
        delays: Delay::rows(delays).unwrap(),
        stations: Station::rows(stations).unwrap(),
        suspects: Suspect::rows(suspects).unwrap(),
        fit: Fit::rows(fits).unwrap().remove(0),
        ambiguities: Ambiguity::rows(ambiguities).unwrap(),
        footprints: PatchFootprint::rows(footprints).unwrap(),
    }
}

fn points(patches: &[Patch], alternative: i32) -> Vec<Point> {
    let rows = patches.iter().filter(|patch| patch.alternative == alternative);
    rows.map(|patch| Point::new(patch.x_m, patch.y_m, patch.z_m)).collect()
}

#[test]
fn from_nothing_a_room_is_found_in_the_canonical_frame_which_is_said() {
    let room = room();
    let rows = refined(&context(CAMPAIGN, Vec::new()), Day::new(&room, 1).all(|_, _| true).labels);
    let positions = points(&rows.patches, 0);
    assert!(procrustes::rotation(&positions, &room, Point::origin(), true).rms_m < 1e-3);
    assert!(positions[0].y.abs() < 1e-9 && positions[0].z.abs() < 1e-9 && positions[1].z.abs() < 1e-9);
    assert_eq!((&*rows.fit.frame, rows.fit.free_rotations, &*rows.fit.covariance), ("canonical", 3, "exact"));
    assert_eq!(rows.ambiguities.iter().map(|row| &*row.kind).collect::<Vec<_>>(), ["rotation"]);
    assert!(rows.suspects.is_empty() && rows.stations.is_empty());
    assert!((rows.patches[0].chi2_dof.unwrap() - 1.0).abs() < 0.5);
}

#[test]
fn places_that_labels_did_not_take_are_alternatives_where_they_are_about_as_likely() {
    let room = room();
    let labels = Day::new(&room, 1).all(|_, _| true).labels;
    let first = refined(&context(CAMPAIGN, Vec::new()), labels.clone()).patches;
    let elsewhere = Point::new(0.1, 0.2, 0.3);
    let rival = |log_likelihood: f64| Rival { places: BTreeMap::from([(12, elsewhere)]), log_likelihood };
    let with = |rivals: Vec<Rival>| {
        let start = first.iter().map(|row| (row.patch, row.clone())).collect();
        refined(&Context { start, rivals, ..context(CAMPAIGN, Vec::new()) }, labels.clone())
    };
    let rows = with(vec![rival(-3.0_f64.ln()), rival(-20.0)]);
    let of_patch: Vec<&Patch> = rows.patches.iter().filter(|row| row.patch == 12).collect();
    let [best, other] = of_patch[..] else { panic!("{of_patch:?}") };
    assert!((best.probability.unwrap() - 0.75).abs() < 1e-9 && (other.probability.unwrap() - 0.25).abs() < 1e-9);
    assert!((points(&rows.patches, 1)[0] - elsewhere).norm() < 1e-3);
    assert!(rows.ambiguities.iter().any(|row| row.patches == [12] && row.alternative == Some(1)));
    assert!(with(vec![rival(-20.0)]).patches.iter().all(|row| row.alternative == 0 && row.probability == Some(1.0)));
}

#[test]
fn every_range_has_its_own_delay_and_ranges_share_the_error_of_the_known_path() {
    let room = room();
    let mut day = Day::new(&room, 2);
    for a in 1..=12 {
        day.add(&[a], "s1", Some("coarse"), 30.0);
        (1..=12).filter(|&b| b != a).for_each(|b| day.add(&[a, b], "s1", Some("fine"), 36.0));
    }
    let calibration = vec![latency(Some("coarse"), 41.0, 40.0), latency(Some("fine"), 41.0, 40.0)];
    let rows = refined(&context(CAMPAIGN, calibration), day.labels.clone());
    let [coarse, fine] = &rows.delays[..] else { panic!("two delays") };
    assert_eq!((coarse.range.as_deref(), fine.range.as_deref()), (Some("coarse"), Some("fine")));
    for (delay, truth_ps) in [(coarse, 30.0), (fine, 36.0)] {
        assert!((delay.delay_ps - truth_ps).abs() < 4.0 * delay.sd_ps && delay.sd_ps < 41.0, "{delay:?}");
    }
    // The common part hardly shows in times, the difference does.
    let apart_ps = fine.delay_ps - coarse.delay_ps;
    assert!((apart_ps - 6.0).abs() < 6.0, "{apart_ps}");
    // One row of calibration without a range stands for all.
    let rows = refined(&context(CAMPAIGN, vec![latency(None, 50.0, 0.0)]), day.labels);
    assert_eq!((rows.delays.len(), rows.delays[0].range.as_deref()), (1, None));
}

#[test]
fn a_sensor_apart_needs_no_start_and_anchors_rays_and_stations_fix_the_frame() {
    let room = room();
    let sensor = Point::new(0.4, 0.1, 0.2);
    let given = sensor + Vector3::new(0.003, -0.002, 0.004);
    let ray = room[4].coords.normalize();
    let campaign = format!(
        "[campaign]\nname = 'c'\ngroup_index = 1.0\n[stations.laser]\nposition_m = [0.0, 0.0, 0.0]\n[stations.aside]\nposition_m = [{}, {}, {}]\nsd_m = 0.004\n\
         [sensors.s1]\nstation = 'aside'\n[patches.1]\nposition_m = [{}, {}, {}]\nsd_m = 0.001\n[patches.5]\nray = {{ from = 'laser', direction = [{}, {}, {}], sd_rad = 0.001 }}\n",
        given.x, given.y, given.z, room[0].x, room[0].y, room[0].z, ray.x, ray.y, ray.z
    );
    let mut day = Day::new(&room, 3);
    day.sensor = sensor;
    let rows = refined(&context(&campaign, Vec::new()), day.all(|_, _| true).labels);
    assert_eq!((&*rows.fit.frame, rows.fit.free_rotations), ("fixed", 0));
    let off_m = points(&rows.patches, 0).iter().zip(&room).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
    assert!(off_m < 0.01, "{off_m}");
    let [station] = &rows.stations[..] else { panic!("one station is uncertain") };
    let left_m = (Point::new(station.x_m, station.y_m, station.z_m) - sensor).norm();
    assert!(left_m < 3.0 * station.sd_m && station.sd_m < 0.004 * 3_f64.sqrt() && station.moved_m > 0.0);
    assert!(!rows.ambiguities.iter().any(|row| &*row.kind == "rotation"), "{:?}", rows.ambiguities);
}

#[test]
fn what_is_not_determined_is_told_with_its_patches() {
    let room = room();
    // 1 to 5 see one another, as do 6 to 10; 11 sees but two of the second group, 12 but one.
    let open = |a: PatchId, b: PatchId| match (a.min(b), a.max(b)) {
        (a, 11) => a == 6 || a == 7,
        (a, 12) => a == 6,
        (a, b) => (a <= 5) == (b <= 5),
    };
    let rows = refined(&context(CAMPAIGN, Vec::new()), Day::new(&room, 4).all(open).labels);
    let of_kind =
        |kind: &str| -> Vec<&Ambiguity> { rows.ambiguities.iter().filter(|row| &*row.kind == kind).collect() };
    assert_eq!(of_kind("part").iter().map(|row| row.patches.clone()).collect::<Vec<_>>(), [vec![1, 2, 3, 4, 5]]);
    assert_eq!(of_kind("open")[0].patches, [12]);
    let flip = of_kind("flip").into_iter().find(|row| row.patches.contains(&11)).expect("11 has two places");
    assert!(flip.log_likelihood.unwrap().abs() < 3.0);
    let n = flip.alternative.unwrap();
    let places: Vec<&Patch> = rows.patches.iter().filter(|patch| patch.patch == 11).collect();
    assert!(places.iter().any(|patch| patch.alternative == n) && places.iter().any(|patch| patch.alternative == 0));
    let row = |patch: PatchId| rows.patches.iter().find(|row| row.patch == patch && row.alternative == 0).unwrap();
    assert!(row(12).sd_m.is_none() && row(11).sd_m.is_some() && row(3).sd_m.unwrap() < 0.01);
}

/// Three onsets place patch 11. Read as light over one more patch, one of them places it elsewhere; the same of a pair
/// whose patches all others see changes nothing.
#[test]
fn an_onset_that_places_a_patch_by_itself_is_read_the_other_way_too() {
    let room = room();
    let open = |a: PatchId, b: PatchId| a < b && (b < 11 || (b == 11 && a <= 2));
    let place = |patch: PatchId| room[patch as usize - 1];
    // First light and the other neighbour leave patch 11 a circle about the line to that neighbour. Light over patch k
    // in place of the direct light gives another place on it, where such light may be as long.
    let reads = |lit: PatchId, k: PatchId| {
        let axis = nalgebra::Unit::new_normalize(place(3 - lit).coords);
        let longer_m = |degrees: i32| {
            let turned = nalgebra::Rotation3::from_axis_angle(&axis, f64::from(degrees).to_radians()) * place(11);
            (place(k) - place(lit)).norm() + (turned - place(k)).norm() - (place(11) - place(lit)).norm()
        };
        let [least, most] = [f64::min, f64::max].map(|of| (0..360).step_by(5).map(longer_m).fold(longer_m(0), of));
        least < -0.02 && most > 0.02
    };
    let [lit, over] = (1..=2)
        .flat_map(|lit| (3..=10).map(move |over| [lit, over]))
        .find(|[lit, over]| reads(*lit, *over))
        .expect("light over one of eight patches may be as long");
    let read = |lit: PatchId, seen: PatchId| {
        let mut labels = Day::new(&room[..11], 5).all(open).labels;
        let taken = labels.iter().find(|label| label.path.as_deref() == Some(&[lit, seen])).unwrap();
        let path = Some(vec![lit, over, seen]);
        labels.push(Label { bounces: 3, path, probability: 0.3, alternative: 1, ..taken.clone() });
        refined(&context(CAMPAIGN, Vec::new()), labels)
    };
    let rows = read(lit, 11);
    let told = rows.ambiguities.iter().find(|row| &*row.kind == "label").expect("the other reading is told");
    assert_eq!(told.patches, [11]);
    let elsewhere = rows.patches.iter().find(|row| row.patch == 11 && Some(row.alternative) == told.alternative);
    assert!(elsewhere.is_some_and(|row| row.probability.is_some_and(|share| share > 0.0)), "{elsewhere:?}");
    assert!(read(1, 2).ambiguities.iter().all(|row| &*row.kind != "label"));
}

#[test]
fn a_wrong_label_leads_the_suspects_and_an_unchecked_onset_is_among_them() {
    let room = room();
    // 12 has three neighbours and a first bounce: four onsets for three coordinates. 11 has two: nothing checks them.
    let open = |a: PatchId, b: PatchId| (a < b) && (b < 11 || (b == 11 && a <= 2) || (b == 12 && a <= 3));
    let mut labels = Day::new(&room, 5).all(open).labels;
    let wrong = labels.iter().position(|label| label.path.as_deref() == Some(&[2, 7])).unwrap();
    labels[wrong].time_ps += 400.0;
    let rows = refined(&context(CAMPAIGN, Vec::new()), labels);
    let worst = &rows.suspects[0];
    assert_eq!((worst.path.as_slice(), &*worst.reason), ([2, 7].as_slice(), "left-out"));
    assert!(worst.studentised.unwrap().abs() > 50.0);
    assert!(!rows.ambiguities.iter().any(|row| &*row.kind == "doubtful"), "one wrong onset moves nobody");
    let unchecked: Vec<&Suspect> = rows.suspects.iter().filter(|row| &*row.reason == "unchecked").collect();
    assert!(unchecked.iter().any(|row| row.path == [11]) && unchecked.iter().all(|row| row.path.contains(&11)));
}

/// Of the seven neighbours that place a patch, four have light that comes 400 ps late both ways: what contradicts the
/// rest is left out, and who is right, nothing tells. Two such neighbours move nobody.
#[test]
fn a_patch_that_left_out_onsets_would_place_elsewhere_is_doubtful() {
    let room = room();
    let open = |a: PatchId, b: PatchId| (a != 12 && b != 12) || a.min(b) <= 7;
    for (late, expected) in [(2, vec![]), (4, vec![vec![12]])] {
        let mut labels = Day::new(&room, 5).all(open).labels;
        for label in &mut labels {
            let path = label.path.as_deref().unwrap();
            let has_late = path.iter().any(|patch| (1..=late).contains(patch));
            if path.len() == 2 && path.contains(&12) && has_late {
                label.time_ps += 400.0;
            }
        }
        let rows = refined(&context(CAMPAIGN, Vec::new()), labels);
        let left_out = rows.suspects.iter().filter(|row| &*row.reason == "left-out").count();
        let doubtful = rows.ambiguities.iter().filter(|row| &*row.kind == "doubtful");
        let doubtful: Vec<Vec<PatchId>> = doubtful.map(|row| row.patches.clone()).collect();
        assert_eq!((left_out, doubtful), (2 * late as usize, expected));
    }
}

#[test]
fn the_laser_period_is_refined_where_light_arrives_in_several() {
    let room = room();
    let (nominal_ps, true_ps) = (5000.0, 5000.4);
    // Ranges that grow with their turns would do for a longer period, were it not for anchors.
    let anchor = |patch: usize| {
        let Point { coords } = room[patch - 1];
        format!("[patches.{patch}]\nposition_m = [{}, {}, {}]\nsd_m = 0.0002\n", coords.x, coords.y, coords.z)
    };
    let anchors: String = (1..=5).map(anchor).collect();
    let campaign = CAMPAIGN.replace("[sensors", "repetition_ps = 5000.0\nrepetition_sd_ps = 0.5\n[sensors") + &anchors;
    let mut labels = Day::new(&room, 6).all(|_, _| true).labels;
    for label in &mut labels {
        label.turns = (label.time_ps / true_ps).floor() as i32;
        label.time_ps += f64::from(label.turns) * (nominal_ps - true_ps);
    }
    assert!(labels.iter().any(|label| label.turns != labels[0].turns));
    let rows = refined(&context(&campaign, Vec::new()), labels);
    let (period_ps, sd_ps) = (rows.fit.repetition_ps.unwrap(), rows.fit.repetition_sd_ps.unwrap());
    assert!((period_ps - true_ps).abs() < 4.0 * sd_ps && sd_ps < 0.4, "{period_ps} {sd_ps}");
}

#[test]
fn a_station_that_no_sensor_stands_at_leaves_the_frame_of_stations_in_line() {
    let room = room();
    let sensor = Point::new(0.5, 0.0, 0.0);
    let campaign = "[campaign]\nname = 'c'\ngroup_index = 1.0\n[stations.laser]\nposition_m = [0.0, 0.0, 0.0]\n[stations.aside]\nposition_m = [0.5, 0.0, 0.0]\n\
                    [stations.door]\nposition_m = [0.0, 3.0, 1.0]\n[sensors.s1]\nstation = 'aside'\n";
    let mut day = Day::new(&room, 8);
    day.sensor = sensor;
    let rows = refined(&context(campaign, Vec::new()), day.all(|_, _| true).labels);
    assert_eq!((&*rows.fit.frame, rows.fit.free_rotations), ("stations", 1));
    // Turning about the line keeps every distance from both stations.
    for (point, truth) in points(&rows.patches, 0).iter().zip(&room) {
        assert!(((point - sensor).norm() - (truth - sensor).norm()).abs() < 0.02, "{point} {truth}");
    }
}

/// A wall as good as flat leaves two places for a hidden patch.
#[test]
fn a_hidden_patch_lies_on_the_laser_s_side_of_its_wall_and_the_other_place_is_told() {
    let at = [(-0.8, -0.5), (-0.5, 0.6), (-0.1, -0.2), (0.2, 0.5), (0.5, -0.6), (0.8, 0.1), (1.1, 0.7), (1.2, -0.3)];
    let side = |n: usize| if n.is_multiple_of(2) { 1e-4 } else { -1e-4 };
    let mut room: Vec<Point> = at.iter().enumerate().map(|(n, (x, z))| Point::new(*x, 2.0 + side(n), *z)).collect();
    room.push(Point::new(0.3, 1.0, 0.2));
    for seed in 0..4 {
        let mut day = Day::new(&room, seed);
        for a in 1..=8 {
            day.add(&[a], "s1", None, 0.0);
            (1..=8).filter(|&b| b != a).for_each(|b| day.add(&[a, b], "s1", None, 0.0));
            (a..=8).for_each(|b| day.add(&[a, 9, b], "s1", None, 0.0));
        }
        let rows = refined(&context(CAMPAIGN, Vec::new()), day.labels);
        let positions = points(&rows.patches, 0);
        let turned = procrustes::rotation(&positions, &room, Point::origin(), true);
        assert!(turned.rms_m < 2e-3, "{} {positions:?}", turned.rms_m);
        let other: Vec<&Patch> = rows.patches.iter().filter(|row| row.alternative > 0 && row.patch == 9).collect();
        assert!(other.len() == 1 && rows.ambiguities.iter().any(|row| &*row.kind == "flip"), "{other:?}");
        assert!((Point::new(other[0].x_m, other[0].y_m, other[0].z_m) - positions[8]).norm() > 1.5);
    }
}

#[test]
fn hidden_patches_are_placed_from_nothing_by_third_bounces_and_kinds_are_told() {
    let room = room();
    let mut day = Day::new(&room, 9);
    for a in 1..=9 {
        day.add(&[a], "s1", None, 0.0);
        (1..=9).filter(|&b| b != a).for_each(|b| day.add(&[a, b], "s1", None, 0.0));
        for hidden in 10..=12 {
            (a..=9).step_by(2).for_each(|b| day.add(&[a, hidden, b], "s1", None, 0.0));
        }
    }
    let campaign = CAMPAIGN.to_owned() + "[patches.12]\nrole = 'mirror'\n";
    let rows = refined(&context(&campaign, Vec::new()), day.labels);
    let kinds: Vec<&str> = rows.patches.iter().map(|patch| &*patch.kind).collect();
    assert_eq!((&kinds[..9], &kinds[9..]), (["visible"; 9].as_slice(), ["hidden", "hidden", "mirror"].as_slice()));
    let positions = points(&rows.patches, 0);
    assert!(procrustes::rotation(&positions, &room, Point::origin(), true).rms_m < 1e-3);
    assert!(rows.patches[9..].iter().all(|patch| patch.sd_m.unwrap() < 0.002));
}

/// A point of the wall whose own light was gated away, met by third bounces alone: given, and so not hidden.
#[test]
fn an_anchor_that_no_label_has_as_lit_or_seen_is_not_hidden() {
    let points = room();
    let mut day = Day::new(&points[..11], 3).all(|_, _| true);
    day.points = &points;
    for path in [[1, 12, 2], [2, 12, 3], [3, 12, 4], [4, 12, 5], [5, 12, 6]] {
        day.add(&path, "s1", None, 0.0);
    }
    let kind = |campaign: &str| {
        let rows = refined(&context(campaign, vec![latency(None, 0.0, 0.0)]), day.labels.clone());
        rows.patches.iter().find(|row| row.patch == 12 && row.alternative == 0).unwrap().kind.to_string()
    };
    let at = points[11];
    let anchor = |role: &str| {
        format!("{CAMPAIGN}[patches.12]\nposition_m = [{:?}, {:?}, {:?}]\nrole = '{role}'\n", at.x, at.y, at.z)
    };
    assert_eq!((kind(CAMPAIGN).as_str(), kind(&anchor("visible")).as_str()), ("hidden", "visible"));
    assert_eq!(kind(&anchor("hidden")), "hidden", "campaign.toml has the last word");
}

/// Onsets twice as far off as they say: their variances are larger by about four, and the fit says so.
#[test]
fn what_the_model_does_not_explain_makes_standard_deviations_larger() {
    let points = room();
    let labels = Day::new(&points, 3).all(|_, _| true).labels;
    let fair = refined(&context(CAMPAIGN, Vec::new()), labels.clone());
    let bold = labels.into_iter().map(|label| Label { time_sd_ps: SD_PS / 2.0, ..label }).collect();
    let widened = refined(&context(CAMPAIGN, Vec::new()), bold);
    assert_eq!((fair.fit.misfit, fair.fit.widened), (1.0, vec![1.0; 4]));
    assert!((2.5..6.0).contains(&widened.fit.widened[1]), "{:?}", widened.fit.widened);
    for (fair, widened) in fair.patches.iter().zip(&widened.patches) {
        let ratio = widened.sd_m.unwrap() / fair.sd_m.unwrap();
        assert!((0.8..1.2).contains(&ratio), "patch {}: {ratio}", fair.patch);
    }
}

/// Tilted disks of six centimetres whose sizes nobody gave: their pulses' widths tell them, and the centres are
/// found.
#[test]
fn widths_of_onsets_tell_footprints() {
    let points = room();
    let at = |patch: &PatchId| points[*patch as usize - 1];
    // Each faces a place between the stations and the other patches.
    let disk = |patch: PatchId| {
        let normal = (Point::new(0.0, 0.8, 0.0) - at(&patch)).normalize();
        (patch, Footprint::exact(normal, 0.06))
    };
    let disks = Footprints((1..=points.len() as PatchId).map(disk).collect());
    let origin = Point::origin();
    let mut labels = Day::new(&points, 3).all(|_, _| true).labels;
    for label in &mut labels {
        let path = label.path.clone().unwrap();
        label.time_ps += time_ps(disks.shift_m(origin, &path, at, origin), 1.0);
        let nodes: Vec<Point> = [origin].into_iter().chain(path.iter().map(at)).chain([origin]).collect();
        let variance_m2 = |(patch, legs): (&PatchId, &[Point])| {
            let slope = (legs[1] - legs[0]).normalize() + (legs[1] - legs[2]).normalize();
            let Footprint { normal, size_m, .. } = disks.0[patch];
            size_m * size_m / 16.0 * (slope.norm_squared() - slope.dot(&normal).powi(2))
        };
        let width_ps = time_ps(path.iter().zip(nodes.windows(3)).map(variance_m2).sum::<f64>().sqrt(), 1.0);
        (label.width_ps, label.width_sd_ps) = (Some(width_ps), Some(0.05 * width_ps));
    }
    let solution = refined(&context(CAMPAIGN, Vec::new()), labels.clone());
    assert_eq!(solution.footprints.len(), points.len());
    for row in &solution.footprints {
        assert!((0.054..0.066).contains(&row.size_m) && &*row.source == "widths", "{row:?}");
    }
    let without = labels.into_iter().map(|label| Label { width_ps: None, width_sd_ps: None, ..label }).collect();
    let as_points = refined(&context(CAMPAIGN, Vec::new()), without);
    assert!(as_points.footprints.is_empty());
    let off_m2 = |rows: &[Patch]| {
        let found = |n: usize| Point::new(rows[n].x_m, rows[n].y_m, rows[n].z_m);
        let pairs = (0..points.len()).flat_map(|a| (0..a).map(move |b| (a, b)));
        let off_m = |(a, b)| (found(a) - found(b)).norm() - (points[a] - points[b]).norm();
        pairs.map(|pair: (usize, usize)| off_m(pair).powi(2)).sum::<f64>()
    };
    let off_m2 = [&solution, &as_points].map(|one| off_m2(&one.patches));
    assert!(off_m2[0] < 0.7 * off_m2[1], "{off_m2:?}");
}
