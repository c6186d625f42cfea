//! Where the light of a finite patch comes from: not from its centre.
//!
//! What is timed is the mean path over all points of the patches, weighted by how much light takes each. For flat round
//! patches whose size is small against the legs, to second order,
//!
//! ```text
//! mean - centre = sum over bounces of  grad(ln w)' S grad(l) + tr(S H(l)) / 2,     S = (size^2 / 16) (1 - n n')
//! ```
//!
//! with the legs `l` that meet at the patch and the weight `w` of the light on them. `S` holds the second moments of a
//! disk of the patch's diameter and normal `n`. The laser lights its patch evenly. A leg towards the sensor has
//! `w = cos / r^2`, one between patches `w = cos cos' / r^2` (Lambert). Terms of the fourth order are left out: below
//! 1 % of the shift where legs are longer than three sizes. The cosine at the other end of a leg is linear over
//! the patch, and its term exact, until the patch crosses the plane of the patch there: then a part of it is dark, or
//! lit from behind. What that makes of the shift is part of [`Shift::sd_m`]. Not modelled: glossy patches, a spot
//! smaller than its patch.

mod from_widths;
mod spread;

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};

use super::Point;
use crate::units::PatchId;
pub use from_widths::{Bounce, Sizes, Spread, from_widths};
pub use spread::LengthSpread;

/// A flat round patch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Footprint {
    /// Unit normal; its sign does not matter.
    pub normal: Vector3<f64>,
    /// Diameter.
    pub size_m: f64,
    /// Three independent errors of the normal times the diameter, each a standard deviation: columns, the eigenvectors
    /// of its covariance. (Widths tell the angle to the light that a patch has and sends much better than the turn
    /// about that.)
    pub errors_m: Matrix3<f64>,
}

/// Footprints by patch; a patch without one is a point.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Footprints(pub BTreeMap<PatchId, Footprint>);

impl Footprints {
    /// Whether all patches are points.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Diameter of the largest, 0 of points.
    #[must_use]
    pub fn largest_m(&self) -> f64 {
        self.0.values().map(|footprint| footprint.size_m).fold(0.0, f64::max)
    }

    /// What the mean way of the light over the patches of a path is longer than that over their centres; see
    /// [`shift_m`].
    #[must_use]
    pub fn shift_m(&self, source: Point, path: &[PatchId], centre: impl Fn(&PatchId) -> Point, sensor: Point) -> f64 {
        if self.is_empty() {
            return 0.0;
        }
        shift_m(source, &self.bounces(path, centre), sensor)
    }

    fn bounces(&self, path: &[PatchId], centre: impl Fn(&PatchId) -> Point) -> Vec<(Point, Option<Footprint>)> {
        path.iter().map(|patch| (centre(patch), self.0.get(patch).copied())).collect()
    }

    /// All of them so many standard deviations off, three numbers for each in the order of the patches, one for each
    /// error. Those that are missing are 0.
    #[must_use]
    pub fn moved(&self, sds: &[f64]) -> Self {
        let own = |n: usize| [0, 1, 2].map(|k| sds.get(3 * n + k).copied().unwrap_or(0.0));
        Self(self.0.iter().enumerate().map(|(n, (patch, footprint))| (*patch, footprint.moved(own(n)))).collect())
    }

