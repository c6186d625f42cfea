//! Where packages of others may be named, and numbers that have one address.

use std::fs;

use super::sources::{Source, code, root};

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

#[test]
fn packages_are_named_only_at_their_addresses() {
    for source in code("src/") {
        for (package, addresses) in ADDRESSES {
            let is_home = addresses.iter().any(|address| source.file["src/".len()..].starts_with(address));
            let named = source.paths.iter().find(|path| path.len() > 1 && path[0] == package);
            let Some(named) = named.filter(|_| !is_home && !is_ours(source, package)) else { continue };
            let named = named.join("::");
            panic!("{} names {named}; the addresses of {package} are {addresses:?}", source.file);
        }
    }
}

/// Whether a file means a module of ours that has the name of a package: `store::parquet`.
fn is_ours(source: &Source, package: &str) -> bool {
    source.imports().any(|import| import.last() == Some(&package))
}

/// Law 9.
#[test]
fn times_become_metres_in_one_place() {
    for source in code("src/").filter(|source| source.file != "src/geometry/units.rs") {
        let is_speed = |literal: &String| {
            let digits = literal.replace('_', "");
            ["299792", "2.997924", "0.2998"].iter().any(|speed| digits.contains(speed)) || digits == "0.0003"
        };
        let literal = source.literals.iter().find(|literal| is_speed(literal));
        let constant = source.paths.iter().any(|path| path.last().is_some_and(|name| name.contains("SPEED_OF_LIGHT")));
        assert!(
            literal.is_none() && !constant,
            "{} knows the speed of light ({literal:?}); units::path_m and units::time_ps do",
            source.file
        );
    }
}

#[test]
fn every_reader_is_fuzzed() {
    let manifest = fs::read_to_string(root().join("tests/fuzz/Cargo.toml")).unwrap();
    for reader in periscope::formats::READERS {
        let target = format!("name = \"{}\" # format", reader.format().replace('.', "-"));
        assert!(manifest.contains(&target), "tests/fuzz/Cargo.toml has no [[bin]] with {target}");
    }
}

/// The macros of the standard library panic where nothing reads what they print.
#[test]
fn no_code_prints_into_a_closed_pipe() {
    for source in code("src/") {
        let prints = |path: &&Vec<String>| {
            path.last().is_some_and(|name| ["print", "println", "eprint", "eprintln"].contains(&name.as_str()))
        };
        // `commands::output::print` is ours.
        let named = source.paths.iter().find(|path| prints(path) && path.len() == 1 && path[0] != "print");
        assert!(named.is_none(), "{} names {named:?}; commands/output.rs prints", source.file);
    }
}
