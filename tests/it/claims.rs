//! What onsets claim, from arrays of shots through `run`, with instruments that are not kind: slopes, hum, wander, 1/f
//! noise, coarse converters, responses measured another day. `benches/accuracy.rs` runs it over many records, for
//! docs/error-bars.md.

use std::f64::consts::TAU;
use std::fs::{self, File};

use nalgebra::{DMatrix, DVector};
use periscope::formats::npy;
use periscope::pipeline::run::Settings;
use periscope::tables::{Calibration, Onset};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::lab::{Lab, write_table};
use crate::reading_scene;
use crate::readings::import;
use crate::score::{Estimate, Rate};
use crate::shape::{Sensor, Shape};
use crate::twins::STAGES;

/// Steps of the response before its start.
const BEFORE: i32 = 270;
const DT_PS: f64 = 50.0;
const SAMPLES: usize = 600;
const SHOTS: usize = 64;
/// Two-sided normal quantile of 95 %.
const Z_95: f64 = 1.959_964;
/// An onset belongs to a pulse within so many of its standard deviations, and picoseconds.
const NEAR: (f64, f64) = (6.0, 60.0);
/// Shots of a bad laser: none, or four times the light.
const BAD: [f64; 2] = [0.0, 4.0];

/// The calibration as the first records have it.
const RECALIBRATION: &str = "[first_traces]\nstage = 'ingest'\nparams = { roles = ['scene'], captures_max = 64 }\n\
    [first_profiles]\nstage = 'average'\nfrom = 'first_traces'\nwith = { calibration = 'response' }\n\
    [calibration]\nstage = 'recalibrate'\nfrom = 'first_profiles'\nwith = { calibration = 'response' }\n";

/// What an instrument does to light; noise is white, of the standard deviation 1 in a shot, and all else is in it.
#[derive(Clone, Debug)]
pub struct Instrument {
    /// For the table.
    pub name: String,
    /// Rise over a record, the same in each shot.
    pub slope: f64,
    /// Noise in lines: standard deviation and frequency, GHz; of random phase in each shot.
    pub lines: Vec<(f64, f64)>,
    /// The same phase in each shot of a capture.
    pub is_locked: bool,
    /// Steps of the converter in it.
    pub codes: f64,
    /// The response as it is, and as the calibration has it.
    pub own: Shape,
    pub calibrated: Shape,
    /// Share of bad shots.
    pub bad: f64,
    /// Standard deviation of the trigger, ps, and of that of the calibration.
    pub jitter_ps: f64,
    pub calibrated_jitter_ps: f64,
}

