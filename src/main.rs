//! The command line. Results go to standard output, all else to standard error.
//!
//! Exit codes: 0 done; 1 failed; 2 wrong usage; 3 done, but some input was left out or rejected, or a result is empty
//! (`--strict` makes that 1), `check` found something to fix, or `diff` a difference; 130 ended by Ctrl-C or SIGTERM:
//! what was finished is kept; 141 standard output was closed before all was printed.

mod commands;

use std::process::ExitCode;

use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{CommandFactory, Parser, Subcommand};
use commands::output::{Closed, note, print};
use mimalloc::MiMalloc;

/// Blocks of a record's size come and go by the thousand: the system's allocator gives each back to the kernel, which
/// clears its pages for the next. It is built to ask for no huge pages, which double what small runs take. Version 2
/// keeps what is free for a tenth of a second, version 3 for a second: peaks are lower by a sixth to a quarter.
#[global_allocator]
static ALLOCATOR: MiMalloc = MiMalloc;

/// Positions with error bars from time-of-flight waveforms, also of surfaces around the corner.
#[derive(Parser)]
#[command(name = "periscope", version, arg_required_else_help = true, after_help = AFTER_HELP, after_long_help = format!("{AFTER_HELP}\n\n{EXIT_CODES}"))]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

const AFTER_HELP: &str = "First time here:\n  periscope demo\nA campaign of your own:\n  periscope run --campaign DIR";

const EXIT_CODES: &str = "\
Exit codes:
  0    done
  1    failed
  2    wrong usage
  3    done, but input was left out or rejected, a result is empty, `check` found something to fix, or `diff` a difference
  130  ended by Ctrl-C or SIGTERM; what was finished is kept
  141  standard output was closed before all was printed, as by `| head`";

#[derive(Subcommand)]
enum Command {
    /// Simulate a small campaign of scope files, run its pipeline, and compare the result with the truth
    Demo(commands::demo::Demo),
    /// Turn campaigns into tables: the main job
    Run(commands::run::Run),
    /// List the built-in pipelines, each with the scene that it is for; with a name: print one
    Pipelines(commands::pipelines::Pipelines),
    /// Show what `run` would reuse or compute, and why; runs nothing. With --shards: split the work for many machines
    Plan(commands::plan::PlanArgs),
    /// Compute one shard of a plan: on any machine that can read the campaign and write to the result folder
    RunShard(commands::run_shard::RunShard),
    /// Finish a run when all shards are computed: run the stages that need all captures, and show the tables
    Gather(commands::gather::Gather),
    /// Decode scope files and show what they hold
    Inspect(commands::inspect::Inspect),
    /// Check a campaign, also while you still capture it: what is missing, clipped, faint or drifting
    Check(commands::check::Check),
    /// List the tables of a result folder
    Tables(commands::tables::Tables),
    /// Query the tables of a result folder in SQL
    Query(commands::query::Query),
    /// Draw the results: one page of HTML that needs no network, and figures for a paper
    Report(commands::report::Report),
    /// Show where a result comes from: from a patch, a distance or an onset back to the raw files
    Explain(commands::explain::Explain),
    /// Compare two result folders: which table differs first, by how much, and why
    Diff(commands::diff::Diff),
    /// Record the content hashes of a campaign's files
    Seal(commands::seal::Seal),
    /// Check a campaign's files against their hashes, or a result folder for damage: every byte, every lineage
    Verify(commands::verify::Verify),
    /// Simulate a campaign of scope files from a scene description, with the true values in a folder of their own
    Simulate(commands::simulate::Simulate),
    /// Convert a capture of non-line-of-sight imaging into a campaign (y-tal, Z-NLOS, confocal MAT-files)
    Convert(commands::convert::Convert),
    /// Write results for other programs: patches as a point cloud, profiles as a capture of y-tal
    Export(commands::export::Export),
    /// Before you capture: the error bars to expect, how long it takes, and what a change would bring
    Design(commands::design::Arguments),
    /// Show the columns of the tables, with units and meanings
    Schema(commands::schema::Schema),
    /// Print shell completions
    Completions {
        /// Shell
        shell: clap_complete::Shell,
    },
    /// Write manual pages: periscope.1 and one for each command
    Man(commands::man::Man),
}

impl Command {
    /// How a command that computes tables is asked to use the machine.
    fn machine(&self) -> Option<&commands::Machine> {
        match self {
            Self::Run(args) => Some(&args.machine),
            Self::RunShard(args) => Some(&args.machine),
            Self::Gather(args) => Some(&args.machine),
            _ => None,
        }
    }
}

fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return refuse(error),
    };
    let result = commands::start_threads(cli.command.machine()).and_then(|()| execute(cli.command));
    match result {
        Ok(code) => code,
        // A reader that has seen enough (`| head`) needs no message.
        Err(error) if error.is::<Closed>() => ExitCode::from(commands::CLOSED),
        Err(error) if commands::is_interruption(&error) => {
            note!("interrupted: {error}");
            ExitCode::from(commands::INTERRUPTED)
        }
        Err(error) => {
            note!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn execute(command: Command) -> anyhow::Result<ExitCode> {
    match command {
        Command::Demo(args) => commands::demo::demo(&args),
        Command::Run(args) => commands::run::run(&args),
        Command::Pipelines(args) => commands::pipelines::pipelines(&args),
        Command::Plan(args) => commands::plan::plan(&args),
        Command::RunShard(args) => commands::run_shard::run_shard(&args),
        Command::Gather(args) => commands::gather::gather(&args),
        Command::Inspect(args) => commands::inspect::inspect(&args),
        Command::Check(args) => commands::check::check(&args),
        Command::Tables(args) => commands::tables::tables(&args),
        Command::Query(args) => commands::query::query(&args),
        Command::Report(args) => commands::report::report(&args),
        Command::Explain(args) => commands::explain::explain(&args),
        Command::Diff(args) => commands::diff::diff(&args),
        Command::Seal(args) => commands::seal::seal(&args),
        Command::Verify(args) => commands::verify::verify(&args),
        Command::Simulate(args) => commands::simulate::simulate(&args),
        Command::Convert(args) => commands::convert::convert(&args),
        Command::Export(args) => commands::export::export(&args),
        Command::Design(args) => commands::design::design(&args),
        Command::Schema(args) => commands::schema::schema(&args),
        Command::Completions { shell } => {
            // In memory first: the crate's own writer takes a closed pipe for a defect.
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut Cli::command(), "periscope", &mut script);
            print(script).map(|()| ExitCode::SUCCESS)
        }
        Command::Man(args) => commands::man::man(&args, Cli::command()),
    }
}

/// Prints help, the version, or what is wrong with the command line.
fn refuse(mut error: clap::Error) -> ExitCode {
    let is_json = |value: &ContextValue| matches!(value, ContextValue::String(argument) if argument == "--json");
    if error.kind() == ErrorKind::UnknownArgument && error.get(ContextKind::InvalidArg).is_some_and(is_json) {
        let advice = "`--json` is now `--format json`; there is `--format csv` too".to_owned();
        error.remove(ContextKind::SuggestedArg);
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![advice.into()]));
    }
    let is_closed = error.print().is_err_and(|failure| failure.kind() == std::io::ErrorKind::BrokenPipe);
    let is_output = !error.use_stderr();
    ExitCode::from(if is_closed && is_output { commands::CLOSED } else { error.exit_code() as u8 })
}
