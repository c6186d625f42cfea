//! Prior knowledge of a lab about a scene: `[known]` of a scene file, as lines of campaign.toml.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::scene::Scene;
use crate::campaign::keys::{LASER, PatchRole};
use crate::units::PatchId;

/// Random stream for errors of prior knowledge; captures have their own.
const STREAM: u64 = u64::MAX;

/// Draws the values in campaign.toml, in the order of the file.
pub struct PriorKeys<'a> {
    scene: &'a Scene,
    rng: ChaCha8Rng,
}

impl<'a> PriorKeys<'a> {
    pub fn new(scene: &'a Scene, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(STREAM);
        Self { scene, rng }
    }

    fn draw(&mut self, truth: [f64; 3], sd: f64) -> [f64; 3] {
        // In flatland all points stay in the plane.
        let dimensions = usize::from(self.scene.dimensions);
        std::array::from_fn(|k| {
            let error: f64 = if k < dimensions { StandardNormal.sample(&mut self.rng) } else { 0.0 };
            truth[k] + sd * error
        })
    }

    /// Keys of a station.
    pub fn station(&mut self, name: &str) -> String {
        let position_m = self.scene.stations[name].position_m;
        let sd_m = self.scene.prior.station_sd_m;
        if name == LASER || sd_m == 0.0 {
            return format!("position_m = {position_m:?}");
        }
        format!("position_m = {:?}\nsd_m = {sd_m:?}", self.draw(position_m, sd_m))
    }

    /// Keys of a patch, beyond its role.
    pub fn patch(&mut self, patch: PatchId) -> String {
        let (prior, disk) = (&self.scene.prior, &self.scene.patches[&patch]);
        // The empty first line ends the line before.
        let mut lines = vec![String::new()];
        if prior.size {
            lines.push(format!("size_m = {:?}", disk.size_m));
        }
        if let Some(lobe) = disk.lobe.filter(|_| prior.lobe) {
            lines.push(format!("lobe_rad = {:?}", lobe.width_rad));
        }
        // A lab cannot see the orientation of a hidden mirror.
        if prior.normal && disk.role != PatchRole::Hidden {
            lines.push(format!("normal = {:?}", disk.normal));
        }
        if prior.anchors.contains(&patch) {
            let position_m = self.draw(disk.position_m, prior.anchor_sd_m);
            lines.push(format!("position_m = {position_m:?}"));
            if prior.anchor_sd_m > 0.0 {
                lines.push(format!("sd_m = {:?}", prior.anchor_sd_m));
            }
        }
        if prior.rays.contains(&patch) {
            let laser_m = self.scene.stations[LASER].position_m;
            let arm: [f64; 3] = std::array::from_fn(|k| disk.position_m[k] - laser_m[k]);
            let length = arm.iter().map(|x| x * x).sum::<f64>().sqrt();
            let direction = self.draw(arm.map(|x| x / length), prior.ray_sd_rad);
            let sd = if prior.ray_sd_rad > 0.0 { format!(", sd_rad = {:?}", prior.ray_sd_rad) } else { String::new() };
            lines.push(format!("ray = {{ from = {LASER:?}, direction = {direction:?}{sd} }}"));
        }
        lines.join("\n")
    }
}
