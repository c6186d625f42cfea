//! The matrix of distances, with its gaps.

use std::collections::{BTreeMap, BTreeSet};

use super::sources::Sources;
use crate::history::HistoryError;
use crate::tables::Distance;
use crate::units::PatchId;

/// Patches in the matrix at most.
const PATCHES: usize = 400;

/// Distances between patches; 0 is source and camera.
pub struct Distances {
    /// Heading of their table.
    pub heading: String,
    /// Patches of rows and columns, ascending.
    pub patches: Vec<PatchId>,
    /// How many patches there are.
    pub all: usize,
    /// Distance and its standard deviation by places in `patches`, the smaller first.
    pub of_pair: BTreeMap<(usize, usize), (f64, f64)>,
}

impl Distances {
    /// Reads them; `None` where there are none.
    ///
    /// # Errors
    /// When the table cannot be read.
    pub fn of(sources: &Sources<'_>) -> Result<Option<Self>, HistoryError> {
        let rows = sources.rows(|_: &Distance| true)?;
        let all: BTreeSet<PatchId> = rows.iter().flat_map(|row| [row.a, row.b]).collect();
        let patches: Vec<PatchId> = all.iter().copied().take(PATCHES).collect();
        let mut of_pair = BTreeMap::new();
        for row in &rows {
            if let (Ok(a), Ok(b)) = (patches.binary_search(&row.a), patches.binary_search(&row.b)) {
                of_pair.insert((a, b), (row.distance_m, row.sd_m));
            }
        }
        let heading = sources.heading("distances").filter(|_| !patches.is_empty());
        Ok(heading.map(|heading| Self { heading, all: all.len(), patches, of_pair }))
    }

    /// Pairs without a distance.
    pub fn gaps(&self) -> usize {
        self.patches.len() * (self.patches.len() - 1) / 2 - self.of_pair.len()
    }
}
