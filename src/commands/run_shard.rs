//! `periscope run-shard`.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use clap::Args;
use periscope::pipeline::progress::Progress;
use periscope::pipeline::run::{RunError, Settings};
use periscope::pipeline::shards::{Cut, Shard, ShardError, absent};
use periscope::store::Shelf;

use super::interrupt::cancel_on_signals;
use super::machine::Machine;
use super::output::{note, say};

/// Arguments of `run-shard`.
#[derive(Args)]
pub struct RunShard {
    /// Key of the shard, as `plan --shards` prints it
    key: String,
    /// Result folder of the plan
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    pub machine: Machine,
}

/// The command.
pub fn run_shard(args: &RunShard) -> Result<ExitCode> {
    // A missing folder is not created here: a worker that does not see the result folder must fail.
    Shelf::look(&args.out)?;
    let shelf = args.machine.folder(Shelf::join(&args.out)?);
    if shelf.gathered()?.is_some_and(|gathered| gathered.keys.contains(&args.key)) {
        note!("shard {} was gathered already: nothing to do", args.key);
        return Ok(ExitCode::SUCCESS);
    }
    let cut: Option<Cut> = shelf.cut(&args.key)?;
    let settings = args.machine.settings(Settings::default());
    cancel_on_signals(&settings.cancel)?;
    let progress = Progress::new(args.machine.style());
    let made = if let Some(cut) = cut {
        cut.make(&args.key, &shelf, &settings, &progress)
    } else {
        let shard: Shard = shelf.shard(&args.key)?.ok_or_else(|| absent(&shelf, &args.key))?;
        shard.make(&args.key, &shelf, &settings, &progress)
    };
    let made = match made {
        Err(ShardError::Run(error @ RunError::Interrupted { .. })) => return Err(error.into()),
        made => made?,
    };
    say!("{}", serde_json::to_string(&made)?)?;
    Ok(ExitCode::SUCCESS)
}
