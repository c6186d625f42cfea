//! Histograms of one scan in, points of the surface out.

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::cancel::Cancel;
use crate::geometry::Point;
use crate::geometry::first_return::{
    Face, GROWN, Lit, Place, Return, Scan, SurfacePoint, Systematic, alike, layers, surface_points,
};
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
    /// Errors that all points of the wall share.
    pub systematic: Systematic,
}

/// What the histograms of a scan show.
#[derive(Clone, Debug)]
pub struct Shown {
    /// Points of surfaces, by histogram and rank.
    pub points: Vec<ShownPoint>,
    /// Histograms whose first light shows no point.
    pub omitted: Vec<Omitted>,
}

/// A point of a surface, and the light that shows it.
#[derive(Clone, Debug)]
pub struct ShownPoint {
    /// Number of the histogram.
    pub number: usize,
    /// 1 of first light, more of light of things behind: one more than the rises before it.
    pub rank: usize,
    /// The point.
    pub point: SurfacePoint,
}

/// A histogram whose first light shows no point of a surface.
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

/// Bins about a rise of a histogram, and what lies before the first one.
struct Rise {
    first_ps: f64,
    dt_ps: f64,
    values: Vec<f64>,
    noise: Noise,
    time_ps: f64,
    early: Option<Early>,
}

impl Rise {
    fn new(Bins { first_ps, dt_ps, values, noise }: Bins<'_>, time_ps: f64, early: Option<Early>) -> Self {
        Self { first_ps, dt_ps, values: values.to_vec(), noise, time_ps, early }
    }

    fn bins(&self) -> Bins<'_> {
        Bins { first_ps: self.first_ps, dt_ps: self.dt_ps, values: &self.values, noise: self.noise }
    }
}

/// A rise that is timed.
struct Timed<'a> {
    number: usize,
    rank: usize,
    window: Window<'a>,
    place: Place,
    /// Of the light, as of a surface without an edge near.
    height: f64,
}

