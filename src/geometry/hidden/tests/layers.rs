//! Scenes with patches that light reaches over hidden ones only, for tests and studies: lengths of fifth bounces.
//! Shares no code with the search.

use nalgebra::{Matrix3, Vector3};
use periscope_cancel::Cancel;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::{Arrival, Focus, Point, Profile, Room, Way};

/// What a scene is drawn from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setting {
    /// Visible patches, all lit and seen.
    pub visible: usize,
    /// Hidden patches that these show, in place.
    pub first: usize,
    /// Hidden patches that only the former show.
    pub second: usize,
    /// Standard deviation of an arrival.
    pub sd_m: f64,
    /// Chance that a fifth bounce over a patch of the second layer makes an arrival.
    pub seen: f64,
    /// False arrivals of a profile.
    pub spurious: usize,
}

/// A scene and its profiles.
pub struct Drawn {
    /// What the search is given: patches of the first layer where third bounces have them.
    pub room: Room,
    /// What the search is given.
    pub profiles: Vec<Profile>,
    /// Patches of the second layer.
    pub hidden: Vec<Point>,
    /// Bound of each from the arrivals that are there, their paths known, with what third bounces leave open of the
    /// first layer: root of the sum of variances.
    pub bounds_m: Vec<f64>,
}

fn within(rng: &mut ChaCha8Rng, low: [f64; 3], high: [f64; 3]) -> Point {
    Point::from(Vector3::from_fn(|k, _| rng.random_range(low[k]..high[k])))
}

fn apart(rng: &mut ChaCha8Rng, count: usize, low: [f64; 3], high: [f64; 3]) -> Vec<Point> {
    let mut points: Vec<Point> = Vec::new();
    while points.len() < count {
        let point = within(rng, low, high);
        if points.iter().all(|other| (other - point).norm() > 0.15) {
            points.push(point);
        }
    }
    points
}

fn slope(at: Point, ends: [Point; 2]) -> Vector3<f64> {
    ends.iter().map(|end| (at - end).normalize()).sum()
}

/// Draws a scene: visible patches on two walls, the first layer before them, the second beyond it.
#[must_use]
pub fn draw(setting: &Setting, seed: u64) -> Drawn {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let visible: Vec<Point> = (0..setting.visible)
        .map(|k| {
            let (along, z) = (rng.random_range(0.0..1.6), rng.random_range(-0.8..0.8));
            if k % 2 == 0 { Point::new(along, 0.0, z) } else { Point::new(0.0, along, z) }
        })
        .collect();
    let first = apart(&mut rng, setting.first, [0.8, 0.8, -0.4], [2.0, 1.8, 0.4]);
    let hidden = apart(&mut rng, setting.second, [1.4, 1.8, -0.5], [2.6, 2.8, 0.5]);
    let pairs = || (0..visible.len()).flat_map(|a| (0..visible.len()).map(move |b| (a, b)));
    // Third bounces in all profiles place the first layer.
    let placed: Vec<(Point, Matrix3<f64>)> = first
        .iter()
        .map(|q| {
            let slopes = pairs().map(|(a, b)| slope(*q, [visible[a], visible[b]]));
            let information: Matrix3<f64> = slopes.map(|slope| slope * slope.transpose()).sum();
            let covariance = information.try_inverse().expect("walls have two directions") * setting.sd_m.powi(2);
            let root = covariance.cholesky().expect("a covariance is positive").l();
            (q + root * Vector3::from_fn(|_, _| StandardNormal.sample(&mut rng)), covariance)
        })
        .collect();
    let longest_m = 9.0;
    let mut slopes: Vec<Vec<(Vec<usize>, Vec<Vector3<f64>>)>> = vec![Vec::new(); hidden.len()];
    let mut profiles = Vec::new();
    for (a, b) in pairs() {
        let explained_m = |q: &[Point], (p, r): (usize, usize)| (visible[a] - q[p]).norm() + (q[r] - visible[b]).norm();
        let at: Vec<Point> = placed.iter().map(|(point, _)| *point).collect();
        let (mut ways, mut arrivals) = (Vec::new(), Vec::new());
        for (p, r) in (0..first.len()).flat_map(|p| (0..first.len()).map(move |r| (p, r))) {
            // Back and forth over one patch both orders are one arrival.
            if a == b && r < p {
                continue;
            }
            let mean_m2 = |n: usize| placed[n].1.trace() / 3.0;
            let along = |n: usize, v: usize| {
                let along = (at[n] - visible[v]).normalize();
                along.dot(&(placed[n].1 * along))
            };
            let sd_m = (along(p, a) + along(r, b) + mean_m2(p) + mean_m2(r)).sqrt();
            ways.push(Way::new([p, r], explained_m(&at, (p, r)), sd_m));
            for (n, x) in hidden.iter().enumerate() {
                if rng.random_bool(setting.seen) {
                    let error: f64 = StandardNormal.sample(&mut rng);
                    let inner_m = (x - first[p]).norm() + (x - first[r]).norm();
                    let length_m = explained_m(&first, (p, r)) + inner_m + setting.sd_m * error;
                    arrivals.push(Arrival { length_m, sd_m: setting.sd_m });
                    let of = |q: usize, v: usize| slope(first[q], [visible[v], *x]);
                    slopes[n].push((vec![p, r], vec![slope(*x, [first[p], first[r]]), of(p, a), of(r, b)]));
                }
            }
        }
        for _ in 0..setting.spurious {
            arrivals.push(Arrival { length_m: rng.random_range(2.0..longest_m), sd_m: setting.sd_m });
        }
        let span_m = [(visible[a] - visible[b]).norm(), longest_m];
        profiles.push(Profile::over(0, ways, arrivals, Vec::new(), span_m));
    }
    let covariances: Vec<Matrix3<f64>> = placed.iter().map(|(_, covariance)| *covariance).collect();
    let bounds_m = slopes.iter().map(|slopes| bound_m(slopes, &covariances, setting.sd_m)).collect();
    let foci = placed.iter().map(|(point, _)| Focus { point: *point, normal: None }).collect();
    Drawn {
        room: Room { foci, dimensions: 3, false_alarm: 1e-2, count: None, blend_m: 0.0, cancel: Cancel::never() },
        profiles,
        hidden,
        bounds_m,
    }
}

