//! Impulse response of a sensor: what one infinitely short pulse of light leaves in a record.
//!
//! A natural cubic spline through equally spaced, usually oversampled, values; exactly zero outside their support. The
//! spline gives value and slope at any time, as the fits of pulse times need. A slope by differences would cost
//! accuracy at high SNR. Time 0 of a response is the arrival of the pulse: a pulse that arrives at `t_k` adds `a_k h(t
//! - t_k)` to the record.
//!
//! Source: natural spline as in Press et al., *Numerical Recipes*, section 3.3 (tridiagonal system for the second
//! derivatives). Not modelled: dependence of the shape on amplitude (saturation), and echoes or tails beyond the
//! support.

use std::ops::Range;
use std::sync::OnceLock;

/// Impulse response: natural cubic spline through equally spaced values, zero outside its support.
#[derive(Clone, Debug)]
pub struct Response {
    t0_ps: f64,
    step_ps: f64,
    /// One cubic a knot interval, in powers of the position `u` in 0..=1 within it.
    pieces: Vec<[f64; 4]>,
    /// Sought once: fits of single shots ask for it each time.
    outline: OnceLock<Outline>,
}

/// What is sought over all pieces.
#[derive(Clone, Copy, Debug)]
struct Outline {
    is_step: bool,
    height: f64,
    peak_ps: f64,
    width_ps: f64,
}

impl Response {
    /// Spline through `values`, value `i` at `t0_ps + i * step_ps`; time 0 is the arrival of the pulse.
    ///
    /// # Panics
    /// With fewer than two values, a step that is not positive, or anything not finite.
    #[must_use]
    pub fn new(t0_ps: f64, step_ps: f64, values: &[f64]) -> Self {
        assert!(values.len() >= 2, "a response needs at least two values, got {}", values.len());
        assert!(
            t0_ps.is_finite() && step_ps.is_finite() && step_ps > 0.0,
            "a response needs a finite start and a positive step"
        );
        assert!(values.iter().all(|v| v.is_finite()), "a response needs finite values");
        let curvatures = natural_curvatures(values);
        let pieces = values
            .windows(2)
            .zip(curvatures.windows(2))
            .map(|(v, m)| [v[0], v[1] - v[0] - (2.0 * m[0] + m[1]) / 6.0, m[0] / 2.0, (m[1] - m[0]) / 6.0])
            .collect();
        Self::of(t0_ps, step_ps, pieces)
    }

    fn of(t0_ps: f64, step_ps: f64, pieces: Vec<[f64; 4]>) -> Self {
        Self { t0_ps, step_ps, pieces, outline: OnceLock::new() }
    }

    /// The same, `factor` times as wide about the arrival.
    ///
    /// # Panics
    /// If the factor is not positive or not finite.
    #[must_use]
    pub fn stretched(&self, factor: f64) -> Self {
        assert!(factor > 0.0 && factor.is_finite(), "a width has a positive factor");
        Self::of(factor * self.t0_ps, factor * self.step_ps, self.pieces.clone())
    }

    /// The same, `delay_ps` later after the arrival.
    ///
    /// # Panics
    /// If the delay is not finite.
    #[must_use]
    pub fn delayed(&self, delay_ps: f64) -> Self {
        assert!(delay_ps.is_finite(), "a delay is a number");
        Self::of(self.t0_ps + delay_ps, self.step_ps, self.pieces.clone())
    }

    /// Distance of its knots, ps.
    #[must_use]
    pub fn step_ps(&self) -> f64 {
        self.step_ps
    }

    /// Value at `time_ps` after the arrival of the pulse.
    #[must_use]
    pub fn value(&self, time_ps: f64) -> f64 {
        self.value_and_slope(time_ps).0
    }

    /// Value and slope (per ps) at `time_ps` after the arrival of the pulse.
    #[must_use]
    pub fn value_and_slope(&self, time_ps: f64) -> (f64, f64) {
        self.piece(time_ps).map_or((0.0, 0.0), |([c0, c1, c2, c3], u)| {
            (c0 + u * (c1 + u * (c2 + u * c3)), (c1 + u * (2.0 * c2 + u * 3.0 * c3)) / self.step_ps)
        })
    }

