//! Where the light of a pulse lies and how it is spread in time, and what the spread makes of a response.
//!
//! Light from an extended patch arrives over an interval: a Gaussian of variance `v`; where that does not suffice, what
//! disks make of it, of variance `v` too, or a Gaussian with a one-sided exponential tail of constant `tau`. All are
//! centred, so that the time of a place is the centroid of the light in every case. The variance is the parameter, not
//! its root: by the heat equation the derivative of the widened response by `v` is half its second derivative, regular
//! down to a point at `v = 0`.
//!
//! An evenly lit disk has as much light at each distance as its chord is long: within twice its standard deviation to
//! either side, `sqrt(1 - x^2 / 4 v)` of it, with an excess kurtosis of -1. Light over two disks has one from -1 to
//! -1/2, over three from -1 to -1/3, by their shares of the variance. Symmetric beta distributions have each of these:
//! `(1 - x^2 / r^2)^(a - 1)`, of excess kurtosis `k = -6 / (2 a + 3)`, are a disk's chords at -1 and a Gaussian at 0.
//! Their sixth moments lie within 2.5 % of those of light over two disks. What is nearer is brighter: a factor
//! `e^(b x)` tilts the light. Of strong pulses both show.

use super::Response;
use super::nodes::{REACH_SD, REACH_TAILS, beta_nodes, gaussian_nodes, tail_nodes};
use super::prediction::Prior;
use std::ops::Range;

/// Widest step of a kernel's nodes and widest panel of the tail's, in widths of the response.
const STEP_WIDTHS: f64 = 0.25;
const PANEL_WIDTHS: f64 = 0.5;
/// Nodes of a Gaussian that neighbouring samples share are no nearer than the time between samples over this.
const PARTS_MAX: f64 = 8.0;
/// Excess kurtosis of light from disks to start from, that over two of them; the largest, which is as good as a
/// Gaussian's; and the step of derivatives by it and by the tilt.
const DISKS_START: f64 = -0.5;
const DISKS_MAX: f64 = -0.05;
const SHAPE_STEP: f64 = 1e-3;
/// Largest tilt: light that changes by more over a patch is of more than one.
const TILT_MAX: f64 = 0.05;
/// A tail starts from this part of the largest allowed, and falls to no less than the second: below it is no different
/// from none.
const TAIL_START: f64 = 0.3;
const TAIL_MIN: f64 = 1e-3;

/// How the light of a pulse is spread.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Spread {
    /// Not at all.
    Point,
    /// By a Gaussian.
    Gaussian,
    /// As light over disks, by a symmetric beta distribution of this excess kurtosis.
    Disks { kurtosis: f64 },
    /// The same, tilted: the relative change of the light over a standard deviation.
    TiltedDisks { kurtosis: f64, tilt: f64 },
    /// By a Gaussian with an exponential tail of this constant, ps.
    Tail { tail_ps: f64 },
}

/// Centroid and spread of a pulse's light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Place {
    /// Centroid, ps.
    pub(super) time_ps: f64,
    /// Variance of the Gaussian, or of what disks make, ps^2.
    pub(super) variance_ps2: f64,
    pub(super) spread: Spread,
    /// Whether the time is held where it is.
    pub(super) is_pinned: bool,
    /// What other records say of it.
    pub(super) prior: Option<Prior>,
}

/// Nodes of a kernel: time after the centroid, and weight.
pub(super) struct Node {
    pub(super) after_ps: f64,
    weight: f64,
    /// Weights of slopes and curvatures in the derivative by the variance.
    by_variance: [f64; 2],
    /// Weight of slopes in the derivative by the tail's constant.
    by_tail: f64,
}

impl Place {
    /// A point.
    pub(super) fn point(time_ps: f64) -> Self {
        Self { time_ps, variance_ps2: 0.0, spread: Spread::Point, is_pinned: false, prior: None }
    }

