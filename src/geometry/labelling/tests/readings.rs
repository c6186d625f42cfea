//! Wide arrivals read as one pulse or as two.

use super::*;
use crate::labelling::{Pair, Verdict};

/// The third patch lies between the first and the second, so that the detour over it is 90 ps behind the direct way.
const ROOM: [[f64; 3]; 5] = [[0.0, 0.0, 2.0], [0.6, 0.1, 1.8], [0.3, 0.143, 1.9], [-0.7, 0.4, 1.5], [-0.5, -0.6, 1.6]];
const SD_PS: f64 = 1.0;
const SEARCH: Options = Options {
    bounces: 3,
    probability_min: 0.95,
    clutter_per_ns: 0.05,
    near_m: 0.0,
    hidden: HiddenPatches::None,
    false_alarm: 1e-3,
    blend_ps: 100.0,
};

fn point(patch: PatchId) -> Point {
    Point::from(ROOM[patch as usize - 1])
}

fn time_ps(path: &[PatchId]) -> f64 {
    let (mut at, mut length_m) = (Point::origin(), 0.0);
    for patch in path {
        length_m += (point(*patch) - at).norm();
        at = point(*patch);
    }
    units::time_ps(length_m + at.coords.norm(), 1.0)
}

fn scene() -> Scene {
    let patches = (1..=ROOM.len() as PatchId).map(|patch| (patch, (point(patch), 1e-9 * Matrix3::identity())));
    Scene::new(&patches.collect(), &BTreeMap::new(), Footprints::default(), BTreeMap::new())
}

/// A wide arrival `late_ps` behind `at_ps`, that may be two pulses at these times.
fn wide(at_ps: f64, width_ps: f64, times_ps: [f64; 2], gain: f64) -> Arrival {
    let pair = Pair { times_ps, covariance_ps2: [36.0, 20.0, 36.0], snrs: [30.0, 30.0], gain };
    Arrival { width_ps, width_sd_ps: 2.0, pair: Some(pair), ..Arrival::point(at_ps, SD_PS, 60.0) }
}

/// All profiles: first bounces as wide as given, second ones as points, but for that of 1 and 2.
fn profiles(own_width_ps: f64, of_pair: Arrival) -> Vec<SensorProfiles> {
    let of = |lit: PatchId, seen: PatchId| {
        let direct = if lit == seen { vec![lit] } else { vec![lit, seen] };
        let at_ps = time_ps(&direct);
        let arrival = match (lit, seen) {
            (1, 2) => of_pair,
            _ if own_width_ps > 0.0 => wide(at_ps, own_width_ps, [at_ps - own_width_ps, at_ps + own_width_ps], 0.0),
            _ => Arrival::point(at_ps, SD_PS, 60.0),
        };
        Profile { lit, seen, delay_ps: 0.0, delay_sd_ps: 0.0, arrivals: vec![arrival] }
    };
    let patches = 1..=ROOM.len() as PatchId;
    vec![SensorProfiles {
        medium: Medium { group_index: 1.0, repetition_ps: None },
        source: Point::origin(),
        sensor: Point::origin(),
        dimensions: 3,
        largest_patch: ROOM.len() as PatchId,
        hidden_count: None,
        profiles: patches.clone().flat_map(|lit| patches.clone().map(move |seen| of(lit, seen))).collect(),
    }]
}

/// What the profile of 1 and 2 is read as: parts with their labels, and the readings that are less likely.
fn read(sensors: &[SensorProfiles], scene: Option<&Scene>) -> (Vec<(i32, Verdict)>, Vec<(i32, Verdict)>) {
    let solution = label(sensors, scene, &SEARCH, &Cancel::never());
    let arrivals = solution.arrivals[0][1].iter().zip(&solution.verdicts[0][1]);
    let parts = arrivals.map(|((origin, _), verdicts)| (origin.part, verdicts[0].clone())).collect();
    let losers = &solution.losers[0][1];
    (parts, losers.iter().map(|loser| (loser.origin.part, loser.verdict.clone())).collect())
}

