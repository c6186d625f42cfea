//! Data sets of several axes, read whole.

use super::super::array::{self, Array};
use super::super::inflate::{self, Packing, Unpacker};
use super::super::reader::FormatError;
use super::dataset::{Layout, deflated};
use super::field;
use super::file::{File, Header, UNDEFINED, message, u32_at, u64_at};
use super::value::{Number, axes};

/// Most axes of a data set (H5S_MAX_RANK).
const AXES_MAX: usize = 32;

impl Array {
    /// Reads the numbers of an object of at most `most_bytes`; `None` for a null data space.
    pub(super) fn read(file: &mut File, name: &str, at: u64, most_bytes: u64) -> Result<Option<Self>, FormatError> {
        let header = file.header(at)?;
        let refuse = |problem: &str| field(at, format!("{name} {problem}"));
        let Some(axes) = axes(header.need(message::DATASPACE, "data space")?) else { return Ok(None) };
        let number = Number::parse(header.need(message::DATATYPE, "data type")?)
            .ok_or_else(|| refuse("is no array of integers or IEEE numbers; save it as such"))?;
        let bytes = array::bytes_of(&axes, number.bytes())
            .filter(|_| axes.len() <= AXES_MAX)
            .ok_or_else(|| refuse("has more numbers than any memory"))?;
        array::check_size(name, bytes, most_bytes).map_err(|problem| field(at, problem))?;
        let mut codes = match Layout::read(&header)? {
            Layout::Compact(data) if data.len() as u64 == bytes => data.to_vec(),
            Layout::Contiguous { at, bytes: stored } if stored == bytes && at != UNDEFINED => {
                file.samples(at, bytes)?
            }
            Layout::Compact(_) | Layout::Contiguous { .. } => {
                return Err(refuse("was not written as long as its axes say; save it again"));
            }
            Layout::Chunked { tree, chunk, element } => {
                if chunk.len() != axes.len() || chunk.contains(&0) || element != number.bytes() as u64 {
                    return Err(refuse("has chunks that do not fit its axes or type; copy the file again"));
                }
                Chunks { axes: &axes, chunk: &chunk, element: number.bytes() }.read(file, &header, name, tree, bytes)?
            }
        };
        if number.big_endian {
            codes.chunks_exact_mut(number.bytes()).for_each(<[u8]>::reverse);
        }
        let code_type = number.code_type();
        if code_type.is_none() {
            codes = array::from_long(&codes, number.signed);
        }
        let code_type = code_type.unwrap_or(crate::waveform::CodeType::F64);
        Ok(Some(Self { axes: array::lengths(&axes), code_type, codes }))
    }
}

/// How a data set is divided into chunks.
struct Chunks<'a> {
    axes: &'a [u64],
    chunk: &'a [u64],
    element: usize,
}

impl Chunks<'_> {
    fn read(
        &self,
        file: &mut File,
        header: &Header,
        name: &str,
        tree: u64,
        bytes: u64,
    ) -> Result<Vec<u8>, FormatError> {
        let refuse = |problem: String| field(header.place, format!("{name} {problem}"));
        let deflated = deflated(header)?;
        let rank = self.axes.len();
        let mut stored: Vec<(Vec<u64>, u64, u64, Packing)> = Vec::new();
        if tree != UNDEFINED {
            // A key holds the bytes of the chunk, skipped filters, and the start of the chunk on each axis.
            file.leaves(tree, 1, 16 + 8 * rank, &mut |key, at| {
                let packing = if deflated && u32_at(key, 4) & 1 == 0 { Packing::Zlib } else { Packing::Stored };
                let start = (0..rank).map(|axis| u64_at(key, 8 + 8 * axis)).collect();
                stored.push((start, at, u64::from(u32_at(key, 0)), packing));
            })?;
        }
        let needed: u64 = self.axes.iter().zip(self.chunk).map(|(axis, chunk)| axis.div_ceil(*chunk)).product();
        let is_in_place = |start: &[u64]| {
            let cells = start.iter().zip(self.axes.iter().zip(self.chunk));
            cells.into_iter().all(|(start, (axis, chunk))| start % chunk == 0 && start < axis)
        };
        stored.sort_by(|a, b| a.0.cmp(&b.0));
        let is_twice = stored.windows(2).any(|two| two[0].0 == two[1].0);
        if stored.len() as u64 != needed || is_twice || !stored.iter().all(|(start, ..)| is_in_place(start)) {
            let problem = format!("has {} of {needed} chunks in their places; save it again", stored.len());
            return Err(refuse(problem));
        }
        let chunk_bytes = array::bytes_of(self.chunk, self.element)
            .filter(|chunk_bytes| stored.iter().all(|(_, _, packed, _)| inflate::can_hold(*packed, *chunk_bytes)))
            .ok_or_else(|| refuse("has chunks that cannot hold what they should; copy the file again".to_owned()))?;
        let mut out = vec![0; bytes as usize];
        let mut piece = vec![0; chunk_bytes as usize];
        for (start, at, packed, packing) in stored {
            let at = file.claim(at, packed)?;
            let mut unpacker = Unpacker::new(packing, at, packed);
            if unpacker.read(file.packed(), &mut piece)? < piece.len() {
                return Err(refuse("has a chunk that unpacks to too little; copy the file again".to_owned()));
            }
            self.place(&start, &piece, &mut out);
        }
        Ok(out)
    }

    /// Copies a chunk to its place, row by row along the last axis. Chunks at the border extend beyond the axes: that
    /// is cut off.
    fn place(&self, start: &[u64], piece: &[u8], out: &mut [u8]) {
        let rank = self.axes.len();
        let own: Vec<usize> =
            (0..rank).map(|axis| self.chunk[axis].min(self.axes[axis] - start[axis]) as usize).collect();
        let Some((row, leading)) = own.split_last() else { return out.copy_from_slice(piece) };
        for n in 0..leading.iter().product::<usize>() {
            let (mut rest, mut from, mut to) = (n, 0, 0);
            let (mut from_stride, mut to_stride) = (self.chunk[rank - 1] as usize, self.axes[rank - 1] as usize);
            for axis in (0..rank - 1).rev() {
                let place = rest % own[axis];
                rest /= own[axis];
                from += place * from_stride;
                to += (place + start[axis] as usize) * to_stride;
                from_stride *= self.chunk[axis] as usize;
                to_stride *= self.axes[axis] as usize;
            }
            let (from, to) = (from * self.element, (to + start[rank - 1] as usize) * self.element);
            let bytes = row * self.element;
            out[to..to + bytes].copy_from_slice(&piece[from..from + bytes]);
        }
    }
}
