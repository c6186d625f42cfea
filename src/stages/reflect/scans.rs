//! Onsets as scans of a mirror, with their context.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Matrix3, Vector3};
use serde::Serialize;

use crate::campaign::Campaign;
use crate::campaign::keys::{self, LASER, PatchRole};
use crate::cancel::Cancel;
use crate::geometry::maximum_likelihood::Station;
use crate::geometry::mirror::{Arrival, Experiment, Scan};
use crate::geometry::{Matrix, Point};
use crate::priors::campaign_fields::{ByCampaign, Medium, PatchPrior, StationPriors};
use crate::priors::covariances;
use crate::priors::delays::Latencies;
use crate::priors::sensor_range::SensorRange;
use crate::tables::{Name, Onset, Patch};
use crate::units::PatchId;

/// Standard deviation of what campaign.toml gives as exact, as far as numbers go.
const EXACT_M: f64 = 1e-6;
const EXACT_RAD: f64 = 1e-6;
/// Share of the laser's period by which errors may make a path shorter than the straight one.
const GRACE: f64 = 0.05;

/// What campaign.toml says that paths over a mirror depend on.
#[derive(Clone, Debug, Serialize)]
pub struct Fields {
    dimensions: u8,
    #[serde(flatten)]
    medium: Medium,
    repetition_ps: Option<f64>,
    #[serde(flatten)]
    stations: StationPriors,
    pub patches: BTreeMap<PatchId, PatchPrior>,
}

impl From<&Campaign> for Fields {
    fn from(campaign: &Campaign) -> Self {
        Self {
            dimensions: campaign.dimensions,
            medium: campaign.into(),
            repetition_ps: campaign.repetition_ps,
            stations: campaign.into(),
            patches: PatchPrior::of_all(campaign),
        }
    }
}

impl Fields {
    /// Whether both are of one scene.
    pub fn is_of_scene(&self, other: &Self) -> bool {
        (self.dimensions, &self.patches) == (other.dimensions, &other.patches)
            && self.stations.has_stations_of(&other.stations)
    }

    fn is_mirror(&self, patch: PatchId) -> bool {
        self.patches.get(&patch).is_some_and(|prior| prior.role == PatchRole::Mirror)
    }
}

/// Campaigns, positions of diffuser points, and priors of the delays.
pub struct Context {
    pub fields: ByCampaign<Fields>,
    /// Positions that campaign.toml or an earlier stage gives, with their covariances in m^2.
    positions: BTreeMap<PatchId, (Point, Matrix3<f64>)>,
    latencies: Latencies,
    cancel: Cancel,
}

impl Context {
    pub fn new(fields: ByCampaign<Fields>, patches: &[Patch], latencies: Latencies, cancel: Cancel) -> Self {
        let scene = scene(&fields);
        // In flatland nothing leaves the plane.
        let axes = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, if scene.dimensions == 2 { 0.0 } else { 1.0 }));
        let anchor = |(patch, prior): (&PatchId, &PatchPrior)| {
            let sd_m = prior.sd_m.unwrap_or(0.0).max(EXACT_M);
            Some((*patch, (Point::from(prior.position_m?), axes * (sd_m * sd_m))))
        };
        let estimate = |row: &Patch| {
            let covariance_m2 = covariances::of_patch(row)? + axes * (EXACT_M * EXACT_M);
            Some((row.patch, (Point::new(row.x_m, row.y_m, row.z_m), covariance_m2)))
        };
        // An earlier stage has used what campaign.toml says.
        let estimates = patches.iter().filter(|row| row.alternative == 0).filter_map(estimate);
        let positions = scene.patches.iter().filter_map(anchor).chain(estimates).collect();
        Self { fields, positions, latencies, cancel }
    }

    fn of(&self, onset: &Onset) -> &Fields {
        self.fields.of(&onset.campaign)
    }

    /// Prior covariance of delays, as lengths.
    fn delay_covariance_m2(&self, delays: &[&SensorRange]) -> Matrix {
        let length_m = |delay: &SensorRange| self.fields.of(&delay.campaign).medium.path_m(1.0);
        Matrix::from_fn(delays.len(), delays.len(), |i, k| {
            let (a, b) = (delays[i], delays[k]);
            length_m(a) * length_m(b) * self.latencies.covariance_ps2(a, b)
        })
    }
}

/// What all campaigns share.
fn scene(fields: &ByCampaign<Fields>) -> &Fields {
    fields.first().expect("a run has a campaign")
}

/// Scans that can be used.
pub struct Scans {
    /// Mirror point and diffuser point of each.
    pub patches: Vec<(PatchId, PatchId)>,
    pub experiment: Experiment,
}

