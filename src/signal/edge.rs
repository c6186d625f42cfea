//! First light of extended things: when light begins to arrive, with its standard deviation.
//!
//! A hidden surface returns light from its nearest point on. How its rate begins depends on where the surface ends
//! near that point: [`Ends`]. Where it does not, the rate is a step; its limits are a square root where the nearest
//! point lies on an edge, and a ramp where it is a corner. In a window about the first return `tau` the model of the
//! bin at `t` is
//!
//! ```text
//! background + height F(t - tau) + slope G(t - tau),    F(t) = integral over u > 0 of share(u) h(t - u)
//! ```
//!
//! with the response `h`, and `G` as `F` with `u share(u)`, `u` in units of the response's width ([`Rises`]). The four
//! unknowns are fitted by maximum likelihood with Fisher scoring. The standard deviation of `tau` is that with the
//! other three free; the slope has a prior, which the decline of light over the surface sets.
//!
//! One histogram seldom shows where its surface ends. Whoever joins first returns of neighbours knows, and times them
//! again ([`Window::first_return`]).

mod background;
mod early;
mod law;
mod rise;

pub use background::Background;
pub use early::{Early, earlier_light};
pub use law::{CORNER, EDGE, Ends, Face, Rise, Rises, STEP};
pub use rise::first_rise;

use super::response::Response;

/// Full width at half maximum of a Gaussian, in standard deviations.
const FWHM: f64 = 2.354_820_045_030_949_3;
/// Window before and behind the first return, in standard deviations of the response.
const BEFORE: f64 = 6.0;
const BEHIND: f64 = 3.0;
/// Behind a rise no window ends later: its first return is looked for from there, a few times.
const AFTER: f64 = BEHIND + TURNS as f64 * FARTHEST;
/// Decline of light from a ring, as a power of its time: the inverse fourth power of the distance and cosines at the
/// surface and at the wall, less the growth of the ring. It is the slope over the height before there is light.
const DECLINE: f64 = 6.0;
/// How far the mean slope over the height of a surface may be off that, for each standard deviation of the response.
const DECLINE_SD: f64 = 0.05;
/// Standard deviation of the slope over the height, for each standard deviation of the response.
const SLOPE_SD: f64 = 0.1;
/// Fisher steps, halvings of a step, and turns of the window about its first return.
const STEPS: usize = 30;
const HALVINGS: i32 = 10;
const TURNS: usize = 4;
/// Gain of a step, in logarithms of the likelihood, that ends the fit.
const DONE: f64 = 1e-3;
/// Least number of bins in the window.
const LEAST: usize = 8;
/// Farthest step of the first return from its start, in standard deviations of the response.
const FARTHEST: f64 = 4.0;
/// Samples of a response across its width.
const SAMPLES: f64 = 40.0;

impl Rises {
    /// From the response at `first_ps`, `first_ps + step_ps`... behind the arrival of light, on any scale; its full
    /// width at half maximum; and the width of a bin.
    ///
    /// # Panics
    /// If the response has no positive sum, or a width or step is not positive.
    #[must_use]
    pub fn new(grid_ps: [f64; 2], response: &[f64], [width_ps, bin_ps]: [f64; 2]) -> Self {
        let sigma_ps = width_ps / FWHM;
        Self::over(grid_ps, response, [sigma_ps, bin_ps], (BEHIND + 2.0 * FARTHEST) * sigma_ps)
    }

    /// Behind a response of some width, for bins of this width.
    ///
    /// # Panics
    /// If the response has no positive sum, or a width is not positive.
    #[must_use]
    pub fn behind(response: &Response, [width_ps, bin_ps]: [f64; 2]) -> Self {
        let step_ps = width_ps / SAMPLES;
        let (first_ps, end_ps) = response.support_ps();
        let count = ((end_ps - first_ps) / step_ps).ceil() as usize + 1;
        let value = |n: usize| response.value(first_ps + n as f64 * step_ps).max(0.0);
        let values: Vec<f64> = (0..count).map(value).collect();
        Self::new([first_ps, step_ps], &values, [width_ps, bin_ps])
    }
}

/// How values vary about their means.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Noise {
    /// Photon counts.
    Counts,
    /// Independent Gaussian noise.
    Gauss {
        /// Standard deviation of a value.
        sd: f64,
    },
}

/// Values of a histogram.
#[derive(Clone, Copy, Debug)]
pub struct Bins<'a> {
    /// Middle of the first bin.
    pub first_ps: f64,
    /// Width of a bin.
    pub dt_ps: f64,
    /// Counts, or levels.
    pub values: &'a [f64],
    /// Their noise.
    pub noise: Noise,
}

