//! The time behind which the wall's own light is smooth.
//!
//! The sum of all histograms begins with the light of the wall: a pulse, then a tail. Behind the gate a parabola
//! explains it over [`BLOCKS`] blocks of bins, each about as wide as the response. What is hidden adds pulses later,
//! and does not matter: the first time is taken at which the sum is smooth.

/// Blocks over which the sum must be smooth.
pub const BLOCKS: usize = 6;
/// Standard deviations that a block may lie off the parabola, and the share of its light.
const SIGMA: f64 = 4.0;
const SHARE: f64 = 0.003;

/// First bin behind which [`BLOCKS`] blocks of `block` bins of `sum` follow a parabola; `None` where there is none.
/// `variance` is that of each bin.
///
/// # Panics
/// If the slices differ in length, or a block has no bin.
#[must_use]
pub fn gate(sum: &[f64], variance: &[f64], block: usize) -> Option<usize> {
    assert!(sum.len() == variance.len() && block > 0, "sum and variance differ in length, or blocks are empty");
    let windows = sum.windows(BLOCKS * block).zip(variance.windows(BLOCKS * block));
    windows.into_iter().position(|(sum, variance)| is_smooth(sum, variance, block))
}

fn is_smooth(sum: &[f64], variance: &[f64], block: usize) -> bool {
    let mut light = [0.0; BLOCKS];
    let mut sd = [0.0; BLOCKS];
    for (n, (sum, variance)) in sum.chunks(block).zip(variance.chunks(block)).enumerate() {
        light[n] = sum.iter().sum();
        sd[n] = variance.iter().sum::<f64>().sqrt();
    }
    let smooth = parabola(&light);
    (0..BLOCKS).all(|n| (light[n] - smooth[n]).abs() <= SIGMA * sd[n] + SHARE * light[n].abs())
}

/// The parabola nearest to the values, by polynomials that are orthogonal on their places.
fn parabola(values: &[f64; BLOCKS]) -> [f64; BLOCKS] {
    let place = |n: usize| n as f64 - (BLOCKS - 1) as f64 / 2.0;
    let square = (0..BLOCKS).map(|n| place(n).powi(2)).sum::<f64>() / BLOCKS as f64;
    let polynomials: [fn(f64, f64) -> f64; 3] = [|_, _| 1.0, |x, _| x, |x, square| x * x - square];
    let mut smooth = [0.0; BLOCKS];
    for polynomial in polynomials {
        let basis: [f64; BLOCKS] = std::array::from_fn(|n| polynomial(place(n), square));
        let norm: f64 = basis.iter().map(|b| b * b).sum();
        let coefficient = basis.iter().zip(values).map(|(b, v)| b * v).sum::<f64>() / norm;
        smooth.iter_mut().zip(basis).for_each(|(s, b)| *s += coefficient * b);
    }
    smooth
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall's pulse at bin 100 with a tail that falls by e in 120 bins, dark counts, and a hidden pulse.
    fn light(hidden: f64) -> Vec<f64> {
        let pulse = |at: f64, bin: usize| (-0.5 * ((bin as f64 - at) / 6.0).powi(2)).exp();
        let tail = |bin: usize| if bin > 100 { 1e3 * (-((bin - 100) as f64) / 120.0).exp() } else { 0.0 };
        (0..900).map(|bin| 1e5 * pulse(100.0, bin) + tail(bin) + 50.0 + hidden * pulse(500.0, bin)).collect()
    }

    #[test]
    fn the_gate_lies_behind_the_pulse_and_before_what_is_hidden() {
        for hidden in [0.0, 5e3] {
            let light = light(hidden);
            let gate = gate(&light[90..], &light[90..], 15).unwrap() + 90;
            assert!((115..180).contains(&gate), "{gate}");
        }
    }

    #[test]
    fn light_without_a_wall_needs_no_gate_and_pulses_everywhere_have_none() {
        assert_eq!(gate(&[7.0; 300], &[7.0; 300], 15), Some(0));
        let comb: Vec<f64> = (0..300).map(|bin| if bin % 45 < 15 { 1e4 } else { 0.0 }).collect();
        assert_eq!(gate(&comb, &comb, 15), None);
    }
}
