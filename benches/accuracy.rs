//! Study: positions over many seeds against the Cramer-Rao bound. Prints the tables of docs/accuracy.md.
//!
//! `cargo bench --bench accuracy` (200 seeds), `cargo bench --bench accuracy -- 20` for fewer; `-- rectangles 200` for
//! the paper's Fig. 4, `-- corner 100` for hidden patches (`-- corner 100 8` for 8 of them alone), `-- readings 20` for
//! wide pulses and pairs (docs/time-resolution.md), `-- readings 20 3000 one` for the choice of the scene alone and
//! seeds from 3000 on (`-- readings 20 3000 one 12 13`: of its table lines 12 and 13, counted from 0);
//! `-- small-rooms 60` for few patches with pairs missing and spurious onsets, 60 rooms of each kind
//! (`-- small-rooms 60 5000 30`: seeds from 5000 on, only with 30 % missing); `-- sizes 20` for patches of centimetres
//! whose sizes nobody gives; `-- locate 20 2000` for small things behind a relay wall (`-- locate 100 5000 14 15`:
//! cells 14 and 15 of the table alone); `-- claims 200 3000` for instruments that are not kind, 200 records a cell
//! (docs/error-bars.md; `-- claims 200 3000 7 8`: cells 7 and 8 alone); `-- drift 40 1000` for delays that drift
//! through a day without fiducials (`-- drift 40 1000 2 3`: cells 2 and 3 alone); `-- ranks 40 1000` for ranks of true
//! positions in what `run` states, over instruments and rooms at random (`-- ranks 40 1000 2`: cell 2 alone);
//! `-- twins 300` for tables b, d, e and f of docs/time-resolution.md through `run`.

#[path = "../tests/it/claims.rs"]
mod claims;
#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../tests/it/corner.rs"]
mod corner;
#[allow(dead_code, unused_imports, reason = "the tests use more of it")]
#[path = "../tests/it/drift.rs"]
mod drift;
#[path = "accuracy/instruments.rs"]
mod instruments;
#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../tests/it/lab.rs"]
mod lab;
#[allow(dead_code, unused_imports, reason = "the tests use more of it")]
#[path = "../tests/it/locate.rs"]
mod locate;
#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../tests/it/missed.rs"]
mod missed;
#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../tests/it/ranks.rs"]
mod ranks;
#[path = "accuracy/ranks.rs"]
mod ranks_table;
#[path = "../tests/it/reading_scene.rs"]
mod reading_scene;
#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../tests/it/readings.rs"]
mod readings;
#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../tests/it/rectangles.rs"]
mod rectangles;
#[path = "../tests/it/relay_scene.rs"]
mod relay_scene;
#[allow(dead_code, reason = "other studies use more of it")]
#[path = "resolution/mod.rs"]
mod resolution;
#[path = "../tests/it/sizes.rs"]
mod sizes;
#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../tests/it/small_rooms.rs"]
mod small_rooms;
#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../tests/it/accuracy.rs"]
mod study;
#[path = "../tests/it/twins.rs"]
mod twins;

use std::ops::Range;
use std::path::Path;

use reading_scene::{Instrument, Setting};
use readings::{Choice, Outcome, outcomes};
use resolution::{information, score, shape};
use score::Rate;
use shape::{Sensor, Shape};
use study::{SCENE, Study, study};
use twins::{Kind, twin};

/// Scenes with hidden patches have 1 to so many, by their seed.
const HIDDEN_MAX: u64 = 6;
const CHOICES: [Choice; 3] = [Choice::Wide, Choice::Points, Choice::Readings];

