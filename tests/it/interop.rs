//! Captures of other programs to campaigns and positions, and results to files that other programs open.

mod mat;
pub mod scene;
pub mod y_tal;

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use nalgebra::{Matrix3, Vector3};
use periscope::exchange::{self, Capture, Defaults, ply};
use periscope::formats::array::{Array, Arrays};
use periscope::tables::{Patch, SurfacePoint};

use scene::{DT_PS, FWHM_PS, HIDDEN, LIGHT, Layout, Made, gap_m, save};

const PIPELINE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/pipelines/scene.toml");

fn periscope(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_periscope")).args(args).current_dir(folder).output().unwrap()
}

/// What a command prints; it must not fail.
fn done(folder: &Path, args: &[&str]) -> String {
    let output = periscope(folder, args);
    assert_eq!(output.status.code(), Some(0), "{args:?}\n{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn fwhm() -> String {
    FWHM_PS.to_string()
}

/// Converts `capture.hdf5` of a folder and runs it; what is found.
fn patches_of(folder: &Path) -> Vec<Patch> {
    done(folder, &["convert", "capture.hdf5", "--out", "campaign", "--fwhm-ps", &fwhm()]);
    // With one lit point `range` says that distances stay open, which is exit code 3: `refine` takes the sums.
    let run = periscope(folder, &["run", PIPELINE, "--campaign", "campaign", "--out", "results"]);
    assert!(matches!(run.status.code(), Some(0 | 3)), "{}", String::from_utf8_lossy(&run.stderr));
    let shelf = periscope::store::Shelf::look(&folder.join("results")).unwrap();
    let batches = shelf.batches("patches").unwrap();
    batches.iter().flat_map(|batch| <Patch as periscope::tables::Row>::rows(batch).unwrap()).collect()
}

/// Squared error of a hidden point in units of its variance, over three; the point must exist. Prints both in
/// millimetres, for docs/interoperation.md.
fn squared_error(patches: &[Patch], truth: [f64; 3]) -> f64 {
    let at = |patch: &&Patch| gap_m([patch.x_m, patch.y_m, patch.z_m], truth);
    let hidden = patches.iter().filter(|patch| patch.alternative == 0 && &*patch.kind == "hidden");
    let patch = hidden.min_by(|a, b| at(a).total_cmp(&at(b))).expect("a hidden patch");
    assert!(at(&patch) < 0.002, "{truth:?} is {} m from what was found", at(&patch));
    println!("error {:.3} mm, standard deviation {:.3} mm", 1e3 * at(&patch), 1e3 * patch.sd_m.unwrap());
    let cov = |value: Option<f64>| value.unwrap();
    let (xy, xz, yz) = (cov(patch.cov_xy_m2), cov(patch.cov_xz_m2), cov(patch.cov_yz_m2));
    let (xx, yy, zz) = (cov(patch.cov_xx_m2), cov(patch.cov_yy_m2), cov(patch.cov_zz_m2));
    let covariance = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
    let error = Vector3::new(patch.x_m, patch.y_m, patch.z_m) - Vector3::from(truth);
    error.dot(&(covariance.try_inverse().unwrap() * error)) / 3.0
}

#[test]
fn hidden_points_are_found_from_captures_of_every_layout() {
    let mut errors = Vec::new();
    for (seed, layout, with_legs, counts) in [
        (1, Layout::Confocal, true, true),
        (2, Layout::Confocal, false, true),
        (3, Layout::Confocal, true, false),
        (4, Layout::OneLit, true, true),
        (5, Layout::All, false, true),
    ] {
        let side = if layout == Layout::All { 3 } else { 5 };
        let made = Made { layout, side, with_legs, counts, seed };
        let folder = tempfile::tempdir().unwrap();
        made.write(&folder.path().join("capture.hdf5"));
        let patches = patches_of(folder.path());
        let hidden = patches.iter().filter(|patch| patch.alternative == 0 && &*patch.kind == "hidden").count();
        assert_eq!(hidden, HIDDEN.len(), "{made:?}");
        println!("{made:?}");
        errors.extend(HIDDEN.map(|truth| squared_error(&patches, truth)));
    }
    // Thirty coordinates: the mean lies between these in all but one of some 10,000 sets of draws.
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    println!("mean squared error {mean:.2} of what the covariances claim");
    assert!((0.3..2.2).contains(&mean), "{errors:?}");
}

/// Whether two captures say the same.
fn assert_equal(one: &Capture, other: &Capture) {
    assert!((one.dt_ps - other.dt_ps).abs() < 1e-9 && one.bins() == other.bins());
    assert_eq!(one.pairs.len(), other.pairs.len());
    for (a, b) in one.pairs.iter().zip(&other.pairs) {
        assert!((a.start_ps - b.start_ps).abs() < 1e-6, "{} and {} ps", a.start_ps, b.start_ps);
        assert_eq!(one.histogram(a), other.histogram(b));
        for (spot, same) in
            [(one.lit.spots[a.lit], other.lit.spots[b.lit]), (one.seen.spots[a.seen], other.seen.spots[b.seen])]
        {
            assert!(gap_m(spot.position_m, same.position_m) < 1e-9);
            assert_eq!(spot.normal, same.normal);
        }
    }
    assert_eq!((one.with_legs, one.laser_m, one.sensor_m), (other.with_legs, other.laser_m, other.sensor_m));
    assert_eq!((&one.seen.axes, one.lit.spots.len()), (&other.seen.axes, other.lit.spots.len()));
}

#[test]
fn a_capture_comes_back_from_a_result_folder_as_it_was() {
    for (layout, with_legs) in [(Layout::Confocal, false), (Layout::OneLit, true), (Layout::All, true)] {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        Made { layout, side: 3, with_legs, counts: true, seed: 9 }.write(&path("capture.hdf5"));
        done(folder.path(), &["convert", "capture.hdf5", "--out", "campaign", "--fwhm-ps", &fwhm()]);
        done(folder.path(), &["run", PIPELINE, "--campaign", "campaign", "--out", "results", "--until", "profiles"]);
        let printed = done(folder.path(), &["export", "results", "back.hdf5", "--campaign", "campaign"]);
        assert!(printed.contains("bins of 16.000 ps"), "{printed}");
        let read = |name: &str| exchange::read(&path(name), &Defaults::default()).unwrap();
        assert_equal(&read("capture.hdf5"), &read("back.hdf5"));
    }
}

#[test]
fn times_in_the_campaign_lead_from_laser_to_sensor() {
    for with_legs in [true, false] {
        let made = Made { layout: Layout::Confocal, side: 2, with_legs, counts: true, seed: 1 };
        let folder = tempfile::tempdir().unwrap();
        made.write(&folder.path().join("capture.hdf5"));
        done(folder.path(), &["convert", "capture.hdf5", "--out", "campaign", "--fwhm-ps", &fwhm()]);
        let table = fs::read_to_string(folder.path().join("campaign/captures.csv")).unwrap();
        for (row, point) in table.lines().skip(1).zip(made.wall()) {
            let t0_ps: f64 = row.rsplit(',').next().unwrap().parse().unwrap();
            let legs_m = if with_legs { 0.0 } else { gap_m(scene::LASER, point) + gap_m(point, scene::SENSOR) };
            let expected_ps = (made.start_m() + legs_m) / LIGHT + 0.5 * DT_PS;
            assert!((t0_ps - expected_ps).abs() < 1e-6, "{t0_ps} is not {expected_ps}");
        }
    }
}

#[test]
fn every_so_manieth_point_may_be_kept() {
    let folder = tempfile::tempdir().unwrap();
    Made { layout: Layout::All, side: 3, with_legs: true, counts: true, seed: 1 }
        .write(&folder.path().join("capture.hdf5"));
    let printed = done(folder.path(), &["convert", "capture.hdf5", "--out", "c", "--fwhm-ps", "70", "--every", "2"]);
    assert!(printed.contains("16 histograms") && printed.contains("4 points"), "{printed}");
}

/// A capture as of Z-NLOS, its number at each place telling where it is.
fn z_nlos(axes: &[usize], lit: usize, reversed: bool) -> Arrays {
    let count: usize = axes.iter().product();
    let values: Vec<f64> = (0..count).map(|place| place as f64).collect();
    let grid = |side: usize, shift: f64| {
        let points = (0..side).flat_map(|a| (0..side).map(move |b| [a as f64 + shift, b as f64, 0.0]));
        let points: Vec<[f64; 3]> = points.collect();
        if reversed {
            // x, y and z first, then the grid's axes in reverse order.
            let part = |k: usize| {
                (0..side)
                    .flat_map(|b| (0..side).map(|a| points[a * side + b][k]).collect::<Vec<_>>())
                    .collect::<Vec<f64>>()
            };
            Array::of(&[3, side, side], &(0..3).flat_map(part).collect::<Vec<f64>>())
        } else {
            Array::of(&[side, side, 3], points.as_flattened())
        }
    };
    let arrays = [
        ("data", Array::of(axes, &values)),
        ("cameraGridPositions", grid(2, 0.0)),
        ("laserGridPositions", grid(lit, 10.0)),
        ("cameraPosition", Array::of(&[3], &[0.0, 0.0, 3.0])),
        ("laserPosition", Array::of(&[1, 3], &[1.0, 0.0, 3.0])),
        ("deltaT", Array::of(&[1], &[0.003])),
        ("t0", Array::of(&[1], &[0.3])),
    ];
    arrays.map(|(name, array)| (name.to_owned(), array)).into()
}

/// Indices of a value in an array, from its colour, bounce and bin, and its places in the grids of seen and lit points.
type Place = fn(usize, usize, usize, [usize; 2], [usize; 2]) -> Vec<usize>;

#[test]
fn captures_of_z_nlos_are_read_in_all_their_orders() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("z.hdf5");
    let (colours, bounces, bins) = (2, 6, 5);
    // Sizes of the axes, lit points along an axis, whether the grid's own axes are reversed, and the order.
    let orders: [(Vec<usize>, usize, bool, Place); 4] = [
        (vec![colours, bins, bounces, 2, 2], 2, true, |c, b, t, s, _| vec![c, t, b, s[1], s[0]]),
        (vec![2, 2, bounces, bins, colours], 2, false, |c, b, t, s, _| vec![s[0], s[1], b, t, c]),
        (vec![colours, bins, bounces, 2, 2, 1, 1], 1, true, |c, b, t, s, l| vec![c, t, b, s[1], s[0], l[1], l[0]]),
        (vec![1, 1, 2, 2, bounces, bins, colours], 1, false, |c, b, t, s, l| vec![l[1], l[0], s[1], s[0], b, t, c]),
    ];
    for (axes, lit, reversed, place) in orders {
        save(&path, &z_nlos(&axes, lit, reversed));
        let capture = exchange::read(&path, &Defaults::default()).unwrap();
        assert!((capture.dt_ps - 0.003 / LIGHT).abs() < 1e-9 && capture.with_legs);
        assert_eq!((capture.bins(), capture.pairs.len()), (bins, 4));
        for pair in &capture.pairs {
            let seen = capture.seen.spots[pair.seen].position_m;
            let lit = capture.lit.spots[pair.lit].position_m;
            assert!((pair.start_ps - 0.3 / LIGHT).abs() < 1e-6);
            let (s, l) = ([seen[0] as usize, seen[1] as usize], [lit[0] as usize - 10, lit[1] as usize]);
            let at = |c: usize, b: usize, t: usize| {
                place(c, b, t, s, l).iter().zip(&axes).fold(0, |at, (i, length)| at * length + i) as f64
            };
            let sum =
                |t: usize| (0..colours).flat_map(|c| (0..bounces).map(move |b| (c, b))).map(|(c, b)| at(c, b, t)).sum();
            let expected: Vec<f64> = (0..bins).map(sum).collect();
            assert_eq!(capture.histogram(pair), expected, "{axes:?}, seen {seen:?}");
        }
    }
}

