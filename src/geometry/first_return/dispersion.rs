//! How large the error of the law of first light is: what residuals of neighbours have in common.
//!
//! Noise of one place does not show at the next, an error of the law does. A fit takes most of a smooth error into its
//! unknowns, so that residuals `r = M e` show a part of it alone: with `M = 1 - J H J^T W` (slopes `J`, covariance `H`,
//! weights `W`) their products have the mean `s^2 M K M^T + M N M^T`, where `K` is the correlation of the error over
//! the wall, `s` its standard deviation, and `N` the noise. Products of neighbours, summed over all fields of a scan,
//! give `s`.
//!
//! Where noise is large, residuals do not show a small error: `s` is one standard deviation more than the likeliest.
//! Fields share places, so that their standard deviations add up.
//!
//! Source: the method of moments for components of variance, Henderson, Biometrics 9:226, 1953.

use super::local::{Covariance, Local, Sample, Target, UNKNOWNS, Unknowns, WAVE_VARIANCES, WAVES};

/// Sums over pairs of neighbours: products of residuals, weighted, less those of noise, and their mean where the error
/// is 1 m.
#[derive(Clone, Copy, Debug, Default)]
pub struct Dispersion {
    products: f64,
    mean: f64,
    /// Standard deviation of the products by noise.
    sd: f64,
}

/// A member: its residual, its slopes, its weight and the variance of its noise.
struct Line {
    off_m: f64,
    slopes: Unknowns,
    weight: f64,
    noise_m2: f64,
}

impl Dispersion {
    /// Of a field that was fitted to members. `near` holds the nearest places of each, itself first; errors of the law
    /// are common within `zone_m`.
    pub fn of(field: &impl Local, samples: &[Sample], members: &[u32], near: &[Vec<u32>], zone_m: f64) -> Option<Self> {
        let line = |n: &u32| {
            let sample = &samples[*n as usize];
            let (length_m, slopes) = field.length(&sample.at);
            let (weight, noise_m2) = (sample.weighted_m.powi(-2), sample.sd_m.powi(2));
            Line { off_m: sample.length_m - length_m, slopes, weight, noise_m2 }
        };
        let lines: Vec<Line> = members.iter().map(line).collect();
        let mut place = vec![None; samples.len()];
        members.iter().enumerate().for_each(|(k, n)| place[*n as usize] = Some(k));
        let pair = |(k, n): (usize, &u32)| Some([k, place[near[*n as usize][1] as usize]?]);
        let pairs: Vec<[usize; 2]> = members.iter().enumerate().filter_map(pair).collect();
        let targets: Vec<Target> = members.iter().map(|n| Target::of(&samples[*n as usize])).collect();
        let inverse = field.normal_equations(&targets).information.cholesky()?.inverse();
        let weighted = |[a, b]: &[usize; 2]| lines[*a].weight * lines[*b].weight;
        let summed = |value: &dyn Fn(usize) -> f64| -> f64 {
            pairs.iter().map(|pair| weighted(pair) * value(pair[0]) * value(pair[1])).sum()
        };
        let mut waves = field.waves(samples, members, zone_m);
        leave_residuals(&mut waves, &lines, &inverse);
        let of_waves = |[a, b]: &[usize; 2]| -> f64 {
            let both = waves[*a].iter().zip(&waves[*b]).zip(WAVE_VARIANCES);
            both.map(|((one, other), variance)| variance * one * other).sum()
        };
        let mean = pairs.iter().map(|pair| weighted(pair) * of_waves(pair)).sum();
        let noise = |line: &Line| line.slopes * line.slopes.transpose() * (line.weight.powi(2) * line.noise_m2);
        let spread = inverse * lines.iter().map(noise).sum::<Covariance>() * inverse;
        let of_noise = |[a, b]: &[usize; 2]| {
            let [one, other] = [&lines[*a], &lines[*b]];
            let both = one.weight * one.noise_m2 + other.weight * other.noise_m2;
            one.slopes.dot(&((spread - inverse * both) * other.slopes))
        };
        let of_all_noise: f64 = pairs.iter().map(|pair| weighted(pair) * of_noise(pair)).sum();
        let by_noise = |pair: &[usize; 2]| weighted(pair).powi(2) * lines[pair[0]].noise_m2 * lines[pair[1]].noise_m2;
        let sd = pairs.iter().map(by_noise).sum::<f64>().sqrt();
        Some(Self { products: summed(&|k| lines[k].off_m) - of_all_noise, mean, sd })
    }

    pub fn and(self, other: Self) -> Self {
        Self { products: self.products + other.products, mean: self.mean + other.mean, sd: self.sd + other.sd }
    }

    /// Standard deviation of the error that residuals show.
    pub fn likeliest_m(&self) -> f64 {
        (self.products / self.mean.max(1e-300)).max(0.0).sqrt()
    }

    /// Standard deviation of the error that residuals do not exclude, of which noise
    /// hides `most_m` at most.
    pub fn law_m(&self, most_m: f64) -> f64 {
        let by_noise_m = (self.sd / self.mean.max(1e-300)).sqrt().min(most_m);
        self.likeliest_m().hypot(by_noise_m)
    }
}

/// What a fit leaves of waves: `M` times each.
fn leave_residuals(waves: &mut [[f64; WAVES]], lines: &[Line], inverse: &Covariance) {
    let mut taken = [[0.0; WAVES]; UNKNOWNS];
    for (line, waves) in lines.iter().zip(&*waves) {
        for (taken, slope) in taken.iter_mut().zip(line.slopes.iter()) {
            let share = slope * line.weight;
            taken.iter_mut().zip(waves).for_each(|(taken, wave)| *taken += share * wave);
        }
    }
    for (line, waves) in lines.iter().zip(waves) {
        let shares = inverse * line.slopes;
        for (taken, share) in taken.iter().zip(shares.iter()) {
            waves.iter_mut().zip(taken).for_each(|(wave, taken)| *wave -= share * taken);
        }
    }
}
