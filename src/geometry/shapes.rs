//! What smooth points of hidden surfaces lie on: planes, spheres, cylinders.
//!
//! A point of a wall that is lit and seen itself has its first light from the nearest point of a surface. So the length
//! of first light is the distance to a plane, to a line or to a point less a radius. Shapes are fitted to these
//! lengths, not to points: lengths are what was measured, and errors of points across the line of sight are many times
//! larger.
//!
//! | module | does |
//! |---|---|
//! | `core` | a shape, and the distance from a place of the wall to it |
//! | `errors` | errors of lengths: noise, what neighbours have in common, what all have in common |
//! | `grow` | which places see a shape first |
//!
//! A shape grows from a few neighbouring places by those that it predicts. The one that explains most places is taken
//! first, then the same with the rest. Its kind is the likeliest one on the places that it explains, by marginal
//! likelihoods under the full covariance. A shape is reported only if its kind is much likelier than any other, if its
//! lengths are those that their errors allow, if the surface does not go on smoothly where the shape no longer follows
//! it, if no smooth departure from it is much likelier, and if a surface that is bent otherwise than a sphere or a
//! cylinder is much less likely: bent surfaces are explained piece by piece by any of these shapes, and are none of
//! them.
//!
//! Source: consensus as in Fischler and Bolles, Commun. ACM 24:381, 1981, from evenly spread starts in place of random
//! ones; evidence by Laplace's method, MacKay, Neural Comput. 4:415, 1992.
//!
//! Only places whose point is known to be smooth count. Straight edges and corners are lines and points without a
//! radius, but errors of their law of first light are not known well enough: fitted so, 0.3 to 0.9 of them lay within
//! their ellipsoids of 95 %.
//!
//! Not modelled: lit points apart from the seen ones, spheres and cylinders that are concave towards the wall, where
//! planes end, shapes that are known to be parallel or to meet.

mod core;
mod errors;
mod grow;

#[cfg(test)]
pub(crate) mod tests;

use faer::Mat;
use nalgebra::{Matrix3, Vector3};
use periscope_cancel::Cancel;

use self::core::{Core, Covariance, UNKNOWNS, Unknowns};
use super::Point;
use super::dense::Definite;
use super::first_return::{FirstLight, Kind as Part};
use super::median::median;
use errors::{Errors, Smooth};
use grow::Wall;

/// Logarithm of how much likelier a kind is than the next one.
const SURE: f64 = 3.0;
/// By how much the curvature of lengths may be otherwise than that of a sphere or a cylinder, over one over the
/// distance. Either is reported where it is surely likelier than a surface with such a departure: lengths of a small
/// piece of a bent surface show no difference, nor those of a narrow one across it.
const BENT: f64 = 0.1;
/// Logarithm of how much likelier a smooth departure may be. One that is likelier by less widens the errors.
const DEPARTS: f64 = 5.0;
/// Standard deviations of departures that are tried, over the median error of the law.
const DEPARTURES: [f64; 5] = [0.5, 1.0, 2.0, 4.0, 8.0];
/// Of the variance of the law's error, the share that changes slowly over all that shows a shape, since obliqueness and
/// distance change so too, and the share that changes over half of the zone: edges and marks of a surface pass.
const SLOW: f64 = 0.25;
const ROUGH: f64 = 0.25;
/// Factors by which noise may be larger than was thought.
const SCATTERS: [f64; 4] = [1.0, 1.4, 2.0, 2.8];
/// Normal score of chi-square beyond which lengths are not explained: 1 of 1,000.
const EXPLAINED: f64 = 3.1;
/// Least places of a shape.
const LEAST: usize = 24;
/// Rounds of least squares with the full covariance, and the step in standard deviations, squared, that ends them.
const ROUNDS: usize = 15;
const DONE: f64 = 1e-4;
/// Places among which kinds are distinguished, evenly over all.
const ENOUGH: usize = 600;

/// What a surface is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// All places with one distance along its normal.
    Plane,
    /// A middle and a radius.
    Sphere,
    /// A straight axis and a radius.
    Cylinder,
}

impl Kind {
    const ALL: [Self; 3] = [Self::Plane, Self::Sphere, Self::Cylinder];