/// Root of the sum of variances of a patch of the second layer, with the patches of the first layer unknown but for
/// their prior.
fn bound_m(slopes: &[(Vec<usize>, Vec<Vector3<f64>>)], prior: &[Matrix3<f64>], sd_m: f64) -> f64 {
    let size = 3 + 3 * prior.len();
    let mut information = nalgebra::DMatrix::<f64>::zeros(size, size);
    for (n, covariance) in prior.iter().enumerate() {
        let inverse = covariance.try_inverse().expect("a covariance is positive");
        information.view_mut((3 + 3 * n, 3 + 3 * n), (3, 3)).copy_from(&inverse);
    }
    for (foci, parts) in slopes {
        let mut row = nalgebra::DVector::<f64>::zeros(size);
        for (place, part) in std::iter::once(0).chain(foci.iter().map(|focus| 3 + 3 * focus)).zip(parts) {
            let mut block = row.fixed_rows_mut::<3>(place);
            block += part;
        }
        information += &row * row.transpose() / (sd_m * sd_m);
    }
    information.try_inverse().map_or(f64::INFINITY, |covariance| (0..3).map(|k| covariance[(k, k)]).sum::<f64>().sqrt())
}

/// Hidden patches with no found one within ten bounds or 10 mm, from where a fit of all patches together settles; found
/// ones that are none; squared errors and squared bounds of those that were found.
#[must_use]
pub fn score(drawn: &Drawn, solution: &[Point]) -> (usize, usize, Vec<(f64, f64)>) {
    let mut rest: Vec<Point> = solution.to_vec();
    let (mut missed, mut squares_m2) = (0, Vec::new());
    for (q, bound_m) in drawn.hidden.iter().zip(&drawn.bounds_m) {
        match rest.iter().position(|point| (point - q).norm() < (10.0 * bound_m).max(0.01)) {
            Some(n) => squares_m2.push(((rest.remove(n) - q).norm_squared(), bound_m * bound_m)),
            None => missed += 1,
        }
    }
    (missed, rest.len(), squares_m2)
}
