//! Paths of light: from the laser over a sequence of facets to the lens.

use std::cmp::Ordering;
use std::collections::BTreeMap;

use super::facet::{Element, Facet, Vector};
use super::light::{Light, Moments};
use super::room::Room;
use crate::simulate::scene::Scene;
use crate::units::PatchId;

/// Light by path. A path lists the patches in the order in which the light meets them, 0 for objects that are no patch.
/// Its light holds the arrivals at the lens, with strengths in joules per pulse.
pub type PathLights = BTreeMap<Vec<PatchId>, Light>;

/// Light at one point of a facet.
#[derive(Clone, Copy)]
struct Spot {
    at: Vector,
    /// Where it came from.
    from: Vector,
    light: Moments,
}

/// Light on a facet. On a glossy facet each point has one spot per origin of light, else a single one.
struct Lit {
    facet: usize,
    /// Whether spots are the facet's elements, with `elements` of them per origin.
    on_elements: bool,
    /// Time zero of the moments.
    origin_ps: f64,
    spots: Vec<Spot>,
}

/// Captures of one lit patch or view: for each sensor and seen patch or view, the light that ends there.
pub type CaptureLights = BTreeMap<(String, PatchId), PathLights>;

/// What is needed to follow paths.
pub struct Paths<'a> {
    room: &'a Room,
    bounces: usize,
    /// Sensors and their positions.
    eyes: Vec<(String, Vector)>,
    /// Number of a patch or view, and the patches that it covers.
    seen: Vec<(PatchId, Vec<PatchId>)>,
}

impl<'a> Paths<'a> {
    /// Follows paths in a scene, up to `bounces` bounces, into each of its captures.
    pub fn new(scene: &Scene, room: &'a Room, bounces: usize) -> Self {
        let eyes = scene.sensors.keys().map(|name| (name.clone(), Vector::from(scene.sensor_m(name)))).collect();
        let seen = scene.seen().into_iter().map(|view| (view, scene.covers(view))).collect();
        Self { room, bounces, eyes, seen }
    }

    /// All light from a pulse on a patch; a view divides it among its patches by area.
    pub fn lit(&self, patches: &[PatchId]) -> CaptureLights {
        let facets: Vec<usize> = patches.iter().map(|patch| self.facet(*patch)).collect();
        let area_m2: f64 = facets.iter().map(|&facet| self.room.facets[facet].area_m2).sum();
        let mut lights = CaptureLights::new();
        for facet in facets {
            let energy_j = self.room.pulse_j * self.room.facets[facet].area_m2 / area_m2;
            for (path, lit) in self.first(facet, energy_j) {
                self.follow(&path, &lit, &mut lights);
            }
        }
        lights
    }

    /// The light of one path, as in [`Paths::lit`] for the seen patch at its end.
    pub fn along(&self, through: &[PatchId], eye: Vector) -> Light {
        let mut light = Light::default();
        let mut open: Vec<(Vec<PatchId>, Lit)> = self.first(self.facet(through[0]), self.room.pulse_j);
        while let Some((path, lit)) = open.pop() {
            if path == through {
                light.0.extend(self.arrivals(path.len(), &lit, |spot, facet| self.direct(spot, facet, eye)).0);
            } else if through.starts_with(&path) {
                let ahead = |more: &[PatchId]| through[path.len()..].starts_with(more);
                open.extend(self.onward(&lit, ahead).map(|(more, lit)| ([path.as_slice(), &more].concat(), lit)));
            }
        }
        light
    }

    fn facet(&self, patch: PatchId) -> usize {
        self.room.facets.iter().position(|facet| facet.id == patch).expect("checked: the scene has the patch")
    }

