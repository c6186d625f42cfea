//! f: a true response that differs from the one that the estimator is given.

use periscope::signal::response::Response;
use periscope::signal::sparse::SparseOptions;

use super::draw::{Effort, LEN, draws, fit, middle_ps, noisy, own_sds_ps};
use super::information::time_sds_ps;
use super::score::{Rate, heading, row};
use super::shape::{Sensor, Shape};

/// Standard deviations of chi2 beyond which the stage `detect` flags a misfit.
const MISFIT_SIGMA: f64 = 3.0;
/// An echo of a cable of 7 cm.
const ECHO_PS: f64 = 700.0;

/// What became of one record.
struct Draw {
    /// Of each true pulse, the error of the nearest found.
    errors_ps: Vec<f64>,
    pulses: usize,
    bound_ps: f64,
    /// Share of true pulses within the 95 % interval of the nearest found.
    within: f64,
    /// As the stage `detect` flags a pulse of it.
    is_flagged: bool,
}

/// Pulses of height 1 of the shape `light`, fitted with `response`.
fn measure(
    label: &str,
    light: &Shape,
    response: &Response,
    apart_ps: Option<f64>,
    snr: f64,
    count: usize,
) -> Vec<Draw> {
    draws(label, count, |rng| {
        let at_ps = middle_ps(LEN, rng);
        let truth: Vec<(f64, f64)> =
            std::iter::once(at_ps).chain(apart_ps.map(|d| at_ps + d)).map(|at| (at, 1.0)).collect();
        let samples = noisy(light, &truth, 1.0 / snr, LEN, rng);
        let solution = fit(response, &samples, 1.0 / snr, &SparseOptions::default());
        let own = own_sds_ps(&solution);
        let nearest = |at: f64| {
            let errors = solution.pulses.iter().zip(&own).map(|(pulse, sd_ps)| (pulse.time_ps - at, *sd_ps));
            errors.min_by(|a, b| a.0.abs().total_cmp(&b.0.abs())).expect("a strong pulse is found")
        };
        let nearest: Vec<(f64, f64)> = truth.iter().map(|(at, _)| nearest(*at)).collect();
        Draw {
            errors_ps: nearest.iter().map(|(error, _)| *error).collect(),
            within: Rate::of(nearest.iter().map(|(error, sd_ps)| error.abs() < 1.959_964 * sd_ps)).share(),
            pulses: solution.pulses.len(),
            bound_ps: time_sds_ps(light, &truth, 1.0 / snr, LEN)[0],
            is_flagged: solution.pulses.iter().any(|pulse| pulse.misfit_sigma > MISFIT_SIGMA),
        }
    })
}

/// Prints the table.
pub fn print(effort: Effort) {
    let columns = [
        "response",
        "error",
        "light",
        "SNR",
        "right number",
        "more than there are",
        "bias (ps)",
        "rms (ps)",
        "bound (ps)",
        "in 95 % interval",
        "flag `misfit`",
    ];
    let count = effort.of(300);
    heading(&format!("### f. A response that is not as told\n\n{count} draws a row."), &columns);
    for Sensor { name, shape, response } in Sensor::both() {
        let cases = [
            ("none", shape.clone(), response.clone()),
            ("told 2 % too wide", shape.clone(), shape.stretched(1.02).response()),
            ("told 5 % too wide", shape.clone(), shape.stretched(1.05).response()),
            ("told 2 % too narrow", shape.clone(), shape.stretched(0.98).response()),
            ("told 5 % too narrow", shape.clone(), shape.stretched(0.95).response()),
            ("echo of -40 dB", shape.with_echo(ECHO_PS, 0.01), response.clone()),
            ("tail of 2 %, 1 ns", shape.with_tail(1000.0, 0.02), response.clone()),
        ];
        for (case, light, given) in &cases {
            for (pulses, apart_ps) in [("one", None), ("pair, 100 ps", Some(100.0)), ("pair, 150 ps", Some(150.0))] {
                for snr in [100.0, 300.0] {
                    let label = format!("mismatch {name} {case} {pulses} {snr}");
                    let draws = measure(&label, light, given, apart_ps, snr, count);
                    let truth = draws[0].errors_ps.len();
                    let mean = |value: &dyn Fn(&Draw) -> f64| draws.iter().map(value).sum::<f64>() / count as f64;
                    let bias = (0..truth).map(|k| format!("{:+.2}", mean(&|draw| draw.errors_ps[k])));
                    let rate = |held: &dyn Fn(&Draw) -> bool| format!("{:.2}", Rate::of(draws.iter().map(held)));
                    let square =
                        mean(&|draw| draw.errors_ps.iter().map(|e| e * e).sum::<f64>() / draw.errors_ps.len() as f64);
                    row(&[
                        name.to_owned(),
                        (*case).to_owned(),
                        pulses.to_owned(),
                        snr.to_string(),
                        rate(&|draw| draw.pulses == truth),
                        rate(&|draw| draw.pulses > truth),
                        bias.collect::<Vec<_>>().join(", "),
                        format!("{:.2}", square.sqrt()),
                        format!("{:.2}", mean(&|draw| draw.bound_ps)),
                        format!("{:.2}", mean(&|draw| draw.within)),
                        rate(&|draw| draw.is_flagged),
                    ]);
                }
            }
        }
    }
}
