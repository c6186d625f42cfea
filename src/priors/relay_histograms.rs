//! The light of each capture of a relay wall over the time from its lit point to its seen point, and the gate that cuts
//! off the wall's own.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde::Serialize;

use super::calibration::{Calibrated, Sensors};
use super::campaign_fields::{Medium, StationPositions};
use super::sensor_range::SensorRange;
use crate::campaign::{Campaign, keys};
use crate::cancel::Cancel;
use crate::geometry::Point;
use crate::geometry::joint::{Noise, Pulse, WallSum};
use crate::signal::image::foreground;
use crate::signal::image::gate::gate;
use crate::signal::response::Response;
use crate::tables::{Name, Profile, Samples};
use crate::units::PatchId;

/// Relative difference of bins that count as equally wide.
const SAME: f64 = 1e-6;

/// What campaign.toml says of light on its way over a wall.
#[derive(Clone, Debug, Serialize)]
pub struct Fields {
    /// What light travels in.
    #[serde(flatten)]
    pub medium: Medium,
    /// Where laser and sensors stand.
    #[serde(flatten)]
    pub stations: StationPositions,
    /// Gates of sensors that have one, by sensor.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    gates_ps: BTreeMap<String, f64>,
}

impl From<&Campaign> for Fields {
    fn from(campaign: &Campaign) -> Self {
        let gate = |(name, sensor): (&String, &keys::Sensor)| Some((name.clone(), sensor.gate_ps?));
        Self {
            medium: campaign.into(),
            stations: campaign.into(),
            gates_ps: campaign.sensors.iter().filter_map(gate).collect(),
        }
    }
}

/// What a sensor recorded.
enum Light {
    /// Photons in each bin.
    Counts(Vec<i32>),
    /// Mean and standard error of each sample, turned upwards by the sign, and the autocorrelation of the noise.
    Volts { mean_v: Samples, se_v: Samples, sign: f64, acf: Samples },
}

/// The profile of one capture, of a calibrated sensor.
pub struct Waveform {
    campaign: Name,
    sensor: Name,
    lit: PatchId,
    seen: PatchId,
    /// Time of the first bin from the laser to the sensor.
    first_ps: f64,
    dt_ps: f64,
    /// What averaging leaves of the sensor's response, with the arrival of light at 0.
    response: Arc<Response>,
    width_ps: f64,
    light: Light,
}

/// The profiles of the scene.
#[derive(Default)]
pub struct Waveforms {
    /// Those of calibrated sensors.
    pub calibrated: Vec<Waveform>,
    /// How many have no calibration.
    pub uncalibrated: usize,
}

impl Waveforms {
    /// From the rows of `profiles`, in batches: those of other roles are left out, and no batch is kept.
    ///
    /// # Errors
    /// That of the first batch with one.
    pub fn new<E>(batches: impl Iterator<Item = Result<Vec<Profile>, E>>, sensors: &Sensors) -> Result<Self, E> {
        let (mut waveforms, mut responses) = (Self::default(), Responses::default());
        for batch in batches {
            for profile in batch?.into_iter().filter(|profile| &*profile.role == "scene") {
                match sensors.of(&profile) {
                    Some((key, sensor)) => {
                        let response = responses.of(key, sensor, &profile);
                        waveforms.calibrated.push(Waveform::new(profile, sensor, response));
                    }
                    None => waveforms.uncalibrated += 1,
                }
            }
        }
        Ok(waveforms)
    }
}

/// The averaged response of the last profile. Thousands of captures share it, and a copy for each would take more
/// memory than their counts.
#[derive(Default)]
struct Responses(Option<(Alike, Arc<Response>)>);

/// On what an averaged response depends: sensor and range, width of a bin, shots at each phase.
type Alike = (SensorRange, f64, Option<Vec<i32>>);

impl Responses {
    fn of(&mut self, key: &SensorRange, sensor: &Calibrated, profile: &Profile) -> Arc<Response> {
        let is_same = |(of, dt_ps, phase_shots): &Alike| {
            of == key && *dt_ps == profile.dt_ps && *phase_shots == profile.phase_shots
        };
        match &self.0 {
            Some((alike, response)) if is_same(alike) => Arc::clone(response),
            _ => {
                let response = Arc::new(sensor.averaged(profile));
                let alike = (key.clone(), profile.dt_ps, profile.phase_shots.clone());
                self.0 = Some((alike, Arc::clone(&response)));
                response
            }
        }
    }
}

impl Waveform {
    fn new(mut profile: Profile, sensor: &Calibrated, response: Arc<Response>) -> Self {
        let light = match profile.counts.take() {
            Some(counts) => Light::Counts(counts),
            None => Light::Volts {
                mean_v: profile.mean_v(),
                se_v: profile.se_v(),
                sign: sensor.polarity,
                acf: profile.noise_acf,
            },
        };
        Self {
            campaign: profile.campaign,
            sensor: profile.sensor,
            lit: profile.lit,
            seen: profile.seen,
            first_ps: profile.t0_ps - sensor.latency_ps,
            dt_ps: profile.dt_ps,
            width_ps: response.width_ps(),
            response,
            light,
        }
    }

