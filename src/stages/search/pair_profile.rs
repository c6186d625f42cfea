//! Profiles in which hidden patches are searched for, and the light in them that is known.

use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;

use super::{Context, Fields, Open, sparse};
use crate::cancel::Cancel;
use crate::geometry::{Point, faint};
use crate::priors::calibration::{self, Calibrated};
use crate::priors::campaign_fields::Medium;
use crate::priors::flight_profile::FlightProfile;
use crate::priors::sensor_range::{OfSensorRange, SensorRange};
use crate::signal::response::Response;
use crate::signal::sparse::Given;
use crate::stages::stage::{Rejection, StageError};
use crate::tables::{Impulse, Profile};
use crate::units::PatchId;

/// Scores in the full width of a response.
const STEPS: f64 = 12.0;
/// A calibrated response may be wrong by this share of its value near by, and by this share of its height: under strong
/// pulses that is more than noise.
const WRONG_NEAR: f64 = 0.2;
const WRONG_ANYWHERE: f64 = 5e-4;
/// So long after its end too, in widths.
const TAIL_WIDTHS: f64 = 4.0;
/// The width of impulses as strong as that, in standard deviations of their amplitude, is taken as open.
const STRONG: f64 = 30.0;

/// A profile of two patches in known places; its times are those of the way between them, over hidden places.
pub(super) struct PairProfile {
    pub(super) lit: PatchId,
    pub(super) seen: PatchId,
    pub(super) shots: i32,
    pub(super) acquired_at: Option<String>,
    pub(super) response: Response,
    /// Laser and sensor.
    pub(super) stations: [Point; 2],
    pub(super) sensor: SensorRange,
    /// Standard deviation of its delay.
    delay_sd_ps: f64,
    /// Times begin when light leaves the lit patch, and the way from the seen one to the sensor is taken off.
    flight: FlightProfile,
    medium: Medium,
    /// Share of the light that attenuators leave.
    transmission: f64,
    /// Impulses that were fitted, by the same time.
    fitted: Vec<Given>,
    /// Root mean square of the scores that known light too weak to be fitted makes.
    weak_score: f64,
}

impl Context {
    /// All profiles between patches in known places that can be searched; why others cannot.
    pub(super) fn pairs(
        &self,
        points: &BTreeMap<PatchId, Point>,
    ) -> Result<(Vec<PairProfile>, Vec<Rejection>), StageError> {
        let ready: Vec<_> =
            self.profiles.par_iter().filter_map(|profile| Some((profile, self.pair(profile, points)?))).collect();
        let (mut pairs, mut rejections) = (Vec::new(), Vec::new());
        for (profile, pair) in ready {
            match pair? {
                Ok(pair) => pairs.push(pair),
                Err(why) => {
                    let Profile { sensor, lit, seen, .. } = profile;
                    let text = format!("profile of sensor {sensor}, lit {lit}, seen {seen}, {why}");
                    rejections.push(Rejection::new(&profile.campaign, text));
                }
            }
        }
        Ok((pairs, rejections))
    }

    /// `None` where a patch has no place.
    fn pair(
        &self,
        profile: &Profile,
        points: &BTreeMap<PatchId, Point>,
    ) -> Option<Result<Result<PairProfile, String>, StageError>> {
        let (lit, seen) = (*points.get(&profile.lit)?, *points.get(&profile.seen)?);
        let stations = &self.fields.of(&profile.campaign).stations;
        let stations = [stations.source(), stations.sensor(&profile.sensor)?];
        let legs_m = (lit - stations[0]).norm() + (seen - stations[1]).norm();
        let Some(calibrated) = self.sensors.of(profile) else {
            let (sensor, campaign) = (&profile.sensor, &profile.campaign);
            let text = format!(
                "sensor `{sensor}` of campaign `{campaign}` is not calibrated: capture its response, or import a calibration"
            );
            return Some(Err(StageError::Refused(text)));
        };
        Some(Ok(self.ready(profile, calibrated, stations, legs_m)))
    }

