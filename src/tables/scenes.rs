//! Table `scenes`: other places of patches, weighed by all onsets.

use crate::table;

table! {
    /// An alternative of the `patches` that onsets were labelled with, and how well all onsets fit it. Rows of taken
    /// alternatives come first, in the order in which they were taken.
    "scenes": SceneOdds, SceneOddsColumns {
        /// Number of the alternative in `patches`.
        alternative: i32,
        /// Patches that it moves.
        patches: Vec<i32>,
        /// Whether the labels have these patches at the alternative's places. Then the alternative's number stands for
        /// their former places.
        taken: bool,
        /// Log-likelihood of all onsets, third and later bounces included, with these patches at the places that were
        /// not taken, minus that with all patches at the places that were.
        log_likelihood: f64,
    }
}
