use super::search::Legs;
mod layers;
mod scene;

use super::*;
use crate::units;
use nalgebra::Rotation3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::{Clutter, Pattern, Setting, Walls, draw, score};

/// Standard deviation of a length, for an onset timed to `sd_ps`.
fn sd_m(sd_ps: f64) -> f64 {
    units::path_m(sd_ps, 1.0)
}

fn points(solution: &Solution) -> Vec<Point> {
    solution.patches.iter().map(|hidden| hidden.point).collect()
}

/// The short version of `cargo bench --bench corner`.
#[test]
fn all_are_found_and_nothing_else() {
    let base = Setting::new(8, 4, sd_m(25.0), 0.3, 4);
    let settings = [
        base,
        Setting { hidden: 8, onset_sd_m: sd_m(5.0), ..base },
        Setting { pattern: Pattern::NoneOwn, ..base },
        Setting { visible: 20, hidden: 8, pattern: Pattern::Disjoint(16), missing: 0.1, spurious: 1, ..base },
        Setting { walls: Walls::One, ..base },
        Setting { walls: Walls::Flatland, missing: 0.1, spurious: 1, ..base },
        Setting { clutter: Clutter::Echo, missing: 0.1, spurious: 1, ..base },
        Setting { clutter: Clutter::Floor, missing: 0.1, spurious: 1, ..base },
        Setting { clutter: Clutter::Floor, hidden: 0, ..base },
        Setting { onset_sd_m: sd_m(100.0), missing: 0.1, spurious: 1, ..base },
    ];
    for setting in settings {
        for seed in 0..3 {
            let drawn = draw(&setting, seed);
            let result = score(&drawn, &points(&find(&drawn.profiles, &drawn.room)));
            assert!(result.is_right(), "{setting:?}, seed {seed}: {result:?}");
        }
    }
}

/// Where pulses up to 250 ps apart are one, most arrivals are several.
#[test]
fn blended_arrivals_hide_no_patch_and_make_none_up() {
    let setting = Setting { merged_m: sd_m(250.0), ..Setting::new(8, 8, sd_m(5.0), 0.1, 1) };
    let (mut with, mut without) = (0, 0);
    for seed in 0..4 {
        let drawn = draw(&setting, seed);
        let wrong = |room: &Room| {
            let score = score(&drawn, &points(&find(&drawn.profiles, room)));
            score.missed + score.extra
        };
        with += wrong(&drawn.room);
        without += wrong(&Room { blend_m: 0.0, ..drawn.room.clone() });
    }
    eprintln!("wrong patches of 32: {with}; where blends are not looked for {without}");
    assert!(with == 0 && without >= 3, "{with} {without}");
}

/// Five of eight patches are small or turned away: a quarter of the profiles shows what is hidden.
#[test]
fn patches_that_show_over_few_others_are_found() {
    let base = Setting { dark: 5, ..Setting::new(8, 2, sd_m(8.0), 0.1, 0) };
    for setting in [base, Setting { merged_m: sd_m(100.0), ..base }, Setting { spurious: 1, ..base }] {
        for seed in 0..4 {
            let drawn = draw(&setting, seed);
            let result = score(&drawn, &points(&find(&drawn.profiles, &drawn.room)));
            assert!(result.is_right(), "{setting:?}, seed {seed}: {result:?}");
        }
    }
}

/// The search's own error bars, visible patches exact.
#[test]
fn covariances_are_as_large_as_the_errors() {
    let (mut squares, mut count) = (0.0, 0.0);
    for seed in 0..20 {
        let drawn = draw(&Setting::new(8, 4, sd_m(5.0), 0.1, 1), seed);
        for hidden in find(&drawn.profiles, &drawn.room).patches {
            let error = drawn.hidden.iter().map(|q| q - hidden.point).min_by(|a, b| a.norm().total_cmp(&b.norm()));
            let error = error.expect("there are hidden patches");
            squares += error.dot(&(hidden.covariance.try_inverse().expect("positions are determined") * error));
            count += 3.0;
        }
    }
    // 80 patches: an rms of 1 is known to 5 %.
    let rms = f64::sqrt(squares / count);
    eprintln!("errors over their standard deviations: {rms:.3} ({count} coordinates)");
    assert!((rms - 1.0).abs() < 0.15, "{rms}");
}

/// Markov's bound on the Bayes factor holds where nothing is hidden.
#[test]
fn where_nothing_is_hidden_nothing_is_found() {
    let setting = Setting::new(8, 0, sd_m(25.0), 0.0, 8);
    let false_ones = (0..30).filter(|&seed| {
        let drawn = draw(&setting, seed);
        let room = Room { false_alarm: 0.1, ..drawn.room };
        !find(&drawn.profiles, &room).patches.is_empty()
    });
    let false_ones = false_ones.count();
    // At most 3 are expected; 8 or more have a probability of 1 %.
    assert!(false_ones < 8, "{false_ones} of 30");
}

