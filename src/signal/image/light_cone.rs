//! The light-cone transform: an image of what a confocal scan shows.
//!
//! Laser and sensor look at one point of a plane wall at a time, on a grid of equal pitch. Light of a hidden point at
//! depth `z` comes back to a point of the wall at distance `r` from its foot after `t = 2 sqrt(z^2 + r^2)`, all as
//! times of flight. With `v = t^2 / 4` and `u = z^2` this reads `v = u + r^2`: the same paraboloid for every hidden
//! point, so the histograms, resampled to equal steps of `v`, are a convolution, and a Wiener filter undoes it. Source:
//! O'Toole, Lindell and Wetzstein, Nature 555:338 (2018).
//!
//! What differs from the source, so that the noise of each voxel is known:
//!
//! - A bin of time belongs to one bin of `v`, which is the mean of its bins of time. So bins of `v` are independent. A
//!   step of `v` is as wide as [`Scan::step_ps`] at the far end of the record, and wider in time before it.
//! - Voxels stay at equal steps of `u`: nothing is resampled back.
//! - The paraboloid is not cut into bins: its spectrum is exact, and ends with the record.
//! - The variance of each voxel is the convolution of the variances with the square of the filter.
//!
//! The transform comes in steps, so that the caller may share their blocks among threads; no step depends on the
//! order of its blocks:
//!
//! 1. [`LightCone::row`] for each row of the grid: histograms to spectra;
//! 2. [`LightCone::filter`] for each frequency: the image's spectrum and the filter itself;
//! 3. [`LightCone::square`] for each row of the filter;
//! 4. [`LightCone::spread`] for each frequency: the spectrum of the variance, which [`LightCone::keep`] puts where the
//!    frequency's own values were;
//! 5. [`LightCone::values`] and [`LightCone::variances`] for each row of the grid.
//!
//! Spectra are complex values, frequency by frequency, each a row or a plane of the grid. They are kept in single
//! precision, but for those of the variance, which spans many orders of magnitude. Not modelled: occlusion,
//! light of more than three bounces, the angle under which surfaces are seen.

use std::f64::consts::TAU;

use super::foreground::Foreground;
use crate::fft::{Complex, PlaneFft, RealFft, fast_length};

/// A confocal scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scan {
    /// Points along a row of the grid.
    pub columns: usize,
    /// Rows of the grid.
    pub rows: usize,
    /// Distance of neighbours.
    pub pitch_ps: f64,
    /// Times whose light counts: from the gate to the end of the record.
    pub times_ps: [f64; 2],
    /// Step in time at the far end; at least the width of a bin.
    pub step_ps: f64,
}

/// What the filter takes the scene for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prior {
    /// Light falls off with this power of the distance: 4 for diffuse surfaces, 2 for retroreflective ones.
    pub falloff: f64,
    /// Power of the signal over that of the noise, at a mean frequency.
    pub signal_to_noise: f64,
    /// Standard deviation of the response.
    pub response_ps: f64,
}

/// Spectra of a row of the grid, over the frequencies: `columns` values each.
#[derive(Clone, Debug)]
pub struct RowSpectra {
    /// Of the values.
    pub values: Vec<Complex<f32>>,
    /// Of their variances.
    pub variances: Vec<Complex<f64>>,
}

/// One frequency: the image's spectrum, and the filter.
#[derive(Clone, Debug)]
pub struct Slice {
    /// `rows` x `columns` values.
    pub image: Vec<Complex<f32>>,
    /// The filter for lags of 0 to `rows - 1` and 0 to `columns - 1`; it is even in both.
    pub kernel: Vec<Complex<f32>>,
}

/// In the precision of computing.
pub(super) fn wide(value: Complex<f32>) -> Complex<f64> {
    Complex::new(f64::from(value.re), f64::from(value.im))
}

/// In the precision of keeping.
pub(super) fn narrow(value: Complex<f64>) -> Complex<f32> {
    Complex::new(value.re as f32, value.im as f32)
}

/// Plans and buffers of one worker.
pub struct Workspace {
    plane: PlaneFft,
    time: RealFft,
}

/// The transform of one scan.
#[derive(Clone, Debug)]
pub struct LightCone {
    scan: Scan,
    prior: Prior,
    /// Bins of `v` and of `u`, and their step.
    bins: usize,
    step_ps2: f64,
    /// Lengths of the padded transforms.
    columns: usize,
    rows: usize,
    times: usize,
}

