//! A window about a first return: the likeliest time, background, height and slopes in it.

use super::{BEHIND, Background, Bins, FARTHEST, Face, FirstReturn, Noise, Rise, Rises, TURNS};

/// How far a window reaches before the first return, in standard deviations of the response.
const BEFORE: f64 = 6.0;
/// Decline of light from a ring, as a power of its time: the inverse fourth power of the distance and cosines at the
/// surface and at the wall, less the growth of the ring. It is the slope over the height before there is light.
const DECLINE: f64 = 6.0;
/// How far the mean slope over the height of a surface may be off that, for each standard deviation of the response.
const DECLINE_SD: f64 = 0.05;
/// Standard deviation of the slope over the height, for each standard deviation of the response.
const SLOPE_SD: f64 = 0.1;
/// How far light of nearer things bends from a steady decline: half of its second derivative over itself, in units of
/// the response's standard deviation. Things are told apart from ten of these on, and their light changes over so much.
const BEND_SD: f64 = 0.005;
/// Light of what lies between two things may grow before that of the farther one begins, which makes it early: by so
/// much, in standard deviations of the response.
const EARLY_SD: f64 = 0.3;
/// Fisher steps, and halvings of a step.
const STEPS: usize = 30;
const HALVINGS: i32 = 10;
/// Gain of a step, in logarithms of the likelihood, that ends the fit.
const DONE: f64 = 1e-3;
/// Least number of bins in the window.
const LEAST: usize = 8;

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
    order: Order,
    /// Least background.
    least: f64,
    /// The fit of a step. Fits with a given time start from there.
    step: Option<Likelihood>,
}

/// Whether what begins to shine is the first thing that does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Order {
    First,
    /// Over the light of what is nearer.
    Later,
}

/// First return, background, height, slope, and the slope of the background: of later returns alone.
type Unknowns = [f64; MOST];

const MOST: usize = 5;

/// Logarithm of the likelihood at some unknowns, its gradient, and the lower half of the information.
#[derive(Clone, Debug)]
struct Likelihood {
    unknowns: Unknowns,
    logarithm: f64,
    gradient: Unknowns,
    information: [Unknowns; MOST],
}

impl<'a> Window<'a> {
    /// About the first return near a time; `None` where there is none.
    #[must_use]
    pub fn about(bins: &Bins<'a>, rises: &'a Rises, background: Background, start_ps: f64) -> Option<Self> {
        Self::turned(bins, rises, (Order::First, background), start_ps)
    }

    /// About a later return near a time; `None` where there is none. The bins begin where what is nearer shines.
    #[must_use]
    pub fn later(bins: &Bins<'a>, rises: &'a Rises, start_ps: f64) -> Option<Self> {
        Self::turned(bins, rises, (Order::Later, Background::declining(start_ps, DECLINE)), start_ps)
    }

