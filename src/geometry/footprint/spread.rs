//! How far footprints spread the light of a path: what makes its pulse wide.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::{Footprint, Footprints};
use crate::Point;
use crate::units::PatchId;

/// Variances of paths are known to no better than this share: light is not even over a patch.
const SPREAD_SD: f64 = 0.04;
/// A size with a larger standard deviation, as a share of it, is not known: widths hardly showed it.
const KNOWN_SD: f64 = 0.45;

/// How far the lengths of one path's light are spread.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LengthSpread {
    /// Variance, over the patches that have a footprint.
    pub variance_m2: f64,
    /// Standard deviation of that; `None` where a patch of the path has none, or one of unknown size.
    pub sd_m2: Option<f64>,
}

impl LengthSpread {
    /// Its root.
    #[must_use]
    pub fn width_m(&self) -> f64 {
        self.variance_m2.sqrt()
    }

    /// Standard deviation of that; of a variance that is nearly 0, the root of its error. `None` where that
    /// of the variance is.
    #[must_use]
    pub fn width_sd_m(&self) -> Option<f64> {
        let to_first_order = |sd_m2: f64| sd_m2 < 2.0 * self.variance_m2;
        let of = |sd_m2: f64| if to_first_order(sd_m2) { sd_m2 / (2.0 * self.width_m()) } else { sd_m2.sqrt() };
        self.sd_m2.map(of)
    }
}

impl Footprints {
    /// What the patches of a path spread its light by.
    ///
    /// To first order the lengths over a disk have the variance `g' S g`, with `g` the path's gradient at the patch.
    #[must_use]
    pub fn spread(
        &self,
        source: Point,
        path: &[PatchId],
        centre: impl Fn(&PatchId) -> Point,
        sensor: Point,
    ) -> LengthSpread {
        let ends = std::iter::once(source).chain(path.iter().map(centre)).chain(std::iter::once(sensor));
        let at: Vec<Point> = ends.collect();
        let towards = |from: Point, to: Point| (to - from).try_normalize(f64::MIN_POSITIVE).unwrap_or_default();
        let mut variance_m2 = 0.0;
        let mut changes_m2 = BTreeMap::<PatchId, [f64; 3]>::new();
        for (patch, legs) in path.iter().zip(at.windows(3)) {
            let Some(footprint) = self.0.get(patch) else { continue };
            let slope = towards(legs[1], legs[0]) + towards(legs[1], legs[2]);
            let of = |footprint: Footprint| footprint.variance_m2(&slope);
            variance_m2 += of(*footprint);
            let change = |error: usize| {
                let [more, less] = [1.0, -1.0].map(|sd| [0, 1, 2].map(|k| if k == error { sd } else { 0.0 }));
                0.5 * (of(footprint.moved(more)) - of(footprint.moved(less)))
            };
            let all = changes_m2.entry(*patch).or_default();
            all.iter_mut().enumerate().for_each(|(error, sum)| *sum += change(error));
        }
        let of_errors_m2: f64 = changes_m2.values().flatten().map(|change| change * change).sum();
        let is_known = |one: &Footprint| one.size_sd_m() < KNOWN_SD * one.size_m;
        let are_known = path.iter().all(|patch| self.0.get(patch).is_some_and(is_known));
        let sd_m2 = of_errors_m2.sqrt().hypot(SPREAD_SD * variance_m2);
        LengthSpread { variance_m2, sd_m2: are_known.then_some(sd_m2) }
    }
}

