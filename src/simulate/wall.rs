//! What a relay wall records of a surface: the expected counts of each histogram, before anything is captured.
//!
//! Each point of the wall is lit and seen itself. Light is summed over facets of the surface that face the wall, with
//! cosines at the surface and at the wall and the inverse fourth power of the distance, and goes through a Gaussian
//! response. Facets hide one another only where they face away.
//!
//! ```toml
//! [wall]                   # upright at z = 0, its middle at the origin; surfaces lie at positive z
//! size_m = [1.0, 1.0]      # width, height
//! points = [32, 32]        # columns, rows
//! photons = 3000.0         # of the surface, in a mean histogram
//! background = 0.2         # counts of a bin besides (optional)
//! bin_ps = 8.0
//! fwhm_ps = 60.0           # of the instrument's response
//! [surfaces.plate]         # as many as you like; each is looked at alone
//! shape = "plate"
//! position_m = [0.0, 0.0, 0.7]
//! normal = [0.2, 0.0, -1.0]
//! size_m = [0.4, 0.3]
//! [surfaces.ball]
//! shape = "sphere"
//! position_m = [0.0, 0.0, 0.8]
//! radius_m = 0.2
//! [surfaces.stairs]        # a plate whose right half lies farther away
//! shape = "step"
//! position_m = [0.0, 0.0, 0.7]
//! normal = [0.0, 0.0, -1.0]
//! size_m = [0.4, 0.3]
//! step_m = 0.1
//! ```

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use serde::Deserialize;

use super::load_scene::SceneError;
use crate::campaign::toml_text;
use crate::parameter::{NonNegative, Positive};
use crate::units::{path_m, time_ps};

/// Full width at half maximum of a Gaussian, in standard deviations.
const FWHM: f64 = 2.354_820_045_030_949_3;
/// Group index.
const VACUUM: f64 = 1.0;
/// Facets over the radius of the ring whose light comes one standard deviation of the response after the first, and
/// the most facets of a surface along one direction.
const FACETS: f64 = 24.0;
const MOST: f64 = 400.0;
/// Record before the first light, behind the last, and response summed, in standard deviations of the response.
const BEFORE: f64 = 40.0;
const BEHIND: f64 = 20.0;
const REACH: f64 = 6.0;
/// Parts of a bin in which light is summed.
const PARTS: usize = 4;
/// Most points of a wall along one direction.
const MOST_POINTS: usize = 1024;

/// A wall, and surfaces that it is to show.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WallScene {
    /// `[wall]`.
    pub wall: Wall,
    /// `[surfaces.NAME]`.
    #[serde(default)]
    pub surfaces: BTreeMap<String, Surface>,
}

/// `[wall]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wall {
    /// Width and height.
    pub size_m: [Positive; 2],
    /// Columns and rows of points, evenly over the wall, borders included.
    pub points: [usize; 2],
    /// Photons of the surface in a mean histogram.
    pub photons: Positive,
    /// Counts of a bin besides.
    #[serde(default = "none")]
    pub background: NonNegative,
    /// Width of a bin.
    pub bin_ps: Positive,
    /// Full width at half maximum of the response.
    pub fwhm_ps: Positive,
}

fn none() -> NonNegative {
    NonNegative::new(0.0)
}

/// `[surfaces.NAME]`; the wall sees the side that its normal points away from.
#[derive(Clone, Debug, Deserialize)]
#[serde(tag = "shape", rename_all = "lowercase", deny_unknown_fields)]
pub enum Surface {
    /// A rectangle.
    Plate {
        /// Middle.
        position_m: [f64; 3],
        /// Towards the wall, of any length.
        normal: [f64; 3],
        /// Width and height.
        size_m: [Positive; 2],
    },
    /// A sphere.
    Sphere {
        /// Middle.
        position_m: [f64; 3],
        /// Radius.
        radius_m: Positive,
    },
    /// A rectangle whose right half lies farther from the wall; what joins both halves is not lit.
    Step {
        /// Middle of the nearer half's plane.
        position_m: [f64; 3],
        /// Towards the wall, of any length.
        normal: [f64; 3],
        /// Width and height of both halves together.
        size_m: [Positive; 2],
        /// Distance of both planes.
        step_m: Positive,
    },
}

