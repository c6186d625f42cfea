//! How a row becomes Arrow columns and back. [`table!`](crate::table) declares each table once; its schema, writer,
//! reader and published contract follow from that declaration.
//!
//! A column's unit is the suffix of its name; its meaning is the doc comment of its field. Field metadata hold both.

use std::collections::HashMap;
use std::sync::Arc;

use arrow_array::Array;
use arrow_array::RecordBatch;
use arrow_schema::{Field, Schema, SchemaRef};
use thiserror::Error;

use super::cell::Cell;

/// A table lacks the columns that its name implies.
#[derive(Debug, Error)]
pub enum SchemaError {
    /// A column is missing.
    #[error("table `{table}` has no column `{column}`; see `periscope schema {table}`")]
    Missing {
        /// Table.
        table: &'static str,
        /// Column.
        column: &'static str,
    },
    /// A column has another type.
    #[error("column `{column}` of table `{table}` is {actual}, not {expected}; see `periscope schema {table}`")]
    Type {
        /// Table.
        table: &'static str,
        /// Column.
        column: &'static str,
        /// Its type in the table.
        actual: String,
        /// Its declared type.
        expected: String,
    },
    /// A column that must not be null has nulls.
    #[error(
        "column `{column}` of table `{table}` has nulls, which its schema does not allow; see `periscope schema {table}`"
    )]
    Null {
        /// Table.
        table: &'static str,
        /// Column.
        column: &'static str,
    },
}

/// One row of a table, declared with [`table!`](crate::table).
pub trait Row: Sized + Clone + Send + Sync + 'static {
    /// Name of the table.
    const TABLE: &'static str;
    /// The table's columns as typed Arrow arrays: the way to read many rows without making a [`Row`] of each.
    type Columns: Send + Sync;
    /// Arrow schema with units and meanings as field metadata.
    fn schema() -> SchemaRef;
    /// Makes one batch of rows. A row that is listed several times is not copied first.
    fn to_batch_of<'a>(rows: impl Iterator<Item = &'a Self> + Clone) -> RecordBatch;
    /// One batch of so many rows like this one.
    fn repeat(&self, rows: usize) -> RecordBatch;
    /// Typed view of a batch, without copying.
    ///
    /// # Errors
    /// When a column is missing, has another type, or has nulls where its schema allows none.
    fn columns(batch: &RecordBatch) -> Result<Self::Columns, SchemaError>;
    /// Row `i` of a view. Its waveforms share the batch's buffers.
    fn read(columns: &Self::Columns, i: usize) -> Self;

    /// Rows as one batch.
    fn to_batch(rows: &[Self]) -> RecordBatch {
        Self::to_batch_of(rows.iter())
    }

    /// All rows of a batch.
    ///
    /// # Errors
    /// As [`Row::columns`].
    fn rows(batch: &RecordBatch) -> Result<Vec<Self>, SchemaError> {
        let columns = Self::columns(batch)?;
        Ok((0..batch.num_rows()).map(|i| Self::read(&columns, i)).collect())
    }
}

/// Units that a column name can end in, longest first, and how they are printed.
const UNITS: [(&str, &str); 10] = [
    ("_m2", "m^2"),
    ("_ps2", "ps^2"),
    ("_v_ps", "V ps"),
    ("_ps", "ps"),
    ("_m", "m"),
    ("_v", "V"),
    ("_w", "W"),
    ("_s", "s"),
    ("_rad", "rad"),
    ("_bytes", "B"),
];

/// Unit of a column, from the suffix of its name.
#[must_use]
pub fn unit_of(column: &str) -> Option<&'static str> {
    UNITS.iter().find(|(suffix, _)| column.ends_with(suffix)).map(|(_, unit)| *unit)
}

/// Schema field of a column of cell type `C`.
#[must_use]
pub fn field<C: Cell>(name: &str, meaning: &str) -> Field {
    let mut metadata = HashMap::from([("meaning".to_owned(), meaning.trim().to_owned())]);
    if let Some(unit) = unit_of(name) {
        metadata.insert("unit".to_owned(), unit.to_owned());
    }
    Field::new(name, C::data_type(), C::NULLABLE).with_metadata(metadata)
}

