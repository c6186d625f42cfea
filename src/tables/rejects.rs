//! Table `rejects`: what was set aside, and why.

use super::cell::Name;
use crate::table;

table! {
    /// An input or record that was set aside; the run went on without it.
    "rejects": Reject, RejectColumns {
        /// Heading of the pipeline whose stage set it aside.
        stage: Name,
        /// Campaign.
        campaign: Name,
        /// Raw file, relative to the campaign folder; null where it is not about one file.
        file: Option<Name>,
        /// Segment of the file.
        segment: Option<i32>,
        /// Where in the file.
        byte_offset: Option<i64>,
        /// Why, and the mend.
        reason: Name,
    }
}
