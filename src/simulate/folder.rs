//! The campaign folder that a simulation writes: raw files, campaign.toml, truth.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::{self, BufWriter};
use std::path::Path;

use super::prior::PriorKeys;
use super::scene::Scene;
use super::session::Shooting;
use super::{Format, SimulateError, Truth};
use crate::campaign::Role;
use crate::campaign::keys::{PatchRole, SensorKind};
use crate::campaign::walk::TRUTH;
use crate::store::TableWriter;
use crate::tables::Row;

/// Table of the fiducial captures, since a pattern cannot distinguish them.
const FIDUCIALS: &str = "fiducials.csv";

pub(super) fn or_write_error<T>(path: &Path, result: io::Result<T>) -> Result<T, SimulateError> {
    result.map_err(|source| SimulateError::Write { path: path.to_owned(), source })
}

/// Creates the folder, and checks that it is empty.
pub fn claim(out: &Path) -> Result<(), SimulateError> {
    or_write_error(out, fs::create_dir_all(out))?;
    if or_write_error(out, fs::read_dir(out))?.next().is_some() {
        return Err(SimulateError::InUse { folder: out.to_owned() });
    }
    Ok(())
}

/// Creates a file and its parent folders.
pub(super) fn create(path: &Path) -> Result<BufWriter<File>, SimulateError> {
    or_write_error(path, fs::create_dir_all(path.parent().expect("a file lies in a folder")))?;
    Ok(BufWriter::new(or_write_error(path, File::create(path))?))
}

/// Writes campaign.toml with what a lab would know; the truth stays out.
pub fn write_campaign(
    out: &Path,
    scene: &Scene,
    seed: u64,
    format: Format,
    shootings: &[Shooting],
) -> Result<(), SimulateError> {
    if shootings.iter().any(|shooting| shooting.role == Role::Fiducial) {
        let path = out.join(FIDUCIALS);
        or_write_error(&path, fs::write(&path, fiducials_text(scene, format, shootings)))?;
    }
    let path = out.join("campaign.toml");
    or_write_error(&path, fs::write(&path, campaign_text(scene, seed, format, shootings)))
}

fn campaign_text(scene: &Scene, seed: u64, format: Format, shootings: &[Shooting]) -> String {
    let mut text = String::from("# A simulated campaign. What is true lies in truth/, which no stage reads.\n");
    let mut line = |line: String| writeln!(text, "{line}").expect("a String takes all text");
    line(format!(
        "[campaign]\nname = {:?}\ngroup_index = {:?}\ndimensions = {}",
        scene.name, scene.group_index, scene.dimensions
    ));
    if let Some(repetition_ps) = scene.repetition_ps().filter(|_| scene.wraps()) {
        line(format!("repetition_ps = {repetition_ps:?}"));
    }
    let mut prior_keys = PriorKeys::new(scene, seed);
    for name in scene.stations.keys() {
        line(format!("\n[stations.{name}]\n{}", prior_keys.station(name)));
    }
    for (name, sensor) in &scene.sensors {
        line(format!("\n[sensors.{name}]"));
        if let Some(station) = &sensor.station {
            line(format!("station = {station:?}"));
        }
        if let Some(counts) = scene.instrument.counts.filter(|_| sensor.kind == SensorKind::Counts) {
            line(format!("kind = \"counts\"\ncycles = {}", scene.captures.shots));
            if counts.dead_time_ps > 0.0 {
                line(format!("dead_time_ps = {:?}", counts.dead_time_ps));
            }
        }
    }
    line(String::new());
    for (patch, disk) in &scene.patches {
        match disk.role {
            PatchRole::Visible => {
                line(format!("[patches.{patch}]\nrole = \"visible\"{}", prior_keys.patch(*patch)));
            }
            PatchRole::Mirror => line(format!("[patches.{patch}]\nrole = \"mirror\"{}", prior_keys.patch(*patch))),
            PatchRole::Hidden => {
                if let Some(exit) = scene.prior.strips.get(patch) {
                    line(format!("[patches.{patch}]\nrole = \"hidden\"\nthrough = {exit}{}", prior_keys.patch(*patch)));
                }
            }
        }
    }
    for (view, covers) in &scene.views {
        line(format!("[views.{view}]\npatches = {:?}", covers.patches));
    }
    if scene.prior.apart_max_m.is_some() || scene.prior.along.is_some() {
        line("\n[hidden]".to_owned());
        scene.prior.apart_max_m.iter().for_each(|apart_max_m| line(format!("apart_max_m = {apart_max_m:?}")));
        scene.prior.along.iter().for_each(|along| line(format!("along = {along:?}")));
    }
    let mut rules = BTreeSet::new();
    for shooting in shootings.iter().filter(|shooting| shooting.role != Role::Fiducial) {
        let rule = rule_text(scene, format, shooting);
        if rules.insert(rule.clone()) {
            line(rule);
        }
    }
    if shootings.iter().any(|shooting| shooting.role == Role::Fiducial) {
        line(format!("\n[[captures]]\nrole = \"fiducial\"\ntable = \"{FIDUCIALS}\"\nsegments = \"shot\""));
    }
    text
}

