//! `periscope design`.

mod wall;

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Result, bail};
use clap::Args;
use periscope::bound::Use;
use periscope::bound::outlook::{Change, Outlook};
use periscope::campaign::keys::PatchRole;
use periscope::simulate::Scene;
use periscope::simulate::wall::WallScene;
use serde_json::json;

use super::output::{Format, Output, Rows, json, print, print_text};

/// Arguments of `design`.
#[derive(Args)]
pub struct Design {
    /// Scene description (TOML), as for `simulate`; or a wall and surfaces that it is to show ([wall], [surfaces.NAME])
    scene: PathBuf,
    /// Highest order of bounces that the geometry uses: 2, or 3 where the scene has hidden patches
    #[arg(long, value_name = "N")]
    bounces: Option<usize>,
    /// Signal-to-noise ratio from which a pulse counts as an onset
    #[arg(long, value_name = "SIGMA", default_value_t = 5.0)]
    threshold: f64,
    #[command(flatten)]
    output: Output,
}

/// Most blends that are listed.
const LISTED: usize = 10;

/// The command.
pub fn design(args: &Design) -> Result<ExitCode> {
    if args.threshold.is_nan() || args.threshold <= 0.0 {
        bail!("--threshold {} must be above 0", args.threshold);
    }
    if WallScene::is_in(&args.scene)? {
        if args.bounces.is_some() {
            bail!("--bounces has no meaning for a wall: first light of a surface is light of three bounces");
        }
        wall::design(&WallScene::load(&args.scene)?, args.threshold, &args.output)?;
        return Ok(ExitCode::SUCCESS);
    }
    let mut scene = Scene::load(&args.scene)?;
    let hidden = scene.patches.values().any(|disk| disk.role == PatchRole::Hidden);
    let bounces = args.bounces.unwrap_or(if hidden { 3 } else { 2 });
    if !(1..=5).contains(&bounces) {
        bail!("--bounces {bounces}: light is followed over 1 to 5");
    }
    // One order more than the geometry uses shows which pulses are too weak, and which blend.
    scene.captures.bounces = scene.captures.bounces.max(bounces).max(3);
    let outlook = Outlook::new(&scene, Use { bounces, threshold_sigma: args.threshold })?;
    match args.output.format {
        Format::Table => print_text(&text(&scene, &outlook, bounces, args.threshold)?)?,
        Format::Json => print(json(&object(&scene, &outlook))?)?,
        Format::Csv => {
            let columns =
                ["patch", "kind", "sd_m", "chance", "onsets", "snr_strongest", "shots_strongest", "hours_strongest"];
            Rows::of(&columns, object(&scene, &outlook)["patches"].as_array().expect("a list"))?.print(Format::Csv)?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn length(metres: Option<f64>) -> String {
    match metres {
        None => "-".to_owned(),
        Some(metres) if metres < 1e-4 => format!("{:.1} um", 1e6 * metres),
        Some(metres) if metres < 0.1 => format!("{:.3} mm", 1e3 * metres),
        Some(metres) => format!("{metres:.3} m"),
    }
}

fn hours(hours: f64) -> String {
    match 3600.0 * hours {
        seconds if seconds < 0.1 => format!("{:.2} ms", 1e3 * seconds),
        seconds if seconds < 360.0 => format!("{seconds:.1} s"),
        seconds if seconds < 4e5 => format!("{hours:.2} h"),
        seconds if seconds < 8e7 => format!("{:.0} days", seconds / 86_400.0),
        seconds => format!("{:.1e} years", seconds / 3.156e7),
    }
}

/// Shots and time of one profile.
fn effort(shots: f64, time_h: f64) -> String {
    match shots {
        shots if shots <= 1.0 => "one shot".to_owned(),
        shots if shots.is_finite() => format!("{shots:.1e} shots, {}", hours(time_h)),
        _ => "no light".to_owned(),
    }
}

fn text(scene: &Scene, outlook: &Outlook, bounces: usize, threshold: f64) -> Result<String, std::fmt::Error> {
    let mut text = String::new();
    let seen: usize = scene.sensors.keys().map(|sensor| scene.seen_by(sensor).len()).sum();
    let captures = scene.lit().len() * seen;
    writeln!(
        text,
        "{}: {} patches, {captures} captures of {} shots; {:.3e} pulses, {} of capture{}\n",
        scene.name,
        scene.patches.len(),
        scene.captures.shots,
        outlook.pulses,
        hours(outlook.hours),
        if scene.instrument.snr.is_some() { " (signal-to-noise ratio set, not derived)" } else { "" }
    )?;
    positions(&mut text, outlook, bounces)?;
    orders(&mut text, outlook, threshold)?;
    blends(&mut text, outlook)?;
    if !outlook.ambiguities.is_empty() {
        writeln!(text, "\nWhat the data leave open")?;
        for open in &outlook.ambiguities {
            writeln!(text, "  {open}")?;
        }
    }
    changes(&mut text, outlook)?;
    Ok(text)
}

fn positions(text: &mut String, outlook: &Outlook, bounces: usize) -> std::fmt::Result {
    writeln!(text, "Positions, from bounces up to order {bounces} (Cramer-Rao bound of an unbiased estimate)")?;
    writeln!(
        text,
        "{:>7} {:8} {:>12} {:>8} {:>7} {:>10}   a profile to the threshold",
        "patch", "kind", "sd", "found", "onsets", "strongest"
    )?;
    for row in &outlook.patches {
        writeln!(
            text,
            "{:>7} {:8} {:>12} {:>7.1}% {:>7} {:>10.2e}   {}",
            row.patch,
            row.kind,
            length(row.sd_m),
            100.0 * row.chance,
            row.onsets,
            row.snr,
            effort(row.shots, row.hours)
        )?;
    }
    Ok(())
}

fn orders(text: &mut String, outlook: &Outlook, threshold: f64) -> std::fmt::Result {
    writeln!(
        text,
        "\nBounces, by the signal-to-noise ratio of the averaged pulse, and what it takes a profile to bring one to the threshold of {threshold}"
    )?;
    writeln!(
        text,
        "{:>7} {:>7} {:>7} {:>9} {:>9} {:>9}   strongest needs            median needs",
        "order", "paths", "found", "least", "median", "most"
    )?;
    for row in &outlook.orders {
        let [least, median, most] = row.snr;
        let needs = |k: usize| effort(row.shots[k], row.hours[k]);
        writeln!(
            text,
            "{:>7} {:>7} {:>7} {least:>9.2e} {median:>9.2e} {most:>9.2e}   {:26} {}",
            row.bounces,
            row.paths,
            row.onsets,
            needs(1),
            needs(0)
        )?;
    }
    Ok(())
}

fn blends(text: &mut String, outlook: &Outlook) -> std::fmt::Result {
    if !outlook.blends.is_empty() {
        writeln!(text, "\nPulses that are seen as one: {} pairs", outlook.blends.len())?;
        for blend in outlook.blends.iter().take(LISTED) {
            let [a, b] = &blend.paths;
            writeln!(
                text,
                "  sensor {}, lit {}, seen {}: paths {a:?} and {b:?}, {:.1} ps apart",
                blend.sensor, blend.lit, blend.seen, blend.apart_ps
            )?;
        }
        if outlook.blends.len() > LISTED {
            writeln!(text, "  and {} more (--format json lists all)", outlook.blends.len() - LISTED)?;
        }
    }
    Ok(())
}

fn changes(text: &mut String, outlook: &Outlook) -> std::fmt::Result {
    writeln!(text, "\nWhat a change would bring (root mean square over patches)")?;
    writeln!(text, "{:44} {:>12} {:>12} {:>7} {:>10}", "", "visible", "hidden", "onsets", "capture")?;
    for row in &outlook.changes {
        writeln!(
            text,
            "{:44} {:>12} {:>12} {:>7} {:>10}",
            row.what,
            length(row.visible_m),
            length(row.hidden_m),
            row.onsets,
            hours(row.hours)
        )?;
    }
    Ok(())
}

/// JSON has no infinity: a value that no number of shots reaches becomes null.
fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

fn object(scene: &Scene, outlook: &Outlook) -> serde_json::Value {
    let change = |row: &Change| json!({"change": row.what, "visible_sd_m": row.visible_m, "hidden_sd_m": row.hidden_m, "onsets": row.onsets, "hours": row.hours});
    json!({
        "scene": scene.name,
        "snr_was_set": scene.instrument.snr.is_some(),
        "pulses": outlook.pulses,
        "hours": outlook.hours,
        "patches": outlook.patches.iter().map(|row| json!({
            "patch": row.patch, "kind": row.kind, "sd_m": row.sd_m, "covariance_m2": row.covariance_m2, "chance": row.chance, "onsets": row.onsets,
            "snr_strongest": row.snr, "shots_strongest": finite(row.shots), "hours_strongest": finite(row.hours),
        })).collect::<Vec<_>>(),
        "bounces": outlook.orders.iter().map(|row| json!({
            "order": row.bounces, "paths": row.paths, "found": row.onsets, "snr_least": row.snr[0], "snr_median": row.snr[1],
            "snr_most": row.snr[2], "shots_median": finite(row.shots[0]), "shots_strongest": finite(row.shots[1]),
            "hours_median": finite(row.hours[0]), "hours_strongest": finite(row.hours[1]),
        })).collect::<Vec<_>>(),
        "blends": outlook.blends.iter().map(|row| json!({
            "sensor": row.sensor, "lit": row.lit, "seen": row.seen, "paths": row.paths, "apart_ps": row.apart_ps,
        })).collect::<Vec<_>>(),
        "ambiguities": outlook.ambiguities,
        "changes": outlook.changes.iter().map(change).collect::<Vec<_>>(),
    })
}
