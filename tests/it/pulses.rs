//! Pulses at known times, from arrays of shots through `run`: what `deconvolve` proves is in `onsets`.

use std::fs::{self, File};

use periscope::formats::npy;
use periscope::pipeline::run::Settings;
use periscope::tables::{Calibration, Onset, Stir};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::lab::{Lab, write_table};
use crate::shape::{Sensor, Shape};

const CAMPAIGN: &str = "[campaign]\nname = 'pulses'\n[sensors.s1]\n[[captures]]\nrole = 'scene'\nfiles = 'raw/L{lit}_P{seen}.npy'\n\
    dt_ps = 50.0\nt0_ps = 0.0\ngain_v = 0.0001\noffset_v = 0.0\n";
const PIPELINE: &str = "[traces]\nstage = 'ingest'\n[profiles]\nstage = 'average'\nfrom = 'traces'\nparams = { shots_min = 16 }\n\
    [stir]\nstage = 'deconvolve'\nfrom = 'profiles'\nwith = { calibration = 'calibration' }\n\
    [onsets]\nstage = 'detect'\nfrom = 'stir'\n";
const DT_PS: f64 = 50.0;
const SAMPLES: usize = 200;
const SHOTS: usize = 32;
/// Codes of a pulse's height.
const HEIGHT: f64 = 4000.0;
/// Step of the response that the program is given.
const STEP_PS: f64 = 2.5;

/// Pulses of heights relative to the first, so many picoseconds behind it; SNR of the mean.
struct Setting<'a> {
    pulses: &'a [(f64, f64)],
    snr: f64,
    /// Width of the response that the program is given over that of the pulses.
    stretch: f64,
}

/// What came of each profile.
struct Outcome {
    impulses: usize,
    /// Of the first pulse.
    onsets: Vec<Onset>,
}

impl Setting<'_> {
    /// Profiles of these pulses in white noise, through files and `run`.
    fn outcomes(&self, profiles: usize, seed: u64) -> Vec<Outcome> {
        let shape = Sensor::gaussian().shape;
        let lab = Lab::bulk(0);
        fs::write(lab.campaign().join("campaign.toml"), CAMPAIGN).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        for profile in 0..profiles {
            let codes = self.codes(&shape, &mut rng);
            let path = lab.campaign().join(format!("raw/L{}_P{}.npy", 2 * profile + 1, 2 * profile + 2));
            npy::write(&mut File::create(path).unwrap(), &[SHOTS as u64, SAMPLES as u64], &codes).unwrap();
        }
        let calibration = lab.path("calibration.parquet");
        write_table(&calibration, &[calibration_of(&shape.stretched(self.stretch))]);
        let import = format!(
            "[calibration]\nstage = 'import'\nparams = {{ table = 'calibration', path = '{}' }}\n",
            calibration.display()
        );
        lab.run("out", &(import + PIPELINE), &Settings::default()).unwrap();
        let onsets: Vec<Onset> = lab.rows("out", "onsets");
        let of = |stir: &Stir| Outcome {
            impulses: stir.impulses.len(),
            onsets: onsets.iter().filter(|onset| onset.lit == stir.lit).cloned().collect(),
        };
        lab.rows::<Stir>("out", "stir").iter().map(of).collect()
    }

    fn codes(&self, shape: &Shape, rng: &mut ChaCha8Rng) -> Vec<i16> {
        let first_ps = 4000.0 + rng.random_range(0.0..DT_PS);
        let strongest = self.pulses.iter().map(|pulse| pulse.1).fold(0.0, f64::max);
        let light = |n: usize| {
            let at_ps = n as f64 * DT_PS - first_ps;
            let pulses = self.pulses.iter().map(|(behind_ps, height)| height * shape.at(at_ps - behind_ps)[0]);
            HEIGHT / strongest * pulses.sum::<f64>()
        };
        let noise = HEIGHT / self.snr * (SHOTS as f64).sqrt();
        let sample = |n: usize, rng: &mut ChaCha8Rng| {
            let normal: f64 = StandardNormal.sample(rng);
            (light(n) + noise * normal).round() as i16
        };
        (0..SHOTS).flat_map(|_| (0..SAMPLES).collect::<Vec<_>>()).map(|n| sample(n, rng)).collect()
    }
}

/// A calibration that knows this response.
fn calibration_of(shape: &Shape) -> Calibration {
    let response: Vec<f64> = (-280..=280).map(|i| shape.at(f64::from(i) * STEP_PS)[0]).collect();
    Calibration {
        campaign: "pulses".into(),
        sensor: "s1".into(),
        shots: 1000,
        step_ps: STEP_PS,
        response_t0_ps: -280.0 * STEP_PS,
        response: response.into_iter().collect(),
        latency_sd_ps: 0.1,
        width_ps: 250.0,
        ..Calibration::default()
    }
}

/// Two pulses so close that neither amplitude is certain, while their number is.
#[test]
fn pairs_that_are_proven_have_both_their_onsets() {
    for (pulses, snr) in [([(0.0, 1.0), (100.0, 1.0)], 30.0), ([(0.0, 1.0), (75.0, 3.0)], 100.0)] {
        let outcomes = Setting { pulses: &pulses, snr, stretch: 1.0 }.outcomes(200, 1);
        let pairs: Vec<&Outcome> = outcomes.iter().filter(|outcome| outcome.impulses == 2).collect();
        let both = pairs.iter().filter(|outcome| outcome.onsets.len() == 2).count();
        let empty = outcomes.iter().filter(|outcome| outcome.onsets.is_empty()).count();
        eprintln!("{pulses:?}: {} pairs of 200, {both} with both onsets, {empty} without any", pairs.len());
        assert!(pairs.len() >= 180 && both as f64 >= 0.95 * pairs.len() as f64 && empty == 0);
        let blended = |onset: &Onset| onset.snr >= 5.0 || onset.flags.iter().any(|flag| **flag == *"blended");
        assert!(outcomes.iter().flat_map(|outcome| &outcome.onsets).all(blended));
    }
}

/// A response that is given too narrow makes two of a strong pulse; its light stays.
#[test]
fn a_pulse_that_misfit_splits_is_not_lost() {
    let mut all_split = 0;
    for stretch in [0.98, 0.96] {
        let outcomes = Setting { pulses: &[(0.0, 1.0)], snr: 100.0, stretch }.outcomes(200, 2);
        let split = outcomes.iter().filter(|outcome| outcome.impulses > 1).count();
        let empty = outcomes.iter().filter(|outcome| outcome.onsets.is_empty()).count();
        eprintln!("{stretch}: {split} of 200 split, {empty} without any onset");
        assert!(empty == 0);
        all_split += split;
    }
    assert!(all_split > 20);
}
