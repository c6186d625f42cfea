//! Study: hidden patches from unlabelled third bounces. Prints the tables of docs/accuracy.md, "Around the corner".
//!
//! `cargo bench --bench corner` for all, `cargo bench --bench corner -- cells` for one of cells, patterns, relief,
//! clutter, blends, large; a number sets the scenes.

use std::time::Instant;

use periscope::geometry::Point;
use periscope::geometry::hidden::{Arrival, Focus, Profile, Room, find};
use periscope::units;

#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../src/geometry/hidden/tests/scene.rs"]
mod scene;
#[allow(dead_code, reason = "other studies use more of it")]
#[path = "resolution/score.rs"]
mod score;

use scene::{Clutter, Drawn, Pattern, Setting, Walls, draw};
use score::Rate;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    let scenes: Option<u64> = arguments.iter().find_map(|argument| argument.parse().ok());
    let names: Vec<&String> = arguments.iter().filter(|argument| argument.parse::<u64>().is_err()).collect();
    let is_selected = |name: &str| names.is_empty() || names.iter().any(|given| *given == name);
    if is_selected("cells") {
        cells(scenes);
    }
    if is_selected("patterns") {
        patterns(scenes.unwrap_or(100));
    }
    if is_selected("relief") {
        relief(scenes.unwrap_or(100));
    }
    if is_selected("clutter") {
        clutter(scenes.unwrap_or(100));
    }
    if is_selected("blends") {
        blends(scenes.unwrap_or(100));
    }
    if is_selected("large") {
        large(scenes.unwrap_or(10));
    }
}

fn sd_m(sd_ps: f64) -> f64 {
    units::path_m(sd_ps, 1.0)
}

/// Scenes of one setting.
struct Row {
    right: Rate,
    missed: usize,
    extra: usize,
    hidden: usize,
    squares_m2: [f64; 2],
    rank: Rate,
    seconds: f64,
}

fn row(setting: &Setting, scenes: u64) -> Row {
    row_with(setting, scenes, |_| ())
}

/// With the room changed before the search.
fn row_with(setting: &Setting, scenes: u64, change: impl Fn(&mut Room)) -> Row {
    let (mut rights, mut ranks) = (0, 0);
    let (mut missed, mut extra, mut squares_m2, mut seconds) = (0, 0, [0.0; 2], 0.0);
    for seed in 0..scenes {
        let mut drawn = draw(setting, seed);
        change(&mut drawn.room);
        let start = Instant::now();
        let solution = find(&drawn.profiles, &drawn.room);
        seconds += start.elapsed().as_secs_f64();
        let points: Vec<Point> = solution.patches.iter().map(|hidden| hidden.point).collect();
        let score = scene::score(&drawn, &points);
        rights += usize::from(score.is_right());
        ranks += usize::from(is_ordered(&drawn));
        missed += score.missed;
        extra += score.extra;
        (0..2).for_each(|k| squares_m2[k] += score.squares_m2[k]);
    }
    let rate = |hits| Rate { hits, of: scenes as usize };
    let hidden = setting.hidden * scenes as usize;
    Row { right: rate(rights), missed, extra, hidden, squares_m2, rank: rate(ranks), seconds: seconds / scenes as f64 }
}

/// Whether labels by order of arrival are right: the same hidden patches in the same order in every profile, nothing
/// missing and nothing false.
fn is_ordered(drawn: &Drawn) -> bool {
    let is_whole =
        |sources: &Vec<Option<usize>>| sources.len() == drawn.hidden.len() && sources.iter().all(Option::is_some);
    drawn.sources.iter().all(is_whole) && drawn.sources.windows(2).all(|pair| pair[0] == pair[1])
}

const HEAD: &str =
    "scenes | right [95 %] | patches missed | extra | rms / bound | bound (mm) | by order of arrival right";

fn print(name: &str, row: &Row) {
    let [error_m2, bound_m2] = row.squares_m2;
    println!(
        "| {name} | {} | {} | {} of {} | {} | {:.2} | {:.2} | {:.2} |",
        row.right.of,
        row.right,
        row.missed,
        row.hidden,
        row.extra,
        (error_m2 / bound_m2).sqrt(),
        1e3 * (bound_m2 / (row.hidden - row.missed) as f64).sqrt(),
        row.rank.share(),
    );
}

/// 8 visible patches on two walls.
fn cells(scenes: Option<u64>) {
    println!("\n| hidden | noise (ps) | missing / spurious | {HEAD} |\n|---|---|---|---|---|---|---|---|---|---|");
    for hidden in [1, 2, 4, 8] {
        for noise_ps in [5.0, 25.0, 100.0] {
            for (missing, spurious) in [(0.0, 0), (0.1, 1), (0.3, 4)] {
                let many = hidden > 1 && noise_ps == 25.0 && spurious == 4;
                let setting = Setting::new(8, hidden, sd_m(noise_ps), missing, spurious);
                let row = row(&setting, scenes.unwrap_or(if many { 300 } else { 100 }));
                print(&format!("{hidden} | {noise_ps} | {:.0} % / {spurious}", 100.0 * missing), &row);
            }
        }
    }
}