impl Bins<'_> {
    /// Those about a rise that [`Background::before`] and windows take.
    #[must_use]
    pub fn about(&self, rise_ps: f64, sigma_ps: f64) -> Self {
        let place = |ps: f64| ((ps - self.first_ps) / self.dt_ps).max(0.0) as usize;
        let to = (place(rise_ps + AFTER * sigma_ps) + 1).min(self.values.len());
        let from = place(rise_ps - background::FROM * sigma_ps).saturating_sub(1).min(to);
        Self { first_ps: self.first_ps + from as f64 * self.dt_ps, values: &self.values[from..to], ..*self }
    }
}

/// Bins, or cells, of a width.
fn wide(width_ps: f64, dt_ps: f64) -> usize {
    ((width_ps / dt_ps).round() as usize).max(1)
}

/// A first return under one law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FirstReturn {
    /// When light begins.
    pub time_ps: f64,
    /// Its standard deviation, with height, slope and background free.
    pub sd_ps: f64,
    /// Light of a bin where whole rings are lit.
    pub height: f64,
    /// Standard deviation of an error that histograms of one surface have in common: of light that declines otherwise
    /// than thought, and the bias of the likeliest time of weak light, which grows as the square of its standard
    /// deviation (Cox and Snell, Journal of the Royal Statistical Society B 30:248, 1968).
    pub common_ps: f64,
    /// Logarithm of the likelihood, with the prior of the slope; laws compare, since they share their bins.
    pub log_likelihood: f64,
}

/// Bins about a first return. Likelihoods of laws in it compare.
#[derive(Clone, Debug)]
pub struct Window<'a> {
    all: Bins<'a>,
    bins: Bins<'a>,
    rises: &'a Rises,
    background: Background,
    /// Background of each bin over that at the start.
    before: Vec<f64>,
    start_ps: f64,
    /// Least background.
    least: f64,
    /// The fit of a step. Fits with a given time start from there.
    step: Option<Likelihood>,
}

/// First return, background, height, slope.
type Unknowns = [f64; 4];

/// Logarithm of the likelihood at some unknowns, its gradient, and the lower half of the information.
#[derive(Clone, Debug)]
struct Likelihood {
    unknowns: Unknowns,
    logarithm: f64,
    gradient: Unknowns,
    information: [Unknowns; 4],
}

impl<'a> Window<'a> {
    /// About the first return near a time; `None` where there is none.
    #[must_use]
    pub fn about(bins: &Bins<'a>, rises: &'a Rises, background: Background, start_ps: f64) -> Option<Self> {
        let law = rises.first();
        let mut window = Self::new(bins, rises, background, start_ps)?;
        let mut step = window.fit(law, window.start(law), None)?;
        for _ in 0..TURNS {
            let [time_ps, ..] = step.unknowns;
            if (time_ps - window.start_ps).abs() < bins.dt_ps {
                break;
            }
            window = Self::new(bins, rises, background, time_ps)?;
            step = window.fit(law, window.start(law), None)?;
        }
        window.step = Some(step);
        Some(window)
    }

    /// The likeliest first return of such a surface; `None` where the bins do not determine it.
    #[must_use]
    pub fn first_return(&self, faces: &[Face]) -> Option<FirstReturn> {
        self.likeliest(&self.rises.law(faces, f64::INFINITY))
    }

    /// Those of a step, an edge and a corner.
    #[must_use]
    pub fn first_returns(&self) -> [Option<FirstReturn>; 3] {
        let [_, edge, corner] = self.rises.limits();
        let step = self.step.as_ref().and_then(|step| self.first_return_of(step, None));
        [step, self.likeliest(edge), self.likeliest(corner)]
    }

    /// Of each of these surfaces, one step of Fisher scoring from a time that others tell, all else being fitted there:
    /// less biased than the likeliest time where counts are few, and joined with others the likeliest again. The
    /// likeliest where the step is wider than half the response.
    #[must_use]
    pub fn first_returns_near(&self, laws: &[Vec<Face>], time_ps: f64) -> Vec<Option<FirstReturn>> {
        let near = Self::new(&self.all, self.rises, self.background, time_ps);
        let mut start = self.step.as_ref().map(|step| step.unknowns);
        let mut of = |faces: &Vec<Face>| {
            let window = near.as_ref()?;
            let law = self.rises.law(faces, window.end_ps() - time_ps);
            let fit = window.fit(&law, start.unwrap_or_else(|| window.start(&law)), Some(time_ps))?;
            // Laws differ little: what one was fitted with is next to what others are.
            start = Some(fit.unknowns);
            let first = window.first_return_of(&fit, Some(time_ps))?;
            Some(first).filter(|first| (first.time_ps - time_ps).abs() < self.rises.sigma_ps())
        };
        laws.iter().map(|faces| of(faces).or_else(|| self.first_return(faces))).collect()
    }

