//! The lab's day: which captures are recorded, in which order, at which setting, into which files.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::chain::{Chain, Setting, detections_per_j};
use super::keys::{Fiducial, Ranges};
use super::recorder::{Exposure, arrived};
use super::scene::Scene;
use super::transport::{CaptureLights, Light, PathLights, Paths, Room};
use crate::campaign::Role;
use crate::campaign::keys::SensorKind;
use crate::units::{self, PatchId};

/// Reflectance of the diffuser in response and fiducial captures.
const DIFFUSER: f64 = 0.8;
/// Steps of the attenuator that brings a response into the range, in optical density.
const OD_STEP: f64 = 0.1;
/// Time between the steps of a delay's random walk.
const STEP_S: f64 = 60.0;
/// Random stream of that walk; captures have their own.
const WALK_STREAM: u64 = u64::MAX - 1;

/// One capture.
#[derive(Clone, Debug)]
pub struct Shooting {
    /// Number of its random stream.
    pub stream: u64,
    /// What is captured.
    pub role: Role,
    /// Sensor.
    pub sensor: String,
    /// Whether the sensor counts photons.
    pub counts: bool,
    /// Patch or view lit (0: none).
    pub lit: PatchId,
    /// Patch or view seen (0: none).
    pub seen: PatchId,
    /// Prefix of its file names, relative to the campaign.
    pub stem: String,
    /// Light of the scene by path; empty for other roles.
    pub paths: PathLights,
    /// All light.
    pub light: Light,
    /// Known path, for responses and fiducials.
    pub path_m: Option<f64>,
    /// Bounces of the known path.
    pub bounces: Option<usize>,
    /// Optical density in the beam.
    pub attenuation_od: f64,
    /// Share of the light that remains after attenuator and drift.
    pub factor: f64,
    /// Delay from the arrival of light to the recorded maximum.
    pub latency_ps: f64,
    /// Setting of the oscilloscope.
    pub setting: Setting,
    /// Whether the laser fires.
    pub fires: bool,
    /// Shots.
    pub shots: usize,
    /// Start after that of the campaign.
    pub start_s: f64,
}

/// Makes the list of captures.
pub struct Session<'a> {
    scene: &'a Scene,
    chain: &'a Chain,
    room: &'a Room,
    seed: u64,
    now_s: f64,
    /// The delay's random walk, in ps at every step, and where its steps come from.
    walk: Vec<f64>,
    walk_rng: ChaCha8Rng,
    shootings: Vec<Shooting>,
}

impl<'a> Session<'a> {
    /// All captures of a scene. `lights` is the scene's light: for each lit patch or view, what the sensors receive.
    pub fn plan(
        scene: &'a Scene,
        chain: &'a Chain,
        room: &'a Room,
        lights: &BTreeMap<PatchId, CaptureLights>,
        seed: u64,
    ) -> Vec<Shooting> {
        let mut walk_rng = ChaCha8Rng::seed_from_u64(seed);
        walk_rng.set_stream(WALK_STREAM);
        let mut session =
            Self { scene, chain, room, seed, now_s: 0.0, walk: Vec::new(), walk_rng, shootings: Vec::new() };
        for (number, name) in scene.sensors.keys().enumerate() {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(number as u64);
            session.sensor(name, lights, &mut rng);
        }
        session.shootings
    }

    fn sensor(&mut self, name: &str, lights: &BTreeMap<PatchId, CaptureLights>, rng: &mut ChaCha8Rng) {
        let captures = &self.scene.captures;
        let normal: f64 = StandardNormal.sample(rng);
        let true_path_m = captures.path_m + captures.path_sd_m * normal;
        let response = self.over_diffuser(true_path_m);
        for setting in self.settings(name) {
            let od = self.density_for(&response, &setting, captures.response_od);
            let at = self.now_s;
            let mut shooting = self.shooting(Role::Response, name, &setting, response.clone(), rng);
            shooting.shots = captures.response_shots;
            shooting.path_m = Some(captures.path_m);
            shooting.bounces = Some(1);
            self.put(Shooting { attenuation_od: od, start_s: at, ..shooting });
        }
        let base = self.settings(name);
        for (role, shots) in [(Role::Dark, captures.dark_shots), (Role::Blocked, captures.blocked_shots)] {
            for setting in base.iter().filter(|_| shots > 0) {
                let shooting = self.shooting(role, name, setting, Light::default(), rng);
                self.put(Shooting { shots, fires: role == Role::Blocked, start_s: self.now_s, ..shooting });
            }
        }
        for (number, fiducial) in captures.fiducials.iter().enumerate() {
            self.fiducial(name, number, fiducial, rng);
        }
        for lit in self.scene.lit() {
            for seen in self.scene.seen_by(name) {
                let paths = lights[&lit].get(&(name.to_owned(), seen)).cloned().unwrap_or_default();
                self.capture(name, lit, seen, paths, rng);
            }
        }
    }

