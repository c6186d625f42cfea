//! Histograms of one scan in, points of the surface out.

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::cancel::Cancel;
use crate::geometry::Point;
use crate::geometry::first_return::{Face, Lit, Place, Return, Scan, SurfacePoint, alike, surface_points};
use crate::priors::campaign_fields::Medium;
use crate::signal::edge::{self, Background, Bins, Early, FirstReturn, Noise, Rises, Window};

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

/// What the histograms of a scan show.
#[derive(Clone, Debug)]
pub struct Shown {
    /// Points of the surface, each with the number of its histogram.
    pub points: Vec<(usize, SurfacePoint)>,
    /// The other histograms.
    pub omitted: Vec<Omitted>,
}

/// A histogram that shows no point of the surface.
#[derive(Clone, Copy, Debug)]
pub struct Omitted {
    /// Its number.
    pub number: usize,
    /// Why it shows none.
    pub why: Why,
    /// Light that was found, as of a surface without an edge near.
    pub light: Option<Return>,
}

/// Why a histogram shows no point of the surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Why {
    /// No light rises by the threshold.
    NoRise,
    /// The bins do not determine when light begins.
    Untimed,
    /// With the histograms of its neighbours there is light before it.
    EarlierLight,
    /// Neighbours do not agree on one surface, or are too few.
    NoField,
}

/// A histogram of a scan.
pub trait Histogram {
    /// The seen point, or the place midway between a pair that moves together.
    fn seen(&self) -> Point;
    /// Its bins.
    fn bins(&self) -> Bins<'_>;
}

impl Histogram for (Point, Bins<'_>) {
    fn seen(&self) -> Point {
        self.0
    }

    fn bins(&self) -> Bins<'_> {
        self.1
    }
}

/// Bins about the first rise of a histogram, and what lies before it.
struct Rise {
    first_ps: f64,
    dt_ps: f64,
    values: Vec<f64>,
    noise: Noise,
    time_ps: f64,
    early: Option<Early>,
}

impl Rise {
    fn bins(&self) -> Bins<'_> {
        Bins { first_ps: self.first_ps, dt_ps: self.dt_ps, values: &self.values, noise: self.noise }
    }
}

