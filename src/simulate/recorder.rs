//! The oscilloscope: turns light into codes, shot by shot.

use std::f64::consts::{LN_2, TAU};

use rand::RngExt;
use rand_distr::{Distribution, Poisson, StandardNormal};

use super::chain::{Chain, Setting};
use super::keys::{Flaws, Instrument, Interleave, Shape};
use super::pulse::Pulse;
use super::scene::Scene;
use super::transport::Light;

/// A shot: time of its trigger after the first, time of sample 0 as the instrument records it, and codes.
pub type Shot = (f64, f64, Vec<i16>);

/// Shots of one capture.
pub struct Shots {
    /// Signal channel.
    pub signal: Vec<Shot>,
    /// Reference channel.
    pub reference: Option<Vec<Shot>>,
}

/// What to record into one file, or pair of files.
pub struct Exposure<'a> {
    /// Light at the lens.
    pub light: &'a Light,
    /// Share of the light that remains after attenuators and the laser's drift.
    pub factor: f64,
    /// Delay from the arrival of light to the maximum of the recorded response.
    pub latency_ps: f64,
    /// Setting of the oscilloscope.
    pub setting: &'a Setting,
    /// Whether the laser fires at all.
    pub fires: bool,
    /// Shots.
    pub shots: usize,
}

/// Shot noise is neglected below this fraction of the other noise, in variance.
const SHOT_NOISE: f64 = 1e-3;
/// Time step in which electrons are drawn, in ps.
const ELECTRONS_PS: usize = 10;
/// Margin around the record for which the signal is computed, in standard deviations of the trigger jitter: triggers
/// move the record within it.
const JITTERS: f64 = 8.0;

/// The instrument, ready to record.
pub struct Recorder<'a> {
    instrument: &'a Instrument,
    chain: &'a Chain,
    bad_shots: f64,
    lost_shots: f64,
    period_ps: Option<f64>,
    rate_hz: f64,
    reference: Option<(Pulse, Setting)>,
    /// Weights that give white noise the front end's bandwidth; sum of squares 1.
    colour: Vec<f64>,
}

/// The signal of a capture without noise.
struct Clean {
    /// Volts over time.
    mean: Pulse,
    /// If shot noise matters: times and expected electrons, and height of the response to one electron.
    electrons: Option<(Vec<(f64, f64)>, f64)>,
}

impl<'a> Recorder<'a> {
    /// Of a scene's instrument.
    pub fn new(scene: &'a Scene, chain: &'a Chain) -> Self {
        let instrument = &scene.instrument;
        let reference = instrument
            .reference
            .zip(chain.reference_setting(instrument))
            .map(|(reference, setting)| (Pulse::of(&Shape::Gaussian { fwhm_ps: reference.fwhm_ps }), setting));
        Self {
            instrument,
            chain,
            bad_shots: scene.captures.bad_shots,
            lost_shots: scene.captures.lost_shots,
            period_ps: scene.repetition_ps(),
            rate_hz: scene.rate_hz(),
            reference,
            colour: colour(instrument),
        }
    }

    /// Shots of a capture.
    pub fn shots(&self, exposure: &Exposure, rng: &mut impl RngExt) -> Shots {
        let instrument = self.instrument;
        let clean = self.clean(exposure);
        let reference = self.reference_signal().filter(|_| exposure.fires);
        let cores = instrument.flaws.interleave.map(|interleave| cores(interleave, rng));
        let mut shots = Shots { signal: Vec::new(), reference: reference.as_ref().map(|_| Vec::new()) };
        for shot in 0..exposure.shots {
            let trigger_s = shot as f64 / self.rate_hz;
            // The instrument knows the phase of its sample clock at the trigger, so the file records it. It does not
            // know how late the trigger itself is.
            let t0_ps = instrument.t0_ps + instrument.dt_ps * rng.random_range(0.0..1.0);
            let jitter: f64 = StandardNormal.sample(rng);
            let start_ps = t0_ps - instrument.jitter_ps * jitter;
            let strength =
                if rng.random_bool(self.bad_shots) { if rng.random_bool(0.5) { 0.0 } else { 4.0 } } else { 1.0 };
            let signal = |volts: &mut [f64], rng: &mut _| self.signal(&clean, exposure, strength, start_ps, volts, rng);
            let codes = self.record(exposure.setting, cores.as_deref(), signal, rng);
            // A lost shot is missing in both channels, without a gap: the file has one segment less.
            let lost = rng.random_bool(self.lost_shots) && shot > 0;
            if !lost {
                shots.signal.push((trigger_s, t0_ps * 1e-12, codes));
            }
            if let (Some(records), Some((pulse, setting))) = (&mut shots.reference, &reference) {
                let signal = |volts: &mut [f64], _: &mut _| {
                    for (n, volts) in volts.iter_mut().enumerate() {
                        *volts = pulse.value(start_ps + n as f64 * instrument.dt_ps);
                    }
                };
                let codes = self.record(setting, None, signal, rng);
                if !lost {
                    records.push((trigger_s, t0_ps * 1e-12, codes));
                }
            }
        }
        shots
    }

