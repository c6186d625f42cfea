//! Light transport: when and how strongly light arrives, by integrals over the patches' areas.
//!
//! A Lambertian element gives back `reflectance / pi * cos` per solid angle. The laser lights the whole of its patch evenly; the sensor sees the whole
//! of its own. First bounce (lit = seen = i): mean over x in i of `rho cos / (pi r^2)`. Second bounce (lit i, seen j): mean over x in i, integral
//! over y in j, of `rho_i cos cos / (pi |x - y|^2) * rho_j cos / (pi r^2)`. Strength 1/pi is a white disk at 1 m, lit and seen head on.

use std::f64::consts::{PI, TAU};

use super::scene::{Disk, Scene};
use crate::units::{self, PatchId};

/// Elements of a disk.
const ELEMENTS: usize = 48;

/// Arrivals of light: times of flight, and strengths.
#[derive(Clone, Debug, PartialEq)]
pub struct Light(pub Vec<(f64, f64)>);

impl Light {
    /// One arrival.
    pub fn at(time_ps: f64, strength: f64) -> Self {
        Self(vec![(time_ps, strength)])
    }

    /// Strength of all arrivals together.
    pub fn total(&self) -> f64 {
        self.0.iter().map(|(_, strength)| strength).sum()
    }

    /// Mean time of flight.
    pub fn centroid_ps(&self) -> f64 {
        self.0.iter().map(|(time_ps, strength)| time_ps * strength).sum::<f64>() / self.total()
    }

    /// First time of flight.
    pub fn earliest_ps(&self) -> f64 {
        self.0.iter().map(|(time_ps, _)| *time_ps).fold(f64::INFINITY, f64::min)
    }

    /// Standard deviation of the times of flight.
    pub fn width_ps(&self) -> f64 {
        let centroid_ps = self.centroid_ps();
        (self.0.iter().map(|(time_ps, strength)| strength * (time_ps - centroid_ps).powi(2)).sum::<f64>()
            / self.total())
        .sqrt()
    }
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|k| a[k] - b[k])
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn length(a: [f64; 3]) -> f64 {
    dot(a, a).sqrt()
}

/// Cosine between a normal and the direction to a point, zero behind the surface.
fn cosine(normal: [f64; 3], from: [f64; 3], to: [f64; 3]) -> f64 {
    let arm = minus(to, from);
    (dot(normal, arm) / length(arm)).max(0.0)
}

/// Points of equal area that cover a disk evenly: on a spiral by the golden angle, each with its opposite, so that their mean is the centre.
fn elements(disk: &Disk) -> Vec<[f64; 3]> {
    let least = (0..3).min_by(|&a, &b| disk.normal[a].abs().total_cmp(&disk.normal[b].abs())).expect("three axes");
    let mut axis = [0.0; 3];
    axis[least] = 1.0;
    let along = dot(axis, disk.normal);
    let u = std::array::from_fn(|k| axis[k] - along * disk.normal[k]);
    let u = u.map(|value: f64| value / length(u));
    let n = disk.normal;
    let v = [n[1] * u[2] - n[2] * u[1], n[2] * u[0] - n[0] * u[2], n[0] * u[1] - n[1] * u[0]];
    let golden = TAU * (1.0 - 2.0 / (1.0 + 5_f64.sqrt()));
    let half = ELEMENTS / 2;
    let point = |k: usize, side: f64| {
        let radius_m = side * 0.5 * disk.size_m * ((k as f64 + 0.5) / half as f64).sqrt();
        let (sin, cos) = (golden * k as f64).sin_cos();
        std::array::from_fn(|i| disk.position_m[i] + radius_m * (cos * u[i] + sin * v[i]))
    };
    (0..half).flat_map(|k| [point(k, 1.0), point(k, -1.0)]).collect()
}