    /// A profile made ready, or why it cannot be searched. `legs_m`: from the laser to the lit patch, and from the seen
    /// one to the sensor.
    fn ready(
        &self,
        profile: &Profile,
        (key, sensor): (&SensorRange, &Calibrated),
        stations: [Point; 2],
        legs_m: f64,
    ) -> Result<PairProfile, String> {
        let Fields { medium, repetition_ps, .. } = self.fields.of(&profile.campaign);
        if profile.counts.is_some() {
            return Err("holds photon counts, whose noise is not normal; they are not searched for hidden patches yet"
                .to_owned());
        }
        let length_ps = profile.dt_ps * profile.samples() as f64;
        if repetition_ps.is_some_and(|period_ps| period_ps < length_ps * (1.0 + 1e-6)) {
            return Err(
                "wraps around the laser's period; such records are not searched for hidden patches yet".to_owned()
            );
        }
        // Away from impulses the noise is that before the pulse. The profile's own noise comes from a model in level
        // and slope of a mean that is noise there: it grows with the sample, which costs a quarter of the information
        // on weak light.
        let quiet_v = calibration::noise_v(profile);
        let own_v = calibration::sd_v(profile);
        let sd_v = own_v.iter().map(|sd| if sd.is_finite() { quiet_v } else { *sd }).collect();
        let mut flight = FlightProfile::new(profile, (key, sensor), &self.sessions, *repetition_ps, sd_v)?;
        let (response, impulses) = (sensor.averaged(profile), self.impulses(profile));
        for impulse in impulses {
            add_misfit(&mut flight, &own_v, &response, impulse);
        }
        let (delay_ps, delay_sd_ps) = self.delays.delay_ps(profile, profile.acquired_at.as_deref());
        let legs_ps = medium.time_ps(legs_m) + delay_ps;
        flight.t0_ps -= legs_ps;
        Ok(PairProfile {
            lit: profile.lit,
            seen: profile.seen,
            shots: profile.shots,
            acquired_at: profile.acquired_at.as_deref().map(str::to_owned),
            response,
            stations,
            sensor: profile.sensor_range(),
            delay_sd_ps,
            flight,
            medium: *medium,
            transmission: 10_f64.powf(-profile.attenuation_od.unwrap_or(0.0)),
            fitted: impulses.iter().map(|impulse| given(impulse, legs_ps)).collect(),
            weak_score: 0.0,
        })
    }

    /// Impulses of a profile, or of the reciprocal one with which it was explained.
    fn impulses(&self, profile: &Profile) -> &[Impulse] {
        let of = |lit: PatchId, seen: PatchId| {
            let is_it = |row: &&crate::tables::Stir| row.ids() == profile.ids() && (row.lit, row.seen) == (lit, seen);
            self.stir.iter().find(is_it).map_or(&[][..], |row| &row.impulses)
        };
        let own = of(profile.lit, profile.seen);
        if own.is_empty() { of(profile.seen, profile.lit) } else { own }
    }
}

/// Gives the samples under an impulse their own noise, and adds what an error of the response leaves there.
fn add_misfit(flight: &mut FlightProfile, own_v: &[f64], response: &Response, impulse: &Impulse) {
    let FlightProfile { sd_v, t0_ps, dt_ps, .. } = flight;
    let (t0_ps, dt_ps) = (*t0_ps, *dt_ps);
    let half_ps = 0.5 * response.width_ps();
    let reach = response.reach(impulse.time_ps, t0_ps, dt_ps, sd_v.len());
    // Its tail goes on where the response is cut off.
    let end = (reach.end + (TAIL_WIDTHS * response.width_ps() / dt_ps) as usize).min(sd_v.len());
    for n in reach.start..end {
        let after_ps = t0_ps + n as f64 * dt_ps - impulse.time_ps;
        let near = [-half_ps, 0.0, half_ps].map(|off_ps| response.value(after_ps + off_ps).abs());
        let share = WRONG_NEAR * near.into_iter().fold(0.0, f64::max) + WRONG_ANYWHERE;
        sd_v[n] = sd_v[n].max(own_v[n]).hypot(share * impulse.amplitude_v);
    }
}

fn given(impulse: &Impulse, legs_ps: f64) -> Given {
    let is_strong = impulse.amplitude_v.abs() > STRONG * impulse.amplitude_sd_v;
    let open = if is_strong { Open::Width } else { Open::Time };
    Given { time_ps: impulse.time_ps - legs_ps, width_ps: impulse.width_ps, open }
}

impl PairProfile {
    fn end_ps(&self) -> f64 {
        let FlightProfile { mean_v, t0_ps, dt_ps, .. } = &self.flight;
        t0_ps + dt_ps * (mean_v.len() as f64 - 1.0) - self.response.peak_ps()
    }

