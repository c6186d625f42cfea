//! Passes over all pairs: the objective with its slope, and the normal matrix times a vector, eight pairs at once, in
//! chunks of rows that the data define.

use std::ops::Range;

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::{CHUNKS, HUBER, LANES, Measurements, Sds, Slope, Values, definite_inverse};

/// Pairs of patch i with j, j + 1, ...: direction from them to i, residual over standard deviation, weight.
struct Block {
    along: [[f64; LANES]; 3],
    residual_sd: [f64; LANES],
    residual: [f64; LANES],
    weight: [f64; LANES],
}

/// Fields of the sums of [`Measurements::slope`], by patch over its pairs: weight w, residual r, direction e from the
/// other patch. A vector stands in three fields: x, y, z.
mod slope_field {
    /// w.
    pub const STIFFNESS: usize = 0;
    /// w r.
    pub const PULL: usize = 1;
    /// w e.
    pub const STIFFNESS_ALONG: usize = 2;
    /// w r e.
    pub const PULL_ALONG: usize = 5;
    /// w e e': xx, yy, zz, xy, xz, yz.
    pub const MOMENTS: usize = 8;
    /// Number of fields.
    pub const COUNT: usize = 14;
}

/// Fields of the sums of [`Measurements::product`], by patch over its pairs: pull p on a pair, direction e from the
/// other patch.
mod product_field {
    /// p.
    pub const PULL: usize = 0;
    /// p e: x, y, z.
    pub const PULL_ALONG: usize = 1;
    /// Number of fields.
    pub const COUNT: usize = 4;
}

/// Sums over a chunk's pairs by patch, field by field.
struct Sums<const FIELDS: usize> {
    fields: [Vec<f64>; FIELDS],
    loss: f64,
}

impl<const FIELDS: usize> Sums<FIELDS> {
    fn new(len: usize) -> Self {
        Self { fields: std::array::from_fn(|_| vec![0.0; len]), loss: 0.0 }
    }

    /// Adds values to field `field` of the patches from `j` on, and gives them to the sum of the row.
    #[inline]
    fn add(&mut self, field: usize, j: usize, values: [f64; LANES]) {
        let at: &mut [f64; LANES] = (&mut self.fields[field][j..j + LANES]).try_into().expect("LANES values");
        (0..LANES).for_each(|l| at[l] += values[l]);
    }

    /// The vector of patch `i` that begins at field `x`.
    fn vector(&self, x: usize, i: usize) -> Vector3<f64> {
        Vector3::from_fn(|k, _| self.fields[x + k][i])
    }

    /// The symmetric matrix of patch `i` that begins at field `xx`.
    fn symmetric(&self, xx: usize, i: usize) -> Matrix3<f64> {
        let [xx, yy, zz, xy, xz, yz] = std::array::from_fn(|n| self.fields[xx + n][i]);
        Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
    }
}

#[inline]
fn load(from: &[f64], j: usize) -> [f64; LANES] {
    from[j..j + LANES].try_into().expect("LANES values")
}

#[inline]
fn lanes(f: impl Fn(usize) -> f64) -> [f64; LANES] {
    std::array::from_fn(f)
}