    /// Second derivative (per ps squared) at `time_ps` after the arrival of the pulse.
    #[must_use]
    pub fn curvature(&self, time_ps: f64) -> f64 {
        self.piece(time_ps).map_or(0.0, |([_, _, c2, c3], u)| (2.0 * c2 + 6.0 * c3 * u) / (self.step_ps * self.step_ps))
    }

    /// Value, slope and second derivative, as [`Self::value_and_slope`] and [`Self::curvature`] have them.
    pub(crate) fn value_slope_and_curvature(&self, time_ps: f64) -> [f64; 3] {
        self.piece(time_ps).map_or([0.0; 3], |([c0, c1, c2, c3], u)| {
            [
                c0 + u * (c1 + u * (c2 + u * c3)),
                (c1 + u * (2.0 * c2 + u * 3.0 * c3)) / self.step_ps,
                (2.0 * c2 + 6.0 * c3 * u) / (self.step_ps * self.step_ps),
            ]
        })
    }

    /// The cubic that holds `time_ps` and the position within it; `None` outside the support.
    fn piece(&self, time_ps: f64) -> Option<([f64; 4], f64)> {
        let position = (time_ps - self.t0_ps) / self.step_ps;
        // A NaN is in no range.
        if !(0.0..=self.pieces.len() as f64).contains(&position) {
            return None;
        }
        let i = (position as usize).min(self.pieces.len() - 1);
        Some((self.pieces[i], position - i as f64))
    }

    /// First and last time at which the response is defined, ps after the arrival.
    #[must_use]
    pub fn support_ps(&self) -> (f64, f64) {
        (self.t0_ps, self.t0_ps + self.pieces.len() as f64 * self.step_ps)
    }

    /// Samples `n` in `0..len` of a record (sample `n` at `t0_ps + n * dt_ps`) that a pulse at `arrival_ps` reaches.
    #[must_use]
    pub fn reach(&self, arrival_ps: f64, t0_ps: f64, dt_ps: f64, len: usize) -> Range<usize> {
        let (first_ps, last_ps) = self.support_ps();
        let index = |time_ps: f64| (arrival_ps + time_ps - t0_ps) / dt_ps;
        // Float casts saturate, so an arrival far outside gives an empty range at the nearer end.
        let start = (index(first_ps).ceil().max(0.0) as usize).min(len);
        let end = ((index(last_ps).floor() + 1.0).max(0.0) as usize).min(len);
        start..end.max(start)
    }

    /// Whether it is a step: it ends above half its maximum, where a pulse has decayed.
    #[must_use]
    pub fn is_step(&self) -> bool {
        self.outline().is_step
    }

    /// Largest value.
    #[must_use]
    pub fn height(&self) -> f64 {
        self.outline().height
    }

    /// Time of the maximum, ps after the arrival; for a step, of its steepest rise.
    #[must_use]
    pub fn peak_ps(&self) -> f64 {
        self.outline().peak_ps
    }

    fn outline(&self) -> &Outline {
        self.outline.get_or_init(|| {
            let (maximum_ps, reach) = (self.maximum_ps(), self.support_ps());
            let height = self.value(maximum_ps);
            let is_step = self.value(reach.1) > height / 2.0;
            let (peak_ps, width_ps) = if is_step {
                let (steepest_ps, slope) = self.steepest();
                (steepest_ps, height / slope)
            } else {
                let end = |limit_ps| self.crossing(maximum_ps, limit_ps, height / 2.0);
                (maximum_ps, end(reach.1) - end(reach.0))
            };
            Outline { is_step, height, peak_ps, width_ps }
        })
    }

