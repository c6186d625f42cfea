//! What a place gains in covariance by errors that its profiles share: those of the visible patches, and of delays.

use nalgebra::{DMatrix, Matrix3, Vector3};

use super::likelihood::legs_m;
use super::{Profile, Room};
use crate::Point;

/// Errors that profiles have in common.
#[derive(Clone, Debug)]
pub struct Shared {
    /// Covariance of the positions of the foci, m^2: three coordinates for each.
    pub foci_m2: DMatrix<f64>,
    /// Of each profile, in the order of the profiles.
    pub profiles: Vec<Ends>,
    /// How many delays there are.
    pub delays: usize,
}

/// Where light begins and ends its way, and the delay of that way. The legs to both foci are taken off the profile.
#[derive(Clone, Copy, Debug)]
pub struct Ends {
    /// Of the laser.
    pub source: Point,
    /// Of the sensor.
    pub sensor: Point,
    /// Which delay the profile has, and its standard deviation as a length.
    pub delay: Option<(usize, f64)>,
}

/// Covariance, m^2, that a place gains, to first order. Errors of foci and of delays count as independent.
///
/// Light that comes over a way that is e longer than expected asks for a place that is farther off. By the squares u^2
/// of the signal-to-noise ratios, and the gradients g of the lengths of the ways, the place moves by
/// `(sum u^2 g g^T)^-1 sum u^2 g e`: how sharp pulses are does not matter.
///
/// Zero where the profiles do not determine a place.
///
/// # Panics
/// If there are not as many ends as profiles.
#[must_use]
pub fn gained_m2(point: Point, profiles: &[Profile], room: &Room, shared: &Shared) -> Matrix3<f64> {
    assert_eq!(profiles.len(), shared.profiles.len(), "each profile has its ends");
    let (foci, first_delay) = (&room.foci, 3 * room.foci.len());
    let legs_m = legs_m(foci, &point);
    let mut information = Matrix3::zeros();
    // By each error: what it adds to the sum of u^2 g e.
    let mut pulls = DMatrix::<f64>::zeros(3, first_delay + shared.delays);
    for (profile, ends) in profiles.iter().zip(&shared.profiles) {
        let Some((_, gain)) = profile.signal(&legs_m) else { continue };
        let places = profile.foci;
        let towards = |from: Point, to: Point| (to - from).try_normalize(0.0).unwrap_or_else(Vector3::zeros);
        let mut gradient = places.map(|place| towards(foci[place].point, point)).into_iter().sum::<Vector3<f64>>();
        if room.dimensions == 2 {
            gradient.z = 0.0;
        }
        let pull = gradient * (gain * gain);
        information += pull * gradient.transpose();
        // A focus that is farther off makes the way longer by both of its legs.
        for (place, end) in places.into_iter().zip([ends.source, ends.sensor]) {
            let longer = towards(end, foci[place].point) + towards(point, foci[place].point);
            let mut pulled = pulls.fixed_columns_mut::<3>(3 * place);
            pulled += pull * longer.transpose();
        }
        if let Some((delay, sd_m)) = ends.delay {
            let mut pulled = pulls.column_mut(first_delay + delay);
            pulled += pull * sd_m;
        }
    }
    if room.dimensions == 2 {
        information[(2, 2)] = 1.0;
    }
    let Some(inverse) = information.try_inverse() else { return Matrix3::zeros() };
    let moved = inverse * pulls;
    let (by_foci, by_delays) = (moved.columns(0, first_delay), moved.columns(first_delay, shared.delays));
    let gained = by_foci * &shared.foci_m2 * by_foci.transpose() + by_delays * by_delays.transpose();
    Matrix3::from_iterator(gained.iter().copied())
}
