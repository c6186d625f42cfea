//! Light well before that which histograms show alone.
//!
//! A surface shines on behind its first light. Where that is too weak to be found in one histogram, the light of many
//! histograms over many times the response's width is not. Histograms of neighbours are added up as they lie before
//! what each shows alone: light of something nearer then lies at nearly one place.

use super::{Bins, Noise, wide};

/// Width of a cell, in standard deviations of the response.
const CELL: f64 = 0.5;
/// Light that is this many standard deviations of the response before what is shown alone, or more, is sought.
const EARLIER: f64 = 6.0;
/// Lengths of the light that is sought, and the gap before it, in the same unit. As much as twice its length before the
/// gap tells what there is without it.
const LENGTHS: [f64; 5] = [2.5, 5.0, 10.0, 20.0, 40.0];
const GAP: f64 = 1.0;
const BEFORE: usize = 2;
/// Light that exceeds what there is without it by a smaller share than this is none: the background may have a slope.
const LEAST: f64 = 0.15;

/// Counts of a histogram before its first rise.
#[derive(Clone, Debug)]
pub struct Early {
    /// End of the last cell.
    end_ps: f64,
    cell_ps: f64,
    /// Counts of cells, in order of time.
    counts: Vec<f32>,
}

impl Early {
    /// Of a histogram up to a time, for responses of this standard deviation; `None` of levels, whose noise may be
    /// alike over long stretches.
    #[must_use]
    pub fn before(bins: &Bins<'_>, sigma_ps: f64, time_ps: f64) -> Option<Self> {
        if bins.noise != Noise::Counts {
            return None;
        }
        let wide = wide(CELL * sigma_ps, bins.dt_ps);
        let bin = ((time_ps - bins.first_ps) / bins.dt_ps + 0.5).max(0.0) as usize;
        let end = bin.min(bins.values.len());
        let cell_ps = wide as f64 * bins.dt_ps;
        let longest = LENGTHS[LENGTHS.len() - 1] * (1 + BEFORE) as f64 + GAP + EARLIER;
        let cells = (end / wide).min((longest * sigma_ps / cell_ps).ceil() as usize);
        let counts = bins.values[end - cells * wide..end].chunks_exact(wide);
        let counts = counts.map(|cell| cell.iter().sum::<f64>() as f32).collect();
        Some(Self { end_ps: bins.first_ps + (end as f64 - 0.5) * bins.dt_ps, cell_ps, counts })
    }

    /// Cells that end well before a time.
    fn well_before(&self, sigma_ps: f64, time_ps: f64) -> &[f32] {
        let late_ps = self.end_ps - (time_ps - EARLIER * sigma_ps);
        let left_out = (late_ps / self.cell_ps).ceil().max(0.0) as usize;
        &self.counts[..self.counts.len().saturating_sub(left_out)]
    }
}

/// By how many standard deviations the counts of histograms, each before a time, together show light well before these
/// times; 0 where there are none, or they begin too late to tell.
#[must_use]
pub fn earlier_light(histograms: &[(&Early, f64)], sigma_ps: f64) -> f64 {
    let Some((first, _)) = histograms.first() else { return 0.0 };
    let alike = histograms.iter().filter(|(early, _)| early.cell_ps == first.cell_ps);
    let all: Vec<&[f32]> = alike.map(|(early, time_ps)| early.well_before(sigma_ps, *time_ps)).collect();
    let cells = all.iter().map(|counts| counts.len()).min().unwrap_or(0);
    // Sums of the counts before each cell.
    let mut sums = vec![0.0_f64; cells + 1];
    for counts in all {
        let last = &counts[counts.len() - cells..];
        sums[1..].iter_mut().zip(last).for_each(|(sum, count)| *sum += f64::from(*count));
    }
    (0..cells).for_each(|n| sums[n + 1] += sums[n]);
    let wide = |sigmas: f64| wide(sigmas * sigma_ps, first.cell_ps);
    let gap = wide(GAP);
    let of_length = |length: usize| {
        let starts = (2 * gap + 1..(cells + 1).saturating_sub(length)).step_by(length.div_ceil(8));
        starts.map(move |start| (start, length))
    };
    let scores = LENGTHS.iter().flat_map(|sigmas| of_length(wide(*sigmas))).map(|(start, length)| {
        let (to, from) = (start - gap, (start - gap).saturating_sub(BEFORE * length));
        excess(sums[start + length] - sums[start], sums[to] - sums[from], length as f64 / (to - from) as f64)
    });
    scores.fold(0.0, f64::max)
}

/// By how many standard deviations a count exceeds another one times a ratio, where it does by a share that counts: the
/// root of twice the logarithm of the ratio of likelihoods.
fn excess(light: f64, quiet: f64, ratio: f64) -> f64 {
    if light <= (1.0 + LEAST) * ratio * quiet {
        return 0.0;
    }
    let all = light + quiet;
    let expected = all * ratio / (1.0 + ratio);
    let part = |count: f64, mean: f64| if count > 0.0 { count * (count / mean).ln() } else { 0.0 };
    (2.0 * (part(light, expected) + part(quiet, all - expected))).max(0.0).sqrt()
}
