//! Images of what a wall shows, through files: captures made here, converted, and run by the built-in pipeline. No code
//! is shared with what reads or images them.

use std::fs;
use std::path::Path;
use std::process::Command;

use periscope::formats::array::Array;
use periscope::store::Shelf;
use periscope::tables::{Image, Row, Voxel};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Poisson};

use crate::interop::scene::{self, LIGHT, Layout, Made, gap_m};

const SIDE: usize = 24;
const HALF_M: f64 = 0.3;
const BINS: usize = 400;
const DT_PS: f64 = 10.0;
const FWHM_PS: f64 = 60.0;
const PITCH_M: f64 = 2.0 * HALF_M / (SIDE - 1) as f64;

/// A hidden point: place, and photons in the highest bin of a histogram half a metre away.
type Source = ([f64; 3], f64);

/// A plate like the letter L, at this depth.
fn letter(depth_m: f64) -> Vec<Source> {
    let bar = |[left, right]: [f64; 2], [low, high]: [f64; 2]| {
        let along = |[from, to]: [f64; 2]| (0..).map(move |n| from + 0.01 * f64::from(n)).take_while(move |x| *x < to);
        along([left, right]).flat_map(move |x| along([low, high]).map(move |y| ([x, y, depth_m], 1.0)))
    };
    bar([-0.15, -0.07], [-0.2, 0.2]).chain(bar([-0.07, 0.15], [-0.2, -0.12])).collect()
}

fn points() -> Vec<Source> {
    vec![([0.1, -0.05, 0.33], 40.0), ([-0.15, 0.12, 0.42], 40.0), ([0.02, 0.2, 0.5], 40.0)]
}

/// Writes a confocal scan: light of the wall, its tail, dark counts, and what is hidden.
fn write_scan(path: &Path, hidden: &[Source], seed: u64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let along = |place: usize| PITCH_M * place as f64 - HALF_M;
    let sigma_ps = FWHM_PS / 2.354_820_045;
    let mut values = vec![0.0; BINS * SIDE * SIDE];
    for point in 0..SIDE * SIDE {
        let wall = [along(point % SIDE), along(point / SIDE), 0.0];
        let mut mean = [0.0; BINS];
        for (bin, mean) in mean.iter_mut().enumerate() {
            let time_ps = (bin as f64 + 0.5) * DT_PS;
            *mean = 0.2 + 3e3 * (-0.5 * (time_ps / sigma_ps).powi(2)).exp() + 30.0 * (-time_ps / 300.0).exp();
        }
        for (place, photons) in hidden {
            let distance_m = gap_m(wall, *place);
            let arrival_ps = 2.0 * distance_m / LIGHT;
            let peak = photons * (0.5 / distance_m).powi(4);
            let first = ((arrival_ps - 5.0 * sigma_ps) / DT_PS).max(0.0) as usize;
            for (bin, mean) in mean.iter_mut().enumerate().skip(first).take(30) {
                let time_ps = (bin as f64 + 0.5) * DT_PS;
                *mean += peak * (-0.5 * ((time_ps - arrival_ps) / sigma_ps).powi(2)).exp();
            }
        }
        for (bin, mean) in mean.into_iter().enumerate() {
            values[bin * SIDE * SIDE + point] = Poisson::new(mean).unwrap().sample(&mut rng);
        }
    }
    let arrays = [("rect_data", Array::of(&[BINS, SIDE, SIDE], &values)), ("width", Array::of(&[1, 1], &[HALF_M]))];
    scene::save(path, &arrays.map(|(name, array)| (name.to_owned(), array)).into());
}

/// Runs the program; it must succeed.
fn periscope(folder: &Path, args: &[&str]) {
    let output = Command::new(env!("CARGO_BIN_EXE_periscope")).args(args).current_dir(folder).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{args:?}\n{}", String::from_utf8_lossy(&output.stderr));
}

/// Converts `scan.mat` of a folder.
fn convert(folder: &Path) {
    let (fwhm, dt) = (FWHM_PS.to_string(), DT_PS.to_string());
    periscope(folder, &["convert", "scan.mat", "--out", "campaign", "--fwhm-ps", &fwhm, "--dt-ps", &dt]);
}

