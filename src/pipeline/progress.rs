//! Progress of a run on standard error: a bar on a terminal, plain lines elsewhere, JSON lines for programs, or
//! nothing.
//!
//! A pass reads raw files or a stored table, and the fraction read is the progress. Gathering stages start when all
//! rows are read. Their duration is unknown in advance, so the elapsed time is shown then.

use std::io::{IsTerminal, Write};
use std::sync::Mutex;
use std::sync::PoisonError;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressFinish, ProgressStyle};
use serde_json::{Value, json};

/// How to show progress.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// A bar that is redrawn.
    Bar,
    /// A line for each pass, and some in between.
    Lines,
    /// JSON objects, one per line.
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

/// What a pass reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Amount {
    /// Raw files, in bytes.
    Bytes(u64),
    /// A stored table, in rows.
    Rows(u64),
}

impl Amount {
    fn total(self) -> u64 {
        let (Self::Bytes(total) | Self::Rows(total)) = self;
        total
    }

    fn unit(self) -> &'static str {
        match self {
            Self::Bytes(_) => "bytes",
            Self::Rows(_) => "rows",
        }
    }

    /// An amount for people: `12.5 MB`, `480 rows`.
    fn text(self, amount: f64) -> String {
        match self {
            Self::Bytes(_) if amount < 1e9 => format!("{:.1} MB", amount / 1e6),
            Self::Bytes(_) => format!("{:.2} GB", amount / 1e9),
            Self::Rows(_) => format!("{amount:.0} rows"),
        }
    }
}

/// Time to the first line within a pass. Each further one takes twice as long, up to [`LINE_AT_LAST`], so that the log
/// of a night stays short.
const LINE_FIRST: Duration = Duration::from_secs(5);
const LINE_AT_LAST: Duration = Duration::from_mins(5);
/// Time between two JSON objects within a pass.
const JSON_EVERY: Duration = Duration::from_secs(1);
const LISTENER_EVERY: Duration = Duration::from_millis(100);

/// Prints a line to standard error. That it is closed is no reason to stop.
macro_rules! note {
    ($($text:tt)*) => {{
        let _ = writeln!(std::io::stderr().lock(), $($text)*);
    }};
}

/// Takes the events of [`Style::Json`].
type Listener = Box<dyn Fn(&Value) + Send + Sync>;

/// Progress of a run.
pub struct Progress {
    style: Style,
    listener: Option<Listener>,
    pass: Mutex<Option<Pass>>,
    read: AtomicU64,
    rejected: AtomicU64,
}

/// The current pass.
struct Pass {
    tables: Vec<String>,
    amount: Amount,
    started: Instant,
    last_line: Instant,
    next_line: Duration,
    bar: Option<ProgressBar>,
}

impl Progress {
    /// Shows progress in this style.
    #[must_use]
    pub fn new(style: Style) -> Self {
        Self { style, listener: None, pass: Mutex::new(None), read: AtomicU64::new(0), rejected: AtomicU64::new(0) }
    }

    /// Hands the objects of [`Style::Json`] to a listener in place of standard error, ten a second at most.
    #[must_use]
    pub fn to(listener: impl Fn(&Value) + Send + Sync + 'static) -> Self {
        Self { listener: Some(Box::new(listener)), ..Self::new(Style::Json) }
    }

    /// Passes an object on.
    fn send(&self, event: &Value) {
        match &self.listener {
            Some(listener) => listener(event),
            None => note!("{event}"),
        }
    }

    /// Starts a pass that makes these tables from this amount; `whole` of the `wanted` tables are finished.
    pub(super) fn pass(&self, headings: &[&str], amount: Amount, whole: usize, wanted: usize) {
        self.read.store(0, Ordering::Relaxed);
        self.rejected.store(0, Ordering::Relaxed);
        let tables = headings.join(", ");
        let place = format!("[{whole}/{wanted}]");
        let bar = (self.style == Style::Bar).then(|| bar(place.clone(), tables.clone(), amount));
        match self.style {
            Style::Lines => note!("{place} computing {tables}"),
            Style::Json => self.send(
                &json!({ "event": "pass", "tables": headings, "unit": amount.unit(), "of": amount.total(), "whole": whole, "wanted": wanted })
            ),
            Style::Bar | Style::Silent => {}
        }
        let tables = headings.iter().map(|&heading| heading.to_owned()).collect();
        let next_line = match (self.style, &self.listener) {
            (Style::Json, Some(_)) => LISTENER_EVERY,
            (Style::Json, None) => JSON_EVERY,
            _ => LINE_FIRST,
        };
        let now = Instant::now();
        *self.pass.lock().unwrap_or_else(PoisonError::into_inner) =
            Some(Pass { tables, amount, started: now, last_line: now, next_line, bar });
    }

