//! `periscope report`.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::Args;
use periscope::report::{self, figures, page};

use super::output::say;
use super::whole_file;

/// Arguments of `report`.
#[derive(Args)]
pub struct Report {
    /// Result folder
    out: PathBuf,
    /// File for the page (default: report.html in the result folder)
    #[arg(long, value_name = "FILE")]
    to: Option<PathBuf>,
    /// Write figures for a paper (SVG) into this folder, instead of the page
    #[arg(long, value_name = "DIR", conflicts_with = "to")]
    figures: Option<PathBuf>,
}

/// The command.
pub fn report(args: &Report) -> Result<ExitCode> {
    let report = report::Report::of(&args.out)?;
    if let Some(folder) = &args.figures {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
        for (name, svg) in figures::all(&report)? {
            write(&folder.join(format!("{name}.svg")), &svg)?;
        }
        return Ok(ExitCode::SUCCESS);
    }
    let file = args.to.clone().unwrap_or_else(|| page_of(&args.out));
    write(&file, &page::page(&report))?;
    Ok(ExitCode::SUCCESS)
}

/// Where the page of a result folder is, unless it is asked for elsewhere.
fn page_of(out: &Path) -> PathBuf {
    out.join("report.html")
}

/// Writes the page into its result folder; returns its path.
pub fn write_page(out: &Path) -> Result<PathBuf> {
    let file = page_of(out);
    let page = page::page(&report::Report::of(out)?);
    whole_file::write(&file, |out| out.write_all(page.as_bytes()))?;
    Ok(file)
}

fn write(file: &Path, text: &str) -> Result<()> {
    whole_file::write(file, |out| out.write_all(text.as_bytes()))?;
    say!("{}", file.display())
}
