//! What the scatter of the shots' times does to the shape of their mean.
//!
//! Shots of a trigger that jitters by `j` are the pulse earlier or later. Infinitely many leave the response widened by
//! `j`, h; the mean of N is `sum_m (-j)^m / m! mean(He_m) h^(m)`: Hermite's polynomials of the times over j are
//! uncorrelated, and the mean of `He_m` has the variance `m! / N`. The first term is h, the next a time that all pulses
//! share (`jitter_ps` of a profile). From the second on the mean is a little wider or narrower than h, and more or less
//! askew, all its pulses alike: derivatives of the pulses, whose amplitudes have the variances `j^2m / (m! N)`. At high
//! signal-to-noise ratios they exceed the noise, and would pass for pulses. They are explained as what lies under the
//! pulses is ([`super::nuisance`]).
//!
//! Not modelled: times that scatter otherwise than normally.

use super::column::Column;
use super::greedy::Fitter;
use super::nuisance::Direction;
use super::place::Place;
use super::state::State;

/// Scatter of the times of shots about their mean's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jitter {
    /// Standard deviation of a shot's time, ps.
    pub sd_ps: f64,
    /// Shots in the mean.
    pub shots: f64,
}

/// Derivatives of the pulses by time: order, and weights of pulses that come so many steps later, over the step to the
/// power of the order.
const DERIVATIVES: [(i32, [f64; 5]); 3] =
    [(2, [0.0, 1.0, -2.0, 1.0, 0.0]), (3, [-0.5, 1.0, 0.0, -1.0, 0.5]), (4, [1.0, -4.0, 6.0, -4.0, 1.0])];
/// The step, over the response's width.
const STEP_WIDTHS: f64 = 0.05;
/// Chi2 that a derivative adds on average, from which it counts.
const SHOWS: f64 = 0.05;

/// Directions along which the scatter of each record's shots moves the pulses of a fit, where they show.
pub(super) fn directions(fitter: &Fitter, state: &State, jitters: &[Option<Jitter>]) -> Vec<Vec<Direction>> {
    let of_record = |(r, jitter): (usize, &Option<Jitter>)| {
        let Some(jitter) = jitter else { return Vec::new() };
        let all = DERIVATIVES.iter().map(|(order, weights)| {
            let factorial: i32 = (1..=*order).product();
            let variance = jitter.sd_ps.powi(2 * order) / (f64::from(factorial) * jitter.shots);
            (derivative(fitter, state, r, *order, weights), variance)
        });
        all.filter(|(direction, variance)| variance * direction.iter().map(|d| d * d).sum::<f64>() > SHOWS).collect()
    };
    jitters.iter().enumerate().map(of_record).collect()
}

/// The derivative of all pulses by their time.
fn derivative(fitter: &Fitter, state: &State, r: usize, order: i32, weights: &[f64; 5]) -> Vec<f64> {
    let (record, group) = (&fitter.model.records[r], fitter.group_of(r));
    let step_ps = STEP_WIDTHS * record.width_ps;
    let of_pulse = |k: usize| {
        let (place, amplitude) = (state.place(k), state.amplitude_of(group, k));
        weights.iter().enumerate().filter(|(_, weight)| **weight != 0.0).map(move |(n, weight)| {
            let later = Place { time_ps: place.time_ps + (n as f64 - 2.0) * step_ps, ..place };
            (amplitude * weight / step_ps.powi(order), Column::new(record, &later))
        })
    };
    Column::sum((0..state.pulses()).flat_map(of_pulse), record.len()).values()
}
