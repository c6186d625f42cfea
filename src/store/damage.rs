//! Compares a table file with its record, and locates damage: row group, column, page, and the records in it.
//!
//! The digests of its sections decide. The checksums of its pages only help to locate damage; they count only if the
//! footer's own digest is right.

use std::fmt;
use std::fs::File;
use std::io;
use std::ops::Range;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use arrow_cast::display::array_value_to_string;
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::{ArrowReaderOptions, ParquetRecordBatchReaderBuilder, RowSelection, RowSelector};
use parquet::errors::ParquetError;
use parquet::file::metadata::{PageIndexPolicy, ParquetMetaData};
use rayon::prelude::*;
use serde::Serialize;

use super::Digest;
use super::disk;
use super::failure::{At, StoreError};
use super::page_checksums;
use super::parquet::{FileRecord, RowGroup};

/// Columns that identify a record; a table has some of them.
const KEYS: [&str; 8] = ["campaign", "sensor", "lit", "seen", "shot", "rank", "patch", "file"];

/// A table file that differs from its record.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Damage {
    /// The file.
    pub file: PathBuf,
    /// Where in the file.
    #[serde(flatten)]
    pub place: Place,
}

/// Where in a file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(tag = "place", rename_all = "snake_case")]
pub enum Place {
    /// The file is missing.
    Gone,
    /// It has another length.
    Length {
        /// Recorded length in bytes.
        #[serde(rename = "written")]
        expected: u64,
        /// Bytes that are there.
        #[serde(rename = "found")]
        actual: u64,
    },
    /// In what follows the pages: indexes, footer.
    Footer {
        /// Where that begins.
        byte: u64,
    },
    /// In a page.
    Page(Box<Page>),
    /// In the headers of pages, or between pages: their own bytes are sound.
    Headers,
}

/// A page.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Page {
    /// Row group, from 0.
    pub row_group: usize,
    /// Column, with the names of what it is nested in.
    pub column: String,
    /// First byte of the page in the file.
    pub byte: u64,
    /// Its length, with its header.
    pub bytes: u64,
    /// Rows of the file that have values in it, from 0; for a dictionary all of the row group.
    pub rows: Range<u64>,
    /// The first and the last of them by their key columns, as far as those are sound.
    pub records: Option<String>,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Gone => f.write_str("it is gone"),
            Self::Length { expected, actual } => write!(f, "it has {actual} bytes instead of {expected}"),
            Self::Footer { byte } => write!(f, "in its footer, after byte {byte}"),
            Self::Headers => f.write_str("in the header of a page"),
            Self::Page(page) => {
                let Page { row_group, column, byte, rows, records, .. } = page.as_ref();
                write!(
                    f,
                    "row group {row_group}, column {column}, page at byte {byte}: rows {} to {}",
                    rows.start,
                    rows.end - 1
                )?;
                records.iter().try_for_each(|records| write!(f, " ({records})"))
            }
        }
    }
}

/// Refuses a file that is not as it was written.
///
/// # Errors
/// When it is not, with where, or cannot be read.
pub fn check(path: &Path, record: &FileRecord) -> Result<(), StoreError> {
    find(path, record)?.map_or(Ok(()), |damage| Err(StoreError::Damaged(damage)))
}

/// Opens a file whose length and footer are as they were written.
///
/// # Errors
/// When one is not, or cannot be read.
pub fn open_sound(path: &Path, record: &FileRecord) -> Result<File, StoreError> {
    let damaged = |place| Err(StoreError::Damaged(Box::new(Damage { file: path.to_owned(), place })));
    let file = match open(path, record)? {
        Ok(file) => file,
        Err(place) => return damaged(place),
    };
    let no_footer = || damaged(Place::Footer { byte: record.pages_end });
    let Some(length) = record.bytes.checked_sub(record.pages_end) else { return no_footer() };
    let mut footer = vec![0; length as usize];
    file.read_exact_at(&mut footer, record.pages_end).at("read", path)?;
    if record.footer == Digest::of_bytes(&footer) { Ok(file) } else { no_footer() }
}

/// Opens a file that is there with its length, or says which of these it lacks.
fn open(path: &Path, record: &FileRecord) -> Result<Result<File, Place>, StoreError> {
    let file = match disk::open(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Err(Place::Gone)),
        opened => opened.at("read", path)?,
    };
    let actual = file.metadata().at("read", path)?.len();
    Ok(if actual == record.bytes { Ok(file) } else { Err(Place::Length { expected: record.bytes, actual }) })
}

/// Compares a file with its record; `None` if every byte is as it was written.
///
/// # Errors
/// When it cannot be read.
pub fn find(path: &Path, record: &FileRecord) -> Result<Option<Box<Damage>>, StoreError> {
    let place = |place| Ok(Some(Box::new(Damage { file: path.to_owned(), place })));
    let mut file = match open(path, record)? {
        Ok(file) => file,
        Err(missing) => return place(missing),
    };
    let digest = match &record.groups {
        Some(groups) => FileRecord::digest_of(&sections(&file, record, groups).at("read", path)?),
        None => whole(&mut file).at("read", path)?,
    };
    if record.digest == digest {
        return Ok(None);
    }
    let bytes = disk::read(path).at("read", path)?;
    place(locate(path, &bytes, record).at("read", path)?)
}

