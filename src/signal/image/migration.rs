//! Frequency-wavenumber (f-k) migration: an image of what a confocal scan shows, as of waves.
//!
//! Laser and sensor look at one point of a plane wall at a time, on a grid of equal pitch. A hidden point at depth `z`
//! answers a point of the wall at distance `r` from its foot after `t = 2 sqrt(z^2 + r^2)`. So over `t / 2` the scan is
//! what a wave leaves on the wall that all hidden points send out at time 0. Where its spectrum over the wall and over
//! `t / 2` is `D(k, w)`, the wave at time 0 has the spectrum `(kz / w) D(k, w)`, `w^2 = k^2 + kz^2`, over the wall and
//! depth (Stolt, Geophysics 43:23, 1978; for hidden things: Lindell, Wetzstein and O'Toole, ACM Trans. Graph. 38:116,
//! 2019). A wave of points in three dimensions falls off with the distance, hence [`Wave::growth`].
//!
//! What differs from the sources:
//!
//! - Light comes as pulses of one sign, whose wave would vanish where the points are. A quarter of a period makes its
//!   peak, so that the image is real and linear in the histograms; no square is taken.
//! - What lies beyond the band of the response is left out: [`Wave::response_ps`].
//! - Between frequencies a histogram's spectrum is interpolated to some parts in a thousand: an exponential of a
//!   semicircle over [`REACH`] neighbours, its own shape taken out beforehand (Barnett, Magland and af Klinteberg, SIAM
//!   J. Sci. Comput. 41:C479, 2019). Linear interpolation would leave ghosts.
//!
//! The transform comes in steps, so that the caller may share their blocks among threads; no step depends on the order
//! of its blocks:
//!
//! 1. [`Migration::row`] for each row of the grid: histograms to spectra over time;
//! 2. [`Migration::plane`] for each frequency: the spectrum over the wall;
//! 3. [`Migration::slice`] for each wavenumber of depth;
//! 4. [`Migration::values`] for each row of the grid.
//!
//! The answer to noise is that to a record of noise at one point, [`Migration::kernel`] in place of the third step,
//! squared, and summed over the points with light: [`Migration::spread`]. Not modelled: occlusion, light of more than
//! three bounces, the angle under which surfaces are seen.

use std::f64::consts::TAU;

use super::foreground::Foreground;
use super::light_cone::{Scan, narrow, wide};
use crate::fft::{Complex, PlaneFft, RealFft, fast_length};

/// Frequencies from which one between them is interpolated.
pub const REACH: usize = 4;
/// Exponent of the interpolation's kernel, for records padded to twice their length.
const SHARPNESS: f64 = 2.3 * REACH as f64;
/// Steps of the integral of the kernel.
const STEPS: usize = 200;
/// Share of a frequency that the response leaves, below which there is no light.
const DARK: f64 = 1e-3;

/// What waves the histograms are taken for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wave {
    /// Histograms are scaled by this power of the time, so that their light falls off with the distance.
    pub growth: f64,
    /// Standard deviation of the response.
    pub response_ps: f64,
}

/// Plans and buffers of one worker.
pub struct Workspace {
    plane: PlaneFft,
    time: RealFft,
}

/// The migration of one scan.
#[derive(Clone, Debug)]
pub struct Migration {
    scan: Scan,
    wave: Wave,
    /// Bins of `t / 2` and of depth, and their step.
    bins: usize,
    step_ps: f64,
    /// Lengths of the padded transforms.
    columns: usize,
    rows: usize,
    times: usize,
    /// Wavenumbers of depth that have light.
    bright: usize,
    /// What takes the interpolation's shape out of each bin.
    shapes: Vec<f64>,
}

