//! The room: all facets, which of them block light, and how much light each passes to another.

use std::f64::consts::{PI, TAU};
use std::sync::OnceLock;

use super::facet::{Facet, Outline, Vector};
use crate::campaign::keys::{LASER, PatchRole};
use crate::simulate::scene::Scene;
use crate::units;

/// Intersections this close to an end of a line, relative to its length, count as the end itself.
const TOUCH: f64 = 1e-6;
/// Cells nearer than this multiple of their size get their share of light from the closed form.
const NEAR: f64 = 3.0;

/// The share of light from one point that reaches another.
#[derive(Clone, Copy, Debug)]
pub struct Link {
    /// Solid angle times the cosine at the start.
    pub factor: f64,
    /// Delay of the path relative to that between the facets' centres.
    pub later_ps: f64,
}

/// The room.
pub struct Room {
    /// Facets over which light is followed.
    pub facets: Vec<Facet>,
    blockers: Vec<Facet>,
    /// Links from each element of one facet to each of another, by `from * facets + to`; computed on first use.
    links: Vec<OnceLock<Vec<Link>>>,
    /// Position of the laser.
    pub source: Vector,
    /// Energy of a pulse; 1 where the signal-to-noise ratio is set.
    pub pulse_j: f64,
    /// Area of the lens times its transmission; 1 where the signal-to-noise ratio is set.
    pub lens_m2: f64,
    /// Etendue of the detector: area times solid angle, times the transmission.
    etendue_m2_sr: f64,
    group_index: f64,
}

impl Room {
    /// The room of a scene.
    pub fn new(scene: &Scene) -> Self {
        let points: Vec<Vector> = scene
            .stations
            .values()
            .map(|station| station.position_m)
            .chain(scene.patches.values().map(|disk| disk.position_m))
            .map(Vector::from)
            .collect();
        let patch = |(id, disk): (&i32, &crate::simulate::keys::Disk)| {
            let centre = Vector::from(disk.position_m);
            let distances = points.iter().map(|point| (point - centre).norm()).filter(|distance| *distance > 0.0);
            let nearest_m = distances.fold(f64::INFINITY, f64::min);
            // Enough points to resolve the nearest neighbour's solid angle, and the times across the patch.
            let across_ps = 2.0 * units::time_ps(disk.size_m, scene.group_index);
            let smooth = 1 + (6.0 * disk.size_m / nearest_m + across_ps / 80.0) as usize;
            // Shadow edges are resolved only as finely as the elements are.
            let rings = if scene.surfaces.is_empty() { smooth } else { smooth + 3 };
            Facet::patch(*id, disk, disk.role == PatchRole::Mirror, rings.min(10))
        };
        let mut facets: Vec<Facet> = scene.patches.iter().map(patch).collect();
        let mut blockers = facets.clone();
        blockers.extend(scene.surfaces.values().map(Facet::blocker));
        for cell in scene.surfaces.values().flat_map(Facet::cells) {
            // Where a patch covers a wall, light meets the patch, not the wall.
            let covered = |patch: &Facet| {
                patch.normal.dot(&(cell.centre - patch.centre)).abs() < 1e-3 && patch.covers(cell.centre)
            };
            if !blockers.iter().any(|blocker| matches!(blocker.outline, Outline::Disk { .. }) && covered(blocker)) {
                facets.push(cell);
            }
        }
        let links = (0..facets.len() * facets.len()).map(|_| OnceLock::new()).collect();
        let (pulse_j, lens_m2, etendue_m2_sr) = match (&scene.laser, &scene.optics) {
            (Some(laser), Some(optics)) => {
                let disk_m2 = |diameter_m: f64| PI * (0.5 * diameter_m).powi(2);
                let cone = PI * optics.numerical_aperture.powi(2);
                let etendue = optics.detector_m.map_or(f64::INFINITY, |detector_m| disk_m2(detector_m) * cone);
                (laser.pulse_j, disk_m2(optics.lens_m) * optics.transmission, etendue * optics.transmission)
            }
            _ => (1.0, 1.0, f64::INFINITY),
        };
        let source = Vector::from(scene.stations[LASER].position_m);
        Self { facets, blockers, links, source, pulse_j, lens_m2, etendue_m2_sr, group_index: scene.group_index }
    }