/// Light of one capture.
pub fn light(scene: &Scene, sensor: &str, lit: PatchId, seen: PatchId) -> Light {
    let (source, eye) = (scene.stations[crate::campaign::keys::LASER].position_m, scene.sensor_m(sensor));
    let (i, j) = (&scene.patches[&lit], &scene.patches[&seen]);
    let time = |length_m| units::time_ps(length_m, scene.group_index);
    let volts = PI * scene.instrument.volts.unwrap_or(1.0) / ELEMENTS as f64;
    // What of the light on an element reaches the sensor.
    let to_eye = |disk: &Disk, at: [f64; 3]| {
        disk.reflectance / PI * cosine(disk.normal, at, eye) / dot(minus(eye, at), minus(eye, at))
    };
    if lit == seen {
        let arrival = |at: [f64; 3]| (time(length(minus(at, source)) + length(minus(eye, at))), volts * to_eye(i, at));
        return Light(elements(i).into_iter().map(arrival).collect());
    }
    let area_m2 = PI * (0.5 * j.size_m).powi(2) / ELEMENTS as f64;
    let targets: Vec<([f64; 3], f64)> = elements(j).into_iter().map(|at| (at, to_eye(j, at) * area_m2)).collect();
    let mut arrivals = Vec::with_capacity(ELEMENTS * ELEMENTS);
    for x in elements(i) {
        for (y, onward) in &targets {
            let arm = minus(*y, x);
            let handed_on = i.reflectance / PI * cosine(i.normal, x, *y) * cosine(j.normal, *y, x) / dot(arm, arm);
            arrivals.push((
                time(length(minus(x, source)) + length(arm) + length(minus(eye, *y))),
                volts * handed_on * onward,
            ));
        }
    }
    Light(arrivals)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn scene(size_m: f64) -> Scene {
        let text =
            include_str!("../../pipelines/scenes/tiny.toml").replace("size_m = 0.001", &format!("size_m = {size_m}"));
        Scene::parse(Path::new("tiny.toml"), &text).unwrap()
    }

    /// Facing disks: the view factor of coaxial parallel disks in closed form (Howell, configuration C-41).
    #[test]
    fn two_facing_disks_exchange_what_the_view_factor_says() {
        let mut scene = scene(0.2);
        let facing = |z: f64, side: f64| Disk {
            position_m: [0.0, 0.0, z],
            normal: [0.0, 0.0, side],
            ..scene.patches[&1].clone()
        };
        let pair = [facing(1.0, 1.0), facing(1.3, -1.0)];
        scene.patches = [(1, pair[0].clone()), (2, pair[1].clone())].into();
        // Light that leaves disk 1 evenly: the share that meets disk 2, from the mean of the elements' exchange.
        let (r, d) = (0.1, 0.3);
        let x = 1.0 + (1.0 + (r / d) * (r / d)) / ((r / d) * (r / d));
        let expected = 0.5 * (x - (x * x - 4.0_f64).sqrt());
        let area_m2 = PI * r * r / ELEMENTS as f64;
        let mut exchange = 0.0;
        for a in elements(&pair[0]) {
            for b in elements(&pair[1]) {
                let arm = minus(b, a);
                exchange += cosine(pair[0].normal, a, b) * cosine(pair[1].normal, b, a) / (PI * dot(arm, arm))
                    * area_m2
                    / ELEMENTS as f64;
            }
        }
        assert!((exchange / expected - 1.0).abs() < 0.01, "{exchange} {expected}");
    }

    #[test]
    fn strength_falls_with_the_square_of_the_distance_and_as_the_cosine() {
        let mut scene = scene(0.001);
        let disk = |z: f64, normal: [f64; 3]| Disk { position_m: [0.0, 0.0, z], normal, ..scene.patches[&1].clone() };
        let tilted = [0.0, 0.6, -0.8];
        let disks = [disk(1.0, [0.0, 0.0, -1.0]), disk(2.0, [0.0, 0.0, -1.0]), disk(1.0, tilted)];
        scene.patches = disks.into_iter().enumerate().map(|(i, disk)| (i as i32 + 1, disk)).collect();
        let total = |patch| light(&scene, "s1", patch, patch).total();
        assert!((total(1) / total(2) - 4.0).abs() < 1e-4 && (total(3) / total(1) - 0.8).abs() < 1e-4);
        let white = total(1) / 0.8;
        assert!((white - 1.0).abs() < 1e-4, "a white disk at 1 m gives `volts` of 1: {white}");
    }

    #[test]
    fn the_centroid_of_a_small_patch_is_the_path_through_its_centre() {
        let scene = scene(0.002);
        let path = |points: &[[f64; 3]]| points.windows(2).map(|ends| length(minus(ends[1], ends[0]))).sum::<f64>();
        let origin = [0.0; 3];
        let at = |patch: i32| scene.patches[&patch].position_m;
        let single = light(&scene, "s1", 1, 1).centroid_ps();
        let double = light(&scene, "s1", 1, 2).centroid_ps();
        assert!((single - units::time_ps(path(&[origin, at(1), origin]), scene.group_index)).abs() < 0.02);
        assert!((double - units::time_ps(path(&[origin, at(1), at(2), origin]), scene.group_index)).abs() < 0.02);
        assert!((double - light(&scene, "s1", 2, 1).centroid_ps()).abs() < 0.02, "reciprocity");
    }
}