#[test]
fn patches_become_a_point_cloud() {
    let patch = |number: i32, kind: &str, alternative: i32, cov_m2: Option<f64>| Patch {
        patch: number,
        kind: kind.into(),
        x_m: 0.5,
        y_m: -0.25,
        z_m: 2.0,
        cov_xx_m2: cov_m2,
        cov_xy_m2: cov_m2,
        cov_xz_m2: cov_m2,
        cov_yy_m2: cov_m2,
        cov_yz_m2: cov_m2,
        cov_zz_m2: cov_m2,
        sd_m: cov_m2,
        onsets: 1,
        alternative,
        ..Patch::default()
    };
    let patches = [patch(3, "visible", 0, None), patch(9, "hidden", 0, Some(1e-6)), patch(9, "hidden", 1, None)];
    let mut bytes = Vec::new();
    assert_eq!(ply::write(&mut bytes, &patches).unwrap(), 2);
    let text = String::from_utf8(bytes).unwrap();
    let (head, rows) = text.split_once("end_header\n").unwrap();
    let properties = head.lines().filter(|line| line.starts_with("property")).count();
    assert!(head.starts_with("ply\nformat ascii 1.0\n") && head.contains("element vertex 2\n"), "{head}");
    let rows: Vec<Vec<&str>> = rows.lines().map(|row| row.split(' ').collect()).collect();
    assert!(rows.len() == 2 && rows.iter().all(|row| row.len() == properties), "{text}");
    assert_eq!(rows[0][..9], ["0.5", "-0.25", "2", "160", "160", "160", "3", "0", "nan"]);
    assert_eq!(rows[1][6..9], ["9", "1", "1e-6"]);
}