    /// A Gaussian.
    pub(super) fn widened(time_ps: f64, variance_ps2: f64) -> Self {
        Self { variance_ps2, spread: Spread::Gaussian, ..Self::point(time_ps) }
    }

    /// Where a fitted pulse is.
    pub(super) fn of(pulse: &super::Pulse) -> Self {
        let spread = match pulse {
            _ if pulse.tail_ps > 0.0 => Spread::Tail { tail_ps: pulse.tail_ps },
            _ if pulse.width_ps == 0.0 => Spread::Point,
            _ if pulse.tilt != 0.0 => Spread::TiltedDisks { kurtosis: pulse.kurtosis.min(DISKS_MAX), tilt: pulse.tilt },
            _ if pulse.kurtosis < 0.0 => Spread::Disks { kurtosis: pulse.kurtosis.min(DISKS_MAX) },
            _ => Spread::Gaussian,
        };
        Self { variance_ps2: pulse.width_ps * pulse.width_ps, spread, ..Self::point(pulse.time_ps) }
    }

    /// Number of free parameters of its shape: the variance; the kurtosis of disks or the constant of a tail; the tilt.
    pub(super) fn shapes(&self) -> usize {
        match self.spread {
            Spread::Point => 0,
            Spread::Gaussian => 1,
            Spread::Disks { .. } | Spread::Tail { .. } => 2,
            Spread::TiltedDisks { .. } => 3,
        }
    }

    /// Constant of its exponential tail, ps; 0 for none.
    pub(super) fn tail_ps(&self) -> f64 {
        match self.spread {
            Spread::Tail { tail_ps } => tail_ps,
            _ => 0.0,
        }
    }

    /// Samples of a record of `len` that the spread response reaches.
    pub(super) fn reach(&self, response: &Response, t0_ps: f64, dt_ps: f64, len: usize) -> Range<usize> {
        let (side_ps, tail_ps) = (REACH_SD * self.variance_ps2.sqrt(), self.tail_ps());
        let from = response.reach(self.time_ps - side_ps - tail_ps, t0_ps, dt_ps, len);
        let to = response.reach(self.time_ps + side_ps + (REACH_TAILS - 1.0) * tail_ps, t0_ps, dt_ps, len);
        from.start..to.end
    }

    /// The spread response and its derivatives by the centroid, the variance, the kurtosis of disks or the tail's
    /// constant, and the tilt, at `count` times `dt_ps` apart, the first `after_ps` after the centroid.
    ///
    /// Nodes of the Gaussian lie a whole part of `dt_ps` apart, so that neighbouring samples share what they need of
    /// the response. A Gaussian far narrower than that, and light of disks, has its own nodes at each sample.
    pub(super) fn samples(
        &self,
        response: &Response,
        width_ps: f64,
        after_ps: f64,
        dt_ps: f64,
        count: usize,
    ) -> Vec<[f64; 5]> {
        let sd_ps = self.variance_ps2.sqrt();
        let parts = (dt_ps / sd_ps.min(STEP_WIDTHS * width_ps)).ceil();
        if sd_ps == 0.0 || count == 0 {
            return self.tailed_samples(response, width_ps, after_ps, dt_ps, count);
        }
        if self.kurtosis() < 0.0 {
            return self.disk_samples(response, width_ps, after_ps, dt_ps, count);
        }
        if parts > PARTS_MAX {
            let nodes = self.nodes(width_ps);
            return (0..count).map(|n| spread_response(response, &nodes, after_ps + n as f64 * dt_ps)).collect();
        }
        let (parts, step_ps) = (parts as usize, dt_ps / parts);
        let side = (REACH_SD * sd_ps / step_ps).ceil() as usize;
        let density = |i: usize| (-0.5 * ((i as f64 - side as f64) * step_ps / sd_ps).powi(2)).exp();
        let total: f64 = (0..=2 * side).map(density).sum();
        let weights: Vec<f64> = (0..=2 * side).map(|i| density(i) / total).collect();
        let fine = self.tailed_samples(
            response,
            width_ps,
            after_ps - side as f64 * step_ps,
            step_ps,
            (count - 1) * parts + weights.len(),
        );
        let sample = |n: usize| {
            let mut sum = [0.0; 5];
            for (weight, one) in weights.iter().zip(&fine[n * parts..]) {
                (0..5).for_each(|k| sum[k] += weight * one[k]);
            }
            sum
        };
        (0..count).map(sample).collect()
    }

