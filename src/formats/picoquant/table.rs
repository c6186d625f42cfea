//! Photons of T3 mode, counted for all channels in one pass. Channel and time are next to each other in an event, and
//! together are the index of its count: no event is decoded, and none takes a branch.

use std::io::{self, SeekFrom};

use super::events::Layout;
use super::{Events, PIECE_BYTES, Survey, WORD_BYTES};
use crate::waveform::ReadSeek;

/// Combinations of channel and time, and times of a channel: of a PicoHarp, of others.
const PICO_HARP: (usize, usize) = (1 << 16, 1 << 12);
const HYDRA_HARP: (usize, usize) = (1 << 22, 1 << 15);

/// Counts of photons by channel and time.
pub(super) struct Table {
    counts: Vec<u32>,
    /// Times of a channel.
    times: usize,
}

impl Table {
    /// Counts all events. `None` where a table does not serve: for events of T2 mode, for fewer than it has counts (it
    /// is no larger than the file then), for more than a count may hold, and where some are on channels that the
    /// instrument does not have.
    pub(super) fn of(events: &Events, file: &mut dyn ReadSeek) -> io::Result<Option<Self>> {
        let (least, _) = if events.layout == Layout::PicoHarpT3 { PICO_HARP } else { HYDRA_HARP };
        if events.layout.is_t2() || !(least as u64..=u32::MAX.into()).contains(&events.count) {
            return Ok(None);
        }
        let table = Self::count(events, file)?;
        let is_damaged = events.layout == Layout::PicoHarpT3
            && (0..15).any(|channel| !(1..=4).contains(&channel) && table.last(channel).is_some());
        Ok((!is_damaged).then_some(table))
    }

    /// Counts events of T3 mode. Special ones have a count too: they are channel 15 of a PicoHarp, and the upper half
    /// of the other table.
    pub(super) fn count(events: &Events, file: &mut dyn ReadSeek) -> io::Result<Self> {
        Ok(if events.layout == Layout::PicoHarpT3 {
            Self { counts: counts::<{ PICO_HARP.0 }>(events, file)?, times: PICO_HARP.1 }
        } else {
            Self { counts: counts::<{ HYDRA_HARP.0 }>(events, file)?, times: HYDRA_HARP.1 }
        })
    }

    fn of_channel(&self, channel: usize) -> &[u32] {
        &self.counts[channel * self.times..][..self.times]
    }

    /// The latest time with a photon.
    fn last(&self, channel: usize) -> Option<usize> {
        self.of_channel(channel).iter().rposition(|count| *count > 0)
    }

    /// What the events are together, if no marker cuts them.
    pub(super) fn survey(&self, events: &Events) -> Survey {
        let mut survey = Survey::whole(events);
        let photons = match events.layout {
            Layout::PicoHarpT3 => 1..5,
            _ => 0..64,
        };
        for channel in photons {
            if let Some(last) = self.last(channel) {
                survey.channels[channel] = true;
                survey.times = survey.times.max(last as u64 + 1);
            }
        }
        survey
    }

    /// The histogram of a channel, little-endian, with so many units of the time base in a bin.
    pub(super) fn histogram(&self, channel: usize, bins: usize, per_bin: usize) -> Vec<u8> {
        let of_bins = self.of_channel(channel).chunks(per_bin).take(bins);
        of_bins.flat_map(|counts| counts.iter().sum::<u32>().to_le_bytes()).collect()
    }
}

/// Events by their highest bits, of which there are `COUNTS` combinations.
fn counts<const COUNTS: usize>(events: &Events, file: &mut dyn ReadSeek) -> io::Result<Vec<u32>> {
    let mut counts = vec![0_u32; COUNTS];
    // An array, whose length the compiler knows: no index needs to be checked.
    let table: &mut [u32; COUNTS] = counts.as_mut_slice().try_into().expect("as many as it was made with");
    let mut piece = vec![0; PIECE_BYTES as usize];
    file.seek(SeekFrom::Start(events.byte_offset))?;
    let mut left = events.count * WORD_BYTES;
    while left > 0 {
        let piece = &mut piece[..PIECE_BYTES.min(left) as usize];
        file.read_exact(piece)?;
        for event in piece.as_chunks().0 {
            table[(u32::from_le_bytes(*event) >> (u32::BITS - COUNTS.ilog2())) as usize] += 1;
        }
        left -= piece.len() as u64;
    }
    Ok(counts)
}
