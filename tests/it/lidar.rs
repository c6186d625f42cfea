//! Lidars from their files to echoes: simulated flights with known truth, and real shots where present.
//! docs/real-light.md holds what the real shots give: `cargo test --release --test it lidar -- --nocapture`.

mod files;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use periscope::formats::{self, Source};
use periscope::signal::echoes::Outgoing;
use periscope::signal::regression::least_squares;
use periscope::store::Shelf;
use periscope::tables::{Echo, Reject, Row};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::interop::y_tal;
use crate::relay_scene::periscope;
use files::{ANCHOR_UNITS, LasPulse, Shot, VELOCITY_Z_M_PER_PS};

/// Rounded level of records, and noise of a sample.
const FLOOR: f64 = 200.0;
const NOISE: f64 = 2.0;
/// Where a simulated outgoing record has the pulse's maximum.
const LEFT: f64 = 30.3;

/// The outgoing pulse, its maximum at 0: a steep front, a slow tail.
fn pulse(time: f64) -> f64 {
    let sigma = if time < 0.0 { 3.5 } else { 5.0 };
    (-0.5 * (time / sigma).powi(2)).exp()
}

/// A pulse widened by a Gaussian of this standard deviation.
fn widened(pulse: fn(f64) -> f64, time: f64, sigma: f64) -> f64 {
    let (mut sum, mut all) = (0.0, 0.0);
    for x in (-60..=60).map(|i| f64::from(i) / 12.0) {
        let weight = (-0.5 * x * x).exp();
        sum += weight * pulse(time - sigma * x);
        all += weight;
    }
    sum / all
}

/// An echo of a simulation: time of the maximum, before it is widened, after that of the outgoing pulse; strength;
/// width.
#[derive(Clone, Copy, Debug)]
struct Light {
    time: f64,
    strength: f64,
    width: f64,
}

/// Samples from time `start` on, rounded, with noise.
fn samples(pulse: fn(f64) -> f64, light: &[Light], start: f64, count: usize, rng: &mut ChaCha8Rng) -> Vec<u16> {
    let of = |light: &Light, t: f64| light.strength * widened(pulse, t - light.time, light.width);
    let clean = (0..count).map(|n| light.iter().map(|light| of(light, start + n as f64)).sum::<f64>());
    clean
        .map(|value| {
            let noise: f64 = StandardNormal.sample(rng);
            (FLOOR + value + NOISE * noise).round().clamp(0.0, 1023.0) as u16
        })
        .collect()
}

/// A flight: its shots with their light, of 0 to 3 echoes; of two the first is weak; each tenth is beyond the rail.
fn flight(shots: usize, seed: u64) -> Vec<(Shot, Vec<Light>)> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let shot = |number: usize| {
        let count = number % 4;
        let first = 3000.0 + rng.random_range(0.0..50.0);
        let mut light: Vec<Light> = (0..count)
            .map(|k| Light {
                time: first + 45.0 * k as f64 + rng.random_range(0.0..8.0),
                strength: rng.random_range(80.0..400.0),
                width: [1.0, 3.0, 6.0][k],
            })
            .collect();
        if count == 2 {
            light[0].strength = 40.0;
        }
        if number % 40 == 1 {
            light[0].strength = 1200.0;
        }
        // Each pulse leaves a little earlier or later in its own record.
        let late = rng.random_range(-1.0..1.0);
        let left = LEFT + late;
        let outgoing = samples(pulse, &[Light { time: left, strength: 700.0, width: 0.0 }], 0.0, 90, &mut rng);
        let left_at = left - f64::from(ANCHOR_UNITS);
        let start = (first + left_at - 60.0).floor();
        let shifted: Vec<Light> = light.iter().map(|one| Light { time: one.time + left_at, ..*one }).collect();
        let returning = samples(pulse, &shifted, start, 130 + 45 * count, &mut rng);
        (Shot { outgoing, start: start as i32, returning }, light)
    };
    (0..shots).map(shot).collect()
}

