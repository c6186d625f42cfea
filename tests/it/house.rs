//! The house rules of ARCHITECTURE.md: floors, package addresses, and what must not be there at all.

use std::fs;
use std::path::{Path, PathBuf};

/// Rooms by floor: a file may import only from floors below its own, or from its own room.
const FLOORS: [&[&str]; 8] = [
    &["cancel", "units", "store"],
    &["path", "campaign", "waveform"],
    &["geometry", "tables", "formats", "signal", "parameter"],
    &["priors"],
    &["stages", "simulate"],
    &["pipeline", "history", "bound", "exchange"],
    &["lib", "report", "guide"],
    &["main", "commands"],
];

/// Imports between neighbours on one floor, or upwards, each with its reason.
const GRANTED: [(&str, &str); 1] = [
    // The shelf itself writes the table `rejects`: that one is the runtime's own, not a stage's.
    ("store", "tables"),
];

/// Packages that have few addresses: (package, files or folders under src that may name it).
const ADDRESSES: [(&str, &[&str]); 13] = [
    ("rustfft", &["signal/fft.rs"]),
    ("realfft", &["signal/fft.rs"]),
    ("faer", &["geometry/"]),
    ("pulp", &["signal/widest.rs"]),
    ("nalgebra", &["geometry/", "priors/", "simulate/", "stages/", "bound/"]),
    ("arrow_array", &["tables/", "stages/", "store/", "pipeline/", "history/"]),
    ("arrow_schema", &["tables/", "stages/", "store/", "pipeline/", "history/"]),
    ("parquet", &["store/"]),
    ("polars", &["store/query"]),
    ("crossbeam_channel", &["pipeline/"]),
    ("plotly", &["report/page/"]),
    ("maud", &["report/page/"]),
    ("plotters", &["report/figures/"]),
];

