//! The pulses of a lidar, and the records of their light.

use crate::waveform::Record;

/// One pulse of the laser: its beam, and the records of its light.
#[derive(Clone, Debug, PartialEq)]
pub struct Pulse {
    /// GPS time at which it was fired, as the file counts it.
    pub gps_time_s: f64,
    /// Place of an echo at time 0 of the records, in the file's unit of length.
    pub anchor: [f64; 3],
    /// How far the place of an echo moves with a second of the records' time: half the speed of light, along the beam.
    pub velocity_per_s: [f64; 3],
    /// Number of the record of the outgoing pulse, where the file has it.
    pub outgoing: Option<usize>,
    /// Numbers of the records of returning light, in order of time: one for each stretch that was recorded.
    pub returning: Vec<usize>,
}

/// All pulses of a file with their records.
#[derive(Debug)]
pub struct Flight {
    /// The records, as [`records`](crate::records) returns them.
    pub records: Vec<Record>,
    /// The pulses that have returning light, in the order of the file.
    pub pulses: Vec<Pulse>,
}

/// Whether as many records as a file claims fit in the memory that a file of its length may take.
pub(super) fn are_too_many(records: u64, file_bytes: u64) -> bool {
    records.saturating_mul(size_of::<Record>() as u64) > 2 * file_bytes + (1 << 19)
}