#[test]
fn a_known_path_leaves_nothing_to_find() {
    let drawn = draw(&Setting::new(8, 2, sd_m(25.0), 0.0, 0), 1);
    let explained = |profile: &Profile| -> Profile {
        let of_first = {
            let [a, b] = profile.ways[0].foci.map(|focus| drawn.room.foci[focus].point);
            (drawn.hidden[0] - a).norm() + (drawn.hidden[0] - b).norm()
        };
        let explained = vec![Path { length_m: of_first, sd_m: 1e-4, seen: 0.9 }];
        Profile::new(profile.ways[0].foci, profile.arrivals.clone(), explained, profile.span_m)
    };
    let profiles: Vec<Profile> = drawn.profiles.iter().map(explained).collect();
    let solution = find(&profiles, &drawn.room).patches;
    assert!(solution.len() == 1 && (solution[0].point - drawn.hidden[1]).norm() < 0.02, "{solution:?}");
}

/// Paths that are seldom seen come within the error of every arrival, and minimal sets still find the patches. A search
/// of all space among that many arrivals would take long.
#[test]
fn paths_that_are_seldom_seen_hide_no_minimal_set() {
    let mut missed = 0;
    for seed in 0..4 {
        let drawn = draw(&Setting::new(12, 6, sd_m(5.0), 0.1, 1), seed);
        let faint = |profile: &Profile| -> Profile {
            let [low_m, high_m] = profile.span_m;
            let paths = ((high_m - low_m) / sd_m(5.0)) as usize;
            let at = |n: usize| low_m + (n as f64 + 0.5) * sd_m(5.0);
            let explained = (0..paths).map(|n| Path { length_m: at(n), sd_m: 1e-4, seen: 0.1 }).collect();
            Profile::new(profile.ways[0].foci, profile.arrivals.clone(), explained, profile.span_m)
        };
        let profiles: Vec<Profile> = drawn.profiles.iter().map(faint).collect();
        let mut all = Explanation::new(&profiles, &drawn.room, SHOWN).expect("arrivals");
        all.add_seeds(Claims::Likely);
        let result = score(&drawn, &points(&all.solution()));
        assert!(result.extra == 0, "seed {seed}: {result:?}");
        missed += result.missed;
    }
    // A set with an arrival that is missing leads nowhere.
    eprintln!("minimal sets miss {missed} of 24");
    assert!(missed <= 3, "{missed}");
}

/// Numbers of profiles and the order of arrivals do not matter, nor how the scene lies in the frame.
#[test]
fn a_turned_scene_gives_the_turned_answer() {
    let drawn = draw(&Setting::new(8, 3, sd_m(25.0), 0.1, 1), 4);
    let rotation = Rotation3::from_euler_angles(0.3, -0.7, 1.1);
    let mut room = drawn.room.clone();
    for focus in &mut room.foci {
        *focus = Focus { point: rotation * focus.point, normal: focus.normal.map(|normal| rotation * normal) };
    }
    let mut profiles = drawn.profiles.clone();
    profiles.reverse();
    let (solution, turned) = (find(&drawn.profiles, &drawn.room).patches, find(&profiles, &room).patches);
    assert_eq!(solution.len(), 3);
    for hidden in &solution {
        let gaps = turned.iter().map(|other| (other.point - rotation * hidden.point).norm());
        assert!(gaps.fold(f64::INFINITY, f64::min) < 1e-4, "{solution:?} {turned:?}");
    }
}

/// Compared with a scan of all space.
#[test]
fn branch_and_bound_finds_the_largest_sum() {
    let drawn = draw(&Setting::new(5, 3, sd_m(100.0), 0.2, 2), 2);
    let scene = Explanation::new(&drawn.profiles, &drawn.room, SHOWN).expect("there are arrivals");
    let legs = scene.legs(scene.left());
    let sum = |point: Point| -> f32 {
        let of_legs = |legs: &Legs| {
            let foci = legs.foci.map(|focus| &drawn.room.foci[focus]);
            if !foci.iter().all(|focus| focus.faces(point, 0.0)) {
                return 0.0;
            }
            let length_m: f64 = foci.iter().map(|focus| (point - focus.point).norm()).sum();
            let bin = ((length_m - legs.curve.low_m) / legs.curve.step_m) as usize;
            legs.curve.values.get(bin).copied().unwrap_or(0.0)
        };
        legs.iter().map(of_legs).sum()
    };
    let (mut best, mut at) = (f32::NEG_INFINITY, Point::origin());
    for i in 0..60 {
        for (j, k) in (0..60).flat_map(|j| (0..60).map(move |k| (j, k))) {
            let step = |n: i32| (f64::from(n) + 0.5) / 60.0 * 2.0 * scene.domain.half_m - scene.domain.half_m;
            let point = scene.domain.centre + Vector3::new(step(i), step(j), step(k));
            let value = sum(point);
            if scene.domain.holds(point, 0.0) && value > best {
                (best, at) = (value, point);
            }
        }
    }
    let fine_m = 0.02;
    let cubes = search::search(&drawn.room.foci, &legs, &scene.domain, fine_m, best * 0.8, &Cancel::never());
    assert!(cubes.iter().any(|(centre, bound)| (centre - at).norm() <= fine_m && *bound >= best), "{best} {at}");
}

