//! Kernels on the hot path, each beside a reference in the same run: the ratio is what counts. `cargo bench --bench kernels`.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use periscope::signal::average::PhaseSums;
use periscope::signal::codes::Codes;
use periscope::signal::fft::{Complex, RealFft};
use periscope::signal::onset;
use periscope::signal::response::Response;
use periscope::signal::sparse::{self, Profile, SparseOptions};
use periscope::signal::wiener::{Transfer, Wiener};

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
    group.bench_function("leading edge", |b| b.iter(|| onset::leading_edge(black_box(&light), 0.2, 1.0)));
    group.finish();
}

/// Sparse deconvolution of two pulses half a width apart; reference: one pass of the matched filter's sums over the record.
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
                &Profile { mean_v: black_box(&mean_v), sd_v: &sd_v, acf: &[1.0], t0_ps: 0.0, dt_ps: 50.0 },
                &response,
                &SparseOptions::default(),
            )
        });
    });
    group.finish();
}

criterion_group!(benches, average, deconvolve, sparse_fit);
criterion_main!(benches);
