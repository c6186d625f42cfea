//! `periscope design` of a relay wall: what first light of a surface would show.

use std::fmt::Write as _;

use anyhow::Result;
use periscope::cancel::Cancel;
use periscope::parameter::Positive;
use periscope::simulate::wall::{Wall, WallScene};
use periscope::wall_outlook::WallOutlook;

use super::length;
use crate::commands::output::{Format, Output, Rows, count, json, print, print_text};

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
    let outlooks = WallOutlook::all(scene, threshold_sigma, &Cancel::never());
    match output.format {
        Format::Table => print_text(&text(&scene.wall, &outlooks)?)?,
        Format::Json => print(json(&outlooks)?)?,
        Format::Csv => Rows::of(&COLUMNS, &outlooks)?.print(Format::Csv)?,
    }
    Ok(())
}

fn text(wall: &Wall, outlooks: &[WallOutlook]) -> Result<String, std::fmt::Error> {
    let mut text = String::new();
    let ([width_m, height_m], [columns, rows]) = (wall.size_m.map(Positive::get), wall.points);
    writeln!(
        text,
        "A wall of {width_m} x {height_m} m, {columns} x {rows} points, each lit and seen itself; {} photons of the surface in a mean histogram, background of {} counts in each bin; bins of {} ps, a response of {} ps\n",
        wall.photons.get(),
        wall.background.get(),
        wall.bin_ps.get(),
        wall.fwhm_ps.get()
    )?;
    writeln!(text, "Points that first light would show, and medians of their standard deviations")?;
    writeln!(
        text,
        "{:12} {:>7} {:>7} {:>7} {:>7} {:>7} {:>12} {:>12} {:>8}   between points",
        "surface", "points", "smooth", "edge", "corner", "unknown", "sd", "in depth", "normal"
    )?;
    for one in outlooks {
        let normal = one.normal_sd_deg.map_or("-".to_owned(), |turn| format!("{turn:.2}°"));
        let between = match one.mesh_nodes {
            0 => "nothing".to_owned(),
            nodes => format!("{}, {}", count(nodes, "node", "nodes"), length(one.mesh_sd_m)),
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
