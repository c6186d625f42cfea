//! A record as a small plot of characters.

/// Columns and rows of a plot.
const COLUMNS: usize = 72;
const ROWS: usize = 8;
/// Characters for a column that is filled by so many eighths of a row.
const EIGHTHS: [char; 9] =
    [' ', '\u{2581}', '\u{2582}', '\u{2583}', '\u{2584}', '\u{2585}', '\u{2586}', '\u{2587}', '\u{2588}'];

/// Extremes of the samples of each column, gathered piece by piece.
pub struct Plot {
    samples: usize,
    seen: usize,
    columns: Vec<(f64, f64)>,
}

impl Plot {
    /// Of a record of so many samples.
    pub fn of(samples: usize) -> Self {
        let columns = samples.clamp(1, COLUMNS);
        Self { samples, seen: 0, columns: vec![(f64::INFINITY, f64::NEG_INFINITY); columns] }
    }

    /// Takes the next samples.
    pub fn take(&mut self, values: &[f64]) {
        for value in values {
            let column = self.seen * self.columns.len() / self.samples.max(1);
            let (low, high) = &mut self.columns[column];
            (*low, *high) = (low.min(*value), high.max(*value));
            self.seen += 1;
        }
    }

    /// Rows from the top, each column filled up to the extreme that lies further from the level of most columns.
    pub fn rows(&self) -> Vec<String> {
        let mut middles: Vec<f64> = self.columns.iter().map(|(low, high)| (low + high) / 2.0).collect();
        middles.retain(|middle| middle.is_finite());
        middles.sort_by(f64::total_cmp);
        let Some(level) = middles.get(middles.len() / 2) else { return Vec::new() };
        let height = |(low, high): &(f64, f64)| if high - level >= level - low { *high } else { *low };
        let heights: Vec<f64> = self.columns.iter().map(height).collect();
        let low = heights.iter().copied().filter(|value| value.is_finite()).fold(f64::INFINITY, f64::min);
        let high = heights.iter().copied().filter(|value| value.is_finite()).fold(f64::NEG_INFINITY, f64::max);
        let span = if high > low { high - low } else { 1.0 };
        let eighths = |height: &f64| ((height - low) / span * (8 * ROWS) as f64).round() as usize;
        let filled: Vec<usize> = heights.iter().map(eighths).collect();
        let row = |row: usize| filled.iter().map(|filled| EIGHTHS[filled.saturating_sub(8 * row).min(8)]).collect();
        (0..ROWS).rev().map(row).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pulse_stands_above_its_baseline() {
        let mut plot = Plot::of(720);
        let values: Vec<f64> = (0..720).map(|i| if (360..370).contains(&i) { 1.0 } else { 0.0 }).collect();
        values.chunks(100).for_each(|piece| plot.take(piece));
        let rows = plot.rows();
        assert_eq!((rows.len(), rows[0].chars().count()), (ROWS, COLUMNS));
        assert_eq!(rows[0].trim(), "\u{2588}");
        assert_eq!(rows[0].chars().position(|character| character == '\u{2588}'), Some(36));
    }

    #[test]
    fn flat_short_and_missing_samples_have_a_plot() {
        let rows = |values: &[f64]| {
            let mut plot = Plot::of(values.len());
            plot.take(values);
            plot.rows()
        };
        assert!(rows(&[2.0; 5]).iter().all(|row| row.trim().is_empty()));
        assert_eq!(rows(&[1.0])[0].chars().count(), 1);
        assert!(rows(&[f64::NAN; 3]).iter().all(|row| row.chars().count() == 3) || rows(&[f64::NAN; 3]).is_empty());
    }
}