    /// The laser's light on a patch; on a mirror, the light on the patches that the reflected beam meets.
    fn first(&self, facet: usize, energy_j: f64) -> Vec<(Vec<PatchId>, Lit)> {
        let room = self.room;
        let target = &room.facets[facet];
        let source = room.source;
        let origin_ps = room.time_ps((target.centre - source).norm());
        let open = target
            .elements
            .iter()
            .filter(|element| target.normal.dot(&(source - element.at)) > 0.0 && room.clear(source, element.at));
        if !target.mirror {
            let spot = |element: &Element| {
                let later_ps = room.time_ps((element.at - source).norm()) - origin_ps;
                Spot { at: element.at, from: source, light: Moments::at(later_ps, energy_j * element.share) }
            };
            let spots: Vec<Spot> = open.map(spot).collect();
            let on_elements = spots.len() == target.elements.len();
            return vec![(vec![target.id], Lit { facet, on_elements, origin_ps, spots })];
        }
        let mut landed: BTreeMap<usize, Vec<Spot>> = BTreeMap::new();
        for element in open {
            let onward = target.image(source);
            let beyond = element.at + (element.at - onward);
            let meets = |(index, facet): (usize, &Facet)| {
                let share = facet.hit(element.at, beyond).filter(|share| *share > 1e-6)?;
                let at = element.at + share * (beyond - element.at);
                (facet.normal.dot(&(element.at - at)) > 0.0).then_some((share, index, at))
            };
            let nearest = room.facets.iter().enumerate().filter_map(meets).min_by(|a, b| a.0.total_cmp(&b.0));
            if let Some((_, index, at)) = nearest.filter(|(_, _, at)| room.clear(element.at, *at)) {
                let way_m = (element.at - source).norm() + (at - element.at).norm();
                let strength = energy_j * element.share * target.reflectance;
                let light = Moments::at(room.time_ps(way_m) - origin_ps, strength);
                landed.entry(index).or_default().push(Spot { at, from: element.at, light });
            }
        }
        let lit = |(index, spots): (usize, Vec<Spot>)| {
            let path = vec![target.id, room.facets[index].id];
            (path, Lit { facet: index, on_elements: false, origin_ps, spots })
        };
        landed.into_iter().map(lit).collect()
    }

    /// Passes light to the sensors that see it, and on to all other facets.
    fn follow(&self, path: &[PatchId], lit: &Lit, lights: &mut CaptureLights) {
        if path.len() > self.bounces {
            return;
        }
        self.leave(path, lit, lights);
        // A sensor must see the last facet.
        let seen = |patch: &PatchId| self.seen.iter().any(|(_, patches)| patches.contains(patch));
        let worth = |more: &[PatchId]| match (path.len() + more.len()).cmp(&self.bounces) {
            Ordering::Less => true,
            Ordering::Equal => more.last().is_some_and(seen),
            Ordering::Greater => false,
        };
        for (more, next) in self.onward(lit, worth) {
            self.follow(&[path, &more].concat(), &next, lights);
        }
    }

    fn leave(&self, path: &[PatchId], lit: &Lit, lights: &mut CaptureLights) {
        let room = self.room;
        let here = room.facets[lit.facet].id;
        for (sensor, eye) in &self.eyes {
            for (view, patches) in &self.seen {
                let mut put = |path: Vec<PatchId>, light: Light| {
                    if !light.0.is_empty() {
                        // All cells of a wall have one name.
                        lights.entry((sensor.clone(), *view)).or_default().entry(path).or_default().0.extend(light.0);
                    }
                };
                if patches.contains(&here) {
                    let light = self.arrivals(path.len(), lit, |spot, facet| self.direct(spot, facet, *eye));
                    put(path.to_vec(), light);
                }
                let mirrors = room.facets.iter().filter(|facet| facet.mirror && patches.contains(&facet.id));
                for mirror in mirrors.filter(|_| path.len() < self.bounces) {
                    let seen = |spot: &Spot, facet: &Facet| {
                        let (factor, way_m, to) = room.to_eye_mirrored(spot.at, facet, mirror, *eye)?;
                        Some((factor * facet.reflection(spot.from, spot.at, to), way_m))
                    };
                    put([path, &[mirror.id]].concat(), self.arrivals(path.len() + 1, lit, seen));
                }
            }
        }
    }

    fn direct(&self, spot: &Spot, facet: &Facet, eye: Vector) -> Option<(f64, f64)> {
        let (factor, way_m) = self.room.to_eye(spot.at, facet, eye)?;
        Some((factor * facet.reflection(spot.from, spot.at, eye), way_m))
    }

    /// Arrivals at a lens: each spot contributes its light times a factor, after a path length. Up to second bounces
    /// each spot stays separate; for later ones the sum of all spots suffices.
    fn arrivals(&self, bounces: usize, lit: &Lit, reaches: impl Fn(&Spot, &Facet) -> Option<(f64, f64)>) -> Light {
        let facet = &self.room.facets[lit.facet];
        let mut light = Light::default();
        let mut sum = Moments::default();
        for spot in &lit.spots {
            if let Some((factor, way_m)) = reaches(spot, facet) {
                let arrived = spot.light.passed_on(factor, self.room.time_ps(way_m));
                if bounces <= 2 {
                    arrived.arrivals(lit.origin_ps, &mut light);
                } else {
                    sum.add(&arrived);
                }
            }
        }
        sum.arrivals(lit.origin_ps, &mut light);
        light
    }

