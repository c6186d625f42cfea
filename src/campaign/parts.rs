//! Where a part ends: content-defined cuts of a campaign's captures into parts of about `part_bytes`.
//!
//! A capture (or a reciprocal pair, which never straddles two parts) of `b` bytes closes its part under one condition:
//! the first 64 bits of BLAKE3 of its key, as a fraction of 2^64, are below `b / part_bytes`. Parts then have that mean
//! size if captures are far smaller, and their sizes follow an exponential distribution. The decision is local: a
//! capture that joins a growing campaign moves no boundary except within the part where it falls.

/// Default mean size of a part, in bytes of raw files.
pub const PART_BYTES: u64 = 64 << 20;

/// Whether the capture or pair of this key is the last of its part.
///
/// It has `bytes` bytes of raw files; parts have `part_bytes` in the mean. The key must be unique in the campaign, and
/// the same in every call.
#[must_use]
pub fn closes_part(pair_key: &str, bytes: u64, part_bytes: u64) -> bool {
    let hash = blake3::hash(pair_key.as_bytes());
    let first: [u8; 8] = std::array::from_fn(|i| hash.as_bytes()[i]);
    // hash / 2^64 < bytes / part_bytes, in whole numbers, since floats would round.
    u128::from(u64::from_le_bytes(first)) * u128::from(part_bytes) < u128::from(bytes) << 64
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    /// The parts of a list of captures, each as the list of its keys.
    fn parts(captures: &[(String, u64)]) -> BTreeSet<Vec<String>> {
        let (mut parts, mut open) = (BTreeSet::new(), Vec::new());
        for (key, bytes) in captures {
            open.push(key.clone());
            if closes_part(key, *bytes, PART_BYTES) {
                parts.insert(std::mem::take(&mut open));
            }
        }
        if !open.is_empty() {
            parts.insert(open);
        }
        parts
    }

    fn captures(count: u64) -> Vec<(String, u64)> {
        (0..count).map(|i| (format!("s1 {} {}", i / 300, i % 300), 500_000 + 20_000 * (i % 100))).collect()
    }

    #[test]
    fn parts_have_their_size_in_the_mean() {
        let captures = captures(80_000);
        let bytes: u64 = captures.iter().map(|(_, bytes)| bytes).sum();
        let mean = bytes as f64 / parts(&captures).len() as f64;
        // About 1850 parts: the standard error of their count is 2.3 %.
        assert!((mean / PART_BYTES as f64 - 1.0).abs() < 0.08, "mean {mean}");
    }

    #[test]
    fn a_capture_as_large_as_a_part_closes_it_and_an_empty_one_never_does() {
        for i in 0..1000 {
            assert!(closes_part(&format!("{i}"), PART_BYTES, PART_BYTES));
            assert!(!closes_part(&format!("{i}"), 0, PART_BYTES));
        }
    }

    #[test]
    fn a_capture_that_joins_leaves_all_parts_but_its_own() {
        let old = captures(2000);
        let before = parts(&old);
        for at in (0..2000).step_by(37) {
            let mut grown = old.clone();
            grown.insert(at, (format!("new {at}"), 1_000_000));
            let after = parts(&grown);
            assert!(before.difference(&after).count() <= 1, "old parts gone");
            assert!(after.difference(&before).count() <= 2, "new parts");
        }
    }
}
