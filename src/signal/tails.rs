//! The chance that noise alone goes as far: tails of the normal, Student's and chi-square distributions.
//!
//! Source: incomplete gamma and beta functions by series and continued fractions, Press et al., *Numerical Recipes*,
//! sections 6.2 and 6.4; the logarithm of the gamma function by Lanczos's sum (g = 7, nine terms), good to 1e-13.

/// Terms after which a series or fraction has long settled, for the arguments that occur.
const TERMS: usize = 10_000;
const EPSILON: f64 = 1e-15;
/// Keeps a continued fraction from dividing by zero.
const TINY: f64 = 1e-300;

/// Chance that a normal variable lies further than `z` standard deviations from its mean, on either side.
#[must_use]
pub fn normal(z: f64) -> f64 {
    upper_gamma(0.5, z * z / 2.0)
}

/// The same for a mean over its standard deviation where that is estimated with `dof` degrees of freedom: Student's t.
///
/// # Panics
/// Without a degree of freedom.
#[must_use]
pub fn student(t: f64, dof: usize) -> f64 {
    assert!(dof > 0, "an estimated standard deviation has degrees of freedom");
    let dof = dof as f64;
    if t.is_infinite() {
        return 0.0;
    }
    beta(dof / 2.0, 0.5, dof / (dof + t * t))
}

/// Chance that a sum of `dof` squared normal variables exceeds `chi2`.
///
/// # Panics
/// Without a degree of freedom.
#[must_use]
pub fn chi_square(chi2: f64, dof: usize) -> f64 {
    assert!(dof > 0, "a chi-square has degrees of freedom");
    upper_gamma(dof as f64 / 2.0, chi2 / 2.0)
}

/// Logarithm of the gamma function of a positive argument.
fn ln_gamma(x: f64) -> f64 {
    const LANCZOS: [f64; 9] = [
        0.999_999_999_999_809_9,
        676.520_368_121_885_1,
        -1_259.139_216_722_402_8,
        771.323_428_777_653_1,
        -176.615_029_162_140_6,
        12.507_343_278_686_905,
        -0.138_571_095_265_720_12,
        9.984_369_578_019_572e-6,
        1.505_632_735_149_311_6e-7,
    ];
    let x = x - 1.0;
    let sum: f64 = LANCZOS[1..].iter().enumerate().map(|(k, c)| c / (x + k as f64 + 1.0)).sum();
    let t = x + 7.5;
    0.5 * std::f64::consts::TAU.ln() + (x + 0.5) * t.ln() - t + (LANCZOS[0] + sum).ln()
}

/// Regularised upper incomplete gamma function `Q(a, x)`.
fn upper_gamma(a: f64, x: f64) -> f64 {
    if x <= 0.0 {
        return 1.0;
    }
    if x.is_infinite() {
        return 0.0;
    }
    let front = (a * x.ln() - x - ln_gamma(a)).exp();
    if x < a + 1.0 {
        let (mut term, mut sum) = (1.0 / a, 1.0 / a);
        for n in 1..TERMS {
            term *= x / (a + n as f64);
            sum += term;
            if term < sum * EPSILON {
                break;
            }
        }
        return 1.0 - front * sum;
    }
    // Lentz's method, where numerator n is -n (n - a) and denominator x + 2 n + 1 - a.
    let mut b = x + 1.0 - a;
    let (mut c, mut d) = (1.0 / TINY, 1.0 / b);
    let mut fraction = d;
    for n in 1..TERMS {
        let numerator = -(n as f64) * (n as f64 - a);
        b += 2.0;
        d = 1.0 / away_from_zero(numerator * d + b);
        c = away_from_zero(b + numerator / c);
        fraction *= d * c;
        if (d * c - 1.0).abs() < EPSILON {
            break;
        }
    }
    front * fraction
}

/// Regularised incomplete beta function `I_x(a, b)`.
fn beta(a: f64, b: f64, x: f64) -> f64 {
    if x <= 0.0 || x >= 1.0 {
        return x.clamp(0.0, 1.0);
    }
    let front = (ln_gamma(a + b) - ln_gamma(a) - ln_gamma(b) + a * x.ln() + b * (1.0 - x).ln()).exp();
    if x < (a + 1.0) / (a + b + 2.0) {
        front * beta_fraction(a, b, x) / a
    } else {
        1.0 - front * beta_fraction(b, a, 1.0 - x) / b
    }
}

fn beta_fraction(a: f64, b: f64, x: f64) -> f64 {
    let mut c = 1.0;
    let mut d = 1.0 / away_from_zero(1.0 - (a + b) * x / (a + 1.0));
    let mut fraction = d;
    for n in 1..TERMS {
        let m = n as f64;
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        let mut step = 1.0;
        for numerator in [even, odd] {
            d = 1.0 / away_from_zero(1.0 + numerator * d);
            c = away_from_zero(1.0 + numerator / c);
            step = d * c;
            fraction *= step;
        }
        if (step - 1.0).abs() < EPSILON {
            break;
        }
    }
    fraction
}

fn away_from_zero(x: f64) -> f64 {
    if x.abs() < TINY { TINY } else { x }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Twice the upper tail of a density by the midpoint rule, from `from` to where nothing is left.
    fn tail(density: impl Fn(f64) -> f64, from: f64, to: f64) -> f64 {
        let steps = 400_000;
        let step = (to - from) / f64::from(steps);
        (0..steps).map(|i| density(from + (f64::from(i) + 0.5) * step)).sum::<f64>() * step
    }

    #[test]
    fn they_are_the_integrals_of_their_densities() {
        for z in [0.3, 1.0, 2.5, 4.5] {
            let naive = 2.0 * tail(|x| (-0.5 * x * x).exp() / std::f64::consts::TAU.sqrt(), z, z + 12.0);
            assert!((normal(z) / naive - 1.0).abs() < 1e-6, "z {z}: {} {naive}", normal(z));
        }
        for (t, dof) in [(0.5, 3), (2.0, 5), (4.0, 12)] {
            let nu = dof as f64;
            let shape = |x: f64| (1.0 + x * x / nu).powf(-(nu + 1.0) / 2.0);
            let naive = tail(shape, t, 4000.0) / tail(shape, 0.0, 4000.0);
            assert!((student(t, dof) / naive - 1.0).abs() < 1e-3, "t {t} dof {dof}: {} {naive}", student(t, dof));
        }
        for (chi2, dof) in [(0.5, 2), (9.0, 4), (40.0, 18)] {
            let density = |x: f64| x.powf(dof as f64 / 2.0 - 1.0) * (-x / 2.0).exp();
            let naive = tail(density, chi2, 400.0) / tail(density, 0.0, 400.0);
            assert!(
                (chi_square(chi2, dof) / naive - 1.0).abs() < 1e-4,
                "{chi2}/{dof}: {} {naive}",
                chi_square(chi2, dof)
            );
        }
    }

    #[test]
    fn students_tail_becomes_the_normal_one_and_chi_square_of_one_is_normal() {
        for z in [0.1, 1.0, 3.0] {
            assert!((student(z, 1_000_000) / normal(z) - 1.0).abs() < 1e-4);
            assert!((chi_square(z * z, 1) / normal(z) - 1.0).abs() < 1e-12);
        }
        assert_eq!(
            (normal(0.0), student(0.0, 4), student(f64::INFINITY, 4), normal(f64::INFINITY)),
            (1.0, 1.0, 0.0, 0.0)
        );
    }
}