/// A campaign of these raw files.
fn campaign(folder: &Path, files: &[(&str, &[u8])]) {
    fs::create_dir_all(folder.join("campaign/raw")).unwrap();
    for (name, bytes) in files {
        fs::write(folder.join("campaign/raw").join(name), bytes).unwrap();
    }
    let ending = files[0].0.rsplit('.').next().unwrap();
    let text = format!(
        "[campaign]\nname = \"flight\"\n[sensors.lidar]\n[[captures]]\nrole = \"scene\"\nfiles = \"raw/*.{ending}\"\n\
         lit = 1\nseen = 1\n"
    );
    fs::write(folder.join("campaign/campaign.toml"), text).unwrap();
}

fn rows<R: Row>(out: &Path, view: &str) -> Vec<R> {
    let shelf = Shelf::look(out).unwrap();
    shelf.batches(view).unwrap().iter().flat_map(|batch| R::rows(batch).unwrap()).collect()
}

/// Runs the pipeline that the program chooses.
fn run(folder: &Path, out: &str, more: &[&str]) -> Vec<Echo> {
    periscope(folder, &[&["run", "--campaign", "campaign", "--out", out], more].concat());
    rows(&folder.join(out), "echoes")
}

fn rms(z: &[f64]) -> f64 {
    (z.iter().map(|z| z * z).sum::<f64>() / z.len() as f64).sqrt()
}

/// Shots with 0 to 3 echoes as a PulseWaves file: numbers of echoes, times, places and the size of their errors; the
/// same rows for any number of threads; a point cloud.
#[test]
fn echoes_of_a_simulated_flight_lie_within_their_errors() {
    let flight = flight(400, 36);
    let folder = tempfile::tempdir().unwrap();
    let shots: Vec<&Shot> = flight.iter().map(|(shot, _)| shot).collect();
    let [pls, wvs] = files::pulse_waves(&shots, Some(ANCHOR_UNITS));
    campaign(folder.path(), &[("a.pls", &pls), ("a.wvs", &wvs)]);
    let rail = ["--set", "echoes.rail_code=1023"];
    let echoes = run(folder.path(), "results", &rail);
    let (mut z, mut wrong, mut alarms) = ([const { Vec::new() }; 3], 0, 0);
    for (number, (_, light)) in flight.iter().enumerate() {
        let of_shot: Vec<&Echo> = echoes.iter().filter(|echo| echo.pulse == number as i64).collect();
        if of_shot.len() != light.len() {
            wrong += 1;
            alarms += usize::from(light.is_empty());
            continue;
        }
        for (k, (echo, light)) in of_shot.iter().zip(light).enumerate() {
            assert_eq!((echo.echo, echo.echoes), (k as i32 + 1, of_shot.len() as i32), "{echo:?}");
            assert_eq!(echo.clipped > 0, light.strength > 1000.0, "{echo:?}");
            z[0].push((echo.time_ps - 1e3 * light.time) / echo.time_sd_ps);
            z[1].push((echo.width_ps - 1e3 * light.width) / echo.width_sd_ps);
            let down_m = VELOCITY_Z_M_PER_PS * echo.time_ps;
            let [x_m, y_m, z_m] = files::anchor_m(number);
            assert_eq!((echo.x_m, echo.y_m), (x_m, y_m), "the beam points down");
            assert!((echo.z_m - z_m - down_m).abs() < 1e-6 && (echo.range_m + down_m).abs() < 1e-6, "{echo:?}");
            z[2].push((echo.range_m + VELOCITY_Z_M_PER_PS * 1e3 * light.time) / echo.range_sd_m);
        }
    }
    let [time, width, range] = z.map(|z| (rms(&z), z.len()));
    println!(
        "{} echoes: rms z of time {:.2}, width {:.2}; {wrong} shots otherwise, {alarms} alarms",
        time.1, time.0, width.0
    );
    assert!(time.1 >= 300 && (0.85..1.15).contains(&time.0), "{time:?}");
    assert!((range.0 - time.0).abs() < 1e-6, "{range:?}");
    assert!((0.8..1.25).contains(&width.0), "{width:?}");
    assert!(wrong <= 8 && alarms <= 1, "{wrong} shots of 400 have another number of echoes, {alarms} of 100 have one");
    let edges_ps = echoes.iter().filter_map(|echo| echo.edge_ps).count();
    assert_eq!(edges_ps, echoes.len());
    assert_eq!(run(folder.path(), "again", &[&rail[..], &["--threads", "1"]].concat()), echoes);
    periscope(folder.path(), &["export", "results", "cloud.ply"]);
    let cloud = fs::read_to_string(folder.path().join("cloud.ply")).unwrap();
    let (head, body) = cloud.split_once("end_header\n").unwrap();
    assert!(head.contains(&format!("element vertex {}\n", echoes.len())), "{head}");
    let first: Vec<f64> = body.lines().next().unwrap().split(' ').map(|number| number.parse().unwrap()).collect();
    let echo = &echoes[0];
    assert_eq!(first[..5], [echo.x_m, echo.y_m, echo.z_m, echo.range_sd_m, echo.height]);
    assert_eq!(first[7..9], [f64::from(echo.echo), f64::from(echo.echoes)]);
    assert_eq!(body.lines().count(), echoes.len());
    periscope(folder.path(), &["export", "results", "cloud.las"]);
    check_las(&fs::read(folder.path().join("cloud.las")).unwrap(), &echoes);
    let row = |echo: &Echo| {
        let Echo { x_m, y_m, z_m, range_sd_m, echo: number, echoes, .. } = echo;
        format!("{x_m:?},{y_m:?},{z_m:?},{range_sd_m:?},{number},{echoes}\n")
    };
    fs::write(folder.path().join("echoes.csv"), echoes.iter().map(row).collect::<String>()).unwrap();
    y_tal::python(folder.path(), &["cloud", "cloud.las", "echoes.csv"]);
}

