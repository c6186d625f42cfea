//! First light of extended things: when light begins to arrive, with its standard deviation.
//!
//! A hidden surface returns light from its nearest point on. The rate begins as a power of the time since that first
//! return: a step where the surface faces the point of the wall, a square root where its nearest point lies on an edge,
//! a ramp where it is a corner ([`Law`]). In a window about the first return `tau` the model of the bin at `t` is
//!
//! ```text
//! background + height F_k(t - tau) + slope F_(k+1)(t - tau),    F_k(t) = integral over u > 0 of u^k h(t - u)
//! ```
//!
//! with the response `h`, and `u` in units of its width ([`Rises`]). The four unknowns are fitted by maximum likelihood
//! with Fisher scoring. The standard deviation of `tau` is that with the other three free; the slope has a prior, which
//! the decline of light over the surface sets.
//!
//! The laws are first orders. Within the window a surface ends, bends, or another one begins, and `tau` is off by up
//! to a tenth of the response's width. That error varies smoothly over the wall, and no single histogram shows it:
//! whoever joins first returns of neighbours has to count it.

/// Full width at half maximum of a Gaussian, in standard deviations.
const FWHM: f64 = 2.354_820_045_030_949_3;
/// Window before and behind the first return, in standard deviations of the response.
const BEFORE: f64 = 6.0;
const BEHIND: f64 = 3.0;
/// Slope over height before there is light, and its standard deviation.
const SLOPE: f64 = -0.08;
const SLOPE_SD: f64 = 0.1;
/// Fisher steps, halvings of a step, and turns of the window about its first return.
const STEPS: usize = 30;
const HALVINGS: usize = 10;
const TURNS: usize = 4;
/// Least number of bins in the window.
const LEAST: usize = 8;
/// Farthest step of the first return from its start, in standard deviations of the response.
const FARTHEST: f64 = 4.0;

/// Laws by which light begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Law {
    /// Of a surface that faces the point of the wall.
    Step,
    /// Of an edge: a square root.
    Edge,
    /// Of a corner: a ramp.
    Corner,
}

/// All laws, in the order of their powers.
pub const LAWS: [Law; 3] = [Law::Step, Law::Edge, Law::Corner];
/// Powers of the table: law `k` stands in column `k`, one power more two columns on.
const POWERS: [f64; 5] = [0.0, 0.5, 1.0, 1.5, 2.0];

/// Powers of the time since the first return behind a response, averaged over a bin.
#[derive(Clone, Debug)]
pub struct Rises {
    first_ps: f64,
    step_ps: f64,
    sigma_ps: f64,
    columns: Vec<[f64; 5]>,
}

impl Rises {
    /// From the response at `first_ps`, `first_ps + step_ps`... behind the arrival of light, on any scale; its full
    /// width at half maximum; and the width of a bin.
    ///
    /// # Panics
    /// If the response has no positive sum, or a width or step is not positive.
    #[must_use]
    pub fn new([first_ps, step_ps]: [f64; 2], response: &[f64], [width_ps, bin_ps]: [f64; 2]) -> Self {
        let sum: f64 = response.iter().sum();
        assert!(
            sum > 0.0 && step_ps > 0.0 && width_ps > 0.0 && bin_ps > 0.0,
            "a response with positive sum and widths"
        );
        let sigma_ps = width_ps / FWHM;
        let half = (0.5 * bin_ps / step_ps).round() as usize;
        let mean = |n: usize| {
            let places = n.saturating_sub(2 * half).min(response.len())..(n + 1).min(response.len());
            response[places].iter().sum::<f64>() / ((2 * half + 1) as f64 * sum)
        };
        let averaged: Vec<f64> = (0..response.len() + 2 * half).map(mean).collect();
        let first_ps = first_ps - half as f64 * step_ps;
        let reach_ps = (BEHIND + 2.0 * FARTHEST) * sigma_ps;
        let count = ((reach_ps - first_ps) / step_ps).ceil().max(1.0) as usize + 2;
        // The integral of each power over a step.
        let unit = sigma_ps / step_ps;
        let integrals = |n: usize| {
            POWERS.map(|power| {
                let up_to = |place: f64| (place.max(0.0) / unit).powf(power + 1.0) / (power + 1.0);
                (up_to(n as f64 + 0.5) - up_to(n as f64 - 0.5)) * unit
            })
        };
        let integrals: Vec<[f64; 5]> = (0..count).map(integrals).collect();
        let column = |at: usize| {
            let mut sums = [0.0; 5];
            for (n, value) in averaged.iter().enumerate().take(at + 1) {
                sums.iter_mut().zip(integrals[at - n]).for_each(|(sum, integral)| *sum += value * integral);
            }
            sums
        };
        Self { first_ps, step_ps, sigma_ps, columns: (0..count).map(column).collect() }
    }

