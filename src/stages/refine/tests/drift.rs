//! Delays that drift through a day.

use rand_distr::{Distribution, StandardNormal};

use super::*;

/// Captures that follow one another through a day, while the delay goes `drift_ps` along a line and half of it along a
/// wave; with the times of capture or without.
fn drifting_day(points: &[Point], drift_ps: f64, has_times: bool) -> Vec<Label> {
    let mut labels = Day::new(points, 11).all(|_, _| true).labels;
    let count = labels.len() as f64;
    for (n, label) in labels.iter_mut().enumerate() {
        let place = n as f64 / count;
        label.time_ps += drift_ps * (place + 0.5 * (7.0 * place).sin());
        let minutes = (24.0 * 60.0 * place) as u32;
        let time = format!("2026-05-12T{:02}:{:02}:00", minutes / 60, minutes % 60);
        label.acquired_at = has_times.then(|| time.as_str().into());
    }
    labels
}

#[test]
fn a_delay_that_drifts_is_followed_and_said() {
    let room = room();
    let context = context(CAMPAIGN, vec![latency(None, 1.0, 1.0)]);
    let [with, without] = [true, false].map(|has_times| refined(&context, drifting_day(&room, 20.0, has_times)));
    let off_m =
        |rows: &SolutionRows| procrustes::rotation(&points(&rows.patches, 0), &room, Point::origin(), true).rms_m;
    let stated_m =
        |rows: &SolutionRows| (rows.patches.iter().map(|patch| patch.sd_m.unwrap().powi(2)).sum::<f64>() / 12.0).sqrt();
    let [(off, stated), (off_without, stated_without)] = [&with, &without].map(|rows| (off_m(rows), stated_m(rows)));
    eprintln!("off by {off:.5} m of {stated:.5}, without times {off_without:.5} m of {stated_without:.5}");
    assert!(without.fit.drift_ps.is_none() && without.fit.widened[1] > 3.0, "{:?}", without.fit);
    assert!(
        with.fit.misfit == 1.0 && with.fit.widened == [1.0; 4] && with.fit.drift_log_likelihood.unwrap() > 20.0,
        "{:?}",
        with.fit
    );
    assert!((with.fit.drift_span_s.unwrap() / 3600.0 - 24.0).abs() < 0.3);
    assert!(off_m(&with) < 0.5 * off_m(&without) && off_m(&with) < 2.0 * stated_m(&with));
    // Both directions of pairs tell how far onsets are off where nothing tells why.
    assert!(off_m(&without) < 2.0 * stated_m(&without), "{} {}", off_m(&without), stated_m(&without));
    let delay = &with.delays[0];
    let (values_ps, sds_ps) = (delay.drift_ps.as_ref().unwrap(), delay.drift_sd_ps.as_ref().unwrap());
    let knots_s = delay.drift_knots_s.as_ref().unwrap();
    assert_eq!((knots_s.len(), knots_s[0]), (values_ps.len(), 0.0));
    for (knot, (value_ps, sd_ps)) in values_ps.iter().zip(sds_ps).enumerate() {
        let place = knots_s[knot] / 86_400.0;
        let truth_ps = 20.0 * (place + 0.5 * (7.0 * place).sin());
        assert!(
            (delay.delay_ps + value_ps - truth_ps).abs() < 4.0 * sd_ps + 0.5,
            "{knot}: {value_ps} {truth_ps} {sd_ps}"
        );
    }
}

/// Nothing drifts: the times of capture change no row.
#[test]
fn times_change_nothing_where_nothing_drifts() {
    let room = room();
    let context = context(CAMPAIGN, vec![latency(None, 1.0, 1.0)]);
    let [with, without] = [true, false].map(|has_times| refined(&context, drifting_day(&room, 0.0, has_times)));
    assert_eq!((with.patches, with.delays, with.fit), (without.patches, without.delays, without.fit));
}

/// Walks of 20 ps a day, and onsets of a twentieth of a picosecond. Places that the onsets have without the walk
/// differ by many of these; with it, they are the one that was found.
#[test]
fn what_a_walk_moves_is_no_second_place() {
    let (sd_ps, step_ps) = (0.05, 20.0 / 8.0);
    let (mut off_m2, mut stated_m2) = (0.0, 0.0);
    for seed in 0..6 {
        let points = &room()[..8];
        let mut day = Day::new(points, seed).all(|_, _| true);
        let mut normal = || -> f64 { StandardNormal.sample(&mut day.rng) };
        let walk: Vec<[f64; 2]> = (0..64).map(|_| [step_ps * normal(), sd_ps * normal()]).collect();
        let ways_m: Vec<f64> = day.labels.iter().map(|label| day.way_m(label.path.as_deref().unwrap())).collect();
        let mut delay_ps = 0.0;
        for (n, (label, [step_ps, error_ps])) in day.labels.iter_mut().zip(walk).enumerate() {
            delay_ps += step_ps;
            (label.time_ps, label.time_sd_ps) = (time_ps(ways_m[n], 1.0) + delay_ps + error_ps, sd_ps);
            let minutes = 20 * n;
            label.acquired_at = Some(format!("2026-05-12T{:02}:{:02}:00", minutes / 60, minutes % 60).as_str().into());
        }
        let rows = refined(&context(CAMPAIGN, vec![latency(None, 1.0, 1.0)]), day.labels);
        assert!(rows.fit.drift_ps.is_some(), "{seed}: {:?}", rows.fit);
        let kinds: Vec<&str> = rows.ambiguities.iter().map(|row| &*row.kind).collect();
        assert_eq!(kinds, ["rotation"], "{seed}: {:?}", rows.ambiguities);
        off_m2 +=
            8.0 * procrustes::rotation(&super::points(&rows.patches, 0), points, Point::origin(), true).rms_m.powi(2);
        stated_m2 += rows.patches.iter().map(|patch| patch.sd_m.unwrap().powi(2)).sum::<f64>();
    }
    let ratio = (off_m2 / stated_m2).sqrt();
    assert!((0.6..1.6).contains(&ratio), "errors are {ratio} times the stated ones");
}
