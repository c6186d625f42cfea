//! Objects of a segment: paths, where their raw data are, properties.

use std::collections::BTreeMap;

use super::joined::Extent;
use super::properties::{Properties, Value};
use super::{Channel, daqmx};
use crate::reader::FormatError;
use crate::waveform::CodeType;

/// Lengths of an object's raw data index that mean something else: no data, as before, DAQmx.
const NO_DATA: u32 = u32::MAX;
const AS_BEFORE: u32 = 0;
const DAQMX_INDICES: [u32; 2] = [0x1269, 0x126A];
/// Type of text, whose data have a length of their own.
const TEXT: u32 = 0x20;
const TIME: u32 = 0x44;
/// Types whose values can be records. The last two have their unit in a property.
const NUMBERS: [(u32, CodeType); 10] = [
    (1, CodeType::I8),
    (2, CodeType::I16),
    (3, CodeType::I32),
    (5, CodeType::U8),
    (6, CodeType::U16),
    (7, CodeType::U32),
    (9, CodeType::F32),
    (10, CodeType::F64),
    (0x19, CodeType::F32),
    (0x1A, CodeType::F64),
];
/// Other types: number, bytes of a value (0 where each has its own length), what they are.
const OTHERS: [(u32, u64, &str); 8] = [
    (0, 0, "void"),
    (4, 8, "integers of 64 bits"),
    (8, 8, "integers of 64 bits"),
    (TEXT, 0, "text"),
    (0x21, 1, "logic values"),
    (TIME, 16, "times"),
    (0x08_000C, 8, "complex numbers"),
    (0x10_000D, 16, "complex numbers"),
];
/// Bytes of a file for each of its objects, and for each stretch of raw data; beyond the first so many, a file that
/// has more would take too much memory.
const OBJECT_BYTES: u64 = 512;
const EXTENT_BYTES: u64 = 144;
const FIRST_OBJECTS: u64 = 512;
const FIRST_EXTENTS: u64 = 2048;

/// The objects of a segment as bytes, with a place in them.
pub(super) struct Text {
    bytes: Vec<u8>,
    at: usize,
    origin: u64,
    big_endian: bool,
}

impl Text {
    pub(super) fn new(bytes: Vec<u8>, origin: u64, big_endian: bool) -> Self {
        Self { bytes, at: 0, origin, big_endian }
    }

    /// Where in the file it is.
    pub(super) fn place(&self) -> u64 {
        self.origin + self.at as u64
    }

    fn refuse(&self, problem: &str) -> FormatError {
        FormatError::Field { byte_offset: self.place(), problem: format!("{problem}; copy the file again") }
    }

    fn take(&mut self, count: usize) -> Result<&[u8], FormatError> {
        let end = self.at.checked_add(count).filter(|end| *end <= self.bytes.len());
        let end = end.ok_or_else(|| self.refuse("the objects of a segment end within a field"))?;
        let bytes = &self.bytes[self.at..end];
        self.at = end;
        Ok(bytes)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], FormatError> {
        let big_endian = self.big_endian;
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        if big_endian {
            array.reverse();
        }
        Ok(array)
    }

    fn u32(&mut self) -> Result<u32, FormatError> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, FormatError> {
        self.array().map(u64::from_le_bytes)
    }

    fn text(&mut self) -> Result<String, FormatError> {
        let length = self.u32()? as usize;
        Ok(String::from_utf8_lossy(self.take(length)?).into_owned())
    }

