//! Waveforms of scope files.
//!
//! | module | holds |
//! |---|---|
//! | `opened` | the file, whose samples become arrays |
//! | `waveform` | one waveform |

mod opened;
mod waveform;

use std::collections::HashSet;
use std::path::PathBuf;
use std::sync::Arc;

use numpy::{PyArray1, PyArray2, PyArrayMethods};
use periscope::waveform::{Head, Record};
use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PySlice;

use crate::arrays::vector;
use opened::Opened;
pub use waveform::Waveform;
use waveform::{dt_ps, range, t0_ps};

/// Opens a file of an oscilloscope, digitiser or photon counter, and returns its waveforms.
///
/// The format is recognised by content, then by extension. Headers are read at once. Samples stay in the file until
/// they are asked for, so that a file may be larger than memory.
///
/// Parameters
/// ----------
/// path : str or os.PathLike
///     The file. A companion that holds its samples or its header is opened with it.
///
/// Returns
/// -------
/// Waveforms
///     One waveform for each segment of each channel, in the order of the file.
///
/// Raises
/// ------
/// FormatError
///     If no reader knows the file, or the file contradicts itself. It says at which byte or line, and what to do.
/// OSError
///     If the system cannot read the file.
#[pyfunction]
pub fn read(py: Python<'_>, path: PathBuf) -> PyResult<Waveforms> {
    let (file, records) = Opened::open(py, path)?;
    Ok(Waveforms { file: Arc::new(file), records })
}

/// Waveforms of one file: a sequence. A slice, or `channel`, is a part of them.
#[pyclass(frozen, module = "periscope")]
pub struct Waveforms {
    file: Arc<Opened>,
    records: Vec<Record>,
}

impl Waveforms {
    fn part(&self, records: Vec<Record>) -> Self {
        Self { file: Arc::clone(&self.file), records }
    }

    fn waveform(&self, record: &Record) -> Waveform {
        Waveform { file: Arc::clone(&self.file), record: record.clone() }
    }

    fn names(&self) -> Vec<String> {
        let mut known = HashSet::new();
        let names = self.records.iter().map(|record| record.head.channel.as_deref().unwrap_or_default());
        names.filter(|name| known.insert(*name)).map(str::to_owned).collect()
    }

    /// What all have in common, for an array with a row for each.
    fn head(&self) -> PyResult<&Head> {
        let Some((first, others)) = self.records.split_first() else {
            return Err(PyValueError::new_err("there are no waveforms to make an array of"));
        };
        let differs =
            |other: &&Record| other.head.samples != first.head.samples || other.head.code_type != first.head.code_type;
        if others.iter().any(|other| differs(&other)) {
            let problem = format!(
                "{}: its waveforms differ in samples or type; choose some with channel(NAME), of {:?}",
                self.file.path.display(),
                self.names()
            );
            return Err(PyValueError::new_err(problem));
        }
        Ok(&first.head)
    }

    fn of_each(&self, py: Python<'_>, value: impl Fn(&Record) -> Option<f64>) -> Py<PyArray1<f64>> {
        vector(py, self.records.iter().map(|record| value(record).unwrap_or(f64::NAN)).collect())
    }
}

#[pymethods]
impl Waveforms {
    /// The file.
    #[getter]
    fn path(&self) -> PathBuf {
        self.file.path.clone()
    }

    /// Bytes that belong to no waveform, and what else the waveforms do not show.
    #[getter]
    fn remarks(&self) -> Vec<String> {
        self.file.remarks.clone()
    }

    /// Names of the channels, in the order of the file; "" for a channel without a name.
    #[getter]
    fn channels(&self) -> Vec<String> {
        self.names()
    }

    /// Time of sample 0 of each waveform after its trigger, ps, with the sub-sample part; NaN where the file has none.
    #[getter]
    fn t0_ps(&self, py: Python<'_>) -> Py<PyArray1<f64>> {
        self.of_each(py, t0_ps)
    }

    /// Time of the trigger of each waveform after that of the first segment, s; NaN where the file has none.
    #[getter]
    fn trigger_s(&self, py: Python<'_>) -> Py<PyArray1<f64>> {
        self.of_each(py, |record| record.trigger_s)
    }

    /// Time between samples, ps; None without a time base.
    ///
    /// Raises
    /// ------
    /// ValueError
    ///     If the waveforms differ in length or type, and so make no array.
    #[getter]
    fn dt_ps(&self) -> PyResult<Option<f64>> {
        self.head().map(dt_ps)
    }

    /// The waveforms of one channel.
    ///
    /// Parameters
    /// ----------
    /// name : str
    ///     One of `channels`.
    fn channel(&self, name: &str) -> PyResult<Self> {
        let is_of = |record: &&Record| record.head.channel.as_deref().unwrap_or_default() == name;
        let records: Vec<Record> = self.records.iter().filter(is_of).cloned().collect();
        if records.is_empty() {
            let problem =
                format!("{} has no channel {name:?}; its channels are {:?}", self.file.path.display(), self.names());
            return Err(PyValueError::new_err(problem));
        }
        Ok(self.part(records))
    }

    /// Codes of the converter, as the file holds them: an array [waveform, sample], read now.
    ///
    /// Parameters
    /// ----------
    /// start, stop : int
    ///     Read the samples from `start` to before `stop`.
    #[pyo3(signature = (start=0, stop=None))]
    fn codes<'py>(&self, py: Python<'py>, start: usize, stop: Option<usize>) -> PyResult<Bound<'py, PyAny>> {
        let samples = range(self.head()?.samples, start, stop)?;
        let shape = (self.records.len(), samples.len());
        self.file.codes(py, &self.records, samples)?.call_method1("reshape", (shape,))
    }

    /// Values in the unit of the waveforms, as a rule V: an array [waveform, sample], read now. The codes, as numbers,
    /// where the file has no scale.
    ///
    /// Parameters
    /// ----------
    /// start, stop : int
    ///     Read the samples from `start` to before `stop`.
    #[pyo3(signature = (start=0, stop=None))]
    fn volts(&self, py: Python<'_>, start: usize, stop: Option<usize>) -> PyResult<Py<PyArray2<f64>>> {
        let samples = range(self.head()?.samples, start, stop)?;
        let (height, width) = (self.records.len(), samples.len());
        Ok(self.file.values(py, &self.records, samples)?.reshape([height, width])?.unbind())
    }

    fn __len__(&self) -> usize {
        self.records.len()
    }

    fn __getitem__<'py>(&self, py: Python<'py>, index: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let count = self.records.len();
        if let Ok(slice) = index.cast::<PySlice>() {
            let indices = slice.indices(count as isize)?;
            let places = (0..indices.slicelength).map(|n| indices.start + n as isize * indices.step);
            let records = places.map(|place| self.records[place as usize].clone()).collect();
            return Ok(self.part(records).into_pyobject(py)?.into_any());
        }
        let place: isize = index.extract()?;
        let place = if place < 0 { place + count as isize } else { place };
        let record = usize::try_from(place).ok().and_then(|place| self.records.get(place));
        let record = record.ok_or_else(|| PyIndexError::new_err(format!("there are {count} waveforms")))?;
        Ok(self.waveform(record).into_pyobject(py)?.into_any())
    }

    fn __repr__(&self) -> String {
        let format = self.records.first().map_or("", |record| record.head.format);
        format!("<Waveforms of {}: {format}, {} waveforms>", self.file.path.display(), self.records.len())
    }
}
