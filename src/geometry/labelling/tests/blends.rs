//! Arrivals that are the light of two paths.

use super::*;
use crate::association::{Candidate, Time};
use crate::labelling::scene::Prediction;

const SD_PS: f64 = 2.0;
const OWN_PS: f64 = 5000.0;
const OTHER_PS: f64 = 5060.0;

/// Standard deviation that an arrival gets in addition to its own of 2 ps. Near it two equally strong paths 60 ps apart
/// are predicted; with `is_resolved` the other path has an arrival of its own.
fn added_ps(time_ps: f64, is_resolved: bool) -> f64 {
    let visible: Vec<PatchId> = (1..=4).collect();
    let chances = Chances::prior(&visible);
    let path = |inner: PatchId| vec![1, inner, 2];
    let prediction =
        |inner: PatchId, time_ps: f64| Prediction { path: path(inner), turns: 0, time: Time { time_ps, sd_ps: 0.5 } };
    let predictions = [prediction(3, OWN_PS), prediction(4, OTHER_PS)];
    let arrival = |time_ps: f64| Arrival::point(time_ps, SD_PS, 20.0);
    let mut arrivals = vec![arrival(time_ps)];
    let candidate = |path: usize| vec![Candidate { path, residual_ps: 0.0, probability: 1.0 }];
    let mut candidates = vec![candidate(0)];
    if is_resolved {
        arrivals.push(arrival(OTHER_PS));
        candidates.push(candidate(1));
    }
    let snrs = [(chances.class(&path(3)), 10.0)].into();
    let profile = Profile { lit: 1, seen: 2, delay_ps: 0.0, delay_sd_ps: 0.0, arrivals };
    Blends { chances: &chances, snrs, reach_ps: 100.0 }.sds_ps(&profile, &predictions, &candidates)[0]
}

/// An arrival between two paths may be off by half their distance. One in its place, on the far side, or near an
/// arrival of the other path's own gets no further error.
#[test]
fn arrivals_between_two_paths_are_the_uncertain_ones() {
    let between_ps = added_ps(OWN_PS + 30.0, false);
    assert!((29.0..31.0).contains(&between_ps), "{between_ps}");
    let in_place_ps = added_ps(OWN_PS, false);
    assert!(in_place_ps < SD_PS, "{in_place_ps}");
    let far_side_ps = added_ps(OWN_PS - 8.0, false);
    assert!(far_side_ps < 2.0 * SD_PS, "{far_side_ps}");
    assert_eq!(added_ps(OWN_PS + 30.0, true), 0.0);
}
