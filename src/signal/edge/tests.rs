use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Poisson};

use super::*;

pub(super) const SIGMA_PS: f64 = 25.0;
pub(super) const DT_PS: f64 = 8.0;
const DRAWS: usize = 600;
/// First bin of light from so far that it hardly declines over the window.
pub(super) const FAR_PS: f64 = 8000.0;

/// First returns under the limits of the law: a step, an edge, a corner.
fn limits(bins: &Bins<'_>, rises: &Rises) -> [FirstReturn; 3] {
    let start_ps = first_rise(bins, SIGMA_PS, 5.0).unwrap();
    let window = Window::about(bins, rises, Background::CONSTANT, start_ps).unwrap();
    [STEP, EDGE, CORNER].map(|ends| window.first_return(&[Face::quarter(ends)]).unwrap())
}

pub(super) fn rises() -> Rises {
    let response: Vec<f64> = (-150..=150).map(|n| (-0.5 * (f64::from(n) / SIGMA_PS).powi(2)).exp()).collect();
    Rises::new([-150.0, 1.0], &response, [FWHM * SIGMA_PS, DT_PS])
}

/// Mean counts of a power that begins at `tau_ps`, by sums over femtosecond steps: no code is shared with the table.
pub(super) fn means(power: f64, tau_ps: f64, [background, height]: [f64; 2]) -> Vec<f64> {
    let density = |t: f64| (-0.5 * (t / SIGMA_PS).powi(2)).exp() / (SIGMA_PS * std::f64::consts::TAU.sqrt());
    let bin = |n: i32| {
        let at = f64::from(n) * DT_PS - tau_ps;
        let parts =
            (0..1600).map(|k| 0.25 * (f64::from(k) + 0.5)).map(|u| (u / SIGMA_PS).powf(power) * density(at - u));
        background + height * 0.25 * parts.sum::<f64>()
    };
    (0..120).map(bin).collect()
}

#[test]
fn the_law_of_the_light_is_the_likeliest_and_has_its_time() {
    let rises = rises();
    for (k, power) in [0.0, 0.5, 1.0].into_iter().enumerate() {
        let values = means(power, 500.0, [20.0, 1e5]);
        let bins = Bins { first_ps: 0.0, dt_ps: DT_PS, values: &values, noise: Noise::Counts };
        let laws = limits(&bins, &rises);
        // An edge and a corner have a plane at some distance, which is not that of the limit.
        assert!((laws[k].time_ps - 500.0).abs() < [0.5, 1.0, 2.0][k], "{power}: {laws:?}");
        for other in (0..3).filter(|other| *other != k) {
            assert!(laws[k].log_likelihood > laws[other].log_likelihood, "{power}: {laws:?}");
        }
    }
}

#[test]
fn errors_scatter_as_stated() {
    let rises = rises();
    let means = means(0.0, 500.0, [2.0, 40.0]);
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let (mut square, mut held) = (0.0, 0);
    for _ in 0..DRAWS {
        let values: Vec<f64> = means.iter().map(|mean| Poisson::new(*mean).unwrap().sample(&mut random)).collect();
        let bins = Bins { first_ps: FAR_PS, dt_ps: DT_PS, values: &values, noise: Noise::Counts };
        let [step, ..] = limits(&bins, &rises);
        let z = (step.time_ps - FAR_PS - 500.0) / step.sd_ps;
        square += z * z / DRAWS as f64;
        held += usize::from(z.abs() < 1.96);
    }
    // Of 600 draws a share of .95 has a standard deviation of .009. Slopes are not drawn from their prior here.
    assert!((0.92..0.98).contains(&(held as f64 / DRAWS as f64)), "{held} of {DRAWS}");
    assert!((0.7..1.2).contains(&square), "{square}");
}