fn main() {
    let numbers: Vec<u64> = std::env::args().skip(1).filter_map(|arg| arg.parse().ok()).collect();
    let seeds = numbers.first().copied().unwrap_or(200);
    let cells: Vec<usize> = numbers.iter().skip(2).map(|cell| *cell as usize).collect();
    if std::env::args().any(|arg| arg == "rectangles") {
        return print_rectangles(&rectangles::study(rectangles::SCENE, 1000..1000 + seeds));
    }
    if std::env::args().any(|arg| arg == "sizes") {
        return print_sizes(seeds);
    }
    if std::env::args().any(|arg| arg == "twins") {
        return print_twins(seeds as usize);
    }
    if std::env::args().any(|arg| arg == "claims") {
        let first = numbers.get(1).copied().unwrap_or(3000);
        return instruments::print_claims(seeds as usize, first, &cells);
    }
    if std::env::args().any(|arg| arg == "drift") {
        let first = numbers.get(1).copied().unwrap_or(1000);
        return instruments::print_drift(first..first + seeds, &cells);
    }
    if std::env::args().any(|arg| arg == "ranks") {
        let first = numbers.get(1).copied().unwrap_or(1000);
        return ranks_table::print_ranks(&(first..first + seeds), &cells);
    }
    if std::env::args().any(|arg| arg == "locate") {
        let first = numbers.get(1).copied().unwrap_or(1000);
        return print_locate(first..first + seeds, &cells);
    }
    if std::env::args().any(|arg| arg == "small-rooms") {
        let first = numbers.get(1).copied().unwrap_or(1000);
        return print_small_rooms(first..first + seeds, numbers.get(2).copied());
    }
    if std::env::args().any(|arg| arg == "readings") {
        let is_one = std::env::args().any(|arg| arg == "one");
        let first = numbers.get(1).copied().unwrap_or(1000);
        return print_readings(first..first + seeds, if is_one { &[Choice::Readings] } else { &CHOICES }, &cells);
    }
    if std::env::args().any(|arg| arg == "corner") {
        let counts = numbers.get(1).map_or(vec![4, 8], |&hidden| vec![hidden as usize]);
        return print_corner(seeds, &counts);
    }
    print_scenes(seeds);
}

/// Visible patches of several scenes, from scope files.
fn print_scenes(seeds: u64) {
    let scene = |name: &str| {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("pipelines/scenes/{name}.toml"));
        std::fs::read_to_string(path).expect("a scene of ours")
    };
    let cases = [
        ("demo scene", SCENE.to_owned()),
        ("without jitter of the trigger", SCENE.replace("jitter_ps = 80.0", "jitter_ps = 0.0")),
        ("patches of 5 mm in place of 1 mm", SCENE.replace("size_m = 0.001", "size_m = 0.005")),
        ("photodiode", scene("photodiode")),
        ("dome", scene("dome")),
        ("flatland", scene("flatland")),
        ("no-reference", scene("no-reference")),
    ];
    println!(
        "| scene | seeds | rms (mm) | bound (mm) | bound / rms [95 %] | NSE / dof [95 %] | Algorithm 1 (mm) | classical scaling (mm) | onset rms (ps) | onset bound (ps) | onsets found | false onsets |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    let studies: Vec<(&str, Study)> = cases
        .iter()
        .map(|(name, text)| {
            let study = study(text, 1000..1000 + seeds);
            print_row(name, &study);
            (*name, study)
        })
        .collect();
    println!(
        "\n| scene | onsets | within the interval of 50 % | of 68 % | of 95 % | of 99 % |\n|---|---|---|---|---|---|"
    );
    for (name, study) in &studies {
        print_coverage(name, &study.pulls);
    }
}

/// Hidden patches at random places, from scope files.
fn print_corner(seeds: u64, counts: &[usize]) {
    println!(
        "| hidden | scenes | found | extra | within 2 mm of three bounds and half the patch | rms error (mm) | median (mm) | 90 % (mm) | rms bound (mm) | median error over its sd |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    for &hidden in counts {
        let scored: Vec<corner::Scored> = (1000..1000 + seeds).map(|seed| corner::scored(hidden, seed)).collect();
        let places: Vec<corner::Place> = scored.iter().flat_map(|scored| scored.places.clone()).collect();
        let mut errors_mm: Vec<f64> = places.iter().filter_map(|place| Some(1e3 * place.found_m?.0)).collect();
        errors_mm.sort_by(f64::total_cmp);
        let mut pulls: Vec<f64> =
            places.iter().filter_map(|place| place.found_m.map(|(error, sd)| error / sd)).collect();
        pulls.sort_by(f64::total_cmp);
        let squares: Vec<f64> = errors_mm.iter().map(|error| error * error).collect();
        let bounds: Vec<f64> = places.iter().map(|place| (1e3 * place.bound_m).powi(2)).collect();
        let right = Rate { hits: places.iter().filter(|place| place.is_right()).count(), of: places.len() };
        println!(
            "| {hidden} | {seeds} | {} of {} | {} | {right} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} |",
            errors_mm.len(),
            places.len(),
            scored.iter().map(|scored| scored.extra).sum::<usize>(),
            mean(&squares).sqrt(),
            errors_mm[errors_mm.len() / 2],
            errors_mm[errors_mm.len() * 9 / 10],
            mean(&bounds).sqrt(),
            pulls[pulls.len() / 2],
        );
    }
}

