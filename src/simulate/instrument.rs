//! The instrument: impulse response, trigger, noise and converter.

use std::f64::consts::LN_2;

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

use super::scene::{Instrument, Shape};
use super::transport::Light;

/// A pulse shape, maximum 1 at time 0, on a fine grid.
#[derive(Clone, Debug)]
pub struct Pulse {
    start_ps: f64,
    values: Vec<f64>,
}

impl Pulse {
    /// Step of the grid.
    pub const STEP_PS: f64 = 1.0;

    /// By its definition; the Gaussian with a decay by quadrature.
    pub fn of(shape: &Shape) -> Self {
        let gauss = |t: f64, sigma: f64| (-0.5 * (t / sigma).powi(2)).exp();
        match *shape {
            Shape::Gaussian { fwhm_ps } => {
                let sigma = fwhm_ps / (8.0 * LN_2).sqrt();
                let reach = (7.0 * sigma).ceil() as i32;
                Self {
                    start_ps: -f64::from(reach),
                    values: (-reach..=reach).map(|t| gauss(f64::from(t), sigma)).collect(),
                }
            }
            Shape::Emg { sigma_ps, tau_ps } => {
                let (before, after) = ((7.0 * sigma_ps).ceil() as i32, (7.0 * sigma_ps + 25.0 * tau_ps).ceil() as i32);
                let step = (sigma_ps / 20.0).min(tau_ps / 20.0);
                let count = ((7.0 * sigma_ps + 25.0 * tau_ps) / step) as usize;
                let decayed = |t: f64| {
                    (0..count)
                        .map(|k| k as f64 * step)
                        .map(|s| (-s / tau_ps).exp() * gauss(t - s, sigma_ps))
                        .sum::<f64>()
                        - 0.5 * gauss(t, sigma_ps)
                };
                // Time 0 shall be the maximum: a parabola through the highest three values of a fine scan says where it lies.
                let scan: Vec<f64> = (-before..=2 * before).map(|t| decayed(f64::from(t))).collect();
                let top =
                    (1..scan.len() - 1).max_by(|&a, &b| scan[a].total_cmp(&scan[b])).expect("a scan of many values");
                let (left, peak, right) = (scan[top - 1], scan[top], scan[top + 1]);
                let maximum_ps = top as f64 - f64::from(before) + 0.5 * (left - right) / (left - 2.0 * peak + right);
                let height = decayed(maximum_ps);
                let values = (-2 * before..=after).map(|t| decayed(f64::from(t) + maximum_ps) / height).collect();
                Self { start_ps: -2.0 * f64::from(before), values }
            }
        }
    }

    /// Time of the first value.
    pub fn start_ps(&self) -> f64 {
        self.start_ps
    }

    /// The values.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Full width at half maximum, by linear interpolation.
    pub fn width_ps(&self) -> f64 {
        let above = |v: &f64| *v >= 0.5;
        let (first, last) = (self.values.iter().position(above), self.values.iter().rposition(above));
        let (first, last) = (first.expect("the maximum is 1"), last.expect("the maximum is 1"));
        // How far beyond the outermost values above one half the crossings lie.
        let beyond =
            |inside: usize, outside: usize| (self.values[inside] - 0.5) / (self.values[inside] - self.values[outside]);
        (last - first) as f64 * Self::STEP_PS + (beyond(first, first - 1) + beyond(last, last + 1)) * Self::STEP_PS
    }

    /// Value at a time, by a cubic through four neighbours.
    pub fn value(&self, time_ps: f64) -> f64 {
        cubic(&self.values, (time_ps - self.start_ps) / Self::STEP_PS)
    }
}

/// Lagrange's cubic through the four values around a place; zero outside.
fn cubic(values: &[f64], place: f64) -> f64 {
    let whole = place.floor();
    if !(whole >= 1.0 && whole + 2.0 < values.len() as f64) {
        return 0.0;
    }
    let (i, u) = (whole as usize, place - whole);
    let [a, b, c, d] = [values[i - 1], values[i], values[i + 1], values[i + 2]];
    let (before, after, beyond) = (u + 1.0, u - 1.0, u - 2.0);
    -u * after * beyond / 6.0 * a + before * after * beyond / 2.0 * b - before * u * beyond / 2.0 * c
        + before * u * after / 6.0 * d
}

/// Shots of one capture: for each the time of its trigger since the first, the time of sample 0 as the instrument records it, and codes.
pub struct Shots {
    /// Signal channel.
    pub signal: Vec<(f64, f64, Vec<i16>)>,
    /// Reference channel.
    pub reference: Option<Vec<(f64, f64, Vec<i16>)>>,
}

/// Time between laser pulses that are recorded.
const CYCLE_S: f64 = 1e-3;

/// What turns light into codes.
pub struct Digitizer<'a> {
    instrument: &'a Instrument,
    bad_shots: f64,
    pulse: &'a Pulse,
    reference: Option<(Pulse, f64)>,
}

impl<'a> Digitizer<'a> {
    /// Of a scene's instrument.
    pub fn new(instrument: &'a Instrument, bad_shots: f64, pulse: &'a Pulse) -> Self {
        let height_v = Instrument::HEIGHT * instrument.full_scale_v;
        let reference = instrument
            .reference
            .map(|reference| (Pulse::of(&Shape::Gaussian { fwhm_ps: reference.fwhm_ps }), height_v / reference.snr));
        Self { instrument, bad_shots, pulse, reference }
    }