/// Other sets of visible patches and profiles, at 25 ps.
fn patterns(scenes: u64) {
    println!("\n| what | {HEAD} |\n|---|---|---|---|---|---|---|---|");
    for (missing, spurious) in [(0.1, 1), (0.3, 4)] {
        for hidden in [2, 4, 8] {
            let base = Setting::new(8, hidden, sd_m(25.0), missing, spurious);
            let rows = [
                ("8 visible, none of one patch lit and seen", Setting { pattern: Pattern::NoneOwn, ..base }),
                ("16 lit, 4 others seen", Setting { visible: 20, pattern: Pattern::Disjoint(16), ..base }),
                ("8 visible on one wall", Setting { walls: Walls::One, ..base }),
                ("flatland, 8 visible", Setting { walls: Walls::Flatland, ..base }),
                ("4 visible", Setting { visible: 4, ..base }),
                ("5 visible", Setting { visible: 5, ..base }),
                ("16 visible", Setting { visible: 16, ..base }),
                ("24 visible", Setting { visible: 24, ..base }),
            ];
            for (name, setting) in rows {
                let name = format!("{name}; {hidden} hidden, {:.0} % / {spurious}", 100.0 * missing);
                print(&name, &row(&setting, scenes));
            }
        }
    }
}

/// One wall with relief to either side, whose front the search does not know: how often the mirror image of a patch is
/// reported, and how often it is the likelier one.
fn relief(scenes: u64) {
    println!(
        "\n| relief (mm) | noise (ps) | patches found | mirror image told | likelier than the patch | neither place right |\n|---|---|---|---|---|---|"
    );
    for noise_ps in [5.0, 25.0] {
        for relief_mm in [0.0, 1.0, 3.0, 10.0, 30.0, 100.0] {
            let base = Setting::new(8, 4, sd_m(noise_ps), 0.1, 1);
            let (mut count, mut rivals, mut behind, mut wrong) = (0, 0, 0, 0);
            for seed in 0..scenes {
                let drawn = draw(&Setting { walls: Walls::Rough(1e-3 * relief_mm), ..base }, seed);
                let solution = find(&drawn.profiles, &drawn.room);
                count += solution.patches.len();
                rivals += solution.rivals.iter().flatten().count();
                // The wall is y = 0, its front y > 0.
                behind += solution.patches.iter().filter(|patch| patch.point.y < 0.0).count();
                let in_front = solution.patches.iter().zip(&solution.rivals).map(|(patch, rival)| match rival {
                    Some(rival) if patch.point.y < 0.0 => rival.point,
                    _ => patch.point,
                });
                let score = scene::score(&drawn, &in_front.collect::<Vec<Point>>());
                wrong += score.missed + score.extra;
            }
            println!("| {relief_mm} | {noise_ps} | {count} of {} | {rivals} | {behind} | {wrong} |", 4 * scenes);
        }
    }
}

/// False arrivals that are not random, at 25 ps.
fn clutter(scenes: u64) {
    println!("\n| what | {HEAD} |\n|---|---|---|---|---|---|---|---|");
    for hidden in [0, 4, 8] {
        let base = Setting::new(8, hidden, sd_m(25.0), 0.1, 1);
        let rows = [
            ("random only", Setting { spurious: 8, ..base }),
            (
                "six undeclared patches, each in a third of the profiles",
                Setting { clutter: Clutter::Furniture, ..base },
            ),
            ("a cable's echo of the direct light", Setting { clutter: Clutter::Echo, ..base }),
            ("a continuous floor", Setting { clutter: Clutter::Floor, ..base }),
        ];
        for (name, setting) in rows {
            print(&format!("{name}; {hidden} hidden"), &row(&setting, scenes));
        }
    }
}

/// Pulses of hidden patches that come closer together make one arrival; at 5 ps.
fn blends(scenes: u64) {
    println!("\n| what | {HEAD} |\n|---|---|---|---|---|---|---|---|");
    for hidden in [4, 8] {
        for merged_ps in [70.0, 150.0, 250.0] {
            let base = Setting::new(8, hidden, sd_m(5.0), 0.1, 1);
            let setting = Setting { merged_m: sd_m(merged_ps), ..base };
            let name = |what: &str| format!("{hidden} hidden, one within {merged_ps} ps, {what}");
            print(&name("blends looked for"), &row(&setting, scenes));
            print(&name("not looked for"), &row_with(&setting, scenes, |room| room.blend_m = 0.0));
        }
    }
}

/// Many hidden patches: how the time grows.
fn large(scenes: u64) {
    println!("\n| what | {HEAD} | s |\n|---|---|---|---|---|---|---|---|---|");
    for (visible, hidden, noise_ps) in [(24, 8, 5.0), (24, 16, 5.0), (24, 32, 5.0), (24, 64, 5.0), (24, 64, 1.0)] {
        let base = Setting::new(visible, hidden, sd_m(noise_ps), 0.1, 1);
        let row = row(&Setting { apart_m: 0.06, ..base }, scenes);
        print(&format!("{visible} visible, {hidden} hidden, {noise_ps} ps"), &row);
        println!("  {:.3} s", row.seconds);
    }
}
