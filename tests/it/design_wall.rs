//! What `design` says of a wall before anything is captured, against captures.

use std::process::Command;

use serde_json::Value;

use crate::hidden_things::thing;
use crate::surface_study::{capture, median, results};

const WALL: &str = include_str!("../../pipelines/scenes/wall.toml");

fn design(text: &str, args: &[&str]) -> (Option<i32>, String, String) {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("wall.toml"), text).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_periscope"));
    let output = command.args(["design", "wall.toml"]).args(args).current_dir(folder.path()).output().unwrap();
    let [out, error] = [output.stdout, output.stderr].map(|text| String::from_utf8(text).unwrap());
    (output.status.code(), out, error)
}

fn surfaces(text: &str) -> Value {
    let (code, json, error) = design(text, &["--format", "json"]);
    assert_eq!(code, Some(0), "{error}");
    serde_json::from_str(&json).unwrap()
}

#[test]
fn standard_deviations_are_those_that_a_capture_states() {
    // The sphere of the study: bins, response, dark counts and photons are those of its captures.
    let scan = results(&thing("sphere", 1), &capture(32, 1), 3000.0);
    let stated_m = median(&scan.points[0].sds_m);
    let rows = surfaces(WALL);
    let sphere = rows.as_array().unwrap().iter().find(|row| row["surface"] == "sphere").unwrap();
    let expected_m = sphere["sd_m"].as_f64().unwrap();
    println!("a sphere: {expected_m} m expected, {stated_m} m stated by a capture");
    assert!((0.6..1.6).contains(&(expected_m / stated_m)), "{expected_m} m, {stated_m} m");
    assert!(sphere["points"].as_u64() > Some(1000) && sphere["smooth"].as_u64() > Some(900), "{sphere}");
    assert!(sphere["mesh_nodes"].as_u64() > Some(50), "{sphere}");
}

#[test]
fn less_light_shows_less() {
    let weak = surfaces(&WALL.replace("photons = 3000.0", "photons = 100.0"));
    let strong = surfaces(WALL);
    for (weak, strong) in weak.as_array().unwrap().iter().zip(strong.as_array().unwrap()) {
        let [weak_m, strong_m] = [weak, strong].map(|row| row["depth_sd_m"].as_f64());
        assert!(weak_m.is_none() || weak_m > strong_m, "{weak} {strong}");
        assert!(weak["points"].as_u64() <= strong["points"].as_u64(), "{weak} {strong}");
    }
    let (code, text, _) = design(WALL, &[]);
    assert!(code == Some(0) && text.contains("up to") && text.contains("sphere"), "{text}");
}

#[test]
fn what_a_wall_has_not_is_refused() {
    let (code, _, error) = design(WALL, &["--bounces", "2"]);
    assert!(code == Some(1) && error.contains("--bounces has no meaning for a wall"), "{error}");
    let (code, _, error) = design(&WALL.replace("photons", "fotons"), &[]);
    assert!(code == Some(1) && error.contains("did you mean `photons`"), "{error}");
    let (code, _, error) = design(WALL.split("[surfaces").next().unwrap(), &[]);
    assert!(code == Some(1) && error.contains("[surfaces.NAME]"), "{error}");
}
