//! Periscope: where light bounced, from oscilloscope traces of a time-of-flight campaign.
//!
//! A tour, from the ground up. Four crates of the workspace stand on their own and are re-exported here; the rest of
//! the program stands on them.
//!
//! - [`geometry`] (`periscope-geometry`): points and path lengths in, positions out. Its [`units`] turns times into
//!   lengths, and is the only place that does; its [`path`] is a path of light over patches.
//! - [`signal`] (`periscope-signal`): samples in, arrival times out.
//! - [`formats`] (`periscope-formats`) reads scope files; [`waveform`] is one record of an oscilloscope.
//! - [`cancel`] (`periscope-cancel`) ends long loops.
//! - [`store`] keeps tables on disk under the lineage that made them; [`campaign`] is what was captured, and in which
//!   files; [`tables`] declares each kind of row once, [`parameter`] the ranges of parameters.
//! - [`stages`] are the verbs: each takes rows of one table, gives rows of another, and knows neither files nor
//!   threads. [`priors`] is what they know before a solve. [`simulate`] makes campaigns whose truth is known, and
//!   shares no code with them.
//! - [`pipeline`] turns a pipeline file into a plan, and a plan into finished tables; it knows no physics. [`history`]
//!   goes the other way: from a row back to the raw files, and from two result folders to what made them differ.
//!   [`report`] draws what a result folder says. [`exchange`] turns captures of other programs into campaigns, and
//!   results into files that other programs open. [`bound`] predicts the precision of a
//!   planned campaign, [`wall_outlook`] the points that a relay wall would show.
//!
//! How to use the program stands in the [`guide`].
//!
//! ```no_run
//! use periscope::pipeline::{plan::Plan, progress::{Progress, Style}, run, spec::Spec};
//! use periscope::{campaign::Campaign, store::Shelf};
//! # fn main() -> anyhow::Result<()> {
//! let spec = Spec::load("all-visible".as_ref(), &[])?;
//! let campaigns = [Campaign::load("my-campaign".as_ref())?];
//! let shelf = Shelf::open("results".as_ref())?;
//! let mut plan = Plan::new(&spec, &campaigns, &shelf, None)?;
//! run::run(&mut plan, &run::Settings::default(), &Progress::new(Style::auto()))?;
//! # Ok(()) }
//! ```

pub mod bound;
pub mod campaign;
pub mod exchange;
#[cfg(doc)]
pub mod guide;
pub mod history;
pub mod parameter;
pub mod pipeline;
pub mod priors;
pub mod report;
pub mod simulate;
pub mod stages;
pub mod store;
pub mod tables;
pub mod wall_outlook;

pub use periscope_cancel as cancel;
pub use periscope_formats::{self as formats, waveform};
pub use periscope_geometry::{self as geometry, path, units};
pub use periscope_signal as signal;
