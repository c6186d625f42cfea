//! The structure of an HDF5 file: superblock, object headers, groups and B-trees.

use super::super::reader::{FormatError, Input};
use super::field;
use crate::waveform::ReadSeek;

/// The bytes with which a file begins.
pub(super) const SIGNATURE: &[u8] = b"\x89HDF\r\n\x1a\n";
/// The address of an object that was never stored.
pub(super) const UNDEFINED: u64 = u64::MAX;

/// Types of the messages in object headers.
pub(super) mod message {
    pub const DATASPACE: u16 = 0x01;
    pub const DATATYPE: u16 = 0x03;
    pub const LAYOUT: u16 = 0x08;
    pub const FILTERS: u16 = 0x0B;
    pub const ATTRIBUTE: u16 = 0x0C;
    pub const CONTINUATION: u16 = 0x10;
    pub const SYMBOL_TABLE: u16 = 0x11;
}

/// Bytes before the messages of a header, and before the data of a message.
const HEADER: u64 = 16;
const MESSAGE: usize = 8;
/// Bytes that may be read beyond the length of the file, since an object can have two names.
const SPARE_BYTES: u64 = 1 << 16;

/// Start of the HDF5 content in files with a user block, such as MATLAB's.
const USER_BLOCK: u64 = 512;

/// A file whose every byte may be read once. Circular references exhaust the file's length before they cost time or
/// memory.
pub(super) struct File<'a> {
    input: &'a mut dyn Input,
    /// Base of all addresses.
    base: u64,
    structure_left: u64,
    names_left: u64,
    samples_left: u64,
}

impl<'a> File<'a> {
    /// Opens a file. Returns also where the header of its root group is.
    pub fn open(input: &'a mut dyn Input) -> Result<(Self, u64), FormatError> {
        let length = input.length();
        let most = length.saturating_add(SPARE_BYTES);
        let mut file = Self { input, base: 0, structure_left: most, names_left: most, samples_left: most };
        let mut head = file.bytes("the superblock", 0, 24)?;
        if !head.starts_with(SIGNATURE) && length > USER_BLOCK {
            file.base = USER_BLOCK;
            head = file.bytes("the superblock", 0, 24)?;
        }
        if !head.starts_with(SIGNATURE) {
            return Err(field(0, "is no HDF5 file; copy it again"));
        }
        let at = match head[8] {
            0 => 24,
            1 => 28,
            version => {
                let problem = format!(
                    "superblock version {version} is not read, only 0 and 1; rewrite the file with h5repack --low=0"
                );
                return Err(field(8, problem));
            }
        };
        if (head[13], head[14]) != (8, 8) {
            let problem = format!("Size of Offsets {} and of Lengths {} are not read, only 8", head[13], head[14]);
            return Err(field(13, problem));
        }
        let addresses = file.bytes("the superblock", at, 48)?;
        let (base, end, root) = (u64_at(&addresses, 0), u64_at(&addresses, 16), u64_at(&addresses, 40));
        if base != file.base {
            let problem = format!("Base Address {base} is not where the superblock is; rewrite the file with h5repack");
            return Err(field(at, problem));
        }
        if end > length {
            let what = "all up to the End of File Address in the superblock";
            return Err(FormatError::Truncated { what, byte_offset: 0, needed: end, length });
        }
        // The format manages its own free space, up to its end.
        file.input.uses(0..end.saturating_add(file.base).min(length));
        Ok((file, root))
    }

    /// Length of the file.
    pub fn length(&self) -> u64 {
        self.input.length()
    }

    /// Returns some bytes of the structure.
    pub fn bytes(&mut self, what: &'static str, at: u64, count: u64) -> Result<Vec<u8>, FormatError> {
        self.structure_left = used_up(self.structure_left, at, count)?;
        self.input.bytes(what, at.saturating_add(self.base), count)
    }

    /// Returns samples at an address.
    pub fn samples(&mut self, at: u64, count: u64) -> Result<Vec<u8>, FormatError> {
        let at = self.claim(at, count)?;
        self.input.bytes("a data set", at, count)
    }

