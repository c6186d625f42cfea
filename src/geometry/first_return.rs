//! Points of hidden surfaces, with covariances and normals, from the first light that comes back to points of a wall.
//!
//! `d(p)` is the distance from a point `p` of the wall to the nearest point `x` of the surface. Its gradient in space
//! is the unit vector from `x` to `p`, so that value and gradient give `x = p - d grad d`; on a smooth surface the
//! gradient is the normal too. Where the lit point is fixed, the same holds for the length of the way from there over
//! the surface to the seen point. Neighbouring points of the wall tell value, gradient and curvature: a field is
//! fitted to them, which is exact for planes, spheres, cylinders, straight edges and corners. Where lit and seen point
//! move together apart, value and gradient of the way's length give the point too (`way`), and fields are local fits.
//!
//! | module | does |
//! |---|---|
//! | `alike` | which neighbours show light of the same thing |
//! | `systematic` | errors of the set-up that all points share |
//! | `sheets` | light of several things at each place, parted |
//! | `joined` | places that lie closer than first light tells apart, joined |
//! | `local` | what fields have in common: how they are fitted to lengths, and how sure they are |
//! | `way` | how light goes to a place, and the point that value and gradient show |
//! | `field` | a bent field: value, direction, curvature |
//! | `flat` | the field of flat faces that end: a rectangle, or a block |
//! | `windows` | which neighbours a field is fitted to, and which field a place shares with others |
//! | `choice` | the bent field or the flat faces: the mixture of what both say |
//! | `dispersion` | how large the error of the law of first light is |
//! | `laws` | under which law light begins at each point of the wall |
//! | `odds` | probabilities from odds |
//!
//! Where the nearest point jumps from one place to another, the gradient jumps too, and no field may be fitted across.
//! A window of neighbours starts where one field explains them, on one side if need be, and grows by neighbours that
//! the field predicts, as long as it explains all of them and agrees with what smaller windows said.
//!
//! When light begins depends on where the surface ends. Flat faces show that; so lengths are timed again under the law
//! of the faces, and faces are fitted again, in some rounds. Faces count as long as bent fields, which know nothing of
//! them, say the same of the points: a slightly curved surface has nearly the lengths of flat faces. And as long as
//! light rises as from a face: steps whose edges lie in a plane have nearly its lengths.
//!
//! Covariances have five parts: noise; an error that each place has for itself, such as jitter, which scatter about the
//! smallest windows shows; the error of the law of first light, which is a smooth random function over the wall
//! ([`Scan::sigma_m`] sets its length, and its size but for flat faces, whose residuals tell it); what other windows
//! and other faces say otherwise; and the mixture of bent fields and flat faces by their likelihoods. All but the first
//! two are common to neighbours and do not average out. Where all these let a point slide by centimetres, it leaves the
//! tangent of what has its length, which is a sphere about the place: that is added across.
//!
//! Source: Tsai et al., The Geometry of First-Returning Photons, CVPR 2017; Xin et al., A Theory of Fermat Paths,
//! CVPR 2019. Windows by agreement: Lepski, Theory Probab. Appl. 35:454, 1990.
//!
//! Not modelled: errors of single places of the wall, flat faces where the lit point is not the seen point, and
//! the wall's relief in how the lengths of pairs that move together change across the wall.

mod alike;
mod choice;
mod dispersion;
mod field;
mod flat;
mod joined;
mod laws;
mod local;
mod odds;
mod sheets;
mod systematic;
mod way;
mod windows;

#[cfg(test)]
mod tests;

use nalgebra::{Matrix3, Vector3};
use periscope_cancel::Cancel;
use rayon::prelude::*;

use super::Point;
use super::axes::Scatter;
pub use alike::alike;
use choice::Choice;
use dispersion::Dispersion;
use field::Field;
pub use field::Kind;
use flat::{Flat, Hint};
use joined::Joined;
use local::{Local, Sample};
pub use sheets::layers;
pub use systematic::Systematic;
use windows::{Chosen, Reading, Wall};

/// Least number of places of the wall.
pub const LEAST: usize = 16;
/// Least number of places of a window that has grown.
pub const GROWN: usize = windows::SIZES[1];

