//! b: two equal pulses closer than the response is wide.

use periscope::signal::sparse::{SparseFit, SparseOptions, fit_joint};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::draw::{DT_PS, Effort, LEN, draws, errors_ps, fit, middle_ps, noisy, profile};
use super::information::{resolution_limit_ps, time_sds_ps};
use super::score::{Estimate, Rate, heading, mean_square, met, row};
use super::shape::Sensor;

const SEPARATIONS_PS: [f64; 8] = [30.0, 50.0, 75.0, 100.0, 125.0, 150.0, 200.0, 300.0];
const SNRS: [f64; 5] = [10.0, 31.6, 100.0, 316.0, 1000.0];
/// The targets hold from this many resolution limits on.
pub const LIMITS: f64 = 1.35;

/// How pairs are separated.
#[derive(Clone, Copy, Debug)]
pub struct Separation {
    /// Exactly two found.
    pub two: Rate,
    /// Mean bound of the first time, ps.
    pub bound_ps: f64,
    /// Where two are found: root of the mean squared error over the bound.
    pub ratio: Estimate,
}

/// Two pulses of height 1 and the fit that `estimate` makes of them; the bound is that of one record over `gain`.
fn measure(
    label: &str,
    sensor: &Sensor,
    (apart_ps, snr, gain): (f64, f64, f64),
    count: usize,
    estimate: impl Fn(&[(f64, f64)], &mut ChaCha8Rng) -> SparseFit + Sync,
) -> Separation {
    let results = draws(&format!("{label} {} {apart_ps} {snr}", sensor.name), count, |rng| {
        let at_ps = middle_ps(LEN, rng);
        let truth = [(at_ps, 1.0), (at_ps + apart_ps, 1.0)];
        let bounds_ps = time_sds_ps(&sensor.shape, &truth, 1.0 / snr / gain, LEN);
        let errors = errors_ps(&estimate(&truth, rng), &truth);
        let square = errors.map(|errors| mean_square(errors.iter().zip(&bounds_ps).map(|(e, bound)| e / bound)));
        (bounds_ps[0], square)
    });
    let squares: Vec<f64> = results.iter().filter_map(|(_, square)| *square).collect();
    Separation {
        two: Rate::of(results.iter().map(|(_, square)| square.is_some())),
        bound_ps: results.iter().map(|(bound, _)| bound).sum::<f64>() / count as f64,
        ratio: Estimate::rms(&squares),
    }
}

/// Pairs in one record.
pub fn separation(sensor: &Sensor, apart_ps: f64, snr: f64, count: usize) -> Separation {
    measure("pair", sensor, (apart_ps, snr, 1.0), count, |truth, rng| {
        let samples = noisy(&sensor.shape, truth, 1.0 / snr, LEN, rng);
        fit(&sensor.response, &samples, 1.0 / snr, &SparseOptions::default())
    })
}

/// Pairs in two reciprocal records, whose noise and place between samples differ.
pub fn joint_separation(sensor: &Sensor, apart_ps: f64, snr: f64, shared_amplitudes: bool, count: usize) -> Separation {
    let sd_v = vec![1.0 / snr; LEN];
    measure("joint pair", sensor, (apart_ps, snr, 2_f64.sqrt()), count, |truth, rng| {
        let first = noisy(&sensor.shape, truth, 1.0 / snr, LEN, rng);
        let t0_ps = rng.random_range(0.0..DT_PS);
        let later: Vec<(f64, f64)> = truth.iter().map(|(at, a)| (at - t0_ps, *a)).collect();
        let second = noisy(&sensor.shape, &later, 1.0 / snr, LEN, rng);
        let (first, second) = (profile(&first, &sd_v, &[]), profile(&second, &sd_v, &[]));
        let second = periscope::signal::sparse::Profile { t0_ps, ..second };
        let records = [(first, &sensor.response), (second, &sensor.response)];
        fit_joint(&records, &SparseOptions::default(), shared_amplitudes).remove(0)
    })
}

/// Prints the tables.
pub fn print(effort: Effort) {
    let count = effort.of(1000);
    let snrs = SNRS.map(|snr| format!("SNR {snr}"));
    let columns: Vec<&str> = std::iter::once("apart (ps)").chain(snrs.iter().map(String::as_str)).collect();
    for sensor in Sensor::both() {
        let limits: Vec<String> =
            SNRS.iter().map(|snr| format!("{:.0}", LIMITS * resolution_limit_ps(&sensor.shape, *snr))).collect();
        heading(
            &format!(
                "### b. Two equal pulses, {}\n\n{count} draws a cell: exactly two found; rms / bound where two are found; bound of the first time. \
                 {LIMITS} resolution limits: {} ps at these SNRs.",
                sensor.name,
                limits.join(", ")
            ),
            &columns,
        );
        let cell = |apart_ps: f64, snr: f64| {
            let timing = separation(&sensor, apart_ps, snr, count);
            let has_target = sensor.name == "G250" && apart_ps >= LIMITS * 149.0 * (10.0 / snr).sqrt();
            let target = met(timing.two.share() >= 0.99 && timing.ratio.value <= 1.1);
            let target = if has_target { format!("; {target}") } else { String::new() };
            format!("{}; {}; {:.2} ps{target}", timing.two, timing.ratio, timing.bound_ps)
        };
        for apart_ps in SEPARATIONS_PS {
            let cells = SNRS.map(|snr| cell(apart_ps, snr));
            row(&[vec![apart_ps.to_string()], cells.to_vec()].concat());
        }
    }
    print_joint(effort);
}

fn print_joint(effort: Effort) {
    let columns = ["E, 30 ps, SNR 100", "draws", "two found", "rms / bound", "bound (ps)", "target"];
    heading("Two reciprocal profiles fitted together:", &columns);
    let (sensor, count) = (Sensor::exponential(), effort.of(1000));
    let rows = [
        ("one profile", separation(&sensor, 30.0, 100.0, count)),
        ("both, one amplitude a pulse", joint_separation(&sensor, 30.0, 100.0, true, count)),
        ("both, amplitudes of their own", joint_separation(&sensor, 30.0, 100.0, false, count)),
    ];
    for (i, (name, separation)) in rows.into_iter().enumerate() {
        row(&[
            name.to_owned(),
            count.to_string(),
            separation.two.to_string(),
            separation.ratio.to_string(),
            format!("{:.2}", separation.bound_ps),
            if i == 0 { String::new() } else { met(separation.two.share() >= 0.95).to_owned() },
        ]);
    }
}
