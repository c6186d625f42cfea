//! Reads some columns of a Parquet file, in batches whose size follows from that of the rows.

use std::collections::BTreeSet;
use std::path::Path;

use arrow_array::RecordBatch;
use arrow_schema::SchemaRef;
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use parquet::errors::ParquetError;
use parquet::file::metadata::RowGroupMetaData;
use parquet::file::statistics::Statistics;

use super::damage;
use super::disk;
use super::failure::{At, StoreError};
use super::views::on_record;

/// Approximate bytes of a batch.
const BATCH_BYTES: i64 = 4 << 20;
/// Most rows of a batch.
const BATCH_ROWS: i64 = 1 << 13;

/// Batches of a file with the columns that `wanted` accepts, in the file's order; missing columns are omitted.
///
/// # Errors
/// When the file is missing or is not Parquet.
pub fn scan<F: Fn(&str) -> bool>(
    path: &Path,
    wanted: F,
) -> Result<impl Iterator<Item = Result<RecordBatch, StoreError>> + use<F>, StoreError> {
    scan_near(path, wanted, &[])
}

/// Batches without row groups in which no row can have one of these numbers in these columns. Other rows may be
/// included.
///
/// # Errors
/// When the file is missing or is not Parquet.
pub fn scan_near<F: Fn(&str) -> bool>(
    path: &Path,
    wanted: F,
    numbers: &[(&str, &BTreeSet<i32>)],
) -> Result<impl Iterator<Item = Result<RecordBatch, StoreError>> + use<F>, StoreError> {
    check(path)?;
    let builder = ParquetRecordBatchReaderBuilder::try_new(disk::open(path).at("read", path)?).at("read", path)?;
    let fields = builder.schema().fields().iter().enumerate();
    let roots: Vec<usize> = fields.filter(|(_, field)| wanted(field.name())).map(|(i, _)| i).collect();
    let mask = ProjectionMask::roots(builder.parquet_schema(), roots);
    let (mut bytes, mut rows, mut near) = (0, 0, Vec::new());
    for (i, group) in builder.metadata().row_groups().iter().enumerate() {
        if numbers.iter().all(|(column, numbers)| may_hold(group, column, numbers)) {
            near.push(i);
        }
        let columns = group.columns().iter().enumerate().filter(|(i, _)| mask.leaf_included(*i));
        bytes += columns.map(|(_, column)| column.uncompressed_size()).sum::<i64>();
        rows += group.num_rows();
    }
    let batch_rows = (BATCH_BYTES / (bytes / rows.max(1)).max(1)).clamp(1, BATCH_ROWS) as usize;
    let reader =
        builder.with_projection(mask).with_row_groups(near).with_batch_size(batch_rows).build().at("read", path)?;
    let path = path.to_owned();
    Ok(reader.map(move |batch| batch.map_err(ParquetError::from).at("read", &path)))
}

/// Checks a file of a view against its record. Other files have none.
fn check(path: &Path) -> Result<(), StoreError> {
    on_record(path)?.map_or(Ok(()), |record| damage::check(path, &record))
}

/// Whether a column of a row group may hold one of these numbers, by its statistics.
fn may_hold(group: &RowGroupMetaData, column: &str, numbers: &BTreeSet<i32>) -> bool {
    let column = group.columns().iter().find(|chunk| chunk.column_path().string() == column);
    match column.and_then(|column| column.statistics()) {
        Some(Statistics::Int32(of)) => match (of.min_opt(), of.max_opt()) {
            (Some(least), Some(most)) => numbers.range(least..=most).next().is_some(),
            _ => true,
        },
        _ => true,
    }
}

/// Schema of a file.
///
/// # Errors
/// When the file is missing or is not Parquet.
pub fn schema(path: &Path) -> Result<SchemaRef, StoreError> {
    check(path)?;
    super::parquet::schema(path).at("read", path)
}

/// Rows of a file.
///
/// # Errors
/// When the file is missing or is not Parquet.
pub fn rows(path: &Path) -> Result<u64, StoreError> {
    check(path)?;
    super::parquet::footer(path).map(|(rows, _)| rows).at("read", path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::TableWriter;
    use crate::tables::{Distance, Row};

    #[test]
    fn columns_and_row_groups_that_are_not_wanted_are_left_out() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("distances.parquet");
        let distance = |a: i32| Distance { a, b: a + 1, distance_m: 1.0, sd_m: 0.1, bounces: 2, onsets: 4 };
        let all: Vec<Distance> = (0..200_000).map(distance).collect();
        let mut writer = TableWriter::create(&path, &Distance::schema()).unwrap();
        writer.write(&Distance::to_batch(&all)).unwrap();
        writer.finish(&[]).unwrap();
        let numbers = BTreeSet::from([70_000, 70_001]);
        let batches: Vec<RecordBatch> =
            scan_near(&path, |name| name != "sd_m", &[("a", &numbers)]).unwrap().map(Result::unwrap).collect();
        assert!(batches.iter().all(|batch| batch.num_columns() == 5 && batch.column_by_name("sd_m").is_none()));
        assert_eq!(batches.iter().map(RecordBatch::num_rows).sum::<usize>(), 1 << 16, "the second row group");
        let whole = scan(&path, |_| true).unwrap().flat_map(|batch| Distance::rows(&batch.unwrap()).unwrap());
        assert!(whole.eq(all));
        assert_eq!(rows(&path).unwrap(), 200_000);
    }
}
