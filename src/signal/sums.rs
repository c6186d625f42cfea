//! Sums in lanes side by side: one chain of additions would wait for every result.

use super::widest::widest;

/// Numbers that are added side by side; the order of additions is fixed.
const LANES: usize = 16;

/// The sum of all values.
pub fn sum(values: &[f64]) -> f64 {
    widest(
        #[inline(always)]
        || sum_in_kernel(values),
    )
}

/// The same where a kernel of [`widest`] needs it: of few values, the choice of vectors takes longer than the sum.
#[allow(clippy::inline_always, reason = "else it stays on narrow vectors")]
#[inline(always)]
pub fn sum_in_kernel(values: &[f64]) -> f64 {
    let (blocks, rest) = values.as_chunks::<LANES>();
    let mut sums = [0.0; LANES];
    for block in blocks {
        for lane in 0..LANES {
            sums[lane] += block[lane];
        }
    }
    sums.iter().sum::<f64>() + rest.iter().sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_counts_once() {
        for len in [0, 1, 15, 16, 17, 100] {
            let values: Vec<f64> = (0..len).map(f64::from).collect();
            let n = f64::from(len);
            assert_eq!(sum(&values), n * (n - 1.0) / 2.0);
        }
    }
}