/// Of so many nearest places, itself with them, one tells curvatures.
const CURVED: usize = 3;
/// Neighbours whose points of bent fields and of flat faces are compared, and their mean chi-square of three
/// coordinates beyond which they differ.
const NEIGHBOURS: usize = 13;
const DIFFER: f64 = 3.0;
/// Probability of edges that lengths do not show, beyond which the kind of a point is not known, and the point is none
/// of a smooth surface.
pub(crate) const EDGES: f64 = 0.5;
/// Rounds in which first light is timed again under the law of flat faces.
const ROUNDS: usize = 2;
/// Points of a wall lie in a line where their squares across it are below this share of those along it.
const IN_LINE: f64 = 1e-6;

/// A first return under one law of how light begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Return {
    /// Length of its way.
    pub length_m: f64,
    /// Standard deviation.
    pub sd_m: f64,
    /// Standard deviation of an error that neighbours have in common.
    pub common_m: f64,
    /// Logarithm of the likelihood of this law.
    pub log_likelihood: f64,
}

/// A flat part of a surface as a point of the wall sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Face {
    /// Its light next to that of other parts.
    pub weight: f64,
    /// Signed distances of the foot of the point from the edges of a rectangle, positive within, both ends of each of
    /// its directions. Their unit is the radius of the ring whose light comes one standard deviation of the response
    /// after the foot's.
    pub ends: [[f64; 2]; 2],
}

/// A point of the wall, with its first return as a step, an edge and a corner make it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// The seen point; where a lit point moves with it, the place midway.
    pub seen: Point,
    /// The first return. Its lengths are there and back where the lit point is the seen point, else from the lit point
    /// over the surface to the seen point.
    pub returns: [Return; 3],
}

/// Which points of a wall are lit.
#[derive(Clone, Debug, PartialEq)]
pub enum Lit {
    /// Each seen point itself.
    Same,
    /// One for all seen points.
    One(Point),
    /// One apart for each seen point, and both move together over the wall: the way from the place midway to the seen
    /// point, by place. Neighbours' ways are a linear function of their places, or places have no point.
    Apart(Vec<Vector3<f64>>),
}

impl Lit {
    /// Share of a way's length that is a field's: half of a way there and back.
    #[must_use]
    pub fn share(&self) -> f64 {
        if matches!(self, Self::One(_)) { 1.0 } else { 0.5 }
    }
}

/// First returns of a wall.
#[derive(Clone, Debug)]
pub struct Scan {
    /// The lit points.
    pub lit: Lit,
    /// Unit normal of the wall, towards what is hidden.
    pub inwards: Vector3<f64>,
    /// Standard deviation of the response, as length of a way.
    pub sigma_m: f64,
    /// Points of the wall.
    pub places: Vec<Place>,
    /// Least number of places, among those that lie apart, that show a point.
    pub least: usize,
}

/// First light at a place under the law that its surface sets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FirstLight {
    /// Length: its way from a lit point that is one for all, else half of its way.
    pub length_m: f64,
    /// Standard deviation of its noise, and of the error that each place has for itself.
    pub sd_m: f64,
    /// Standard deviation of the error of its law, a smooth random function over the wall.
    pub law_m: f64,
    /// Over which that function's correlation falls as a Gaussian.
    pub zone_m: f64,
    /// Standard deviation of the error that all places have in common.
    pub common_m: f64,
}

/// A point of a hidden surface.
#[derive(Clone, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Number of the place that it is nearest to.
    pub place: usize,
    /// The light that tells it.
    pub light: FirstLight,
    /// Position.
    pub point: Point,
    /// Its covariance.
    pub covariance_m2: Matrix3<f64>,
    /// Unit vector away from the surface; the normal where the kind is [`Kind::Smooth`].
    pub normal: Vector3<f64>,
    /// Its covariance.
    pub normal_covariance: Matrix3<f64>,
    /// What part of the surface it is.
    pub kind: Kind,
    /// Curvatures of the surface, larger one first: positive where it is convex towards the wall. Of a smooth point.
    pub curvatures_per_m: Option<[f64; 2]>,
    /// Places of the wall that entered.
    pub places: usize,
    /// Chi-square over its degrees of freedom.
    pub misfit: f64,
    /// Probability that first light of the neighbourhood comes from edges or corners, where lengths show neither.
    pub edges: f64,
}

