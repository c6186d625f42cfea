//! Labels without patches in place: the first light of each profile, and whether it took a detour.

use std::collections::BTreeMap;

use periscope_cancel::Cancel;

use super::problem::{Arrival, Medium, Options, Profile, SensorProfiles, Verdict, Verdicts, View};
use crate::detours::detours;
use crate::t2::{self, Length};
use crate::units::PatchId;

/// Stations closer than this are one.
const ONE_STATION_M: f64 = 1e-6;
/// Bounds on a second bounce are kept this many standard deviations wide, and light of reciprocal profiles agrees
/// within as many.
const GATE: f64 = 5.0;
/// A first bounce is no weaker than this share of the strongest light of its profile.
const WEAKEST: f64 = 0.25;
/// Delays of reciprocal captures differ by less than this, whatever their vertical ranges and attenuators.
const DELAYS_PS: f64 = 100.0;

/// An arrival that may be a profile's first light.
#[derive(Clone, Copy, Debug)]
struct First {
    /// Its position in the profile.
    arrival: usize,
    turns: i32,
    time_ps: f64,
    sd_ps: f64,
}

/// First light by (lit, seen).
type Firsts = BTreeMap<(PatchId, PatchId), First>;

/// For each pair whose first light took a detour, the patch that it came over if that is certain.
type Detours = BTreeMap<(PatchId, PatchId), Option<PatchId>>;

/// For each profile of one sensor, for each arrival, its label.
pub(super) fn label(sensor: &SensorProfiles, options: &Options, cancel: &Cancel) -> Verdicts {
    let firsts = firsts(sensor, options.near_m);
    let is_one_station = sensor.baseline_m() < ONE_STATION_M;
    let detours = detours(&lengths(sensor.medium, &firsts, is_one_station), is_one_station, cancel);
    let of_profile = |profile: &Profile| {
        let (lit, seen) = profile.pair();
        let reciprocal = firsts.get(&(seen, lit)).filter(|_| is_one_station);
        // A false arrival comes in one of two reciprocal profiles.
        let first = firsts.get(&(lit, seen)).filter(|first| reciprocal.is_none_or(|other| first.agrees(other)));
        verdicts(profile, first, &detours, options.bounces)
    };
    sensor.profiles.iter().map(of_profile).collect()
}

/// A path for the first light, if it is known; none for any other arrival.
fn verdicts(profile: &Profile, first: Option<&First>, detours: &Detours, bounces: usize) -> Vec<Vec<Verdict>> {
    let mut verdicts = vec![vec![Verdict::open()]; profile.arrivals.len()];
    let path = match detours.get(&profile.pair()) {
        None => Some(profile.direct()),
        Some(via) => via.map(|via| vec![profile.lit, via, profile.seen]),
    };
    if let (Some(first), Some(path)) = (first, path.filter(|path| path.len() <= bounces)) {
        let probability = profile.arrivals[first.arrival].signal_probability();
        verdicts[first.arrival] =
            vec![Verdict { turns: first.turns, path: Some(path), probability, ..Verdict::open() }];
    }
    verdicts
}

/// First light of all profiles.
fn firsts(sensor: &SensorProfiles, near_m: f64) -> Firsts {
    let (own, between): (Vec<View>, Vec<View>) = sensor.views().partition(|view| view.profile.lit == view.profile.seen);
    let near_ps = sensor.medium.time_ps(2.0 * near_m);
    let mut firsts = Firsts::new();
    for View { profile, .. } in own {
        firsts.extend(first_bounce(profile, sensor.medium, near_ps).map(|first| (profile.pair(), first)));
    }
    // Bounds on second bounces come from first bounces alone, not from one another.
    let second = |view: &View| Some((view.profile.pair(), second_bounce(*view, &firsts, near_ps)?));
    let seconds: Vec<((PatchId, PatchId), First)> = between.iter().filter_map(second).collect();
    firsts.extend(seconds);
    firsts
}

/// First light of a profile whose lit patch is the one seen.
fn first_bounce(profile: &Profile, medium: Medium, near_ps: f64) -> Option<First> {
    let far_ps = medium.repetition_ps.map_or(f64::INFINITY, |period_ps| near_ps + period_ps);
    let readings = readings(profile, medium, (near_ps, far_ps));
    let snr = |first: &First| profile.arrivals[first.arrival].snr;
    if medium.repetition_ps.is_some() {
        // The laser's period may put later light before the first bounce, which is by far the strongest.
        readings.into_iter().max_by(|a, b| snr(a).total_cmp(&snr(b)))
    } else {
        // What comes before the first bounce is spurious, and weak against it. Two overlapping pulses are alike.
        let strongest = readings.iter().map(snr).fold(0.0, f64::max);
        readings.into_iter().find(|first| snr(first) >= WEAKEST * strongest)
    }
}