    /// The same of light over disks.
    fn disk_samples(
        &self,
        response: &Response,
        width_ps: f64,
        after_ps: f64,
        dt_ps: f64,
        count: usize,
    ) -> Vec<[f64; 5]> {
        let (kurtosis, tilt) = (self.kurtosis(), self.tilt());
        let nodes = self.disk_nodes(kurtosis, tilt, width_ps);
        let steps = [-SHAPE_STEP, SHAPE_STEP];
        let of_kurtosis = steps.map(|step| self.disk_nodes(kurtosis + step, tilt, width_ps));
        // Without a free tilt, nothing asks for its derivative.
        let of_tilt = (self.shapes() > 2).then(|| steps.map(|step| self.disk_nodes(kurtosis, tilt + step, width_ps)));
        let value = |nodes: &[Node], at: f64| -> f64 {
            nodes.iter().map(|node| node.weight * response.value(at - node.after_ps)).sum()
        };
        let change = |[less, more]: &[Vec<Node>; 2], at: f64| (value(more, at) - value(less, at)) / (2.0 * SHAPE_STEP);
        let sample = |n: usize| {
            let at = after_ps + n as f64 * dt_ps;
            let [whole, by_time, by_variance, ..] = spread_response(response, &nodes, at);
            let by_tilt = of_tilt.as_ref().map_or(0.0, |nodes| change(nodes, at));
            [whole, by_time, by_variance, change(&of_kurtosis, at), by_tilt]
        };
        (0..count).map(sample).collect()
    }

    /// The same without the Gaussian. A tail at one time is that at the time before, decayed, and what is new:
    ///
    /// ```text
    /// F(t) = integral of e^-u g(t - tau u),   F(t + dt) = e^-c F(t) + integral from 0 to c of e^-u g(t + dt - tau u),
    /// ```
    ///
    /// with `c = dt / tau`; so it costs a step's nodes a sample, not all.
    fn tailed_samples(
        &self,
        response: &Response,
        width_ps: f64,
        after_ps: f64,
        dt_ps: f64,
        count: usize,
    ) -> Vec<[f64; 5]> {
        let tail_ps = self.tail_ps();
        let at =
            |n: usize, u: f64| response.value_slope_and_curvature(after_ps + n as f64 * dt_ps - (u - 1.0) * tail_ps);
        if tail_ps == 0.0 {
            let sample = |n: usize| {
                let [value, slope, curvature] = at(n, 1.0);
                [value, -slope, 0.5 * curvature, 0.0, 0.0]
            };
            return (0..count).map(sample).collect();
        }
        let (panel_max, step) = (PANEL_WIDTHS * width_ps / tail_ps, dt_ps / tail_ps);
        // Value, slope, curvature, and slope times u, integrated over nodes.
        let sum = |n: usize, nodes: &[(f64, f64)]| {
            nodes.iter().fold([0.0; 4], |sum, &(u, weight)| {
                let [value, slope, curvature] = at(n, u);
                let add = [weight * value, weight * slope, weight * curvature, weight * u * slope];
                [0, 1, 2, 3].map(|k| sum[k] + add[k])
            })
        };
        let fresh = tail_nodes(panel_max, step.min(REACH_TAILS));
        let kept = (-step).exp();
        let mut state = sum(0, &tail_nodes(panel_max, REACH_TAILS));
        let mut samples = Vec::with_capacity(count);
        for n in 0..count {
            if n > 0 {
                let new = sum(n, &fresh);
                let carried = [state[0], state[1], state[2], state[3] + step * state[1]];
                state = [0, 1, 2, 3].map(|k| kept * carried[k] + new[k]);
            }
            samples.push([state[0], -state[1], 0.5 * state[2], state[1] - state[3], 0.0]);
        }
        samples
    }