    fn has_radius(self) -> bool {
        self != Self::Plane
    }
}

/// First light at a place of the wall, and the point of a surface that it comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// The place of the wall, lit and seen.
    pub seen: Point,
    /// First light.
    pub light: FirstLight,
    /// The point.
    pub point: Point,
    /// Its covariance.
    pub covariance_m2: Matrix3<f64>,
    /// What part of a surface the lengths of neighbours show it to be.
    pub part: Part,
    /// Probability that its light comes from edges that lengths do not show.
    pub edges: f64,
}

/// A shape that places of the wall see.
#[derive(Clone, Debug)]
pub struct Shape {
    core: Core,
    covariance: Covariance,
    /// Sightings that show it, ascending.
    pub members: Vec<usize>,
    /// Logarithm of how much likelier its kind is than the next one on these.
    pub evidence: f64,
    /// Chi-square of their lengths over its degrees of freedom, with the errors that they have in common.
    pub misfit: f64,
    /// Root of the mean square of what lengths are off.
    pub rms_m: f64,
}

impl Shape {
    /// What it is.
    #[must_use]
    pub fn kind(&self) -> Kind {
        self.core.kind
    }

    /// The middle of a sphere; of a plane and an axis the point next to the middle of the points on it.
    #[must_use]
    pub fn at(&self) -> Point {
        self.core.at
    }

    /// Normal of a plane, towards the wall; direction of a cylinder's axis. `None` for spheres.
    #[must_use]
    pub fn axis(&self) -> Option<Vector3<f64>> {
        (self.kind() != Kind::Sphere).then_some(self.core.axis)
    }

    /// Radius of a sphere or a cylinder, with its standard deviation.
    #[must_use]
    pub fn radius_m(&self) -> Option<[f64; 2]> {
        let (.., variance_m2) = self.core.covariances(&self.covariance);
        self.kind().has_radius().then_some([self.core.radius_m, variance_m2.sqrt()])
    }

    /// Covariances of [`Shape::at`], across planes and axes alone, and of the axis.
    #[must_use]
    pub fn covariances(&self) -> [Matrix3<f64>; 2] {
        let (at_m2, axis, _) = self.core.covariances(&self.covariance);
        [at_m2, axis]
    }
}

/// A shape that is fitted with the full covariance.
struct Fit {
    core: Core,
    covariance: Covariance,
    likelihood: Likelihood,
}

/// How likely lengths are with all unknowns of a shape, but for what all shapes have in common.
struct Likelihood {
    square: f64,
    log_determinant: f64,
}

impl Likelihood {
    /// Logarithm.
    fn evidence(&self) -> f64 {
        -0.5 * (self.square + self.log_determinant)
    }
}

/// What errors have beyond those that are stated.
#[derive(Clone, Copy)]
struct Excess {
    /// Factor by which noise is larger.
    scatter: f64,
    /// Standard deviation of a smooth departure from the shape, over the width of what the wall sees of it.
    departure_m: f64,
}

impl Excess {
    const NONE: Self = Self { scatter: 1.0, departure_m: 0.0 };
}

/// A shape that is sure.
struct Verdict {
    fit: Fit,
    /// Logarithm of how much likelier its kind is.
    lead: f64,
    excess: Excess,
}

/// Shapes that sightings of a wall show, the one with most of them first.
///
/// # Panics
/// If a standard deviation is not positive.
#[must_use]
pub fn shapes(sightings: &[Sighting], cancel: &Cancel) -> Vec<Shape> {
    assert!(sightings.iter().all(|one| one.light.sd_m > 0.0), "lengths have standard deviations");
    let Some(wall) = Wall::new(sightings, cancel) else { return Vec::new() };
    let mut cores = Vec::new();
    let mut free = vec![true; sightings.len()];
    let mut is_seed = free.clone();
    while let Some((core, members)) = wall.largest(&free, &is_seed, cancel) {
        let verdict =
            (!wall.goes_on(&core, &members)).then(|| verdict(&wall, &core, &spread(&members, ENOUGH))).flatten();
        // Places of what is not reported stay free for other shapes, but start none.
        members.iter().for_each(|n| is_seed[*n as usize] = false);
        if let Some(verdict) = verdict {
            members.iter().for_each(|n| free[*n as usize] = false);
            cores.push(verdict.fit.core);
        }
    }
    let members = wall.shared(&cores);
    let shapes = cores.iter().zip(members).filter_map(|(core, members)| shape(&wall, core, &members));
    let mut shapes: Vec<Shape> = shapes.collect();
    shapes.sort_by_key(|shape| std::cmp::Reverse(shape.members.len()));
    shapes
}

