//! What campaign.toml says, in the pieces that stages read.
//!
//! A stage composes its fields of these pieces, and only what is in them enters its lineage: so a piece holds no more
//! than what goes together. A stage flattens them, so that recipes and `diff` name the keys of campaign.toml.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::campaign::Campaign;
use crate::campaign::keys::{self, LASER, PatchRole, Ray};
use crate::geometry::Point;
use crate::geometry::first_return::Systematic;
use crate::units::{self, PatchId};

/// Stations closer than this are one.
pub const ONE_STATION_M: f64 = 1e-6;

/// The fields of each campaign of a run, by the campaign's name.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ByCampaign<F>(BTreeMap<String, F>);

impl<F> ByCampaign<F> {
    /// Picks the fields out of each campaign.
    pub fn new(campaigns: &[Campaign], fields: impl Fn(&Campaign) -> F) -> Self {
        Self(campaigns.iter().map(|campaign| (campaign.name.clone(), fields(campaign))).collect())
    }

    /// Those of one campaign; `None` for a campaign that is not of this run.
    pub fn get(&self, campaign: &str) -> Option<&F> {
        self.0.get(campaign)
    }

    /// Those of one campaign.
    ///
    /// # Panics
    /// When it is not of this run.
    pub fn of(&self, campaign: &str) -> &F {
        &self.0[campaign]
    }

    /// Those of the first campaign, in the order of names. Its frame holds where campaigns share a scene.
    pub fn first(&self) -> Option<&F> {
        self.0.values().next()
    }

    /// Name of the first campaign; nothing in a run without one.
    pub fn first_name(&self) -> &str {
        self.0.keys().next().map_or("", String::as_str)
    }

    /// Name and fields of the only campaign.
    ///
    /// # Errors
    /// The number of campaigns, where it is not one.
    pub fn into_only(mut self) -> Result<(String, F), usize> {
        let count = self.0.len();
        self.0.pop_first().filter(|_| count == 1).ok_or(count)
    }

    /// Of all campaigns, with their names.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &F)> {
        self.0.iter().map(|(name, fields)| (name.as_str(), fields))
    }

    /// Of all campaigns.
    pub fn values(&self) -> impl Iterator<Item = &F> {
        self.0.values()
    }
}

/// What light travels in.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Medium {
    /// Group index: path = c * time / index.
    pub group_index: f64,
}

impl From<&Campaign> for Medium {
    fn from(campaign: &Campaign) -> Self {
        Self { group_index: campaign.group_index }
    }
}

impl Medium {
    /// Length of the path that light takes in a time.
    pub fn path_m(self, time_ps: f64) -> f64 {
        units::path_m(time_ps, self.group_index)
    }

    /// Time that light takes for a path.
    pub fn time_ps(self, path_m: f64) -> f64 {
        units::time_ps(path_m, self.group_index)
    }
}

/// Where laser and sensors stand, taken as exact.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct StationPositions {
    source_m: [f64; 3],
    /// By sensor.
    sensors_m: BTreeMap<String, [f64; 3]>,
}

impl From<&Campaign> for StationPositions {
    fn from(campaign: &Campaign) -> Self {
        let position = |sensor: &String| Some((sensor.clone(), campaign.station_of(sensor)?.position_m));
        Self {
            source_m: campaign.source().position_m,
            sensors_m: campaign.sensors.keys().filter_map(position).collect(),
        }
    }
}

impl StationPositions {
    /// Where the light leaves.
    pub fn source(&self) -> Point {
        Point::from(self.source_m)
    }

    /// Where a sensor stands; `None` where campaign.toml has no such sensor.
    pub fn sensor(&self, sensor: &str) -> Option<Point> {
        self.sensors_m.get(sensor).map(|position_m| Point::from(*position_m))
    }

    /// Names of the sensors.
    pub fn sensors(&self) -> impl Iterator<Item = &str> {
        self.sensors_m.keys().map(String::as_str)
    }

    /// Whether a sensor stands where the laser is; `None` where campaign.toml has no such sensor.
    pub fn is_with_laser(&self, sensor: &str) -> Option<bool> {
        Some((self.sensor(sensor)? - self.source()).norm() <= ONE_STATION_M)
    }

    /// Whether any sensor stands where the laser is.
    pub fn is_any_with_laser(&self) -> bool {
        self.sensors().any(|sensor| self.is_with_laser(sensor) == Some(true))
    }
}

/// Stations as unknowns: positions with their standard deviations, and where each sensor stands.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StationPriors {
    stations: BTreeMap<String, keys::Station>,
    /// Station of each sensor.
    sensors: BTreeMap<String, String>,
}

impl From<&Campaign> for StationPriors {
    fn from(campaign: &Campaign) -> Self {
        let station = |sensor: &keys::Sensor| sensor.station.clone().unwrap_or_else(|| LASER.to_owned());
        Self {
            stations: campaign.stations.clone(),
            sensors: campaign.sensors.iter().map(|(name, sensor)| (name.clone(), station(sensor))).collect(),
        }
    }
}

