//! Surfaces from captures whose lit and seen points are apart and move together over the wall, through files and `run`.

use std::fmt::Write;
use std::fs::File;
use std::path::Path;

use nalgebra::{Matrix3, Point3, Rotation3, Vector3};
use periscope::formats::npy;
use periscope::tables::SurfacePoint;

use crate::hidden_things::{LIGHT, PITCH_M, Thing, cuboid, sphere};
use crate::relay_scene::{FWHM_PS, periscope, response};
use crate::surface_study::{HOLDS, capture, median, rows};

type Point = Point3<f64>;

/// Parts the lit and the seen point of each capture of a confocal campaign: tables and times are those of points so far
/// to both sides. Gives the pairs, by the number of the patch that is seen, less one.
fn part(folder: &Path, half: Vector3<f64>) -> Vec<[Point; 2]> {
    let (settings, captures) = (folder.join("campaign/campaign.toml"), folder.join("campaign/captures.csv"));
    let text = std::fs::read_to_string(&settings).unwrap();
    let (head, patches) = text.split_at(text.find("[patches.").unwrap());
    let numbers = |line: &str| -> Vec<f64> {
        line[line.find('[').unwrap() + 1..line.len() - 1].split(", ").map(|word| word.parse().unwrap()).collect()
    };
    let place = |line: &str| Point::from_slice(&numbers(line));
    let mut stations = head.lines().filter(|line| line.starts_with("position_m"));
    let station = place(stations.next().unwrap());
    assert!(stations.next().is_none(), "one station for laser and sensor");
    let places = patches.lines().filter(|line| line.starts_with("position_m")).map(place);
    let pairs: Vec<[Point; 2]> = places.map(|place| [place - half, place + half]).collect();
    let mut text = head.to_owned();
    for (n, pair) in pairs.iter().enumerate() {
        for (patch, Point { coords, .. }) in [(n + 1 + pairs.len(), pair[0]), (n + 1, pair[1])] {
            let [x, y, z] = coords.into();
            writeln!(text, "[patches.{patch}]\nposition_m = [{x}, {y}, {z}]\nnormal = [0.0, 0.0, 1.0]\n").unwrap();
        }
    }
    std::fs::write(settings, text).unwrap();
    let table = std::fs::read_to_string(&captures).unwrap();
    let mut text = table.lines().next().unwrap().to_owned() + "\n";
    for line in table.lines().skip(1) {
        let [file, segment, lit, seen, t0_ps] = line.split(',').collect::<Vec<_>>().try_into().unwrap();
        assert_eq!(lit, seen);
        let [to, from] = pairs[seen.parse::<usize>().unwrap() - 1];
        let legs_m = (to - station).norm() + (from - station).norm();
        let later_m = legs_m - 2.0 * (nalgebra::center(&to, &from) - station).norm();
        let t0_ps = t0_ps.parse::<f64>().unwrap() + later_m / LIGHT;
        writeln!(text, "{file},{segment},{},{seen},{t0_ps}", lit.parse::<usize>().unwrap() + pairs.len()).unwrap();
    }
    std::fs::write(captures, text).unwrap();
    pairs
}

/// Puts the response with its tail in the place of the Gaussian one that a conversion makes: where lit and seen point
/// differ, no light of the wall itself shows it.
fn give_response(folder: &Path, dt_ps: f64) {
    let table = std::fs::read_to_string(folder.join("campaign/response.csv")).unwrap();
    let t0_ps: f64 = table.trim().rsplit(',').next().unwrap().parse().unwrap();
    let arrival_ps = 1.0 / LIGHT - t0_ps;
    let counts = |n: usize| (1e8 * response(n as f64 * dt_ps - arrival_ps)).round() as i32;
    let counts: Vec<i32> = (0..220).map(counts).collect();
    let mut file = File::create(folder.join("campaign/raw/response.npy")).unwrap();
    npy::write(&mut file, &[1, counts.len() as u64], &counts).unwrap();
}