    /// As light over disks, to start from.
    pub(super) fn of_disks(self) -> Self {
        Self { spread: Spread::Disks { kurtosis: DISKS_START }, ..self }
    }

    /// The same with a tilt of its light that is free.
    pub(super) fn tilted(self) -> Self {
        Self { spread: Spread::TiltedDisks { kurtosis: self.kurtosis(), tilt: 0.0 }, ..self }
    }

    /// Excess kurtosis of the spread without its tail: 0 for a Gaussian, -1 for a disk.
    pub(super) fn kurtosis(&self) -> f64 {
        match self.spread {
            Spread::Disks { kurtosis } | Spread::TiltedDisks { kurtosis, .. } => kurtosis,
            _ => 0.0,
        }
    }

    /// Relative change of its light over a standard deviation of the spread.
    pub(super) fn tilt(&self) -> f64 {
        match self.spread {
            Spread::TiltedDisks { tilt, .. } => tilt,
            _ => 0.0,
        }
    }

    /// With a tail besides its variance, to start from.
    pub(super) fn tailed(self, extent_max_ps: f64) -> Self {
        Self { spread: Spread::Tail { tail_ps: TAIL_START * extent_max_ps }, ..self }
    }

    /// Number of free parameters.
    pub(super) fn parameters(&self) -> usize {
        1 + self.shapes()
    }

    /// How far parameter `p` is off what its prior expects, and the information of that.
    pub(super) fn pull(&self, p: usize) -> Option<[f64; 2]> {
        self.prior.and_then(|prior| prior.pull(self, p))
    }

    /// Chi2 of its priors.
    pub(super) fn penalty(&self) -> f64 {
        (0..self.parameters()).filter_map(|p| self.pull(p)).map(|[off, information]| off * off * information).sum()
    }

    /// Moved by `step` along its free parameters: time by no more than `step_max_ps`, the shape within its limits.
    pub(super) fn moved(mut self, step: &[f64], step_max_ps: f64, extent_max_ps: f64) -> Self {
        self.time_ps += step[0].clamp(-step_max_ps, step_max_ps);
        if self.shapes() > 0 {
            self.variance_ps2 = (self.variance_ps2 + step[1]).clamp(0.0, extent_max_ps * extent_max_ps);
        }
        match &mut self.spread {
            Spread::Disks { kurtosis } => *kurtosis = (*kurtosis + step[2]).clamp(-1.0, DISKS_MAX),
            Spread::TiltedDisks { kurtosis, tilt } => {
                *kurtosis = (*kurtosis + step[2]).clamp(-1.0, DISKS_MAX);
                *tilt = (*tilt + step[3]).clamp(-TILT_MAX, TILT_MAX);
            }
            Spread::Tail { tail_ps } => {
                *tail_ps = (*tail_ps + step[2]).clamp(TAIL_MIN * extent_max_ps, extent_max_ps);
            }
            Spread::Point | Spread::Gaussian => {}
        }
        self
    }

    /// Whether parameter `p`, pulled along `gradient`, is held back: a time that is pinned, a shape at its limit.
    pub(super) fn is_held(&self, p: usize, gradient: f64, extent_max_ps: f64) -> bool {
        let (value, least, most) = match (p, self.spread) {
            (0, _) => return self.is_pinned,
            (1, _) => (self.variance_ps2, 0.0, extent_max_ps * extent_max_ps),
            (3, _) => (self.tilt(), -TILT_MAX, TILT_MAX),
            (_, Spread::Disks { kurtosis } | Spread::TiltedDisks { kurtosis, .. }) => (kurtosis, -1.0, DISKS_MAX),
            _ => (self.tail_ps(), TAIL_MIN * extent_max_ps, extent_max_ps),
        };
        (value <= least && gradient < 0.0) || (value >= most && gradient > 0.0)
    }

