//! g: profiles a second, compared with SciPy's non-negative least squares on the same records.

use std::collections::BTreeMap;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use periscope::signal::sparse::SparseOptions;
use periscope_comparison::nnls::{self, NnlsOptions};
use rand::RngExt;
use serde_json::json;

use super::draw::{DT_PS, Effort, draws, fit, middle_ps, noisy, profile};
use super::score::{heading, row};
use super::shape::Sensor;

const LEN: usize = 2048;
const SD: f64 = 0.01;
/// Each record is timed so often; the least counts.
const ROUNDS: usize = 3;
const PULSES: [usize; 3] = [1, 4, 12];

/// A record and where its first and last pulse are.
struct TimedRecord {
    light_ps: [f64; 2],
    samples: Vec<f64>,
}

/// Records of `pulses` pulses of amplitudes from 0.3 to 1, 150 to 650 ps apart.
fn records(sensor: &Sensor, pulses: usize, count: usize) -> Vec<TimedRecord> {
    draws(&format!("speed {} {pulses}", sensor.name), count, |rng| {
        let mut at_ps = middle_ps(LEN, rng);
        let pulse = |_| {
            at_ps += rng.random_range(150.0..650.0);
            (at_ps, rng.random_range(0.3..1.0))
        };
        let truth: Vec<(f64, f64)> = (0..pulses).map(pulse).collect();
        TimedRecord { light_ps: [truth[0].0, truth[pulses - 1].0], samples: noisy(&sensor.shape, &truth, SD, LEN, rng) }
    })
}

/// Seconds a record that `solve` takes.
fn seconds(records: &[TimedRecord], solve: impl Fn(&[f64])) -> f64 {
    let timed = |record: &TimedRecord| {
        let round = |_| {
            let start = Instant::now();
            solve(&record.samples);
            start.elapsed().as_secs_f64()
        };
        (0..ROUNDS).map(round).fold(f64::INFINITY, f64::min)
    };
    records.iter().map(timed).sum::<f64>() / records.len() as f64
}

/// Seconds per record of SciPy's NNLS on the range with signal, and on the whole record, by file name. `None` without
/// SciPy.
fn peer(folder: &Path) -> Option<BTreeMap<String, [f64; 2]>> {
    let python = std::env::var("PERISCOPE_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/nnls.py");
    let output = Command::new(python)
        .arg(script)
        .arg(folder)
        .env("OPENBLAS_NUM_THREADS", "1")
        .output()
        .ok()
        .filter(|output| output.status.success())?;
    serde_json::from_slice(&output.stdout).ok()
}

/// Prints the table.
pub fn print(effort: Effort) {
    let columns = [
        "response",
        "pulses",
        "records",
        "sparse (profiles / s)",
        "own nnls, whole record (profiles / s)",
        "scipy.optimize.nnls, stretch with light (profiles / s)",
        "sparse over it",
        "scipy.optimize.nnls, whole record (profiles / s)",
        "sparse over it",
    ];
    heading("### g. Profiles of 2,048 samples a second, one thread, SNR up to 100", &columns);
    let temporary = tempfile::tempdir().expect("a temporary folder");
    let folder = std::env::var_os("PERISCOPE_BENCH_FOLDER").map_or(temporary.path().to_owned(), PathBuf::from);
    let mut ours = Vec::new();
    for sensor in Sensor::both() {
        let (first_ps, last_ps) = sensor.response.support_ps();
        let step_ps = DT_PS / 20.0;
        let times = (0..).map(|i| first_ps + f64::from(i) * step_ps).take_while(|t| *t <= last_ps);
        let response: Vec<f64> = times.map(|t| sensor.shape.at(t)[0]).collect();
        for pulses in PULSES {
            let records = records(&sensor, pulses, effort.of(50));
            let name = format!("{}-{pulses}", sensor.name);
            let document = json!({
                "dt_ps": DT_PS, "sd": SD, "records": records.iter().map(|r| &r.samples).collect::<Vec<_>>(),
                "light_ps": records.iter().map(|r| r.light_ps).collect::<Vec<_>>(),
                "response": { "t0_ps": first_ps, "step_ps": step_ps, "values": response },
            });
            std::fs::write(folder.join(format!("{name}.json")), document.to_string()).expect("a folder to write to");
            let sparse = seconds(&records, |record| {
                black_box(fit(&sensor.response, record, SD, &SparseOptions::default()));
            });
            let grid = seconds(&records, |record| {
                let options = NnlsOptions { step_ps: Some(0.5 * DT_PS), ..NnlsOptions::default() };
                black_box(nnls::fit(&profile(record, &[SD; LEN], &[]), &sensor.response, &options));
            });
            ours.push((sensor.name, pulses, records.len(), name, sparse, grid));
        }
    }
    let theirs = peer(&folder);
    for (sensor, pulses, count, name, sparse, grid) in ours {
        let rates = [sparse, grid].map(|seconds| format!("{:.0}", 1.0 / seconds));
        let cells = [&[sensor.to_owned(), pulses.to_string(), count.to_string()], &rates[..]].concat();
        let compared = theirs.as_ref().and_then(|theirs| theirs.get(&name)).map_or_else(
            || vec!["no SciPy here".to_owned()],
            |both| {
                both.iter()
                    .flat_map(|their| [format!("{:.2}", 1.0 / their), format!("{:.2}", their / sparse)])
                    .collect()
            },
        );
        row(&[cells, compared].concat());
    }
}
