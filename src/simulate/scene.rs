//! A scene: the objects in the room, the instrument, and the captures.

use std::collections::BTreeMap;

use super::keys::{Captures, Disk, Instrument, Laser, Optics, Prior, Rectangle, Sensor};
use crate::campaign::keys::{LASER, PatchRole, Station, View};
use crate::units::PatchId;

/// Shots per second, if neither laser nor instrument gives a rate.
const UNSTATED_HZ: f64 = 1000.0;

/// A checked scene.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Name of the campaign.
    pub name: String,
    /// Group index of the medium.
    pub group_index: f64,
    /// 3, or 2 for flatland.
    pub dimensions: u8,
    /// Positions of laser and sensors.
    pub stations: BTreeMap<String, Station>,
    /// Detectors.
    pub sensors: BTreeMap<String, Sensor>,
    /// Patches.
    pub patches: BTreeMap<PatchId, Disk>,
    /// Spots and pixels that cover several patches.
    pub views: BTreeMap<PatchId, View>,
    /// Other objects in the room.
    pub surfaces: BTreeMap<String, Rectangle>,
    /// The laser; absent where the signal-to-noise ratio is set.
    pub laser: Option<Laser>,
    /// The sensor's optics; absent where the signal-to-noise ratio is set.
    pub optics: Option<Optics>,
    /// The recording instrument.
    pub instrument: Instrument,
    /// Which captures to record.
    pub captures: Captures,
    /// What campaign.toml gives as prior knowledge.
    pub prior: Prior,
    /// The text of the file.
    pub text: String,
}

impl Scene {
    /// Position of a sensor.
    ///
    /// # Panics
    /// When the scene has no such sensor.
    #[must_use]
    pub fn sensor_m(&self, sensor: &str) -> [f64; 3] {
        let station = self.sensors[sensor].station.as_deref().unwrap_or(LASER);
        self.stations[station].position_m
    }

    /// Patches and views that the laser lights: all that laser and sensor reach, unless `captures.lit` lists them.
    #[must_use]
    pub fn lit(&self) -> Vec<PatchId> {
        if self.captures.lit.is_empty() { self.visible() } else { self.captures.lit.clone() }
    }

    /// Patches and views that the sensors look at, with the same default.
    #[must_use]
    pub fn seen(&self) -> Vec<PatchId> {
        if self.captures.seen.is_empty() { self.visible() } else { self.captures.seen.clone() }
    }

    /// Those that one sensor looks at.
    ///
    /// # Panics
    /// When the scene has no such sensor.
    #[must_use]
    pub fn seen_by(&self, sensor: &str) -> Vec<PatchId> {
        let own = &self.sensors[sensor].seen;
        if own.is_empty() { self.seen() } else { own.clone() }
    }

    /// Patches that laser and sensor reach.
    #[must_use]
    pub fn visible(&self) -> Vec<PatchId> {
        self.patches.iter().filter(|(_, disk)| disk.role == PatchRole::Visible).map(|(id, _)| *id).collect()
    }

    /// The patches that a number in `lit` or `seen` denotes.
    #[must_use]
    pub fn covers(&self, number: PatchId) -> Vec<PatchId> {
        self.views.get(&number).map_or_else(|| vec![number], |view| view.patches.clone())
    }

    /// Laser period, where records may reach beyond it: profiles are circular then.
    #[must_use]
    pub fn repetition_ps(&self) -> Option<f64> {
        self.laser.map(|laser| 1e12 / laser.repetition_hz)
    }

    /// Whether records reach across the laser's period, so that profiles are circular.
    #[must_use]
    pub fn wraps(&self) -> bool {
        let instrument = &self.instrument;
        let end_ps = instrument.t0_ps + instrument.samples as f64 * instrument.dt_ps;
        self.repetition_ps().is_some_and(|period_ps| period_ps < end_ps)
    }

    /// Recorded shots per second: the lower of the rates of laser and instrument.
    #[must_use]
    pub fn rate_hz(&self) -> f64 {
        let laser_hz = self.laser.map_or(f64::INFINITY, |laser| laser.repetition_hz);
        let instrument_hz = self.instrument.rate_hz.unwrap_or(f64::INFINITY);
        let slower = laser_hz.min(instrument_hz);
        if slower.is_finite() { slower } else { UNSTATED_HZ }
    }
}
