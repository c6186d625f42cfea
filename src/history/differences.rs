//! How much the values of paired rows differ, column by column.

use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::Float64Type;
use arrow_array::{Array, ArrayRef, Float64Array, RecordBatch};
use arrow_buffer::{NullBuffer, OffsetBuffer};
use arrow_cast::cast;
use arrow_schema::{DataType, Field};
use serde::Serialize;

use super::HistoryError;
use super::values;

/// Differences in one column, over the rows that both sides have.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ColumnDifference {
    /// Column; `list.field` for a field of a list's items.
    pub column: String,
    /// Unit of the numbers.
    pub unit: Option<String>,
    /// Rows with different values, or with a value on one side only.
    pub rows: u64,
    /// Rows among these with a value on one side only.
    pub one_sided: u64,
    /// Rows among these whose lists differ in length.
    pub other_length: u64,
    /// Difference B - A of two numbers that is largest in magnitude.
    pub largest: Option<f64>,
    /// Root mean square of the nonzero differences.
    pub rms: Option<f64>,
    /// The row of the largest.
    pub largest_at: Option<String>,
    /// The largest difference in standard deviations, if the table has them.
    pub largest_in_sd: Option<f64>,
    /// Root mean square in standard deviations.
    pub rms_in_sd: Option<f64>,
}

/// Running sums of differences.
#[derive(Default)]
struct Sum {
    difference: ColumnDifference,
    count: u64,
    squares: f64,
    count_in_sd: u64,
    squares_in_sd: f64,
}

/// Sums the differences of paired rows.
pub struct Differences {
    key: Vec<String>,
    /// By column, in their order.
    sums: Vec<Sum>,
    /// Pairs in which some column differs.
    pub changed: u64,
}

/// Numbers of a column, as f64.
enum Numbers {
    Flat(Float64Array),
    List(OffsetBuffer<i32>, Float64Array, Option<NullBuffer>),
}

impl Numbers {
    /// The numbers of a row; `None` where it is null.
    fn of(&self, row: usize) -> Option<&[f64]> {
        match self {
            Self::Flat(values) => values.is_valid(row).then(|| &values.values()[row..=row]),
            Self::List(offsets, values, nulls) => {
                let range = offsets[row] as usize..offsets[row + 1] as usize;
                nulls.as_ref().is_none_or(|nulls| nulls.is_valid(row)).then(|| &values.values()[range])
            }
        }
    }
}

/// A column for comparison; each field of a list of structs is a column.
struct View {
    name: String,
    unit: Option<String>,
    data_type: DataType,
    cells: Cells,
}

enum Cells {
    Numbers(Numbers),
    Other(ArrayRef),
}

impl View {
    fn all(batch: &RecordBatch) -> Result<Vec<Self>, HistoryError> {
        let mut views = Vec::new();
        for (field, column) in batch.schema().fields().iter().zip(batch.columns()) {
            views.extend(Self::of(field, column)?);
        }
        Ok(views)
    }

    fn of(field: &Field, column: &ArrayRef) -> Result<Vec<Self>, HistoryError> {
        let float = |values: &ArrayRef| -> Result<Float64Array, HistoryError> {
            Ok(cast(values, &DataType::Float64)?.as_primitive::<Float64Type>().clone())
        };
        let view = |name: String, field: &Field, cells: Cells| Self {
            name,
            unit: field.metadata().get("unit").cloned(),
            data_type: field.data_type().clone(),
            cells,
        };
        let list = |values: &ArrayRef| -> Result<Cells, HistoryError> {
            let list = column.as_list::<i32>();
            Ok(Cells::Numbers(Numbers::List(list.offsets().clone(), float(values)?, list.nulls().cloned())))
        };
        let cells = match field.data_type() {
            data_type if data_type.is_numeric() => Cells::Numbers(Numbers::Flat(float(column)?)),
            DataType::List(item) if item.data_type().is_numeric() => list(column.as_list::<i32>().values())?,
            DataType::List(item) if matches!(item.data_type(), DataType::Struct(_)) => {
                let items = column.as_list::<i32>().values().as_struct();
                let of_item = |(item, values): (&Arc<Field>, &ArrayRef)| {
                    Ok(view(format!("{}.{}", field.name(), item.name()), item, list(values)?))
                };
                return items.fields().iter().zip(items.columns()).map(of_item).collect();
            }
            _ => Cells::Other(column.clone()),
        };
        Ok(vec![view(field.name().clone(), field, cells)])
    }
}

impl Differences {
    pub fn new(key: &[&str]) -> Self {
        Self { key: key.iter().map(|name| (*name).to_owned()).collect(), sums: Vec::new(), changed: 0 }
    }

