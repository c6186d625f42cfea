//! Ctrl-C and SIGTERM end the program within [`WITHIN`] from the inside of the kernels that compute longest.
//!
//! Each case imports tables that keep one stage busy for well over 10 s, and signals the program while that stage
//! computes.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use periscope::geometry::Point;
use periscope::store::Shelf;
use periscope::store::runs::Ending;
use periscope::tables::{Calibration, Label, Onset, Patch, Profile, Stir};
use periscope::units::time_ps;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::lab::{Lab, write_table};

/// What the guide promises, 2 s, and as much again for a machine that runs other tests.
const WITHIN: Duration = Duration::from_secs(4);
/// From the beginning of its pass until the stage is in its kernel: tables of some megabytes are read in less.
const UNDER_WAY: Duration = Duration::from_millis(1500);
const SD_PS: f64 = 5.0;
/// Standard deviation of the response.
const RESPONSE_PS: f64 = 100.0;
const NOISE_V: f64 = 0.005;

/// `[name]` that imports `table`.
fn import(name: &str, table: &str) -> String {
    format!("[{name}]\nstage = 'import'\nparams = {{ table = '{table}', path = '{name}.parquet' }}\n")
}

/// Runs a pipeline whose stage `busy` computes for long, and signals the program in its midst.
fn interrupt(lab: &Lab, pipeline: &str, signal: &str) {
    std::fs::write(lab.path("p.toml"), pipeline).unwrap();
    let mut child = Command::new(env!("CARGO_BIN_EXE_periscope"))
        .args(["run", "p.toml", "--campaign", "campaign", "--out", "out", "--progress", "json"])
        .current_dir(lab.path(""))
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let text = wait_for_busy(&mut child);
    std::thread::sleep(UNDER_WAY);
    assert!(child.try_wait().unwrap().is_none(), "the stage ends too early to be interrupted: {text}");
    let start = Instant::now();
    assert!(Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap().success());
    let code = child.wait().unwrap().code();
    assert!(start.elapsed() < WITHIN, "{:?}", start.elapsed());
    assert_eq!(code, Some(130));
    let shelf = Shelf::look(&lab.path("out")).unwrap();
    // A program that is ended by force, since some loop does not poll, leaves its record open.
    assert_eq!(shelf.runs().unwrap()[0].ending, Some(Ending::Interrupted));
    assert!(!lab.path("out/busy").exists());
}