    /// [`Self::shift_m`] as far as the errors of footprints let it be known.
    ///
    /// Where a leg grazes a patch, a shift is far from linear in the direction of that patch. So what it is at its
    /// footprint does not tell, but what it is where the three errors are one standard deviation to either side: at all
    /// eight combinations, of which linear terms and what is left of the products come, and one by one, which tells the
    /// squares. (Statistical linearisation, as in the sigma points of Julier and Uhlmann, Proc. IEEE 92:401, 2004.) A
    /// term `q c^2` of an error `c` of variance 1 has the mean q, and the variance `2 q^2` that no `c` explains.
    #[must_use]
    pub fn shift(&self, source: Point, path: &[PatchId], centre: impl Fn(&PatchId) -> Point, sensor: Point) -> Shift {
        if self.is_empty() {
            return Shift::default();
        }
        let bounces = self.bounces(path, centre);
        let [here_m, doubt_m] = shift_and_doubt_m(source, &bounces, sensor);
        let with = |patch: PatchId, other: Footprint| {
            let of = |(each, bounce): (&PatchId, &(Point, Option<Footprint>))| {
                (bounce.0, if *each == patch { Some(other) } else { bounce.1 })
            };
            shift_m(source, &path.iter().zip(&bounces).map(of).collect::<Vec<_>>(), sensor)
        };
        let mut patches: Vec<PatchId> = path.to_vec();
        patches.sort_unstable();
        patches.dedup();
        let mut shift = Shift { mean_m: here_m, sd_m: doubt_m, changes: Vec::new() };
        for patch in patches {
            let Some(footprint) = self.0.get(&patch).filter(|one| one.errors_m.norm() > 0.0) else { continue };
            let more_m = |sds: [f64; 3]| with(patch, footprint.moved(sds)) - here_m;
            let corners = [0, 1, 2, 3, 4, 5, 6, 7].map(|n| [1, 2, 4].map(|bit| if n & bit == 0 { 1.0 } else { -1.0 }));
            let at_corners_m = corners.map(more_m);
            let mean_m = |weight: &dyn Fn(usize) -> f64| (0..8).map(|n| weight(n) * at_corners_m[n]).sum::<f64>() / 8.0;
            let all_m = mean_m(&|_| 1.0);
            let each_m = [0, 1, 2].map(|error| mean_m(&|n| corners[n][error]));
            let of_linear_m2: f64 = each_m.iter().map(|each_m| each_m * each_m).sum();
            let of_products_m2 = mean_m(&|n| at_corners_m[n]) - all_m * all_m - of_linear_m2;
            let square_m = |error: usize| {
                let sides = [1.0, -1.0].map(|sd| more_m([0, 1, 2].map(|k| if k == error { sd } else { 0.0 })));
                0.5 * (sides[0] + sides[1])
            };
            let of_squares_m2: f64 = [0, 1, 2].map(square_m).iter().map(|square_m| 2.0 * square_m * square_m).sum();
            shift.mean_m += all_m;
            shift.sd_m = (shift.sd_m * shift.sd_m + of_products_m2.max(0.0) + of_squares_m2).sqrt();
            shift.changes.push((patch, each_m));
        }
        shift
    }
}

/// A shift with errors.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shift {
    /// Its mean.
    pub mean_m: f64,
    /// Standard deviation of what no error of a footprint explains.
    pub sd_m: f64,
    /// What a standard deviation of each error of a footprint adds, for the patches whose footprint is uncertain.
    pub changes: Vec<(PatchId, [f64; 3])>,
}

impl Footprint {
    /// One without error.
    #[must_use]
    pub fn exact(normal: Vector3<f64>, size_m: f64) -> Self {
        Self { normal, size_m, errors_m: Matrix3::zeros() }
    }

    /// One by the covariance of its normal times its diameter.
    #[must_use]
    pub fn with_covariance(normal: Vector3<f64>, size_m: f64, covariance_m2: Matrix3<f64>) -> Self {
        let principal = covariance_m2.symmetric_eigen();
        let sds_m = principal.eigenvalues.map(|variance_m2| variance_m2.max(0.0).sqrt());
        Self { normal, size_m, errors_m: principal.eigenvectors * Matrix3::from_diagonal(&sds_m) }
    }

    /// Covariance of the normal times the diameter.
    #[must_use]
    pub fn covariance_m2(&self) -> Matrix3<f64> {
        self.errors_m * self.errors_m.transpose()
    }

    /// Standard deviation of the normal's direction to either side, the mean of all sides.
    #[must_use]
    pub fn normal_sd_rad(&self) -> f64 {
        let across_m2 = self.errors_m.norm_squared() - self.size_sd_m().powi(2);
        if self.size_m > 0.0 { (0.5 * across_m2.max(0.0)).sqrt() / self.size_m } else { 0.0 }
    }

    /// Standard deviation of the diameter.
    #[must_use]
    pub fn size_sd_m(&self) -> f64 {
        (self.normal.transpose() * self.errors_m).norm()
    }

    /// The footprint so many standard deviations of each error off.
    fn moved(&self, sds: [f64; 3]) -> Self {
        let moved_m = self.size_m * self.normal + self.errors_m * Vector3::from(sds);
        Self { normal: moved_m.try_normalize(0.0).unwrap_or(self.normal), size_m: moved_m.norm(), ..*self }
    }
}

