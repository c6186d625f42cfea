//! Kernels on the hot path, each with a reference in the same run: only the ratio counts. `cargo bench --bench
//! kernels`.

use std::hint::black_box;
use std::sync::Arc;

use arrow_array::{ArrayRef, BinaryViewArray, RecordBatch};
use arrow_schema::{DataType, Field, Schema};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use periscope::signal::average::PhaseSums;
use periscope::signal::codes::Codes;
use periscope::signal::fft::{Complex, RealFft};
use periscope::signal::onset;
use periscope::signal::response::Response;
use periscope::signal::sparse::{self, Profile, SparseOptions};
use periscope::signal::wiener::{Transfer, Wiener};
use periscope::store::parquet::{TableWriter, read_recorded, uncompressed};

const SAMPLES: usize = 2048;

/// Codes of a pulse on a ramp: no noise, which sums do not care about.
fn shot() -> Vec<u8> {
    (0..SAMPLES)
        .flat_map(|i| ((3000.0 * (-0.5 * ((i as f64 - 900.0) / 30.0).powi(2)).exp()) as i16 + i as i16).to_le_bytes())
        .collect()
}

fn pulse() -> Response {
    Response::new(
        -400.0,
        10.0,
        &(0..80).map(|i| (-0.5 * ((f64::from(i) - 40.0) / 10.6).powi(2)).exp()).collect::<Vec<_>>(),
    )
}

/// One shot into the sums of its capture; reference: adding 16 bit numbers in memory to sums in memory.
fn average(c: &mut Criterion) {
    let mut group = c.benchmark_group("average one shot of 2048 samples");
    group.throughput(Throughput::Bytes(2 * SAMPLES as u64));
    let bytes = shot();
    let numbers: Vec<i16> = bytes.chunks_exact(2).map(|code| i16::from_le_bytes([code[0], code[1]])).collect();
    let mut sums = vec![0_i32; SAMPLES];
    group.bench_function("reference: plain sum", |b| {
        b.iter(|| {
            black_box(&mut sums)
                .iter_mut()
                .zip(black_box(&numbers))
                .for_each(|(sum, number)| *sum = sum.wrapping_add(i32::from(*number)))
        });
    });
    let mut phase_sums = PhaseSums::new(SAMPLES);
    group.bench_function("one phase", |b| b.iter(|| phase_sums.add(Codes::I16(black_box(&bytes)), 0)));
    let mut phase_sums = PhaseSums::new(SAMPLES);
    let mut position = 0;
    group.bench_function("all phases", |b| {
        b.iter(|| {
            position = (position + 29) % 640;
            phase_sums.add(Codes::I16(black_box(&bytes)), position);
        });
    });
    group.finish();
}

/// Wiener filter and edge of one profile; reference: the two transforms alone.
fn deconvolve(c: &mut Criterion) {
    let mut group = c.benchmark_group("one profile of 2048 samples");
    let profile = Codes::I16(&shot()).to_f64();
    let mut fft = RealFft::new();
    let (mut spectrum, mut light) = (vec![Complex::default(); RealFft::bins(SAMPLES)], vec![0.0; SAMPLES]);
    group.bench_function("reference: two transforms", |b| {
        b.iter(|| {
            fft.forward(black_box(&profile), &mut spectrum);
            fft.inverse(&spectrum, &mut light);
        });
    });
    let wiener = Wiener::new(&Transfer::from_response(&mut fft, &pulse(), 50.0, SAMPLES), 0.02, Some(0.08));
    group.bench_function("wiener", |b| b.iter(|| wiener.apply(&mut fft, black_box(&profile), &mut light)));
    group.bench_function("leading edge", |b| {
        b.iter(|| onset::leading_edge(black_box(&light), 0.2, onset::Noise::even(1.0)))
    });
    group.finish();
}

