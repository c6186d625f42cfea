//! NumPy `.npz`: a zip file of `.npy` members, stored (`numpy.savez`) or deflated (`numpy.savez_compressed`).
//!
//! Each array is a channel with the member's name: its last axis counts samples, the leading ones count segments. A
//! caller may name one array (`variable`) and its axes. The file has no scale and no time base, so values are the
//! numbers themselves. An array named `time` is a channel like any other. Single numbers (arrays without axes) are
//! omitted. Each read unpacks deflated members and compares their checksums at the end; stored members are not
//! compared. A deflated array whose samples lie apart is unpacked whole, if it is at most twice as large as the file.
//!
//! Refused by name: Zip64 (arrays of 4 GiB and more), encryption, and what the `.npy` reader refuses. Tested on files
//! that the tests build and on files of NumPy; no file of an instrument was available.

use std::io;
use std::ops::ControlFlow;
use std::sync::{Arc, Mutex};

use super::array::{self, Arrays};
use super::description::{Description, Key};
use super::inflate::{Packing, Unpacker};
use super::npy::{self, Array, HEADER_BYTES};
use super::reader::{FormatError, Input, Reader};
use super::zip_file::{self, Member};
use crate::waveform::{CodeType, Head, Payload, ReadSeek, Record, Unpack};

/// The reader.
pub struct Npz;

impl Reader for Npz {
    fn format(&self) -> &'static str {
        "npz"
    }
    fn extensions(&self) -> &'static [&'static str] {
        &["npz"]
    }
    fn recognises(&self, head: &[u8]) -> bool {
        zip_file::first_name(head).is_some_and(|name| name.ends_with(b".npy"))
    }

    fn keys(&self) -> &'static [Key] {
        &[Key::Variable, Key::Axes]
    }

    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let mut records = Vec::new();
        let resumed = Arc::new(Resumed::default());
        let members = zip_file::members(input)?;
        let description = input.description().clone();
        let variable = variable(&description, &members)?;
        let mut room = 2 * input.length() + (1 << 18);
        for member in
            members.into_iter().filter(|member| variable.as_deref().is_none_or(|variable| name(member) == variable))
        {
            let named = |error: FormatError| {
                let problem = format!("member {:?}: {error}", member.name);
                FormatError::Field { byte_offset: member.byte_offset, problem }
            };
            let bytes = member.start(input.file(), HEADER_BYTES).map_err(|error| named(error.into()))?;
            let Some(array) = Array::read(&bytes, member.length, description.axes.as_deref()).map_err(named)? else {
                continue;
            };
            if array.data + array.bytes() != member.length {
                let problem = format!(
                    "member {:?} has {} bytes, its array {}; save it again",
                    member.name,
                    member.length,
                    array.data + array.bytes()
                );
                return Err(FormatError::Field { byte_offset: member.byte_offset, problem });
            }
            let each = size_of::<Record>() + size_of::<Deflated>();
            array.grid.limit(input.length(), records.len(), each).map_err(named)?;
            let lies_apart = member.packing != Packing::Stored && !array.grid.is_contiguous();
            let codes = lies_apart.then(|| unpack(input, &member, &array, &mut room)).transpose()?;
            records.extend(self.records_of(member, &array, codes, &resumed));
        }
        if records.is_empty() {
            let problem = "holds no array of samples; save the waveforms with numpy.savez".to_owned();
            return Err(FormatError::Field { byte_offset: 0, problem });
        }
        Ok(records)
    }
}

/// Returns the arrays whose names `wanted` accepts, with all of their axes, and the names of all arrays. An array may
/// have `most_bytes`.
///
/// # Errors
/// When the file contradicts the format, or a wanted member is no array of numbers, or a larger one.
pub fn arrays(
    input: &mut dyn Input,
    wanted: impl Fn(&str) -> bool,
    most_bytes: u64,
) -> Result<(Arrays, Vec<String>), FormatError> {
    let members = zip_file::members(input)?;
    let mut arrays = Arrays::new();
    for member in members.iter().filter(|member| wanted(name(member))) {
        let refuse = |problem: String| FormatError::Field { byte_offset: member.byte_offset, problem };
        array::check_size(name(member), member.length, most_bytes).map_err(refuse)?;
        let mut bytes = Vec::new();
        let _ = member.unpack(&mut member.unpacker(), input.file(), member.length, &mut |piece| {
            bytes.extend_from_slice(piece);
            Ok(ControlFlow::Continue(()))
        })?;
        let array = npy::whole(&bytes).map_err(|error| refuse(format!("member {:?}: {error}", member.name)))?;
        arrays.insert(name(member).to_owned(), array);
    }
    Ok((arrays, members.iter().map(|member| name(member).to_owned()).collect()))
}

