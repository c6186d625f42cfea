//! Bytes that belong to no record, in real files: put in, doubled, padded. Each is reported or refused, never read as
//! if nothing were there.

use std::fs;
use std::io::{Cursor, Read, Seek};
use std::path::{Path, PathBuf};

use periscope::formats::companions::companion;
use periscope::formats::{self, Source};

use crate::scope_samples::samples;

/// Longer files are left out: each is read some hundred times.
const LONGEST_BYTES: u64 = 4 << 20;
/// Places at which bytes are put in, evenly over a file.
const PLACES: usize = 24;
/// Texts: what is put into a number or a name may give another one.
const TEXTS: [&str; 4] = ["csv", "tek-isf", "lecroy-ascii", "rs-bin"];
/// What is no surplus: the byte that a chunk of odd length lacks, and more values below values, without heads or times.
const NO_SURPLUS: [(&str, &str); 2] = [("wav", "padded with 1 byte"), ("Wfm.csv", "doubled")];

/// What is said about a file: why it is refused, or the remarks on it, with those of its values.
fn said<F: Read + Seek>(source: Source<F>) -> Result<Vec<String>, String> {
    let mut source = source;
    let contents = formats::contents(&mut source).map_err(|error| error.to_string())?;
    let mut said: Vec<String> = contents.remarks.iter().map(|remark| remark.problem.clone()).collect();
    for record in &contents.records {
        // Compressed samples show only while they are unpacked that they are broken.
        said.extend(source.values(record).err().map(|error| error.to_string()));
    }
    Ok(said)
}

/// A file in memory, in front of the bytes of its companion.
fn source(file: &[u8], beside: &[u8], path: &Path) -> Source<Cursor<Vec<u8>>> {
    Source::with_companion(Cursor::new([file, beside].concat()), file.len() as u64, path).unwrap()
}

/// Ways in which bytes are too many, with the changed file.
fn changed(bytes: &[u8]) -> Vec<(String, Vec<u8>)> {
    let mut changed = vec![
        ("doubled".to_owned(), [bytes, bytes].concat()),
        ("padded with 1 byte".to_owned(), [bytes, &[0]].concat()),
        ("padded with 4096 bytes".to_owned(), [bytes, &[0; 4096]].concat()),
    ];
    for place in 0..PLACES {
        let at = place * bytes.len() / PLACES;
        let (start, end) = bytes.split_at(at);
        for put_in in [&[0xA5; 16][..], &[1, 2, 3]] {
            changed.push((format!("{} bytes put in at byte {at}", put_in.len()), [start, put_in, end].concat()));
        }
    }
    changed
}

fn files(folder: &Path, files_there: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files(&path, files_there);
        } else {
            files_there.push(path);
        }
    }
}

#[test]
fn surplus_bytes_in_real_files_are_reported_or_refused() {
    let Some(folder) = samples() else { return };
    let mut all = Vec::new();
    files(&folder, &mut all);
    all.sort();
    let (mut tried, mut silent) = (0, Vec::new());
    for path in all {
        if fs::metadata(&path).unwrap().len() > LONGEST_BYTES {
            continue;
        }
        let bytes = fs::read(&path).unwrap();
        let beside = companion(&path).and_then(|companion| fs::read(companion).ok()).unwrap_or_default();
        let Ok(before) = said(source(&bytes, &beside, &path)) else { continue };
        let format = formats::records(&mut source(&bytes, &beside, &path)).unwrap()[0].head.format;
        let is_text = TEXTS.iter().any(|text| format.ends_with(text));
        for (how, changed) in changed(&bytes) {
            let is_no_surplus = |(name, way): &(&str, &str)| path.to_string_lossy().ends_with(name) && how == *way;
            if is_text && how.contains("put in") || NO_SURPLUS.iter().any(is_no_surplus) {
                continue;
            }
            tried += 1;
            if said(source(&changed, &beside, &path)).is_ok_and(|after| after == before) {
                silent.push(format!("{} ({format}): {how}", path.display()));
            }
        }
    }
    println!("{tried} changed files");
    assert!(silent.is_empty(), "{} of {tried} changed files without a word:\n{}", silent.len(), silent.join("\n"));
}
