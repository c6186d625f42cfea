//! First light at points of a wall as the kernels of shapes and surfaces take it.

use std::collections::BTreeMap;

use nalgebra::Matrix3;

use crate::geometry::Point;
use crate::geometry::first_return::{FirstLight, Kind};
use crate::geometry::shapes::Sighting;
use crate::tables::{Patch, SurfacePoint};
use crate::units::PatchId;

/// Places of the points of a wall.
#[derive(Clone, Debug, Default)]
pub struct Walls {
    places: BTreeMap<PatchId, Point>,
}

impl Walls {
    /// Of the best solution.
    #[must_use]
    pub fn new(patches: &[Patch]) -> Self {
        let best = patches.iter().filter(|patch| patch.alternative == 0);
        Self { places: best.map(|patch| (patch.patch, Point::new(patch.x_m, patch.y_m, patch.z_m))).collect() }
    }

    /// First light as it shows points of surfaces, each with the number of its row. Points of later returns have none,
    /// nor those whose point of the wall is not lit itself, or has no place.
    #[must_use]
    pub fn sightings(&self, points: &[SurfacePoint]) -> Vec<(usize, Sighting)> {
        let first = points.iter().enumerate().filter(|(_, point)| point.rank == 1);
        first.filter_map(|(row, point)| Some((row, self.sighting(point)?))).collect()
    }

    fn sighting(&self, point: &SurfacePoint) -> Option<Sighting> {
        let seen = *self.places.get(&point.seen).filter(|_| point.lit == point.seen)?;
        let light = FirstLight {
            length_m: point.light_m,
            sd_m: point.light_sd_m,
            law_m: point.light_law_sd_m,
            zone_m: point.light_zone_m,
            common_m: point.light_common_sd_m,
        };
        let [xx, xy, xz] = [point.cov_xx_m2, point.cov_xy_m2, point.cov_xz_m2];
        let [yy, yz, zz] = [point.cov_yy_m2, point.cov_yz_m2, point.cov_zz_m2];
        let part = match &*point.kind {
            "smooth" => Kind::Smooth,
            "edge" => Kind::Edge,
            "corner" => Kind::Corner,
            _ => Kind::Unknown,
        };
        let covariance_m2 = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        let place = Point::new(point.x_m, point.y_m, point.z_m);
        Some(Sighting { seen, light, point: place, covariance_m2, part, edges: point.edges })
    }
}