    /// Time and slope (per ps) of the steepest rise.
    fn steepest(&self) -> (f64, f64) {
        let slope = |[_, c1, c2, c3]: [f64; 4], u: f64| c1 + u * (2.0 * c2 + u * 3.0 * c3);
        let candidates = self.pieces.iter().enumerate().flat_map(|(i, &piece)| {
            let inner = -piece[2] / (3.0 * piece[3]);
            let inner = Some(inner).filter(|u| (0.0..1.0).contains(u));
            [Some(0.0), inner].into_iter().flatten().map(move |u| (i as f64 + u, slope(piece, u)))
        });
        let (position, slope) =
            candidates.fold((0.0, f64::NEG_INFINITY), |best, at| if at.1 > best.1 { at } else { best });
        (self.t0_ps + position * self.step_ps, slope / self.step_ps)
    }

    fn maximum_ps(&self) -> f64 {
        let knots = self.pieces.iter().enumerate().map(|(i, p)| (i as f64, p[0]));
        let interior =
            self.pieces.iter().enumerate().filter_map(|(i, p)| interior_maximum(*p).map(|(u, v)| (i as f64 + u, v)));
        let last = self.pieces.len() as f64;
        let end = self.value(self.t0_ps + last * self.step_ps);
        let (position, _) = knots
            .chain(interior)
            .chain([(last, end)])
            .fold((0.0, f64::NEG_INFINITY), |best, at| if at.1 > best.1 { at } else { best });
        self.t0_ps + position * self.step_ps
    }

    /// Full width at half maximum, ps: distance between the half-maximum crossings next to the maximum on either side.
    /// For a step, its rise time: height over steepest slope.
    #[must_use]
    pub fn width_ps(&self) -> f64 {
        self.outline().width_ps
    }

    /// First time from `peak_ps` towards `limit_ps` at which the value falls to `level`; `limit_ps` if it never does.
    fn crossing(&self, peak_ps: f64, limit_ps: f64, level: f64) -> f64 {
        let stride = self.step_ps.copysign(limit_ps - peak_ps);
        let mut above = peak_ps;
        while (limit_ps - above).abs() > 0.0 {
            let next = if (limit_ps - above).abs() < self.step_ps { limit_ps } else { above + stride };
            if self.value(next) < level {
                return self.bisect(above, next, level);
            }
            above = next;
        }
        limit_ps
    }

    fn bisect(&self, mut above: f64, mut below: f64, level: f64) -> f64 {
        for _ in 0..50 {
            let middle = f64::midpoint(above, below);
            if self.value(middle) < level {
                below = middle;
            } else {
                above = middle;
            }
        }
        f64::midpoint(above, below)
    }
}

/// Second derivatives (per knot step squared) of the natural cubic spline: Thomas algorithm on
/// `m[i-1] + 4 m[i] + m[i+1] = 6 (v[i-1] - 2 v[i] + v[i+1])`, zero at both ends.
fn natural_curvatures(values: &[f64]) -> Vec<f64> {
    let n = values.len();
    let mut curvatures = vec![0.0; n];
    let mut ratio = vec![0.0; n];
    for i in 1..n - 1 {
        let right = 6.0 * (values[i - 1] - 2.0 * values[i] + values[i + 1]);
        let pivot = 4.0 - ratio[i - 1];
        ratio[i] = 1.0 / pivot;
        curvatures[i] = (right - curvatures[i - 1]) / pivot;
    }
    for i in (1..n - 1).rev() {
        curvatures[i] -= ratio[i] * curvatures[i + 1];
    }
    curvatures
}

