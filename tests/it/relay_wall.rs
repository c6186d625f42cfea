//! A campaign that `convert` writes, run without a pipeline and without any editing: the verdict, the image, the gate.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use periscope::formats::{self, Source};
use periscope::report::{Report, page};
use periscope::store::Shelf;
use periscope::tables::{Decision, Image, JointSearch, Patch, Row, SurfacePoint, Voxel};

use crate::locate::scene;
use crate::relay_scene::{FWHM_PS, periscope};

/// A converted scan of 64 points.
fn converted(kind: &str, count: usize, photons: f64, more: &[&str]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let (capture, hidden) = scene(kind, count, photons, 1);
    capture.write(&folder.path().join("scan.mat"), &hidden);
    let (fwhm, dt) = (FWHM_PS.to_string(), capture.dt_ps.to_string());
    let convert = ["convert", "scan.mat", "--out", "campaign", "--fwhm-ps", &fwhm, "--dt-ps", &dt];
    periscope(folder.path(), &[&convert, more].concat());
    folder
}

fn run(folder: &Path, more: &[&str]) -> Output {
    let args = [&["run", "--campaign", "campaign", "--progress", "none"], more].concat();
    let output = Command::new(env!("CARGO_BIN_EXE_periscope")).args(args).current_dir(folder).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    output
}

fn rows<R: Row>(folder: &Path, view: &str) -> Vec<R> {
    let shelf = Shelf::look(&folder.join("campaign-results")).unwrap();
    shelf.batches(view).unwrap().iter().flat_map(|batch| R::rows(batch).unwrap()).collect()
}

#[test]
fn a_letter_is_an_extended_object_with_an_image() {
    let folder = converted("letter 20 cm", 0, 3000.0, &[]);
    let output = run(folder.path(), &["--set", "voxels.volume=true"]);
    let (said, warned) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(warned.contains("pipeline locate: campaign.toml has a relay wall"), "{warned}");
    let last: Vec<&str> = said.lines().rev().take(7).collect();
    assert!(last[6].contains("hidden things") && last[6].contains("an extended object"), "{said}");
    assert!(last[5].contains("points of a surface with error bars"), "{said}");
    assert!(last[4].contains("shapes") && last[3].contains("meshes"), "{said}");
    assert!(last[2].contains("voxels brighter than noise"), "{said}");
    let patches: Vec<Patch> = rows(folder.path(), "patches");
    assert!(patches.len() == 64 && patches.iter().all(|patch| &*patch.kind == "visible"), "{}", patches.len());
    let decisions: Vec<Decision> = rows(folder.path(), "decisions");
    assert_eq!(&*decisions[0].what, "hidden things");
    // First light shows the surface of an extended object.
    let surface: Vec<SurfacePoint> = rows(folder.path(), "surface");
    let text = format!("{} points of a surface", surface.len());
    assert!(!surface.is_empty() && decisions[1].chosen.starts_with(&text), "{}", decisions[1].chosen);
    // The report has the verdict first, and the image where places stand.
    let page = page::page(&Report::of(&folder.path().join("campaign-results")).unwrap());
    let at = |text: &str| page.find(text).unwrap_or_else(|| panic!("{text} is not in the report"));
    assert!(at("hidden things: an extended object") < at("What the wall shows"));
    assert!(at("image-0") < at("Positions of 64 patches") && page.contains("image-2"));
    // The volume has the voxels of the table at their places.
    periscope(folder.path(), &["export", "campaign-results", "volume.npy"]);
    let mut file = Source::open(&folder.path().join("volume.npy")).unwrap();
    let records = formats::records(&mut file).unwrap();
    let image: Image = rows(folder.path(), "voxels.images").remove(0);
    let shape = [image.rows, image.columns, image.depths].map(|count| count as usize);
    assert_eq!(records.len(), shape[0] * shape[1]);
    let bytes = fs::read(folder.path().join("volume.npy")).unwrap();
    let values = &bytes[bytes.len() - 4 * shape.iter().product::<usize>()..];
    let voxels: Vec<Voxel> = rows(folder.path(), "voxels");
    assert!(!voxels.is_empty());
    for voxel in voxels {
        let place = (voxel.grid_row as usize * shape[1] + voxel.grid_column as usize) * shape[2];
        let at = 4 * (place + voxel.grid_depth as usize);
        let value = f32::from_le_bytes(values[at..at + 4].try_into().unwrap());
        assert_eq!(value, voxel.value as f32, "{voxel:?}");
    }
}

#[test]
fn dots_are_points_in_the_last_lines_of_the_run() {
    let folder = converted("dots", 3, 300.0, &[]);
    let output = run(folder.path(), &[]);
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(said.contains("hidden things            3 points with error bars, in `patches`"), "{said}");
    let patches: Vec<Patch> = rows(folder.path(), "patches");
    assert_eq!(patches.iter().filter(|patch| &*patch.kind == "hidden").count(), 3);
    assert_eq!(rows::<SurfacePoint>(folder.path(), "surface"), []);
    let error = Command::new(env!("CARGO_BIN_EXE_periscope"))
        .args(["export", "campaign-results", "volume.npy"])
        .current_dir(folder.path())
        .output()
        .unwrap();
    let error = String::from_utf8_lossy(&error.stderr).into_owned();
    assert!(error.contains("--set voxels.volume=true"), "{error}");
}

/// `locate` and `image` take the gate of the sensor; a parameter goes before it.
#[test]
fn the_gate_that_a_user_knows_is_taken() {
    let folder = converted("dots", 3, 300.0, &["--gate", "950"]);
    let keys = fs::read_to_string(folder.path().join("campaign/campaign.toml")).unwrap();
    assert!(keys.contains("gate_ps = 950.0"), "{keys}");
    let gates = || {
        let search: JointSearch = rows(folder.path(), "patches.searches").remove(0);
        let image: Image = rows(folder.path(), "voxels.images").remove(0);
        [search.gate_ps, image.gate_ps]
    };
    run(folder.path(), &[]);
    assert_eq!(gates(), [950.0, 950.0]);
    run(folder.path(), &["--set", "patches.gate_ps=700"]);
    assert_eq!(gates(), [700.0, 950.0]);
    fs::write(folder.path().join("campaign/campaign.toml"), keys.replace("gate_ps = 950.0", "gate_ps = 800.0"))
        .unwrap();
    run(folder.path(), &[]);
    assert_eq!(gates(), [800.0, 800.0]);
}

/// Each histogram is a segment of one file: a part holds as many as come to its size, and not each the whole file's.
#[test]
fn a_part_holds_many_captures_of_one_file() {
    let folder = converted("dots", 3, 300.0, &[]);
    let bytes = fs::metadata(folder.path().join("campaign/raw/histograms.npy")).unwrap().len();
    let file = folder.path().join("campaign/campaign.toml");
    let keys = fs::read_to_string(&file).unwrap();
    let keys = keys.replacen("[campaign]\n", &format!("[campaign]\npart_bytes = {}\n", bytes / 4), 1);
    fs::write(&file, keys).unwrap();
    run(folder.path(), &["--until", "profiles"]);
    let profiles = fs::read_dir(folder.path().join("campaign-results/profiles")).unwrap().flatten();
    let parts = profiles.filter(|entry| entry.path().extension().is_some_and(|end| end == "parquet")).count();
    // Four in the mean, one more where the campaign ends.
    assert!((2..=14).contains(&parts), "{parts} parts of 64 captures");
}
