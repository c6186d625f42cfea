//! How the answer grew: what each run knew that left other positions than the one before it. Tables of earlier runs
//! stay in the result folder until `periscope tables --prune`.

use std::path::{Path, PathBuf};

use super::spread;
use crate::history::HistoryError;
use crate::store::runs::RunRecord;
use crate::store::{Shelf, scan};
use crate::table;
use crate::tables::{Name, Row};

/// Steps at most.
const STEPS: usize = 40;
/// Role of the captures that are counted.
const SCENE: &str = "scene";

table! {
    /// How sure a position is.
    "patches": Sureness, SurenessColumns {
        /// visible, hidden or mirror.
        kind: Name,
        /// Root of the sum of the three variances.
        sd_m: Option<f64>,
        /// 0 for the best solution.
        alternative: i32,
    }
}

table! {
    /// Shots of a profile.
    "profiles": Exposure, ExposureColumns {
        /// Role.
        role: Name,
        /// Shots averaged.
        shots: i32,
    }
}

/// What one run left.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// Start of the run (UTC).
    pub started: String,
    /// Profiles of the scene.
    pub profiles: usize,
    /// Parts that hold them.
    pub parts: usize,
    /// Valid shots in these profiles.
    pub shots: i64,
    /// Visible patches with a position, and their median standard deviation.
    pub visible: (usize, Option<f64>),
    /// The same of hidden patches.
    pub hidden: (usize, Option<f64>),
}

/// Steps in the order of runs.
pub struct Growth {
    /// Those that left other positions than the one before.
    pub steps: Vec<Step>,
}

impl Growth {
    /// Reads what the runs of a folder left under the view `heading`. Runs whose tables are no longer there are left
    /// out.
    ///
    /// # Errors
    /// When the records of runs cannot be read.
    pub fn of(shelf: &Shelf, heading: Option<&str>) -> Result<Self, HistoryError> {
        let Some(heading) = heading else { return Ok(Self { steps: Vec::new() }) };
        let mut runs: Vec<(RunRecord, PathBuf)> =
            shelf.runs()?.into_iter().filter_map(|run| Some((run.clone(), run.views.get(heading)?.clone()))).collect();
        runs.dedup_by(|later, earlier| later.1 == earlier.1);
        let steps = spread(&runs, STEPS).iter().filter_map(|(run, answer)| step(shelf.out(), run, answer)).collect();
        Ok(Self { steps })
    }
}

fn step(out: &Path, run: &RunRecord, answer: &Path) -> Option<Step> {
    let patches: Vec<Sureness> = rows(&files(&out.join(answer))?)?;
    let of = |kind: &str| {
        let of_kind = || patches.iter().filter(|patch| &*patch.kind == kind && patch.alternative == 0);
        let mut sds_m: Vec<f64> = of_kind().filter_map(|patch| patch.sd_m).collect();
        sds_m.sort_by(f64::total_cmp);
        (of_kind().count(), sds_m.get(sds_m.len() / 2).copied())
    };
    let files = run.views.get("profiles").and_then(|folder| files(&out.join(folder))).unwrap_or_default();
    let exposures: Vec<Exposure> = rows(&files)?;
    let scene = || exposures.iter().filter(|exposure| &*exposure.role == SCENE);
    Some(Step {
        started: run.started.clone(),
        profiles: scene().count(),
        parts: files.len(),
        shots: scene().map(|exposure| i64::from(exposure.shots)).sum(),
        visible: of("visible"),
        hidden: of("hidden"),
    })
}

/// Files of a table; `None` where it is no longer there.
fn files(folder: &Path) -> Option<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).ok()?.flatten().map(|entry| entry.path());
    let mut files: Vec<PathBuf> = entries.filter(|path| path.extension().is_some_and(|end| end == "parquet")).collect();
    files.sort();
    Some(files)
}

fn rows<R: Row>(files: &[PathBuf]) -> Option<Vec<R>> {
    let columns = R::schema();
    let mut rows = Vec::new();
    for file in files {
        for batch in scan::scan(file, |name| columns.column_with_name(name).is_some()).ok()? {
            rows.extend(R::rows(&batch.ok()?).ok()?);
        }
    }
    Some(rows)
}
