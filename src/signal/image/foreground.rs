//! Light of a histogram without its smooth part: the wall's own tail, ambient light and dark counts.
//!
//! In a window about each bin a parabola is fitted by least squares, and its middle is subtracted: a Savitzky-Golay
//! filter (Anal. Chem. 36:1627, 1964) as high-pass. What varies over less than the window remains. Towards both ends
//! the window shrinks.

/// Values of independent noise, and their variances.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Foreground {
    /// What the parabola leaves of each bin.
    pub values: Vec<f64>,
    /// Its variance.
    pub variances: Vec<f64>,
}

/// What parabolas over up to `half` bins to either side leave of `values`, whose bins have these `variances`.
///
/// The variance of a remainder is that of its bin times the share that least squares leave, as for equal variances in
/// the window. Covariances between bins, of the order of one over the window, are left out.
///
/// # Panics
/// If the slices differ in length.
#[must_use]
pub fn foreground(values: &[f64], variances: &[f64], half: usize) -> Foreground {
    assert_eq!(values.len(), variances.len(), "values and variances differ in length");
    let moments = Moments::new(values);
    let remainder = |at: usize| {
        let half = half.min(at).min(values.len() - 1 - at);
        // A parabola through three points leaves nothing.
        if half < 2 {
            return (0.0, 0.0);
        }
        let width = (2 * half + 1) as f64;
        let scale = 0.75 / (width * (width * width - 4.0));
        let [sum, second] = moments.about(at, half);
        let constant = 3.0 * width * width - 7.0;
        let smooth = scale * (constant * sum - 20.0 * second);
        (values[at] - smooth, variances[at] * (1.0 - scale * constant))
    };
    let (values, variances) = (0..values.len()).map(remainder).unzip();
    Foreground { values, variances }
}

/// Means over up to `half` bins to either side: the rate of photons behind their counts.
#[must_use]
pub fn rate(values: &[f64], half: usize) -> Vec<f64> {
    let mut sums = Vec::with_capacity(values.len() + 1);
    sums.push(0.0);
    for value in values {
        sums.push(sums[sums.len() - 1] + value);
    }
    let mean = |at: usize| {
        let (from, to) = (at.saturating_sub(half), (at + half + 1).min(values.len()));
        (sums[to] - sums[from]) / (to - from) as f64
    };
    (0..values.len()).map(mean).collect()
}

/// Running sums of values, of values times place, and of values times place squared.
struct Moments([Vec<f64>; 3]);

impl Moments {
    fn new(values: &[f64]) -> Self {
        let mut sums = [0.0; 3];
        let mut running = [vec![0.0], vec![0.0], vec![0.0]];
        for (place, value) in values.iter().enumerate() {
            let place = place as f64;
            for (power, factor) in [1.0, place, place * place].into_iter().enumerate() {
                sums[power] += factor * value;
                running[power].push(sums[power]);
            }
        }
        Self(running)
    }

    /// Sum of the values up to `half` places from `at`, and the same with the square of the distance as factor.
    fn about(&self, at: usize, half: usize) -> [f64; 2] {
        let [sum, first, second] = [0, 1, 2].map(|power| self.0[power][at + half + 1] - self.0[power][at - half]);
        let at = at as f64;
        [sum, second - 2.0 * at * first + at * at * sum]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parabolas_vanish_and_their_variance_is_that_of_least_squares() {
        let values: Vec<f64> = (0..60).map(|i| 3.0 - 0.2 * f64::from(i) + 0.01 * f64::from(i * i)).collect();
        let rest = foreground(&values, &[2.0; 60], 9);
        assert!(rest.values.iter().all(|value| value.abs() < 1e-9));
        assert_eq!(rest.variances[..2], [0.0; 2]);
        // Weight of a bin in its own fit: the diagonal of the hat matrix, from the sums of powers of j = -9..9.
        let (m, s2, s4) = (19.0, 570.0, 30_666.0);
        assert!((rest.variances[30] - 2.0 * (1.0 - s4 / (m * s4 - s2 * s2))).abs() < 1e-12);
    }

    #[test]
    fn a_pulse_stays() {
        let mut values = vec![5.0; 101];
        values[50] += 10.0;
        let rest = foreground(&values, &values, 25);
        assert!((rest.values[50] - 10.0 * (1.0 - rest_weight(25))).abs() < 1e-9);
        assert!(rest.values[90].abs() < 1e-9);
    }

    fn rest_weight(half: usize) -> f64 {
        let width = (2 * half + 1) as f64;
        0.75 * (3.0 * width * width - 7.0) / (width * (width * width - 4.0))
    }

    #[test]
    fn a_rate_is_a_mean_that_shrinks_at_the_ends() {
        assert_eq!(rate(&[1.0, 2.0, 6.0, 3.0], 1), [1.5, 3.0, 11.0 / 3.0, 4.5]);
    }
}