    /// The reference pulse in volts, and its setting.
    pub fn reference_signal(&self) -> Option<(Pulse, Setting)> {
        let (pulse, setting) = self.reference.as_ref()?;
        let height_v = Chain::HEIGHT * setting.full_scale_v;
        let volts = Pulse::new(pulse.start_ps(), pulse.values().iter().map(|value| value * height_v).collect());
        Some((self.folded(&volts), setting.clone()))
    }

    /// Mean signal of a capture: the limit of averaging infinitely many shots of [`Recorder::shots`] that start at
    /// `t0_ps`.
    pub fn mean_v(&self, exposure: &Exposure, t0_ps: f64) -> Vec<f64> {
        let clean = self.clean(exposure);
        let sample = |n: usize| {
            let time_ps = t0_ps + n as f64 * self.instrument.dt_ps;
            self.distorted(clean.mean.value(time_ps) + self.pickup(exposure, time_ps), exposure.setting)
                + self.chain.background_v
        };
        (0..self.instrument.samples).map(sample).collect()
    }

    fn clean(&self, exposure: &Exposure) -> Clean {
        let volts = exposure.factor * self.chain.volts_per_strength(exposure.light.total());
        let Flaws { slew_ps, .. } = self.instrument.flaws;
        let pulse = &self.chain.pulse;
        if exposure.light.0.is_empty() || !exposure.fires || volts == 0.0 {
            return Clean { mean: Pulse::new(0.0, vec![0.0; 4]), electrons: None };
        }
        let signal = arrived(exposure.light, exposure.latency_ps, volts, pulse);
        // A slew-limited stage delays large pulses more.
        let slewed_ps = slew_ps * signal.height() / exposure.setting.full_scale_v;
        let signal = Pulse::new(signal.start_ps() + slewed_ps, signal.values().to_vec());
        let shot_v2 = exposure.factor * self.chain.shot_v2_per_strength();
        let most_v2 = shot_v2 * signal.height() / volts;
        let electrons = (most_v2 > SHOT_NOISE * exposure.setting.noise_v.powi(2)).then(|| {
            let per_j = Chain::electrons_per_j(self.instrument) * exposure.factor;
            let (start_ps, bins) = binned(exposure.light, exposure.latency_ps + slewed_ps);
            let chunk = |(k, bins): (usize, &[f64])| {
                let sum: f64 = bins.iter().sum();
                let time: f64 = bins.iter().enumerate().map(|(i, bin)| i as f64 * bin).sum();
                (sum > 0.0).then(|| (start_ps + (k * ELECTRONS_PS) as f64 + time / sum, sum * per_j))
            };
            let times = bins.chunks(ELECTRONS_PS).enumerate().filter_map(chunk).collect();
            (times, self.chain.volts_per_strength(1.0) / Chain::electrons_per_j(self.instrument))
        });
        Clean { mean: self.folded(&signal), electrons }
    }

    /// A signal as it repeats with the laser, over the time of the record.
    pub fn folded(&self, signal: &Pulse) -> Pulse {
        let Some(period_ps) = self.period_ps else {
            return signal.clone();
        };
        let Instrument { t0_ps, dt_ps, samples, jitter_ps, .. } = *self.instrument;
        let margin_ps = (JITTERS * jitter_ps + dt_ps + 4.0).ceil();
        let start_ps = (t0_ps - margin_ps).floor();
        let count = (samples as f64 * dt_ps + 2.0 * margin_ps + 8.0) as usize;
        let mut values = vec![0.0; count];
        let (first, last) = (
            ((signal.start_ps() - start_ps - count as f64) / period_ps).floor() as i64,
            ((signal.end_ps() - start_ps) / period_ps).ceil() as i64,
        );
        for turn in first..=last {
            let later_ps = turn as f64 * period_ps;
            for (i, value) in values.iter_mut().enumerate() {
                *value += signal.value(start_ps + i as f64 + later_ps);
            }
        }
        Pulse::new(start_ps, values)
    }