    /// Whether its spread, or its tilt, is as large as is allowed: then it is more likely something else.
    pub(super) fn is_at_limit(&self, extent_max_ps: f64) -> bool {
        let is_wide = self.variance_ps2 >= extent_max_ps * extent_max_ps || self.tail_ps() >= extent_max_ps;
        is_wide || self.tilt().abs() >= TILT_MAX
    }

    /// Nodes that stand for light over disks of its variance.
    fn disk_nodes(&self, kurtosis: f64, tilt: f64, width_ps: f64) -> Vec<Node> {
        let node = |(after_ps, weight): (f64, f64)| {
            // Each stays at its share of the radius: it moves by its distance over twice the variance.
            let moves = -weight * after_ps / (2.0 * self.variance_ps2);
            Node { after_ps, weight, by_variance: [moves, 0.0], by_tail: 0.0 }
        };
        beta_nodes(self.variance_ps2.sqrt(), [kurtosis, tilt], STEP_WIDTHS * width_ps).into_iter().map(node).collect()
    }

    /// Nodes that stand for the Gaussian and the tail.
    pub(super) fn nodes(&self, width_ps: f64) -> Vec<Node> {
        let gaussian = gaussian_nodes(self.variance_ps2.sqrt(), STEP_WIDTHS * width_ps);
        let node = |(after_ps, weight)| Node { after_ps, weight, by_variance: [0.0, 0.5 * weight], by_tail: 0.0 };
        let tail_ps = self.tail_ps();
        if tail_ps == 0.0 {
            return gaussian.into_iter().map(node).collect();
        }
        let tail = tail_nodes(PANEL_WIDTHS * width_ps / tail_ps, REACH_TAILS);
        let both = |&(x, weight): &(f64, f64)| {
            // Later light by u - 1 constants: the centroid stays.
            tail.iter()
                .map(move |&(u, share)| Node {
                    by_tail: -(u - 1.0) * weight * share,
                    ..node((x + (u - 1.0) * tail_ps, weight * share))
                })
                .collect::<Vec<_>>()
        };
        gaussian.iter().flat_map(both).collect()
    }
}

