//! Shards: sets of parts that processes on any machines compute independently, into one result folder.
//!
//! The whole tables that streaming stages need are made first and once ([`prepare`]). The parts of the tables that
//! stream from raw files are then independent of one another, and are distributed ([`deal`]). A shard holds everything
//! its worker needs, so that no folder is searched again. The worker ([`Shard::make`]) leaves parts on the shelf under
//! the lineages that a run would give them; a later run finds them, and makes the rest. Nothing here depends on a lock:
//! parts have the same bytes on every machine, and appear by a rename.

mod deal;
mod failure;
mod pieces;

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use serde_json::json;

use super::cut::next_pass;
use super::pass::{self, Ended, Joined};
use super::plan::{Plan, PlanError, Scope};
use super::progress::Progress;
use super::run::{amount, kept, whole};
use super::settings::{RunError, Settings};
use super::spec::{Spec, SpecError};
use crate::campaign::{Campaign, CampaignError};
use crate::stages::Node;
use crate::stages::source::{OpenSource, Ticket};
use crate::store::runs::RunRecord;
use crate::store::{Digest, Shelf, StageId};
use crate::tables::{Reject, Row};
pub use deal::{Dealt, deal, prepare};
pub use failure::{ShardError, absent};
pub use pieces::Cut;

/// What all shards of a job have in common.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Work {
    /// Pipeline: the absolute path of its file, or the name of one in the program.
    pub pipeline: PathBuf,
    /// Its text, bases included.
    pub text: String,
    /// Parameters changed on the command line, as typed.
    pub set: Vec<String>,
    /// Campaign folders, absolute, in the given order.
    pub campaigns: Vec<PathBuf>,
    /// Stages of the distributed tables, by heading.
    pub stages: BTreeMap<String, StageId>,
    /// Lineages of the parts of the whole tables that they need, by heading.
    pub beside: BTreeMap<String, Vec<Digest>>,
}

impl Work {
    /// Parses the pipeline.
    ///
    /// # Errors
    /// When this program refuses it.
    pub fn spec(&self) -> Result<Spec, SpecError> {
        Spec::parse(&self.pipeline.display().to_string(), &self.text, &self.set)
    }
}

/// The distributed work, and where its results go.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Job {
    /// What its shards have in common.
    pub work: Work,
    /// Last wanted table.
    pub until: Option<String>,
    /// The run that planned it, which ends when the shards are gathered.
    pub run: RunRecord,
    /// Keys of its shards, and of those pieces of parts that were not finished before.
    pub shards: Vec<String>,
    /// Keys of the shards of parts that are divided, each with the keys of all its pieces, in order.
    #[serde(default)]
    pub cut: BTreeMap<String, Vec<String>>,
}

/// A set of parts for one process.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Shard {
    /// What to make.
    pub work: Work,
    /// The parts, by heading of their source.
    pub parts: BTreeMap<String, Vec<Ticket>>,
}

/// Report on a finished shard: the same whenever and wherever it is made, except `computed`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Made {
    /// Key of the shard.
    pub key: String,
    /// Its captures.
    pub captures: usize,
    /// Parts of tables that it was to make.
    pub parts: usize,
    /// Number of these that were not there before.
    pub computed: usize,
    /// Rejected rows.
    pub rejects: u64,
    /// Rows of each kept table.
    pub rows: BTreeMap<String, u64>,
    /// Digest of all its table files.
    pub digest: Digest,
}

/// Makes what the plan wants and lacks, without views. Parts that were joined from pieces are not read again.
fn make(
    plan: &mut Plan<'_>,
    settings: &Settings,
    progress: &Progress,
    joined: Option<&Joined>,
) -> Result<(), RunError> {
    settings.check()?;
    let mut content = BTreeMap::new();
    while let Some(mut pass) = next_pass(plan) {
        pass.joined = joined.filter(|joined| pass.root == joined.source && pass.steps.contains(&pass.root)).cloned();
        let headings: Vec<&str> = pass.steps.iter().map(|&step| plan.spec.steps[step].heading.as_str()).collect();
        let (whole, wanted) = whole(plan);
        progress.pass(&headings, amount(plan, &pass), whole, wanted);
        let ended = pass::run(plan, &pass, settings, u64::MAX, progress, &mut content)?;
        plan.refresh(&content)?;
        if ended == Ended::Interrupted {
            return Err(RunError::Interrupted { kept: kept(plan, &pass) });
        }
        progress.finish();
    }
    Ok(())
}

impl Shard {
    /// The tickets of its parts.
    pub fn tickets(&self) -> impl Iterator<Item = &Ticket> {
        self.parts.values().flatten()
    }

    fn campaigns(&self) -> Result<Vec<Campaign>, CampaignError> {
        self.work.campaigns.iter().map(|root| Campaign::load(root)).collect()
    }