    /// About the likeliest time of a step.
    fn turned(bins: &Bins<'a>, rises: &'a Rises, before: (Order, Background), start_ps: f64) -> Option<Self> {
        let law = rises.first();
        let mut window = Self::new(bins, rises, before, start_ps)?;
        let mut step = window.fit(law, window.start(law), None)?;
        for _ in 0..TURNS {
            let [time_ps, ..] = step.unknowns;
            if (time_ps - window.start_ps).abs() < bins.dt_ps {
                break;
            }
            window = Self::new(bins, rises, before, time_ps)?;
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
        let step = self.step.as_ref().and_then(|step| self.first_return_of(self.rises.first(), step, None));
        [step, self.likeliest(edge), self.likeliest(corner)]
    }

    /// Of each of these surfaces, one step of Fisher scoring from a time that others tell, all else being fitted there:
    /// less biased than the likeliest time where counts are few, and joined with others the likeliest again. The
    /// likeliest where the step is wider than half the response.
    #[must_use]
    pub fn first_returns_near(&self, laws: &[Vec<Face>], time_ps: f64) -> Vec<Option<FirstReturn>> {
        let near = Self::new(&self.all, self.rises, (self.order, self.background), time_ps);
        let mut start = self.step.as_ref().map(|step| step.unknowns);
        let mut of = |faces: &Vec<Face>| {
            let window = near.as_ref()?;
            let law = self.rises.law(faces, window.end_ps() - time_ps);
            let fit = window.fit(&law, start.unwrap_or_else(|| window.start(&law)), Some(time_ps))?;
            // Laws differ little: what one was fitted with is next to what others are.
            start = Some(fit.unknowns);
            let first = window.first_return_of(&law, &fit, Some(time_ps))?;
            Some(first).filter(|first| (first.time_ps - time_ps).abs() < self.rises.sigma_ps())
        };
        laws.iter().map(|faces| of(faces).or_else(|| self.first_return(faces))).collect()
    }

    fn likeliest(&self, law: &Rise) -> Option<FirstReturn> {
        self.first_return_of(law, &self.fit(law, self.start(law), None)?, None)
    }

    fn end_ps(&self) -> f64 {
        self.bins.first_ps + self.bins.values.len() as f64 * self.bins.dt_ps
    }

    fn new(bins: &Bins<'a>, rises: &'a Rises, (order, background): (Order, Background), start_ps: f64) -> Option<Self> {
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
        Some(Self { all: *bins, bins: bins_here, rises, background, before, start_ps, order, least, step: None })
    }

    /// The law in each bin where light begins at a time.
    fn law_at(&self, law: &Rise, time_ps: f64) -> Vec<[f64; 4]> {
        let first_ps = self.bins.first_ps - time_ps;
        (0..self.bins.values.len()).map(|n| law.at(first_ps + n as f64 * self.bins.dt_ps)).collect()
    }

    /// Least rate of a bin whose logarithm is taken.
    fn floor(&self) -> f64 {
        0.3 / self.bins.values.len() as f64
    }

    /// Time of a bin behind the start, in standard deviations of the response.
    fn sigmas(&self, bin: usize) -> f64 {
        (self.bins.first_ps + bin as f64 * self.bins.dt_ps - self.start_ps) / self.rises.sigma_ps()
    }

    /// Slope over height before there is light.
    fn slope(&self) -> f64 {
        -DECLINE * self.rises.sigma_ps() / self.start_ps.max(self.rises.sigma_ps())
    }

    /// Logarithm of the likelihood, its gradient, and Fisher's information, at these unknowns, with the law by bin.
    fn likelihood(&self, law: &[[f64; 4]], unknowns: Unknowns) -> Likelihood {
        let mut likelihood = match self.order {
            Order::First => self.of_bins::<4>(law, unknowns),
            Order::Later => self.of_bins::<5>(law, unknowns),
        };
        let Likelihood { logarithm, gradient, information, .. } = &mut likelihood;
        let [_, _, height, slope, _] = unknowns;
        let off = (slope / height - self.slope()) / SLOPE_SD;
        *logarithm -= 0.5 * off * off;
        let by = prior_slopes(unknowns);
        for a in 2..4 {
            gradient[a] -= off * by[a];
            (2..=a).for_each(|b| information[a][b] += by[a] * by[b]);
        }
        likelihood
    }

    /// That of the bins, with as many unknowns.
    fn of_bins<const COUNT: usize>(&self, law: &[[f64; 4]], unknowns: Unknowns) -> Likelihood {
        let none = [[0.0; MOST]; MOST];
        let mut likelihood = Likelihood { unknowns, logarithm: 0.0, gradient: none[0], information: none };
        let Likelihood { logarithm, gradient, information, .. } = &mut likelihood;
        let floor = self.floor();
        let bins = self.bins.values.iter().zip(&self.before).zip(law).enumerate();
        for (n, ((value, before), light)) in bins {
            let behind = if COUNT == MOST { self.sigmas(n) } else { 0.0 };
            let (rate, slopes) = rate(unknowns, [*before, behind], light);
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
            for a in 0..COUNT {
                gradient[a] += by_rate * slopes[a];
                (0..=a).for_each(|b| information[a][b] += weight * slopes[a] * slopes[b]);
            }
        }
        (COUNT..MOST).for_each(|a| information[a][a] = f64::INFINITY);
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
        [self.start_ps, background, height.max(least) / risen.max(1e-3), 0.0, 0.0]
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
    fn first_return_of(&self, law: &Rise, fit: &Likelihood, given_ps: Option<f64>) -> Option<FirstReturn> {
        let root = root(fit.information)?;
        let mut one = [0.0; MOST];
        one[0] = 1.0;
        let covariances = solve(&root, one);
        let [variance, ..] = covariances;
        let [time_ps, _, height, ..] = fit.unknowns;
        // What the prior of the slope moves, counts against it.
        let by = prior_slopes(fit.unknowns);
        let by_slope_ps = (2..4).map(|a| covariances[a] * by[a]).sum::<f64>() / SLOPE_SD;
        let later_ps = match self.order {
            Order::First => 0.0,
            Order::Later => self.moved_by_bend(law, fit.unknowns, covariances).hypot(EARLY_SD * self.rises.sigma_ps()),
        };
        let step_ps = given_ps.map_or(0.0, |_| solve(&root, fit.gradient)[0]);
        Some(FirstReturn {
            time_ps: time_ps + step_ps,
            sd_ps: variance.sqrt(),
            height,
            common_ps: (by_slope_ps * DECLINE_SD).hypot(later_ps).hypot(variance / self.rises.sigma_ps()),
            log_likelihood: fit.logarithm,
        })
    }

    /// By how much a later return moves where the light of what is nearer bends by one standard deviation.
    fn moved_by_bend(&self, law: &Rise, unknowns: Unknowns, covariances: Unknowns) -> f64 {
        let [time_ps, background, ..] = unknowns;
        let of_bin = |(n, (light, before)): (usize, ([f64; 4], &f64))| {
            let behind = self.sigmas(n);
            let (rate, slopes) = rate(unknowns, [*before, behind], &light);
            let weight = match self.bins.noise {
                Noise::Counts => 1.0 / rate.max(self.floor()),
                Noise::Gauss { sd } => 1.0 / (sd * sd),
            };
            let by: f64 = slopes.iter().zip(covariances).map(|(slope, covariance)| slope * covariance).sum();
            weight * by * background * BEND_SD * behind * behind
        };
        self.law_at(law, time_ps).into_iter().zip(&self.before).enumerate().map(of_bin).sum()
    }
}

/// Rate of a bin and its slopes, from what background and its slope add there, and the law.
#[inline]
fn rate(
    [_, background, height, slope, tilt]: Unknowns,
    [before, behind]: [f64; 2],
    [light, next, rise, next_rise]: &[f64; 4],
) -> (f64, Unknowns) {
    let rate = background * before + height * light + slope * next + tilt * behind;
    (rate, [-(height * rise + slope * next_rise), before, *light, *next, behind])
}

/// By how many standard deviations of its prior the slope over the height changes with each unknown.
fn prior_slopes([_, _, height, slope, _]: Unknowns) -> Unknowns {
    [0.0, 0.0, -slope / (height * height * SLOPE_SD), 1.0 / (height * SLOPE_SD), 0.0]
}

/// Lower Cholesky factor of a matrix whose lower half is given; `None` where it is not positive definite.
fn root(mut matrix: [Unknowns; MOST]) -> Option<[Unknowns; MOST]> {
    for a in 0..MOST {
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

fn solve(root: &[Unknowns; MOST], mut right: Unknowns) -> Unknowns {
    for a in 0..MOST {
        right[a] = (right[a] - (0..a).map(|b| root[a][b] * right[b]).sum::<f64>()) / root[a][a];
    }
    for a in (0..MOST).rev() {
        right[a] = (right[a] - (a + 1..MOST).map(|b| root[b][a] * right[b]).sum::<f64>()) / root[a][a];
    }
    right
}

#[cfg(test)]
mod tests;
