//! `periscope pipelines`.

use std::process::ExitCode;

use anyhow::Result;
use clap::Args;
use periscope::pipeline::spec::{BUILT_IN, BuiltIn, SpecError};

/// Arguments of `pipelines`.
#[derive(Args)]
pub struct Pipelines {
    /// Name of one, to print it; without it, all are listed
    name: Option<String>,
}

/// The command.
pub fn pipelines(args: &Pipelines) -> Result<ExitCode> {
    if let Some(name) = &args.name {
        let pipeline = BuiltIn::named(name).ok_or_else(|| SpecError::Unknown { name: name.clone() })?;
        print!("{}", pipeline.text);
        return Ok(ExitCode::SUCCESS);
    }
    for pipeline in BUILT_IN {
        println!("{:20} {}", pipeline.name, pipeline.purpose());
    }
    Ok(ExitCode::SUCCESS)
}