impl LightCone {
    /// The transform of a scan.
    ///
    /// # Panics
    /// If the grid is empty, or the times, the step or the pitch are not positive and in order.
    #[must_use]
    pub fn new(scan: Scan, prior: Prior) -> Self {
        let [start_ps, end_ps] = scan.times_ps;
        assert!(scan.columns > 0 && scan.rows > 0, "the grid has no points");
        assert!(0.0 <= start_ps && start_ps < end_ps, "no time between {start_ps} and {end_ps} ps");
        assert!(scan.step_ps > 0.0 && scan.pitch_ps > 0.0, "{scan:?}");
        // dv = t dt / 2, at the far end.
        let step_ps2 = 0.5 * end_ps * scan.step_ps;
        let bins = ((end_ps.powi(2) - start_ps.powi(2)) / 4.0 / step_ps2).ceil() as usize;
        let [columns, rows, times] = [scan.columns, scan.rows, bins].map(|length| fast_length(2 * length));
        Self { scan, prior, bins, step_ps2, columns, rows, times }
    }

    /// Bins of depth.
    #[must_use]
    pub fn depths(&self) -> usize {
        self.bins
    }

    /// Frequencies: the blocks of [`LightCone::filter`] and [`LightCone::spread`].
    #[must_use]
    pub fn frequencies(&self) -> usize {
        RealFft::bins(self.times)
    }

    /// Depth of the middle of a bin.
    #[must_use]
    pub fn depth_ps(&self, bin: usize) -> f64 {
        (self.scan.times_ps[0].powi(2) / 4.0 + (bin as f64 + 0.5) * self.step_ps2).sqrt()
    }

    /// Plans and buffers for one worker.
    #[must_use]
    pub fn workspace(&self) -> Workspace {
        Workspace { plane: PlaneFft::new(self.columns, self.rows), time: RealFft::new() }
    }

    /// Spectra of a row. Each histogram has the time of its first bin, the width of its bins, and its light; `None` for
    /// a point without one.
    ///
    /// # Panics
    /// If there are not as many as points in a row.
    pub fn row(&self, workspace: &mut Workspace, histograms: &[Option<(f64, f64, Foreground)>]) -> RowSpectra {
        assert_eq!(histograms.len(), self.scan.columns, "a row has another number of points");
        let columns = self.scan.columns;
        let count = self.frequencies() * columns;
        let mut row =
            RowSpectra { values: vec![Complex::default(); count], variances: vec![Complex::default(); count] };
        let mut spectrum = vec![Complex::default(); self.frequencies()];
        for (column, histogram) in histograms.iter().enumerate() {
            let Some((first_ps, dt_ps, light)) = histogram else { continue };
            let resampled = self.resample(*first_ps, *dt_ps, light);
            workspace.time.forward(&resampled.values, &mut spectrum);
            spectrum.iter().enumerate().for_each(|(k, bin)| row.values[k * columns + column] = narrow(*bin));
            workspace.time.forward(&resampled.variances, &mut spectrum);
            spectrum.iter().enumerate().for_each(|(k, bin)| row.variances[k * columns + column] = *bin);
        }
        row
    }

    /// A histogram over equal steps of `v`, padded, scaled to the same light from every distance.
    fn resample(&self, first_ps: f64, dt_ps: f64, light: &Foreground) -> Foreground {
        let [start_ps, end_ps] = self.scan.times_ps;
        let mut resampled = Foreground { values: vec![0.0; self.times], variances: vec![0.0; self.times] };
        let mut members = vec![0_u32; self.bins];
        for (n, (value, variance)) in light.values.iter().zip(&light.variances).enumerate() {
            let time_ps = first_ps + n as f64 * dt_ps;
            if time_ps < start_ps || time_ps >= end_ps {
                continue;
            }
            let bin = ((time_ps.powi(2) - start_ps.powi(2)) / 4.0 / self.step_ps2) as usize;
            let Some(count) = members.get_mut(bin) else { continue };
            *count += 1;
            // A pulse of time is lower in v by dv / dt, hence the power that is one less.
            let weight = (time_ps / end_ps).powf(self.prior.falloff - 1.0);
            resampled.values[bin] += weight * value;
            resampled.variances[bin] += weight * weight * variance;
        }
        for (bin, count) in members.into_iter().enumerate().filter(|(_, count)| *count > 1) {
            resampled.values[bin] /= f64::from(count);
            resampled.variances[bin] /= f64::from(count).powi(2);
        }
        resampled
    }

