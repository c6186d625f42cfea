//! HDF5 files for the tests, written as the HDF5 library writes them by default (superblock 0).

use std::io::Write;

use flate2::{Compression, write::ZlibEncoder};

use crate::waveform::CodeType;

/// How the data of a data set are stored.
#[derive(Clone, Copy)]
pub enum Storage {
    Compact,
    Contiguous,
    /// In chunks of this many elements, deflated or not.
    Chunked(u32, bool),
}

/// A message of an object header: its type and data.
pub type Message = (u16, Vec<u8>);

/// A file that is being built.
pub struct Builder(Vec<u8>);

impl Builder {
    pub fn new() -> Self {
        Self(vec![0; 96])
    }

    /// Appends bytes at a multiple of eight, and returns where they are.
    fn put(&mut self, bytes: &[u8]) -> u64 {
        self.0.resize(self.0.len().next_multiple_of(8), 0);
        let at = self.0.len() as u64;
        self.0.extend_from_slice(bytes);
        at
    }

    /// An object header; what follows its first message is in a continuation.
    pub fn header(&mut self, messages: &[Message]) -> u64 {
        let encode = |messages: &[Message]| {
            let mut bytes = Vec::new();
            for (kind, data) in messages {
                let padded = data.len().next_multiple_of(8);
                bytes.extend([kind.to_le_bytes(), (padded as u16).to_le_bytes()].concat());
                bytes.extend([0; 4]);
                bytes.extend(data);
                bytes.resize(bytes.len() + padded - data.len(), 0);
            }
            bytes
        };
        let (first, rest) = messages.split_at(1);
        let rest = encode(rest);
        let place = self.put(&rest);
        let continuation = (0x10, [place, rest.len() as u64].map(u64::to_le_bytes).concat());
        let block = encode(&[first[0].clone(), continuation]);
        let head = [[1, 0].as_slice(), &(messages.len() as u16 + 1).to_le_bytes(), &1_u32.to_le_bytes()].concat();
        self.put(&[head.as_slice(), &(block.len() as u32).to_le_bytes(), &[0; 4], &block].concat())
    }

    /// A version 1 B-tree over pairs of key and child, with this many levels above its leaves.
    fn tree(&mut self, node_type: u8, levels: u8, pairs: &[(Vec<u8>, u64)], last: &[u8]) -> u64 {
        let mut level = pairs.to_vec();
        let mut at = 0;
        for depth in 0..=levels {
            let mut above = Vec::new();
            let per_node = if depth == levels { level.len().max(1) } else { 2 };
            let nodes: Vec<_> = if level.is_empty() { vec![[].as_slice()] } else { level.chunks(per_node).collect() };
            for pairs in nodes {
                let count = (pairs.len() as u16).to_le_bytes();
                let mut node = [b"TREE".as_slice(), &[node_type, depth], &count, &[255; 16]].concat();
                pairs.iter().for_each(|(key, child)| node.extend([key, child.to_le_bytes().as_slice()].concat()));
                node.extend(last);
                at = self.put(&node);
                above.extend(pairs.first().map(|pair| (pair.0.clone(), at)));
            }
            level = above;
        }
        at
    }

    /// A group of these objects, sorted by name, with attributes.
    pub fn group(&mut self, objects: &[(&str, u64)], attributes: &[Message]) -> u64 {
        let mut objects = objects.to_vec();
        objects.sort_unstable();
        let mut names = vec![0; 8];
        let mut symbols = Vec::new();
        for (name, at) in &objects {
            symbols.push([&(names.len() as u64).to_le_bytes(), &at.to_le_bytes(), [0; 24].as_slice()].concat());
            names.extend(name.as_bytes());
            names.resize((names.len() + 1).next_multiple_of(8), 0);
        }
        let segment = self.put(&names);
        let sizes = [names.len() as u64, 1, segment].map(u64::to_le_bytes).concat();
        let heap = self.put(&[b"HEAP\0\0\0\0".as_slice(), &sizes].concat());
        let mut tables = Vec::new();
        for symbols in symbols.chunks(3) {
            let head = [b"SNOD".as_slice(), &[1, 0], &(symbols.len() as u16).to_le_bytes()].concat();
            tables.push((vec![0; 8], self.put(&[head, symbols.concat()].concat())));
        }
        let tree = self.tree(0, u8::from(tables.len() > 2), &tables, &[0; 8]);
        let table = (0x11, [tree, heap].map(u64::to_le_bytes).concat());
        self.header(&[[table].as_slice(), attributes].concat())
    }