/// Waits for the pass of the stage; standard error so far. What comes later is read and dropped, so that the program
/// never waits for us.
fn wait_for_busy(child: &mut Child) -> String {
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
    let mut text = String::new();
    for line in lines.by_ref() {
        let line = line.unwrap();
        text += &line;
        text.push('\n');
        if line.contains("\"event\":\"pass\"") && line.contains("\"busy\"") {
            std::thread::spawn(move || lines.for_each(drop));
            return text;
        }
    }
    panic!("the stage never began: {text}");
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

fn calibration() -> Calibration {
    Calibration {
        campaign: "tiny".into(),
        sensor: "s1".into(),
        shots: 1000,
        step_ps: 10.0,
        response_t0_ps: -400.0,
        response: (0..80).map(|i| (-0.5 * (10.0 * (f64::from(i) - 40.0) / RESPONSE_PS).powi(2)).exp()).collect(),
        width_ps: 235.0,
        ..Calibration::default()
    }
}

/// A record of white noise and of pulses at `pulses_ps`.
fn profile(lit: i32, seen: i32, dt_ps: f64, samples: usize, pulses_ps: &[f64], rng: &mut ChaCha8Rng) -> Profile {
    let mut mean_v: Vec<f64> = (0..samples).map(|_| NOISE_V * normal(rng)).collect();
    for at_ps in pulses_ps {
        let reach = (5.0 * RESPONSE_PS / dt_ps) as usize;
        let middle = (at_ps / dt_ps) as usize;
        for (n, value) in mean_v.iter_mut().enumerate().take(middle + reach).skip(middle - reach) {
            *value += (-0.5 * ((n as f64 * dt_ps - at_ps) / RESPONSE_PS).powi(2)).exp();
        }
    }
    Profile {
        campaign: "tiny".into(),
        sensor: "s1".into(),
        lit,
        seen,
        role: "scene".into(),
        shots: 1000,
        dt_ps,
        mean_v: Some(mean_v.into_iter().collect()),
        se_v: Some((0..samples).map(|_| NOISE_V).collect()),
        noise_v: NOISE_V * 1000_f64.sqrt(),
        noise_acf: vec![1.0].into(),
        gain_v: 0.001,
        ..Profile::default()
    }
}

fn patches(points: &[Point], path: &Path) {
    let patch = |(n, point): (usize, &Point)| Patch {
        patch: n as i32 + 1,
        kind: "visible".into(),
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
    write_table(path, &points.iter().enumerate().map(patch).collect::<Vec<_>>());
}

/// Patches on two walls, laser and sensor at the origin.
fn visible(count: usize, rng: &mut ChaCha8Rng) -> Vec<Point> {
    let mut point = |n: usize| match n % 2 {
        0 => Point::new(rng.random_range(-1.5..0.5), 2.6, rng.random_range(-0.8..0.8)),
        _ => Point::new(1.1, rng.random_range(1.0..2.4), rng.random_range(-0.8..0.8)),
    };
    (0..count).map(&mut point).collect()
}

fn length_m(way: &[Point]) -> f64 {
    let ends = [way[0], way[way.len() - 1]].map(|point| point.coords.norm());
    ends.iter().sum::<f64>() + way.windows(2).map(|legs| (legs[1] - legs[0]).norm()).sum::<f64>()
}

/// A record of 2 million samples with 16 pulses: a pass over it is repeated for every pulse and each of 800 taps.
#[test]
fn deconvolve_ends_in_the_midst_of_a_long_record() {
    let (lab, mut rng) = (Lab::tiny(), ChaCha8Rng::seed_from_u64(1));
    let (dt_ps, samples) = (1.0, 2_000_000);
    let pulses_ps: Vec<f64> = (1..=16).map(|n| f64::from(n) * 1e5).collect();
    write_table(&lab.path("profiles.parquet"), &[profile(1, 2, dt_ps, samples, &pulses_ps, &mut rng)]);
    write_table(&lab.path("calibration.parquet"), &[calibration()]);
    let pipeline = import("profiles", "profiles")
        + &import("calibration", "calibration")
        + "[busy]\nstage = 'deconvolve'\nfrom = 'profiles'\nwith = { calibration = 'calibration' }\n";
    interrupt(&lab, &pipeline, "-TERM");
}

/// 64 hidden patches that only third bounces show, each lost in a tenth of the profiles.
#[test]
fn label_ends_in_the_midst_of_the_search_for_hidden_patches() {
    let (lab, mut rng) = (Lab::tiny(), ChaCha8Rng::seed_from_u64(2));
    let points = visible(24, &mut rng);
    let mut hidden = || {
        let [x, y, z] = [-0.8..0.8, 0.3..2.0, -0.8..0.8].map(|range: std::ops::Range<f64>| rng.random_range(range));
        Point::new(x, y, z)
    };
    let hidden: Vec<Point> = (0..64).map(|_| hidden()).collect();
    let mut onsets = Vec::new();
    for (a, b) in (0..points.len()).flat_map(|a| (0..points.len()).map(move |b| (a, b))) {
        let mut times = vec![(length_m(&[points[a], points[b]]), 200.0)];
        for over in &hidden {
            if rng.random_bool(0.9) {
                times.push((length_m(&[points[a], *over, points[b]]), 40.0));
            }
        }
        let mut times: Vec<(f64, f64)> =
            times.into_iter().map(|(m, snr)| (time_ps(m, 1.0) + SD_PS * normal(&mut rng), snr)).collect();
        times.sort_by(|a, b| a.0.total_cmp(&b.0));
        onsets.extend(times.into_iter().enumerate().map(|(rank, (time_ps, snr))| Onset {
            campaign: "tiny".into(),
            sensor: "s1".into(),
            lit: a as i32 + 1,
            seen: b as i32 + 1,
            rank: rank as i32 + 1,
            time_ps,
            time_sd_ps: SD_PS,
            amplitude: 1.0,
            snr,
            ..Onset::default()
        }));
    }
    write_table(&lab.path("onsets.parquet"), &onsets);
    patches(&points, &lab.path("patches.parquet"));
    let pipeline = import("onsets", "onsets")
        + &import("patches", "patches")
        + "[busy]\nstage = 'label'\nfrom = 'onsets'\nwith = { patches = 'patches' }\nparams = { bounces = 3 }\n";
    interrupt(&lab, &pipeline, "-TERM");
}

/// Records of 100 ns leave a room of 30 m, which is searched in steps of some centimetres.
#[test]
fn search_ends_in_the_midst_of_its_grid() {
    let (lab, mut rng) = (Lab::tiny(), ChaCha8Rng::seed_from_u64(3));
    let points = visible(8, &mut rng);
    let pairs = (1..=8).flat_map(|lit| (1..=8).map(move |seen| (lit, seen)));
    let profiles: Vec<Profile> = pairs.map(|(lit, seen)| profile(lit, seen, 50.0, 2000, &[], &mut rng)).collect();
    write_table(&lab.path("profiles.parquet"), &profiles);
    write_table(&lab.path("calibration.parquet"), &[calibration()]);
    write_table::<Stir>(&lab.path("stir.parquet"), &[]);
    write_table::<Label>(&lab.path("labels.parquet"), &[]);
    patches(&points, &lab.path("patches.parquet"));
    let tables = ["profiles", "calibration", "stir", "labels", "patches"];
    let with = ["profiles", "calibration", "stir", "labels"].map(|table| format!("{table} = '{table}'")).join(", ");
    let pipeline: String = tables.iter().map(|table| import(table, table)).collect();
    interrupt(
        &lab,
        &(pipeline + &format!("[busy]\nstage = 'search'\nfrom = 'patches'\nwith = {{ {with} }}\n")),
        "-INT",
    );
}

/// Voxels of a centimetre in front of a wall of some square metres, to a depth of 15 m.
#[test]
fn image_ends_in_the_midst_of_its_voxels() {
    let (lab, mut rng) = (Lab::tiny(), ChaCha8Rng::seed_from_u64(5));
    let points = visible(8, &mut rng);
    let pairs = (1..=8).flat_map(|lit| (1..=8).map(move |seen| (lit, seen)));
    let profiles: Vec<Profile> = pairs.map(|(lit, seen)| profile(lit, seen, 50.0, 2000, &[], &mut rng)).collect();
    write_table(&lab.path("profiles.parquet"), &profiles);
    write_table(&lab.path("calibration.parquet"), &[calibration()]);
    patches(&points, &lab.path("patches.parquet"));
    let pipeline: String = ["profiles", "calibration", "patches"].iter().map(|table| import(table, table)).collect();
    let stage = "[busy]\nstage = 'image'\nfrom = 'patches'\nwith = { profiles = 'profiles', calibration = 'calibration' }\nparams = { pitch_m = 0.01 }\n";
    interrupt(&lab, &(pipeline + stage), "-INT");
}

/// A thousand histograms of six hidden points, lit and seen apart, to a depth of 15 m.
#[test]
fn locate_ends_in_the_midst_of_its_search() {
    let (lab, mut rng) = (Lab::tiny(), ChaCha8Rng::seed_from_u64(6));
    let points = visible(32, &mut rng);
    let hidden = visible(6, &mut rng).into_iter().map(|point| point - nalgebra::Vector3::new(0.9, 0.9, 0.0));
    let hidden: Vec<Point> = hidden.collect();
    let mut profiles = Vec::new();
    for (a, b) in (0..points.len()).flat_map(|a| (0..points.len()).map(move |b| (a, b))) {
        let arrivals = hidden.iter().map(|over| time_ps(length_m(&[points[a], *over, points[b]]), 1.0));
        let arrivals: Vec<f64> = arrivals.filter(|at_ps| (1e3..9.9e4).contains(at_ps)).collect();
        profiles.push(profile(a as i32 + 1, b as i32 + 1, 50.0, 2000, &arrivals, &mut rng));
    }
    write_table(&lab.path("profiles.parquet"), &profiles);
    write_table(&lab.path("calibration.parquet"), &[calibration()]);
    patches(&points, &lab.path("patches.parquet"));
    let pipeline: String = ["profiles", "calibration", "patches"].iter().map(|table| import(table, table)).collect();
    let stage =
        "[busy]\nstage = 'locate'\nfrom = 'patches'\nwith = { profiles = 'profiles', calibration = 'calibration' }\n";
    interrupt(&lab, &(pipeline + stage), "-INT");
}

/// 6,400 patches, each paired with the 12 nearest: so soft that each step takes hundreds of passes.
#[test]
fn refine_ends_in_the_midst_of_a_solution() {
    const SIDE: i32 = 80;
    let (lab, mut rng) = (Lab::tiny(), ChaCha8Rng::seed_from_u64(4));
    let place = |u: i32, v: i32| {
        Point::new(0.03 * f64::from(u) - 1.2, 2.6 + 0.02 * f64::from(v % 7), 0.03 * f64::from(v) - 1.2)
    };
    let number = |u: i32, v: i32| u * SIDE + v + 1;
    let mut labels = Vec::new();
    let mut add = |path: Vec<i32>, way: &[Point], rng: &mut ChaCha8Rng| {
        labels.push(Label {
            campaign: "tiny".into(),
            sensor: "s1".into(),
            lit: path[0],
            seen: path[path.len() - 1],
            rank: 1,
            time_ps: time_ps(length_m(way), 1.0) + SD_PS * normal(rng),
            time_sd_ps: SD_PS,
            width_ps: Some(0.0),
            bounces: path.len() as i32,
            path: Some(path),
            probability: 1.0,
            ..Label::default()
        });
    };
    let mut start = Vec::new();
    for (u, v) in (0..SIDE).flat_map(|u| (0..SIDE).map(move |v| (u, v))) {
        let (own, here) = (number(u, v), place(u, v));
        start.push(here + nalgebra::Vector3::from_fn(|_, _| 0.003 * normal(&mut rng)));
        add(vec![own], &[here], &mut rng);
        for (x, y) in [(1, 0), (0, 1), (1, 1), (1, -1), (2, 0), (0, 2)].map(|(x, y)| (u + x, v + y)) {
            if (0..SIDE).contains(&x) && (0..SIDE).contains(&y) {
                add(vec![own, number(x, y)], &[here, place(x, y)], &mut rng);
                add(vec![number(x, y), own], &[place(x, y), here], &mut rng);
            }
        }
    }
    write_table(&lab.path("labels.parquet"), &labels);
    patches(&start, &lab.path("patches.parquet"));
    write_table(&lab.path("calibration.parquet"), &[calibration()]);
    let pipeline = ["labels", "patches", "calibration"].map(|table| import(table, table)).concat()
        + "[busy]\nstage = 'refine'\nfrom = 'labels'\nwith = { patches = 'patches', calibration = 'calibration' }\n";
    interrupt(&lab, &pipeline, "-TERM");
}
