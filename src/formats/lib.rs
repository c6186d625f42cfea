//! Readers for the files of oscilloscopes, digitisers and photon counters. Each file becomes a list of records: one
//! [`Record`] is one segment of one channel, as codes with the numbers that turn them into volts and seconds.
//!
//! The crate finds the format by content first, then by extension. It reads headers at once and samples on demand, so a
//! file may be larger than memory. Reading is pure Rust, without `unsafe`.
//!
//! # Example
//!
//! Open a file, whatever its format, and print its samples:
//!
//! ```
//! # let folder = std::env::temp_dir().join(format!("periscope-formats-{}", std::process::id()));
//! # std::fs::create_dir_all(&folder)?;
//! # let path = folder.join("pulse.csv");
//! // A file to read: four samples, 500 ps apart, the first 1 ns before the trigger.
//! periscope_formats::csv::write(&mut std::fs::File::create(&path)?, -1e-9, 500e-12, &[0.0, 0.02, 0.31, 0.12])?;
//!
//! let mut file = periscope_formats::Source::open(&path)?;
//! for record in periscope_formats::records(&mut file)? {
//!     println!("{}, channel {:?}: {} samples", record.head.format, record.head.channel, record.head.samples);
//!     for (sample, value) in file.values(&record)?.into_iter().enumerate() {
//!         match record.time_s(sample) {
//!             Some(time_s) => println!("{time_s:e} s  {value} V"),
//!             None => println!("sample {sample}  {value}"), // this format has no time base
//!         }
//!     }
//! #   assert_eq!(file.values(&record)?, [0.0, 0.02, 0.31, 0.12]);
//! #   assert!((record.time_s(3).expect("CSV has a time base") - 0.5e-9).abs() < 1e-18);
//! #   assert_eq!(record.head.unit.as_deref(), Some("V"));
//! }
//! # std::fs::remove_dir_all(&folder)?;
//! # Ok::<(), periscope_formats::FormatError>(())
//! ```
//!
//! A reader refuses a file that contradicts itself. [`FormatError`] says what is wrong, at which byte or line, and what
//! to do. Match on it to tell an empty file from a truncated one:
//!
//! ```
//! use periscope_formats::{FormatError, Source, records};
//!
//! let bytes = std::io::Cursor::new(Vec::new());
//! match records(&mut Source::new(bytes, "shot.wfm".as_ref())?) {
//!     Err(FormatError::Empty) => println!("the capture was interrupted"),
//!     Err(FormatError::Truncated { length, .. }) => println!("the copy ended after {length} bytes"),
//!     Err(FormatError::Unknown) => println!("no reader knows this file"),
//!     other => println!("{other:?}"),
//! }
//! # let empty = std::io::Cursor::new(Vec::new());
//! # assert!(matches!(records(&mut Source::new(empty, "shot.wfm".as_ref())?), Err(FormatError::Empty)));
//! # Ok::<(), FormatError>(())
//! ```
//!
//! # Rooms
//!
//! | module | holds |
//! |---|---|
//! | [`waveform`] | [`Record`]: head, time base, scale, and where its codes lie |
//! | [`accounting`] | which bytes of a file were used, and what is said of the others ([`Remark`]) |
//! | [`mod@reader`] | the trait [`Reader`], the file as a reader sees it ([`Source`]), [`FormatError`] |
//! | [`description`] | what a caller says about a file that does not say it: units, the array to read |
//! | [`companions`] | the second file of formats that keep head and samples apart |
//! | [`lecroy_trc`], [`lecroy_1_0`] | Teledyne LeCroy |
//! | [`tek_wfm`], [`tek_isf`] | Tektronix; its `.h5` files are in [`hdf5`] |
//! | [`keysight_bin`], [`hdf5`] | Keysight and Agilent |
//! | [`rigol_wfm`], [`rigol_bin`] | Rigol |
//! | [`rohde_schwarz`] | Rohde & Schwarz |
//! | [`siglent_bin`] | Siglent |
//! | [`picoquant`], [`becker_hickl_sdt`] | photon counters |
//! | [`caen_wavedump`], [`caen_compass`] | CAEN digitisers |
//! | [`drs4`] | DRS4 evaluation boards |
//! | [`picoscope_mat`] | Pico Technology |
//! | [`tdms`] | National Instruments |
//! | [`pulse_waves`], [`las`], [`lidar`] | lidars, and the beam of each of their pulses |
//! | [`csv`], [`npy`], [`npz`], [`wav`], [`sigrok_sr`] | formats that many programs write |
//! | [`mat`] | one array of a MATLAB file |
//! | [`mat5`], [`array`](mod@array) | arrays by name, for files that hold whole data sets |
//!
//! [`READERS`] lists all readers; [`records`] asks them in that order. `lecroy_trc`, `tek_wfm`, `keysight_bin`, `npy`,
//! `hdf5` and `csv` also write, for tests and simulations.
//!
//! # Conventions
//!
//! - Value of a code: `gain * code + offset`, in the unit that [`Head::unit`](waveform::Head) names (usually V).
//!   A file without a scale gives codes.
//! - Sample `i` lies `t0_s + i * dt_s` after the trigger, in seconds, with the sub-sample part of the trigger time.
//! - What a file does not say is `None`; no reader guesses.
//! - A reader checks every length against the file before it allocates, and never panics on what a file holds.
//!
//! # Not here
//!
//! No averaging, no plots, no conversion to picoseconds; no instrument control. Logic levels, spectra and envelopes are
//! read and named ([`Kind`](waveform::Kind)), but arrival times cannot be taken from them.

