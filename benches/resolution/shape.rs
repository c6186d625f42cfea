//! Responses by formula: sums of exponentially modified Gaussians, with their derivatives.
//!
//! Everything that the study draws is made of them: both sensors, light spread by a patch, and other sensors than the
//! estimator assumes (too wide, with an echo, with a tail). The estimator sees them only as fine-gridded values
//! ([`Shape::response`]).

use std::f64::consts::{PI, SQRT_2, TAU};

use periscope::signal::response::Response;

/// Step of the grid that the estimator is given, ps.
const GRID_PS: f64 = 2.5;
/// The grid reaches this many standard deviations and decay times.
const REACH_SD: f64 = 6.2;
const REACH_TAU: f64 = 12.0;

/// A Gaussian, convolved with an exponential decay if `tau_ps` is not 0.
#[derive(Clone, Copy, Debug)]
#[expect(clippy::struct_field_names, reason = "units stand in names")]
struct Part {
    after_ps: f64,
    sd_ps: f64,
    tau_ps: f64,
    area_ps: f64,
}

/// What an infinitely short pulse leaves in a record; time 0 is its arrival.
#[derive(Clone, Debug)]
pub struct Shape {
    parts: Vec<Part>,
}

/// A response and what the estimator knows of it.
#[derive(Clone, Debug)]
pub struct Sensor {
    /// Its name in the tables.
    pub name: &'static str,
    /// The truth.
    pub shape: Shape,
    /// The truth on a fine grid.
    pub response: Response,
}

impl Sensor {
    /// Gaussian, full width at half maximum 250 ps.
    pub fn gaussian() -> Self {
        let sd_ps = 250.0 / (8.0 * 2_f64.ln()).sqrt();
        Self::new("G250", Part { after_ps: 0.0, sd_ps, tau_ps: 0.0, area_ps: 1.0 })
    }

    /// Gaussian of sd 33 ps, convolved with a decay of 112 ps: a fast diode.
    pub fn exponential() -> Self {
        Self::new("E", Part { after_ps: 0.0, sd_ps: 33.0, tau_ps: 112.0, area_ps: 1.0 })
    }

    /// Both.
    pub fn both() -> [Self; 2] {
        [Self::gaussian(), Self::exponential()]
    }

    fn new(name: &'static str, part: Part) -> Self {
        // The maximum by bisection of the slope.
        let (mut before, mut behind) = (-part.sd_ps, 3.0 * part.sd_ps + part.tau_ps);
        for _ in 0..80 {
            let middle = 0.5 * (before + behind);
            *(if part.density(middle)[1] > 0.0 { &mut before } else { &mut behind }) = middle;
        }
        let shape = Shape { parts: vec![Part { area_ps: 1.0 / part.density(before)[0], ..part }] };
        Self { name, response: shape.response(), shape }
    }
}

impl Shape {
    /// Value, slope and curvature `time_ps` after the arrival.
    pub fn at(&self, time_ps: f64) -> [f64; 3] {
        self.parts.iter().fold([0.0; 3], |sum, part| {
            let density = part.density(time_ps - part.after_ps);
            [0, 1, 2].map(|i| sum[i] + part.area_ps * density[i])
        })
    }

    /// Its integral, ps.
    pub fn area_ps(&self) -> f64 {
        self.parts.iter().map(|part| part.area_ps).sum()
    }

    /// Its values on a fine grid.
    pub fn response(&self) -> Response {
        let reach = |part: &Part| REACH_SD * part.sd_ps;
        let first_ps = self.parts.iter().map(|p| p.after_ps - reach(p)).fold(f64::INFINITY, f64::min);
        let last_ps = self.parts.iter().map(|p| p.after_ps + reach(p) + REACH_TAU * p.tau_ps).fold(0.0, f64::max);
        let count = ((last_ps - first_ps) / GRID_PS) as i32;
        let values: Vec<f64> = (0..=count).map(|i| self.at(first_ps + f64::from(i) * GRID_PS)[0]).collect();
        Response::new(first_ps, GRID_PS, &values)
    }

    /// `factor` times as wide, as high as before.
    pub fn stretched(&self, factor: f64) -> Self {
        self.each(|p| Part {
            after_ps: factor * p.after_ps,
            sd_ps: factor * p.sd_ps,
            tau_ps: factor * p.tau_ps,
            area_ps: factor * p.area_ps,
        })
    }

    /// Of light that is spread by a Gaussian of the given sd.
    pub fn widened(&self, sd_ps: f64) -> Self {
        self.each(|p| Part { sd_ps: p.sd_ps.hypot(sd_ps), ..p })
    }

    /// With `share` of itself once more, `after_ps` later.
    pub fn with_echo(&self, after_ps: f64, share: f64) -> Self {
        let echo = self.each(|p| Part { after_ps: p.after_ps + after_ps, area_ps: share * p.area_ps, ..p });
        Self { parts: [self.parts.clone(), echo.parts].concat() }
    }

    /// With `height` of an exponential decay of `tau_ps` behind it, smeared as the response is.
    pub fn with_tail(&self, tau_ps: f64, height: f64) -> Self {
        let total_ps = self.area_ps();
        let tail = self.parts.iter().flat_map(|p| {
            // Two decays in turn are a difference of decays.
            let area_ps = height * tau_ps * p.area_ps / total_ps / (tau_ps - p.tau_ps);
            let slow = Part { tau_ps, area_ps: area_ps * tau_ps, ..*p };
            let fast = Part { area_ps: -area_ps * p.tau_ps, ..*p };
            [slow, fast]
        });
        Self { parts: self.parts.iter().copied().chain(tail).collect() }
    }

    fn each(&self, change: impl Fn(Part) -> Part) -> Self {
        Self { parts: self.parts.iter().map(|part| change(*part)).collect() }
    }
}

impl Part {
    /// Value, slope and curvature of the density of area 1.
    fn density(&self, time_ps: f64) -> [f64; 3] {
        let x = time_ps / self.sd_ps;
        if x < -9.0 {
            return [0.0; 3];
        }
        let normal = (-0.5 * x * x).exp() / (self.sd_ps * TAU.sqrt());
        let normal_slope = -x / self.sd_ps * normal;
        if self.tau_ps == 0.0 {
            return [normal, normal_slope, (x * x - 1.0) / (self.sd_ps * self.sd_ps) * normal];
        }
        let ratio = self.sd_ps / self.tau_ps;
        let decay = (0.5 * ratio * ratio - time_ps / self.tau_ps).exp() / self.tau_ps;
        let value = 0.5 * decay * erfc((ratio - x) / SQRT_2);
        // tau f' = N - f, of the convolution with a decay.
        let slope = (normal - value) / self.tau_ps;
        [value, slope, (normal_slope - slope) / self.tau_ps]
    }
}

/// Complementary error function: series of positive terms below 2, continued fraction above (Abramowitz and Stegun,
/// 7.1.6 and 7.1.14).
pub fn erfc(x: f64) -> f64 {
    if x < 0.0 {
        return 2.0 - erfc(-x);
    }
    if x < 2.0 {
        let (mut term, mut sum, mut n) = (x, x, 0.0);
        while term > 1e-17 * sum {
            n += 1.0;
            term *= 2.0 * x * x / (2.0 * n + 1.0);
            sum += term;
        }
        return 1.0 - 2.0 / PI.sqrt() * (-x * x).exp() * sum;
    }
    let fraction = (1..=60).rev().fold(x, |below, n| x + 0.5 * f64::from(n) / below);
    (-x * x).exp() / (PI.sqrt() * fraction)
}
