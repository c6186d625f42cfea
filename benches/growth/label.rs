//! Stage `label` with hidden patches: known beforehand, and searched for.

use periscope::geometry::Point;
use periscope::geometry::hidden::{Arrival, Focus, Profile, Room, find};
use periscope::stages::label::LabelOnsets;
use periscope::stages::stage::{Apply, BesideTables};
use periscope::tables::{Onset, Patch, Row};
use periscope::units::{path_m, time_ps};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::curve::Curve;
use super::{context, normal};

#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../../src/geometry/hidden/tests/scene.rs"]
mod scene;

use scene::{Setting, draw};

const VISIBLE: usize = 24;
const SD_PS: f64 = 5.0;
const MISSING: f64 = 0.1;
/// Where the laser and the sensor stand among the walls of the drawn scenes.
const STATION: Point = Point::new(3.0, 3.0, 0.0);

/// 24 visible patches on two walls and some hidden ones, 6 cm apart at least. All profiles, with a tenth of the
/// arrivals missing and one false in each.
fn setting(hidden: usize) -> Setting {
    Setting { apart_m: 0.06, ..Setting::new(VISIBLE, hidden, path_m(SD_PS, 1.0), MISSING, 1) }
}

/// Visible patches and then hidden ones, laser and sensor at the origin.
fn points(hidden: usize) -> Vec<Point> {
    let drawn = draw(&setting(hidden), 1);
    let visible = drawn.room.foci.iter().map(|focus| focus.point);
    visible.chain(drawn.hidden).map(|point| Point::from(point - STATION)).collect()
}

fn onset(pair: [usize; 2], rank: usize, time_ps: f64, snr: f64) -> Onset {
    Onset {
        campaign: "c".into(),
        sensor: "s1".into(),
        lit: pair[0] as i32 + 1,
        seen: pair[1] as i32 + 1,
        rank: rank as i32 + 1,
        time_ps,
        time_sd_ps: SD_PS,
        amplitude: 1.0,
        snr,
        ..Onset::default()
    }
}

/// Direct light of every pair of visible patches, and third bounces over hidden ones.
fn onsets(points: &[Point]) -> Vec<Onset> {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let mut onsets = Vec::new();
    for pair in (0..VISIBLE).flat_map(|a| (0..VISIBLE).map(move |b| [a, b])) {
        let [a, b] = pair.map(|patch| points[patch]);
        let ends_m = a.coords.norm() + b.coords.norm();
        let mut times = vec![(ends_m + (a - b).norm(), 200.0)];
        for over in &points[VISIBLE..] {
            if !rng.random_bool(MISSING) {
                times.push((ends_m + (a - over).norm() + (b - over).norm(), 40.0));
            }
        }
        times.push((ends_m + rng.random_range(1.0..4.0), 10.0));
        let mut times: Vec<(f64, f64)> =
            times.into_iter().map(|(m, snr)| (time_ps(m, 1.0) + SD_PS * normal(&mut rng), snr)).collect();
        times.sort_by(|a, b| a.0.total_cmp(&b.0));
        onsets.extend(times.into_iter().enumerate().map(|(rank, (time_ps, snr))| onset(pair, rank, time_ps, snr)));
    }
    onsets
}

fn beside(points: &[Point]) -> BesideTables {
    let patch = |(n, point): (usize, &Point)| Patch {
        patch: n as i32 + 1,
        kind: if n < VISIBLE { "visible".into() } else { "hidden".into() },
        x_m: point.x,
        y_m: point.y,
        z_m: point.z,
        cov_xx_m2: Some(1e-8),
        cov_xy_m2: Some(0.0),
        cov_xz_m2: Some(0.0),
        cov_yy_m2: Some(1e-8),
        cov_yz_m2: Some(0.0),
        cov_zz_m2: Some(1e-8),
        sd_m: Some(1.7e-4),
        onsets: 1,
        ..Patch::default()
    };
    let patches: Vec<Patch> = points.iter().enumerate().map(patch).collect();
    BesideTables::from([("patches".to_owned(), vec![Patch::to_batch(&patches)])])
}

/// Prints the table of labels, the hidden patches known beforehand and not.
pub fn print_labelling(sizes: &[usize]) {
    for (what, params, has_hidden) in
        [("known", "bounces = 3\nhidden = 'none'", true), ("searched", "bounces = 3", false)]
    {
        println!(
            "\n| hidden patches, {what} | onsets | s (min, median, max) | onsets with a path |\n|---|---|---|---|"
        );
        let mut curve = Curve::default();
        for &hidden in sizes {
            let points = points(hidden);
            let onsets = onsets(&points);
            let stage: LabelOnsets = toml::from_str(params).expect("parameters");
            let context = context(&stage, &beside(if has_hidden { &points } else { &points[..VISIBLE] }));
            let mut labelled = 0;
            let seconds = curve.time(hidden, || {
                let rows = stage.apply(&context, onsets.clone()).expect("labels").rows;
                labelled = rows.iter().filter(|row| row.alternative == 0 && row.path.is_some()).count();
            });
            println!("| {hidden} | {} | {seconds} | {labelled} |", onsets.len());
        }
        curve.print(sizes[0], sizes[sizes.len() - 1]);
    }
}

/// Prints the table of the search alone.
pub fn print_search(sizes: &[usize]) {
    println!("\n| hidden patches, search alone | arrivals | s (min, median, max) | found |\n|---|---|---|---|");
    let mut curve = Curve::default();
    for &hidden in sizes {
        let drawn = draw(&setting(hidden), 1);
        let arrivals: usize = drawn.sources.iter().map(Vec::len).sum();
        let mut patches = 0;
        let seconds = curve.time(hidden, || patches = find(&drawn.profiles, &drawn.room).patches.len());
        println!("| {hidden} | {arrivals} | {seconds} | {patches} |");
    }
    curve.print(sizes[0], sizes[sizes.len() - 1]);
}
