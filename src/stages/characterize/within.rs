//! Checks within runs: noise, echo, pick-up, and whether faint paths are seen at all.

use std::collections::BTreeMap;

use super::Characterize;
use super::finding::{Finding, Test};
use super::series::Run;
use crate::campaign::Role;
use crate::tables::Measurement;
use crate::units;

/// Least signal-to-noise ratio of a pulse that counts as seen.
const SNR_MIN: f64 = 5.0;
/// Least noise, in codes, that averaging needs.
const DITHER_CODES: f64 = 0.5;
/// Index of a coaxial cable: its signals run at two thirds of the speed of light.
const CABLE_INDEX: f64 = 1.5;

/// `bounces_N`: smallest signal-to-noise ratio of the runs with N bounces.
pub fn bounces(rows: &[&Measurement]) -> Vec<Finding> {
    let mut ratios: BTreeMap<i32, Vec<f64>> = BTreeMap::new();
    for row in rows {
        if let Some(bounces) = row.bounces {
            ratios.entry(bounces).or_default().push(row.snr.unwrap_or(0.0));
        }
    }
    if ratios.is_empty() {
        return vec![Finding::missing(
            "bounces",
            "no run says how often its light bounced: give the [[captures]] rules of known paths `bounces = N`",
        )];
    }
    let finding = |(bounces, ratios): (i32, Vec<f64>)| {
        let least = ratios.iter().copied().fold(f64::INFINITY, f64::min);
        Finding::limited(&format!("bounces_{bounces}"), least, SNR_MIN, "", ratios.len()).because(format!(
            "light is not seen after {bounces} bounces: average more shots, open the aperture, or use brighter patches"
        ))
    };
    ratios.into_iter().map(finding).collect()
}

/// `echo`: the largest second pulse of all runs.
pub fn echo(params: &Characterize, runs: &[Run<'_>]) -> Finding {
    let echoes: Vec<[f64; 4]> = runs
        .iter()
        .filter_map(|run| {
            Some([run.row.echo_ratio?, run.row.echo_ratio_sd?, run.row.echo_delay_ps?, run.row.echo_trials?])
        })
        .collect();
    let beyond = |[ratio, sd, ..]: &[f64; 4]| (ratio.abs() - params.echo_tolerance.get()) / sd;
    let Some([ratio, sd, delay_ps, _]) = echoes.iter().copied().max_by(|a, b| beyond(a).total_cmp(&beyond(b))) else {
        return Finding::missing(
            "echo",
            "no pulse with enough record behind it: record at least a response's length more after the pulse",
        );
    };
    let cable_m = units::path_m(delay_ps, CABLE_INDEX) / 2.0;
    let cause = format!(
        "an echo of {:.2} % comes {delay_ps:.0} ps behind the pulse, as from the far end of a cable of {cable_m:.3} m with a bad match: terminate it with 50 ohm, or shorten or change it",
        100.0 * ratio
    );
    let trials = echoes.iter().map(|[.., trials]| trials).sum();
    let good = (0.0, params.echo_tolerance.get());
    Finding { trials, ..Finding::tested("echo", (ratio, sd), good, "", Test::Normal, echoes.len()) }.because(cause)
}

/// `pickup`: the largest deviation of the mean record while the beam is stopped.
pub fn pickup(params: &Characterize, rows: &[&Measurement]) -> Finding {
    let blocked = rows.iter().filter(|row| *row.role == *Role::Blocked.name());
    let pickups: Vec<[f64; 3]> =
        blocked.filter_map(|row| Some([row.pickup_v?, row.pickup_sd_v?, row.pickup_trials?])).collect();
    let beyond = |[pickup_v, sd, _]: &[f64; 3]| (pickup_v.abs() - params.pickup_tolerance_v.get()) / sd;
    let Some([pickup_v, sd, _]) = pickups.iter().copied().max_by(|a, b| beyond(a).total_cmp(&beyond(b))) else {
        return Finding::missing(
            "pickup",
            "no run of role blocked: capture as many shots as of the scene with the laser firing and its beam stopped",
        );
    };
    let cause = "synchronous pick-up: the laser's electronics reach the signal with the beam stopped; shield and ground, move cables apart, or take the mean of blocked captures off";
    let trials = pickups.iter().map(|[.., trials]| trials).sum();
    let good = (0.0, params.pickup_tolerance_v.get());
    Finding { trials, ..Finding::tested("pickup", (pickup_v, sd), good, "V", Test::Normal, pickups.len()) }
        .because(cause)
}

/// `noise`, `noise_codes` and `noise_correlation`: of dark runs where there are any, else of what precedes the pulse.
pub fn noise(rows: &[&Measurement]) -> Vec<Finding> {
    let dark: Vec<&&Measurement> = rows.iter().filter(|row| *row.role == *Role::Dark.name()).collect();
    let rows: Vec<&&Measurement> = if dark.is_empty() { rows.iter().collect() } else { dark };
    let count = rows.len();
    let mean = |value: &dyn Fn(&Measurement) -> f64| rows.iter().map(|row| value(row)).sum::<f64>() / count as f64;
    let cause = "the noise is smaller than half a code, so that averaging leaves the converter's steps: choose a smaller vertical range, or add noise";
    let mut findings = vec![
        Finding::info("noise", mean(&|row| row.noise_v), "V", count),
        Finding::limited("noise_codes", mean(&|row| row.noise_v / row.gain_v.abs()), DITHER_CODES, "codes", count)
            .because(cause),
    ];
    if rows.iter().all(|row| row.noise_acf.is_some()) {
        let correlation = mean(&|row| row.noise_acf.unwrap_or(0.0));
        findings.push(Finding::info("noise_correlation", correlation, "", count));
    }
    findings
}

/// `noise_slope`: variance that light adds, over the amplitude (shot noise makes it positive, a laser that fluctuates
/// too); `width`; `dynamic_range_db`: the largest pulse over the noise of its mean record.
pub fn told_of_pulses(runs: &[Run<'_>]) -> Vec<Finding> {
    let mut findings = Vec::new();
    let added = runs.iter().filter_map(|run| {
        let extra_v2 = run.row.signal_noise_v?.powi(2) - run.row.noise_v.powi(2);
        Some((run.amplitude_v, extra_v2))
    });
    let added: Vec<(f64, f64)> = added.collect();
    let squares: f64 = added.iter().map(|(amplitude_v, _)| amplitude_v * amplitude_v).sum();
    if squares > 0.0 {
        let slope_v = added.iter().map(|(amplitude_v, extra_v2)| amplitude_v * extra_v2).sum::<f64>() / squares;
        findings.push(Finding::info("noise_slope", slope_v, "V", added.len()));
    }
    let widths: Vec<f64> = runs.iter().filter_map(|run| run.row.width_ps).collect();
    if !widths.is_empty() {
        let width_ps = widths.iter().sum::<f64>() / widths.len() as f64;
        findings.push(Finding::info("width", width_ps, "ps", widths.len()));
    }
    let largest = runs.iter().max_by(|a, b| a.amplitude_v.abs().total_cmp(&b.amplitude_v.abs()));
    if let Some(run) = largest.filter(|run| run.row.noise_v > 0.0) {
        let noise_v = run.row.noise_v / f64::from(run.row.shots).sqrt();
        let range_db = 20.0 * (run.amplitude_v.abs() / noise_v).log10();
        findings.push(Finding::info("dynamic_range_db", range_db, "dB", 1));
    }
    findings
}
