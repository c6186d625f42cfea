//! Table `rejects`: rejected inputs and records, and why.

use super::cell::Name;
use crate::table;

table! {
    /// An input or record that a stage rejected; the run continued without it.
    "rejects": Reject, RejectColumns {
        /// Heading in the pipeline file of the stage that rejected it.
        stage: Name,
        /// Campaign.
        campaign: Name,
        /// Raw file, relative to the campaign folder; null if no single file is concerned.
        file: Option<Name>,
        /// Segment of the file.
        segment: Option<i32>,
        /// Place in the file.
        byte_offset: Option<i64>,
        /// Why, and how to fix it.
        reason: Name,
    }
}
