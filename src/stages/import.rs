//! `import`: a table made elsewhere stands in for its stage, such as onsets from someone's own picker.
//!
//! Takes a Parquet file (or a folder of them, in order of name); writes the table that `table` names. Columns are found
//! by name and brought to the table's own types; columns that may be null may be absent; columns that the table does
//! not have are refused by name. Times and lengths must already be in the units of the column names.
//!
//! ```toml
//! [onsets]
//! stage = "import"
//! params = { table = "onsets", path = "picked/onsets.parquet" }   # relative to the folder that periscope runs in
//! ```

use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::{ArrayRef, RecordBatch, new_null_array};
use arrow_cast::{CastOptions, cast_with_options};
use arrow_schema::SchemaRef;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::operator::WrittenTable;
use super::source::{Feed, OpenSource, PartRead, Source, SourcePart};
use super::stage::StageError;
use crate::campaign::{Campaign, LeftOut, hash_file, suggest};
use crate::store::finite::NotJson;
use crate::store::{Digest, parquet};
use crate::tables::{self, Profile, Row};

/// Parameters of `import`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Import {
    /// Table that the file is.
    #[serde(deserialize_with = "known_table")]
    table: String,
    /// Parquet file, or folder of them.
    path: PathBuf,
}

fn known_table<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<String, D::Error> {
    let name = String::deserialize(deserializer)?;
    let names: Vec<&str> = tables::all().into_iter().map(|(name, _)| name).collect();
    if names.contains(&name.as_str()) {
        return Ok(name);
    }
    Err(serde::de::Error::custom(format!("unknown table `{name}`; {}", suggest::hint(&name, names))))
}

impl Import {
    fn schema(&self) -> SchemaRef {
        tables::schema_of(&self.table).expect("checked when it was parsed")
    }

    fn refused(&self, message: impl std::fmt::Display) -> StageError {
        StageError::Refused(format!("{}: {message}", self.path.display()))
    }

    fn files(&self) -> Result<Vec<PathBuf>, StageError> {
        if self.path.is_file() {
            return Ok(vec![self.path.clone()]);
        }
        let entries = std::fs::read_dir(&self.path).map_err(|error| {
            self.refused(format!("cannot be read; `path` is a .parquet file, or a folder of them, seen from where periscope runs: {error}"))
        })?;
        let mut files: Vec<_> = entries.flatten().map(|entry| entry.path()).collect();
        files.retain(|file| file.extension().is_some_and(|extension| extension == "parquet"));
        files.sort();
        if files.is_empty() { Err(self.refused("holds no .parquet file")) } else { Ok(files) }
    }

    /// The batch with the table's own columns, types and order. It begins with this row of the file, from 0.
    fn conform(&self, file: &Path, first_row: usize, batch: &RecordBatch) -> Result<RecordBatch, StageError> {
        let schema = self.schema();
        let place = |column: &str, message: String| {
            StageError::Refused(format!("{}: column `{column}`: {message}", file.display()))
        };
        let names: Vec<&str> = schema.fields().iter().map(|field| field.name().as_str()).collect();
        if let Some(other) = batch.schema_ref().fields().iter().find(|field| !names.contains(&field.name().as_str())) {
            let hint = suggest::hint(other.name(), names.iter().copied());
            return Err(place(other.name(), format!("table `{}` has none such; {hint}", self.table)));
        }
        let column = |field: &Arc<arrow_schema::Field>| -> Result<ArrayRef, StageError> {
            match batch.column_by_name(field.name()) {
                Some(column) => {
                    let options = CastOptions { safe: false, ..CastOptions::default() };
                    let column = cast_with_options(column, field.data_type(), &options)
                        .map_err(|error| place(field.name(), error.to_string()))?;
                    if column.null_count() > 0 && !field.is_nullable() {
                        return Err(place(field.name(), "has nulls, and may not".to_owned()));
                    }
                    Ok(column)
                }
                None if field.is_nullable() => Ok(new_null_array(field.data_type(), batch.num_rows())),
                None => Err(place(field.name(), format!("is missing; see `periscope schema {}`", self.table))),
            }
        };
        let columns = schema.fields().iter().map(column).collect::<Result<_, _>>()?;
        let rows = RecordBatch::try_new(schema.clone(), columns)?;
        if self.table == Profile::TABLE
            && let Some(row) = Profile::without_samples(&rows)
        {
            let neither = "has neither this nor `counts`: a profile needs its mean signal, or the photons of each bin";
            return Err(place("mean_v", format!("row {} {neither}", first_row + row)));
        }
        Ok(rows)
    }
}

