//! Tables b, d, e and f of docs/time-resolution.md once more, from arrays of shots through `run` to `onsets`: what the
//! kernels resolve is not lost on the way. `benches/accuracy.rs` runs it over many records.

use std::fs::{self, File};

use periscope::formats::npy;
use periscope::pipeline::run::Settings;
use periscope::tables::Onset;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::information::time_sds_ps;
use crate::lab::{Lab, write_table};
use crate::reading_scene::calibration;
use crate::readings::import;
use crate::score::{Estimate, Rate, mean_square};
use crate::shape::Shape;

const CAMPAIGN: &str = "[campaign]\nname = 'readings'\n[sensors.s1]\n[[captures]]\nrole = 'scene'\n\
    files = 'raw/L{lit}_P{seen}.npy'\ndt_ps = 50.0\nt0_ps = 0.0\ngain_v = 0.0001\noffset_v = 0.0\n";
/// From arrays of shots to onsets, with a calibration of the heading `calibration`.
pub const STAGES: &str = "[traces]\nstage = 'ingest'\nparams = { roles = ['scene'] }\n\
    [profiles]\nstage = 'average'\nfrom = 'traces'\nwith = { calibration = 'calibration' }\n\
    [stir]\nstage = 'deconvolve'\nfrom = 'profiles'\nwith = { calibration = 'calibration' }\n\
    params = { method = 'sparse' }\n\
    [onsets]\nstage = 'detect'\nfrom = 'stir'\nparams = { method = 'impulses', threshold_sigma = 5.0 }\n";
/// Steps of the response before its start: six standard deviations of the wider one.
const BEFORE: i32 = 270;
const DT_PS: f64 = 50.0;
const SAMPLES: usize = 600;
const SHOTS: usize = 16;
/// Codes of a pulse of amplitude 1.
const HEIGHT: f64 = 2000.0;
/// Two-sided normal quantile of 95 %.
const Z_95: f64 = 1.959_964;

/// Pulses (time in ps, amplitude).
type Light = Vec<(f64, f64)>;

/// What a record shows.
#[derive(Clone, Copy, Debug)]
pub enum Kind {
    /// One pulse.
    One,
    /// Two equal pulses so many ps apart.
    Pair(f64),
    /// 3 to 12 pulses, spaced by 0.5 to 1.5 of so many ps, of amplitudes over a factor of ten.
    Many(f64),
}

/// What became of many records.
#[derive(Clone, Copy, Debug)]
pub struct Twin {
    /// The right number of onsets.
    pub right: Rate,
    /// More onsets than pulses.
    pub more: Rate,
    /// Of those with the right number: root of the mean squared error over the bound.
    pub ratio: Estimate,
    /// Onsets of these whose interval of 95 % holds the truth.
    pub within: Rate,
    /// Records of which an onset has the flag `misfit`.
    pub flagged: Rate,
}

impl Kind {
    fn light(self, rng: &mut ChaCha8Rng) -> Light {
        let first_ps = 80.0 * DT_PS + rng.random_range(0.0..DT_PS);
        match self {
            Self::One => vec![(first_ps, 1.0)],
            Self::Pair(apart_ps) => vec![(first_ps, 1.0), (first_ps + apart_ps, 1.0)],
            Self::Many(spacing_ps) => {
                let mut at_ps = first_ps;
                let count = rng.random_range(3..=12);
                let pulse = |_| {
                    at_ps += spacing_ps * rng.random_range(0.5..1.5);
                    (at_ps, 10_f64.powf(rng.random_range(0.0..1.0)))
                };
                (0..count).map(pulse).collect()
            }
        }
    }
}

