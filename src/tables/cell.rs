//! Types of columns: numbers, texts, lists, codes of a record and samples of a waveform. The last two share their
//! buffers with the table.

use std::iter::repeat_n;
use std::ops::Deref;
use std::sync::Arc;

use arrow_array::builder::BinaryViewBuilder;
use arrow_array::cast::AsArray;
use arrow_array::types::{Float32Type, Float64Type, Int32Type, Int64Type};
use arrow_array::{
    Array, ArrayRef, BinaryViewArray, BooleanArray, Float32Array, Float64Array, Int32Array, Int64Array, ListArray,
    StringArray,
};
use arrow_buffer::{Buffer, OffsetBuffer, ScalarBuffer};
use arrow_schema::{DataType, Field};

/// A shared, immutable text: names of campaigns, sensors, files.
pub type Name = Arc<str>;

/// A Rust type of a column's cells.
pub trait Cell: Sized {
    /// The Arrow array of the column.
    type Array: Array + Clone + 'static;
    /// Whether the column may hold nulls.
    const NULLABLE: bool;
    /// Arrow type of the column.
    fn data_type() -> DataType;
    /// The column of these cells.
    fn build<'a>(cells: impl Iterator<Item = &'a Self>) -> ArrayRef
    where
        Self: 'a;
    /// The column of so many cells like this one.
    fn repeat(&self, rows: usize) -> ArrayRef {
        Self::build(repeat_n(self, rows))
    }
    /// Cell `i`.
    fn get(array: &Self::Array, i: usize) -> Self;
}

macro_rules! primitive_cell {
    ($($native:ty, $array:ty, $data_type:expr;)*) => {$(
        impl Cell for $native {
            type Array = $array;
            const NULLABLE: bool = false;
            fn data_type() -> DataType { $data_type }
            fn build<'a>(cells: impl Iterator<Item = &'a Self>) -> ArrayRef {
                Arc::new(<$array>::from(cells.copied().collect::<Vec<_>>()))
            }
            fn repeat(&self, rows: usize) -> ArrayRef { Arc::new(<$array>::from(vec![*self; rows])) }
            fn get(array: &Self::Array, i: usize) -> Self { array.value(i) }
        }
        impl Cell for Option<$native> {
            type Array = $array;
            const NULLABLE: bool = true;
            fn data_type() -> DataType { $data_type }
            fn build<'a>(cells: impl Iterator<Item = &'a Self>) -> ArrayRef {
                Arc::new(cells.copied().collect::<$array>())
            }
            fn repeat(&self, rows: usize) -> ArrayRef {
                self.map_or_else(|| Arc::new(<$array>::new_null(rows)) as ArrayRef, |value| value.repeat(rows))
            }
            fn get(array: &Self::Array, i: usize) -> Self { array.is_valid(i).then(|| array.value(i)) }
        }
    )*};
}
primitive_cell! {
    f64, Float64Array, DataType::Float64;
    i32, Int32Array, DataType::Int32;
    i64, Int64Array, DataType::Int64;
    bool, BooleanArray, DataType::Boolean;
}

impl Cell for Name {
    type Array = StringArray;
    const NULLABLE: bool = false;
    fn data_type() -> DataType {
        DataType::Utf8
    }
    fn build<'a>(cells: impl Iterator<Item = &'a Self>) -> ArrayRef {
        Arc::new(StringArray::from_iter_values(cells))
    }
    fn repeat(&self, rows: usize) -> ArrayRef {
        let offsets = OffsetBuffer::from_lengths(repeat_n(self.len(), rows));
        Arc::new(StringArray::new(offsets, Buffer::from_vec(self.as_bytes().repeat(rows)), None))
    }
    fn get(array: &Self::Array, i: usize) -> Self {
        array.value(i).into()
    }
}

impl Cell for Option<Name> {
    type Array = StringArray;
    const NULLABLE: bool = true;
    fn data_type() -> DataType {
        DataType::Utf8
    }
    fn build<'a>(cells: impl Iterator<Item = &'a Self>) -> ArrayRef {
        Arc::new(cells.map(|cell| cell.as_deref()).collect::<StringArray>())
    }
    fn repeat(&self, rows: usize) -> ArrayRef {
        self.as_ref().map_or_else(|| Arc::new(StringArray::new_null(rows)) as ArrayRef, |text| text.repeat(rows))
    }
    fn get(array: &Self::Array, i: usize) -> Self {
        array.is_valid(i).then(|| array.value(i).into())
    }
}

