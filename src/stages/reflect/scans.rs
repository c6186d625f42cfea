//! Onsets as scans of a mirror, with what is known beforehand.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Matrix3, Vector3};
use serde::Serialize;

use crate::campaign::Campaign;
use crate::campaign::keys::{self, LASER, PatchRole};
use crate::cancel::Cancel;
use crate::geometry::maximum_likelihood::Station;
use crate::geometry::mirror::{Arrival, Experiment, Scan};
use crate::geometry::{Matrix, Point};
use crate::priors::covariances;
use crate::priors::delays::{DelayKey, Latencies};
use crate::tables::{Name, Onset, Patch};
use crate::units::{self, PatchId};

/// Standard deviation of what campaign.toml gives as exact, as far as numbers go.
const EXACT_M: f64 = 1e-6;
const EXACT_RAD: f64 = 1e-6;
/// Share of the laser's period by which errors may make a path shorter than the straight one.
const GRACE: f64 = 0.05;

/// What a campaign says that paths over a mirror depend on.
#[derive(Clone, Debug, Serialize)]
pub struct Setup {
    pub dimensions: u8,
    pub group_index: f64,
    pub repetition_ps: Option<f64>,
    pub stations: BTreeMap<String, keys::Station>,
    /// Station of each sensor.
    pub sensors: BTreeMap<String, String>,
    pub patches: BTreeMap<PatchId, keys::Patch>,
}

impl Setup {
    pub fn new(campaign: &Campaign) -> Self {
        // What is written for people, and footprints, change nothing here.
        let silent = |(id, patch): (&PatchId, &keys::Patch)| {
            (*id, keys::Patch { label: None, size_m: None, normal: None, ..patch.clone() })
        };
        let station = |sensor: &keys::Sensor| sensor.station.clone().unwrap_or_else(|| LASER.to_owned());
        Self {
            dimensions: campaign.dimensions,
            group_index: campaign.group_index,
            repetition_ps: campaign.repetition_ps,
            stations: campaign.stations.clone(),
            sensors: campaign.sensors.iter().map(|(name, sensor)| (name.clone(), station(sensor))).collect(),
            patches: campaign.patches.iter().map(silent).collect(),
        }
    }

    /// Whether both set-ups are of one scene.
    pub fn is_of_scene(&self, other: &Self) -> bool {
        (self.dimensions, &self.stations, &self.patches) == (other.dimensions, &other.stations, &other.patches)
    }

    fn is_mirror(&self, patch: PatchId) -> bool {
        self.patches.get(&patch).is_some_and(|known| known.role == PatchRole::Mirror)
    }
}

/// What is known beforehand.
pub struct Known {
    /// By campaign.
    pub setups: BTreeMap<String, Setup>,
    /// Positions that campaign.toml or an earlier stage gives.
    positions: BTreeMap<PatchId, (Point, Matrix3<f64>)>,
    latencies: Latencies,
    cancel: Cancel,
}

impl Known {
    pub fn new(setups: BTreeMap<String, Setup>, patches: &[Patch], latencies: Latencies, cancel: Cancel) -> Self {
        let scene = setups.values().next().expect("a run has a campaign");
        // In flatland nothing leaves the plane.
        let axes = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, if scene.dimensions == 2 { 0.0 } else { 1.0 }));
        let given = |(patch, known): (&PatchId, &keys::Patch)| {
            let sd_m = known.sd_m.unwrap_or(0.0).max(EXACT_M);
            Some((*patch, (Point::from(known.position_m?), axes * (sd_m * sd_m))))
        };
        let found = |row: &Patch| {
            let covariance_m2 = covariances::of_patch(row)? + axes * (EXACT_M * EXACT_M);
            Some((row.patch, (Point::new(row.x_m, row.y_m, row.z_m), covariance_m2)))
        };
        // An earlier stage has used what campaign.toml says.
        let found = patches.iter().filter(|row| row.alternative == 0).filter_map(found);
        let positions = scene.patches.iter().filter_map(given).chain(found).collect();
        Self { setups, positions, latencies, cancel }
    }

    /// What all campaigns share.
    pub fn scene(&self) -> &Setup {
        self.setups.values().next().expect("a run has a campaign")
    }

    fn setup(&self, onset: &Onset) -> &Setup {
        &self.setups[&*onset.campaign]
    }

    fn delay_of(&self, onset: &Onset) -> Option<DelayKey> {
        self.latencies.delay_of(&onset.campaign, &onset.sensor, onset.range.as_ref())
    }

    /// Prior covariance of delays, as lengths.
    fn delay_covariance_m2(&self, delays: &[DelayKey]) -> Matrix {
        let length_m = |delay: &DelayKey| units::path_m(1.0, self.setups[&*delay.0].group_index);
        Matrix::from_fn(delays.len(), delays.len(), |i, k| {
            let (a, b) = (&delays[i], &delays[k]);
            length_m(a) * length_m(b) * self.latencies.covariance_ps2(a, b)
        })
    }
}

