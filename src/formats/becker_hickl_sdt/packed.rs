//! Compressed blocks: a zip archive of one file. Only its first header is read, never a directory, so that its claims
//! allocate nothing.

use std::io::{self, Read, SeekFrom};
use std::ops::ControlFlow;

use flate2::Crc;
use flate2::bufread::DeflateDecoder;

use crate::waveform::{CodeType, ReadSeek, Unpack};

/// Largest ratio of unpacked to packed bytes in deflate.
const DEFLATE_RATIO: u64 = 1032;
/// Length of the header before a file in an archive.
const HEADER_BYTES: u64 = 30;
const SIGNATURE: [u8; 4] = *b"PK\x03\x04";
/// Compression methods.
const STORED: u16 = 0;
const DEFLATED: u16 = 8;
/// Flags: encrypted; the CRC follows the data.
const ENCRYPTED: u16 = 1;
const CRC_FOLLOWS: u16 = 8;
/// Bytes that are in memory at a time.
const PIECE_BYTES: u64 = 1 << 14;

/// A block in its archive.
#[derive(Clone, Copy, Debug)]
pub(super) struct Packed {
    pub(super) start: u64,
    pub(super) end: u64,
    /// Length of the unpacked block.
    pub(super) unpacked: u64,
}

impl Packed {
    /// Whether this many packed bytes can hold the unpacked ones.
    pub(super) fn is_possible(self) -> bool {
        self.unpacked <= (self.end - self.start).saturating_mul(DEFLATE_RATIO)
    }

    /// A range of its unpacked bytes.
    pub(super) fn part(self, from: u64, length: u64, code_type: CodeType) -> Part {
        Part { block: self, from, length, width: code_type.bytes() as u64 }
    }
}

/// A curve of a block.
#[derive(Debug)]
pub(super) struct Part {
    block: Packed,
    from: u64,
    length: u64,
    width: u64,
}

fn damaged(problem: impl Into<String>) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, problem.into())
}

impl Unpack for Part {
    fn unpack(
        &self,
        file: &mut dyn ReadSeek,
        take: &mut dyn FnMut(&[u8]) -> io::Result<ControlFlow<()>>,
    ) -> io::Result<()> {
        let curve = self.curve(file)?;
        for piece in curve.chunks((PIECE_BYTES / self.width * self.width) as usize) {
            if take(piece)?.is_break() {
                break;
            }
        }
        Ok(())
    }
}

impl Part {
    /// The curve. It unpacks the whole block, so that nothing is passed on before the checksum is right.
    fn curve(&self, file: &mut dyn ReadSeek) -> io::Result<Vec<u8>> {
        file.seek(SeekFrom::Start(self.block.start))?;
        let length = self.block.end - self.block.start;
        let mut header = [0; HEADER_BYTES as usize];
        let mut archive = io::BufReader::new(file.take(length));
        archive.read_exact(&mut header)?;
        let word = |at: usize| u16::from_le_bytes([header[at], header[at + 1]]);
        let (flags, method) = (word(6), word(8));
        if header[..4] != SIGNATURE || flags & ENCRYPTED != 0 {
            return Err(damaged("a compressed block is no zip archive; save the file without compression"));
        }
        let names = u64::from(word(26)) + u64::from(word(28));
        io::copy(&mut (&mut archive).take(names), &mut io::sink())?;
        let crc = (flags & CRC_FOLLOWS == 0).then(|| u32::from(word(14)) | u32::from(word(16)) << 16);
        match method {
            STORED => self.within(&mut archive, crc),
            DEFLATED => self.within(&mut DeflateDecoder::new(archive), crc),
            _ => Err(damaged(format!("compression method {method} is not read; save the file without compression"))),
        }
    }

    fn within(&self, unpacked: &mut dyn Read, expected: Option<u32>) -> io::Result<Vec<u8>> {
        let (mut curve, mut crc) = (Vec::new(), Crc::new());
        let mut piece = vec![0; PIECE_BYTES as usize];
        let (mut at, end) = (0, self.from + self.length);
        while at < self.block.unpacked {
            let count = PIECE_BYTES.min(self.block.unpacked - at);
            let piece = &mut piece[..count as usize];
            unpacked.read_exact(piece)?;
            crc.update(piece);
            let (from, to) = (self.from.clamp(at, at + count), end.clamp(at, at + count));
            curve.extend_from_slice(&piece[(from - at) as usize..(to - at) as usize]);
            at += count;
        }
        if expected.is_some_and(|expected| expected != crc.sum()) {
            return Err(damaged(
                "a compressed block does not match its checksum; copy the file from the instrument again",
            ));
        }
        Ok(curve)
    }
}