    /// Time of flight over a length.
    pub fn time_ps(&self, length_m: f64) -> f64 {
        units::time_ps(length_m, self.group_index)
    }

    /// Whether the line between two points is free. Surfaces that contain an end do not block it.
    pub fn clear(&self, a: Vector, b: Vector) -> bool {
        clear_of(self.blockers.iter(), a, b)
    }

    /// Blockers that may stand between two facets.
    fn between(&self, p: &Facet, q: &Facet) -> Vec<&Facet> {
        let (way, reach_m) = (q.centre - p.centre, p.radius_m().max(q.radius_m()));
        let near = |blocker: &&Facet| {
            let arm = blocker.centre - p.centre;
            let along = (arm.dot(&way) / way.norm_squared()).clamp(0.0, 1.0);
            (arm - along * way).norm() <= blocker.radius_m() + reach_m
        };
        self.blockers.iter().filter(near).collect()
    }

    /// Whether the line between two points by way of a mirror is free of other objects.
    fn clear_over(&self, a: Vector, mirror: Vector, b: Vector) -> bool {
        self.clear(a, mirror) && self.clear(mirror, b)
    }

    /// Links from each element of a facet to each of another, row by row; empty if neither sees the other.
    pub fn links(&self, from: usize, to: usize) -> &[Link] {
        self.links[from * self.facets.len() + to].get_or_init(|| {
            let points: Vec<Vector> = self.facets[from].elements.iter().map(|element| element.at).collect();
            self.links_from(&points, from, to)
        })
    }

    /// The same from any points of a facet.
    pub fn links_from(&self, points: &[Vector], from: usize, to: usize) -> Vec<Link> {
        let (p, q) = (&self.facets[from], &self.facets[to]);
        let centres_m = (q.centre - p.centre).norm();
        let facing = |point: &Vector, normal: &Vector, other: &Facet| {
            other.elements.iter().any(|element| normal.dot(&(element.at - point)) > 0.0)
        };
        let both = points.iter().any(|at| facing(at, &p.normal, q)) && facing(&q.centre, &q.normal, p);
        let back = points.iter().any(|at| q.normal.dot(&(at - q.centre)) > 0.0);
        if !(both || back) {
            return Vec::new();
        }
        let blockers = self.between(p, q);
        let mut links = Vec::with_capacity(points.len() * q.elements.len());
        for at in points {
            let start = links.len();
            for element in &q.elements {
                let arm = element.at - at;
                let length_m = arm.norm();
                let cosines = (p.normal.dot(&arm) / length_m).max(0.0) * (-q.normal.dot(&arm) / length_m).max(0.0);
                let open = cosines > 0.0 && clear_of(blockers.iter().copied(), *at, element.at);
                let factor = if open { cosines * q.area_m2 * element.share / (length_m * length_m) } else { 0.0 };
                links.push(Link { factor, later_ps: self.time_ps(length_m - centres_m) });
            }
            near_field(&mut links[start..], *at, p, q);
        }
        if links.iter().all(|link| link.factor == 0.0) { Vec::new() } else { links }
    }

    /// Link from `at` on facet `from` to `to` on facet `q` by way of a mirror, and where the light meets the mirror.
    pub fn mirrored(
        &self,
        at: Vector,
        from: &Facet,
        mirror: &Facet,
        q: &Facet,
        to: usize,
    ) -> Option<(f64, f64, Vector)> {
        let target = q.elements[to];
        let image = mirror.image(at);
        let sides = [at, target.at].map(|point| mirror.normal.dot(&(point - mirror.centre)));
        let share = mirror.hit(image, target.at).filter(|_| sides.iter().all(|side| *side > 0.0))?;
        let meeting = image + share * (target.at - image);
        let (out, into) = (meeting - at, target.at - meeting);
        let cosines = (from.normal.dot(&out) / out.norm()).max(0.0) * (-q.normal.dot(&into) / into.norm()).max(0.0);
        let length_m = out.norm() + into.norm();
        let factor = mirror.reflectance * cosines * q.area_m2 * target.share / (length_m * length_m);
        (factor > 0.0 && self.clear_over(at, meeting, target.at)).then_some((factor, length_m, meeting))
    }

