//! The drivers of pipelines/cluster, checked and run: Dask, Snakemake and the script for Slurm, in the versions of
//! tests/cluster/requirements.txt.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Python with the packages of the drivers and their tests: that of PERISCOPE_PYTHON_CLUSTER, else of a virtual
/// environment in the target folder.
fn python() -> Option<PathBuf> {
    let target = Path::new(env!("CARGO_BIN_EXE_periscope")).ancestors().nth(2).unwrap();
    let given = std::env::var_os("PERISCOPE_PYTHON_CLUSTER").map(PathBuf::from);
    let python = given.unwrap_or_else(|| target.join("python-cluster/bin/python"));
    let imports = "import dask_jobqueue, distributed, mypy, pytest, ruff, snakemake";
    let has_all = Command::new(&python).args(["-c", imports]).output().is_ok_and(|output| output.status.success());
    if !has_all {
        // Not by `eprintln!`, which the test harness swallows: a test that looked at nothing must not pass in silence.
        let venv = target.join("python-cluster");
        let _ = writeln!(
            std::io::stderr(),
            "NOT TESTED with Dask and Snakemake: {} lacks something of tests/cluster/requirements.txt; fix: python3 -m venv {1} && {1}/bin/pip install -r tests/cluster/requirements.txt",
            python.display(),
            venv.display(),
        );
    }
    has_all.then_some(python)
}

/// Runs a module of Python in the clone; it must end well.
fn run(python: &Path, arguments: &[&str]) {
    let output = Command::new(python)
        .arg("-m")
        .args(arguments)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .env("PERISCOPE", env!("CARGO_BIN_EXE_periscope"))
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .output()
        .unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    assert!(output.status.success(), "{arguments:?}\n{}\n{}", text(&output.stdout), text(&output.stderr));
}

#[test]
fn drivers_are_typed_and_in_order() {
    let Some(python) = python() else { return };
    let files = ["pipelines/cluster", "tests/cluster", "benches/scale.py"];
    run(&python, &[&["ruff", "check", "--no-cache", "--config", "tests/cluster/pyproject.toml"], &files[..]].concat());
    run(
        &python,
        &[&["ruff", "format", "--check", "--no-cache", "--config", "tests/cluster/pyproject.toml"], &files[..]]
            .concat(),
    );
    let mypy = ["mypy", "--config-file", "tests/cluster/pyproject.toml", "--cache-dir", "/dev/null"];
    run(&python, &[&mypy, &files[..]].concat());
}

/// Workers and schedulers that are killed, cancelled jobs, and the bytes of a single run.
#[test]
fn drivers_survive_what_happens_and_make_the_bytes_of_a_single_run() {
    let Some(python) = python() else { return };
    run(&python, &["pytest", "-q", "-x", "-p", "no:cacheprovider", "tests/cluster"]);
}

#[test]
fn drivers_are_tested_with_what_they_ask_for() {
    let lines = |text: &'static str| text.lines().filter(|line| !line.starts_with('#'));
    let tested: Vec<&str> = lines(include_str!("../cluster/requirements.txt")).collect();
    assert!(lines(include_str!("../../pipelines/cluster/requirements.txt")).all(|line| tested.contains(&line)));
}
