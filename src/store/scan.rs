//! Some columns of a Parquet file, in batches whose size follows from that of the rows.

use std::fs::File;
use std::path::Path;

use arrow::array::RecordBatch;
use arrow::datatypes::SchemaRef;
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use parquet::errors::ParquetError;

use super::failure::{At, StoreError};

/// Bytes of a batch, about.
const BATCH_BYTES: i64 = 4 << 20;
/// Rows of a batch at most.
const BATCH_ROWS: i64 = 1 << 13;

/// Batches of a file with the columns that `wanted` names, in the file's order; columns that it does not have are left out.
///
/// # Errors
/// When the file is missing or is not Parquet.
pub fn scan<F: Fn(&str) -> bool>(
    path: &Path,
    wanted: F,
) -> Result<impl Iterator<Item = Result<RecordBatch, StoreError>> + use<F>, StoreError> {
    let builder = ParquetRecordBatchReaderBuilder::try_new(File::open(path).at("read", path)?).at("read", path)?;
    let fields = builder.schema().fields().iter().enumerate();
    let roots: Vec<usize> = fields.filter(|(_, field)| wanted(field.name())).map(|(i, _)| i).collect();
    let mask = ProjectionMask::roots(builder.parquet_schema(), roots);
    let (mut bytes, mut rows) = (0, 0);
    for group in builder.metadata().row_groups() {
        let columns = group.columns().iter().enumerate().filter(|(i, _)| mask.leaf_included(*i));
        bytes += columns.map(|(_, column)| column.uncompressed_size()).sum::<i64>();
        rows += group.num_rows();
    }
    let batch_rows = (BATCH_BYTES / (bytes / rows.max(1)).max(1)).clamp(1, BATCH_ROWS) as usize;
    let reader = builder.with_projection(mask).with_batch_size(batch_rows).build().at("read", path)?;
    let path = path.to_owned();
    Ok(reader.map(move |batch| batch.map_err(ParquetError::from).at("read", &path)))
}

/// Schema of a file.
///
/// # Errors
/// When the file is missing or is not Parquet.
pub fn schema(path: &Path) -> Result<SchemaRef, StoreError> {
    super::parquet::describe(path).map(|(schema, ..)| schema).at("read", path)
}

/// Rows of a file.
///
/// # Errors
/// When the file is missing or is not Parquet.
pub fn rows(path: &Path) -> Result<u64, StoreError> {
    super::parquet::describe(path).map(|(_, rows, _)| rows).at("read", path)
}