    /// Adds pairs of rows: (row of A, row of B). Columns that B lacks, or has with another type, are ignored.
    pub fn add(&mut self, a: &RecordBatch, b: &RecordBatch, pairs: &[(usize, usize)]) -> Result<(), HistoryError> {
        let (views_a, views_b) = (View::all(a)?, View::all(b)?);
        let mut changed = vec![false; pairs.len()];
        for view in views_a.iter().filter(|view| !self.key.contains(&view.name)) {
            let same = |other: &&View| other.name == view.name && other.data_type == view.data_type;
            let Some(other) = views_b.iter().find(same) else { continue };
            let sd = [Sd::of(&views_a, &view.name), Sd::of(&views_b, &view.name)];
            let place = self.sums.iter().position(|sum| sum.difference.column == view.name).unwrap_or_else(|| {
                self.sums.push(Sum::new(view));
                self.sums.len() - 1
            });
            let sum = &mut self.sums[place];
            for (&(row_a, row_b), changed) in pairs.iter().zip(&mut changed) {
                let differs = match (&view.cells, &other.cells) {
                    (Cells::Numbers(in_a), Cells::Numbers(in_b)) => {
                        let sd_of = |item| {
                            let of_side = |(sd, row): (&Option<Sd<'_>>, usize)| sd.as_ref()?.at(row, item);
                            sd.iter().zip([row_a, row_b]).find_map(of_side)
                        };
                        sum.add(in_a.of(row_a), in_b.of(row_b), sd_of, || label(a, &self.key, row_a))
                    }
                    (Cells::Other(in_a), Cells::Other(in_b)) => !is_equal(in_a, row_a, in_b, row_b),
                    _ => unreachable!("columns of one type are seen in one way"),
                };
                sum.difference.rows += u64::from(differs);
                *changed |= differs;
            }
        }
        self.changed += changed.iter().filter(|changed| **changed).count() as u64;
        Ok(())
    }

    /// Columns with differences, in order.
    pub fn finish(self) -> Vec<ColumnDifference> {
        self.sums.into_iter().filter(|sum| sum.difference.rows > 0).map(Sum::finish).collect()
    }
}

impl Sum {
    fn new(view: &View) -> Self {
        let difference =
            ColumnDifference { column: view.name.clone(), unit: view.unit.clone(), ..ColumnDifference::default() };
        Self { difference, ..Self::default() }
    }

    /// Adds the numbers of a row. Returns whether they differ.
    fn add(
        &mut self,
        a: Option<&[f64]>,
        b: Option<&[f64]>,
        sd: impl Fn(usize) -> Option<f64>,
        at: impl Fn() -> String,
    ) -> bool {
        let (a, b) = match (a, b) {
            (None, None) => return false,
            (Some(a), Some(b)) if a.len() == b.len() => (a, b),
            (a, b) => {
                let is_one_sided = a.is_none() || b.is_none();
                self.difference.one_sided += u64::from(is_one_sided);
                self.difference.other_length += u64::from(!is_one_sided);
                return true;
            }
        };
        let mut differs = false;
        for (item, (a, b)) in a.iter().zip(b).enumerate() {
            if a == b || (a.is_nan() && b.is_nan()) {
                continue;
            }
            differs = true;
            let by = b - a;
            if !by.is_finite() {
                continue;
            }
            self.count += 1;
            self.squares += by * by;
            let difference = &mut self.difference;
            if difference.largest.is_none_or(|largest: f64| by.abs() > largest.abs()) {
                (difference.largest, difference.largest_at) = (Some(by), Some(at()));
            }
            if let Some(sd) = sd(item) {
                self.count_in_sd += 1;
                self.squares_in_sd += (by / sd).powi(2);
                difference.largest_in_sd = Some(difference.largest_in_sd.unwrap_or(0.0).max(by.abs() / sd));
            }
        }
        differs
    }

    fn finish(self) -> ColumnDifference {
        let rms = |squares: f64, count: u64| (count > 0).then(|| (squares / count as f64).sqrt());
        ColumnDifference {
            rms: rms(self.squares, self.count),
            rms_in_sd: rms(self.squares_in_sd, self.count_in_sd),
            ..self.difference
        }
    }
}

/// Standard deviations of a column's numbers, if its table has them.
struct Sd<'a> {
    numbers: &'a Numbers,
    is_variance: bool,
}

impl<'a> Sd<'a> {
    /// Finds them by name: `time_sd_ps` for `time_ps`, and others.
    fn of(views: &'a [View], column: &str) -> Option<Self> {
        let numbers = |name: &str| {
            let view = views.iter().find(|view| view.name == name)?;
            if let Cells::Numbers(numbers) = &view.cells { Some(numbers) } else { None }
        };
        let (stem, unit) = column.rsplit_once('_').unwrap_or((column, ""));
        let sd_numbers = match column {
            "distance_m" => numbers("sd_m"),
            "residual_ps" | "delay_ps" => numbers("sd_ps"),
            "mean_v" => numbers("se_v"),
            "value" => numbers("sd"),
            "x_m" | "y_m" | "z_m" => numbers(&format!("cov_{stem}{stem}_m2")),
            _ => numbers(&format!("{column}_sd")).or_else(|| numbers(&format!("{stem}_sd_{unit}"))),
        };
        let is_variance = matches!(column, "x_m" | "y_m" | "z_m");
        sd_numbers.map(|numbers| Self { numbers, is_variance })
    }

    /// Standard deviation of one item of a row.
    fn at(&self, row: usize, item: usize) -> Option<f64> {
        let value = *self.numbers.of(row)?.get(item)?;
        let sd = if self.is_variance { value.sqrt() } else { value };
        (sd.is_finite() && sd > 0.0).then_some(sd)
    }
}

fn is_equal(a: &ArrayRef, row_a: usize, b: &ArrayRef, row_b: usize) -> bool {
    match (a.data_type(), a.is_null(row_a), b.is_null(row_b)) {
        (_, true, true) => true,
        (_, true, false) | (_, false, true) => false,
        (DataType::Utf8, ..) => a.as_string::<i32>().value(row_a) == b.as_string::<i32>().value(row_b),
        _ => values::cell(a, row_a) == values::cell(b, row_b),
    }
}

/// The key of a row as text: `lit 3, seen 4, rank 2`.
pub fn label(batch: &RecordBatch, key: &[String], row: usize) -> String {
    let named = key.iter().filter_map(|name| Some((name, values::cell(batch.column_by_name(name)?, row))));
    let named = named.filter(|(_, value)| !value.is_null());
    let named = named.map(|(name, value)| match value.as_str() {
        Some(text) => format!("{name} {text}"),
        None => format!("{name} {value}"),
    });
    named.collect::<Vec<_>>().join(", ")
}