/// Name of an array.
fn name(member: &Member) -> &str {
    member.name.strip_suffix(".npy").unwrap_or(&member.name)
}

/// The array that is to be read alone, if one is named. Axes can only be those of one array.
fn variable(description: &Description, members: &[Member]) -> Result<Option<String>, FormatError> {
    if description.variable.is_none() && description.axes.is_none() {
        return Ok(None);
    }
    let names: Vec<&str> = members.iter().map(name).collect();
    Ok(Some(names[description.array(&names)?].to_owned()))
}

/// The numbers of a compressed array, little-endian. `room` is what memory may still take.
fn unpack(input: &mut dyn Input, member: &Member, array: &Array, room: &mut u64) -> Result<Arc<Vec<u8>>, FormatError> {
    *room = room.checked_sub(array.bytes()).ok_or_else(|| {
        let problem = format!(
            "member {:?} unpacks to {} bytes, too many for its file, and the samples of a record lie apart; save it \
             with numpy.savez, or with the samples on the last axis",
            member.name,
            array.bytes()
        );
        FormatError::Field { byte_offset: member.byte_offset, problem }
    })?;
    let mut unpacker = member.unpacker();
    let mut codes = Vec::with_capacity(array.bytes() as usize);
    let _ = member.unpack(&mut unpacker, input.file(), array.data, &mut |_| Ok(ControlFlow::Continue(())))?;
    let _ = member.unpack(&mut unpacker, input.file(), array.bytes(), &mut |piece| {
        codes.extend_from_slice(piece);
        Ok(ControlFlow::Continue(()))
    })?;
    if array.big_endian {
        array.code_type.swap_bytes(&mut codes);
    }
    Ok(Arc::new(codes))
}

impl Npz {
    fn records_of(
        &self,
        member: Member,
        array: &Array,
        codes: Option<Arc<Vec<u8>>>,
        resumed: &Arc<Resumed>,
    ) -> Vec<Record> {
        let Array { code_type, big_endian, data, ref grid } = *array;
        let head = Head { channel: Some(name(&member).to_owned()), ..grid.head(self.format(), code_type) };
        let member = Arc::new(member);
        grid.list(head, |i| match (&codes, member.packing) {
            (Some(codes), _) => grid.gather(i, codes, code_type),
            (None, Packing::Stored) => grid.payload(i, member.byte_offset + data, code_type, big_endian),
            _ => Payload::Packed(Arc::new(Deflated {
                member: Arc::clone(&member),
                start: data + grid.start(i) * code_type.bytes() as u64,
                bytes: array.record_bytes(),
                swapped: big_endian.then_some(code_type),
                resumed: Arc::clone(resumed),
            })),
        })
    }
}

/// Where unpacking stopped, and in which member (by its place in the file). The next segment continues there.
type Resumed = Mutex<Option<(u64, Unpacker)>>;

/// A record in a deflated member.
#[derive(Debug)]
struct Deflated {
    member: Arc<Member>,
    /// Where it begins among the unpacked bytes.
    start: u64,
    bytes: u64,
    /// Type of its codes, if they are big-endian.
    swapped: Option<CodeType>,
    resumed: Arc<Resumed>,
}

