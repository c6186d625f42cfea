//! The roots of a result folder: whether its source parts match the present raw files of the campaigns.

use std::collections::BTreeSet;

use crate::campaign::manifest::MANIFEST_FILE;
use crate::campaign::{Campaign, Manifest, ManifestError};
use crate::stages::stage::StageError;
use crate::stages::{self, Node};
use crate::store::{Digest, Shelf, StageId, lineage};

/// Reads again all raw files on record (by the seal, or by earlier runs), and compares their content with the record.
///
/// # Errors
/// When the content of a file differs, or a file cannot be read.
pub fn rehash(campaigns: &[Campaign], shelf: &Shelf) -> Result<(), ManifestError> {
    for campaign in campaigns {
        for folder in [campaign.root.clone(), shelf.notes().join(&campaign.name)] {
            let Some(manifest) = Manifest::load(&folder)? else {
                continue;
            };
            let changed = manifest.audit(campaign, true)?.changed;
            if !changed.is_empty() {
                let files = changed.iter().map(|file| file.display().to_string()).collect();
                return Err(ManifestError::Changed { files, manifest: folder.join(MANIFEST_FILE) });
            }
        }
    }
    Ok(())
}

/// How the parts of one source stage relate to the raw files.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Root {
    /// Some parts follow from the recorded raw files; others were made from files that have changed since.
    Followed {
        /// Parts that follow.
        parts: usize,
        /// Parts that do not.
        other: usize,
    },
    /// It is unknown from which files it was made.
    Unknown,
    /// The campaign cannot be read.
    Refused(String),
}

/// Derives the parts of a source stage from the raw files of these campaigns.
#[must_use]
pub fn follow(id: &StageId, parts: &[Digest], campaigns: &[Campaign], shelf: &Shelf) -> Root {
    let Some(Node::Source(source)) = node(id) else {
        return Root::Unknown;
    };
    if campaigns.is_empty() {
        return Root::Unknown;
    }
    let made = match source.open(campaigns, &shelf.notes()) {
        Ok(open) => open.parts().iter().filter_map(|part| part.content).collect::<Vec<_>>(),
        Err(StageError::Refused(why)) => return Root::Refused(why),
        Err(error) => return Root::Refused(error.to_string()),
    };
    let lineages: BTreeSet<Digest> = made.iter().map(|content| lineage::part(&id.recipe(), content, &[])).collect();
    let followed = parts.iter().filter(|part| lineages.contains(*part)).count();
    Root::Followed { parts: followed, other: parts.len() - followed }
}

/// The stage of a recipe, if this program has it in that version.
fn node(id: &StageId) -> Option<Node> {
    let params = toml::Table::try_from(&id.params).ok()?;
    stages::parse(&id.kind, params).ok().filter(|node| match node {
        Node::Source(source) => source.version() == id.version,
        Node::Operator(_) => false,
    })
}
