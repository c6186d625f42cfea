//! What one record of an oscilloscope is, whatever the vendor: codes, and what makes volts and seconds of them.
//!
//! volts = gain * code + offset, sample i at `t0_s + i * dt_s` after the trigger. The sub-sample part of the trigger time is in `t0_s`: leaving it
//! out costs up to one sample.

use std::io;
use std::sync::Arc;

/// Type of a raw code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CodeType {
    /// Signed, 8 bits.
    I8,
    /// Unsigned, 8 bits.
    U8,
    /// Signed, 16 bits.
    I16,
    /// Unsigned, 16 bits.
    U16,
    /// Signed, 32 bits.
    I32,
    /// Floating, 32 bits.
    F32,
    /// Floating, 64 bits.
    F64,
}

impl CodeType {
    /// All of them.
    pub const ALL: [Self; 7] = [Self::I8, Self::U8, Self::I16, Self::U16, Self::I32, Self::F32, Self::F64];

    /// Name, as in the tables.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::I8 => "i8",
            Self::U8 => "u8",
            Self::I16 => "i16",
            Self::U16 => "u16",
            Self::I32 => "i32",
            Self::F32 => "f32",
            Self::F64 => "f64",
        }
    }

    /// The type of this name.
    #[must_use]
    pub fn parse(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|code_type| code_type.name() == name)
    }

    /// Bytes of a code.
    #[must_use]
    pub const fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// Lowest and highest code of an integer type.
    #[must_use]
    pub fn limits(self) -> Option<(f64, f64)> {
        match self {
            Self::I8 => Some((f64::from(i8::MIN), f64::from(i8::MAX))),
            Self::U8 => Some((0.0, f64::from(u8::MAX))),
            Self::I16 => Some((f64::from(i16::MIN), f64::from(i16::MAX))),
            Self::U16 => Some((0.0, f64::from(u16::MAX))),
            Self::I32 => Some((f64::from(i32::MIN), f64::from(i32::MAX))),
            Self::F32 | Self::F64 => None,
        }
    }

    /// Turns big-endian codes into little-endian ones, or back, in place.
    pub fn swap_bytes(self, codes: &mut [u8]) {
        codes.chunks_exact_mut(self.bytes()).for_each(<[u8]>::reverse);
    }

    /// Codes as numbers, from little-endian bytes.
    #[must_use]
    pub fn decode(self, codes: &[u8]) -> Vec<f64> {
        macro_rules! numbers {
            ($number:ty) => {
                codes
                    .chunks_exact(size_of::<$number>())
                    .map(|code| {
                        f64::from(<$number>::from_le_bytes(code.try_into().expect("chunks have the code's size")))
                    })
                    .collect()
            };
        }
        match self {
            Self::I8 => numbers!(i8),
            Self::U8 => numbers!(u8),
            Self::I16 => numbers!(i16),
            Self::U16 => numbers!(u16),
            Self::I32 => numbers!(i32),
            Self::F32 => numbers!(f32),
            Self::F64 => numbers!(f64),
        }
    }
}

/// Volts of a code: gain * code + offset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// Volts per code.
    pub gain: f64,
    /// Volts at code 0.
    pub offset: f64,
}

/// What all segments of a channel share.
#[derive(Clone, Debug, PartialEq)]
pub struct Head {
    /// Format of the file.
    pub format: &'static str,
    /// Instrument, as the file has it.
    pub instrument: Option<String>,
    /// Channel.
    pub channel: Option<String>,
    /// Unit of a scaled value.
    pub unit: Option<String>,
    /// Type of a code.
    pub code_type: CodeType,
    /// Samples of one segment.
    pub samples: usize,
    /// Time between samples, as the file has it.
    pub dt_s: Option<f64>,
    /// What makes a value of a code.
    pub scale: Option<Scale>,
    /// Gain as the header has it.
    pub header_gain: Option<f64>,
    /// Offset as the header has it; its sign is the vendor's.
    pub header_offset: Option<f64>,
    /// Lowest and highest code of the converter.
    pub rails: Option<(f64, f64)>,
    /// Time of the acquisition in ISO 8601, zone of the instrument.
    pub acquired_at: Option<String>,
    /// Leading axes of an array, without the samples' own; empty otherwise.
    pub shape: Vec<usize>,
}

/// Where the codes of a record are.
#[derive(Clone, Debug, PartialEq)]
pub enum Payload {
    /// In the file, as they are.
    File {
        /// From this byte.
        byte_offset: u64,
        /// Whether they are big-endian.
        big_endian: bool,
    },
    /// Decoded from text: little-endian bytes of the head's code type.
    Decoded(Arc<[u8]>),
}

/// One waveform: one segment of one channel.
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    /// What it shares with the other segments.
    pub head: Arc<Head>,
    /// Its segment, where the file holds several.
    pub segment: Option<u32>,
    /// Time of sample 0 relative to the trigger, sub-sample part included.
    pub t0_s: Option<f64>,
    /// Time of its trigger since that of the first segment.
    pub trigger_s: Option<f64>,
    /// Its codes.
    pub payload: Payload,
}

impl Record {
    /// Bytes that its codes take.
    #[must_use]
    pub fn code_bytes(&self) -> usize {
        self.head.samples * self.head.code_type.bytes()
    }

    /// Its codes as little-endian bytes, read from the file that it came from.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn read<F: io::Read + io::Seek>(&self, file: &mut F) -> io::Result<Vec<u8>> {
        match &self.payload {
            Payload::Decoded(codes) => Ok(codes.to_vec()),
            Payload::File { byte_offset, big_endian } => {
                let mut codes = vec![0; self.code_bytes()];
                file.seek(io::SeekFrom::Start(*byte_offset))?;
                file.read_exact(&mut codes)?;
                if *big_endian {
                    self.head.code_type.swap_bytes(&mut codes);
                }
                Ok(codes)
            }
        }
    }

    /// Scaled values of its codes; the codes themselves where the file has no scale.
    #[must_use]
    pub fn values(&self, codes: &[u8]) -> Vec<f64> {
        let mut values = self.head.code_type.decode(codes);
        if let Some(Scale { gain, offset }) = self.head.scale {
            values.iter_mut().for_each(|value| *value = gain * *value + offset);
        }
        values
    }
}
