//! Whether Python can read our tables as a lab would: DuckDB, Polars, pandas and PyArrow, in the versions of
//! queries/requirements.txt.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::LazyLock;

/// The Python of the environment variable PERISCOPE_PYTHON, else of a virtual environment in the target folder; `None`
/// if packages are missing.
static PYTHON: LazyLock<Option<PathBuf>> = LazyLock::new(|| {
    let target = Path::new(env!("CARGO_BIN_EXE_periscope")).ancestors().nth(2).unwrap();
    let given = std::env::var_os("PERISCOPE_PYTHON").map(PathBuf::from);
    let python = given.unwrap_or_else(|| target.join("python/bin/python"));
    let imports = "import duckdb, numpy, pandas, polars, pyarrow";
    let has_all = Command::new(&python).args(["-c", imports]).output().is_ok_and(|output| output.status.success());
    if !has_all {
        // Not by `eprintln!`, which the test harness swallows: a test that looked at nothing must not pass in silence.
        let venv = target.join("python");
        let _ = writeln!(
            std::io::stderr(),
            "NOT TESTED in Python: {python} has not all of {imports}; fix: python3 -m venv {venv} && {venv}/bin/pip install -r queries/requirements.txt",
            python = python.display(),
            imports = imports.trim_start_matches("import "),
            venv = venv.display(),
        );
    }
    has_all.then_some(python)
});

/// Runs Python with these arguments in a folder; `None` where there is no Python to test with.
pub fn python(folder: &Path, args: &[&str]) -> Option<Output> {
    let python = PYTHON.as_ref()?;
    Some(Command::new(python).args(args).current_dir(folder).env("PYTHONDONTWRITEBYTECODE", "1").output().unwrap())
}

/// What it prints; it must not fail.
pub fn printed(folder: &Path, args: &[&str]) -> Option<String> {
    let output = python(folder, args)?;
    assert!(output.status.success(), "{args:?}\n{}", String::from_utf8_lossy(&output.stderr));
    Some(String::from_utf8(output.stdout).unwrap())
}
