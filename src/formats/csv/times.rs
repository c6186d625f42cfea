//! The time base: from the header where it has one, else from the first and last time. Each time is checked against it.

use super::super::reader::FormatError;
use super::layout::{Axis, Layout, Role, Survey};
use super::refuse;

/// Largest deviation of a time from the even grid, in steps: rounding in print stays far below, a missing line exceeds
/// it.
const UNEVEN: f64 = 0.25;

/// Largest relative difference at which the steps of header and times count as equal.
const SAME: f64 = 1e-15;

/// Largest spread of the first times of segments, in steps: the trigger falls anywhere within a sample.
const APART: f64 = 2.0;

/// The time base of all segments.
#[derive(Debug)]
pub(super) struct Base {
    pub dt_s: Option<f64>,
    /// Time of the first sample of each segment.
    pub t0_s: Vec<Option<f64>>,
    /// The x that the column must have.
    printed: Option<Printed>,
}

/// The x of each sample, in the unit of its column.
#[derive(Debug)]
struct Printed {
    /// First x of each segment.
    first: Vec<f64>,
    step: f64,
    tolerance: f64,
    unit: String,
}

impl Base {
    pub(super) fn new(layout: &Layout, survey: &Survey, samples: u64) -> Result<Self, FormatError> {
        let mut base = Self::of(layout, survey, samples)?;
        if layout.axis.unit.name.is_none() {
            // The grid of the times is checked all the same.
            (base.dt_s, base.t0_s) = (None, vec![None; base.t0_s.len()]);
        }
        if base.t0_s.iter().flatten().all(|t0_s| t0_s.is_finite()) {
            return Ok(base);
        }
        Err(refuse(layout.first_line, "the time of the first sample is beyond all numbers; export the trace again"))
    }

    fn of(layout: &Layout, survey: &Survey, samples: u64) -> Result<Self, FormatError> {
        let axis = &layout.axis;
        if !layout.columns.iter().any(|column| column.role == Role::Time) {
            return Ok(Self { dt_s: axis.dt_s, t0_s: vec![axis.t0_s; layout.segments as usize], printed: None });
        }
        let first_xs = survey.ends.iter().map(|(first, _)| *first).collect();
        if axis.sequence {
            return Ok(Self::of_sequence(axis, first_xs));
        }
        let dt_s = step(layout, survey, samples)?;
        let unit = |x: f64| axis.unit.scale(x);
        // If the step comes from the times themselves, rounding is no excuse: they must be fine enough to show it.
        let resolution = |x: f64| if axis.dt_s.is_some() { resolution(unit(x), survey.digits) } else { 0.0 };
        let coarsest = survey.ends.iter().flat_map(|(first, last)| [*first, *last]).map(resolution).fold(0.0, f64::max);
        let first: Vec<f64> = match axis.t0_s {
            Some(t0_s) => vec![axis.unit.unscale(t0_s)],
            None => first_xs,
        };
        let apart = |x: &f64| (unit(*x) - unit(first[0])).abs() > APART * dt_s + coarsest;
        if first.iter().any(apart) {
            let problem =
                "the times of a segment do not begin where those of the first do; export the segments one by one";
            return Err(refuse(layout.first_line, problem));
        }
        let t0_s = first.iter().map(|x| (axis.t0_s.is_some() || resolution(*x) <= dt_s).then(|| unit(*x))).collect();
        let printed = Printed {
            first,
            step: axis.unit.unscale(dt_s),
            tolerance: axis.unit.unscale(UNEVEN * dt_s + coarsest),
            unit: axis.unit.name.clone().unwrap_or_default(),
        };
        Ok(Self { dt_s: Some(dt_s), t0_s, printed: Some(printed) })
    }

    /// The time base of a column that numbers the samples: the header gives the time of number 0 and the step.
    fn of_sequence(axis: &Axis, first: Vec<f64>) -> Self {
        let (dt_s, start_s) = (axis.dt_s.unwrap_or_default(), axis.t0_s.unwrap_or_default());
        let t0_s = first.iter().map(|number| Some(start_s + number * dt_s)).collect();
        let printed = Printed { first, step: 1.0, tolerance: UNEVEN, unit: String::new() };
        Self { dt_s: Some(dt_s), t0_s, printed: Some(printed) }
    }

    /// Checks that a printed x is on the grid.
    pub(super) fn check(&self, segment: usize, index: usize, x: f64) -> Result<(), String> {
        let Some(printed) = &self.printed else { return Ok(()) };
        let Printed { first, step, tolerance, unit } = printed;
        if (x - (first[segment] + index as f64 * step)).abs() <= *tolerance {
            return Ok(());
        }
        let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
        Err(format!("time {x}{unit} is off the even step of {step}; export the trace again with all its points"))
    }
}

/// Time between samples: from the header where it has one, else from the printed times.
fn step(layout: &Layout, survey: &Survey, samples: u64) -> Result<f64, FormatError> {
    let Axis { unit, dt_s: header_dt_s, .. } = &layout.axis;
    let steps =
        survey.ends.iter().map(|(first, last)| (unit.scale(*last) - unit.scale(*first)) / (samples.max(2) - 1) as f64);
    let of_times = steps.sum::<f64>() / survey.ends.len() as f64;
    let dt_s = match *header_dt_s {
        // If header and times agree, the last digit of the times counts; if the times are printed too coarsely, the
        // header does.
        Some(dt_s) if samples > 1 && (of_times - dt_s).abs() <= SAME * dt_s => of_times,
        Some(dt_s) => dt_s,
        None if samples < 2 => {
            return Err(refuse(layout.first_line, "a single time gives no step; export the trace with its samples"));
        }
        None => of_times,
    };
    if dt_s > 0.0 && dt_s.is_finite() {
        return Ok(dt_s);
    }
    Err(refuse(layout.first_line, "times do not increase; export the trace again"))
}

/// The last digit of a number that is printed with `digits` digits.
fn resolution(x: f64, digits: usize) -> f64 {
    if x == 0.0 { 0.0 } else { 10_f64.powi(x.abs().log10().floor() as i32 + 1 - digits as i32) }
}
