use super::*;
use crate::signal::response::Response;
use crate::signal::sparse::{self, Profile, SparseOptions};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const DT_PS: f64 = 50.0;

fn gaussian(t_ps: f64) -> f64 {
    (-0.5 * (t_ps / 106.165_225).powi(2)).exp()
}

fn response() -> Response {
    Response::new(-650.0, 10.0, &(-65..=65).map(|i| gaussian(10.0 * f64::from(i))).collect::<Vec<_>>())
}

/// What `deconvolve` makes of pulses in noise of 1.
fn stir(pulses: &[(f64, f64)], response: &Response, rng: &mut ChaCha8Rng) -> Stir {
    let mean_v: Vec<f64> = (0..160)
        .map(|n| {
            let noise: f64 = StandardNormal.sample(rng);
            pulses.iter().map(|(time_ps, a)| a * gaussian(f64::from(n) * DT_PS - time_ps)).sum::<f64>() + noise
        })
        .collect();
    let profile = Profile {
        mean_v: &mean_v,
        sd_v: &[1.0; 160],
        acf: &[1.0],
        slow_v2: &[],
        jitter: None,
        t0_ps: 0.0,
        dt_ps: DT_PS,
    };
    let fit = sparse::fit(&profile, response, &SparseOptions::default());
    let count = fit.pulses.len();
    let impulse = |k: usize| Impulse {
        time_ps: fit.pulses[k].time_ps,
        time_sd_ps: fit.time_sd_ps(k),
        amplitude_v: fit.pulses[k].amplitude_v,
        amplitude_sd_v: fit.pulses[k].amplitude_sd_v,
        width_ps: 0.0,
        evidence: fit.pulses[k].evidence,
        misfit_sigma: fit.pulses[k].misfit_sigma,
        misfit_factor: fit.pulses[k].misfit_factor,
        width_sd_ps: None,
        width_kurtosis: None,
        width_tilt: None,
        tail_ps: None,
        own_time_ps: None,
        own_variance_ps2: None,
        pair: None,
    };
    Stir {
        campaign: "c".into(),
        sensor: "s".into(),
        lit: 1,
        seen: 2,
        range: Some("fine".into()),
        acquired_at: Some("2026-05-12T13:05:10".into()),
        t0_ps: 0.0,
        dt_ps: DT_PS,
        profile: mean_v.iter().copied().collect(),
        profile_noise: 1.0,
        impulses: (0..count).map(impulse).collect(),
        impulse_cov: fit.covariance_ps2.clone(),
        background: None,
        ground_v: 0.0,
        response_width: None,
        response_width_sd: None,
        chi2_dof: Some(fit.chi2_per_dof),
        jitter_ps: 0.0,
        gain_sd: 0.0,
        power_ratio: None,
    }
}

/// Two equal pulses so close that each amplitude is uncertain by more than a fifth: dropped by their amplitudes, found
/// by their evidence.
#[test]
fn a_blended_pair_is_not_lost_where_it_is_certain_that_it_is_there() {
    let (detect, response, mut rng) = (Detect::default(), response(), ChaCha8Rng::seed_from_u64(1));
    let (mut by_amplitude, mut kept, mut pairs, mut empty, mut squares) = (0, 0, 0, 0, Vec::new());
    for _ in 0..200 {
        let first_ps = 3000.0 + rng.random_range(0.0..DT_PS);
        let stir = stir(&[(first_ps, 100.0), (first_ps + 50.0, 100.0)], &response, &mut rng);
        let snr = |impulse: &Impulse| impulse.amplitude_v / impulse.amplitude_sd_v;
        by_amplitude += usize::from(stir.impulses.iter().any(|impulse| snr(impulse) >= 5.0));
        let onsets = detect.impulses(&stir);
        empty += usize::from(onsets.is_empty());
        kept += usize::from(!onsets.is_empty());
        if let [a, b] = &onsets[..] {
            pairs += 1;
            squares
                .extend([(a, first_ps), (b, first_ps + 50.0)].map(|(o, at)| ((o.time_ps - at) / o.time_sd_ps).powi(2)));
            assert!(onsets.iter().all(|onset| onset.flags.iter().any(|flag| **flag == *"blended")));
        }
    }
    let normalised = squares.iter().sum::<f64>() / squares.len() as f64;
    eprintln!(
        "{by_amplitude} by amplitude, {kept} found, {pairs} as pairs, {empty} lost; squared errors {normalised:.2}"
    );
    assert!(by_amplitude < 100 && empty <= 2, "{by_amplitude} by amplitude, {empty} lost");
    assert!(normalised < 2.0, "{normalised}");
}

/// Noise alone, and single pulses weak and strong: no onset comes in that was not there.
#[test]
fn evidence_brings_in_nothing_false() {
    let (detect, response, mut rng) = (Detect::default(), response(), ChaCha8Rng::seed_from_u64(2));
    for amplitude in [0.0, 5.0, 30.0, 1000.0] {
        let mut false_onsets = 0;
        for _ in 0..1000 {
            let at_ps = 3000.0 + rng.random_range(0.0..DT_PS);
            let onsets = detect.impulses(&stir(&[(at_ps, amplitude)], &response, &mut rng));
            false_onsets += onsets.iter().filter(|o| (o.time_ps - at_ps).abs() > 6.0 * o.time_sd_ps).count();
            false_onsets += onsets.len().saturating_sub(1);
        }
        assert!(false_onsets <= 1, "amplitude {amplitude}: {false_onsets} false in 1000 records");
    }
}

/// Edges at places that are known: a ramp of two pulses on no noise.
#[test]
fn responses_and_beginnings_are_found_each() {
    let profile = |n: i32| match n {
        20..30 => f64::from(n - 19) * 10.0,
        30..40 => f64::from(40 - n) * 10.0,
        80..85 => f64::from(n - 79) * 8.0,
        85..90 => f64::from(90 - n) * 8.0,
        _ => {
            if n % 2 == 0 {
                0.5
            } else {
                -0.5
            }
        }
    };
    let stir = Stir {
        profile: (0..120).map(profile).collect(),
        impulses: Vec::new(),
        impulse_cov: Vec::new(),
        background: None,
        ground_v: 0.0,
        response_width: None,
        response_width_sd: None,
        chi2_dof: None,
        ..stir(&[], &response(), &mut ChaCha8Rng::seed_from_u64(3))
    };
    for (method, places) in [(Method::FirstResponse, [20.0, 80.0]), (Method::Aic, [20.0, 80.0])] {
        let onsets = Detect { method, ..Detect::default() }.edges(&stir).unwrap();
        let starts: Vec<f64> = onsets.iter().map(|onset| onset.time_ps / DT_PS).collect();
        assert_eq!(starts.len(), 2, "{method:?}: {starts:?}");
        assert!(starts.iter().zip(places).all(|(start, place)| (start - place).abs() <= 3.0), "{method:?}: {starts:?}");
        assert_eq!([onsets[0].amplitude, onsets[1].amplitude], [100.0, 40.0]);
        assert_eq!(onsets[1].covariance, [0.0, onsets[1].time_sd_ps.powi(2)]);
    }
    let refused = Detect { method: Method::Aic, rearm_sigma: Positive::new(6.0), ..Detect::default() };
    assert_eq!(refused.conflict(), Some(Conflict("rearm_sigma", "must be at most `threshold_sigma`, 5".to_owned())));
}
