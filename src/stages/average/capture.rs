//! The records of one capture, sorted by vertical range and given their time zero.

use super::piece::Extent;
use super::record;
use super::reference::ReferencePulse;
use super::rejected::Sought;
use super::shots::{Shots, view};
use super::{Average, Context, is_alike, rejection};
use crate::campaign::Role;
use crate::stages::stage::{Outcome, StageError};
use crate::tables::cell::Cell;
use crate::tables::traces::TraceColumns;
use crate::tables::{Codes, Name, Profile, Row, Subtotal, Trace};

/// A capture under way.
pub struct Capture {
    /// First signal row; until one comes, a row with its key.
    first: Trace,
    /// In the order of names; the empty one where captures have but one.
    ranges: Vec<(Name, Shots)>,
    /// Reference pulse of the shot whose signal comes next: shot and pulse; `None` where no pulse was found.
    reference: Option<(i32, Option<ReferencePulse>)>,
    /// Whether that reference pulse is cut off at the rails.
    reference_clipped: bool,
    /// Time of the first reference pulse: those of a train that come later are taken for the one next to it.
    first_pulse_ps: Option<f64>,
    missing_template: bool,
    has_reference: bool,
    /// Where the first reference pulse was sought.
    sought: Option<Sought>,
    extent: Extent,
}

/// File and channel of a reference row.
fn sought(columns: &TraceColumns, i: usize) -> Sought {
    let channel = <Option<Name> as Cell>::get(&columns.channel, i);
    let channel = channel.map_or(String::new(), |channel| format!(", channel {channel}"));
    Sought(format!("{}{channel}", columns.file.value(i)))
}

/// Whether times of a capture of this role are used.
fn needs_reference(row: &Trace) -> bool {
    [Role::Scene, Role::Fiducial].iter().any(|role| *row.role == *role.name())
}

impl Capture {
    /// No record yet; `first` has the key. A piece can be saved.
    pub fn new(first: Trace, extent: Extent) -> Self {
        Self {
            first,
            ranges: Vec::new(),
            reference: None,
            reference_clipped: false,
            first_pulse_ps: None,
            missing_template: false,
            has_reference: false,
            sought: None,
            extent,
        }
    }

    /// Takes the pulse that marks time zero of the next signal.
    pub fn take_reference(&mut self, context: &Context, columns: &TraceColumns, i: usize) {
        self.has_reference = true;
        self.sought.get_or_insert_with(|| sought(columns, i));
        let Some(template) = context.template(&self.first) else {
            self.missing_template = true;
            return;
        };
        let gain_v = columns.gain_v.value(i);
        let codes = view(columns.code_type.value(i), columns.codes.value(i));
        let samples_v: Vec<f64> = codes.to_f64().into_iter().map(|code| code * gain_v).collect();
        let whole = samples_v.iter().all(|sample| sample.is_finite());
        let pulse =
            whole.then(|| ReferencePulse::of(&samples_v, columns.t0_ps.value(i), columns.dt_ps.value(i), template));
        self.reference_clipped = columns.clipped.values()[i] > 0;
        // A pulse that is cut off at the rails has a biased time: such a shot is rejected.
        let mut pulse = pulse.flatten().filter(|_| !self.reference_clipped);
        if let Some(period_ps) = context.period_ps(&self.first) {
            pulse = pulse.map(|pulse| pulse.of_train(period_ps, self.first_pulse_ps.unwrap_or(0.0)));
            self.first_pulse_ps = self.first_pulse_ps.or(pulse.map(|pulse| pulse.time_ps));
        }
        self.reference = Some((columns.shot.value(i), pulse));
    }

    /// Takes a signal.
    pub fn take_signal(&mut self, average: &Average, context: &Context, columns: &TraceColumns, i: usize) {
        let reference = self.reference.take();
        let reference_clipped = std::mem::take(&mut self.reference_clipped);
        if self.first.is_reference {
            self.first = Trace::read(columns, i);
        }
        let range = columns.range.value(i);
        let place = self.place_of(range).unwrap_or_else(|place| {
            let shots = Shots::new(average, context, Trace::read(columns, i), self.extent);
            self.ranges.insert(place, (range.into(), shots));
            place
        });
        let (_, shots) = &mut self.ranges[place];
        if !is_alike(&shots.first, columns, i) {
            shots.rejected.other_scale += 1;
            return;
        }
        // A reference pulse that was not found, or is of another shot, leaves a shot without time.
        let timed = match reference {
            None => Some(None),
            Some((of, pulse)) => pulse.filter(|_| of == columns.shot.value(i)).map(Some),
        };
        let clipped = columns.clipped.values()[i].max(0) as usize;
        let Some(reference) = timed else {
            let cause = if reference_clipped {
                &mut shots.rejected.reference_clipped
            } else {
                &mut shots.rejected.without_reference
            };
            *cause += 1;
            shots.rejected.at_rails += i32::from(clipped > 0 || reference_clipped);
            return;
        };
        let codes = <Codes as Cell>::get(&columns.codes, i);
        if !view(&shots.first.code_type, &codes).is_finite() {
            shots.rejected.not_a_number += 1;
            return;
        }
        shots.take(average, codes, columns.t0_ps.value(i), reference, clipped);
    }