impl Timing<'_> {
    /// Points of surfaces that histograms show. Each histogram is asked for once; of its bins those about its rises are
    /// kept, and sums of those before the first.
    #[must_use]
    pub fn shown<H: Histogram>(&self, count: usize, histogram: impl Fn(usize) -> H + Sync, cancel: &Cancel) -> Shown {
        let rises = |number: usize| {
            cancel.check();
            let histogram = histogram(number);
            (histogram.seen(), self.rises_of(&histogram.bins()))
        };
        let all: Vec<(Point, Vec<Rise>)> = (0..count).into_par_iter().map(rises).collect();
        let first = self.first(&all, cancel);
        let are_from_behind = self.are_from_behind(&all, &first, cancel);
        let mut light = vec![None; count];
        first.iter().for_each(|one| light[one.number] = Some(one.place.returns[0]));
        let first: Vec<Timed<'_>> = first.into_iter().filter(|one| !are_from_behind[one.number]).collect();
        let mut points = self.points(&first, 0, cancel);
        let mut is_shown = vec![false; count];
        points.iter().for_each(|point| is_shown[point.number] = true);
        points.extend(self.points_behind(self.later(&all, &are_from_behind, cancel), cancel));
        points.sort_by_key(|point| (point.number, point.rank));
        let why = |n: usize| match (all[n].1.first(), light[n]) {
            (None, _) => Why::NoRise,
            (Some(_), None) => Why::Untimed,
            _ if are_from_behind[n] => Why::EarlierLight,
            _ => Why::NoField,
        };
        let omitted = (0..count).filter(|n| !is_shown[*n]).map(|n| Omitted { number: n, why: why(n), light: light[n] });
        Shown { points, omitted: omitted.collect() }
    }

    /// The rises of a histogram, in order of time.
    fn rises_of(&self, all: &Bins<'_>) -> Vec<Rise> {
        let (sigma_ps, threshold) = (self.rises.sigma_ps(), self.threshold_sigma);
        let times_ps = edge::rises(all, sigma_ps, threshold);
        let first = times_ps.first().map(|first_ps| {
            let early = self.steepest().and_then(|_| Early::before(all, sigma_ps, *first_ps));
            Rise::new(all.about(*first_ps, sigma_ps), *first_ps, early)
        });
        let later = times_ps.windows(2).map(|both| {
            let [before_ps, later_ps] = [both[0], both[1]];
            Rise::new(all.about_later([before_ps, later_ps], sigma_ps), later_ps, None)
        });
        first.into_iter().chain(later).collect()
    }

    /// First light of the histograms that have it.
    fn first<'a>(&'a self, all: &'a [(Point, Vec<Rise>)], cancel: &Cancel) -> Vec<Timed<'a>> {
        let first = all.iter().filter_map(|(_, rises)| rises.first());
        let before: Vec<(Bins<'_>, f64)> = first.map(|rise| (rise.bins(), rise.time_ps)).collect();
        let background = Background::before(&before, self.rises.sigma_ps());
        let timed = |(number, (seen, rises)): (usize, &'a (Point, Vec<Rise>))| {
            cancel.check();
            let rise = rises.first()?;
            self.timed([number, 1], *seen, Window::about(&rise.bins(), self.rises, background, rise.time_ps)?)
        };
        all.par_iter().enumerate().filter_map(timed).collect()
    }

    /// Light of things behind: of later rises, and of the first ones of some histograms that have weaker light before.
    fn later<'a>(&'a self, all: &'a [(Point, Vec<Rise>)], are_from_behind: &[bool], cancel: &Cancel) -> Vec<Timed<'a>> {
        let timed = |(number, (seen, rises)): (usize, &'a (Point, Vec<Rise>))| {
            cancel.check();
            let hidden = usize::from(are_from_behind[number]);
            let of_rise = move |(n, rise): (usize, &'a Rise)| {
                let window = Window::later(&rise.bins(), self.rises, rise.time_ps)?;
                self.timed([number, n + 1 + hidden], *seen, window)
            };
            rises.iter().enumerate().skip(1 - hidden).filter_map(of_rise).collect::<Vec<_>>()
        };
        all.par_iter().enumerate().flat_map_iter(timed).collect()
    }

    fn timed<'a>(&self, [number, rank]: [usize; 2], seen: Point, window: Window<'a>) -> Option<Timed<'a>> {
        let first = window.first_returns();
        let height = first[0].as_ref()?.height;
        let [step, edge, corner] = first.map(|first| self.returned(first));
        let place = Place { seen, returns: [step?, edge?, corner?] };
        Some(Timed { number, rank, window, place, height })
    }

    /// Points of surfaces behind others, sheet by sheet. Windows that did not grow are no surface: in caustics, such as
    /// those of bowls, light rises too.
    fn points_behind(&self, later: Vec<Timed<'_>>, cancel: &Cancel) -> Vec<ShownPoint> {
        let light = later.iter().map(|one| (one.number, one.place.seen, one.place.returns[0].length_m));
        // Ways of pairs that move together change at both ends.
        let layers = layers(&light.collect::<Vec<_>>(), self.steepest().unwrap_or(2.0), cancel);
        let mut later: Vec<Option<Timed<'_>>> = later.into_iter().map(Some).collect();
        let of_layer = |layer: Vec<usize>| {
            let layer: Vec<Timed<'_>> = layer.into_iter().filter_map(|one| later[one].take()).collect();
            self.points(&layer, GROWN, cancel)
        };
        layers.into_iter().flat_map(of_layer).collect()
    }

    /// Points of the surfaces that light comes from, where so many places or more show them.
    fn points(&self, timed: &[Timed<'_>], least: usize, cancel: &Cancel) -> Vec<ShownPoint> {
        let lit = match self.lit {
            Lit::Apart(halves) => Lit::Apart(timed.iter().map(|one| halves[one.number]).collect()),
            other => other.clone(),
        };
        let places = timed.iter().map(|one| one.place).collect();
        let sigma_m = self.medium.path_m(self.rises.sigma_ps());
        let scan = Scan { lit, inwards: self.inwards, sigma_m, places, least };
        let points_of = |scan: &Scan, later_m: &[f64]| {
            let again = |place: usize, laws: &[Vec<Face>], length_m: f64| {
                let face = |face: &Face| edge::Face { weight: face.weight, ends: face.ends };
                let laws: Vec<Vec<edge::Face>> = laws.iter().map(|faces| faces.iter().map(face).collect()).collect();
                let near_ps = self.medium.time_ps(length_m - later_m[place]);
                let first = timed[place].window.first_returns_near(&laws, near_ps).into_iter();
                let moved = |one: Return| Return { length_m: one.length_m + later_m[place], ..one };
                first.map(|first| self.returned(first).map(moved)).collect()
            };
            surface_points(scan, again, cancel)
        };
        let shown = |point: SurfacePoint| {
            let Timed { number, rank, .. } = timed[point.place];
            ShownPoint { number, rank, point }
        };
        let mut points = points_of(&scan, &vec![0.0; timed.len()]);
        let heights: Vec<f64> = timed.iter().map(|one| one.height).collect();
        self.systematic.add(&scan, &heights, &mut points, points_of, cancel);
        points.into_iter().map(shown).collect()
    }

    /// Which histograms show light from behind: with those of their neighbours they have light before it.
    fn are_from_behind(&self, all: &[(Point, Vec<Rise>)], timed: &[Timed<'_>], cancel: &Cancel) -> Vec<bool> {
        let Some(steepest) = self.steepest() else { return vec![false; all.len()] };
        let sigma_ps = self.rises.sigma_ps();
        let mut places: Vec<(Point, Option<f64>)> = all.iter().map(|(seen, _)| (*seen, None)).collect();
        // Under whichever law it begins earliest.
        let first_m = |place: &Place| place.returns.iter().map(|one| one.length_m).fold(f64::INFINITY, f64::min);
        timed.iter().for_each(|one| places[one.number].1 = Some(first_m(&one.place)));
        let early = |n: &usize| {
            let early = all[*n].1.first()?.early.as_ref()?;
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
