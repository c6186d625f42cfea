//! The information in one mean profile about its pulses, from a response and noise that are given as numbers.
//!
//! [`super::profile`] asks the simulator for both; here a caller has them, from measurements or on paper.

use nalgebra::{DMatrix, DVector};

use super::banded::Banded;
use super::profile::inverse;

/// Value and slope (per ps) of a response at a time after the arrival of its pulse.
pub type Shape<'a> = dyn Fn(f64) -> (f64, f64) + 'a;

/// The samples of a profile and their noise.
#[derive(Clone, Copy, Debug)]
pub struct Samples<'a> {
    /// Time of sample 0.
    pub t0_ps: f64,
    /// Time between samples.
    pub dt_ps: f64,
    /// Standard deviation of each sample of the mean; infinite for a sample without information.
    pub sd: &'a [f64],
    /// Autocorrelation of the noise from lag 0 on; empty for white noise.
    pub acf: &'a [f64],
}

/// What else is unknown under the pulses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Under {
    /// Nothing.
    Nothing,
    /// A constant.
    Constant,
    /// A straight line.
    Line,
}

/// The bound of all pulses together.
#[derive(Clone, Debug, PartialEq)]
pub struct PulsesBound {
    /// Covariance of the times, ps^2.
    pub covariance_ps2: DMatrix<f64>,
    /// Standard deviations of the amplitudes.
    pub amplitude_sd: Vec<f64>,
}

/// Why there is no bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoBound {
    /// The autocorrelation belongs to no noise.
    #[error("the autocorrelation is not that of any noise (not positive definite)")]
    Autocorrelation,
    /// The samples do not determine all unknowns.
    #[error("the samples do not determine the times: pulses coincide, lie outside of the record, or have no amplitude")]
    Undetermined,
}

/// The Cramer-Rao bound of times and amplitudes of pulses, with all of them and what is under them unknown.
///
/// A pulse is a time in ps and an amplitude, the factor of the response.
///
/// # Errors
/// When the autocorrelation is none, or an unknown is not determined.
pub fn pulses_bound(
    samples: &Samples<'_>,
    shape: &Shape<'_>,
    pulses: &[(f64, f64)],
    under: Under,
) -> Result<PulsesBound, NoBound> {
    let (count, length) = (pulses.len(), samples.sd.len());
    let acf = if samples.acf.is_empty() { &[1.0][..] } else { samples.acf };
    let noise = Banded::factored(acf, &vec![0.0; length]).ok_or(NoBound::Autocorrelation)?;
    let middle = 0.5 * (length as f64 - 1.0);
    let time_ps = |n: usize| samples.t0_ps + n as f64 * samples.dt_ps;
    let times = pulses.iter().map(|&(at_ps, amplitude)| column(length, |n| -amplitude * shape(time_ps(n) - at_ps).1));
    let amplitudes = pulses.iter().map(|&(at_ps, _)| column(length, |n| shape(time_ps(n) - at_ps).0));
    let mut columns: Vec<Vec<f64>> = times.chain(amplitudes).collect();
    if under != Under::Nothing {
        columns.push(vec![1.0; length]);
    }
    if under == Under::Line {
        columns.push(column(length, |n| n as f64 - middle));
    }
    let mut matrix = DMatrix::zeros(length, columns.len());
    for (c, mut values) in columns.into_iter().enumerate() {
        values.iter_mut().zip(samples.sd).for_each(|(value, sd)| *value /= sd);
        noise.whiten(&mut values);
        matrix.set_column(c, &DVector::from_vec(values));
    }
    let covariance = inverse(&matrix.tr_mul(&matrix)).ok_or(NoBound::Undetermined)?;
    Ok(PulsesBound {
        covariance_ps2: covariance.view((0, 0), (count, count)).into_owned(),
        amplitude_sd: (count..2 * count).map(|i| covariance[(i, i)].sqrt()).collect(),
    })
}

fn column(length: usize, value: impl Fn(usize) -> f64) -> Vec<f64> {
    (0..length).map(value).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIGMA_PS: f64 = 100.0;
    const DT_PS: f64 = 10.0;

    /// A bell whose value and slope are exact.
    fn bell(time_ps: f64) -> (f64, f64) {
        let value = (-0.5 * (time_ps / SIGMA_PS).powi(2)).exp();
        (value, -time_ps / (SIGMA_PS * SIGMA_PS) * value)
    }

    fn bound(sd: &[f64], acf: &[f64], pulses: &[(f64, f64)], under: Under) -> Result<PulsesBound, NoBound> {
        pulses_bound(&Samples { t0_ps: 0.0, dt_ps: DT_PS, sd, acf }, &bell, pulses, under)
    }

    /// The sum over samples of a squared slope is its integral over their step: sqrt(pi) / (2 sigma dt).
    #[test]
    fn one_pulse_in_white_noise_has_the_closed_form() {
        let (sd, amplitude) = (0.01, 0.3);
        let one = bound(&[sd; 400], &[], &[(2003.0, amplitude)], Under::Nothing).unwrap();
        let information = std::f64::consts::PI.sqrt() / (2.0 * SIGMA_PS * DT_PS) * (amplitude / sd).powi(2);
        assert!((one.covariance_ps2[(0, 0)] * information - 1.0).abs() < 1e-9, "{one:?}");
        let height = sd / (std::f64::consts::PI.sqrt() * SIGMA_PS / DT_PS).sqrt();
        assert!((one.amplitude_sd[0] / height - 1.0).abs() < 1e-9, "{one:?}");
    }

    #[test]
    fn unknowns_neighbours_and_lost_samples_cost_precision() {
        let sd = [0.01; 400];
        let variance = |bound: Result<PulsesBound, NoBound>| bound.map(|bound| bound.covariance_ps2[(0, 0)]).unwrap();
        let pulse = (2003.0, 0.3);
        let alone = variance(bound(&sd, &[], &[pulse], Under::Nothing));
        let close = variance(bound(&sd, &[], &[pulse, (2103.0, 0.3)], Under::Nothing));
        let far = variance(bound(&sd, &[], &[pulse, (3500.0, 0.3)], Under::Line));
        assert!(close > 3.0 * alone && far < 1.01 * alone, "{alone} {close} {far}");
        // What lies behind the maximum is as much as what lies before it.
        let half: Vec<f64> = (0..400).map(|n| if n < 200 { 0.01 } else { f64::INFINITY }).collect();
        let lost = variance(bound(&half, &[], &[pulse], Under::Nothing));
        assert!(lost > 1.9 * alone, "{lost} {alone}");
    }

    #[test]
    fn what_is_not_determined_is_refused() {
        let sd = [0.01; 400];
        let twins = [(2000.0, 0.3), (2000.0, 0.3)];
        for pulses in [&twins[..], &[(9000.0, 0.3)], &[(2000.0, 0.0)]] {
            assert_eq!(bound(&sd, &[], pulses, Under::Constant), Err(NoBound::Undetermined));
        }
        assert_eq!(bound(&sd, &[1.0, 0.9, -0.9], &twins[..1], Under::Line), Err(NoBound::Autocorrelation));
    }
}