#[test]
fn a_detour_behind_a_second_bounce_is_read_as_two_pulses() {
    let (direct_ps, detour_ps) = (time_ps(&[1, 2]), time_ps(&[1, 3, 2]));
    assert!((50.0..150.0).contains(&(detour_ps - direct_ps)), "{}", detour_ps - direct_ps);
    let times_ps = [direct_ps + 3.0, detour_ps + 4.0];
    let one_ps = 0.7 * direct_ps + 0.3 * detour_ps;
    let sensors = profiles(0.0, wide(one_ps, 45.0, times_ps, 1.0));
    let (parts, losers) = read(&sensors, Some(&scene()));
    let paths: Vec<_> = parts.iter().map(|(part, verdict)| (*part, verdict.path.clone())).collect();
    assert_eq!(paths, [(1, Some(vec![1, 2])), (2, Some(vec![1, 3, 2]))]);
    assert!(parts.iter().all(|(_, verdict)| verdict.probability > 0.95) && losers.len() <= 1, "{parts:?} {losers:?}");
    // Both times err as the pair's do; where patches spread light, each of the two lies too far out.
    for (own_width_ps, most_ps2) in [(0.0, 20.0), (9.0, 15.0)] {
        let sensors = profiles(own_width_ps, wide(one_ps, 45.0, times_ps, 6.0));
        let solution = label(&sensors, Some(&scene()), &SEARCH, &Cancel::never());
        let with_other_ps2: Vec<f64> =
            solution.arrivals[0][1].iter().map(|(origin, _)| origin.with_other_ps2).collect();
        assert_eq!(with_other_ps2.len(), 2, "{own_width_ps}");
        assert!(with_other_ps2.iter().all(|ps2| *ps2 <= most_ps2), "{own_width_ps}: {with_other_ps2:?}");
        assert!(own_width_ps > 0.0 || with_other_ps2 == [20.0, 20.0], "{with_other_ps2:?}");
    }
}

#[test]
fn light_that_patches_spread_is_read_as_one_pulse() {
    let direct_ps = time_ps(&[1, 2]);
    for gain in [-2.0, 0.0, 4.0] {
        let arrival = wide(direct_ps + 0.8, 40.0, [direct_ps - 38.0, direct_ps + 41.0], gain);
        let (parts, _) = read(&profiles(30.0, arrival), Some(&scene()));
        assert_eq!(parts.len(), 1, "{gain}: {parts:?}");
        assert_eq!((parts[0].0, parts[0].1.path.as_deref()), (0, Some(&[1, 2][..])));
    }
}

/// No predicted path is where the second pulse is, and no patch is as large as that: two pulses all the same, one of
/// them open.
#[test]
fn a_width_that_no_patch_has_is_two_pulses() {
    let direct_ps = time_ps(&[1, 2]);
    let arrival = wide(direct_ps + 15.0, 60.0, [direct_ps + 1.0, direct_ps + 140.0], 15.0);
    let (parts, losers) = read(&profiles(0.0, arrival), Some(&scene()));
    let paths: Vec<_> = parts.iter().map(|(part, verdict)| (*part, verdict.path.clone())).collect();
    assert_eq!(paths, [(1, Some(vec![1, 2])), (2, None)], "{losers:?}");
}

/// Without patches first bounces stay where they are; second ones are read by widths, their error covers both.
#[test]
fn without_a_scene_the_error_of_first_light_covers_both_readings() {
    let (direct_ps, detour_ps) = (time_ps(&[1, 2]), time_ps(&[1, 3, 2]));
    let one_ps = 0.5 * (direct_ps + detour_ps);
    for (own_width_ps, parts) in [(0.0, 2), (40.0, 1)] {
        let sensors = profiles(own_width_ps, wide(one_ps, 45.0, [direct_ps, detour_ps], 4.0));
        let solution = label(&sensors, None, &Options { bounces: 2, ..SEARCH }, &Cancel::never());
        let arrivals = &solution.arrivals[0][1];
        assert_eq!(arrivals.len(), parts, "{arrivals:?}");
        let (first, moved_ps) = (arrivals[0].1, one_ps - direct_ps);
        assert!(first.sd_ps > SD_PS && first.sd_ps < moved_ps);
        assert_eq!(solution.arrivals[0][0][0].1, sensors[0].profiles[0].arrivals[0]);
    }
}

/// Where nothing is wide, readings change nothing.
#[test]
fn points_are_read_as_they_are() {
    let sensors = profiles(0.0, Arrival::point(time_ps(&[1, 2]), SD_PS, 60.0));
    let solution = label(&sensors, Some(&scene()), &SEARCH, &Cancel::never());
    for (profile, arrivals) in sensors[0].profiles.iter().zip(&solution.arrivals[0]) {
        let whole: Vec<Arrival> = arrivals.iter().map(|(_, arrival)| *arrival).collect();
        assert_eq!(whole, profile.arrivals);
        assert!(arrivals.iter().all(|(origin, _)| origin.part == 0));
    }
    assert!(solution.losers[0].iter().all(Vec::is_empty));
}

