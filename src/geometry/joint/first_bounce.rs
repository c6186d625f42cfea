//! The response as the wall's own light shows it: the sum of all histograms of a confocal scan.
//!
//! A calibrated response is often a Gaussian of the right width, and real ones have a tail: one per cent of the peak
//! after a nanosecond, under which hidden light vanishes, or looks like more points. At each point of a confocal scan
//! the wall returns the response itself, with arrival 0. Its rise is often cut off, since scans begin with the wall:
//! then it is a Gaussian of the given width. Behind the gate, where hidden light lies, its tail is that of [`Tail`].

use periscope_cancel::Cancel;

use super::Noise;
use super::background::Tail;
use super::pulse::Pulse;

/// The first bounce is at least so many times as high as the light at the gate.
const ABOVE: f64 = 5.0;
/// Its peak is that many times as high as its standard deviation.
const SURE: f64 = 30.0;
/// Largest distance of its peak from the arrival, and least distance of the gate from its peak, in full widths.
const NEAR: f64 = 1.5;
const CLEAR: f64 = 1.0;
/// Blocks of the sum that the mixture explains behind the gate, within so many standard deviations and this share.
const BLOCKS: usize = 6;
/// Least distance of the gate from the arrival, and largest from where it is first sought, in such blocks.
const FIRST: usize = 5;
const FARTHEST: usize = 10;
const OFF_SD: f64 = 4.0;
const OFF_SHARE: f64 = 1e-3;
/// Full width at half maximum of a Gaussian, in standard deviations, and reach of its rise.
const FWHM: f64 = 2.354_820_045_030_949_3;
const REACH: f64 = 3.5;
/// Standard deviation of the logarithm of the width of a rise that the scan cuts off.
const CUT_OFF: f64 = 0.1;

/// The sum of all histograms of a confocal scan.
#[derive(Clone, Copy, Debug)]
pub struct WallSum<'a> {
    /// Counts of each bin, or levels.
    pub sum: &'a [f64],
    /// Path length at the middle of the first bin.
    pub first_m: f64,
    /// Width of its bins.
    pub step_m: f64,
    /// Bin behind which it is smooth but for hidden light.
    pub gate: usize,
    /// Full width at half maximum of the response, from elsewhere.
    pub width_m: f64,
    /// How the values of the sum vary.
    pub noise: Noise,
}

impl WallSum<'_> {
    /// The first bin from the gate on behind which the mixture explains the sum over `BLOCKS` blocks, each as wide as
    /// the response, and at least `FIRST` of them behind the arrival; the bin that comes nearest where there is none.
    ///
    /// A gate that is found by other means may leave the end of the first bounce, which would look like points close to
    /// the wall.
    #[must_use]
    pub fn clear(&self, cancel: &Cancel) -> usize {
        let block = (self.width_m / self.step_m).ceil().max(1.0) as usize;
        // The largest difference of a block, in units of what is allowed.
        let worst = |from: usize| {
            cancel.check();
            let after = &self.sum[from..];
            let tail = Tail::new([0.0, self.step_m, self.width_m], (after, &vec![0.0; after.len()]), (1, self.noise));
            let constant = tail.constant();
            let pairs = after.chunks(block).zip(tail.values().chunks(block)).take(BLOCKS);
            let off = pairs.map(|(sum, tail)| {
                let [sum, model] = [sum.iter().sum::<f64>(), tail.iter().map(|value| value + constant).sum()];
                let sd = (block as f64 * self.noise.variance(model / block as f64)).sqrt();
                (sum - model).abs() / (OFF_SD * sd + OFF_SHARE * model.abs())
            });
            off.fold(0.0, f64::max)
        };
        // Farther on hidden light may be what the mixture does not explain.
        let last = (self.gate + FARTHEST * block).min(self.sum.len().saturating_sub(BLOCKS * block));
        let least = self.gate.max((FIRST * block).saturating_sub((self.first_m / self.step_m) as usize)).min(last);
        let mut best = (f64::INFINITY, least);
        for from in (least..last).step_by(block.div_ceil(2)) {
            let worst = worst(from);
            if worst < best.0 {
                best = (worst, from);
            }
            if worst < 1.0 {
                break;
            }
        }
        best.1
    }

    /// The response for histograms with bins of `bin_m`; `None` where no first bounce stands at length 0.
    #[must_use]
    pub fn pulse(&self, bin_m: f64) -> Option<Pulse> {
        let Self { sum, step_m, gate, width_m, noise, .. } = *self;
        let before = sum.get(..gate)?;
        let peak = (0..gate).max_by(|a, b| before[*a].total_cmp(&before[*b]).then(b.cmp(a)))?;
        let peak_m = self.first_m + peak as f64 * step_m;
        let after = &sum[gate..];
        let tail = Tail::new([0.0, step_m, width_m], (after, &vec![0.0; after.len()]), (1, noise));
        // The mixture without its constant: what both share is not of the response.
        let behind = tail.values();
        let constant = (sum.get(gate)? - behind.first()?).max(0.0);
        let height = before[peak] - constant;
        let is_there = peak_m.abs() < NEAR * width_m
            && height > ABOVE * behind[0]
            && height > SURE * noise.variance(before[peak]).sqrt()
            && (gate - peak) as f64 * step_m > CLEAR * width_m;
        if !is_there {
            return None;
        }
        let sigma = width_m / FWHM / step_m;
        let rise = (REACH * sigma).ceil() as usize;
        let mut response: Vec<f64> = if peak >= rise {
            before[peak - rise..peak].iter().map(|value| (value - constant).max(0.0)).collect()
        } else {
            // About length 0, which the first bin may lie behind.
            let gauss = |at_m: f64| (-0.5 * (at_m / (sigma * step_m)).powi(2)).exp();
            let scale = height / gauss(peak_m);
            (1..=rise).rev().map(|n| scale * gauss(peak_m - n as f64 * step_m)).collect()
        };
        response.extend(before[peak..].iter().map(|value| (value - constant).max(0.0)));
        response.extend_from_slice(behind);
        // Light of the first bounce tells its shape to the relative error of its sum.
        let core = &before[peak..];
        let light: f64 = core.iter().map(|value| (value - constant).max(0.0)).sum();
        let sd = core.iter().map(|value| noise.variance(*value)).sum::<f64>().sqrt() / light;
        let mut doubts = Pulse::measured().map(|doubt| doubt.hypot(sd));
        if peak < rise {
            doubts[1] = CUT_OFF;
        }
        Some(Pulse::new(peak_m - rise as f64 * step_m, step_m, &response, bin_m).doubted(doubts))
    }
}