/// The point of the surface that each place of the wall sees first, where its neighbours tell it. Places are fewer
/// than points where neighbours do not agree on one field. `timed` are the first returns of a place that
/// sees some faces or others, near a length; `None` where there is none.
///
/// # Panics
/// If a standard deviation is not positive, or `sigma_m` is not, or pairs are not as many as places.
#[must_use]
pub fn surface_points(
    scan: &Scan,
    timed: impl Fn(usize, &[Vec<Face>], f64) -> Vec<Option<Return>> + Sync,
    cancel: &Cancel,
) -> Vec<SurfacePoint> {
    assert!(scan.sigma_m > 0.0, "a response of some width");
    if let Lit::Apart(halves) = &scan.lit {
        assert_eq!(halves.len(), scan.places.len(), "each place has a pair");
    }
    assert!(
        scan.places.iter().flat_map(|place| &place.returns).all(|one| one.sd_m > 0.0),
        "first returns have standard deviations"
    );
    if scan.places.len() < LEAST {
        return Vec::new();
    }
    let joined = Joined::of(scan, cancel);
    let mut rounds = Rounds::new(&joined.scan, cancel);
    // The law of flat faces is that of a point that is lit and seen.
    if matches!(scan.lit, Lit::Same) {
        for round in 0..=ROUNDS {
            if round > 0 {
                rounds.time_again(|place, laws, flat| {
                    let length_m = |seen: &Point| flat.length_m(seen) / scan.share();
                    joined.timed(place, laws, length_m, &timed)
                });
            }
            rounds.find_faces(cancel);
        }
    }
    let edges = rounds.edges_on_fields();
    let of_place = |place: usize| {
        let edges = f64::max(rounds.edges[place], edges[place]);
        joined.members(place).iter().filter_map(|member| rounds.point_of(&joined, place, *member, edges)).collect()
    };
    let of_places: Vec<Vec<SurfacePoint>> = (0..joined.scan.places.len()).into_par_iter().map(of_place).collect();
    let mut points: Vec<SurfacePoint> = of_places.into_iter().flatten().collect();
    points.sort_by_key(|point| point.place);
    points
}

/// What is known of each place, and what a round hands on to the next.
struct Rounds<'a> {
    scan: &'a Scan,
    wall: Wall,
    /// Standard deviation of the error that each place has for itself beside its noise.
    own_m: f64,
    /// Lengths under the laws that likelihood and curvature show, and bent fields of them.
    first: Vec<Sample>,
    fields: Vec<Option<Chosen<Field>>>,
    /// Lengths under the laws that flat faces show, the faces about some places, and those of each place among them.
    samples: Vec<Sample>,
    faces: Vec<Option<Chosen<Flat>>>,
    flats: Vec<Option<Chosen<Flat>>>,
    /// Probability that there are edges on these faces, where they have none.
    edges: Vec<f64>,
    /// Shares of these faces, where there are bent fields too: by likelihood, and those that bent fields bear out.
    likelihoods: Vec<f64>,
    shares: Vec<f64>,
}

impl<'a> Rounds<'a> {
    fn new(scan: &'a Scan, cancel: &Cancel) -> Self {
        let wall = Wall::new(scan, cancel);
        let likely = laws::by_likelihood(scan, &wall.near);
        // Curvatures of neighbours are nearly the same: some do.
        let some = windows::apart(&wall.near, CURVED);
        let few = (&windows::SIZES[..windows::FEW], &some[..]);
        let own_m = windows::own_m(scan, &laws::samples(scan, &likely, 0.0), &wall.near, &some);
        let fields = windows::fields(scan, &laws::samples(scan, &likely, own_m), &wall, few, cancel);
        let shares = laws::by_curvature(&wall.near, &likely, &fields, &some);
        let first = laws::samples(scan, &shares, own_m);
        let all = vec![true; some.len()];
        let fields = windows::fields(scan, &first, &wall, (&windows::SIZES, &all), cancel);
        let wide = |sample: &Sample| Sample { weighted_m: sample.sd_m.hypot(sample.law_m), ..*sample };
        let samples = first.iter().map(wide).collect();
        let (flats, none) = (fields.iter().map(|_| None).collect(), vec![0.0; fields.len()]);
        let (faces, edges, likelihoods) = (Vec::new(), none.clone(), none.clone());
        Self { scan, wall, own_m, first, fields, samples, faces, flats, edges, likelihoods, shares: none }
    }

