//! Study: points of hidden surfaces from first light, through files and `run`. Prints the tables of docs/surfaces.md.
//!
//! `cargo bench --bench surfaces -- 5 32 1000`: 5 scans of each cell, 32 x 32 points of the wall, seeds from 1000 on;
//! a fourth number takes scans of so many photons in a mean histogram alone. Names of things take these alone.
//!
//! A second table has points of later returns, a third one what `shape` told, with the radii of spheres, a fourth one
//! the surfaces of `mesh`.
//!
//! `cargo bench --bench surfaces -- write FOLDER 1 32 2000 3000` writes such scans as `THING-PHOTONS-SEED.mat`, with
//! points of the true surface beside each (`.csv`: x, y, z, normal), and runs nothing: for other programs.

#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../tests/it/hidden_things.rs"]
mod hidden_things;
#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../tests/it/relay_scene.rs"]
mod relay_scene;
#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../tests/it/surface_study.rs"]
mod surface_study;

use std::fmt::Write;
use std::path::{Path, PathBuf};

use hidden_things::thing;
use surface_study::{Nodes, Results, Tally, capture, median, results};

const THINGS: [&str; 8] = ["sphere", "plate", "box", "sphere and plate", "letter", "stairs", "wavy", "saddle"];
const PHOTONS: [f64; 3] = [300.0, 3000.0, 30_000.0];
const KINDS: [&str; 3] = ["smooth", "edge", "corner"];

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let is_to_write = words.first().is_some_and(|word| word == "write");
    let folder = is_to_write.then(|| PathBuf::from(words.get(1).expect("`write` needs a folder")));
    let numbers: Vec<u64> = words.iter().filter_map(|word| word.parse().ok()).collect();
    let number = |place: usize, other: u64| numbers.get(place).copied().unwrap_or(other);
    let (scans, side, first) = (number(0, 5), number(1, 32) as usize, number(2, 1000));
    let photons = numbers.get(3).map_or(PHOTONS.to_vec(), |photons| vec![*photons as f64]);
    let named = |kind: &&str| words.iter().any(|word| word == kind);
    let is_any_named = THINGS.iter().any(named);
    let things = THINGS.into_iter().filter(|kind| !is_any_named || named(kind));
    if let Some(folder) = folder {
        for kind in things {
            let of_kind = photons.iter().flat_map(|photons| (first..first + scans).map(move |seed| (*photons, seed)));
            of_kind.for_each(|(photons, seed)| write(&folder, kind, photons, (side, seed)));
        }
        return;
    }
    println!(
        "| scene | photons | kind | scans | points | of a farther thing | 95 % hold (least to most of a scan) | median error (mm) | 95 % of errors below (mm) | median sd (mm) | median turn of the normal (degrees) |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    let [mut behind, mut shapes, mut meshes] = [const { String::new() }; 3];
    for kind in things {
        for photons in &photons {
            let of_seed = |seed| results(&thing(kind, seed), &capture(side, seed), *photons);
            let scans: Vec<Results> = (first..first + scans).map(of_seed).collect();
            for (k, name) in KINDS.iter().enumerate() {
                let of_kind = scans.iter().map(|one| &one.points[k]).filter(|one| one.points > 0);
                print(&format!("{kind} | {photons} | {name}"), &of_kind.collect::<Vec<_>>());
            }
            behind.push_str(&behind_of(&format!("{kind} | {photons}"), &scans));
            shapes.push_str(&shapes_of(&format!("{kind} | {photons}"), &scans));
            meshes.push_str(&meshes_of(&format!("{kind} | {photons}"), &scans));
        }
    }
    println!(
        "\n| scene | photons | scans with later returns | points | with a facet within 95 % (least to most of a scan) | median distance (mm) | 95 % of distances below (mm) | median sd (mm) |\n|---|---|---|---|---|---|---|---|"
    );
    print!("{behind}");
    println!(
        "\n| scene | photons | scans | points on shapes | shapes of a scan | radius - true (mm) | over its sd |\n|---|---|---|---|---|---|---|"
    );
    print!("{shapes}");
    println!(
        "\n| scene | photons | scans with a surface | nodes | 95 % hold (least to most of a scan) | median distance (mm) | 95 % of distances below (mm) | median sd (mm) | median turn of the normal (degrees) |\n|---|---|---|---|---|---|---|---|---|"
    );
    print!("{meshes}");
}

/// Points of later returns.
fn behind_of(name: &str, scans: &[Results]) -> String {
    let with: Vec<&Tally> = scans.iter().map(|one| &one.later).filter(|later| later.points > 0).collect();
    let begins = format!("| {name} | {} of {}", with.len(), scans.len());
    if with.is_empty() {
        return format!("{begins} | 0 | | | | |\n");
    }
    let sum = |of: fn(&Tally) -> usize| with.iter().map(|one| of(one)).sum::<usize>();
    let (points, held) = (sum(|one| one.points), sum(|one| one.held));
    let shares = with.iter().map(|one| one.held as f64 / one.points as f64);
    let (least, most) = (shares.clone().fold(1.0, f64::min), shares.fold(0.0, f64::max));
    let mut errors_m: Vec<f64> = with.iter().flat_map(|one| one.errors_m.clone()).collect();
    errors_m.sort_by(f64::total_cmp);
    let sds_m: Vec<f64> = with.iter().flat_map(|one| one.sds_m.clone()).collect();
    format!(
        "{begins} | {points} | {:.2} ({least:.2} to {most:.2}) | {:.1} | {:.1} | {:.1} |\n",
        held as f64 / points as f64,
        1e3 * median(&errors_m),
        1e3 * errors_m[errors_m.len() * 95 / 100],
        1e3 * median(&sds_m),
    )
}