/// Patches of centimetres of which campaign.toml gives neither size nor normal.
fn print_sizes(seeds: u64) {
    println!(
        "| patches (cm) | seeds | rms / bound with sizes known | NSE / dof | chi-square / dof | sizes found | rms error of sizes | phantoms |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for size_m in [0.005, 0.01, 0.02, 0.03, 0.05] {
        let outcomes = sizes::outcomes(size_m, 1000..1000 + seeds);
        let mean = |value: fn(&sizes::Outcome) -> f64| outcomes.iter().map(value).sum::<f64>() / seeds as f64;
        println!(
            "| {} | {seeds} | {:.2} | {:.2} | {:.2} | {:.1} of 12 | {:.0} % | {} |",
            100.0 * size_m,
            mean(|one| one.over_bound).sqrt(),
            mean(|one| one.normalised),
            mean(|one| one.chi2_dof),
            mean(|one| one.sizes as f64),
            100.0 * mean(|one| one.size_error.powi(2)).sqrt(),
            outcomes.iter().map(|one| one.phantoms).sum::<usize>()
        );
    }
}

/// Small things behind a relay wall: scenes, how many of them, photons of each in a mean histogram (of an extended
/// object: in all).
const LOCATE: [(&str, usize, f64); 24] = [
    ("dots", 1, 30.0),
    ("dots", 1, 300.0),
    ("dots", 1, 3000.0),
    ("dots", 3, 30.0),
    ("dots", 3, 300.0),
    ("dots", 3, 3000.0),
    ("dots", 6, 30.0),
    ("dots", 6, 300.0),
    ("dots", 6, 3000.0),
    ("dots", 12, 30.0),
    ("dots", 12, 300.0),
    ("dots", 12, 3000.0),
    ("retroreflective dots", 9, 300.0),
    ("twins 12 mm apart", 6, 3000.0),
    ("dots, relief 1 mm, jitter 5 ps", 6, 300.0),
    ("dots, pile-up", 6, 300.0),
    ("plate 20 cm", 0, 300.0),
    ("plate 20 cm", 0, 3000.0),
    ("plate 6 cm", 0, 300.0),
    ("plate 6 cm", 0, 3000.0),
    ("letter 20 cm", 0, 3000.0),
    ("sphere of 10 cm radius", 0, 300.0),
    ("sphere of 10 cm radius", 0, 3000.0),
    ("nothing", 0, 0.0),
];