    /// Standard deviation of a Gaussian as wide as the response.
    #[must_use]
    pub fn sigma_ps(&self) -> f64 {
        self.sigma_ps
    }

    /// A law and one power more at a time behind the first return, and their slopes by time.
    fn at(&self, law: Law, time_ps: f64) -> [f64; 4] {
        let place = (time_ps - self.first_ps) / self.step_ps;
        if place < 0.0 {
            return [0.0; 4];
        }
        let left = (place as usize).min(self.columns.len() - 2);
        let (a, b, share) = (&self.columns[left], &self.columns[left + 1], place - left as f64);
        let [k, next] = [law as usize, law as usize + 2];
        let value = |k: usize| a[k] + share * (b[k] - a[k]);
        [value(k), value(next), (b[k] - a[k]) / self.step_ps, (b[next] - a[next]) / self.step_ps]
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

/// A first return under one law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FirstReturn {
    /// When light begins.
    pub time_ps: f64,
    /// Its standard deviation, with height, slope and background free.
    pub sd_ps: f64,
    /// Height of the law in a bin, a width of the response behind its begin.
    pub height: f64,
    /// Logarithm of the likelihood, with the prior of the slope; laws compare, since they share their bins.
    pub log_likelihood: f64,
}

/// About when light first rises above what lies before it, by at least `threshold` standard deviations; `None` where
/// it does not.
#[must_use]
pub fn first_rise(bins: &Bins<'_>, sigma_ps: f64, threshold: f64) -> Option<f64> {
    let mut sums = Vec::with_capacity(bins.values.len() + 1);
    sums.push(0.0);
    bins.values.iter().for_each(|value| sums.push(sums[sums.len() - 1] + value));
    let wide = |sigmas: f64| ((sigmas * sigma_ps / bins.dt_ps).round() as usize).max(1);
    let (before, gap, behind) = (wide(5.0), wide(1.0), wide(2.5));
    let score = |at: usize| {
        let [from, to] = [at.saturating_sub(before + gap), at.saturating_sub(gap)];
        if to <= from + gap || at + behind >= sums.len() {
            return f64::NEG_INFINITY;
        }
        let (quiet, light) = (sums[to] - sums[from], sums[at + behind] - sums[at]);
        let ratio = behind as f64 / (to - from) as f64;
        let variance = match bins.noise {
            Noise::Counts => (ratio * (quiet + light)).max(ratio),
            Noise::Gauss { sd } => sd * sd * behind as f64 * (1.0 + ratio),
        };
        (light - ratio * quiet) / variance.sqrt()
    };
    let last = bins.values.len().saturating_sub(behind);
    let start = (0..last).find(|at| score(*at) > threshold)?;
    // Strong light exceeds the threshold long before it has risen: on to where the score rises no more.
    let largest = |from: usize| (from..(from + wide(3.0)).min(last)).max_by(|a, b| score(*a).total_cmp(&score(*b)));
    let mut best = start;
    while let Some(next) = largest(best).filter(|next| *next > best) {
        best = next;
    }
    Some(bins.first_ps + (best as f64 - 0.5) * bins.dt_ps + 0.5 * sigma_ps)
}

/// The likeliest first return under each law of [`LAWS`], near a time, on the same bins; `None` where one has none.
#[must_use]
pub fn fit(bins: &Bins<'_>, rises: &Rises, start_ps: f64) -> Option<[FirstReturn; 3]> {
    let mut window = Window::new(bins, rises, start_ps)?;
    for _ in 0..TURNS {
        let step = window.fit(Law::Step)?;
        if (step.time_ps - window.start_ps).abs() < bins.dt_ps {
            break;
        }
        window = Window::new(bins, rises, step.time_ps)?;
    }
    let [step, edge, corner] = LAWS.map(|law| window.fit(law));
    Some([step?, edge?, corner?])
}

/// Bins about a first return.
struct Window<'a> {
    bins: Bins<'a>,
    rises: &'a Rises,
    start_ps: f64,
    /// Least background.
    least: f64,
}

/// First return, background, height, slope.
type Unknowns = [f64; 4];