/// A small part of a surface.
#[derive(Clone, Copy, Debug)]
struct Facet {
    place: Point3<f64>,
    normal: Vector3<f64>,
    area_m2: f64,
}

/// Expected counts of a wall's histograms.
#[derive(Clone, Debug)]
pub struct Expected {
    /// Middle of the first bin.
    pub first_ps: f64,
    /// Points of the wall, row by row, and their counts.
    pub histograms: Vec<(Point3<f64>, Vec<f64>)>,
    /// Share of the surface that some point of the wall has for its nearest, by its normal meeting the wall.
    pub faced: f64,
    /// Largest angle between the wall's normal and that of such a part.
    pub steepest_rad: f64,
}

impl WallScene {
    /// Whether a file describes a wall.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn is_in(file: &Path) -> Result<bool, SceneError> {
        let text = toml_text::read(file).map_err(|source| SceneError::Read { file: file.to_owned(), source })?;
        Ok(text.parse::<toml::Table>().is_ok_and(|table| table.contains_key("wall")))
    }

    /// Reads a file.
    ///
    /// # Errors
    /// When the file cannot be read, or anything in it is refused.
    pub fn load(file: &Path) -> Result<Self, SceneError> {
        let text = toml_text::read(file).map_err(|source| SceneError::Read { file: file.to_owned(), source })?;
        let scene: Self = toml_text::parse(file, &text)?;
        scene.check().map_err(|problem| SceneError::Value { file: file.to_owned(), problem })?;
        Ok(scene)
    }

    fn check(&self) -> Result<(), String> {
        if self.wall.points.iter().any(|count| !(4..=MOST_POINTS).contains(count)) {
            let [columns, rows] = self.wall.points;
            return Err(format!("[wall]: points = [{columns}, {rows}]; each must be 4 to {MOST_POINTS}"));
        }
        if self.surfaces.is_empty() {
            return Err("there is no surface that the wall could show; describe one under [surfaces.NAME]".to_owned());
        }
        for (name, surface) in &self.surfaces {
            if surface.normal().is_none() {
                return Err(format!("[surfaces.{name}]: `normal` must be finite and not all zeros"));
            }
            let facets = surface.facets(&self.wall);
            if facets.is_empty() {
                return Err(format!("[surfaces.{name}]: no part of it faces the wall; turn `normal` to negative z"));
            }
            if facets.iter().any(|facet| facet.place.z.is_nan() || facet.place.z <= 0.0) {
                return Err(format!("[surfaces.{name}]: it reaches the wall; move `position_m` to larger z"));
            }
        }
        Ok(())
    }
}

impl Wall {
    /// Standard deviation of a Gaussian as wide as the response.
    #[must_use]
    pub fn sigma_ps(&self) -> f64 {
        self.fwhm_ps.get() / FWHM
    }

    /// Its points, row by row.
    #[must_use]
    pub fn places(&self) -> Vec<Point3<f64>> {
        let [columns, rows] = self.points;
        let along = |n: usize, count: usize| n as f64 / (count - 1) as f64 - 0.5;
        let place = |n: usize| {
            let [x, y] = [along(n % columns, columns), along(n / columns, rows)];
            Point3::new(x * self.size_m[0].get(), y * self.size_m[1].get(), 0.0)
        };
        (0..columns * rows).map(place).collect()
    }

    /// Side of a facet at a distance.
    fn pitch_m(&self, distance_m: f64, size_m: f64) -> f64 {
        let zone_m = (path_m(self.sigma_ps(), VACUUM) * distance_m.abs()).sqrt();
        (zone_m / FACETS).max(size_m / MOST)
    }