/// Some cells by their numbers from 1 on; all where none is named.
fn print_locate(seeds: Range<u64>, cells: &[usize]) {
    println!(
        "| scene | photons | campaigns | points, extended, nothing, cannot tell | located | extra | rms / bound | 95 % hold (coordinates) |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    let is_wanted = |cell: &usize| cells.is_empty() || cells.contains(cell);
    for (_, (kind, count, photons)) in (1..).zip(LOCATE).filter(|(cell, _)| is_wanted(cell)) {
        let of_seed = |seed| {
            let (capture, hidden) = locate::scene(kind, count, photons, seed);
            locate::outcome(&capture, &hidden)
        };
        let outcomes: Vec<locate::Outcome> = seeds.clone().map(of_seed).collect();
        let is_odd = |one: &locate::Outcome| one.hits < count || one.extra > 0 || one.squares_m2 > 9.0 * one.bound_m2;
        for (seed, one) in seeds.clone().zip(&outcomes).filter(|(_, one)| is_odd(one)) {
            eprintln!(
                "{count} {kind}, {photons} photons, seed {seed}: {} ({}) with {} of {count}, {} extra, {:.2} of the bound",
                one.search.verdict,
                one.search.reason,
                one.hits,
                one.extra,
                (one.squares_m2 / one.bound_m2).sqrt()
            );
        }
        let verdicts = ["points", "extended-object", "nothing", "cannot-tell"]
            .map(|verdict| outcomes.iter().filter(|one| &*one.search.verdict == verdict).count().to_string());
        let sum = |value: fn(&locate::Outcome) -> f64| outcomes.iter().map(value).sum::<f64>();
        let number = |value: fn(&locate::Outcome) -> usize| outcomes.iter().map(value).sum::<usize>();
        let hits = number(|one| one.hits);
        let (errors, inside) = if hits > 0 {
            let [ratio, open] = [sum(|one| one.bound_m2), sum(|one| one.open_bound_m2)]
                .map(|bound_m2| format!("{:.2}", (sum(|one| one.squares_m2) / bound_m2).sqrt()));
            let ratio = if ratio == open { ratio } else { format!("{ratio}; shifts unknown: {open}") };
            let within = Rate { hits: number(|one| one.inside), of: 3 * hits };
            (ratio, format!("{within}"))
        } else {
            ("-".to_owned(), "-".to_owned())
        };
        let name = if count > 0 { format!("{count} {kind}") } else { kind.to_owned() };
        println!(
            "| {name} | {photons} | {} | {} | {hits} of {} | {} | {errors} | {inside} |",
            outcomes.len(),
            verdicts.join(", "),
            count * outcomes.len(),
            number(|one| one.extra),
        );
    }
}

/// Tables b, d, e and f of docs/time-resolution.md through `run`.
fn print_twins(records: usize) {
    println!(
        "| response | told | light | SNR | records | right number | more | rms / bound | in 95 % interval | flag `misfit` |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    let print = |name: &str, told: &str, [own, given]: [&Shape; 2], kind: Kind, snr: f64, seed: u64| {
        let twin = twin(own, given, kind, snr, records, seed);
        let twins::Twin { right, more, ratio, within, flagged } = twin;
        let light = match kind {
            Kind::One => "one pulse".to_owned(),
            Kind::Pair(apart_ps) => format!("pair, {apart_ps:.0} ps"),
            Kind::Many(spacing_ps) => format!("3 to 12, {spacing_ps:.0} ps"),
        };
        println!(
            "| {name} | {told} | {light} | {snr} | {records} | {right} | {more} | {ratio} | {within} | {flagged:.2} |"
        );
    };
    for Sensor { name, shape, .. } in Sensor::both() {
        for snr in [30.0, 100.0, 316.0, 1000.0] {
            let limit_ps = information::resolution_limit_ps(&shape, snr);
            let kinds =
                [Kind::One, Kind::Pair(1.35 * limit_ps), Kind::Pair(2.0 * limit_ps), Kind::Many(12.0 * limit_ps)];
            for (seed, kind) in (100..).zip(kinds) {
                print(name, "as it is", [&shape, &shape], kind, snr, seed);
            }
        }
        let told = [("2 % too wide", 1.02), ("2 % too narrow", 0.98), ("5 % too wide", 1.05)];
        for (text, factor) in told {
            for (seed, kind) in (200..).zip([Kind::One, Kind::Pair(100.0)]) {
                print(name, text, [&shape, &shape.stretched(factor)], kind, 100.0, seed);
            }
        }
        let tail = shape.with_tail(1000.0, 0.02);
        print(name, "without its tail of 2 %, 1 ns", [&tail, &shape], Kind::One, 100.0, 300);
    }
}

/// Wide pulses and pairs: patches of all sizes, signal-to-noise ratios, hidden patches or none, instruments; of these
/// cells all or those named, counted from 0.
fn print_readings(seeds: Range<u64>, choices: &[Choice], only: &[usize]) {
    println!(
        "| patches (cm) | SNR | hidden | instrument | choice | scenes | refused | with a phantom | phantoms | missed | rms (mm) | rms / bound | 95 % interval | not explained | patches doubtful | patches confidently wrong |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|");
    let kind =
        [0.0, 0.01, 0.02, 0.04].into_iter().flat_map(|size_m| [30.0, 100.0].map(|snr| (size_m, snr, Instrument::Kind)));
    let unkind = [Instrument::Tail, Instrument::Slope].map(|instrument| (0.02, 100.0, instrument));
    let cells = kind.chain(unkind).flat_map(|cell| [false, true].map(|has_hidden| (cell, has_hidden)));
    let cells = cells.enumerate().filter(|(n, _)| only.is_empty() || only.contains(n)).map(|(_, cell)| cell);
    let mut totals = vec![(0, 0); choices.len()];
    for ((size_m, snr, instrument), has_hidden) in cells {
        let setting = |seed: u64| {
            let hidden = if has_hidden { 1 + (seed % HIDDEN_MAX) as usize } else { 0 };
            Setting { size_m, snr, hidden, instrument }
        };
        let scenes: Vec<Vec<Outcome>> = seeds.clone().map(|seed| outcomes(&setting(seed), choices, seed)).collect();
        for (seed, scene) in seeds.clone().zip(&scenes) {
            if scene.iter().any(|one| one.phantoms + one.missed + one.confident + one.refused > 0) {
                eprintln!("{:?}, seed {seed}: {scene:?}", setting(seed));
            }
        }
        for (n, choice) in choices.iter().enumerate() {
            let sum = scenes.iter().fold(Outcome::default(), |sum, scene| sum.plus(scene[n]));
            let hits = scenes.iter().filter(|scene| scene[n].phantoms > 0).count();
            if !has_hidden {
                totals[n] = (totals[n].0 + hits, totals[n].1 + scenes.len());
            }
            let rms_mm = 1e3 * (sum.squares_m2 / sum.count as f64).sqrt();
            let over_bound = (sum.squares_m2 / sum.bounds_m2).sqrt();
            let covered = Rate { hits: sum.covered, of: sum.coordinates };
            println!(
                "| {} | {snr} | {} | {instrument:?} | {choice:?} | {} | {} | {hits} | {} | {} | {rms_mm:.3} | {over_bound:.2} | {covered} | {} | {} | {} |",
                100.0 * size_m,
                if has_hidden { "1 to 6" } else { "none" },
                scenes.len(),
                sum.refused,
                sum.phantoms,
                sum.missed,
                sum.unexplained,
                sum.doubtful,
                sum.confident
            );
        }
    }
    for (choice, (hits, of)) in choices.iter().zip(totals) {
        println!("nothing hidden, {choice:?}: a patch that is none in {}", Rate { hits, of });
    }
}

/// Few patches, pairs missing, spurious onsets: which rooms are wrong without saying so. With a share of missing pairs
/// in percent, only those kinds.
fn print_small_rooms(seeds: Range<u64>, missing_percent: Option<u64>) {
    println!(
        "| pairs missing | profiles with a spurious onset | rooms | confidently wrong [95 %] | of these, fit not explained | wrong, and said so | right patches named doubtful | refused | patches placed | with open patches | with phantoms | p of errors (Kolmogorov) |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    let shares = [0.0, 0.3, 0.6].into_iter().flat_map(|missing| [0.0, 0.2, 0.4].map(|spurious| (missing, spurious)));
    let shares = shares.filter(|(missing, _)| missing_percent.is_none_or(|only| (100.0 * missing) as u64 == only));
    for kind in shares.map(|(missing, spurious)| small_rooms::Kind { missing, spurious }) {
        let rooms = small_rooms::solve_all(kind, seeds.clone());
        for (seed, room) in seeds.clone().zip(&rooms) {
            if room.refused.is_some() || !room.confidently_wrong.is_empty() || !room.wrong.is_empty() || room.open > 0 {
                eprintln!("{kind:?}, room {seed}: {room:?}");
            }
        }
        let count = |holds: fn(&small_rooms::Outcome) -> bool| rooms.iter().filter(|room| holds(room)).count();
        let solved = count(|room| room.refused.is_none());
        let wrong = count(|room| !room.confidently_wrong.is_empty());
        let chance = small_rooms::kolmogorov(rooms.iter().filter_map(|room| room.p_value).collect());
        let chance = chance.map_or("-".to_owned(), |chance| format!("{chance:.2}"));
        println!(
            "| {:.0} % | {:.0} % | {} | {wrong}: {} | {} | {} | {} | {} | {} of {} | {} | {} | {} |",
            100.0 * kind.missing,
            100.0 * kind.spurious,
            rooms.len(),
            Rate { hits: wrong, of: solved },
            count(|room| !room.confidently_wrong.is_empty() && room.chi2_dof.is_some_and(|ratio| ratio > 2.0)),
            count(|room| room.confidently_wrong.is_empty() && !room.wrong.is_empty()),
            rooms.iter().map(|room| room.doubted).sum::<usize>(),
            rooms.len() - solved,
            rooms.iter().map(|room| room.patches - room.open).sum::<usize>(),
            rooms.iter().map(|room| room.patches).sum::<usize>(),
            count(|room| room.open > 0),
            count(|room| room.phantoms > 0),
            chance
        );
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Half the 95 % interval of a mean.
fn half_95(values: &[f64]) -> f64 {
    let centre = mean(values);
    let squares: f64 = values.iter().map(|value| (value - centre).powi(2)).sum();
    1.96 * (squares / (values.len() as f64 - 1.0) / values.len() as f64).sqrt()
}

/// The study of Fig. 4 as a list.
fn print_rectangles(study: &rectangles::Study) {
    let bound_mm = 1e3 * study.bound_m;
    let ratio = |squares_m2: &[f64]| {
        let (rms_mm, share) = (1e3 * mean(squares_m2).sqrt(), half_95(squares_m2) / mean(squares_m2));
        let ratio = rms_mm / bound_mm;
        let (low, high) = (ratio * (1.0 - share).max(0.0).sqrt(), ratio * (1.0 + share).sqrt());
        format!("{rms_mm:.4} mm, {ratio:.3} [{low:.3}, {high:.3}] of the bound")
    };
    println!("- {} seeds; bound {bound_mm:.4} mm", study.squares_m2.len());
    println!("- patches: {}", ratio(&study.squares_m2));
    println!("- the same with footprints taken as points: {}", ratio(&study.first_m2));
    let nse: Vec<f64> = study.normalised.iter().map(|nse| nse / study.degrees_of_freedom).collect();
    let (low, high) = (mean(&nse) - half_95(&nse), mean(&nse) + half_95(&nse));
    println!("- NSE / dof ({} degrees of freedom): {:.3} [{low:.3}, {high:.3}]", study.degrees_of_freedom, mean(&nse));
    println!("- labels without known patches: {}, wrong {}", study.blind.0, study.blind.1);
    for (bounces, (labels, wrong)) in &study.labels {
        println!("- labels of {bounces} bounces: {labels}, wrong {wrong}");
    }
    println!("- distance of patches from their planes: {:.1} um rms", 1e6 * mean(&study.planarity_m));
    let pulls: Vec<f64> = study.tilts_rad.iter().map(|(off_rad, sd_rad)| (off_rad / sd_rad).powi(2)).collect();
    let tilts: Vec<f64> = study.tilts_rad.iter().map(|(off_rad, _)| off_rad.powi(2)).collect();
    println!(
        "- angles between planes less 90 degrees: {:.1} urad rms, squares over variances {:.3} +- {:.3}",
        1e6 * mean(&tilts).sqrt(),
        mean(&pulls),
        half_95(&pulls)
    );
}

/// Shares of errors within intervals that are to hold 50, 68, 95 and 99 % of them, each with its 95 % interval.
fn print_coverage(name: &str, pulls: &[f64]) {
    let count = pulls.len() as f64;
    print!("| {name} | {count} |");
    for sigmas in [0.674_490, 0.994_458, 1.959_964, 2.575_829] {
        let share = pulls.iter().filter(|pull| pull.abs() < sigmas).count() as f64 / count;
        print!(" {share:.3} ± {:.3} |", 1.96 * (share * (1.0 - share) / count).sqrt());
    }
    println!();
}

fn print_row(name: &str, study: &Study) {
    let ratio = study.bound_m / study.rms_m;
    let mean = study.normalised.iter().sum::<f64>() / study.seeds as f64;
    let variance = study.normalised.iter().map(|nse| (nse - mean).powi(2)).sum::<f64>() / (study.seeds as f64 - 1.0);
    let nse_95 = 1.96 * (variance / study.seeds as f64).sqrt() / study.degrees_of_freedom;
    // Squared errors of one seed spread as its normalised error does.
    let ratio_95 = 0.5 * 1.96 * (variance.sqrt() / mean) / (study.seeds as f64).sqrt() * ratio;
    println!(
        "| {name} | {} | {:.4} | {:.4} | {ratio:.3} [{:.3}, {:.3}] | {:.3} [{:.3}, {:.3}] | {:.4} | {:.4} | {:.4} | {:.4} | {:.5} | {} |",
        study.seeds,
        1e3 * study.rms_m,
        1e3 * study.bound_m,
        ratio - ratio_95,
        ratio + ratio_95,
        mean / study.degrees_of_freedom,
        mean / study.degrees_of_freedom - nse_95,
        mean / study.degrees_of_freedom + nse_95,
        1e3 * study.paper_rms_m,
        1e3 * study.start_rms_m,
        study.onset_rms_ps,
        study.onset_bound_ps,
        study.onsets_found,
        study.false_onsets,
    );
}