/// A LAS file of these echoes, by the layout of the specification: each place to half of its scale.
fn check_las(file: &[u8], echoes: &[Echo]) {
    let number = |at: usize| f64::from_le_bytes(file[at..at + 8].try_into().unwrap());
    let word = |at: usize| u32::from_le_bytes(file[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!((&file[..4], &file[24..26], file[104]), (&b"LASF"[..], &[1, 4][..], 6));
    let (start, stride) = (word(96), usize::from(u16::from_le_bytes([file[105], file[106]])));
    assert_eq!((word(247), file.len()), (echoes.len(), start + stride * echoes.len()));
    let of_return: usize = (0..15).map(|number| word(255 + 8 * number)).sum();
    assert_eq!(of_return, echoes.len());
    for (echo, point) in echoes.iter().zip(file[start..].chunks_exact(stride)) {
        for (axis, place_m) in [echo.x_m, echo.y_m, echo.z_m].into_iter().enumerate() {
            let code = i32::from_le_bytes(point[4 * axis..4 * axis + 4].try_into().unwrap());
            let (scale_m, offset_m) = (number(131 + 8 * axis), number(155 + 8 * axis));
            assert!((f64::from(code) * scale_m + offset_m - place_m).abs() < 0.51 * scale_m);
            assert!(number(187 + 16 * axis) <= place_m && place_m <= number(179 + 16 * axis));
        }
        assert_eq!((point[14] & 15, point[14] >> 4), (echo.echo as u8, echo.echoes as u8));
        assert_eq!(point[22..30], echo.gps_time_s.to_le_bytes());
        assert_eq!(point[30..34], (echo.range_sd_m as f32).to_le_bytes());
    }
}

/// A campaign of several strips: what a check says of it, how its shards are planned and computed one by one, and what
/// is told of an echo.
#[test]
fn a_flight_is_checked_computed_in_shards_and_explained() {
    let folder = tempfile::tempdir().unwrap();
    let strips: Vec<_> = (0..3).map(|strip| flight(40, 50 + strip)).collect();
    let names = ["1", "2", "3"];
    let files: Vec<(String, Vec<u8>)> = strips
        .iter()
        .zip(names)
        .flat_map(|(strip, name)| {
            let [pls, wvs] =
                files::pulse_waves(&strip.iter().map(|(shot, _)| shot).collect::<Vec<_>>(), Some(ANCHOR_UNITS));
            [(format!("{name}.pls"), pls), (format!("{name}.wvs"), wvs)]
        })
        .collect();
    let files: Vec<(&str, &[u8])> = files.iter().map(|(name, bytes)| (name.as_str(), bytes.as_slice())).collect();
    campaign(folder.path(), &files);
    let toml = folder.path().join("campaign/campaign.toml");
    let text = fs::read_to_string(&toml).unwrap();
    let text = text
        .replace("[campaign]", "[campaign]\npart_bytes = 1")
        .replace("raw/*.pls", "raw/{lit}.pls")
        .replace("lit = 1\n", "");
    fs::write(&toml, text).unwrap();
    let echoes = run(folder.path(), "whole", &[]);

    let json = |args: &[&str]| -> serde_json::Value {
        let output =
            Command::new(env!("CARGO_BIN_EXE_periscope")).args(args).current_dir(folder.path()).output().unwrap();
        assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&output.stdout).unwrap_or_default()
    };
    let report = json(&["check", "--campaign", "campaign", "--format", "json"]);
    let sensor = &report["sensors"][0];
    assert_eq!(sensor["echoes"], echoes.len());
    assert_eq!(sensor["pulses_with_echoes"], 90, "a fourth of the pulses has none");
    assert_eq!((report["fix"].as_array().unwrap().len(), report["captures"][0]["files"].as_u64()), (0, Some(3)));

    let plan = ["plan", "lidar", "--campaign", "campaign", "--out", "cut", "--shards", "3", "--format", "json"];
    let shards = json(&plan);
    let keys: Vec<&str> = shards.as_array().unwrap().iter().map(|row| row["key"].as_str().unwrap()).collect();
    assert_eq!(keys.len(), 3, "{shards:#}");
    for key in keys {
        periscope(folder.path(), &["run-shard", key, "--out", "cut"]);
    }
    assert_eq!(run(folder.path(), "cut", &[]), echoes);

    let echo = echoes.iter().find(|echo| echo.pulse == 5 && echo.run.contains('2')).unwrap();
    let explained = json(&["explain", "cut", &format!("echo={},5,1", echo.run), "--format", "json"]);
    assert_eq!(
        (explained["row"]["time_ps"].as_f64(), &explained["table_kind"]),
        (Some(echo.time_ps), &"echoes".into())
    );
    let queries = explained["queries"].as_array().unwrap();
    assert!(
        queries
            .iter()
            .any(|query| query["about"] == "its pulse" && query["sql"].as_str().unwrap().contains("pulse = 5"))
    );
    let unknown = Command::new(env!("CARGO_BIN_EXE_periscope"))
        .args(["explain", "cut", "echo=raw/4.pls,5,1"])
        .current_dir(folder.path())
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&unknown.stderr).into_owned();
    assert!(text.contains("no run raw/4.pls") && text.contains("did you mean"), "{text}");
}

