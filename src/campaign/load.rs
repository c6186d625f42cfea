//! Reads `campaign.toml` into a checked [`Campaign`].

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::fault::Fault;
use super::keys::{
    CAMPAIGN_FILE, Campaign, CaptureRule, Exclude, Hidden, Patch, Sensor, Station, View, Wall, exclude_place,
    one_station, rule_place,
};
use super::manifest::ManifestError;
use super::parts::PART_BYTES;
use super::toml_text::{self, TomlError};
use super::{check_captures, check_setup, settings};
use crate::units::PatchId;

/// Why a campaign cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum CampaignError {
    /// The file cannot be read.
    #[error("{}: cannot be read; {}", file.display(), advice(file))]
    Read {
        /// The file.
        file: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Not TOML, an unknown key, or a value of the wrong type.
    #[error(transparent)]
    Toml(#[from] TomlError),
    /// An impossible value.
    #[error("{}: {fault}", file.display())]
    Keys {
        /// The file.
        file: PathBuf,
        /// What is wrong with which key.
        fault: Fault,
    },
    /// The seal cannot be read, or the settings differ from it.
    #[error(transparent)]
    Seal(#[from] ManifestError),
}

/// Advice for a missing `campaign.toml`.
fn advice(file: &Path) -> String {
    let folder = file.parent().unwrap_or(Path::new(""));
    match folder.file_name() {
        Some(name) if name == CAMPAIGN_FILE => {
            let folder = folder.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
            format!("give the folder, {}, and not the file in it", folder.display())
        }
        _ if folder.is_file() => {
            format!("{} is a file, and a campaign is a folder with a campaign.toml in it", folder.display())
        }
        _ => "a campaign folder holds a campaign.toml that says what its raw files are".to_owned(),
    }
}

/// The headings of the file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CampaignFile {
    campaign: Heading,
    #[serde(default = "one_station")]
    stations: BTreeMap<String, Station>,
    #[serde(default)]
    sensors: BTreeMap<String, Sensor>,
    #[serde(default)]
    patches: BTreeMap<PatchId, Patch>,
    #[serde(default)]
    views: BTreeMap<PatchId, View>,
    #[serde(default)]
    hidden: Hidden,
    #[serde(default)]
    wall: Wall,
    #[serde(default)]
    captures: Vec<CaptureRule>,
    #[serde(default)]
    exclude: Vec<Exclude>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Heading {
    name: String,
    #[serde(default = "index_of_air")]
    group_index: f64,
    repetition_ps: Option<f64>,
    repetition_sd_ps: Option<f64>,
    #[serde(default = "space")]
    dimensions: u8,
    #[serde(default = "usual_part")]
    part_bytes: u64,
}

/// Group index of air at visible wavelengths, 15 degrees Celsius, one atmosphere.
fn index_of_air() -> f64 {
    1.000_277
}

fn space() -> u8 {
    3
}

fn usual_part() -> u64 {
    PART_BYTES
}

impl Campaign {
    /// Reads and checks `root/campaign.toml`. In a sealed campaign it must be as it was sealed, as must the tables that
    /// it names.
    ///
    /// # Errors
    /// When the file cannot be read, has an impossible value, or differs from the seal. The message names line or
    /// heading, key, and the fix.
    pub fn load(root: &Path) -> Result<Self, CampaignError> {
        settings::hold(root)?;
        Self::read(root)
    }

    /// The same without regard to a seal.
    ///
    /// # Errors
    /// When the file cannot be read, or has an impossible value.
    pub fn read(root: &Path) -> Result<Self, CampaignError> {
        let file = root.join(CAMPAIGN_FILE);
        let text = toml_text::read(&file).map_err(|source| CampaignError::Read { file, source })?;
        Self::parse(root, &text)
    }

    /// Checks the text of a `campaign.toml` in folder `root`.
    ///
    /// # Errors
    /// As [`Campaign::load`].
    pub fn parse(root: &Path, text: &str) -> Result<Self, CampaignError> {
        let file = root.join(CAMPAIGN_FILE);
        let keys: CampaignFile = toml_text::parse(&file, text)?;
        let campaign = Self {
            root: root.to_owned(),
            name: keys.campaign.name,
            group_index: keys.campaign.group_index,
            repetition_ps: keys.campaign.repetition_ps,
            repetition_sd_ps: keys.campaign.repetition_sd_ps,
            dimensions: keys.campaign.dimensions,
            part_bytes: keys.campaign.part_bytes,
            stations: keys.stations,
            sensors: keys.sensors,
            patches: keys.patches,
            views: keys.views,
            hidden: keys.hidden,
            wall: keys.wall,
            captures: keys.captures,
            exclude: keys.exclude,
            settled: None,
        };
        campaign.check().map_err(|fault| CampaignError::Keys { file, fault })?;
        Ok(campaign)
    }

    fn check(&self) -> Result<(), Fault> {
        check_setup::campaign(self)?;
        for (index, rule) in self.captures.iter().enumerate() {
            check_captures::rule(rule, &rule_place(index), &self.sensors)?;
        }
        for (index, exclude) in self.exclude.iter().enumerate() {
            check_captures::exclude(exclude, &exclude_place(index), &self.sensors)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::keys::{Axis, PatchRole, Role, SensorKind};

    const FULL: &str = r#"
[campaign]
name = "around-the-corner"
repetition_ps = 10674.64
[stations.laser]
position_m = [0, 0, 0.0]
[stations.s1]
position_m = [0.08, 0.0, 0.0]
sd_m = 0.0005
[sensors.s1]
station = "s1"
kind = "analog"
latency_ps = 1250.0
latency_sd_ps = 10.0
[sensors.spad]
kind = "counts"
cycles = 1000000
dead_time_ps = 50000
gate_ps = 400
[patches.1]
role = "visible"
label = "lower left"
[patches.2]
role = "mirror"
position_m = [0.1, 1.2, 0.0]
sd_m = 0.002
normal = [0.0, -1.0, 0.0]
size_m = 0.04
ray = { from = "laser", direction = [0.08, 0.99, 0.0], sd_rad = 0.002 }
[views.7]
patches = [3, 4]
[hidden]
count = 2
[wall]
grid_sd = 0.002
relief_sd_m = 0.001
relief_length_m = 0.2
delay_sd_ps = 5.0
walk_sd_ps = 2.0
[[captures]]
role = "scene"
files = "raw/scene/L{lit}_P{seen}.trc"
sensor = "s1"
channel = "C1"
reference = { channel = "C2" }
segments = "shot"
averaged_shots = 1
attenuation_od = 0.0
[[captures]]
role = "response"
files = "raw/response/*.npy"
sensor = "s1"
segments = ["range", "shot"]
path_m = 1.0
path_sd_m = 0.0005
dt_ps = 50.0
gain_v = 0.001
offset_v = 0.0
t0_ps = -2000.0
samples = [0, 500]
[[captures]]
table = "captures.csv"
[[exclude]]
match = { sensor = "s1", lit = 12 }
reason = "shutter stuck"
"#;

    fn parse(text: &str) -> Result<Campaign, String> {
        Campaign::parse(Path::new("dir"), text).map_err(|error| error.to_string())
    }

    #[test]
    fn all_keys_of_the_contract_are_read() {
        let campaign = parse(FULL).unwrap();
        assert_eq!(campaign.group_index, 1.000_277);
        assert_eq!(campaign.dimensions, 3);
        assert_eq!(campaign.station_of("s1").unwrap().position_m[0], 0.08);
        assert_eq!(campaign.station_of("spad"), Some(campaign.source()));
        assert_eq!(campaign.station_of("s2"), None);
        assert_eq!(campaign.sensors["spad"].kind, SensorKind::Counts);
        assert_eq!(campaign.patches[&2].role, PatchRole::Mirror);
        assert_eq!(campaign.views[&7].patches, [3, 4]);
        assert_eq!((campaign.wall.grid_sd, campaign.wall.walk_sd_ps), (Some(0.002), Some(2.0)));
        assert_eq!(campaign.captures[0].segments, [Axis::Shot]);
        assert_eq!(campaign.captures[1].segments, [Axis::Range, Axis::Shot]);
        assert_eq!(campaign.captures[1].samples, Some([0, 500]));
        assert_eq!(campaign.captures[2].role, None);
        assert_eq!(campaign.exclude[0].matches.lit, Some(12));
        assert_eq!(campaign.captures[0].role.map(Role::name), Some("scene"));
    }

    #[test]
    fn the_folder_does_not_enter_what_is_serialized() {
        let here = Campaign::parse(Path::new("/a"), FULL).unwrap();
        let there = Campaign::parse(Path::new("/b"), FULL).unwrap();
        let text = |campaign: &Campaign| serde_json::to_string(campaign).unwrap();
        assert_eq!(text(&here), text(&there));
        assert!(text(&here).contains("\"position_m\":[0.08,0.0,0.0]"));
    }

    #[test]
    fn a_campaign_without_stations_has_all_at_the_origin() {
        let campaign = parse("[campaign]\nname = 'c'\n[sensors.s1]\n").unwrap();
        assert_eq!(campaign.station_of("s1").unwrap().position_m, [0.0; 3]);
        assert_eq!(campaign.source().sd_m, None);
    }

    /// One fault per line: text of the full file, its replacement, and two parts of the message.
    const FAULTS: &str = r#"
sd_m = 0.002 ~ sd = 0.002 ~ [patches.2] ~ did you mean `sd_m`?
count = 2 ~ count = 2.5 ~ `count` in [hidden] ~ expected u32
[hidden] ~ [hiden] ~ the top level ~ did you mean `hidden`?
grid_sd = 0.002 ~ grid_sd = 1.5 ~ [wall] ~ a share of the distance
relief_length_m = 0.2 ~  ~ [wall] ~ add relief_length_m
walk_sd_ps = 2.0 ~ walk_sd_ps = -2.0 ~ [wall] ~ walk_sd_ps must be above 0
"response" ~ "respons" ~ [[captures]] number 2 ~ did you mean `response`?
["range", "shot"] ~ "shots" ~ `segments` in [[captures]] number 2 ~ did you mean `shot`?
repetition_ps ~ dimensions = 4\nrepetition_ps ~ [campaign] ~ 3, or 2
repetition_ps ~ group_index = 0.9\nrepetition_ps ~ [campaign] ~ 1.000277
10674.64 ~ nan ~ [campaign] ~ repetition_ps is not a finite number
[stations.laser] ~ [stations.lasr] ~ [stations] ~ add [stations.laser]
station = "s1" ~ station = "s2" ~ [sensors.s1] ~ add [stations.s2]
[patches.1] ~ [patches.0] ~ [patches.0] ~ number them from 1
[0.0, -1.0, 0.0] ~ [0.0, -2.0, 0.0] ~ [patches.2] ~ [0.000000, -1.000000, 0.000000]
from = "laser" ~ from = "lasre" ~ [patches.2]: ray.from ~ did you mean `laser`?
sd_rad = 0.002 ~ sd_rad = -1 ~ ray.sd_rad ~ above 0
kind = "counts" ~  ~ [sensors.spad] ~ kind = "counts"
latency_ps = 1250.0 ~  ~ [sensors.s1] ~ latency_sd_ps stands without latency_ps
[3, 4] ~ [] ~ [views.7] ~ list what
role = "scene" ~  ~ [[captures]] number 1 ~ `role` is missing
table = "captures.csv" ~ role = "dark" ~ [[captures]] number 3 ~ either `files`
table = "captures.csv" ~ table = "/a.csv" ~ [[captures]] number 3 ~ relative to the campaign folder
channel = "C1" ~ sensor_ = 1 ~ [[captures]] number 1 ~ did you mean `sensor`?
channel = "C1" ~ lit = 3 ~ [[captures]] number 1 ~ take one out
_P{seen} ~  ~ [[captures]] number 1 ~ which patch is `seen`
{seen} ~ {sen} ~ [[captures]] number 1 ~ did you mean `seen`?
{ channel = "C2" } ~ { channel = "C2", files = "x" } ~ [[captures]] number 1 ~ either `channel`
{ channel = "C2" } ~ { files = "{shot}.trc" } ~ [[captures]] number 1 ~ put it into both
{ channel = "C2" } ~ { channel = "C1" } ~ [[captures]] number 1 ~ the other one
["range", "shot"] ~ ["sensor"] ~ [[captures]] number 2 ~ `sensor` stands in segments
[0, 500] ~ [500, 0] ~ [[captures]] number 2 ~ a must be below b
path_m = 1.0 ~  ~ [[captures]] number 2 ~ path_sd_m stands without path_m
lit = 12 } ~ lit = 12, file = "L{lit}" } ~ [[exclude]] number 1 ~ placeholder
{ sensor = "s1", lit = 12 } ~ {} ~ [[exclude]] number 1 ~ everything
sensor = "s1", lit ~ sensor = "s3", lit ~ [[exclude]] number 1 ~ add [sensors.s3]
"#;

    #[test]
    fn faults_name_place_and_fix() {
        for line in FAULTS.trim().lines() {
            let cells: Vec<&str> = line.split('~').map(str::trim).collect();
            assert!(FULL.contains(cells[0]), "{line}");
            let error = parse(&FULL.replacen(cells[0], &cells[1].replace("\\n", "\n"), 1)).unwrap_err();
            let file = Path::new("dir").join(CAMPAIGN_FILE).display().to_string();
            assert!(error.starts_with(&file), "{error}");
            assert!(error.contains(cells[2]) && error.contains(cells[3]), "{line}: {error}");
        }
    }

    #[test]
    fn flatland_has_no_third_coordinate() {
        let flat = FULL.replace("repetition_ps", "dimensions = 2\nrepetition_ps");
        assert!(parse(&flat).is_ok());
        let error = parse(&flat.replace("[0.1, 1.2, 0.0]", "[0.1, 1.2, 0.3]")).unwrap_err();
        assert!(error.contains("[patches.2]: position_m leaves flatland"), "{error}");
    }

    #[test]
    fn a_folder_without_campaign_file_is_reported() {
        let folder = tempfile::tempdir().unwrap();
        let error = Campaign::load(folder.path()).unwrap_err().to_string();
        assert!(error.contains("campaign.toml: cannot be read"), "{error}");
    }
}
