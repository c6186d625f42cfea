//! The kernels that are counted: each is prepared, then run.

#[path = "hidden.rs"]
mod hidden;

use std::hint::black_box;
use std::io::Cursor;
use std::path::Path;

use periscope_formats::reader::{Input, Source};
use periscope_formats::{self as formats, npy};
use periscope_geometry::Point;
use periscope_geometry::association::{Expected, Time, associate};
use periscope_geometry::maximum_likelihood::{Node, Observation, Problem, approach};
use periscope_signal::average::PhaseSums;
use periscope_signal::codes::Codes;
use periscope_signal::dark::Dark;
use periscope_signal::fft::RealFft;
use periscope_signal::outlying::OutlierTest;
use periscope_signal::response::Response;
use periscope_signal::shot_spread::{HEAD_SHOTS, Spread};
use periscope_signal::sparse::{self, Profile, SparseOptions};
use periscope_signal::wiener::{Transfer, Wiener};
use periscope_signal::{noise, onset};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Ready to run.
pub type Kernel = Box<dyn FnMut()>;

/// All, by name.
pub const ALL: [(&str, fn() -> Kernel); 15] = [
    ("associate", association),
    ("first-returns", hidden::first_returns),
    ("gauss-newton", gauss_newton),
    ("joint-search", hidden::small_thing),
    ("leading-edge", leading_edge),
    ("noise", noise_of_stretches),
    ("npy-sums", npy_sums),
    ("outliers", outliers),
    ("plain-sum", plain_sum),
    ("sparse", sparse_fit),
    ("spread", spread_of_shots),
    ("sums-all-phases", sums_all_phases),
    ("sums-one-phase", sums_one_phase),
    ("threshold", threshold),
    ("wiener", wiener),
];

const SAMPLES: usize = 2048;
const SHOTS: usize = 100;

fn pulse_and_ramp(i: usize) -> i16 {
    (3000.0 * (-0.5 * ((i as f64 - 900.0) / 30.0).powi(2)).exp()) as i16 + i as i16
}

/// Codes of one shot.
fn shot() -> Vec<u8> {
    (0..SAMPLES).flat_map(|i| pulse_and_ramp(i).to_le_bytes()).collect()
}

fn response() -> Response {
    let values: Vec<f64> = (0..80).map(|i| (-0.5 * ((f64::from(i) - 40.0) / 10.6).powi(2)).exp()).collect();
    Response::new(-400.0, 10.0, &values)
}

/// The reference: 100 shots of 16 bit numbers added to sums, all in memory.
fn plain_sum() -> Kernel {
    let numbers: Vec<i16> = (0..SAMPLES).map(pulse_and_ramp).collect();
    let mut sums = vec![0_i32; SAMPLES];
    Box::new(move || {
        for _ in 0..SHOTS {
            let pairs = black_box(&mut sums).iter_mut().zip(black_box(&numbers));
            pairs.for_each(|(sum, number)| *sum = sum.wrapping_add(i32::from(*number)));
        }
    })
}

/// 100 shots into the sums of their capture, all of one phase.
fn sums_one_phase() -> Kernel {
    let (bytes, mut sums) = (shot(), PhaseSums::new(SAMPLES));
    Box::new(move || (0..SHOTS).for_each(|_| sums.add(Codes::I16(black_box(&bytes)), 0)))
}

/// The same at positions all over ten samples.
fn sums_all_phases() -> Kernel {
    let (bytes, mut sums) = (shot(), PhaseSums::new(SAMPLES));
    Box::new(move || (0..SHOTS).for_each(|n| sums.add(Codes::I16(black_box(&bytes)), (29 * n as i64) % 640)))
}

/// A file of 100 shots, in memory, into sums.
fn npy_sums() -> Kernel {
    let codes: Vec<i16> = (0..SHOTS * SAMPLES).map(|i| pulse_and_ramp(i % SAMPLES)).collect();
    let mut file = Vec::new();
    npy::write(&mut file, &[SHOTS as u64, SAMPLES as u64], &codes).expect("memory takes all");
    Box::new(move || {
        let mut source = Source::new(Cursor::new(&file), Path::new("shots.npy")).expect("a source");
        let mut sums = PhaseSums::new(SAMPLES);
        for record in formats::records(&mut source).expect("records") {
            let samples = 0..record.head.samples;
            record.visit(source.file(), samples, &mut |bytes| sums.add(Codes::I16(bytes), 0)).expect("codes");
        }
        black_box(&sums);
    })
}

/// Noise of 32 stretches of 256 samples, 32 lags.
fn noise_of_stretches() -> Kernel {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let stretches: Vec<Vec<f64>> = (0..32).map(|_| (0..256).map(|_| rng.random_range(-1.0..1.0)).collect()).collect();
    Box::new(move || {
        black_box(noise::estimate(black_box(&stretches), 32));
    })
}

