//! Who may import whom: the floors of the program, the member crates, and no circles within them.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;

use super::sources::{MEMBERS, Source, code, root, sources};

/// Rooms of the program by floor: a file imports only from floors below its own, or from its own room. `units`, `path`
/// and `waveform` are modules of member crates; the floors say who may use those crates.
const FLOORS: [&[&str]; 8] = [
    &["cancel", "units", "store"],
    &["path", "campaign", "waveform"],
    &["geometry", "tables", "formats", "signal", "parameter"],
    &["priors"],
    &["stages", "simulate"],
    &["pipeline", "history", "bound", "wall_outlook", "exchange"],
    &["lib", "report", "guide"],
    &["main", "commands"],
];

/// Imports between neighbours on one floor, or upwards, each with its reason.
const GRANTED: [(&str, &str); 2] = [
    ("store", "tables"), // the shelf itself writes the table `rejects`: the runtime's own, not a stage's
    ("campaign", "formats"), // a recording in two files is one raw file: `formats::companions` names the second
];

/// Files of `stages/` that are not stages but what a stage is.
const NO_STAGES: [&str; 4] = ["stage", "operator", "source", "method"];

/// What the member crates may depend on: packages of others, and of ours.
const DEPENDENCIES: [(&str, &[&str]); 4] = [
    ("cancel", &["thiserror"]),
    ("formats", &["flate2", "quick-xml", "thiserror"]),
    ("signal", &["periscope-cancel", "pulp", "realfft", "rustfft", "thiserror"]),
    ("geometry", &["faer", "nalgebra", "periscope-cancel", "rayon", "thiserror"]),
];

fn floor(room: &str) -> Option<usize> {
    FLOORS.iter().position(|rooms| rooms.contains(&room))
}

/// The room of a file of the program.
fn room(source: &Source) -> &str {
    source.file["src/".len()..].split('/').next().unwrap().trim_end_matches(".rs")
}

fn program() -> impl Iterator<Item = &'static Source> {
    code("src/").filter(|source| source.member().is_none())
}

#[test]
fn every_file_is_on_a_floor() {
    for source in program() {
        assert!(
            floor(room(source)).is_some(),
            "{} is in no room of the house: give its room a floor in ARCHITECTURE.md and here",
            source.file
        );
    }
}

#[test]
fn a_floor_imports_only_from_floors_below() {
    let mut wrong = BTreeSet::new();
    for source in program() {
        let own = room(source);
        for import in source.imports() {
            let Some(other) = import.first().filter(|other| **other != own && floor(other).is_some()) else { continue };
            if floor(other) >= floor(own) && !GRANTED.contains(&(own, other)) {
                wrong.insert(format!("{} imports {other}", source.file));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn stages_never_import_one_another() {
    let stage = |file: &'static str| file.strip_prefix("src/stages/")?.split('/').next()?.strip_suffix(".rs");
    let stages: BTreeSet<&str> = code("src/stages/").filter_map(|source| stage(&source.file)).collect();
    for source in code("src/stages/").filter(|source| source.module() != ["stages"]) {
        let own = source.module()[1];
        for import in source.imports().filter(|import| import.len() > 2 && import[0] == "stages") {
            let other = import[1];
            let is_stage = stages.contains(other) && !NO_STAGES.contains(&other);
            assert!(other == own || !is_stage, "{} imports stage {other}", source.file);
        }
    }
}

#[test]
fn simulator_and_bound_share_no_code_with_the_estimators() {
    for source in code("src/simulate/").chain(code("src/bound/")) {
        for import in source.imports() {
            let is_estimator = ["signal", "geometry", "priors", "stages"].contains(&import[0]);
            assert!(!is_estimator, "{} imports {}", source.file, import[0]);
        }
    }
}

#[test]
fn members_depend_on_what_they_may() {
    for (member, allowed) in DEPENDENCIES {
        let manifest = fs::read_to_string(root().join(format!("src/{member}/Cargo.toml"))).unwrap();
        let manifest: toml::Table = manifest.parse().unwrap();
        for package in manifest["dependencies"].as_table().unwrap().keys() {
            assert!(allowed.contains(&package.as_str()), "src/{member}/Cargo.toml: {package}; it may name {allowed:?}");
        }
    }
}

#[test]
fn modules_of_a_member_import_in_no_circle() {
    for member in MEMBERS {
        let imports = module_imports(member);
        for (module, direct) in &imports {
            for other in direct {
                let back = reach(&imports, other).contains(module);
                assert!(
                    !back,
                    "src/{member}: `{module}` imports `{other}`, which imports `{module}`, perhaps over others"
                );
            }
        }
    }
}

/// The modules of a member crate, and which others each imports. What the root re-exports counts as its module's.
fn module_imports(member: &'static str) -> BTreeMap<&'static str, BTreeSet<&'static str>> {
    let files = || code("src/").filter(move |source| source.member() == Some(member));
    let names: BTreeSet<&str> = files().filter_map(|source| source.module().first().copied()).collect();
    let exports: BTreeMap<&str, &str> = files()
        .filter(|source| source.module().is_empty())
        .flat_map(|source| &source.paths)
        .filter(|path| path.len() == 2 && names.contains(path[0].as_str()))
        .map(|path| (path[1].as_str(), path[0].as_str()))
        .collect();
    let mut imports: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for source in files().filter(|source| !source.module().is_empty()) {
        let own = source.module()[0];
        let others = source.imports().filter_map(|import| import.first().copied());
        let others = others.map(|other| exports.get(other).copied().unwrap_or(other));
        let others = others.filter(|other| *other != own && names.contains(other));
        imports.entry(own).or_default().extend(others);
    }
    imports
}

/// The modules that one imports, directly or over others.
fn reach<'a>(imports: &BTreeMap<&'a str, BTreeSet<&'a str>>, from: &'a str) -> BTreeSet<&'a str> {
    let mut reached = BTreeSet::new();
    let mut open = vec![from];
    while let Some(module) = open.pop() {
        open.extend(imports[module].iter().copied().filter(|next| reached.insert(*next)));
    }
    reached
}

#[test]
fn kernels_know_no_file_no_table_no_thread_and_no_clock() {
    for source in code("src/signal/").chain(code("src/geometry/")) {
        for path in &source.paths {
            let is_outside = ["fs", "thread", "time", "net", "process", "env"];
            let knows = path.len() > 1 && path[0] == "std" && is_outside.contains(&path[1].as_str());
            assert!(!knows && path[0] != "rand", "{} names {}", source.file, path.join("::"));
        }
    }
}

#[test]
fn no_room_is_a_drawer_for_odds_and_ends() {
    for source in sources() {
        for name in ["utils", "util", "common", "types", "error", "helpers", "misc"] {
            let is_drawer = source.file.split('/').any(|part| part.trim_end_matches(".rs") == name);
            assert!(!is_drawer, "{}: name what lives there", source.file);
        }
    }
}
