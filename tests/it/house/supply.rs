//! The lock file against deny.toml: licences, sources, versions side by side; and that crates with C code have a reason
//! in docs/reliability.md. It reads what Cargo knows of the packages, and so checks neither advisories nor whether a
//! package's licence file says what its manifest does.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::process::Command;

use serde_json::Value;

/// Everything in the lock file, as Cargo describes it. It fetches what no build here needed: packages of other systems
/// and features. `None`, and a loud word, where it has none of a package and no way to fetch it.
fn packages() -> Option<Vec<Value>> {
    let metadata = |arguments: &[&str]| {
        Command::new(env!("CARGO"))
            .args(["metadata", "--locked", "--format-version", "1"])
            .args(arguments)
            .current_dir(env!("CARGO_MANIFEST_DIR"))
            .output()
            .unwrap()
    };
    let all = metadata(&["--all-features"]);
    if !all.status.success() {
        let why = String::from_utf8_lossy(&all.stderr).into_owned();
        // A lock file that does not fit the manifests is no lack of a network.
        let of_ours = metadata(&["--no-deps"]);
        assert!(of_ours.status.success() && !why.contains("--locked"), "{why}");
        eprintln!(
            "SUPPLY CHAIN NOT CHECKED: Cargo does not have all packages of Cargo.lock, and cannot fetch them:\n{why}"
        );
        return None;
    }
    let mut metadata: Value = serde_json::from_slice(&all.stdout).unwrap();
    let Value::Array(packages) = metadata["packages"].take() else { panic!("cargo metadata has packages") };
    Some(packages)
}

fn policy() -> toml::Table {
    fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/deny.toml")).unwrap().parse().unwrap()
}

fn texts<'a>(policy: &'a toml::Table, heading: &str, key: &str) -> BTreeSet<&'a str> {
    policy[heading][key].as_array().unwrap().iter().map(|text| text.as_str().unwrap()).collect()
}

fn text<'a>(package: &'a Value, key: &str) -> &'a str {
    package[key].as_str().unwrap_or_default()
}

/// Whether one of the licences that an expression offers is allowed, where it demands several, of each.
fn is_allowed(expression: &str, allowed: &BTreeSet<&str>) -> bool {
    let plain = expression.replace(['(', ')'], "").replace('/', " OR ");
    plain.split(" AND ").all(|offered| offered.split(" OR ").any(|licence| allowed.contains(licence.trim())))
}

#[test]
fn licences_and_sources_are_those_of_the_list() {
    let policy = policy();
    let (licences, registries) = (texts(&policy, "licenses", "allow"), texts(&policy, "sources", "allow-registry"));
    assert!(is_allowed("(GPL-3.0 OR MIT) AND Zlib", &licences) && !is_allowed("MIT AND GPL-3.0", &licences));
    let Some(packages) = packages() else { return };
    assert!(packages.len() > 100, "{}", packages.len());
    for package in packages {
        let (name, licence) = (text(&package, "name"), text(&package, "license"));
        assert!(is_allowed(licence, &licences), "{name}: licence {licence}");
        if let Some(source) = package["source"].as_str() {
            let is_known = source.strip_prefix("registry+").is_some_and(|registry| registries.contains(registry));
            assert!(is_known, "{name} comes from {source}");
        } else {
            assert!(name.starts_with("periscope"), "{name} is in this repository");
        }
    }
}

#[test]
fn a_second_version_of_a_package_is_on_the_list() {
    let policy = policy();
    let skipped = texts(&policy, "bans", "skip");
    let Some(packages) = packages() else { return };
    let mut versions: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for package in &packages {
        versions.entry(text(package, "name")).or_default().insert(text(package, "version"));
    }
    let several = versions.iter().filter(|(_, versions)| versions.len() > 1);
    let several: BTreeSet<String> =
        several.flat_map(|(name, versions)| versions.iter().map(move |version| format!("{name}@{version}"))).collect();
    for skip in &skipped {
        assert!(several.contains(*skip), "{skip} has no other version beside it any more; take it out of deny.toml");
    }
    for (name, versions) in versions {
        let left = versions.iter().filter(|version| !skipped.contains(format!("{name}@{version}").as_str())).count();
        assert_eq!(left, 1, "versions of {name}: {versions:?}");
    }
}

#[test]
fn crates_with_c_code_have_a_reason() {
    let docs = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/docs/reliability.md")).unwrap();
    let (_, reasons) = docs.split_once("## Code of others").expect("the section is there");
    for package in packages().into_iter().flatten() {
        let mut dependencies = package["dependencies"].as_array().unwrap().iter();
        let is_compiled = dependencies.any(|needed| text(needed, "name") == "cc" && text(needed, "kind") == "build");
        let name = text(&package, "name");
        if is_compiled || package["links"].is_string() {
            assert!(
                reasons.contains(&format!("`{name}`")),
                "{name} brings C code and has no reason in docs/reliability.md"
            );
        }
    }
}