    /// The file, for samples that [`Self::claim`] has counted.
    pub fn packed(&mut self) -> &mut dyn ReadSeek {
        self.input.file()
    }

    /// Counts samples at an address. Returns their byte offset in the file.
    pub fn claim(&mut self, at: u64, count: u64) -> Result<u64, FormatError> {
        let length = self.length();
        let at = at.saturating_add(self.base);
        if at.checked_add(count).is_none_or(|end| end > length) {
            return Err(FormatError::Truncated { what: "a data set", byte_offset: at, needed: count, length });
        }
        self.samples_left = used_up(self.samples_left, at, count)?;
        Ok(at)
    }

    /// Reads the messages of an object.
    pub fn header(&mut self, at: u64) -> Result<Header, FormatError> {
        let head = self.bytes("an object header", at, HEADER)?;
        if head[0] != 1 {
            let problem =
                "is no object header of version 1; the file is damaged, or must be rewritten with h5repack --low=0";
            return Err(field(at, problem));
        }
        let (count, bytes) = (u16_at(&head, 2), u64::from(u32_at(&head, 8)));
        let mut header = Header { place: at, bytes: Vec::new() };
        let mut blocks = vec![(at.saturating_add(HEADER), bytes)];
        let mut messages = 0;
        while let Some((place, bytes)) = blocks.pop() {
            let block = self.bytes("an object header's messages", place, bytes)?;
            let mut next = 0;
            while next + MESSAGE <= block.len() {
                let data = next + MESSAGE..next + MESSAGE + usize::from(u16_at(&block, next + 2));
                let Some(data) = block.get(data.clone()) else {
                    let problem =
                        format!("a message of {} bytes goes beyond its header; copy the file again", data.len());
                    return Err(field(place + next as u64, problem));
                };
                if u16_at(&block, next) == message::CONTINUATION && data.len() >= 16 {
                    blocks.push((u64_at(data, 0), u64_at(data, 8)));
                }
                next += MESSAGE + data.len();
                messages += 1;
            }
            header.bytes.extend_from_slice(&block[..next]);
        }
        if messages != usize::from(count) {
            let problem = format!(
                "the object header has {messages} messages, but gives their number as {count}; copy the file again"
            );
            return Err(field(at + 2, problem));
        }
        Ok(header)
    }

    /// Reads the entries of a group.
    pub fn group(&mut self, at: u64) -> Result<Entries, FormatError> {
        let header = self.header(at)?;
        self.entries(&header)
    }

    /// Reads the entries of a group whose header is already read.
    pub fn entries(&mut self, header: &Header) -> Result<Entries, FormatError> {
        let Some(table) = header.find(message::SYMBOL_TABLE)?.filter(|table| table.len() >= 16) else {
            let problem = "is no group with a symbol table; rewrite the file with h5repack --low=0";
            return Err(field(header.place, problem));
        };
        let (tree, heap) = (u64_at(table, 0), u64_at(table, 8));
        let head = self.bytes("a local heap", heap, 32)?;
        if !head.starts_with(b"HEAP") {
            return Err(field(heap, "is no local heap (HEAP); copy the file again"));
        }
        let names = self.bytes("the names of a group", u64_at(&head, 24), u64_at(&head, 8))?;
        let mut tables = Vec::new();
        self.leaves(tree, 0, 8, &mut |_, table| tables.push(table))?;
        let mut entries = Vec::new();
        for table in tables {
            self.symbols(table, &names, &mut entries)?;
        }
        Ok(Entries(entries))
    }

