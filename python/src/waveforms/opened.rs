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

/// Samples that a thread reads at a time, and as many as it makes values of while their codes stay in its caches.
const BLOCK: usize = 1 << 22;
const SMALL_BLOCK: usize = 1 << 18;
/// Samples of a packed record, which one thread unpacks, that each thread makes values of.
const PIECE: usize = 1 << 16;
/// Bytes of a file that several threads read side by side.
const LARGE: usize = 1 << 24;

/// An open file.
pub struct Opened {
    pub path: PathBuf,
    /// The file, opened once for each thread if it is large.
    sources: Vec<Mutex<Source<Joined>>>,
    pub remarks: Vec<String>,
}

impl Opened {
    /// Opens a file; returns its records too.
    pub fn open(py: Python<'_>, path: PathBuf) -> PyResult<(Self, Vec<Record>)> {
        let opened = interruptible(py, |_| {
            let mut source = Source::open(&path)?;
            let contents = formats::contents(&mut source)?;
            let others = if source.total() < LARGE { 0 } else { rayon::current_num_threads() - 1 };
            let mut sources = vec![source];
            for _ in 0..others {
                sources.push(Source::open(&path)?);
            }
            Ok((sources.into_iter().map(Mutex::new).collect(), contents))
        })?;
        let (sources, Contents { records, remarks }) = opened.map_err(|error| of_file(&path, &error))?;
        let remark = |remark: &formats::Remark| format!("byte {}: {}", remark.byte_offset, remark.problem);
        let remarks = remarks.iter().map(remark).collect();
        Ok((Self { path, sources, remarks }, records))
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
            let read = interruptible(py, |cancel| {
                in_blocks(records, &samples, target, BLOCK, |_, records, part, target| {
                    self.read(records, &part, target, cancel)
                })
            })?;
            read.map_err(|error| of_file(&self.path, &FormatError::Io(error)))?;
        }
        bytes.call_method1("view", (dtype(code_type),))
    }

    /// Scaled values of records, one after another. Each thread of the pool reads blocks of codes, which stay in the
    /// processor's caches, and makes values of them: the pages of a new array are cleared where they are first written.
    pub fn values<'py>(
        &self,
        py: Python<'py>,
        records: &[Record],
        samples: Range<usize>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let width = records[0].head.code_type.bytes();
        let values = empty::<f64>(py, records.len() * samples.len())?;
        {
            let mut target = values.readwrite();
            let target = target.as_slice_mut()?;
            let read = interruptible(py, |cancel| {
                in_blocks(records, &samples, target, SMALL_BLOCK, |codes, records, part, target| {
                    codes.resize(target.len() * width, 0);
                    self.read(records, &part, codes, cancel)?;
                    scale(records, codes, target);
                    Ok(())
                })
            })?;
            read.map_err(|error| of_file(&self.path, &FormatError::Io(error)))?;
        }
        Ok(values)
    }

    /// Codes of some samples of records, one record after another, by the thread's own file.
    fn read(&self, records: &[Record], samples: &Range<usize>, target: &mut [u8], cancel: &Cancel) -> io::Result<()> {
        let own = rayon::current_thread_index().unwrap_or(0) % self.sources.len();
        let mut source = self.sources[own].lock().unwrap_or_else(PoisonError::into_inner);
        Record::read_into(records, source.file(), samples, target, &mut || cancel.check())
    }
}

/// Fills `target`, which has the same number of elements for each sample, block by block on all threads: each of some
/// short records, or of a part of a long one. What is packed is unpacked from its beginning, and so not cut. `fill` has
/// some room of its own.
fn in_blocks<T: Send>(
    records: &[Record],
    samples: &Range<usize>,
    target: &mut [T],
    block: usize,
    fill: impl Fn(&mut Vec<u8>, &[Record], Range<usize>, &mut [T]) -> io::Result<()> + Sync,
) -> io::Result<()> {
    if target.is_empty() {
        return Ok(());
    }
    let (length, each) = (samples.len(), target.len() / (records.len() * samples.len()));
    let is_plain = records.iter().all(|record| record.contiguous().is_some());
    let (together, most) = ((block / length).max(1), if is_plain { block.min(length) } else { length });
    let blocks = records.par_chunks(together).zip(target.par_chunks_mut(together * length * each));
    blocks.try_for_each(|(records, target)| {
        let starts = samples.clone().into_par_iter().step_by(most);
        let parts = starts.zip(target.par_chunks_mut(records.len() * most * each));
        parts.try_for_each_init(Vec::new, |room, (start, target)| {
            fill(room, records, start..(start + most).min(samples.end), target)
        })
    })
}

/// Values of codes of as many samples of each record; of many on all threads.
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
