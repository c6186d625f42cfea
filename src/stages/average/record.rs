//! A mean record on its way to a profile: ranges merged, folded into the laser's period.

use super::clipping::Clipping;
use crate::signal::fold::{self, Folded};
use crate::signal::merge_ranges::{MergeOptions, Merged, RangeProfile, merge};
use crate::tables::Profile;

/// The gain between two ranges must be known to this part of itself.
const GAIN_SD_MAX: f64 = 0.1;
/// A sample this many standard errors off the baseline is light.
const LIGHT_SIGMA: f64 = 4.0;

/// Mean record of one or all ranges.
pub struct Record {
    /// Place of sample 0 on the common grid.
    pub first: i64,
    pub mean_v: Vec<f64>,
    pub se_v: Vec<f64>,
    pub clipping: Clipping,
    /// All but the samples and their times.
    pub profile: Profile,
}

impl Record {
    /// As a row; in a campaign whose light repeats with `period_ps`, a record that holds a period as one period.
    pub fn into_profile(self, period_ps: Option<f64>) -> Profile {
        let Self { first, mean_v, se_v, profile, .. } = self;
        let dt_ps = profile.dt_ps;
        let t0_ps = first as f64 * dt_ps;
        let period_ps = period_ps.filter(|period_ps| (2.0 * dt_ps..=mean_v.len() as f64 * dt_ps).contains(period_ps));
        let Some(period_ps) = period_ps else {
            let (mean_v, se_v) = (mean_v.into_iter().collect(), se_v.into_iter().collect());
            return Profile { t0_ps, mean_v, se_v, ..profile };
        };
        // Weights need errors: without any noise all samples weigh the same.
        let sd_v = if se_v.contains(&0.0) { vec![1.0; se_v.len()] } else { se_v.clone() };
        let record = fold::PulseTrain { mean_v: &mean_v, sd_v: &sd_v, dt_ps };
        let Folded { mut mean_v, se_v: mut folded_se_v, step_ps } = fold::fold(&record, period_ps);
        let is_dark: Vec<bool> = mean_v.iter().zip(&folded_se_v).map(|(v, se)| v.abs() <= LIGHT_SIGMA * se).collect();
        let start = fold::opening(&is_dark);
        mean_v.rotate_left(start);
        folded_se_v.rotate_left(start);
        if se_v.contains(&0.0) {
            folded_se_v.fill(0.0);
        }
        Profile {
            t0_ps: t0_ps + start as f64 * step_ps,
            dt_ps: step_ps,
            mean_v: mean_v.into_iter().collect(),
            se_v: folded_se_v.into_iter().collect(),
            ..profile
        }
    }
}

/// One record of all ranges, on the scale and at the times of the most sensitive.
pub fn merged(mut ranges: Vec<Record>) -> Result<Record, String> {
    ranges.sort_by(|a, b| a.profile.gain_v.abs().total_cmp(&b.profile.gain_v.abs()));
    let dt_ps = ranges[0].profile.dt_ps;
    if ranges.iter().any(|range| range.profile.dt_ps != dt_ps) {
        return Err("was taken at several vertical ranges with unequal times between samples".to_owned());
    }
    if ranges.iter().any(|range| range.se_v.iter().any(|se| *se <= 0.0)) {
        return Err("has a vertical range without any noise, which cannot be weighed against the others".to_owned());
    }
    let first = ranges.iter().map(|range| range.first).max().unwrap_or(0);
    let end = ranges.iter().map(|range| range.first + range.mean_v.len() as i64).min().unwrap_or(0);
    let Some(count) = usize::try_from(end - first).ok().filter(|count| *count > 0) else {
        return Err("was taken at vertical ranges whose records do not overlap in time".to_owned());
    };
    let clipped: Vec<Vec<bool>> = ranges.iter().map(|range| range.clipping.at(first, count)).collect();
    let cut = |range: &Record| (first - range.first) as usize..(end - range.first) as usize;
    let views: Vec<RangeProfile<'_>> = ranges
        .iter()
        .zip(&clipped)
        .map(|(range, clipped)| RangeProfile {
            mean_v: &range.mean_v[cut(range)],
            se_v: &range.se_v[cut(range)],
            clipped,
        })
        .collect();
    let Clipping { before, after, .. } = ranges[0].clipping;
    let options = MergeOptions { margin_before: before, margin_after: after, delay_dt_ps: Some(dt_ps) };
    let Some(merged) = merge(&views, &options).ok().filter(is_certain) else {
        return Err(
            "was taken at several vertical ranges, in all of which too little light is seen to tell how they scale; \
                    exclude all but one in campaign.toml"
                .to_owned(),
        );
    };
    let largest = |f: &dyn Fn(usize) -> f64| (0..merged.links.len()).map(f).fold(0.0, f64::max);
    let gain_sd = largest(&|k| merged.links[k].gain_sd / merged.links[k].gain);
    let delay_sd_ps = largest(&|k| merged.links[k].delay_sd_ps);
    let sum = |f: &dyn Fn(&Profile) -> i32| ranges.iter().map(|range| f(&range.profile)).sum::<i32>();
    let (rejected, clipped) = (sum(&|profile| profile.rejected), sum(&|profile| profile.clipped));
    let phase_shots = phase_shots(&ranges);
    let Record { profile, clipping, .. } = ranges.swap_remove(0);
    let (jitter_ps, gain_sd) = (profile.jitter_ps.hypot(delay_sd_ps), profile.gain_sd.hypot(gain_sd));
    let profile = Profile { rejected, clipped, phase_shots, jitter_ps, gain_sd, ..profile };
    Ok(Record { first, mean_v: merged.mean_v, se_v: merged.se_v, clipping, profile })
}

/// Whether the ranges' factors are measured well enough.
fn is_certain(merged: &Merged) -> bool {
    merged.links.iter().all(|link| link.gain_sd < GAIN_SD_MAX * link.gain)
}

/// Shots of all ranges at each phase.
fn phase_shots(ranges: &[Record]) -> Option<Vec<i32>> {
    let all = ranges.iter().map(|range| range.profile.phase_shots.clone()).collect::<Option<Vec<_>>>()?;
    all.into_iter().reduce(|sums, shots| sums.iter().zip(shots).map(|(sum, shots)| sum + shots).collect())
}