impl StationPriors {
    /// Stations by name, the laser first: the frame turns about it.
    pub fn laser_first(&self) -> impl Iterator<Item = (&str, &keys::Station)> {
        let laser = self.stations.iter().filter(|(name, _)| *name == LASER);
        let others = self.stations.iter().filter(|(name, _)| *name != LASER);
        laser.chain(others).map(|(name, station)| (name.as_str(), station))
    }

    /// Whether the stations are the same, whatever stands at them.
    pub fn has_stations_of(&self, other: &Self) -> bool {
        self.stations == other.stations
    }

    /// Name of the station at which a sensor stands.
    ///
    /// # Panics
    /// When campaign.toml has no such sensor.
    pub fn of_sensor(&self, sensor: &str) -> &str {
        &self.sensors[sensor]
    }
}

/// Where campaign.toml says that a patch is.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PatchPrior {
    /// Whether laser and sensor reach it.
    pub role: PatchRole,
    /// Position of an anchor.
    pub position_m: Option<[f64; 3]>,
    /// Standard deviation of each of its coordinates; `None`: exact.
    pub sd_m: Option<f64>,
    /// The line on which it lies.
    pub ray: Option<Ray>,
}

impl PatchPrior {
    /// Of all patches of a campaign.
    pub fn of_all(campaign: &Campaign) -> BTreeMap<PatchId, Self> {
        campaign.patches.iter().map(|(id, patch)| (*id, Self::from(patch))).collect()
    }
}

impl From<&keys::Patch> for PatchPrior {
    fn from(patch: &keys::Patch) -> Self {
        let keys::Patch { role, position_m, sd_m, ray, .. } = patch.clone();
        Self { role, position_m, sd_m, ray }
    }
}

/// Errors that all points of a relay wall share.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct WallErrors {
    /// What campaign.toml says of them.
    #[serde(rename = "wall", skip_serializing_if = "WallErrors::is_none")]
    keys: keys::Wall,
}

impl From<&Campaign> for WallErrors {
    fn from(campaign: &Campaign) -> Self {
        Self { keys: campaign.wall }
    }
}

impl WallErrors {
    fn is_none(keys: &keys::Wall) -> bool {
        *keys == keys::Wall::default()
    }

    /// As the kernel takes them, in a medium.
    pub fn systematic(&self, medium: Medium) -> Systematic {
        let keys::Wall { grid_sd, relief_sd_m, relief_length_m, delay_sd_ps, walk_sd_ps } = self.keys;
        let length_m = |time_ps: Option<f64>| medium.path_m(time_ps.unwrap_or(0.0));
        Systematic {
            grid: grid_sd.unwrap_or(0.0),
            relief_m: relief_sd_m.zip(relief_length_m).map(|(sd_m, length_m)| [sd_m, length_m]),
            delay_m: length_m(delay_sd_ps),
            walk_m: length_m(walk_sd_ps),
        }
    }
}

/// From where on hidden patches are numbered, and how many there are.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct HiddenPatches {
    /// Largest number of a patch in campaign.toml; 0 without patches.
    pub largest_patch: PatchId,
    /// Number of hidden patches, where campaign.toml gives it.
    #[serde(rename = "hidden_count")]
    pub count: Option<u32>,
}

impl From<&Campaign> for HiddenPatches {
    fn from(campaign: &Campaign) -> Self {
        Self { largest_patch: campaign.patches.keys().copied().max().unwrap_or(0), count: campaign.hidden.count }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    const CAMPAIGN: &str = "[campaign]\nname = 'c'\ngroup_index = 1.5\n\
        [stations.laser]\nposition_m = [1.0, 0.0, 0.0]\n[stations.aside]\nposition_m = [0.0, 0.0, 2.0]\nsd_m = 0.1\n\
        [sensors.here]\n[sensors.there]\nstation = 'aside'\n[patches.7]\nrole = 'hidden'\nsize_m = 0.1\n";

    #[test]
    fn sensors_stand_at_their_stations_and_without_one_at_the_laser() {
        let campaign = Campaign::parse(Path::new("c"), CAMPAIGN).unwrap();
        let positions = StationPositions::from(&campaign);
        assert_eq!(positions.sensor("there"), Some(Point::new(0.0, 0.0, 2.0)));
        let with_laser = ["here", "there", "nowhere"].map(|sensor| positions.is_with_laser(sensor));
        assert_eq!(with_laser, [Some(true), Some(false), None]);
        let priors = StationPriors::from(&campaign);
        let names: Vec<&str> = priors.laser_first().map(|(name, _)| name).collect();
        assert_eq!(names, ["laser", "aside"]);
        assert_eq!((priors.of_sensor("here"), priors.of_sensor("there")), ("laser", "aside"));
    }

    #[test]
    fn what_no_estimator_reads_is_in_no_piece() {
        let read = |text: &str| {
            let campaign = Campaign::parse(Path::new("c"), text).unwrap();
            let pieces = (Medium::from(&campaign), StationPositions::from(&campaign), PatchPrior::of_all(&campaign));
            serde_json::to_string(&(pieces, HiddenPatches::from(&campaign))).unwrap()
        };
        assert_eq!(read(CAMPAIGN), read(&format!("{CAMPAIGN}label = 'a wall'\n")));
        assert_ne!(read(CAMPAIGN), read(&CAMPAIGN.replace("hidden", "mirror")));
    }
}