    /// A property: its name and its value.
    fn property(&mut self) -> Result<(String, Value), FormatError> {
        let name = self.text()?;
        let kind = self.u32()?;
        let value = match kind {
            1 => Value::Number(i8::from_le_bytes(self.array()?).into()),
            2 => Value::Number(i16::from_le_bytes(self.array()?).into()),
            3 => Value::Number(i32::from_le_bytes(self.array()?).into()),
            4 => Value::Number(i64::from_le_bytes(self.array()?) as f64),
            5 => Value::Number(u8::from_le_bytes(self.array()?).into()),
            6 => Value::Number(u16::from_le_bytes(self.array()?).into()),
            7 => Value::Number(self.u32()?.into()),
            8 => Value::Number(self.u64()? as f64),
            9 | 0x19 => Value::Number(f32::from_le_bytes(self.array()?).into()),
            10 | 0x1A => Value::Number(f64::from_le_bytes(self.array()?)),
            TEXT => Value::Text(self.text()?),
            TIME => self.time()?,
            _ => match OTHERS.iter().find(|(number, ..)| *number == kind) {
                Some((_, bytes, _)) => self.take(*bytes as usize).map(|_| Value::Other)?,
                None => return Err(self.refuse(&format!("a property of type {kind:#x}, which is none"))),
            },
        };
        Ok((name, value))
    }

    /// A time: parts of 2^-64 s, then seconds; in the other order where the segment is big-endian.
    fn time(&mut self) -> Result<Value, FormatError> {
        let (first, second) = (self.u64()?, self.u64()?);
        let (parts, seconds) = if self.big_endian { (second, first) } else { (first, second) };
        Ok(Value::Time(seconds.cast_signed() as f64 + parts as f64 / 2_f64.powi(64)))
    }
}

/// Raw data of an object in a chunk.
#[derive(Clone, Copy, Debug)]
pub(super) struct Layout {
    kind: u32,
    pub values: u64,
    pub bytes: u64,
    /// Bytes of a value; 0 for text.
    pub width: u64,
}

impl Layout {
    fn read(text: &mut Text) -> Result<Self, FormatError> {
        let (kind, dimension, values) = (text.u32()?, text.u32()?, text.u64()?);
        let number = NUMBERS.iter().find(|(number, _)| *number == kind).map(|(_, code_type)| code_type.bytes() as u64);
        let other = OTHERS.iter().find(|(number, ..)| *number == kind).map(|(_, bytes, _)| *bytes);
        let width = number.or(other).ok_or_else(|| text.refuse(&format!("values of type {kind:#x} are none")))?;
        if dimension != 1 {
            return Err(text.refuse(&format!("arrays of {dimension} dimensions, where TDMS has one")));
        }
        let bytes = if kind == TEXT { Some(text.u64()?) } else { values.checked_mul(width) };
        let bytes = bytes.ok_or_else(|| text.refuse(&format!("{values} values are more than any file holds")))?;
        Ok(Self { kind, values, bytes, width })
    }
}

/// All objects of a file, and which of them have raw data in the current segment, in order.
#[derive(Default)]
pub(super) struct Objects {
    numbers: BTreeMap<String, usize>,
    channels: Vec<Channel>,
    layouts: Vec<Option<Layout>>,
    /// The list of the current segment: object, and whether it has data.
    list: Vec<(usize, bool)>,
    extents: u64,
}

impl Objects {
    /// Takes over the objects of a segment of a file of `file_bytes`.
    pub(super) fn update(&mut self, text: &mut Text, is_new: bool, file_bytes: u64) -> Result<(), FormatError> {
        if is_new {
            self.list.clear();
        }
        let mut places: BTreeMap<usize, usize> =
            self.list.iter().enumerate().map(|(place, (object, _))| (*object, place)).collect();
        for _ in 0..text.u32()? {
            let at = text.place();
            let object = self.object(text, at, file_bytes)?;
            let index = text.u32()?;
            if DAQMX_INDICES.contains(&index) {
                return Err(daqmx());
            }
            if index != NO_DATA && index != AS_BEFORE {
                let layout = Layout::read(text)?;
                self.set_layout(object, layout).map_err(|problem| text.refuse(&problem))?;
            }
            if index == AS_BEFORE && self.layouts[object].is_none() {
                return Err(text.refuse("raw data as before, but this object had none before"));
            }
            let has_data = index != NO_DATA;
            if let Some(place) = places.get(&object) {
                self.list[*place].1 = has_data;
            } else {
                places.insert(object, self.list.len());
                self.list.push((object, has_data));
            }
            for _ in 0..text.u32()? {
                let (name, value) = text.property()?;
                self.channels[object].properties.set(&name, value);
            }
        }
        Ok(())
    }

