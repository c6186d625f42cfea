//! Errors that onsets of one profile share.

use super::*;

/// Light over three more patches in each profile of two, all as late as the profile's jitter says.
fn jittering(room: &[Point], seed: u64, is_given: bool) -> Vec<Label> {
    let jitter_ps = 10.0;
    let mut day = Day::new(room, seed);
    for (a, b) in (1..=12).flat_map(|a| (1..=12).map(move |b| (a, b))) {
        let late: f64 = StandardNormal.sample(&mut day.rng);
        let mut paths = vec![if a == b { vec![a] } else { vec![a, b] }];
        paths.extend((1..=12).filter(|k| ![a, b].contains(k)).take(3).map(|k| vec![a, k, b]));
        let first = day.labels.len();
        paths.iter().for_each(|path| day.add(path, "s1", None, jitter_ps * late));
        for (rank, label) in (1..).zip(&mut day.labels[first..]) {
            (label.rank, label.time_sd_ps) = (rank, jitter_ps.hypot(SD_PS));
            let of = |other: i32| jitter_ps.powi(2) + if other == rank { SD_PS * SD_PS } else { 0.0 };
            label.covariance = if is_given { (1..=4).map(of).collect() } else { Vec::new() };
        }
    }
    day.labels
}

/// Of all patches but those that fix the frame: squared errors over their variances, by coordinate, and their rms, m.
fn errors(is_given: bool) -> [f64; 2] {
    let room = room();
    let anchor = |n: usize| format!("[patches.{n}]\nposition_m = {:?}\nsd_m = 1e-5\n", room[n - 1].coords.as_slice());
    let context = context(&format!("{CAMPAIGN}{}", (1..=4).map(anchor).collect::<String>()), Vec::new());
    let (mut pulls, mut squares_m2, mut patches) = (0.0, 0.0, 0.0);
    for seed in 0..12 {
        let rows = refined(&context, jittering(&room, 40 + seed, is_given)).patches;
        for row in rows.iter().filter(|row| row.alternative == 0 && row.patch > 4) {
            let error = Point::new(row.x_m, row.y_m, row.z_m) - room[row.patch as usize - 1];
            let covariance_m2 = crate::priors::covariances::of_patch(row).unwrap();
            pulls += error.dot(&(covariance_m2.try_inverse().unwrap() * error));
            squares_m2 += error.norm_squared();
            patches += 1.0;
        }
    }
    [pulls / (3.0 * patches), (squares_m2 / patches).sqrt()]
}

/// The jitter of a profile moves all its onsets alike: their differences are known better than each, their mean no
/// better than one.
#[test]
fn onsets_that_share_an_error_are_weighed_together() {
    let ([with, rms_m], [without, rms_without_m]) = (errors(true), errors(false));
    println!("pulls {with:.3} and {without:.3}, errors {:.3} and {:.3} mm", 1e3 * rms_m, 1e3 * rms_without_m);
    assert!((0.8..1.25).contains(&with), "squared errors over their variances: {with}");
    assert!(without > 1.25 && rms_m < 0.7 * rms_without_m, "{without}; {rms_m} m and {rms_without_m} m");
}
