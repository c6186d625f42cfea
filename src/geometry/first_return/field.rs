//! A local field of lengths about a place of the wall.

use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector3};

use crate::Point;

/// Value, two turns of its direction, three curvatures.
pub type Unknowns = SVector<f64, 6>;
pub type Covariance = SMatrix<f64, 6, 6>;

/// Rounds of least squares, and change of chi-square that ends them.
const ROUNDS: usize = 6;
const DONE: f64 = 1e-3;
/// Standard deviation of a curvature before there is light, over one over the length.
const BEND_SD: f64 = 7.0;
/// Frequencies and weights of a Gaussian spectrum, by quadrature of Hermite.
const SPECTRUM: [[f64; 2]; 3] =
    [[0.0, 0.533_333_333_333], [1.355_626_179_974, 0.222_075_922_006], [2.856_970_013_873, 0.011_257_411_328]];
/// A surface faces the wall where its curvature is below that of an edge by so many standard deviations. An edge needs
/// a curvature known to this share: a sphere of a fifth of its distance has five sixths of the curvature of a point.
const APART: f64 = 2.5;
const SURE: f64 = 0.07;
/// Step of differences.
const STEP: f64 = 1e-6;

/// A length at a place of the wall.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    pub at: Point,
    pub length_m: f64,
    /// Standard deviation of its noise, and of the law of its light.
    pub sd_m: f64,
    pub law_m: f64,
}

/// What part of a surface a point is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A surface that faces the wall's point.
    Smooth,
    /// An edge.
    Edge,
    /// A corner, or a thing that is small in all directions.
    Corner,
    /// Curvatures are not known well enough.
    Unknown,
}

/// Lengths about a place: `(1 + round (L - length))^2 = 1 + 2 round n.u + (round n.u)^2 + round u.K u` at `u` from it,
/// exact for a plane, a straight edge and a corner, and with the right `round` for a sphere and a cylinder.
#[derive(Clone, Debug)]
pub struct Field {
    /// The place.
    pub at: Point,
    /// Length there.
    pub length_m: f64,
    /// Direction in which lengths grow.
    pub direction: Vector3<f64>,
    /// Two directions across it.
    across: [Vector3<f64>; 2],
    /// Curvature of the lengths along these.
    bend: Matrix2<f64>,
    round: f64,
    /// Of noise, and of the law of light, for the unknowns.
    pub noise: Covariance,
    pub law: Covariance,
    /// Chi-square, and lengths that entered.
    pub square: f64,
    pub count: usize,
}

impl Field {
    /// Before there are neighbours.
    pub fn new(sample: &Sample, direction: Vector3<f64>) -> Self {
        Self {
            at: sample.at,
            length_m: sample.length_m,
            direction,
            across: frame(&direction),
            bend: Matrix2::zeros(),
            round: 0.0,
            noise: Covariance::zeros(),
            law: Covariance::zeros(),
            square: 0.0,
            count: 0,
        }
    }

    /// Length at a place, and its slopes by the unknowns.
    pub fn length(&self, place: &Point) -> (f64, Unknowns) {
        let u = place - self.at;
        let along = self.direction.dot(&u);
        let [x, y] = self.across.map(|across| across.dot(&u));
        let [xx, xy, yy] = [self.bend[(0, 0)], self.bend[(0, 1)], self.bend[(1, 1)]];
        let bent = xx * x * x + 2.0 * xy * x * y + yy * y * y;
        let q = along + 0.5 * self.round * along * along + 0.5 * bent;
        let root = (1.0 + 2.0 * self.round * q).max(0.01).sqrt();
        let grow = 1.0 + self.round * along;
        let turns = [x * grow - along * (xx * x + xy * y), y * grow - along * (xy * x + yy * y)];
        let slopes = Unknowns::new(root, turns[0], turns[1], 0.5 * x * x, x * y, 0.5 * y * y) / root;
        (self.length_m + 2.0 * q / (1.0 + root), slopes)
    }

    /// The field of least squares from this start; `None` where the members do not determine it.
    pub fn fit(&self, samples: &[Sample], members: &[u32], zone_m: f64) -> Option<Self> {
        let mut field = self.clone();
        field.count = members.len();
        let mut before = f64::INFINITY;
        for _ in 0..ROUNDS {
            let (mut information, mut gradient) = (Covariance::zeros(), Unknowns::zeros());
            field.square = 0.0;
            for sample in members.iter().map(|n| &samples[*n as usize]) {
                let (length_m, slopes) = field.length(&sample.at);
                let weight = sample.sd_m.powi(-2);
                let rest = sample.length_m - length_m;
                field.square += weight * rest * rest;
                information += slopes * slopes.transpose() * weight;
                gradient += slopes * (rest * weight);
            }
            let precision = (field.length_m / BEND_SD).powi(2);
            for (k, place) in [(0, 0), (0, 1), (1, 1)].into_iter().enumerate() {
                information[(3 + k, 3 + k)] += precision;
                gradient[3 + k] -= precision * field.bend[place];
            }
            let root = information.cholesky()?;
            field.step(&root.solve(&gradient));
            field.noise = root.inverse();
            if (field.square - before).abs() < DONE {
                break;
            }
            before = field.square;
        }
        if field.length_m <= 0.0 || !field.square.is_finite() {
            return None;
        }
        field.law = field.noise * field.spread(samples, members, zone_m) * field.noise;
        Some(field)
    }

