//! What a person sees of a run: a bar on a terminal, plain lines elsewhere, JSON lines for programs, or nothing. On standard error.

use std::io::IsTerminal;
use std::sync::Mutex;
use std::sync::PoisonError;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;

/// How to show progress.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// A bar that is redrawn.
    Bar,
    /// A line for each pass, and every few seconds.
    Lines,
    /// The same as JSON objects.
    Json,
    /// Nothing.
    Silent,
}

impl Style {
    /// The bar on a terminal, lines elsewhere.
    #[must_use]
    pub fn auto() -> Self {
        if std::io::stderr().is_terminal() { Self::Bar } else { Self::Lines }
    }
}

/// Time between two lines.
const LINE_EVERY: Duration = Duration::from_secs(5);

/// Progress of a run.
pub struct Progress {
    style: Style,
    state: Mutex<State>,
    read: AtomicU64,
    rejected: AtomicU64,
}

struct State {
    bar: Option<ProgressBar>,
    pass: String,
    total: u64,
    started: Instant,
    last_line: Instant,
}

impl Progress {
    /// Shows progress in this style.
    #[must_use]
    pub fn new(style: Style) -> Self {
        let now = Instant::now();
        let state = State { bar: None, pass: String::new(), total: 0, started: now, last_line: now };
        Self { style, state: Mutex::new(state), read: AtomicU64::new(0), rejected: AtomicU64::new(0) }
    }

    /// A pass begins that makes these tables from so many raw bytes (0: from stored tables).
    pub fn pass(&self, headings: &[&str], bytes: u64) {
        self.finish();
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let now = Instant::now();
        (state.pass, state.total, state.started, state.last_line) = (headings.join(", "), bytes, now, now);
        self.read.store(0, Ordering::Relaxed);
        match self.style {
            Style::Bar => state.bar = Some(bar(&state.pass, bytes)),
            Style::Lines => eprintln!("computing {}", state.pass),
            Style::Json => eprintln!("{}", json!({ "event": "pass", "tables": headings, "bytes": bytes })),
            Style::Silent => {}
        }
    }

    /// So many raw bytes more were read.
    pub fn advance(&self, bytes: u64) {
        let read = self.read.fetch_add(bytes, Ordering::Relaxed) + bytes;
        if self.style == Style::Silent {
            return;
        }
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(bar) = &state.bar {
            bar.inc(bytes);
        } else if state.last_line.elapsed() >= LINE_EVERY {
            state.last_line = Instant::now();
            let seconds = state.started.elapsed().as_secs_f64();
            let (megabytes, rate) = (read as f64 / 1e6, read as f64 / 1e6 / seconds);
            let left_s = (state.total.saturating_sub(read)) as f64 / 1e6 / rate;
            match self.style {
                Style::Json => {
                    eprintln!("{}", json!({ "event": "read", "bytes": read, "of": state.total, "seconds": seconds }))
                }
                _ => eprintln!(
                    "  {megabytes:.0} of {:.0} MB, {rate:.0} MB/s, {left_s:.0} s left",
                    state.total as f64 / 1e6
                ),
            }
        }
    }

    /// So many rows more were set aside.
    pub fn rejected(&self, rows: u64) {
        self.rejected.fetch_add(rows, Ordering::Relaxed);
    }

    /// The pass, or the run, has ended.
    pub fn finish(&self) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(bar) = state.bar.take() {
            bar.finish_and_clear();
        }
        if state.pass.is_empty() {
            return;
        }
        let seconds = state.started.elapsed().as_secs_f64();
        let read = self.read.load(Ordering::Relaxed);
        match self.style {
            Style::Json => {
                eprintln!("{}", json!({ "event": "done", "tables": state.pass, "bytes": read, "seconds": seconds }))
            }
            Style::Bar if read > 0 => eprintln!("{}: {:.1} MB in {seconds:.2} s", state.pass, read as f64 / 1e6),
            Style::Bar => eprintln!("{}: {seconds:.2} s", state.pass),
            Style::Lines | Style::Silent => {}
        }
        state.pass.clear();
    }
}

fn bar(pass: &str, bytes: u64) -> ProgressBar {
    let (bar, template) = if bytes > 0 {
        (ProgressBar::new(bytes), "{msg}  {bar:30}  {bytes} of {total_bytes}, {bytes_per_sec}, {eta} left")
    } else {
        (ProgressBar::new_spinner(), "{spinner} {msg}")
    };
    let style = ProgressStyle::with_template(template).expect("the template is fixed");
    let bar = bar.with_style(style).with_message(pass.to_owned());
    bar.enable_steady_tick(Duration::from_millis(100));
    bar
}