/// The weaker light is, the later its likeliest time: neighbours have that in common, so that it does not average out.
#[test]
fn weak_light_is_late_by_what_it_says() {
    let rises = rises();
    let mut random = ChaCha8Rng::seed_from_u64(13);
    for (k, power, height) in [(0, 0.0, 3.0), (1, 0.5, 3.0), (2, 1.0, 3.0), (2, 1.0, 12.0)] {
        let means = means(power, 500.0, [0.05, height]);
        let (mut late_ps, mut common_ps, mut sd_ps, mut count) = (0.0, 0.0, 0.0, 0.0);
        for _ in 0..4 * DRAWS {
            let values: Vec<f64> = means.iter().map(|mean| Poisson::new(*mean).unwrap().sample(&mut random)).collect();
            let bins = Bins { first_ps: FAR_PS, dt_ps: DT_PS, values: &values, noise: Noise::Counts };
            // Those that do not rise by the threshold are not timed.
            if first_rise(&bins, SIGMA_PS, 5.0).is_none() {
                continue;
            }
            let one = limits(&bins, &rises)[k];
            late_ps += one.time_ps - FAR_PS - 500.0;
            common_ps += one.common_ps;
            sd_ps += one.sd_ps;
            count += 1.0;
        }
        let [late_ps, common_ps, sd_ps] = [late_ps, common_ps, sd_ps].map(|sum| sum / count);
        println!("power {power}, height {height}: late by {late_ps:.2} ps, common {common_ps:.2} ps, sd {sd_ps:.2} ps");
        assert!(late_ps.abs() < common_ps + 2.0 * sd_ps / f64::sqrt(count), "{late_ps} and {common_ps} ps");
    }
}

#[test]
fn background_alone_has_no_first_return() {
    let mut random = ChaCha8Rng::seed_from_u64(12);
    let background = Poisson::new(5.0).unwrap();
    let rises = (0..200).filter(|_| {
        let values: Vec<f64> = (0..500).map(|_| background.sample(&mut random)).collect();
        let bins = Bins { first_ps: 0.0, dt_ps: DT_PS, values: &values, noise: Noise::Counts };
        first_rise(&bins, SIGMA_PS, 5.0).is_some()
    });
    assert_eq!(rises.count(), 0);
}

/// Histograms that show light from 2,400 ps on, and before that so many counts a bin.
fn early_light(count: usize, random: &mut ChaCha8Rng, before: impl Fn(f64) -> f64) -> Vec<Vec<f64>> {
    let mut bin = |n: usize| {
        let time_ps = n as f64 * DT_PS;
        Poisson::new(before(time_ps) + if time_ps > 2400.0 { 8.0 } else { 0.0 }).unwrap().sample(random)
    };
    (0..count).map(|_| (0..400).map(&mut bin).collect()).collect()
}

/// By how much the histograms of a group together show light before what each shows alone.
fn earlier(histograms: &[Vec<f64>], noise: Noise) -> f64 {
    let early = |values: &Vec<f64>| {
        let bins = Bins { first_ps: 0.0, dt_ps: DT_PS, values, noise };
        let rise_ps = first_rise(&bins, SIGMA_PS, 5.0)?;
        Some((Early::before(&bins, SIGMA_PS, rise_ps)?, 2400.0))
    };
    let early: Vec<(Early, f64)> = histograms.iter().filter_map(early).collect();
    let early: Vec<(&Early, f64)> = early.iter().map(|(early, time_ps)| (early, *time_ps)).collect();
    earlier_light(&early, SIGMA_PS)
}

#[test]
fn light_that_no_histogram_shows_is_found_in_many() {
    let mut random = ChaCha8Rng::seed_from_u64(15);
    let mut groups = |count: usize, before: &dyn Fn(f64) -> f64| -> usize {
        let is_found = |_: &usize| earlier(&early_light(count, &mut random, before), Noise::Counts) > 5.0;
        (0..40).filter(is_found).count()
    };
    let weak = |from_ps: f64| move |time_ps: f64| if time_ps > from_ps { 0.3 } else { 0.2 };
    assert_eq!([groups(49, &|_| 0.2), groups(1, &|_| 0.2)], [0, 0]);
    assert_eq!([groups(49, &weak(1600.0)), groups(1, &weak(1600.0))], [40, 0]);
    // Light that grows just before is that which is shown.
    assert_eq!(groups(49, &|time_ps| if time_ps > 2300.0 { 1.0 } else { 0.2 }), 0);
    // A background that grows by a third over 5 ns.
    assert_eq!(groups(49, &|time_ps| 2.0 + 1.3e-4 * time_ps), 0);
    assert_eq!(earlier(&early_light(49, &mut random, weak(1600.0)), Noise::Gauss { sd: 0.5 }), 0.0);
}

