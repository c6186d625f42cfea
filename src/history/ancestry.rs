//! The tables of a result folder, each with the tables that it was made from.
//!
//! A stage's recipe names the recipes of its inputs, and a part's lineage joins that recipe with the lineages of its
//! inputs. Therefore the input of a table is found by its recipe, whatever its heading is called. If raw files changed
//! in between, it is the one whose lineage fits.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::PathBuf;

use super::HistoryError;
use crate::store::whole::WholeTable;
use crate::store::{Digest, Shelf, StageId, TableRecord, lineage, scan};
use crate::tables::{self, Row};

/// The stage's name for the input that it streams.
const STREAMED: &str = "from";

/// One table, main or side.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Table {
    /// Index of the work that made it.
    work: usize,
    /// Its name, as in `periscope schema`.
    pub name: String,
}

/// A finished result of a stage: a complete table with its side tables, or the parts of a table that is not kept.
struct Work {
    stage: StageId,
    recipe: Digest,
    parts: BTreeSet<Digest>,
    whole: Option<WholeTable>,
    /// Names of its tables; for a table that is not kept, all possible ones.
    names: Vec<String>,
    /// Views by table.
    views: BTreeMap<String, String>,
    /// By the stage's own names: the streamed input first.
    inputs: Vec<(String, Table)>,
    /// Whether the lineages of inputs and parts fit.
    fits: bool,
    /// Longest path from a source.
    depth: usize,
}

/// All tables of a result folder.
pub struct Ancestry {
    works: Vec<Work>,
}

impl Ancestry {
    /// Reads the records of a result folder.
    ///
    /// # Errors
    /// When one cannot be read.
    pub fn of(shelf: &Shelf) -> Result<Self, HistoryError> {
        let mut works = Vec::new();
        for stored in shelf.stored()? {
            let recipe = stored.stage.recipe();
            let work = |whole: Option<WholeTable>, parts: BTreeSet<Digest>, names: Vec<String>| Work {
                stage: stored.stage.clone(),
                recipe,
                parts,
                whole,
                names,
                views: BTreeMap::new(),
                inputs: Vec::new(),
                fits: true,
                depth: 0,
            };
            if stored.tables.is_empty() {
                let names = tables::all().into_iter().map(|(name, _)| name.to_owned()).collect();
                works.push(work(None, stored.parts, names));
            } else {
                for table in stored.tables {
                    let parts = table.record.parts.iter().map(|part| part.lineage).collect();
                    let names = table.names()?;
                    works.push(work(Some(table), parts, names));
                }
            }
        }
        let mut ancestry = Self { works };
        for (view, record) in shelf.tables()? {
            if let (Some(work), Some(table)) = (ancestry.work_of(&record), shelf.table_of(&view)?) {
                ancestry.works[work].views.entry(table).or_insert(view);
            }
        }
        for work in 0..ancestry.works.len() {
            (ancestry.works[work].inputs, ancestry.works[work].fits) = ancestry.find_inputs(work);
        }
        for work in 0..ancestry.works.len() {
            ancestry.works[work].depth = ancestry.find_depth(work);
        }
        Ok(ancestry)
    }

    fn work_of(&self, record: &TableRecord) -> Option<usize> {
        self.works.iter().position(|work| work.whole.as_ref().is_some_and(|whole| whole.record == *record))
    }

    /// Inputs of a result, and whether their lineages explain its own.
    fn find_inputs(&self, work: usize) -> (Vec<(String, Table)>, bool) {
        let mut choices: Vec<Vec<(String, Table)>> = vec![Vec::new()];
        for (input, recipe) in &self.works[work].stage.inputs {
            let tables = self.with_recipe(recipe);
            if tables.is_empty() {
                continue; // removed from the shelf since
            }
            let longer = |choice: &Vec<(String, Table)>| {
                let added = |table: &Table| {
                    let mut choice = choice.clone();
                    choice.push((input.clone(), table.clone()));
                    choice
                };
                tables.iter().map(added).collect::<Vec<_>>()
            };
            choices = choices.iter().flat_map(longer).collect();
        }
        let whole = |choice: &Vec<(String, Table)>| choice.len() == self.works[work].stage.inputs.len();
        let fitting = choices.iter().position(|choice| whole(choice) && self.fits(work, choice));
        let mut inputs = choices.swap_remove(fitting.unwrap_or(0));
        inputs.sort_by_key(|(name, _)| name != STREAMED);
        (inputs, fitting.is_some())
    }

    /// Tables with this recipe digest; those with a view first.
    fn with_recipe(&self, recipe: &Digest) -> Vec<Table> {
        let named = |(index, work): (usize, &Work)| {
            let name = work.names.iter().find(|name| lineage::table_recipe(name, &work.recipe) == *recipe)?;
            Some((work.views.is_empty(), Table { work: index, name: name.clone() }))
        };
        let mut tables: Vec<(bool, Table)> = self.works.iter().enumerate().filter_map(named).collect();
        tables.sort();
        tables.into_iter().map(|(_, table)| table).collect()
    }

    /// Whether these inputs explain the lineage of the result. For a table that is not kept, the order of its parts is
    /// unknown: it fits.
    fn fits(&self, work: usize, inputs: &[(String, Table)]) -> bool {
        let work = &self.works[work];
        let whole = |table: &Table| self.works[table.work].whole.as_ref().map(|whole| whole.record.lineage);
        let beside = inputs.iter().filter(|(name, _)| name != STREAMED).map(|(_, table)| whole(table));
        let Some(beside) = beside.collect::<Option<Vec<Digest>>>() else { return true };
        let Some((_, streamed)) = inputs.iter().find(|(name, _)| name == STREAMED) else { return true };
        let part = |input: &Digest| lineage::part(&work.recipe, input, &beside);
        let mut possible: BTreeSet<Digest> = self.works[streamed.work].parts.iter().map(part).collect();
        match whole(streamed) {
            Some(whole) => possible.extend([part(&whole)]),
            None if !work.parts.is_subset(&possible) => return true,
            None => {}
        }
        work.parts.is_subset(&possible)
    }