/// Runs the built-in pipeline: voxels, and the image as a whole.
fn run(folder: &Path, out: &str, more: &[&str]) -> (Vec<Voxel>, Image) {
    periscope(folder, &[&["run", "image", "--campaign", "campaign", "--out", out], more].concat());
    let shelf = Shelf::look(&folder.join(out)).unwrap();
    let voxels = shelf.batches("voxels").unwrap().iter().flat_map(|batch| Voxel::rows(batch).unwrap()).collect();
    let images: Vec<Image> =
        shelf.batches("voxels.images").unwrap().iter().flat_map(|batch| Image::rows(batch).unwrap()).collect();
    assert_eq!(images.len(), 1);
    println!("{:?}", images[0]);
    (voxels, images[0].clone())
}

fn image_of(hidden: &[Source], seed: u64) -> (Vec<Voxel>, Image) {
    let folder = tempfile::tempdir().unwrap();
    write_scan(&folder.path().join("scan.mat"), hidden, seed);
    convert(folder.path());
    run(folder.path(), "results", &[])
}

/// The most significant voxel among some.
fn brightest<'a>(voxels: impl Iterator<Item = &'a Voxel>) -> &'a Voxel {
    voxels.max_by(|a, b| a.significance.total_cmp(&b.significance)).expect("a voxel")
}

#[test]
fn a_plate_lies_at_its_depth() {
    let depth_m = 0.4;
    let plate = letter(depth_m);
    let (voxels, image) = image_of(&plate, 1);
    assert!(&*image.method == "light-cone" && (image.columns, image.rows) == (SIDE as i32, SIDE as i32));
    assert!((60.0..500.0).contains(&image.gate_ps), "{}", image.gate_ps);
    // The brightest voxel of each column in front of the plate, half a pitch from its edges or more.
    let mut depths_m = Vec::new();
    let is_on = |x_m: f64, y_m: f64| plate.iter().any(|([x, y, _], _)| (x_m - x).hypot(y_m - y) < 0.01);
    let mut missing = 0;
    for column in 0..SIDE * SIDE {
        let at = |place: usize| PITCH_M * place as f64 - HALF_M;
        let (x_m, y_m) = (at(column % SIDE), at(column / SIDE));
        let here: Vec<&Voxel> = voxels.iter().filter(|voxel| (voxel.x_m - x_m).hypot(voxel.y_m - y_m) < 1e-6).collect();
        if is_on(x_m, y_m) {
            if here.is_empty() {
                missing += 1;
            } else {
                depths_m.push(brightest(here.into_iter()).z_m);
            }
        }
    }
    depths_m.sort_by(f64::total_cmp);
    let median_m = depths_m[depths_m.len() / 2];
    println!("{} columns on the plate, {missing} without voxel, median depth {median_m}", depths_m.len());
    assert!(missing * 10 < depths_m.len());
    assert!((median_m - depth_m).abs() < 0.003, "{median_m}");
    let off =
        voxels.iter().filter(|voxel| !is_on(voxel.x_m, voxel.y_m) && voxel.significance > 0.5 * image.largest.unwrap());
    assert_eq!(off.count(), 0);
}

#[test]
fn points_lie_at_their_places() {
    let (voxels, image) = image_of(&points(), 2);
    for (place, _) in points() {
        let near = voxels.iter().filter(|voxel| gap_m([voxel.x_m, voxel.y_m, voxel.z_m], place) < 0.06);
        let best = brightest(near);
        let step_m = 0.5 * DT_PS * LIGHT * image.depth_max_m / place[2];
        println!("{place:?}: {best:?}, step in depth {step_m}");
        assert!((best.x_m - place[0]).abs() < 1.5 * PITCH_M && (best.y_m - place[1]).abs() < 1.5 * PITCH_M);
        assert!((best.z_m - place[2]).abs() < 1.5 * step_m, "{}", best.z_m);
    }
}

