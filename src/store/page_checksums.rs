//! Checksums of pages as the Parquet format defines them: the page header holds the CRC-32 of the page's bytes, for any
//! reader.
//!
//! The Parquet crate checks them where they exist, but writes none. Therefore this file keeps the pages of a column
//! chunk as the crate makes them. It adds the checksum to each header before the chunk enters the file.

use std::collections::VecDeque;
use std::io::{self, Read};
use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};

use bytes::{Buf, Bytes};
use parquet::arrow::arrow_writer::{PageKey, PageStore, PageStoreArgs, PageStoreFactory};
use parquet::column::writer::ColumnCloseResult;
use parquet::errors::{ParquetError, Result};
use parquet::file::reader::{ChunkReader, Length};

/// Start of an i32 field that directly follows the previous field, in Thrift's compact protocol.
const NEXT_I32: u8 = 0x15;
/// Fields of a page header before its checksum: type, uncompressed size, compressed size.
const FIELDS_BEFORE: usize = 3;
/// Type of a dictionary page, zigzag.
const DICTIONARY_PAGE: u32 = 4;

/// Header and bytes of each page of a chunk, as the crate makes them.
type Pages = Arc<Mutex<Vec<Bytes>>>;

/// Keeps the pages of every column chunk.
#[derive(Debug, Default)]
pub struct ChunkPages(Mutex<Vec<Pages>>);

