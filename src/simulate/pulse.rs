//! The impulse response, as the instrument gives it.

use std::f64::consts::LN_2;

use super::keys::{Flaws, Shape};

/// A pulse shape on a fine grid, maximum 1 at time 0; or any signal on that grid.
#[derive(Clone, Debug)]
pub struct Pulse {
    start_ps: f64,
    values: Vec<f64>,
}

impl Pulse {
    /// Step of the grid.
    pub const STEP_PS: f64 = 1.0;

    /// A signal that begins at `start_ps`.
    pub fn new(start_ps: f64, values: Vec<f64>) -> Self {
        Self { start_ps, values }
    }

    /// A shape from its definition. The convolution of Gaussian and decay uses quadrature.
    pub fn of(shape: &Shape) -> Self {
        let gauss = |t: f64, sigma: f64| (-0.5 * (t / sigma).powi(2)).exp();
        match *shape {
            Shape::Gaussian { fwhm_ps } => {
                let sigma = fwhm_ps / (8.0 * LN_2).sqrt();
                let reach = (7.0 * sigma).ceil() as i32;
                Self::new(-f64::from(reach), (-reach..=reach).map(|t| gauss(f64::from(t), sigma)).collect())
            }
            Shape::Emg { sigma_ps, tau_ps } => {
                let (before, after) = ((7.0 * sigma_ps).ceil() as i32, (7.0 * sigma_ps + 25.0 * tau_ps).ceil() as i32);
                let step = (sigma_ps / 20.0).min(tau_ps / 20.0);
                let count = ((7.0 * sigma_ps + 25.0 * tau_ps) / step) as usize;
                let decayed = |t: f64| {
                    let sum: f64 =
                        (0..count).map(|k| k as f64 * step).map(|s| (-s / tau_ps).exp() * gauss(t - s, sigma_ps)).sum();
                    sum - 0.5 * gauss(t, sigma_ps)
                };
                Self::new(-f64::from(before), (-before..=after).map(|t| decayed(f64::from(t))).collect()).settled()
            }
        }
    }

    /// The shape with the instrument's echo and tail.
    #[must_use]
    pub fn with(&self, flaws: &Flaws) -> Self {
        let mut shape = self.clone();
        if let Some(tail) = flaws.tail {
            let (mut state, keep) = (0.0, (-Self::STEP_PS / tail.tau_ps).exp());
            let more = (20.0 * tail.tau_ps) as usize;
            let slow: Vec<f64> = self
                .values
                .iter()
                .copied()
                .chain(std::iter::repeat_n(0.0, more))
                .map(|value| {
                    state = state * keep + value;
                    state
                })
                .collect();
            let top = slow.iter().copied().fold(0.0, f64::max);
            shape.values.resize(slow.len(), 0.0);
            shape.values.iter_mut().zip(&slow).for_each(|(value, slow)| *value += tail.ratio * slow / top);
        }
        if let Some(echo) = flaws.echo {
            let end_ps = shape.start_ps + shape.values.len() as f64 + echo.delay_ps;
            let values = (0..(end_ps - shape.start_ps) as usize).map(|i| {
                let t = shape.start_ps + i as f64;
                shape.value(t) + echo.ratio * shape.value(t - echo.delay_ps)
            });
            shape.values = values.collect();
        }
        shape.settled()
    }

    /// Scales to height 1 and moves the maximum to time 0, by a parabola through the highest three values.
    fn settled(mut self) -> Self {
        let top = (1..self.values.len() - 1)
            .max_by(|&a, &b| self.values[a].total_cmp(&self.values[b]))
            .expect("a shape has many values");
        let (left, peak, right) = (self.values[top - 1], self.values[top], self.values[top + 1]);
        let beside = 0.5 * (left - right) / (left - 2.0 * peak + right);
        let height = peak - 0.25 * (left - right) * beside;
        self.values.iter_mut().for_each(|value| *value /= height);
        self.start_ps = -(top as f64 + beside);
        self
    }

    /// The shape, wider by `factor`, with its maximum in place.
    #[must_use]
    pub fn stretched(&self, factor: f64) -> Self {
        let start_ps = (self.start_ps * factor).floor();
        let count = (self.values.len() as f64 * factor).ceil() as usize + 2;
        let value = |i: usize| self.value((start_ps + i as f64 * Self::STEP_PS) / factor);
        Self::new(start_ps, (0..count).map(value).collect())
    }

