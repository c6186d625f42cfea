//! An open file, whose samples are read into arrays when they are asked for.

use std::ops::Range;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use numpy::{Element, PyArray1, PyArrayMethods};
use periscope::formats::{self, Contents, FormatError, Input, Joined, Source};
use periscope::waveform::{CodeType, Record};
use pyo3::prelude::*;

use crate::failure::of_file;
use crate::interrupt::interruptible;

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

    /// Passes on the codes of some samples of records, record by record.
    fn visit(
        &self,
        py: Python<'_>,
        records: &[Record],
        samples: Range<usize>,
        mut take: impl FnMut(&Record, &[u8]) + Send,
    ) -> PyResult<()> {
        let read = interruptible(py, |cancel| {
            let mut source = self.source.lock().unwrap_or_else(PoisonError::into_inner);
            records.iter().try_for_each(|record| {
                record.visit(source.file(), samples.clone(), &mut |codes| {
                    cancel.check();
                    take(record, codes);
                })
            })
        })?;
        read.map_err(|error| of_file(&self.path, &FormatError::Io(error)))
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
            let mut rest = target.as_slice_mut()?;
            self.visit(py, records, samples, |_, codes| rest = fill(std::mem::take(&mut rest), codes))?;
        }
        bytes.call_method1("view", (dtype(code_type),))
    }

    /// Scaled values of records, one after another.
    pub fn values<'py>(
        &self,
        py: Python<'py>,
        records: &[Record],
        samples: Range<usize>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let values = empty::<f64>(py, records.len() * samples.len())?;
        {
            let mut target = values.readwrite();
            let mut rest = target.as_slice_mut()?;
            let take = |record: &Record, codes: &[u8]| rest = fill(std::mem::take(&mut rest), &record.values(codes));
            self.visit(py, records, samples, take)?;
        }
        Ok(values)
    }
}

/// An array whose values are to be filled in. NumPy allocates it: on large pages, which are cleared much faster.
fn empty<T: Element>(py: Python<'_>, count: usize) -> PyResult<Bound<'_, PyArray1<T>>> {
    Ok(py.import("numpy")?.call_method1("empty", (count, T::get_dtype(py)))?.cast_into()?)
}

/// Copies values to the front of a target; returns the rest of it.
fn fill<'a, T: Copy>(target: &'a mut [T], values: &[T]) -> &'a mut [T] {
    let (front, rest) = target.split_at_mut(values.len());
    front.copy_from_slice(values);
    rest
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
