//! RIFF/WAVE: integer PCM of 8 (unsigned), 16, 24 and 32 bits, floats of 32 and 64 bits, any number of channels.
//!
//! value = code / 2^(bits - 1), for 8 bits (code - 128) / 128. This is a fraction of full scale, since the file has no
//! volts and no trigger (`t0_s` is `None`). Sample i of a channel is i / nSamplesPerSec after the first. Codes narrower
//! than their container are left-justified, so that the container gives the scale (Multimedia Programming Interface and
//! Data Specifications 1.0; WAVEFORMATEXTENSIBLE).
//!
//! Refused by name: RF64, BW64 and W64 (beyond 4 GiB), RIFX (big-endian), compressed samples. Only 8 bit mono was
//! tested on a real file, the rest on files that the tests build.

use std::io::{self, SeekFrom};
use std::ops::ControlFlow;
use std::sync::Arc;

use super::reader::{FormatError, Input, Reader};
use crate::waveform::{CodeType, Head, Payload, ReadSeek, Record, Scale, Unpack};

/// The reader.
pub struct Wav;

/// 24 bit samples that are in memory at a time.
const PIECE_SAMPLES: usize = 1 << 14;
/// Most channels that are accepted: a larger number means a broken header.
const MAX_CHANNELS: u16 = 1024;

impl Reader for Wav {
    fn format(&self) -> &'static str {
        "wav"
    }
    fn extensions(&self) -> &'static [&'static str] {
        &["wav"]
    }
    fn recognises(&self, head: &[u8]) -> bool {
        let riff = [b"RIFF", b"RF64", b"BW64", b"RIFX"].iter().any(|mark| head.starts_with(mark.as_slice()));
        riff && head.get(8..12) == Some(b"WAVE") || head.starts_with(b"riff") && head.get(24..28) == Some(b"wave")
    }

    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let mark = input.bytes("the RIFF head", 0, 12)?;
        if !mark.starts_with(b"RIFF") || mark[8..] != *b"WAVE" {
            let problem = format!(
                "begins with {:?} and is no RIFF/WAVE file; RF64, BW64, W64 and RIFX are not read: \
                 save it as plain WAV",
                String::from_utf8_lossy(&mark[..4])
            );
            return Err(field(0, problem));
        }
        let (format, byte_offset, bytes) = chunks(input)?;
        input.uses(byte_offset..byte_offset + bytes);
        let samples =
            usize::try_from(bytes / format.block).map_err(|_| field(byte_offset, "is too large for this machine"))?;
        let record = |channel: u16| {
            let at = byte_offset + u64::from(channel) * format.width;
            let payload = match format.code {
                Code::Plain(_) => Payload::File { byte_offset: at, stride: format.block, big_endian: false },
                Code::I24 => Payload::Packed(Arc::new(Triples { byte_offset: at, stride: format.block, samples })),
            };
            let head = Arc::new(format.head(self.format(), channel, samples));
            Record { head, segment: None, t0_s: None, trigger_s: None, payload }
        };
        Ok((0..format.channels).map(record).collect())
    }
}

fn field(byte_offset: u64, problem: impl Into<String>) -> FormatError {
    FormatError::Field { byte_offset, problem: problem.into() }
}

/// Returns the format, where the samples begin, and their length in bytes.
fn chunks(input: &mut dyn Input) -> Result<(Format, u64, u64), FormatError> {
    let mut format = None;
    let mut at = 12;
    loop {
        let head = input.bytes("a chunk's head (the data chunk has not come yet)", at, 8)?;
        let bytes = u64::from(u32::from_le_bytes(head[4..].try_into().expect("four bytes")));
        let start = at + 8;
        match &head[..4] {
            b"fmt " => format = Some(Format::read(input, start, bytes)?),
            b"data" => {
                let format = format.ok_or_else(|| field(at, "the data chunk comes before the fmt chunk"))?;
                if bytes == 0 || bytes == u64::from(u32::MAX) {
                    let problem =
                        format!("the data chunk has length {bytes}: the recording was not closed; record it again");
                    return Err(field(at + 4, problem));
                }
                let length = input.length();
                if bytes > length - start {
                    return Err(FormatError::Truncated {
                        what: "the data chunk",
                        byte_offset: start,
                        needed: bytes,
                        length,
                    });
                }
                if bytes % format.block != 0 {
                    let problem = format!("{bytes} bytes of data are no whole number of {} byte blocks", format.block);
                    return Err(field(at + 4, problem));
                }
                trailing(input, start + bytes, bytes % 2)?;
                return Ok((format, start, bytes));
            }
            _ => {}
        }
        input.uses(start..(start + bytes + bytes % 2).min(input.length()));
        // A padding byte follows each chunk of odd length.
        at = start + bytes + bytes % 2;
    }
}

/// Counts the chunks after the samples: names, markers, padding.
fn trailing(input: &mut dyn Input, end: u64, padding: u64) -> Result<(), FormatError> {
    let length = input.length();
    let mut at = end + padding;
    input.uses(end..at.min(length));
    while at + 8 <= length {
        let head = input.peek("a chunk's head", at, 8)?;
        let bytes = u64::from(u32::from_le_bytes(head[4..].try_into().expect("four bytes")));
        let end = at + 8 + bytes + bytes % 2;
        let is_name =
            head[..4].iter().all(|byte| byte.is_ascii_graphic() || *byte == b' ') && !head.starts_with(b"RIFF");
        if !is_name || end > length {
            break;
        }
        input.uses(at..end);
        at = end;
    }
    Ok(())
}

