//! One record of an oscilloscope, whatever the vendor: raw codes, and how they become volts and seconds.
//!
//! volts = gain * code + offset; sample `i` is at `t0_s + i * dt_s` after the trigger. `t0_s` includes the sub-sample
//! part of the trigger time: without it, times are off by up to one sample.

use std::fmt::Debug;
use std::io::{self, Read, Seek, SeekFrom};
use std::ops::{ControlFlow, Range};
use std::sync::Arc;

/// Bytes of a file that are in memory at a time while its codes are passed on.
const PIECE_BYTES: usize = 1 << 17;

/// What a record holds. Only some kinds can be timed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// One voltage after another.
    Waveform,
    /// One voltage after another, averaged over triggers by the instrument.
    Average,
    /// Photons counted in each time bin.
    Counts,
    /// Extremes between samples: envelope, peak detect.
    Envelope,
    /// Logic levels.
    Digital,
    /// Power or voltage over frequency.
    Spectrum,
    /// In-phase and quadrature samples of a carrier.
    Iq,
}

impl Kind {
    /// Name, as `inspect` prints it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Waveform => "waveform",
            Self::Average => "average",
            Self::Counts => "counts",
            Self::Envelope => "envelope",
            Self::Digital => "digital",
            Self::Spectrum => "spectrum",
            Self::Iq => "iq",
        }
    }

    /// Whether arrival times can be measured in it.
    #[must_use]
    pub const fn is_timed(self) -> bool {
        matches!(self, Self::Waveform | Self::Average | Self::Counts)
    }
}

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
    /// Unsigned, 32 bits.
    U32,
    /// Floating, 32 bits.
    F32,
    /// Floating, 64 bits.
    F64,
}

impl CodeType {
    /// All types.
    pub const ALL: [Self; 8] = [Self::I8, Self::U8, Self::I16, Self::U16, Self::I32, Self::U32, Self::F32, Self::F64];

