//! Flights of a lidar: the waveforms of a file with the beam that each belongs to.
//!
//! A reader of waveforms gives records alone. A lidar also says where each of its pulses began and which way it went;
//! an echo at time t of a record lies at `anchor + velocity_per_s * t`.

use std::io::{Read, Seek};

pub use crate::beam::{Flight, Pulse};
use crate::las::{self, Las};
use crate::pulse_waves::{self, PulseWaves};
use crate::reader::{FormatError, Reader, Source};

/// Returns the pulses of a PulseWaves or LAS file with their records.
///
/// # Errors
/// When the file is neither, or when its reader refuses it.
pub fn flight<F: Read + Seek>(source: &mut Source<F>) -> Result<Flight, FormatError> {
    let head = source.head(16)?;
    if PulseWaves.recognises(&head) {
        pulse_waves::flight(source)
    } else if Las.recognises(&head) {
        las::flight(source)
    } else {
        Err(FormatError::Unknown)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hostile::source;

    #[test]
    fn a_file_of_another_kind_has_no_flight() {
        assert!(matches!(flight(&mut source(b"time,counts")), Err(FormatError::Unknown)));
    }
}