/// Raw sample codes of one record: a range of little-endian bytes in a block that many records may share.
#[derive(Clone, Debug)]
pub struct Codes {
    block: Buffer,
    offset: u32,
    length: u32,
}

impl Codes {
    /// The `length` bytes from `offset` of `block`, without copying.
    ///
    /// # Panics
    /// When the range exceeds the block, or the block is 4 GiB or larger.
    #[must_use]
    pub fn new(block: &Buffer, offset: usize, length: usize) -> Self {
        assert!(
            offset + length <= block.len() && u32::try_from(block.len()).is_ok(),
            "codes {offset}+{length} outside their block"
        );
        Self { block: block.clone(), offset: offset as u32, length: length as u32 }
    }

    /// The `length` bytes from `offset` of these, without copying.
    ///
    /// # Panics
    /// When the range exceeds them.
    #[must_use]
    pub fn slice(&self, offset: usize, length: usize) -> Self {
        assert!(offset + length <= self.len(), "bytes {offset}+{length} of {}", self.len());
        Self { block: self.block.clone(), offset: self.offset + offset as u32, length: length as u32 }
    }
}

impl Default for Codes {
    /// No codes.
    fn default() -> Self {
        Self { block: Buffer::from_vec(Vec::<u8>::new()), offset: 0, length: 0 }
    }
}

impl Deref for Codes {
    type Target = [u8];
    fn deref(&self) -> &[u8] {
        &self.block[self.offset as usize..(self.offset + self.length) as usize]
    }
}

impl PartialEq for Codes {
    fn eq(&self, other: &Self) -> bool {
        **self == **other
    }
}

impl Cell for Codes {
    type Array = BinaryViewArray;
    const NULLABLE: bool = false;
    fn data_type() -> DataType {
        DataType::BinaryView
    }
    fn build<'a>(cells: impl Iterator<Item = &'a Self>) -> ArrayRef {
        codes(cells.map(Some))
    }
    fn get(array: &Self::Array, i: usize) -> Self {
        // A view packs length, first bytes (or all, up to 12), block and offset into 128 bits.
        let view = array.views()[i];
        let length = view as u32;
        if length <= 12 {
            return Self { block: Buffer::from(array.value(i)), offset: 0, length };
        }
        Self { block: array.data_buffers()[(view >> 64) as u32 as usize].clone(), offset: (view >> 96) as u32, length }
    }
}

impl Cell for Option<Codes> {
    type Array = BinaryViewArray;
    const NULLABLE: bool = true;
    fn data_type() -> DataType {
        Codes::data_type()
    }
    fn build<'a>(cells: impl Iterator<Item = &'a Self>) -> ArrayRef {
        codes(cells.map(Option::as_ref))
    }
    fn get(array: &Self::Array, i: usize) -> Self {
        array.is_valid(i).then(|| <Codes as Cell>::get(array, i))
    }
}

/// The column of these codes; `None` is a null cell. Neighbours of one block share it.
fn codes<'a>(cells: impl Iterator<Item = Option<&'a Codes>>) -> ArrayRef {
    let mut builder = BinaryViewBuilder::new();
    let mut last: Option<(&Buffer, u32)> = None;
    for cell in cells {
        let Some(Codes { block, offset, length }) = cell else {
            builder.append_null();
            continue;
        };
        let id = match last {
            Some((shared, id)) if shared.as_ptr() == block.as_ptr() && shared.len() == block.len() => id,
            _ => builder.append_block(block.clone()),
        };
        builder.try_append_view(id, *offset, *length).expect("codes lie within their block");
        last = Some((block, id));
    }
    Arc::new(builder.finish())
}

/// Samples of a waveform (`list<f32>` in the table); shares its buffer.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Samples(ScalarBuffer<f32>);

impl From<Vec<f32>> for Samples {
    fn from(values: Vec<f32>) -> Self {
        Self(values.into())
    }
}

impl FromIterator<f64> for Samples {
    fn from_iter<I: IntoIterator<Item = f64>>(values: I) -> Self {
        values.into_iter().map(|value| value as f32).collect::<Vec<f32>>().into()
    }
}

impl Samples {
    /// The samples as f64.
    #[must_use]
    pub fn to_f64(&self) -> Vec<f64> {
        self.iter().map(|&value| f64::from(value)).collect()
    }
}

impl Deref for Samples {
    type Target = [f32];
    fn deref(&self) -> &[f32] {
        &self.0
    }
}

/// Field of a list's items.
fn item(data_type: DataType) -> Arc<Field> {
    Arc::new(Field::new_list_field(data_type, false))
}