/// What the mean way of the light from `source` over `patches` (centres, in the order light meets them; `None` for one
/// without known footprint, which is taken as a point) to `sensor` is longer than the way over the centres.
#[must_use]
pub fn shift_m(source: Point, patches: &[(Point, Option<Footprint>)], sensor: Point) -> f64 {
    shift_and_doubt_m(source, patches, sensor)[0]
}

/// The shift, and the root of the summed squares of how far off it may be where patches cross the planes of others.
fn shift_and_doubt_m(source: Point, patches: &[(Point, Option<Footprint>)], sensor: Point) -> [f64; 2] {
    let at = |bounce: usize| {
        let (centre, footprint) = &patches[bounce];
        let Some(footprint) = footprint else { return [0.0; 2] };
        let before = match bounce.checked_sub(1) {
            None => Leg::new(*centre, source, End::Laser, footprint),
            Some(before) => Leg::new(*centre, patches[before].0, End::Patch(patches[before].1), footprint),
        };
        let after = match patches.get(bounce + 1) {
            None => Leg::new(*centre, sensor, End::Sensor, footprint),
            Some((point, of)) => Leg::new(*centre, *point, End::Patch(*of), footprint),
        };
        let slope = before.along + after.along;
        let normal = footprint.normal;
        let in_plane = |pull: Vector3<f64>| pull.dot(&slope) - pull.dot(&normal) * slope.dot(&normal);
        let of_disk_m2 = footprint.size_m * footprint.size_m / 16.0;
        let shift_m = of_disk_m2 * (in_plane(before.pull + after.pull) + 0.5 * (before.bend + after.bend));
        [shift_m, of_disk_m2 * in_plane(before.left_out).hypot(in_plane(after.left_out))]
    };
    (0..patches.len()).map(at).fold([0.0; 2], |sum, one| [sum[0] + one[0], sum[1].hypot(one[1])])
}

/// What stands at the other end of a leg.
#[derive(Clone, Copy)]
enum End {
    Laser,
    Sensor,
    Patch(Option<Footprint>),
}

/// A patch that crosses the plane of the other and lets light through has the mean `E[x |h + x|] / E|h + x|` over
/// heights x from its middle, that at h: nearly h where h is small. So with `u` the largest x, `1 / h` bends into
/// `h / sqrt(h^4 + (u / 2)^4)`.
const CROSSING: f64 = 0.5;
/// Two patches in one plane would send each other no light, and next to that a shift would be infinitely steep in their
/// directions: the sine of the angle between them counts as this at least.
const COPLANAR: f64 = 0.3;
/// How far off the shift of a patch is whose middle lies in the plane of the other, over the shift where it just
/// touches that plane, whose mean lies 0.25 radii aside. That of an opaque patch, one half of which is dark, lies 0.59
/// radii aside, that of one that lets light through in its middle.
const CROSSED: f64 = 1.4;

/// Heights above a plane that are known to so many of their standard deviations have their sign.
const UNSURE: f64 = 2.0;

/// A leg as a patch's points see it.
struct Leg {
    /// Gradient of its length.
    along: Vector3<f64>,
    /// Gradient of the logarithm of its light's weight, in the patch's plane.
    pull: Vector3<f64>,
    /// How far off that may be where the patch crosses the plane of the other.
    left_out: Vector3<f64>,
    /// Trace of its length's second derivatives in the patch's plane.
    bend: f64,
}

