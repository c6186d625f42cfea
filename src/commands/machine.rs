//! How a computing command uses the machine, and how it shows progress.

use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use periscope::pipeline::progress::Style;
use periscope::pipeline::run::Settings;
use periscope::store::Shelf;

/// Options of every command that computes tables; the tables do not depend on them.
#[derive(Args)]
pub struct Machine {
    /// Worker threads (default: one per core)
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Memory for raw samples in flight, such as 512MiB
    #[arg(long, value_name = "SIZE", value_parser = size)]
    memory: Option<usize>,
    /// Wait until each finished part is on the disk: then a power cut loses none
    #[arg(long)]
    durable: bool,
    /// How to show progress
    #[arg(long, value_enum, default_value = "auto")]
    progress: ProgressKind,
}

impl Machine {
    /// These settings, with the requested memory, or the default.
    pub fn settings(&self, defaults: Settings) -> Settings {
        let memory_bytes = self.memory.unwrap_or(defaults.memory_bytes.max(defaults.least_memory()));
        Settings { memory_bytes, ..defaults }
    }

    /// A result folder that is written as these options say.
    pub fn folder(&self, shelf: Shelf) -> Shelf {
        shelf.durable(self.durable)
    }

    /// How to show progress.
    pub fn style(&self) -> Style {
        self.progress.into()
    }
}

/// How to show progress.
#[derive(Clone, Copy, ValueEnum)]
pub enum ProgressKind {
    /// A bar on a terminal, lines elsewhere
    Auto,
    /// A bar
    Bar,
    /// A line for each pass, and some in between
    Lines,
    /// One JSON object per line
    Json,
    /// Nothing
    None,
}

impl From<ProgressKind> for Style {
    fn from(kind: ProgressKind) -> Self {
        match kind {
            ProgressKind::Auto => Self::auto(),
            ProgressKind::Bar => Self::Bar,
            ProgressKind::Lines => Self::Lines,
            ProgressKind::Json => Self::Json,
            ProgressKind::None => Self::Silent,
        }
    }
}

/// Parses `512MiB`, `64M`, `1GB`, `4096`.
pub fn size(text: &str) -> Result<usize, String> {
    let digits = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    let number: usize =
        number.parse().map_err(|_| format!("`{text}` does not begin with a whole number; write 512MiB"))?;
    let factor = match unit.trim().to_ascii_lowercase().as_str() {
        "" | "b" => 1,
        "k" | "kib" => 1 << 10,
        "kb" => 1000,
        "m" | "mib" => 1 << 20,
        "mb" => 1_000_000,
        "g" | "gib" => 1 << 30,
        "gb" => 1_000_000_000,
        _ => {
            return Err(format!("`{unit}` is no unit of size; write KiB, MiB or GiB"));
        }
    };
    number.checked_mul(factor).ok_or_else(|| format!("`{text}` is too much"))
}

/// Starts the worker threads: as many as the command asks for, if it does. Comes before anything that uses them, which
/// would start them itself, and panic where the system gives none.
pub fn start_threads(machine: Option<&Machine>) -> Result<()> {
    let threads = machine.and_then(|machine| machine.threads);
    if threads == Some(0) {
        bail!("--threads 0: give at least 1");
    }
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads.unwrap_or(0))
        .build_global()
        .context("cannot start the worker threads; this user, or container, is at its limit of processes")
}