/// A list column from its items and the length of each cell; `None` is a null cell.
pub(crate) fn list(items: ArrayRef, lengths: &[Option<usize>]) -> ArrayRef {
    let offsets = OffsetBuffer::from_lengths(lengths.iter().map(|length| length.unwrap_or(0)));
    let nulls = lengths.iter().any(Option::is_none).then(|| lengths.iter().map(Option::is_some).collect());
    Arc::new(ListArray::new(item(items.data_type().clone()), offsets, items, nulls))
}

/// The column of these waveforms. They are long, so it allocates room for all before it copies them.
fn waveforms(cells: &[Option<&Samples>]) -> ArrayRef {
    let lengths: Vec<_> = cells.iter().map(|cell| cell.map(|samples| samples.len())).collect();
    let mut values = Vec::with_capacity(lengths.iter().flatten().sum());
    cells.iter().flatten().for_each(|samples| values.extend_from_slice(samples));
    list(Arc::new(Float32Array::from(values)), &lengths)
}

impl Cell for Samples {
    type Array = ListArray;
    const NULLABLE: bool = false;
    fn data_type() -> DataType {
        DataType::List(item(DataType::Float32))
    }
    fn build<'a>(cells: impl Iterator<Item = &'a Self>) -> ArrayRef {
        waveforms(&cells.map(Some).collect::<Vec<_>>())
    }
    fn get(array: &Self::Array, i: usize) -> Self {
        Self(array.value(i).as_primitive::<Float32Type>().values().clone())
    }
}

impl Cell for Option<Samples> {
    type Array = ListArray;
    const NULLABLE: bool = true;
    fn data_type() -> DataType {
        Samples::data_type()
    }
    fn build<'a>(cells: impl Iterator<Item = &'a Self>) -> ArrayRef {
        waveforms(&cells.map(Option::as_ref).collect::<Vec<_>>())
    }
    fn get(array: &Self::Array, i: usize) -> Self {
        array.is_valid(i).then(|| Samples::get(array, i))
    }
}

macro_rules! list_cell {
    ($($native:ty, $array:ty, $arrow:ty, $data_type:expr;)*) => {$(
        impl Cell for Vec<$native> {
            type Array = ListArray;
            const NULLABLE: bool = false;
            fn data_type() -> DataType { DataType::List(item($data_type)) }
            fn build<'a>(cells: impl Iterator<Item = &'a Self>) -> ArrayRef {
                let mut values: Vec<$native> = Vec::new();
                let lengths: Vec<_> = cells.map(|cell| { values.extend_from_slice(cell); Some(cell.len()) }).collect();
                list(Arc::new(<$array>::from(values)), &lengths)
            }
            fn get(array: &Self::Array, i: usize) -> Self { array.value(i).as_primitive::<$arrow>().values().to_vec() }
        }
        impl Cell for Option<Vec<$native>> {
            type Array = ListArray;
            const NULLABLE: bool = true;
            fn data_type() -> DataType { <Vec<$native>>::data_type() }
            fn build<'a>(cells: impl Iterator<Item = &'a Self>) -> ArrayRef {
                let mut values: Vec<$native> = Vec::new();
                let lengths: Vec<_> = cells
                    .map(|cell| cell.as_ref().map(|items| { values.extend_from_slice(items); items.len() }))
                    .collect();
                list(Arc::new(<$array>::from(values)), &lengths)
            }
            fn get(array: &Self::Array, i: usize) -> Self { array.is_valid(i).then(|| <Vec<$native>>::get(array, i)) }
        }
    )*};
}
list_cell! {
    i32, Int32Array, Int32Type, DataType::Int32;
    i64, Int64Array, Int64Type, DataType::Int64;
    f64, Float64Array, Float64Type, DataType::Float64;
}

impl Cell for Vec<Name> {
    type Array = ListArray;
    const NULLABLE: bool = false;
    fn data_type() -> DataType {
        DataType::List(item(DataType::Utf8))
    }
    fn build<'a>(cells: impl Iterator<Item = &'a Self>) -> ArrayRef {
        let mut values: Vec<Name> = Vec::new();
        let lengths: Vec<_> = cells
            .map(|cell| {
                values.extend_from_slice(cell);
                Some(cell.len())
            })
            .collect();
        list(Arc::new(StringArray::from_iter_values(values)), &lengths)
    }
    fn get(array: &Self::Array, i: usize) -> Self {
        array.value(i).as_string::<i32>().iter().flatten().map(Name::from).collect()
    }
}
