//! `periscope design`.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Result, bail};
use clap::Args;
use periscope::bound::Use;
use periscope::bound::outlook::{Change, Outlook};
use periscope::campaign::keys::PatchRole;
use periscope::simulate::Scene;
use serde_json::json;

/// Arguments of `design`.
#[derive(Args)]
pub struct Design {
    /// Scene description (TOML), as for `simulate`
    scene: PathBuf,
    /// Highest order of bounces that the geometry uses: 2, or 3 where the scene has hidden patches
    #[arg(long, value_name = "N")]
    bounces: Option<usize>,
    /// Signal-to-noise ratio from which a pulse counts as an onset
    #[arg(long, value_name = "SIGMA", default_value_t = 5.0)]
    threshold: f64,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// Blends that are listed one by one.
const LISTED: usize = 10;

/// The command.
pub fn design(args: &Design) -> Result<ExitCode> {
    let mut scene = Scene::load(&args.scene)?;
    if args.threshold.is_nan() || args.threshold <= 0.0 {
        bail!("--threshold {} must be above 0", args.threshold);
    }
    let hidden = scene.patches.values().any(|disk| disk.role == PatchRole::Hidden);
    let bounces = args.bounces.unwrap_or(if hidden { 3 } else { 2 });
    if !(1..=5).contains(&bounces) {
        bail!("--bounces {bounces}: light is followed over 1 to 5");
    }
    // One order more than is used shows what drowns, and what blends.
    scene.captures.bounces = scene.captures.bounces.max(bounces).max(3);
    let outlook = Outlook::new(&scene, Use { bounces, threshold_sigma: args.threshold })?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&object(&scene, &outlook))?);
    } else {
        print(&scene, &outlook, bounces, args.threshold);
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
    if hours < 0.1 { format!("{:.1} s", 3600.0 * hours) } else { format!("{hours:.2} h") }
}

fn print(scene: &Scene, outlook: &Outlook, bounces: usize, threshold: f64) {
    let captures = scene.lit().len() * scene.seen().len() * scene.sensors.len();
    println!(
        "{}: {} patches, {captures} captures of {} shots; {:.3e} pulses, {} of capture{}\n",
        scene.name,
        scene.patches.len(),
        scene.captures.shots,
        outlook.pulses,
        hours(outlook.hours),
        if scene.instrument.snr.is_some() { " (signal-to-noise ratio set, not derived)" } else { "" }
    );
    println!("Positions, from bounces up to order {bounces} (Cramer-Rao bound of an unbiased estimate)");
    println!("{:>7} {:8} {:>12} {:>8} {:>7}", "patch", "kind", "sd", "found", "onsets");
    for row in &outlook.patches {
        println!(
            "{:>7} {:8} {:>12} {:>7.1}% {:>7}",
            row.patch,
            row.kind,
            length(row.sd_m),
            100.0 * row.chance,
            row.onsets
        );
    }
    println!("\nBounces, by the signal-to-noise ratio of the averaged pulse (threshold {threshold})");
    println!(
        "{:>7} {:>7} {:>7} {:>10} {:>10} {:>10}  the median needs",
        "order", "paths", "found", "least", "median", "most"
    );
    for row in &outlook.orders {
        let needs = if row.shots_factor > 1.0 {
            format!("{:.2e} times the shots", row.shots_factor)
        } else {
            "no more shots".to_owned()
        };
        let [least, median, most] = row.snr;
        println!(
            "{:>7} {:>7} {:>7} {least:>10.2e} {median:>10.2e} {most:>10.2e}  {needs}",
            row.bounces, row.paths, row.found
        );
    }
    if !outlook.blends.is_empty() {
        println!("\nPulses that are seen as one: {} pairs", outlook.blends.len());
        for blend in outlook.blends.iter().take(LISTED) {
            let [a, b] = &blend.paths;
            println!(
                "  sensor {}, lit {}, seen {}: paths {a:?} and {b:?}, {:.1} ps apart",
                blend.sensor, blend.lit, blend.seen, blend.apart_ps
            );
        }
        if outlook.blends.len() > LISTED {
            println!("  and {} more (--json lists all)", outlook.blends.len() - LISTED);
        }
    }
    if !outlook.ambiguities.is_empty() {
        println!("\nWhat the data leave open");
        outlook.ambiguities.iter().for_each(|text| println!("  {text}"));
    }
    println!("\nWhat a change would bring (root mean square over patches)");
    println!("{:44} {:>12} {:>12} {:>7} {:>10}", "", "visible", "hidden", "onsets", "capture");
    for row in &outlook.changes {
        println!(
            "{:44} {:>12} {:>12} {:>7} {:>10}",
            row.what,
            length(row.visible_m),
            length(row.hidden_m),
            row.onsets,
            hours(row.hours)
        );
    }
}

fn object(scene: &Scene, outlook: &Outlook) -> serde_json::Value {
    let change = |row: &Change| json!({"change": row.what, "visible_sd_m": row.visible_m, "hidden_sd_m": row.hidden_m, "onsets": row.onsets, "hours": row.hours});
    json!({
        "scene": scene.name,
        "snr_was_set": scene.instrument.snr.is_some(),
        "pulses": outlook.pulses,
        "hours": outlook.hours,
        "patches": outlook.patches.iter().map(|row| json!({
            "patch": row.patch, "kind": row.kind, "sd_m": row.sd_m, "chance": row.chance, "onsets": row.onsets,
        })).collect::<Vec<_>>(),
        "bounces": outlook.orders.iter().map(|row| json!({
            "order": row.bounces, "paths": row.paths, "found": row.found, "snr_least": row.snr[0], "snr_median": row.snr[1],
            "snr_most": row.snr[2], "shots_factor": row.shots_factor,
        })).collect::<Vec<_>>(),
        "blends": outlook.blends.iter().map(|row| json!({
            "sensor": row.sensor, "lit": row.lit, "seen": row.seen, "paths": row.paths, "apart_ps": row.apart_ps,
        })).collect::<Vec<_>>(),
        "ambiguities": outlook.ambiguities,
        "changes": outlook.changes.iter().map(change).collect::<Vec<_>>(),
    })
}