/// The rule for a capture's files.
fn rule_text(scene: &Scene, format: Format, shooting: &Shooting) -> String {
    let format = if shooting.counts { Format::Npy } else { format };
    let shot = if format == Format::Csv { "_{shot}" } else { "" };
    let stem = match shooting.role {
        Role::Scene => {
            let end = format!("{}_L{}_P{}", shooting.sensor, shooting.lit, shooting.seen);
            shooting.stem.replace(&end, "{sensor}_L{lit}_P{seen}")
        }
        _ => shooting.stem.clone(),
    };
    let end = format.extension();
    let role = shooting.role.name();
    let mut text = format!("\n[[captures]]\nrole = \"{role}\"\nfiles = \"{stem}{shot}_C1.{end}\"\n");
    let mut line = |line: String| writeln!(text, "{line}").expect("a String takes all text");
    if shooting.role != Role::Scene {
        line(format!("sensor = {:?}", shooting.sensor));
    }
    if scene.instrument.reference.is_some() && shooting.fires && !shooting.counts {
        line(format!("reference = {{ files = \"{stem}{shot}_C2.{end}\" }}"));
    }
    if let Some(range) = &shooting.setting.name {
        line(format!("range = {range:?}"));
    }
    line("segments = \"shot\"".to_owned());
    if shooting.role == Role::Response {
        line(format!("path_m = {:?}\npath_sd_m = {:?}", scene.captures.path_m, scene.captures.path_sd_m));
    }
    if shooting.attenuation_od > 0.0 {
        line(format!("attenuation_od = {:?}", shooting.attenuation_od));
    }
    if format == Format::Npy {
        let (dt_ps, t0_ps) = (scene.instrument.dt_ps, scene.instrument.t0_ps);
        let (gain_v, offset_v) =
            if shooting.counts { (1.0, 0.0) } else { shooting.setting.scale(scene.instrument.bits) };
        line(format!("dt_ps = {dt_ps:?}\nt0_ps = {t0_ps:?}\ngain_v = {gain_v:?}\noffset_v = {offset_v:?}"));
    }
    text
}

/// The table of fiducial captures, one row per file.
fn fiducials_text(scene: &Scene, format: Format, shootings: &[Shooting]) -> String {
    let mut text = String::from(
        "file,reference_file,sensor,range,path_m,path_sd_m,attenuation_od,bounces,shot,dt_ps,t0_ps,gain_v,offset_v\n",
    );
    for shooting in shootings.iter().filter(|shooting| shooting.role == Role::Fiducial) {
        let files = if format == Format::Csv { shooting.shots } else { 1 };
        for number in 0..files {
            let format = if shooting.counts { Format::Npy } else { format };
            let shot = if format == Format::Csv { format!("_{number:05}") } else { String::new() };
            let file = |channel: usize| format!("{}{shot}_C{channel}.{}", shooting.stem, format.extension());
            let reference =
                if scene.instrument.reference.is_some() && !shooting.counts { file(2) } else { String::new() };
            let number = if format == Format::Csv { number.to_string() } else { String::new() };
            let base = if format == Format::Npy {
                let (gain_v, offset_v) =
                    if shooting.counts { (1.0, 0.0) } else { shooting.setting.scale(scene.instrument.bits) };
                format!("{:?},{:?},{gain_v:?},{offset_v:?}", scene.instrument.dt_ps, scene.instrument.t0_ps)
            } else {
                ",,,".to_owned()
            };
            let cell = |value: Option<f64>| value.map_or(String::new(), |value| format!("{value:?}"));
            let path_sd_m = shooting.path_m.map(|_| scene.captures.path_sd_m).filter(|sd_m| *sd_m > 0.0);
            writeln!(
                text,
                "{},{reference},{},{},{},{},{:?},{},{number},{base}",
                file(1),
                shooting.sensor,
                shooting.setting.name.as_deref().unwrap_or(""),
                cell(shooting.path_m),
                cell(path_sd_m),
                shooting.attenuation_od,
                shooting.bounces.unwrap_or(1),
            )
            .expect("a String takes all text");
        }
    }
    text
}

/// Writes the truth: tables with the pipeline's schemas, tables that only a simulation can fill, and the scene with its
/// seed.
pub fn write_truth(out: &Path, scene: &Scene, seed: u64, truth: &Truth) -> Result<(), SimulateError> {
    write_table(out, &truth.patches)?;
    write_table(out, &truth.onsets)?;
    write_table(out, &truth.calibration)?;
    write_table(out, &truth.paths)?;
    write_table(out, &truth.centroids)?;
    write_table(out, &truth.captures)?;
    let path = out.join(TRUTH).join("scene.toml");
    or_write_error(&path, fs::write(&path, format!("# Simulated with seed {seed}.\n{}", scene.text)))
}

fn write_table<R: Row>(out: &Path, rows: &[R]) -> Result<(), SimulateError> {
    let folder = out.join(TRUTH).join(R::TABLE);
    or_write_error(&folder, fs::create_dir_all(&folder))?;
    let path = folder.join("truth.parquet");
    let result = TableWriter::create(&path, &R::schema()).and_then(|mut writer| {
        writer.write(&R::to_batch(rows))?;
        writer.finish(&[])
    });
    result.map(|_| ()).map_err(|error| SimulateError::Write { path, source: io::Error::other(error) })
}