impl Footprint {
    /// Variance of the length of a path of this gradient over the disk.
    fn variance_m2(&self, slope: &Vector3<f64>) -> f64 {
        (0.25 * self.size_m * self.normal).cross(slope).norm_squared()
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    use super::*;

    const PLACES: [[f64; 3]; 2] = [[0.3, 1.0, 0.1], [-0.4, 1.2, -0.2]];

    fn centre(patch: PatchId) -> Point {
        Point::from(PLACES[patch as usize])
    }

    fn along(source: Point, at: &[Point], sensor: Point) -> f64 {
        let ends = [&[source], at, &[sensor]].concat();
        ends.windows(2).map(|leg| (leg[1] - leg[0]).norm()).sum()
    }

    /// Lengths over points drawn from the disks have the variance that is told.
    #[test]
    fn lengths_over_disks_have_the_variance_that_is_told() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let normals = [Vector3::new(0.2, -0.9, 0.4).normalize(), Vector3::new(0.6, -0.7, 0.1).normalize()];
        let sizes_m = [0.02, 0.03];
        let each = (0..2).map(|n| (n as PatchId, Footprint::exact(normals[n], sizes_m[n])));
        let footprints = Footprints(each.collect());
        let (source, sensor) = (Point::origin(), Point::new(0.1, 0.0, 0.0));
        let mut on_disk = |n: usize| {
            let aside = normals[n].cross(&Vector3::new(0.3, -0.7, 0.64)).normalize();
            let radius_m = 0.5 * sizes_m[n] * rng.random_range(0.0..1.0_f64).sqrt();
            let (sin, cos) = rng.random_range(0.0..std::f64::consts::TAU).sin_cos();
            centre(n as PatchId) + (aside * cos + normals[n].cross(&aside) * sin) * radius_m
        };
        let lengths_m: Vec<f64> = (0..40_000).map(|_| along(source, &[on_disk(0), on_disk(1)], sensor)).collect();
        let mean_m = lengths_m.iter().sum::<f64>() / lengths_m.len() as f64;
        let drawn_m2 =
            lengths_m.iter().map(|length_m| (length_m - mean_m).powi(2)).sum::<f64>() / lengths_m.len() as f64;
        let told = footprints.spread(source, &[0, 1], |patch| centre(*patch), sensor);
        assert!((told.variance_m2 / drawn_m2 - 1.0).abs() < 0.03, "{told:?} {drawn_m2}");
        assert!((told.sd_m2.unwrap() / told.variance_m2 - SPREAD_SD).abs() < 1e-9, "{told:?}");
        let of_one =
            Footprints(BTreeMap::from([(0, footprints.0[&0])])).spread(source, &[0, 1], |patch| centre(*patch), sensor);
        assert!(of_one.variance_m2 < told.variance_m2 && of_one.sd_m2.is_none(), "{of_one:?}");
    }

    /// Variances of footprints drawn with their errors scatter as they say; a patch that is met twice errs twice alike.
    #[test]
    fn variances_of_footprints_with_errors_scatter_as_they_say() {
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let normal = Vector3::new(0.2, -0.9, 0.4).normalize();
        let along = normal * normal.transpose();
        let covariance_m2 = 0.002_f64.powi(2) * (Matrix3::identity() - along) + 0.001_f64.powi(2) * along;
        let uncertain = Footprint::with_covariance(normal, 0.03, covariance_m2);
        let other = Footprint::exact(Vector3::new(0.6, -0.7, 0.1).normalize(), 0.02);
        let footprints = Footprints(BTreeMap::from([(0, uncertain), (1, other)]));
        let (source, sensor) = (Point::origin(), Point::new(0.1, 0.0, 0.0));
        for path in [vec![0, 1], vec![0, 1, 0]] {
            let told = footprints.spread(source, &path, |patch| centre(*patch), sensor);
            let mut of_draw_m2 = || {
                let sds: [f64; 3] = std::array::from_fn(|_| rng.sample(StandardNormal));
                footprints.moved(&sds).spread(source, &path, |patch| centre(*patch), sensor).variance_m2
            };
            let drawn_m2: Vec<f64> = (0..4000).map(|_| of_draw_m2() - told.variance_m2).collect();
            let scatter_m2 =
                (drawn_m2.iter().map(|off_m2| off_m2 * off_m2).sum::<f64>() / drawn_m2.len() as f64).sqrt();
            let told_m2 = (told.sd_m2.unwrap().powi(2) - (SPREAD_SD * told.variance_m2).powi(2)).sqrt();
            assert!((scatter_m2 / told_m2 - 1.0).abs() < 0.1, "{path:?} {scatter_m2} {told_m2}");
        }
    }
}