impl Source for Import {
    fn kind(&self) -> &'static str {
        "import"
    }
    fn version(&self) -> u32 {
        1
    }
    fn params(&self) -> Result<Value, NotJson> {
        // Where the file lies does not matter, only what is in it: its digest is the part's content.
        Ok(json!({ "table": self.table }))
    }
    fn fields(&self, _: &[Campaign]) -> Result<Value, NotJson> {
        Ok(Value::Null)
    }
    fn table(&self) -> WrittenTable {
        WrittenTable { name: self.table.clone(), schema: self.schema() }
    }

    fn open<'a>(&'a self, _: &'a [Campaign], _: &Path) -> Result<Box<dyn OpenSource + 'a>, StageError> {
        let files = self.files()?;
        let mut digests = Vec::new();
        let mut bytes = 0;
        for file in &files {
            digests.push(Digest::from(hash_file(file).map_err(|error| self.refused(error))?));
            bytes += std::fs::metadata(file).map_err(|error| self.refused(error))?.len();
        }
        let content = Digest::join("import", &digests);
        Ok(Box::new(Opened { import: self, files, parts: [SourcePart { content: Some(content), bytes, records: 0 }] }))
    }
}

/// Files that were found and hashed.
struct Opened<'a> {
    import: &'a Import,
    files: Vec<PathBuf>,
    parts: [SourcePart; 1],
}

impl OpenSource for Opened<'_> {
    fn parts(&self) -> &[SourcePart] {
        &self.parts
    }
    fn left_out(&self) -> &[LeftOut] {
        &[]
    }

    fn read(&self, _: usize, batch_bytes: usize, feed: &dyn Feed) -> Result<PartRead, StageError> {
        for file in &self.files {
            let refused = |error| StageError::Refused(format!("{}: {error}", file.display()));
            let mut rows = 0;
            for batch in parquet::read(file, 1024).map_err(refused)? {
                let batch = self.import.conform(file, rows, &batch.map_err(refused)?)?;
                rows += batch.num_rows();
                let credit = feed.reserve(batch.get_array_memory_size().min(batch_bytes))?;
                feed.send(batch, credit)?;
            }
            feed.read_bytes(std::fs::metadata(file).map_or(0, |file| file.len()));
        }
        Ok(PartRead { content: self.parts[0].content.expect("hashed when it was opened"), rejections: Vec::new() })
    }

    fn close(&self) -> Result<(), StageError> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(rows: &RecordBatch) -> String {
        let import = Import { table: "profiles".to_owned(), path: "mine.parquet".into() };
        import.conform(Path::new("mine.parquet"), 1024, rows).map_or_else(|error| error.to_string(), |_| String::new())
    }

    #[test]
    fn a_table_made_elsewhere_is_refused_with_file_column_and_row() {
        let profile = Profile { mean_v: Some([0.5, 1.0].into_iter().collect()), ..Profile::default() };
        let rows = Profile::to_batch(&[profile.clone(), Profile { mean_v: None, ..profile.clone() }]);
        let text = refusal(&rows);
        assert!(text.contains("mine.parquet") && text.contains("`mean_v`: row 1025 has neither"), "{text}");
        let counted = Profile { mean_v: None, counts: Some(vec![3, 0]), ..profile.clone() };
        assert_eq!(refusal(&Profile::to_batch(&[profile, counted])), "");
        let without = |column: &str| {
            let kept: Vec<usize> =
                (0..rows.num_columns()).filter(|i| rows.schema().field(*i).name() != column).collect();
            rows.project(&kept).unwrap()
        };
        assert!(refusal(&without("dt_ps")).contains("`dt_ps`: is missing"), "{}", refusal(&without("dt_ps")));
        assert!(refusal(&without("mean_v")).contains("row 1024"), "{}", refusal(&without("mean_v")));
        let names = rows.schema().fields().iter().map(|field| field.as_ref().clone()).collect::<Vec<_>>();
        let other = names.into_iter().map(|field| {
            let name = if field.name() == "noise_v" { "noise_volts".to_owned() } else { field.name().clone() };
            field.with_name(name)
        });
        let schema = Arc::new(arrow_schema::Schema::new(other.collect::<Vec<_>>()));
        let other = RecordBatch::try_new(schema, rows.columns().to_vec()).unwrap();
        assert!(refusal(&other).contains("`noise_volts`"), "{}", refusal(&other));
    }
}