/// Sparse deconvolution of two pulses half a width apart; reference: one pass of the matched filter's sums over the
/// record.
fn sparse_fit(c: &mut Criterion) {
    let mut group = c.benchmark_group("sparse, 400 samples, two pulses");
    let response = pulse();
    let mean_v: Vec<f64> = (0..400)
        .map(|n| f64::from(n) * 50.0)
        .map(|t| response.value(t - 8000.0) + 0.7 * response.value(t - 8120.0) + 0.005 * (t * 12.9898).sin())
        .collect();
    let sd_v = vec![0.005; 400];
    group.bench_function("reference: matched filter", |b| {
        b.iter(|| {
            (0..400)
                .map(|k| (0..400).map(|n| mean_v[n] * response.value(f64::from(n as i32 - k) * 50.0)).sum::<f64>())
                .fold(0.0, f64::max)
        });
    });
    group.bench_function("fit", |b| {
        b.iter(|| {
            sparse::fit(
                &Profile {
                    mean_v: black_box(&mean_v),
                    sd_v: &sd_v,
                    acf: &[1.0],
                    slow_v2: &[],
                    jitter: None,
                    t0_ps: 0.0,
                    dt_ps: 50.0,
                },
                &response,
                &SparseOptions::default(),
            )
        });
    });
    group.finish();
}

/// Codes of 4096 shots (16 MiB; 12 bits, noise of 6 codes) written as a table, and read back with their digest; in one
/// thread. Reference: the same bytes written to a file, or read from it.
fn table_of_codes(c: &mut Criterion) {
    const SHOTS: usize = 4096;
    let clean: Vec<i16> =
        (0..SAMPLES).map(|i| (1500.0 * (-0.5 * ((i as f64 - 900.0) / 30.0).powi(2)).exp()) as i16 - 1500).collect();
    let mut state = 1_u64;
    let mut noise = || {
        // The sum of twelve bytes is nearly normal.
        let sum: u64 = (0..12)
            .map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                state >> 56
            })
            .sum();
        ((sum as f64 - 1530.0) / 256.0 * 6.0) as i16
    };
    let shots: Vec<Vec<u8>> =
        (0..SHOTS).map(|_| clean.iter().flat_map(|code| (code + noise()).to_le_bytes()).collect()).collect();
    let all = shots.concat();
    let array: ArrayRef = Arc::new(BinaryViewArray::from_iter_values(&shots));
    let folder = tempfile::tempdir().unwrap();
    let mut group = c.benchmark_group("table of codes");
    group.throughput(Throughput::Bytes(all.len() as u64)).sample_size(20);
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let path = folder.path().join("reference");
    group.bench_function("reference: write a file", |b| b.iter(|| std::fs::write(&path, &all).unwrap()));
    group.bench_function("reference: read a file", |b| b.iter(|| black_box(std::fs::read(&path).unwrap())));
    let codes = Field::new("codes", DataType::BinaryView, false);
    for (name, field) in [("zstd", codes.clone()), ("not compressed", uncompressed(&codes))] {
        let schema = Arc::new(Schema::new(vec![field]));
        let batch = RecordBatch::try_new(schema.clone(), vec![array.clone()]).unwrap();
        let path = folder.path().join(name);
        let write = || {
            let mut writer = TableWriter::create(&path, &schema).unwrap();
            writer.write(&batch).unwrap();
            writer.finish(&[]).unwrap()
        };
        group.bench_function(format!("write, {name}"), |b| one.install(|| b.iter(write)));
        let record = one.install(write);
        println!("{name}: {:.3} of the raw bytes", record.bytes as f64 / all.len() as f64);
        let read = || read_recorded(&path, &record, 256).unwrap().map(|batch| batch.unwrap().num_rows()).sum::<usize>();
        assert_eq!(one.install(read), SHOTS);
        group.bench_function(format!("read, {name}"), |b| one.install(|| b.iter(read)));
    }
}

criterion_group!(benches, average, deconvolve, sparse_fit, table_of_codes);
criterion_main!(benches);