impl Migration {
    /// The migration of a scan.
    ///
    /// # Panics
    /// If the grid is empty, or the times, the step, the pitch or the response are not positive and in order.
    #[must_use]
    pub fn new(scan: Scan, wave: Wave) -> Self {
        let [start_ps, end_ps] = scan.times_ps;
        assert!(scan.columns > 0 && scan.rows > 0, "the grid has no points");
        assert!(0.0 <= start_ps && start_ps < end_ps, "no time between {start_ps} and {end_ps} ps");
        assert!(scan.step_ps > 0.0 && scan.pitch_ps > 0.0 && wave.response_ps > 0.0, "{scan:?}, {wave:?}");
        let bins = ((end_ps - start_ps) / scan.step_ps).ceil() as usize;
        let [columns, rows, times] = [scan.columns, scan.rows, bins.max(REACH)].map(|length| fast_length(2 * length));
        let step_ps = 0.5 * scan.step_ps;
        // A Gaussian over t / 2 is half as wide.
        let rate = (2.0 * (-DARK.ln())).sqrt() / (0.5 * wave.response_ps) * step_ps;
        let bright = ((rate / TAU * times as f64) as usize + 1).min(times / 2 - REACH / 2);
        let shapes = (0..bins).map(|bin| shape((bin as f64 - (bins / 2) as f64) / times as f64)).collect();
        Self { scan, wave, bins, step_ps, columns, rows, times, bright, shapes }
    }

    /// Bins of depth: the blocks of [`Migration::spread`].
    #[must_use]
    pub fn depths(&self) -> usize {
        self.bins
    }

    /// Depth of the middle of a bin.
    #[must_use]
    pub fn depth_ps(&self, bin: usize) -> f64 {
        0.5 * self.scan.times_ps[0] + (bin as f64 + 0.5) * self.step_ps
    }

    /// Wavenumbers of depth: the blocks of [`Migration::slice`] and [`Migration::kernel`].
    #[must_use]
    pub fn wavenumbers(&self) -> usize {
        self.bright
    }

    /// Frequencies: the blocks of [`Migration::plane`].
    #[must_use]
    pub fn frequencies(&self) -> usize {
        self.bright + REACH / 2
    }

    /// Plans and buffers for one worker.
    #[must_use]
    pub fn workspace(&self) -> Workspace {
        Workspace { plane: PlaneFft::new(self.columns, self.rows), time: RealFft::new() }
    }

    /// Spectra of a row over the frequencies, a value for each point. Each histogram has the time of its first bin, the
    /// width of its bins, and its light; `None` for a point without one.
    pub fn row(&self, workspace: &mut Workspace, histograms: &[Option<(f64, f64, Foreground)>]) -> Vec<Complex<f32>> {
        let columns = histograms.len();
        let mut row = vec![Complex::default(); self.frequencies() * columns];
        let mut spectrum = vec![Complex::default(); RealFft::bins(self.times)];
        for (column, histogram) in histograms.iter().enumerate() {
            let Some((first_ps, dt_ps, light)) = histogram else { continue };
            workspace.time.forward(&self.resample(*first_ps, *dt_ps, light), &mut spectrum);
            let kept = spectrum.iter().take(self.frequencies()).enumerate();
            kept.for_each(|(k, bin)| row[k * columns + column] = narrow(*bin));
        }
        row
    }

    /// A histogram over equal steps of `t / 2`, its middle first, padded.
    fn resample(&self, first_ps: f64, dt_ps: f64, light: &Foreground) -> Vec<f64> {
        let [start_ps, end_ps] = self.scan.times_ps;
        let mut sums = vec![[0.0; 2]; self.bins];
        for (n, value) in light.values.iter().enumerate() {
            let time_ps = first_ps + n as f64 * dt_ps;
            if time_ps < start_ps || time_ps >= end_ps {
                continue;
            }
            let Some(sum) = sums.get_mut(((time_ps - start_ps) / self.scan.step_ps) as usize) else { continue };
            sum[0] += (time_ps / end_ps).powf(self.wave.growth) * value;
            sum[1] += 1.0;
        }
        let mut record = vec![0.0; self.times];
        for (bin, ([sum, count], shape)) in sums.into_iter().zip(&self.shapes).enumerate() {
            if count > 0.0 {
                record[(bin + self.times - self.bins / 2) % self.times] = sum / count / shape;
            }
        }
        record
    }

