//! `periscope gather`.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use clap::Args;
use periscope::pipeline::rejects::MaxRejects;
use periscope::pipeline::run::Settings;
use periscope::pipeline::shards::{Job as Dealt, ShardError};
use periscope::store::{Gathered, Shelf};

use super::aftermath;
use super::interrupt::cancel_on_signals;
use super::machine::Machine;
use super::output::{Output, note};
use super::run::{Job, campaigns, open};

/// Arguments of `gather`.
#[derive(Args)]
pub struct Gather {
    /// Result folder
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    pub machine: Machine,
    /// Wait while shards are still being computed into the result folder, instead of failing
    #[arg(long)]
    wait: bool,
    /// Stop if more than this many records are rejected, or more than this share of all, such as 5%
    #[arg(long, value_name = "N|P%")]
    max_rejects: Option<MaxRejects>,
    /// Exit with 1 if any input was left out or rejected, or a result is empty
    #[arg(long)]
    strict: bool,
    #[command(flatten)]
    output: Output,
}

/// The command.
pub fn gather(args: &Gather) -> Result<ExitCode> {
    Shelf::look(&args.out)?;
    let shelf = args.machine.folder(open(&args.out, args.wait)?);
    let dealt: Option<Dealt> = shelf.job()?;
    let Some(dealt) = dealt else {
        let gathered = shelf.gathered()?.ok_or_else(|| ShardError::NoJob(args.out.clone()))?;
        note!("gathered already: nothing to do");
        return Ok(aftermath::exit_code(gathered.is_incomplete, args.strict));
    };
    let mut record = dealt.run.clone();
    let spec = dealt.work.spec()?;
    let campaigns = campaigns(&dealt.work.campaigns)?;
    let settings = args.machine.settings(Settings { max_rejects: args.max_rejects, ..Settings::default() });
    cancel_on_signals(&settings.cancel)?;
    let job = Job {
        spec: &spec,
        pipeline: &dealt.work.pipeline,
        set: &dealt.work.set,
        campaigns: &campaigns,
        shelf: &shelf,
        until: dealt.until.as_deref(),
        settings,
        style: args.machine.style(),
        shards: Some(&dealt),
    };
    let outcome = job.execute_and_tell(&mut record)?;
    let is_incomplete = aftermath::tell(&spec, &outcome, &shelf, args.output.format)?;
    let pieces = dealt.cut.iter().flat_map(|(key, pieces)| pieces.iter().chain([key]));
    let keys = dealt.shards.iter().chain(pieces).cloned().collect();
    shelf.end_shards(&Gathered { keys, is_incomplete })?;
    Ok(aftermath::exit_code(is_incomplete, args.strict))
}
