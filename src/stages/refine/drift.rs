//! Delays that drift while the captures are taken, as onsets that check one another show it.
//!
//! The delay of each sensor walks through the times of its captures ([`crate::geometry::drift`]); all sensors walk
//! alike far in the same time. A walk begins at the calibration: what it has gone until the first capture is one more
//! error that all onsets of the sensor share.

use std::collections::BTreeMap;
use std::ops::Range;

use super::model::Model;
use crate::geometry::drift;
use crate::geometry::maximum_likelihood::{Observation, Problem, Solution};
use crate::geometry::repeats::Repeats;
use crate::priors::acquisition_time;
use crate::priors::campaign_fields::Medium;
use crate::priors::sensor_range::SensorRange;
use crate::tables::{Label, Name};

/// A size to begin with where no path was measured twice, in errors of a single onset, as far as residuals are larger
/// than these: too large rather than too small.
const FIRST_SIZE: f64 = 3.0;

/// Walks of the delays of all sensors whose captures have times.
#[derive(Clone)]
pub struct Drift {
    /// By campaign and sensor.
    walks: BTreeMap<(Name, Name), Walk>,
    /// Number of their first error among those that onsets have in common.
    first: usize,
    /// Longest of their spans.
    pub span_s: f64,
    /// Standard deviation of a walk at the end of that.
    size_m: f64,
    /// Log-likelihood ratio of the walks.
    pub gain: f64,
}

/// A walk from the first to the last capture of a sensor.
#[derive(Clone)]
struct Walk {
    /// Number of its first error: that from the calibration to the first capture. Then follow those of its steps.
    first: usize,
    /// When the first capture was taken, as its file says it.
    from: Name,
    from_s: f64,
    span_s: f64,
    /// From the calibration to the first capture.
    before_s: f64,
    /// From 0 s on.
    steps: drift::Walk,
}

/// A drift at the times of captures.
pub struct Knots {
    pub from: Name,
    /// Since then.
    pub times_s: Vec<f64>,
    /// Of each, the common errors that make it, m per standard deviation.
    pub errors: Vec<Vec<(usize, f64)>>,
}

fn time_s(time: Option<&Name>) -> Option<f64> {
    acquisition_time::seconds(time?)
}

impl Drift {
    /// Walks whose size is yet to be told; `None` where no sensor has all its captures at known times. Their errors
    /// have the numbers from `first` on.
    pub fn new(model: &Model, solution: &Solution, problem: &Problem, first: usize) -> Option<Self> {
        let mut of_sensors: BTreeMap<(Name, Name), Vec<&Label>> = BTreeMap::new();
        for label in model.labels {
            of_sensors.entry((label.campaign.clone(), label.sensor.clone())).or_default().push(label);
        }
        let (mut walks, mut next) = (BTreeMap::new(), first);
        for (key, labels) in of_sensors {
            if let Some(walk) = Walk::new(&labels, model.context.calibrated_at.get(&key), next) {
                next = walk.errors().end;
                walks.insert(key, walk);
            }
        }
        let span_s = walks.values().map(|walk| walk.span_s).reduce(f64::max)?;
        let weight: f64 = problem.observations.iter().map(|observation| observation.sd_m.powi(-2)).sum();
        let sd_m = (problem.observations.len() as f64 / weight).sqrt();
        let factor = solution.loss / solution.degrees_of_freedom.max(1) as f64;
        let times: Vec<Option<f64>> = model.labels.iter().map(|label| time_s(label.acquired_at.as_ref())).collect();
        let walked_m = Repeats::of(&problem.observations).walk_m2(&times).map(|rate_m2_s| (rate_m2_s * span_s).sqrt());
        let size_m = walked_m.unwrap_or_else(|| FIRST_SIZE * sd_m * factor.max(1.0).sqrt());
        Some(Self { walks, first, span_s, size_m, gain: 0.0 })
    }

    /// Numbers of the errors.
    pub fn errors(&self) -> Range<usize> {
        self.first..self.walks.values().map(|walk| walk.errors().end).max().unwrap_or(self.first)
    }

