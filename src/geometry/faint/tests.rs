mod scene;

use nalgebra::DMatrix;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::*;
use scene::{Strengths, draw};

/// What a patch needs at a false alarm of 1e-3.
const NEEDED: f64 = 6.9;

fn squared(faint: &Faint, truth: &Point) -> f64 {
    let off = faint.point - truth;
    off.dot(&(faint.covariance.try_inverse().unwrap() * off))
}

/// Signal-to-noise ratios of 1.5 in each of 64 profiles are a patch, at the place that its covariance says; noise is
/// none.
#[test]
fn pulses_too_weak_in_each_profile_are_a_patch_in_all_together() {
    for strengths in [Strengths::Physical, Strengths::Alike] {
        let (mut normalised, count) = (0.0, 10);
        for seed in 0..count {
            let (profiles, room, hidden) = draw(8, 1.5, strengths, seed);
            let solution = likeliest(&profiles, &room).unwrap();
            assert!(solution.evidence > NEEDED, "{strengths:?} {seed}: {}", solution.evidence);
            normalised += squared(&solution, &hidden) / 3.0 / count as f64;
        }
        eprintln!("{strengths:?}: squared errors over covariances {normalised:.2}");
        assert!((0.3..1.8).contains(&normalised), "{strengths:?}: {normalised}");
    }
    for seed in 0..6 {
        let (profiles, room, _) = draw(8, 0.0, Strengths::Alike, seed);
        let most = likeliest(&profiles, &room).map_or(f64::NEG_INFINITY, |place| place.evidence);
        assert!(most < NEEDED, "{seed}: {most}");
    }
}

/// Patches and delays that are not quite where they are believed to be move a place as far as stated, and farther than
/// noise does.
#[test]
fn errors_that_profiles_share_are_those_that_a_place_gains() {
    let (source, sensor) = (Point::new(-0.6, 1.2, 0.3), Point::new(1.4, -0.5, 0.2));
    let (focus_sd_m, delay_sd_m, count) = (0.01, 0.02, 24);
    let mut squares = [0.0; 2];
    for seed in 0..count {
        let (mut profiles, mut room, hidden) = draw(8, 2.5, Strengths::Alike, 100 + seed);
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut normal =
            |sd_m: f64| -> f64 { sd_m * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut rng) };
        let late_m = [normal(delay_sd_m), normal(delay_sd_m)];
        let known: Vec<Point> = room.foci.iter().map(|focus| focus.point).collect();
        for focus in &mut room.foci {
            focus.point += Vector3::from_fn(|_, _| normal(focus_sd_m));
        }
        let longer_m =
            |station: Point, place: usize| (known[place] - station).norm() - (room.foci[place].point - station).norm();
        // Profiles by turns have one delay or the other.
        for (n, profile) in profiles.iter_mut().enumerate() {
            let [a, b] = profile.foci;
            profile.low_m += longer_m(source, a) + longer_m(sensor, b) + late_m[n % 2];
        }
        let ends = (0..profiles.len()).map(|n| Ends { source, sensor, delay: Some((n % 2, delay_sd_m)) }).collect();
        let foci_m2 = DMatrix::identity(24, 24) * (focus_sd_m * focus_sd_m);
        let place = likeliest(&profiles, &room).unwrap();
        let gained_m2 = gained_m2(place.point, &profiles, &room, &Shared { foci_m2, profiles: ends, delays: 2 });
        let whole = Faint { covariance: place.covariance + gained_m2, ..place };
        for (sum, place) in squares.iter_mut().zip([whole, place]) {
            *sum += squared(&place, &hidden) / 3.0 / f64::from(count as u32);
        }
    }
    eprintln!("squared errors over covariances: {squares:.2?} with and without the errors that profiles share");
    assert!((0.6..1.5).contains(&squares[0]) && squares[1] > 2.0, "{squares:?}");
}

/// The evidence is the integral that it claims to be, and nothing near is likelier. Compared with a grid over all
/// places within five standard deviations.
#[test]
fn evidence_and_likelihood_are_those_of_a_grid() {
    let (profiles, room, _) = draw(6, 2.0, Strengths::Physical, 3);
    let solution = likeliest(&profiles, &room).unwrap();
    let longest_m = profiles.iter().map(Profile::end_m).fold(0.0, f64::max);
    let middle = room.foci.iter().map(|focus| focus.point.coords).sum::<Vector3<f64>>() / room.foci.len() as f64;
    let domain = Domain { centre: Point::from(middle), half_m: 0.5 * longest_m, dimensions: 3 };
    let all = Likelihood::new(&profiles, &room, &domain);
    let axes = solution.covariance.symmetric_eigen();
    let (side, step) = (12_i32, 5.0 / 12.0);
    let (mut sum, mut most) = (0.0, f64::NEG_INFINITY);
    for (i, j, k) in
        (-side..=side).flat_map(|i| (-side..=side).flat_map(move |j| (-side..=side).map(move |k| (i, j, k))))
    {
        let along = Vector3::new(f64::from(i), f64::from(j), f64::from(k)) * step;
        let off = axes.eigenvectors * along.component_mul(&axes.eigenvalues.map(f64::sqrt));
        let Some(place) = all.place(&(solution.point + off)) else { continue };
        sum += (place.mean() - solution.likelihood).exp();
        most = most.max(place.most());
    }
    let cell = axes.eigenvalues.map(f64::sqrt).product() * step.powi(3);
    let evidence = solution.likelihood + (sum * cell).ln() - all.log_volume;
    assert!((solution.evidence - evidence).abs() < 0.15, "{} {evidence}", solution.evidence);
    assert!(solution.likelihood > most - 0.3, "{} {most}", solution.likelihood);
}

/// A patch that is not sure is sure with as many shots as it asks for.
#[test]
fn as_many_shots_as_asked_for_show_a_patch() {
    let (mut declined, mut shown) = (0, 0);
    for seed in 0..24 {
        let (profiles, room, hidden) = draw(8, 0.9, Strengths::Alike, seed);
        let is_it = |place: &Faint| squared(place, &hidden) < 25.0;
        let Some(place) = likeliest(&profiles, &room).filter(|place| place.evidence < NEEDED && is_it(place)) else {
            continue;
        };
        let growth = place.growth(NEEDED, 3);
        assert!((1.0..10.0).contains(&growth), "{growth}");
        let (profiles, room, _) = draw(8, 0.9 * growth.sqrt(), Strengths::Alike, seed);
        declined += 1;
        shown += usize::from(likeliest(&profiles, &room).is_some_and(|place| place.evidence > NEEDED && is_it(&place)));
    }
    eprintln!("{shown} of {declined} declined patches are shown");
    assert!(declined >= 5 && 10 * shown >= 7 * declined, "{shown} of {declined}");
}