impl<'a> Window<'a> {
    fn new(bins: &Bins<'a>, rises: &'a Rises, start_ps: f64) -> Option<Self> {
        let place = |time_ps: f64| ((time_ps - bins.first_ps) / bins.dt_ps).round().max(0.0) as usize;
        let end = |sigmas: f64| place(start_ps + sigmas * rises.sigma_ps).min(bins.values.len());
        let (from, to) = (end(-BEFORE), end(BEHIND));
        if to < from + LEAST {
            return None;
        }
        let first_ps = bins.first_ps + from as f64 * bins.dt_ps;
        let least = match bins.noise {
            Noise::Counts => 0.02 / (to - from) as f64,
            Noise::Gauss { .. } => f64::NEG_INFINITY,
        };
        Some(Self { bins: Bins { first_ps, values: &bins.values[from..to], ..*bins }, rises, start_ps, least })
    }

    /// Rate of a bin and its slopes by the unknowns.
    fn rate(&self, law: Law, [tau, background, height, slope]: Unknowns, n: usize) -> (f64, Unknowns) {
        let time_ps = self.bins.first_ps + n as f64 * self.bins.dt_ps - tau;
        let [value, next, rise, next_rise] = self.rises.at(law, time_ps);
        let rate = background + height * value + slope * next;
        (rate, [-(height * rise + slope * next_rise), 1.0, value, next])
    }

    fn log_likelihood(&self, law: Law, unknowns: Unknowns) -> f64 {
        let of_bin = |(n, value): (usize, &f64)| {
            let (rate, _) = self.rate(law, unknowns, n);
            match self.bins.noise {
                Noise::Counts => value * rate.max(1e-9).ln() - rate.max(1e-9),
                Noise::Gauss { sd } => -0.5 * ((value - rate) / sd).powi(2),
            }
        };
        let prior = ((unknowns[3] / unknowns[2] - SLOPE) / SLOPE_SD).powi(2);
        self.bins.values.iter().enumerate().map(of_bin).sum::<f64>() - 0.5 * prior
    }

    /// Root of the information and gradient of the likelihood.
    fn information(&self, law: Law, unknowns: Unknowns) -> Option<([Unknowns; 4], Unknowns)> {
        let (mut information, mut gradient) = ([[0.0; 4]; 4], [0.0; 4]);
        let floor = 0.3 / self.bins.values.len() as f64;
        for (n, value) in self.bins.values.iter().enumerate() {
            let (rate, slopes) = self.rate(law, unknowns, n);
            let weight = match self.bins.noise {
                Noise::Counts => 1.0 / rate.max(floor),
                Noise::Gauss { sd } => 1.0 / (sd * sd),
            };
            for a in 0..4 {
                gradient[a] += (value - rate) * weight * slopes[a];
                (0..=a).for_each(|b| information[a][b] += weight * slopes[a] * slopes[b]);
            }
        }
        let prior = (SLOPE_SD * unknowns[2]).powi(-2);
        information[3][3] += prior;
        gradient[3] -= prior * (unknowns[3] - SLOPE * unknowns[2]);
        Some((root(information)?, gradient))
    }

    fn start(&self) -> Unknowns {
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
        let values = self.bins.values;
        let quiet_ps = self.start_ps - 2.0 * self.rises.sigma_ps - self.bins.first_ps;
        let quiet = ((quiet_ps / self.bins.dt_ps) as usize).clamp(2, values.len());
        let background = mean(&values[..quiet]).max(self.least);
        let height = mean(&values[values.len() * 2 / 3..]) - background;
        let least = 1e-3 * background.abs().max(1.0);
        [self.start_ps, background, height.max(least), 0.0]
    }

    fn fit(&self, law: Law) -> Option<FirstReturn> {
        let mut unknowns = self.start();
        let mut now = self.log_likelihood(law, unknowns);
        for _ in 0..STEPS {
            let (root, gradient) = self.information(law, unknowns)?;
            let step = solve(&root, gradient);
            let next = (0..HALVINGS).find_map(|halving| {
                let share = 0.5_f64.powi(halving as i32);
                let mut next: Unknowns = std::array::from_fn(|a| unknowns[a] + share * step[a]);
                next[1] = next[1].max(self.least);
                let is_near = (next[0] - self.start_ps).abs() < FARTHEST * self.rises.sigma_ps;
                let then = (next[2] > 0.0 && is_near).then(|| self.log_likelihood(law, next))?;
                (then > now).then_some((next, then))
            });
            let Some((next, then)) = next else { break };
            let is_done = then - now < 1e-6;
            (unknowns, now) = (next, then);
            if is_done {
                break;
            }
        }
        let (root, _) = self.information(law, unknowns)?;
        let variance = solve(&root, [1.0, 0.0, 0.0, 0.0])[0];
        let [time_ps, _, height, _] = unknowns;
        Some(FirstReturn { time_ps, sd_ps: variance.sqrt(), height, log_likelihood: now })
    }
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