    fn likeliest(&self, law: &Rise) -> Option<FirstReturn> {
        self.first_return_of(&self.fit(law, self.start(law), None)?, None)
    }

    fn end_ps(&self) -> f64 {
        self.bins.first_ps + self.bins.values.len() as f64 * self.bins.dt_ps
    }

    fn new(bins: &Bins<'a>, rises: &'a Rises, background: Background, start_ps: f64) -> Option<Self> {
        let place = |time_ps: f64| ((time_ps - bins.first_ps) / bins.dt_ps).round().max(0.0) as usize;
        let end = |sigmas: f64| place(start_ps + sigmas * rises.sigma_ps()).min(bins.values.len());
        let (from, to) = (end(-BEFORE), end(BEHIND));
        if to < from + LEAST {
            return None;
        }
        let first_ps = bins.first_ps + from as f64 * bins.dt_ps;
        let least = match bins.noise {
            Noise::Counts => 0.02 / (to - from) as f64,
            Noise::Gauss { .. } => f64::NEG_INFINITY,
        };
        let at_start = background.at(start_ps);
        let before = (from..to).map(|n| background.at(bins.first_ps + n as f64 * bins.dt_ps) / at_start).collect();
        let bins_here = Bins { first_ps, values: &bins.values[from..to], ..*bins };
        Some(Self { all: *bins, bins: bins_here, rises, background, before, start_ps, least, step: None })
    }

    /// The law in each bin where light begins at a time.
    fn law_at(&self, law: &Rise, time_ps: f64) -> Vec<[f64; 4]> {
        let first_ps = self.bins.first_ps - time_ps;
        (0..self.bins.values.len()).map(|n| law.at(first_ps + n as f64 * self.bins.dt_ps)).collect()
    }

    /// Slope over height before there is light.
    fn slope(&self) -> f64 {
        -DECLINE * self.rises.sigma_ps() / self.start_ps.max(self.rises.sigma_ps())
    }

    /// Logarithm of the likelihood, its gradient, and Fisher's information, at these unknowns, with the law by bin.
    fn likelihood(&self, law: &[[f64; 4]], unknowns: Unknowns) -> Likelihood {
        let mut likelihood = Likelihood { unknowns, logarithm: 0.0, gradient: [0.0; 4], information: [[0.0; 4]; 4] };
        let Likelihood { logarithm, gradient, information, .. } = &mut likelihood;
        let floor = 0.3 / self.bins.values.len() as f64;
        let [_, background, height, slope] = unknowns;
        for ((value, before), [light, next, rise, next_rise]) in self.bins.values.iter().zip(&self.before).zip(law) {
            let rate = background * before + height * light + slope * next;
            let slopes = [-(height * rise + slope * next_rise), *before, *light, *next];
            let (by_rate, weight) = match self.bins.noise {
                Noise::Counts => {
                    // Below the floor, where the rate may be negative, the logarithm goes on as its parabola there.
                    let mean = rate.max(floor);
                    let below = (rate - mean) / mean;
                    // Most bins of weak light are empty, and need no logarithm.
                    if *value != 0.0 {
                        *logarithm += value * (mean.ln() + below - 0.5 * below * below);
                    }
                    *logarithm -= rate;
                    (value * (1.0 - below) / mean - 1.0, 1.0 / mean)
                }
                Noise::Gauss { sd } => {
                    let score = (value - rate) / sd;
                    *logarithm -= 0.5 * score * score;
                    (score / sd, 1.0 / (sd * sd))
                }
            };
            for a in 0..4 {
                gradient[a] += by_rate * slopes[a];
                (0..=a).for_each(|b| information[a][b] += weight * slopes[a] * slopes[b]);
            }
        }
        let off = (slope / height - self.slope()) / SLOPE_SD;
        *logarithm -= 0.5 * off * off;
        let by = prior_slopes(unknowns);
        for a in 2..4 {
            gradient[a] -= off * by[a];
            (2..=a).for_each(|b| information[a][b] += by[a] * by[b]);
        }
        likelihood
    }

    fn start(&self, law: &Rise) -> Unknowns {
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
        let values = self.bins.values;
        let quiet_ps = self.start_ps - 2.0 * self.rises.sigma_ps() - self.bins.first_ps;
        let quiet = ((quiet_ps / self.bins.dt_ps) as usize).clamp(2, values.len());
        let background = mean(&values[..quiet]).max(self.least);
        let height = mean(&values[values.len() * 2 / 3..]) - background;
        let least = 1e-3 * background.abs().max(1.0);
        let [risen, ..] = law.at(0.5 * BEHIND * self.rises.sigma_ps());
        [self.start_ps, background, height.max(least) / risen.max(1e-3), 0.0]
    }