    /// The object of the path that follows.
    fn object(&mut self, text: &mut Text, place: u64, file_bytes: u64) -> Result<usize, FormatError> {
        let path = text.text()?;
        if let Some(object) = self.numbers.get(&path) {
            return Ok(*object);
        }
        if self.channels.len() as u64 >= FIRST_OBJECTS + file_bytes / OBJECT_BYTES {
            return Err(text.refuse("more objects than such a file can have"));
        }
        let names = split(&path).ok_or_else(|| text.refuse("an object whose path is none"))?;
        let [group, name] = names;
        self.channels.push(Channel { place, group, name, ..Channel::default() });
        self.layouts.push(None);
        self.numbers.insert(path, self.channels.len() - 1);
        Ok(self.channels.len() - 1)
    }

    fn set_layout(&mut self, object: usize, layout: Layout) -> Result<(), String> {
        if self.layouts[object].is_some_and(|before| before.kind != layout.kind) {
            return Err("a channel changes the type of its values".to_owned());
        }
        self.layouts[object] = Some(layout);
        let channel = &mut self.channels[object];
        channel.code_type = NUMBERS.iter().find(|(number, _)| *number == layout.kind).map(|(_, code_type)| *code_type);
        let other = OTHERS.iter().find(|(number, ..)| *number == layout.kind && layout.bytes > 0);
        channel.skipped = channel.skipped.or(other.map(|(.., what)| *what));
        Ok(())
    }

    /// The objects that have raw data in this segment.
    pub(super) fn live(&self) -> Vec<(usize, Layout)> {
        let layout = |object: &usize| self.layouts[*object].filter(|layout| layout.bytes > 0).map(|l| (*object, l));
        self.list.iter().filter(|(_, has_data)| *has_data).filter_map(|(object, _)| layout(object)).collect()
    }

    /// Adds a stretch of raw data to an object whose values are read.
    pub(super) fn push(&mut self, object: usize, extent: Extent, file_bytes: u64) -> Result<(), &'static str> {
        if self.channels[object].code_type.is_none() {
            return Ok(());
        }
        self.extents += 1;
        if self.extents > FIRST_EXTENTS + file_bytes / EXTENT_BYTES {
            return Err("more pieces than can be read; defragment the file in LabVIEW (TDMS Defragment)");
        }
        self.channels[object].pieces.push(extent);
        Ok(())
    }

    /// The channels, with scales of their group or of the file where they have none of their own.
    pub(super) fn into_channels(self) -> Vec<Channel> {
        let (mut channels, holders): (Vec<_>, Vec<_>) =
            self.channels.into_iter().partition(|object| !object.name.is_empty());
        let scales: BTreeMap<String, Properties> = holders
            .into_iter()
            .filter(|object| object.properties.has_scales())
            .map(|object| (object.group, object.properties))
            .collect();
        for channel in channels.iter_mut().filter(|channel| !channel.properties.has_scales()) {
            if let Some(properties) = scales.get(&channel.group).or_else(|| scales.get("")) {
                channel.properties.inherit(properties);
            }
        }
        channels
    }
}

/// Group and channel of a path like `/'group'/'channel'`; of a group, and of the file (`/`), what is missing is empty.
fn split(path: &str) -> Option<[String; 2]> {
    if path == "/" {
        return Some(Default::default());
    }
    let inner = path.strip_prefix("/'")?.strip_suffix('\'')?;
    // A quote in a name is doubled, so that this can only be the border between two names.
    let (group, channel) = match inner.split_once("'/'") {
        Some((_, "")) => return None,
        Some(names) => names,
        None => (inner, ""),
    };
    Some([group, channel].map(|name| name.replace("''", "'")))
}