    fn find_depth(&self, work: usize) -> usize {
        let inputs = self.works[work].inputs.iter();
        inputs.map(|(_, table)| self.find_depth(table.work) + 1).max().unwrap_or(0)
    }

    /// Tables with a view, in the order of the dataflow: every table follows those that it was made from.
    #[must_use]
    pub fn views(&self) -> Vec<(String, Table)> {
        let mut views: Vec<(usize, &String, Table)> = Vec::new();
        for (index, work) in self.works.iter().enumerate() {
            for (name, view) in &work.views {
                views.push((work.depth, view, Table { work: index, name: name.clone() }));
            }
        }
        views.sort();
        views.into_iter().map(|(_, view, table)| (view.clone(), table)).collect()
    }

    /// The table that a view shows.
    #[must_use]
    pub fn view(&self, view: &str) -> Option<Table> {
        self.views().into_iter().find(|(name, _)| name == view).map(|(_, table)| table)
    }

    /// Name of a table: that of its view if it has one, else from its stage.
    #[must_use]
    pub fn label(&self, table: &Table) -> String {
        let work = &self.works[table.work];
        work.views.get(&table.name).cloned().unwrap_or_else(|| format!("{} of {}", table.name, work.stage.kind))
    }

    /// The stage that made a table.
    #[must_use]
    pub fn stage(&self, table: &Table) -> &StageId {
        &self.works[table.work].stage
    }

    /// Record of a table, if it is kept.
    #[must_use]
    pub fn record(&self, table: &Table) -> Option<&TableRecord> {
        self.works[table.work].whole.as_ref().map(|whole| &whole.record)
    }

    /// Lineages of the parts of a table, kept or not.
    #[must_use]
    pub fn parts(&self, table: &Table) -> &BTreeSet<Digest> {
        &self.works[table.work].parts
    }

    /// Longest path from a source to a table: a table is deeper than everything it was made from.
    #[must_use]
    pub fn depth(&self, table: &Table) -> usize {
        self.works[table.work].depth
    }

    /// Whether the inputs on the shelf are those that the table was made from.
    #[must_use]
    pub fn inputs_fit(&self, table: &Table) -> bool {
        self.works[table.work].fits
    }

    /// Inputs of a table by the stage's own names; those no longer on the shelf are omitted.
    #[must_use]
    pub fn inputs(&self, table: &Table) -> &[(String, Table)] {
        &self.works[table.work].inputs
    }

    /// Another table of the same result, main or side.
    #[must_use]
    pub fn beside(&self, table: &Table, name: &str) -> Option<Table> {
        let work = &self.works[table.work];
        let is_there = work.whole.is_some() && work.names.iter().any(|other| other == name);
        is_there.then(|| Table { work: table.work, name: name.to_owned() })
    }

    /// All ancestors of a table, nearest first; streamed inputs before the others.
    #[must_use]
    pub fn upstream(&self, of: &Table) -> Vec<Table> {
        let mut tables: Vec<Table> = Vec::new();
        let mut queue = VecDeque::from([of.clone()]);
        while let Some(table) = queue.pop_front() {
            for (_, input) in self.inputs(&table) {
                if !tables.contains(input) {
                    tables.push(input.clone());
                    queue.push_back(input.clone());
                }
            }
        }
        tables
    }

    /// The nearest ancestor with this name.
    #[must_use]
    pub fn nearest(&self, of: &Table, name: &str) -> Option<Table> {
        self.upstream(of).into_iter().find(|table| table.name == name)
    }

    /// Files of a table, in order; none if it is not kept.
    ///
    /// # Errors
    /// When its folder cannot be read.
    pub fn files(&self, table: &Table) -> Result<Vec<PathBuf>, HistoryError> {
        let whole = self.works[table.work].whole.as_ref();
        Ok(whole.map(|whole| whole.files(&table.name)).transpose()?.unwrap_or_default())
    }

    /// Folder of a table, through its view if it has one.
    #[must_use]
    pub fn folder(&self, shelf: &Shelf, table: &Table) -> Option<PathBuf> {
        let work = &self.works[table.work];
        let view = work.views.get(&table.name).map(|view| shelf.out().join(view));
        view.or_else(|| work.whole.as_ref().map(|whole| whole.folder.join(&table.name)))
    }

    /// Rows of a table that `wanted` accepts, with only the columns of `R`.
    ///
    /// # Errors
    /// When a file cannot be read, or lacks a column.
    pub fn rows<R: Row>(&self, table: &Table, wanted: impl Fn(&R) -> bool) -> Result<Vec<R>, HistoryError> {
        self.rows_near(table, &[], wanted)
    }

    /// The same for rows that have one of these numbers in these columns; most others are not read.
    ///
    /// # Errors
    /// When a file cannot be read, or lacks a column.
    pub fn rows_near<R: Row>(
        &self,
        table: &Table,
        numbers: &[(&str, &BTreeSet<i32>)],
        wanted: impl Fn(&R) -> bool,
    ) -> Result<Vec<R>, HistoryError> {
        let columns = R::schema();
        let mut rows = Vec::new();
        for path in self.files(table)? {
            for batch in scan::scan_near(&path, |name| columns.column_with_name(name).is_some(), numbers)? {
                rows.extend(R::rows(&batch?)?.into_iter().filter(&wanted));
            }
        }
        Ok(rows)
    }
}
