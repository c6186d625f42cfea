//! Nodes and weights that stand for how light is spread: places at which a response is looked up.

/// Gaussian kernels reach this many sds to either side, exponential ones this many constants: less than a millionth of
/// the light lies beyond.
pub(super) const REACH_SD: f64 = 5.0;
pub(super) const REACH_TAILS: f64 = 14.0;
/// Least parts of the half circle between whose ends a standard deviation of light from disks lies.
const DISK_PARTS: f64 = 6.0;

/// Nodes and weights of a symmetric beta distribution of sd `sd_ps`, this excess kurtosis and this tilt, no farther
/// apart than `step_max_ps`: the trapezoidal rule over the half circle, which for a disk's chords is Gauss and
/// Chebyshev's of the second kind. The sum of the weights, the centroid and the variance are exact.
pub(super) fn beta_nodes(sd_ps: f64, [kurtosis, tilt]: [f64; 2], step_max_ps: f64) -> Vec<(f64, f64)> {
    let a = -3.0 / kurtosis - 1.5;
    let radius = (2.0 * a + 1.0).sqrt();
    let parts = (std::f64::consts::PI * radius * (sd_ps / step_max_ps)).max(DISK_PARTS * radius).ceil();
    let node = |i: i32| {
        let (sine, cosine) = (std::f64::consts::PI * f64::from(i) / parts).sin_cos();
        (cosine, sine.powf(2.0 * a - 1.0) * (tilt * radius * cosine).exp())
    };
    let nodes: Vec<(f64, f64)> = (1..parts as i32).map(node).collect();
    let total: f64 = nodes.iter().map(|(_, weight)| weight).sum();
    let centroid = nodes.iter().map(|(x, weight)| x * weight).sum::<f64>() / total;
    let variance = nodes.iter().map(|(x, weight)| (x - centroid).powi(2) * weight).sum::<f64>() / total;
    let scale_ps = sd_ps / variance.sqrt();
    nodes.into_iter().map(|(x, weight)| (scale_ps * (x - centroid), weight / total)).collect()
}

/// Nodes and weights of a Gaussian of sd `sd_ps`, no farther apart than `step_max_ps` or an sd: the trapezoidal rule,
/// which converges faster than any power for it.
pub(super) fn gaussian_nodes(sd_ps: f64, step_max_ps: f64) -> Vec<(f64, f64)> {
    let per_sd = (sd_ps / step_max_ps).ceil().max(1.0);
    let side = (REACH_SD * per_sd) as i32;
    let density = |i: i32| (-0.5 * (f64::from(i) / per_sd).powi(2)).exp();
    let total: f64 = (-side..=side).map(density).sum();
    if sd_ps == 0.0 {
        return vec![(0.0, 1.0)];
    }
    (-side..=side).map(|i| (f64::from(i) * sd_ps / per_sd, density(i) / total)).collect()
}

/// Nodes and weights of `exp(-u)`, `u` from 0 to `reach`: four Gauss-Legendre nodes in panels no longer than
/// `panel_max` or 1.
pub(super) fn tail_nodes(panel_max: f64, reach: f64) -> Vec<(f64, f64)> {
    const LEGENDRE: [(f64, f64); 4] = [
        (-0.861_136_311_594_052_6, 0.347_854_845_137_453_9),
        (-0.339_981_043_584_856_3, 0.652_145_154_862_546_1),
        (0.339_981_043_584_856_3, 0.652_145_154_862_546_1),
        (0.861_136_311_594_052_6, 0.347_854_845_137_453_9),
    ];
    let panels = (reach / panel_max.min(1.0)).ceil();
    let half = 0.5 * reach / panels;
    let nodes = |i: i32| {
        LEGENDRE.map(|(x, weight)| {
            let u = half * (2.0 * f64::from(i) + 1.0 + x);
            (u, half * weight * (-u).exp())
        })
    };
    (0..panels as i32).flat_map(nodes).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Moments of the chords of a disk, of light over two disks and of nearly a Gaussian.
    #[test]
    fn disks_have_their_moments() {
        let sixth = |kurtosis: f64| {
            let a = -3.0 / kurtosis - 1.5;
            15.0 * (2.0 * a + 1.0).powi(2) / ((2.0 * a + 3.0) * (2.0 * a + 5.0))
        };
        for (kurtosis, sd) in [(-1.0, 2.0_f64), (-1.0, 150.0), (-0.5, 30.0), (-0.73, 30.0), (-0.05, 9.0)] {
            let nodes = beta_nodes(sd, [kurtosis, 0.0], 40.0);
            let moment = |k: i32| nodes.iter().map(|(x, weight)| weight * (x / sd).powi(k)).sum::<f64>();
            let moments = [0, 1, 2, 4, 6].map(moment);
            let expected = [1.0, 0.0, 1.0, 3.0 + kurtosis, sixth(kurtosis)];
            let is_near = |(one, other): (&f64, f64)| (one - other).abs() < 2e-3;
            assert!(moments.iter().zip(expected).all(is_near), "{kurtosis} {sd} {moments:?} {expected:?}");
        }
        // A tilt of 0.02 gives a skewness of `0.02 kurtosis`.
        let nodes = beta_nodes(1.0, [-1.0, 0.02], 1.0);
        let [first, third] = [1, 3].map(|k| nodes.iter().map(|(x, weight)| weight * x.powi(k)).sum::<f64>());
        assert!(first.abs() < 1e-12 && (third + 0.02).abs() < 1e-4, "{first} {third}");
        // Light over two disks of equal shares has the sixth moment 8.75.
        assert!((sixth(-1.0) - 5.0).abs() < 1e-9 && (sixth(-0.5) / 8.75 - 1.0).abs() < 0.025);
    }
}