#[test]
fn points_of_a_surface_become_vertices_and_rows() {
    let point = |seen: i32, kind: &str, sd_m: f64| SurfacePoint {
        lit: seen,
        seen,
        x_m: 0.5,
        y_m: -0.25,
        z_m: 2.0,
        normal_z: -1.0,
        cov_zz_m2: sd_m * sd_m,
        sd_m,
        kind: kind.into(),
        ..SurfacePoint::default()
    };
    let points = [point(3, "smooth", 1e-3), point(4, "edge", 4e-3), point(5, "unknown", 2e-3)];
    let mut bytes = Vec::new();
    ply::write_surface(&mut bytes, &points).unwrap();
    let text = String::from_utf8(bytes).unwrap();
    let (head, rows) = text.split_once("end_header\n").unwrap();
    let properties = head.lines().filter(|line| line.starts_with("property")).count();
    let rows: Vec<Vec<&str>> = rows.lines().map(|row| row.split(' ').collect()).collect();
    assert!(rows.len() == 3 && rows.iter().all(|row| row.len() == properties), "{text}");
    assert_eq!(rows[0][..13], ["0.5", "-0.25", "2", "0", "0", "-1", "63", "60", "192", "3", "3", "0", "1e-3"]);
    assert_eq!(rows[1][6..13], ["255", "60", "0", "4", "4", "1", "4e-3"]);
    assert_eq!(ply::surface_numbers(&points[0]), [0.5, -0.25, 2.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1e-6]);
}

