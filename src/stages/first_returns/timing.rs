//! Histograms of one scan in, points of the surface out.

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::cancel::Cancel;
use crate::geometry::Point;
use crate::geometry::first_return::{Face, Lit, Place, Return, Scan, SurfacePoint, surface_points};
use crate::priors::campaign_fields::Medium;
use crate::signal::edge::{self, Background, Bins, CORNER, EDGE, FirstReturn, Rises, STEP, Window};

/// What the histograms of a scan have in common.
#[derive(Clone, Copy, Debug)]
pub struct Timing<'a> {
    /// The lit points; ways between pairs are those of the histograms.
    pub lit: &'a Lit,
    /// Unit normal of the wall, towards what is hidden.
    pub inwards: Vector3<f64>,
    /// What light travels in.
    pub medium: Medium,
    /// Beginnings of light behind the response.
    pub rises: &'a Rises,
    /// Standard deviations by which light rises at its first return.
    pub threshold_sigma: f64,
}

impl Timing<'_> {
    /// Points of the surface that histograms show, each with the number of its histogram. A histogram is a seen point,
    /// or the place midway between a pair that moves together, and its bins.
    #[must_use]
    pub fn points(&self, histograms: &[(Point, Bins<'_>)], cancel: &Cancel) -> Vec<(usize, SurfacePoint)> {
        let rises = self.rises;
        let starts: Vec<(usize, f64)> = histograms
            .par_iter()
            .enumerate()
            .filter_map(|(n, (_, bins))| Some((n, edge::first_rise(bins, rises.sigma_ps(), self.threshold_sigma)?)))
            .collect();
        let before: Vec<(Bins<'_>, f64)> = starts.iter().map(|(n, start_ps)| (histograms[*n].1, *start_ps)).collect();
        let background = Background::before(&before, rises.sigma_ps());
        let timed: Vec<(usize, Window<'_>, Place)> = starts
            .par_iter()
            .filter_map(|(n, start_ps)| {
                cancel.check();
                let (seen, bins) = &histograms[*n];
                let window = Window::about(bins, rises, background, *start_ps)?;
                let [step, edge, corner] =
                    [STEP, EDGE, CORNER].map(|ends| self.returned(window.first_return(&[edge::Face::quarter(ends)])));
                Some((*n, window, Place { seen: *seen, returns: [step?, edge?, corner?] }))
            })
            .collect();
        let places = timed.iter().map(|(.., place)| *place).collect();
        let sigma_m = self.medium.path_m(rises.sigma_ps());
        let lit = match self.lit {
            Lit::Apart(halves) => Lit::Apart(timed.iter().map(|(n, ..)| halves[*n]).collect()),
            other => other.clone(),
        };
        let scan = Scan { lit, inwards: self.inwards, sigma_m, places };
        let again = |place: usize, faces: &[Face], length_m: f64| {
            let face = |face: &Face| edge::Face { weight: face.weight, ends: face.ends };
            let faces: Vec<edge::Face> = faces.iter().map(face).collect();
            self.returned(timed[place].1.first_return_near(&faces, self.medium.time_ps(length_m)))
        };
        surface_points(&scan, again, cancel).into_iter().map(|point| (timed[point.place].0, point)).collect()
    }

    /// A first return as a length.
    fn returned(&self, first: Option<FirstReturn>) -> Option<Return> {
        let FirstReturn { time_ps, sd_ps, decline_ps, log_likelihood, .. } = first?;
        let [length_m, sd_m, common_m] = [time_ps, sd_ps, decline_ps].map(|time_ps| self.medium.path_m(time_ps));
        Some(Return { length_m, sd_m, common_m, log_likelihood })
    }
}
