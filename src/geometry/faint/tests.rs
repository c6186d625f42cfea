mod scene;

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
