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
//!
//! Another thing behind the first begins to shine while the first still does ([`rises()`]). Its first return is
//! timed over the light of what is nearer ([`Window::later`]): there the background has a slope of its own, a fifth
//! unknown.

mod background;
mod early;
mod law;
mod rise;
mod window;

pub use background::Background;
pub use early::{Early, earlier_light};
pub use law::{CORNER, EDGE, Ends, Face, Rise, Rises, STEP};
pub use rise::{first_rise, rises};
pub use window::Window;

use super::response::Response;

/// Full width at half maximum of a Gaussian, in standard deviations.
const FWHM: f64 = 2.354_820_045_030_949_3;
/// How far a window reaches behind the first return, in standard deviations of the response.
const BEHIND: f64 = 3.0;
/// Behind a rise no window ends later: its first return is looked for from there, a few times.
const AFTER: f64 = BEHIND + TURNS as f64 * FARTHEST;
/// Turns of a window about its first return, and the farthest step from its start, in standard deviations of the
/// response.
const TURNS: usize = 4;
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

    /// Those about a later rise, behind the one before it.
    #[must_use]
    pub fn about_later(&self, [before_ps, rise_ps]: [f64; 2], sigma_ps: f64) -> Self {
        let about = self.about(rise_ps, sigma_ps);
        let risen_ps = before_ps + rise::RISEN * sigma_ps;
        let from = ((risen_ps - about.first_ps) / about.dt_ps).ceil().max(0.0) as usize;
        let values = &about.values[from.min(about.values.len())..];
        Self { first_ps: about.first_ps + from as f64 * about.dt_ps, values, ..about }
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

#[cfg(test)]
mod tests;
