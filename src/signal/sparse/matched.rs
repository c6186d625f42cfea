//! One more pulse, too weak to be found, beside light of known places.

use super::column::Column;
use super::model::Record;
use super::place::Place;
use super::{Profile, Response, SparseOptions};

/// A column of which others leave no larger part of its length says nothing new.
const NEW: f64 = 0.05;

/// Light whose place is known and whose amplitude is not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Given {
    /// Arrival, ps.
    pub time_ps: f64,
    /// Standard deviation of the spread of its light, ps.
    pub width_ps: f64,
    /// What beside the amplitude is open.
    pub open: Open,
}

/// What of a given pulse is open beside its amplitude.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Open {
    /// Nothing: it is where other light says.
    Amplitude,
    /// Its time, to first order: it was fitted.
    Time,
    /// The spread of its light as well, as strong pulses tell it.
    Width,
}

/// What a record says of one more pulse at each of some times.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Matched {
    /// Amplitude over its standard deviation.
    pub scores: Vec<f64>,
    /// One over that standard deviation, 1/V; 0 where nothing can be said.
    pub gains: Vec<f64>,
}

/// The matched filter for a pulse of spread `width_ps` at each of `times_ps`, in whitened samples freed of a constant and of `given` light: what any of these could explain
/// does not count. Amplitude and standard deviation are those of the joint least-squares fit of the pulse with all of them.
///
/// # Panics
/// As [`super::fit`].
#[must_use]
pub fn matched(
    profile: &Profile,
    response: &Response,
    given: &[Given],
    width_ps: f64,
    times_ps: impl Iterator<Item = f64>,
) -> Matched {
    let record = Record::new(profile, response, &SparseOptions::default());
    let mut known = Known { axes: Vec::new() };
    known.add(record.constant.clone());
    for light in given {
        known.add_light(&record, light);
    }
    let mut residual = record.whitener.apply(profile.mean_v);
    known.take_out(&mut residual);
    let mut matched = Matched::default();
    for time_ps in times_ps {
        let column = Column::new(&record, &place(time_ps, width_ps));
        let (norm, left) = known.left_of(&column);
        let is_told = record.holds(time_ps) && left > NEW * NEW * norm;
        let gain = if is_told { left.sqrt() } else { 0.0 };
        matched.scores.push(if is_told { column.dot_record(&residual)[0] / gain } else { 0.0 });
        matched.gains.push(gain);
    }
    matched
}

fn place(time_ps: f64, width_ps: f64) -> Place {
    if width_ps > 0.0 { Place::widened(time_ps, width_ps * width_ps) } else { Place::point(time_ps) }
}

/// An orthonormal basis of what given light may look like.
struct Known {
    axes: Vec<Vec<f64>>,
}

impl Known {
    /// Adds a direction, if it is a new one. Taken out twice: once leaves what rounding makes of nearly equal ones.
    fn add(&mut self, mut direction: Vec<f64>) {
        let before = squared(&direction);
        self.take_out(&mut direction);
        self.take_out(&mut direction);
        let left = squared(&direction);
        if left > NEW * NEW * before && left > 0.0 {
            direction.iter_mut().for_each(|value| *value /= left.sqrt());
            self.axes.push(direction);
        }
    }

    fn add_light(&mut self, record: &Record, light: &Given) {
        let column = Column::new(record, &place(light.time_ps, light.width_ps));
        let [value, slope] = column.dense(record.len());
        self.add(value);
        if light.open != Open::Amplitude {
            self.add(slope);
        }
        if light.open == Open::Width {
            let [widening, _] = Column::widening(record, light.time_ps).dense(record.len());
            self.add(widening);
        }
    }

    fn take_out(&self, samples: &mut [f64]) {
        for axis in &self.axes {
            let along: f64 = axis.iter().zip(&*samples).map(|(a, s)| a * s).sum();
            samples.iter_mut().zip(axis).for_each(|(s, a)| *s -= along * a);
        }
    }

    /// Squared norm of a column, and of what the basis leaves of it.
    fn left_of(&self, column: &Column) -> (f64, f64) {
        let norm = column.shared(column);
        let along = |axis: &Vec<f64>| column.dot_record(axis)[0].powi(2);
        (norm, norm - self.axes.iter().map(along).sum::<f64>())
    }
}

fn squared(values: &[f64]) -> f64 {
    values.iter().map(|value| value * value).sum()
}