/// Where a file does not say when its pulses left, times are those of the record.
#[test]
fn without_the_time_of_the_outgoing_pulse_times_are_those_of_the_record() {
    let flight = flight(8, 3);
    let folder = tempfile::tempdir().unwrap();
    let shots: Vec<&Shot> = flight.iter().map(|(shot, _)| shot).collect();
    let [pls, wvs] = files::pulse_waves(&shots, None);
    campaign(folder.path(), &[("a.pls", &pls), ("a.wvs", &wvs)]);
    let echoes = run(folder.path(), "results", &[]);
    let echo = echoes.iter().find(|echo| echo.pulse == 5).unwrap();
    let (_, light) = &flight[5];
    let late_ps = echo.time_ps - 1e3 * light[0].time;
    // The outgoing pulse has its maximum at sample 30.3 ± 1 of its record, whose start is 4 samples early.
    assert!((25_000.0..28_000.0).contains(&late_ps), "{late_ps}");
    assert!((echo.edge_ps.unwrap() - echo.time_ps + 5_000.0).abs() < 1500.0, "{echo:?}");
}

/// A LAS file has no outgoing pulses: their width is asked for, and then a Gaussian.
#[test]
fn a_las_file_needs_the_width_of_its_pulses() {
    let gauss: fn(f64) -> f64 = |time| (-0.5 * (time / 4.0).powi(2)).exp();
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let shot = |_| {
        let light = [
            Light { time: rng.random_range(45.0..55.0), strength: rng.random_range(80.0..400.0), width: 2.0 },
            Light { time: rng.random_range(100.0..110.0), strength: rng.random_range(80.0..400.0), width: 4.0 },
        ];
        (
            light,
            LasPulse { samples: samples(gauss, &light, 0.0, 160, &mut rng), location_ps: 1e3 * light[0].time as f32 },
        )
    };
    let flight: Vec<_> = (0..160).map(shot).collect();
    let pulses: Vec<&LasPulse> = flight.iter().map(|(_, pulse)| pulse).collect();
    let folder = tempfile::tempdir().unwrap();
    campaign(folder.path(), &[("a.las", &files::las(&pulses))]);
    let output = Command::new(env!("CARGO_BIN_EXE_periscope"))
        .args(["run", "--campaign", "campaign", "--out", "none"])
        .current_dir(folder.path())
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(3), "{}", String::from_utf8_lossy(&output.stderr));
    let rejects: Vec<Reject> = rows(&folder.path().join("none"), "rejects");
    assert!(
        rejects
            .iter()
            .any(|reject| reject.reason.starts_with("160 of 160 pulses") && reject.reason.contains("`pulse_fwhm_ps`")),
        "{rejects:?}"
    );
    let width = ["--set", "echoes.pulse_fwhm_ps=9419.28"];
    let echoes = run(folder.path(), "results", &width);
    assert!((318..=320).contains(&echoes.len()), "{}", echoes.len());
    let mut z = Vec::new();
    for echo in echoes.iter().filter(|echo| echo.echoes == 2) {
        let (light, pulse) = &flight[echo.pulse as usize];
        // Times count from the first return.
        let true_ps = 1e3 * light[echo.echo as usize - 1].time - f64::from(pulse.location_ps);
        z.push((echo.time_ps - true_ps) / echo.time_sd_ps);
        let down_m = files::LAS_VELOCITY_Z_M_PER_PS * echo.time_ps;
        assert!((echo.z_m - files::las_place_m()[2] - down_m).abs() < 1e-3, "{echo:?}");
    }
    println!("LAS: {} echoes, rms z of time {:.2}", z.len(), rms(&z));
    assert!((0.85..1.15).contains(&rms(&z)), "{}", rms(&z));
}

