//! What each thread of a run does when: a file that Perfetto's viewer opens.
//!
//! Each stage has a track, and so has what reads raw files or a stored table, and the run itself with its passes. A
//! stage that waits for rows waits for the one above it; one that waits to hand rows on, for the one below.
//!
//! The file is an array of JSON objects, an event a line, in the trace event format that Chrome began. Readers take it
//! without its closing bracket too, so that a run that is killed leaves what it did.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use serde_json::{Value, json};

/// Shorter spans are left out, in microseconds: a stage takes many batches a millisecond.
const SHORTEST_US: f64 = 20.0;

/// A trace that is being written.
pub struct Timeline {
    began: Instant,
    state: Mutex<State>,
}

struct State {
    out: Box<dyn Write + Send>,
    /// Numbers of tracks by their names.
    tracks: BTreeMap<String, usize>,
    /// The first error: a trace is no reason to stop a run, but its loss is reported.
    failure: Option<io::Error>,
}

impl std::fmt::Debug for Timeline {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Timeline").field("began", &self.began).finish_non_exhaustive()
    }
}

impl Timeline {
    /// Begins a trace.
    ///
    /// # Errors
    /// When it cannot be written to.
    pub fn new(mut out: Box<dyn Write + Send>) -> io::Result<Self> {
        writeln!(out, "[")?;
        let state = State { out, tracks: BTreeMap::new(), failure: None };
        Ok(Self { began: Instant::now(), state: Mutex::new(state) })
    }

    /// Does something, as a span of a track.
    pub fn span<T>(timeline: Option<&Self>, track: &str, what: &str, body: impl FnOnce() -> T) -> T {
        let Some(timeline) = timeline else { return body() };
        let from_us = timeline.now_us();
        let value = body();
        let for_us = timeline.now_us() - from_us;
        if for_us >= SHORTEST_US {
            timeline.write(
                track,
                |id| json!({ "ph": "X", "pid": 1, "tid": id, "name": what, "ts": from_us, "dur": for_us }),
            );
        }
        value
    }

    /// Ends the trace.
    ///
    /// # Errors
    /// When any of it could not be written.
    pub fn finish(&self) -> io::Result<()> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let failure = state.failure.take();
        failure.map_or(Ok(()), Err)?;
        // The last event has a comma behind it.
        writeln!(
            state.out,
            "{}\n]",
            json!({ "ph": "M", "pid": 1, "name": "process_name", "args": { "name": "periscope" } })
        )?;
        state.out.flush()
    }

    fn now_us(&self) -> f64 {
        self.began.elapsed().as_secs_f64() * 1e6
    }

    fn write(&self, track: &str, event: impl FnOnce(usize) -> Value) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let next = state.tracks.len() + 1;
        let outcome = if let Some(id) = state.tracks.get(track).copied() {
            state.line(&event(id))
        } else {
            state.tracks.insert(track.to_owned(), next);
            let name = json!({ "ph": "M", "pid": 1, "tid": next, "name": "thread_name", "args": { "name": track } });
            state.line(&name).and_then(|()| state.line(&event(next)))
        };
        if let Err(error) = outcome {
            state.failure.get_or_insert(error);
        }
    }
}

impl State {
    fn line(&mut self, event: &Value) -> io::Result<()> {
        writeln!(self.out, "{event},")
    }
}