    /// Signal without noise on a grid of 1 ps from its first to its last light.
    fn clean(&self, light: &Light, latency_ps: f64) -> Pulse {
        let (first, last) = light.0.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), (time_ps, _)| {
            (low.min(*time_ps), high.max(*time_ps))
        });
        // Arrivals are first gathered on the fine grid, each shared by its two neighbours so that its time is kept.
        let origin = (first + latency_ps).floor();
        let mut bins = vec![0.0; (last + latency_ps - origin) as usize + 2];
        let scale = self.instrument.height_v(light.total()) / light.total();
        for (time_ps, strength) in &light.0 {
            let place = time_ps + latency_ps - origin;
            let share = place.fract();
            bins[place as usize] += (1.0 - share) * strength * scale;
            bins[place as usize + 1] += share * strength * scale;
        }
        let mut values = vec![0.0; bins.len() + self.pulse.values.len()];
        for (at, weight) in bins.iter().enumerate().filter(|(_, weight)| **weight != 0.0) {
            values[at..].iter_mut().zip(&self.pulse.values).for_each(|(value, pulse)| *value += weight * pulse);
        }
        Pulse { start_ps: origin + self.pulse.start_ps, values }
    }

    /// Shots of a capture.
    pub fn shots(&self, light: &Light, latency_ps: f64, count: usize, rng: &mut impl RngExt) -> Shots {
        let instrument = self.instrument;
        let clean = self.clean(light, latency_ps);
        let mut shots = Shots {
            signal: Vec::with_capacity(count),
            reference: self.reference.as_ref().map(|_| Vec::with_capacity(count)),
        };
        for shot in 0..count {
            let trigger_s = shot as f64 * CYCLE_S;
            // Where the sample clock stands at the trigger: the instrument knows. How late the trigger itself came: nobody does.
            let t0_ps = instrument.t0_ps + instrument.dt_ps * rng.random_range(0.0..1.0);
            let jitter: f64 = StandardNormal.sample(rng);
            let late_ps = instrument.jitter_ps * jitter;
            let strength =
                if rng.random_bool(self.bad_shots) { if rng.random_bool(0.5) { 0.0 } else { 4.0 } } else { 1.0 };
            let codes = self.record(&clean, strength, t0_ps - late_ps, instrument.sample_noise_v(), rng);
            shots.signal.push((trigger_s, t0_ps * 1e-12, codes));
            if let (Some(records), Some((pulse, noise_v))) = (&mut shots.reference, &self.reference) {
                let codes =
                    self.record(pulse, Instrument::HEIGHT * instrument.full_scale_v, t0_ps - late_ps, *noise_v, rng);
                records.push((trigger_s, t0_ps * 1e-12, codes));
            }
        }
        shots
    }

    fn record(&self, clean: &Pulse, strength: f64, t0_ps: f64, noise_v: f64, rng: &mut impl RngExt) -> Vec<i16> {
        let instrument = self.instrument;
        let (gain_v, offset_v) = (instrument.gain_v(), instrument.offset_v());
        let half = f64::from(1_u32 << (instrument.bits - 1));
        // A converter of 9 to 16 bits fills the upper bits of a word.
        let step = if instrument.bits == 8 { 1.0 } else { f64::from(1_u32 << (16 - instrument.bits)) };
        let sample = |n: usize| {
            let noise: f64 = StandardNormal.sample(rng);
            let volts = strength * clean.value(t0_ps + n as f64 * instrument.dt_ps) + noise_v * noise;
            (((volts - offset_v) / gain_v).round().clamp(-half, half - 1.0) * step) as i16
        };
        (0..instrument.samples).map(sample).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pulse_has_its_maximum_at_zero_and_the_width_of_its_definition() {
        let gaussian = Pulse::of(&Shape::Gaussian { fwhm_ps: 250.0 });
        assert!((gaussian.width_ps() - 250.0).abs() < 0.01, "{}", gaussian.width_ps());
        let emg = Pulse::of(&Shape::Emg { sigma_ps: 33.0, tau_ps: 112.0 });
        assert!(
            (emg.value(0.0) - 1.0).abs() < 1e-9 && emg.value(-0.5) < emg.value(0.0) && emg.value(0.5) < emg.value(0.0)
        );
        // Mean of a Gaussian with a decay: that of the Gaussian plus the time constant; its variance sigma^2 + tau^2.
        let times = || (0..emg.values.len()).map(|i| emg.start_ps + i as f64).zip(&emg.values);
        let area: f64 = emg.values.iter().sum();
        let mean = times().map(|(t, v)| t * v).sum::<f64>() / area;
        let variance = times().map(|(t, v)| (t - mean).powi(2) * v).sum::<f64>() / area;
        assert!((variance.sqrt() - (33.0_f64.powi(2) + 112.0 * 112.0).sqrt()).abs() < 0.1, "{}", variance.sqrt());
    }

    #[test]
    fn the_cubic_is_exact_for_cubics() {
        let values: Vec<f64> = (0..8).map(f64::from).map(|x| x * x * x - 2.0 * x + 1.0).collect();
        for place in [1.0, 2.25, 3.9, 4.5] {
            assert!((cubic(&values, place) - (place * place * place - 2.0 * place + 1.0)).abs() < 1e-12);
        }
    }
}
