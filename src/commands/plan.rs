//! `periscope plan`.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::Args;
use periscope::pipeline::plan::{Action, Plan};
use periscope::pipeline::progress::{Progress, Style};
use periscope::pipeline::run::Settings;
use periscope::pipeline::shards::{self, Cut, Dealt, Job, Shard, Work};
use periscope::pipeline::spec::Spec;
use periscope::store::Shelf;
use periscope::store::runs::RunRecord;
use serde_json::json;

use super::interrupt::cancel_on_signals;
use super::run::campaigns;

/// Arguments of `plan`.
#[derive(Args)]
pub struct PlanArgs {
    /// Pipeline file (TOML)
    pipeline: PathBuf,
    /// Campaign folder; may be given several times
    #[arg(long, required = true, value_name = "DIR")]
    campaign: Vec<PathBuf>,
    /// Result folder
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
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
    /// With --shards: one JSON object per shard, one per line
    #[arg(long, requires = "shards")]
    json: bool,
}

/// The command.
pub fn plan(args: &PlanArgs) -> Result<ExitCode> {
    let spec = Spec::load(&args.pipeline, &args.set)?;
    if let Some(count) = args.shards {
        return deal(args, &spec, count as usize);
    }
    let campaigns = campaigns(&args.campaign)?;
    let shelf = Shelf::imagine(&args.out);
    let plan = Plan::new(&spec, &campaigns, &shelf, args.until.as_deref())?;
    tell_warnings(&plan);
    for step in 0..spec.steps.len() {
        let decision = plan.decision(step)?;
        let action = match decision.action {
            Action::Reuse => "reuse",
            Action::Compute => "compute",
            Action::Pass => "pass",
            Action::Skip => "skip",
        };
        println!("{action:8} {:24} {:10} {}", decision.heading, decision.stage, decision.why);
    }
    Ok(ExitCode::SUCCESS)
}

fn tell_warnings(plan: &Plan<'_>) {
    for warning in plan.warnings() {
        eprintln!("warning: {warning}");
    }
}

/// Writes shards into the result folder, and lists them.
fn deal(args: &PlanArgs, spec: &Spec, count: usize) -> Result<ExitCode> {
    // Absolute paths: a worker may start in another folder.
    let absolute = |path: &PathBuf| std::path::absolute(path);
    let campaigns = campaigns(&args.campaign.iter().map(absolute).collect::<Result<Vec<_>, _>>()?)?;
    let shelf = Shelf::join(&args.out)?;
    let roots = campaigns.iter().map(|campaign| (campaign.name.as_str(), campaign.root.as_path()));
    let run = RunRecord::start(&args.pipeline, &args.set, roots)?;
    // As long as this record has no end, `tables --prune` keeps the results of shards.
    shelf.write_run(&run)?;
    let mut plan = Plan::new(spec, &campaigns, &shelf, args.until.as_deref())?;
    tell_warnings(&plan);
    let settings = Settings::default();
    let settings = Settings { memory_bytes: settings.memory_bytes.max(settings.least_memory()), ..settings };
    cancel_on_signals(&settings.cancel)?;
    shards::prepare(&mut plan, &settings, &Progress::new(Style::auto()))?;
    let work = Work {
        pipeline: absolute(&args.pipeline)?,
        text: std::fs::read_to_string(&args.pipeline)
            .with_context(|| format!("cannot read {}", args.pipeline.display()))?,
        set: args.set.clone(),
        campaigns: campaigns.iter().map(|campaign| campaign.root.clone()).collect(),
        ..Work::default()
    };
    let Dealt { work, shards, cut, uncut } = shards::deal(&plan, work, count)?;
    for why in uncut {
        eprintln!("a part that is more than a fair share is not cut: {why}");
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
    pieces.iter().for_each(|(key, cut)| tell_piece(key, cut, args.json));
    shards.iter().for_each(|(key, shard)| tell(key, shard, args.json));
    let dealt = job.shards.len();
    if dealt == 0 {
        eprintln!(
            "nothing is missing that shards make; `periscope gather --out {}` makes the rest",
            args.out.display()
        );
    } else if dealt < count {
        eprintln!(
            "{dealt} shards and not {count}: a shard holds whole parts, or a piece of one; a smaller `part_bytes` in [campaign] of campaign.toml makes more of them"
        );
    }
    Ok(ExitCode::SUCCESS)
}

fn tell_piece(key: &str, cut: &Cut, is_json: bool) {
    let Cut { number, count, piece, .. } = cut;
    let shots = |shots: &Range<usize>| [shots.start, shots.end];
    let shots: BTreeMap<&Path, [usize; 2]> =
        piece.shots.iter().map(|(file, of_file)| (file.as_path(), shots(of_file))).collect();
    if is_json {
        println!(
            "{}",
            json!({
                "key": key, "captures": piece.captures.len(), "parts": 0, "piece": number, "pieces": count, "shots": shots,
                "bytes": piece.bytes, "inputs": piece.files,
            })
        );
    } else {
        let (captures, bytes, files) = (piece.captures.len(), piece.bytes, piece.files.len());
        let shots: Vec<String> =
            shots.iter().map(|(file, [first, end])| format!("  shots {first}..{end} of {}", file.display())).collect();
        println!(
            "{key}  {captures:>9} captures  piece {number} of {count}  {bytes:>14} bytes  {files:>7} files{}",
            shots.concat()
        );
    }
}

fn tell(key: &str, shard: &Shard, is_json: bool) {
    let tickets = || shard.tickets();
    let captures: usize = tickets().map(|ticket| ticket.captures).sum();
    let (parts, bytes) = (tickets().count(), tickets().map(|ticket| ticket.bytes).sum::<u64>());
    let mut inputs: Vec<&Path> = tickets().flat_map(|ticket| &ticket.files).map(PathBuf::as_path).collect();
    inputs.sort();
    inputs.dedup();
    if is_json {
        println!("{}", json!({ "key": key, "captures": captures, "parts": parts, "bytes": bytes, "inputs": inputs }));
    } else {
        println!("{key}  {captures:>9} captures  {parts:>6} parts  {bytes:>14} bytes  {:>7} files", inputs.len());
    }
}