    fn capture(&mut self, name: &str, lit: PatchId, seen: PatchId, paths: PathLights, rng: &mut ChaCha8Rng) {
        let light = Light(paths.values().flat_map(|light| light.0.iter().copied()).collect());
        let covered = self.scene.covers(seen);
        let is_first = self.scene.covers(lit).iter().any(|patch| covered.contains(patch));
        let od = if is_first { self.scene.captures.first_bounce_od } else { 0.0 };
        let height_v = self.height_v(&light) * attenuation(od);
        let settings = match self.scene.captures.ranges {
            Ranges::All => self.settings(name),
            Ranges::Auto => vec![self.chain.setting_for(height_v).clone()],
        };
        for setting in settings {
            let shooting = self.shooting(Role::Scene, name, &setting, light.clone(), rng);
            let range = setting.name.as_ref().map_or(String::new(), |range| format!("{range}/"));
            let filter = if od > 0.0 { format!("od{od}/") } else { String::new() };
            let kind = if shooting.counts { "counts" } else { "scene" };
            self.put(Shooting {
                lit,
                seen,
                stem: format!("raw/{kind}/{range}{filter}{name}_L{lit}_P{seen}"),
                paths: paths.clone(),
                attenuation_od: od,
                shots: self.scene.captures.shots,
                start_s: self.now_s,
                ..shooting
            });
        }
    }

    fn fiducial(&mut self, name: &str, number: usize, fiducial: &Fiducial, rng: &mut ChaCha8Rng) {
        let light = if let Some(path_m) = fiducial.path_m {
            self.over_diffuser(path_m)
        } else {
            let eye = self.scene.sensor_m(name).into();
            Paths::new(self.scene, self.room, fiducial.through.len()).along(&fiducial.through, eye)
        };
        // A blocked path has no light, and no length that a lab could know.
        let centroid_m = || (!light.0.is_empty()).then(|| units::path_m(light.centroid_ps(), self.scene.group_index));
        let path_m = fiducial.path_m.or_else(centroid_m);
        let strength = light.moved(0.0, attenuation(fiducial.attenuation_od));
        let setting = self.chain.setting_for(self.height_v(&strength)).clone();
        let after_s = self.now_s;
        for run in 0..fiducial.runs {
            let shooting = self.shooting(Role::Fiducial, name, &setting, light.clone(), rng);
            let stem = format!("raw/fiducial/{}/{name}_{run:04}", number + 1);
            self.put(Shooting {
                stem,
                path_m,
                bounces: Some(fiducial.through.len().max(1)),
                attenuation_od: fiducial.attenuation_od,
                shots: fiducial.shots,
                start_s: if fiducial.every_s > 0.0 { run as f64 * fiducial.every_s } else { self.now_s },
                ..shooting
            });
        }
        // Repeated runs are interleaved with other captures; single ones follow in order.
        if fiducial.every_s > 0.0 {
            self.now_s = after_s;
        }
    }

    /// A capture, with everything that follows from sensor and setting.
    fn shooting(&self, role: Role, name: &str, setting: &Setting, light: Light, rng: &mut ChaCha8Rng) -> Shooting {
        let sensor = &self.scene.sensors[name];
        let folder = setting.name.as_ref().map_or(String::new(), |range| format!("{range}/"));
        Shooting {
            stream: rng.random(),
            role,
            sensor: name.to_owned(),
            counts: sensor.kind == SensorKind::Counts,
            lit: 0,
            seen: 0,
            stem: format!("raw/{}/{folder}{name}", role.name()),
            paths: PathLights::new(),
            light,
            path_m: None,
            bounces: None,
            attenuation_od: 0.0,
            factor: 1.0,
            latency_ps: sensor.latency_ps + setting.latency_ps,
            setting: setting.clone(),
            fires: true,
            shots: 0,
            start_s: 0.0,
        }
    }

