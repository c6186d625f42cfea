//! `periscope seal`.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use clap::Args;
use periscope::campaign::{Campaign, seal as seal_campaign};

use super::output::say;

/// Arguments of `seal`.
#[derive(Args)]
pub struct Seal {
    /// Campaign folder
    dir: PathBuf,
    /// Also record files that are new since the last seal, and campaign.toml as it is now
    #[arg(long)]
    update: bool,
}

/// The command.
pub fn seal(args: &Seal) -> Result<ExitCode> {
    let campaign = Campaign::read(&args.dir)?;
    let survey = campaign.survey()?;
    let report = seal_campaign(&campaign, &survey, args.update)?;
    say!("{}", report.to_string().trim_start())?;
    Ok(ExitCode::SUCCESS)
}
