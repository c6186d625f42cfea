//! Writes and reads tables with the Parquet crate: one table of one part, in row groups.
//!
//! The sizes of the rows decide where a row group ends, so that a file's bytes do not depend on how the rows were
//! batched. The worker pool encodes row groups; they are appended in order.

mod recorded;

use std::collections::VecDeque;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::{Array, ArrayRef, RecordBatch};
use arrow_schema::{DataType, Field, SchemaRef};
use arrow_select::concat::concat;
use parquet::arrow::ArrowWriter;
use parquet::arrow::arrow_reader::{ArrowReaderMetadata, ArrowReaderOptions, ParquetRecordBatchReaderBuilder};
use parquet::arrow::arrow_writer::{ArrowColumnWriter, ArrowRowGroupWriterFactory, ArrowWriterOptions, compute_leaves};
use parquet::basic::{Compression, ZstdLevel};
use parquet::column::writer::ColumnCloseResult;
use parquet::errors::ParquetError;
use parquet::file::metadata::{KeyValue, ParquetMetaDataReader};
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::ColumnPath;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::Digest;
use super::digesting::Digesting;
use super::disk;
use super::failure::StoreError;
use super::page_checksums::{Chunk, ChunkPages, with_checksums};

pub use recorded::read_groups;

/// A row group ends with the row that brings it to this many bytes.
pub const ROW_GROUP_BYTES: usize = 4 << 20;
/// Waveforms of a row group are encoded so many bytes at a time: what the encoder makes of them on the way, their
/// levels above all, then stays in the cache.
const PIECE_BYTES: usize = 8 << 10;
/// Pages of samples have this many bytes, so that the second cache has them from their making to their hash.
const PAGE_BYTES: usize = 64 << 10;
/// Most rows of a row group.
const ROW_GROUP_ROWS: usize = 1 << 16;

/// The record of one file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileRecord {
    /// Rows in the file.
    pub rows: u64,
    /// Size of the file.
    pub bytes: u64,
    /// BLAKE3 of the word `file` and of the BLAKE3 hashes of its sections: its row groups (without any, what stands
    /// before the footer) and its footer. Without `groups`, of the file.
    pub digest: Digest,
    /// Where its pages end. Indexes and footer follow.
    pub pages_end: u64,
    /// BLAKE3 of everything after the pages.
    pub footer: Digest,
    /// Its row groups, in order; `None` in the records of earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub groups: Option<Vec<RowGroup>>,
}

impl FileRecord {
    /// Digest of a file that has these sections.
    pub(super) fn digest_of<'a>(sections: impl IntoIterator<Item = &'a Digest>) -> Digest {
        Digest::join("file", sections)
    }
}

/// A row group of a file, from the end of the one before.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RowGroup {
    /// Where its pages end.
    pub end: u64,
    /// BLAKE3 of its bytes.
    pub digest: Digest,
}

/// Writes one table of one part.
pub struct TableWriter {
    path: PathBuf,
    schema: SchemaRef,
    /// Leaf columns of each field.
    leaves: Vec<usize>,
    writer: SerializedFileWriter<Digesting>,
    factory: ArrowRowGroupWriterFactory,
    /// Pages of the column chunks in encoding.
    pages: Arc<ChunkPages>,
    /// Rows of the unfinished row group.
    open: Group,
    open_bytes: usize,
    open_rows: usize,
    /// Complete row groups that wait to be encoded together.
    whole: Vec<Group>,
    groups: Vec<RowGroup>,
    rows: u64,
}

impl TableWriter {
    /// Starts a file, and replaces an existing one at `path`.
    ///
    /// # Errors
    /// When the file cannot be created.
    pub fn create(path: &Path, schema: &SchemaRef) -> Result<Self, ParquetError> {
        let sink = Digesting::new(disk::create(path)?);
        let pages = Arc::new(ChunkPages::default());
        let options =
            ArrowWriterOptions::new().with_properties(properties(schema)).with_page_store_factory(pages.clone());
        let (writer, factory) =
            ArrowWriter::try_new_with_options(sink, schema.clone(), options)?.into_serialized_writer()?;
        let mut leaves = vec![0; schema.fields().len()];
        let columns = writer.schema_descr();
        (0..columns.num_columns()).for_each(|leaf| leaves[columns.get_column_root_idx(leaf)] += 1);
        Ok(Self {
            path: path.to_owned(),
            schema: schema.clone(),
            leaves,
            writer,
            factory,
            pages,
            open: Group::default(),
            open_bytes: 0,
            open_rows: 0,
            whole: Vec::new(),
            groups: Vec::new(),
            rows: 0,
        })
    }

