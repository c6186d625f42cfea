//! Images against naive sums, against points whose place is known, and against noise alone.

use std::f64::consts::TAU;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Poisson, StandardNormal};

use super::back_projection::{self, Stabiliser, Trace};
use super::foreground::{Foreground, foreground, rate};
use super::light_cone::{LightCone, Prior, Scan, Slice};
use super::threshold;
use crate::fft::Complex;

const PRIOR: Prior = Prior { falloff: 4.0, signal_to_noise: 0.8, response_ps: 25.0 };

type Histogram = Option<(f64, f64, Foreground)>;

/// Value and variance of each voxel, [y][x][depth].
fn image(cone: &LightCone, scan: &Scan, histograms: &[Histogram]) -> (Vec<f64>, Vec<f64>) {
    let mut w = cone.workspace();
    let rows = histograms.chunks(scan.columns).map(|row| cone.row(&mut w, row)).map(|row| (row.values, row.variances));
    let (values, mut variances): (Vec<_>, Vec<_>) = rows.unzip();
    let slices: Vec<Slice> = (0..cone.frequencies()).map(|k| cone.filter(&mut w, k, &values)).collect();
    let squares: Vec<_> = (0..scan.rows).map(|y| cone.square(&mut w, y, &slices)).collect();
    for k in 0..cone.frequencies() {
        let plane = cone.spread(&mut w, k, &variances, &squares);
        cone.keep(k, &plane, &mut variances);
    }
    let values = (0..scan.rows).flat_map(|y| cone.values(&mut w, y, &slices)).collect();
    (values, variances.iter().flat_map(|row| cone.variances(&mut w, row)).collect())
}

/// Voxels by the definition: sums over all lags of a filter that naive transforms make.
#[test]
fn the_light_cone_transform_is_its_defining_sum() {
    let scan = Scan { columns: 4, rows: 3, pitch_ps: 70.0, times_ps: [200.0, 800.0], step_ps: 75.0 };
    let cone = LightCone::new(scan, PRIOR);
    let bins = cone.depths();
    assert_eq!(bins, 5);
    // One bin of time in each bin of depth, at its middle: then resampling only scales.
    let step = 0.5 * 800.0 * 75.0;
    let time = |bin: usize| 2.0 * (1e4 + (bin as f64 + 0.5) * step).sqrt();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut data = vec![0.0; 12 * bins];
    let mut histograms = Vec::new();
    for point in 0..12 {
        let mut light = Foreground { values: vec![0.0; 800], variances: vec![0.0; 800] };
        for bin in 0..bins {
            let value: f64 = StandardNormal.sample(&mut rng);
            let at = time(bin) as usize;
            light.values[at] = value;
            light.variances[at] = value * value;
            data[point * bins + bin] = value * (at as f64 / 800.0).powi(3) / members(&scan, step, bin);
        }
        histograms.push(Some((0.0, 1.0, light)));
    }
    let (values, variances) = image(&cone, &scan, &histograms);
    let filter = naive_filter(&scan, bins, step);
    for voxel in 0..values.len() {
        let at = |n: usize| [n / bins % 4, n / bins / 4, n % bins].map(|n| n as i32);
        let lag = |n: usize| std::array::from_fn(|axis| at(voxel)[axis] - at(n)[axis]);
        let terms: Vec<f64> = data.iter().enumerate().map(|(n, value)| filter.at(lag(n)) * value).collect();
        let (sum, square): (f64, f64) = (terms.iter().sum(), terms.iter().map(|term| term * term).sum());
        assert!((values[voxel] - sum).abs() < 1e-6, "voxel {voxel}: {} is not {sum}", values[voxel]);
        assert!((variances[voxel] - square).abs() < 1e-6, "voxel {voxel}: {} is not {square}", variances[voxel]);
    }
}

/// Bins of 1 ps whose mean is a bin of depth.
fn members(scan: &Scan, step: f64, bin: usize) -> f64 {
    let [start, end] = scan.times_ps;
    let place = |time: usize| ((time as f64).powi(2) - start * start) / 4.0 / step;
    (start as usize..end as usize).filter(|time| place(*time) as usize == bin).count() as f64
}

/// A filter over all lags, on a padded grid.
struct Filter {
    lengths: [usize; 3],
    values: Vec<f64>,
}

impl Filter {
    fn at(&self, lag: [i32; 3]) -> f64 {
        let [x, y, v] = std::array::from_fn(|axis| lag[axis].rem_euclid(self.lengths[axis] as i32) as usize);
        self.values[(y * self.lengths[0] + x) * self.lengths[2] + v]
    }
}

