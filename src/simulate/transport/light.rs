//! Arrivals of light, and the moments of their times.

/// Arrivals of light: times of flight, and strengths.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Light(pub Vec<(f64, f64)>);

impl Light {
    /// One arrival.
    pub fn at(time_ps: f64, strength: f64) -> Self {
        Self(vec![(time_ps, strength)])
    }

    /// Total strength of all arrivals.
    pub fn total(&self) -> f64 {
        // Starts at +0, since the sum of an empty iterator is -0.
        self.0.iter().fold(0.0, |sum, (_, strength)| sum + strength)
    }

    /// Mean time of flight.
    pub fn centroid_ps(&self) -> f64 {
        self.0.iter().map(|(time_ps, strength)| time_ps * strength).sum::<f64>() / self.total()
    }

    /// Earliest time of flight.
    pub fn earliest_ps(&self) -> f64 {
        self.0.iter().map(|(time_ps, _)| *time_ps).fold(f64::INFINITY, f64::min)
    }

    /// Standard deviation of the times of flight.
    pub fn width_ps(&self) -> f64 {
        let centroid_ps = self.centroid_ps();
        let squares: f64 = self.0.iter().map(|(time_ps, strength)| strength * (time_ps - centroid_ps).powi(2)).sum();
        (squares / self.total()).sqrt()
    }

    /// The same light, delayed by `later_ps` and scaled by `factor`.
    #[must_use]
    pub fn moved(&self, later_ps: f64, factor: f64) -> Self {
        Self(self.0.iter().map(|(time_ps, strength)| (time_ps + later_ps, strength * factor)).collect())
    }
}

/// Strength of light, and the first three moments of its time about an external origin. Sums over all points of all
/// facets of a path need just these, at the cost of one product per pair of points.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Moments([f64; 4]);

/// Below this spread, one arrival represents the light.
const POINT_PS: f64 = 0.5;
/// Below this spread, two arrivals represent it.
const PAIR_PS: f64 = 6.0;
/// Number of arrivals for any wider spread.
const ARRIVALS: usize = 9;

impl Moments {
    /// One arrival.
    pub fn at(time_ps: f64, strength: f64) -> Self {
        Self([strength, strength * time_ps, strength * time_ps.powi(2), strength * time_ps.powi(3)])
    }

    /// Strength.
    pub fn strength(&self) -> f64 {
        self.0[0]
    }

    /// The same light, scaled by `factor` and delayed by `later_ps`.
    pub fn passed_on(&self, factor: f64, later_ps: f64) -> Self {
        let [m0, m1, m2, m3] = self.0;
        let d = later_ps;
        Self([
            factor * m0,
            factor * (m1 + d * m0),
            factor * (m2 + d * (2.0 * m1 + d * m0)),
            factor * (m3 + d * (3.0 * m2 + d * (3.0 * m1 + d * m0))),
        ])
    }

    /// Adds other light.
    pub fn add(&mut self, other: &Self) {
        self.0.iter_mut().zip(other.0).for_each(|(sum, term)| *sum += term);
    }

    /// A few arrivals with the same strength, mean and spread: one, two (with the same skewness), or nine at quantiles
    /// from the Cornish-Fisher expansion.
    pub fn arrivals(&self, origin_ps: f64, out: &mut Light) {
        let [strength, m1, m2, m3] = self.0;
        if strength <= 0.0 {
            return;
        }
        let (mean, second, third) = (m1 / strength, m2 / strength, m3 / strength);
        let variance = (second - mean * mean).max(0.0);
        let sd_ps = variance.sqrt();
        if sd_ps < POINT_PS {
            out.0.push((origin_ps + mean, strength));
            return;
        }
        let skewness = ((third - 3.0 * mean * second + 2.0 * mean.powi(3)) / sd_ps.powi(3)).clamp(-1.5, 1.5);
        if sd_ps < PAIR_PS {
            let root = (1.0 + 0.25 * skewness * skewness).sqrt();
            for sign in [-1.0, 1.0] {
                let node = 0.5 * skewness + sign * root;
                let weight = 0.5 * (1.0 - sign * 0.5 * skewness / root);
                out.0.push((origin_ps + mean + sd_ps * node, strength * weight));
            }
            return;
        }
        // Quantiles of the normal distribution, at the middle of nine equal shares.
        let normal = [-1.593_218_818, -0.967_421_566, -0.589_455_798, -0.282_216_147, 0.0];
        let quantile = |k: usize| if k < 5 { normal[k] } else { -normal[8 - k] };
        let skewed = |z: f64| z + skewness / 6.0 * (z * z - 1.0);
        let nodes: [f64; ARRIVALS] = std::array::from_fn(|k| skewed(quantile(k)));
        let middle = nodes.iter().sum::<f64>() / ARRIVALS as f64;
        let spread = (nodes.iter().map(|node| (node - middle).powi(2)).sum::<f64>() / ARRIVALS as f64).sqrt();
        let arrival = |node: f64| (origin_ps + mean + sd_ps * (node - middle) / spread, strength / ARRIVALS as f64);
        out.0.extend(nodes.map(arrival));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_pass_on_as_the_arrivals_that_they_stand_for() {
        let arrivals = [(0.3, 2.0), (1.7, 0.5), (-0.4, 1.1)];
        let mut sum = Moments::default();
        let mut expected = Moments::default();
        for (time, strength) in arrivals {
            sum.add(&Moments::at(time, strength));
            expected.add(&Moments::at(time + 2.5, 3.0 * strength));
        }
        let passed = sum.passed_on(3.0, 2.5);
        assert!(passed.0.iter().zip(expected.0).all(|(a, b)| (a - b).abs() < 1e-12 * b.abs()));
    }

    #[test]
    fn few_arrivals_keep_strength_mean_and_spread() {
        for scale in [0.1, 3.0, 40.0] {
            let arrivals = [(0.3 * scale, 2.0), (1.7 * scale, 0.5), (-0.4 * scale, 1.1), (0.9 * scale, 0.7)];
            let mut moments = Moments::default();
            arrivals.iter().for_each(|(time, strength)| moments.add(&Moments::at(*time, *strength)));
            let mut light = Light::default();
            moments.arrivals(100.0, &mut light);
            let true_light = Light(arrivals.iter().map(|(time, strength)| (100.0 + time, *strength)).collect());
            assert!((light.total() - true_light.total()).abs() < 1e-12);
            assert!((light.centroid_ps() - true_light.centroid_ps()).abs() < 1e-9);
            let spread = if light.0.len() > 1 { light.width_ps() } else { true_light.width_ps() };
            assert!((spread - true_light.width_ps()).abs() < 1e-9, "{scale}");
        }
    }
}
