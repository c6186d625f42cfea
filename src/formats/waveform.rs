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
/// Bytes of a file that are read straight to where they are wanted, at a time.
const LARGE_PIECE_BYTES: usize = 1 << 22;

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

/// Evaluates an expression for the number that a code is.
macro_rules! by_type {
    ($code_type:expr, $number:ident => $value:expr) => {
        match $code_type {
            CodeType::I8 => by_type!(@ $number = i8, $value),
            CodeType::U8 => by_type!(@ $number = u8, $value),
            CodeType::I16 => by_type!(@ $number = i16, $value),
            CodeType::U16 => by_type!(@ $number = u16, $value),
            CodeType::I32 => by_type!(@ $number = i32, $value),
            CodeType::U32 => by_type!(@ $number = u32, $value),
            CodeType::F32 => by_type!(@ $number = f32, $value),
            CodeType::F64 => by_type!(@ $number = f64, $value),
        }
    };
    (@ $number:ident = $type:ty, $value:expr) => {{
        type $number = $type;
        $value
    }};
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
        by_type!(self, Number => numbers::<Number>(codes).map(value).collect())
    }

    /// The same into values that are there: as many as codes.
    fn decode_into(self, codes: &[u8], target: &mut [f64], value: impl Fn(f64) -> f64) {
        by_type!(self, Number => {
            target.iter_mut().zip(numbers::<Number>(codes)).for_each(|(target, code)| *target = value(code));
        });
    }
}

/// Numbers of one type from little-endian bytes.
trait LittleEndian: Sized {
    /// Bytes of a number.
    const BYTES: usize = size_of::<Self>();
    /// A number from as many bytes.
    fn number(bytes: &[u8]) -> f64;
}

macro_rules! little_endian {
    ($($number:ty),*) => {
        $(impl LittleEndian for $number {
            fn number(bytes: &[u8]) -> f64 {
                f64::from(Self::from_le_bytes(bytes.try_into().expect("chunks have the code's size")))
            }
        })*
    };
}

little_endian!(i8, u8, i16, u16, i32, u32, f32, f64);

fn numbers<N: LittleEndian>(codes: &[u8]) -> impl Iterator<Item = f64> {
    codes.chunks_exact(N::BYTES).map(N::number)
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

    /// Reads the codes of some samples of records of one type into `target`, one record after another, little-endian.
    /// Codes that lie in the file as they are asked for go straight there, and those of records that follow one another
    /// in one go. `pause` is called between pieces.
    ///
    /// # Errors
    /// When the file cannot be read.
    ///
    /// # Panics
    /// When a record does not have these samples, or `target` is not as long as their codes.
    pub fn read_into(
        records: &[Self],
        file: &mut dyn ReadSeek,
        samples: &Range<usize>,
        target: &mut [u8],
        pause: &mut dyn FnMut(),
    ) -> io::Result<()> {
        let (mut records, mut rest) = (records, target);
        while let Some(first) = records.first() {
            let width = first.head.code_type.bytes();
            let bytes = samples.len() * width;
            let Some((start, big_endian)) = first.place_of(samples) else {
                first.visit(file, samples.clone(), &mut |codes| {
                    pause();
                    let (here, after) = std::mem::take(&mut rest).split_at_mut(codes.len());
                    here.copy_from_slice(codes);
                    rest = after;
                })?;
                records = &records[1..];
                continue;
            };
            let follows =
                |(record, n): &(&Self, u64)| record.place_of(samples) == Some((start + n * bytes as u64, big_endian));
            let count = records.iter().zip(0..).take_while(follows).count();
            let (here, after) = std::mem::take(&mut rest).split_at_mut(count * bytes);
            file.seek(SeekFrom::Start(start))?;
            for piece in here.chunks_mut(LARGE_PIECE_BYTES) {
                pause();
                file.read_exact(piece)?;
                if big_endian {
                    first.head.code_type.swap_bytes(piece);
                }
            }
            (records, rest) = (&records[count..], after);
        }
        assert!(rest.is_empty(), "the target has room for the codes, and no more");
        Ok(())
    }

    /// Where the codes of some samples begin and whether they are big-endian, if they lie one after another.
    fn place_of(&self, samples: &Range<usize>) -> Option<(u64, bool)> {
        assert!(samples.start <= samples.end && samples.end <= self.head.samples, "samples of another record");
        let (byte_offset, big_endian) = self.contiguous()?;
        Some((byte_offset + (samples.start * self.head.code_type.bytes()) as u64, big_endian))
    }

    /// Scaled values of codes as [`Record::values`] has them, into `target`: as many.
    pub fn values_into(&self, codes: &[u8], target: &mut [f64]) {
        match self.head.scale {
            Some(Scale { gain, offset }) => {
                self.head.code_type.decode_into(codes, target, |code| gain * code + offset);
            }
            None => self.head.code_type.decode_into(codes, target, |code| code),
        }
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

#[cfg(test)]
mod tests;
