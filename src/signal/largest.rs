//! The largest of many numbers.

use super::widest::widest;

/// Numbers that are looked at side by side.
const LANES: usize = 16;

/// The largest of what `of` makes of each value, not below `least`; what is no number is passed over.
pub fn largest<T: Copy + PartialOrd>(values: &[T], least: T, of: impl Fn(T) -> T) -> T {
    let larger = |most: T, value: T| if value > most { value } else { most };
    let (blocks, rest) = values.as_chunks::<LANES>();
    // A lane each: one chain of comparisons would wait for every result.
    let most = widest(
        #[inline(always)]
        || {
            let mut most = [least; LANES];
            for block in blocks {
                // The compiler leaves a zip of two arrays as a call, which keeps the largest in memory.
                for (lane, most) in most.iter_mut().enumerate() {
                    *most = larger(*most, of(block[lane]));
                }
            }
            most
        },
    );
    most.into_iter().chain(rest.iter().map(|value| of(*value))).fold(least, larger)
}

#[cfg(test)]
mod tests {
    use super::largest;

    #[test]
    fn is_the_largest_wherever_it_stands() {
        for len in [1, 15, 16, 17, 100] {
            for place in 0..len {
                let mut values = vec![-2.0; len];
                values[place] = -1.5;
                assert_eq!(largest(&values, f64::NEG_INFINITY, |value| value), -1.5, "{place} of {len}");
                assert_eq!(largest(&values, 0.0, f64::abs), if len == 1 { 1.5 } else { 2.0 });
            }
        }
        assert_eq!(largest(&[f32::NAN, 1.0], 0.0, |value| value), 1.0);
        assert_eq!(largest(&[], 3.0, |value| value), 3.0);
    }
}