    /// Filters one frequency of the values of all rows.
    ///
    /// # Panics
    /// If there are not as many rows as in the grid.
    pub fn filter(&self, workspace: &mut Workspace, frequency: usize, values: &[Vec<Complex<f32>>]) -> Slice {
        let fft = &mut workspace.plane;
        let mut kernel = self.spectrum_of_filter(fft, frequency);
        let mut image = self.gather(frequency, values, wide);
        fft.forward(&mut image, self.scan.rows);
        image.iter_mut().zip(&kernel).for_each(|(value, factor)| *value *= factor);
        fft.inverse(&mut image, self.scan.rows);
        fft.inverse(&mut kernel, self.scan.rows);
        let keep = |plane: &[Complex<f64>]| self.cut(plane).map(narrow).collect();
        Slice { image: keep(&image), kernel: keep(&kernel) }
    }

    /// The Wiener filter at one frequency: `conj(P) / (|P|^2 + 1 / snr)` for the paraboloid's spectrum `P`, scaled to a
    /// mean of `|P|^2` of 1. As transforms of planes have it.
    fn spectrum_of_filter(&self, fft: &mut PlaneFft, frequency: usize) -> Vec<Complex<f64>> {
        let rate = -TAU * frequency as f64 / self.times as f64;
        let squared = |lag: usize| (lag as f64 * self.scan.pitch_ps).powi(2) / self.step_ps2;
        let phases = |count: usize| (0..count).map(|lag| Complex::cis(rate * squared(lag))).collect::<Vec<_>>();
        let (across, down) = (phases(self.scan.columns), phases(self.scan.rows));
        let mut plane = vec![Complex::default(); fft.values()];
        let copies = |lag: usize| if lag > 0 { 2.0 } else { 1.0 };
        let mut energy = 0.0_f64;
        for (y, down) in down.iter().enumerate() {
            for (x, across) in across.iter().enumerate() {
                // Behind the end of the record there is no light.
                if squared(x) + squared(y) > self.bins as f64 {
                    break;
                }
                for at in self.mirrors(x, y) {
                    plane[at] = across * down;
                }
                energy += copies(x) * copies(y);
            }
        }
        fft.forward(&mut plane, self.rows);
        let gain = energy.sqrt() * self.low_pass(frequency);
        let floor = energy / self.prior.signal_to_noise;
        plane.iter_mut().for_each(|value| *value = value.conj() * (gain / (value.norm_sqr() + floor)));
        plane
    }

    /// What the response leaves of a frequency, at the geometric mean of the times: its width in `v` grows with time.
    fn low_pass(&self, frequency: usize) -> f64 {
        let [start_ps, end_ps] = self.scan.times_ps;
        let middle_ps = (start_ps.max(self.prior.response_ps) * end_ps).sqrt();
        let width = 0.5 * middle_ps * self.prior.response_ps / self.step_ps2;
        (-0.5 * (TAU * frequency as f64 / self.times as f64 * width).powi(2)).exp()
    }

    /// Places of a lag and of its mirror images in a padded plane.
    fn mirrors(&self, x: usize, y: usize) -> [usize; 4] {
        let (left, up) = ((self.columns - x) % self.columns, (self.rows - y) % self.rows);
        [(x, y), (left, y), (x, up), (left, up)].map(|(x, y)| y * self.columns + x)
    }

    /// A padded plane of one frequency.
    fn gather<T: Copy>(
        &self,
        frequency: usize,
        rows: &[Vec<T>],
        convert: impl Fn(T) -> Complex<f64>,
    ) -> Vec<Complex<f64>> {
        assert_eq!(rows.len(), self.scan.rows, "the grid has another number of rows");
        let columns = self.scan.columns;
        let mut plane = vec![Complex::default(); self.columns * self.rows];
        for (row, into) in rows.iter().zip(plane.chunks_mut(self.columns)) {
            into.iter_mut().zip(&row[frequency * columns..][..columns]).for_each(|(into, bin)| *into = convert(*bin));
        }
        plane
    }

    /// The part of a padded plane that the grid covers.
    fn cut<'a>(&'a self, plane: &'a [Complex<f64>]) -> impl Iterator<Item = Complex<f64>> + 'a {
        plane.chunks(self.columns).take(self.scan.rows).flat_map(|row| &row[..self.scan.columns]).copied()
    }