    /// Standard deviation of its delay, as a length.
    pub(super) fn delay_sd_m(&self) -> f64 {
        self.medium.path_m(self.delay_sd_ps)
    }

    /// Scores of one more pulse by the length of its way over a hidden place.
    pub(super) fn scores(
        &self,
        visible: &[PatchId],
        given: &[Given],
        spread_ps: f64,
        cancel: &Cancel,
    ) -> faint::Profile {
        let step_ps = self.response.width_ps() / STEPS;
        let count = (self.end_ps() / step_ps).max(0.0) as usize;
        let times_ps = (0..count).map(|k| k as f64 * step_ps);
        let matched = sparse::matched(&self.flight.view(), &self.response, given, spread_ps, times_ps, cancel);
        let place = |patch| visible.binary_search(&patch).expect("the patches of a pair are visible");
        faint::Profile {
            foci: [place(self.lit), place(self.seen)],
            low_m: 0.0,
            step_m: self.medium.path_m(step_ps),
            scores: matched.scores,
            gains: matched.gains.into_iter().map(|gain| gain * self.transmission).collect(),
        }
    }
}

/// Which light over patches in place there may be.
pub(super) struct Light<'a> {
    visible: &'a [PatchId],
    /// Pairs of visible patches that exchange no light: captured, and nothing came straight from one to the other.
    closed: BTreeSet<(PatchId, PatchId)>,
}

impl<'a> Light<'a> {
    pub(super) fn new(context: &Context, pairs: &[PairProfile], visible: &'a [PatchId]) -> Self {
        let pair = |a: PatchId, b: PatchId| (a.min(b), a.max(b));
        let paths =
            context.labels.iter().filter(|label| label.alternative == 0).filter_map(|label| label.path.as_ref());
        let open: BTreeSet<_> = paths.flat_map(|path| path.windows(2).map(|legs| pair(legs[0], legs[1]))).collect();
        let captured = pairs.iter().map(|profile| pair(profile.lit, profile.seen));
        Self { visible, closed: captured.filter(|pair| !open.contains(pair)).collect() }
    }

    fn is_open(&self, a: PatchId, b: PatchId) -> bool {
        a != b && !self.closed.contains(&(a.min(b), a.max(b)))
    }

    /// What is known of a pair's light: impulses, and third bounces over patches in place.
    pub(super) fn given(&self, pair: &PairProfile, points: &BTreeMap<PatchId, Point>) -> Vec<Given> {
        let mut given = pair.fitted.clone();
        for (patch, point) in points {
            if !(self.is_open(pair.lit, *patch) && self.is_open(*patch, pair.seen)) {
                continue;
            }
            let way_m = (point - points[&pair.lit]).norm() + (point - points[&pair.seen]).norm();
            let time_ps = pair.medium.time_ps(way_m);
            // A hidden patch in place is as strong as it likes.
            let is_visible = self.visible.binary_search(patch).is_ok();
            let open = if is_visible { Open::Score(pair.weak_score) } else { Open::Amplitude };
            if time_ps < pair.end_ps() {
                given.push(Given { time_ps, width_ps: 0.0, open });
            }
        }
        given
    }

    /// Learns how strong third bounces over visible patches are, where they were not fitted: noise alone makes scores
    /// of 1 in the root mean square.
    pub(super) fn learn(&self, pairs: &mut [PairProfile], points: &BTreeMap<PatchId, Point>, cancel: &Cancel) {
        let scores = |pair: &PairProfile| {
            let weak = self.given(pair, points).into_iter().filter(|light| matches!(light.open, Open::Score(_)));
            let times_ps = weak.map(|light| light.time_ps);
            let matched = sparse::matched(&pair.flight.view(), &pair.response, &pair.fitted, 0.0, times_ps, cancel);
            let measured = matched.scores.into_iter().zip(matched.gains).filter(|(_, gain)| *gain > 0.0);
            measured.map(|(score, _)| score).collect::<Vec<f64>>()
        };
        let scores: Vec<f64> = pairs.par_iter().map(scores).collect::<Vec<_>>().concat();
        if scores.is_empty() {
            return;
        }
        let count = scores.len() as f64;
        let mean_square = scores.iter().map(|score| score * score).sum::<f64>() / count;
        // No less than what two standard errors leave open.
        let weak_score = (mean_square - 1.0 + 2.0 * (2.0 / count).sqrt()).max(0.0).sqrt();
        pairs.iter_mut().for_each(|pair| pair.weak_score = weak_score);
    }
}
