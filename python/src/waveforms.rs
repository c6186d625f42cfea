//! Waveforms of scope files.

use std::ops::Range;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use numpy::{Element, PyArray1, PyArray2, PyArrayMethods};
use periscope::formats::{self, Contents, FormatError, Input, Joined, Source};
use periscope::waveform::{CodeType, Head, Kind, Record};
use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PySlice, PyTuple};

use crate::arrays::vector;
use crate::failure::of_file;
use crate::interrupt::interruptible;

const PS_PER_S: f64 = 1e12;

/// An open file.
struct Opened {
    path: PathBuf,
    source: Mutex<Source<Joined>>,
    remarks: Vec<String>,
}

impl Opened {
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
    fn codes<'py>(&self, py: Python<'py>, records: &[Record], samples: Range<usize>) -> PyResult<Bound<'py, PyAny>> {
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
    fn values<'py>(
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

/// The samples from `start` to before `stop`, both as in a slice of Python without negative numbers.
fn range(samples: usize, start: usize, stop: Option<usize>) -> PyResult<Range<usize>> {
    let stop = stop.unwrap_or(samples);
    if start > stop || stop > samples {
        let problem = format!("samples {start} to {stop} are asked for; the record has samples 0 to {samples}");
        return Err(PyIndexError::new_err(problem));
    }
    Ok(start..stop)
}

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
    let opened = interruptible(py, |_| {
        let mut source = Source::open(&path)?;
        let contents = formats::contents(&mut source)?;
        Ok((source, contents))
    })?;
    let (source, Contents { records, remarks }) = opened.map_err(|error| of_file(&path, &error))?;
    let remark = |remark: &formats::Remark| format!("byte {}: {}", remark.byte_offset, remark.problem);
    let remarks = remarks.iter().map(remark).collect();
    Ok(Waveforms { file: Arc::new(Opened { path, source: Mutex::new(source), remarks }), records })
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
        let mut names: Vec<String> = Vec::new();
        for record in &self.records {
            let name = record.head.channel.as_deref().unwrap_or_default();
            if !names.iter().any(|other| other == name) {
                names.push(name.to_owned());
            }
        }
        names
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

fn is_in_time(head: &Head) -> bool {
    head.kind != Kind::Spectrum
}

fn t0_ps(record: &Record) -> Option<f64> {
    record.t0_s.filter(|_| is_in_time(&record.head)).map(|t0_s| t0_s * PS_PER_S)
}

fn dt_ps(head: &Head) -> Option<f64> {
    head.dt_s.filter(|_| is_in_time(head)).map(|dt_s| dt_s * PS_PER_S)
}

/// One segment of one channel. Its samples stay in the file until they are asked for.
#[pyclass(frozen, module = "periscope")]
pub struct Waveform {
    file: Arc<Opened>,
    record: Record,
}

#[pymethods]
impl Waveform {
    /// The file.
    #[getter]
    fn path(&self) -> PathBuf {
        self.file.path.clone()
    }

