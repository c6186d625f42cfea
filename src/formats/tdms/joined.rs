//! Where a channel's values are, and waveforms that lie in several places.

use std::io::{self, SeekFrom};
use std::ops::ControlFlow;
use std::sync::Arc;

use crate::waveform::{CodeType, ReadSeek, Unpack};

/// Bytes that are in memory at a time.
const PIECE_BYTES: u64 = 1 << 16;

/// Values of a channel in one segment: in each chunk some, with the same distance between neighbours.
#[derive(Clone, Debug)]
pub(super) struct Extent {
    /// Where the first value begins.
    pub at: u64,
    /// Values of a chunk.
    pub values: u64,
    pub chunks: u64,
    /// Bytes from a chunk to the next.
    pub chunk_bytes: u64,
    /// Bytes from a value to the next.
    pub stride: u64,
    pub big_endian: bool,
}

impl Extent {
    /// Values of all chunks.
    pub(super) fn total(&self) -> u64 {
        self.values * self.chunks
    }

    /// Where value `skip` begins, and how many values follow from there on at the same distance, itself included;
    /// `None` behind the last one.
    pub(super) fn run(&self, skip: u64) -> Option<(u64, u64)> {
        if skip >= self.total() {
            return None;
        }
        let (chunk, value) = (skip / self.values, skip % self.values);
        let at = self.at + chunk * self.chunk_bytes + value * self.stride;
        let is_seamless = self.chunk_bytes == self.values * self.stride;
        Some((at, if is_seamless { self.total() - skip } else { self.values - value }))
    }
}

/// A waveform whose values lie in several chunks.
#[derive(Debug)]
pub(super) struct Joined {
    /// Those of its channel.
    pub pieces: Arc<[Extent]>,
    /// The piece of its first value, and how many values of that come before.
    pub first: usize,
    pub skip: u64,
    pub values: u64,
    pub code_type: CodeType,
}

impl Unpack for Joined {
    fn unpack(
        &self,
        file: &mut dyn ReadSeek,
        take: &mut dyn FnMut(&[u8]) -> io::Result<ControlFlow<()>>,
    ) -> io::Result<()> {
        let (mut skip, mut left) = (self.skip, self.values);
        let width = self.code_type.bytes() as u64;
        for piece in &self.pieces[self.first..] {
            while let Some((at, run)) = piece.run(skip).filter(|_| left > 0) {
                let count = run.min(left).min((PIECE_BYTES / piece.stride).max(1));
                let mut bytes = vec![0; ((count - 1) * piece.stride + width) as usize];
                file.seek(SeekFrom::Start(at))?;
                file.read_exact(&mut bytes)?;
                let mut codes = bytes;
                if piece.stride > width {
                    let values = codes.chunks(piece.stride as usize);
                    codes = values.flat_map(|value| value[..width as usize].iter().copied()).collect();
                }
                if piece.big_endian {
                    self.code_type.swap_bytes(&mut codes);
                }
                if take(&codes)?.is_break() {
                    return Ok(());
                }
                skip += count;
                left -= count;
            }
            skip = 0;
        }
        Ok(())
    }
}