impl Instrument {
    /// Without a flaw.
    pub fn kind(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            slope: 0.0,
            lines: Vec::new(),
            is_locked: false,
            codes: 100.0,
            own: Sensor::exponential().shape,
            calibrated: Sensor::exponential().shape,
            bad: 0.0,
            jitter_ps: 0.0,
            calibrated_jitter_ps: 0.0,
        }
    }

    /// The instruments of the study.
    pub fn all() -> Vec<Self> {
        let shape = Sensor::exponential().shape;
        let kind = Self::kind;
        let wander = |ghz: f64| Self { lines: vec![(4.0, ghz)], ..kind(&format!("wander of 4, {:.0} MHz", 1e3 * ghz)) };
        let locked = |ghz: f64, height: f64| Self {
            lines: vec![(height, ghz)],
            is_locked: true,
            ..kind(&format!("ripple of {height} locked to the laser, {:.0} MHz", 1e3 * ghz))
        };
        let stretched = |factor: f64, name: &str| Self { own: shape.stretched(1.0 / factor), ..kind(name) };
        vec![
            kind("white noise"),
            Self { slope: 0.5, ..kind("slope of 0.5") },
            Self { slope: 2.0, ..kind("slope of 2") },
            Self { lines: vec![(100.0, 60e-9)], ..kind("hum of 100, 60 Hz") },
            wander(0.001),
            wander(0.01),
            wander(0.025),
            wander(0.1),
            Self { lines: flicker(1.0), ..kind("1/f, corner 1 GHz") },
            Self { lines: flicker(0.1), ..kind("1/f, corner 100 MHz") },
            locked(0.025, 0.5),
            locked(0.1, 0.5),
            Self { codes: 2.0, ..kind("2 codes of noise") },
            Self { codes: 0.3, ..kind("0.3 codes of noise") },
            Self { codes: 0.1, ..kind("0.1 codes of noise") },
            Self { bad: 0.06, ..kind("6 % bad shots") },
            Self {
                jitter_ps: 30.0,
                calibrated_jitter_ps: 30.0,
                calibrated: shape.widened(30.0),
                ..kind("jitter of 30 ps")
            },
            stretched(1.02, "response given 2 % too wide"),
            stretched(0.98, "response given 2 % too narrow"),
            stretched(1.05, "response given 5 % too wide"),
            stretched(0.95, "response given 5 % too narrow"),
            Self { own: shape.with_echo(600.0, 0.01), ..kind("echo of -40 dB after 0.6 ns") },
            Self { own: shape.with_tail(1000.0, 0.01), ..kind("tail of 1 %, 1 ns") },
            Self { jitter_ps: 30.0, ..kind("jitter of 30 ps since calibration") },
            // Between pulses and samples, and where converters of four parts have their spurs.
            locked(1.0, 0.5),
            locked(5.0, 0.5),
        ]
    }

    /// Standard deviation of a sample in the mean of all shots: white noise, and what rounding leaves whatever their
    /// number (harmonics of a sawtooth, filtered by the noise).
    fn mean_sd(&self) -> f64 {
        let harmonic = |k: f64| (-(TAU * k * self.codes).powi(2)).exp() / (k * k);
        let sawtooth: f64 = (1..100).map(|k| harmonic(f64::from(k))).sum::<f64>() * 2.0 / (TAU * self.codes).powi(2);
        (1.0 / SHOTS as f64 + sawtooth).sqrt()
    }

    /// Covariance of a sample in the mean, over [`Self::mean_sd`] squared.
    fn covariance(&self) -> DMatrix<f64> {
        let at =
            |lag: f64| self.lines.iter().map(|(sd, ghz)| sd * sd * (TAU * ghz * 1e-3 * lag * DT_PS).cos()).sum::<f64>();
        // The rest is noise of single shots.
        let share = 1.0 / (SHOTS as f64 * self.mean_sd().powi(2));
        DMatrix::from_fn(SAMPLES, SAMPLES, |i, j| {
            let own = if i == j { 1.0 } else { 0.0 };
            own + if self.is_locked { 0.0 } else { share * at(i.abs_diff(j) as f64) }
        })
    }
}

/// Lines that add up to 1/f noise whose density is that of white noise at `corner_ghz`.
pub fn flicker(corner_ghz: f64) -> Vec<(f64, f64)> {
    const LINES: i32 = 160;
    // From a twentieth of a turn in a record to the highest that samples show.
    let (first, last) = (0.05 / (SAMPLES as f64 * DT_PS * 1e-3), 0.5e3 / DT_PS);
    let edge = |k: i32| first * (last / first).powf(f64::from(k) / f64::from(LINES));
    // White noise of variance 1 has the density 2 dt up to there.
    let line = |k: i32| {
        let variance = 2.0e-3 * DT_PS * corner_ghz * (edge(k + 1) / edge(k)).ln();
        (variance.sqrt(), (edge(k) * edge(k + 1)).sqrt())
    };
    (0..LINES).map(line).collect()
}

/// What became of the pulses of many records.
#[derive(Clone, Copy, Debug)]
pub struct Claims {
    /// Pulses without an onset.
    pub missed: Rate,
    /// Records with an onset that is no pulse.
    pub false_onsets: Rate,
    /// Of the others: root of the mean squared error over the bound that knows the noise.
    pub ratio: Estimate,
    /// Intervals of 95 % that hold the truth.
    pub within: Rate,
    /// Records of which an onset has the flag `misfit`.
    pub flagged: Rate,
    /// Bound over the one in white noise alone.
    pub lost: f64,
}