/// The profile of a patch that is lit and seen whose pulse has a shape of its own, fitted as a wide one and a point.
#[test]
fn a_first_bounce_of_odd_shape_is_one_arrival() {
    let first_ps = time_ps(&[2]);
    let part = |late_ps: f64, amplitude: f64, width_ps: f64| Arrival {
        amplitude,
        blended: true,
        width_ps,
        ..Arrival::point(first_ps + late_ps, 2.0, 20.0)
    };
    for with_scene in [false, true] {
        let mut sensors = profiles(0.0, Arrival::point(time_ps(&[1, 2]), SD_PS, 60.0));
        let own = sensors[0].profiles.iter_mut().position(|profile| (profile.lit, profile.seen) == (2, 2)).unwrap();
        let later = Arrival { amplitude: 0.05, ..Arrival::point(time_ps(&[2, 4, 2]), SD_PS, 60.0) };
        sensors[0].profiles[own].arrivals = vec![part(-15.0, 0.8, 35.0), part(60.0, 0.2, 0.0), later];
        let scene = with_scene.then(scene);
        let solution = label(&sensors, scene.as_ref(), &SEARCH, &Cancel::never());
        let arrivals: Vec<(usize, Arrival)> =
            solution.arrivals[0][own].iter().map(|(origin, arrival)| (origin.onset, *arrival)).collect();
        assert_eq!(arrivals.iter().map(|(onset, _)| *onset).collect::<Vec<_>>(), [0, 2], "{arrivals:?}");
        let first = arrivals[0].1;
        assert!((first.time_ps - first_ps).abs() < 1e-9 && first.amplitude == 1.0, "{first:?}");
        assert!((1.0..2.0).contains(&first.sd_ps) && (40.0..50.0).contains(&first.width_ps), "{first:?}");
        assert_eq!(solution.verdicts[0][own][0][0].path, Some(vec![2]));
        // The part keeps a row, without a path.
        let losers = &solution.losers[0][own];
        assert!(losers.len() == 1 && losers[0].origin.onset == 1 && losers[0].verdict.path.is_none(), "{losers:?}");
    }
}

/// A second bounce and the third one behind it give one arrival between both, which neither explains: nothing says that
/// the pair is dark, so that third bounces over it keep their paths.
#[test]
fn a_pair_whose_light_may_be_blended_is_not_dark() {
    let between_ps = 0.7 * time_ps(&[1, 2]) + 0.3 * time_ps(&[1, 3, 2]);
    for (at_ps, is_open) in [(between_ps, true), (time_ps(&[1, 2]) + 400.0, false)] {
        let mut sensors = profiles(0.0, Arrival::point(at_ps, SD_PS, 60.0));
        for profile in &mut sensors[0].profiles {
            let (lit, seen) = (profile.lit, profile.seen);
            if (lit, seen) == (2, 1) {
                profile.arrivals = vec![Arrival::point(at_ps, SD_PS, 60.0)];
            }
            if (lit, seen) == (4, 2) {
                profile.arrivals.push(Arrival::point(time_ps(&[4, 1, 2]), SD_PS, 60.0));
            }
        }
        let solution = label(&sensors, Some(&scene()), &SEARCH, &Cancel::never());
        let place = |lit, seen| sensors[0].profiles.iter().position(|one| (one.lit, one.seen) == (lit, seen)).unwrap();
        let of_third = &solution.verdicts[0][place(4, 2)][1][0];
        assert_eq!(of_third.path, is_open.then(|| vec![4, 1, 2]), "{at_ps}");
    }
}

/// Third bounces show a visible patch 5 mm from where its own second bounces put it. That is no hidden patch.
#[test]
fn a_hidden_patch_beside_a_visible_one_is_that_patch() {
    let patches = 1..=ROOM.len() as PatchId;
    let mut sensors = profiles(0.0, Arrival::point(time_ps(&[1, 2]), SD_PS, 60.0));
    for profile in &mut sensors[0].profiles {
        let (lit, seen) = (profile.lit, profile.seen);
        let over = patches.clone().filter(|over| ![lit, seen].contains(over));
        profile.arrivals.extend(over.map(|over| Arrival::point(time_ps(&[lit, over, seen]), SD_PS, 60.0)));
    }
    let wrong = |patch: PatchId| if patch == 4 { point(4) + Vector3::new(0.003, -0.004, 0.0) } else { point(patch) };
    let scene = Scene::new(
        &patches.map(|patch| (patch, (wrong(patch), 1e-9 * Matrix3::identity()))).collect(),
        &BTreeMap::new(),
        Footprints::default(),
        BTreeMap::new(),
    );
    let options = Options { hidden: HiddenPatches::Search, ..SEARCH };
    let solution = label(&sensors, Some(&scene), &options, &Cancel::never());
    assert!(solution.hypotheses.iter().all(|one| one.patch.is_none()), "{:?}", solution.hypotheses);
    let paths = solution.verdicts[0].iter().flatten().filter_map(|verdicts| verdicts[0].path.as_ref());
    let over_4 = paths.filter(|path| path.len() == 3 && path[1] == 4).count();
    assert!(over_4 >= 14, "{over_4} of 16");
}