    /// Adds an amount that was read, in the unit of the pass.
    pub(super) fn advance(&self, by: u64) {
        let read = self.read.fetch_add(by, Ordering::Relaxed) + by;
        if self.style == Style::Silent {
            return;
        }
        let mut pass = self.pass.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(pass) = pass.as_mut() else { return };
        if let Some(bar) = &pass.bar {
            bar.set_position(read);
            if read >= pass.amount.total() {
                bar.set_style(style("{prefix} {spinner} all read, still computing, {elapsed} so far  {wide_msg}"));
            }
        } else if pass.last_line.elapsed() >= pass.next_line {
            pass.last_line = Instant::now();
            let elapsed = pass.started.elapsed();
            if self.style == Style::Json {
                self.send(&json_line("read", pass, read, elapsed));
            } else {
                pass.next_line = (2 * pass.next_line).min(LINE_AT_LAST);
                note!("  {}", line(pass.amount, read, elapsed));
            }
        }
    }

    /// Adds rejected rows.
    pub(super) fn rejected(&self, rows: u64) {
        self.rejected.fetch_add(rows, Ordering::Relaxed);
    }

    /// Ends the pass, with all its tables finished. A failing pass prints nothing: its bar disappears.
    pub(super) fn finish(&self) {
        let Some(pass) = self.pass.lock().unwrap_or_else(PoisonError::into_inner).take() else { return };
        let elapsed = pass.started.elapsed();
        let read = self.read.load(Ordering::Relaxed);
        let rejected = self.rejected.load(Ordering::Relaxed);
        let aside = if rejected > 0 { format!(", {rejected} rejected") } else { String::new() };
        let summary = format!("{} in {:.2} s{aside}", pass.amount.text(read as f64), elapsed.as_secs_f64());
        match self.style {
            Style::Json => {
                let mut done = json_line("done", &pass, read, elapsed);
                done["tables"] = json!(pass.tables);
                done["rejected"] = json!(rejected);
                self.send(&done);
            }
            Style::Bar => {
                pass.bar.iter().for_each(ProgressBar::finish_and_clear);
                note!("{}: {summary}", pass.tables.join(", "));
            }
            // A line for slow passes: who reads a log wants to know what took long.
            Style::Lines if elapsed >= LINE_FIRST || rejected > 0 => note!("  {summary}"),
            Style::Lines | Style::Silent => {}
        }
    }
}

/// Seconds for the rest at the present rate; `None` before anything is read.
fn left_s(total: u64, read: u64, elapsed: Duration) -> Option<f64> {
    (read > 0).then(|| total.saturating_sub(read) as f64 / read as f64 * elapsed.as_secs_f64())
}

fn line(amount: Amount, read: u64, elapsed: Duration) -> String {
    let rate = read as f64 / elapsed.as_secs_f64();
    let left = left_s(amount.total(), read, elapsed).map_or(String::new(), |left_s| format!(", {left_s:.0} s left"));
    format!("{} of {}, {}/s{left}", amount.text(read as f64), amount.text(amount.total() as f64), amount.text(rate))
}

fn json_line(event: &str, pass: &Pass, read: u64, elapsed: Duration) -> Value {
    let (unit, of) = (pass.amount.unit(), pass.amount.total());
    json!({
        "event": event, "unit": unit, "read": read, "of": of,
        "seconds": elapsed.as_secs_f64(), "left_s": left_s(of, read, elapsed),
    })
}

fn bar(place: String, tables: String, amount: Amount) -> ProgressBar {
    let reading = match amount {
        Amount::Bytes(_) => {
            "{prefix} {bar:25} {decimal_bytes} of {decimal_total_bytes}, {decimal_bytes_per_sec}, {eta} left  {wide_msg}"
        }
        Amount::Rows(_) => "{prefix} {bar:25} {human_pos} of {human_len} rows, {eta} left  {wide_msg}",
    };
    let bar = ProgressBar::new(amount.total()).with_style(style(reading));
    let bar = bar.with_prefix(place).with_message(tables).with_finish(ProgressFinish::AndClear);
    bar.enable_steady_tick(Duration::from_millis(100));
    bar
}

fn style(template: &str) -> ProgressStyle {
    ProgressStyle::with_template(template).expect("the templates are fixed")
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;

    #[test]
    fn a_line_says_how_far_how_fast_and_how_long_still() {
        let elapsed = Duration::from_secs(4);
        let bytes = Amount::Bytes(3_000_000_000);
        assert_eq!(line(bytes, 500_000_000, elapsed), "500.0 MB of 3.00 GB, 125.0 MB/s, 20 s left");
        assert_eq!(line(Amount::Rows(900), 300, elapsed), "300 rows of 900 rows, 75 rows/s, 8 s left");
        assert_eq!(line(Amount::Rows(900), 0, elapsed), "0 rows of 900 rows, 0 rows/s");
    }

    #[test]
    fn a_listener_gets_each_pass_with_its_end() {
        let events = Arc::new(Mutex::new(Vec::new()));
        let heard = Arc::clone(&events);
        let progress = Progress::to(move |event| heard.lock().unwrap().push(event.clone()));
        progress.pass(&["profiles"], Amount::Rows(10), 1, 2);
        progress.advance(10);
        progress.finish();
        let events = events.lock().unwrap();
        assert_eq!(events[0]["event"], "pass");
        assert_eq!((&events[0]["tables"], &events[0]["of"]), (&json!(["profiles"]), &json!(10)));
        let last = events.last().unwrap();
        assert_eq!((&last["event"], &last["read"]), (&json!("done"), &json!(10)));
    }
}
