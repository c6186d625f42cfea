//! The plan: for each table, reuse or compute, and why. Nothing is run here.

use std::collections::BTreeMap;

use arrow_schema::SchemaRef;

use super::recipe::stage_id;
use super::spec::Spec;
use crate::campaign::{Campaign, LeftOut};
use crate::stages::Node;
use crate::stages::source::{OpenSource, SourcePart};
use crate::stages::stage::StageError;
use crate::store::{Digest, PartRecord, Shelf, StageId, StoreError, TableRecord, lineage};
use crate::tables::{Reject, Row};

/// The state of one step's table.
pub struct Planned {
    /// Everything that determines it, except raw files.
    pub id: StageId,
    /// Its recipe.
    pub recipe: Digest,
    /// Lineage of each of its parts; `None` as long as one of its raw files was never hashed.
    pub lineages: Vec<Option<Digest>>,
    /// The parts that are complete on the shelf.
    pub present: Vec<Option<PartRecord>>,
    /// Whether the run needs it: it is kept, or leads to a kept one that must be computed.
    pub wanted: bool,
}

impl Planned {
    /// Whether every part is on the shelf. A table without captures has no parts, and is complete.
    #[must_use]
    pub fn complete(&self) -> bool {
        self.present.iter().all(Option::is_some)
    }

    /// Lineage of the whole table, if that of every part is known.
    #[must_use]
    pub fn lineage(&self) -> Option<Digest> {
        let parts: Option<Vec<Digest>> = self.lineages.iter().copied().collect();
        parts.map(|parts| TableRecord::lineage_of(&parts))
    }
}

/// A pipeline, applied to campaigns and a result folder.
pub struct Plan<'a> {
    /// The pipeline.
    pub spec: &'a Spec,
    /// The campaigns.
    pub campaigns: &'a [Campaign],
    /// The result folder.
    pub shelf: &'a Shelf,
    /// The surveyed sources, by step.
    pub sources: BTreeMap<usize, Box<dyn OpenSource + 'a>>,
    /// The state of each step's table.
    pub tables: Vec<Planned>,
    scope: Scope,
    /// Lineages of the parts of tables that another process reports as complete.
    given: BTreeMap<usize, Vec<Digest>>,
}

/// The tables of a plan, by step.
#[derive(Clone, Debug)]
pub(super) enum Scope {
    /// All kept tables.
    All,
    /// These, and their inputs.
    Until(Vec<usize>),
    /// Only these.
    Only(Vec<usize>),
}

/// Why planning failed.
#[derive(Debug, thiserror::Error)]
pub enum PlanError {
    /// A source cannot be surveyed.
    #[error("[{heading}]")]
    Stage {
        /// Heading.
        heading: String,
        /// Cause.
        source: StageError,
    },
    /// The result folder cannot be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// No such table.
    #[error("--until {0}")]
    Until(String),
}

impl<'a> Plan<'a> {
    /// Surveys sources and shelf. `until` names the last wanted table; by default all are wanted.
    ///
    /// # Errors
    /// When a campaign or the result folder cannot be read.
    pub fn new(
        spec: &'a Spec,
        campaigns: &'a [Campaign],
        shelf: &'a Shelf,
        until: Option<&str>,
    ) -> Result<Self, PlanError> {
        let until = until
            .map(|heading| {
                let headings: Vec<&str> = spec.steps.iter().map(|step| step.heading.as_str()).collect();
                spec.position(heading)
                    .ok_or_else(|| PlanError::Until(crate::campaign::suggest::unknown("table", heading, &headings)))
            })
            .transpose()?;
        let mut sources = BTreeMap::new();
        for (i, step) in spec.steps.iter().enumerate() {
            if let Node::Source(source) = &step.node {
                let open = source
                    .open(campaigns, &shelf.notes())
                    .map_err(|source| PlanError::Stage { heading: step.heading.clone(), source })?;
                sources.insert(i, open);
            }
        }
        let scope = until.map_or(Scope::All, |until| Scope::Until(vec![until]));
        Ok(Self::of(spec, campaigns, shelf, sources, scope, BTreeMap::new())?)
    }

    /// A plan from surveyed sources; `given` has the lineages of the parts of some tables, by step.
    ///
    /// # Errors
    /// When the shelf cannot be read, or a campaign field is not finite.
    pub(super) fn of(
        spec: &'a Spec,
        campaigns: &'a [Campaign],
        shelf: &'a Shelf,
        sources: BTreeMap<usize, Box<dyn OpenSource + 'a>>,
        scope: Scope,
        given: BTreeMap<usize, Vec<Digest>>,
    ) -> Result<Self, StoreError> {
        let mut ids: Vec<StageId> = Vec::new();
        for i in 0..spec.steps.len() {
            let id = stage_id(spec, i, campaigns, &ids)?;
            ids.push(id);
        }
        let tables = ids.into_iter().map(|id| Planned {
            recipe: id.recipe(),
            id,
            lineages: Vec::new(),
            present: Vec::new(),
            wanted: false,
        });
        let mut plan = Self { spec, campaigns, shelf, sources, tables: tables.collect(), scope, given };
        plan.refresh(&BTreeMap::new())?;
        Ok(plan)
    }