    fn choice(&self, place: usize) -> Choice<'_> {
        let (bent, flat) = (self.fields[place].as_ref(), self.flats[place].as_ref());
        let [likelihood, share] = [&self.likelihoods, &self.shares].map(|shares| shares[place]);
        Choice { bent, flat, likelihood, share, samples: &self.samples }
    }

    /// Shares of the flat faces.
    fn shares_of_faces(&self) -> Vec<f64> {
        let samples: [&[Sample]; 2] = [&self.first, &self.samples];
        let square = |flat: &Option<Chosen<Flat>>| {
            flat.as_ref().map_or(0.0, |flat| choice::square(&flat.field, &self.samples, &flat.members))
        };
        let squares: Vec<f64> = self.faces.par_iter().map(square).collect();
        let of_place = |(bent, flat): (&Option<Chosen<Field>>, &Option<Chosen<Flat>>)| match (bent, flat) {
            (Some(bent), Some(flat)) => Choice::share(bent, flat, squares[flat.centre as usize], samples),
            (None, Some(_)) => 1.0,
            (_, None) => 0.0,
        };
        self.fields.par_iter().zip(&self.flats).map(of_place).collect()
    }

    fn point(&self, place: usize) -> Option<SurfacePoint> {
        self.choice(place).surface_point(self.scan, place, &self.samples[place])
    }

    /// The point of a member of a joined place, where there are edges with this probability that lengths do not show.
    fn point_of(&self, joined: &Joined<'_>, place: usize, member: u32, edges: f64) -> Option<SurfacePoint> {
        let light = joined.of_member(place, member, &self.samples[place]);
        let bent = self.fields[place].as_ref().map(|bent| bent.seen_from(light.at));
        let flat = self.flats[place].as_ref().map(|flat| flat.seen_from(light.at));
        let choice = Choice { bent: bent.as_ref(), flat: flat.as_ref(), ..self.choice(place) };
        let mut point =
            choice.surface_point(self.scan, member as usize, &light).filter(|point| point.places >= self.scan.least)?;
        choice.add_edges(&mut point, &light.at, edges);
        point.places = joined.count(point.places);
        Some(point)
    }

    /// Flat faces that go on from the points of the round before.
    fn find_faces(&mut self, cancel: &Cancel) {
        let hint = |place: usize| self.point(place).as_ref().map(Hint::new);
        let hints: Vec<Option<Hint>> = (0..self.samples.len()).into_par_iter().map(hint).collect();
        let bent: Vec<Option<Reading>> = self.fields.par_iter().map(|field| Some(field.as_ref()?.reading())).collect();
        self.faces = windows::flats(self.scan, &self.samples, &self.wall, (&hints, &bent), cancel);
        self.flats = windows::shared(&self.faces, &self.samples, &self.wall.near);
        self.edges = self.edges_on_faces();
        for ((flat, edges), bent) in self.flats.iter_mut().zip(&self.edges).zip(&bent) {
            // Where nothing else explains a place, it has no point then.
            if bent.is_none() && *edges > EDGES {
                *flat = None;
            }
        }
        let borne_out = self.borne_out(&bent);
        let both = self.shares_of_faces().into_iter().zip(&self.edges).zip(&bent);
        let likelihood = |((share, edges), bent): ((f64, &f64), &Option<Reading>)| {
            if bent.is_some() { share * (1.0 - edges) } else { share }
        };
        self.likelihoods = both.map(likelihood).collect();
        let both = self.likelihoods.iter().zip(borne_out);
        self.shares = both.map(|(likelihood, borne_out)| likelihood * borne_out).collect();
    }

    /// Probability that there are edges on flat faces.
    fn edges_on_faces(&self) -> Vec<f64> {
        let faces =
            |flat: &Option<Chosen<Flat>>| flat.as_ref().is_some_and(|flat| flat.field.kinds()[0] > choice::SURE);
        let is_facing: Vec<bool> = self.flats.par_iter().map(faces).collect();
        let members = |n: usize| self.flats[n].as_ref().map(|flat| &*flat.members);
        laws::by_rise(self.scan, &self.wall.near, &is_facing, members)
    }

    /// The same on bent fields.
    fn edges_on_fields(&self) -> Vec<f64> {
        let faces =
            |bent: &Option<Chosen<Field>>| bent.as_ref().is_some_and(|bent| bent.field.kind(&bent.way) == Kind::Smooth);
        let is_facing: Vec<bool> = self.fields.par_iter().map(faces).collect();
        let members = |n: usize| self.fields[n].as_ref().filter(|_| is_facing[n]).map(|bent| &*bent.members);
        laws::by_rise(self.scan, &self.wall.near, &is_facing, members)
    }

    /// Share of flat faces that bent fields leave, which know nothing of faces: all, or less where points of neighbours
    /// differ by more than the errors of both.
    fn borne_out(&self, bent: &[Option<Reading>]) -> Vec<f64> {
        let off =
            |(bent, flat): (&Option<Reading>, &Option<Chosen<Flat>>)| flat.as_ref()?.reading().off(bent.as_ref()?);
        let off: Vec<Option<f64>> = bent.par_iter().zip(&self.flats).map(off).collect();
        let of_place = |(near, bent): (&Vec<u32>, &Option<Reading>)| {
            // Where faces alone explain a place, nothing can take their share.
            if bent.is_none() {
                return 1.0;
            }
            let about = near.iter().take(NEIGHBOURS).filter_map(|other| off[*other as usize]);
            let (sum, count) = about.fold((0.0, 0), |(sum, count), off| (sum + off, count + 1));
            if sum > DIFFER * f64::from(count) { DIFFER * f64::from(count) / sum } else { 1.0 }
        };
        self.wall.near.iter().zip(bent).map(of_place).collect()
    }

    /// Standard deviation of the error of the faces' law, as residuals of all faces show it.
    fn law_m(&self) -> f64 {
        let shown = |face: &Chosen<Flat>| {
            let zone_m = self.scan.zone_m(face.field.length_m(&face.field.at()));
            Dispersion::of(&face.field, &self.samples, &face.members, &self.wall.near, zone_m)
        };
        let shown: Vec<Option<Dispersion>> = self.faces.par_iter().flatten().map(shown).collect();
        let shown = shown.into_iter().flatten().fold(Dispersion::default(), Dispersion::and);
        shown.law_m(self.scan.share() * self.scan.sigma_m * laws::MOST_ERROR)
    }

    /// Lengths under the laws of the faces.
    fn time_again(&mut self, timed: impl Fn(usize, &[Vec<Face>], &Flat) -> Vec<Option<Return>> + Sync) {
        let law_m = self.law_m();
        let choices: Vec<Choice<'_>> = (0..self.samples.len()).map(|place| self.choice(place)).collect();
        let again = |place: usize| laws::again(self.scan, place, &choices[place], law_m, &timed);
        let again: Vec<_> = (0..choices.len()).into_par_iter().map(again).collect();
        self.samples = laws::mixed(self.scan, &self.wall.near, &self.first, &choices, &again, self.own_m);
    }
}

/// Unit normal of the plane next to points of a wall, towards the side of `front`; `None` where they lie in a line.
#[must_use]
pub fn wall_normal(points: &[Point], front: &Point) -> Option<Vector3<f64>> {
    let Scatter { middle, axes: [.., normal], squares_m2: [most, less, _] } = Scatter::of(points);
    let normal = if normal.dot(&(front - middle)) < 0.0 { -normal } else { normal };
    (less > IN_LINE * most).then_some(normal)
}

impl Scan {
    fn share(&self) -> f64 {
        self.lit.share()
    }

    /// Radius of the part of the surface that returns light within the response's width, at a distance.
    fn zone_m(&self, distance_m: f64) -> f64 {
        (self.sigma_m * distance_m.abs()).sqrt()
    }
}