/// The Wiener filter by the sums that define it.
fn naive_filter(scan: &Scan, bins: usize, step: f64) -> Filter {
    let lengths = [8, 6, 10];
    let signed = |place: usize, length: usize| place as f64 - if 2 * place > length { length as f64 } else { 0.0 };
    let mut spectrum = vec![Complex::default(); lengths.iter().product()];
    let places: Vec<[usize; 3]> = (0..spectrum.len())
        .map(|n| [n / lengths[2] % lengths[0], n / lengths[2] / lengths[0], n % lengths[2]])
        .collect();
    let points: Vec<(usize, usize, f64)> = (0..lengths[1])
        .flat_map(|y| (0..lengths[0]).map(move |x| (x, y)))
        .map(|(x, y)| {
            (x, y, (signed(x, lengths[0]).powi(2) + signed(y, lengths[1]).powi(2)) * scan.pitch_ps.powi(2) / step)
        })
        .filter(|(x, y, depth)| {
            signed(*x, lengths[0]).abs() < 4.0 && signed(*y, lengths[1]).abs() < 3.0 && *depth <= bins as f64
        })
        .collect();
    let energy = points.len() as f64;
    let width = 0.5 * (200.0 * 800.0_f64).sqrt() * PRIOR.response_ps / step;
    for (value, [fx, fy, fv]) in spectrum.iter_mut().zip(&places) {
        // Transforms of real records have no frequencies beyond the middle: these are conjugates of those below.
        let frequency = signed(*fv, lengths[2]);
        let turns = |(x, y, depth): &(usize, usize, f64)| {
            (x * fx) as f64 / lengths[0] as f64
                + (y * fy) as f64 / lengths[1] as f64
                + depth * frequency / lengths[2] as f64
        };
        let paraboloid: Complex<f64> = points.iter().map(|point| Complex::cis(-TAU * turns(point))).sum();
        let blur = (-0.5 * (TAU * frequency / lengths[2] as f64 * width).powi(2)).exp();
        *value = paraboloid.conj() * energy.sqrt() * blur / (paraboloid.norm_sqr() + energy / PRIOR.signal_to_noise);
    }
    let values = places.iter().map(|place| {
        let term = |(value, frequency): (&Complex<f64>, &[usize; 3])| {
            let turns: f64 = (0..3).map(|a| (place[a] * frequency[a]) as f64 / lengths[a] as f64).sum();
            (value * Complex::cis(TAU * turns)).re
        };
        spectrum.iter().zip(&places).map(term).sum::<f64>() / spectrum.len() as f64
    });
    Filter { lengths, values: values.collect() }
}

/// A scan of 16 x 16 points and 256 bins of 16 ps.
const SCAN: Scan = Scan { columns: 16, rows: 16, pitch_ps: 100.0, times_ps: [800.0, 4096.0], step_ps: 16.0 };

fn scan_of(rates: impl Fn(usize, usize, f64) -> f64, seed: u64) -> Vec<Histogram> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let histogram = |point: usize| {
        let mut draw = |bin: usize| {
            let rate = rates(point % 16, point / 16, 16.0 * bin as f64);
            Poisson::new(rate).unwrap().sample(&mut rng)
        };
        let counts: Vec<f64> = (50..256).map(&mut draw).collect();
        Some((800.0, 16.0, foreground(&counts, &rate(&counts, 5), 20)))
    };
    (0..256).map(histogram).collect()
}

/// Dark counts, and a wall's tail.
fn dark(time_ps: f64) -> f64 {
    2.0 + 5.0 * (-(time_ps - 800.0) / 1000.0).exp()
}

#[test]
fn noise_alone_has_a_significance_of_one_and_exceeds_the_threshold_nowhere() {
    let cone = LightCone::new(SCAN, PRIOR);
    let (mut square, mut count, mut beyond, mut most) = (0.0, 0.0, 0, 0.0_f64);
    for seed in 0..20 {
        let (values, variances) = image(&cone, &SCAN, &scan_of(|_, _, time_ps| dark(time_ps), seed));
        for (value, variance) in values.iter().zip(&variances) {
            let significance = value / variance.sqrt();
            square += significance * significance;
            count += 1.0;
            beyond += i32::from(significance.abs() > 2.5758);
            most = most.max(significance);
        }
    }
    // A million voxels, some ten thousand of them independent: 1 % is one standard deviation.
    let sd = (square / count).sqrt();
    let share = f64::from(beyond) / count;
    println!("{count} voxels: sd {sd:.4}, beyond 2.576 {share:.5}, largest {most:.2}");
    assert!((0.95..1.05).contains(&sd), "{sd}");
    assert!((0.006..0.014).contains(&share), "{share}");
    assert!(most < threshold(20 * cone.depths() * 256, 0.01), "{most}");
}