/// The first shots of a capture, with noise.
fn head() -> Vec<Vec<u8>> {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let mut shot = |_| -> Vec<u8> {
        (0..SAMPLES).flat_map(|i| (pulse_and_ramp(i) + rng.random_range(-60..60)).to_le_bytes()).collect()
    };
    (0..HEAD_SHOTS).map(&mut shot).collect()
}

/// A test for outlying shots from the first 32, and these judged by it.
fn outliers() -> Kernel {
    let head = head();
    Box::new(move || {
        let shots: Vec<(Codes<'_>, i64)> = head.iter().map(|bytes| (Codes::I16(black_box(bytes)), 0)).collect();
        let test = OutlierTest::new(&shots, Dark::at_start(256), 6.0).expect("they overlap");
        black_box(shots.iter().filter(|(codes, position)| test.is_outlier(*codes, *position)).count());
    })
}

/// How the first 32 shots differ from their mean.
fn spread_of_shots() -> Kernel {
    let head = head();
    let mut sums = PhaseSums::new(SAMPLES);
    head.iter().for_each(|bytes| sums.add(Codes::I16(bytes), 0));
    let mean = sums.finish().expect("they overlap");
    Box::new(move || {
        let shots: Vec<(Codes<'_>, i64)> = head.iter().map(|bytes| (Codes::I16(black_box(bytes)), 0)).collect();
        black_box(Spread::of(&shots, &mean, &Dark::at_start(256)));
    })
}

fn wiener() -> Kernel {
    let (mut fft, profile, mut light) = (RealFft::new(), Codes::I16(&shot()).to_f64(), vec![0.0; SAMPLES]);
    let filter = Wiener::new(&Transfer::from_response(&mut fft, &response(), 50.0, SAMPLES), 0.02, Some(0.08));
    Box::new(move || filter.apply(&mut fft, black_box(&profile), &mut light))
}

fn leading_edge() -> Kernel {
    let profile = Codes::I16(&shot()).to_f64();
    Box::new(move || {
        black_box(onset::leading_edge(black_box(&profile), 0.2, onset::Noise::even(1.0)));
    })
}

/// Every crossing of a level.
fn threshold() -> Kernel {
    let profile = Codes::I16(&shot()).to_f64();
    Box::new(move || {
        black_box(onset::thresholds(black_box(&profile), 2500.0, 2000.0, 1.0));
    })
}

/// Two pulses half a width apart in 400 samples.
fn sparse_fit() -> Kernel {
    let response = response();
    let value = |t_ps: f64| {
        response.value(t_ps - 8000.0) + 0.7 * response.value(t_ps - 8120.0) + 0.005 * (t_ps * 12.9898).sin()
    };
    let mean_v: Vec<f64> = (0..400).map(|n| value(f64::from(n) * 50.0)).collect();
    let sd_v = vec![0.005; 400];
    Box::new(move || {
        let profile = Profile {
            mean_v: black_box(&mean_v),
            sd_v: &sd_v,
            acf: &[1.0],
            slow_v2: &[],
            jitter: None,
            t0_ps: 0.0,
            dt_ps: 50.0,
        };
        black_box(sparse::fit(&profile, &response, &SparseOptions::default()));
    })
}

/// 64 arrivals of a profile and 200 paths that may have made them.
fn association() -> Kernel {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let mut time = || Time { time_ps: rng.random_range(0.0..20_000.0), sd_ps: 5.0 };
    let arrivals: Vec<Time> = (0..64).map(|_| time()).collect();
    let expected: Vec<Expected> = (0..200).map(|_| Expected { time: time(), seen: 0.5 }).collect();
    Box::new(move || {
        black_box(associate(black_box(&arrivals), &expected, &[5e-5; 64]));
    })
}

/// One step from near the solution: 49 patches, first bounces and second bounces of all pairs.
fn gauss_newton() -> Kernel {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut place = || Point::new(rng.random_range(-1.0..1.0), rng.random_range(0.6..2.2), rng.random_range(-0.9..0.9));
    let points: Vec<Point> = (0..49).map(|_| place()).collect();
    let observation = |patches: &[usize]| {
        let way = || patches.iter().map(|&patch| points[patch]);
        let from = std::iter::once(Point::origin()).chain(way());
        let legs = from.zip(way().chain([Point::origin()]));
        let patches = patches.iter().map(|&patch| Node::Patch(patch));
        Observation::new(
            std::iter::once(Node::Station(0)).chain(patches).chain([Node::Station(0)]).collect(),
            legs.map(|(a, b)| (b - a).norm()).sum(),
            1e-3,
        )
    };
    let first = (0..points.len()).map(|a| observation(&[a]));
    let second = (0..points.len()).flat_map(|a| (0..a).map(move |b| [a, b])).map(|pair| observation(&pair));
    let observations = first.chain(second).collect();
    let start = points.iter().map(|point| point + nalgebra::Vector3::new(1e-3, -2e-3, 1e-3)).collect();
    let problem = Problem::new(start, 3, &[Point::origin()], observations);
    Box::new(move || {
        black_box(approach(black_box(&problem), 1, 0.0));
    })
}
