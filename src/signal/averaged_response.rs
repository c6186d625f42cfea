//! What averaging leaves of an impulse response: each phase of a sample is delayed onto the grid by a filter that ends
//! at half the sample rate.

use super::average::PHASES;
use super::resample;
use super::response::Response;

/// Fine steps in a sample of an averaged response.
const RESPONSE_STEPS: usize = 8;

/// What averaging leaves of an impulse response: `sum_p n_p / N sum_u w(u) h(t + u dt)`, over the phases p with their
/// shots `n_p` and the taps u of the filter that delays each phase.
///
/// One phase that lies on the grid leaves it as it is. Shots spread over all phases leave what lies below half the
/// sample rate: what a fast edge has above rings, in the mean as in this. The ends of it that are less than the share
/// `negligible` of its maximum are cut off.
///
/// # Panics
/// When there are not [`PHASES`] counts, no shots, or `dt_ps` is not positive.
#[must_use]
pub fn averaged_response(response: &Response, dt_ps: f64, phase_shots: &[i32], negligible: f64) -> Response {
    assert_eq!(phase_shots.len(), PHASES, "a count for each phase");
    let shots: f64 = phase_shots.iter().copied().map(f64::from).sum();
    assert!(shots > 0.0 && dt_ps > 0.0, "an average has shots and a step");
    if f64::from(phase_shots[0]) == shots {
        return response.clone();
    }
    // The response on the grid of phases, and room for the taps on either side.
    let step_ps = dt_ps / PHASES as f64;
    let (first_ps, last_ps) = response.support_ps();
    let (first, last) = ((first_ps / step_ps).floor() as i64, (last_ps / step_ps).ceil() as i64);
    let table: Vec<f64> = (first..=last).map(|n| response.value(n as f64 * step_ps)).collect();
    let reach = (resample::TAPS / 2 * PHASES) as i64;
    let coarse = PHASES / RESPONSE_STEPS;
    let start = (first - reach).div_euclid(coarse as i64) * coarse as i64;
    let mut values = vec![0.0; ((last + reach - start) as usize).div_ceil(coarse) + 1];
    for (phase, &count) in phase_shots.iter().enumerate().filter(|(_, count)| **count > 0) {
        let fraction = phase as f64 / PHASES as f64;
        for (k, tap) in resample::taps(fraction).into_iter().enumerate() {
            let ahead = (k as i64 - (resample::TAPS / 2) as i64) * PHASES as i64 + phase as i64;
            let weight = tap * f64::from(count) / shots;
            // Value i looks at the response at start + i * coarse + ahead.
            let skip = usize::try_from((first - start - ahead).max(0)).expect("not negative").div_ceil(coarse);
            for (i, value) in values.iter_mut().enumerate().skip(skip) {
                let at = start + (i * coarse) as i64 + ahead - first;
                match table.get(at as usize) {
                    Some(response) => *value += weight * response,
                    None => break,
                }
            }
        }
    }
    let most = values.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    let counts = |value: &f64| value.abs() > negligible * most;
    let (from, to) = (values.iter().position(counts).unwrap_or(0), values.iter().rposition(counts).unwrap_or(1));
    let (from, to) = (from.saturating_sub(1), (to + 2).min(values.len()));
    Response::new((start + (from * coarse) as i64) as f64 * step_ps, step_ps * coarse as f64, &values[from..to])
}
