//! i: the methods compared.

use std::fmt;

use periscope::signal::onset;
use periscope::signal::sparse::{self, SparseOptions};
use periscope_comparison::nnls::{self, NnlsOptions};
use periscope_comparison::pencil::{self, PencilOptions};
use periscope_comparison::richardson_lucy::{self, RichardsonLucyOptions};
use rand::RngExt;

use super::draw::{DT_PS, Effort, LEN, draws, middle_ps, noisy, profile};
use super::information::{resolution_limit_ps, time_sds_ps};
use super::pairs::LIMITS;
use super::score::{Estimate, Rate, heading, mean_square, row};
use super::shape::Sensor;

const SNR: f64 = 100.0;
const APART_PS: f64 = 100.0;
/// Atoms of `nnls` no more grid steps apart than this are one pulse; closer ones are left to the pruning.
const MERGE_STEPS: f64 = 1.5;
/// False pulses a record of noise alone, as the stage `deconvolve` has it.
const FALSE_PULSES: f64 = 1e-4;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Method {
    Sparse,
    Nnls,
    Pencil,
    RichardsonLucy,
    LeadingEdge,
    ConstantFraction,
    Akaike,
    FirstResponse,
}

impl Method {
    const ALL: [Self; 8] = [
        Self::Sparse,
        Self::Nnls,
        Self::Pencil,
        Self::RichardsonLucy,
        Self::LeadingEdge,
        Self::ConstantFraction,
        Self::Akaike,
        Self::FirstResponse,
    ];

    /// Whether it knows the response; an edge does not, and sees one onset of a blended pair.
    fn deconvolves(self) -> bool {
        matches!(self, Self::Sparse | Self::Nnls | Self::Pencil | Self::RichardsonLucy)
    }

    /// Times of the pulses of `samples`, ps.
    fn times_ps(self, sensor: &Sensor, samples: &[f64]) -> Vec<f64> {
        let (sd, response) = (1.0 / SNR, &sensor.response);
        let sd_v = vec![sd; samples.len()];
        let record = profile(samples, &sd_v, &[1.0]);
        let evidence_min = sparse::evidence_min_of(&record, response, FALSE_PULSES);
        let at = |position: Option<f64>| position.map(|position| DT_PS * position).into_iter().collect();
        match self {
            Self::Sparse => {
                let solution = sparse::fit(&record, response, &SparseOptions::default());
                solution.pulses.iter().map(|pulse| pulse.time_ps).collect()
            }
            Self::Nnls => {
                let options = NnlsOptions { merge_steps: MERGE_STEPS, ..NnlsOptions::default() };
                nnls::fit(&record, response, &options).pruned(&record, response, evidence_min).times_ps
            }
            Self::Pencil => {
                let solution = pencil::fit(&record, response, &PencilOptions::default());
                solution.pruned(&record, response, evidence_min).times_ps
            }
            Self::RichardsonLucy => richardson_lucy::fit(&record, response, &RichardsonLucyOptions::default()).times_ps,
            Self::LeadingEdge => {
                at(onset::leading_edge(samples, 0.5, onset::Noise::even(sd)).map(|edge| edge.position))
            }
            Self::ConstantFraction => {
                at(onset::constant_fraction(samples, 0.5, 2.0, onset::Noise::even(sd)).map(|edge| edge.position))
            }
            Self::Akaike => at(onset::akaike(samples, 20, sd)),
            Self::FirstResponse => at(onset::responses(samples, 5.0, 2.0, sd).first().map(|first| first.position)),
        }
    }
}

impl fmt::Display for Method {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Self::Sparse => "sparse",
            Self::Nnls => "nnls, pruned",
            Self::Pencil => "pencil, pruned",
            Self::RichardsonLucy => "richardson-lucy",
            Self::LeadingEdge => "leading edge, 0.5",
            Self::ConstantFraction => "constant fraction, 0.5, 100 ps",
            Self::Akaike => "aic",
            Self::FirstResponse => "first response, 5 sigma",
        })
    }
}

/// Errors of one pulse whose height has a logarithm from 0 to `log_max`; `None` if not one is found.
fn single(method: Method, sensor: &Sensor, log_max: f64, count: usize) -> Vec<Option<(f64, f64)>> {
    draws(&format!("methods {} {log_max}", sensor.name), count, |rng| {
        let log = log_max * rng.random_range(0.0..1.0);
        let truth = [(middle_ps(LEN, rng), log.exp())];
        let samples = noisy(&sensor.shape, &truth, 1.0 / SNR, LEN, rng);
        let [time_ps] = method.times_ps(sensor, &samples)[..] else { return None };
        Some((log, time_ps - truth[0].0))
    })
}

/// How many pairs are found as two, and their root of the mean squared error over the bound.
fn pair(method: Method, sensor: &Sensor, apart_ps: f64, count: usize) -> [String; 2] {
    if !method.deconvolves() {
        return ["-", "-"].map(str::to_owned);
    }
    let squares = draws(&format!("methods {} pair {apart_ps}", sensor.name), count, |rng| {
        let at_ps = middle_ps(LEN, rng);
        let truth = [(at_ps, 1.0), (at_ps + apart_ps, 1.0)];
        let bounds_ps = time_sds_ps(&sensor.shape, &truth, 1.0 / SNR, LEN);
        let samples = noisy(&sensor.shape, &truth, 1.0 / SNR, LEN, rng);
        let [first, second] = method.times_ps(sensor, &samples)[..] else { return None };
        Some(mean_square([(first - truth[0].0) / bounds_ps[0], (second - truth[1].0) / bounds_ps[1]]))
    });
    let squares: Vec<f64> = squares.into_iter().flatten().collect();
    [Rate { hits: squares.len(), of: count }.to_string(), Estimate::rms(&squares).to_string()]
}

/// Prints the table.
pub fn print(effort: Effort) {
    let columns = [
        "response",
        "method",
        "draws",
        "one found of one",
        "offset (ps)",
        "sd (ps)",
        "walk (ps per e-fold)",
        "two found of a pair 100 ps apart",
        "rms / bound there",
        "two found of a pair 1.35 limits apart",
        "rms / bound there",
    ];
    heading(&format!("### i. Methods at an SNR of {SNR}"), &columns);
    for sensor in Sensor::both() {
        let limit_ps = resolution_limit_ps(&sensor.shape, SNR);
        for method in Method::ALL {
            let count = effort.of(300);
            let all = single(method, &sensor, 0.0, count);
            let errors: Vec<f64> = all.iter().flatten().map(|(_, error)| *error).collect();
            let walk: Vec<(f64, f64)> = single(method, &sensor, 10_f64.ln(), count).into_iter().flatten().collect();
            let [two, ratio] = pair(method, &sensor, APART_PS, count);
            let [two_close, ratio_close] = pair(method, &sensor, LIMITS * limit_ps, count);
            row(&[
                sensor.name.to_owned(),
                method.to_string(),
                count.to_string(),
                Rate { hits: errors.len(), of: count }.to_string(),
                format!("{:.2}", Estimate::mean(&errors)),
                format!("{:.2}", Estimate::spread(&errors)),
                format!("{:.2}", Estimate::slope(&walk)),
                two,
                ratio,
                two_close,
                ratio_close,
            ]);
        }
    }
}
