//! A smooth random function along a line: a Gaussian process as a sum of waves of a box about its places.
//!
//! Source: Solin and Sarkka, Stat. Comput. 30:419, 2020.

/// Frequencies up to so many over a function's length are waves; the rest is some 0.1 % of the variance.
const FREQUENCIES: f64 = 3.2;
/// Most waves along a line.
const MOST: usize = 20;
/// Lengths by which waves go on beyond the places, where they are zero.
const BEYOND: f64 = 2.0;

/// Waves at these places, one a vector, each with the share of a variance of 1 that its frequency has. The function's
/// correlation falls as a Gaussian of `length_m`.
pub fn waves(places_m: &[f64], length_m: f64) -> Vec<Vec<f64>> {
    let (least, most) = places_m.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(*x), b.max(*x)));
    let (middle, half) = (0.5 * (least + most), 0.5 * (most - least) + BEYOND * length_m);
    let count = (FREQUENCIES * 2.0 * half / (std::f64::consts::PI * length_m)).ceil() as usize;
    (1..=count.min(MOST))
        .map(|n| {
            let frequency = std::f64::consts::PI * n as f64 / (2.0 * half);
            let density = length_m * std::f64::consts::TAU.sqrt() * (-0.5 * (frequency * length_m).powi(2)).exp();
            let height = (density / half).sqrt();
            places_m.iter().map(|place| height * (frequency * (place - middle + half)).sin()).collect()
        })
        .collect()
}