    /// The spectrum of one frequency over the wall, from the spectra of all rows.
    ///
    /// # Panics
    /// If there are not as many rows as in the grid.
    pub fn plane(&self, workspace: &mut Workspace, frequency: usize, rows: &[Vec<Complex<f32>>]) -> Vec<Complex<f32>> {
        assert_eq!(rows.len(), self.scan.rows, "the grid has another number of rows");
        let columns = self.scan.columns;
        let mut plane = vec![Complex::default(); self.columns * self.rows];
        for (row, into) in rows.iter().zip(plane.chunks_mut(self.columns)) {
            let values = &row[frequency * columns..][..columns];
            into.iter_mut().zip(values).for_each(|(into, value)| *into = wide(*value));
        }
        workspace.plane.forward(&mut plane, self.scan.rows);
        plane.into_iter().map(narrow).collect()
    }

    /// One wavenumber of depth of the image, `rows` x `columns` values, from the planes of all frequencies.
    ///
    /// # Panics
    /// If there are not as many planes as frequencies.
    pub fn slice(
        &self,
        workspace: &mut Workspace,
        wavenumber: usize,
        planes: &[Vec<Complex<f32>>],
    ) -> Vec<Complex<f32>> {
        assert_eq!(planes.len(), self.frequencies(), "the scan has another number of frequencies");
        self.migrate(workspace, wavenumber, |frequency, at| wide(planes[frequency][at]))
    }

    /// The same of one point alone, from its spectrum: for lags of 0 to `rows - 1` and 0 to `columns - 1`; it is even
    /// in both.
    ///
    /// # Panics
    /// If the spectrum has another number of frequencies.
    pub fn kernel(&self, workspace: &mut Workspace, wavenumber: usize, spectrum: &[Complex<f32>]) -> Vec<Complex<f32>> {
        assert_eq!(spectrum.len(), self.frequencies(), "the point has another number of frequencies");
        self.migrate(workspace, wavenumber, |frequency, _| wide(spectrum[frequency]))
    }

    /// The wave at time 0 at a wavenumber of depth.
    fn migrate(
        &self,
        workspace: &mut Workspace,
        wavenumber: usize,
        spectrum_at: impl Fn(usize, usize) -> Complex<f64>,
    ) -> Vec<Complex<f32>> {
        let per_bin = TAU / self.times as f64;
        let down = wavenumber as f64 * per_bin;
        // Radians for each step of depth, squared.
        let squares = |count: usize| -> Vec<f64> {
            let rate = TAU * self.step_ps / (count as f64 * self.scan.pitch_ps);
            (0..count).map(|n| (n.min(count - n) as f64 * rate).powi(2)).collect()
        };
        let (across, along) = (squares(self.columns), squares(self.rows));
        let first = self.depth_ps(0) / self.step_ps;
        let middle = first + (self.bins / 2) as f64;
        let mut plane = vec![Complex::default(); self.columns * self.rows];
        for (x, values) in plane.chunks_mut(self.rows).enumerate() {
            for (y, value) in values.iter_mut().enumerate() {
                let rate = (down * down + across[x] + along[y]).sqrt();
                let place = rate / per_bin;
                if place >= self.bright as f64 || wavenumber == 0 {
                    continue;
                }
                // The first wavenumber of depth leaves no place below 1.
                let left = place as usize + 1 - REACH / 2;
                let at = x * self.rows + y;
                let near = left..left + REACH;
                let sum: Complex<f64> = near.map(|k| spectrum_at(k, at) * weight(place - k as f64)).sum();
                let factor = down / rate * self.low_pass(rate);
                *value = sum * Complex::from_polar(factor, 0.25 * TAU + down * first - rate * middle);
            }
        }
        workspace.plane.inverse(&mut plane, self.scan.rows);
        let rows = plane.chunks(self.columns).take(self.scan.rows);
        rows.flat_map(|row| &row[..self.scan.columns]).map(|value| narrow(*value)).collect()
    }

