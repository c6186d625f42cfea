//! An open file, whose samples are read into arrays when they are asked for.

use std::io;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use numpy::{Element, PyArray1, PyArrayMethods};
use periscope::cancel::Cancel;
use periscope::formats::{self, Contents, FormatError, Input, Joined, Source};
use periscope::waveform::{CodeType, Record};
use pyo3::prelude::*;
use rayon::prelude::*;

use crate::failure::of_file;
use crate::interrupt::interruptible;

/// Samples whose codes are read at a time to make values of them, and samples that a thread takes of these.
const BLOCK: usize = 1 << 20;
const PIECE: usize = 1 << 16;

/// An open file.
pub struct Opened {
    pub path: PathBuf,
    source: Mutex<Source<Joined>>,
    pub remarks: Vec<String>,
}

impl Opened {
    /// Opens a file; returns its records too.
    pub fn open(py: Python<'_>, path: PathBuf) -> PyResult<(Self, Vec<Record>)> {
        let opened = interruptible(py, |_| {
            let mut source = Source::open(&path)?;
            let contents = formats::contents(&mut source)?;
            Ok((source, contents))
        })?;
        let (source, Contents { records, remarks }) = opened.map_err(|error| of_file(&path, &error))?;
        let remark = |remark: &formats::Remark| format!("byte {}: {}", remark.byte_offset, remark.problem);
        let remarks = remarks.iter().map(remark).collect();
        Ok((Self { path, source: Mutex::new(source), remarks }, records))
    }

    /// Codes of records, one after another: bytes of the file, seen as the type of the codes.
    pub fn codes<'py>(
        &self,
        py: Python<'py>,
        records: &[Record],
        samples: Range<usize>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let code_type = records[0].head.code_type;
        let bytes = empty::<u8>(py, records.len() * samples.len() * code_type.bytes())?;
        {
            let mut target = bytes.readwrite();
            let target = target.as_slice_mut()?;
            let read = interruptible(py, |cancel| self.read(records, &samples, target, cancel))?;
            read.map_err(|error| of_file(&self.path, &FormatError::Io(error)))?;
        }
        bytes.call_method1("view", (dtype(code_type),))
    }

    /// Scaled values of records, one after another. Blocks of codes stay in the processor's caches, and the threads of
    /// the pool turn each into values side by side: the pages of a new array are cleared where they are first written.
    pub fn values<'py>(
        &self,
        py: Python<'py>,
        records: &[Record],
        samples: Range<usize>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let (length, width) = (samples.len(), records[0].head.code_type.bytes());
        let values = empty::<f64>(py, records.len() * length)?;
        if length == 0 {
            return Ok(values);
        }
        {
            let mut target = values.readwrite();
            let target = target.as_slice_mut()?;
            // Some short records, or a part of a long one; what is packed is unpacked from its beginning.
            let is_plain = records.iter().all(|record| record.contiguous().is_some());
            let (together, most) = ((BLOCK / length).max(1), if is_plain { BLOCK.min(length) } else { length });
            let read = interruptible(py, |cancel| {
                let mut codes = Vec::new();
                for (records, target) in records.chunks(together).zip(target.chunks_mut(together * length)) {
                    let parts = samples.clone().step_by(most).zip(target.chunks_mut(records.len() * most));
                    for (start, target) in parts {
                        let part = start..(start + most).min(samples.end);
                        codes.resize(target.len() * width, 0);
                        self.read(records, &part, &mut codes, cancel)?;
                        scale(records, &codes, target);
                    }
                }
                Ok(())
            })?;
            read.map_err(|error| of_file(&self.path, &FormatError::Io(error)))?;
        }
        Ok(values)
    }

    /// Codes of some samples of records, one record after another.
    fn read(&self, records: &[Record], samples: &Range<usize>, target: &mut [u8], cancel: &Cancel) -> io::Result<()> {
        let mut source = self.source.lock().unwrap_or_else(PoisonError::into_inner);
        Record::read_into(records, source.file(), samples, target, &mut || cancel.check())
    }
}

/// Values of codes of as many samples of each record, on all threads.
fn scale(records: &[Record], codes: &[u8], target: &mut [f64]) {
    let (length, width) = (target.len() / records.len(), records[0].head.code_type.bytes());
    let of_records = records.par_iter().zip(codes.par_chunks(length * width)).zip(target.par_chunks_mut(length));
    of_records.for_each(|((record, codes), target)| {
        let pieces = codes.par_chunks(PIECE * width).zip(target.par_chunks_mut(PIECE));
        pieces.for_each(|(codes, target)| record.values_into(codes, target));
    });
}

/// An array whose values are to be filled in. NumPy allocates it: on large pages, which are cleared much faster.
fn empty<T: Element>(py: Python<'_>, count: usize) -> PyResult<Bound<'_, PyArray1<T>>> {
    Ok(py.import("numpy")?.call_method1("empty", (count, T::get_dtype(py)))?.cast_into()?)
}

/// NumPy's name of a type of codes.
fn dtype(code_type: CodeType) -> &'static str {
    match code_type {
        CodeType::I8 => "|i1",
        CodeType::U8 => "|u1",
        CodeType::I16 => "<i2",
        CodeType::U16 => "<u2",
        CodeType::I32 => "<i4",
        CodeType::U32 => "<u4",
        CodeType::F32 => "<f4",
        CodeType::F64 => "<f8",
    }
}
