//! Where the light of a pulse lies and how it is spread in time, and what the spread makes of a response.
//!
//! Light from an extended patch arrives over an interval: a Gaussian of variance `v`, and where that does not suffice,
//! one with a one-sided exponential tail of constant `tau`. Both are centred, so that the time of a place is the
//! centroid of the light in every case. The variance is the parameter, not its root: by the heat equation the
//! derivative of the widened response by `v` is half its second derivative, regular down to a point at `v = 0`.

use super::Response;
use std::ops::Range;

/// Gaussian kernels reach this many sds to either side, exponential ones this many constants: less than a millionth of
/// the light lies beyond.
const REACH_SD: f64 = 5.0;
const REACH_TAILS: f64 = 14.0;
/// Widest step of a kernel's nodes and widest panel of the tail's, in widths of the response.
const STEP_WIDTHS: f64 = 0.25;
const PANEL_WIDTHS: f64 = 0.5;
/// A tail starts from this part of the largest allowed, and falls to no less than the second: below it is no different
/// from none.
const TAIL_START: f64 = 0.3;
const TAIL_MIN: f64 = 1e-3;

/// Centroid and spread of a pulse's light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Place {
    /// Centroid, ps.
    pub(super) time_ps: f64,
    /// Variance of the Gaussian spread, ps^2.
    pub(super) variance_ps2: f64,
    /// Constant of the exponential tail, ps.
    pub(super) tail_ps: f64,
    /// Number of shape parameters that are free: none (a point), the variance, or both.
    pub(super) shapes: usize,
    /// Whether the time is held where it is.
    pub(super) is_pinned: bool,
}

/// Nodes of a kernel: time after the centroid, weight, and its weight in the derivative by the tail's constant, which
/// takes slopes.
pub(super) type Node = (f64, f64, f64);

impl Place {
    /// A point.
    pub(super) fn point(time_ps: f64) -> Self {
        Self { time_ps, variance_ps2: 0.0, tail_ps: 0.0, shapes: 0, is_pinned: false }
    }

    /// A Gaussian.
    pub(super) fn widened(time_ps: f64, variance_ps2: f64) -> Self {
        Self { variance_ps2, shapes: 1, ..Self::point(time_ps) }
    }

    /// Where a fitted pulse is.
    pub(super) fn of(pulse: &super::Pulse) -> Self {
        let shapes = if pulse.tail_ps > 0.0 { 2 } else { usize::from(pulse.width_ps > 0.0) };
        Self {
            variance_ps2: pulse.width_ps * pulse.width_ps,
            tail_ps: pulse.tail_ps,
            shapes,
            ..Self::point(pulse.time_ps)
        }
    }

    /// Samples of a record of `len` that the response reaches when it is spread over `nodes`.
    pub(super) fn reach(
        &self,
        nodes: &[Node],
        response: &Response,
        t0_ps: f64,
        dt_ps: f64,
        len: usize,
    ) -> Range<usize> {
        let (least, most) =
            nodes.iter().fold((0.0, 0.0), |(least, most): (f64, f64), (x, _, _)| (least.min(*x), most.max(*x)));
        let from = response.reach(self.time_ps + least, t0_ps, dt_ps, len);
        let to = response.reach(self.time_ps + most, t0_ps, dt_ps, len);
        from.start..to.end
    }

    /// With a tail besides its variance, to start from.
    pub(super) fn tailed(self, extent_max_ps: f64) -> Self {
        Self { tail_ps: TAIL_START * extent_max_ps, shapes: 2, ..self }
    }

    /// Number of free parameters.
    pub(super) fn parameters(&self) -> usize {
        1 + self.shapes
    }

    /// Moved by `step` along its free parameters: time by no more than `step_max_ps`, the shape within its limits.
    pub(super) fn moved(mut self, step: &[f64], step_max_ps: f64, extent_max_ps: f64) -> Self {
        self.time_ps += step[0].clamp(-step_max_ps, step_max_ps);
        if self.shapes > 0 {
            self.variance_ps2 = (self.variance_ps2 + step[1]).clamp(0.0, extent_max_ps * extent_max_ps);
        }
        if self.shapes > 1 {
            self.tail_ps = (self.tail_ps + step[2]).clamp(TAIL_MIN * extent_max_ps, extent_max_ps);
        }
        self
    }

    /// Whether parameter `p`, pulled along `gradient`, is held back: a time that is pinned, a shape at its limit.
    pub(super) fn is_held(&self, p: usize, gradient: f64, extent_max_ps: f64) -> bool {
        let (value, least, most) = match p {
            0 => return self.is_pinned,
            1 => (self.variance_ps2, 0.0, extent_max_ps * extent_max_ps),
            _ => (self.tail_ps, TAIL_MIN * extent_max_ps, extent_max_ps),
        };
        (value <= least && gradient < 0.0) || (value >= most && gradient > 0.0)
    }

    /// Whether its spread is as large as is allowed: then it is more likely something else.
    pub(super) fn is_at_limit(&self, extent_max_ps: f64) -> bool {
        self.variance_ps2 >= extent_max_ps * extent_max_ps || self.tail_ps >= extent_max_ps
    }