#[test]
fn a_point_is_brightest_at_its_place() {
    let cone = LightCone::new(SCAN, PRIOR);
    let (x, y, depth_ps) = (9.0, 5.0, 1200.0_f64);
    let light = |column: usize, row: usize, time_ps: f64| {
        let aside = ((column as f64 - x).powi(2) + (row as f64 - y).powi(2)) * SCAN.pitch_ps.powi(2);
        let distance_ps = (depth_ps.powi(2) + aside).sqrt();
        dark(time_ps) + 30.0 * (-0.5 * ((time_ps - 2.0 * distance_ps) / 25.0).powi(2)).exp()
    };
    let (values, variances) = image(&cone, &SCAN, &scan_of(light, 3));
    let significance: Vec<f64> =
        values.iter().zip(&variances).map(|(value, variance)| value / variance.sqrt()).collect();
    let best = (0..values.len()).max_by(|a, b| significance[*a].total_cmp(&significance[*b])).unwrap();
    let depths = cone.depths();
    assert_eq!((best / depths % 16, best / depths / 16), (9, 5));
    assert!((cone.depth_ps(best % depths) - depth_ps).abs() < 16.0, "{}", cone.depth_ps(best % depths));
    assert!(significance[best] > threshold(values.len(), 0.01), "{}", significance[best]);
}

/// Points of a wall, each lit while another is seen.
fn pairs() -> Vec<([f64; 3], [f64; 3])> {
    let point = |n: usize| [150.0 * (n % 5) as f64, 150.0 * (n / 5) as f64, 0.0];
    (0..25).flat_map(|lit| (0..25).step_by(3).map(move |seen| (point(lit), point(seen)))).collect()
}

fn gap(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

/// Traces of a hidden point of so many photons over this rate.
fn traces(place: [f64; 3], photons: f64, dark: f64, seed: u64) -> Vec<Trace> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let stabiliser = Stabiliser::new();
    let trace = |(lit, seen): ([f64; 3], [f64; 3])| {
        let arrival_ps = gap(lit, place) + gap(place, seen);
        let mut draw = |bin: i32| {
            let time_ps = 10.0 * f64::from(bin);
            let mean = dark + photons * (-0.5 * ((time_ps - arrival_ps) / 30.0).powi(2)).exp();
            Poisson::new(mean).unwrap().sample(&mut rng)
        };
        let counts: Vec<f64> = (0..400).map(&mut draw).collect();
        let (values, sd) = stabiliser.apply(&counts, &rate(&counts, 15));
        Trace { lit, seen, first_ps: 0.0, dt_ps: 10.0, scores: back_projection::scores(&values, &sd, 3.0) }
    };
    pairs().into_iter().map(trace).collect()
}

#[test]
fn back_projection_peaks_at_the_point() {
    let place = [260.0, 330.0, 900.0];
    let traces = traces(place, 4.0, 2.0, 1);
    let steps = || (-10..=10).map(|n| 20.0 * f64::from(n));
    let places = steps().flat_map(|x| steps().flat_map(move |y| steps().map(move |z| [x, y, z])));
    let significance = |d: &[f64; 3]| {
        let (sum, sd) = back_projection::voxel(&traces, std::array::from_fn(|axis| place[axis] + d[axis]));
        sum / sd
    };
    let best = places.max_by(|a, b| significance(a).total_cmp(&significance(b))).unwrap();
    assert!(best.iter().all(|d| d.abs() < 25.0), "{best:?}");
    assert!(significance(&[0.0; 3]) > threshold(9261, 1e-3));
}

#[test]
fn back_projection_is_a_sum_of_scores_that_vary_by_one() {
    for (dark, seed) in [(0.3, 1), (3.0, 2), (100.0, 3)] {
        let traces = traces([0.0; 3], 0.0, dark, seed);
        let scores: Vec<f64> = traces.iter().flat_map(|trace| &trace.scores).map(|score| f64::from(*score)).collect();
        let finite: Vec<f64> = scores.into_iter().filter(|score| score.is_finite()).collect();
        let square = finite.iter().map(|score| score * score).sum::<f64>() / finite.len() as f64;
        let mean = finite.iter().sum::<f64>() / finite.len() as f64;
        println!("rate {dark}: mean {mean:.4}, mean square {square:.4} of {} scores", finite.len());
        assert!((0.93..1.07).contains(&square) && mean.abs() < 0.02, "rate {dark}: {square}, mean {mean}");
        let mut voxels = Vec::new();
        for n in 0..400 {
            let point = [37.0 * f64::from(n % 20), 31.0 * f64::from(n / 20), 600.0 + 1.5 * f64::from(n)];
            let (sum, sd) = back_projection::voxel(&traces, point);
            let naive: f64 = traces
                .iter()
                .map(|trace| {
                    let bin = ((gap(trace.lit, point) + gap(point, trace.seen)) / 10.0).round() as usize;
                    f64::from(trace.scores[bin])
                })
                .sum();
            assert!((sum - naive).abs() < 1e-9 && sd == (traces.len() as f64).sqrt(), "{sum} is not {naive}");
            voxels.push(sum / sd);
        }
        let square = voxels.iter().map(|v| v * v).sum::<f64>() / voxels.len() as f64;
        assert!((0.7..1.35).contains(&square), "rate {dark}: {square}");
        assert!(voxels.iter().all(|v| *v < threshold(1200, 0.01)));
    }
}

#[test]
fn a_point_that_no_histogram_covers_has_no_deviation() {
    assert_eq!(back_projection::voxel(&traces([0.0; 3], 0.0, 1.0, 1), [0.0, 0.0, 9e3]), (0.0, 0.0));
}
