//! `periscope design`.

mod wall;

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Result, bail};
use clap::Args;
use periscope::bound::design::Design;
use periscope::bound::outlook::Outlook;
use periscope::simulate::Scene;
use periscope::simulate::wall::WallScene;

use super::output::{Format, Output, Rows, count, json, print, print_text};

/// Arguments of `design`.
#[derive(Args)]
pub struct Arguments {
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
pub fn design(args: &Arguments) -> Result<ExitCode> {
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
    let scene = Scene::load(&args.scene)?;
    if let Some(bounces) = args.bounces.filter(|bounces| !(1..=5).contains(bounces)) {
        bail!("--bounces {bounces}: light is followed over 1 to 5");
    }
    let design = Design::new(scene, args.bounces, args.threshold)?;
    match args.output.format {
        Format::Table => print_text(&text(&design)?)?,
        Format::Json => print(json(&design.object())?)?,
        Format::Csv => {
            let columns =
                ["patch", "kind", "sd_m", "chance", "onsets", "snr_strongest", "shots_strongest", "hours_strongest"];
            Rows::of(&columns, design.object()["patches"].as_array().expect("a list"))?.print(Format::Csv)?;
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

fn text(design: &Design) -> Result<String, std::fmt::Error> {
    let Design { scene, bounces, threshold_sigma, outlook } = design;
    let mut text = String::new();
    let seen: usize = scene.sensors.keys().map(|sensor| scene.seen_by(sensor).len()).sum();
    let captures = scene.lit().len() * seen;
    writeln!(
        text,
        "{}: {}, {} of {}; {:.3e} laser pulses, {} of capture{}\n",
        scene.name,
        count(scene.patches.len(), "patch", "patches"),
        count(captures, "capture", "captures"),
        count(scene.captures.shots, "shot", "shots"),
        outlook.pulses,
        hours(outlook.hours),
        if scene.instrument.snr.is_some() { " (signal-to-noise ratio set, not derived)" } else { "" }
    )?;
    positions(&mut text, outlook, *bounces)?;
    orders(&mut text, outlook, *threshold_sigma)?;
    blends(&mut text, outlook)?;
    if !outlook.ambiguities.is_empty() {
        writeln!(text, "\nWhat the data do not determine")?;
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
        writeln!(text, "\nPulses too close to separate: {}", count(outlook.blends.len(), "pair", "pairs"))?;
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