    /// The likeliest unknowns from a start; with a time that is given, the likeliest others. Where the time is free, a
    /// start from another law or window may lead astray.
    fn fit(&self, law: &Rise, mut start: Unknowns, given_ps: Option<f64>) -> Option<Likelihood> {
        start[0] = given_ps.unwrap_or(start[0]);
        let mut at = self.law_at(law, start[0]);
        let mut best = self.likelihood(&at, start);
        for _ in 0..STEPS {
            let mut information = best.information;
            if given_ps.is_some() {
                information[0][0] = f64::INFINITY;
            }
            // At its least, the background stays there while the likelihood would have it lower.
            if best.unknowns[1] <= self.least && best.gradient[1] < 0.0 {
                information[1][1] = f64::INFINITY;
            }
            let step = solve(&root(information)?, best.gradient);
            let gain: f64 = step.iter().zip(best.gradient).map(|(step, slope)| 0.5 * step * slope).sum();
            if gain < DONE {
                // So small a step needs no other look at the likelihood.
                best.unknowns.iter_mut().zip(step).for_each(|(unknown, step)| *unknown += step);
                break;
            }
            let next = (0..HALVINGS).take_while(|halving| gain * 0.5_f64.powi(*halving) > DONE).find_map(|halving| {
                let share = 0.5_f64.powi(halving);
                let mut next: Unknowns = std::array::from_fn(|a| best.unknowns[a] + share * step[a]);
                next[1] = next[1].max(self.least);
                let is_near = (next[0] - self.start_ps).abs() < FARTHEST * self.rises.sigma_ps();
                if next[2] <= 0.0 || !is_near {
                    return None;
                }
                if given_ps.is_none() {
                    at = self.law_at(law, next[0]);
                }
                Some(self.likelihood(&at, next)).filter(|next| next.logarithm > best.logarithm)
            });
            let Some(next) = next else { break };
            let is_done = next.logarithm - best.logarithm < DONE;
            best = next;
            if is_done {
                break;
            }
        }
        Some(best)
    }

    /// The first return of the likeliest unknowns; with a time that was given, one step from it.
    fn first_return_of(&self, fit: &Likelihood, given_ps: Option<f64>) -> Option<FirstReturn> {
        let root = root(fit.information)?;
        let covariances = solve(&root, [1.0, 0.0, 0.0, 0.0]);
        let [variance, ..] = covariances;
        let [time_ps, _, height, _] = fit.unknowns;
        // What the prior of the slope moves, counts against it.
        let by = prior_slopes(fit.unknowns);
        let by_slope_ps = (2..4).map(|a| covariances[a] * by[a]).sum::<f64>() / SLOPE_SD;
        let step_ps = given_ps.map_or(0.0, |_| solve(&root, fit.gradient)[0]);
        Some(FirstReturn {
            time_ps: time_ps + step_ps,
            sd_ps: variance.sqrt(),
            height,
            common_ps: (by_slope_ps * DECLINE_SD).hypot(variance / self.rises.sigma_ps()),
            log_likelihood: fit.logarithm,
        })
    }
}

/// By how many standard deviations of its prior the slope over the height changes with each unknown.
fn prior_slopes([_, _, height, slope]: Unknowns) -> Unknowns {
    [0.0, 0.0, -slope / (height * height * SLOPE_SD), 1.0 / (height * SLOPE_SD)]
}

/// Lower Cholesky factor of a matrix whose lower half is given; `None` where it is not positive definite.
fn root(mut matrix: [Unknowns; 4]) -> Option<[Unknowns; 4]> {
    for a in 0..4 {
        for b in 0..=a {
            let rest = matrix[a][b] - (0..b).map(|c| matrix[a][c] * matrix[b][c]).sum::<f64>();
            if a != b {
                matrix[a][b] = rest / matrix[b][b];
            } else if rest > 0.0 {
                matrix[a][a] = rest.sqrt();
            } else {
                return None;
            }
        }
    }
    Some(matrix)
}

fn solve(root: &[Unknowns; 4], mut right: Unknowns) -> Unknowns {
    for a in 0..4 {
        right[a] = (right[a] - (0..a).map(|b| root[a][b] * right[b]).sum::<f64>()) / root[a][a];
    }
    for a in (0..4).rev() {
        right[a] = (right[a] - (a + 1..4).map(|b| root[b][a] * right[b]).sum::<f64>()) / root[a][a];
    }
    right
}

#[cfg(test)]
mod tests;
