//! `periscope plan`.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Result;
use clap::Args;
use periscope::pipeline::plan::{Action, Plan};
use periscope::pipeline::progress::{Progress, Style};
use periscope::pipeline::responses;
use periscope::pipeline::run::Settings;
use periscope::pipeline::shards::{self, Cut, Dealt, Job, Shard, Work};
use periscope::pipeline::spec::{Definition, Reference, Spec};
use periscope::store::Shelf;
use periscope::store::runs::RunRecord;
use serde_json::json;

use super::aftermath;
use super::interrupt::cancel_on_signals;
use super::output::{self, Format, Output, Rows, note, print};
use super::run::{campaigns, or_declared, reference, results};

/// Arguments of `plan`.
#[derive(Args)]
pub struct PlanArgs {
    /// Pipeline: a name that `periscope pipelines` lists, or a file (TOML) [default: as of `run`]
    #[arg(value_parser = reference())]
    pipeline: Option<Reference>,
    /// Campaign folder; may be given several times
    #[arg(long, required_unless_present = "resolved", value_name = "DIR")]
    campaign: Vec<PathBuf>,
    /// Result folder (default: `<campaign>-results`, next to the campaign)
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print the whole pipeline, with what its bases give and what --set changes, as a file that can be run
    #[arg(long, conflicts_with_all = ["campaign", "out", "until", "shards"])]
    resolved: bool,
    /// Stop after this table
    #[arg(long, value_name = "TABLE")]
    until: Option<String>,
    /// Change a parameter of the pipeline, such as `onsets.threshold_sigma=6`
    #[arg(long, value_name = "TABLE.PARAM=VALUE")]
    set: Vec<String>,
    /// Distribute the missing work over at most this many shards, for `run-shard` on any machines and `gather` at the
    /// end; makes the whole tables that they need, such as the calibration
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    shards: Option<u32>,
    #[command(flatten)]
    output: Output,
}

/// The command.
pub fn plan(args: &PlanArgs) -> Result<ExitCode> {
    let campaigns = campaigns(&args.campaign)?;
    let reference = or_declared(args.pipeline.as_ref(), &campaigns);
    let definition = Definition::load(&reference)?;
    let mut changed = definition.clone();
    changed.set(&args.set)?;
    let spec = Spec::new(&changed)?;
    if args.resolved {
        print(changed.to_toml())?;
        return Ok(ExitCode::SUCCESS);
    }
    let out = results(args.out.as_deref(), &args.campaign)?;
    if let Some(count) = args.shards {
        let work = Work {
            pipeline: reference.absolute()?,
            text: definition.to_toml(),
            set: args.set.clone(),
            ..Work::default()
        };
        return deal(args, &spec, work, &out, count as usize);
    }
    let shelf = Shelf::imagine(&out);
    let plan = Plan::new(&spec, &campaigns, &shelf, args.until.as_deref())?;
    aftermath::tell_left_out(&plan);
    responses::require(&plan)?;
    let mut rows = Rows::new(&["action", "table", "stage", "why"]);
    for step in 0..spec.steps.len() {
        let decision = plan.decision(step)?;
        let action = match decision.action {
            Action::Reuse => "reuse",
            Action::Compute => "compute",
            Action::Pass => "pass",
            Action::Skip => "skip",
        };
        rows.push([json!(action), json!(decision.heading), json!(decision.stage), json!(decision.why)]);
    }
    rows.print(args.output.format)?;
    Ok(ExitCode::SUCCESS)
}

