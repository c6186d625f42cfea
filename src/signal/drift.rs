//! Drift of a delay over a session, from references that are repeated between captures.
//!
//! The delay is a polygon with equally spaced knots: it minimises `sum rho((d_i - p(t_i)) / sd_i) + sum (second
//! difference of the knots)^2 / r^2` with Huber's `rho`, by iterated weights (Huber, Ann. Math. Stat. 35, 73 (1964)).
//! Points far off the median of their neighbourhood do not count. The same is the estimate of a walk whose slope
//! changes at each knot by a normal number of sd r. The inverse of the normal matrix is then the covariance of the
//! knots. r, the roughness, follows by maximum likelihood with the knots integrated out. Source: Wahba, *Spline Models
//! for Observational Data*, chapters 1 and 4. Beyond the points the delay goes on as a line, and its error grows as the
//! walk's does.
//!
//! A step of the delay (a cable that was touched) is no drift. At each gap that has enough points on either side, a
//! step is fitted together with the polygon and a new roughness. A step that stands out from its error is an error that
//! names the gap, so that the session can be split there. Not modelled: error common to all references, steps next to
//! the session's ends.

use super::banded::{Banded, BandedFactor};

/// Residuals beyond this many sd count linearly: of normal ones 1 in 80, so that a drift without outliers loses little.
const HUBER: f64 = 2.5;
/// A point this many sd (or spreads, if larger) off the median of its neighbourhood does not count.
const REJECTED: f64 = 5.0;
/// Rounds of reweighting.
const ROUNDS: usize = 4;
/// Points on either side of one in its neighbourhood; fewer may be outliers.
const SIDE: usize = 4;
/// Points that count which a step needs on either side.
const STEP_SIDE: usize = 6;
/// Roughness tried, over the median sd of a point: from, to, in how many geometric steps.
const ROUGHNESS: (f64, f64, usize) = (1e-3, 10.0, 16);

/// One repeated reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// When, s.
    pub time_s: f64,
    /// Delay, ps.
    pub delay_ps: f64,
    /// Its standard deviation, ps.
    pub sd_ps: f64,
}

/// What is asked of a fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriftOptions {
    /// Time between knots at most, s.
    pub spacing_s: f64,
    /// A step is refused that differs from none by this many standard deviations.
    pub step_sigma: f64,
}

/// Why a delay has no drift.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum DriftError {
    /// Fewer than three points, or all that count at one time.
    #[error("a drift needs three points that span some time")]
    TooFew,
    /// The delay jumps.
    #[error("the delay jumps by {step_ps:.2} ps (sd {sd_ps:.2}) between {:.0} s and {:.0} s", between_s.0, between_s.1)]
    Step {
        /// Between which times, s.
        between_s: (f64, f64),
        /// By how much, ps.
        step_ps: f64,
        /// Standard deviation of that, ps.
        sd_ps: f64,
    },
}

/// Delay over time.
#[derive(Clone, Debug)]
pub struct Drift {
    start_s: f64,
    spacing_s: f64,
    /// Delay that the knots are counted from.
    level_ps: f64,
    knots_ps: Vec<f64>,
    roughness_ps: f64,
    factor: BandedFactor<3>,
}

impl Drift {
    /// Delay at a time and its standard deviation, ps.
    #[must_use]
    pub fn at(&self, time_s: f64) -> (f64, f64) {
        let (knot, part) = place(self.start_s, self.spacing_s, self.knots_ps.len(), time_s);
        let mut hats = vec![0.0; self.knots_ps.len()];
        (hats[knot], hats[knot + 1]) = (1.0 - part, part);
        let delay_ps = (1.0 - part) * self.knots_ps[knot] + part * self.knots_ps[knot + 1];
        let mut solved = hats.clone();
        self.factor.solve(&mut solved);
        let variance = (1.0 - part) * solved[knot] + part * solved[knot + 1];
        (self.level_ps + delay_ps, (variance + self.walk_ps2(part)).sqrt())
    }

    /// By how much the delay at a time exceeds that at `origin_s`, and the standard deviation of the difference, ps.
    /// Both within the points, or the same side of them; else the walk beyond them counts in full.
    #[must_use]
    pub fn since(&self, origin_s: f64, time_s: f64) -> (f64, f64) {
        let mut hats = vec![0.0; self.knots_ps.len()];
        let mut walk_ps2 = 0.0;
        for (at_s, sign) in [(time_s, 1.0), (origin_s, -1.0)] {
            let (knot, part) = place(self.start_s, self.spacing_s, self.knots_ps.len(), at_s);
            hats[knot] += sign * (1.0 - part);
            hats[knot + 1] += sign * part;
            walk_ps2 += self.walk_ps2(part);
        }
        let mut solved = hats.clone();
        self.factor.solve(&mut solved);
        let delay_ps: f64 = hats.iter().zip(&self.knots_ps).map(|(hat, knot)| hat * knot).sum();
        let variance: f64 = hats.iter().zip(&solved).map(|(hat, solved)| hat * solved).sum();
        (delay_ps, (variance.max(0.0) + walk_ps2).sqrt())
    }

