//! Whether something stands in the middle between two strips.

use super::model::Model;
use super::{Known, Triangulate, calibrated};
use crate::geometry::Point;
use crate::geometry::bistatic::Solution;
use crate::signal::response::Response;
use crate::signal::sparse::{self, Given, Open};
use crate::stages::correction::Correction;
use crate::tables::{Gap, Onset, Profile};
use crate::units;

/// Share of the strips' pulses that is left where another pulse would be, as their light has some extent in time and a little of it leaves over the other's exit.
const LEFT_OVER: f64 = 0.02;

/// Evidence of all profiles on light from the middle over one exit.
#[derive(Default)]
struct Evidence {
    log_ratio: f64,
    /// Sums of share over variance, and of one over variance.
    weighted: f64,
    weights: f64,
}

/// A profile made ready: upwards, without pick-up, in times of flight.
struct Ready {
    samples: Vec<f64>,
    sd_v: Vec<f64>,
    acf: Vec<f64>,
    t0_ps: f64,
    dt_ps: f64,
    response: Response,
}

impl Triangulate {
    /// The gap behind strip `a`. `None` without profiles.
    pub(super) fn gap(
        &self,
        known: &Known,
        model: &Model,
        solution: &Solution,
        a: usize,
        reasons: &mut Vec<String>,
    ) -> Option<Gap> {
        let profiles = known.profiles.as_ref()?;
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
            let Some(profile) = profiles.iter().find(is_its) else { continue };
            let ready = match ready(known, profile) {
                Ok(ready) => ready,
                Err(why) => {
                    let Profile { sensor, lit, seen, .. } = profile;
                    reasons.push(format!("profile of sensor {sensor}, lit {lit}, seen {seen}, {why}"));
                    continue;
                }
            };
            let given: Vec<Given> =
                onsets.iter().map(|onset| Given { time_ps: onset.time_ps, width_ps: 0.0, open: Open::Time }).collect();
            let lit = solution.anchors[model.problem.records[*record].lit].0;
            // From the neighbour's own onset, so that what delays and positions have in common cancels.
            let time_ps = |strip: usize| {
                let exit = solution.anchors[model.problem.strips[strip].exit].0;
                let way_m = |at: Point| (lit - at).norm() + (exit - at).norm();
                let later_m = way_m(middle) - way_m(solution.points[strip]);
                onsets[strip].time_ps + units::time_ps(later_m, model.group_index)
            };
            let matched =
                sparse::matched(&ready.profile(), &ready.response, &given, 0.0, strips.map(time_ps).into_iter());
            let heights_v = strips.map(|strip| onsets[strip].amplitude.abs());
            for (evidence, (score, gain)) in evidence.iter_mut().zip(matched.scores.iter().zip(&matched.gains)) {
                evidence.add(*score, *gain, heights_v, self.share_least);
            }
            looked_at += 1;
        }
        let [first, second] = &evidence;
        let (strip, evidence) = if first.log_ratio <= second.log_ratio { (a, first) } else { (a + 1, second) };
        let free_probability = 1.0 / (1.0 + (-evidence.log_ratio).exp());
        let verdict = if free_probability >= self.certain {
            "free"
        } else if free_probability <= 1.0 - self.certain {
            "occupied"
        } else {
            "open"
        };
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
            share_least: self.share_least,
            log_ratio: evidence.log_ratio,
            free_probability,
            verdict: verdict.into(),
        })
    }
}

impl Evidence {
    /// Adds what a profile says of a pulse at the place: score and gain beside the strips' pulses. Something there has at least the least share, and its likeliest amplitude above.
    fn add(&mut self, score: f64, gain: f64, heights_v: [f64; 2], share_least: f64) {
        if gain == 0.0 {
            return;
        }
        let weaker_v = heights_v[0].min(heights_v[1]);
        let share = score / gain / weaker_v;
        let variance = ((1.0 / gain).powi(2) + (LEFT_OVER * (heights_v[0] + heights_v[1])).powi(2)) / weaker_v.powi(2);
        let missing = (share_least - share).max(0.0);
        self.log_ratio += 0.5 * (missing * missing - share * share) / variance;
        self.weighted += share / variance;
        self.weights += 1.0 / variance;
    }
}

fn ready(known: &Known, profile: &Profile) -> Result<Ready, String> {
    if profile.counts.is_some() {
        return Err("holds photon counts, whose noise is not normal; gaps are not judged on them yet".to_owned());
    }
    let row = calibrated::row_of(&known.calibration, profile)
        .ok_or_else(|| "has no calibration; capture the sensor's response, or import one".to_owned())?;
    let key = calibrated::key_of(row);
    let sensor = &known.calibrated[&key];
    let correction = Correction::of(&known.sessions, &key, profile)?;
    let mut samples = profile.mean_v.to_f64();
    let mut sd_v = calibrated::sd_v(profile);
    correction.take_pickup_off(profile, known.setup.repetition_ps, &mut samples, &mut sd_v)?;
    samples.iter_mut().for_each(|sample| *sample *= sensor.polarity);
    let noise_v = profile.noise_v / f64::from(profile.shots).sqrt();
    // What is no more than the rounding of the samples is white.
    let acf = if noise_v <= calibrated::rounding_v(profile) { vec![1.0] } else { calibrated::correlation(profile) };
    Ok(Ready {
        samples,
        sd_v,
        acf,
        t0_ps: profile.t0_ps - sensor.latency_ps - correction.drift_ps,
        dt_ps: profile.dt_ps,
        response: sensor.averaged(profile),
    })
}

impl Ready {
    fn profile(&self) -> sparse::Profile<'_> {
        let Self { samples: mean_v, sd_v, acf, t0_ps, dt_ps, .. } = self;
        sparse::Profile { mean_v, sd_v, acf, t0_ps: *t0_ps, dt_ps: *dt_ps }
    }
}
