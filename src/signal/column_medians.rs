//! Medians over shots, sample by sample: a sorting network takes several samples side by side, where a selection takes
//! one after the other and waits for each comparison.
//!
//! Source: K. E. Batcher, *Sorting networks and their applications*, AFIPS 32, 307 (1968), odd-even merging.

use super::widest::widest;

/// Samples that go through the network together. With fewer, the compiler makes no loop of them, and so no vectors.
const LANES: usize = 32;

type Lanes = [f64; LANES];

/// The upper medians of columns, and of the distances from these.
#[derive(Clone, Debug, PartialEq)]
pub struct ColumnMedians {
    /// Of the values of each column; infinite for one without values.
    pub medians: Vec<f64>,
    /// Of their distances from that.
    pub deviations: Vec<f64>,
    /// Values of the column that has fewest.
    pub fewest: usize,
}

impl ColumnMedians {
    /// Of `count` columns; each row has a value for column `n` at its place `n + later`, if it has that place, and they
    /// are finite.
    #[must_use]
    pub fn of(rows: &[(i64, Vec<f64>)], count: usize) -> Self {
        let size = rows.len().next_power_of_two();
        let pairs = odd_even_merges(size);
        let (mut medians, mut deviations) = (Vec::with_capacity(count + LANES), Vec::with_capacity(count + LANES));
        let mut fewest = rows.len();
        let mut columns = vec![[f64::INFINITY; LANES]; size];
        for start in (0..count).step_by(LANES) {
            let mut values = [0; LANES];
            for (lanes, (later, row)) in columns.iter_mut().zip(rows) {
                take(row, start as i64 + later, lanes, &mut values);
            }
            columns[rows.len()..].fill([f64::INFINITY; LANES]);
            fewest = values.iter().take(count - start).fold(fewest, |fewest, values| fewest.min(*values));
            sort(&mut columns, &pairs);
            let median: Lanes = std::array::from_fn(|lane| columns[values[lane] / 2][lane]);
            let mut deviation = [f64::INFINITY; LANES];
            if values.iter().all(|of_lane| *of_lane == values[0]) {
                nearest_half(&columns[..values[0]], &median, &mut deviation);
            } else {
                for lane in 0..LANES {
                    let column: Vec<[f64; 1]> = columns[..values[lane]].iter().map(|lanes| [lanes[lane]]).collect();
                    nearest_half(&column, &[median[lane]], std::array::from_mut(&mut deviation[lane]));
                }
            }
            medians.extend(median);
            deviations.extend(deviation);
        }
        medians.truncate(count);
        deviations.truncate(count);
        Self { medians, deviations, fewest }
    }
}

/// A row's values from a place on, infinite where it has none; counts those that it has.
fn take(row: &[f64], place: i64, lanes: &mut Lanes, values: &mut [usize; LANES]) {
    let whole = usize::try_from(place).ok().and_then(|place| row.get(place..)?.first_chunk());
    if let Some(whole) = whole {
        *lanes = *whole;
        values.iter_mut().for_each(|values| *values += 1);
        return;
    }
    for (at, (lane, values)) in (place..).zip(lanes.iter_mut().zip(values)) {
        let value = usize::try_from(at).ok().and_then(|at| row.get(at));
        *lane = value.copied().unwrap_or(f64::INFINITY);
        *values += usize::from(value.is_some());
    }
}

/// Pairs of places, in turn, that put any values in order if each pair is put in order. `size` is a power of two.
fn odd_even_merges(size: usize) -> Vec<(usize, usize)> {
    let mut pairs = Vec::new();
    let mut merged = 1;
    while merged < size {
        let mut apart = merged;
        while apart > 0 {
            let firsts = (apart % merged..size - apart).step_by(2 * apart).flat_map(|first| first..first + apart);
            let are_of_one = |low: &usize| low / (2 * merged) == (low + apart) / (2 * merged);
            pairs.extend(firsts.filter(|low| low + apart < size).filter(are_of_one).map(|low| (low, low + apart)));
            apart /= 2;
        }
        merged *= 2;
    }
    pairs
}

/// Puts pairs in order, lane by lane.
fn sort(columns: &mut [Lanes], pairs: &[(usize, usize)]) {
    widest(
        #[inline(always)]
        || {
            for (low, high) in pairs {
                let (before, after) = columns.split_at_mut(*high);
                for (low, high) in before[*low].iter_mut().zip(&mut after[0]) {
                    let (a, b) = (*low, *high);
                    *low = if a < b { a } else { b };
                    *high = if a > b { a } else { b };
                }
            }
        },
    );
}

/// Upper median of the distances of sorted values from a place, lane by lane. The values that lie nearest, one more
/// than half of all, follow one another: of all runs of so many, theirs has the nearest ends.
fn nearest_half<const N: usize>(sorted: &[[f64; N]], place: &[f64; N], distance: &mut [f64; N]) {
    let half = sorted.len() / 2;
    widest(
        #[inline(always)]
        || {
            for (first, last) in sorted.iter().zip(sorted.iter().skip(half)) {
                for ((first, last), (place, distance)) in first.iter().zip(last).zip(place.iter().zip(&mut *distance)) {
                    let (before, after) = (place - first, last - place);
                    let farther = if before > after { before } else { after };
                    *distance = if farther < *distance { farther } else { *distance };
                }
            }
        },
    );
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::median::upper_median;

    /// Rows that begin and end anywhere, of numbers many of which are alike: as column by column.
    #[test]
    fn columns_have_the_medians_that_each_has_alone() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for rows in (1..=33).chain([64]) {
            let count = rng.random_range(1..70);
            let row = |rng: &mut ChaCha8Rng| {
                let (later, len) = (rng.random_range(-9..9), rng.random_range(count / 2..count + 9));
                (later, (0..len).map(|_| f64::from(rng.random_range(-5..40)) / 4.0).collect())
            };
            let rows: Vec<(i64, Vec<f64>)> = (0..rows).map(|_| row(&mut rng)).collect();
            let all = ColumnMedians::of(&rows, count);
            let mut fewest = rows.len();
            for n in 0..count {
                let value = |(later, row): &(i64, Vec<f64>)| row.get(usize::try_from(n as i64 + later).ok()?).copied();
                let mut column: Vec<f64> = rows.iter().filter_map(value).collect();
                fewest = fewest.min(column.len());
                if !column.is_empty() {
                    let median = upper_median(&mut column);
                    let mut distances: Vec<f64> = column.iter().map(|value| (value - median).abs()).collect();
                    let own = (all.medians[n], all.deviations[n]);
                    assert_eq!(own, (median, upper_median(&mut distances)), "{} rows, column {n}", rows.len());
                }
            }
            assert_eq!((all.medians.len(), all.deviations.len(), all.fewest), (count, count, fewest));
        }
    }
}
