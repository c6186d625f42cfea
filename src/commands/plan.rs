//! `periscope plan`.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use clap::Args;
use periscope::pipeline::plan::{Action, Plan};
use periscope::pipeline::spec::Spec;
use periscope::store::Shelf;

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
}

/// The command.
pub fn plan(args: &PlanArgs) -> Result<ExitCode> {
    let spec = Spec::load(&args.pipeline, &args.set)?;
    let campaigns = campaigns(&args.campaign)?;
    let shelf = Shelf::imagine(&args.out);
    let plan = Plan::new(&spec, &campaigns, &shelf, args.until.as_deref())?;
    for warning in plan.warnings() {
        eprintln!("warning: {warning}");
    }
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
