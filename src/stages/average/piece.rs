//! Captures in pieces: what is judged by their first shots, what is added up exactly, and what is handed over to be
//! added up in order.

use arrow_array::RecordBatch;
use arrow_schema::SchemaRef;

use super::capture::Capture;
use super::histogram::Histogram;
use super::{Average, Context, State};
use crate::stages::stage::InPieces;
use crate::tables::{Row, Subtotal, Trace};

/// Codes of 32 bits have sums below 2^53 up to this number of shots, in any order: whole numbers that `f64` holds
/// exactly.
const EXACT_SHOTS: u64 = 1 << 21;

/// How much of a capture is added up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    /// All of it; or pieces are joined to it.
    Whole,
    /// A piece, which will be saved.
    Piece,
}

impl InPieces<Self> for Average {
    fn schema(&self) -> SchemaRef {
        Subtotal::schema()
    }

    fn begin(&self, context: &Context, first: Trace) -> State {
        match context.cycles(&first) {
            Some(cycles) => State::Counts(Box::new(Histogram::new(first, cycles))),
            None => State::Analog(Box::new(Capture::new(first, Extent::Piece))),
        }
    }

    fn is_primed(&self, context: &Context, state: &State) -> bool {
        match state {
            State::Analog(capture) => capture.is_primed(context),
            State::Counts(histogram) => histogram.is_primed(),
        }
    }

    fn forget(&self, state: &mut State) {
        match state {
            State::Analog(capture) => capture.forget(self),
            State::Counts(histogram) => histogram.forget(),
        }
    }

    fn save(&self, state: State) -> Result<RecordBatch, String> {
        let subtotals = match state {
            State::Analog(capture) => capture.save(self)?,
            State::Counts(histogram) => histogram.save()?,
        };
        Ok(Subtotal::to_batch(&subtotals))
    }

    fn absorb(&self, state: &mut State, subtotals: &RecordBatch) -> Result<(), String> {
        let rows = Subtotal::rows(subtotals).map_err(|error| error.to_string())?;
        rows.into_iter().try_for_each(|subtotal| match state {
            State::Analog(capture) => capture.absorb(subtotal),
            State::Counts(histogram) => histogram.absorb(&subtotal),
        })
    }
}

/// Whether this many shots like the first add up to the same whatever their order.
///
/// # Errors
/// When they may not; the text says why.
pub fn exact(first: &Trace, shots: u64) -> Result<(), String> {
    let most = match &*first.code_type {
        "f32" | "f64" => {
            return Err("codes in floating point have sums that depend on the order of the shots".to_owned());
        }
        "i32" | "u32" => EXACT_SHOTS,
        _ => u64::MAX,
    };
    if shots <= most { Ok(()) } else { Err(format!("more than {most} shots of 32 bit codes may not add up exactly")) }
}

/// No shots of the capture and range of this row.
pub fn nothing(first: &Trace) -> Subtotal {
    Subtotal {
        campaign: first.campaign.clone(),
        sensor: first.sensor.clone(),
        lit: first.lit,
        seen: first.seen,
        role: first.role.clone(),
        run: first.run.clone(),
        range: first.range.clone(),
        is_cut: false,
        phase: None,
        shots: 0,
        first: 0,
        covered_from: 0,
        covered_to: 0,
        sums: Vec::new(),
        reference_ps: Vec::new(),
        reference_sd_ps: Vec::new(),
        reference_v_ps: Vec::new(),
        clipped_places: Vec::new(),
        clipped: 0,
        outlying: 0,
        reference_clipped: 0,
        without_reference: 0,
        not_a_number: 0,
        other_scale: 0,
        at_rails: 0,
        has_reference: false,
        missing_template: false,
    }
}