/// The likeliest kind on the members, if it is sure, and no smooth departure is much likelier.
fn verdict(wall: &Wall<'_>, core: &Core, members: &[u32]) -> Option<Verdict> {
    let fits = kinds(wall, core, members, &errors(wall, members, Excess::NONE)?);
    let first = &fits.first()?.core;
    let evidence = |excess: Excess| -> Option<(f64, Excess)> {
        let errors = errors(wall, members, excess)?;
        Some((Step::new(wall, first, &errors, members)?.likelihood.evidence(), excess))
    };
    let likeliest = |all: &mut dyn Iterator<Item = Excess>| all.filter_map(evidence).max_by(|a, b| a.0.total_cmp(&b.0));
    let (without, mut excess) =
        likeliest(&mut SCATTERS.iter().map(|scatter| Excess { scatter: *scatter, ..Excess::NONE }))?;
    if first.kind.has_radius() {
        let length_m = median(members.iter().map(|n| wall.sightings[*n as usize].light.length_m).collect());
        let [_, narrow_m] = wall.reach_m(members);
        let departure_m = BENT * narrow_m.powi(2) / (2.0 * length_m);
        let (bent, _) = evidence(Excess { departure_m, ..excess })?;
        if without - bent < SURE {
            return None;
        }
    }
    let law_m = median(members.iter().map(|n| wall.sightings[*n as usize].light.law_m).collect());
    let departures = DEPARTURES.map(|share| Excess { departure_m: share * law_m, ..excess });
    let (with, departure) = likeliest(&mut departures.into_iter())?;
    let gain = with - (DEPARTURES.len() as f64).ln() - without;
    if gain > 0.0 {
        excess = departure;
    }
    let fits = kinds(wall, core, members, &errors(wall, members, excess)?);
    let lead = lead(&fits);
    let fit = fits.into_iter().next()?;
    (lead > SURE && gain < DEPARTS && is_explained(&fit, members.len())).then_some(Verdict { fit, lead, excess })
}

/// All kinds on these members, the likeliest one first.
fn kinds(wall: &Wall<'_>, core: &Core, members: &[u32], errors: &Errors) -> Vec<Fit> {
    let of_kind = |kind: Kind| {
        let starts = if kind == core.kind { vec![core.clone()] } else { wall.starts(kind, members) };
        let starts = starts.into_iter().filter_map(|start| wall.fit(&start, members));
        let start = starts.min_by(|a, b| wall.square(a, members).total_cmp(&wall.square(b, members)))?;
        fit(wall, start, errors, members)
    };
    let mut fits: Vec<Fit> = Kind::ALL.into_iter().filter_map(of_kind).collect();
    fits.sort_by(|a, b| b.likelihood.evidence().total_cmp(&a.likelihood.evidence()));
    fits
}

/// Logarithm of how much likelier the first kind is than the next one.
fn lead(fits: &[Fit]) -> f64 {
    let [best, next, ..] = fits else { return 0.0 };
    best.likelihood.evidence() - next.likelihood.evidence()
}

/// Errors of the members' lengths.
fn errors(wall: &Wall<'_>, members: &[u32], Excess { scatter, departure_m }: Excess) -> Option<Errors> {
    let zone_m = median(members.iter().map(|n| wall.sightings[*n as usize].light.zone_m).collect());
    let [reach_m, _] = wall.reach_m(members);
    let reach_m = reach_m.max(zone_m);
    let law = |length_m: f64, share: f64| Smooth {
        length_m,
        sd_m: Box::new(move |one: &Sighting| one.light.law_m * share.sqrt()),
    };
    let slow = Smooth {
        length_m: reach_m,
        sd_m: Box::new(move |one: &Sighting| departure_m.hypot(one.light.law_m * SLOW.sqrt())),
    };
    let functions = [law(zone_m, 1.0 - SLOW - ROUGH), law(0.5 * zone_m, ROUGH), slow];
    Errors::new(&wall.members(members), scatter, &functions)
}