    fn pickup(&self, exposure: &Exposure, time_ps: f64) -> f64 {
        self.instrument.flaws.pickup.filter(|_| exposure.fires).map_or(0.0, |pickup| {
            let turn = TAU * pickup.frequency_ghz * 1e-3 * time_ps;
            pickup.volts * turn.cos() * (-time_ps.abs() / pickup.decay_ps).exp()
        })
    }

    /// Signal of one shot with its shot noise, before the oscilloscope.
    fn signal(
        &self,
        clean: &Clean,
        exposure: &Exposure,
        strength: f64,
        start_ps: f64,
        volts: &mut [f64],
        rng: &mut impl RngExt,
    ) {
        let dt_ps = self.instrument.dt_ps;
        for (n, volts) in volts.iter_mut().enumerate() {
            let time_ps = start_ps + n as f64 * dt_ps;
            *volts = strength * clean.mean.value(time_ps) + self.pickup(exposure, time_ps);
        }
        if let Some((electrons, electron_v)) = clean.electrons.as_ref().filter(|_| strength > 0.0) {
            let pulse = &self.chain.pulse;
            for (time_ps, expected) in electrons {
                let expected = expected * strength;
                let electrons: f64 = Poisson::new(expected).expect("a positive number").sample(rng);
                let surplus_v = (electrons - expected) * electron_v;
                let first = ((time_ps + pulse.start_ps() - start_ps) / dt_ps).ceil().max(0.0) as usize;
                let last = ((time_ps + pulse.end_ps() - start_ps) / dt_ps).floor();
                if last >= 0.0 {
                    for n in first..(last as usize + 1).min(volts.len()) {
                        volts[n] += surplus_v * pulse.value(start_ps + n as f64 * dt_ps - time_ps);
                    }
                }
            }
        }
        volts.iter_mut().for_each(|volts| *volts = self.distorted(*volts, exposure.setting) + self.chain.background_v);
    }

    /// Distorts a voltage that exceeds the range of detector and amplifier.
    fn distorted(&self, volts: f64, setting: &Setting) -> f64 {
        let Flaws { saturation_v, cubic, .. } = self.instrument.flaws;
        let volts = saturation_v.map_or(volts, |limit_v| volts / (1.0 + volts.abs() / limit_v));
        volts + cubic * volts * (volts / setting.full_scale_v).powi(2)
    }

    /// Adds noise, and applies amplifier and converter.
    fn record<R: RngExt>(
        &self,
        setting: &Setting,
        cores: Option<&[(f64, f64)]>,
        signal: impl FnOnce(&mut [f64], &mut R),
        rng: &mut R,
    ) -> Vec<i16> {
        let instrument = self.instrument;
        let mut volts = vec![0.0; instrument.samples];
        signal(&mut volts, rng);
        let white: Vec<f64> = (0..volts.len() + self.colour.len() - 1).map(|_| StandardNormal.sample(rng)).collect();
        for (n, volts) in volts.iter_mut().enumerate() {
            let noise: f64 = self.colour.iter().zip(&white[n..]).map(|(weight, noise)| weight * noise).sum();
            *volts += setting.noise_v * noise;
        }
        if let Some(cores) = cores {
            let start = rng.random_range(0..cores.len());
            for (n, volts) in volts.iter_mut().enumerate() {
                let (offset_v, gain) = cores[(start + n) % cores.len()];
                *volts = *volts * gain + offset_v;
            }
        }
        let (gain_v, offset_v) = (setting.gain_v(), setting.offset_v());
        let half = f64::from(1_u32 << (instrument.bits - 1));
        // A converter of 9 to 16 bits fills the upper bits of a word.
        let step = if instrument.bits == 8 { 1.0 } else { f64::from(1_u32 << (16 - instrument.bits)) };
        let recovery = instrument.flaws.recovery;
        let keep = recovery.map_or(0.0, |recovery| (-instrument.dt_ps / recovery.tau_ps).exp());
        let mut afterwards_v = 0.0;
        let code = |volts: f64| {
            let volts = volts + afterwards_v;
            let code = (volts - offset_v) / gain_v;
            let beyond_v = (code - code.clamp(-half, half - 1.0)) * gain_v;
            afterwards_v = afterwards_v * keep + recovery.map_or(0.0, |recovery| recovery.ratio * beyond_v);
            (code.round().clamp(-half, half - 1.0) * step) as i16
        };
        volts.into_iter().map(code).collect()
    }
}