/// The point of a plate with half axes over which the way between two points is shortest, by search: the way is convex
/// over the plate.
fn shortest(middle: Point, [along, up]: [Vector3<f64>; 2], [lit, seen]: [Point; 2]) -> Point {
    let place = |[x, y]: [f64; 2]| middle + along * x + up * y;
    let way_m = |at: [f64; 2]| (place(at) - lit).norm() + (place(at) - seen).norm();
    let (mut best, mut step) = ([0.0, 0.0], 0.5);
    while step > 1e-7 {
        let moved = |x: f64, sign: usize| (x + (sign as f64 - 1.0) * step).clamp(-1.0, 1.0);
        let tries = (0..9).map(|n| [moved(best[0], n % 3), moved(best[1], n / 3)]);
        let next = tries.min_by(|a, b| way_m(*a).total_cmp(&way_m(*b))).unwrap();
        if way_m(next) < way_m(best) {
            best = next;
        } else {
            step *= 0.5;
        }
    }
    place(best)
}

/// Points of a scan whose lit and seen points lie so far to both sides of places of the wall: how many, how many within
/// their error bars, and the median distance from the truth.
fn apart(thing: &Thing, half: Vector3<f64>, truth: &dyn Fn([Point; 2]) -> Point) -> (usize, usize, f64) {
    let folder = tempfile::tempdir().unwrap();
    let capture = capture(32, 7);
    thing.write_apart(&folder.path().join("scan.mat"), &capture, 3000.0, half);
    let dt_ps = capture.dt_ps;
    let (fwhm, dt) = (FWHM_PS.to_string(), dt_ps.to_string());
    periscope(folder.path(), &["convert", "scan.mat", "--out", "campaign", "--fwhm-ps", &fwhm, "--dt-ps", &dt]);
    let pairs = part(folder.path(), half);
    give_response(folder.path(), dt_ps);
    periscope(folder.path(), &["run", "first-returns", "--campaign", "campaign", "--out", "out", "--threads", "2"]);
    let points: Vec<SurfacePoint> = rows(folder.path(), "out", "surface");
    let off =
        |point: &SurfacePoint| Point::new(point.x_m, point.y_m, point.z_m) - truth(pairs[point.seen as usize - 1]);
    let holds = |point: &&SurfacePoint| {
        let [xx, xy, xz, yy, yz, zz] =
            [point.cov_xx_m2, point.cov_xy_m2, point.cov_xz_m2, point.cov_yy_m2, point.cov_yz_m2, point.cov_zz_m2];
        let root = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz).cholesky().expect("a covariance");
        off(point).dot(&root.solve(&off(point))) < HOLDS
    };
    let errors_m: Vec<f64> = points.iter().map(|point| off(point).norm()).collect();
    (points.len(), points.iter().filter(holds).count(), median(&errors_m))
}

#[test]
fn pairs_that_move_together_show_a_surface() {
    let middle = Point::new(0.02, -0.01, 0.8);
    let half = Vector3::new(0.08, 0.05, 0.0);
    let of_sphere = |[lit, seen]: [Point; 2]| {
        let halves = |point: &Point| ((lit - point).normalize() + (seen - point).normalize()).normalize();
        (0..200).fold(middle - Vector3::z() * 0.2, |point, _| middle + halves(&point) * 0.2)
    };
    let sphere = apart(&sphere(middle, 0.2, PITCH_M), half, &of_sphere);
    let turn = Rotation3::from_euler_angles(0.2, 0.3, 0.1);
    let axes = [0, 1, 2].map(|k| turn * Vector3::ith(k, [0.25, 0.2, 0.0][k]));
    let of_plate = |pair: [Point; 2]| shortest(middle, [axes[0], axes[1]], pair);
    let plate = apart(&cuboid(middle, axes, PITCH_M), half, &of_plate);
    for (name, (points, held, median_m), most_m) in [("sphere", sphere, 4e-3), ("plate", plate, 1.2e-2)] {
        println!("{name}: {held} of {points}, {median_m} m");
        assert!(
            points > 700 && held * 100 > 90 * points && median_m < most_m,
            "{name}: {held} of {points}, {median_m}"
        );
    }
}