    /// Whether a ray from a facet along its normal meets the wall.
    fn is_met(&self, facet: &Facet) -> bool {
        let share = facet.place.z / -facet.normal.z;
        let meets = facet.place + facet.normal * share;
        let [width_m, height_m] = self.size_m.map(Positive::get);
        meets.x.abs() <= 0.5 * width_m && meets.y.abs() <= 0.5 * height_m
    }

    /// Expected counts of a surface.
    #[must_use]
    pub fn expected(&self, surface: &Surface) -> Expected {
        let facets = surface.facets(self);
        let met: Vec<&Facet> = facets.iter().filter(|facet| self.is_met(facet)).collect();
        let area = |facets: &mut dyn Iterator<Item = &Facet>| facets.map(|facet| facet.area_m2).sum::<f64>();
        let faced = area(&mut met.iter().copied()) / area(&mut facets.iter());
        let steepest_rad = met.iter().map(|facet| (-facet.normal.z).min(1.0).acos()).fold(0.0, f64::max);
        let places = self.places();
        let arrives_ps = |place: &Point3<f64>, facet: &Facet| time_ps(2.0 * (facet.place - place).norm(), VACUUM);
        let of_place = |place: &Point3<f64>| {
            let times = facets.iter().map(|facet| arrives_ps(place, facet));
            times.fold([f64::INFINITY, 0.0_f64], |[least, most], time| [least.min(time), most.max(time)])
        };
        let ends: Vec<[f64; 2]> = places.par_iter().map(of_place).collect();
        let [least, most] = ends.iter().fold([f64::INFINITY, 0.0_f64], |[a, b], end| [a.min(end[0]), b.max(end[1])]);
        let first_ps = least - BEFORE * self.sigma_ps();
        let bins = ((most - first_ps + BEHIND * self.sigma_ps()) / self.bin_ps.get()).ceil() as usize;
        let response = self.response();
        let light = |place: &Point3<f64>| {
            let mut fine = vec![0.0; bins * PARTS];
            for facet in &facets {
                let way = place - facet.place;
                let distance_m = way.norm();
                let [at_facet, at_wall] = [facet.normal.dot(&way) / distance_m, facet.place.z / distance_m];
                let part =
                    (arrives_ps(place, facet) - first_ps) / self.bin_ps.get() * PARTS as f64 + 0.5 * PARTS as f64;
                fine[part as usize] += facet.area_m2 * (at_facet.max(0.0) * at_wall).powi(2) / distance_m.powi(4);
            }
            let behind = |bin: usize| {
                let middle = (bin * PARTS) as isize - (response.len() / 2) as isize;
                let of_part = |(k, share): (usize, &f64)| {
                    usize::try_from(middle + k as isize).ok().and_then(|part| fine.get(part)).unwrap_or(&0.0) * share
                };
                response.iter().enumerate().map(of_part).sum()
            };
            (0..bins).map(behind).collect::<Vec<f64>>()
        };
        let mut histograms: Vec<(Point3<f64>, Vec<f64>)> =
            places.par_iter().map(|place| (*place, light(place))).collect();
        let all: f64 = histograms.iter().flat_map(|(_, counts)| counts).sum();
        let scale = self.photons.get() * histograms.len() as f64 / all.max(f64::MIN_POSITIVE);
        for count in histograms.iter_mut().flat_map(|(_, counts)| counts) {
            *count = *count * scale + self.background.get();
        }
        Expected { first_ps, histograms, faced, steepest_rad }
    }

    /// Share of light that arrives in the middle of a part and is counted in a bin, by parts from the first that has
    /// any to the last, the bin's first part in the middle.
    fn response(&self) -> Vec<f64> {
        let part_ps = self.bin_ps.get() / PARTS as f64;
        let reach = (REACH * self.sigma_ps() / part_ps).ceil() as isize + PARTS as isize;
        let density = |part: isize| (-0.5 * (part as f64 * part_ps / self.sigma_ps()).powi(2)).exp();
        let of_part = |part: isize| (0..PARTS as isize).map(|own| density(own - part)).sum::<f64>();
        let shares: Vec<f64> = (-reach..=reach).map(of_part).collect();
        let sum: f64 = shares.iter().sum();
        shares.into_iter().map(|share| share * PARTS as f64 / sum).collect()
    }
}

