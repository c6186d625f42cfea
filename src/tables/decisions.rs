//! Table `decisions`: what a run chose where the onsets could mean several things.

use super::cell::Name;
use crate::table;

table! {
    /// One choice that the results depend on, with its evidence, its runner-up and what would change it.
    "decisions": Decision, DecisionColumns {
        /// Number, from 1, in the order in which they matter.
        decision: i32,
        /// What was decided: fit, frame, hidden patches, other solutions, pulse shapes...
        what: Name,
        /// What was chosen.
        chosen: Name,
        /// Measurements that speak for it, in words.
        evidence: Name,
        /// The next best choice; null where there is none.
        runner_up: Option<Name>,
        /// Log-likelihood of the choice minus that of its runner-up, where the program has computed both.
        log_likelihood_ratio: Option<f64>,
        /// What would change the choice: a measurement to make, or a value of campaign.toml.
        would_change: Name,
    }
}