    /// The same with walks that go so many times as far.
    pub fn scaled(&self, scale: f64, gain: f64) -> Self {
        Self { size_m: scale * self.size_m, gain, ..self.clone() }
    }

    /// Adds what the walk of a label's sensor makes of its onset.
    pub fn add_to(&self, label: &Label, observation: &mut Observation) {
        let walk = self.walks.get(&(label.campaign.clone(), label.sensor.clone()));
        if let Some((walk, time_s)) = walk.zip(time_s(label.acquired_at.as_ref())) {
            let since_s = time_s - walk.from_s;
            observation.common.extend(self.errors_at(walk, since_s));
            observation.sd_m = observation.sd_m.hypot(self.sd_m(walk.steps.variance_left(since_s)));
        }
    }

    /// Standard deviation of a walk after so long.
    fn sd_m(&self, span_s: f64) -> f64 {
        self.size_m * (span_s / self.span_s).sqrt()
    }

    fn errors_at(&self, walk: &Walk, since_s: f64) -> Vec<(usize, f64)> {
        let one_second_m = self.sd_m(1.0);
        let of_steps = walk.steps.terms(since_s).into_iter().map(|term| one_second_m * term);
        (walk.first..).zip([self.sd_m(walk.before_s)].into_iter().chain(of_steps)).collect()
    }

    /// The drift of a sensor; `None` where it has none.
    pub fn knots(&self, campaign: &Name, sensor: &Name) -> Option<Knots> {
        let walk = self.walks.get(&(campaign.clone(), sensor.clone()))?;
        let times_s = walk.steps.knots().to_vec();
        let errors = times_s.iter().map(|since_s| self.errors_at(walk, *since_s)).collect();
        Some(Knots { from: walk.from.clone(), times_s, errors })
    }

    /// Sensors that drift, but have no delay of their own among `delays`, since their latency is exact.
    pub fn without_delay(&self, delays: &[SensorRange]) -> Vec<SensorRange> {
        let has_delay =
            |key: &(Name, Name)| delays.iter().any(|delay| (&delay.campaign, &delay.sensor) == (&key.0, &key.1));
        let key = |(campaign, sensor): &(Name, Name)| SensorRange {
            campaign: campaign.clone(),
            sensor: sensor.clone(),
            range: None,
        };
        self.walks.keys().filter(|sensor| !has_delay(sensor)).map(key).collect()
    }

    /// The largest change of a sensor's delay.
    pub fn largest_ps(&self, solution: &Solution, medium: impl Fn(&Name) -> Medium) -> f64 {
        let change = |(campaign, sensor): &(Name, Name)| {
            let knots = self.knots(campaign, sensor).expect("sensors with a walk");
            let values_m = knots.errors.iter().map(|errors| solution.addition_m(None, errors).0);
            let (least, most) = values_m
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), value| (least.min(value), most.max(value)));
            medium(campaign).time_ps(most - least)
        };
        self.walks.keys().map(change).fold(0.0, f64::max)
    }
}

impl Walk {
    /// Through the captures of one sensor.
    fn new(labels: &[&Label], calibrated_at: Option<&Name>, first: usize) -> Option<Self> {
        let times_s: Vec<f64> = labels.iter().map(|label| time_s(label.acquired_at.as_ref())).collect::<Option<_>>()?;
        let earliest = (0..labels.len()).min_by(|a, b| times_s[*a].total_cmp(&times_s[*b]))?;
        let from_s = times_s[earliest];
        let since_s: Vec<f64> = times_s.iter().map(|time_s| time_s - from_s).collect();
        let steps = drift::Walk::through(&since_s)?;
        let before_s = time_s(calibrated_at).map_or(0.0, |time_s| (from_s - time_s).abs());
        let from = labels[earliest].acquired_at.clone()?;
        Some(Self { first, from, from_s, span_s: *steps.knots().last()?, before_s, steps })
    }

    /// Numbers of its errors.
    fn errors(&self) -> Range<usize> {
        self.first..self.first + self.steps.knots().len()
    }
}
