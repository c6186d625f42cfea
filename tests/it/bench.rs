//! An instrument on the bench, good or with one fault, and the runs of its check: a Gaussian edge with a decay, a reference channel, trigger jitter,
//! white noise, a converter of 16 bits.

use std::fmt::Write as _;
use std::fs;
use std::io::BufWriter;
use std::path::Path;

use periscope::units;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

pub const DT_PS: f64 = 50.0;
const T0_PS: f64 = -1500.0;
const SAMPLES: usize = 320;
const GAIN_V: f64 = 1e-4;
const NOISE_V: f64 = 0.02;
const JITTER_PS: f64 = 80.0;
const LATENCY_PS: f64 = 900.0;
/// Height of the pulse of one shot without attenuator at 1 m.
pub const HEIGHT_V: f64 = 0.8;

/// What may be wrong with it.
#[derive(Clone, Copy, Default)]
pub struct Faults {
    /// Share that a pulse of [`HEIGHT_V`] is too low.
    pub compression: f64,
    /// Delay that each run of the time series has more than the one before.
    pub drift_ps: f64,
    /// Height of a second pulse 4 ns behind.
    pub echo: f64,
    /// Delay of a pulse of [`HEIGHT_V`] more than of a small one.
    pub walk_ps: f64,
    /// Height of a burst while the beam is stopped.
    pub pickup_v: f64,
}

/// One run: settings, and how many shots.
struct Run {
    role: &'static str,
    name: String,
    keys: String,
    height_v: f64,
    path_m: f64,
    delay_ps: f64,
    shots: usize,
}

/// A pulse with its maximum 1 at 0: a Gaussian edge of 33 ps with a decay of 112 ps.
fn pulse(shape: &[f64], t_ps: f64) -> f64 {
    let place = (t_ps + 400.0) / 2.0;
    let (i, u) = (place.floor(), place - place.floor());
    match shape.get(i.max(0.0) as usize..).and_then(|rest| rest.get(..2)) {
        Some(pair) if i >= 0.0 => pair[0] + u * (pair[1] - pair[0]),
        _ => 0.0,
    }
}

fn shape() -> Vec<f64> {
    /// Where the maximum lies behind the Gaussian's.
    const MODE_PS: f64 = 41.1;
    let value = |t_ps: f64| {
        let terms = (0..1200).map(|k| f64::from(k) * 2.0);
        terms.map(|s| (-s / 112.0).exp() * (-0.5 * ((t_ps - s) / 33.0).powi(2)).exp()).sum::<f64>()
    };
    let values: Vec<f64> = (0..1400).map(|i| value(f64::from(i) * 2.0 - 400.0 + MODE_PS)).collect();
    let top = values.iter().copied().fold(0.0, f64::max);
    values.into_iter().map(|value| value / top).collect()
}

/// The runs of a whole check: calibration, attenuations, paths, times, bounces, dark and blocked.
fn runs(faults: &Faults, shots: usize) -> Vec<Run> {
    let run = |role, name: String, keys: String, height_v: f64, path_m: f64| Run {
        role,
        name,
        keys,
        height_v,
        path_m,
        delay_ps: 0.0,
        shots,
    };
    let mut runs =
        vec![run("response", "response".to_owned(), "path_m = 1.0\npath_sd_m = 0.0001\n".to_owned(), 0.5, 1.0)];
    runs[0].shots = 8 * shots;
    for tenth in 0..6 {
        let od = f64::from(tenth) / 5.0;
        let keys = format!("path_m = 1.0\nattenuation_od = {od:?}\n");
        runs.push(run("fiducial", format!("od_{tenth}"), keys, HEIGHT_V * 10_f64.powf(-od), 1.0));
    }
    for tenth in [9, 11, 13, 15, 17] {
        let path_m = f64::from(tenth) / 10.0;
        let keys = format!("path_m = {path_m:?}\npower_w = 0.1\n");
        runs.push(run("fiducial", format!("path_{tenth:02}"), keys, 0.4 / (path_m * path_m), path_m));
    }
    for hour in 0..8 {
        let keys = "path_m = 1.2\npower_w = 0.2\n".to_owned();
        let delay_ps = f64::from(hour) * faults.drift_ps;
        runs.push(Run { delay_ps, ..run("fiducial", format!("time_{hour}"), keys, 0.4, 1.2) });
    }
    for bounces in 1..=3 {
        let keys = format!("path_m = 2.0\nbounces = {bounces}\n");
        runs.push(run("fiducial", format!("bounces_{bounces}"), keys, HEIGHT_V * 0.3_f64.powi(bounces), 2.0));
    }
    runs.push(run("dark", "dark".to_owned(), String::new(), 0.0, 0.0));
    runs.push(run("blocked", "blocked".to_owned(), String::new(), 0.0, 0.0));
    runs
}