/// Scans that can be used.
pub struct Scans {
    /// Mirror point and diffuser point of each.
    pub patches: Vec<(PatchId, PatchId)>,
    pub experiment: Experiment,
}

impl Scans {
    /// Of all onsets, and why scans are left out.
    pub fn new(known: &Known, onsets: &[Onset]) -> (Self, Vec<String>) {
        let setup = known.scene();
        let others = setup.stations.keys().map(String::as_str).filter(|name| *name != LASER);
        let names: Vec<&str> = std::iter::once(LASER).chain(others).collect();
        let station = |name: &&str| {
            let station = &setup.stations[*name];
            Station { position: Point::from(station.position_m), sd_m: station.sd_m.unwrap_or(0.0) }
        };
        let mut scans = Self {
            patches: Vec::new(),
            experiment: Experiment {
                dimensions: usize::from(setup.dimensions),
                stations: names.iter().map(station).collect(),
                scans: Vec::new(),
                delay_covariance_m2: Matrix::zeros(0, 0),
                cancel: known.cancel.clone(),
            },
        };
        let used: Vec<Result<Used, String>> = setup
            .patches
            .keys()
            .filter(|patch| setup.is_mirror(**patch))
            .map(|&mirror| Used::new(known, setup, mirror, onsets))
            .collect();
        let delays: BTreeSet<DelayKey> =
            used.iter().flatten().flat_map(|used| &used.onsets).filter_map(|onset| known.delay_of(onset)).collect();
        let delays: Vec<DelayKey> = delays.into_iter().collect();
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
                        let sensor = names.iter().position(|name| *name == known.setup(onset).sensors[&*onset.sensor]);
                        let sensor = sensor.expect("checked: a sensor's station is there");
                        let delay = known.delay_of(onset).and_then(|delay| delays.binary_search(&delay).ok());
                        used.arrival(known.setup(onset), onset, stations, sensor, delay)
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
        scans.experiment.delay_covariance_m2 = known.delay_covariance_m2(&delays);
        (scans, reasons)
    }
}

/// One mirror point with the light that tells it.
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
    fn new(known: &Known, setup: &Setup, mirror: PatchId, onsets: &'a [Onset]) -> Result<Self, String> {
        let ray = setup.patches[&mirror].ray.as_ref().filter(|ray| ray.from == LASER).ok_or_else(|| {
            format!(
                "mirror point {mirror} has no ray from the laser; give patches.{mirror} the beam's direction in campaign.toml: ray = {{ from = \"laser\", direction = [x, y, z], \
                 sd_rad = 0.001 }}"
            )
        })?;
        let lit = || onsets.iter().filter(|onset| onset.lit == mirror && !setup.is_mirror(onset.seen));
        let strongest = lit().max_by(|a, b| a.amplitude.total_cmp(&b.amplitude)).ok_or_else(|| {
            format!(
                "mirror point {mirror} has no onset; capture it lit, with the point of the diffuser seen where the reflected beam lands"
            )
        })?;
        let diffuser = strongest.seen;
        let position = *known.positions.get(&diffuser).ok_or_else(|| {
            format!(
                "diffuser point {diffuser}, where the beam over mirror point {mirror} lands, has no known position; give patches.{diffuser} `position_m` and `sd_m` in campaign.toml, \
                 or `patches` of an earlier stage beside"
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
        setup: &Setup,
        onset: &Onset,
        stations: &[Station],
        sensor: usize,
        delay: Option<usize>,
    ) -> Arrival {
        let length_m = |time_ps: f64| units::path_m(time_ps, setup.group_index);
        let diffuser = self.position.0;
        let straight_m = (diffuser - stations[0].position).norm() + (stations[sensor].position - diffuser).norm();
        let period_m = setup.repetition_ps.map(length_m);
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
