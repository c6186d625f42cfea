//! Labels without known patches: the first light of each profile, and whether it took a detour.

use std::collections::BTreeMap;

use super::{LabelOnsets, ONE_STATION_M, OfSensor, Setup, Verdict, Verdicts, direct, light, sd_ps, time_ps};
use crate::geometry::detours::detours;
use crate::geometry::t2::{self, Length};
use crate::tables::Onset;
use crate::units::{self, PatchId};

/// Bounds on a second bounce are kept this many standard deviations wide, and light of reciprocal profiles agrees within as many.
const GATE: f64 = 5.0;
/// Delays of reciprocal captures differ by less than this, whatever their vertical ranges and attenuators.
const DELAYS_PS: f64 = 100.0;

/// An onset that may be a profile's first light.
#[derive(Clone, Copy, Debug)]
struct First {
    /// Its place in the profile.
    onset: usize,
    turns: i32,
    time_ps: f64,
    sd_ps: f64,
}

/// First light by (lit, seen).
type Firsts = BTreeMap<(PatchId, PatchId), First>;

impl LabelOnsets {
    /// For each profile of one sensor, for each onset, its labels.
    pub(super) fn blind(&self, sensor: &OfSensor) -> Verdicts {
        let OfSensor { setup, profiles, .. } = sensor;
        let mut firsts = Firsts::new();
        for profile in profiles.iter().filter(|profile| profile[0].lit == profile[0].seen) {
            let near_ps = time_ps(2.0 * self.near_m, setup);
            let far_ps = setup.repetition_ps.map_or(f64::INFINITY, |period_ps| near_ps + period_ps);
            let readings = readings(profile, setup.repetition_ps, (near_ps, far_ps));
            // The laser's period may put later light before the first bounce, which is by far the strongest.
            let first = if setup.repetition_ps.is_some() {
                readings.into_iter().max_by(|a, b| profile[a.onset].snr.total_cmp(&profile[b.onset].snr))
            } else {
                readings.into_iter().next()
            };
            firsts.extend(first.map(|first| ((profile[0].lit, profile[0].seen), first)));
        }
        let seconds: Vec<((PatchId, PatchId), First)> = profiles
            .iter()
            .filter(|profile| profile[0].lit != profile[0].seen)
            .filter_map(|profile| {
                let pair = (profile[0].lit, profile[0].seen);
                Some((pair, self.second(sensor, &firsts, profile)?))
            })
            .collect();
        firsts.extend(seconds);
        let is_one_station = sensor.apart_m() < ONE_STATION_M;
        let closed = detours(&arrivals(setup, &firsts, is_one_station), is_one_station);
        let labels = |profile: &&[Onset]| {
            let pair = (profile[0].lit, profile[0].seen);
            let other = firsts.get(&(pair.1, pair.0)).filter(|_| is_one_station);
            let first = firsts.get(&pair).filter(|first| other.is_none_or(|other| first.agrees(other)));
            let label = |(i, onset): (usize, &Onset)| {
                let Some(first) = first.filter(|first| first.onset == i) else {
                    return vec![Verdict::open()];
                };
                let path = match closed.get(&pair) {
                    None => Some(direct(profile)),
                    Some(via) => via.map(|via| vec![pair.0, via, pair.1]),
                };
                let Some(path) = path.filter(|path| path.len() as i32 <= self.bounces) else {
                    return vec![Verdict::open()];
                };
                let probability = light(onset);
                vec![Verdict { turns: first.turns, path: Some(path), probability, ..Verdict::open() }]
            };
            profile.iter().enumerate().map(label).collect()
        };
        profiles.iter().map(labels).collect()
    }

    /// First light of a pair, between the longer of its two first bounces and their sum; `None` where the laser's period leaves a choice.
    fn second(&self, sensor: &OfSensor, firsts: &Firsts, profile: &[Onset]) -> Option<First> {
        let setup = sensor.setup;
        let own = [profile[0].lit, profile[0].seen].map(|patch| firsts.get(&(patch, patch)));
        let known = || own.iter().flatten();
        let near_ps = time_ps(2.0 * self.near_m, setup);
        let least_ps = known().map(|first| first.time_ps - GATE * first.sd_ps).fold(near_ps, f64::max);
        let most_ps = match own {
            [Some(a), Some(b)] => {
                // Stations apart leave each leg as much longer.
                let apart_ps = time_ps(2.0 * sensor.apart_m(), setup);
                a.time_ps + b.time_ps + apart_ps + GATE * a.sd_ps.hypot(b.sd_ps)
            }
            _ if setup.repetition_ps.is_some() => return None,
            _ => f64::INFINITY,
        };
        let readings = readings(profile, setup.repetition_ps, (least_ps, most_ps));
        let first = readings.first().copied()?;
        // Later light, read some periods earlier, may lie within the bounds too.
        (setup.repetition_ps.is_none() || readings.len() == 1).then_some(first)
    }
}

impl First {
    /// Whether light of the reciprocal profile is the same: a false onset comes in one of them.
    fn agrees(&self, other: &Self) -> bool {
        (self.time_ps - other.time_ps).abs() <= (GATE * self.sd_ps.hypot(other.sd_ps)).max(DELAYS_PS)
    }
}

/// Onsets of a profile read with so many laser periods added that they lie within bounds, in order of time.
fn readings(profile: &[Onset], period_ps: Option<f64>, (least_ps, most_ps): (f64, f64)) -> Vec<First> {
    let reading = |(onset, row): (usize, &Onset)| -> Vec<First> {
        let sd_ps = sd_ps(row);
        let (least_ps, most_ps) = (least_ps - GATE * sd_ps, most_ps + GATE * sd_ps);
        let of_turns = |turns: i32| {
            let time_ps = row.time_ps + f64::from(turns) * period_ps.unwrap_or(0.0);
            (time_ps >= least_ps && time_ps <= most_ps).then_some(First { onset, turns, time_ps, sd_ps })
        };
        let Some(period_ps) = period_ps else {
            return of_turns(0).into_iter().collect();
        };
        let turns_of = |time_ps: f64| (time_ps - row.time_ps) / period_ps;
        (turns_of(least_ps).ceil() as i32..=turns_of(most_ps).floor() as i32).filter_map(of_turns).collect()
    };
    let mut readings: Vec<First> = profile.iter().enumerate().flat_map(reading).collect();
    readings.sort_by(|a, b| a.time_ps.total_cmp(&b.time_ps));
    readings
}

/// Lengths of first light. Where laser and sensor stand together, both directions of a pair are one: their mean, or if they disagree, the longer,
/// which may hide a detour but makes none up.
fn arrivals(setup: &Setup, firsts: &Firsts, is_one_station: bool) -> BTreeMap<(PatchId, PatchId), Length> {
    let length = |first: &First| Length {
        length_m: units::path_m(first.time_ps, setup.group_index),
        variance_m2: units::path_m(first.sd_ps, setup.group_index).powi(2),
    };
    let mut arrivals = BTreeMap::new();
    for (&(lit, seen), first) in firsts {
        let other = firsts.get(&(seen, lit)).filter(|_| is_one_station && lit != seen);
        let both = match other {
            None => length(first),
            Some(other) if first.agrees(other) => t2::mean(&[length(first), length(other)]).0,
            Some(other) => length(if first.time_ps > other.time_ps { first } else { other }),
        };
        arrivals.insert((lit, seen), both);
        if is_one_station {
            arrivals.insert((seen, lit), both);
        }
    }
    arrivals
}
