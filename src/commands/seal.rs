//! `periscope seal`.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use clap::Args;
use periscope::campaign;

/// Arguments of `seal`.
#[derive(Args)]
pub struct Seal {
    /// Campaign folder
    dir: PathBuf,
    /// Let files join that came since it was sealed
    #[arg(long)]
    update: bool,
}

/// The command.
pub fn seal(args: &Seal) -> Result<ExitCode> {
    let campaign = campaign::load(&args.dir)?;
    let survey = campaign::survey(&campaign)?;
    let report = campaign::manifest::seal(&campaign, &survey, args.update)?;
    println!("{report}");
    Ok(ExitCode::SUCCESS)
}
