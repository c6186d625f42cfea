//! Tones that are the same in every shot, beside pulses and as strong as these are.

use super::*;

/// A tone of any frequency is no row of pulses, and costs the times nothing.
#[test]
fn a_tone_is_no_row_of_pulses() {
    let shape = exponential();
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let pulses = [(4012.0, 1.0), (9031.0, 0.6)];
    let sd = 0.02;
    // Turns a sample: slow ones, one as fast as pulses are wide, a quarter, and just below a half, and a half.
    for turns in [0.02, 0.05, 0.0821, 0.25, 0.4931, 0.5] {
        let options = SparseOptions { pulses_max: 16, ..SparseOptions::default() };
        let mut squares = Vec::new();
        for _ in 0..15 {
            let phase = rng.random_range(0.0..std::f64::consts::TAU);
            let mut mean_v = with_noise(&clean(&shape, &pulses, 0.1, 400), sd, &mut rng);
            for (n, value) in mean_v.iter_mut().enumerate() {
                *value += 6.0 * sd * (std::f64::consts::TAU * turns * n as f64 + phase).cos();
            }
            let sd_v = vec![sd; mean_v.len()];
            let profile = Profile {
                mean_v: &mean_v,
                sd_v: &sd_v,
                acf: &[],
                slow_v2: &[],
                jitter: None,
                t0_ps: T0_PS,
                dt_ps: DT_PS,
            };
            let fit = fit(&profile, &shape.response, &options);
            assert_eq!(fit.pulses.len(), 2, "{turns}: {:?}", fit.pulses);
            let shown = fit.ground_v / (6.0 * sd / 2.0_f64.sqrt());
            // Pulses that explained a part of it were there first.
            // Of half the sample rate, phase is size.
            assert!(turns == 0.5 || (0.3..1.2).contains(&shown), "{turns}: {shown}");
            for (pulse, (at_ps, _)) in fit.pulses.iter().zip(pulses) {
                squares.push(((pulse.time_ps - at_ps) / pulse.time_sd_ps).powi(2));
            }
        }
        let mean = squares.iter().sum::<f64>() / squares.len() as f64;
        assert!((0.5..1.8).contains(&mean), "{turns}: {mean}");
    }
}