    /// Whether all is known by which later shots of the ranges seen so far are judged: their first shots, and of a
    /// train the first pulse.
    pub fn is_primed(&self, context: &Context) -> bool {
        let of_train = context.period_ps(&self.first).is_some() && context.template(&self.first).is_some();
        let is_timed = !of_train || self.first_pulse_ps.is_some();
        is_timed && !self.ranges.is_empty() && self.ranges.iter().all(|(_, shots)| shots.is_primed())
    }

    /// Forgets what was added up; of the ranges seen so far no first shots are to come.
    pub fn forget(&mut self, average: &Average) {
        self.ranges.iter_mut().for_each(|(_, shots)| shots.forget(average));
        (self.has_reference, self.missing_template) = (false, false);
    }

    /// What a piece adds up to.
    pub fn save(self, average: &Average) -> Result<Vec<Subtotal>, String> {
        let mut subtotals = Vec::new();
        for (_, shots) in self.ranges {
            subtotals.extend(shots.save(average)?);
        }
        subtotals.iter_mut().for_each(|subtotal| {
            (subtotal.has_reference, subtotal.missing_template) = (self.has_reference, self.missing_template);
        });
        Ok(subtotals)
    }

    /// Adds a row of what the next piece adds up to.
    pub fn absorb(&mut self, subtotal: Subtotal) -> Result<(), String> {
        self.has_reference |= subtotal.has_reference;
        self.missing_template |= subtotal.missing_template;
        let range = subtotal.range.clone().unwrap_or_default();
        let place = self.place_of(&range);
        let place = place.map_err(|_| format!("has shots of a vertical range {range} without first shots"))?;
        self.ranges[place].1.absorb(subtotal)
    }

    /// Where a range stands, or where it would.
    fn place_of(&self, range: &str) -> Result<usize, usize> {
        self.ranges.binary_search_by(|(name, _)| (**name).cmp(range))
    }

    /// The capture's profile.
    pub fn finish(self, average: &Average, context: &Context) -> Result<Outcome<Profile>, StageError> {
        let Self { first, ranges, missing_template, has_reference, sought, .. } = self;
        if missing_template {
            return Err(StageError::Refused(context.without_template(&first)));
        }
        // The latency of such a sensor counts from its reference pulse; times from the trigger would be wrong by what
        // lies between.
        if !first.is_reference && !has_reference && needs_reference(&first) && context.template(&first).is_some() {
            let why = "has no reference pulse, but the response captures of its sensor have; \
                 give its [[captures]] rule the `reference` too, or take it out of both";
            return Ok(Outcome::rejected(rejection(&first, why)));
        }
        let several = ranges.len() > 1;
        let place = |name: &Name| if several { format!("in its vertical range {name} ") } else { String::new() };
        let (mut records, mut troubles) = (Vec::new(), Vec::new());
        for (name, shots) in ranges {
            let place = place(&name);
            match shots.finish(average, several, sought.as_ref()) {
                Ok((record, doubts)) => {
                    records.push(record);
                    troubles.extend(doubts.iter().map(|why| format!("{place}{why}")));
                }
                Err(why) => troubles.push(format!("{place}{why}")),
            }
        }
        let record = match records.len() {
            0 => None,
            1 if !several => records.pop(),
            _ => match record::merged(records, &|profile| context.latency(profile)) {
                Ok((record, alone)) => {
                    troubles.extend(alone);
                    Some(record)
                }
                Err(why) => {
                    troubles.push(why);
                    None
                }
            },
        };
        if record.is_none() && troubles.is_empty() {
            troubles.push(format!("has no signal, but needs {} valid shots", average.shots_needed()));
        }
        let rows = record.map(|record| record.into_profile(context.period_ps(&first)));
        Ok(Outcome {
            rejections: troubles.iter().map(|why| rejection(&first, why)).collect(),
            ..Outcome::rows(rows.into_iter().collect())
        })
    }
}
