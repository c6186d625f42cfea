//! `anchor`: patches whose places are known beforehand, as a table: the wall of a campaign that only looks for what is
//! hidden.
//!
//! Takes campaign.toml; writes `patches`: those with a `position_m`, with its standard deviation (`sd_m`; where none is
//! given, a micrometre). `label`, `range` and `embed` take them in place of patches that `refine` found. Their errors
//! are independent of each other.
//!
//! ```toml
//! [wall]
//! stage = "anchor"
//! ```

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::operator::WrittenTable;
use super::source::{Feed, OpenSource, PartRead, Source, SourcePart};
use super::stage::StageError;
use crate::campaign::keys::{self, PatchRole};
use crate::campaign::{Campaign, LeftOut};
use crate::geometry::Point;
use crate::priors::covariances;
use crate::store::Digest;
use crate::store::finite::{self, NotJson};
use crate::tables::{Patch, Row};
use crate::units::PatchId;

/// Standard deviation of a coordinate that is called exact.
const EXACT_M: f64 = 1e-6;

/// Parameters of `anchor`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AnchorPatches {
    /// Whether the table may be empty: of a campaign without anchors.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    optional: bool,
}

impl Source for AnchorPatches {
    fn kind(&self) -> &'static str {
        "anchor"
    }
    fn version(&self) -> u32 {
        1
    }
    fn params(&self) -> Result<Value, NotJson> {
        finite::to_json(self)
    }
    fn fields(&self, campaigns: &[Campaign]) -> Result<Value, NotJson> {
        finite::to_json(&campaigns.first().map(anchors))
    }
    fn table(&self) -> WrittenTable {
        WrittenTable { name: Patch::TABLE.to_owned(), schema: Patch::schema() }
    }

    fn open<'a>(&'a self, campaigns: &'a [Campaign], _: &Path) -> Result<Box<dyn OpenSource + 'a>, StageError> {
        let mut all = campaigns.iter().map(anchors);
        let anchors = all.next().unwrap_or_default();
        if anchors.is_empty() && !self.optional {
            let text =
                "no patch in campaign.toml has a `position_m`; add [patches.N] with one for each point of the wall";
            return Err(StageError::Refused(text.to_owned()));
        }
        if all.any(|other| other != anchors) {
            let text = "the campaigns differ in anchors: campaigns of one scene must share them";
            return Err(StageError::Refused(text.to_owned()));
        }
        let content = finite::to_json(&anchors).map_err(|fault| StageError::Refused(fault.to_string()))?;
        let part = SourcePart { content: Some(Digest::of(&content)), bytes: 0, records: anchors.len() as u64 };
        Ok(Box::new(Opened { anchors, parts: [part] }))
    }
}

/// A patch as campaign.toml has it: role, place and standard deviation.
type Anchor = (PatchRole, [f64; 3], Option<f64>);

fn anchors(campaign: &Campaign) -> BTreeMap<PatchId, Anchor> {
    let anchor = |(id, patch): (&PatchId, &keys::Patch)| Some((*id, (patch.role, patch.position_m?, patch.sd_m)));
    campaign.patches.iter().filter_map(anchor).collect()
}

/// Anchors that were found.
struct Opened {
    anchors: BTreeMap<PatchId, Anchor>,
    parts: [SourcePart; 1],
}

impl OpenSource for Opened {
    fn parts(&self) -> &[SourcePart] {
        &self.parts
    }
    fn left_out(&self) -> &[LeftOut] {
        &[]
    }

    fn read(&self, _: usize, _: usize, feed: &dyn Feed) -> Result<PartRead, StageError> {
        let rows: Vec<Patch> = self.anchors.iter().map(|(id, anchor)| row(*id, anchor)).collect();
        let batch = Patch::to_batch(&rows);
        let credit = feed.reserve(batch.get_array_memory_size())?;
        feed.send(batch, credit)?;
        Ok(PartRead { content: self.parts[0].content.expect("known when it was opened"), rejections: Vec::new() })
    }

    fn close(&self) -> Result<(), StageError> {
        Ok(())
    }
}

fn row(patch: PatchId, (role, position_m, sd_m): &Anchor) -> Patch {
    let variance_m2 = sd_m.unwrap_or(EXACT_M).powi(2);
    let cov_m2 = Matrix3::from_diagonal_element(variance_m2);
    covariances::patch_row(patch, role.name(), Point::from(*position_m), Some(&cov_m2))
}