/// Value of the response at `after_ps` spread over `nodes`, and its derivatives by the centroid, the variance, the
/// tail's constant, and a tilt, which these nodes have none of.
pub(super) fn spread_response(response: &Response, nodes: &[Node], after_ps: f64) -> [f64; 5] {
    nodes.iter().fold([0.0; 5], |[value, by_time, by_variance, by_tail, _], node| {
        let [h, slope, curvature] = response.value_slope_and_curvature(after_ps - node.after_ps);
        [
            value + node.weight * h,
            by_time - node.weight * slope,
            by_variance + node.by_variance[0] * slope + node.by_variance[1] * curvature,
            by_tail + node.by_tail * slope,
            0.0,
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
                let [value, by_time, by_variance, ..] = spread_response(&response, &nodes, t);
                assert!((value - expected).abs() < 3e-5, "{sd} {t}: {value} {expected}");
                assert!((by_time - expected * t / variance).abs() < 1e-6);
                let curvature = expected * (t * t / variance - 1.0) / variance;
                assert!((by_variance - 0.5 * curvature).abs() < 1e-6);
            }
        }
    }

    /// Value and derivatives of light over disks, as differences have them.
    #[test]
    fn light_over_disks_changes_with_its_shape() {
        let response = gaussian();
        let at = |kurtosis: f64, variance: f64, t: f64| {
            let place = Place { spread: Spread::Disks { kurtosis }, ..Place::widened(0.0, variance) };
            place.samples(&response, response.width_ps(), t, 50.0, 3)
        };
        for (sd, kurtosis, t) in [(8.0_f64, -0.5, -70.0), (45.0, -1.0, 10.0), (120.0, -0.3, -20.0)] {
            let variance = sd * sd;
            let own = at(kurtosis, variance, t);
            let [less, more] = [-1e-3, 1e-3].map(|step| at(kurtosis, variance * (1.0 + step), t));
            let tilted = |tilt: f64| {
                let place = Place { spread: Spread::TiltedDisks { kurtosis, tilt }, ..Place::widened(0.0, variance) };
                place.samples(&response, response.width_ps(), t, 50.0, 3)
            };
            let [earlier, level, later] = [-1e-2, 0.0, 1e-2].map(tilted);
            let [flatter, higher] = [-1e-2, 1e-2].map(|step| at(kurtosis + step, variance, t));
            for n in 0..3 {
                let by_variance = (more[n][0] - less[n][0]) / (2e-3 * variance);
                let by_kurtosis = (higher[n][0] - flatter[n][0]) / 2e-2;
                assert!((own[n][2] - by_variance).abs() < 1e-3 / variance, "{sd} {n}: {} {by_variance}", own[n][2]);
                let by_tilt = (later[n][0] - earlier[n][0]) / 2e-2;
                assert!((level[n][4] - by_tilt).abs() < 1e-5 && (level[n][0] - own[n][0]).abs() < 1e-12);
                let near = 1e-5 + 0.02 * by_kurtosis.abs();
                assert!((own[n][3] - by_kurtosis).abs() < near, "{sd} {n}: {} {by_kurtosis}", own[n][3]);
            }
        }
        // Nearly a Gaussian, and a point, which has no shape.
        let gaussian = Place::widened(0.0, 900.0).samples(&response, response.width_ps(), 20.0, 50.0, 3);
        assert!(gaussian.iter().zip(at(-0.05, 900.0, 20.0)).all(|(one, other)| (one[0] - other[0]).abs() < 1e-3));
        assert!(at(-0.5, 0.0, 10.0).iter().flatten().all(|value| value.is_finite()));
    }

    /// Area 1, centroid at the time, variance and third moment of the tail; its derivative is that of the value.
    #[test]
    fn a_tail_keeps_the_centroid() {
        let response = gaussian();
        let place = |tail_ps: f64| Place { spread: Spread::Tail { tail_ps }, ..Place::widened(0.0, 400.0) };
        for tail in [0.1, 10.0, 80.0] {
            let nodes = place(tail).nodes(response.width_ps());
            let moment = |k: i32| nodes.iter().map(|node| node.weight * node.after_ps.powi(k)).sum::<f64>();
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

    /// Sample by sample a tail is what all its nodes make of it, from anywhere in the response; curvatures, which have
    /// corners, as far as nodes in other places see those alike.
    #[test]
    fn a_tail_goes_on_from_sample_to_sample() {
        let response = gaussian();
        let tails =
            [(0.3, 20.0, 50.0), (30.0, 0.0, 50.0), (90.0, 40.0, 12.5), (200.0, 5.0, 400.0), (60.0, 130.0, 50.0)];
        let gaussians = [(0.0, 2.0, 50.0), (0.0, 33.0, 50.0), (0.0, 90.0, 7.0), (0.0, 170.0, 100.0)];
        for (tail_ps, sd_ps, dt_ps) in tails.into_iter().chain(gaussians) {
            let spread = if tail_ps > 0.0 { Spread::Tail { tail_ps } } else { Spread::Gaussian };
            let place = Place { spread, ..Place::widened(0.0, sd_ps * sd_ps) };
            let nodes = place.nodes(response.width_ps());
            for first_ps in [-700.0, -80.0, 300.0] {
                let samples = place.samples(&response, response.width_ps(), first_ps, dt_ps, 60);
                for (n, sample) in samples.iter().enumerate() {
                    let whole = spread_response(&response, &nodes, first_ps + n as f64 * dt_ps);
                    let near = (0..4).all(|k| (sample[k] - whole[k]).abs() < [1e-5, 1e-6, 4e-7, 1e-6][k]);
                    assert!(near, "{tail_ps} {first_ps} {n}: {sample:?} {whole:?}");
                }
            }
        }
    }
}
