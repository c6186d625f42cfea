//! Which of several scenes explains the arrivals best.
//!
//! The log-likelihood of a scene is the sum over profiles of the logarithm of the weights of all associations of
//! arrivals and paths ([`crate::association`]). So no label has to be chosen, and an arrival that a scene leaves to
//! clutter counts against it.
//!
//! Chances that paths are seen are learned once, so that scenes of the same patches expect as much light in all, and
//! light that is missing cancels. Hidden patches are not searched for: under a wrong scene one would come to lie where
//! a visible patch truly is, and explain its light. A true hidden patch has its light unexplained by all scenes alike.
//!
//! Not modelled: wide arrivals as pairs of pulses; errors of patches that arrivals share (each profile counts as if the
//! scene's errors were its own).

use periscope_cancel::Cancel;

use super::assignment::{self, Prior};
use super::chances::Chances;
use super::closed;
use super::paths::Graph;
use super::problem::{Options, SensorProfiles};
use super::readings::Readings;
use super::scene::Scene;
use crate::units::PatchId;

/// Arrivals that scenes are compared by.
pub struct Comparison<'a> {
    sensors: Vec<SensorProfiles>,
    visible: Vec<PatchId>,
    chances: Chances,
    options: &'a Options,
    cancel: &'a Cancel,
}

impl<'a> Comparison<'a> {
    /// Of scenes with the same patches as this one, which is about right.
    #[must_use]
    pub fn new(sensors: &[SensorProfiles], scene: &Scene, options: &'a Options, cancel: &'a Cancel) -> Self {
        let sensors = Readings::whole(sensors, Some(scene), options.blend_ps).sensors;
        let visible = scene.visible(&sensors);
        let chances = Chances::prior(&visible);
        let mut comparison = Self { sensors, visible, chances, options, cancel };
        comparison.chances = comparison.learned(scene);
        comparison
    }

    /// Log-likelihood of all arrivals, up to a constant that all scenes share.
    #[must_use]
    pub fn log_likelihood(&self, scene: &Scene) -> f64 {
        let prior = Prior::Learned { chances: &self.chances, blends: None };
        let of_sensor = |sensor: &SensorProfiles| {
            let closed = closed::closed(scene, sensor, &self.visible, self.options, self.cancel);
            let graph = Graph::new(scene, sensor, &closed, self.options.bounces, self.cancel);
            assignment::log_likelihood(&graph, sensor, &prior, self.options)
        };
        self.sensors.iter().map(of_sensor).sum()
    }

    fn learned(&self, scene: &Scene) -> Chances {
        let closed = |sensor| closed::closed(scene, sensor, &self.visible, self.options, self.cancel);
        let closed: Vec<_> = self.sensors.iter().map(closed).collect();
        let graph = |(sensor, closed)| Graph::new(scene, sensor, closed, self.options.bounces, self.cancel);
        let graphs: Vec<Graph> = self.sensors.iter().zip(&closed).map(graph).collect();
        Chances::prior(&self.visible).learned(&graphs, &self.sensors, self.options.bounces)
    }
}