/// Also near a patch that is known, whose arrivals are claimed and may hide those of another.
#[test]
fn curves_add_up_to_the_likelihood() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for merged_m in [0.0, sd_m(250.0)] {
        let drawn = draw(&Setting { merged_m, ..Setting::new(8, 3, sd_m(25.0), 0.1, 1) }, 7);
        let known = |profile: &Profile| -> Profile {
            let foci = profile.ways[0].foci.map(|focus| drawn.room.foci[focus].point);
            let length_m = foci.iter().map(|focus| (drawn.hidden[0] - focus).norm()).sum();
            let paths = vec![Path { length_m, sd_m: 1e-4, seen: 0.9 }];
            // As if of one seen patch: what shows there shows in all of them.
            Profile::over(0, profile.ways.clone(), profile.arrivals.clone(), paths, profile.span_m)
        };
        let profiles: Vec<Profile> = drawn.profiles.iter().map(known).collect();
        let all = Explanation::new(&profiles, &drawn.room, SHOWN).expect("arrivals");
        let legs = all.legs(all.left());
        for _ in 0..200 {
            let aside = Vector3::from_fn(|_, _| rng.random_range(-0.03..0.03));
            let at = drawn.hidden[rng.random_range(0..2)] + aside;
            let value = |Legs { foci, curve, .. }: &Legs| {
                let length_m: f64 = foci.iter().map(|&focus| (at - drawn.room.foci[focus].point).norm()).sum();
                let place = (length_m - curve.low_m) / curve.step_m;
                let [before, after] = [0, 1].map(|k| f64::from(curve.values[place as usize + k]));
                before + (after - before) * place.fract()
            };
            let sum: f64 = legs.iter().map(value).sum();
            let likelihood = all.view(Surface::Patch, all.left(), SEEN).place(at).likelihood;
            let expected = (1.0 - SHOWN + SHOWN * sum.exp()).ln();
            // A curve is known at every third of a standard deviation.
            assert!((expected - likelihood).abs() < 0.01 * likelihood.abs() + 0.5, "{expected} {likelihood}");
        }
    }
}

/// Through a flat wall that may face either way the mirror image of each patch is as likely; through a rough one it is
/// not.
#[test]
fn a_flat_wall_leaves_two_places() {
    for seed in 0..4 {
        let base = Setting::new(8, 2, sd_m(25.0), 0.1, 1);
        let drawn = draw(&Setting { walls: Walls::Rough(0.0), ..base }, seed);
        let solution = find(&drawn.profiles, &drawn.room);
        assert_eq!((solution.patches.len(), solution.rivals.len()), (2, 2));
        for (hidden, rival) in solution.patches.iter().zip(&solution.rivals) {
            let rival = rival.expect("nothing tells the sides apart");
            let image = Point::new(hidden.point.x, -hidden.point.y, hidden.point.z);
            assert!(
                (rival.point - image).norm() < 1e-4 && (rival.evidence - hidden.evidence).abs() < 1e-3,
                "{rival:?} {hidden:?}"
            );
        }
        let rough = draw(&Setting { walls: Walls::Rough(0.3), ..base }, seed);
        let solution = find(&rough.profiles, &rough.room);
        assert!(
            solution.rivals.iter().all(Option::is_none) && score(&rough, &points(&solution)).is_right(),
            "{solution:?}"
        );
    }
}

