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

/// Squared errors of patches over their variances, by coordinate.
fn squares(is_given: bool) -> f64 {
    let room = room();
    let anchors: String = (1..=4)
        .map(|n| format!("[patches.{n}]\nposition_m = {:?}\nsd_m = 1e-5\n", room[n - 1].coords.as_slice()))
        .collect();
    let context = context(&format!("{CAMPAIGN}{anchors}"), Vec::new());
    let (mut sum, draws) = (0.0, 12);
    for seed in 0..draws {
        let patches = refined(&context, jittering(&room, 40 + seed, is_given)).patches;
        for row in patches.iter().filter(|row| row.alternative == 0 && row.patch > 4) {
            let error = Point::new(row.x_m, row.y_m, row.z_m) - room[row.patch as usize - 1];
            let covariance_m2 = crate::priors::covariances::of_patch(row).unwrap();
            sum += error.dot(&(covariance_m2.try_inverse().unwrap() * error));
        }
    }
    sum / (draws as f64 * 8.0 * 3.0)
}

#[test]
fn onsets_that_share_an_error_do_not_count_as_many() {
    let (with, without) = (squares(true), squares(false));
    assert!((0.8..1.25).contains(&with), "squared errors over their variances: {with}");
    assert!(without > 1.5, "without what they share, errors are larger than stated: {without}");
}
