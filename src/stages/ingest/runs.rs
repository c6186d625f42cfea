//! A column of mostly equal cells, as runs: what a piece of a part passes on of its rows.

use serde::{Deserialize, Serialize};

/// Cells of a column, each with the number of rows in a row that have it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Runs(Vec<(Option<i32>, usize)>);

impl Runs {
    /// Adds the cell of the next row.
    pub fn push(&mut self, cell: Option<i32>) {
        match self.0.last_mut() {
            Some((last, count)) if *last == cell => *count += 1,
            _ => self.0.push((cell, 1)),
        }
    }

    /// The cells, row by row.
    pub fn cells(&self) -> impl Iterator<Item = Option<i32>> + '_ {
        self.0.iter().flat_map(|(cell, count)| std::iter::repeat_n(*cell, *count))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_have_the_cells_that_were_added() {
        let cells = [Some(0), Some(0), None, None, None, Some(3), Some(0)];
        let mut runs = Runs::default();
        cells.into_iter().for_each(|cell| runs.push(cell));
        assert_eq!(runs.0.len(), 4);
        assert_eq!(runs.cells().collect::<Vec<_>>(), cells);
    }
}