    /// Format of the file.
    #[getter]
    fn format(&self) -> &'static str {
        self.record.head.format
    }

    /// What the samples are: "waveform", "average", "counts", "envelope", "digital", "spectrum" or "iq".
    #[getter]
    fn kind(&self) -> &'static str {
        self.record.head.kind.name()
    }

    /// Instrument, as the file names it.
    #[getter]
    fn instrument(&self) -> Option<String> {
        self.record.head.instrument.clone()
    }

    /// Channel.
    #[getter]
    fn channel(&self) -> Option<String> {
        self.record.head.channel.clone()
    }

    /// Number of the segment, where the file holds several.
    #[getter]
    fn segment(&self) -> Option<u32> {
        self.record.segment
    }

    /// Unit of `volts()`, as the file names it.
    #[getter]
    fn unit(&self) -> Option<String> {
        self.record.head.unit.clone()
    }

    /// Time between samples, ps; None without a time base, and of a spectrum.
    #[getter]
    fn dt_ps(&self) -> Option<f64> {
        dt_ps(&self.record.head)
    }

    /// Time of sample 0 after the trigger, ps, with the sub-sample part.
    #[getter]
    fn t0_ps(&self) -> Option<f64> {
        t0_ps(&self.record)
    }

    /// Time between samples as the file gives it, s; of a spectrum, hertz between them.
    #[getter]
    fn dt_s(&self) -> Option<f64> {
        self.record.head.dt_s
    }

    /// Time of sample 0 as the file gives it, s; of a spectrum, its first frequency in hertz.
    #[getter]
    fn t0_s(&self) -> Option<f64> {
        self.record.t0_s
    }

    /// Whether `t0_ps` is uncertain by some samples: the header gives only the nominal trigger position.
    #[getter]
    fn t0_nominal(&self) -> bool {
        self.record.head.t0_nominal
    }

    /// Time of its trigger after that of the first segment, s.
    #[getter]
    fn trigger_s(&self) -> Option<f64> {
        self.record.trigger_s
    }

    /// Units of `volts()` per code: `volts = gain * code + offset`.
    #[getter]
    fn gain(&self) -> Option<f64> {
        self.record.head.scale.map(|scale| scale.gain)
    }

    /// Value of code 0.
    #[getter]
    fn offset(&self) -> Option<f64> {
        self.record.head.scale.map(|scale| scale.offset)
    }

    /// Gain as the header gives it.
    #[getter]
    fn header_gain(&self) -> Option<f64> {
        self.record.head.header_gain
    }

    /// Offset as the header gives it; its sign is the vendor's.
    #[getter]
    fn header_offset(&self) -> Option<f64> {
        self.record.head.header_offset
    }

    /// Lowest and highest code of the converter: a sample at either is clipped.
    #[getter]
    fn rails(&self) -> Option<(f64, f64)> {
        self.record.head.rails
    }

    /// Time of the acquisition in ISO 8601, in the time zone of the instrument.
    #[getter]
    fn acquired_at(&self) -> Option<String> {
        self.record.head.acquired_at.clone()
    }

    /// Leading axes of the array that this waveform is a row of; () otherwise.
    #[getter]
    fn shape<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, &self.record.head.shape)
    }

    /// Bytes that belong to no waveform of the file, and what else the waveforms do not show.
    #[getter]
    fn remarks(&self) -> Vec<String> {
        self.file.remarks.clone()
    }

    /// Codes of the converter, as the file holds them: an array of its type, read now.
    ///
    /// Parameters
    /// ----------
    /// start, stop : int
    ///     Read the samples from `start` to before `stop`.
    #[pyo3(signature = (start=0, stop=None))]
    fn codes<'py>(&self, py: Python<'py>, start: usize, stop: Option<usize>) -> PyResult<Bound<'py, PyAny>> {
        let samples = range(self.record.head.samples, start, stop)?;
        self.file.codes(py, std::slice::from_ref(&self.record), samples)
    }

    /// Values in `unit`, as a rule V: an array, read now. The codes, as numbers, where the file has no scale.
    ///
    /// Parameters
    /// ----------
    /// start, stop : int
    ///     Read the samples from `start` to before `stop`.
    #[pyo3(signature = (start=0, stop=None))]
    fn volts(&self, py: Python<'_>, start: usize, stop: Option<usize>) -> PyResult<Py<PyArray1<f64>>> {
        let samples = range(self.record.head.samples, start, stop)?;
        Ok(self.file.values(py, std::slice::from_ref(&self.record), samples)?.unbind())
    }

    /// Time of each sample after the trigger, ps.
    ///
    /// Parameters
    /// ----------
    /// start, stop : int
    ///     Of the samples from `start` to before `stop`.
    ///
    /// Raises
    /// ------
    /// ValueError
    ///     If the file has no time base.
    #[pyo3(signature = (start=0, stop=None))]
    fn time_ps(&self, py: Python<'_>, start: usize, stop: Option<usize>) -> PyResult<Py<PyArray1<f64>>> {
        let samples = range(self.record.head.samples, start, stop)?;
        let base = t0_ps(&self.record).zip(dt_ps(&self.record.head));
        let (t0_ps, dt_ps) = base.ok_or_else(|| {
            PyValueError::new_err(format!("{}: the file gives no times of its samples", self.file.path.display()))
        })?;
        Ok(vector(py, samples.map(|sample| t0_ps + sample as f64 * dt_ps).collect()))
    }

    fn __len__(&self) -> usize {
        self.record.head.samples
    }

    fn __repr__(&self) -> String {
        let Head { format, channel, samples, .. } = &*self.record.head;
        let channel = channel.as_deref().unwrap_or("-");
        let segment = self.record.segment.map_or(String::new(), |segment| format!(", segment {segment}"));
        format!("<Waveform of {}: {format}, channel {channel}{segment}, {samples} samples>", self.file.path.display())
    }
}