    /// Variance of the walk beyond the last knot, `part` of a spacing after the one before.
    fn walk_ps2(&self, part: f64) -> f64 {
        // Sum of squares 1 + 4 + .. of the knots that lie between the last one and this time.
        let beyond = (part - 1.0).max(-part).max(0.0);
        self.roughness_ps.powi(2) * beyond * (beyond + 1.0) * (2.0 * beyond + 1.0) / 6.0
    }

    /// Times of the knots, s.
    pub fn knots_s(&self) -> impl Iterator<Item = f64> {
        (0..self.knots_ps.len()).map(|knot| self.start_s + knot as f64 * self.spacing_s)
    }

    /// Standard deviation of the change of slope at a knot, ps a knot.
    #[must_use]
    pub fn roughness_ps(&self) -> f64 {
        self.roughness_ps
    }
}

/// The knot before a time and the part of the way to the next; below 0 or above 1 outside.
fn place(start_s: f64, spacing_s: f64, knots: usize, time_s: f64) -> (usize, f64) {
    let position = (time_s - start_s) / spacing_s;
    let knot = (position.max(0.0) as usize).min(knots - 2);
    (knot, position - knot as f64)
}

/// Drift through `points`, in any order.
///
/// # Errors
/// [`DriftError`], where there are too few points or the delay jumps.
///
/// # Panics
/// If an sd or the spacing is not positive, or a value not finite.
pub fn fit(points: &[Point], options: &DriftOptions) -> Result<Drift, DriftError> {
    assert!(options.spacing_s > 0.0, "the spacing must be positive");
    for point in points {
        assert!(point.time_s.is_finite() && point.delay_ps.is_finite(), "times and delays must be finite");
        assert!(point.sd_ps > 0.0, "the sds must be positive");
    }
    let mut points = points.to_vec();
    points.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    let span_s = points.last().map_or(0.0, |last| last.time_s - points[0].time_s);
    if points.len() < 3 || span_s <= 0.0 {
        return Err(DriftError::TooFew);
    }
    // Sums of squares keep their digits when the level is taken off.
    let level_ps = points[0].delay_ps;
    points.iter_mut().for_each(|point| point.delay_ps -= level_ps);
    let knots = (span_s / options.spacing_s).ceil() as usize + 1;
    let system = System::new(points, knots.max(3), span_s);
    let enough = |counted: &[f64]| counted.iter().sum::<f64>() >= STEP_SIDE as f64;
    let steps = (1..system.points.len())
        .filter(|i| system.counted[*i] > 0.0 && enough(&system.counted[..*i]) && enough(&system.counted[*i..]))
        .filter_map(|i| Some((i, system.robust(Some(i))?)));
    let significance = |s: &Solution| s.step_ps.abs() / s.step_sd_ps;
    let largest = steps.max_by(|a, b| significance(&a.1).total_cmp(&significance(&b.1)));
    if let Some((i, solution)) = largest.filter(|(_, s)| significance(s) > options.step_sigma) {
        return Err(DriftError::Step {
            between_s: (system.points[i - 1].time_s, system.points[i].time_s),
            step_ps: solution.step_ps,
            sd_ps: solution.step_sd_ps,
        });
    }
    let Solution { knots_ps, factor, roughness_ps, .. } = system.robust(None).ok_or(DriftError::TooFew)?;
    let (start_s, spacing_s) = (system.points[0].time_s, system.spacing_s);
    Ok(Drift { start_s, spacing_s, level_ps, knots_ps, roughness_ps, factor })
}

/// Points and knots.
struct System {
    points: Vec<Point>,
    spacing_s: f64,
    knots: usize,
    /// Knot before each point and part of the way to the next.
    places: Vec<(usize, f64)>,
    roughnesses_ps: Vec<f64>,
    /// 0 for a point far off its neighbourhood, else 1.
    counted: Vec<f64>,
}

/// The minimum for given weights and roughness.
struct Solution {
    knots_ps: Vec<f64>,
    step_ps: f64,
    step_sd_ps: f64,
    factor: BandedFactor<3>,
    roughness_ps: f64,
    /// Minus twice the logarithm of the likelihood, the knots integrated out, but for a constant.
    badness: f64,
}

impl System {
    fn new(points: Vec<Point>, knots: usize, span_s: f64) -> Self {
        let spacing_s = span_s / (knots - 1) as f64;
        let places = points.iter().map(|p| place(points[0].time_s, spacing_s, knots, p.time_s)).collect();
        let mut sds: Vec<f64> = points.iter().map(|p| p.sd_ps).collect();
        sds.sort_by(f64::total_cmp);
        let (from, to, count) = ROUGHNESS;
        let factor = |i: usize| from * (to / from).powf(i as f64 / count as f64);
        let roughnesses_ps = (0..=count).map(|i| sds[sds.len() / 2] * factor(i)).collect();
        let counted = counted(&points);
        Self { points, spacing_s, knots, places, roughnesses_ps, counted }
    }