    /// A data set of one axis, or a single value where `length` is `None`.
    pub fn dataset(
        &mut self,
        datatype: Vec<u8>,
        length: Option<u64>,
        data: &[u8],
        storage: Storage,
        attributes: &[Message],
    ) -> u64 {
        let width = data.len() / length.map_or(1, |length| length as usize);
        let (layout, filters) = match storage {
            Storage::Compact => ([&[3, 0], (data.len() as u16).to_le_bytes().as_slice(), data].concat(), None),
            Storage::Contiguous => {
                let place = [self.put(data), data.len() as u64].map(u64::to_le_bytes).concat();
                ([[3, 1].as_slice(), &place].concat(), None)
            }
            Storage::Chunked(elements, deflate) => {
                let tree = self.chunks(data, elements as usize * width, elements, deflate);
                let sizes = [elements, width as u32].map(u32::to_le_bytes).concat();
                ([[3, 2, 2].as_slice(), &tree.to_le_bytes(), &sizes].concat(), deflate.then(|| (0x0B, deflated())))
            }
        };
        let mut messages = vec![(0x01, space(length)), (0x03, datatype), (0x08, layout)];
        messages.extend(filters);
        messages.extend_from_slice(attributes);
        self.header(&messages)
    }

    /// A data set of several axes in chunks, deflated or not.
    pub fn chunked(&mut self, datatype: Vec<u8>, axes: &[u64], data: &[u8], chunk: &[u32], deflate: bool) -> u64 {
        let rank = axes.len();
        let element = data.len() / axes.iter().product::<u64>() as usize;
        let counts: Vec<u64> = axes.iter().zip(chunk).map(|(axis, chunk)| axis.div_ceil(u64::from(*chunk))).collect();
        let places = |lengths: &[u64]| -> Vec<Vec<u64>> {
            lengths.iter().fold(vec![Vec::new()], |all, length| {
                all.iter().flat_map(|start| (0..*length).map(move |i| [start.as_slice(), &[i]].concat())).collect()
            })
        };
        let inside = places(&chunk.iter().map(|length| u64::from(*length)).collect::<Vec<u64>>());
        let key = |packed: usize, start: &[u64]| {
            let starts = start.iter().flat_map(|start| start.to_le_bytes()).chain([0; 8]);
            [(packed as u32).to_le_bytes(), [0; 4]].concat().into_iter().chain(starts).collect::<Vec<u8>>()
        };
        let mut pairs = Vec::new();
        for place in places(&counts) {
            let start: Vec<u64> = place.iter().zip(chunk).map(|(place, chunk)| place * u64::from(*chunk)).collect();
            let mut bytes = Vec::new();
            for offset in &inside {
                let at: Vec<u64> = start.iter().zip(offset).map(|(start, offset)| start + offset).collect();
                if at.iter().zip(axes).all(|(at, axis)| at < axis) {
                    let place = at.iter().zip(axes).fold(0, |place, (at, axis)| place * axis + at) as usize;
                    bytes.extend(&data[place * element..(place + 1) * element]);
                } else {
                    bytes.extend(vec![0xEE; element]);
                }
            }
            if deflate {
                let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
                encoder.write_all(&bytes).unwrap();
                bytes = encoder.finish().unwrap();
            }
            pairs.push((key(bytes.len(), &start), self.put(&bytes)));
        }
        let last = key(0, axes);
        let tree = self.tree(1, u8::from(pairs.len() > 2), &pairs, &last);
        let sizes = chunk.iter().copied().chain([element as u32]).flat_map(u32::to_le_bytes);
        let layout = [3, 2, rank as u8 + 1].into_iter().chain(tree.to_le_bytes()).chain(sizes).collect();
        let space = [1, rank as u8, 0, 0, 0, 0, 0, 0].into_iter();
        let space = space.chain(axes.iter().flat_map(|axis| axis.to_le_bytes())).collect();
        let mut messages = vec![(0x01, space), (0x03, datatype), (0x08, layout)];
        messages.extend(deflate.then(|| (0x0B, deflated())));
        self.header(&messages)
    }

    fn chunks(&mut self, data: &[u8], chunk_bytes: usize, elements: u32, deflate: bool) -> u64 {
        let mut pairs = Vec::new();
        let key = |packed: usize, i: usize| {
            let offset = i as u64 * u64::from(elements);
            [[(packed as u32).to_le_bytes(), [0; 4]].concat(), [offset, 0].map(u64::to_le_bytes).concat()].concat()
        };
        for (i, chunk) in data.chunks(chunk_bytes).enumerate() {
            let mut chunk = chunk.to_vec();
            chunk.resize(chunk_bytes, 0);
            if deflate {
                let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
                encoder.write_all(&chunk).unwrap();
                chunk = encoder.finish().unwrap();
            }
            pairs.push((key(chunk.len(), i), self.put(&chunk)));
        }
        let last = key(0, pairs.len());
        self.tree(1, u8::from(pairs.len() > 2), &pairs, &last)
    }

