//! Zip files, for the formats that are built on them: their members, and how to unpack these.
//!
//! Lengths and checksums come from the central directory (APPNOTE 4.3.12). Local headers are unreliable: writers that
//! stream leave zeros there, and NumPy writes Zip64 fields even for small members. Three kinds of members are refused
//! by name: those of 4 GiB and more (Zip64), encrypted ones, and those packed by a method other than deflate.

use std::io;
use std::ops::ControlFlow;

use super::inflate::{self, Packing, Unpacker, broken};
use super::reader::{FormatError, Input};
use crate::waveform::ReadSeek;

/// The mark of a local header, with which a zip file begins.
pub(super) const MARK: &[u8] = b"PK\x03\x04";

const END_MARK: &[u8] = b"PK\x05\x06";
const END: usize = 22;
const ENTRY_MARK: &[u8] = b"PK\x01\x02";
const ENTRY: usize = 46;
const DESCRIPTOR_MARK: &[u8] = b"PK\x07\x08";
const DESCRIPTOR: u64 = 16;
const LOCAL: u64 = 30;
/// Bytes of samples that are in memory at a time.
const PIECE_BYTES: usize = 1 << 16;

/// One member.
#[derive(Clone, Debug)]
pub(super) struct Member {
    /// Name.
    pub name: String,
    /// Where its packed bytes begin.
    pub byte_offset: u64,
    /// Length of the packed bytes.
    pub packed: u64,
    /// Length of the unpacked bytes.
    pub length: u64,
    /// How it is packed.
    pub packing: Packing,
    crc: u32,
}

/// Name of the first member, from the first bytes of the file.
pub(super) fn first_name(head: &[u8]) -> Option<&[u8]> {
    let name = head.strip_prefix(MARK)?.get(22..24)?;
    head.get(30..30 + usize::from(u16::from_le_bytes([name[0], name[1]])))
}

/// All members, in the order of the directory.
pub(super) fn members(input: &mut dyn Input) -> Result<Vec<Member>, FormatError> {
    let (count, start, bytes) = directory(input)?;
    let directory = input.bytes("the central directory", start, bytes)?;
    let mut members = Vec::with_capacity(count);
    let mut places = Vec::with_capacity(count);
    let mut at = 0;
    for _ in 0..count {
        let place = start + at as u64;
        let (member, local, next) = entry(&directory, at, place)?;
        let member = located(input, member, local, start, place)?;
        let end = member.byte_offset + member.packed;
        let after = end + descriptor(input, end, start)?;
        input.uses(local..after);
        places.push((local, end));
        members.push(member);
        at = next;
    }
    places.sort_unstable();
    if let Some(pair) = places.windows(2).find(|pair| pair[0].1 > pair[1].0) {
        let problem = "two members of the zip file overlap: its directory is damaged; copy the file again";
        return Err(field(pair[1].0, problem));
    }
    Ok(members)
}

fn field(byte_offset: u64, problem: impl Into<String>) -> FormatError {
    FormatError::Field { byte_offset, problem: problem.into() }
}

fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes([bytes[at], bytes[at + 1]])
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"))
}

/// How many members the central directory has, where it begins, and its bytes.
fn directory(input: &mut dyn Input) -> Result<(usize, u64, u64), FormatError> {
    let length = input.length();
    // A comment of up to 64 KiB may follow the end record, and nothing else.
    let tail_bytes = length.min((END + usize::from(u16::MAX)) as u64);
    let tail = input.peek("the end of the zip file", length - tail_bytes, tail_bytes)?;
    let is_end =
        |at: &usize| tail[*at..].starts_with(END_MARK) && at + END + usize::from(u16_at(&tail, at + 20)) == tail.len();
    let Some(at) = (0..(tail.len() + 1).saturating_sub(END)).rev().find(is_end) else {
        let problem = "the zip file has no end-of-central-directory record: it is cut short, \
                       or something was appended; copy it again";
        return Err(field(length, problem));
    };
    let (end, place) = (&tail[at..], length - tail_bytes + at as u64);
    let (count, bytes, start) = (u16_at(end, 10), u32_at(end, 12), u32_at(end, 16));
    if count == u16::MAX || bytes == u32::MAX || start == u32::MAX {
        return Err(field(place, "is a Zip64 file, which is not read; save less than 4 GiB and 65535 members"));
    }
    input.uses(place..length);
    if u16_at(end, 4) != 0 || u16_at(end, 6) != 0 || u16_at(end, 8) != count {
        return Err(field(place, "is one part of several of a zip file; join them, or save it as one"));
    }
    let (start, bytes) = (u64::from(start), u64::from(bytes));
    if start + bytes > place || (bytes / ENTRY as u64) < u64::from(count) {
        let problem = format!(
            "the central directory ({count} members, {bytes} bytes from byte {start}) does not fit the file; \
             copy it again"
        );
        return Err(field(place, problem));
    }
    Ok((usize::from(count), start, bytes))
}