    /// Name, as in the tables.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::I8 => "i8",
            Self::U8 => "u8",
            Self::I16 => "i16",
            Self::U16 => "u16",
            Self::I32 => "i32",
            Self::U32 => "u32",
            Self::F32 => "f32",
            Self::F64 => "f64",
        }
    }

    /// Returns the type of this name.
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
            Self::I32 | Self::U32 | Self::F32 => 4,
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
            Self::U32 => Some((0.0, f64::from(u32::MAX))),
            Self::F32 | Self::F64 => None,
        }
    }

    /// Turns big-endian codes into little-endian ones, or back, in place.
    pub fn swap_bytes(self, codes: &mut [u8]) {
        codes.chunks_exact_mut(self.bytes()).for_each(<[u8]>::reverse);
    }

    /// Decodes little-endian bytes into numbers.
    #[must_use]
    pub fn decode(self, codes: &[u8]) -> Vec<f64> {
        self.decode_as(codes, |code| code)
    }

    /// Applies `value` to each code as it is decoded: one pass, since memory bandwidth limits the speed.
    fn decode_as(self, codes: &[u8], value: impl Fn(f64) -> f64) -> Vec<f64> {
        macro_rules! numbers {
            ($number:ty) => {
                codes
                    .chunks_exact(size_of::<$number>())
                    .map(|code| {
                        let code = <$number>::from_le_bytes(code.try_into().expect("chunks have the code's size"));
                        value(f64::from(code))
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
            Self::U32 => numbers!(u32),
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

/// What all segments of a channel have in common.
#[derive(Clone, Debug, PartialEq)]
pub struct Head {
    /// Format of the file.
    pub format: &'static str,
    /// What its records hold.
    pub kind: Kind,
    /// Instrument, as the file names it.
    pub instrument: Option<String>,
    /// Channel.
    pub channel: Option<String>,
    /// Unit of a scaled value.
    pub unit: Option<String>,
    /// Type of a code.
    pub code_type: CodeType,
    /// Samples of one segment.
    pub samples: usize,
    /// Time between samples, as the file gives it. (For a spectrum: hertz between them.)
    pub dt_s: Option<f64>,
    /// Whether the time of sample 0 is uncertain by some samples: the header gives only the nominal trigger position.
    pub t0_nominal: bool,
    /// Converts a code to a value.
    pub scale: Option<Scale>,
    /// Gain, as the header gives it.
    pub header_gain: Option<f64>,
    /// Offset, as the header gives it; its sign is the vendor's.
    pub header_offset: Option<f64>,
    /// Lowest and highest code of the converter.
    pub rails: Option<(f64, f64)>,
    /// Time of the acquisition in ISO 8601, in the time zone of the instrument.
    pub acquired_at: Option<String>,
    /// Leading axes of an array, without the axis of the samples; empty otherwise.
    pub shape: Vec<usize>,
}

impl Head {
    /// A waveform without any optional field.
    #[must_use]
    pub fn new(format: &'static str, code_type: CodeType, samples: usize) -> Self {
        Self {
            format,
            kind: Kind::Waveform,
            instrument: None,
            channel: None,
            unit: None,
            code_type,
            samples,
            dt_s: None,
            t0_nominal: false,
            scale: None,
            header_gain: None,
            header_offset: None,
            rails: None,
            acquired_at: None,
            shape: Vec::new(),
        }
    }
}

/// A file that records are read from.
pub trait ReadSeek: Read + Seek {}
impl<T: Read + Seek> ReadSeek for T {}

/// Codes that are packed in their file (compressed, in chunks, in a wider record). Each read unpacks them anew.
pub trait Unpack: Debug + Send + Sync {
    /// Passes on all codes in order, little-endian, in pieces of whole codes, until `take` breaks.
    ///
    /// # Errors
    /// When the file cannot be read, or when its content contradicts its header.
    fn unpack(
        &self,
        file: &mut dyn ReadSeek,
        take: &mut dyn FnMut(&[u8]) -> io::Result<ControlFlow<()>>,
    ) -> io::Result<()>;
}

/// Where the codes of a record are.
#[derive(Clone, Debug)]
pub enum Payload {
    /// In the file, unpacked.
    File {
        /// Where the first code begins.
        byte_offset: u64,
        /// Bytes from one code to the next: more than one code where channels are interleaved.
        stride: u64,
        /// Whether the codes are big-endian.
        big_endian: bool,
    },
    /// In the file, packed.
    Packed(Arc<dyn Unpack>),
    /// Decoded from text: little-endian bytes of the head's code type.
    Decoded(Arc<[u8]>),
}

/// One waveform: one segment of one channel.
#[derive(Clone, Debug)]
pub struct Record {
    /// What it has in common with the other segments.
    pub head: Arc<Head>,
    /// Number of the segment, where the file holds several.
    pub segment: Option<u32>,
    /// Time of sample 0 relative to the trigger, sub-sample part included.
    pub t0_s: Option<f64>,
    /// Time of its trigger after the trigger of the first segment.
    pub trigger_s: Option<f64>,
    /// Its codes.
    pub payload: Payload,
}

impl Record {
    /// Bytes of all its codes.
    #[must_use]
    pub fn code_bytes(&self) -> usize {
        self.head.samples * self.head.code_type.bytes()
    }

    /// Time of a sample after the trigger, if the file has a time base. (Of a spectrum: its frequency, Hz.)
    #[must_use]
    pub fn time_s(&self, sample: usize) -> Option<f64> {
        Some(self.t0_s? + sample as f64 * self.head.dt_s?)
    }

    /// Where its codes begin and whether they are big-endian, if the file holds them one after another.
    #[must_use]
    pub fn contiguous(&self) -> Option<(u64, bool)> {
        match self.payload {
            Payload::File { byte_offset, stride, big_endian } if stride == self.head.code_type.bytes() as u64 => {
                Some((byte_offset, big_endian))
            }
            _ => None,
        }
    }

    /// Passes on the codes of some samples, little-endian, in pieces of whole codes: a record may be larger than
    /// memory.
    ///
    /// # Errors
    /// When the file cannot be read.
    ///
    /// # Panics
    /// When the record does not have these samples.
    pub fn visit(&self, file: &mut dyn ReadSeek, samples: Range<usize>, take: &mut dyn FnMut(&[u8])) -> io::Result<()> {
        assert!(samples.start <= samples.end && samples.end <= self.head.samples, "samples of another record");
        let width = self.head.code_type.bytes();
        match &self.payload {
            Payload::Decoded(codes) => take(&codes[samples.start * width..samples.end * width]),
            Payload::Packed(packed) => {
                let (mut skip, mut left) = (samples.start * width, (samples.end - samples.start) * width);
                packed.unpack(file, &mut |codes| {
                    let skipped = skip.min(codes.len());
                    skip -= skipped;
                    let codes = &codes[skipped..];
                    let codes = &codes[..left.min(codes.len())];
                    left -= codes.len();
                    take(codes);
                    Ok(if left == 0 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) })
                })?;
                if left > 0 {
                    return Err(io::Error::new(io::ErrorKind::UnexpectedEof, "holds fewer samples than its head says"));
                }
            }
            Payload::File { byte_offset, stride, big_endian } => {
                let stride = *stride as usize;
                let per_piece = (PIECE_BYTES / stride).max(1);
                let mut piece = vec![0; per_piece.min(samples.len()) * stride];
                for start in samples.clone().step_by(per_piece) {
                    let count = per_piece.min(samples.end - start);
                    file.seek(SeekFrom::Start(byte_offset + (start * stride) as u64))?;
                    file.read_exact(&mut piece[..(count - 1) * stride + width])?;
                    if stride > width {
                        (1..count).for_each(|i| piece.copy_within(i * stride..i * stride + width, i * width));
                    }
                    let codes = &mut piece[..count * width];
                    if *big_endian {
                        self.head.code_type.swap_bytes(codes);
                    }
                    take(codes);
                }
            }
        }
        Ok(())
    }

    /// Returns the codes of some samples, little-endian.
    ///
    /// # Errors
    /// When the file cannot be read.
    ///
    /// # Panics
    /// When the record does not have these samples.
    pub fn read(&self, file: &mut dyn ReadSeek, samples: Range<usize>) -> io::Result<Vec<u8>> {
        let mut codes = Vec::with_capacity(samples.len() * self.head.code_type.bytes());
        self.visit(file, samples, &mut |piece| codes.extend_from_slice(piece))?;
        Ok(codes)
    }

    /// Scaled values of codes, or the codes themselves where the file has no scale.
    #[must_use]
    pub fn values(&self, codes: &[u8]) -> Vec<f64> {
        match self.head.scale {
            Some(Scale { gain, offset }) => self.head.code_type.decode_as(codes, |code| gain * code + offset),
            None => self.head.code_type.decode(codes),
        }
    }
}