#[test]
fn levels_have_first_returns_too() {
    let rises = rises();
    let values: Vec<f64> =
        means(0.0, 500.0, [0.0, 1.0]).iter().enumerate().map(|(n, v)| v + 1e-3 * f64::from(n as i32 % 3 - 1)).collect();
    let bins = Bins { first_ps: 0.0, dt_ps: DT_PS, values: &values, noise: Noise::Gauss { sd: 1e-3 } };
    let [step, ..] = limits(&bins, &rises);
    assert!((step.time_ps - 500.0).abs() < 4.0 * step.sd_ps.max(0.1), "{step:?}");
}

/// Light of a rectangle behind the response, by a sum over small squares of it.
fn sum_over_squares(ends: [[f64; 2]; 2], times: &[f64]) -> Vec<f64> {
    const SIDE: f64 = 0.01;
    let density = |t: f64| (-0.5 * t * t).exp() / std::f64::consts::TAU.sqrt();
    let places = |[high, low]: [f64; 2]| -> Vec<f64> {
        let count = ((high + low) / SIDE).round() as usize;
        (0..count).map(|n| -low + SIDE * (n as f64 + 0.5)).collect()
    };
    let nearest: f64 = ends.iter().flatten().map(|end| end.min(0.0).powi(2)).sum();
    let mut light = vec![0.0; times.len()];
    for x in places(ends[0]) {
        for y in places(ends[1]).into_iter().filter(|y| x * x + y * y - nearest < 12.0) {
            let since = x * x + y * y - nearest;
            let area = SIDE * SIDE / std::f64::consts::PI;
            light.iter_mut().zip(times).for_each(|(light, time)| *light += area * density(time - since));
        }
    }
    light
}

#[test]
fn the_law_is_a_sum_over_the_surface() {
    let rises = rises();
    let times = [-1.0, 0.0, 0.5, 1.0, 2.0, 3.0];
    let narrow = [[0.3, 0.9], [0.7, 1.1]];
    let beyond_an_edge = [[-0.8, 3.5], [0.5, 1.2]];
    let beyond_a_corner = [[-0.6, 2.0], [-1.1, 3.0]];
    let at_the_far_end = [[1.5, -0.4], [4.0, 4.0]];
    for ends in [narrow, beyond_an_edge, beyond_a_corner, at_the_far_end] {
        let law = rises.law(&[Face { weight: 1.0, ends }], f64::INFINITY);
        for (time, sum) in times.iter().zip(sum_over_squares(ends, &times)) {
            let [light, ..] = law.at(time * SIGMA_PS);
            // Bins of a third of the width, and distances of the table, blur a little.
            assert!((light - sum).abs() < 0.012, "{ends:?} at {time}: {light}, {sum}");
        }
    }
}

#[test]
fn light_over_a_declining_tail_is_not_late() {
    let rises = rises();
    let tail = |n: usize| 60.0 * (-(n as f64) * DT_PS / 250.0).exp() + 0.5;
    let begins_ps = [450.0, 550.0, 650.0];
    let histogram = |tau_ps: f64| -> Vec<f64> {
        means(1.0, tau_ps, [0.0, 20.0]).iter().enumerate().map(|(n, light)| light + tail(n)).collect()
    };
    let histograms = begins_ps.map(histogram);
    let starts: Vec<(Bins<'_>, f64)> = histograms
        .iter()
        .zip(begins_ps)
        .map(|(values, tau_ps)| (Bins { first_ps: 0.0, dt_ps: DT_PS, values, noise: Noise::Counts }, tau_ps + 10.0))
        .collect();
    let late_ps = |background: Background| {
        let (bins, start_ps) = &starts[1];
        let window = Window::about(bins, &rises, background, *start_ps).unwrap();
        window.first_return(&[Face::quarter(CORNER)]).unwrap().time_ps - 550.0
    };
    let [with, without] = [Background::before(&starts, SIGMA_PS), Background::CONSTANT].map(late_ps);
    assert!(without > with.abs() + 5.0, "{with} ps with a tail, {without} ps without");
}
