//! A scene with its light and its list of captures: everything that is determined before noise is drawn.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::chain::{Chain, Setting, dark_per_bin, detections_per_j};
use super::pulse::Pulse;
use super::recorder::{Recorder, arrived};
use super::scene::Scene;
use super::session::{Session, Shooting};
use super::transport::{CaptureLights, Light, Paths, Room};
use super::truth::true_onsets;
use super::{SimulateError, Truth};
use crate::units::PatchId;

/// A scene, its light, and its captures.
pub struct Laboratory<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// From light to volts.
    pub chain: Chain,
    /// The scene's light, by lit patch or view.
    pub lights: BTreeMap<PatchId, CaptureLights>,
    /// Captures, in order. The seed determines their drifts.
    pub shootings: Vec<Shooting>,
}

impl<'a> Laboratory<'a> {
    /// Computes the light of a scene and lists its captures.
    ///
    /// # Errors
    /// When the first light of a capture arrives outside the record.
    pub fn new(scene: &'a Scene, seed: u64) -> Result<Self, SimulateError> {
        let (room, chain) = (Room::new(scene), Chain::new(scene));
        let paths = Paths::new(scene, &room, scene.captures.bounces);
        let lights: BTreeMap<PatchId, CaptureLights> =
            scene.lit().into_par_iter().map(|lit| (lit, paths.lit(&scene.covers(lit)))).collect();
        let shootings = Session::plan(scene, &chain, &room, &lights, seed);
        shootings.iter().try_for_each(|shooting| scene.check_record(shooting))?;
        Ok(Self { scene, chain, lights, shootings })
    }

    /// The same light on another day: drifts and errors of prior knowledge are drawn anew.
    #[must_use]
    pub fn reseeded(&self, seed: u64) -> Self {
        let (chain, lights) = (self.chain.clone(), self.lights.clone());
        let shootings = Session::plan(self.scene, &chain, &Room::new(self.scene), &lights, seed);
        Self { scene: self.scene, chain, lights, shootings }
    }

    /// Time from the first shot to the last.
    #[must_use]
    pub fn hours(&self) -> f64 {
        let end_s = |shooting: &Shooting| shooting.start_s + shooting.duration_s(self.scene);
        self.shootings.iter().map(end_s).fold(0.0, f64::max) / 3600.0
    }

    /// The limit of averaging a capture infinitely long, in volts, with samples from `t0_ps` after the reference pulse;
    /// includes the instrument's flaws.
    #[must_use]
    pub fn mean_v(&self, shooting: &Shooting, t0_ps: f64) -> Vec<f64> {
        Recorder::new(self.scene, &self.chain).mean_v(&shooting.exposure(), t0_ps)
    }

    /// Signal of a part of a capture's light: volts over time, repeated with the laser; for a photon counter,
    /// detections per bin in all cycles.
    #[must_use]
    pub fn signal(&self, shooting: &Shooting, light: &Light) -> Pulse {
        self.response_of(shooting, light, &self.chain.pulse)
    }

    /// The same for several paths together, with a response that is stretched by `factor`.
    #[must_use]
    pub fn stretched(&self, shooting: &Shooting, lights: &[&Light], factor: f64) -> Pulse {
        let light = Light(lights.iter().flat_map(|light| light.0.iter().copied()).collect());
        self.response_of(shooting, &light, &self.chain.pulse.stretched(factor))
    }

    fn response_of(&self, shooting: &Shooting, light: &Light, pulse: &Pulse) -> Pulse {
        let per_strength = if shooting.counts {
            // A bin integrates the pulse over its width.
            detections_per_j(self.scene) * shooting.shots as f64 * self.scene.instrument.dt_ps
                / self.chain.pulse.area_ps()
        } else {
            self.chain.volts_per_strength(shooting.light.total())
        };
        if light.0.is_empty() {
            return Pulse::new(0.0, vec![0.0; 4]);
        }
        let signal = arrived(light, shooting.latency_ps, per_strength * shooting.factor, pulse);
        Recorder::new(self.scene, &self.chain).folded(&signal)
    }

    /// Dark detections per bin of a photon counter, in all cycles.
    #[must_use]
    pub fn dark_counts(&self, shooting: &Shooting) -> f64 {
        dark_per_bin(self.scene) * shooting.shots as f64
    }

    /// Shots of a capture that are neither bad nor lost.
    #[must_use]
    pub fn good_shots(&self, shooting: &Shooting) -> f64 {
        let captures = &self.scene.captures;
        shooting.shots as f64 * (1.0 - captures.bad_shots) * (1.0 - captures.lost_shots)
    }

    /// Autocorrelation of the oscilloscope's noise, by lag in samples.
    #[must_use]
    pub fn noise_acf(&self) -> Vec<f64> {
        let weights = super::recorder::colour(&self.scene.instrument);
        let lag = |lag: usize| weights.iter().zip(&weights[lag..]).map(|(a, b)| a * b).sum();
        (0..weights.len()).map(lag).collect()
    }

    /// The reference pulse in volts around time 0, and its setting.
    #[must_use]
    pub fn reference_signal(&self) -> Option<(Pulse, Setting)> {
        Recorder::new(self.scene, &self.chain).reference_signal()
    }

    /// Variance of a shot's shot noise over time, from the capture's own light; `None` where it is neglected.
    #[must_use]
    pub fn shot_noise_v2(&self, shooting: &Shooting) -> Option<Pulse> {
        let per_strength = self.chain.shot_v2_per_strength() * shooting.factor;
        if per_strength == 0.0 || shooting.light.0.is_empty() {
            return None;
        }
        let variance = arrived(&shooting.light, shooting.latency_ps, per_strength, &self.chain.pulse.squared());
        Some(Recorder::new(self.scene, &self.chain).folded(&variance))
    }

    pub(super) fn truth(&self) -> Truth {
        let scene = self.scene;
        let mut truth = Truth {
            patches: scene.true_patches(),
            onsets: Vec::new(),
            calibration: scene.true_calibration(&self.chain),
            paths: Vec::new(),
            centroids: scene.true_centroids(&self.lights),
            captures: Vec::new(),
        };
        for shooting in &self.shootings {
            let paths = scene.true_paths(&self.chain, shooting);
            truth.onsets.extend(true_onsets(&paths, shooting, scene.instrument.snr.is_some()));
            truth.paths.extend(paths);
            truth.captures.push(scene.true_capture(&self.chain, shooting, &shooting.stem));
        }
        truth
    }
}