    fn bins(&self) -> usize {
        match &self.light {
            Light::Counts(counts) => counts.len(),
            Light::Volts { mean_v, .. } => mean_v.len(),
        }
    }
}

/// A waveform whose points have places.
pub struct Histogram<'a> {
    /// Place of the lit patch.
    pub lit: Point,
    /// Place of the seen patch.
    pub seen: Point,
    /// Time of the first bin from the lit point to the seen point.
    pub first_ps: f64,
    /// The sensor's gate, where campaign.toml gives one.
    gate_ps: Option<f64>,
    waveform: &'a Waveform,
}

impl<'a> Histogram<'a> {
    /// `None` where a patch or the sensor has no place.
    pub fn new<'f>(
        waveform: &'a Waveform,
        points: &BTreeMap<PatchId, Point>,
        fields: impl Fn(&str) -> Option<&'f Fields>,
    ) -> Option<Self> {
        let fields = fields(&waveform.campaign)?;
        let (lit, seen) = (*points.get(&waveform.lit)?, *points.get(&waveform.seen)?);
        let legs_m =
            (lit - fields.stations.source()).norm() + (fields.stations.sensor(&waveform.sensor)? - seen).norm();
        let gate_ps = fields.gates_ps.get(&*waveform.sensor).copied();
        Some(Self { lit, seen, first_ps: waveform.first_ps - fields.medium.time_ps(legs_m), gate_ps, waveform })
    }

    /// The lit and the seen patch.
    pub fn pair(&self) -> [PatchId; 2] {
        [self.waveform.lit, self.waveform.seen]
    }

    /// Width of a bin.
    pub fn dt_ps(&self) -> f64 {
        self.waveform.dt_ps
    }

    /// Full width at half maximum of the response.
    pub fn width_ps(&self) -> f64 {
        self.waveform.width_ps
    }

    /// The sensor's response.
    pub fn response(&self) -> &Response {
        &self.waveform.response
    }

    /// Whether laser and sensor look at one point.
    pub fn is_confocal(&self) -> bool {
        self.waveform.lit == self.waveform.seen
    }

    /// Whether these are photon counts.
    pub fn is_counts(&self) -> bool {
        matches!(self.waveform.light, Light::Counts(_))
    }

    /// Mean variance of the samples of a voltage, and the autocorrelation of its noise; `None` for counts.
    pub fn noise(&self) -> Option<(f64, Vec<f64>)> {
        let Light::Volts { se_v, acf, .. } = &self.waveform.light else { return None };
        let sum: f64 = se_v.iter().map(|se| f64::from(*se).powi(2)).sum();
        Some((sum / se_v.len().max(1) as f64, acf.to_f64()))
    }

    fn end_ps(&self) -> f64 {
        self.first_ps + self.waveform.bins() as f64 * self.dt_ps()
    }

    /// Time of the first bin behind the gate, and the values from there on.
    pub fn behind(&self, times: &Times) -> (f64, Vec<f64>) {
        let from = self.bin(times.gate_ps);
        let values = match &self.waveform.light {
            Light::Counts(counts) => counts[from..].iter().map(|count| f64::from(*count)).collect(),
            Light::Volts { mean_v, sign, .. } => mean_v[from..].iter().map(|mean| sign * f64::from(*mean)).collect(),
        };
        (self.first_ps + from as f64 * self.dt_ps(), values)
    }

    /// Variances of the same values: of photons their rate, a mean over a width of the response to either side.
    pub fn variances(&self, times: &Times, values: &[f64]) -> Vec<f64> {
        match &self.waveform.light {
            Light::Counts(_) => foreground::rate(values, (self.width_ps() / self.dt_ps()).ceil() as usize),
            Light::Volts { se_v, .. } => {
                se_v[self.bin(times.gate_ps)..].iter().map(|se| f64::from(*se).powi(2)).collect()
            }
        }
    }

    /// The first bin from this time on.
    fn bin(&self, time_ps: f64) -> usize {
        (((time_ps - self.first_ps) / self.dt_ps()).ceil().max(0.0) as usize).min(self.waveform.bins())
    }
}

/// The times over the hidden surface whose light counts.
#[derive(Clone, Copy, Debug)]
pub struct Times {
    /// From here on.
    pub gate_ps: f64,
    /// All histograms reach to here.
    pub end_ps: f64,
    /// Whether the gate was given, by a parameter or by campaign.toml.
    pub is_given: bool,
}