impl Unpack for Deflated {
    fn unpack(
        &self,
        file: &mut dyn ReadSeek,
        take: &mut dyn FnMut(&[u8]) -> io::Result<ControlFlow<()>>,
    ) -> io::Result<()> {
        let place = self.member.byte_offset;
        let resumed = self.resumed.lock().ok().and_then(|mut resumed| resumed.take());
        let before = |unpacker: &Unpacker| unpacker.position() <= self.start;
        let mut unpacker = match resumed {
            Some((member, unpacker)) if member == place && before(&unpacker) => unpacker,
            _ => self.member.unpacker(),
        };
        let skipped = self.start - unpacker.position();
        let _ = self.member.unpack(&mut unpacker, file, skipped, &mut |_| Ok(ControlFlow::Continue(())))?;
        let mut take = |piece: &mut [u8]| {
            if let Some(code_type) = self.swapped {
                code_type.swap_bytes(piece);
            }
            take(piece)
        };
        let _ = self.member.unpack(&mut unpacker, file, self.bytes, &mut take)?;
        if unpacker.position() < self.member.length
            && let Ok(mut resumed) = self.resumed.lock()
        {
            *resumed = Some((place, unpacker));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;
    use std::path::Path;

    use super::super::hostile;
    use super::super::zip_file::tests::{Local, zip};
    use super::*;
    use crate::Source;

    /// Counts the bytes that are read.
    struct Counting<'a> {
        file: Cursor<&'a Vec<u8>>,
        read: usize,
    }
    impl io::Read for Counting<'_> {
        fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
            let count = self.file.read(bytes)?;
            self.read += count;
            Ok(count)
        }
    }
    impl io::Seek for Counting<'_> {
        fn seek(&mut self, to: io::SeekFrom) -> io::Result<u64> {
            self.file.seek(to)
        }
    }

    fn array<T: npy::Number>(shape: &[u64], values: &[T]) -> Vec<u8> {
        let mut bytes = Vec::new();
        npy::write(&mut bytes, shape, values).unwrap();
        bytes
    }

    /// Two segments of three 16 bit codes, big-endian.
    fn swapped() -> Vec<u8> {
        let mut bytes = array(&[2, 3], &[1_i16, -2, 300, 4, 5, 6]);
        let type_code = bytes.windows(3).position(|window| window == b"<i2").unwrap();
        bytes[type_code] = b'>';
        let data = bytes.len() - 12;
        bytes[data..].chunks_exact_mut(2).for_each(<[u8]>::reverse);
        bytes
    }

    fn file(deflate: bool, local: Local) -> Vec<u8> {
        let (one, dt) = (array(&[4], &[0.5_f64, 1.5, -1.0, 9.0]), array(&[], &[1e-9]));
        zip(&[("L1.npy", &one), ("dt.npy", &dt), ("L2.npy", &swapped())], deflate, local)
    }

    fn records(bytes: &[u8]) -> Result<Vec<Record>, String> {
        let mut source = Source::new(Cursor::new(bytes), Path::new("a.npz")).unwrap();
        Npz.records(&mut source).map_err(|error| error.to_string())
    }

    fn values(record: &Record, bytes: &[u8]) -> Vec<f64> {
        record.values(&record.read(&mut Cursor::new(bytes), 0..record.head.samples).unwrap())
    }

    #[test]
    fn arrays_are_channels_and_leading_axes_segments() {
        for (deflate, local) in [(false, Local::Zip64), (true, Local::Lengths), (true, Local::Streamed)] {
            let bytes = file(deflate, local);
            assert!(Npz.recognises(&bytes));
            let records = records(&bytes).unwrap();
            assert_eq!(records.len(), 3);
            assert_eq!(values(&records[0], &bytes), [0.5, 1.5, -1.0, 9.0]);
            for _ in 0..2 {
                assert_eq!(values(&records[1], &bytes), [1.0, -2.0, 300.0]);
                assert_eq!(values(&records[2], &bytes), [4.0, 5.0, 6.0]);
            }
            let key = |record: &Record| (record.head.channel.clone().unwrap(), record.segment, record.t0_s);
            assert_eq!(key(&records[0]), ("L1".to_owned(), None, None));
            assert_eq!(key(&records[2]), ("L2".to_owned(), Some(1), None));
            assert_eq!(records[2].head.shape, [2]);
        }
    }

    #[test]
    fn long_segments_are_read_in_any_order() {
        let codes: Vec<i32> = (0..120_000).map(|i: i32| i.wrapping_mul(48_271) >> 8).collect();
        let bytes = zip(&[("a.npy", &array(&[3, 40_000], &codes))], true, Local::Lengths);
        let records = records(&bytes).unwrap();
        for i in [2, 0, 1, 1, 2, 0] {
            let expected = codes[i * 40_000..(i + 1) * 40_000].iter().map(|&code| f64::from(code));
            assert!(values(&records[i], &bytes).into_iter().eq(expected), "segment {i}");
        }
        // If segments are read in order, the file is unpacked once.
        let mut counting = Counting { file: Cursor::new(&bytes), read: 0 };
        for record in &records {
            record.read(&mut counting, 0..40_000).unwrap();
        }
        assert!(counting.read < bytes.len() + 1, "{} of {} bytes read", counting.read, bytes.len());
        let middle = records[1].read(&mut Cursor::new(&bytes), 17..19).unwrap();
        assert_eq!(middle, [codes[40_017], codes[40_018]].map(i32::to_le_bytes).concat());
    }

    #[test]
    fn what_is_wrong_is_said() {
        let error = |members: &[(&str, &[u8])]| records(&zip(members, false, Local::Lengths)).unwrap_err();
        assert!(error(&[]).contains("holds no array"));
        assert!(error(&[("dt.npy", &array(&[], &[1.0]))]).contains("holds no array"));
        assert!(error(&[("notes.txt", b"no array at all")]).contains("\"notes.txt\": byte 0: header"));
        let one = array(&[2], &[1.0, 2.0]);
        assert!(error(&[("a.npy", &one[..one.len() - 1])]).contains("\"a.npy\": byte 128: shape [2] does not fit"));
        assert!(error(&[("a.npy", &[one.as_slice(), b"more"].concat())]).contains("has 148 bytes, its array 144"));
        let mut long = array(&[2], &[1_i32, 0]);
        let width = long.windows(3).position(|window| window == b"<i4").unwrap() + 2;
        long[width] = b'8';
        assert!(error(&[("a.npy", &long)]).contains("are not read; save them as"));
        let short = array(&[40_000, 1], &vec![0_u8; 40_000]);
        assert!(error(&[("a.npy", &short)]).contains("40000 records of 1 samples"));
    }

    #[test]
    fn damaged_samples_are_found_when_they_are_read() {
        let bytes = zip(&[("a.npy", &array(&[1000], &[7_i16; 1000]))], true, Local::Lengths);
        let mut damaged = bytes.clone();
        let directory = bytes.windows(4).position(|window| window == b"PK\x01\x02").unwrap();
        damaged[directory + 16] ^= 1;
        let record = records(&damaged).unwrap().remove(0);
        let error = record.read(&mut Cursor::new(&damaged), 0..1000).unwrap_err().to_string();
        assert!(error.contains("checksum"), "{error}");
    }

    fn described(bytes: &[u8], variable: Option<&str>, axes: Option<&[&str]>) -> Result<Vec<Vec<f64>>, String> {
        let axes = axes.map(|axes| axes.iter().map(ToString::to_string).collect());
        let description = Description { variable: variable.map(str::to_owned), axes, ..Description::default() };
        let mut source = Source::new(Cursor::new(bytes), Path::new("a.npz")).unwrap().described(description);
        let records = crate::records(&mut source).map_err(|error| error.to_string())?;
        Ok(records.iter().map(|record| values(record, bytes)).collect())
    }

    /// An array of 3 shots of 4 samples in both orders, each number 10 * shot + sample.
    #[test]
    fn a_named_array_is_read_in_any_order_of_axes() {
        let c: Vec<i16> = (0..12).map(|n| 10 * (n / 4) + n % 4).collect();
        let mut fortran = array(&[3, 4], &(0..12).map(|n| 10 * (n % 3) + n / 3).collect::<Vec<i16>>());
        let at = fortran.windows(5).position(|bytes| bytes == b"False").expect("the order");
        fortran[at..at + 5].copy_from_slice(b"True ");
        let members = [("c.npy", array(&[3, 4], &c)), ("fortran.npy", fortran), ("x.npy", array(&[2], &[1.0, 2.0]))];
        let members = members.each_ref().map(|(name, bytes)| (*name, bytes.as_slice()));
        let shots = |shot: i16| (0..4).map(|sample| f64::from(10 * shot + sample)).collect::<Vec<f64>>();
        let samples = |sample: i16| (0..3).map(|shot| f64::from(10 * shot + sample)).collect::<Vec<f64>>();
        for deflate in [false, true] {
            let bytes = zip(&members, deflate, Local::Lengths);
            for name in ["c", "fortran.npy"] {
                let (by_shot, by_sample) = ([0, 1, 2].map(shots), [0, 1, 2, 3].map(samples));
                assert_eq!(described(&bytes, Some(name), None).unwrap(), by_shot, "{name}, deflated {deflate}");
                assert_eq!(described(&bytes, Some(name), Some(&["shot", "time"])).unwrap(), by_shot);
                assert_eq!(described(&bytes, Some(name), Some(&["time", "shot"])).unwrap(), by_sample);
            }
            assert_eq!(described(&bytes, None, None).unwrap().len(), 7, "each array is a channel");
            let error = described(&bytes, Some("d"), None).unwrap_err();
            assert!(error.contains("it has c, fortran, x"), "{error}");
            let error = described(&bytes, None, Some(&["time", "shot"])).unwrap_err();
            assert!(error.contains("`variable` is missing"), "{error}");
        }
    }

    /// Two rows of three numbers, 10 * row + column, however they are stored.
    #[test]
    fn whole_arrays_keep_their_axes() {
        let head = |from: &str, to: &str, mut bytes: Vec<u8>| {
            let at = bytes.windows(from.len()).position(|window| window == from.as_bytes()).expect("in the header");
            bytes[at..at + from.len()].copy_from_slice(to.as_bytes());
            bytes
        };
        let plain = array(&[2, 3], &[0.0, 1.0, 2.0, 10.0, 11.0, 12.0]);
        let fortran = head("False", "True ", array(&[2, 3], &[0_i16, 10, 1, 11, 2, 12]));
        // Integers of 64 bits, as NumPy has them by default, big-endian: floats give the room of eight bytes.
        let bits = [0_i64, 1, 2, 10, 11, -12].map(|number| f64::from_bits(number.swap_bytes() as u64));
        let long = head("<f8", ">i8", array(&[2, 3], &bits));
        let unsigned = head("<f4", "<u4", array(&[1], &[f32::from_bits(4_000_000_000)]));
        let members = [
            ("plain.npy", plain.as_slice()),
            ("fortran.npy", &fortran),
            ("long.npy", &long),
            ("unsigned.npy", &unsigned),
            ("dt_ps.npy", &array(&[], &[16.0])),
            ("notes.txt", b"no array"),
        ];
        for deflate in [false, true] {
            let bytes = zip(&members, deflate, Local::Lengths);
            let read = |most_bytes: u64| {
                let mut source = Source::new(Cursor::new(&bytes), Path::new("a.npz")).unwrap();
                arrays(&mut source, |name| name != "notes.txt", most_bytes).map_err(|error| error.to_string())
            };
            let (arrays, names) = read(u64::MAX).unwrap();
            assert_eq!(names, ["plain", "fortran", "long", "unsigned", "dt_ps", "notes.txt"]);
            assert_eq!((arrays["plain"].axes.as_slice(), arrays["dt_ps"].axes.len()), (&[2, 3][..], 0));
            assert_eq!(arrays["plain"].values(), [0.0, 1.0, 2.0, 10.0, 11.0, 12.0]);
            assert_eq!(arrays["fortran"].values(), [0.0, 1.0, 2.0, 10.0, 11.0, 12.0]);
            assert_eq!(arrays["long"].values(), [0.0, 1.0, 2.0, 10.0, 11.0, -12.0]);
            assert_eq!(arrays["unsigned"].values(), [4e9]);
            assert_eq!(arrays["dt_ps"].values(), [16.0]);
            assert!(read(100).unwrap_err().contains("may take 100"));
        }
    }

    #[test]
    fn hostile_files_are_refused_or_decoded_whole() {
        for (deflate, local) in [(false, Local::Zip64), (true, Local::Lengths)] {
            hostile::cut_everywhere(&Npz, &file(deflate, local));
            hostile::change_anywhere(&Npz, &file(deflate, local), 3000);
        }
    }
}