#[test]
fn faults_name_the_file_and_the_fix() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let made = Made { layout: Layout::Confocal, side: 2, with_legs: true, counts: true, seed: 1 };
    made.write(&path("good.hdf5"));
    let without = |name: &str, file: &str| {
        made.write(&path(file));
        let mut source = periscope::formats::Source::open(&path(file)).unwrap();
        let (mut arrays, _) = periscope::formats::hdf5::arrays(&mut source, |_| true, u64::MAX).unwrap();
        arrays.remove(name).unwrap();
        save(&path(file), &arrays);
    };
    without("t_accounts_first_and_last_bounces", "legs.hdf5");
    without("sensor_xyz", "sensor.hdf5");
    without("H", "h.hdf5");
    fs::write(path("text.mat"), "no capture at all").unwrap();
    fs::create_dir(path("full")).unwrap();
    fs::write(path("full/file"), "").unwrap();
    for (file, more, parts) in [
        ("good.hdf5", vec!["--fwhm-ps", "0"], ["--fwhm-ps 0", "must be positive"]),
        ("good.hdf5", vec!["--fwhm-ps", "70", "--every", "0"], ["--every 0", "give 1"]),
        ("none.hdf5", vec!["--fwhm-ps", "70"], ["none.hdf5", "No such file"]),
        ("text.mat", vec!["--fwhm-ps", "70"], ["text.mat", "neither HDF5 nor a MAT-file"]),
        ("h.hdf5", vec!["--fwhm-ps", "70"], ["h.hdf5", "in its own format first"]),
        ("legs.hdf5", vec!["--fwhm-ps", "70"], ["legs.hdf5", "set t_accounts_first_and_last_bounces"]),
        ("sensor.hdf5", vec!["--fwhm-ps", "70"], ["sensor.hdf5", "sensor_xyz"]),
    ] {
        let output = periscope(folder.path(), &[&["convert", file, "--out", "out"], more.as_slice()].concat());
        let error = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{error}");
        assert!(parts.iter().all(|part| error.contains(part)), "{file}: {error}");
        assert!(!path("out").exists(), "{file} left a folder");
    }
    let output = periscope(folder.path(), &["convert", "good.hdf5", "--out", "full", "--fwhm-ps", "70"]);
    assert!(String::from_utf8(output.stderr).unwrap().contains("full: is not empty"));
    let output = periscope(folder.path(), &["convert", "good.hdf5", "--out", "out"]);
    assert!(String::from_utf8(output.stderr).unwrap().contains("--fwhm-ps"));
    fs::create_dir_all(path("results/.shelf")).unwrap();
    for (args, part) in [
        (vec!["export", "results", "a.txt"], ".ply for patches"),
        (vec!["export", "results", "a.ply"], "no table `patches`"),
        (vec!["export", "results", "a.hdf5"], "add --campaign DIR"),
    ] {
        let error = String::from_utf8(periscope(folder.path(), &args).stderr).unwrap();
        assert!(error.contains(part), "{args:?}: {error}");
    }
}
