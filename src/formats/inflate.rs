//! Unpacks deflated ranges of a file, piece by piece.

use std::io::{self, SeekFrom};

use flate2::{Crc, Decompress, FlushDecompress, Status};

use crate::waveform::ReadSeek;

/// Packed bytes that are in memory at a time.
const PIECE_BYTES: u64 = 1 << 15;
/// Largest ratio of unpacked to packed bytes. Deflate packs at best 258 bytes into two bits (RFC 1951), which is
/// slightly less.
const DENSEST: u64 = 1032;

/// Whether this many packed bytes can hold what the header claims.
pub(super) fn can_hold(packed: u64, claimed: u64) -> bool {
    packed.checked_mul(DENSEST).is_none_or(|most| claimed <= most)
}

/// How a range is packed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Packing {
    /// Not packed.
    Stored,
    /// Deflate without a header, as in zip files.
    Deflate,
    /// Deflate with the header and checksum of zlib, as in HDF5.
    Zlib,
}

/// The state of unpacking a range of a file.
#[derive(Debug)]
pub(super) struct Unpacker {
    state: Option<Decompress>,
    /// Packed bytes that are not read yet.
    next: u64,
    end: u64,
    /// Packed bytes in memory, and how many of them are unpacked.
    piece: Vec<u8>,
    used: usize,
    /// Number of unpacked bytes, and their checksum.
    crc: Crc,
    position: u64,
    ended: bool,
}

impl Unpacker {
    /// Starts at the `packed` bytes from `byte_offset` on.
    pub fn new(packing: Packing, byte_offset: u64, packed: u64) -> Self {
        let state = match packing {
            Packing::Stored => None,
            Packing::Deflate => Some(Decompress::new(false)),
            Packing::Zlib => Some(Decompress::new(true)),
        };
        Self {
            state,
            next: byte_offset,
            end: byte_offset.saturating_add(packed),
            piece: Vec::new(),
            used: 0,
            crc: Crc::new(),
            position: 0,
            ended: false,
        }
    }

    /// Whether its range is not packed at all.
    pub fn is_stored(&self) -> bool {
        self.state.is_none()
    }

    /// Number of unpacked bytes so far.
    pub fn position(&self) -> u64 {
        self.position
    }

    /// CRC-32 of the unpacked bytes so far.
    pub fn crc(&self) -> u32 {
        self.crc.sum()
    }

    /// Unpacks into all of `out`, or up to the end; returns the number of bytes.
    pub fn read(&mut self, file: &mut dyn ReadSeek, out: &mut [u8]) -> io::Result<usize> {
        let mut filled = 0;
        while filled < out.len() && !self.ended {
            if self.used == self.piece.len() {
                self.refill(file)?;
            }
            let (packed, rest) = (&self.piece[self.used..], &mut out[filled..]);
            let (bytes_in, bytes_out) = match &mut self.state {
                None => {
                    let count = packed.len().min(rest.len());
                    rest[..count].copy_from_slice(&packed[..count]);
                    self.ended = packed.is_empty();
                    (count, count)
                }
                Some(state) => {
                    let before = (state.total_in(), state.total_out());
                    let status = state.decompress(packed, rest, FlushDecompress::None).map_err(|error| {
                        broken(format!(
                            "its compressed samples are damaged ({error}); copy it from the instrument again"
                        ))
                    })?;
                    let count = ((state.total_in() - before.0) as usize, (state.total_out() - before.1) as usize);
                    self.ended = status == Status::StreamEnd;
                    if count == (0, 0) && !self.ended {
                        return Err(io::Error::new(
                            io::ErrorKind::UnexpectedEof,
                            "its compressed samples end too early",
                        ));
                    }
                    count
                }
            };
            self.used += bytes_in;
            filled += bytes_out;
        }
        self.crc.update(&out[..filled]);
        self.position += filled as u64;
        Ok(filled)
    }

    fn refill(&mut self, file: &mut dyn ReadSeek) -> io::Result<()> {
        let count = (self.end - self.next).min(PIECE_BYTES);
        self.piece.resize(count as usize, 0);
        self.used = 0;
        file.seek(SeekFrom::Start(self.next))?;
        file.read_exact(&mut self.piece)?;
        self.next += count;
        Ok(())
    }
}

/// An error in packed samples: it appears only when they are read, not with the header.
pub(super) fn broken(problem: impl Into<String>) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, problem.into())
}

#[cfg(test)]
mod tests {
    use std::io::{Cursor, Write};

    use super::*;

    fn packed(packing: Packing, bytes: &[u8]) -> Vec<u8> {
        let level = flate2::Compression::default();
        match packing {
            Packing::Stored => bytes.to_vec(),
            Packing::Deflate => {
                let mut writer = flate2::write::DeflateEncoder::new(Vec::new(), level);
                writer.write_all(bytes).unwrap();
                writer.finish().unwrap()
            }
            Packing::Zlib => {
                let mut writer = flate2::write::ZlibEncoder::new(Vec::new(), level);
                writer.write_all(bytes).unwrap();
                writer.finish().unwrap()
            }
        }
    }

    fn numbers() -> Vec<u8> {
        (0..200_000_u32).flat_map(|i| (i.wrapping_mul(2_654_435_761) >> 12).to_le_bytes()).collect()
    }

    #[test]
    fn a_stretch_is_unpacked_in_pieces_of_any_size() {
        let bytes = numbers();
        for packing in [Packing::Stored, Packing::Deflate, Packing::Zlib] {
            let packed = packed(packing, &bytes);
            let mut file = Cursor::new([b"head".as_slice(), &packed, b"tail"].concat());
            let mut unpacker = Unpacker::new(packing, 4, packed.len() as u64);
            let mut unpacked = Vec::new();
            let mut piece = vec![0; 70_001];
            loop {
                let count = unpacker.read(&mut file, &mut piece).unwrap();
                unpacked.extend_from_slice(&piece[..count]);
                if count < piece.len() {
                    break;
                }
            }
            assert!(unpacked == bytes && unpacker.position() == bytes.len() as u64);
            let mut crc = Crc::new();
            crc.update(&bytes);
            assert_eq!(unpacker.crc(), crc.sum());
        }
    }

    #[test]
    fn what_is_cut_or_damaged_is_an_error() {
        let bytes = numbers();
        let packed = packed(Packing::Zlib, &bytes);
        let mut out = vec![0; bytes.len() + 1];
        let mut cut = Unpacker::new(Packing::Zlib, 0, packed.len() as u64 - 10);
        assert!(cut.read(&mut Cursor::new(&packed), &mut out).unwrap_err().to_string().contains("end too early"));
        let mut damaged = packed.clone();
        damaged[0] = 0;
        let mut unpacker = Unpacker::new(Packing::Zlib, 0, packed.len() as u64);
        assert!(unpacker.read(&mut Cursor::new(&damaged), &mut out).unwrap_err().to_string().contains("are damaged"));
        let mut short = Unpacker::new(Packing::Zlib, 0, packed.len() as u64 + 1);
        assert!(short.read(&mut Cursor::new(&packed), &mut out).is_err() || short.position() == bytes.len() as u64);
        assert!(can_hold(1, 1032) && !can_hold(1, 1033) && can_hold(u64::MAX, u64::MAX));
    }
}