/// Digests of the sections of a file, as its bytes are now.
fn sections(file: &File, record: &FileRecord, groups: &[RowGroup]) -> io::Result<Vec<Digest>> {
    let ends = groups.iter().map(|group| group.end);
    let ends = ends.chain(groups.is_empty().then_some(record.pages_end)).map(|end| end.min(record.bytes));
    let ends: Vec<u64> = ends.chain([record.bytes]).collect();
    let starts = std::iter::once(0).chain(ends.iter().copied());
    let sections: Vec<(u64, u64)> = starts.zip(ends.iter().copied()).collect();
    let digest = |(start, end): (u64, u64)| -> io::Result<Digest> {
        let mut bytes = vec![0; end.saturating_sub(start) as usize];
        file.read_exact_at(&mut bytes, start)?;
        Ok(Digest::of_bytes(&bytes))
    };
    sections.into_par_iter().map(digest).collect()
}

/// Digest of a whole file.
fn whole(file: &mut File) -> io::Result<Digest> {
    let mut whole = blake3::Hasher::new();
    whole.update_reader(file)?;
    Ok(whole.finalize().into())
}

/// Where the bytes of a file of the recorded length are not as they were written.
fn locate(path: &Path, bytes: &[u8], record: &FileRecord) -> Result<Place, ParquetError> {
    let pages_end = record.pages_end as usize;
    if bytes.get(pages_end..).is_none_or(|footer| record.footer != Digest::of_bytes(footer)) {
        return Ok(Place::Footer { byte: record.pages_end });
    }
    let options = ArrowReaderOptions::new().with_page_index_policy(PageIndexPolicy::Required);
    let builder = ParquetRecordBatchReaderBuilder::try_new_with_options(disk::open(path)?, options)?;
    let metadata = builder.metadata();
    let damaged: Vec<Page> = pages(metadata)
        .into_iter()
        .filter(|page| {
            !bytes.get(page.byte as usize..(page.byte + page.bytes) as usize).is_some_and(page_checksums::holds)
        })
        .collect();
    let Some(mut first) = damaged.first().cloned() else {
        return Ok(Place::Headers);
    };
    first.records = records(path, metadata, &first, &damaged);
    Ok(Place::Page(Box::new(first)))
}

/// All pages of a file, in order; dictionaries too.
fn pages(metadata: &ParquetMetaData) -> Vec<Page> {
    let mut pages = Vec::new();
    let mut first_row = 0;
    for (row_group, group) in metadata.row_groups().iter().enumerate() {
        let rows = group.num_rows() as u64;
        let index = metadata.page_index_for_row_group(row_group);
        for (c, column) in group.columns().iter().enumerate() {
            let mut page = |byte: u64, bytes: u64, rows: Range<u64>| {
                let column = column.column_path().string();
                pages.push(Page { row_group, column, byte, bytes, rows, records: None });
            };
            if let Some(dictionary) = column.dictionary_page_offset() {
                let bytes = column.data_page_offset() - dictionary;
                page(dictionary as u64, bytes as u64, first_row..first_row + rows);
            }
            let locations = index.offset_index(c).map_or(&[][..], |index| index.page_locations());
            for (i, location) in locations.iter().enumerate() {
                let end = locations.get(i + 1).map_or(rows, |next| next.first_row_index as u64);
                let rows = first_row + location.first_row_index as u64..first_row + end;
                page(location.offset as u64, location.compressed_page_size as u64, rows);
            }
        }
        first_row += rows;
    }
    pages
}

/// The first and the last record of a page, by the key columns without damaged pages.
fn records(path: &Path, metadata: &ParquetMetaData, page: &Page, damaged: &[Page]) -> Option<String> {
    let schema = metadata.file_metadata().schema_descr();
    let sound = |key: &&str| !damaged.iter().any(|page| page.column.split('.').next() == Some(*key));
    let keys: Vec<&str> = KEYS.into_iter().filter(sound).collect();
    let record = |row: u64| -> Option<String> {
        let selection = RowSelection::from(vec![RowSelector::skip(row as usize), RowSelector::select(1)]);
        let mask = ProjectionMask::columns(schema, keys.iter().copied());
        let builder = ParquetRecordBatchReaderBuilder::try_new(disk::open(path).ok()?).ok()?;
        let mut batches = builder.with_projection(mask).with_row_selection(selection).build().ok()?;
        let batch = batches.next()?.ok()?;
        let schema = batch.schema();
        let keys = schema.fields().iter().zip(batch.columns()).filter(|(_, column)| column.is_valid(0));
        let words = keys.map(|(field, column)| {
            array_value_to_string(column, 0).map(|value| format!("{} {value}", field.name())).ok()
        });
        Some(words.collect::<Option<Vec<_>>>()?.join(", ")).filter(|text| !text.is_empty())
    };
    let (first, last) = (record(page.rows.start)?, record(page.rows.end.checked_sub(1)?)?);
    Some(if first == last { first } else { format!("{first} to {last}") })
}
