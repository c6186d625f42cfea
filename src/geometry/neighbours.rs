//! The nearest points of each point.

use periscope_cancel::Cancel;
use rayon::prelude::*;

use super::Point;

/// Points of a cell in the mean.
const IN_CELL: f64 = 8.0;

/// The nearest points of each, itself first.
pub fn neighbours(points: &[Point], most: usize, cancel: &Cancel) -> Vec<Vec<u32>> {
    Cells::new(points.to_vec()).all_nearest(most, cancel)
}

/// Points in square cells across the axis along which they reach least far.
pub struct Cells {
    points: Vec<Point>,
    axes: [usize; 2],
    least_m: [f64; 2],
    side_m: f64,
    counts: [usize; 2],
    members: Vec<Vec<u32>>,
}

impl Cells {
    pub fn new(points: Vec<Point>) -> Self {
        let mut axes = [0, 1, 2].map(|axis| (axis, ends(&points, axis)));
        axes.sort_by(|(_, a), (_, b)| (b[1] - b[0]).total_cmp(&(a[1] - a[0])));
        let [[left, right], [low, high]] = [axes[0].1, axes[1].1];
        let share = IN_CELL / points.len().max(1) as f64;
        let side_m = ((right - left) * (high - low) * share).sqrt().max((right - left) * share).max(f64::MIN_POSITIVE);
        let counts = [right - left, high - low].map(|extent_m| (extent_m / side_m) as usize + 1);
        let members = vec![Vec::new(); counts[0] * counts[1]];
        let mut all = Self { points, axes: [axes[0].0, axes[1].0], least_m: [left, low], side_m, counts, members };
        for n in 0..all.points.len() {
            let [column, row] = all.cell(&all.points[n]);
            all.members[row * counts[0] + column].push(n as u32);
        }
        all
    }

    fn cell(&self, point: &Point) -> [usize; 2] {
        [0, 1].map(|k| (((point[self.axes[k]] - self.least_m[k]) / self.side_m) as usize).min(self.counts[k] - 1))
    }

    /// The nearest points of each.
    pub fn all_nearest(&self, most: usize, cancel: &Cancel) -> Vec<Vec<u32>> {
        let of_point = |n: usize| {
            cancel.check();
            self.nearest(n, most)
        };
        (0..self.points.len()).into_par_iter().map(of_point).collect()
    }

    /// The nearest points of one, itself first; of some that are equally near, to seven digits of the square of the
    /// distance, those with smaller numbers.
    pub fn nearest(&self, n: usize, most: usize) -> Vec<u32> {
        let here = self.points[n];
        let [column, row] = self.cell(&here);
        // In order of distance, then of number: as bits, floats that are not negative are ordered as they are.
        let key = |gap_m2: f64, n: u32| u64::from((gap_m2 as f32).to_bits()) << 32 | u64::from(n);
        let mut list: Vec<u64> = Vec::with_capacity(2 * most);
        let rings = self.counts[0].max(self.counts[1]);
        for ring in 0..rings {
            let rows = row.saturating_sub(ring)..(row + ring + 1).min(self.counts[1]);
            for at in rows {
                let is_end = at.abs_diff(row) == ring;
                let columns = column.saturating_sub(ring)..(column + ring + 1).min(self.counts[0]);
                for cell in columns.filter(|other| is_end || other.abs_diff(column) == ring) {
                    let of = |other: &u32| key((self.points[*other as usize] - here).norm_squared(), *other);
                    list.extend(self.members[at * self.counts[0] + cell].iter().map(of));
                }
            }
            // All points that are so near lie in these rings.
            let reach = key((ring as f64 * self.side_m).powi(2), 0);
            if list.len() >= most && list.iter().filter(|one| **one < reach).count() >= most {
                break;
            }
        }
        if list.len() > most {
            list.select_nth_unstable(most);
            list.truncate(most);
        }
        list.sort_unstable();
        list.into_iter().map(|one| one as u32).collect()
    }
}

fn ends(points: &[Point], axis: usize) -> [f64; 2] {
    let ends = |[least, most]: [f64; 2], point: &Point| [least.min(point[axis]), most.max(point[axis])];
    if points.is_empty() { [0.0; 2] } else { points.iter().fold([f64::INFINITY, f64::NEG_INFINITY], ends) }
}