    /// The most likely roughness with Huber's weights; a step before point `step` is fitted too.
    fn robust(&self, step: Option<usize>) -> Option<Solution> {
        let mut weights = self.counted.clone();
        let mut best = self.likeliest(&weights, step)?;
        for _ in 1..ROUNDS {
            for (i, weight) in weights.iter_mut().enumerate() {
                let (knot, part) = self.places[i];
                let line = (1.0 - part) * best.knots_ps[knot] + part * best.knots_ps[knot + 1];
                let jump = if step.is_some_and(|step| i >= step) { best.step_ps } else { 0.0 };
                let residual = (self.points[i].delay_ps - line - jump).abs() / self.points[i].sd_ps;
                *weight = self.counted[i] * (HUBER / residual).min(1.0);
            }
            best = self.likeliest(&weights, step)?;
        }
        Some(best)
    }

    fn likeliest(&self, weights: &[f64], step: Option<usize>) -> Option<Solution> {
        let solutions = self.roughnesses_ps.iter().filter_map(|r| self.solve(weights, *r, step));
        solutions.min_by(|a, b| a.badness.total_cmp(&b.badness))
    }

    /// `None` where the points that count leave the knots undetermined.
    fn solve(&self, weights: &[f64], roughness_ps: f64, step: Option<usize>) -> Option<Solution> {
        let mut matrix = Banded::zeros(self.knots);
        matrix.add_second_differences(roughness_ps.powi(-2));
        let (mut right, mut with_step) = (vec![0.0; self.knots], vec![0.0; self.knots]);
        let (mut total, mut step_right, mut step_square) = (0.0, 0.0, 0.0);
        for (i, (point, &(knot, part))) in self.points.iter().zip(&self.places).enumerate() {
            let weight = weights[i] / point.sd_ps.powi(2);
            matrix.add(knot, knot, weight * (1.0 - part).powi(2));
            matrix.add(knot + 1, knot + 1, weight * part * part);
            matrix.add(knot + 1, knot, weight * part * (1.0 - part));
            right[knot] += weight * (1.0 - part) * point.delay_ps;
            right[knot + 1] += weight * part * point.delay_ps;
            total += weight * point.delay_ps.powi(2);
            if step.is_some_and(|step| i >= step) {
                with_step[knot] += weight * (1.0 - part);
                with_step[knot + 1] += weight * part;
                step_right += weight * point.delay_ps;
                step_square += weight;
            }
        }
        let factor = matrix.cholesky()?;
        let mut knots_ps = right.clone();
        factor.solve(&mut knots_ps);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let mut badness = factor.log_determinant() + 2.0 * (self.knots - 2) as f64 * roughness_ps.ln();
        badness += total - dot(&right, &knots_ps);
        let (mut step_ps, mut step_sd_ps) = (0.0, f64::INFINITY);
        if step.is_some() {
            let mut imitated = with_step.clone();
            factor.solve(&mut imitated);
            let information = step_square - dot(&with_step, &imitated);
            step_ps = (step_right - dot(&with_step, &knots_ps)) / information;
            step_sd_ps = information.sqrt().recip();
            knots_ps.iter_mut().zip(&imitated).for_each(|(knot, imitated)| *knot -= step_ps * imitated);
            badness += information.ln() - step_ps.powi(2) * information;
        }
        Some(Solution { knots_ps, step_ps, step_sd_ps, factor, roughness_ps, badness })
    }
}

/// Which points lie near the median of their neighbourhood: a start that outliers do not bend, and that steps do not
/// blur.
fn counted(points: &[Point]) -> Vec<f64> {
    let median = |values: &mut Vec<f64>| {
        let half = values.len() / 2;
        *values.select_nth_unstable_by(half, f64::total_cmp).1
    };
    let len = points.len();
    (0..len)
        .map(|i| {
            let start = i.saturating_sub(SIDE).min(len.saturating_sub(2 * SIDE + 1));
            let near = &points[start..(start + 2 * SIDE + 1).min(len)];
            let mut values: Vec<f64> = near.iter().map(|p| p.delay_ps).collect();
            let middle_ps = median(&mut values);
            values.iter_mut().for_each(|v| *v = (*v - middle_ps).abs());
            let spread_ps = 1.4826 * median(&mut values);
            let far = (points[i].delay_ps - middle_ps).abs() > REJECTED * points[i].sd_ps.max(spread_ps);
            f64::from(u8::from(!far))
        })
        .collect()
}

#[cfg(test)]
mod tests;
