//! `campaign.toml` to a checked [`Campaign`].

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::fault::Fault;
use super::{check_captures, check_setup};
use super::keys::{
    Campaign, CaptureRule, Exclude, Hidden, Patch, Sensor, Station, View, exclude_place, one_station, rule_place,
};
use super::toml_text::{self, TomlError};
use crate::units::PatchId;

/// Name of the file that makes a folder a campaign.
pub const CAMPAIGN_FILE: &str = "campaign.toml";

/// Why a campaign cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum CampaignError {
    /// The file cannot be read.
    #[error("{}: cannot be read; a campaign folder holds a campaign.toml that says what its raw files are", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// No TOML, an unknown key, or a value of the wrong type.
    #[error(transparent)]
    Toml(#[from] TomlError),
    /// A value that cannot be.
    #[error("{}: {fault}", file.display())]
    Keys {
        /// The file.
        file: PathBuf,
        /// What is wrong with which key.
        fault: Fault,
    },
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
    #[serde(default = "space")]
    dimensions: u8,
}

/// Group index of air at visible wavelengths, 15 degrees Celsius, one atmosphere.
fn index_of_air() -> f64 {
    1.000_277
}

fn space() -> u8 {
    3
}

impl Campaign {
    /// Reads and checks `root/campaign.toml`.
    ///
    /// # Errors
    /// When it cannot be read, or holds anything that cannot be: the message names line or heading, key and mend.
    pub fn load(root: &Path) -> Result<Self, CampaignError> {
        let file = root.join(CAMPAIGN_FILE);
        let text = std::fs::read_to_string(&file)
            .map_err(|source| CampaignError::Read { file, source })?;
        Self::parse(root, &text)
    }

    /// Checks the text of the `campaign.toml` of a folder.
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
            dimensions: keys.campaign.dimensions,
            stations: keys.stations,
            sensors: keys.sensors,
            patches: keys.patches,
            views: keys.views,
            hidden: keys.hidden,
            captures: keys.captures,
            exclude: keys.exclude,
        };
        campaign
            .check()
            .map_err(|fault| CampaignError::Keys { file, fault })?;
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
