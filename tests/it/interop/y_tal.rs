//! The real y-tal, SciPy, plyfile and laspy on our files, and ours on theirs.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;

use super::{PIPELINE, done};
use crate::locate::scene;
use periscope::exchange::{self, Defaults};
use periscope::store::Shelf;
use periscope::tables::{Row, Voxel};

const SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/it/interop/y_tal.py");

/// The first of these that has the packages; `None`, and said aloud, where none has.
static PYTHON: LazyLock<Option<PathBuf>> = LazyLock::new(|| {
    let target = Path::new(env!("CARGO_BIN_EXE_periscope")).ancestors().nth(2).unwrap();
    let given = std::env::var_os("PERISCOPE_PYTHON").map(PathBuf::from);
    let venv = target.join("python-tal");
    let mut pythons = given.into_iter().chain([venv.join("bin/python"), "python3".into()]);
    let has_all = |python: &PathBuf| {
        let imports = ["-c", "import laspy, plyfile, scipy.io, tal.io"];
        Command::new(python).args(imports).output().is_ok_and(|output| output.status.success())
    };
    let python = pythons.find(has_all);
    if python.is_none() {
        // Not by `eprintln!`, which the test harness swallows: a test that looked at nothing must not pass in silence.
        let _ = writeln!(
            std::io::stderr(),
            "NOT TESTED against y-tal: no Python has y-tal, scipy, plyfile and laspy; fix: python3 -m venv {0} && {0}/bin/pip install y-tal scipy plyfile laspy",
            venv.display()
        );
    }
    python
});

/// Runs the script; `false` where there is no Python to test with.
pub fn python(folder: &Path, args: &[&str]) -> bool {
    let Some(python) = PYTHON.as_ref() else { return false };
    let output = Command::new(python).arg(SCRIPT).args(args).current_dir(folder).output().unwrap();
    assert!(output.status.success(), "{args:?}\n{}", String::from_utf8_lossy(&output.stderr));
    true
}

#[test]
fn what_y_tal_writes_is_read_and_what_is_written_y_tal_reads() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    if !python(folder, &["make"]) {
        return;
    }
    for name in ["confocal", "packed", "list", "one-lit", "all", "all-list", "z-nlos", "z-nlos-confocal"] {
        let (capture, campaign, results, back) = (
            format!("{name}.hdf5"),
            format!("{name}-campaign"),
            format!("{name}-results"),
            format!("{name}-back.hdf5"),
        );
        done(folder, &["convert", &capture, "--out", &campaign, "--fwhm-ps", "70"]);
        python(folder, &["campaign", &capture, &campaign]);
        done(folder, &["run", PIPELINE, "--campaign", &campaign, "--out", &results, "--until", "profiles"]);
        done(folder, &["export", &results, &back, "--campaign", &campaign]);
        python(folder, &["same", &capture, &back]);
    }
    for version in ["5", "5-packed"] {
        let (capture, campaign) = (format!("scan-{version}.mat"), format!("scan-{version}"));
        done(folder, &["convert", &capture, "--out", &campaign, "--fwhm-ps", "70", "--dt-ps", "16"]);
        python(folder, &["scan", &campaign]);
    }
    done(folder, &["run", PIPELINE, "--campaign", "all-campaign", "--out", "all-results", "--until", "anchors"]);
    done(folder, &["export", "all-results", "wall.ply", "--patches", "anchors"]);
    python(folder, &["ply", "wall.ply", "all.hdf5"]);
}

/// A volume with the places of its voxels, of each method of a grid.
#[test]
fn a_volume_is_read_by_y_tal() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let (capture, hidden) = scene("dots", 1, 3000.0, 1);
    capture.write(&folder.join("scan.mat"), &hidden);
    done(folder, &["convert", "scan.mat", "--out", "campaign", "--fwhm-ps", "60", "--dt-ps", "8"]);
    for method in ["light-cone", "f-k"] {
        let set = format!("voxels.method={method}");
        let run =
            ["run", "image", "--campaign", "campaign", "--out", method, "--set", "voxels.volume=true", "--set", &set];
        done(folder, &run);
        done(folder, &["export", method, "volume.npy"]);
        done(folder, &["export", method, "volume.hdf5", "--volume"]);
        let shelf = Shelf::look(&folder.join(method)).unwrap();
        let voxels: Vec<Voxel> =
            shelf.batches("voxels").unwrap().iter().flat_map(|batch| Voxel::rows(batch).unwrap()).collect();
        let last = voxels.last().expect("a voxel");
        let cell = [last.grid_column, last.grid_row, last.grid_depth].map(|at| at.to_string());
        let place = [last.x_m, last.y_m, last.z_m].map(|along_m| along_m.to_string());
        let voxel: Vec<&str> = cell.iter().chain(&place).map(String::as_str).collect();
        python(folder, &[&["volume", "volume.hdf5", "volume.npy"], voxel.as_slice()].concat());
    }
}

#[test]
fn a_file_of_numpy_is_a_capture() {
    let folder = tempfile::tempdir().unwrap();
    if !python(folder.path(), &["points", "points.npz"]) {
        return;
    }
    let capture = exchange::read(&folder.path().join("points.npz"), &Defaults::default()).unwrap();
    assert_eq!((capture.pairs.len(), capture.bins(), capture.dt_ps), (6, 4, 16.0));
    for pair in &capture.pairs {
        let first = (100 * pair.lit + 10 * pair.seen) as f64;
        assert_eq!(capture.histogram(pair), [first, first + 1.0, first + 2.0, first + 3.0]);
        assert_eq!(pair.start_ps, 7.0);
    }
}
