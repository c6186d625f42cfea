//! `periscope man`.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::{Args, Command};

use super::output::say;

/// Arguments of `man`.
#[derive(Args)]
pub struct Man {
    /// Folder for the pages, such as ~/.local/share/man/man1
    dir: PathBuf,
}

/// The command: writes the pages of `cli`, the whole command line.
pub fn man(args: &Man, cli: Command) -> Result<ExitCode> {
    let dir = args.dir.display();
    std::fs::create_dir_all(&args.dir).with_context(|| format!("cannot create {dir}"))?;
    clap_mangen::generate_to(cli, &args.dir).with_context(|| format!("cannot write the pages into {dir}"))?;
    say!("wrote periscope.1 and a page a command to {dir}; read with: man {dir}/periscope.1")?;
    Ok(ExitCode::SUCCESS)
}
