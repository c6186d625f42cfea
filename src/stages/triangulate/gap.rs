//! Whether something stands in the middle between two strips.

use super::model::Model;
use super::{Context, Triangulate};
use crate::geometry::Point;
use crate::geometry::bistatic::{ProfileOnsets, Solution};
use crate::priors::calibration;
use crate::priors::flight_profile::FlightProfile;
use crate::signal::between::{Between, Pair, Stray, between};
use crate::signal::response::Response;
use crate::tables::{Gap, Onset, Profile};

/// Share of a strip's light that leaves over the other's exit.
const STRAY: f64 = 0.02;
/// Variance in time of the light of one pulse, as patches have some extent: that of some millimetres.
const SPREAD_SD_PS2: f64 = 100.0;

/// Evidence of all profiles on light from the middle over one exit.
#[derive(Default)]
struct Evidence {
    log_ratio: f64,
    /// Sums of share over variance, and of one over variance.
    weighted: f64,
    weights: f64,
}

impl Triangulate {
    /// The gap behind strip `a`. `None` without profiles.
    pub(super) fn gap(
        &self,
        context: &Context,
        model: &Model,
        solution: &Solution,
        a: usize,
        reasons: &mut Vec<String>,
    ) -> Option<Gap> {
        let profiles = context.profiles.as_ref()?;
        let strips = [a, a + 1];
        let middle = nalgebra::center(&solution.points[a], &solution.points[a + 1]);
        let mut evidence = [Evidence::default(), Evidence::default()];
        let mut looked_at = 0;
        for (record, labels) in &solution.labels {
            let onsets: Vec<&Onset> = labels.iter().map(|onset| &model.onsets[*record][*onset].0).collect();
            let is_its = |profile: &&Profile| {
                (&profile.sensor, profile.lit, profile.seen, &profile.range)
                    == (&onsets[a].sensor, onsets[a].lit, onsets[a].seen, &onsets[a].range)
                    && &*profile.role == "scene"
            };
            context.cancel.check();
            let Some(profile) = profiles.iter().find(is_its) else { continue };
            let (flight, response) = match ready(context, profile) {
                Ok(ready) => ready,
                Err(why) => {
                    let Profile { sensor, lit, seen, .. } = profile;
                    reasons.push(format!("profile of sensor {sensor}, lit {lit}, seen {seen}, {why}"));
                    continue;
                }
            };
            let view = View { model, solution, record: &model.problem.records[*record], strips };
            let strays = view.strays();
            for (evidence, through) in evidence.iter_mut().zip([0, 1]) {
                let pair = Pair {
                    times_ps: [0, 1].map(|side| onsets[strips[side]].time_ps),
                    heights_v: [0, 1].map(|side| onsets[strips[side]].amplitude.abs()),
                    place: view.place([0, 1].map(|side| onsets[strips[side]].time_ps), middle, through),
                    share_least: self.share_least.get(),
                    spread_sd_ps2: SPREAD_SD_PS2,
                    strays: &strays,
                };
                between(&flight.view(), &response, &pair).iter().for_each(|said| evidence.add(said));
            }
            looked_at += 1;
        }
        let [first, second] = &evidence;
        let (strip, evidence) = if first.log_ratio <= second.log_ratio { (a, first) } else { (a + 1, second) };
        let free_probability = 1.0 / (1.0 + (-evidence.log_ratio).exp());
        let is_told = evidence.weights > 0.0;
        Some(Gap {
            a: model.strips[a],
            b: model.strips[a + 1],
            x_m: middle.x,
            y_m: middle.y,
            z_m: middle.z,
            through: model.points[model.problem.strips[strip].exit],
            profiles: looked_at,
            share: is_told.then(|| evidence.weighted / evidence.weights),
            share_sd: is_told.then(|| evidence.weights.sqrt().recip()),
            share_least: self.share_least.get(),
            log_ratio: evidence.log_ratio,
            free_probability,
            verdict: self.verdict(free_probability).into(),
        })
    }

    fn verdict(&self, free_probability: f64) -> &'static str {
        if free_probability >= self.certain.get() {
            "free"
        } else if free_probability <= 1.0 - self.certain.get() {
            "occupied"
        } else {
            "open"
        }
    }
}

impl Evidence {
    fn add(&mut self, said: &Between) {
        let weight = said.share_sd.powi(-2);
        self.log_ratio += 0.5 * (said.occupied_chi2 - said.free_chi2);
        self.weighted += said.share * weight;
        self.weights += weight;
    }
}

/// Two neighbours in one profile of third bounces.
struct View<'a> {
    model: &'a Model,
    solution: &'a Solution,
    record: &'a ProfileOnsets,
    strips: [usize; 2],
}

impl View<'_> {
    /// How much later light of one place is over one side's exit than of another over another's, ps.
    fn later_ps(&self, [from, to]: [(Point, usize); 2]) -> f64 {
        let anchor = |anchor: usize| self.solution.anchors[anchor].0;
        let way_m = |(at, side): (Point, usize)| {
            let exit = anchor(self.model.problem.strips[self.strips[side]].exit);
            (anchor(self.record.lit) - at).norm() + (exit - at).norm() + (anchor(self.record.station) - exit).norm()
        };
        self.model.medium.time_ps(way_m(to) - way_m(from))
    }

    /// Where between both pulses light of the middle comes. Counted from the neighbour over whose exit it leaves, so
    /// that what delays and positions have in common cancels.
    fn place(&self, times_ps: [f64; 2], middle: Point, through: usize) -> f64 {
        let strip = self.solution.points[self.strips[through]];
        let time_ps = times_ps[through] + self.later_ps([(strip, through), (middle, through)]);
        (time_ps - times_ps[0]) / (times_ps[1] - times_ps[0])
    }

    /// Light of each strip over the other's exit.
    fn strays(&self) -> [Stray; 2] {
        [0, 1].map(|of| {
            let strip = self.solution.points[self.strips[of]];
            Stray { of, later_ps: self.later_ps([(strip, of), (strip, 1 - of)]), share_sd: STRAY }
        })
    }
}

/// A profile in times of flight, with the response of its pulses; or why gaps are not judged on it.
fn ready(context: &Context, profile: &Profile) -> Result<(FlightProfile, Response), String> {
    if profile.counts.is_some() {
        return Err("holds photon counts, whose noise is not normal; gaps are not judged on them yet".to_owned());
    }
    let calibrated = context.sensors.of(profile);
    let calibrated =
        calibrated.ok_or_else(|| "has no calibration; capture the sensor's response, or import one".to_owned())?;
    let (sd_v, period_ps) = (calibration::sd_v(profile), context.fields.repetition_ps);
    let flight = FlightProfile::new(profile, calibrated, &context.sessions, period_ps, sd_v)?;
    Ok((flight, calibrated.1.averaged(profile)))
}