    /// Changes the scope of the plan; returns the previous one.
    pub(super) fn about(&mut self, scope: Scope) -> Scope {
        let before = std::mem::replace(&mut self.scope, scope);
        self.mark_wanted();
        before
    }

    /// What the sources leave out of the campaigns, each once.
    #[must_use]
    pub fn left_out(&self) -> Vec<LeftOut> {
        let mut left_out: Vec<LeftOut> =
            self.sources.values().flat_map(|source| source.left_out().iter().cloned()).collect();
        left_out.sort();
        left_out.dedup();
        left_out
    }

    /// Looks at the shelf again. `content` has the content digests of source parts read since: (step, part) to digest.
    ///
    /// # Errors
    /// When the shelf cannot be read.
    pub fn refresh(&mut self, content: &BTreeMap<(usize, usize), Digest>) -> Result<(), StoreError> {
        for i in 0..self.tables.len() {
            let lineages = self.lineages(i, content);
            let (id, tables) = (&self.tables[i].id, self.stored_tables(i));
            // A part from a time when the table was not kept has only its rejects.
            let whole = |part: &PartRecord| tables.iter().all(|(table, _)| part.files.contains_key(table));
            let stands = |part: Option<PartRecord>| part.filter(whole);
            let present = self.shelf.parts(id, &lineages)?.into_iter().map(stands).collect();
            self.tables[i].lineages = lineages;
            self.tables[i].present = present;
        }
        self.mark_wanted();
        Ok(())
    }

    fn lineages(&self, i: usize, content: &BTreeMap<(usize, usize), Digest>) -> Vec<Option<Digest>> {
        if let Some(given) = self.given.get(&i) {
            return given.iter().copied().map(Some).collect();
        }
        if let Some(source) = self.sources.get(&i) {
            let content_of = |(part, read): (usize, &SourcePart)| content.get(&(i, part)).copied().or(read.content);
            return source
                .parts()
                .iter()
                .enumerate()
                .map(content_of)
                .map(|content| Some(self.part_lineage(i, &content?, &self.beside(i)?)))
                .collect();
        }
        let Some(from) = self.from(i) else {
            return Vec::new(); // a source that the plan is not about
        };
        let Some(beside) = self.beside(i) else {
            return vec![None; if self.streams(i) { self.tables[from].lineages.len() } else { 1 }];
        };
        if self.streams(i) {
            let inputs = self.tables[from].lineages.iter();
            inputs.map(|input| Some(self.part_lineage(i, input.as_ref()?, &beside))).collect()
        } else {
            vec![self.tables[from].lineage().map(|input| self.part_lineage(i, &input, &beside))]
        }
    }

    /// Lineage of a part of step `i` that is made from `input` and whole tables of these lineages.
    #[must_use]
    pub fn part_lineage(&self, i: usize, input: &Digest, beside: &[Digest]) -> Digest {
        lineage::part(&self.tables[i].recipe, input, beside)
    }

    /// Lineages of the whole tables that step `i` needs, if known.
    #[must_use]
    pub fn beside(&self, i: usize) -> Option<Vec<Digest>> {
        self.beside_steps(i).map(|step| self.tables[step].lineage()).collect()
    }

    /// Steps that make the whole tables that step `i` needs.
    pub fn beside_steps(&self, i: usize) -> impl Iterator<Item = usize> + use<'a, '_> {
        self.spec.steps[i].with.values().map(|heading| self.spec.table(heading).expect("the pipeline was checked").0)
    }

    /// Step from which step `i` streams.
    #[must_use]
    pub fn from(&self, i: usize) -> Option<usize> {
        let from = self.spec.steps[i].from.as_deref()?;
        Some(self.spec.table(from).expect("the pipeline was checked").0)
    }

    /// Whether step `i` streams part by part.
    #[must_use]
    pub fn streams(&self, i: usize) -> bool {
        match &self.spec.steps[i].node {
            Node::Source(_) => true,
            // A side table as input is read whole.
            Node::Operator(operator) => {
                operator.grain().streams() && !self.spec.steps[i].from.as_deref().unwrap_or("").contains('.')
            }
        }
    }

    /// Whether the stored table of step `i` has all that it sends on, so that it is read in its place.
    #[must_use]
    pub fn stands_in(&self, i: usize) -> bool {
        self.spec.steps[i].keep && self.spec.steps[i].node.stands_in()
    }

    /// Whether the rows of step `i` can be read from the shelf.
    #[must_use]
    pub fn replayable(&self, i: usize) -> bool {
        self.stands_in(i) && self.tables[i].complete()
    }

    /// Whether a part of the tables of step `i` is not on the shelf.
    #[must_use]
    pub fn lacks(&self, i: usize, part: usize) -> bool {
        self.tables[i].present.get(part).is_none_or(Option::is_none)
    }