/// One to three pulses, at least 2 ns apart, the strongest of the given SNR, for one sample of the mean of all shots.
fn light(rng: &mut ChaCha8Rng) -> Vec<(f64, f64)> {
    let count = rng.random_range(1..=3);
    let mut at_ps = rng.random_range(5000.0..9000.0);
    let pulse = |k: i32| {
        if k > 0 {
            at_ps += rng.random_range(2000.0..7000.0);
        }
        (at_ps, if k == 0 { 1.0 } else { rng.random_range(0.5..1.0) })
    };
    (0..count).map(pulse).collect()
}

/// Records of an instrument at a signal-to-noise ratio.
pub fn claims(instrument: &Instrument, snr: f64, records: usize, seed: u64) -> Claims {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let lab = Lab::bulk(0);
    let campaign = format!(
        "[campaign]\nname = 'readings'\n[sensors.s1]\n[[captures]]\nrole = 'scene'\nfiles = 'raw/L{{lit}}_P{{seen}}.npy'\n\
         dt_ps = {DT_PS:?}\nt0_ps = 0.0\ngain_v = {:?}\noffset_v = 0.0\n",
        1e-3 / instrument.codes
    );
    fs::write(lab.campaign().join("campaign.toml"), campaign).unwrap();
    // As `calibrate` finds the jitter of the trigger in its own shots.
    let noise_model = Some(vec![0.0, 0.0, 0.0, instrument.calibrated_jitter_ps.powi(2)]);
    let calibration = Calibration { noise_model, ..reading_scene::calibration(&instrument.calibrated, BEFORE) };
    write_table(&lab.path("calibration.parquet"), &[calibration]);
    let lights: Vec<_> = (0..records).map(|_| light(&mut rng)).collect();
    for (n, light) in lights.iter().enumerate() {
        record(&lab, n + 1, instrument, light, snr, &mut rng);
    }
    let pipeline = import(&lab, "response", "calibration", "calibration.parquet") + RECALIBRATION + STAGES;
    lab.run("out", &pipeline, &Settings::default()).unwrap();
    let onsets: Vec<Onset> = lab.rows("out", "onsets");
    let mut found = vec![Vec::new(); records];
    onsets.iter().for_each(|onset| found[onset.lit as usize - 1].push(onset));
    score(instrument, &lights, &found, snr)
}

fn record(lab: &Lab, patch: usize, instrument: &Instrument, light: &[(f64, f64)], snr: f64, rng: &mut ChaCha8Rng) {
    let height = snr * instrument.mean_sd();
    let normal = |rng: &mut ChaCha8Rng| -> f64 { StandardNormal.sample(rng) };
    let phases = |rng: &mut ChaCha8Rng| -> Vec<[f64; 2]> {
        instrument.lines.iter().map(|(sd, _)| [sd * normal(rng), sd * normal(rng)]).collect()
    };
    let offset = rng.random_range(-0.5..0.5) / instrument.codes;
    let locked = phases(rng);
    let mut codes = Vec::with_capacity(SHOTS * SAMPLES);
    for _ in 0..SHOTS {
        let amplitudes = if instrument.is_locked { locked.clone() } else { phases(rng) };
        let late_ps = instrument.jitter_ps * normal(rng);
        let strength = if rng.random_bool(instrument.bad) { BAD[rng.random_range(0..2)] } else { 1.0 };
        codes.extend((0..SAMPLES).map(|n| {
            let time_ps = n as f64 * DT_PS;
            let pulse = |(at, share): &(f64, f64)| share * instrument.own.at(time_ps - late_ps - at)[0];
            let line = |((_, ghz), [cos, sin]): (&(f64, f64), &[f64; 2])| {
                let turn = TAU * ghz * 1e-3 * time_ps;
                cos * turn.cos() + sin * turn.sin()
            };
            let value = strength * height * light.iter().map(pulse).sum::<f64>()
                + instrument.slope * n as f64 / SAMPLES as f64
                + instrument.lines.iter().zip(&amplitudes).map(line).sum::<f64>()
                + offset
                + normal(rng);
            (instrument.codes * value).round() as i16
        }));
    }
    let path = lab.campaign().join(format!("raw/L{patch}_P{patch}.npy"));
    npy::write(&mut File::create(path).unwrap(), &[SHOTS as u64, SAMPLES as u64], &codes).unwrap();
}