/// Writes shards into the result folder, and lists them.
fn deal(args: &PlanArgs, spec: &Spec, work: Work, out: &Path, count: usize) -> Result<ExitCode> {
    // Absolute paths: a worker may start in another folder.
    let absolute = |path: &PathBuf| std::path::absolute(path);
    let campaigns = campaigns(&args.campaign.iter().map(absolute).collect::<Result<Vec<_>, _>>()?)?;
    let shelf = Shelf::join(out)?;
    let roots = campaigns.iter().map(|campaign| (campaign.name.as_str(), campaign.root.as_path()));
    let run = RunRecord::start(work.pipeline.clone(), &args.set, roots)?;
    // As long as this record has no end, `tables --prune` keeps the results of shards.
    shelf.write_run(&run)?;
    let mut plan = Plan::new(spec, &campaigns, &shelf, args.until.as_deref())?;
    aftermath::tell_left_out(&plan);
    responses::require(&plan)?;
    let settings = Settings::default();
    let settings = Settings { memory_bytes: settings.memory_bytes.max(settings.least_memory()), ..settings };
    cancel_on_signals(&settings.cancel)?;
    shards::prepare(&mut plan, &settings, &Progress::new(Style::auto()))?;
    let work = Work { campaigns: campaigns.iter().map(|campaign| campaign.root.clone()).collect(), ..work };
    let Dealt { work, shards, cut, uncut } = shards::deal(&plan, work, count)?;
    for why in uncut {
        note!("a part that is larger than a shard should be is not cut: {why}");
    }
    let mut pieces = Vec::new();
    for (key, cut) in cut.iter().flat_map(|(_, _, pieces)| pieces) {
        if shelf.piece(key)?.is_none() {
            pieces.push((key, cut));
        }
    }
    let keys = pieces.iter().map(|(key, _)| *key).chain(shards.iter().map(|(key, _)| key)).cloned().collect();
    let keys_of = |pieces: &[(String, Cut)]| pieces.iter().map(|(key, _)| key.clone()).collect();
    let job = Job {
        work,
        until: args.until.clone(),
        run,
        shards: keys,
        cut: cut.iter().map(|(key, _, pieces)| (key.clone(), keys_of(pieces))).collect(),
    };
    let whole = cut.iter().map(|(key, shard, _)| (key, shard));
    let files: Vec<_> = shards.iter().map(|(key, shard)| (key, shard)).chain(whole).collect();
    let cuts: Vec<_> = cut.iter().flat_map(|(_, _, pieces)| pieces).map(|(key, cut)| (key, cut)).collect();
    shelf.write_shards(&job, &files, &cuts)?;
    let pieces = pieces.iter().map(|(key, cut)| Listed::of_piece(key, cut));
    let listed = pieces.chain(shards.iter().map(|(key, shard)| Listed::of_shard(key, shard))).collect();
    list(listed, args.output.format)?;
    let dealt = job.shards.len();
    if dealt == 0 {
        note!("no shard is left to compute; `periscope gather --out {}` computes the rest", out.display());
    } else if dealt < count {
        note!(
            "{} instead of {count}: a shard holds whole parts, or a piece of one; a smaller `part_bytes` in [campaign] of campaign.toml makes more of them",
            output::count(dealt, "shard", "shards")
        );
    }
    Ok(ExitCode::SUCCESS)
}

/// A shard or a piece as it is listed.
struct Listed {
    key: String,
    captures: usize,
    parts: usize,
    bytes: u64,
    /// Number of the piece, and of how many.
    piece: Option<(usize, usize)>,
    /// First shot and end, by file, of a piece.
    shots: Option<BTreeMap<PathBuf, [usize; 2]>>,
    /// Raw files.
    inputs: Vec<PathBuf>,
}

impl Listed {
    fn of_piece(key: &str, cut: &Cut) -> Self {
        let Cut { number, count, piece, .. } = cut;
        let shots = |(file, shots): (&PathBuf, &Range<usize>)| (file.clone(), [shots.start, shots.end]);
        Self {
            key: key.to_owned(),
            captures: piece.captures.len(),
            parts: 0,
            bytes: piece.bytes,
            piece: Some((*number, *count)),
            shots: Some(piece.shots.iter().map(shots).collect()),
            inputs: piece.files.clone(),
        }
    }

    fn of_shard(key: &str, shard: &Shard) -> Self {
        let tickets = || shard.tickets();
        let mut inputs: Vec<PathBuf> = tickets().flat_map(|ticket| &ticket.files).cloned().collect();
        inputs.sort();
        inputs.dedup();
        Self {
            key: key.to_owned(),
            captures: tickets().map(|ticket| ticket.captures).sum(),
            parts: tickets().count(),
            bytes: tickets().map(|ticket| ticket.bytes).sum(),
            piece: None,
            shots: None,
            inputs,
        }
    }
}

/// Lists shards; a table has the number of their files in place of their names.
fn list(shards: Vec<Listed>, format: Format) -> Result<()> {
    let is_table = format == Format::Table;
    let last = if is_table { "files" } else { "inputs" };
    let mut rows = Rows::new(&["key", "captures", "parts", "bytes", "piece", "pieces", "shots", last]);
    for Listed { key, captures, parts, bytes, piece, shots, inputs } in shards {
        let (number, count) = piece.unzip();
        let inputs = if is_table { json!(inputs.len()) } else { json!(inputs) };
        rows.push([
            json!(key),
            json!(captures),
            json!(parts),
            json!(bytes),
            json!(number),
            json!(count),
            json!(shots),
            inputs,
        ]);
    }
    rows.print(format)
}