    /// The square of the shape.
    #[must_use]
    pub fn squared(&self) -> Self {
        Self::new(self.start_ps, self.values.iter().map(|value| value * value).collect())
    }

    /// Time of the first value.
    pub fn start_ps(&self) -> f64 {
        self.start_ps
    }

    /// Time of the last value.
    pub fn end_ps(&self) -> f64 {
        self.start_ps + (self.values.len() as f64 - 1.0) * Self::STEP_PS
    }

    /// The values.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Largest value.
    pub fn height(&self) -> f64 {
        self.values.iter().copied().fold(0.0, f64::max)
    }

    /// Integral over time.
    pub fn area_ps(&self) -> f64 {
        self.values.iter().sum::<f64>() * Self::STEP_PS
    }

    /// Integral of the square over time.
    pub fn energy_ps(&self) -> f64 {
        self.values.iter().map(|value| value * value).sum::<f64>() * Self::STEP_PS
    }

    /// Full width at half maximum, by linear interpolation.
    pub fn width_ps(&self) -> f64 {
        let above = |v: &f64| *v >= 0.5;
        let first = self.values.iter().position(above).expect("the maximum is 1");
        let last = first + self.values[first..].iter().position(|v| !above(v)).expect("a pulse ends") - 1;
        // Distances of the crossings from the outermost values above one half.
        let beyond =
            |inside: usize, outside: usize| (self.values[inside] - 0.5) / (self.values[inside] - self.values[outside]);
        (last - first) as f64 * Self::STEP_PS + (beyond(first, first - 1) + beyond(last, last + 1)) * Self::STEP_PS
    }

    /// Value at a time, by cubic interpolation; zero outside.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::keys::{Echo, Tail};

    #[test]
    fn a_pulse_has_its_maximum_at_zero_and_the_width_of_its_definition() {
        let gaussian = Pulse::of(&Shape::Gaussian { fwhm_ps: 250.0 });
        assert!((gaussian.width_ps() - 250.0).abs() < 0.01, "{}", gaussian.width_ps());
        let emg = Pulse::of(&Shape::Emg { sigma_ps: 33.0, tau_ps: 112.0 });
        assert!((emg.value(0.0) - 1.0).abs() < 1e-6);
        assert!(emg.value(-0.5) < emg.value(0.0) && emg.value(0.5) < emg.value(0.0));
        // Moments of a Gaussian with decay: mean of the Gaussian plus the time constant; variance sigma^2 + tau^2.
        let times = || (0..emg.values.len()).map(|i| emg.start_ps + i as f64).zip(&emg.values);
        let area: f64 = emg.values.iter().sum();
        let mean = times().map(|(t, v)| t * v).sum::<f64>() / area;
        let variance = times().map(|(t, v)| (t - mean).powi(2) * v).sum::<f64>() / area;
        assert!((variance.sqrt() - (33.0_f64.powi(2) + 112.0 * 112.0).sqrt()).abs() < 0.1, "{}", variance.sqrt());
    }

    #[test]
    fn an_echo_and_a_tail_stand_where_they_are_put() {
        let shape = Pulse::of(&Shape::Gaussian { fwhm_ps: 250.0 });
        let echo = Flaws { echo: Some(Echo { ratio: 0.01, delay_ps: 3000.0 }), ..Flaws::default() };
        assert!((shape.with(&echo).value(3000.0) - 0.01).abs() < 1e-6);
        let tail = Flaws { tail: Some(Tail { ratio: 0.02, tau_ps: 2000.0 }), ..Flaws::default() };
        let slow = shape.with(&tail);
        assert!((slow.value(4000.0) / slow.value(2000.0) - (-1.0_f64).exp()).abs() < 1e-3);
        assert!(slow.value(800.0) > 0.01 && slow.value(800.0) < 0.02);
    }

    #[test]
    fn the_cubic_is_exact_for_cubics() {
        let values: Vec<f64> = (0..8).map(f64::from).map(|x| x * x * x - 2.0 * x + 1.0).collect();
        for place in [1.0, 2.25, 3.9, 4.5] {
            assert!((cubic(&values, place) - (place * place * place - 2.0 * place + 1.0)).abs() < 1e-12);
        }
    }
}
