//! `ingest`: raw oscilloscope files to `traces`, one row a channel and exposure. The one stage that reads raw files.
//!
//! Takes the campaign folder; writes `traces`. Codes pass on as the converter gave them; scale, time base and the
//! sub-sample trigger time stand next to them. What is stored is an index, which has where they lie in place of them,
//! unless `codes` asks for an archive. Files are hashed whenever they are read, and refused where another content is on
//! record. A file that cannot be decoded is a row in `rejects`, and the rest goes on.
//!
//! ```toml
//! [traces]
//! stage = "ingest"
//! params = { roles = ["scene"] }
//! ```

mod blocks;
pub mod captures;
mod content;
mod files;
mod long;
mod part;
mod piece;
pub mod pulses;
mod raw_file;
mod record;
mod runs;
mod survey;
mod template;
mod ticket;
mod units;

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

use arrow_schema::{Field, Schema, SchemaRef};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::operator::WrittenTable;
use super::source::{Divisible, Feed, OpenSource, PartRead, Piece, PieceFeed, Source, SourcePart, Ticket};
use super::stage::StageError;
use crate::campaign::{Campaign, LeftOut, Role};
use crate::parameter::Count;
use crate::store::finite::{self, NotJson};
use crate::store::{Digest, uncompressed, vacant};
use crate::tables::{Row, Trace};
use survey::{Surveyed, chain};

/// Parameters of `ingest`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ingest {
    /// Roles of the captures to read.
    #[serde(default = "scene")]
    roles: Vec<Role>,
    /// Most captures of each sensor, the first ones; absent: all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    captures_max: Option<Count>,
    /// What the stored table has of the codes.
    #[serde(default)]
    codes: Storage,
}

/// What a stored table has of the codes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Storage {
    /// Where they lie in the raw files.
    #[default]
    Indexed,
    /// Themselves, small: half of the raw bytes where 4 or 5 bits of a code are noise, seven tenths where 8 are.
    Zstd,
    /// Themselves, as large as the raw files, and several times faster to write and to read.
    None,
}

impl Storage {
    /// The schema of `traces`, its codes to be stored so.
    fn schema(self) -> SchemaRef {
        let schema = Trace::schema();
        let mark = match self {
            Self::Indexed => vacant,
            Self::Zstd => return schema,
            Self::None => uncompressed,
        };
        let field = |field: &Arc<Field>| match field.name().as_str() {
            "codes" => Arc::new(mark(field)),
            _ => Arc::clone(field),
        };
        let fields: Vec<_> = schema.fields().iter().map(field).collect();
        Arc::new(Schema::new_with_metadata(fields, schema.metadata().clone()))
    }
}

fn scene() -> Vec<Role> {
    vec![Role::Scene]
}

impl Source for Ingest {
    fn kind(&self) -> &'static str {
        "ingest"
    }
    fn version(&self) -> u32 {
        5
    }
    fn params(&self) -> Result<Value, NotJson> {
        let mut roles = self.roles.clone();
        roles.sort();
        roles.dedup();
        finite::to_json(&Self { roles, ..self.clone() })
    }
    fn fields(&self, _: &[Campaign]) -> Result<Value, NotJson> {
        // Name and rules enter through what they match: each part's content names its campaign, files, exposures and
        // keys.
        Ok(Value::Null)
    }
    fn table(&self) -> WrittenTable {
        WrittenTable { name: Trace::TABLE.to_owned(), schema: self.codes.schema() }
    }
    fn stands_in(&self) -> bool {
        self.codes != Storage::Indexed
    }
    fn is_sample_of(&self, other: &dyn Source) -> bool {
        if self.captures_max.is_none() || other.kind() != self.kind() {
            return false;
        }
        let other = other.params().ok().and_then(|params| serde_json::from_value::<Self>(params).ok());
        other.is_some_and(|other| {
            other.captures_max.is_none() && self.roles.iter().all(|role| other.roles.contains(role))
        })
    }
    fn open<'a>(&'a self, campaigns: &'a [Campaign], notes: &Path) -> Result<Box<dyn OpenSource + 'a>, StageError> {
        Ok(Box::new(Surveyed::new(campaigns, &self.roles, self.captures_max.map(Count::get), notes)?))
    }
    fn take_up<'a>(
        &'a self,
        campaigns: &'a [Campaign],
        notes: &Path,
        tickets: &[Ticket],
    ) -> Result<Box<dyn OpenSource + 'a>, StageError> {
        Ok(Box::new(Surveyed::take_up(campaigns, notes, tickets)?))
    }
}

impl OpenSource for Surveyed<'_> {
    fn parts(&self) -> &[SourcePart] {
        &self.source_parts
    }
    fn left_out(&self) -> &[LeftOut] {
        &self.left_out
    }
    fn sensors(&self) -> Option<BTreeSet<(usize, String, Role)>> {
        let captures = self.parts.iter().flatten();
        Some(captures.map(|capture| (capture.campaign, capture.sensor.clone(), capture.role)).collect())
    }
    fn read(&self, part: usize, batch_bytes: usize, feed: &dyn Feed) -> Result<PartRead, StageError> {
        part::read_part(self, part, batch_bytes, feed)
    }
    fn ticket(&self, part: usize) -> Option<Ticket> {
        Some(self.give(part))
    }
    fn divisible(&self) -> Option<&dyn Divisible> {
        Some(self)
    }
    fn close(&self) -> Result<(), StageError> {
        self.campaigns.iter().zip(&self.records).try_for_each(|(campaign, record)| {
            record.save().map_err(|error| StageError::Refused(chain(&campaign.root, &error)))
        })
    }
}

impl Divisible for Surveyed<'_> {
    fn most_pieces(&self, part: usize) -> Result<usize, String> {
        piece::most_pieces(self, part)
    }
    fn cut(&self, part: usize, count: usize) -> Result<Vec<Piece>, String> {
        piece::cut(self, part, count)
    }
    fn read_piece(
        &self,
        part: usize,
        piece: &Piece,
        batch_bytes: usize,
        feed: &dyn PieceFeed,
    ) -> Result<Value, StageError> {
        piece::read_piece(self, part, piece, batch_bytes, feed)
    }
    fn read_head(
        &self,
        part: usize,
        capture: usize,
        batch_bytes: usize,
        feed: &dyn PieceFeed,
    ) -> Result<(), StageError> {
        piece::read_head(self, &self.parts[part][capture], None, batch_bytes, feed)
    }
    fn join(&self, part: usize, learnt: &[Value], feed: &dyn Feed) -> Result<Digest, StageError> {
        piece::join(self, part, learnt, feed)
    }
}
