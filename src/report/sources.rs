//! Which tables are shown: the answer, and what it was made from.

use std::collections::BTreeSet;

use crate::history::HistoryError;
use crate::history::ancestry::{Ancestry, Table};
use crate::tables::{Decision, Patch, Row};

/// The tables of a result folder that one solution goes back to.
pub struct Sources<'a> {
    ancestry: &'a Ancestry,
    /// The positions that count as the answer; `None` where no stage solved for positions.
    answer: Option<Table>,
}

impl<'a> Sources<'a> {
    /// The answer is what `decisions` are about, else the view `patches`, else the last table of positions in the
    /// dataflow.
    pub fn of(ancestry: &'a Ancestry) -> Self {
        let views = ancestry.views();
        let mut solutions = views.iter().filter(|(_, table)| table.name == Patch::TABLE);
        let named = solutions.clone().find(|(view, _)| view == Patch::TABLE);
        let decided = views.iter().rev().find(|(_, table)| table.name == Decision::TABLE);
        let decided = decided.and_then(|(_, table)| ancestry.nearest(table, Patch::TABLE));
        let answer = decided.or_else(|| named.or_else(|| solutions.next_back()).map(|(_, table)| table.clone()));
        Self { ancestry, answer }
    }

    /// The table of this name that goes with the answer: made by the same work, or by the work whose positions that
    /// work took over; else the nearest that the answer was made from, else the last in the dataflow.
    pub fn table(&self, name: &str) -> Option<Table> {
        let mut positions = self.answer.clone();
        while let Some(table) = positions {
            if table.name == name {
                return Some(table);
            }
            if let Some(beside) = self.ancestry.beside(&table, name) {
                return Some(beside);
            }
            let streamed = self.ancestry.inputs(&table).first();
            positions = streamed.map(|(_, input)| input.clone()).filter(|input| input.name == Patch::TABLE);
        }
        let nearest = self.answer.as_ref().and_then(|answer| self.ancestry.nearest(answer, name));
        let last = || self.ancestry.views().into_iter().rev().map(|(_, table)| table).find(|table| table.name == name);
        nearest.or_else(last)
    }

    /// What the table of this name is called; `None` where there is none.
    pub fn heading(&self, name: &str) -> Option<String> {
        self.table(name).map(|table| self.ancestry.label(&table))
    }

    /// Rows of the table of [`Row::TABLE`] that are wanted; none where there is no such table, or it is not kept.
    ///
    /// # Errors
    /// When a file cannot be read.
    pub fn rows<R: Row>(&self, wanted: impl Fn(&R) -> bool) -> Result<Vec<R>, HistoryError> {
        self.rows_near(&[], wanted)
    }

    /// Rows that are wanted, of the last table of [`Row::TABLE`] in the dataflow that has any.
    ///
    /// # Errors
    /// When a file cannot be read.
    pub fn last_rows<R: Row>(&self, wanted: impl Fn(&R) -> bool) -> Result<Vec<R>, HistoryError> {
        for (_, table) in self.ancestry.views().into_iter().rev().filter(|(_, table)| table.name == R::TABLE) {
            let rows = self.ancestry.rows_near(&table, &[], &wanted)?;
            if !rows.is_empty() {
                return Ok(rows);
            }
        }
        Ok(Vec::new())
    }

    /// Rows that are wanted, of the table that another one was made with: `deconvolve` may have another calibration
    /// than the solver.
    ///
    /// # Errors
    /// When a file cannot be read.
    pub fn rows_behind<R: Row>(&self, other: &str, wanted: impl Fn(&R) -> bool) -> Result<Vec<R>, HistoryError> {
        let behind = self.table(other).and_then(|other| self.ancestry.nearest(&other, R::TABLE));
        let table = behind.or_else(|| self.table(R::TABLE));
        table.map_or_else(|| Ok(Vec::new()), |table| self.ancestry.rows_near(&table, &[], wanted))
    }

    /// Rows that are wanted and have one of these numbers in these columns: others need not be read.
    ///
    /// # Errors
    /// When a file cannot be read.
    pub fn rows_near<R: Row>(
        &self,
        numbers: &[(&str, &BTreeSet<i32>)],
        wanted: impl Fn(&R) -> bool,
    ) -> Result<Vec<R>, HistoryError> {
        self.table(R::TABLE).map_or_else(|| Ok(Vec::new()), |table| self.ancestry.rows_near(&table, numbers, wanted))
    }
}