/// Surfaces between points.
fn meshes_of(name: &str, scans: &[Results]) -> String {
    let with: Vec<&Nodes> = scans.iter().map(|one| &one.nodes).filter(|nodes| !nodes.errors_m.is_empty()).collect();
    let begins = format!("| {name} | {} of {}", with.len(), scans.len());
    if with.is_empty() {
        return format!("{begins} | 0 | | | | | |\n");
    }
    let all = |of: fn(&Nodes) -> &Vec<f64>| -> Vec<f64> { with.iter().flat_map(|one| of(one)).copied().collect() };
    let mut errors_m = all(|one| &one.errors_m);
    errors_m.sort_by(f64::total_cmp);
    let count = errors_m.len();
    let held: usize = with.iter().map(|one| one.held()).sum();
    let shares = with.iter().map(|one| one.held() as f64 / one.errors_m.len() as f64);
    let (least, most) = (shares.clone().fold(1.0, f64::min), shares.fold(0.0, f64::max));
    format!(
        "{begins} | {count} | {:.2} ({least:.2} to {most:.2}) | {:.2} | {:.1} | {:.2} | {:.2} |\n",
        held as f64 / count as f64,
        1e3 * median(&errors_m),
        1e3 * errors_m[count * 95 / 100],
        1e3 * median(&all(|one| &one.sds_m)),
        median(&all(|one| &one.angles_rad)).to_degrees(),
    )
}

/// Shapes that were told, and radii of spheres: those of the study have 0.2 m, or 0.12 m beside a plate.
fn shapes_of(name: &str, scans: &[Results]) -> String {
    let count = |kind: &str| scans.iter().flat_map(|one| &one.shapes).filter(|shape| *shape.kind == *kind).count();
    let kinds = ["plane", "sphere", "cylinder"];
    let of_scan = |kind: &str| format!("{:.1} {kind}", count(kind) as f64 / scans.len() as f64);
    let shapes: Vec<String> = kinds.iter().filter(|kind| count(kind) > 0).map(|kind| of_scan(kind)).collect();
    let true_m = if name.contains("plate") { 0.12 } else { 0.2 };
    let radii = scans.iter().flat_map(|one| &one.shapes).filter(|shape| &*shape.kind == "sphere");
    let off: Vec<[f64; 2]> = radii.filter_map(|shape| Some([shape.radius_m? - true_m, shape.radius_sd_m?])).collect();
    let list =
        |of: fn(&[f64; 2]) -> f64| off.iter().map(|one| format!("{:.1}", of(one))).collect::<Vec<_>>().join(", ");
    let [mm, sds] = [list(|one| 1e3 * one[0]), list(|one| one[0] / one[1])];
    let points: usize = scans.iter().flat_map(|one| &one.points).map(|one| one.points).sum();
    let on_shapes: usize = scans.iter().map(|one| one.on_shapes).sum();
    format!("| {name} | {} | {on_shapes} of {points} | {} | {mm} | {sds} |\n", scans.len(), shapes.join(", "))
}

/// A scan, and points of its surface that face the wall.
fn write(folder: &Path, kind: &str, photons: f64, (side, seed): (usize, u64)) {
    let thing = thing(kind, seed);
    let name = format!("{}-{photons}-{seed}", kind.replace(' ', "-"));
    thing.write(&folder.join(format!("{name}.mat")), &capture(side, seed), photons);
    let mut text = String::from("x_m,y_m,z_m,normal_x,normal_y,normal_z\n");
    for (place, normal) in thing.facing().step_by(7) {
        let [x, y, z, nx, ny, nz] = [place.x, place.y, place.z, normal.x, normal.y, normal.z];
        writeln!(text, "{x:.5},{y:.5},{z:.5},{nx:.5},{ny:.5},{nz:.5}").expect("text");
    }
    std::fs::write(folder.join(format!("{name}.csv")), text).expect("a folder to write to");
}

fn print(name: &str, scans: &[&Tally]) {
    if scans.is_empty() {
        return;
    }
    let all =
        |values: fn(&Tally) -> &Vec<f64>| -> Vec<f64> { scans.iter().flat_map(|one| values(one)).copied().collect() };
    let sum = |value: fn(&Tally) -> usize| scans.iter().map(|one| value(one)).sum::<usize>();
    let (points, farther, held) = (sum(|one| one.points), sum(|one| one.farther), sum(|one| one.held));
    let shares = scans.iter().map(|one| one.held as f64 / one.points as f64);
    let (least, most) = (shares.clone().fold(1.0, f64::min), shares.fold(0.0, f64::max));
    let mut errors_m = all(|one| &one.errors_m);
    errors_m.sort_by(f64::total_cmp);
    println!(
        "| {name} | {} | {points} | {farther} | {:.2} ({least:.2} to {most:.2}) | {:.2} | {:.1} | {:.2} | {:.2} |",
        scans.len(),
        held as f64 / points as f64,
        1e3 * median(&errors_m),
        1e3 * errors_m[errors_m.len() * 95 / 100],
        1e3 * median(&all(|one| &one.sds_m)),
        median(&all(|one| &one.angles_rad)).to_degrees(),
    );
}