    /// Light on all facets that it reaches, directly or over one mirror, and the path extended by them, if `worth`
    /// accepts it.
    fn onward(&self, lit: &Lit, worth: impl Fn(&[PatchId]) -> bool) -> impl Iterator<Item = (Vec<PatchId>, Lit)> {
        let facets = &self.room.facets;
        let mut onward = Vec::new();
        let targets = || (0..facets.len()).filter(|&to| !facets[to].mirror);
        for to in targets().filter(|&to| to != lit.facet && worth(&[facets[to].id])) {
            onward.extend(self.transfer(lit, to).map(|next| (vec![facets[to].id], next)));
        }
        for mirror in (0..facets.len()).filter(|&mirror| facets[mirror].mirror) {
            // A facet may see itself in a mirror.
            for to in targets().filter(|&to| worth(&[facets[mirror].id, facets[to].id])) {
                let path = vec![facets[mirror].id, facets[to].id];
                onward.extend(self.transfer_mirrored(lit, mirror, to).map(|next| (path, next)));
            }
        }
        onward.into_iter()
    }

    fn transfer(&self, lit: &Lit, to: usize) -> Option<Lit> {
        let room = self.room;
        let (p, q) = (&room.facets[lit.facet], &room.facets[to]);
        let made;
        let links = if lit.on_elements {
            room.links(lit.facet, to)
        } else {
            let points: Vec<Vector> = lit.spots.iter().map(|spot| spot.at).collect();
            made = room.links_from(&points, lit.facet, to);
            &made
        };
        if links.is_empty() {
            return None;
        }
        let width = q.elements.len();
        let rows = links.len() / width;
        let mut gathered = Gathered::new(q, rows);
        for (number, spot) in lit.spots.iter().enumerate() {
            let row = number % rows;
            for (k, link) in links[row * width..(row + 1) * width].iter().enumerate() {
                if link.factor > 0.0 {
                    let factor = link.factor * p.reflection(spot.from, spot.at, q.elements[k].at);
                    gathered.add(row, k, spot.at, &spot.light.passed_on(factor, link.later_ps));
                }
            }
        }
        let origin_ps = lit.origin_ps + room.time_ps((q.centre - p.centre).norm());
        gathered.lit(to, origin_ps)
    }

    fn transfer_mirrored(&self, lit: &Lit, mirror: usize, to: usize) -> Option<Lit> {
        let room = self.room;
        let (p, m, q) = (&room.facets[lit.facet], &room.facets[mirror], &room.facets[to]);
        let way_ps = room.time_ps((m.image(p.centre) - q.centre).norm());
        let rows = if lit.on_elements { p.elements.len() } else { lit.spots.len() };
        let mut gathered = Gathered::new(q, rows);
        for (number, spot) in lit.spots.iter().enumerate() {
            for k in 0..q.elements.len() {
                if let Some((factor, length_m, meeting)) = room.mirrored(spot.at, p, m, q, k) {
                    let factor = factor * p.reflection(spot.from, spot.at, meeting);
                    let light = spot.light.passed_on(factor, room.time_ps(length_m) - way_ps);
                    gathered.add(number % rows, k, meeting, &light);
                }
            }
        }
        gathered.lit(to, lit.origin_ps + way_ps)
    }
}

/// Collects light on the elements of a facet; on a glossy facet, separately for each origin.
struct Gathered<'a> {
    facet: &'a Facet,
    spots: Vec<Spot>,
}

impl<'a> Gathered<'a> {
    fn new(facet: &'a Facet, origins: usize) -> Self {
        let origins = if facet.lobe.is_some() { origins } else { 1 };
        let spot = |element: &Element| Spot { at: element.at, from: facet.centre, light: Moments::default() };
        Self { facet, spots: (0..origins).flat_map(|_| facet.elements.iter().map(spot)).collect() }
    }

    fn add(&mut self, origin: usize, element: usize, from: Vector, light: &Moments) {
        let at = (origin * self.facet.elements.len() + element) % self.spots.len();
        self.spots[at].from = from;
        self.spots[at].light.add(light);
    }

    fn lit(self, facet: usize, origin_ps: f64) -> Option<Lit> {
        let any = self.spots.iter().any(|spot| spot.light.strength() > 0.0);
        any.then_some(Lit { facet, on_elements: true, origin_ps, spots: self.spots })
    }
}