/// Offsets and gains of interleaved converters.
fn cores(interleave: Interleave, rng: &mut impl RngExt) -> Vec<(f64, f64)> {
    let mut normal = || -> f64 { StandardNormal.sample(rng) };
    (0..interleave.cores).map(|_| (interleave.offset_v * normal(), 1.0 + interleave.gain * normal())).collect()
}

/// Symmetric weights that turn white noise into noise after a Gaussian low-pass, which is down to 1/sqrt(2) at the
/// bandwidth. Its autocorrelation is Gaussian; the transform of the weights is the root of the transform of the sampled
/// autocorrelation.
pub fn colour(instrument: &Instrument) -> Vec<f64> {
    let Some(bandwidth_ghz) = instrument.noise_bandwidth_ghz else {
        return vec![1.0];
    };
    let sigma_ps = (2.0 * LN_2).sqrt() / (TAU * 1e-3 * bandwidth_ghz);
    let reach = (6.0 * sigma_ps / instrument.dt_ps).ceil().max(4.0) as i32;
    let size = 4 * reach;
    let acf = |lag: i32| (-0.5 * (f64::from(lag) * instrument.dt_ps / sigma_ps).powi(2)).exp();
    let turn = |a: i32, b: i32| (TAU * f64::from(a) * f64::from(b) / f64::from(size)).cos();
    let root = |k: i32| (-2 * reach + 1..2 * reach).map(|lag| acf(lag) * turn(k, lag)).sum::<f64>().max(0.0).sqrt();
    let spectrum: Vec<f64> = (0..size).map(root).collect();
    let weight = |n: i32| (0..size).map(|k| spectrum[k as usize] * turn(k, n)).sum::<f64>() / f64::from(size);
    let weights: Vec<f64> = (-reach..=reach).map(weight).collect();
    let norm = weights.iter().map(|weight| weight * weight).sum::<f64>().sqrt();
    weights.into_iter().map(|weight| weight / norm).collect()
}

/// Light on a grid of 1 ps: time of the first bin, and strengths. Its two neighbours share each arrival so that the
/// mean time is exact.
pub fn binned(light: &Light, later_ps: f64) -> (f64, Vec<f64>) {
    let times = || light.0.iter().map(|(time_ps, _)| time_ps + later_ps);
    let (first, last) = (times().fold(f64::INFINITY, f64::min), times().fold(f64::NEG_INFINITY, f64::max));
    let origin_ps = first.floor();
    let mut bins = vec![0.0; (last - origin_ps) as usize + 2];
    for (time_ps, strength) in &light.0 {
        let place = time_ps + later_ps - origin_ps;
        let share = place.fract();
        bins[place as usize] += (1.0 - share) * strength;
        bins[place as usize + 1] += share * strength;
    }
    (origin_ps, bins)
}

