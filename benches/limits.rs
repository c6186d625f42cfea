//! What the parts of averaging a campaign cost alone, one thread, best of many: the physical limit that
//! docs/performance.md compares a run with. `cargo bench --bench limits -- FOLDER [SAMPLES]`: a folder of .npy files,
//! one a capture, shots of so many 16 bit samples (2048).

use std::fs::File;
use std::hint::black_box;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::time::Instant;

use arrow_array::RecordBatch;
use periscope::signal::average::PhaseSums;
use periscope::signal::codes::Codes;
use periscope::signal::fft::{Complex, RealFft};
use periscope::store::TableWriter;
use periscope::tables::{Profile, Row};

/// Times that each part is done.
const RUNS: usize = 15;
/// Bytes that stay in the second cache.
const CACHED: usize = 512 << 10;
/// Bytes of the header of an .npy file.
const HEADER: usize = 128;
/// Samples that a run leaves of each sample of a capture, as 32 bit numbers: mean, error, impulses.
const LEFT: usize = 3;

/// Least seconds of some runs.
fn best(mut part: impl FnMut()) -> f64 {
    let once = |_| {
        let start = Instant::now();
        part();
        start.elapsed().as_secs_f64()
    };
    (0..RUNS).map(once).fold(f64::INFINITY, f64::min)
}

/// Reads all files into one block, one after the other. Returns their bytes.
fn read(files: &[PathBuf], block: &mut Vec<u8>) -> usize {
    let one = |file: &PathBuf| {
        block.clear();
        File::open(file).expect("a file of the folder").read_to_end(block).expect("a readable file");
        black_box(block.len())
    };
    files.iter().map(one).sum()
}

/// As many rows as there are captures, batch by batch into a new file.
fn write(path: &Path, batch: &RecordBatch, captures: usize) {
    let mut writer = TableWriter::create(path, &Profile::schema()).expect("a folder that can be written to");
    for start in (0..captures).step_by(batch.num_rows()) {
        writer.write(&batch.slice(0, batch.num_rows().min(captures - start))).expect("room for the rows");
    }
    black_box(writer.finish(&[]).expect("room for the rows"));
}

fn main() {
    // The store encodes in the pool.
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global().expect("there is no pool yet");
    let mut args = std::env::args().skip(1).filter(|arg| !arg.starts_with("--"));
    let Some(folder) = args.next() else {
        println!("usage: cargo bench --bench limits -- FOLDER [SAMPLES]");
        return;
    };
    let samples: usize = args.next().map_or(2048, |samples| samples.parse().expect("a number of samples"));
    let files = std::fs::read_dir(&folder).expect("a folder").map(|entry| entry.expect("an entry").path());
    let files: Vec<PathBuf> = files.filter(|file| file.extension().is_some_and(|ending| ending == "npy")).collect();
    let mut block = Vec::new();
    let bytes = read(&files, &mut block);
    let copy = best(|| _ = read(&files, &mut block));

    let cached = &block[HEADER..block.len().min(HEADER + CACHED)];
    let times = bytes as f64 / cached.len() as f64;
    let hash = times * best(|| _ = black_box(blake3::hash(black_box(cached))));
    let mut sums = PhaseSums::new(samples);
    let sum =
        times * best(|| cached.chunks_exact(2 * samples).for_each(|shot| sums.add(Codes::I16(black_box(shot)), 0)));

    let mut fft = RealFft::new();
    let mut signal: Vec<f64> = (0..samples).map(|n| (0.1 * n as f64).sin()).collect();
    let mut spectrum = vec![Complex::default(); samples / 2 + 1];
    let transforms = files.len() as f64
        * best(|| {
            fft.forward(&signal, &mut spectrum);
            fft.inverse(&spectrum, black_box(&mut signal));
        });

    let waveform = (0..LEFT * samples / 2).map(|n| (0.1 * n as f64).sin());
    let profile =
        Profile { mean_v: Some(waveform.clone().collect()), se_v: Some(waveform.collect()), ..Profile::default() };
    let file = std::env::temp_dir().join("periscope-limits.parquet");
    let batch = Profile::to_batch(&vec![profile; 64]);
    let encode = best(|| write(&file, &batch, files.len()));
    let left = std::fs::metadata(&file).expect("it was written").len();
    std::fs::remove_file(&file).expect("it was written");

    let rate = |seconds: f64, bytes: f64| format!("{:.0}", 1e-6 * bytes / seconds);
    println!("{} files, {:.0} MB; one thread, best of {RUNS}\n", files.len(), 1e-6 * bytes as f64);
    println!("| part | s | MB/s |\n|---|---|---|");
    println!("| copy out of the page cache, into one block | {copy:.3} | {} |", rate(copy, bytes as f64));
    println!("| BLAKE3 of the raw bytes, in the second cache | {hash:.3} | {} |", rate(hash, bytes as f64));
    println!("| integer sums, in the second cache | {sum:.3} | {} |", rate(sum, bytes as f64));
    println!("| two transforms a capture | {transforms:.3} | |");
    println!(
        "| encoding: {:.0} MB into a new file, with digests | {encode:.3} | {} |",
        1e-6 * left as f64,
        rate(encode, left as f64)
    );
    let all = copy + hash + sum + transforms + encode;
    println!("| sum | {all:.3} | {} |", rate(all, bytes as f64));
}
