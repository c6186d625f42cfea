//! Checks across a series: how the pulse changes with the light, with the path, and with time.

use super::Characterize;
use super::finding::{Finding, Test};
use super::series::{Run, TimeSeries};
use crate::signal::regression::{Regression, least_squares};
use crate::units;

/// `linearity`: relative compression at the largest amplitude, from `amplitude = k x (1 - q x / x_max)` with x the
/// light.
pub fn linearity(params: &Characterize, runs: &[Run<'_>]) -> Option<Finding> {
    let light: Vec<f64> = runs.iter().map(Run::light).collect();
    let most = light.iter().copied().fold(0.0, f64::max);
    let columns = [light.iter().map(|x| x / most).collect(), light.iter().map(|x| -(x / most).powi(2)).collect()];
    let fit = fit(&columns, runs, |run| (run.amplitude_v, run.amplitude_sd_v))?;
    let (k, q) = (fit.values[0], fit.values[1] / fit.values[0]);
    let c = &fit.covariance;
    let sd = (c[1][1] - 2.0 * q * c[0][1] + q * q * c[0][0]).sqrt() / k.abs();
    let cause = if q > 0.0 {
        format!(
            "saturation: the largest pulse is {:.1} % lower than in proportion to the light; attenuate, or open the vertical range, until this passes, and keep pulses below that",
            100.0 * q
        )
    } else {
        "the amplitude grows faster than the light: correct attenuation_od and power_w of the runs, or look for a second beam past the attenuator".to_owned()
    };
    let good = (0.0, params.linearity_tolerance.get());
    Some(Finding::tested("linearity", (q, sd), good, "", Test::Normal, runs.len()).because(cause))
}

/// `signal_dependent_delay`: how much later the largest pulse of the series comes than the smallest.
pub fn signal_dependent_delay(params: &Characterize, runs: &[Run<'_>]) -> Option<Finding> {
    let amplitudes = || runs.iter().map(|run| run.amplitude_v);
    let (least, most) = (amplitudes().fold(f64::INFINITY, f64::min), amplitudes().fold(f64::NEG_INFINITY, f64::max));
    let range = most - least;
    let columns = [vec![1.0; runs.len()], amplitudes().map(|amplitude| (amplitude - least) / range).collect()];
    let fit = fit(&columns, runs, |run| (run.time_ps, run.time_sd_ps))?;
    let cause = "walk: the time depends on the height of the pulse, through the amplifier's slew rate or the discriminator of the reference; capture with equal amplitudes, or lower them";
    let good = (0.0, params.delay_tolerance_ps.get());
    let estimate = (fit.values[1], fit.sd(1));
    Some(Finding::tested("signal_dependent_delay", estimate, good, "ps", Test::Normal, runs.len()).because(cause))
}

/// `inverse_square`: exponent of the amplitude against the length of the path.
pub fn inverse_square(params: &Characterize, runs: &[Run<'_>]) -> Option<Finding> {
    if runs.iter().any(|run| run.amplitude_v <= 0.0) {
        return None;
    }
    let columns = [vec![1.0; runs.len()], runs.iter().map(|run| path(run).0.ln()).collect()];
    let fit = fit(&columns, runs, |run| {
        let (path_m, path_sd_m) = path(run);
        (run.amplitude_v.ln(), (run.amplitude_sd_v / run.amplitude_v).hypot(2.0 * path_sd_m / path_m))
    })?;
    let cause = "the light does not fall off as from a diffuser: the patch overfills the sensor's view or the beam is not diffused (exponent nearer 0), or the near runs saturate; see `linearity`";
    let (estimate, good) = ((fit.values[1], fit.sd(1)), (-2.0, params.exponent_tolerance.get()));
    Some(Finding::tested("inverse_square", estimate, good, "", Test::Normal, runs.len()).because(cause))
}

/// `shift_per_path`: time against length of the path, over that of light; and `latency_ps`, what is left at length 0.
pub fn shift_per_path(params: &Characterize, runs: &[Run<'_>], group_index: f64) -> Option<[Finding; 2]> {
    let flight = |path_m: f64| units::time_ps(path_m, group_index);
    let columns = [vec![1.0; runs.len()], runs.iter().map(|run| flight(path(run).0)).collect()];
    let fit = fit(&columns, runs, |run| (run.time_ps, run.time_sd_ps.hypot(flight(path(run).1))))?;
    let cause = "time is not proportional to length: the oscilloscope's time base is off, or path_m, or group_index in campaign.toml; a distance is wrong by the same share";
    let (estimate, good) = ((fit.values[1], fit.sd(1)), (1.0, params.shift_tolerance.get()));
    let slope = Finding::tested("shift_per_path", estimate, good, "", Test::Normal, runs.len()).because(cause);
    let latency = Finding { sd: Some(fit.sd(0)), ..Finding::info("latency_ps", fit.values[0], "ps", runs.len()) };
    Some([slope, latency])
}

/// `delay_drift`, `delay_scatter`, `power_drift` and `width_drift` of runs of one setting.
pub fn drifts(params: &Characterize, series: &TimeSeries<'_>) -> Vec<Finding> {
    let (runs, count) = (&series.runs, series.runs.len());
    let mean = series.at.iter().sum::<f64>() / count as f64;
    let span = series.at.iter().copied().fold(f64::NEG_INFINITY, f64::max)
        - series.at.iter().copied().fold(f64::INFINITY, f64::min);
    let columns = [vec![1.0; count], series.at.iter().map(|at| at - mean).collect()];
    let mut findings = Vec::new();
    if let Some(fit) = fit(&columns, runs, |run| (run.time_ps, run.time_sd_ps)) {
        let (estimate, good) = ((fit.values[1], fit.sd(1)), (0.0, params.drift_tolerance_ps.get() / span));
        let unit = format!("ps/{}", series.unit);
        let cause = "cable, amplifier or trigger is warming up: wait until this passes, and interleave fiducials with the scene";
        findings.push(Finding::tested("delay_drift", estimate, good, &unit, Test::Normal, count).because(cause));
        let dof = fit.dof as f64;
        let estimate = (fit.chi2 / dof, (2.0 / dof).sqrt());
        let cause = "times jump by more than noise and alignment explain: a loose cable, or a trigger that moves between runs; captures cannot be compared to better than that";
        let test = Test::ChiSquare(fit.dof);
        findings.push(Finding::tested("delay_scatter", estimate, (1.0, 0.0), "", test, count).because(cause));
    }
    let level = runs.iter().map(|run| run.amplitude_v).sum::<f64>() / count as f64;
    // A laser fluctuates beyond what single runs know of themselves, so the scatter of the runs is their standard
    // deviation.
    if let Some(fit) = fit(&columns, runs, |run| (run.amplitude_v / level, 1.0)) {
        let sd = fit.sd(1) * (fit.chi2 / fit.dof as f64).sqrt();
        let (unit, good) = (format!("1/{}", series.unit), (0.0, params.power_tolerance.get() / span));
        let cause = "the laser's power or the beam's pointing drifts: let the laser warm up, and check the alignment";
        let test = Test::Student(fit.dof);
        findings.push(Finding::tested("power_drift", (fit.values[1], sd), good, &unit, test, count).because(cause));
    }
    let widths: Option<Vec<(f64, f64)>> =
        runs.iter().map(|run| run.row.width_ratio.zip(run.row.width_ratio_sd)).collect();
    if let Some(widths) = widths {
        let (values, sds): (Vec<f64>, Vec<f64>) = widths.into_iter().unzip();
        if let Some(fit) = least_squares(&columns, &values, &sds) {
            let (unit, good) = (format!("1/{}", series.unit), (0.0, params.width_tolerance.get() / span));
            let cause = "the response grows wider or narrower: bias of the photodiode, focus, or temperature; calibrate again, and more often";
            let estimate = (fit.values[1], fit.sd(1));
            findings.push(Finding::tested("width_drift", estimate, good, &unit, Test::Normal, count).because(cause));
        }
    }
    findings
}

/// Least squares over runs with their own standard deviations; at least one degree of freedom.
fn fit(columns: &[Vec<f64>], runs: &[Run<'_>], value: impl Fn(&Run<'_>) -> (f64, f64)) -> Option<Regression> {
    let (values, sds): (Vec<f64>, Vec<f64>) = runs.iter().map(value).unzip();
    least_squares(columns, &values, &sds).filter(|fit| fit.dof > 0)
}

/// Length of the path and its standard deviation.
fn path(run: &Run<'_>) -> (f64, f64) {
    (run.row.path_m.expect("runs of a path series have a path"), run.row.path_sd_m.unwrap_or(0.0))
}