/// Writes the campaign of an instrument's check, `shots` a run.
pub fn write(folder: &Path, faults: &Faults, shots: usize, seed: u64) {
    let (shape, mut rng) = (shape(), ChaCha8Rng::seed_from_u64(seed));
    let mut text = String::from("[campaign]\nname = \"bench\"\ngroup_index = 1.0\n[sensors.s1]\n");
    for run in runs(faults, shots) {
        fs::create_dir_all(folder.join(format!("raw/{}", run.role))).unwrap();
        let stem = format!("raw/{}/{}", run.role, run.name);
        let scale = format!("dt_ps = {DT_PS:?}\nt0_ps = {T0_PS:?}\ngain_v = {GAIN_V:?}\noffset_v = 0.0\n");
        writeln!(
            text,
            "[[captures]]\nrole = \"{}\"\nfiles = \"{stem}_C1.npy\"\nreference = {{ files = \"{stem}_C2.npy\" }}\n{scale}{}",
            run.role, run.keys
        )
        .unwrap();
        let [signal, reference] = record(&run, faults, &shape, &mut rng);
        for (channel, codes) in [(1, signal), (2, reference)] {
            let file = fs::File::create(folder.join(format!("{stem}_C{channel}.npy"))).unwrap();
            let shape = [run.shots as u64, SAMPLES as u64];
            periscope::formats::npy::write(&mut BufWriter::new(file), &shape, &codes).unwrap();
        }
    }
    fs::write(folder.join("campaign.toml"), text).unwrap();
}

/// Codes of signal and reference, shot by shot.
fn record(run: &Run, faults: &Faults, shape: &[f64], rng: &mut ChaCha8Rng) -> [Vec<i16>; 2] {
    let [mut signal, mut reference] = [Vec::new(), Vec::new()];
    let (height_v, share) = (run.height_v, run.height_v / HEIGHT_V);
    let at_ps = units::time_ps(run.path_m, 1.0) + LATENCY_PS + run.delay_ps + faults.walk_ps * share;
    let light = |t_ps: f64| pulse(shape, t_ps - at_ps) + faults.echo * pulse(shape, t_ps - at_ps - 4000.0);
    let burst = |t_ps: f64| if run.role == "blocked" { faults.pickup_v * pulse(shape, t_ps - 3000.0) } else { 0.0 };
    let mut normal = || -> f64 { StandardNormal.sample(rng) };
    for _ in 0..run.shots {
        let jitter_ps = JITTER_PS * normal();
        for n in 0..SAMPLES {
            let t_ps = T0_PS + n as f64 * DT_PS - jitter_ps;
            let bare_v = height_v * light(t_ps);
            let volts = bare_v * (1.0 - faults.compression * bare_v / HEIGHT_V) + burst(t_ps) + NOISE_V * normal();
            signal.push((volts / GAIN_V).round() as i16);
            let pulse_v = 0.8 * (-0.5 * (t_ps / 85.0).powi(2)).exp();
            reference.push(((pulse_v + NOISE_V * normal()) / GAIN_V).round() as i16);
        }
    }
    [signal, reference]
}
