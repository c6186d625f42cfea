//! How fast files are read from the page cache, for `benches/readers.py`, which compares it with Python readers in the
//! same minute: `readers codes|volts FILE ROUNDS` prints the best time of `ROUNDS` rounds in seconds. `codes`: what
//! `ingest` takes on, raw codes in pieces; `volts`: every sample as f64 volts, as the Python readers give it, a piece
//! at a time.

use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

use periscope::formats::{self, FormatError, Input, Source};

fn read(file: &Path, volts: bool) -> Result<usize, FormatError> {
    let mut source = Source::open(file)?;
    let mut samples = 0;
    for record in formats::records(&mut source)? {
        record.visit(source.file(), 0..record.head.samples, &mut |codes| {
            samples += codes.len() / record.head.code_type.bytes();
            if volts {
                black_box(record.values(codes));
            } else {
                black_box(codes);
            }
        })?;
    }
    Ok(samples)
}

fn main() {
    let args: Vec<String> = std::env::args().skip(1).filter(|arg| arg != "--bench").collect();
    let [what, file, rounds] = &args[..] else {
        eprintln!("usage: readers codes|volts FILE ROUNDS (benches/readers.py makes files and calls this)");
        return;
    };
    let rounds: usize = rounds.parse().expect("a number of rounds");
    let mut best_s = f64::INFINITY;
    for _ in 0..rounds {
        let start = Instant::now();
        read(Path::new(file), what == "volts").unwrap_or_else(|error| panic!("{file}: {error}"));
        best_s = best_s.min(start.elapsed().as_secs_f64());
    }
    println!("{best_s}");
}
