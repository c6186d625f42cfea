//! Seeds for the fuzzing of each reader: `seeds CORPUS [FOLDER...]` copies the smaller files in these folders to
//! `CORPUS/FORMAT/` of the format that takes them.

use std::fs;
use std::path::{Path, PathBuf};

use periscope_formats::companions::companion;
use periscope_formats::{Source, reader};

/// Larger files slow the fuzzer down more than they teach it.
const SEED_BYTES: u64 = 128 << 10;

fn main() -> std::io::Result<()> {
    let mut args = std::env::args_os().skip(1).map(PathBuf::from);
    let corpus = args.next().expect("usage: seeds CORPUS [FOLDER...]");
    let mut folders: Vec<PathBuf> = args.collect();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder)? {
            let path = entry?.path();
            if path.is_dir() {
                folders.push(path);
            } else if fs::metadata(&path)?.len() <= SEED_BYTES {
                seed(&corpus, &path)?;
            }
        }
    }
    Ok(())
}

fn seed(corpus: &Path, path: &Path) -> std::io::Result<()> {
    let format = Source::open(path).ok().and_then(|mut source| reader(&mut source).ok()).map(|reader| reader.format());
    let Some(format) = format else { return Ok(()) };
    let mut bytes = fs::read(path)?;
    if format == "rs-bin" {
        // As the target takes it: where the companion begins, the file, the companion.
        let mut joined = (bytes.len() as u32).to_le_bytes().to_vec();
        joined.append(&mut bytes);
        joined.extend(companion(path).and_then(|companion| fs::read(companion).ok()).unwrap_or_default());
        bytes = joined;
    } else if format == "pulsewaves" {
        bytes.extend(companion(path).and_then(|companion| fs::read(companion).ok()).unwrap_or_default());
    }
    let folder = corpus.join(format.replace('.', "-"));
    fs::create_dir_all(&folder)?;
    let name: String = path.to_string_lossy().replace('/', "_");
    fs::write(folder.join(name), bytes)
}
