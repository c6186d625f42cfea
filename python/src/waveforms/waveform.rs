//! One waveform, and the times of its samples.

use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

use numpy::PyArray1;
use periscope::waveform::{Head, Kind, Record};
use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use super::opened::Opened;
use crate::arrays::vector;
use crate::plots::plot;

const PS_PER_S: f64 = 1e12;

/// The samples from `start` to before `stop`, both as in a slice of Python without negative numbers.
pub fn range(samples: usize, start: usize, stop: Option<usize>) -> PyResult<Range<usize>> {
    let stop = stop.unwrap_or(samples);
    if start > stop || stop > samples {
        let problem = format!("samples {start} to {stop} are asked for; the record has samples 0 to {samples}");
        return Err(PyIndexError::new_err(problem));
    }
    Ok(start..stop)
}

fn is_in_time(head: &Head) -> bool {
    head.kind != Kind::Spectrum
}

pub fn t0_ps(record: &Record) -> Option<f64> {
    record.t0_s.filter(|_| is_in_time(&record.head)).map(|t0_s| t0_s * PS_PER_S)
}

pub fn dt_ps(head: &Head) -> Option<f64> {
    head.dt_s.filter(|_| is_in_time(head)).map(|dt_s| dt_s * PS_PER_S)
}

/// One segment of one channel. Its samples stay in the file until they are asked for.
#[pyclass(frozen, module = "periscope")]
pub struct Waveform {
    pub file: Arc<Opened>,
    pub record: Record,
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

    /// Draws the samples over time. Needs matplotlib.
    ///
    /// Parameters
    /// ----------
    /// ax : matplotlib.axes.Axes, optional
    ///     Where to; by default a new figure.
    ///
    /// Returns
    /// -------
    /// matplotlib.axes.Axes
    #[pyo3(signature = (ax=None))]
    fn plot<'py>(slf: &Bound<'py, Self>, ax: Option<Bound<'py, PyAny>>) -> PyResult<Bound<'py, PyAny>> {
        plot(slf, "waveform", ax)
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