    fn mark_wanted(&mut self) {
        let count = self.tables.len();
        let mut wanted = vec![false; count];
        for i in (0..count).rev() {
            let goal = match &self.scope {
                Scope::All => self.spec.steps[i].keep,
                Scope::Until(these) | Scope::Only(these) => these.contains(&i),
            };
            wanted[i] |= goal;
            let inputs = match &self.scope {
                Scope::Only(_) => Vec::new(),
                _ => self.inputs(i),
            };
            if !wanted[i] || self.replayable(i) {
                // Its inputs matter only with `until`: otherwise every kept table is a result of its own.
                if matches!(self.scope, Scope::Until(_)) && wanted[i] {
                    for input in inputs {
                        wanted[input] |= self.spec.steps[input].keep;
                    }
                }
                continue;
            }
            for input in inputs {
                wanted[input] = true;
            }
        }
        self.tables.iter_mut().zip(wanted).for_each(|(table, wanted)| table.wanted = wanted);
    }

    /// Steps whose tables step `i` reads.
    pub(super) fn inputs(&self, i: usize) -> Vec<usize> {
        self.from(i).into_iter().chain(self.beside_steps(i)).collect()
    }

    /// Names of the tables that step `i` writes to the shelf: main, sides, rejects.
    #[must_use]
    pub fn stored_tables(&self, i: usize) -> Vec<(String, SchemaRef)> {
        let step = &self.spec.steps[i];
        let tables = step.node.tables().into_iter().map(|table| (table.name, table.schema));
        let kept: Vec<_> = if step.keep { tables.collect() } else { Vec::new() };
        kept.into_iter().chain([(Reject::TABLE.to_owned(), Reject::schema())]).collect()
    }

    /// The decision in words: reuse or compute, and why.
    ///
    /// # Errors
    /// When the shelf cannot be read.
    pub fn decision(&self, i: usize) -> Result<Decision, StoreError> {
        let (step, table) = (&self.spec.steps[i], &self.tables[i]);
        let finished = table.present.iter().flatten().count();
        let action = match (table.wanted, table.complete(), step.keep) {
            (false, ..) => Action::Skip,
            (true, true, true) => Action::Reuse,
            (true, _, false) => Action::Pass,
            (true, false, true) => Action::Compute,
        };
        let why = match action {
            Action::Skip => "not needed".to_owned(),
            Action::Reuse if !self.stands_in(i) && self.is_read_again(i) => {
                "nothing that it depends on has changed; its samples are read from the raw files again".to_owned()
            }
            Action::Reuse => "nothing that it depends on has changed".to_owned(),
            Action::Pass if table.complete() => "not kept; its rows are not needed".to_owned(),
            Action::Pass => "not kept; its rows are made again where they are needed".to_owned(),
            Action::Compute => self.reason(i, finished)?,
        };
        Ok(Decision {
            heading: step.heading.clone(),
            stage: step.node.kind(),
            action,
            why,
            parts: table.lineages.len(),
            finished,
        })
    }

    /// Whether a table that streams from step `i` is to be made.
    fn is_read_again(&self, i: usize) -> bool {
        let streams = |step: &usize| self.tables[*step].wanted && self.from(*step) == Some(i);
        let mut below = (i + 1..self.tables.len()).filter(streams);
        below.any(|step| !self.tables[step].complete() || (!self.stands_in(step) && self.is_read_again(step)))
    }

    fn reason(&self, i: usize, finished: usize) -> Result<String, StoreError> {
        let table = &self.tables[i];
        if finished > 0 {
            return Ok(format!("{finished} of {} parts are finished", table.lineages.len()));
        }
        let Some(earlier) = self.shelf.view(&self.spec.steps[i].heading)? else {
            return Ok("no earlier result".to_owned());
        };
        let mut reasons = earlier.stage.changes(&table.id);
        if reasons.is_empty() {
            let changed = self.inputs(i).into_iter().filter(|&input| {
                let heading = &self.spec.steps[input].heading;
                let before = self.shelf.view(heading).ok().flatten().map(|record| record.lineage);
                before != self.tables[input].lineage()
            });
            let changed: Vec<_> = changed.map(|input| self.spec.steps[input].heading.as_str()).collect();
            reasons.push(if changed.is_empty() {
                "raw files are new or changed".to_owned()
            } else {
                format!("input changed: {}", changed.join(", "))
            });
        }
        Ok(reasons.join("; "))
    }
}

/// What the run does with a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// It is on the shelf.
    Reuse,
    /// It is computed.
    Compute,
    /// It is not kept, only streamed.
    Pass,
    /// It is not requested.
    Skip,
}

/// A line of the plan.
#[derive(Clone, Debug)]
pub struct Decision {
    /// Heading.
    pub heading: String,
    /// Stage.
    pub stage: &'static str,
    /// What the run does.
    pub action: Action,
    /// Why.
    pub why: String,
    /// Parts of the table.
    pub parts: usize,
    /// Parts that are finished.
    pub finished: usize,
}