    fn step(&mut self, step: &Unknowns) {
        self.length_m += step[0];
        self.turn(step[1], step[2]);
        self.bend += Matrix2::new(step[3], step[4], step[4], step[5]);
        let most = self.bend.symmetric_eigenvalues().max();
        self.round = most.clamp(0.0, 1.0 / self.length_m.max(1e-3));
    }

    fn turn(&mut self, first: f64, second: f64) {
        self.direction = (self.direction + self.across[0] * first + self.across[1] * second).normalize();
        let across = (self.across[0] - self.direction * self.direction.dot(&self.across[0])).normalize();
        self.across = [across, self.direction.cross(&across)];
    }

    /// Covariance of the gradient under errors of the law: a Gaussian random function over the wall, whose correlation
    /// falls as a Gaussian of `zone_m`, as a sum of waves.
    fn spread(&self, samples: &[Sample], members: &[u32], zone_m: f64) -> Covariance {
        let waves = |place: f64| SPECTRUM.map(|[frequency, _]| (frequency * place / zone_m).sin_cos());
        let mut sums = [[[Unknowns::zeros(); 4]; 3]; 3];
        for sample in members.iter().map(|n| &samples[*n as usize]) {
            let u = sample.at - self.at;
            let (_, slopes) = self.length(&sample.at);
            let row = slopes * (sample.law_m / sample.sd_m.powi(2));
            let [first, second] = self.across.map(|across| waves(across.dot(&u)));
            for (a, (sin_a, cos_a)) in first.into_iter().enumerate() {
                for (b, (sin_b, cos_b)) in second.into_iter().enumerate() {
                    let products = [cos_a * cos_b, sin_a * sin_b, sin_a * cos_b, cos_a * sin_b];
                    sums[a][b].iter_mut().zip(products).for_each(|(sum, product)| *sum += row * product);
                }
            }
        }
        let mut spread = Covariance::zeros();
        for (a, sums) in sums.iter().enumerate() {
            for (b, products) in sums.iter().enumerate() {
                // Both signs of each frequency that is not zero.
                let both = |n: usize| if n > 0 { 2.0 } else { 1.0 };
                let weight = SPECTRUM[a][1] * SPECTRUM[b][1] * both(a) * both(b);
                products.iter().for_each(|sum| spread += sum * sum.transpose() * weight);
            }
        }
        spread
    }

    /// Distance from the place to the point of the surface.
    pub fn distance_m(&self, lit: Option<&Point>) -> f64 {
        let Some(lit) = lit else { return self.length_m };
        let apart = self.at - lit;
        (self.length_m.powi(2) - apart.norm_squared()) / (2.0 * (self.length_m - apart.dot(&self.direction)))
    }

    /// The point of the surface, and the unit vector away from it.
    pub fn reading(&self, lit: Option<&Point>) -> (Point, Vector3<f64>) {
        let point = self.at - self.direction * self.distance_m(lit);
        let normal = lit.map_or(self.direction, |lit| (self.direction + (lit - point).normalize()).normalize());
        (point, normal)
    }

    /// Covariances of both, from that of the unknowns.
    pub fn covariances(&self, lit: Option<&Point>, covariance: &Covariance) -> [Matrix3<f64>; 2] {
        let mut slopes = [Matrix3::zeros(), Matrix3::zeros()];
        for k in 0..3 {
            let read = |step: f64| {
                let mut field = self.clone();
                match k {
                    0 => field.length_m += step,
                    1 => field.turn(step, 0.0),
                    _ => field.turn(0.0, step),
                }
                field.reading(lit)
            };
            let (up, down) = (read(STEP), read(-STEP));
            slopes[0].set_column(k, &((up.0 - down.0) / (2.0 * STEP)));
            slopes[1].set_column(k, &((up.1 - down.1) / (2.0 * STEP)));
        }
        let own = covariance.fixed_view::<3, 3>(0, 0).into_owned();
        slopes.map(|slopes| slopes * own * slopes.transpose())
    }

    /// Curvatures of the lengths times the distance, larger one first, and their standard deviations: 1 where the
    /// surface ends.
    pub fn bends(&self, lit: Option<&Point>) -> [[f64; 2]; 2] {
        let distance_m = self.distance_m(lit);
        let eigen = self.bend.symmetric_eigen();
        let covariance = (self.noise + self.law).fixed_view::<3, 3>(3, 3).into_owned();
        let mut bends = [0, 1].map(|k| {
            let [x, y] = [eigen.eigenvectors[(0, k)], eigen.eigenvectors[(1, k)]];
            let slopes = Vector3::new(x * x, 2.0 * x * y, y * y);
            [eigen.eigenvalues[k] * distance_m, slopes.dot(&(covariance * slopes)).sqrt() * distance_m]
        });
        bends.sort_by(|a, b| b[0].total_cmp(&a[0]));
        bends
    }

    /// What part of the surface it shows.
    pub fn kind(&self, lit: Option<&Point>) -> Kind {
        let [first, second] = self.bends(lit).map(|[bend, sd]| {
            let faces = 1.0 - bend > APART * sd;
            let ends = (1.0 - bend).abs() <= APART * sd && sd < SURE;
            (faces, ends)
        });
        match (first, second) {
            ((true, _), _) => Kind::Smooth,
            ((_, true), (true, _)) => Kind::Edge,
            ((_, true), (_, true)) => Kind::Corner,
            _ => Kind::Unknown,
        }
    }
}

/// Two unit vectors across another.
pub fn frame(direction: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let axis = Vector3::ith(direction.iamin(), 1.0);
    let first = (axis - direction * direction.dot(&axis)).normalize();
    [first, direction.cross(&first)]
}