impl ChunkPages {
    /// Pages of the chunks that were begun since the last call, in order.
    pub fn take(&self) -> Vec<Pages> {
        std::mem::take(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl PageStoreFactory for ChunkPages {
    fn create(&self, _: &PageStoreArgs<'_>) -> Result<Box<dyn PageStore>> {
        let pages = Pages::default();
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(pages.clone());
        Ok(Box::new(Kept(pages)))
    }
}

struct Kept(Pages);

impl PageStore for Kept {
    fn put(&mut self, value: Bytes) -> Result<PageKey> {
        let mut pages = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        pages.push(value);
        Ok(PageKey::new(pages.len() as u64 - 1))
    }

    fn take(&mut self, key: PageKey) -> Result<Bytes> {
        Ok(self.0.lock().unwrap_or_else(PoisonError::into_inner)[key.get() as usize].clone())
    }

    fn memory_size(&self) -> usize {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).iter().map(Bytes::len).sum()
    }
}

/// A column chunk, its pages where they were made: in one block they would be copied once more.
pub struct Chunk {
    pieces: Vec<Bytes>,
    bytes: u64,
}

impl Length for Chunk {
    fn len(&self) -> u64 {
        self.bytes
    }
}

impl ChunkReader for Chunk {
    type T = PiecesReader;

    fn get_read(&self, start: u64) -> Result<PiecesReader> {
        let mut reader = PiecesReader(self.pieces.clone().into());
        reader.skip(start as usize);
        Ok(reader)
    }

    fn get_bytes(&self, start: u64, length: usize) -> Result<Bytes> {
        let mut bytes = vec![0; length];
        self.get_read(start)?.read_exact(&mut bytes)?;
        Ok(bytes.into())
    }
}

/// Reads piece after piece.
pub struct PiecesReader(VecDeque<Bytes>);

impl PiecesReader {
    fn skip(&mut self, mut bytes: usize) {
        while let Some(first) = self.0.front_mut().filter(|_| bytes > 0) {
            let step = bytes.min(first.len());
            first.advance(step);
            bytes -= step;
            if first.is_empty() {
                self.0.pop_front();
            }
        }
    }
}

impl Read for PiecesReader {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let Some(first) = self.0.front() else { return Ok(0) };
        let count = first.len().min(buffer.len());
        buffer[..count].copy_from_slice(&first[..count]);
        self.skip(count);
        Ok(count)
    }
}

/// The chunk's bytes with checksums, its dictionary first, and the adjusted description for the row group.
///
/// # Errors
/// When a page header differs from the form that the crate writes.
pub fn with_checksums(pages: &Pages, close: &ColumnCloseResult) -> Result<(Chunk, ColumnCloseResult)> {
    let pages = pages.lock().unwrap_or_else(PoisonError::into_inner);
    let (mut dictionary, mut data, mut sizes) = (Vec::new(), Vec::new(), Vec::new());
    let mut grown = 0;
    for page in pages.chunks_exact(2) {
        let (header, body) = (&page[0], &page[1]);
        let checked = insert(header, crc32fast::hash(body))?;
        grown += (checked.len() - header.len()) as i64;
        if Fields::of(header)?.kind == DICTIONARY_PAGE {
            dictionary.push((checked, body));
        } else {
            sizes.push(checked.len() + body.len());
            data.push((checked, body));
        }
    }
    let length = |pages: &[(Vec<u8>, &Bytes)]| pages.iter().map(|(header, body)| header.len() + body.len()).sum();
    let (dictionary_bytes, data_bytes): (usize, usize) = (length(&dictionary), length(&data));
    let pieces = dictionary.into_iter().chain(data).flat_map(|(header, body)| [header.into(), body.clone()]);
    // A page of nulls has an empty body.
    let pieces = pieces.filter(|piece| !piece.is_empty()).collect();
    let mut close = close.clone();
    close.bytes_written = close.bytes_written.saturating_add_signed(grown);
    let (compressed, uncompressed) = (close.metadata.compressed_size(), close.metadata.uncompressed_size());
    close.metadata = close
        .metadata
        .into_builder()
        .set_total_compressed_size(compressed + grown)
        .set_total_uncompressed_size(uncompressed + grown)
        .set_dictionary_page_offset((dictionary_bytes > 0).then_some(0))
        .set_data_page_offset(dictionary_bytes as i64)
        .build()?;
    let mut offset = dictionary_bytes as i64;
    for (location, size) in close.offset_index.iter_mut().flat_map(|index| &mut index.page_locations).zip(sizes) {
        (location.offset, location.compressed_page_size) = (offset, size as i32);
        offset += size as i64;
    }
    Ok((Chunk { pieces, bytes: (dictionary_bytes + data_bytes) as u64 }, close))
}

/// Whether a page has the checksum in its header. `page` is header and bytes.
pub fn holds(page: &[u8]) -> bool {
    let Ok(fields) = Fields::of(page) else {
        return false;
    };
    let body = page.len().checked_sub(fields.compressed as usize).filter(|start| *start >= fields.end);
    body.is_some_and(|start| fields.checksum == Some(crc32fast::hash(&page[start..])))
}

/// The first fields of a page header.
struct Fields {
    /// Type of the page, zigzag.
    kind: u32,
    /// Bytes of the page after its header.
    compressed: u32,
    /// Where the checksum is, or would be.
    place: Range<usize>,
    checksum: Option<u32>,
    /// End of these fields.
    end: usize,
}

impl Fields {
    fn of(header: &[u8]) -> Result<Self> {
        let mut at = 0;
        let mut values = [0; FIELDS_BEFORE];
        for value in &mut values {
            *value = next_i32(header, &mut at).ok_or_else(unknown_form)?;
        }
        let start = at;
        let checksum = next_i32(header, &mut at).map(unzigzag);
        Ok(Self { kind: values[0], compressed: unzigzag(values[2]), place: start..at, checksum, end: at })
    }
}

/// An i32 field that directly follows the previous one, undecoded. Where there is none, `at` does not move.
fn next_i32(bytes: &[u8], at: &mut usize) -> Option<u32> {
    if bytes.get(*at) != Some(&NEXT_I32) {
        return None;
    }
    let mut value = 0_u64;
    for (i, byte) in bytes.get(*at + 1..)?.iter().take(5).enumerate() {
        value |= u64::from(byte & 0x7f) << (7 * i);
        if byte & 0x80 == 0 {
            *at += i + 2;
            return u32::try_from(value).ok();
        }
    }
    None
}

fn unzigzag(value: u32) -> u32 {
    (value >> 1) ^ (value & 1).wrapping_neg()
}

/// Inserts the checksum into the header; the number of the following field then counts from the checksum's.
fn insert(header: &[u8], checksum: u32) -> Result<Vec<u8>> {
    let fields = Fields::of(header)?;
    let next =
        header.get(fields.end).filter(|next| fields.place.is_empty() && **next >= 0x20).ok_or_else(unknown_form)?;
    let mut out = header[..fields.end].to_vec();
    out.push(NEXT_I32);
    let signed = checksum as i32;
    let mut value = ((signed << 1) ^ (signed >> 31)) as u32;
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.extend([value as u8, next - 0x10]);
    out.extend(&header[fields.end + 1..]);
    Ok(out)
}

fn unknown_form() -> ParquetError {
    ParquetError::General("a page header has not the form that this program writes".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Type 0, sizes 10 and 7, then field 5.
    const HEADER: [u8; 9] = [0x15, 0x00, 0x15, 0x14, 0x15, 0x0e, 0x2c, 0x15, 0x00];

    #[test]
    fn a_checksum_is_found_where_it_was_put() {
        for checksum in [0, 1, 63, 64, 0x7fff_ffff, 0x8000_0000, u32::MAX, 0xdead_beef] {
            let checked = insert(&HEADER, checksum).unwrap();
            let fields = Fields::of(&checked).unwrap();
            assert_eq!((fields.checksum, fields.compressed, fields.kind), (Some(checksum), 7, 0));
            assert_eq!(checked[fields.end..], [0x1c, 0x15, 0x00]);
            assert!(insert(&checked, checksum).is_err(), "it has one");
        }
    }

    #[test]
    fn a_flipped_bit_of_a_page_or_of_its_checksum_is_seen() {
        let body = *b"echoes!";
        let page = [insert(&HEADER, crc32fast::hash(&body)).unwrap(), body.to_vec()].concat();
        assert!(holds(&page));
        let header_after = 3..6; // of the field behind the checksum: not covered
        let behind = page.len() - body.len();
        for bit in 0..8 * page.len() {
            let mut flipped = page.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            let uncovered = bit / 8 < 4 || (behind - header_after.len()..behind).contains(&(bit / 8));
            assert!(uncovered || !holds(&flipped), "bit {bit}");
        }
        assert!(!holds(&[]) && !holds(&page[..5]));
    }
}
