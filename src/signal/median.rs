//! The middle of some numbers.

/// The upper median of one value or more; reorders them.
///
/// # Panics
/// If there is none.
#[must_use]
pub fn upper_median(values: &mut [f64]) -> f64 {
    let half = values.len() / 2;
    *values.select_nth_unstable_by(half, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::upper_median;

    #[test]
    fn of_two_middle_values_it_is_the_larger() {
        assert_eq!(upper_median(&mut [3.0, 1.0, 2.0]), 2.0);
        assert_eq!(upper_median(&mut [4.0, 1.0, 3.0, 2.0]), 3.0);
        assert_eq!(upper_median(&mut [5.0]), 5.0);
    }
}