impl Surface {
    /// Unit normal of flat ones, that of a wall's front for a sphere; `None` where it has no direction.
    fn normal(&self) -> Option<Vector3<f64>> {
        match self {
            Self::Plate { normal, .. } | Self::Step { normal, .. } => {
                Vector3::from(*normal).try_normalize(1e-12).filter(|normal| normal.iter().all(|x| x.is_finite()))
            }
            Self::Sphere { .. } => Some(-Vector3::z()),
        }
    }

    /// The parts that face the wall.
    fn facets(&self, wall: &Wall) -> Vec<Facet> {
        let normal = self.normal().unwrap_or(-Vector3::z());
        let facets = match self {
            Self::Plate { position_m, size_m, .. } => {
                rectangle(wall, (*position_m).into(), normal, size_m.map(Positive::get))
            }
            Self::Step { position_m, size_m, step_m, .. } => {
                let [width_m, height_m] = size_m.map(Positive::get);
                let [across, _] = sides(&normal);
                let half = |side: f64| Point3::from(*position_m) + across * (0.25 * side * width_m);
                let mut facets = rectangle(wall, half(-1.0), normal, [0.5 * width_m, height_m]);
                let farther = half(1.0) - normal * step_m.get();
                facets.extend(rectangle(wall, farther, normal, [0.5 * width_m, height_m]));
                facets
            }
            Self::Sphere { position_m, radius_m } => sphere(wall, (*position_m).into(), radius_m.get()),
        };
        facets.into_iter().filter(|facet| facet.normal.z < 0.0).collect()
    }
}

/// Directions along the width and the height of a rectangle with this normal, the first one level.
fn sides(normal: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let across = Vector3::y().cross(normal).try_normalize(1e-9).unwrap_or(Vector3::x());
    let across = if across.x < 0.0 { -across } else { across };
    [across, normal.cross(&across)]
}

fn rectangle(wall: &Wall, middle: Point3<f64>, normal: Vector3<f64>, size_m: [f64; 2]) -> Vec<Facet> {
    let count = size_m.map(|size_m| (size_m / wall.pitch_m(middle.z, size_m)).ceil().max(1.0) as usize);
    let [across, up] = sides(&normal);
    let area_m2 = size_m[0] * size_m[1] / (count[0] * count[1]) as f64;
    let along = |n: usize, k: usize| ((n as f64 + 0.5) / count[k] as f64 - 0.5) * size_m[k];
    let facet = |n: usize| {
        let place = middle + across * along(n % count[0], 0) + up * along(n / count[0], 1);
        Facet { place, normal, area_m2 }
    };
    (0..count[0] * count[1]).map(facet).collect()
}