    /// Path of the file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Appends rows.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&mut self, batch: &RecordBatch) -> Result<(), ParquetError> {
        self.rows += batch.num_rows() as u64;
        let mut start = 0;
        for (row, bytes) in row_bytes(batch).into_iter().enumerate() {
            self.open_bytes += bytes;
            self.open_rows += 1;
            self.open.count(bytes);
            if self.open_bytes >= ROW_GROUP_BYTES || self.open_rows >= ROW_GROUP_ROWS {
                self.open.batches.push(batch.slice(start, row + 1 - start));
                start = row + 1;
                self.close_group()?;
            }
        }
        if start < batch.num_rows() {
            self.open.batches.push(batch.slice(start, batch.num_rows() - start));
        }
        Ok(())
    }

    fn close_group(&mut self) -> Result<(), ParquetError> {
        self.whole.push(std::mem::take(&mut self.open));
        (self.open_bytes, self.open_rows) = (0, 0);
        // As many groups as give each thread a column of samples.
        let large = self.schema.fields().iter().filter(|field| holds_samples(field)).count().max(1);
        if self.whole.len() * large >= rayon::current_num_threads() { self.encode() } else { Ok(()) }
    }

    fn encode(&mut self) -> Result<(), ParquetError> {
        // Every column of every group is a task of its own, so that all threads are busy.
        let mut columns = Vec::new();
        for (number, group) in self.whole.iter().enumerate() {
            let mut writers = self.factory.create_column_writers(self.groups.len() + number)?.into_iter();
            let mut pages = self.pages.take().into_iter();
            for (column, leaves) in self.leaves.iter().enumerate() {
                let writers: Vec<_> = writers.by_ref().zip(pages.by_ref()).take(*leaves).collect();
                columns.push((number, group, column, writers));
            }
        }
        let encoded: Vec<Vec<(usize, Chunk, ColumnCloseResult)>> = columns
            .into_par_iter()
            .map(|(number, group, column, mut writers)| {
                let field = self.schema.field(column);
                for piece in group.pieces(field, column)? {
                    let leaves = compute_leaves(field, &piece)?;
                    assert_eq!(leaves.len(), writers.len(), "one writer a leaf column of {}", field.name());
                    leaves.iter().zip(&mut writers).try_for_each(|(leaf, (writer, _))| writer.write(leaf))?;
                }
                let end = |(writer, pages): (ArrowColumnWriter, _)| {
                    let close = writer.close()?.close().clone();
                    let (chunk, close) = with_checksums(&pages, &close)?;
                    Ok((number, chunk, close))
                };
                writers.into_iter().map(end).collect()
            })
            .collect::<Result<_, ParquetError>>()?;
        self.whole.clear();
        let encoded: Vec<_> = encoded.into_iter().flatten().collect();
        for group in encoded.chunk_by(|a, b| a.0 == b.0) {
            let mut writer = self.writer.next_row_group()?;
            for (_, chunk, close) in group {
                writer.append_column(chunk, close.clone())?;
            }
            writer.close()?;
            self.writer.flush()?;
            let end = self.writer.bytes_written() as u64;
            let digest = self.writer.inner_mut().end_section()?;
            self.groups.push(RowGroup { end, digest });
        }
        Ok(())
    }

    /// Ends the file with these footer entries.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn finish(mut self, footer: &[(&str, String)]) -> Result<FileRecord, ParquetError> {
        if self.open_rows > 0 {
            self.close_group()?;
        }
        self.encode()?;
        self.writer.flush()?;
        let pages_end = self.writer.bytes_written() as u64;
        let mut sections: Vec<Digest> = self.groups.iter().map(|group| group.digest).collect();
        if sections.is_empty() {
            sections.push(self.writer.inner_mut().end_section()?);
        }
        for (key, value) in footer {
            self.writer.append_key_value_metadata(KeyValue::new((*key).to_owned(), value.clone()));
        }
        let mut sink = self.writer.into_inner()?;
        sink.flush()?;
        let footer = sink.end_section()?;
        sections.push(footer);
        let digest = FileRecord::digest_of(&sections);
        Ok(FileRecord { rows: self.rows, bytes: sink.bytes(), digest, pages_end, footer, groups: Some(self.groups) })
    }
}