impl Measurements<'_> {
    /// Rows of each chunk: about as many pairs in each.
    fn chunks(&self) -> Vec<Range<usize>> {
        let row = |chunk: usize| (self.count as f64 * (chunk as f64 / CHUNKS as f64).sqrt()).round() as usize;
        (0..CHUNKS).map(|chunk| row(chunk)..row(chunk + 1)).collect()
    }

    /// Sums over all pairs: `work` adds those of one row. Chunks are added in order.
    fn sums<const FIELDS: usize>(&self, work: impl Fn(usize, &mut Sums<FIELDS>) + Sync) -> Sums<FIELDS> {
        let chunk = |rows: Range<usize>| {
            let mut sums = Sums::new(rows.end + LANES);
            rows.for_each(|i| work(i, &mut sums));
            sums
        };
        let parts: Vec<Sums<FIELDS>> = self.chunks().into_par_iter().map(chunk).collect();
        let mut all = Sums::new(self.stride);
        for part in parts {
            all.loss += part.loss;
            for (all, part) in all.fields.iter_mut().zip(&part.fields) {
                all.iter_mut().zip(part).for_each(|(all, part)| *all += part);
            }
        }
        all
    }

    /// Pairs of patch i with the patches from j on; those that are not below i have no weight.
    #[inline]
    fn block(&self, values: &Values, i: usize, j: usize) -> Block {
        let stride = self.stride;
        let arm: [[f64; LANES]; 3] = std::array::from_fn(|k| {
            let (x, from) = (values.x[k * stride + i], load(&values.x, k * stride + j));
            lanes(|l| x - from[l])
        });
        let square = lanes(|l| arm[0][l] * arm[0][l] + arm[1][l] * arm[1][l] + arm[2][l] * arm[2][l]);
        let length = square.map(f64::sqrt);
        let over = lanes(|l| if length[l] > 0.0 { 1.0 / length[l] } else { 0.0 });
        let along = arm.map(|arm| lanes(|l| arm[l] * over[l]));
        let (first, n) = (i * (i - 1) / 2 + j, (i - j).min(LANES));
        let (mut measured, mut over_sd) = ([0.0; LANES], [0.0; LANES]);
        let second = &self.lengths.second_m[first..first + n];
        measured.iter_mut().zip(second).for_each(|(measured, length)| *measured = f64::from(*length));
        match self.lengths.second_sd_m {
            Sds::Common(sd_m) => over_sd[..n].fill(1.0 / f64::from(sd_m)),
            Sds::Each(sds_m) => {
                let sds = &sds_m[first..first + n];
                over_sd.iter_mut().zip(sds).for_each(|(over, sd_m)| *over = 1.0 / f64::from(*sd_m));
            }
        }
        let (range, delay) = (load(&values.range, j), values.range[i] + values.x[3 * stride]);
        let residual = lanes(|l| measured[l] - length[l] - range[l] - delay);
        let residual_sd = lanes(|l| residual[l] * over_sd[l]);
        let mut weight = lanes(|l| over_sd[l] * over_sd[l]);
        if residual_sd.iter().any(|residual| residual.abs() > HUBER) {
            weight = lanes(|l| weight[l] * (HUBER / residual_sd[l].abs()).min(1.0));
        }
        Block { along, residual_sd, residual, weight }
    }

    /// Residual of a first bounce and its weight.
    pub(super) fn first(&self, values: &Values, i: usize) -> (f64, f64) {
        let residual = self.lengths.first_m[i] - 2.0 * values.range[i] - values.x[3 * self.stride];
        let sd = self.lengths.first_sd_m;
        (residual, (HUBER * sd / residual.abs()).min(1.0) / (sd * sd))
    }

    /// Weight of the delay's prior; `None` where the delay is known.
    pub(super) fn delay_weight(&self) -> Option<f64> {
        (self.lengths.delay_sd_m > 0.0).then(|| self.lengths.delay_sd_m.powi(-2))
    }

    /// One pass: the objective, its downhill direction and the blocks of the normal matrix.
    pub(super) fn slope(&self, values: &Values) -> Slope {
        let sums: Sums<{ slope_field::COUNT }> = self.sums(|i, sums| {
            let mut row = [[0.0; LANES]; slope_field::COUNT];
            let mut loss = [0.0; LANES];
            for j in (0..i).step_by(LANES) {
                let Block { along: e, residual_sd, residual, weight: w } = self.block(values, i, j);
                let pull = lanes(|l| w[l] * residual[l]);
                let we = e.map(|e| lanes(|l| w[l] * e[l]));
                let re = e.map(|e| lanes(|l| pull[l] * e[l]));
                let second = |a: usize, b: usize| lanes(|l| we[a][l] * e[b][l]);
                let ee = [second(0, 0), second(1, 1), second(2, 2), second(0, 1), second(0, 2), second(1, 2)];
                // Huber's loss is the residual times what its weight leaves of it, and as much again of what it takes.
                (0..LANES).for_each(|l| {
                    let (size, kept) = (residual_sd[l].abs(), residual_sd[l].abs().min(HUBER));
                    loss[l] += kept * (2.0 * size - kept);
                });
                // In the order of `slope_field`.
                let fields =
                    [w, pull, we[0], we[1], we[2], re[0], re[1], re[2], ee[0], ee[1], ee[2], ee[3], ee[4], ee[5]];
                for (field, values) in fields.into_iter().enumerate() {
                    // Seen from the other patch the direction is reversed, which vectors feel and moments do not.
                    let is_vector = (slope_field::STIFFNESS_ALONG..slope_field::MOMENTS).contains(&field);
                    let sign = if is_vector { -1.0 } else { 1.0 };
                    sums.add(field, j, values.map(|value| sign * value));
                    (0..LANES).for_each(|l| row[field][l] += values[l]);
                }
            }
            row.iter().enumerate().for_each(|(field, row)| sums.fields[field][i] += row.iter().sum::<f64>());
            sums.loss += loss.iter().sum::<f64>();
        });
        let mut slope = Slope {
            loss: sums.loss,
            right: vec![0.0; values.x.len()],
            inverses: Vec::with_capacity(self.count),
            coupling: Vec::with_capacity(self.count),
            delay: 1.0,
        };
        let (mut delay_pull, mut delay_stiffness) = (0.0, 0.0);
        for i in 0..self.count {
            let (stiffness, pull) = (sums.fields[slope_field::STIFFNESS][i], sums.fields[slope_field::PULL][i]);
            let stiffness_along = sums.vector(slope_field::STIFFNESS_ALONG, i);
            let (u, (residual, w)) = (self.patch(&values.out, i), self.first(values, i));
            let downhill = u * (pull + 2.0 * w * residual) + sums.vector(slope_field::PULL_ALONG, i);
            (0..3).for_each(|k| slope.right[k * self.stride + i] = downhill[k]);
            let cross = u * stiffness_along.transpose();
            let moments = sums.symmetric(slope_field::MOMENTS, i);
            let block = u * u.transpose() * (stiffness + 4.0 * w) + cross + cross.transpose() + moments;
            slope.inverses.push(definite_inverse(&block));
            slope.coupling.push(u * (stiffness + 2.0 * w) + stiffness_along);
            // A pair is in the sums of both its patches.
            delay_pull += 0.5 * pull + w * residual;
            delay_stiffness += 0.5 * stiffness + w;
            let (size, kept) =
                (residual.abs() / self.lengths.first_sd_m, (w * residual).abs() * self.lengths.first_sd_m);
            slope.loss += kept * (2.0 * size - kept);
        }
        if let Some(prior) = self.delay_weight() {
            let delay_m = values.x[3 * self.stride];
            slope.right[3 * self.stride] = delay_pull - prior * delay_m;
            slope.delay = delay_stiffness + prior;
            slope.loss += prior * delay_m * delay_m;
        }
        slope
    }

    /// One pass: the normal matrix times a vector.
    pub(super) fn product(&self, values: &Values, vector: &[f64]) -> Vec<f64> {
        let stride = self.stride;
        let delay = vector[3 * stride];
        let mut radial: Vec<f64> = vec![0.0; stride];
        (0..self.count).for_each(|i| radial[i] = self.patch(vector, i).dot(&self.patch(&values.out, i)));
        let sums: Sums<{ product_field::COUNT }> = self.sums(|i, sums| {
            let mut row = [[0.0; LANES]; product_field::COUNT];
            let own = radial[i] + delay;
            for j in (0..i).step_by(LANES) {
                let Block { along, weight, .. } = self.block(values, i, j);
                let others = load(&radial, j);
                let mut change = lanes(|l| own + others[l]);
                for (k, along) in along.iter().enumerate() {
                    let (own, others) = (vector[k * stride + i], load(vector, k * stride + j));
                    (0..LANES).for_each(|l| change[l] += along[l] * (own - others[l]));
                }
                let pull = lanes(|l| weight[l] * change[l]);
                sums.add(product_field::PULL, j, pull);
                (0..LANES).for_each(|l| row[product_field::PULL][l] += pull[l]);
                for (k, along) in along.iter().enumerate() {
                    let pull = lanes(|l| pull[l] * along[l]);
                    sums.add(product_field::PULL_ALONG + k, j, pull.map(|pull| -pull));
                    (0..LANES).for_each(|l| row[product_field::PULL_ALONG + k][l] += pull[l]);
                }
            }
            row.iter().enumerate().for_each(|(field, row)| sums.fields[field][i] += row.iter().sum::<f64>());
        });
        let mut product = vec![0.0; vector.len()];
        let mut delay_pull = 0.0;
        for i in 0..self.count {
            let of_pairs = sums.fields[product_field::PULL][i];
            let of_first = self.first(values, i).1 * (2.0 * radial[i] + delay);
            let out = self.patch(&values.out, i);
            let all = out * (of_pairs + 2.0 * of_first) + sums.vector(product_field::PULL_ALONG, i);
            (0..3).for_each(|k| product[k * stride + i] = all[k]);
            delay_pull += 0.5 * of_pairs + of_first;
        }
        if let Some(prior) = self.delay_weight() {
            product[3 * stride] = delay_pull + prior * delay;
        }
        product
    }
}