/// Cramer-Rao bounds of the times of pulses, ps, whose amplitudes and offset are open, in noise of this covariance.
fn bounds_ps(own: &Shape, inverse: &DMatrix<f64>, light: &[(f64, f64)]) -> Vec<f64> {
    let column = |value: &dyn Fn(f64) -> f64| DVector::from_fn(SAMPLES, |n, _| value(n as f64 * DT_PS));
    // In steps of 100 ps, so that the matrix is of one size.
    let times = light.iter().map(|(at, a)| column(&|t| -100.0 * a * own.at(t - at)[1]));
    let amplitudes = light.iter().map(|(at, _)| column(&|t| own.at(t - at)[0]));
    let columns: Vec<DVector<f64>> = times.chain(amplitudes).chain([column(&|_| 1.0)]).collect();
    let design = DMatrix::from_columns(&columns);
    let covariance = (design.transpose() * inverse * &design).try_inverse().expect("pulses stand apart");
    (0..light.len()).map(|k| 100.0 * covariance[(k, k)].sqrt()).collect()
}

fn score(instrument: &Instrument, lights: &[Vec<(f64, f64)>], found: &[Vec<&Onset>], snr: f64) -> Claims {
    let inverse = instrument.covariance().try_inverse().expect("noise is white at least") * (snr * snr);
    let white = DMatrix::identity(SAMPLES, SAMPLES) * (snr * snr);
    let (mut squares, mut inside, mut missed, mut surplus) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let mut lost = Vec::new();
    // What the mean of shots shows that come early and late.
    let blurred = instrument.own.widened(instrument.jitter_ps);
    for (light, onsets) in lights.iter().zip(found) {
        let bounds = bounds_ps(&blurred, &inverse, light);
        lost.extend(bounds.iter().zip(bounds_ps(&blurred, &white, light)).map(|(own, white)| own / white));
        let mut free: Vec<&&Onset> = onsets.iter().collect();
        for ((at, _), bound_ps) in light.iter().zip(&bounds) {
            let gap = |onset: &&&Onset| (onset.time_ps - at).abs();
            let nearest = free.iter().enumerate().min_by(|a, b| gap(a.1).total_cmp(&gap(b.1)));
            let near = |onset: &Onset| NEAR.1.max(NEAR.0 * onset.time_sd_ps.hypot(onset.jitter_ps));
            let Some((k, _)) = nearest.filter(|(_, onset)| gap(onset) < near(onset)) else {
                missed.push(true);
                continue;
            };
            missed.push(false);
            let onset = free.remove(k);
            let sd_ps = onset.time_sd_ps.hypot(onset.jitter_ps);
            inside.push((onset.time_ps - at).abs() < Z_95 * sd_ps);
            // That the mean of all triggers is late, nothing in a record tells.
            let late_ps = instrument.jitter_ps / (SHOTS as f64).sqrt();
            squares.push(((onset.time_ps - at) / bound_ps.hypot(late_ps)).powi(2));
        }
        surplus.push(!free.is_empty());
    }
    let is_flagged = |onset: &&Onset| onset.flags.iter().any(|flag| &**flag == "misfit");
    Claims {
        missed: Rate::of(missed),
        false_onsets: Rate::of(surplus),
        ratio: Estimate::rms(&squares),
        within: Rate::of(inside),
        flagged: Rate::of(found.iter().map(|onsets| onsets.iter().any(is_flagged))),
        lost: lost.iter().sum::<f64>() / lost.len() as f64,
    }
}