/// How the file stores a code.
#[derive(Clone, Copy)]
enum Code {
    Plain(CodeType),
    /// Three bytes, passed on as `i32`.
    I24,
}

/// The fields of the fmt chunk.
struct Format {
    code: Code,
    channels: u16,
    rate_hz: u32,
    /// Bytes of one code.
    width: u64,
    /// Bytes of one code of every channel: nBlockAlign.
    block: u64,
    /// Significant bits of a code.
    bits: u16,
}

impl Format {
    fn read(input: &mut dyn Input, at: u64, bytes: u64) -> Result<Self, FormatError> {
        let chunk = input.peek("the fmt chunk", at, bytes.clamp(16, 40))?;
        let u16_at = |i: usize| chunk.get(i..i + 2).map_or(0, |two| u16::from_le_bytes([two[0], two[1]]));
        let (channels, block, bits) = (u16_at(2), u16_at(12), u16_at(14));
        let rate_hz = u32::from_le_bytes(chunk[4..8].try_into().expect("four bytes"));
        // WAVEFORMATEXTENSIBLE has the format in the first two bytes of SubFormat, and the significant bits in a field
        // of its own.
        let (tag, valid) = match (u16_at(0), u16_at(18)) {
            (0xFFFE, valid) if bytes >= 40 => (u16_at(24), if valid == 0 { bits } else { valid }),
            (tag, _) => (tag, bits),
        };
        if channels == 0 || channels > MAX_CHANNELS {
            return Err(field(at + 2, format!("nChannels = {channels} is none of 1 to {MAX_CHANNELS}")));
        }
        if rate_hz == 0 {
            return Err(field(at + 4, "nSamplesPerSec = 0: the recording has no time base"));
        }
        let width = block / channels;
        if width == 0 || width * channels != block || u32::from(valid) > 8 * u32::from(width) || valid == 0 {
            let problem = format!("nBlockAlign = {block} and {valid} bits do not fit nChannels = {channels}");
            return Err(field(at + 12, problem));
        }
        let code = match (tag, width) {
            (1, 1) => Code::Plain(CodeType::U8),
            (1, 2) => Code::Plain(CodeType::I16),
            (1, 3) => Code::I24,
            (1, 4) => Code::Plain(CodeType::I32),
            (3, 4) if valid == 32 => Code::Plain(CodeType::F32),
            (3, 8) if valid == 64 => Code::Plain(CodeType::F64),
            _ => {
                let problem = format!(
                    "wFormatTag = {tag:#06x} with {width} bytes per sample is not read; save it as PCM of 8 to 32 bits \
                     or as float"
                );
                return Err(field(at, problem));
            }
        };
        Ok(Self { code, channels, rate_hz, width: u64::from(width), block: u64::from(block), bits: valid })
    }

    fn head(&self, format: &'static str, channel: u16, samples: usize) -> Head {
        let code_type = match self.code {
            Code::Plain(code_type) => code_type,
            Code::I24 => CodeType::I32,
        };
        let full_scale = f64::from(1_u32 << (8 * self.width.min(4) - 1));
        let scale = match code_type {
            CodeType::F32 | CodeType::F64 => None,
            CodeType::U8 => Some(Scale { gain: 1.0 / full_scale, offset: -1.0 }),
            _ => Some(Scale { gain: 1.0 / full_scale, offset: 0.0 }),
        };
        let rails = match code_type {
            _ if u64::from(self.bits) != 8 * self.width => None,
            CodeType::I32 => Some((-full_scale, full_scale - 1.0)),
            _ => code_type.limits(),
        };
        Head {
            channel: Some(if self.channels == 1 { "mono".to_owned() } else { format!("ch{}", channel + 1) }),
            unit: Some("full-scale".to_owned()),
            dt_s: Some(1.0 / f64::from(self.rate_hz)),
            scale,
            rails,
            ..Head::new(format, code_type, samples)
        }
    }
}

/// Three-byte codes.
#[derive(Debug)]
struct Triples {
    byte_offset: u64,
    stride: u64,
    samples: usize,
}

impl Unpack for Triples {
    fn unpack(
        &self,
        file: &mut dyn ReadSeek,
        take: &mut dyn FnMut(&[u8]) -> io::Result<ControlFlow<()>>,
    ) -> io::Result<()> {
        let stride = self.stride as usize;
        let per_piece = (3 * PIECE_SAMPLES / stride).clamp(1, self.samples);
        let mut piece = vec![0; per_piece * stride];
        let mut codes = Vec::with_capacity(4 * per_piece);
        for start in (0..self.samples).step_by(per_piece) {
            let count = per_piece.min(self.samples - start);
            file.seek(SeekFrom::Start(self.byte_offset + start as u64 * self.stride))?;
            file.read_exact(&mut piece[..(count - 1) * stride + 3])?;
            codes.clear();
            for code in piece.chunks(stride).take(count) {
                let sign = if code[2] < 0x80 { 0 } else { 0xFF };
                codes.extend_from_slice(&[code[0], code[1], code[2], sign]);
            }
            if take(&codes)?.is_break() {
                return Ok(());
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