    /// What the response leaves of a frequency, in radians for each step.
    fn low_pass(&self, rate: f64) -> f64 {
        (-0.5 * (rate * 0.5 * self.wave.response_ps / self.step_ps).powi(2)).exp()
    }

    /// Values of a row of voxels from the slices of all wavenumbers: [`Migration::depths`] for each column.
    ///
    /// # Panics
    /// If there are not as many slices as wavenumbers.
    pub fn values(&self, workspace: &mut Workspace, row: usize, slices: &[Vec<Complex<f32>>]) -> Vec<f64> {
        assert_eq!(slices.len(), self.wavenumbers(), "the image has another number of wavenumbers");
        let mut voxels = Vec::with_capacity(self.scan.columns * self.bins);
        let (mut spectrum, mut record) = (vec![Complex::default(); RealFft::bins(self.times)], vec![0.0; self.times]);
        for column in 0..self.scan.columns {
            for (bin, slice) in spectrum.iter_mut().zip(slices) {
                *bin = wide(slice[row * self.scan.columns + column]);
            }
            workspace.time.inverse(&spectrum, &mut record);
            voxels.extend(&record[..self.bins]);
        }
        voxels
    }

    /// Variance of the voxels at one depth, `rows` x `columns`, from the squares of what one point's noise leaves at
    /// each lag: [`Migration::values`] squared, a row of lags each. `has_light` says which points of the grid are
    /// captured.
    ///
    /// # Panics
    /// If there are not as many rows or points as in the grid.
    pub fn spread(
        &self,
        workspace: &mut Workspace,
        depth: usize,
        squares: &[Vec<f32>],
        has_light: &[bool],
    ) -> Vec<f64> {
        let Scan { columns, rows, .. } = self.scan;
        assert!(squares.len() == rows && has_light.len() == columns * rows, "the grid has another size");
        let fft = &mut workspace.plane;
        let [mut kernel, mut points] = [(); 2].map(|()| vec![Complex::default(); fft.values()]);
        for (y, square) in squares.iter().enumerate() {
            for x in 0..columns {
                let value = Complex::from(f64::from(square[x * self.bins + depth]));
                let (left, up) = ((self.columns - x) % self.columns, (self.rows - y) % self.rows);
                for (x, y) in [(x, y), (left, y), (x, up), (left, up)] {
                    kernel[y * self.columns + x] = value;
                }
                points[y * self.columns + x] = Complex::from(f64::from(has_light[y * columns + x]));
            }
        }
        fft.forward(&mut kernel, self.rows);
        fft.forward(&mut points, rows);
        points.iter_mut().zip(&kernel).for_each(|(point, kernel)| *point *= kernel);
        fft.inverse(&mut points, rows);
        points.chunks(self.columns).take(rows).flat_map(|row| &row[..columns]).map(|value| value.re).collect()
    }
}

/// The interpolation's kernel at a distance from a frequency.
fn weight(off: f64) -> f64 {
    let place = 2.0 * off / REACH as f64;
    let inside = 1.0 - place * place;
    if inside > 0.0 { (SHARPNESS * (inside.sqrt() - 1.0)).exp() } else { 0.0 }
}

/// What the kernel makes of a bin at this share of a padded record from its middle: its Fourier transform.
fn shape(share: f64) -> f64 {
    let step = REACH as f64 / STEPS as f64;
    let off = |n: usize| (n as f64 + 0.5) * step - 0.5 * REACH as f64;
    (0..STEPS).map(|n| weight(off(n)) * (TAU * off(n) * share).cos() * step).sum()
}

#[cfg(test)]
mod tests;