/// Files that are no lidar's, and files that are cut: each is a row in `rejects`, and the others are used.
#[test]
fn a_file_without_beams_is_rejected_and_the_others_are_used() {
    let flight = flight(8, 5);
    let folder = tempfile::tempdir().unwrap();
    let shots: Vec<&Shot> = flight.iter().map(|(shot, _)| shot).collect();
    let [pls, wvs] = files::pulse_waves(&shots, Some(ANCHOR_UNITS));
    let cut = &pls[..pls.len() - 60];
    campaign(
        folder.path(),
        &[("a.pls", &pls), ("a.wvs", &wvs), ("b.pls", cut), ("b.wvs", &wvs), ("c.pls", b"no lidar")],
    );
    let output = Command::new(env!("CARGO_BIN_EXE_periscope"))
        .args(["run", "--campaign", "campaign", "--out", "results"])
        .current_dir(folder.path())
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(3), "{}", String::from_utf8_lossy(&output.stderr));
    let rejects: Vec<Reject> = rows(&folder.path().join("results"), "rejects");
    let files: Vec<&str> = rejects.iter().filter_map(|reject| reject.file.as_deref()).collect();
    assert_eq!(files, ["raw/b.pls", "raw/c.pls"], "{rejects:?}");
    let echoes: Vec<Echo> = rows(&folder.path().join("results"), "echoes");
    assert!(echoes.len() >= 11 && echoes.iter().all(|echo| &*echo.run == "raw/a.pls"), "{}", echoes.len());
}

