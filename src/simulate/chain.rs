//! From light to volts: the signal of a joule on the detector, and its noise.
//!
//! A pulse of energy E on a detector of responsivity R makes the charge `E R`. Through a load Z it becomes a voltage
//! pulse with the response's shape h (maximum 1, area a) and height `E R Z / a`. Each electron makes such a pulse, so
//! that the variance at a time is the sum of `q E R (Z h / a)^2` over arrivals (Campbell's theorem): shot noise.
//! Ambient light and dark current add a constant amount.

use super::keys::{Instrument, Range};
use super::pulse::Pulse;
use super::scene::Scene;

/// Charge of an electron in coulombs.
const ELECTRON_C: f64 = 1.602_176_634e-19;
/// Planck's constant times the speed of light, joule metres.
const PHOTON_J_M: f64 = 1.986_445_857e-25;
const S_PER_PS: f64 = 1e-12;

/// One setting of the oscilloscope.
#[derive(Clone, Debug, PartialEq)]
pub struct Setting {
    /// Its name; `None` where the instrument has only one.
    pub name: Option<String>,
    /// Full-scale range of the converter.
    pub full_scale_v: f64,
    /// Noise of one sample of one shot without signal; includes ambient light and dark current.
    pub noise_v: f64,
    /// Its contribution to the latency.
    pub latency_ps: f64,
    bits: u16,
}

impl Setting {
    /// Volts per code.
    pub fn gain_v(&self) -> f64 {
        self.full_scale_v / f64::from(1_u32 << self.bits)
    }

    /// Volts at code 0. The baseline is a fifth of the range above the lower rail.
    pub fn offset_v(&self) -> f64 {
        0.3 * self.full_scale_v
    }

    /// Volts per stored code, and volts at code 0: a converter of more than 8 bits fills the upper bits of a word.
    pub fn scale(&self, bits: u16) -> (f64, f64) {
        let step = if bits == 8 { 1.0 } else { f64::from(1_u32 << (16 - bits)) };
        (self.gain_v() / step, self.offset_v())
    }

    /// Highest voltage that it can record.
    pub fn top_v(&self) -> f64 {
        0.8 * self.full_scale_v - self.gain_v()
    }

    /// Noise of one sample, the converter's rounding included.
    pub fn recorded_noise_v(&self) -> f64 {
        self.noise_v.hypot(self.gain_v() / 12_f64.sqrt())
    }
}

/// The recording chain of a scene.
#[derive(Clone, Debug)]
pub struct Chain {
    /// Impulse response with echo and tail.
    pub pulse: Pulse,
    /// Height of the response to one joule; `None` where the signal-to-noise ratio is set, so that all signals have one
    /// height.
    volts_per_j: Option<f64>,
    /// Variance of shot noise in volts^2 per joule at the response's maximum; it scales with the square of the
    /// response.
    shot_v2_per_j: f64,
    /// Constant voltage of ambient light and dark current.
    pub background_v: f64,
    /// Settings, the most sensitive first.
    pub settings: Vec<Setting>,
    height_v: f64,
}

impl Chain {
    /// Height of every signal as a share of the range, if the signal-to-noise ratio is set.
    pub const HEIGHT: f64 = 0.6;

    /// The chain of a scene's analog sensors.
    pub fn new(scene: &Scene) -> Self {
        let instrument = &scene.instrument;
        let pulse = Pulse::of(&instrument.response).with(&instrument.flaws);
        let area_s = pulse.area_ps() * S_PER_PS;
        let height_v = Self::HEIGHT * instrument.full_scale_v;
        let responsivity = instrument.responsivity_a_w.filter(|_| instrument.snr.is_none());
        let volts_per_j = match instrument.snr {
            Some(_) => None,
            None => Some(responsivity.unwrap_or(0.0) * instrument.load_ohm / area_s),
        };
        let electron_v = ELECTRON_C * instrument.load_ohm / area_s;
        let ambient_a = scene.optics.map_or(0.0, |optics| optics.ambient_w) * responsivity.unwrap_or(0.0);
        let background_a = ambient_a + instrument.dark_a;
        let background_v2 = background_a / ELECTRON_C * electron_v * electron_v * pulse.energy_ps() * S_PER_PS;
        let setting = |name: Option<String>, range: Range| Setting {
            name,
            full_scale_v: range.full_scale_v,
            noise_v: (range.noise_v * range.noise_v + background_v2).sqrt(),
            latency_ps: range.latency_ps,
            bits: instrument.bits,
        };
        let noise_v = instrument.snr.map_or(instrument.noise_v.unwrap_or(0.0), |snr| height_v / snr);
        let only = Range { full_scale_v: instrument.full_scale_v, noise_v, latency_ps: 0.0 };
        let mut settings: Vec<Setting> =
            instrument.ranges.iter().map(|(name, range)| setting(Some(name.clone()), *range)).collect();
        settings.sort_by(|a, b| a.full_scale_v.total_cmp(&b.full_scale_v));
        if settings.is_empty() {
            settings.push(setting(None, only));
        }
        Self {
            pulse,
            volts_per_j,
            shot_v2_per_j: volts_per_j.unwrap_or(0.0) * electron_v,
            background_v: background_a * instrument.load_ohm,
            settings,
            height_v,
        }
    }

    /// Volts per unit of strength in a capture with this total strength.
    pub fn volts_per_strength(&self, total: f64) -> f64 {
        self.volts_per_j.unwrap_or_else(|| if total > 0.0 { self.height_v / total } else { 0.0 })
    }

    /// Variance of shot noise at the maximum of the response to a unit of strength.
    pub fn shot_v2_per_strength(&self) -> f64 {
        self.shot_v2_per_j
    }

    /// The setting of the reference channel: the pulse fills the same share of a range of its own.
    pub fn reference_setting(&self, instrument: &Instrument) -> Option<Setting> {
        let reference = instrument.reference?;
        let height_v = reference.height_v.unwrap_or(self.height_v);
        let noise_v = reference.snr.map_or(instrument.noise_v.unwrap_or(0.0), |snr| height_v / snr);
        let full_scale_v = height_v / Self::HEIGHT;
        Some(Setting { name: None, full_scale_v, noise_v, latency_ps: 0.0, bits: instrument.bits })
    }

    /// Electrons that a joule releases.
    pub fn electrons_per_j(instrument: &Instrument) -> f64 {
        instrument.responsivity_a_w.unwrap_or(0.0) / ELECTRON_C
    }

    /// The most sensitive setting whose range contains a signal of this height over the background, noise included;
    /// else the coarsest.
    pub fn setting_for(&self, height_v: f64) -> &Setting {
        let holds = |setting: &&Setting| height_v + self.background_v + 6.0 * setting.noise_v < setting.top_v();
        self.settings.iter().find(holds).unwrap_or(&self.settings[self.settings.len() - 1])
    }
}

/// Detections per joule in a perfect photon counter of the scene's efficiency.
pub fn detections_per_j(scene: &Scene) -> f64 {
    let photons = scene.laser.map_or(0.0, |laser| laser.wavelength_nm * 1e-9 / PHOTON_J_M);
    scene.instrument.counts.map_or(0.0, |counts| counts.efficiency * photons)
}

/// Detections per bin and cycle without the laser: dark counts and ambient light.
pub fn dark_per_bin(scene: &Scene) -> f64 {
    let dark_hz = scene.instrument.counts.map_or(0.0, |counts| counts.dark_hz);
    let ambient_w = scene.optics.map_or(0.0, |optics| optics.ambient_w);
    (dark_hz + ambient_w * detections_per_j(scene)) * scene.instrument.dt_ps * S_PER_PS
}
