//! The sum of all bytes, which shows whether the file is as it was saved.

use std::io::Read;

use super::{CHECKSUM, UNCOUNTED};
use crate::numbers::Numbers;
use crate::reader::{FormatError, Input};

/// Bytes that are summed at a time.
const PIECE_BYTES: usize = 1 << 18;

/// Compares the sum of all bytes before `end` with the checksum stored there.
pub(super) fn verify(header: &Numbers, input: &mut dyn Input, end: u64) -> Result<(), FormatError> {
    // The byte count shows whether a checksum should follow; for files beyond 4 GiB it holds the lower 32 bits.
    let counted = header.u32(11).wrapping_add(UNCOUNTED);
    if input.length() == end && u64::from(counted) == end & u64::from(u32::MAX) {
        return Ok(());
    }
    let bytes = input.bytes("the checksum", end, CHECKSUM)?;
    let checksum = Numbers { bytes, origin: 0, big_endian: header.big_endian };
    let expected = checksum.u64(0);
    let mut stream = input.stream()?;
    let (mut sum, mut left, mut piece) = (0_u64, end, vec![0; PIECE_BYTES]);
    while left > 0 {
        let count = left.min(PIECE_BYTES as u64);
        let piece = &mut piece[..count as usize];
        stream.read_exact(piece)?;
        sum = sum.wrapping_add(sum_of_bytes(piece));
        left -= count;
    }
    if sum == expected {
        return Ok(());
    }
    let problem = format!("the waveform file checksum is {expected}, but the bytes before it add up to {sum}");
    let advice = "the file was damaged or changed, copy it from the instrument again";
    Err(FormatError::Field { byte_offset: end, problem: format!("{problem}: {advice}") })
}

/// Sum of bytes, eight at a time.
pub(super) fn sum_of_bytes(bytes: &[u8]) -> u64 {
    const EVEN: u64 = 0x00ff_00ff_00ff_00ff;
    const LOWER: u64 = 0x0000_ffff_0000_ffff;
    let mut sum = 0;
    // A 16 bit lane adds at most two bytes of each of 128 words, which is 65,280: it cannot overflow.
    for block in bytes.chunks(128 * 8) {
        let words = block.chunks_exact(8);
        sum += words.remainder().iter().copied().map(u64::from).sum::<u64>();
        let lanes = words.fold(0, |lanes, word| {
            let word = u64::from_le_bytes(word.try_into().expect("chunks of eight"));
            lanes + (word & EVEN) + ((word >> 8) & EVEN)
        });
        let halves = (lanes & LOWER) + ((lanes >> 16) & LOWER);
        sum += (halves & u64::from(u32::MAX)) + (halves >> 32);
    }
    sum
}
