//! What first light of a surface would show on a relay wall, before anything is captured.
//!
//! The expected counts of a simulated wall go through the estimators of `first_returns` and `mesh`. Noise is not drawn:
//! the standard deviations are those that a capture of this kind would state. So this room knows simulator and
//! estimators, which do not know one another.

use serde::Serialize;

use crate::cancel::Cancel;
use crate::geometry::Point;
use crate::geometry::first_return::{Kind, Lit, SurfacePoint, Systematic, wall_normal};
use crate::geometry::height_field::height_fields;
use crate::geometry::shapes::Sighting;
use crate::priors::campaign_fields::Medium;
use crate::signal::edge::{Bins, Noise, Rises};
use crate::simulate::wall::{Surface, Wall, WallScene};
use crate::stages::first_returns::{ShownPoint, Timing};

/// Samples of the response across its width, and widths before and behind its middle.
const SAMPLES: f64 = 40.0;
const REACH: f64 = 3.0;

/// What a wall would show of one surface.
#[derive(Clone, Debug, Serialize)]
pub struct WallOutlook {
    /// Name of the surface.
    pub surface: String,
    /// Histograms of the wall.
    pub histograms: usize,
    /// Points that they show.
    pub points: usize,
    /// Points of a smooth surface.
    pub smooth: usize,
    /// Points of edges.
    pub edge: usize,
    /// Points of corners.
    pub corner: usize,
    /// Points of which first light does not determine the kind.
    pub unknown: usize,
    /// Median of the standard deviations of points.
    pub sd_m: Option<f64>,
    /// The same of their depth along the normal.
    pub depth_sd_m: Option<f64>,
    /// The same of the normals of smooth ones.
    pub normal_sd_deg: Option<f64>,
    /// Nodes of a surface between points.
    pub mesh_nodes: usize,
    /// Median of their standard deviations along the normal.
    pub mesh_sd_m: Option<f64>,
    /// Share of the surface whose normal meets the wall.
    pub faced: f64,
    /// The steepest such normal.
    pub steepest_deg: f64,
}

impl WallOutlook {
    /// One for each surface of a scene, by name. `threshold_sigma` is the signal-to-noise ratio from which first light
    /// counts.
    #[must_use]
    pub fn all(scene: &WallScene, threshold_sigma: f64, cancel: &Cancel) -> Vec<Self> {
        scene.surfaces.iter().map(|one| Self::new(&scene.wall, one, threshold_sigma, cancel)).collect()
    }

    fn new(wall: &Wall, (name, surface): (&String, &Surface), threshold_sigma: f64, cancel: &Cancel) -> Self {
        let expected = wall.expected(surface);
        let (first_ps, dt_ps) = (expected.first_ps, wall.bin_ps.get());
        let bins: Vec<_> = expected
            .histograms
            .iter()
            .map(|(seen, counts)| (*seen, Bins { first_ps, dt_ps, values: counts, noise: Noise::Counts }))
            .collect();
        let rises = rises(wall);
        let medium = Medium { group_index: 1.0 };
        let hidden_side = Point::new(0.0, 0.0, 1.0);
        let inwards = wall_normal(&wall.places(), &hidden_side).expect("the points of a wall span a plane");
        let systematic = Systematic::default();
        let timing = Timing { lit: &Lit::Same, inwards, medium, rises: &rises, threshold_sigma, systematic };
        let mut points = timing.shown(bins.len(), |n| bins[n], cancel).points;
        points.retain(|shown| shown.rank == 1);
        let sighting = |ShownPoint { number, point, .. }: &ShownPoint| Sighting {
            seen: bins[*number].0,
            light: point.light,
            point: point.point,
            covariance_m2: point.covariance_m2,
            part: point.kind,
            edges: point.edges,
        };
        let sightings: Vec<Sighting> = points.iter().map(sighting).collect();
        let nodes: Vec<f64> = height_fields(&sightings, cancel)
            .iter()
            .flat_map(|field| field.nodes.iter().map(|node| node.sd_m))
            .collect();
        let all = || points.iter().map(|shown| &shown.point);
        let count = |kind: Kind| all().filter(|point| point.kind == kind).count();
        let along = |point: &SurfacePoint| point.normal.dot(&(point.covariance_m2 * point.normal)).sqrt();
        let turn = |point: &SurfacePoint| (0.5 * point.normal_covariance.trace()).sqrt().to_degrees();
        Self {
            surface: name.clone(),
            histograms: bins.len(),
            points: points.len(),
            smooth: count(Kind::Smooth),
            edge: count(Kind::Edge),
            corner: count(Kind::Corner),
            unknown: count(Kind::Unknown),
            sd_m: median(all().map(|point| point.covariance_m2.trace().sqrt()).collect()),
            depth_sd_m: median(all().map(along).collect()),
            normal_sd_deg: median(all().filter(|point| point.kind == Kind::Smooth).map(turn).collect()),
            mesh_nodes: nodes.len(),
            mesh_sd_m: median(nodes),
            faced: expected.faced,
            steepest_deg: expected.steepest_rad.to_degrees(),
        }
    }
}

/// Beginnings of light behind the wall's Gaussian response.
fn rises(wall: &Wall) -> Rises {
    let width_ps = wall.fwhm_ps.get();
    let (first_ps, step_ps) = (-REACH * width_ps, width_ps / SAMPLES);
    let count = (2.0 * REACH * SAMPLES) as usize;
    let value = |n: usize| (-0.5 * ((first_ps + n as f64 * step_ps) / wall.sigma_ps()).powi(2)).exp();
    let values: Vec<f64> = (0..=count).map(value).collect();
    Rises::new([first_ps, step_ps], &values, [width_ps, wall.bin_ps.get()])
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}
