//! `periscope design` of a relay wall: what first light of a surface would show.
//!
//! The expected counts of a simulated wall go through the estimators of `first_returns` and `mesh`. Noise is not drawn:
//! the standard deviations are those that a capture of this kind would state.

use std::fmt::Write as _;

use anyhow::{Context, Result, bail};
use periscope::cancel::Cancel;
use periscope::geometry::Point;
use periscope::geometry::first_return::{Kind, SurfacePoint, wall_normal};
use periscope::geometry::height_field::height_fields;
use periscope::geometry::shapes::Sighting;
use periscope::parameter::Positive;
use periscope::priors::campaign_fields::Medium;
use periscope::signal::edge::{Bins, Noise, Rises};
use periscope::simulate::wall::{Surface, Wall, WallScene};
use periscope::stages::first_returns::Timing;
use serde::Serialize;

use super::length;
use crate::commands::output::{Format, Output, Rows, json, print, print_text};

/// Samples of the response across its width, and widths before and behind its middle.
const SAMPLES: f64 = 40.0;
const REACH: f64 = 3.0;

/// What a wall would show of one surface.
#[derive(Debug, Serialize)]
struct WallOutlook {
    surface: String,
    /// Histograms of the wall, and points that they show.
    histograms: usize,
    points: usize,
    smooth: usize,
    edge: usize,
    corner: usize,
    unknown: usize,
    /// Median standard deviations: of points, of their depth along the normal, and of the normals of smooth ones.
    sd_m: Option<f64>,
    depth_sd_m: Option<f64>,
    normal_sd_deg: Option<f64>,
    /// Nodes of a surface between points, and the median of their standard deviations along the normal.
    mesh_nodes: usize,
    mesh_sd_m: Option<f64>,
    /// Share of the surface whose normal meets the wall, and the steepest such normal.
    faced: f64,
    steepest_deg: f64,
}

/// The columns, in the order of the table.
const COLUMNS: [&str; 14] = [
    "surface",
    "histograms",
    "points",
    "smooth",
    "edge",
    "corner",
    "unknown",
    "sd_m",
    "depth_sd_m",
    "normal_sd_deg",
    "mesh_nodes",
    "mesh_sd_m",
    "faced",
    "steepest_deg",
];

/// The command for a file with `[wall]`.
pub fn design(scene: &WallScene, threshold_sigma: f64, output: &Output) -> Result<()> {
    if scene.surfaces.is_empty() {
        bail!("there is no surface that the wall could show; describe one under [surfaces.NAME]");
    }
    let outlook = |one: (&String, &Surface)| WallOutlook::new(&scene.wall, one, threshold_sigma);
    let outlooks = scene.surfaces.iter().map(outlook).collect::<Result<Vec<_>>>()?;
    match output.format {
        Format::Table => print_text(&text(&scene.wall, &outlooks)?)?,
        Format::Json => print(json(&outlooks)?)?,
        Format::Csv => Rows::of(&COLUMNS, &outlooks)?.print(Format::Csv)?,
    }
    Ok(())
}

impl WallOutlook {
    fn new(wall: &Wall, (name, surface): (&String, &Surface), threshold_sigma: f64) -> Result<Self> {
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
        let inwards = wall_normal(&wall.places(), &hidden_side).context("the points of the wall span a plane")?;
        let timing = Timing { lit: None, inwards, medium, rises: &rises, threshold_sigma };
        let cancel = Cancel::default();
        let points = timing.points(&bins, &cancel);
        let sighting = |(n, point): &(usize, SurfacePoint)| Sighting {
            seen: bins[*n].0,
            light: point.light,
            point: point.point,
            covariance_m2: point.covariance_m2,
            part: point.kind,
        };
        let sightings: Vec<Sighting> = points.iter().map(sighting).collect();
        let nodes: Vec<f64> = height_fields(&sightings, &cancel)
            .iter()
            .flat_map(|field| field.nodes.iter().map(|node| node.sd_m))
            .collect();
        let all = || points.iter().map(|(_, point)| point);
        let count = |kind: Kind| all().filter(|point| point.kind == kind).count();
        let along = |point: &SurfacePoint| point.normal.dot(&(point.covariance_m2 * point.normal)).sqrt();
        let turn = |point: &SurfacePoint| (0.5 * point.normal_covariance.trace()).sqrt().to_degrees();
        Ok(Self {
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
        })
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

fn text(wall: &Wall, outlooks: &[WallOutlook]) -> Result<String, std::fmt::Error> {
    let mut text = String::new();
    let ([width_m, height_m], [columns, rows]) = (wall.size_m.map(Positive::get), wall.points);
    writeln!(
        text,
        "A wall of {width_m} x {height_m} m, {columns} x {rows} points, each lit and seen itself; {} photons of the surface in a mean histogram, {} counts of a bin besides; bins of {} ps, a response of {} ps\n",
        wall.photons.get(),
        wall.background.get(),
        wall.bin_ps.get(),
        wall.fwhm_ps.get()
    )?;
    writeln!(text, "Points that first light would show, and medians of the standard deviations that they would state")?;
    writeln!(
        text,
        "{:12} {:>7} {:>7} {:>7} {:>7} {:>7} {:>12} {:>12} {:>8}   between points",
        "surface", "points", "smooth", "edge", "corner", "unknown", "sd", "in depth", "normal"
    )?;
    for one in outlooks {
        let normal = one.normal_sd_deg.map_or("-".to_owned(), |turn| format!("{turn:.2}°"));
        let between = match one.mesh_nodes {
            0 => "nothing".to_owned(),
            nodes => format!("{nodes} nodes, {}", length(one.mesh_sd_m)),
        };
        writeln!(
            text,
            "{:12} {:>7} {:>7} {:>7} {:>7} {:>7} {:>12} {:>12} {normal:>8}   {between}",
            one.surface,
            one.points,
            one.smooth,
            one.edge,
            one.corner,
            one.unknown,
            length(one.sd_m),
            length(one.depth_sd_m)
        )?;
    }
    writeln!(
        text,
        "\nNormals that the wall can see: a point is nearest to some point of the wall where its normal meets the wall"
    )?;
    for one in outlooks {
        writeln!(
            text,
            "{:12} {:>6.1} % of the surface, up to {:.1}° from the wall's own normal",
            one.surface,
            100.0 * one.faced,
            one.steepest_deg
        )?;
    }
    Ok(text)
}