/// Least squares with the full covariance. The prior of shifts is a metre, that of turns a radian; that of a radius is
/// a metre too, about none: a plane is no sphere of many metres.
fn fit(wall: &Wall<'_>, start: Core, errors: &Errors, members: &[u32]) -> Option<Fit> {
    let mut core = start;
    let mut step = Step::new(wall, &core, errors, members)?;
    for _ in 0..ROUNDS {
        if step.gain < DONE {
            break;
        }
        core = core.moved(&step.change);
        step = Step::new(wall, &core, errors, members)?;
    }
    let used = core.unknowns();
    let covariance = Covariance::from_fn(|i, j| if i < used && j < used { step.inverse[(i, j)] } else { 0.0 });
    // A kind that does not come to rest still stands against the others, with what its next step promises.
    Some(Fit { core, covariance, likelihood: step.likelihood })
}

/// A step of least squares.
struct Step {
    change: Unknowns,
    /// By how much chi-square falls.
    gain: f64,
    /// Covariance of the unknowns.
    inverse: Mat<f64>,
    /// After the step.
    likelihood: Likelihood,
}

impl Step {
    fn new(wall: &Wall<'_>, core: &Core, errors: &Errors, members: &[u32]) -> Option<Self> {
        let (residuals_m, slopes) = wall.residuals(core, members);
        let (mut square, mut information, mut gradient) = errors.information(&residuals_m, &slopes);
        (0..UNKNOWNS).for_each(|k| information[(k, k)] += 1.0);
        if core.kind.has_radius() {
            square += core.radius_m * core.radius_m;
            gradient[core.unknowns() - 1] -= core.radius_m;
        }
        let definite = Definite::new(&information)?;
        let mut step = Mat::from_fn(UNKNOWNS, 1, |k, _| gradient[k]);
        definite.solve(&mut step);
        let gain: f64 = (0..UNKNOWNS).map(|k| step[(k, 0)] * gradient[k]).sum();
        let log_determinant = errors.log_determinant + definite.log_determinant();
        let likelihood = Likelihood { square: square - gain, log_determinant };
        let change = Unknowns::from_fn(|k, _| step[(k, 0)]);
        likelihood.square.is_finite().then(|| Self { change, gain, inverse: definite.inverse(), likelihood })
    }
}

/// Whether chi-square is one that errors allow (Wilson and Hilferty).
fn is_explained(fit: &Fit, count: usize) -> bool {
    let free = (count - fit.core.unknowns()) as f64;
    let spread = 2.0 / (9.0 * free);
    ((fit.likelihood.square / free).cbrt() - (1.0 - spread)) / spread.sqrt() < EXPLAINED
}

/// The shape with all that show it, if it is the one that was reported.
fn shape(wall: &Wall<'_>, core: &Core, members: &[u32]) -> Option<Shape> {
    if members.len() < LEAST || wall.goes_on(core, members) {
        return None;
    }
    let Verdict { fit, lead, excess } = verdict(wall, core, &spread(members, ENOUGH))?;
    let is_same = fit.core.kind == core.kind;
    let Fit { core: likeliest, covariance, likelihood } =
        self::fit(wall, fit.core, &errors(wall, members, excess)?, members)?;
    let (residuals_m, _) = wall.residuals(&likeliest, members);
    let rms_m = (residuals_m.iter().map(|off_m| off_m * off_m).sum::<f64>() / members.len() as f64).sqrt();
    let misfit = likelihood.square / (members.len() - likeliest.unknowns()) as f64;
    let members = members.iter().map(|n| *n as usize).collect();
    is_same.then_some(Shape { core: likeliest, covariance, members, evidence: lead, misfit, rms_m })
}

/// Some of them, evenly over all.
fn spread(members: &[u32], most: usize) -> Vec<u32> {
    let step = members.len().div_ceil(most).max(1);
    members.iter().step_by(step).copied().collect()
}
