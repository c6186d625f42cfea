//! `periscope pipelines`.

use std::process::ExitCode;

use anyhow::Result;
use clap::Args;
use periscope::pipeline::spec::{BUILT_IN, BuiltIn, SpecError};
use serde_json::json;

use super::output::{Format, Output, Rows, json, print};

/// Arguments of `pipelines`.
#[derive(Args)]
pub struct Pipelines {
    /// Name of one, to print it; without it, all are listed
    name: Option<String>,
    #[command(flatten)]
    output: Output,
}

/// The command.
pub fn pipelines(args: &Pipelines) -> Result<ExitCode> {
    let Some(name) = &args.name else {
        let mut rows = Rows::new(&["pipeline", "scene"]);
        BUILT_IN.iter().for_each(|pipeline| rows.push([json!(pipeline.name), json!(pipeline.purpose())]));
        rows.print(args.output.format)?;
        return Ok(ExitCode::SUCCESS);
    };
    let pipeline = BuiltIn::named(name).ok_or_else(|| SpecError::Unknown { name: name.clone() })?;
    let fields = [json!(pipeline.name), json!(pipeline.purpose()), json!(pipeline.text)];
    match args.output.format {
        Format::Table => print(pipeline.text)?,
        Format::Json => print(json(&json!({ "pipeline": fields[0], "scene": fields[1], "text": fields[2] }))?)?,
        Format::Csv => {
            let mut rows = Rows::new(&["pipeline", "scene", "text"]);
            rows.push(fields);
            rows.print(Format::Csv)?;
        }
    }
    Ok(ExitCode::SUCCESS)
}