impl Leg {
    fn new(centre: Point, other: Point, end: End, footprint: &Footprint) -> Self {
        let arm = centre - other;
        let length_m = arm.norm().max(f64::MIN_POSITIVE);
        let along = arm / length_m;
        // The patch's own cosine is that of its plane's distance, the same for all its points, over the length.
        let (pull, left_out) = match end {
            End::Laser => (Vector3::zeros(), Vector3::zeros()),
            End::Sensor | End::Patch(None) => (-3.0 / length_m * along, Vector3::zeros()),
            End::Patch(Some(other)) => {
                // By how much the height above the other's plane changes from the patch's centre to its edge.
                let height_m = other.normal.dot(&arm);
                let sine = other.normal.cross(&footprint.normal).norm();
                let edge_m = 0.5 * footprint.size_m * sine.hypot(COPLANAR);
                let bent_m2 = (height_m.powi(4) + (CROSSING * edge_m).powi(4)).sqrt();
                let pull = height_m / bent_m2.max(f64::MIN_POSITIVE) * other.normal;
                let sd_m = (other.errors_m.transpose() * arm).norm() / other.size_m.max(f64::MIN_POSITIVE);
                let near_m = f64::max(edge_m, UNSURE * sd_m).max(f64::MIN_POSITIVE);
                let crossed = 1.0 - (height_m.abs() / near_m).min(1.0);
                (pull - 4.0 / length_m * along, CROSSED * crossed / near_m * other.normal)
            }
        };
        let bend = (1.0 + along.dot(&footprint.normal).powi(2)) / length_m;
        Self { along, pull, left_out, bend }
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    use super::*;

    /// Points of a disk, evenly by area, each with its opposite: their mean is the centre.
    fn disk(centre: Point, footprint: &Footprint) -> Vec<Point> {
        let aside = footprint.normal.cross(&Vector3::new(0.3, -0.7, 0.64)).normalize();
        let up = footprint.normal.cross(&aside);
        let golden = std::f64::consts::PI * (3.0 - 5_f64.sqrt());
        let point = |n: usize| {
            let (radius, angle) = (0.5 * footprint.size_m * ((n as f64 + 0.5) / 300.0).sqrt(), golden * n as f64);
            aside * (radius * angle.cos()) + up * (radius * angle.sin())
        };
        (0..300).map(point).flat_map(|offset| [centre + offset, centre - offset]).collect()
    }

    /// Only uncertain footprints change a shift, and their changes are those of footprints a standard deviation off.
    #[test]
    fn changes_are_those_of_other_footprints() {
        let certain = Footprint::exact(Vector3::new(0.2, -0.9, 0.4).normalize(), 0.04);
        let along = certain.normal * certain.normal.transpose();
        let covariance_m2 = (0.1_f64 * 0.04).powi(2) * (Matrix3::identity() - along) + 0.003_f64.powi(2) * along;
        let uncertain = Footprint::with_covariance(certain.normal, certain.size_m, covariance_m2);
        assert!((uncertain.covariance_m2() - covariance_m2).norm() < 1e-12);
        assert!((uncertain.normal_sd_rad() - 0.1).abs() < 1e-12 && (uncertain.size_sd_m() - 0.003).abs() < 1e-12);
        let places = [Point::new(0.3, 1.0, 0.1), Point::new(-0.4, 1.2, -0.2)];
        let centre = |patch: &PatchId| places[*patch as usize];
        let (source, sensor) = (Point::origin(), Point::new(0.1, 0.0, 0.0));
        let footprints = Footprints(BTreeMap::from([(0, certain), (1, uncertain)]));
        let shift = footprints.shift(source, &[0, 1], centre, sensor);
        assert_eq!(shift.changes.iter().map(|(patch, _)| *patch).collect::<Vec<_>>(), [1]);
        let changes_m = shift.changes[0].1;
        // The error along the normal is one of the size, of either sign. A shift goes with the square of the size.
        let along_m = |k: &usize| uncertain.errors_m.column(*k).dot(&certain.normal);
        let of_size = (0..3).find(|k| along_m(k).abs() > 0.002).unwrap();
        let shift_m = |footprints: &Footprints| footprints.shift_m(source, &[0, 1], centre, sensor);
        let here_m = shift_m(&footprints);
        let other = Footprint { size_m: uncertain.size_m + along_m(&of_size), ..uncertain };
        let larger = Footprints(BTreeMap::from([(0, certain), (1, other)]));
        let of_one_m = shift_m(&larger) - here_m;
        let square_m = changes_m[of_size] * along_m(&of_size) / (2.0 * uncertain.size_m);
        assert!((changes_m[of_size] + square_m - of_one_m).abs() < 0.02 * of_one_m.abs(), "{shift:?} {of_one_m}");
        let mut of_turns = (0..3).filter(|k| *k != of_size).map(|k| changes_m[k].abs());
        assert!(of_turns.any(|change_m| change_m > 1e-6), "a turn shifts the light: {shift:?}");
        // A little off in all three: the sum of their changes.
        let sds = [0.05, -0.1, 0.08];
        let moved_m = shift_m(&footprints.moved(&[[0.0; 3], sds].concat())) - here_m;
        let sum_m: f64 = sds.iter().zip(changes_m).map(|(sd, change_m)| sd * change_m).sum();
        let most_m: f64 = sds.iter().zip(changes_m).map(|(sd, change_m)| (sd * change_m).abs()).sum();
        assert!((moved_m - sum_m).abs() < 0.1 * most_m, "{moved_m} {sum_m}");
        assert!((shift_m(&footprints.moved(&[])) - here_m).abs() < 1e-12);
    }

    /// Footprints drawn with their errors: the mean of their shifts is the one that is reported, and what errors do not
    /// explain in proportion scatters as it says, also where a leg grazes a patch.
    #[test]
    fn shifts_of_footprints_with_errors_scatter_as_they_say() {
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let (source, sensor) = (Point::origin(), Point::new(0.1, 0.0, 0.0));
        let places = [Point::new(0.3, 1.0, 0.1), Point::new(-0.4, 1.2, -0.2)];
        let leg = (places[1] - places[0]).normalize();
        // The sine of the angle between the leg and the second patch.
        for (sine, least) in [(0.6, 0.5), (0.3, 0.5), (0.1, 0.3)] {
            let up = leg.cross(&Vector3::new(0.2, 0.3, -0.9)).normalize();
            let normal = leg * sine + up * (1.0_f64 - sine * sine).sqrt();
            let along = normal * normal.transpose();
            let covariance_m2 = 0.003_f64.powi(2) * (Matrix3::identity() - along) + 0.002_f64.powi(2) * along;
            let uncertain = Footprint::with_covariance(normal, 0.03, covariance_m2);
            let other = Footprint::exact(Vector3::new(0.2, -0.9, 0.4).normalize(), 0.03);
            let footprints = Footprints(BTreeMap::from([(0, other), (1, uncertain)]));
            let centre = |patch: &PatchId| places[*patch as usize];
            let shift = footprints.shift(source, &[0, 1], centre, sensor);
            let off_m = |_| {
                let sds: [f64; 3] = std::array::from_fn(|_| rng.sample(StandardNormal));
                let moved = footprints.moved(&[[0.0; 3], sds].concat());
                let of_errors_m: f64 = sds.iter().zip(shift.changes[0].1).map(|(sd, each_m)| sd * each_m).sum();
                moved.shift_m(source, &[0, 1], centre, sensor) - shift.mean_m - of_errors_m
            };
            let mut off_m: Vec<f64> = (0..4000).map(off_m).collect();
            let mean_m = off_m.iter().sum::<f64>() / off_m.len() as f64;
            eprintln!("sine {sine}: the mean is off by {:.2} um", 1e6 * mean_m);
            // Next to a plane a few draws make the mean.
            assert!(sine < 0.5 || mean_m.abs() < 0.1 * shift.sd_m, "{sine}: {mean_m} {}", shift.sd_m);
            off_m.sort_by(f64::total_cmp);
            // Of a normal distribution the middle, and the standard deviation by where two thirds of all lie.
            let (middle_m, scatter_m) = (off_m[2000], 0.5 * (off_m[3365] - off_m[635]));
            let changes_m = Vector3::from(shift.changes[0].1).norm();
            let um = [middle_m, scatter_m, shift.sd_m, changes_m].map(|length_m| 1e6 * length_m);
            eprintln!(
                "sine {sine}: off by {:.1} um, scatter {:.1}, stated {:.1}; errors change it by {:.1}",
                um[0], um[1], um[2], um[3]
            );
            assert!(middle_m.abs() < 0.5 * shift.sd_m && scatter_m < 1.5 * shift.sd_m, "{um:?}");
            assert!(scatter_m > least * shift.sd_m, "{um:?}");
        }
    }

    /// The mean by brute force over all points of two disks.
    fn brute_m(source: Point, patches: &[(Point, Footprint)], sensor: Point) -> f64 {
        let points: Vec<Vec<Point>> = patches.iter().map(|(centre, footprint)| disk(*centre, footprint)).collect();
        // Light and light times way, at each point of the patch reached.
        let mut state: Vec<(f64, f64)> = points[0].iter().map(|p| (1.0, (p - source).norm())).collect();
        for n in 1..patches.len() {
            let (from, to) = (&patches[n - 1].1.normal, &patches[n].1.normal);
            state = points[n]
                .iter()
                .map(|q| {
                    points[n - 1].iter().zip(&state).fold((0.0, 0.0), |sum, (p, (light, way))| {
                        let arm = q - p;
                        let r = arm.norm();
                        let w = from.dot(&arm).abs() * to.dot(&arm).abs() / r.powi(4);
                        (sum.0 + w * light, sum.1 + w * (way + light * r))
                    })
                })
                .collect();
        }
        let last = patches.len() - 1;
        let (light, way) = points[last].iter().zip(&state).fold((0.0, 0.0), |sum, (p, (light, way))| {
            let arm = sensor - p;
            let w = patches[last].1.normal.dot(&arm).abs() / arm.norm().powi(3);
            (sum.0 + w * light, sum.1 + w * (way + light * arm.norm()))
        });
        let centres: f64 = patches.windows(2).map(|pair| (pair[1].0 - pair[0].0).norm()).sum();
        way / light - (patches[0].0 - source).norm() - centres - (sensor - patches[last].0).norm()
    }

    #[test]
    fn it_is_the_mean_over_all_points() {
        let (source, sensor) = (Point::new(0.0, 0.0, 0.0), Point::new(0.1, 0.0, 0.02));
        let patch = |centre: [f64; 3], normal: [f64; 3], size_m: f64| {
            (Point::from(centre), Footprint::exact(Vector3::from(normal).normalize(), size_m))
        };
        let wall = patch([0.4, 1.1, 0.2], [-0.5, -1.0, 0.2], 0.05);
        let side = patch([1.0, 0.7, -0.1], [-1.0, 0.1, 0.3], 0.06);
        let far = patch([0.2, 0.6, 0.7], [0.1, -0.3, -1.0], 0.05);
        for path in [vec![wall], vec![wall, side], vec![side, wall], vec![wall, far, side], vec![far, side, far]] {
            let brute = brute_m(source, &path, sensor);
            let spots: Vec<(Point, Option<Footprint>)> = path.iter().map(|(p, f)| (*p, Some(*f))).collect();
            let shift = shift_m(source, &spots, sensor);
            eprintln!("{} bounces: {:.2} um, by brute force {:.2} um", path.len(), 1e6 * shift, 1e6 * brute);
            assert!(brute.abs() > 5e-5 && (shift / brute - 1.0).abs() < 0.02, "{shift} {brute}");
        }
    }

    /// Near the plane of another patch the shift is off by no more than is doubted of it, and hardly elsewhere.
    #[test]
    fn near_a_plane_a_shift_is_in_doubt() {
        let (source, sensor) = (Point::new(0.0, 0.0, 0.0), Point::new(0.05, 0.0, 0.02));
        let patch = |centre: [f64; 3], normal: [f64; 3]| {
            let normal = Vector3::from(normal).normalize();
            (Point::from(centre), Footprint::exact(normal, 0.03))
        };
        let tilted = patch([0.5, 1.0, 0.0], [-1.0, -0.4, 0.2]);
        for height_m in [0.02, 0.025, 0.03, 0.05, 0.1, 0.2] {
            let flat = patch([0.0, 1.0 + height_m, 0.1], [0.0, -1.0, 0.0]);
            let path = [flat, tilted];
            let spots: Vec<(Point, Option<Footprint>)> = path.iter().map(|(at, disk)| (*at, Some(*disk))).collect();
            let [shift_m, doubt_m] = shift_and_doubt_m(source, &spots, sensor);
            let off_m = (shift_m - brute_m(source, &path, sensor)).abs();
            eprintln!("{height_m} m: {:.1} um off, {:.1} in doubt", 1e6 * off_m, 1e6 * doubt_m);
            assert!(off_m < doubt_m + 5e-6, "{height_m} m: {off_m} {doubt_m}");
            assert!(height_m < 0.1 || doubt_m < 1e-6, "{height_m} m: {shift_m} {doubt_m}");
        }
    }

    #[test]
    fn points_have_no_shift_and_the_sign_of_a_normal_does_not_matter() {
        let (origin, there) = (Point::origin(), Point::new(0.3, 1.0, 0.2));
        assert_eq!(shift_m(origin, &[(there, None)], origin), 0.0);
        let normal = Vector3::new(0.1, -1.0, 0.3).normalize();
        let shift = |normal| {
            let footprint = Some(Footprint::exact(normal, 0.04));
            shift_m(origin, &[(there, footprint), (Point::new(0.9, 0.5, 0.0), footprint)], origin)
        };
        assert_eq!(shift(normal), shift(-normal));
    }
}