pub mod accounting;
pub mod array;
mod beam;
pub mod becker_hickl_sdt;
pub mod caen_compass;
pub mod caen_wavedump;
pub mod companions;
pub mod csv;
pub mod description;
pub mod drs4;
mod grid;
pub mod hdf5;
#[cfg(test)]
mod hostile;
mod inflate;
pub mod keysight_bin;
pub mod las;
pub mod lecroy_1_0;
pub mod lecroy_trc;
pub mod lidar;
pub mod mat;
pub mod mat5;
mod named;
pub mod npy;
pub mod npz;
mod numbers;
pub mod picoquant;
pub mod picoscope_mat;
pub mod pulse_waves;
pub mod reader;
pub mod rigol_bin;
pub mod rigol_wfm;
pub mod rohde_schwarz;
pub mod siglent_bin;
pub mod sigrok_sr;
pub mod tdms;
pub mod tek_isf;
pub mod tek_wfm;
pub mod wav;
pub mod waveform;
mod zip_file;

use std::io::{Read, Seek};

pub use accounting::Remark;
pub use description::Description;
pub use reader::{FormatError, Input, Joined, Reader, Source};

use crate::waveform::Record;

/// The formats. Those with a mark in their first bytes stand before those that accept any text.
pub const READERS: [&dyn Reader; 26] = [
    &lecroy_trc::LecroyTrc,
    &npy::Npy,
    &hdf5::Hdf5,
    &npz::Npz,
    &sigrok_sr::SigrokSr,
    &tek_isf::TekIsf,
    &tek_wfm::TekWfm,
    &wav::Wav,
    &caen_wavedump::CaenWavedump,
    &rohde_schwarz::RohdeSchwarz,
    &keysight_bin::KeysightBin,
    &rigol_bin::RigolBin,
    &lecroy_1_0::Lecroy10,
    &siglent_bin::SiglentBin,
    &rigol_wfm::RigolWfm,
    &caen_compass::CaenCompass,
    &drs4::Drs4,
    &picoscope_mat::PicoscopeMat,
    &mat::Mat,
    &picoquant::PicoquantPhu,
    &picoquant::PicoquantPtu,
    &becker_hickl_sdt::BeckerHicklSdt,
    &tdms::Tdms,
    &pulse_waves::PulseWaves,
    &las::Las,
    &csv::Csv,
];

/// Bytes at the start of a file that [`reader`] looks at to recognise the format.
const HEAD_BYTES: usize = 2048;

/// Returns the reader of a file: by its content, else by its extension.
///
/// # Errors
/// When no reader recognises the file, or it is known to be of a format that is not read.
pub fn reader<F: Read + Seek>(source: &mut Source<F>) -> Result<&'static dyn Reader, FormatError> {
    let head = source.head(HEAD_BYTES)?;
    if head.is_empty() {
        return Err(FormatError::Empty);
    }
    let by_content = READERS.into_iter().find(|reader| reader.recognises(&head));
    let extension = source.extension();
    if let Some(refusal) = named::refusal(&head, extension).filter(|_| by_content.is_none()) {
        return Err(refusal);
    }
    let by_name = || READERS.into_iter().find(|reader| reader.extensions().contains(&extension));
    by_content.or_else(by_name).ok_or(FormatError::Unknown)
}

/// The records of a file, and what is to be said about it.
#[derive(Debug)]
pub struct Contents {
    /// The records.
    pub records: Vec<Record>,
    /// Bytes that belong to none of them, and what else they do not show.
    pub remarks: Vec<Remark>,
}

/// Returns the records of a file with remarks about it. It reads the headers, and samples only where they are text.
///
/// # Errors
/// When no reader recognises the file, or when its reader refuses it.
pub fn contents<F: Read + Seek>(source: &mut Source<F>) -> Result<Contents, FormatError> {
    let reader = reader(source)?;
    source.description().check(reader.format(), reader.keys())?;
    let records = reader.records(source)?;
    let remarks = source.remarks(&records);
    Ok(Contents { records, remarks })
}

/// Returns the records of a file, as [`contents`] does.
///
/// # Errors
/// When no reader recognises the file, or when its reader refuses it.
pub fn records<F: Read + Seek>(source: &mut Source<F>) -> Result<Vec<Record>, FormatError> {
    Ok(contents(source)?.records)
}