/// Rings about the axis towards the wall.
fn sphere(wall: &Wall, middle: Point3<f64>, radius_m: f64) -> Vec<Facet> {
    let pitch_m = wall.pitch_m(middle.z - radius_m, 2.0 * radius_m);
    let rings = (std::f64::consts::FRAC_PI_2 * radius_m / pitch_m).ceil().max(1.0) as usize;
    let angle = |n: f64| std::f64::consts::FRAC_PI_2 * n / rings as f64;
    let ring = |ring: usize| {
        let (sine, cosine) = angle(ring as f64 + 0.5).sin_cos();
        let count = (std::f64::consts::TAU * radius_m * sine / pitch_m).ceil().max(1.0) as usize;
        let band = angle(ring as f64).cos() - angle(ring as f64 + 1.0).cos();
        let area_m2 = std::f64::consts::TAU * radius_m * radius_m * band / count as f64;
        (0..count).map(move |n| {
            // Facets of one ring start off those of the next.
            let turn = std::f64::consts::TAU * (n as f64 + 0.38 * ring as f64) / count as f64;
            let normal = Vector3::new(sine * turn.cos(), sine * turn.sin(), -cosine);
            Facet { place: middle + normal * radius_m, normal, area_m2 }
        })
    };
    (0..rings).flat_map(ring).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(surface: &str) -> Result<WallScene, SceneError> {
        let text = format!(
            "[wall]\nsize_m = [1.0, 1.0]\npoints = [8, 8]\nphotons = 1000.0\nbackground = 0.5\nbin_ps = 8.0\n\
             fwhm_ps = 60.0\n[surfaces.one]\n{surface}"
        );
        let file = Path::new("wall.toml");
        let scene: WallScene = toml_text::parse(file, &text)?;
        scene.check().map_err(|problem| SceneError::Value { file: file.to_owned(), problem })?;
        Ok(scene)
    }

    #[test]
    fn a_small_plate_is_a_pulse_at_its_distance() {
        let scene =
            scene("shape = \"plate\"\nposition_m = [0.1, 0.0, 0.7]\nnormal = [0, 0, -1]\nsize_m = [0.004, 0.004]")
                .unwrap();
        let expected = scene.wall.expected(&scene.surfaces["one"]);
        let mean =
            expected.histograms.iter().flat_map(|(_, counts)| counts).map(|count| count - 0.5).sum::<f64>() / 64.0;
        assert!((mean - 1000.0).abs() < 1e-6, "{mean}");
        for (place, counts) in &expected.histograms {
            let time = |(n, count): (usize, &f64)| (expected.first_ps + 8.0 * n as f64) * (count - 0.5);
            let light: f64 = counts.iter().map(|count| count - 0.5).sum();
            let centroid_ps = counts.iter().enumerate().map(time).sum::<f64>() / light;
            let true_ps = time_ps(2.0 * (Point3::new(0.1, 0.0, 0.7) - place).norm(), VACUUM);
            assert!((centroid_ps - true_ps).abs() < 1.1, "{centroid_ps} ps, {true_ps} ps");
            // Cosines and the inverse fourth power.
            let ratio = light / expected.histograms[0].1.iter().map(|count| count - 0.5).sum::<f64>();
            let law = |place: &Point3<f64>| (Point3::new(0.1, 0.0, 0.7) - place).norm().powi(-8);
            assert!((ratio / (law(place) / law(&expected.histograms[0].0)) - 1.0).abs() < 1e-3, "{ratio}");
        }
    }

    #[test]
    fn a_wall_sees_the_normals_that_meet_it() {
        let ball = scene("shape = \"sphere\"\nposition_m = [0.0, 0.0, 0.8]\nradius_m = 0.2").unwrap();
        let expected = ball.wall.expected(&ball.surfaces["one"]);
        // All normals of a sphere go through its middle: those within the corners of the wall meet it.
        let corner_rad = (0.5_f64.hypot(0.5) / 0.8).atan();
        assert!((expected.steepest_rad - corner_rad).abs() < 0.02, "{} {corner_rad}", expected.steepest_rad);
        // Solid angle of a square of 1 m at 0.8 m, over that of a half space.
        let share = 4.0 * (0.25 / (0.64_f64 * (0.64 + 0.5)).sqrt()).atan() / std::f64::consts::TAU;
        assert!((expected.faced - share).abs() < 0.01, "{} {share}", expected.faced);
    }

    #[test]
    fn what_the_wall_cannot_show_is_refused() {
        let refused = [
            ("shape = \"plate\"\nposition_m = [0, 0, 0.7]\nnormal = [0, 0, 1]\nsize_m = [0.1, 0.1]", "faces the wall"),
            ("shape = \"sphere\"\nposition_m = [0, 0, 0.1]\nradius_m = 0.2", "reaches the wall"),
            ("shape = \"plate\"\nposition_m = [0, 0, 0.7]\nnormal = [0, 0, 0]\nsize_m = [0.1, 0.1]", "not all zeros"),
            ("shape = \"cone\"\nposition_m = [0, 0, 0.7]", "cone"),
        ];
        for (surface, why) in refused {
            let error = scene(surface).unwrap_err().to_string();
            assert!(error.contains(why), "{error}");
        }
    }
}
