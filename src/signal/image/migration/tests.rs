//! The migration against its defining sums, against a point whose place is known, and against noise alone.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::*;
use crate::image::threshold;

const SCAN: Scan = Scan { columns: 16, rows: 14, pitch_ps: 100.0, times_ps: [800.0, 3200.0], step_ps: 10.0 };
const WAVE: Wave = Wave { growth: 1.0, response_ps: 25.0 };

type Histogram = Option<(f64, f64, Foreground)>;

/// Values of all voxels, [y][x][depth].
fn image(migration: &Migration, histograms: &[Histogram]) -> Vec<f64> {
    let mut w = migration.workspace();
    let scan = migration.scan;
    let rows: Vec<_> = histograms.chunks(scan.columns).map(|row| migration.row(&mut w, row)).collect();
    let planes: Vec<_> = (0..migration.frequencies()).map(|k| migration.plane(&mut w, k, &rows)).collect();
    let slices: Vec<_> = (0..migration.wavenumbers()).map(|k| migration.slice(&mut w, k, &planes)).collect();
    (0..scan.rows).flat_map(|y| migration.values(&mut w, y, &slices)).collect()
}

fn noise(rng: &mut ChaCha8Rng, count: usize) -> Foreground {
    let values = (0..count).map(|_| StandardNormal.sample(rng)).collect();
    Foreground { values, variances: vec![1.0; count] }
}

/// One bin of time in each bin of depth: then resampling only scales.
#[test]
fn the_migration_is_its_defining_sum() {
    let scan = Scan { columns: 4, rows: 3, pitch_ps: 70.0, times_ps: [300.0, 1500.0], step_ps: 50.0 };
    let wave = Wave { growth: 1.0, response_ps: 45.0 };
    let migration = Migration::new(scan, wave);
    let bins = migration.depths();
    assert_eq!(bins, 24);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let histograms: Vec<Histogram> = (0..12).map(|_| Some((325.0, 50.0, noise(&mut rng, bins)))).collect();
    let values = image(&migration, &histograms);
    let naive = naive(&migration, &histograms);
    let most = naive.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    for (voxel, (value, naive)) in values.iter().zip(&naive).enumerate() {
        assert!((value - naive).abs() < 2e-3 * most, "voxel {voxel}: {value} is not {naive}; {most} at the most");
    }
}

/// All voxels as sums over all frequencies and samples, at exact frequencies.
fn naive(migration: &Migration, histograms: &[Histogram]) -> Vec<f64> {
    let Migration { scan, bins, step_ps, columns, rows, times, bright, .. } = migration;
    let signed = |n: usize, count: usize| if 2 * n > count { n as f64 - count as f64 } else { n as f64 };
    let time_ps = |bin: usize| 0.5 * scan.times_ps[0] + (bin as f64 + 0.5) * step_ps;
    let mut values = vec![0.0; histograms.len() * bins];
    for (kx, ky, kz) in
        (0..*columns).flat_map(|kx| (0..*rows).flat_map(move |ky| (1..*bright).map(move |kz| (kx, ky, kz))))
    {
        let [across, along] =
            [(kx, columns), (ky, rows)].map(|(k, count)| TAU * signed(k, *count) / (*count as f64 * scan.pitch_ps));
        let down = TAU * kz as f64 / (*times as f64 * step_ps);
        let rate = (across * across + along * along + down * down).sqrt();
        if rate * *times as f64 * step_ps / TAU >= *bright as f64 {
            continue;
        }
        let wall = |point: usize| {
            let [x, y] = [point % scan.columns, point / scan.columns].map(|n| n as f64 * scan.pitch_ps);
            across * x + along * y
        };
        let mut sum = Complex::<f64>::default();
        for (point, histogram) in histograms.iter().enumerate() {
            let light = &histogram.as_ref().unwrap().2;
            for (bin, value) in light.values.iter().enumerate() {
                let growth = (2.0 * time_ps(bin) / scan.times_ps[1]).powf(migration.wave.growth);
                sum += Complex::from_polar(growth * value, -wall(point) - rate * time_ps(bin));
            }
        }
        let low_pass = (-0.5 * (0.5 * rate * migration.wave.response_ps).powi(2)).exp();
        sum *= Complex::new(0.0, down / rate * low_pass * 2.0 / (columns * rows * times) as f64);
        for (voxel, value) in values.iter_mut().enumerate() {
            *value += (sum * Complex::cis(wall(voxel / bins) + down * time_ps(voxel % bins))).re;
        }
    }
    values
}

