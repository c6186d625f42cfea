//! Compressed blocks: a zip archive of one file. Only its first header is read, never a directory, so that its claims
//! allocate nothing.

use std::io::{self, Read, SeekFrom};
use std::ops::ControlFlow;
use std::sync::{Arc, Mutex};

use crate::inflate::{Packing, Unpacker, can_hold};
use crate::waveform::{ReadSeek, Unpack};

/// Length of the header before a file in an archive.
const HEADER_BYTES: u64 = 30;
const SIGNATURE: [u8; 4] = *b"PK\x03\x04";
/// Compression methods.
const STORED: u16 = 0;
const DEFLATED: u16 = 8;
/// Flags: encrypted; the CRC follows the data.
const ENCRYPTED: u16 = 1;
const CRC_FOLLOWS: u16 = 8;
/// Bytes that are in memory at a time, besides a curve.
const PIECE_BYTES: u64 = 1 << 14;

/// A block in its archive.
#[derive(Debug)]
pub(super) struct Packed {
    pub(super) start: u64,
    pub(super) end: u64,
    /// Length of the unpacked block.
    pub(super) unpacked: u64,
    /// Length of a curve.
    pub(super) curve_bytes: u64,
    /// Where the last curve ended: the next one continues there. An image has as many curves as pixels.
    pub(super) resumed: Mutex<Option<Stream>>,
}

/// Unpacking under way.
#[derive(Debug)]
pub(super) struct Stream {
    unpacker: Unpacker,
    crc: Option<u32>,
}

/// A curve of a block, by its number.
#[derive(Debug)]
pub(super) struct Part {
    pub(super) block: Arc<Packed>,
    pub(super) curve: u32,
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
        let curve = self.block.curve(file, u64::from(self.curve))?;
        for piece in curve.chunks(PIECE_BYTES as usize) {
            if take(piece)?.is_break() {
                break;
            }
        }
        Ok(())
    }
}

impl Packed {
    /// Whether this many packed bytes can hold the unpacked ones.
    pub(super) fn is_possible(&self) -> bool {
        can_hold(self.end - self.start, self.unpacked)
    }

    /// A curve, whole. The checksum is compared where the block ends.
    fn curve(&self, file: &mut dyn ReadSeek, number: u64) -> io::Result<Vec<u8>> {
        let from = number * self.curve_bytes;
        let resumed = self.resumed.lock().ok().and_then(|mut resumed| resumed.take());
        let mut stream = match resumed {
            Some(stream) if stream.unpacker.position() <= from => stream,
            _ => self.start(file)?,
        };
        let mut skipped = vec![0; PIECE_BYTES as usize];
        while stream.unpacker.position() < from {
            let count = PIECE_BYTES.min(from - stream.unpacker.position());
            stream.read(file, &mut skipped[..count as usize])?;
        }
        let mut curve = vec![0; self.curve_bytes as usize];
        stream.read(file, &mut curve)?;
        if stream.unpacker.position() < self.unpacked {
            if let Ok(mut resumed) = self.resumed.lock() {
                *resumed = Some(stream);
            }
        } else if stream.crc.is_some_and(|crc| crc != stream.unpacker.crc()) {
            return Err(damaged(
                "a compressed block does not match its checksum; copy the file from the instrument again",
            ));
        }
        Ok(curve)
    }

    /// Starts at the beginning of the block.
    fn start(&self, file: &mut dyn ReadSeek) -> io::Result<Stream> {
        file.seek(SeekFrom::Start(self.start))?;
        let length = self.end - self.start;
        let mut header = [0; HEADER_BYTES as usize];
        file.take(length).read_exact(&mut header)?;
        let word = |at: usize| u16::from_le_bytes([header[at], header[at + 1]]);
        let (flags, method) = (word(6), word(8));
        if header[..4] != SIGNATURE || flags & ENCRYPTED != 0 {
            return Err(damaged("a compressed block is no zip archive; save the file without compression"));
        }
        let packing = match method {
            STORED => Packing::Stored,
            DEFLATED => Packing::Deflate,
            _ => {
                let problem = format!("compression method {method} is not read; save the file without compression");
                return Err(damaged(problem));
            }
        };
        let before = HEADER_BYTES + u64::from(word(26)) + u64::from(word(28));
        let crc = (flags & CRC_FOLLOWS == 0).then(|| u32::from(word(14)) | u32::from(word(16)) << 16);
        let unpacker = Unpacker::new(packing, self.start + before, length.saturating_sub(before));
        Ok(Stream { unpacker, crc })
    }
}

impl Stream {
    fn read(&mut self, file: &mut dyn ReadSeek, bytes: &mut [u8]) -> io::Result<()> {
        if self.unpacker.read(file, bytes)? < bytes.len() {
            return Err(damaged("a compressed block unpacks to fewer bytes than it claims; copy the file again"));
        }
        Ok(())
    }
}