fn sources() -> Vec<(String, String)> {
    fn walk(folder: &Path, out: &mut Vec<PathBuf>) {
        for entry in fs::read_dir(folder).unwrap().flatten() {
            let path = entry.path();
            if path.is_dir() {
                walk(&path, out);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                out.push(path);
            }
        }
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    walk(&root, &mut files);
    files.sort();
    let name = |path: &Path| path.strip_prefix(&root).unwrap().to_string_lossy().replace('\\', "/");
    files.iter().map(|path| (name(path), fs::read_to_string(path).unwrap())).collect()
}

fn room(file: &str) -> &str {
    file.split('/').next().unwrap().trim_end_matches(".rs")
}

fn floor(room: &str) -> Option<usize> {
    FLOORS.iter().position(|rooms| rooms.contains(&room))
}

/// Code without its tests, which may import anything.
fn without_tests(text: &str) -> &str {
    text.split("#[cfg(test)]").next().unwrap()
}

/// A file of tests alone.
fn is_tests(file: &str) -> bool {
    file.ends_with("/tests.rs") || file.contains("/tests/")
}

/// Rooms that a file names after `crate::`.
fn imported(text: &str) -> Vec<String> {
    let code = without_tests(text).lines().filter(|line| !line.trim_start().starts_with("//"));
    let code: String = code.flat_map(|line| [line, "\n"]).collect();
    code.split("crate::")
        .skip(1)
        .map(|rest| rest.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect::<String>())
        .filter(|room| !room.is_empty() && floor(room).is_some())
        .collect()
}

#[test]
fn every_file_is_on_a_floor() {
    for (file, _) in sources() {
        assert!(
            floor(room(&file)).is_some(),
            "src/{file} is in no room of the house: give its room a floor in ARCHITECTURE.md and here"
        );
    }
}

#[test]
fn a_floor_imports_only_from_floors_below() {
    let mut wrong = Vec::new();
    for (file, text) in sources() {
        let own = room(&file);
        for other in imported(&text) {
            let granted = GRANTED.contains(&(own, other.as_str()));
            if own != other && !granted && floor(&other) >= floor(own) {
                wrong.push(format!("src/{file} imports {other}"));
            }
        }
    }
    wrong.dedup();
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn stages_never_import_one_another() {
    let stages: Vec<String> = sources()
        .into_iter()
        .filter_map(|(file, _)| file.strip_prefix("stages/").map(|name| name.trim_end_matches(".rs").to_owned()))
        .collect();
    for (file, text) in sources().iter().filter(|(file, _)| file.starts_with("stages/") && !file.ends_with("mod.rs")) {
        let own = file.trim_start_matches("stages/").split('/').next().unwrap().trim_end_matches(".rs");
        for other in stages.iter().filter(|other| {
            !other.contains('/')
                && *other != own
                && !["stage", "operator", "source", "method", "mod"].contains(&other.as_str())
        }) {
            for form in [format!("super::{other}::"), format!("stages::{other}::")] {
                assert!(!without_tests(text).contains(&form), "src/{file} imports stage {other}");
            }
        }
    }
}

#[test]
fn kernels_know_no_file_no_table_no_thread_and_no_clock() {
    for (file, text) in sources()
        .iter()
        .filter(|(file, _)| (file.starts_with("signal/") || file.starts_with("geometry/")) && !is_tests(file))
    {
        for forbidden in ["std::fs", "std::thread", "std::time", "arrow_", "crate::tables", "rand::"] {
            assert!(!without_tests(text).contains(forbidden), "src/{file} names {forbidden}");
        }
    }
}

#[test]
fn packages_are_named_only_at_their_addresses() {
    for (file, text) in sources().into_iter().filter(|(file, _)| !is_tests(file)) {
        for (package, addresses) in ADDRESSES {
            let named = without_tests(&text).lines().any(|line| {
                let line = line.trim_start();
                !line.starts_with("//")
                    && (line.contains(&format!("use {package}::"))
                        || line.contains(&format!(" {package}::"))
                        || line.contains(&format!("({package}::")))
            });
            let at_home = addresses.iter().any(|address| file.starts_with(address));
            // `crate::store::parquet` is a room of ours, not the package.
            let ours = package == "parquet" && !text.contains("use parquet::");
            assert!(!named || at_home || ours, "src/{file} names package {package}; its addresses are {addresses:?}");
        }
    }
}

#[test]
fn simulator_and_bound_share_no_code_with_the_estimators() {
    for (file, text) in sources().iter().filter(|(file, _)| file.starts_with("simulate/") || file.starts_with("bound/"))
    {
        for estimator in ["signal", "geometry", "priors", "stages"] {
            assert!(!imported(text).iter().any(|room| room == estimator), "src/{file} imports {estimator}");
        }
    }
}

#[test]
fn no_room_is_a_drawer_for_odds_and_ends() {
    for (file, _) in sources() {
        for name in ["utils", "util", "common", "types", "error", "helpers", "misc"] {
            assert!(
                !file.split('/').any(|part| part.trim_end_matches(".rs") == name),
                "src/{file}: name what lives there"
            );
        }
    }
}

/// Law 9.
#[test]
fn times_become_metres_in_one_place() {
    for (file, text) in sources().iter().filter(|(file, _)| file != "units.rs" && !is_tests(file)) {
        for forbidden in ["299792", "299_792", "2.997_924", "SPEED_OF_LIGHT", "0.2998", "0.0003 *"] {
            assert!(
                !without_tests(text).contains(forbidden),
                "src/{file} knows the speed of light; units::path_m and units::time_ps do"
            );
        }
    }
}

#[test]
fn every_reader_is_fuzzed() {
    let manifest = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/Cargo.toml")).unwrap();
    for reader in periscope::formats::READERS {
        let target = format!("name = \"{}\" # format", reader.format().replace('.', "-"));
        assert!(manifest.contains(&target), "tests/fuzz/Cargo.toml has no [[bin]] with {target}");
    }
}
