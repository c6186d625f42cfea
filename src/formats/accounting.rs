//! Which bytes of a file its reader used. What no record and no known part of the format covers is reported: it may be
//! a capture that was appended, padding after an interrupted copy, or a part that the reader does not know.

use std::ops::Range;

use crate::waveform::{Payload, Record};

/// Most stretches of a file that are reported one by one.
const REMARKS: usize = 8;

/// Something about a file that its records do not show. They can be used all the same.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Remark {
    /// Where in the file.
    pub byte_offset: u64,
    /// What it is, and what to do.
    pub problem: String,
    /// Whether the file ends within a record, so that records are missing.
    pub is_cut: bool,
}

/// What a reader says about the bytes of its file while it reads.
#[derive(Debug, Default)]
pub struct Ledger {
    used: Vec<Range<u64>>,
    remarks: Vec<Remark>,
}

impl Ledger {
    /// Counts bytes as used. Neighbours are merged, so that a file that is read in order takes one entry.
    pub fn uses(&mut self, bytes: Range<u64>) {
        if bytes.is_empty() {
            return;
        }
        match self.used.last_mut() {
            Some(last) if bytes.start >= last.start && bytes.start <= last.end => last.end = last.end.max(bytes.end),
            _ => self.used.push(bytes),
        }
    }

    /// Notes something that the records do not show.
    pub fn remark(&mut self, byte_offset: u64, problem: String) {
        self.remarks.push(Remark { byte_offset, problem, is_cut: false });
    }

    /// Notes that the file ends within one of its records, after `whole` others.
    pub fn cut_short(&mut self, byte_offset: u64, what: &str, whole: u64) {
        let problem = format!(
            "is cut short: it ends within {what} {whole}, counted from 0; the {whole} before it are read: copy it from \
             the instrument again, or go on without the rest"
        );
        self.remarks.push(Remark { byte_offset, problem, is_cut: true });
    }

    /// The reader's own remarks, then those on bytes that nothing uses and on records that share bytes. `files` are
    /// where the file and its companion lie.
    pub fn remarks(mut self, records: &[Record], files: &[Range<u64>]) -> Vec<Remark> {
        let mut payloads = Self::default();
        for (bytes, _) in records.iter().filter_map(payload) {
            payloads.uses(bytes);
        }
        self.used.append(&mut payloads.used);
        self.used.sort_unstable_by_key(|bytes| bytes.start);
        let mut remarks = self.remarks;
        remarks.extend(overlap(records));
        for file in files {
            remarks.extend(gaps(&self.used, file));
        }
        remarks
    }
}

/// The bytes of a record that lies unpacked in its file, and whether it has them for itself.
fn payload(record: &Record) -> Option<(Range<u64>, bool)> {
    let Payload::File { byte_offset, stride, .. } = record.payload else { return None };
    let width = record.head.code_type.bytes() as u64;
    let bytes = (record.head.samples as u64).saturating_sub(1) * stride + width;
    Some((byte_offset..byte_offset + bytes, stride == width))
}

/// The first place where two records that are not interleaved share bytes.
fn overlap(records: &[Record]) -> Option<Remark> {
    let alone = |record: &Record| payload(record).and_then(|(bytes, is_alone)| is_alone.then_some(bytes));
    let is_in_order = records.iter().filter_map(alone).is_sorted_by(|a, b| a.end <= b.start);
    if is_in_order {
        return None;
    }
    let mut all: Vec<Range<u64>> = records.iter().filter_map(alone).collect();
    all.sort_unstable_by_key(|bytes| bytes.start);
    let pair = all.windows(2).find(|pair| pair[1].start < pair[0].end)?;
    let problem = "two records share bytes from here on: an offset in the file is wrong; save the file again";
    Some(Remark { byte_offset: pair[1].start, problem: problem.to_owned(), is_cut: false })
}

/// Stretches of a file that are in none of the used ones, which are in order.
fn gaps(used: &[Range<u64>], file: &Range<u64>) -> Vec<Remark> {
    let mut stretches = Vec::new();
    let mut at = file.start;
    for bytes in used.iter().filter(|bytes| bytes.start < file.end && bytes.end > file.start) {
        if bytes.start > at {
            stretches.push(at..bytes.start);
        }
        at = at.max(bytes.end);
    }
    if at < file.end {
        stretches.push(at..file.end);
    }
    let left = stretches.len().saturating_sub(REMARKS);
    let mut remarks: Vec<Remark> = stretches.into_iter().take(REMARKS).map(|gap| of_gap(gap, file)).collect();
    if let Some(last) = remarks.last_mut().filter(|_| left > 0) {
        last.problem = format!("{} ({left} more such stretches follow)", last.problem);
    }
    remarks
}

fn of_gap(gap: Range<u64>, file: &Range<u64>) -> Remark {
    let count = gap.end - gap.start;
    let (bytes, belong) = if count == 1 { ("byte", "belongs") } else { ("bytes", "belong") };
    let place = if gap.end == file.end { "at the end of the file" } else { "before the next part" };
    let problem = format!(
        "{count} {bytes} {place} {belong} to nothing that the header describes; the rest is read. Compare the file with \
         the instrument's own: it may be appended to, padded, or damaged"
    );
    Remark { byte_offset: gap.start, problem, is_cut: false }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::waveform::{CodeType, Head};

    fn record(byte_offset: u64, stride: u64) -> Record {
        let head = Arc::new(Head::new("npy", CodeType::I16, 4));
        let payload = Payload::File { byte_offset, stride, big_endian: false };
        Record { head, segment: None, t0_s: None, trigger_s: None, payload }
    }

    /// Places of remarks on a file whose reader used the stretches from and up to these bytes.
    fn places(records: &[Record], used: &[(u64, u64)], length: u64) -> Vec<u64> {
        let mut ledger = Ledger::default();
        used.iter().for_each(|(start, end)| ledger.uses(*start..*end));
        let (file, companion) = (0..length, length..length + 5);
        ledger.uses(companion.clone());
        ledger.remarks(records, &[file, companion]).into_iter().map(|remark| remark.byte_offset).collect()
    }

    #[test]
    fn surplus_gaps_and_overlaps_are_distinguished() {
        assert_eq!(places(&[record(10, 2), record(18, 2)], &[(0, 10)], 26), []);
        assert_eq!(places(&[record(10, 2)], &[(0, 10)], 26), [18], "surplus at the end");
        assert_eq!(places(&[record(12, 2), record(22, 2)], &[(4, 10), (0, 2)], 30), [2, 10, 20], "gaps");
        assert_eq!(places(&[record(10, 2), record(16, 2)], &[(0, 10)], 24), [16], "overlap");
        assert_eq!(places(&[record(10, 4), record(12, 4)], &[(0, 10)], 26), [], "interleaved records share no byte");
        assert_eq!(places(&[record(10, 2), record(10, 2)], &[(0, 10)], 18), [10], "a record twice");
    }

    #[test]
    fn many_gaps_are_counted() {
        let mut ledger = Ledger::default();
        (0..20).for_each(|i| ledger.uses(2 * i..2 * i + 1));
        let file = 0..40;
        let remarks = ledger.remarks(&[], std::slice::from_ref(&file));
        assert_eq!(remarks.len(), REMARKS);
        assert!(remarks[REMARKS - 1].problem.contains("12 more"), "{remarks:?}");
    }
}