/// First light of a pair, between the longer of its two first bounces and their sum; `None` where the laser's period
/// leaves a choice.
fn second_bounce(view: View, firsts: &Firsts, near_ps: f64) -> Option<First> {
    let medium = view.medium();
    let own = [view.profile.lit, view.profile.seen].map(|patch| firsts.get(&(patch, patch)));
    let least_ps = own.iter().flatten().map(|first| first.time_ps - GATE * first.sd_ps).fold(near_ps, f64::max);
    let most_ps = match own {
        [Some(a), Some(b)] => {
            // Stations apart leave each leg as much longer.
            let apart_ps = medium.time_ps(2.0 * view.sensor.baseline_m());
            a.time_ps + b.time_ps + apart_ps + GATE * a.sd_ps.hypot(b.sd_ps)
        }
        _ if medium.repetition_ps.is_some() => return None,
        _ => f64::INFINITY,
    };
    let readings = readings(view.profile, medium, (least_ps, most_ps));
    let first = readings.first().copied()?;
    // Later light, read some periods earlier, may lie within the bounds too.
    (medium.repetition_ps.is_none() || readings.len() == 1).then_some(first)
}

impl First {
    /// Whether light of the reciprocal profile is the same.
    fn agrees(&self, other: &Self) -> bool {
        (self.time_ps - other.time_ps).abs() <= (GATE * self.sd_ps.hypot(other.sd_ps)).max(DELAYS_PS)
    }

    fn length(&self, medium: Medium) -> Length {
        Length { length_m: medium.path_m(self.time_ps), variance_m2: medium.path_m(self.sd_ps).powi(2) }
    }
}

/// Arrivals of a profile in order of time, with the laser periods added that bring them within bounds.
fn readings(profile: &Profile, medium: Medium, bounds_ps: (f64, f64)) -> Vec<First> {
    let of_arrival = |(n, arrival)| readings_of(n, arrival, medium, bounds_ps);
    let mut readings: Vec<First> = profile.arrivals.iter().enumerate().flat_map(of_arrival).collect();
    readings.sort_by(|a, b| a.time_ps.total_cmp(&b.time_ps));
    readings
}

/// The same of the arrival at position `n`.
fn readings_of(n: usize, arrival: &Arrival, medium: Medium, (least_ps, most_ps): (f64, f64)) -> Vec<First> {
    let sd_ps = arrival.sd_ps;
    let (least_ps, most_ps) = (least_ps - GATE * sd_ps, most_ps + GATE * sd_ps);
    let turns = medium.repetition_ps.map_or(0..=0, |period_ps| {
        let turns = [least_ps, most_ps].map(|time_ps| (time_ps - arrival.time_ps) / period_ps);
        turns[0].ceil() as i32..=turns[1].floor() as i32
    });
    let of_turns = |turns: i32| {
        let time_ps = arrival.time_ps + medium.turns_ps(turns);
        (time_ps >= least_ps && time_ps <= most_ps).then_some(First { arrival: n, turns, time_ps, sd_ps })
    };
    turns.filter_map(of_turns).collect()
}

/// Lengths of first light. Where laser and sensor stand together, both directions of a pair are one: their mean, or if
/// they disagree, the longer, which may hide a detour but makes none up.
fn lengths(medium: Medium, firsts: &Firsts, is_one_station: bool) -> BTreeMap<(PatchId, PatchId), Length> {
    let mut lengths = BTreeMap::new();
    for (&(lit, seen), first) in firsts {
        let other = firsts.get(&(seen, lit)).filter(|_| is_one_station && lit != seen);
        let both = match other {
            None => first.length(medium),
            Some(other) if first.agrees(other) => t2::mean(&[first.length(medium), other.length(medium)]).0,
            Some(other) => if first.time_ps > other.time_ps { first } else { other }.length(medium),
        };
        lengths.insert((lit, seen), both);
        if is_one_station {
            lengths.insert((seen, lit), both);
        }
    }
    lengths
}
