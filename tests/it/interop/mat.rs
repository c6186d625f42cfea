//! Confocal scans as MAT-files, of version 5 and 7.3.

use std::fs;
use std::path::Path;

use periscope::exchange::{self, Defaults};
use periscope::formats::array::Array;

use super::scene::save;

/// Points along x and y, and bins.
const SIZE: [usize; 3] = [2, 3, 4];

/// What stands at a place of the scan.
fn count(x: usize, y: usize, bin: usize) -> f64 {
    (100 * x + 10 * y + bin) as f64
}

/// Numbers of a scan with the first axis fastest.
fn numbers() -> Vec<f64> {
    let [xs, ys, bins] = SIZE;
    (0..bins).flat_map(|bin| (0..ys).flat_map(move |y| (0..xs).map(move |x| count(x, y, bin)))).collect()
}

/// A variable of doubles of a file of version 5, not deflated.
fn variable(name: &str, axes: &[usize], values: &[f64]) -> Vec<u8> {
    let element = |kind: u32, data: Vec<u8>| {
        let mut bytes = [kind.to_le_bytes(), (data.len() as u32).to_le_bytes()].concat();
        bytes.extend(data);
        bytes.resize(bytes.len().next_multiple_of(8), 0);
        bytes
    };
    let axes = axes.iter().flat_map(|axis| (*axis as i32).to_le_bytes()).collect();
    let values = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    let flags = vec![6, 0, 0, 0, 0, 0, 0, 0];
    element(
        14,
        [element(6, flags), element(5, axes), element(1, name.as_bytes().to_vec()), element(9, values)].concat(),
    )
}

fn version_5(path: &Path, variables: &[Vec<u8>]) {
    let mut bytes = b"MATLAB 5.0 MAT-file".to_vec();
    bytes.resize(124, b' ');
    bytes.extend([0, 1, b'I', b'M']);
    bytes.extend(variables.concat());
    fs::write(path, bytes).unwrap();
}

#[test]
fn confocal_scans_are_read_from_both_versions() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    version_5(&path("5.mat"), &[variable("rect_data", &SIZE, &numbers()), variable("width", &[1, 1], &[0.5])]);
    let reversed: Vec<usize> = SIZE.iter().rev().copied().collect();
    let arrays = [("rect_data", Array::of(&reversed, &numbers())), ("width", Array::of(&[1, 1], &[0.5]))];
    save(&path("73.mat"), &arrays.map(|(name, array)| (name.to_owned(), array)).into());
    for file in ["5.mat", "73.mat"] {
        let defaults = Defaults { dt_ps: Some(4.0), start_ps: Some(100.0), ..Defaults::default() };
        let capture = exchange::read(&path(file), &defaults).unwrap();
        assert!(capture.is_confocal() && !capture.with_legs);
        assert_eq!((capture.pairs.len(), capture.bins(), capture.dt_ps), (6, 4, 4.0));
        for pair in &capture.pairs {
            let [x_m, y_m, z_m] = capture.lit.spots[pair.lit].position_m;
            let (x, y) = ((x_m + 0.5).round() as usize, (2.0 * (y_m + 0.5)).round() as usize);
            assert_eq!((z_m, pair.start_ps), (0.0, 100.0));
            let expected: Vec<f64> = (0..SIZE[2]).map(|bin| count(x, y, bin)).collect();
            assert_eq!(capture.histogram(pair), expected, "{file}: {x}, {y}");
        }
    }
    let error = |defaults: &Defaults| exchange::read(&path("5.mat"), defaults).unwrap_err().to_string();
    assert!(error(&Defaults::default()).contains("add --dt-ps"));
    let wide = Defaults { dt_ps: Some(4.0), wall_m: Some(2.0), ..Defaults::default() };
    assert_eq!(exchange::read(&path("5.mat"), &wide).unwrap().lit.spots[0].position_m, [-1.0, -1.0, 0.0]);
}

#[test]
fn raw_scans_need_the_delays_of_their_points() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    version_5(&path("meas.mat"), &[variable("meas", &SIZE, &numbers())]);
    let late: Vec<f64> = (0..6).map(|place| 1000.0 + f64::from(place)).collect();
    version_5(&path("tof.mat"), &[variable("tofgrid", &SIZE[..2], &late)]);
    let defaults = Defaults { dt_ps: Some(32.0), wall_m: Some(2.0), ..Defaults::default() };
    let error = exchange::read(&path("meas.mat"), &defaults).unwrap_err().to_string();
    assert!(error.contains("meas.mat") && error.contains("add --tof"), "{error}");
    let delays = path("tof.mat");
    let capture = exchange::read(&path("meas.mat"), &Defaults { delays: Some(&delays), ..defaults }).unwrap();
    for pair in &capture.pairs {
        let [x_m, y_m, _] = capture.lit.spots[pair.lit].position_m;
        let place = ((x_m + 1.0) / 2.0).round() + 2.0 * (y_m + 1.0).round();
        assert_eq!(pair.start_ps, -(1000.0 + place));
    }
}
