//! The campaign folders of the last run, as far as they can still be read.

use std::collections::BTreeMap;

use super::provenance::Provenance;
use crate::campaign::Campaign;

/// What campaign.toml says, by the campaign's name.
#[derive(Default)]
pub struct Campaigns {
    /// Those that can be read.
    pub by_name: BTreeMap<String, Campaign>,
    /// Why the others cannot.
    pub unread: Vec<String>,
}

impl Campaigns {
    /// Reads the campaign.toml of each campaign of the last run.
    pub fn of(provenance: &Provenance) -> Self {
        let mut campaigns = Self::default();
        for (name, folder) in provenance.campaigns() {
            match Campaign::load(folder) {
                Ok(campaign) => drop(campaigns.by_name.insert(name.to_owned(), campaign)),
                Err(error) => campaigns.unread.push(format!("campaign {name}: {error:#}")),
            }
        }
        campaigns
    }
}