/// Compared with the formula, term by term.
#[test]
fn the_likelihood_is_that_of_the_formula() {
    let drawn = draw(&Setting::new(4, 2, sd_m(50.0), 0.2, 2), 3);
    let scene = Explanation::new(&drawn.profiles, &drawn.room, SHOWN).expect("there are arrivals");
    let left = scene.left();
    let view = scene.view(Surface::Patch, left, 0.7);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for _ in 0..20 {
        let q = drawn.hidden[0] + Vector3::from_fn(|_, _| rng.random_range(-0.03..0.03));
        let of_profile = |profile: &Profile| -> f64 {
            let length_m: f64 =
                profile.ways[0].foci.iter().map(|focus| (q - drawn.room.foci[*focus].point).norm()).sum();
            let density = |arrival: &Arrival| {
                let off = (arrival.length_m - length_m) / arrival.sd_m;
                (-0.5 * off * off).exp() / (arrival.sd_m * (2.0 * std::f64::consts::PI).sqrt())
            };
            let sum: f64 = profile.arrivals.iter().map(density).sum();
            (0.3 + 0.7 * sum / scene.clutter_per_m).ln()
        };
        let of_seen = |seen: usize| -> f64 {
            let sum: f64 = drawn.profiles.iter().filter(|profile| profile.watched == seen).map(of_profile).sum();
            (1.0 - SHOWN + SHOWN * sum.exp()).ln()
        };
        let expected: f64 = (0..4).map(of_seen).sum();
        assert!((view.place(q).likelihood - expected).abs() < 1e-3, "{} {expected}", view.place(q).likelihood);
    }
}

#[test]
fn a_climb_ends_where_nothing_is_higher() {
    let drawn = draw(&Setting::new(8, 2, sd_m(25.0), 0.1, 1), 5);
    let scene = Explanation::new(&drawn.profiles, &drawn.room, SHOWN).expect("there are arrivals");
    let left = scene.left();
    let view = scene.view(Surface::Patch, left, SEEN);
    let top = view.climb(drawn.hidden[0] + Vector3::new(0.01, -0.01, 0.01));
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for _ in 0..200 {
        let near = top.point + Vector3::from_fn(|_, _| rng.random_range(-0.003..0.003));
        assert!(view.place(near).likelihood <= top.likelihood + 1e-6);
    }
}

/// The paper's labels by order of arrival need one order for all profiles: one patch has it, eight never.
#[test]
fn the_order_of_arrival_is_the_same_in_all_profiles_only_for_few() {
    let is_same = |hidden: usize, seed: u64| {
        let sources = draw(&Setting::new(8, hidden, sd_m(5.0), 0.0, 0), seed).sources;
        sources.windows(2).all(|pair| pair[0] == pair[1])
    };
    assert!((0..10).all(|seed| is_same(1, seed)) && (0..10).all(|seed| !is_same(8, seed)));
}

/// Patches that only hidden ones show, from fifth bounces over these.
#[test]
fn a_second_layer_is_found_and_nothing_else() {
    for seed in 0..8 {
        let setting = layers::Setting { visible: 5, first: 5, second: 2, sd_m: sd_m(5.0), seen: 0.6, spurious: 10 };
        let drawn = layers::draw(&setting, seed);
        let (missed, extra, _) = layers::score(&drawn, &points(&find_by_minimal_sets(&drawn.profiles, &drawn.room)));
        assert_eq!((missed, extra), (0, 0), "seed {seed}");
    }
}

/// Markov's bound holds for patches that only hidden ones show, too.
#[test]
fn where_there_is_no_second_layer_none_is_found() {
    let setting = layers::Setting { visible: 5, first: 5, second: 0, sd_m: sd_m(25.0), seen: 0.0, spurious: 60 };
    let false_ones = (0..20).filter(|&seed| {
        let drawn = layers::draw(&setting, seed);
        let room = Room { false_alarm: 0.1, ..drawn.room };
        !find_by_minimal_sets(&drawn.profiles, &room).patches.is_empty()
    });
    let false_ones = false_ones.count();
    // At most 2 are expected; 7 or more have a probability of 1 %.
    assert!(false_ones < 7, "{false_ones} of 20");
}

/// Two ways on which a patch would make one and the same arrival do not count it twice.
#[test]
fn an_arrival_is_taken_once() {
    let foci = [Point::new(0.0, 0.0, 0.0), Point::new(1.0, 0.0, 0.0)].map(|point| Focus { point, normal: None });
    let room = Room {
        foci: foci.to_vec(),
        dimensions: 3,
        false_alarm: 1e-2,
        count: None,
        blend_m: 0.0,
        cancel: Cancel::never(),
    };
    let arrival = Arrival { length_m: 2.0, sd_m: 0.01 };
    let at = Point::new(0.5, 0.75_f64.sqrt(), 0.0);
    let likelihood = |ways: usize| {
        let profiles =
            [Profile::over(0, vec![Way::new([0, 1], 0.0, 0.0); ways], vec![arrival], Vec::new(), [0.0, 3.0])];
        let scene = Explanation::new(&profiles, &room, SHOWN).expect("there is an arrival");
        let left = scene.left();
        let likelihood = scene.view(Surface::Patch, left, 0.7).place(at).likelihood;
        (likelihood.exp() - (1.0 - SHOWN)) / SHOWN
    };
    let weight = likelihood(1) - 0.3;
    assert!((likelihood(2) - (0.3 * 0.3 + 2.0 * 0.3 * weight)).abs() < 1e-9);
}
