//! Scope files to records: one file for each format, behind one trait. The first bytes decide the format, then the
//! extension.

pub mod array;
pub mod becker_hickl_sdt;
pub mod caen_wavedump;
pub mod companions;
pub mod csv;
pub mod hdf5;
#[cfg(test)]
mod hostile;
mod inflate;
pub mod keysight_bin;
pub mod lecroy_1_0;
pub mod lecroy_trc;
pub mod mat5;
pub mod npy;
pub mod npz;
mod numbers;
pub mod picoquant;
pub mod reader;
pub mod rigol_bin;
pub mod rigol_wfm;
pub mod rohde_schwarz;
pub mod sigrok_sr;
pub mod tek_isf;
pub mod tek_wfm;
pub mod wav;
pub mod waveform;
mod zip_file;

use std::io::{Read, Seek};

pub use reader::{FormatError, Input, Joined, Reader, Source};

use crate::waveform::Record;

/// The formats. Those with a mark in their first bytes stand before those that accept any text.
pub const READERS: [&dyn Reader; 18] = [
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
    &rigol_wfm::RigolWfm,
    &picoquant::PicoquantPhu,
    &picoquant::PicoquantPtu,
    &becker_hickl_sdt::BeckerHicklSdt,
    &csv::Csv,
];

/// Bytes at the start of a file that [`reader`] looks at to recognise the format.
const HEAD_BYTES: usize = 2048;

/// Returns the reader of a file: by its content, else by its extension.
///
/// # Errors
/// When no reader recognises the file.
pub fn reader<F: Read + Seek>(source: &mut Source<F>) -> Result<&'static dyn Reader, FormatError> {
    let head = source.head(HEAD_BYTES)?;
    if head.is_empty() {
        return Err(FormatError::Empty);
    }
    let by_content = READERS.into_iter().find(|reader| reader.recognises(&head));
    let extension = source.extension();
    let by_name = || READERS.into_iter().find(|reader| reader.extensions().contains(&extension));
    by_content.or_else(by_name).ok_or(FormatError::Unknown)
}

/// Returns the records of a file. It reads the headers, and samples only where they are text.
///
/// # Errors
/// When no reader recognises the file, or when its reader refuses it.
pub fn records<F: Read + Seek>(source: &mut Source<F>) -> Result<Vec<Record>, FormatError> {
    reader(source)?.records(source)
}