    /// The entries of a symbol table node.
    fn symbols(&mut self, at: u64, names: &[u8], entries: &mut Vec<Entry>) -> Result<(), FormatError> {
        let head = self.bytes("a symbol table node", at, 8)?;
        if !head.starts_with(b"SNOD") {
            return Err(field(at, "is no symbol table node (SNOD); copy the file again"));
        }
        let symbols = self.bytes("a symbol table node", at + 8, 40 * u64::from(u16_at(&head, 6)))?;
        for symbol in symbols.chunks_exact(40) {
            let name = usize::try_from(u64_at(symbol, 0)).ok().and_then(|start| names.get(start..));
            let name = name.and_then(|name| name.split(|byte| *byte == 0).next());
            let name =
                name.ok_or_else(|| field(at, "a name lies outside the names of its group; copy the file again"))?;
            self.names_left = used_up(self.names_left, at, name.len() as u64)?;
            // Symbolic links (cache type 2) have no header, and neither vendor writes them.
            if u32_at(symbol, 16) != 2 {
                entries.push(Entry { name: String::from_utf8_lossy(name).into_owned(), at: u64_at(symbol, 8) });
            }
        }
        Ok(())
    }

    /// Passes on key and child of all entries in the leaves of a version 1 B-tree, in order.
    pub fn leaves(
        &mut self,
        root: u64,
        node_type: u8,
        key_bytes: usize,
        each: &mut dyn FnMut(&[u8], u64),
    ) -> Result<(), FormatError> {
        let mut nodes = vec![root];
        while let Some(at) = nodes.pop() {
            let head = self.bytes("a B-tree node", at, 24)?;
            if !head.starts_with(b"TREE") || head[4] != node_type {
                return Err(field(at, format!("is no B-tree node (TREE) of type {node_type}; copy the file again")));
            }
            let pair = key_bytes + 8;
            let pairs = self.bytes("a B-tree node", at + 24, u64::from(u16_at(&head, 6)) * pair as u64)?;
            let start = nodes.len();
            for pair in pairs.chunks_exact(pair) {
                let child = u64_at(pair, key_bytes);
                if head[5] == 0 { each(&pair[..key_bytes], child) } else { nodes.push(child) }
            }
            nodes[start..].reverse();
        }
        Ok(())
    }
}

fn used_up(left: u64, at: u64, count: u64) -> Result<u64, FormatError> {
    left.checked_sub(count).ok_or_else(|| {
        field(at, format!("{count} bytes here were read before: parts overlap; the file is damaged, copy it again"))
    })
}

pub(super) fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes([bytes[at], bytes[at + 1]])
}

pub(super) fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"))
}

pub(super) fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(bytes[at..at + 8].try_into().expect("eight bytes"))
}

/// The entries of a group: names, and where the headers are.
pub(super) struct Entries(Vec<Entry>);

pub(super) struct Entry {
    pub name: String,
    pub at: u64,
}

impl Entries {
    pub fn iter(&self) -> impl Iterator<Item = &Entry> {
        self.0.iter()
    }

    pub fn find(&self, name: &str) -> Option<u64> {
        self.0.iter().find(|entry| entry.name == name).map(|entry| entry.at)
    }
}

/// The messages of an object, one after another.
pub(super) struct Header {
    pub place: u64,
    bytes: Vec<u8>,
}

impl Header {
    /// Data of all messages of a type. A shared message is stored elsewhere, and is an error.
    pub fn all(&self, wanted: u16) -> impl Iterator<Item = Result<&[u8], FormatError>> {
        let mut rest = self.bytes.as_slice();
        std::iter::from_fn(move || {
            while let Some((head, behind)) = rest.split_at_checked(MESSAGE) {
                let data;
                (data, rest) = behind.split_at_checked(usize::from(u16_at(head, 2)))?;
                if u16_at(head, 0) == wanted {
                    let shared = head[4] & 2 != 0;
                    let problem =
                        format!("message {wanted:#04x} is shared, which is not read; rewrite the file with h5repack");
                    return Some(if shared { Err(field(self.place, problem)) } else { Ok(data) });
                }
            }
            None
        })
    }

    /// Data of the first message of a type.
    pub fn find(&self, wanted: u16) -> Result<Option<&[u8]>, FormatError> {
        self.all(wanted).next().transpose()
    }

    /// Data of the first message of a type, which must exist.
    pub fn need(&self, wanted: u16, what: &str) -> Result<&[u8], FormatError> {
        self.find(wanted)?.ok_or_else(|| field(self.place, format!("the object has no {what}; copy the file again")))
    }
}
