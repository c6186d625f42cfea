//! Writes the raw files of a simulated campaign: the shots of a capture in the format of some instrument.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use super::calendar;
use super::chain::{Chain, Setting};
use super::folder::{create, or_write_error};
use super::recorder::{Shot, Shots};
use super::scene::Scene;
use super::session::Shooting;
use super::{Format, SimulateError};
use crate::formats::{csv, keysight_bin, lecroy_trc, npy, tek_wfm};

/// Name of the instrument in the files' headers.
const INSTRUMENT: &str = "PERISCOPE-SIM";

impl Format {
    /// Extension of its files.
    pub(super) const fn extension(self) -> &'static str {
        match self {
            Self::Trc => "trc",
            Self::Wfm => "wfm",
            Self::Bin => "bin",
            Self::Npy => "npy",
            Self::Csv => "csv",
        }
    }
}

/// One channel of one capture.
struct Channel<'a> {
    scene: &'a Scene,
    /// From 1.
    number: usize,
    setting: &'a Setting,
    start_s: f64,
    shots: &'a [Shot],
}

/// Writes the channels of one capture: `stem_C1`, and `stem_C2` for the reference; in CSV, one file per shot.
pub(super) fn write_shots(
    out: &Path,
    scene: &Scene,
    chain: &Chain,
    format: Format,
    shooting: &Shooting,
    shots: &Shots,
) -> Result<(), SimulateError> {
    let reference = chain.reference_setting(&scene.instrument);
    let channels = [(Some(&shots.signal), Some(&shooting.setting)), (shots.reference.as_ref(), reference.as_ref())];
    for (i, (shots, setting)) in channels.into_iter().enumerate() {
        let Some((shots, setting)) = shots.zip(setting) else {
            continue;
        };
        let channel = Channel { scene, number: i + 1, setting, start_s: shooting.start_s, shots };
        let end = format!("C{}.{}", channel.number, format.extension());
        if format == Format::Csv {
            for (number, shot) in shots.iter().enumerate() {
                let path = out.join(format!("{}_{number:05}_{end}", shooting.stem));
                save(&path, |file| csv::write(file, shot.1, channel.dt_s(), &channel.volts(shot)))?;
            }
            continue;
        }
        save(&out.join(format!("{}_{end}", shooting.stem)), |file| channel.write(format, file))?;
    }
    Ok(())
}

/// Writes the histogram of one capture of a photon counter.
pub(super) fn write_histogram(out: &Path, shooting: &Shooting, counts: &[i32]) -> Result<(), SimulateError> {
    let path = out.join(format!("{}_C1.npy", shooting.stem));
    save(&path, |file| npy::write(file, &[1, counts.len() as u64], counts))
}

fn save(path: &Path, write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> Result<(), SimulateError> {
    let mut file = create(path)?;
    let result = write(&mut file);
    or_write_error(path, result.and_then(|()| file.flush()))
}

impl Channel<'_> {
    fn dt_s(&self) -> f64 {
        self.scene.instrument.dt_ps * 1e-12
    }

    fn volts(&self, (_, _, codes): &Shot) -> Vec<f64> {
        let (gain_v, offset_v) = self.setting.scale(self.scene.instrument.bits);
        codes.iter().map(|code| f64::from(*code) * gain_v + offset_v).collect()
    }

    fn write(&self, format: Format, file: &mut impl Write) -> io::Result<()> {
        let bits = self.scene.instrument.bits;
        let (gain_v, offset_v) = self.setting.scale(bits);
        match format {
            Format::Csv => unreachable!("a CSV holds one shot"),
            Format::Npy => self.write_npy(file),
            Format::Trc => {
                let head = lecroy_trc::SequenceHead {
                    instrument: INSTRUMENT.to_owned(),
                    channel: self.number as i16 - 1,
                    gain_v: gain_v as f32,
                    // LeCroy subtracts the offset.
                    offset_v: -offset_v as f32,
                    dt_s: self.dt_s() as f32,
                    bits,
                    acquired: calendar::acquired(self.start_s),
                };
                lecroy_trc::write_sequence(file, &head, self.shots)
            }
            Format::Wfm => {
                let label = format!("CH{}", self.number);
                let acquired = calendar::unix(self.start_s);
                let head = tek_wfm::FrameHead { label, gain_v, offset_v, dt_s: self.dt_s(), bits, acquired };
                tek_wfm::write(file, &head, self.shots)
            }
            Format::Bin => {
                let (instrument, label) = (format!("{INSTRUMENT}:1"), self.number.to_string());
                let head = keysight_bin::VoltsHead { instrument, label, dt_s: self.dt_s() };
                let float = |shot: &Shot| self.volts(shot).into_iter().map(|volts| volts as f32).collect();
                let segments: Vec<_> = self.shots.iter().map(|shot| (shot.0, shot.1, float(shot))).collect();
                keysight_bin::write(file, &head, &segments)
            }
        }
    }

    fn write_npy(&self, file: &mut impl Write) -> io::Result<()> {
        let shape = [self.shots.len() as u64, self.scene.instrument.samples as u64];
        let codes = || self.shots.iter().flat_map(|(_, _, codes)| codes.iter().copied());
        if self.scene.instrument.bits == 8 {
            npy::write(file, &shape, &codes().map(|code| code as i8).collect::<Vec<_>>())
        } else {
            npy::write(file, &shape, &codes().collect::<Vec<_>>())
        }
    }
}