impl Times {
    /// The gate that is given, else the latest that campaign.toml gives, else the one that the sum of the histograms
    /// shows.
    ///
    /// # Errors
    /// In words, why there is none: histograms of different kinds, or no smooth light.
    pub fn new(histograms: &[Histogram<'_>], gate_ps: Option<f64>) -> Result<Self, String> {
        let dt_ps = histograms[0].dt_ps();
        if histograms.iter().any(|one| (one.dt_ps() - dt_ps).abs() > SAME * dt_ps) {
            return Err(
                "captures of the scene differ in the width of their bins; image each kind in a campaign of its own"
                    .to_owned(),
            );
        }
        if histograms.iter().any(|one| one.is_counts() != histograms[0].is_counts()) {
            return Err(
                "some captures of the scene count photons and some do not; image each kind in a campaign of its own"
                    .to_owned(),
            );
        }
        let start_ps = histograms.iter().map(|one| one.first_ps).fold(0.0, f64::max);
        let end_ps = histograms.iter().map(Histogram::end_ps).fold(f64::INFINITY, f64::min);
        let given_ps = gate_ps.or_else(|| histograms.iter().filter_map(|one| one.gate_ps).reduce(f64::max));
        let gate_ps = match given_ps {
            Some(gate_ps) => Some(gate_ps.max(start_ps)),
            None => find_gate(histograms, start_ps, end_ps),
        };
        let gate_ps = gate_ps.filter(|gate_ps| *gate_ps < end_ps).ok_or_else(|| {
            format!(
                "no smooth light follows that of the wall before the histograms end, {end_ps:.0} ps behind it; give `gate_ps`"
            )
        })?;
        Ok(Self { gate_ps, end_ps, is_given: given_ps.is_some() })
    }
}

/// The gate from the sum of all histograms.
fn find_gate(histograms: &[Histogram<'_>], start_ps: f64, end_ps: f64) -> Option<f64> {
    let dt_ps = histograms[0].dt_ps();
    let (sum, variance) = sum(histograms, [start_ps, end_ps]);
    let block = (histograms[0].width_ps() / dt_ps).ceil().max(1.0) as usize;
    gate(&sum, &variance, block).map(|bin| start_ps + bin as f64 * dt_ps)
}

/// Sum of all histograms between two times, and the variance of each bin.
pub fn sum(histograms: &[Histogram<'_>], [start_ps, end_ps]: [f64; 2]) -> (Vec<f64>, Vec<f64>) {
    let bins = ((end_ps - start_ps) / histograms[0].dt_ps()).max(0.0) as usize;
    let (mut counts, mut sum, mut variance) = (vec![0.0; bins], vec![0.0; bins], vec![0.0; bins]);
    for histogram in histograms {
        let from = histogram.bin(start_ps);
        match &histogram.waveform.light {
            Light::Counts(of_bins) => add(&mut counts, of_bins[from..].iter().map(|count| f64::from(*count))),
            Light::Volts { mean_v, se_v, sign, .. } => {
                add(&mut sum, mean_v[from..].iter().map(|mean| sign * f64::from(*mean)));
                add(&mut variance, se_v[from..].iter().map(|se| f64::from(*se).powi(2)));
            }
        }
    }
    // Photons vary by their number, which in the sum is large.
    add(&mut sum, counts.iter().copied());
    add(&mut variance, counts.into_iter());
    (sum, variance)
}

fn add(sums: &mut [f64], values: impl Iterator<Item = f64>) {
    sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
}

/// The response in bins of `bin_m` of the wall's own light, where the histograms of a confocal scan begin with it.
/// Unless the gate is given, it moves on to where the wall's light is no more than its tail.
pub fn first_bounce(
    histograms: &[Histogram<'_>],
    times: &mut Times,
    (medium, bin_m): (Medium, f64),
    cancel: &Cancel,
) -> Option<Pulse> {
    let first = histograms.first().filter(|_| histograms.iter().all(Histogram::is_confocal))?;
    let (dt_ps, width_ps) = (first.dt_ps(), first.width_ps());
    let start_ps = histograms.iter().map(|one| one.first_ps).fold(f64::NEG_INFINITY, f64::max);
    let (sum, variances) = sum(histograms, [start_ps, times.end_ps]);
    let variance = variances.iter().sum::<f64>() / variances.len().max(1) as f64;
    let is_counts = histograms.iter().all(Histogram::is_counts);
    let noise = if is_counts { Noise::Counts } else { Noise::Gauss { sd: variance.sqrt() } };
    let gate = ((times.gate_ps - start_ps) / dt_ps).round() as usize;
    let [first_m, step_m, width_m] = [start_ps, dt_ps, width_ps].map(|time_ps| medium.path_m(time_ps));
    let mut wall = WallSum { sum: &sum, first_m, step_m, gate, width_m, noise };
    if !times.is_given {
        wall.gate = wall.clear(cancel);
        times.gate_ps = start_ps + wall.gate as f64 * dt_ps;
    }
    wall.pulse(bin_m)
}
