//! The sensors, as calibration found them.

use super::sources::Sources;
use crate::history::HistoryError;
use crate::tables::Calibration;

/// Samples of a response at most.
const SAMPLES: usize = 1200;

/// One sensor's impulse response.
pub struct Response {
    /// Heading of its table.
    pub heading: String,
    /// Its row, the response thinned where it is long.
    pub row: Calibration,
    /// Times and values.
    pub curve: Vec<(f64, f32)>,
}

impl Response {
    /// All sensors' responses.
    ///
    /// # Errors
    /// When the table cannot be read.
    pub fn all(sources: &Sources<'_>) -> Result<Vec<Self>, HistoryError> {
        let Some(heading) = sources.heading("calibration") else { return Ok(Vec::new()) };
        let of = |row: Calibration| {
            let every = row.response.len().div_ceil(SAMPLES).max(1);
            let time_ps = |i: usize| row.response_t0_ps + i as f64 * row.step_ps;
            let curve = row.response.iter().copied().enumerate().step_by(every).map(|(i, value)| (time_ps(i), value));
            Self { heading: heading.clone(), curve: curve.collect(), row }
        };
        Ok(sources.rows(|_: &Calibration| true)?.into_iter().map(of).collect())
    }
}