impl Scans {
    /// Of all onsets, and why scans are left out.
    pub fn new(context: &Context, onsets: &[Onset]) -> (Self, Vec<String>) {
        let scene = scene(&context.fields);
        let station = |(_, station): (_, &keys::Station)| Station {
            position: Point::from(station.position_m),
            sd_m: station.sd_m.unwrap_or(0.0),
        };
        let names: Vec<&str> = scene.stations.laser_first().map(|(name, _)| name).collect();
        let mut scans = Self {
            patches: Vec::new(),
            experiment: Experiment {
                dimensions: usize::from(scene.dimensions),
                stations: scene.stations.laser_first().map(station).collect(),
                scans: Vec::new(),
                delay_covariance_m2: Matrix::zeros(0, 0),
                cancel: context.cancel.clone(),
            },
        };
        let used: Vec<Result<Used, String>> = scene
            .patches
            .keys()
            .filter(|patch| scene.is_mirror(**patch))
            .map(|&mirror| Used::new(context, scene, mirror, onsets))
            .collect();
        let used_onsets = used.iter().flatten().flat_map(|used| &used.onsets);
        let delays: BTreeSet<&SensorRange> =
            used_onsets.filter_map(|onset| context.latencies.delay_of(*onset)).collect();
        let delays: Vec<&SensorRange> = delays.into_iter().collect();
        let mut reasons = Vec::new();
        for used in used {
            match used {
                Err(reason) => reasons.push(reason),
                Ok(used) if scans.patches.iter().any(|(_, diffuser)| *diffuser == used.diffuser) => reasons.push(format!(
                    "mirror point {} shows in diffuser point {}, like another before it; give each place where a beam lands a patch of its own",
                    used.mirror, used.diffuser
                )),
                Ok(used) => {
                    let stations = &scans.experiment.stations;
                    let arrivals = used.onsets.iter().map(|onset| {
                        let at = context.of(onset).stations.of_sensor(&onset.sensor);
                        let sensor = names.iter().position(|name| *name == at);
                        let sensor = sensor.expect("checked: a sensor's station is there");
                        let delay = context.latencies.delay_of(*onset);
                        let delay = delay.and_then(|delay| delays.binary_search(&delay).ok());
                        used.arrival(context.of(onset), onset, stations, sensor, delay)
                    });
                    let scan = Scan {
                        direction: used.direction,
                        direction_sd_rad: used.direction_sd_rad,
                        diffuser: used.position.0,
                        diffuser_covariance_m2: used.position.1,
                        arrivals: arrivals.collect(),
                    };
                    scans.patches.push((used.mirror, used.diffuser));
                    scans.experiment.scans.push(scan);
                }
            }
        }
        scans.experiment.delay_covariance_m2 = context.delay_covariance_m2(&delays);
        (scans, reasons)
    }
}

/// One mirror point with the light that measures it.
struct Used<'a> {
    mirror: PatchId,
    diffuser: PatchId,
    direction: Vector3<f64>,
    direction_sd_rad: f64,
    position: (Point, Matrix3<f64>),
    /// One of each campaign and sensor.
    onsets: Vec<&'a Onset>,
}

impl<'a> Used<'a> {
    /// Or why it cannot be used.
    fn new(context: &Context, scene: &Fields, mirror: PatchId, onsets: &'a [Onset]) -> Result<Self, String> {
        let ray = scene.patches[&mirror].ray.as_ref().filter(|ray| ray.from == LASER).ok_or_else(|| {
            format!(
                "mirror point {mirror} has no ray from the laser; give patches.{mirror} the beam's direction in campaign.toml: ray = {{ from = \"laser\", direction = [x, y, z], \
                 sd_rad = 0.001 }}"
            )
        })?;
        let lit = || onsets.iter().filter(|onset| onset.lit == mirror && !scene.is_mirror(onset.seen));
        let strongest = lit().max_by(|a, b| a.amplitude.total_cmp(&b.amplitude)).ok_or_else(|| {
            format!(
                "mirror point {mirror} has no onset; capture it lit, with the point of the diffuser seen where the reflected beam lands"
            )
        })?;
        let diffuser = strongest.seen;
        let position = *context.positions.get(&diffuser).ok_or_else(|| {
            format!(
                "diffuser point {diffuser}, where the beam over mirror point {mirror} lands, has no known position; give patches.{diffuser} `position_m` and `sd_m` in campaign.toml, \
                 or `patches` from an earlier stage (`with`)"
            )
        })?;
        let mut of_sensor: BTreeMap<(&Name, &Name), &Onset> = BTreeMap::new();
        for onset in lit().filter(|onset| onset.seen == diffuser) {
            let best = of_sensor.entry((&onset.campaign, &onset.sensor)).or_insert(onset);
            if onset.amplitude > best.amplitude {
                *best = onset;
            }
        }
        Ok(Self {
            mirror,
            diffuser,
            direction: Vector3::from(ray.direction).normalize(),
            direction_sd_rad: ray.sd_rad.unwrap_or(0.0).max(EXACT_RAD),
            position,
            onsets: of_sensor.into_values().collect(),
        })
    }

    fn arrival(
        &self,
        fields: &Fields,
        onset: &Onset,
        stations: &[Station],
        sensor: usize,
        delay: Option<usize>,
    ) -> Arrival {
        let length_m = |time_ps: f64| fields.medium.path_m(time_ps);
        let diffuser = self.position.0;
        let straight_m = (diffuser - stations[0].position).norm() + (stations[sensor].position - diffuser).norm();
        let period_m = fields.repetition_ps.map(length_m);
        let measured_m = length_m(onset.time_ps);
        let turns = period_m.map_or(0.0, |period_m| ((straight_m - measured_m) / period_m - GRACE).ceil());
        Arrival {
            sensor,
            length_m: measured_m + turns * period_m.unwrap_or(0.0),
            sd_m: length_m(onset.time_sd_ps.hypot(onset.jitter_ps)).max(EXACT_M),
            delay,
        }
    }
}
