//! A bent field or flat faces that end: which explains the lengths about a place, and what both say together.

use nalgebra::{Matrix3, Vector3};

use super::field::{Field, Kind};
use super::flat::Flat;
use super::local::{Local, Sample};
use super::odds;
use super::way::Way;
use super::windows::{Chosen, Reading};
use super::{EDGES, FirstLight, Lit, Scan, SurfacePoint};
use crate::Point;

/// Power of a likelihood that counts: errors of the law are common to neighbours.
const TEMPER: f64 = 0.3;
/// Standard deviation of the law's error that is common to all places, over that of the response: of bent fields, whose
/// law is off by more at each place, and of flat faces, whose residuals do not show it.
const COMMON: [f64; 2] = [0.05, 0.1];
/// Share of a kind that is sure.
pub const SURE: f64 = 0.9;

/// What explains a place: a bent field, flat faces, their share by likelihood, and that which bent fields bear out.
pub struct Choice<'a> {
    pub bent: Option<&'a Chosen<Field>>,
    pub flat: Option<&'a Chosen<Flat>>,
    pub likelihood: f64,
    pub share: f64,
    pub samples: &'a [Sample],
}

impl Choice<'_> {
    /// Share of the flat faces, where both explain a place. `square_of_faces` is their chi-square of their own
    /// members.
    pub fn share(bent: &Chosen<Field>, flat: &Chosen<Flat>, square_of_faces: f64, samples: [&[Sample]; 2]) -> f64 {
        // The larger window tells: a wrong model explains a small one too.
        let is_bent = bent.members.len() > flat.members.len();
        let members = if is_bent { &bent.members } else { &flat.members };
        let of_flat = if is_bent { square(&flat.field, samples[1], members) } else { square_of_faces };
        let more = of_flat - square(&bent.field, samples[0], members);
        odds::probability(-0.5 * TEMPER * more)
    }

    /// The point of the surface that belongs to a place, with its light; `None` where nothing explains it.
    pub fn surface_point(&self, scan: &Scan, place: usize, light: &Sample) -> Option<SurfacePoint> {
        let common_m = COMMON.map(|share| share * scan.share() * scan.sigma_m);
        // The point is the mean by likelihoods: where a face ends, bent fields are off. The covariance is that about it
        // of what bent fields bear out.
        let parts: Vec<([f64; 2], Reading)> = [
            self.bent.map(|bent| ([1.0 - self.likelihood, 1.0 - self.share], bent.reading().and_along(common_m[0]))),
            self.flat.map(|flat| ([self.likelihood, self.share], flat.reading().and_along(common_m[1]))),
        ]
        .into_iter()
        .flatten()
        .collect();
        let most = parts.iter().max_by(|a, b| a.0[0].total_cmp(&b.0[0]))?.1;
        let mean = |of: &dyn Fn(&Reading) -> Vector3<f64>| parts.iter().map(|([share, _], one)| of(one) * *share).sum();
        let (point, away): (Vector3<f64>, Vector3<f64>) = (mean(&|one| one.point.coords), mean(&|one| one.away));
        let (mut covariance_m2, mut away_covariance) = (Matrix3::zeros(), Matrix3::zeros());
        for ([_, share], one) in &parts {
            let [off, off_away] = [one.point.coords - point, one.away - away];
            covariance_m2 += (one.covariance_m2 + off * off.transpose()) * *share;
            away_covariance += (one.away_covariance + off_away * off_away.transpose()) * *share;
        }
        let kind = self.kind();
        let is_bent = self.likelihood < 0.5;
        let fitted = if is_bent { self.bent?.field.fitted() } else { self.flat?.field.fitted() };
        let curvatures =
            self.bent.filter(|_| kind == Kind::Smooth && is_bent && matches!(scan.lit, Lit::Same)).map(|bent| {
                let distance_m = bent.field.distance_m(&Way::Back);
                bent.field.bends(&Way::Back).map(|[bend, _]| bend / distance_m / (1.0 - bend))
            });
        let Sample { length_m, sd_m, law_m, .. } = *light;
        let common_m = common_m[0] * (1.0 - self.share) + common_m[1] * self.share;
        Some(SurfacePoint {
            place,
            light: FirstLight { length_m, sd_m, law_m, zone_m: scan.zone_m(length_m), common_m },
            point: point.into(),
            covariance_m2,
            normal: away.try_normalize(0.5).unwrap_or(most.away),
            normal_covariance: away_covariance,
            kind,
            curvatures_per_m: curvatures,
            places: fitted.count,
            misfit: fitted.misfit(),
            edges: 0.0,
        })
    }

    /// Adds that there are edges with this probability where neither model has any: then the kind is not known; and how
    /// far the point of the place may slide.
    pub fn add_edges(&self, point: &mut SurfacePoint, seen: &Point, edges: f64) {
        point.edges = edges;
        if edges > EDGES {
            (point.kind, point.curvatures_per_m) = (Kind::Unknown, None);
        }
        self.add_slides(point);
        self.add_arc(point, seen);
    }

    /// Adds by how much a point lies off the plane along which it may slide: points of one length lie on a sphere about
    /// the place, or on an ellipsoid, and leave its tangent by half of their squared distance over its radius. This
    /// counts where nearest points are known to a decimetre and lengths to a millimetre.
    fn add_arc(&self, point: &mut SurfacePoint, seen: &Point) {
        let along = point.normal * point.normal.transpose();
        let across = Matrix3::identity() - along;
        let slides_m2 = across * point.covariance_m2 * across;
        // The mean fourth power of a normal distribution's distance from its middle.
        let fourth_m4 = slides_m2.trace().powi(2) + 2.0 * (slides_m2 * slides_m2).trace();
        let way = self.bent.map_or(Way::Back, |bent| bent.way);
        point.covariance_m2 += along * (0.25 * fourth_m4 * way.bend_per_m(seen, &point.point).powi(2));
    }

    /// Adds what the nearest point may be off by along the surface: where the bent field is concave, and where it shows
    /// no edges though light does.
    fn add_slides(&self, point: &mut SurfacePoint) {
        let Some(bent) = self.bent else { return };
        let square_m2 = |n: &u32| (self.samples[*n as usize].at - bent.field.at).norm_squared();
        let mean_m2 = bent.members.iter().map(square_m2).sum::<f64>() / bent.members.len() as f64;
        for (direction, variance_m2) in bent.field.slides(&bent.way, mean_m2, [1.0 - self.share, point.edges]) {
            let variance_m2 = direction * direction.transpose() * variance_m2;
            point.covariance_m2 += variance_m2;
            point.normal_covariance += variance_m2 / bent.field.distance_m(&bent.way).powi(2);
        }
    }

    fn kind(&self) -> Kind {
        let mut shares = [0.0; 3];
        match self.bent.map(|bent| bent.field.kind(&bent.way)) {
            Some(Kind::Smooth) => shares[0] += 1.0 - self.share,
            Some(Kind::Edge) => shares[1] += 1.0 - self.share,
            Some(Kind::Corner) => shares[2] += 1.0 - self.share,
            Some(Kind::Unknown) | None => {}
        }
        if let Some(flat) = self.flat {
            shares.iter_mut().zip(flat.field.kinds()).for_each(|(share, own)| *share += self.share * own);
        }
        let kinds = [Kind::Smooth, Kind::Edge, Kind::Corner];
        kinds.into_iter().zip(shares).find(|(_, share)| *share > SURE).map_or(Kind::Unknown, |(kind, _)| kind)
    }
}

/// Chi-square with the errors of the law.
pub fn square(field: &impl Local, samples: &[Sample], members: &[u32]) -> f64 {
    let of_one = |n: &u32| {
        let sample = &samples[*n as usize];
        (sample.length_m - field.length_m(&sample.at)).powi(2) / (sample.sd_m.powi(2) + sample.law_m.powi(2))
    };
    members.iter().map(of_one).sum()
}