/// Rows of a row group.
#[derive(Default)]
struct Group {
    /// As they came.
    batches: Vec<RecordBatch>,
    /// Rows of each piece that is full, and of the last one.
    pieces: Vec<usize>,
    rows: usize,
    bytes: usize,
}

impl Group {
    /// Takes the next row into account: pieces depend on the rows alone, not on how these came.
    fn count(&mut self, bytes: usize) {
        (self.rows, self.bytes) = (self.rows + 1, self.bytes + bytes);
        if self.bytes >= PIECE_BYTES {
            self.pieces.push(self.rows);
            (self.rows, self.bytes) = (0, 0);
        }
    }

    /// A column as it is encoded: waveforms in pieces, others at once.
    fn pieces(&self, field: &Field, column: usize) -> Result<Vec<ArrayRef>, ParquetError> {
        let arrays = self.batches.iter().map(|batch| Arc::clone(batch.column(column)));
        if !is_waveform(field) {
            return Ok(vec![joined(&arrays.collect::<Vec<_>>())?]);
        }
        let mut arrays: VecDeque<ArrayRef> = arrays.collect();
        let piece = |mut missing: usize| {
            let mut parts = Vec::new();
            while missing > 0 {
                let array = arrays.pop_front().expect("pieces have the rows of the group");
                let rows = missing.min(array.len());
                parts.push(array.slice(0, rows));
                if rows < array.len() {
                    arrays.push_front(array.slice(rows, array.len() - rows));
                }
                missing -= rows;
            }
            joined(&parts)
        };
        self.pieces.iter().copied().chain((self.rows > 0).then_some(self.rows)).map(piece).collect()
    }
}

/// Arrays as one; a single one is not copied.
fn joined(arrays: &[ArrayRef]) -> Result<ArrayRef, ParquetError> {
    match arrays {
        [array] => Ok(Arc::clone(array)),
        arrays => Ok(concat(&arrays.iter().map(|array| &**array).collect::<Vec<_>>())?),
    }
}

/// Bytes of each row in columns of variable length, plus eight for each other column.
fn row_bytes(batch: &RecordBatch) -> Vec<usize> {
    let mut bytes = vec![0; batch.num_rows()];
    for column in batch.columns() {
        match column.data_type() {
            DataType::BinaryView => {
                let views = column.as_binary_view().views();
                bytes.iter_mut().zip(views).for_each(|(total, view)| *total += *view as u32 as usize);
            }
            DataType::List(item) => {
                let width = item.data_type().primitive_width().unwrap_or(48);
                let offsets = column.as_list::<i32>().value_offsets();
                bytes
                    .iter_mut()
                    .zip(offsets.windows(2))
                    .for_each(|(total, ends)| *total += (ends[1] - ends[0]) as usize * width);
            }
            _ => bytes.iter_mut().for_each(|total| *total += 8),
        }
    }
    bytes
}

/// Metadata entry of a field whose column must not be compressed.
const COMPRESSION: (&str, &str) = ("compression", "none");

/// The same column, stored without compression.
#[must_use]
pub fn uncompressed(field: &Field) -> Field {
    let mut metadata = field.metadata().clone();
    metadata.insert(COMPRESSION.0.to_owned(), COMPRESSION.1.to_owned());
    field.clone().with_metadata(metadata)
}

/// Metadata entry of a field whose column has nothing but nulls.
const VACANT: (&str, &str) = ("holds", "nulls");

/// The same column, which is to have nothing but nulls.
#[must_use]
pub fn vacant(field: &Field) -> Field {
    let mut metadata = field.metadata().clone();
    metadata.insert(VACANT.0.to_owned(), VACANT.1.to_owned());
    field.clone().with_metadata(metadata)
}

/// Whether a column holds waveforms.
fn is_waveform(field: &Field) -> bool {
    matches!(field.data_type(), DataType::List(item) if item.data_type() == &DataType::Float32)
}

/// Whether a column holds samples: codes, or a waveform.
fn holds_samples(field: &Field) -> bool {
    if field.metadata().get(VACANT.0).is_some_and(|mark| mark == VACANT.1) {
        return false;
    }
    field.data_type() == &DataType::BinaryView || is_waveform(field)
}