/// Records of light with the response `own`, solved with the response `given`. SNR is that of amplitude 1, for one
/// sample of the mean of all shots.
pub fn twin(own: &Shape, given: &Shape, kind: Kind, snr: f64, records: usize, seed: u64) -> Twin {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let lab = Lab::bulk(0);
    fs::write(lab.campaign().join("campaign.toml"), CAMPAIGN).unwrap();
    write_table(&lab.path("calibration.parquet"), &[calibration(given, BEFORE)]);
    let lights: Vec<Light> = (0..records).map(|_| kind.light(&mut rng)).collect();
    for (n, light) in lights.iter().enumerate() {
        record(&lab, n + 1, own, light, snr, &mut rng);
    }
    let pipeline = import(&lab, "calibration", "calibration", "calibration.parquet") + STAGES;
    lab.run("out", &pipeline, &Settings::default()).unwrap();
    let onsets: Vec<Onset> = lab.rows("out", "onsets");
    let mut found = vec![Vec::new(); records];
    onsets.iter().for_each(|onset| found[onset.lit as usize - 1].push(onset));
    score(own, &lights, &found, snr)
}

fn record(lab: &Lab, patch: usize, own: &Shape, light: &Light, snr: f64, rng: &mut ChaCha8Rng) {
    let of_pulse = |at_ps: f64| light.iter().map(|(time_ps, height)| height * own.at(at_ps - time_ps)[0]).sum::<f64>();
    let means: Vec<f64> = (0..SAMPLES).map(|n| HEIGHT * of_pulse(n as f64 * DT_PS)).collect();
    let noise = HEIGHT / snr * (SHOTS as f64).sqrt();
    let code = |mean: &f64| {
        let normal: f64 = StandardNormal.sample(rng);
        (mean + noise * normal).round() as i16
    };
    let codes: Vec<i16> = std::iter::repeat_n(&means, SHOTS).flatten().map(code).collect();
    let path = lab.campaign().join(format!("raw/L{patch}_P{patch}.npy"));
    npy::write(&mut File::create(path).unwrap(), &[SHOTS as u64, SAMPLES as u64], &codes).unwrap();
}

fn score(own: &Shape, lights: &[Light], found: &[Vec<&Onset>], snr: f64) -> Twin {
    let (mut squares, mut inside) = (Vec::new(), Vec::new());
    for (light, onsets) in lights.iter().zip(found).filter(|(light, onsets)| light.len() == onsets.len()) {
        let bounds_ps = time_sds_ps(own, light, 1.0 / snr, SAMPLES);
        let errors_ps: Vec<f64> = light.iter().zip(onsets).map(|((at, _), onset)| onset.time_ps - at).collect();
        squares.push(mean_square(errors_ps.iter().zip(&bounds_ps).map(|(error, bound)| error / bound)));
        let holds = |(error, onset): (&f64, &&Onset)| error.abs() < Z_95 * onset.time_sd_ps.hypot(onset.jitter_ps);
        inside.extend(errors_ps.iter().zip(onsets).map(holds));
    }
    let counts = || lights.iter().map(Vec::len).zip(found.iter().map(Vec::len));
    let is_flagged = |onset: &&Onset| onset.flags.iter().any(|flag| &**flag == "misfit");
    Twin {
        right: Rate::of(counts().map(|(true_count, count)| true_count == count)),
        more: Rate::of(counts().map(|(true_count, count)| true_count < count)),
        ratio: Estimate::rms(&squares),
        within: Rate::of(inside),
        flagged: Rate::of(found.iter().map(|onsets| onsets.iter().any(is_flagged))),
    }
}

/// A few records of each kind: as the kernels' tables have them.
#[test]
fn what_kernels_resolve_comes_through_run() {
    let shape = crate::shape::Sensor::exponential().shape;
    let pair = Kind::Pair(1.35 * crate::information::resolution_limit_ps(&shape, 100.0));
    for (kind, least) in [(Kind::One, 0.98), (pair, 0.9), (Kind::Many(12.0 * 26.2), 0.95)] {
        let twin = twin(&shape, &shape, kind, 100.0, 60, 1);
        eprintln!("{kind:?}: {twin:?}");
        assert!(twin.more.hits <= 1 && twin.flagged.share() < 0.1, "{kind:?} {twin:?}");
        assert!(
            twin.right.share() >= least && twin.within.share() > 0.88 && twin.ratio.value < 1.3,
            "{kind:?} {twin:?}"
        );
    }
}
