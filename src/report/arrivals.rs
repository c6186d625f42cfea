//! The onsets that a solution was offered, with all that residuals, labels and onsets say of them.

use std::collections::BTreeMap;

use super::sources::Sources;
use crate::history::HistoryError;
use crate::history::behind::{CaptureKey, OnsetBehind};
use crate::tables::{Label, Onset, Residual};
use crate::units::PatchId;

/// More than any pull.
const LEFT_OUT: f64 = 1e9;

/// Parts that an onset is read as, at most.
const PARTS: i32 = 2;

/// Onsets by capture and rank.
#[derive(Default)]
pub struct Arrivals {
    /// In the order of time within each capture.
    pub by_capture: BTreeMap<CaptureKey, Vec<OnsetBehind>>,
    /// Whether a solution rests on them, so that only those with a residual of its own count.
    is_solved: bool,
    /// Heading of the table that they come from.
    pub heading: Option<String>,
}

impl Arrivals {
    /// All onsets behind the answer; those without a label too.
    ///
    /// # Errors
    /// When a table cannot be read.
    pub fn of(sources: &Sources<'_>) -> Result<Self, HistoryError> {
        let mut all: BTreeMap<(CaptureKey, i32, i32), OnsetBehind> = BTreeMap::new();
        // What says most comes first; the others fill in what it leaves open.
        for residual in sources.rows(|_: &Residual| true)? {
            let onset = OnsetBehind::of_residual(&residual);
            all.insert(onset.id(), onset);
        }
        let is_solved = !all.is_empty();
        for label in sources.rows(|label: &Label| label.alternative == 0)? {
            let mut onset = OnsetBehind::of_label(&label);
            if is_solved {
                // They refer to the positions of an earlier solution.
                (onset.residual_ps, onset.pull) = (None, None);
            }
            let known = all.remove(&onset.id());
            all.insert(onset.id(), known.map_or(onset, |known| known.labelled(&label)));
        }
        for detected in sources.rows(|_: &Onset| true)? {
            let onset = OnsetBehind::of_onset(&detected);
            let (capture, rank) = onset.whole();
            let parts: Vec<_> = (0..=PARTS).map(|part| (capture.clone(), rank, part)).collect();
            let mut is_new = true;
            for id in parts {
                if let Some(earlier) = all.remove(&id) {
                    all.insert(id, earlier.detected(&detected));
                    is_new = false;
                }
            }
            if is_new {
                all.insert(onset.id(), onset);
            }
        }
        let mut by_capture: BTreeMap<CaptureKey, Vec<OnsetBehind>> = BTreeMap::new();
        for ((capture, ..), onset) in all {
            by_capture.entry(capture).or_default().push(onset);
        }
        let heading =
            sources.heading("residuals").or_else(|| sources.heading("labels")).or_else(|| sources.heading("onsets"));
        Ok(Self { by_capture, is_solved, heading })
    }

    /// All of them, in the order of captures.
    pub fn iter(&self) -> impl Iterator<Item = &OnsetBehind> {
        self.by_capture.values().flatten()
    }

    /// Those that the solution was offered; without a solution all.
    pub fn offered(&self) -> impl Iterator<Item = &OnsetBehind> {
        self.iter().filter(|onset| !self.is_solved || onset.used.is_some())
    }

    /// Those that a patch's place rests on: whose path meets it; without paths those of its own captures.
    pub fn over(&self, patch: PatchId) -> impl Iterator<Item = &OnsetBehind> {
        self.offered().filter(move |onset| match &onset.path {
            Some(path) => path.contains(&patch),
            None => onset.lit == patch || onset.seen == patch,
        })
    }
}

/// To sort by: how far an onset lies from the solution, in standard deviations; 0 where that is unknown. Those that the
/// solution left out come first.
pub fn doubt(onset: &OnsetBehind) -> f64 {
    let pull = onset.pull.map_or(0.0, f64::abs);
    if onset.used == Some(false) { LEFT_OUT + pull } else { pull }
}

/// A path in words: `4 > 9 > 2`.
pub fn path_text(path: Option<&[PatchId]>) -> String {
    path.map_or_else(
        || "no path known".to_owned(),
        |path| path.iter().map(ToString::to_string).collect::<Vec<_>>().join(" > "),
    )
}