/// f-k migration: places, depths between its equal steps, and no voxel of a scene without anything.
#[test]
fn points_migrate_to_their_places() {
    let folder = tempfile::tempdir().unwrap();
    let migrated = ["--set", "voxels.method=f-k"];
    write_scan(&folder.path().join("scan.mat"), &points(), 2);
    convert(folder.path());
    let (voxels, image) = run(folder.path(), "results", &migrated);
    assert_eq!(&*image.method, "f-k");
    for (place, _) in points() {
        let near = voxels.iter().filter(|voxel| gap_m([voxel.x_m, voxel.y_m, voxel.z_m], place) < 0.06);
        let best = brightest(near);
        println!("{place:?}: {best:?}");
        assert!((best.x_m - place[0]).abs() < 1.5 * PITCH_M && (best.y_m - place[1]).abs() < 1.5 * PITCH_M);
        // A step of depth is half the path within a bin.
        assert!((best.z_m - place[2]).abs() < 1.5 * 0.5 * DT_PS * LIGHT, "{}", best.z_m);
        let at = [best.grid_column, best.grid_row, best.grid_depth].map(|n| n as usize);
        assert!(gap_m(image.point_m(at), [best.x_m, best.y_m, best.z_m]) < 1e-9);
    }
    for seed in 3..8 {
        let folder = tempfile::tempdir().unwrap();
        write_scan(&folder.path().join("scan.mat"), &[], seed);
        convert(folder.path());
        let (voxels, image) = run(folder.path(), "results", &migrated);
        assert!(voxels.is_empty() && image.largest.unwrap() < image.threshold, "{image:?}");
    }
}

#[test]
fn an_empty_scene_has_no_voxel() {
    for seed in 3..8 {
        let (voxels, image) = image_of(&[], seed);
        assert!(voxels.is_empty() && image.voxels == 0, "{:?}", voxels[0]);
        assert!(image.largest.unwrap() < image.threshold);
    }
}

#[test]
fn the_order_of_captures_and_the_number_of_threads_change_nothing() {
    let folder = tempfile::tempdir().unwrap();
    write_scan(&folder.path().join("scan.mat"), &points(), 2);
    convert(folder.path());
    let (voxels, image) = run(folder.path(), "one", &["--threads", "1"]);
    let table = folder.path().join("campaign/captures.csv");
    let text = fs::read_to_string(&table).unwrap();
    let (head, rows) = text.split_once('\n').unwrap();
    let reversed: Vec<&str> = std::iter::once(head).chain(rows.lines().rev()).collect();
    fs::write(&table, reversed.join("\n") + "\n").unwrap();
    let (again, same) = run(folder.path(), "two", &["--threads", "3"]);
    let bytes = |batch: arrow_array::RecordBatch| format!("{batch:?}");
    assert!(!voxels.is_empty());
    assert_eq!(bytes(Voxel::to_batch(&voxels)), bytes(Voxel::to_batch(&again)));
    assert_eq!(bytes(Image::to_batch(&[image])), bytes(Image::to_batch(&[same])));
}

#[test]
fn pairs_of_any_layout_are_back_projected() {
    let folder = tempfile::tempdir().unwrap();
    let made = Made { layout: Layout::OneLit, side: 8, with_legs: true, counts: true, seed: 1 };
    made.write(&folder.path().join("capture.hdf5"));
    let fwhm = scene::FWHM_PS.to_string();
    periscope(folder.path(), &["convert", "capture.hdf5", "--out", "campaign", "--fwhm-ps", &fwhm]);
    let (voxels, image) = run(folder.path(), "results", &["--set", "voxels.pitch_m=0.02"]);
    assert_eq!((&*image.method, image.histograms), ("back-projection", 64));
    for place in scene::HIDDEN {
        let near = voxels.iter().filter(|voxel| gap_m([voxel.x_m, voxel.y_m, voxel.z_m], place) < 0.15);
        let best = brightest(near);
        println!("{place:?}: {best:?}");
        assert!(gap_m([best.x_m, best.y_m, best.z_m], place) < 0.03, "{best:?}");
    }
}