impl Timing<'_> {
    /// Points of the surface that histograms show. Each histogram is asked for once; of its bins those about its first
    /// rise are kept, and sums of those before.
    #[must_use]
    pub fn shown<H: Histogram>(&self, count: usize, histogram: impl Fn(usize) -> H + Sync, cancel: &Cancel) -> Shown {
        let rises = self.rises;
        let rise = |number: usize| {
            cancel.check();
            let histogram = histogram(number);
            let all = histogram.bins();
            let rise_ps = edge::first_rise(&all, rises.sigma_ps(), self.threshold_sigma);
            let about = |rise_ps| {
                let Bins { first_ps, dt_ps, values, noise } = all.about(rise_ps, rises.sigma_ps());
                let early = self.steepest().and_then(|_| Early::before(&all, rises.sigma_ps(), rise_ps));
                Rise { first_ps, dt_ps, values: values.to_vec(), noise, time_ps: rise_ps, early }
            };
            (histogram.seen(), rise_ps.map(about))
        };
        let all: Vec<(Point, Option<Rise>)> = (0..count).into_par_iter().map(rise).collect();
        let shown = all.iter().filter_map(|(_, rise)| rise.as_ref());
        let before: Vec<(Bins<'_>, f64)> = shown.map(|rise| (rise.bins(), rise.time_ps)).collect();
        let background = Background::before(&before, rises.sigma_ps());
        let mut timed: Vec<(usize, Window<'_>, Place)> = all
            .par_iter()
            .enumerate()
            .filter_map(|(n, (seen, rise))| {
                cancel.check();
                let rise = rise.as_ref()?;
                let window = Window::about(&rise.bins(), rises, background, rise.time_ps)?;
                let [step, edge, corner] = window.first_returns().map(|first| self.returned(first));
                Some((n, window, Place { seen: *seen, returns: [step?, edge?, corner?] }))
            })
            .collect();
        let are_from_behind = self.are_from_behind(&all, &timed, cancel);
        let mut light = vec![None; count];
        timed.iter().for_each(|(n, _, place)| light[*n] = Some(place.returns[0]));
        timed.retain(|(n, ..)| !are_from_behind[*n]);
        let places = timed.iter().map(|(.., place)| *place).collect();
        let sigma_m = self.medium.path_m(rises.sigma_ps());
        let lit = match self.lit {
            Lit::Apart(halves) => Lit::Apart(timed.iter().map(|(n, ..)| halves[*n]).collect()),
            other => other.clone(),
        };
        let scan = Scan { lit, inwards: self.inwards, sigma_m, places };
        let again = |place: usize, laws: &[Vec<Face>], length_m: f64| {
            let face = |face: &Face| edge::Face { weight: face.weight, ends: face.ends };
            let laws: Vec<Vec<edge::Face>> = laws.iter().map(|faces| faces.iter().map(face).collect()).collect();
            let first = timed[place].1.first_returns_near(&laws, self.medium.time_ps(length_m));
            first.into_iter().map(|first| self.returned(first)).collect()
        };
        let points = surface_points(&scan, again, cancel).into_iter().map(|point| (timed[point.place].0, point));
        let points: Vec<(usize, SurfacePoint)> = points.collect();
        let why = |n: usize| match (&all[n].1, light[n]) {
            (None, _) => Why::NoRise,
            (Some(_), None) => Why::Untimed,
            _ if are_from_behind[n] => Why::EarlierLight,
            _ => Why::NoField,
        };
        let mut is_shown = vec![false; count];
        points.iter().for_each(|(n, _)| is_shown[*n] = true);
        let omitted = (0..count).filter(|n| !is_shown[*n]).map(|n| Omitted { number: n, why: why(n), light: light[n] });
        Shown { points, omitted: omitted.collect() }
    }

    /// Which histograms show light from behind: with those of their neighbours they have light before it.
    fn are_from_behind(
        &self,
        all: &[(Point, Option<Rise>)],
        timed: &[(usize, Window<'_>, Place)],
        cancel: &Cancel,
    ) -> Vec<bool> {
        let Some(steepest) = self.steepest() else { return vec![false; all.len()] };
        let sigma_ps = self.rises.sigma_ps();
        let mut places: Vec<(Point, Option<f64>)> = all.iter().map(|(seen, _)| (*seen, None)).collect();
        // Under whichever law it begins earliest.
        let first_m = |place: &Place| place.returns.iter().map(|one| one.length_m).fold(f64::INFINITY, f64::min);
        timed.iter().for_each(|(n, _, place)| places[*n].1 = Some(first_m(place)));
        let early = |n: &usize| {
            let early = all[*n].1.as_ref()?.early.as_ref()?;
            Some((early, self.medium.time_ps(places[*n].1?)))
        };
        let is_from_behind = |neighbours: &Vec<usize>| {
            cancel.check();
            let early: Vec<(&Early, f64)> = neighbours.iter().filter_map(early).collect();
            edge::earlier_light(&early, sigma_ps) > self.threshold_sigma
        };
        alike(&places, steepest, self.medium.path_m(sigma_ps), cancel).par_iter().map(is_from_behind).collect()
    }

    /// The most that lengths change over the wall; `None` of pairs, where they change with the ways too.
    fn steepest(&self) -> Option<f64> {
        match self.lit {
            Lit::Same => Some(2.0),
            Lit::One(_) => Some(1.0),
            Lit::Apart(_) => None,
        }
    }

    /// A first return as a length.
    fn returned(&self, first: Option<FirstReturn>) -> Option<Return> {
        let FirstReturn { time_ps, sd_ps, common_ps, log_likelihood, .. } = first?;
        let [length_m, sd_m, common_m] = [time_ps, sd_ps, common_ps].map(|time_ps| self.medium.path_m(time_ps));
        Some(Return { length_m, sd_m, common_m, log_likelihood })
    }
}