/// A few records of instruments with a slope, wander and hum: nothing is made up, nothing lost.
#[test]
fn baselines_that_move_make_no_onsets() {
    for name in ["white noise", "slope of 2", "wander of 4, 25 MHz", "wander of 4, 100 MHz", "hum of 100, 60 Hz"] {
        let instrument = Instrument::all().into_iter().find(|instrument| instrument.name == name).unwrap();
        let claims = claims(&instrument, 30.0, 40, 1);
        eprintln!("{name}: {claims:?}");
        assert!(claims.missed.hits == 0 && claims.false_onsets.hits == 0, "{name}: {claims:?}");
        assert!(claims.within.share() > 0.85 && claims.ratio.value < 1.3, "{name}: {claims:?}");
        assert!(claims.flagged.hits <= 2 && claims.lost < 1.2, "{name}: {claims:?}");
    }
}

/// The shape of the mean of finitely many shots that come early and late differs from record to record. At high
/// signal-to-noise ratios that would pass for pulses. Shots that come very late are good ones.
#[test]
fn jitter_makes_no_onsets() {
    for name in ["jitter of 30 ps", "jitter of 30 ps since calibration"] {
        let instrument = Instrument::all().into_iter().find(|instrument| instrument.name == name).unwrap();
        let claims = claims(&instrument, 200.0, 100, 5);
        eprintln!("{name}: {claims:?}");
        assert!(claims.missed.hits == 0 && claims.false_onsets.hits == 0, "{name}: {claims:?}");
        assert!(claims.within.share() > 0.88 && claims.ratio.value < 1.2, "{name}: {claims:?}");
    }
}

/// Ripple that is the same in every shot, far above weak pulses, is neither light nor an error of the response.
#[test]
fn ripple_locked_to_the_laser_makes_no_onsets() {
    for mhz in [25, 1000, 5000] {
        let name = format!("ripple of 0.5 locked to the laser, {mhz} MHz");
        let instrument = Instrument::all().into_iter().find(|instrument| instrument.name == name).unwrap();
        let claims = claims(&instrument, 10.0, 64, 4);
        eprintln!("{name}: {claims:?}");
        assert!(claims.missed.hits <= 1 && claims.false_onsets.hits <= 1, "{name}: {claims:?}");
        assert!(claims.within.share() > 0.88 && claims.ratio.value < 1.3, "{name}: {claims:?}");
    }
}

/// A converter of coarse steps is not taken for one without noise.
#[test]
fn coarse_converters_have_the_noise_of_rounding() {
    for codes in [0.1, 0.3] {
        let instrument = Instrument { codes, ..Instrument::kind("coarse") };
        let claims = claims(&instrument, 100.0, 40, 2);
        eprintln!("{codes}: {claims:?}");
        assert!(claims.missed.hits == 0 && claims.false_onsets.hits <= 1 && claims.within.share() > 0.85, "{claims:?}");
    }
}

/// A response measured another day is held against the scene's own pulses: nothing is split, and errors are as stated.
#[test]
fn a_response_that_the_scene_contradicts_is_corrected() {
    for name in [
        "response given 5 % too narrow",
        "response given 5 % too wide",
        "echo of -40 dB after 0.6 ns",
        "tail of 1 %, 1 ns",
    ] {
        let instrument = Instrument::all().into_iter().find(|instrument| instrument.name == name).unwrap();
        let claims = claims(&instrument, 200.0, 60, 3);
        eprintln!("{name}: {claims:?}");
        assert!(claims.missed.hits == 0 && claims.false_onsets.hits <= 1, "{name}: {claims:?}");
        assert!(claims.within.share() > 0.88 && claims.ratio.value < 1.25, "{name}: {claims:?}");
        assert!(claims.flagged.hits <= 2, "{name}: {claims:?}");
    }
}
