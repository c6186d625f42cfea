//! A file writer that computes a digest of the bytes it writes.

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
    hasher: blake3::Hasher,
    /// Digest of the bytes after the pages; `None` before.
    footer: Option<blake3::Hasher>,
    bytes: u64,
}

impl Digesting {
    /// Writes from the start of the file.
    pub fn new(file: Output) -> Self {
        let block = Vec::with_capacity(BLOCK_BYTES);
        Self { file, block, hasher: blake3::Hasher::new(), footer: None, bytes: 0 }
    }

    /// Starts the additional digest of the footer.
    pub fn begin_footer(&mut self) -> io::Result<()> {
        self.flush()?;
        self.footer = Some(blake3::Hasher::new());
        Ok(())
    }

    /// Number of bytes, the digest of all of them, and that of the footer. The caller must flush first.
    pub fn finish(self) -> (u64, Digest, Digest) {
        (self.bytes, self.hasher.finalize().into(), self.footer.unwrap_or_default().finalize().into())
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
        self.hasher.update(&self.block);
        if let Some(footer) = &mut self.footer {
            footer.update(&self.block);
        }
        self.bytes += self.block.len() as u64;
        self.block.clear();
        Ok(())
    }
}