    /// The file; `root` is its root group.
    pub fn finish(mut self, root: u64) -> Vec<u8> {
        let end = self.0.len() as u64;
        let sizes = [8, 8, 0, 4, 0, 16, 0, 0, 0, 0, 0];
        let addresses = [0, u64::MAX, end, u64::MAX, 0, root].map(u64::to_le_bytes).concat();
        let head = [super::SIGNATURE, &[0, 0, 0, 0, 0], &sizes, &addresses].concat();
        self.0[..head.len()].copy_from_slice(&head);
        self.0
    }
}

/// The message that says that chunks are deflated.
fn deflated() -> Vec<u8> {
    [[1, 1, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 0].as_slice(), &6_u32.to_le_bytes(), &[0; 4]].concat()
}

fn space(length: Option<u64>) -> Vec<u8> {
    let head = [1, u8::from(length.is_some()), 0, 0, 0, 0, 0, 0];
    [head.as_slice(), &length.map_or(Vec::new(), |length| length.to_le_bytes().to_vec())].concat()
}

/// Data type of codes.
pub fn numbers(code_type: CodeType, big_endian: bool) -> Vec<u8> {
    let size = code_type.bytes() as u8;
    let order = u8::from(big_endian);
    match code_type {
        CodeType::F32 => vec![0x11, 0x20 | order, 31, 0, 4, 0, 0, 0, 0, 0, 32, 0, 23, 8, 0, 23, 127, 0, 0, 0],
        CodeType::F64 => vec![0x11, 0x20 | order, 63, 0, 8, 0, 0, 0, 0, 0, 64, 0, 52, 11, 0, 52, 255, 3, 0, 0],
        _ => {
            let signed = matches!(code_type, CodeType::I8 | CodeType::I16 | CodeType::I32);
            vec![0x10, order | u8::from(signed) << 3, 0, 0, size, 0, 0, 0, 0, 0, 8 * size, 0]
        }
    }
}

/// Data type of a text of fixed length.
pub fn text(bytes: u32) -> Vec<u8> {
    [[0x13, 0, 0, 0], bytes.to_le_bytes()].concat()
}

/// An attribute of one value.
pub fn attribute(name: &str, datatype: &[u8], value: &[u8]) -> Message {
    let padded = |bytes: &[u8]| {
        let mut bytes = bytes.to_vec();
        bytes.resize(bytes.len().next_multiple_of(8), 0);
        bytes
    };
    let sizes = [name.len() as u16 + 1, datatype.len() as u16, 8].map(u16::to_le_bytes).concat();
    let name = padded(&[name.as_bytes(), &[0]].concat());
    (0x0C, [[1, 0].as_slice(), &sizes, &name, &padded(datatype), &space(None), value].concat())
}

/// The same, of a floating number.
pub fn number(name: &str, value: f64) -> Message {
    attribute(name, &numbers(CodeType::F64, false), &value.to_le_bytes())
}

/// The same, of an enumeration over 16 bit integers.
pub fn enumerated(name: &str, value: i16) -> Message {
    let head = [0x18, 1, 0, 0, 2, 0, 0, 0];
    let datatype = [head.as_slice(), &numbers(CodeType::I16, false), b"NORMAL\0\0", &1_i16.to_le_bytes()].concat();
    attribute(name, &datatype, &value.to_le_bytes())
}

/// The same, of a text.
pub fn text_attribute(name: &str, value: &str) -> Message {
    attribute(name, &text(value.len() as u32 + 3), &[value.as_bytes(), &[0; 3]].concat())
}

/// A compound type of version 1 of texts, and a value.
pub fn texts(members: &[(&str, &str)]) -> (Vec<u8>, Vec<u8>) {
    let mut value = Vec::new();
    let mut types = Vec::new();
    for (name, member) in members {
        types.extend(name.as_bytes());
        types.resize((types.len() + 1).next_multiple_of(8), 0);
        types.extend((value.len() as u32).to_le_bytes());
        types.extend([0; 28]);
        types.extend(text(member.len() as u32 + 1));
        value.extend([member.as_bytes(), &[0]].concat());
    }
    let head = [[0x16, members.len() as u8, 0, 0], (value.len() as u32).to_le_bytes()].concat();
    ([head, types].concat(), value)
}