/// Typed array of one column of a batch.
///
/// # Errors
/// When the column is missing, has another type, or has nulls where its schema allows none.
pub fn column<C: Cell>(
    batch: &RecordBatch,
    table: &'static str,
    column: &'static str,
) -> Result<C::Array, SchemaError> {
    let array = batch.column_by_name(column).ok_or(SchemaError::Missing { table, column })?;
    let typed =
        array.as_any().downcast_ref::<C::Array>().filter(|_| array.data_type().equals_datatype(&C::data_type()));
    let typed = typed.ok_or_else(|| SchemaError::Type {
        table,
        column,
        actual: array.data_type().to_string(),
        expected: C::data_type().to_string(),
    })?;
    if !C::NULLABLE && typed.null_count() > 0 {
        return Err(SchemaError::Null { table, column });
    }
    Ok(typed.clone())
}

/// Schema of a table: fields, and the table's name and meaning as metadata.
#[must_use]
pub fn table_schema(table: &str, meaning: &str, fields: Vec<Field>) -> SchemaRef {
    let metadata =
        HashMap::from([("table".to_owned(), table.to_owned()), ("meaning".to_owned(), meaning.trim().to_owned())]);
    Arc::new(Schema::new_with_metadata(fields, metadata))
}

/// Declares a table: its row type, the typed view of its columns, and through them its Arrow schema, reader and writer.
/// A default row is null, zero or empty in every cell. Stages name the cells that they fill in, and take the rest from
/// it only where a cell that nothing is known of is the point.
///
/// ```
/// use periscope::tables::{Name, Row};
/// periscope::table! {
///     /// Bounces seen.
///     "bounces": Bounce, BounceColumns {
///         /// Sensor that saw it.
///         sensor: Name,
///         /// When it arrived.
///         time_ps: f64,
///     }
/// }
/// let batch = Bounce::to_batch(&[Bounce { sensor: "s1".into(), time_ps: 12.5 }]);
/// assert_eq!(batch.schema().field(1).metadata()["unit"], "ps");
/// assert_eq!(Bounce::rows(&batch).unwrap()[0].time_ps, 12.5);
/// ```
#[macro_export]
macro_rules! table {
    ($(#[doc = $meaning:literal])+ $table:literal : $row:ident, $columns:ident { $($(#[doc = $doc:literal])+ $name:ident : $cell:ty,)+ }) => {
        $(#[doc = $meaning])+
        #[derive(Clone, Debug, Default, PartialEq)]
        pub struct $row { $($(#[doc = $doc])+ pub $name: $cell,)+ }

        #[doc = concat!("Columns of table `", $table, "` as typed Arrow arrays.")]
        #[derive(Clone, Debug)]
        pub struct $columns { $($(#[doc = $doc])+ pub $name: <$cell as $crate::tables::cell::Cell>::Array,)+ }

        impl $crate::tables::row::Row for $row {
            const TABLE: &'static str = $table;
            type Columns = $columns;

            fn schema() -> ::arrow_schema::SchemaRef {
                // Built once, since every batch of rows needs it.
                static SCHEMA: ::std::sync::LazyLock<::arrow_schema::SchemaRef> = ::std::sync::LazyLock::new(|| {
                    $crate::tables::row::table_schema(
                        $table,
                        concat!($($meaning),+),
                        vec![$($crate::tables::row::field::<$cell>(stringify!($name), concat!($($doc),+))),+],
                    )
                });
                SCHEMA.clone()
            }

            fn to_batch_of<'a>(rows: impl Iterator<Item = &'a Self> + Clone) -> ::arrow_array::RecordBatch {
                let columns: Vec<::arrow_array::ArrayRef> =
                    vec![$(<$cell as $crate::tables::cell::Cell>::build(rows.clone().map(|row| &row.$name))),+];
                ::arrow_array::RecordBatch::try_new(Self::schema(), columns).expect("columns are built from their own schema")
            }

            fn repeat(&self, rows: usize) -> ::arrow_array::RecordBatch {
                let columns: Vec<::arrow_array::ArrayRef> =
                    vec![$(<$cell as $crate::tables::cell::Cell>::repeat(&self.$name, rows)),+];
                ::arrow_array::RecordBatch::try_new(Self::schema(), columns).expect("columns are built from their own schema")
            }

            fn columns(batch: &::arrow_array::RecordBatch) -> Result<$columns, $crate::tables::row::SchemaError> {
                Ok($columns { $($name: $crate::tables::row::column::<$cell>(batch, $table, stringify!($name))?,)+ })
            }

            fn read(columns: &$columns, i: usize) -> Self {
                Self { $($name: <$cell as $crate::tables::cell::Cell>::get(&columns.$name, i),)+ }
            }
        }
    };
}
