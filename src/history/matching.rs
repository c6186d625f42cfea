//! Pairs rows of two tables that have the same key, while both are read in parallel.
//!
//! Rows wait for their partner in memory, without raw codes, until the other side reaches it. Tables in equal order
//! need a few megabytes, whatever their size. Each round reads as many new bytes as are waiting, so that tables in very
//! different orders cost memory, but each row is copied only a few times.

use std::collections::{HashMap, VecDeque};
use std::path::PathBuf;
use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::{ArrayRef, RecordBatch, StringArray, UInt64Array};
use arrow_row::{RowConverter, SortField};
use arrow_schema::{DataType, Field, Schema};
use arrow_select::concat::concat_batches;
use arrow_select::take::take_record_batch;

use super::HistoryError;
use crate::store::{Digest, StoreError, scan};

/// Least bytes that a round reads of each side.
const ROUND_BYTES: usize = 8 << 20;

/// One result of a round.
pub enum Match<'a> {
    /// Rows of A and B with equal keys.
    Pairs {
        a: &'a RecordBatch,
        b: &'a RecordBatch,
        /// Row of A, row of B.
        pairs: &'a [(usize, usize)],
    },
    /// Rows that only A has.
    OnlyA(&'a RecordBatch),
    /// Rows that only B has.
    OnlyB(&'a RecordBatch),
}

/// Reads two tables with these key columns, and passes on the matches. Equal keys within one side are paired in order.
pub fn match_rows(
    a: Vec<PathBuf>,
    b: Vec<PathBuf>,
    key: &[&str],
    mut emit: impl FnMut(Match<'_>) -> Result<(), HistoryError>,
) -> Result<(), HistoryError> {
    let (mut a, mut b) = (Stream::new(a), Stream::new(b));
    loop {
        let grown = [a.read()?, b.read()?];
        if let (Some(rows_a), Some(rows_b)) = (&a.waiting, &b.waiting) {
            let pairs = pair(rows_a, rows_b, key)?;
            if !pairs.is_empty() {
                emit(Match::Pairs { a: rows_a, b: rows_b, pairs: &pairs })?;
            }
            let (of_a, of_b): (Vec<usize>, Vec<usize>) = pairs.into_iter().unzip();
            a.drop_rows(of_a)?;
            b.drop_rows(of_b)?;
        }
        if grown == [false, false] {
            break;
        }
    }
    a.waiting.as_ref().map_or(Ok(()), |rows| emit(Match::OnlyA(rows)))?;
    b.waiting.as_ref().map_or(Ok(()), |rows| emit(Match::OnlyB(rows)))
}

/// One side, as far as it has been read.
struct Stream {
    files: VecDeque<PathBuf>,
    batches: Option<Box<dyn Iterator<Item = Result<RecordBatch, StoreError>>>>,
    /// Rows without a partner so far.
    waiting: Option<RecordBatch>,
}

impl Stream {
    fn new(files: Vec<PathBuf>) -> Self {
        Self { files: files.into(), batches: None, waiting: None }
    }

    fn next(&mut self) -> Result<Option<RecordBatch>, HistoryError> {
        loop {
            if let Some(batch) = self.batches.as_mut().and_then(Iterator::next) {
                return Ok(Some(without_codes(&batch?)?));
            }
            let Some(file) = self.files.pop_front() else { return Ok(None) };
            self.batches = Some(Box::new(scan::scan(&file, |_| true)?));
        }
    }

    /// Reads on. Returns whether there was anything.
    fn read(&mut self) -> Result<bool, HistoryError> {
        let most = self.waiting.as_ref().map_or(0, RecordBatch::get_array_memory_size).max(ROUND_BYTES);
        let mut batches: Vec<RecordBatch> = self.waiting.take().into_iter().collect();
        let (mut bytes, mut grown) = (0, false);
        while bytes < most {
            let Some(batch) = self.next()? else { break };
            bytes += batch.get_array_memory_size();
            grown = true;
            batches.push(batch);
        }
        if let Some(first) = batches.first() {
            self.waiting = Some(concat_batches(&first.schema(), &batches)?).filter(|rows| rows.num_rows() > 0);
        }
        Ok(grown)
    }

    fn drop_rows(&mut self, rows: Vec<usize>) -> Result<(), HistoryError> {
        let Some(waiting) = &self.waiting else { return Ok(()) };
        let mut stays = vec![true; waiting.num_rows()];
        rows.into_iter().for_each(|row| stays[row] = false);
        let rest: UInt64Array = (0..stays.len()).filter(|&row| stays[row]).map(|row| row as u64).collect();
        let rest = if rest.is_empty() { None } else { Some(take_record_batch(waiting, &rest)?) };
        self.waiting = rest;
        Ok(())
    }
}

/// The batch with a digest in place of each cell of bytes.
fn without_codes(batch: &RecordBatch) -> Result<RecordBatch, HistoryError> {
    let schema = batch.schema();
    let is_bytes = |field: &Field| field.data_type() == &DataType::BinaryView;
    if !schema.fields().iter().any(|field| is_bytes(field)) {
        return Ok(batch.clone());
    }
    let field = |field: &Arc<Field>| {
        if is_bytes(field) { field.as_ref().clone().with_data_type(DataType::Utf8) } else { field.as_ref().clone() }
    };
    let fields: Vec<Field> = schema.fields().iter().map(field).collect();
    let column = |column: &ArrayRef| match column.data_type() {
        DataType::BinaryView => {
            let digests =
                column.as_binary_view().iter().map(|codes| codes.map(|codes| Digest::of_bytes(codes).short()));
            Arc::new(digests.collect::<StringArray>())
        }
        _ => column.clone(),
    };
    let columns = batch.columns().iter().map(column).collect();
    Ok(RecordBatch::try_new(Arc::new(Schema::new(fields)), columns)?)
}

/// Pairs of rows with equal keys, in the order of A.
fn pair(a: &RecordBatch, b: &RecordBatch, key: &[&str]) -> Result<Vec<(usize, usize)>, HistoryError> {
    let columns = |batch: &RecordBatch| -> Vec<ArrayRef> {
        key.iter().filter_map(|name| batch.column_by_name(name).cloned()).collect()
    };
    let (columns_a, columns_b) = (columns(a), columns(b));
    let fields = columns_a.iter().map(|column| SortField::new(column.data_type().clone())).collect();
    let converter = RowConverter::new(fields)?;
    let (keys_a, keys_b) = (converter.convert_columns(&columns_a)?, converter.convert_columns(&columns_b)?);
    let mut rows: HashMap<_, VecDeque<usize>> = HashMap::new();
    for (i, key) in keys_b.iter().enumerate() {
        rows.entry(key).or_default().push_back(i);
    }
    let partner = |(i, key)| rows.get_mut(&key).and_then(VecDeque::pop_front).map(|j| (i, j));
    Ok(keys_a.iter().enumerate().filter_map(partner).collect())
}
