//! Reads a recorded table file. Each row group is read once, compared with its own digest, and decoded from that
//! memory: what is decoded is what was written.

use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use arrow_array::RecordBatch;
use bytes::{Buf, Bytes, buf};
use parquet::arrow::arrow_reader::{ArrowReaderMetadata, ArrowReaderOptions, ParquetRecordBatchReaderBuilder};
use parquet::errors::ParquetError;
use parquet::file::metadata::{ColumnChunkMetaData, RowGroupMetaData};
use parquet::file::reader::{ChunkReader, Length};
use rayon::prelude::*;

use super::{FileRecord, RowGroup};
use crate::store::Digest;
use crate::store::damage;
use crate::store::disk;
use crate::store::failure::{At, StoreError};

/// Reads the row groups of a recorded file in order, and gives what `each` makes of the batches of one, of at most
/// `rows` rows each. Each thread decodes one row group at a time, and hands it to `each` there.
///
/// # Errors
/// When the file is missing, or differs from its record; the error says where the damage is.
pub fn read_groups<T: Send, F: Fn(Vec<RecordBatch>) -> T + Send + Sync>(
    path: &Path,
    record: &FileRecord,
    rows: usize,
    each: F,
) -> Result<impl Iterator<Item = Result<T, StoreError>> + use<T, F>, StoreError> {
    let file = TableFile::open(path, record)?;
    let (count, together) = (file.groups.len(), rayon::current_num_threads());
    let read = move |group: usize| file.decode(group, rows).map(&each);
    Ok((0..count)
        .step_by(together)
        .flat_map(move |first| (first..count.min(first + together)).into_par_iter().map(&read).collect::<Vec<_>>()))
}

/// The row groups of a file whose footer is as it was written.
struct TableFile {
    path: PathBuf,
    record: FileRecord,
    /// Where each ends, and its digest unless all of the file was compared with its record.
    groups: Vec<(u64, Option<Digest>)>,
    metadata: ArrowReaderMetadata,
}

impl TableFile {
    fn open(path: &Path, record: &FileRecord) -> Result<Self, StoreError> {
        let file = damage::open_sound(path, record)?;
        let metadata = ArrowReaderMetadata::load(&file, ArrowReaderOptions::new()).at("read", path)?;
        let groups = if let Some(groups) = &record.groups {
            groups.iter().map(|RowGroup { end, digest }| (*end, Some(*digest))).collect()
        } else {
            damage::check(path, record)?;
            ends(&metadata).into_iter().map(|end| (end, None)).collect()
        };
        Ok(Self { path: path.to_owned(), record: record.clone(), groups, metadata })
    }

    fn decode(&self, group: usize, rows: usize) -> Result<Vec<RecordBatch>, StoreError> {
        let bytes = self.read(group)?;
        // The decoder sets room for a whole batch aside.
        let rows = rows.min(self.metadata.metadata().row_group(group).num_rows().max(1) as usize);
        let decode = || -> Result<Vec<RecordBatch>, ParquetError> {
            let builder = ParquetRecordBatchReaderBuilder::new_with_metadata(bytes, self.metadata.clone());
            let reader = builder.with_row_groups(vec![group]).with_batch_size(rows).build()?;
            Ok(reader.collect::<Result<_, _>>()?)
        };
        decode().at("read", &self.path)
    }

    /// The bytes of a row group, which are as they were written.
    fn read(&self, group: usize) -> Result<GroupBytes, StoreError> {
        let (end, digest) = self.groups[group];
        let start = group.checked_sub(1).map_or(0, |before| self.groups[before].0);
        let length = end.min(self.record.bytes).saturating_sub(start);
        let mut bytes = Vec::with_capacity(length as usize);
        // Each thread opens the file itself: clones of one handle would share its position.
        let mut file = disk::open(&self.path).at("read", &self.path)?;
        file.seek(SeekFrom::Start(start)).at("read", &self.path)?;
        file.take(length).read_to_end(&mut bytes).at("read", &self.path)?;
        if digest.is_some_and(|digest| digest != Digest::of_bytes(&bytes)) {
            damage::check(&self.path, &self.record)?;
            let twice = io::Error::other("what it reads differs from one time to the next");
            return Err(twice).at("read", &self.path);
        }
        Ok(GroupBytes { start, bytes: bytes.into(), file_bytes: self.record.bytes })
    }
}

/// Where the row groups of a file end.
fn ends(metadata: &ArrowReaderMetadata) -> Vec<u64> {
    let end = |group: &RowGroupMetaData| {
        group
            .columns()
            .iter()
            .map(ColumnChunkMetaData::byte_range)
            .map(|(start, bytes)| start + bytes)
            .max()
            .unwrap_or(0)
    };
    metadata.metadata().row_groups().iter().map(end).collect()
}

/// A file of which one row group is in memory.
struct GroupBytes {
    /// Place of the first of these bytes in the file.
    start: u64,
    bytes: Bytes,
    file_bytes: u64,
}

impl GroupBytes {
    fn bytes_at(&self, place: u64) -> Result<Bytes, ParquetError> {
        let at = place.checked_sub(self.start).filter(|at| *at <= self.bytes.len() as u64);
        at.map(|at| self.bytes.slice(at as usize..)).ok_or_else(outside)
    }
}

impl Length for GroupBytes {
    fn len(&self) -> u64 {
        self.file_bytes
    }
}

impl ChunkReader for GroupBytes {
    type T = buf::Reader<Bytes>;

    fn get_read(&self, start: u64) -> Result<Self::T, ParquetError> {
        Ok(self.bytes_at(start)?.reader())
    }

    fn get_bytes(&self, start: u64, length: usize) -> Result<Bytes, ParquetError> {
        let from = self.bytes_at(start)?;
        if length > from.len() { Err(outside()) } else { Ok(from.slice(..length)) }
    }
}

fn outside() -> ParquetError {
    ParquetError::General("a page lies outside its row group".to_owned())
}