    /// Spectrum of the squared filter for lags of `row` rows, from the filter's frequencies.
    ///
    /// # Panics
    /// If there are not as many slices as frequencies.
    pub fn square(&self, workspace: &mut Workspace, row: usize, slices: &[Slice]) -> Vec<Complex<f32>> {
        assert_eq!(slices.len(), self.frequencies(), "the filter has another number of frequencies");
        let columns = self.scan.columns;
        let mut squares = vec![Complex::default(); self.frequencies() * columns];
        let (mut spectrum, mut lags) = (vec![Complex::default(); self.frequencies()], vec![0.0; self.times]);
        for column in 0..columns {
            for (bin, slice) in spectrum.iter_mut().zip(slices) {
                *bin = wide(slice.kernel[row * columns + column]);
            }
            workspace.time.inverse(&spectrum, &mut lags);
            lags.iter_mut().for_each(|lag| *lag *= *lag);
            workspace.time.forward(&lags, &mut spectrum);
            spectrum.iter().enumerate().for_each(|(k, bin)| squares[k * columns + column] = narrow(*bin));
        }
        squares
    }

    /// One frequency of the variance of the image, `rows` x `columns` values, from the variances of all rows and the
    /// rows of the squared filter.
    ///
    /// # Panics
    /// If there are not as many rows as in the grid.
    pub fn spread(
        &self,
        workspace: &mut Workspace,
        frequency: usize,
        variances: &[Vec<Complex<f64>>],
        squares: &[Vec<Complex<f32>>],
    ) -> Vec<Complex<f64>> {
        let fft = &mut workspace.plane;
        let columns = self.scan.columns;
        let mut kernel = vec![Complex::default(); fft.values()];
        for (y, square) in squares.iter().enumerate() {
            for (x, value) in square[frequency * columns..][..columns].iter().enumerate() {
                for at in self.mirrors(x, y) {
                    kernel[at] = wide(*value);
                }
            }
        }
        fft.forward(&mut kernel, self.rows);
        let mut variance = self.gather(frequency, variances, |bin| bin);
        fft.forward(&mut variance, self.scan.rows);
        variance.iter_mut().zip(&kernel).for_each(|(value, factor)| *value *= factor);
        fft.inverse(&mut variance, self.scan.rows);
        self.cut(&variance).collect()
    }

    /// Values of a row of voxels from the planes of all frequencies: [`LightCone::depths`] for each column.
    ///
    /// # Panics
    /// If there are not as many slices as frequencies.
    pub fn values(&self, workspace: &mut Workspace, row: usize, slices: &[Slice]) -> Vec<f64> {
        assert_eq!(slices.len(), self.frequencies(), "the image has another number of frequencies");
        self.records(workspace, |k, column| wide(slices[k].image[row * self.scan.columns + column]))
    }

    /// Puts a frequency of the variance of the image in the place of that of the histograms, which is not needed any
    /// more.
    ///
    /// # Panics
    /// If the plane or the rows have another size than the grid.
    pub fn keep(&self, frequency: usize, plane: &[Complex<f64>], variances: &mut [Vec<Complex<f64>>]) {
        let columns = self.scan.columns;
        assert!(plane.len() == columns * self.scan.rows, "a plane has another size than the grid");
        for (row, values) in variances.iter_mut().zip(plane.chunks(columns)) {
            row[frequency * columns..][..columns].copy_from_slice(values);
        }
    }

    /// Variances of the same voxels, from all frequencies of a row that [`LightCone::keep`] filled.
    #[must_use]
    pub fn variances(&self, workspace: &mut Workspace, row: &[Complex<f64>]) -> Vec<f64> {
        self.records(workspace, |k, column| row[k * self.scan.columns + column])
    }

    fn records(&self, workspace: &mut Workspace, bin_at: impl Fn(usize, usize) -> Complex<f64>) -> Vec<f64> {
        let mut voxels = Vec::with_capacity(self.scan.columns * self.bins);
        let (mut spectrum, mut record) = (vec![Complex::default(); self.frequencies()], vec![0.0; self.times]);
        for column in 0..self.scan.columns {
            for (k, bin) in spectrum.iter_mut().enumerate() {
                *bin = bin_at(k, column);
            }
            workspace.time.inverse(&spectrum, &mut record);
            voxels.extend(&record[..self.bins]);
        }
        voxels
    }
}
