//! What a caller says about a file because the file does not say it: units of a text, the array to read, bins of photon
//! events.

use thiserror::Error;

/// The name of the axis that counts samples.
pub const TIME: &str = "time";

/// What a file does not say of itself. A key that its format has no use for is refused.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Description {
    /// Unit of the values in a text whose heading names none, such as `mV` or `counts`.
    pub unit: Option<String>,
    /// Unit of the times in a text whose heading names none, such as `ns`.
    pub time_unit: Option<String>,
    /// The array with the samples: its name, or its path in an HDF5 file.
    pub variable: Option<String>,
    /// A name for each axis of that array, in the order of the program that wrote it; [`TIME`] counts samples.
    pub axes: Option<Vec<String>>,
    /// Width of the bins into which photon events are counted.
    pub bin_ps: Option<f64>,
    /// The marker, from 1, at each of whose events a new histogram begins.
    pub marker: Option<u32>,
    /// Pixels of a line, where that marker is the start of the lines of an image.
    pub pixels: Option<u32>,
}

/// A key of a [`Description`] that does not fit the file.
#[derive(Debug, Error)]
#[error("`{key}` {problem}")]
pub struct Misfit {
    /// Its name.
    pub key: &'static str,
    /// What is wrong, and the fix.
    pub problem: String,
}

/// A key of a [`Description`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Key {
    /// `unit`.
    Unit,
    /// `time_unit`.
    TimeUnit,
    /// `variable`.
    Variable,
    /// `axes`.
    Axes,
    /// `bin_ps`.
    Bin,
    /// `marker`.
    Marker,
    /// `pixels`.
    Pixels,
}

impl Key {
    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Unit => "unit",
            Self::TimeUnit => "time_unit",
            Self::Variable => "variable",
            Self::Axes => "axes",
            Self::Bin => "bin_ps",
            Self::Marker => "marker",
            Self::Pixels => "pixels",
        }
    }

    /// The files that it is for.
    const fn files(self) -> &'static str {
        match self {
            Self::Unit | Self::TimeUnit => "text",
            Self::Variable => "MATLAB, HDF5 and .npz files",
            Self::Axes => "MATLAB, HDF5, .npy and .npz files",
            Self::Bin | Self::Marker | Self::Pixels => "streams of photon events (.ptu)",
        }
    }

    /// An error about its value.
    pub(super) fn refuse(self, problem: impl Into<String>) -> Misfit {
        Misfit { key: self.name(), problem: problem.into() }
    }
}

/// Most names of arrays in an error message.
const NAMES: usize = 16;

impl Description {
    /// Which of the arrays of a file holds the samples: the named one, else the only one.
    pub(super) fn array(&self, names: &[&str]) -> Result<usize, Misfit> {
        let list = || {
            let more = names.len().saturating_sub(NAMES);
            let first = names[..names.len() - more].join(", ");
            if more == 0 { first } else { format!("{first}, and {more} more") }
        };
        match (&self.variable, names) {
            (Some(variable), _) => {
                let wanted = variable.trim_start_matches('/');
                let wanted = wanted.strip_suffix(".npy").unwrap_or(wanted);
                let index = names.iter().position(|name| *name == wanted);
                index.ok_or_else(|| {
                    let there = if names.is_empty() { "no array of real numbers".to_owned() } else { list() };
                    Key::Variable.refuse(format!("= \"{variable}\" is not in this file; it has {there}"))
                })
            }
            (None, [_]) => Ok(0),
            (None, []) => {
                Err(Key::Variable.refuse("finds no array of real numbers over an axis; save the samples as one"))
            }
            (None, _) => Err(Key::Variable.refuse(format!("is missing: the file has {}; name one", list()))),
        }
    }

    /// Refuses keys that a format has no use for.
    pub(super) fn check(&self, format: &str, keys: &[Key]) -> Result<(), Misfit> {
        let given = [
            (Key::Unit, self.unit.is_some()),
            (Key::TimeUnit, self.time_unit.is_some()),
            (Key::Variable, self.variable.is_some()),
            (Key::Axes, self.axes.is_some()),
            (Key::Bin, self.bin_ps.is_some()),
            (Key::Marker, self.marker.is_some()),
            (Key::Pixels, self.pixels.is_some()),
        ];
        match given.into_iter().find(|(key, is_given)| *is_given && !keys.contains(key)) {
            Some((key, _)) => {
                Err(key.refuse(format!("is for {}, and this file is {format}; take it out", key.files())))
            }
            None => Ok(()),
        }
    }
}
