//! A file writer that computes digests of the bytes it writes, section by section.

use std::io::{self, Write};

use super::Digest;
use super::disk::Output;

/// Bytes that are digested and written at once. The Parquet crate passes small pieces, which BLAKE3 would digest one by
/// one; of large blocks it digests 16 KiB in parallel.
const BLOCK_BYTES: usize = 1 << 18;

/// Writes bytes to a file in blocks, and digests them.
pub struct Digesting {
    file: Output,
    /// Bytes of the unfinished block.
    block: Vec<u8>,
    /// Of the bytes since the last section.
    section: blake3::Hasher,
    bytes: u64,
}

impl Digesting {
    /// Writes from the start of the file.
    pub fn new(file: Output) -> Self {
        let block = Vec::with_capacity(BLOCK_BYTES);
        Self { file, block, section: blake3::Hasher::new(), bytes: 0 }
    }

    /// Ends a section: gives the digest of the bytes since the last one.
    pub fn end_section(&mut self) -> io::Result<Digest> {
        self.flush()?;
        let digest = self.section.finalize().into();
        self.section.reset();
        Ok(digest)
    }

    /// Number of bytes of all sections that have ended.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }
}

impl Write for Digesting {
    fn write(&mut self, buffer: &[u8]) -> io::Result<usize> {
        let count = buffer.len().min(BLOCK_BYTES - self.block.len());
        self.block.extend_from_slice(&buffer[..count]);
        if self.block.len() == BLOCK_BYTES {
            self.flush()?;
        }
        Ok(count)
    }
    fn flush(&mut self) -> io::Result<()> {
        self.file.write_all(&self.block)?;
        self.section.update(&self.block);
        self.bytes += self.block.len() as u64;
        self.block.clear();
        Ok(())
    }
}