    /// The plan of its parts only.
    fn plan<'a>(&self, spec: &'a Spec, campaigns: &'a [Campaign], shelf: &'a Shelf) -> Result<Plan<'a>, ShardError> {
        let mut sources: BTreeMap<usize, Box<dyn OpenSource + 'a>> = BTreeMap::new();
        let (mut given, mut steps) = (BTreeMap::new(), Vec::new());
        for (i, step) in spec.steps.iter().enumerate() {
            if self.work.stages.contains_key(&step.heading) {
                steps.push(i);
            }
            if let Some(lineages) = self.work.beside.get(&step.heading) {
                given.insert(i, lineages.clone());
            }
            if let (Node::Source(source), Some(tickets)) = (&step.node, self.parts.get(&step.heading)) {
                let failed = |source| PlanError::Stage { heading: step.heading.clone(), source };
                sources.insert(i, source.take_up(campaigns, &shelf.notes(), tickets).map_err(failed)?);
            }
        }
        let plan = Plan::of(spec, campaigns, shelf, sources, Scope::Only(steps.clone()), given)?;
        for i in steps {
            let heading = &spec.steps[i].heading;
            let (planned, here) = (&self.work.stages[heading], &plan.tables[i].id);
            if planned != here {
                let mut changes = planned.changes(here);
                if changes.is_empty() {
                    changes.push("what it is made from".to_owned());
                }
                return Err(ShardError::Unlike { heading: heading.clone(), changes });
            }
        }
        Ok(plan)
    }

    /// Makes its missing parts.
    ///
    /// # Errors
    /// The first failure, or that it was interrupted; finished parts are kept.
    pub fn make(&self, key: &str, shelf: &Shelf, settings: &Settings, progress: &Progress) -> Result<Made, ShardError> {
        let spec = self.work.spec()?;
        let campaigns = self.campaigns()?;
        let mut plan = self.plan(&spec, &campaigns, shelf)?;
        let there = |plan: &Plan<'_>| {
            plan.tables.iter().filter(|table| table.wanted).flat_map(|table| table.present.clone()).flatten().count()
        };
        let before = there(&plan);
        make(&mut plan, settings, progress, None)?;
        let mut made = Made {
            key: key.to_owned(),
            captures: self.tickets().map(|ticket| ticket.captures).sum(),
            parts: there(&plan),
            computed: there(&plan) - before,
            rejects: 0,
            rows: BTreeMap::new(),
            digest: Digest::of(&json!(null)),
        };
        let mut files = Vec::new();
        for (step, table) in spec.steps.iter().zip(&plan.tables).filter(|(_, table)| table.wanted) {
            for (name, file) in table.present.iter().flatten().flat_map(|part| &part.files) {
                match name.as_str() {
                    Reject::TABLE => made.rejects += file.rows,
                    _ => *made.rows.entry(step.heading.clone()).or_default() += file.rows,
                }
                files.push(json!([step.heading, name, file]));
            }
        }
        made.digest = Digest::of(&json!(files));
        Ok(made)
    }

    /// Whether all its parts are complete.
    fn is_finished(&self, shelf: &Shelf) -> Result<bool, ShardError> {
        let spec = self.work.spec()?;
        let campaigns = self.campaigns()?;
        let plan = self.plan(&spec, &campaigns, shelf)?;
        Ok(plan.tables.iter().all(|table| !table.wanted || table.complete()))
    }
}

impl Job {
    /// Makes the parts whose pieces are finished.
    ///
    /// # Errors
    /// As [`Shard::join`].
    pub fn join(
        &self,
        shelf: &Shelf,
        settings: &Settings,
        progress: &Progress,
        tell: &mut dyn FnMut(&str),
    ) -> Result<(), ShardError> {
        for (key, pieces) in &self.cut {
            let shard: Shard = shelf.shard(key)?.ok_or_else(|| absent(shelf, key))?;
            // Unfinished pieces are reported later, with everything else that is missing.
            shard.join(pieces, shelf, settings, progress, tell)?;
        }
        Ok(())
    }

    fn is_finished(&self, key: &str, shelf: &Shelf) -> Result<bool, ShardError> {
        if self.cut.values().flatten().any(|piece| piece == key) {
            return Ok(shelf.piece(key)?.is_some());
        }
        let shard: Shard = shelf.shard(key)?.ok_or_else(|| absent(shelf, key))?;
        shard.is_finished(shelf)
    }

    /// Checks that all distributed work is finished, and gathers notes on raw files. The caller must hold the shelf
    /// alone.
    ///
    /// # Errors
    /// When parts are missing.
    pub fn check(&self, plan: &Plan<'_>) -> Result<(), ShardError> {
        for (step, table) in plan.spec.steps.iter().zip(&plan.tables) {
            let missing = table.present.iter().filter(|part| part.is_none()).count();
            if missing == 0 || !table.wanted || !self.work.stages.contains_key(&step.heading) {
                continue;
            }
            let mut keys = Vec::new();
            for key in &self.shards {
                if !self.is_finished(key, plan.shelf)? {
                    keys.push(key.clone());
                }
            }
            let (heading, parts) = (step.heading.clone(), table.present.len());
            return Err(ShardError::Unfinished { heading, missing, parts, keys });
        }
        // Not earlier: a worker that makes a shard again needs its own notes.
        for (&i, source) in &plan.sources {
            let failed = |source| PlanError::Stage { heading: plan.spec.steps[i].heading.clone(), source };
            source.close().map_err(failed)?;
        }
        Ok(())
    }
}