/// Place (0..1) and value of a maximum inside one cubic piece, if it has one: a root of the slope with falling slope.
fn interior_maximum([c0, c1, c2, c3]: [f64; 4]) -> Option<(f64, f64)> {
    let u = if c3 == 0.0 {
        -c1 / (2.0 * c2)
    } else {
        let root = (c2 * c2 - 3.0 * c1 * c3).sqrt();
        (-c2 - root) / (3.0 * c3)
    };
    let curvature = 2.0 * c2 + 6.0 * c3 * u;
    (u > 0.0 && u < 1.0 && curvature < 0.0).then_some((u, c0 + u * (c1 + u * (c2 + u * c3))))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gaussian of FWHM 250 ps, knots every 10 ps over +-600 ps: negligible (1e-7) at the ends.
    fn gaussian(knot_shift_ps: f64) -> Response {
        let values: Vec<f64> = (0..121).map(|i| gauss(-600.0 + knot_shift_ps + 10.0 * f64::from(i))).collect();
        Response::new(-600.0 + knot_shift_ps, 10.0, &values)
    }

    fn gauss(t_ps: f64) -> f64 {
        (-0.5 * (t_ps / SIGMA_PS).powi(2)).exp()
    }

    const SIGMA_PS: f64 = 106.165_225; // 250 ps / 2.354_82

    #[test]
    fn follows_the_function_and_its_slope_between_knots() {
        let response = gaussian(0.0);
        for i in 0..2000 {
            let t = -590.0 + 0.59 * f64::from(i);
            let (value, slope) = response.value_and_slope(t);
            assert!((value - gauss(t)).abs() < 2e-6, "value at {t}");
            let expected = -t / SIGMA_PS.powi(2) * gauss(t);
            assert!((slope - expected).abs() < 1e-6, "slope at {t}");
            let curvature = ((t / SIGMA_PS).powi(2) - 1.0) / SIGMA_PS.powi(2) * gauss(t);
            // A natural spline's second derivative is wrong near its ends, where it is made zero.
            if t.abs() < 500.0 {
                assert!((response.curvature(t) - curvature).abs() < 5e-7, "curvature at {t}");
            }
        }
    }

    #[test]
    fn a_step_is_placed_by_its_edge() {
        let step = |t: f64| 1.0 / (1.0 + (-t / 20.0).exp());
        let values: Vec<f64> = (0..200).map(|i| step(10.0 * f64::from(i) - 503.0)).collect();
        let response = Response::new(-100.0, 10.0, &values);
        assert!(response.is_step() && !gaussian(0.0).is_step());
        assert!((response.peak_ps() - 403.0).abs() < 6.0, "{}", response.peak_ps());
        assert!((response.width_ps() - 80.0).abs() < 1.0, "{}", response.width_ps());
    }

    #[test]
    fn passes_through_the_knots_and_solves_the_naive_system() {
        let values = [0.0, 1.0, -2.0, 5.0, 4.0, 0.5];
        let response = Response::new(3.0, 2.0, &values);
        for (i, v) in values.iter().enumerate() {
            assert!((response.value(3.0 + 2.0 * i as f64) - v).abs() < 1e-12);
        }
        let m = natural_curvatures(&values);
        for i in 1..5 {
            let right = 6.0 * (values[i - 1] - 2.0 * values[i] + values[i + 1]);
            assert!((m[i - 1] + 4.0 * m[i] + m[i + 1] - right).abs() < 1e-12);
        }
    }

    #[test]
    fn is_zero_outside_and_reaches_exactly_its_support() {
        let response = Response::new(-10.0, 5.0, &[1.0, 2.0, 1.0]);
        assert_eq!(response.value(-10.01), 0.0);
        assert_eq!(response.value(0.01), 0.0);
        assert_eq!(response.value(f64::NAN), 0.0);
        for arrival in [-1e9, -3.0, 0.0, 17.3, 52.0, 108.0, 111.0, 1e9] {
            let naive: Vec<usize> = (0..50)
                .filter(|&n| {
                    let t = 4.0 + 2.0 * n as f64 - arrival;
                    (-10.0..=0.0).contains(&t)
                })
                .collect();
            let reach: Vec<usize> = response.reach(arrival, 4.0, 2.0, 50).collect();
            assert_eq!(reach, naive, "arrival {arrival}");
        }
    }

    #[test]
    fn peak_and_width_do_not_depend_on_the_knots() {
        for shift in [0.0, 1.7, 5.0, 9.1] {
            let response = gaussian(shift);
            assert!(response.peak_ps().abs() < 0.01, "peak, knots at {shift}");
            assert!((response.width_ps() - 250.0).abs() < 0.01, "width, knots at {shift}");
        }
        // A ramp cut off a little below half its maximum is still a pulse: the half width reaches to its end.
        let ramp = Response::new(0.0, 1.0, &[0.0, 1.0, 2.0, 3.0, 4.0, 1.5]);
        assert!((ramp.peak_ps() - 4.0).abs() < 0.3 && !ramp.is_step());
    }
}