/// Response to light, on a grid of 1 ps that covers all of it.
pub fn arrived(light: &Light, latency_ps: f64, volts_per_strength: f64, pulse: &Pulse) -> Pulse {
    let (origin_ps, bins) = binned(light, latency_ps);
    let mut values = vec![0.0; bins.len() + pulse.values().len()];
    for (at, strength) in bins.iter().enumerate().filter(|(_, strength)| **strength != 0.0) {
        let volts = strength * volts_per_strength;
        values[at..].iter_mut().zip(pulse.values()).for_each(|(value, pulse)| *value += volts * pulse);
    }
    Pulse::new(origin_ps + pulse.start_ps(), values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use std::path::Path;

    #[test]
    fn noise_has_the_autocorrelation_of_its_bandwidth() {
        let text = include_str!("../../pipelines/scenes/tiny.toml");
        for bandwidth_ghz in [1.0, 4.0, 8.0] {
            let text = text.replace("snr = 20.0", &format!("noise_bandwidth_ghz = {bandwidth_ghz:?}\nsnr = 20.0"));
            let scene = Scene::parse(Path::new("tiny.toml"), &text).unwrap();
            let weights = colour(&scene.instrument);
            let sigma_ps = LN_2.sqrt() * 2_f64.sqrt() / (TAU * 1e-3 * bandwidth_ghz);
            for lag in 0..8 {
                let acf: f64 = weights.iter().zip(&weights[lag..]).map(|(a, b)| a * b).sum();
                let expected = (-0.5 * (lag as f64 * 50.0 / sigma_ps).powi(2)).exp();
                assert!((acf - expected).abs() < 2e-3, "{bandwidth_ghz} GHz, lag {lag}: {acf} {expected}");
            }
        }
    }

    fn shots(scene: &Scene, light: &Light, count: usize) -> Vec<Vec<f64>> {
        let chain = Chain::new(scene);
        let recorder = Recorder::new(scene, &chain);
        let setting = &chain.settings[0];
        let exposure = Exposure { light, factor: 1.0, latency_ps: 0.0, setting, fires: true, shots: count };
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let volts = |codes: Vec<i16>| {
            codes.iter().map(|code| f64::from(*code) * setting.gain_v() + setting.offset_v()).collect()
        };
        recorder.shots(&exposure, &mut rng).signal.into_iter().map(|(_, _, codes)| volts(codes)).collect()
    }

    fn flawed(flaw: &str) -> Scene {
        let text = include_str!("../../pipelines/scenes/tiny.toml")
            .replace("bad_shots = 0.02", "")
            .replace("snr = 20.0", "snr = 60.0")
            .replace("[captures]", &format!("[instrument.flaws]\n{flaw}\n[captures]"));
        Scene::parse(Path::new("tiny.toml"), &text).unwrap()
    }

    /// Four mismatched converters repeat every fourth sample within a shot. Over shots they average out, since a shot
    /// starts at any of them.
    #[test]
    fn interleaved_converters_repeat_within_a_shot() {
        let scene = flawed("interleave = { cores = 4, offset_v = 0.05 }");
        let shots = shots(&scene, &Light::default(), 400);
        let product = |lag: usize| {
            let pairs = shots.iter().flat_map(|shot| (0..200).map(|n| shot[n] * shot[n + lag]));
            let mean = shots.iter().flatten().sum::<f64>() / (shots.len() * shots[0].len()) as f64;
            pairs.sum::<f64>() / (200.0 * shots.len() as f64) - mean * mean
        };
        assert!(product(4) > 3.0 * 0.01_f64.powi(2) && (product(4) / product(8) - 1.0).abs() < 0.05);
        let column = |n: usize| shots.iter().map(|shot| shot[n]).sum::<f64>() / shots.len() as f64;
        assert!((column(10) - column(11)).abs() < 4.0 * (product(4) / 400.0).sqrt() * 2_f64.sqrt());
    }

    /// After a pulse beyond the rail the amplifier recovers slowly.
    #[test]
    fn an_overdriven_amplifier_recovers_slowly() {
        let after = |flaw: &str| {
            let mut scene = flawed(flaw);
            scene.instrument.full_scale_v = 0.2;
            let mut chain = Chain::new(&scene);
            // Amplified beyond the range of the converter.
            chain.settings[0].full_scale_v = 0.05;
            let recorder = Recorder::new(&scene, &chain);
            let (light, setting) = (Light::at(3000.0, 1.0), &chain.settings[0]);
            let exposure = Exposure { light: &light, factor: 1.0, latency_ps: 0.0, setting, fires: true, shots: 200 };
            let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(6);
            let shots = recorder.shots(&exposure, &mut rng).signal;
            let late = |(_, _, codes): &Shot| codes[130..150].iter().map(|code| f64::from(*code)).sum::<f64>() / 20.0;
            shots.iter().map(late).sum::<f64>() / shots.len() as f64
        };
        let (clean, slow) = (after("cubic = 0.0"), after("recovery = { ratio = 0.05, tau_ps = 3000.0 }"));
        assert!(slow > clean + 5.0, "{clean} {slow}");
    }
}