    /// Solid angle of the lens times the cosine at a facet. It is smaller if the etendue of facet and lens exceeds the
    /// detector's.
    fn aperture(&self, facet: &Facet, cosine: f64, length_m: f64) -> f64 {
        let whole = cosine * self.lens_m2 / (length_m * length_m);
        whole.min(self.etendue_m2_sr / facet.area_m2)
    }

    /// Light from a point of a facet to the lens at `eye`: solid angle times cosine, and path length.
    pub fn to_eye(&self, at: Vector, facet: &Facet, eye: Vector) -> Option<(f64, f64)> {
        let arm = eye - at;
        let length_m = arm.norm();
        let cosine = facet.normal.dot(&arm) / length_m;
        (cosine > 0.0 && self.clear(at, eye)).then(|| (self.aperture(facet, cosine, length_m), length_m))
    }

    /// The same for an eye that looks into a mirror; also where the light meets the mirror.
    pub fn to_eye_mirrored(
        &self,
        at: Vector,
        facet: &Facet,
        mirror: &Facet,
        eye: Vector,
    ) -> Option<(f64, f64, Vector)> {
        let image = mirror.image(eye);
        let sides = [at, eye].map(|point| mirror.normal.dot(&(point - mirror.centre)));
        let share = mirror.hit(at, image).filter(|_| sides.iter().all(|side| *side > 0.0))?;
        let meeting = at + share * (image - at);
        let out = meeting - at;
        let length_m = (image - at).norm();
        let cosine = facet.normal.dot(&out) / out.norm();
        let factor = mirror.reflectance * self.aperture(facet, cosine, length_m);
        (cosine > 0.0 && self.clear_over(at, meeting, eye)).then_some((factor, length_m, meeting))
    }
}

/// Whether no blocker meets the line between two points, its ends excluded.
fn clear_of<'a>(mut blockers: impl Iterator<Item = &'a Facet>, a: Vector, b: Vector) -> bool {
    blockers.all(|blocker| blocker.hit(a, b).is_none_or(|share| !(TOUCH..=1.0 - TOUCH).contains(&share)))
}

/// A near cell, which four points would represent badly, gets its light from the closed form, unless something hides
/// part of it.
fn near_field(links: &mut [Link], at: Vector, p: &Facet, q: &Facet) {
    let Outline::Rectangle { corner, edges } = q.outline else {
        return;
    };
    let size_m = edges[0].norm().max(edges[1].norm());
    if (q.centre - at).norm() > NEAR * size_m || links.iter().any(|link| link.factor == 0.0) {
        return;
    }
    let corners = [corner, corner + edges[0], corner + edges[0] + edges[1], corner + edges[1]];
    if corners.iter().any(|corner| p.normal.dot(&(corner - at)) < -1e-12) {
        return;
    }
    let exact = PI * polygon_view_factor(at, p.normal, &corners);
    let sum: f64 = links.iter().map(|link| link.factor).sum();
    links.iter_mut().for_each(|link| link.factor *= exact / sum);
}

/// Share of the light from a Lambertian point that meets a polygon above its horizon, by Lambert's formula: a sum over
/// edges of the subtended angle times the cosine between the edge plane's normal and the surface's.
fn polygon_view_factor(at: Vector, normal: Vector, corners: &[Vector; 4]) -> f64 {
    let edge = |k: usize| {
        let (a, b) = (corners[k] - at, corners[(k + 1) % 4] - at);
        let across = a.cross(&b);
        let angle = across.norm().atan2(a.dot(&b));
        if across.norm() == 0.0 { 0.0 } else { angle * normal.dot(&across) / across.norm() }
    };
    ((0..4).map(edge).sum::<f64>() / TAU).abs()
}
