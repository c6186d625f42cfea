//! Blocks of memory that raw files are read into, used again when no row needs them any more: a fresh block costs more
//! than what is read into it, since the kernel clears its pages first.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use arrow_buffer::Buffer;
use bytes::Bytes;

/// A block is not used for less than this share of its bytes.
const USED_SHARE: usize = 4;

/// Blocks that wait to be used again: never more than were in use at once.
#[derive(Default)]
pub struct Blocks {
    free: Mutex<Vec<Vec<u8>>>,
}

/// Bytes whose block goes back when the last row lets go of them.
struct Lent {
    bytes: Vec<u8>,
    owner: Arc<Blocks>,
}

impl Blocks {
    /// An empty block with room for `bytes`.
    pub fn take(&self, bytes: usize) -> Vec<u8> {
        let mut free = self.free();
        let fits = |block: &Vec<u8>| (bytes..=bytes.saturating_mul(USED_SHARE)).contains(&block.capacity());
        match free.iter().rposition(fits) {
            Some(place) => free.swap_remove(place),
            None => Vec::with_capacity(bytes),
        }
    }

    /// What was read, for rows to share.
    pub fn lend(self: &Arc<Self>, bytes: Vec<u8>) -> Buffer {
        Buffer::from(Bytes::from_owner(Lent { bytes, owner: Arc::clone(self) }))
    }

    fn free(&self) -> MutexGuard<'_, Vec<Vec<u8>>> {
        self.free.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl AsRef<[u8]> for Lent {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

impl Drop for Lent {
    fn drop(&mut self) {
        let mut block = std::mem::take(&mut self.bytes);
        block.clear();
        self.owner.free().push(block);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_comes_back_with_the_last_of_its_rows() {
        let blocks = Arc::new(Blocks::default());
        let mut block = blocks.take(1000);
        let place = block.as_ptr();
        block.extend([7; 900]);
        let lent = blocks.lend(block);
        let row = lent.slice_with_length(100, 8);
        drop(lent);
        assert_eq!((row.as_slice(), row.as_ptr()), ([7; 8].as_slice(), place.wrapping_add(100)));
        assert!(blocks.free().is_empty(), "a row still has it");
        drop(row);
        assert!(blocks.take(1001).is_empty() && blocks.take(200).is_empty(), "too small, too large");
        let again = blocks.take(500);
        assert_eq!((again.len(), again.as_ptr()), (0, place));
    }
}