/// Columns are compressed, except lists of floats, since their low bits are noise. In tables of samples only codes are
/// compressed: the other columns are a hundredth of the bytes. Codes alone are worth the compressor that zstd starts
/// for each column chunk.
fn properties(schema: &SchemaRef) -> WriterProperties {
    let zstd = Compression::ZSTD(ZstdLevel::try_new(1).expect("level 1 exists"));
    let has_samples = schema.fields().iter().any(|field| holds_samples(field));
    let mut properties = WriterProperties::builder()
        .set_created_by("periscope".to_owned())
        .set_compression(if has_samples { Compression::UNCOMPRESSED } else { Compression::LZ4_RAW })
        .set_max_row_group_row_count(None);
    for field in schema.fields() {
        let marked = field.metadata().get(COMPRESSION.0).is_some_and(|mark| mark == COMPRESSION.1);
        let (path, compression) = match field.data_type() {
            DataType::List(item) if item.data_type().is_floating() => {
                let path = vec![field.name().clone(), "list".into(), item.name().clone()];
                (ColumnPath::from(path), Compression::UNCOMPRESSED)
            }
            DataType::BinaryView if marked => (ColumnPath::from(field.name().as_str()), Compression::UNCOMPRESSED),
            DataType::BinaryView => (ColumnPath::from(field.name().as_str()), zstd),
            _ => continue,
        };
        properties = properties
            .set_column_dictionary_enabled(path.clone(), false)
            .set_column_statistics_enabled(path.clone(), EnabledStatistics::None)
            .set_column_compression(path.clone(), compression)
            .set_column_data_page_size_limit(path, PAGE_BYTES);
    }
    properties.build()
}

/// Reads batches of at most `rows` rows, in order; no batch spans two row groups. Each thread decodes one row group at
/// a time.
///
/// # Errors
/// When the file is missing or is not Parquet.
pub fn read(
    path: &Path,
    rows: usize,
) -> Result<impl Iterator<Item = Result<RecordBatch, ParquetError>> + use<>, ParquetError> {
    let metadata = ArrowReaderMetadata::load(&disk::open(path)?, ArrowReaderOptions::new())?;
    let groups = metadata.metadata().num_row_groups();
    let path = path.to_owned();
    let decode = move |group: usize| -> Result<Vec<RecordBatch>, ParquetError> {
        // Each reader opens the file itself: clones of one handle would share its position.
        let builder = ParquetRecordBatchReaderBuilder::new_with_metadata(disk::open(&path)?, metadata.clone());
        let reader = builder.with_row_groups(vec![group]).with_batch_size(rows).build()?;
        Ok(reader.collect::<Result<_, _>>()?)
    };
    let together = rayon::current_num_threads();
    Ok((0..groups).step_by(together).flat_map(move |first| {
        let decoded: Vec<_> = (first..groups.min(first + together)).into_par_iter().map(&decode).collect();
        decoded.into_iter().flat_map(|group| match group {
            Ok(batches) => batches.into_iter().map(Ok).collect(),
            Err(error) => vec![Err(error)],
        })
    }))
}

/// Reads batches of at most `rows` rows from a recorded file, in order: what it decodes is what was written, or an
/// error.
///
/// # Errors
/// When the file is missing, or differs from its record; the error says where the damage is.
pub fn read_recorded(
    path: &Path,
    record: &FileRecord,
    rows: usize,
) -> Result<impl Iterator<Item = Result<RecordBatch, StoreError>> + use<>, StoreError> {
    let groups = read_groups(path, record, rows, |batches| batches)?;
    Ok(groups.flat_map(|group| match group {
        Ok(batches) => batches.into_iter().map(Ok).collect(),
        Err(error) => vec![Err(error)],
    }))
}

/// Schema of a file.
///
/// # Errors
/// When the file is missing or is not Parquet.
pub fn schema(path: &Path) -> Result<SchemaRef, ParquetError> {
    Ok(Arc::clone(ParquetRecordBatchReaderBuilder::try_new(disk::open(path)?)?.schema()))
}

/// Number of rows of a file, and the entries of its footer.
///
/// # Errors
/// When the file is missing or is not Parquet.
pub fn footer(path: &Path) -> Result<(u64, Vec<(String, String)>), ParquetError> {
    // Without the Arrow schema, which takes most of the time of a small file.
    let metadata = ParquetMetaDataReader::new().parse_and_finish(&disk::open(path)?)?;
    let file = metadata.file_metadata();
    let entries = file.key_value_metadata().into_iter().flatten();
    let entries = entries.filter_map(|entry| Some((entry.key.clone(), entry.value.clone()?))).collect();
    Ok((file.num_rows() as u64, entries))
}

#[cfg(test)]
mod tests;
