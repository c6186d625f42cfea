//! The campaign folder that a simulation leaves: raw files, campaign.toml, truth.

use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write as _};
use std::path::Path;

use super::instrument::Shots;
use super::scene::{Instrument, Scene};
use super::{Format, SimulateError, Truth};
use crate::campaign::walk::TRUTH;
use crate::formats::{lecroy_trc, npy};
use crate::store::TableWriter;
use crate::tables::Row;

fn written<T>(path: &Path, result: io::Result<T>) -> Result<T, SimulateError> {
    result.map_err(|source| SimulateError::Write { path: path.to_owned(), source })
}

/// Makes sure that the folder is there and empty.
pub fn claim(out: &Path) -> Result<(), SimulateError> {
    written(out, fs::create_dir_all(out))?;
    if written(out, fs::read_dir(out))?.next().is_some() {
        return Err(SimulateError::InUse { folder: out.to_owned() });
    }
    Ok(())
}

/// Volts per stored code, and volts at code 0: a converter of more than 8 bits fills the upper bits of a word.
fn scale(instrument: &Instrument) -> (f64, f64) {
    let step = if instrument.bits == 8 { 1.0 } else { f64::from(1_u32 << (16 - instrument.bits)) };
    (instrument.gain_v() / step, instrument.offset_v())
}

fn extension(format: Format) -> &'static str {
    match format {
        Format::Trc => "trc",
        Format::Npy => "npy",
    }
}

/// Writes the channels of one capture: `stem_C1`, and `stem_C2` for the reference.
pub fn write_shots(out: &Path, stem: &str, scene: &Scene, format: Format, shots: &Shots) -> Result<(), SimulateError> {
    let channels = std::iter::once(&shots.signal).chain(&shots.reference);
    for (channel, records) in channels.enumerate() {
        let path = out.join(format!("{stem}_C{}.{}", channel + 1, extension(format)));
        written(&path, fs::create_dir_all(path.parent().expect("a file lies in a folder")))?;
        let mut file = BufWriter::new(written(&path, File::create(&path))?);
        let result = match format {
            Format::Trc => write_trc(&mut file, scene, channel, records),
            Format::Npy => write_npy(&mut file, scene, records),
        };
        written(&path, result.and_then(|()| file.flush()))?;
    }
    Ok(())
}

fn write_trc(
    file: &mut impl io::Write,
    scene: &Scene,
    channel: usize,
    records: &[(f64, f64, Vec<i16>)],
) -> io::Result<()> {
    let (gain_v, offset_v) = scale(&scene.instrument);
    let head = lecroy_trc::SequenceHead {
        instrument: "PERISCOPE-SIM".to_owned(),
        channel: channel as i16,
        gain_v: gain_v as f32,
        // LeCroy's offset is taken off.
        offset_v: -offset_v as f32,
        dt_s: (scene.instrument.dt_ps * 1e-12) as f32,
        bits: scene.instrument.bits,
    };
    lecroy_trc::write_sequence(file, &head, records)
}

fn write_npy(file: &mut impl io::Write, scene: &Scene, records: &[(f64, f64, Vec<i16>)]) -> io::Result<()> {
    let shape = [records.len() as u64, scene.instrument.samples as u64];
    let codes = || records.iter().flat_map(|(_, _, codes)| codes.iter().copied());
    if scene.instrument.bits == 8 {
        npy::write(file, &shape, &codes().map(|code| code as i8).collect::<Vec<_>>())
    } else {
        npy::write(file, &shape, &codes().collect::<Vec<_>>())
    }
}

/// Writes campaign.toml: what a lab would know, which the truth is not.
pub fn write_campaign(out: &Path, scene: &Scene, format: Format) -> Result<(), SimulateError> {
    let path = out.join("campaign.toml");
    written(&path, fs::write(&path, campaign_text(scene, format)))
}

fn campaign_text(scene: &Scene, format: Format) -> String {
    let mut text = String::from("# A simulated campaign. What is true lies in truth/, which no stage reads.\n");
    let mut line = |line: String| writeln!(text, "{line}").expect("a String takes all text");
    line(format!(
        "[campaign]\nname = {:?}\ngroup_index = {:?}\ndimensions = {}",
        scene.name, scene.group_index, scene.dimensions
    ));
    for (name, station) in &scene.stations {
        line(format!("\n[stations.{name}]\nposition_m = {:?}", station.position_m));
    }
    for (name, sensor) in &scene.sensors {
        line(format!("\n[sensors.{name}]"));
        if let Some(station) = &sensor.station {
            line(format!("station = {station:?}"));
        }
    }
    line(String::new());
    for patch in scene.patches.keys() {
        line(format!("[patches.{patch}]\nrole = \"visible\""));
    }
    let reference = scene.instrument.reference.is_some();
    let mut rule = |role: &str, stem: &str, more: String| {
        let end = extension(format);
        line(format!("\n[[captures]]\nrole = \"{role}\"\nfiles = \"{stem}_C1.{end}\""));
        if reference {
            line(format!("reference = {{ files = \"{stem}_C2.{end}\" }}"));
        }
        line(format!("segments = \"shot\"{more}"));
        if format == Format::Npy {
            let (gain_v, offset_v) = scale(&scene.instrument);
            let Instrument { dt_ps, t0_ps, .. } = scene.instrument;
            line(format!("dt_ps = {dt_ps:?}\nt0_ps = {t0_ps:?}\ngain_v = {gain_v:?}\noffset_v = {offset_v:?}"));
        }
    };
    rule("scene", "raw/scene/{sensor}_L{lit}_P{seen}", String::new());
    let path = format!("\npath_m = {:?}\npath_sd_m = {:?}", scene.captures.path_m, scene.captures.path_sd_m);
    rule("response", "raw/response/{sensor}", path);
    text
}

/// Writes the truth: tables of the pipeline's own schemas, and the scene with its seed.
pub fn write_truth(out: &Path, scene: &Scene, seed: u64, truth: &Truth) -> Result<(), SimulateError> {
    write_table(out, &truth.patches)?;
    write_table(out, &truth.onsets)?;
    write_table(out, &truth.calibration)?;
    let path = out.join(TRUTH).join("scene.toml");
    written(&path, fs::write(&path, format!("# Simulated with seed {seed}.\n{}", scene.text)))
}

fn write_table<R: Row>(out: &Path, rows: &[R]) -> Result<(), SimulateError> {
    let folder = out.join(TRUTH).join(R::TABLE);
    written(&folder, fs::create_dir_all(&folder))?;
    let path = folder.join("truth.parquet");
    let result = TableWriter::create(&path, &R::schema()).and_then(|mut writer| {
        writer.write(&R::to_batch(rows))?;
        writer.finish(&[])
    });
    result.map(|_| ()).map_err(|error| SimulateError::Write { path, source: io::Error::other(error) })
}