    /// Adds a capture, with the drift at its time.
    fn put(&mut self, mut shooting: Shooting) {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(!shooting.stream);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let hours = shooting.start_s / 3600.0;
        let flaws = &self.scene.instrument.flaws;
        shooting.latency_ps += flaws.delay_ps_per_h * hours + flaws.delay_sd_ps * normal();
        shooting.latency_ps += self.walk_ps(shooting.start_s);
        let drift =
            self.scene.laser.map_or(1.0, |laser| (1.0 + laser.power_per_h * hours) * (1.0 + laser.power_sd * normal()));
        shooting.factor = attenuation(shooting.attenuation_od) * drift.max(0.0);
        self.now_s = shooting.start_s + shooting.shots as f64 / self.scene.rate_hz() + self.scene.captures.overhead_s;
        self.shootings.push(shooting);
    }

    /// How far the delay has walked at a time.
    fn walk_ps(&mut self, time_s: f64) -> f64 {
        let sd_ps = self.scene.instrument.flaws.delay_walk_ps * (STEP_S / 3600.0).sqrt();
        if sd_ps == 0.0 {
            return 0.0;
        }
        let position = time_s / STEP_S;
        while self.walk.len() < position as usize + 2 {
            let normal: f64 = StandardNormal.sample(&mut self.walk_rng);
            self.walk.push(self.walk.last().map_or(0.0, |last_ps| last_ps + sd_ps * normal));
        }
        let (before_ps, after_ps) = (self.walk[position as usize], self.walk[position as usize + 1]);
        before_ps + position.fract() * (after_ps - before_ps)
    }

    fn settings(&self, name: &str) -> Vec<Setting> {
        let counts = self.scene.sensors[name].kind == SensorKind::Counts;
        if counts { self.chain.settings[..1].to_vec() } else { self.chain.settings.clone() }
    }

    /// First bounce off a white diffuser at half the path, lit and seen at normal incidence.
    fn over_diffuser(&self, path_m: f64) -> Light {
        let strength = match (self.scene.laser, self.scene.optics) {
            (Some(laser), Some(_)) => laser.pulse_j * DIFFUSER / PI * self.room.lens_m2 / (0.5 * path_m).powi(2),
            _ => 1.0,
        };
        Light::at(units::time_ps(path_m, self.scene.group_index), strength)
    }

    fn height_v(&self, light: &Light) -> f64 {
        if light.0.is_empty() {
            return 0.0;
        }
        arrived(light, 0.0, self.chain.volts_per_strength(light.total()), &self.chain.pulse).height()
    }

    /// Optical density, in steps, that brings light into a range; at least `least`.
    fn density_for(&self, light: &Light, setting: &Setting, least: f64) -> f64 {
        let over = self.height_v(light) / (Chain::HEIGHT * setting.full_scale_v);
        if self.scene.laser.is_none() || over <= 0.0 {
            return least;
        }
        // The margin avoids an additional step due to rounding in the last digit.
        let od = ((over.log10() - least).max(0.0) / OD_STEP - 1e-9).ceil() * OD_STEP + least;
        (od * 1e6).round() / 1e6
    }
}

/// Share of the light that an optical density transmits.
fn attenuation(od: f64) -> f64 {
    10_f64.powf(-od)
}

impl Shooting {
    /// The capture as the recorder needs it.
    pub fn exposure(&self) -> Exposure<'_> {
        Exposure {
            light: &self.light,
            factor: self.factor,
            latency_ps: self.latency_ps,
            setting: &self.setting,
            fires: self.fires,
            shots: self.shots,
        }
    }

    /// Duration of its shots.
    pub fn duration_s(&self, scene: &Scene) -> f64 {
        self.shots as f64 / scene.rate_hz()
    }

    /// Height over noise of one shot, for light of this strength; for photon counters, the root of the expected
    /// detections per cycle.
    pub fn shot_snr(&self, scene: &Scene, chain: &Chain, strength: f64) -> f64 {
        if self.counts {
            return (strength * self.factor * detections_per_j(scene)).sqrt();
        }
        let volts = chain.volts_per_strength(self.light.total()) * strength * self.factor;
        let shot_v2 = chain.shot_v2_per_strength() * strength * self.factor;
        volts / (self.setting.recorded_noise_v().powi(2) + shot_v2).sqrt()
    }
}