/// Reads the directory entry at `at`: the member, where its local header is, and where the next entry begins.
fn entry(directory: &[u8], at: usize, place: u64) -> Result<(Member, u64, usize), FormatError> {
    let lost = || field(place, "an entry of the central directory is damaged; copy the file again");
    let head = directory.get(at..at + ENTRY).filter(|head| head.starts_with(ENTRY_MARK)).ok_or_else(lost)?;
    let name_end = at + ENTRY + usize::from(u16_at(head, 28));
    let name = String::from_utf8_lossy(directory.get(at + ENTRY..name_end).ok_or_else(lost)?).into_owned();
    let next = name_end + usize::from(u16_at(head, 30)) + usize::from(u16_at(head, 32));
    let (packed, length, local) = (u32_at(head, 20), u32_at(head, 24), u32_at(head, 42));
    if [packed, length, local].contains(&u32::MAX) {
        return Err(field(place, format!("member {name:?} needs Zip64, which is not read; save less than 4 GiB")));
    }
    if u16_at(head, 8) & 1 != 0 {
        return Err(field(place, format!("member {name:?} is encrypted; save it without a password")));
    }
    let packing = match u16_at(head, 10) {
        0 => Packing::Stored,
        8 => Packing::Deflate,
        method => {
            return Err(field(
                place,
                format!("member {name:?} is compressed by method {method}, which is not read; save it deflated"),
            ));
        }
    };
    let (packed, length) = (u64::from(packed), u64::from(length));
    if packing == Packing::Stored && packed != length || !inflate::can_hold(packed, length) {
        let problem =
            format!("member {name:?} claims {length} bytes, more or less than its {packed} packed bytes can hold");
        return Err(field(place, problem));
    }
    let member = Member { name, byte_offset: 0, packed, length, packing, crc: u32_at(head, 16) };
    Ok((member, u64::from(local), next))
}

/// Adds where the bytes of a member begin, from its local header. They must lie before the directory.
fn located(
    input: &mut dyn Input,
    member: Member,
    local: u64,
    directory: u64,
    place: u64,
) -> Result<Member, FormatError> {
    let lost = || {
        field(place, format!("member {:?} is not where the central directory says; copy the file again", member.name))
    };
    if local + LOCAL > directory {
        return Err(lost());
    }
    let head = input.bytes("a member's local head", local, LOCAL)?;
    let byte_offset = local + LOCAL + u64::from(u16_at(&head, 26)) + u64::from(u16_at(&head, 28));
    if !head.starts_with(MARK) || byte_offset + member.packed > directory {
        return Err(lost());
    }
    Ok(Member { byte_offset, ..member })
}

/// Bytes of the data descriptor after a member, which writers leave that stream: signature, checksum and lengths.
fn descriptor(input: &mut dyn Input, at: u64, directory: u64) -> Result<u64, FormatError> {
    let left = directory.saturating_sub(at);
    if left >= DESCRIPTOR && input.peek("a data descriptor", at, 4)? == DESCRIPTOR_MARK {
        return Ok(DESCRIPTOR);
    }
    Ok(0)
}

impl Member {
    /// Starts to unpack the member from its beginning.
    pub fn unpacker(&self) -> Unpacker {
        Unpacker::new(self.packing, self.byte_offset, self.packed)
    }

    /// Returns the first bytes, up to `count`.
    pub fn start(&self, file: &mut dyn ReadSeek, count: u64) -> io::Result<Vec<u8>> {
        let mut bytes = vec![0; self.length.min(count) as usize];
        let filled = self.unpacker().read(file, &mut bytes)?;
        bytes.truncate(filled);
        Ok(bytes)
    }

    /// Passes on the next `count` bytes in pieces of whole multiples of eight, except the last. At the end it checks
    /// the whole.
    pub fn unpack(
        &self,
        unpacker: &mut Unpacker,
        file: &mut dyn ReadSeek,
        mut count: u64,
        take: &mut dyn FnMut(&mut [u8]) -> io::Result<ControlFlow<()>>,
    ) -> io::Result<ControlFlow<()>> {
        let mut piece = vec![0; PIECE_BYTES.min(usize::try_from(count).unwrap_or(PIECE_BYTES))];
        while count > 0 {
            let wanted = piece.len().min(usize::try_from(count).unwrap_or(PIECE_BYTES));
            let filled = unpacker.read(file, &mut piece[..wanted])?;
            if filled < wanted {
                return Err(broken(format!(
                    "member {:?} unpacks to fewer bytes than it claims; copy the file again",
                    self.name
                )));
            }
            count -= filled as u64;
            if unpacker.position() == self.length {
                self.check(unpacker, file)?;
            }
            if take(&mut piece[..filled])?.is_break() {
                return Ok(ControlFlow::Break(()));
            }
        }
        Ok(ControlFlow::Continue(()))
    }

    /// Checks at the end of the member that nothing follows, and that its checksum is right.
    fn check(&self, unpacker: &mut Unpacker, file: &mut dyn ReadSeek) -> io::Result<()> {
        let crc = unpacker.crc();
        if unpacker.read(file, &mut [0])? != 0 {
            return Err(broken(format!(
                "member {:?} unpacks to more bytes than it claims; copy the file again",
                self.name
            )));
        }
        if crc != self.crc {
            return Err(broken(format!(
                "member {:?} does not have its checksum (CRC-32); copy the file again",
                self.name
            )));
        }
        Ok(())
    }
}

#[cfg(test)]
pub(super) mod tests;
