//! A file whose bytes are digested on their way.

use std::fs::File;
use std::io::{self, Write};

use super::Digest;

/// Bytes that are digested and written at once: the Parquet crate hands them on in small pieces, which BLAKE3 takes one by one, where of large ones it takes
/// sixteen kilobytes side by side.
const BLOCK_BYTES: usize = 1 << 18;

/// Passes bytes on to a file in blocks, and digests them on the way.
pub struct Digesting {
    file: File,
    /// What waits for its block to be full.
    block: Vec<u8>,
    hasher: blake3::Hasher,
    /// Of what is written after the pages; none before.
    footer: Option<blake3::Hasher>,
    bytes: u64,
}

impl Digesting {
    /// Into a file from its start.
    pub fn new(file: File) -> Self {
        let block = Vec::with_capacity(BLOCK_BYTES);
        Self { file, block, hasher: blake3::Hasher::new(), footer: None, bytes: 0 }
    }

    /// Digests also what follows from here on for itself.
    pub fn begin_footer(&mut self) -> io::Result<()> {
        self.flush()?;
        self.footer = Some(blake3::Hasher::new());
        Ok(())
    }

    /// How many bytes there were, the digest of all of them, and that of the footer. All is to be flushed.
    pub fn finish(self) -> (u64, Digest, Digest) {
        (self.bytes, self.hasher.finalize().into(), self.footer.unwrap_or_default().finalize().into())
    }
}

impl Write for Digesting {
    fn write(&mut self, buffer: &[u8]) -> io::Result<usize> {
        let taken = buffer.len().min(BLOCK_BYTES - self.block.len());
        self.block.extend_from_slice(&buffer[..taken]);
        if self.block.len() == BLOCK_BYTES {
            self.flush()?;
        }
        Ok(taken)
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
