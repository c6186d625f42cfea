//! Hashes a file in ranges that several processes read. BLAKE3 is a tree of hashes: each process returns the subtrees
//! of its range, and [`join`] combines them into the hash of the whole file.

use blake3::hazmat::{
    ChainingValue, HasherExt, Mode, left_subtree_len, max_subtree_len, merge_subtrees_non_root, merge_subtrees_root,
};
use blake3::{CHUNK_LEN, Hash, Hasher};
use serde::{Deserialize, Serialize};

use super::manifest::hexadecimal;

/// Ranges begin and end at multiples of this many bytes, or with the file. Larger subtrees would not be hashed faster.
pub const BLOCK_BYTES: u64 = 16 << 10;

/// One subtree of the hash of a file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Subtree {
    /// Place of its first byte in the file.
    pub byte_offset: u64,
    /// Bytes.
    pub bytes: u64,
    /// Its chaining value, which differs from the hash of a file with these bytes.
    #[serde(with = "hexadecimal")]
    pub value: Hash,
}

/// Hashes a range of a file, in order.
pub struct StretchHasher {
    /// Place of the next byte, and end of the range.
    at: u64,
    end: u64,
    /// The current subtree.
    hasher: Hasher,
    left: u64,
    subtrees: Vec<Subtree>,
}

impl StretchHasher {
    /// Starts a range of a file. The range must be smaller than the file: the hash of a whole file is finalised
    /// differently.
    ///
    /// # Panics
    /// When `start` is not a multiple of [`BLOCK_BYTES`].
    #[must_use]
    pub fn new(start: u64, end: u64) -> Self {
        assert!(start.is_multiple_of(BLOCK_BYTES), "a stretch begins with a block");
        Self { at: start, end, hasher: Hasher::new(), left: 0, subtrees: Vec::new() }
    }

    /// Place of the next byte.
    #[must_use]
    pub fn at(&self) -> u64 {
        self.at
    }

    /// End of the range.
    #[must_use]
    pub fn end(&self) -> u64 {
        self.end
    }

    /// Adds the next bytes; those after the end of the range are ignored.
    pub fn update(&mut self, bytes: &[u8]) {
        let mut bytes = &bytes[..bytes.len().min((self.end - self.at) as usize)];
        while !bytes.is_empty() {
            if self.left == 0 {
                self.left = subtree_bytes(self.at, self.end);
                self.hasher = Hasher::new();
                self.hasher.set_input_offset(self.at);
                self.subtrees.push(Subtree {
                    byte_offset: self.at,
                    bytes: self.left,
                    value: Hash::from_bytes([0; 32]),
                });
            }
            let (now, later) = bytes.split_at(bytes.len().min(self.left as usize));
            self.hasher.update(now);
            self.at += now.len() as u64;
            self.left -= now.len() as u64;
            bytes = later;
            if self.left == 0 {
                let subtree = self.subtrees.last_mut().expect("pushed where it began");
                subtree.value = Hash::from_bytes(self.hasher.finalize_non_root());
            }
        }
    }

    /// The subtrees of the range.
    ///
    /// # Panics
    /// When bytes of the range are missing.
    #[must_use]
    pub fn finish(self) -> Vec<Subtree> {
        assert_eq!(self.at, self.end, "bytes of a stretch");
        self.subtrees
    }
}

/// Bytes of the largest subtree that begins at `at` and ends no later than `end`.
fn subtree_bytes(at: u64, end: u64) -> u64 {
    let left = end - at;
    if left <= CHUNK_LEN as u64 {
        return left;
    }
    let fits = 1 << left.ilog2();
    max_subtree_len(at).map_or(fits, |most| most.min(fits))
}

/// The hash of a file of `bytes` bytes, from the subtrees of all ranges in any order; `None` if they do not cover the
/// file.
#[must_use]
pub fn join(mut subtrees: Vec<Subtree>, bytes: u64) -> Option<Hash> {
    subtrees.sort_by_key(|subtree| subtree.byte_offset);
    let mut rest = &subtrees[..];
    if bytes <= CHUNK_LEN as u64 || rest.first()?.bytes == bytes {
        return None;
    }
    let left = left_subtree_len(bytes);
    let (low, high) = (node(&mut rest, 0, left)?, node(&mut rest, left, bytes - left)?);
    rest.is_empty().then(|| merge_subtrees_root(&low, &high, Mode::Hash))
}

/// Chaining value of the subtree of these bytes.
fn node(rest: &mut &[Subtree], byte_offset: u64, bytes: u64) -> Option<ChainingValue> {
    let (first, others) = rest.split_first()?;
    if first.byte_offset != byte_offset || first.bytes > bytes {
        return None;
    }
    if first.bytes == bytes {
        *rest = others;
        return Some(*first.value.as_bytes());
    }
    if bytes <= CHUNK_LEN as u64 {
        return None;
    }
    let left = left_subtree_len(bytes);
    let (low, high) = (node(rest, byte_offset, left)?, node(rest, byte_offset + left, bytes - left)?);
    Some(merge_subtrees_non_root(&low, &high, Mode::Hash))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Ranges of random blocks, each hashed in pieces of random sizes.
    #[test]
    fn stretches_join_to_the_hash_of_the_whole() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for round in 0..200 {
            let blocks = rng.random_range(1..40_u64);
            let odd = if round % 5 == 0 { 0 } else { rng.random_range(0..BLOCK_BYTES) };
            let bytes: Vec<u8> = (0..blocks * BLOCK_BYTES + odd).map(|_| rng.random()).collect();
            let end = bytes.len() as u64;
            let mut cuts: Vec<u64> =
                (0..rng.random_range(1..6)).map(|_| rng.random_range(1..=blocks) * BLOCK_BYTES).collect();
            cuts.extend([0, end]);
            cuts.sort_unstable();
            let mut subtrees = Vec::new();
            for cut in cuts.windows(2) {
                let mut hasher = StretchHasher::new(cut[0], cut[1]);
                while hasher.at() < cut[1] {
                    let some = rng.random_range(1..100_000).min(end - hasher.at());
                    hasher.update(&bytes[hasher.at() as usize..(hasher.at() + some) as usize]);
                }
                subtrees.extend(hasher.finish());
            }
            if subtrees.len() == 1 {
                continue;
            }
            subtrees.reverse();
            assert_eq!(join(subtrees.clone(), end), Some(blake3::hash(&bytes)), "{cuts:?}");
            assert_eq!(join(subtrees[1..].to_vec(), end), None, "a stretch is missing");
            assert_eq!(join(subtrees, end + 1), None, "the file has grown");
        }
    }
}