    /// Nodes that stand for the spread.
    pub(super) fn nodes(&self, width_ps: f64) -> Vec<Node> {
        let gaussian = gaussian_nodes(self.variance_ps2.sqrt(), STEP_WIDTHS * width_ps);
        if self.shapes < 2 {
            return gaussian.into_iter().map(|(x, weight)| (x, weight, 0.0)).collect();
        }
        let tail_ps = self.tail_ps;
        let tail = tail_nodes(PANEL_WIDTHS * width_ps / tail_ps);
        let both = |&(x, weight): &(f64, f64)| {
            // Later light by u - 1 constants: the centroid stays.
            tail.iter()
                .map(move |&(u, share)| (x + (u - 1.0) * tail_ps, weight * share, -(u - 1.0) * weight * share))
                .collect::<Vec<_>>()
        };
        gaussian.iter().flat_map(both).collect()
    }
}

/// Nodes and weights of a Gaussian of sd `sd_ps`, no farther apart than `step_max_ps` or an sd: the trapezoidal rule,
/// which converges faster than any power for it.
fn gaussian_nodes(sd_ps: f64, step_max_ps: f64) -> Vec<(f64, f64)> {
    let per_sd = (sd_ps / step_max_ps).ceil().max(1.0);
    let side = (REACH_SD * per_sd) as i32;
    let density = |i: i32| (-0.5 * (f64::from(i) / per_sd).powi(2)).exp();
    let total: f64 = (-side..=side).map(density).sum();
    if sd_ps == 0.0 {
        return vec![(0.0, 1.0)];
    }
    (-side..=side).map(|i| (f64::from(i) * sd_ps / per_sd, density(i) / total)).collect()
}

/// Nodes and weights of `exp(-u)`, `u >= 0`: four Gauss-Legendre nodes in panels no longer than `panel_max` or 1.
fn tail_nodes(panel_max: f64) -> Vec<(f64, f64)> {
    const LEGENDRE: [(f64, f64); 4] = [
        (-0.861_136_311_594_052_6, 0.347_854_845_137_453_9),
        (-0.339_981_043_584_856_3, 0.652_145_154_862_546_1),
        (0.339_981_043_584_856_3, 0.652_145_154_862_546_1),
        (0.861_136_311_594_052_6, 0.347_854_845_137_453_9),
    ];
    let panels = (REACH_TAILS / panel_max.min(1.0)).ceil();
    let half = 0.5 * REACH_TAILS / panels;
    let nodes = |i: i32| {
        LEGENDRE.map(|(x, weight)| {
            let u = half * (2.0 * f64::from(i) + 1.0 + x);
            (u, half * weight * (-u).exp())
        })
    };
    (0..panels as i32).flat_map(nodes).collect()
}

/// Value of the response at `after_ps` spread over `nodes`, and its derivatives by the centroid, the variance and the
/// tail's constant.
pub(super) fn spread_response(response: &Response, nodes: &[Node], after_ps: f64) -> [f64; 4] {
    nodes.iter().fold([0.0; 4], |[value, by_time, by_variance, by_tail], &(x, weight, tail_weight)| {
        let (h, slope) = response.value_and_slope(after_ps - x);
        let curvature = response.curvature(after_ps - x);
        [
            value + weight * h,
            by_time - weight * slope,
            by_variance + 0.5 * weight * curvature,
            by_tail + tail_weight * slope,
        ]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIGMA_PS: f64 = 60.0;

    fn gaussian() -> Response {
        let values: Vec<f64> = (-100..=100).map(|i| (-0.5 * (f64::from(i) * 5.0 / SIGMA_PS).powi(2)).exp()).collect();
        Response::new(-500.0, 5.0, &values)
    }

    /// A Gaussian widened by a Gaussian is a Gaussian.
    #[test]
    fn widening_adds_variances() {
        let response = gaussian();
        for sd in [0.0, 0.5, 14.0, 60.0, 150.0] {
            let nodes = Place::widened(0.0, sd * sd).nodes(response.width_ps());
            for t in [-130.0, -40.0, 0.0, 3.0, 70.0] {
                let variance = SIGMA_PS * SIGMA_PS + sd * sd;
                let expected = SIGMA_PS / variance.sqrt() * (-0.5 * t * t / variance).exp();
                let [value, by_time, by_variance, _] = spread_response(&response, &nodes, t);
                assert!((value - expected).abs() < 3e-5, "{sd} {t}: {value} {expected}");
                assert!((by_time - expected * t / variance).abs() < 1e-6);
                let curvature = expected * (t * t / variance - 1.0) / variance;
                assert!((by_variance - 0.5 * curvature).abs() < 1e-6);
            }
        }
    }

    /// Area 1, centroid at the time, variance and third moment of the tail; its derivative is that of the value.
    #[test]
    fn a_tail_keeps_the_centroid() {
        let response = gaussian();
        let place = |tail_ps: f64| Place { tail_ps, shapes: 2, ..Place::widened(0.0, 400.0) };
        for tail in [0.1, 10.0, 80.0] {
            let nodes = place(tail).nodes(response.width_ps());
            let moment = |k: i32| nodes.iter().map(|(x, weight, _)| weight * x.powi(k)).sum::<f64>();
            assert!((moment(0) - 1.0).abs() < 1e-5 && moment(1).abs() < 2e-3 * tail.max(1.0));
            assert!((moment(2) / (400.0 + tail * tail) - 1.0).abs() < 1e-3);
            assert!((moment(3) - 2.0 * tail.powi(3)).abs() < 0.01 * (2.0 * tail.powi(3) + 100.0));
            for t in [-60.0, 20.0, 110.0] {
                let at = |tail: f64| spread_response(&response, &place(tail).nodes(response.width_ps()), t);
                let difference = (at(tail + 0.01)[0] - at(tail - 0.01)[0]) / 0.02;
                assert!((at(tail)[3] - difference).abs() < 1e-6, "{tail} {t}");
            }
        }
    }
}