/// Light of a point, as a diffuse one has it after roots are taken.
fn scan_of(place: [f64; 3], seed: u64) -> Vec<Histogram> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let histogram = |point: usize| {
        let aside = [point % 16, point / 16].map(|n| n as f64 * SCAN.pitch_ps);
        let distance_ps = ((aside[0] - place[0]).powi(2) + (aside[1] - place[1]).powi(2) + place[2].powi(2)).sqrt();
        let mut light = noise(&mut rng, 330);
        for (n, value) in light.values.iter_mut().enumerate() {
            let off = (5.0 + 10.0 * n as f64 - 2.0 * distance_ps) / WAVE.response_ps;
            *value += 3.0 * (1200.0 / distance_ps).powi(2) * (-0.5 * off * off).exp();
        }
        Some((5.0, 10.0, light))
    };
    (0..224).map(histogram).collect()
}

#[test]
fn a_point_is_brightest_at_its_place() {
    let migration = Migration::new(SCAN, WAVE);
    let place = [700.0, 500.0, 1003.0];
    let values = image(&migration, &scan_of(place, 2));
    let best = (0..values.len()).max_by(|a, b| values[*a].total_cmp(&values[*b])).unwrap();
    let depths = migration.depths();
    assert_eq!((best / depths % 16, best / depths / 16), (7, 5));
    // The vertex of a parabola through the highest voxel of the column and its neighbours.
    let [before, most, after] = [best - 1, best, best + 1].map(|n| values[n]);
    let vertex = 0.5 * (before - after) / (before - 2.0 * most + after);
    let depth_ps = migration.depth_ps(best % depths) + vertex * 5.0;
    assert!((depth_ps - place[2]).abs() < 1.0, "{depth_ps}");
}

/// Points that are not captured included.
#[test]
fn noise_alone_has_a_significance_of_one_and_exceeds_the_threshold_nowhere() {
    let migration = Migration::new(SCAN, WAVE);
    let mut w = migration.workspace();
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let depths = migration.depths();
    let mut squares = vec![vec![0.0_f32; 16 * depths]; 14];
    let records = 40;
    for _ in 0..records {
        let spectrum = migration.row(&mut w, &[Some((5.0, 10.0, noise(&mut rng, 330)))]);
        let slices: Vec<_> = (0..migration.wavenumbers()).map(|k| migration.kernel(&mut w, k, &spectrum)).collect();
        for (y, sums) in squares.iter_mut().enumerate() {
            let values = migration.values(&mut w, y, &slices);
            sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += (value * value) as f32 / records as f32);
        }
    }
    let has_light: Vec<bool> = (0..224).map(|n| n % 5 != 2).collect();
    let variances: Vec<Vec<f64>> = (0..depths).map(|n| migration.spread(&mut w, n, &squares, &has_light)).collect();
    let (mut square, mut count, mut beyond, mut most) = (0.0, 0.0, 0.0, 0.0_f64);
    for _ in 0..10 {
        let histograms: Vec<Histogram> =
            has_light.iter().map(|has| has.then(|| (5.0, 10.0, noise(&mut rng, 330)))).collect();
        for (voxel, value) in image(&migration, &histograms).into_iter().enumerate() {
            let significance = value / variances[voxel % depths][voxel / depths].sqrt();
            square += significance * significance;
            count += 1.0;
            beyond += f64::from(significance.abs() > 2.5758);
            most = most.max(significance);
        }
    }
    let (sd, share) = ((square / count).sqrt(), beyond / count);
    println!("{count} voxels: sd {sd:.4}, beyond 2.576 {share:.5}, largest {most:.2}");
    assert!((0.95..1.05).contains(&sd), "{sd}");
    assert!((0.007..0.013).contains(&share), "{share}");
    assert!(most < threshold(10 * 224 * depths, 0.01), "{most}");
}