/// Rows of a table of numbers with one line of names; text in quotes does not occur.
fn numbers(file: &Path) -> Vec<Vec<f64>> {
    let text = fs::read_to_string(file).unwrap();
    text.lines().skip(1).map(|line| line.split(',').map(|cell| cell.parse().unwrap_or(f64::NAN)).collect()).collect()
}

fn median(values: &[f64]) -> f64 {
    let mut values = values.to_vec();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Robust standard deviation.
fn spread(values: &[f64]) -> f64 {
    let middle = median(values);
    1.4826 * median(&values.iter().map(|value| (value - middle).abs()).collect::<Vec<_>>())
}

/// Records of a stack of arrays, without the zeros behind them.
fn stack(file: &Path) -> Vec<Vec<f64>> {
    let mut source = Source::open(file).unwrap();
    let records = formats::records(&mut source).unwrap();
    let values = records.iter().map(|record| source.values(record).unwrap());
    values.map(|values| values.into_iter().take_while(|value| *value > 0.0).collect()).collect()
}

/// 250 shots of NEON over Harvard Forest: first edges against NEON's own, echoes against a package's decomposition.
#[test]
fn real_shots_agree_with_other_readings() {
    let folder: PathBuf = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/real-light/lidar");
    if !folder.join("returns.npy").exists() {
        eprintln!("\n!!! no real lidar shots here (../shared/real-light/lidar): what they would test is NOT tested\n");
        return;
    }
    let codes = |values: &[f64]| values.iter().map(|value| *value as u16).collect::<Vec<u16>>();
    let (returns, outgoing) = (stack(&folder.join("returns.npy")), stack(&folder.join("outg.npy")));
    let shots: Vec<Shot> = returns
        .iter()
        .zip(&outgoing)
        .map(|(returning, outgoing)| Shot { outgoing: codes(outgoing), start: 0, returning: codes(returning) })
        .collect();
    let scratch = tempfile::tempdir().unwrap();
    let [pls, wvs] = files::pulse_waves(&shots.iter().collect::<Vec<_>>(), None);
    campaign(scratch.path(), &[("neon.pls", &pls), ("neon.wvs", &wvs)]);
    let echoes = run(scratch.path(), "results", &[]);
    let geo = numbers(&folder.join("geo.csv"));
    let package = numbers(&folder.join("decom_result.csv"));
    let (mut near, mut near_by_theirs) = (0, 0);
    let (mut differences, mut sds) = (Vec::new(), Vec::new());
    for (number, (geo, returning)) in geo.iter().zip(&returns).enumerate() {
        let of_shot: Vec<&Echo> = echoes.iter().filter(|echo| echo.pulse == number as i64).collect();
        let first_bins = of_shot.first().and_then(|echo| echo.edge_ps).map_or(f64::NAN, |edge_ps| edge_ps / 1e3);
        let is_near = (first_bins - geo[8]).abs() < 0.5;
        near += usize::from(is_near);
        near_by_theirs += usize::from(is_near || (half_of_the_record(returning) - geo[8]).abs() < 0.5);
        // Their centres are those of Gaussians, and count from 1.
        let centres: Vec<f64> = of_shot.iter().map(|echo| gaussian_centre(echo, &outgoing[number])).collect();
        for theirs in package.iter().filter(|row| row[0] == number as f64 + 1.0) {
            let of_shot = of_shot.iter().map(|echo| echo.time_sd_ps / 1e3);
            let ours = centres.iter().map(|centre| centre - theirs[2] + 1.0).zip(of_shot);
            if let Some((difference, sd)) = ours.min_by(|a, b| a.0.abs().total_cmp(&b.0.abs()))
                && difference.abs() < 8.0
            {
                differences.push(difference);
                sds.push(sd);
            }
        }
    }
    let per_shot = echoes.len() as f64 / 250.0;
    let z: Vec<f64> = differences.iter().zip(&sds).map(|(difference, sd)| difference / sd).collect();
    println!(
        "{per_shot:.2} echoes a shot; {near} of 250 first edges within half a bin of NEON's, {near_by_theirs} with those \
         where half of the record's maximum is; of {} echoes of the package {} have one of ours within 8 bins: \
         difference {:.2} ± {:.2}, sd {:.2}, robust z {:.2}",
        package.len(),
        z.len(),
        median(&differences),
        spread(&differences),
        median(&sds),
        spread(&z)
    );
    assert!(per_shot <= 2.0, "{per_shot}");
    assert!(near >= 225 && near_by_theirs >= 238, "{near}, {near_by_theirs}");
    assert!((0.75..1.3).contains(&spread(&z)) && median(&differences).abs() < 0.2, "{}", spread(&z));
}

/// Centre, in bins, of the Gaussian that fits a fitted echo best: what a decomposition into Gaussians calls its place.
fn gaussian_centre(echo: &Echo, outgoing: &[f64]) -> f64 {
    const MARGIN: usize = 60;
    let ends = [&outgoing[..3], &outgoing[outgoing.len() - 3..]].map(|end| end.iter().sum::<f64>() / 3.0);
    let light: Vec<f64> = outgoing.iter().map(|value| value - ends[0].min(ends[1])).collect();
    let sigma = (echo.width_ps / 1e3).max(1e-3);
    let weight = |lag: f64| (-0.5 * (lag / sigma).powi(2)).exp();
    let all: f64 = (-200..=200).map(|lag| weight(f64::from(lag))).sum();
    let at = |n: usize| {
        light.iter().enumerate().map(|(i, value)| value * weight((n as f64 - MARGIN as f64) - i as f64)).sum::<f64>()
            / all
    };
    let curve: Vec<f64> = (0..light.len() + 2 * MARGIN).map(at).collect();
    let top = curve.iter().copied().fold(0.0, f64::max);
    let highest = curve.iter().position(|value| *value == top).unwrap();
    let mut gauss = [top, highest as f64, 6.0];
    for _ in 0..30 {
        let [height, centre, width] = gauss;
        let mut columns = vec![Vec::new(); 3];
        let mut residuals = Vec::new();
        for (n, value) in curve.iter().enumerate() {
            let x = (n as f64 - centre) / width;
            let shape = (-0.5 * x * x).exp();
            columns[0].push(shape);
            columns[1].push(height * shape * x / width);
            columns[2].push(height * shape * x * x / width);
            residuals.push(value - height * shape);
        }
        let step = least_squares(&columns, &residuals, &vec![1.0; curve.len()]).unwrap();
        gauss.iter_mut().zip(&step.values).for_each(|(value, step)| *value += step);
    }
    echo.time_ps / 1e3 + gauss[1] - MARGIN as f64 - Outgoing::of(outgoing).unwrap().peak
}

/// Where a record first rises through half of its maximum above its lowest tenth.
fn half_of_the_record(record: &[f64]) -> f64 {
    let mut low = record.to_vec();
    low.sort_by(f64::total_cmp);
    let level = 0.5 * (low[low.len() - 1] + low[low.len() / 20]);
    let above = (1..record.len()).find(|n| record[*n] > level).unwrap();
    above as f64 - (record[above] - level) / (record[above] - record[above - 1])
}
