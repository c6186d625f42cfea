//! A mean record on its way to a profile: ranges merged, folded into the laser's period.

use super::clipping::Clipping;
use crate::signal::fold::{self, Folded};
use crate::signal::merge_ranges::{MergeOptions, Merged, Prior, RangeProfile, merge};
use crate::tables::Profile;

/// The gain between two ranges must be known to this part of itself.
const GAIN_SD_MAX: f64 = 0.1;
/// Standard deviation of the ratio of two stated gains: makers state 1 to 2 % of full scale for the gain of a range.
const GAIN_STATED_SD: f64 = 0.02;
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
            let [mean_v, se_v] = [mean_v, se_v].map(|values| Some(values.into_iter().collect()));
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
            mean_v: Some(mean_v.into_iter().collect()),
            se_v: Some(folded_se_v.into_iter().collect()),
            ..profile
        }
    }
}

/// Delay of a sensor at one of its vertical ranges, and the error that other ranges do not share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Latency {
    pub latency_ps: f64,
    pub own_sd_ps: f64,
}

/// One record of all ranges. Where the light that they share links them, it has scale and times of the most sensitive.
/// Where it does not, what is stated of them does, and it has scale and times of the most sensitive that is whole: the
/// light that clips in others is not shifted then, and keeps its time. Where nothing is stated, that range stands
/// alone, and the text says why. `latency`: what the calibration says of a range.
pub fn merged(
    mut ranges: Vec<Record>,
    latency: &dyn Fn(&Profile) -> Option<Latency>,
) -> Result<(Record, Option<String>), String> {
    ranges.sort_by(|a, b| a.profile.gain_v.abs().total_cmp(&b.profile.gain_v.abs()));
    let why = match merge_all(&ranges, None) {
        Ok((first, merged)) => return Ok((joined(ranges, first, merged), None)),
        Err(why) => why,
    };
    let Some(whole) = ranges.iter().position(|range| range.clipping.places().next().is_none()) else {
        return Err(format!("was taken at several vertical ranges, all of which clip, and {why}"));
    };
    ranges[..=whole].rotate_right(1);
    let latencies: Option<Vec<Latency>> = ranges.iter().map(|range| latency(&range.profile)).collect();
    if let Some(Ok((first, merged))) = latencies.map(|latencies| merge_all(&ranges, Some(&latencies))) {
        return Ok((joined(ranges, first, merged), None));
    }
    let record = ranges.swap_remove(0);
    let name = record.profile.range.as_deref().unwrap_or_default();
    let alone = format!("is averaged from its vertical range {name} alone, since {why}");
    Ok((record, Some(alone)))
}

/// Place of the first sample that all ranges have, and the merged samples from there on; else why there are none. The
/// first range is the one that the others are linked to: by light, or with `latencies` by what is stated.
fn merge_all(ranges: &[Record], latencies: Option<&[Latency]>) -> Result<(i64, Merged), &'static str> {
    let dt_ps = ranges[0].profile.dt_ps;
    if ranges.iter().any(|range| range.profile.dt_ps != dt_ps) {
        return Err("the times between their samples differ: record all with one time base");
    }
    if ranges.iter().any(|range| range.se_v.iter().any(|se| *se <= 0.0)) {
        return Err("one of them has no noise at all and cannot be weighed against the others");
    }
    let first = ranges.iter().map(|range| range.first).max().unwrap_or(0);
    let end = ranges.iter().map(|range| range.first + range.mean_v.len() as i64).min().unwrap_or(0);
    let Some(count) = usize::try_from(end - first).ok().filter(|count| *count > 0) else {
        return Err("their records do not overlap in time: record all with one trigger delay");
    };
    let clipped: Vec<Vec<bool>> = ranges.iter().map(|range| range.clipping.at(first, count)).collect();
    let cut = |range: &Record| (first - range.first) as usize..(end - range.first) as usize;
    let view = |n: usize| RangeProfile {
        mean_v: &ranges[n].mean_v[cut(&ranges[n])],
        se_v: &ranges[n].se_v[cut(&ranges[n])],
        clipped: &clipped[n],
        prior: latencies.map(|latencies| stated(latencies[0], latencies[n])),
    };
    let views: Vec<RangeProfile<'_>> = (0..ranges.len()).map(view).collect();
    let Clipping { before, after, .. } = ranges[0].clipping;
    let options = MergeOptions { margin_before: before, margin_after: after, delay_dt_ps: Some(dt_ps) };
    let merged = merge(&views, &options).ok().filter(is_certain);
    merged.map(|merged| (first, merged)).ok_or(
        "too little light is seen in all of them to tell their scale and delay: capture the response at each range, so that their delays are known",
    )
}

/// What is stated of a range beside the first one: both are in volts, and the calibration has both delays.
fn stated(first: Latency, own: Latency) -> Prior {
    Prior {
        gain: 1.0,
        gain_sd: GAIN_STATED_SD,
        delay_ps: own.latency_ps - first.latency_ps,
        delay_sd_ps: own.own_sd_ps.hypot(first.own_sd_ps),
    }
}

/// The record of all ranges, with the first one's profile.
fn joined(mut ranges: Vec<Record>, first: i64, merged: Merged) -> Record {
    let largest = |f: &dyn Fn(usize) -> f64| (0..merged.links.len()).map(f).fold(0.0, f64::max);
    let gain_sd = largest(&|k| merged.links[k].gain_sd / merged.links[k].gain);
    let delay_sd_ps = largest(&|k| merged.links[k].delay_sd_ps);
    let sum = |f: &dyn Fn(&Profile) -> i32| ranges.iter().map(|range| f(&range.profile)).sum::<i32>();
    let (rejected, clipped) = (sum(&|profile| profile.rejected), sum(&|profile| profile.clipped));
    let phase_shots = phase_shots(&ranges);
    let Record { profile, clipping, .. } = ranges.swap_remove(0);
    let (jitter_ps, gain_sd) = (profile.jitter_ps.hypot(delay_sd_ps), profile.gain_sd.hypot(gain_sd));
    let profile = Profile { rejected, clipped, phase_shots, jitter_ps, gain_sd, ..profile };
    Record { first, mean_v: merged.mean_v, se_v: merged.se_v, clipping, profile }
}

/// Whether the factors between ranges are measured well enough.
fn is_certain(merged: &Merged) -> bool {
    merged.links.iter().all(|link| link.gain_sd < GAIN_SD_MAX * link.gain)
}

/// Shots of all ranges at each phase.
fn phase_shots(ranges: &[Record]) -> Option<Vec<i32>> {
    let all = ranges.iter().map(|range| range.profile.phase_shots.clone()).collect::<Option<Vec<_>>>()?;
    all.into_iter().reduce(|sums, shots| sums.iter().zip(shots).map(|(sum, shots)| sum + shots).collect())
}
