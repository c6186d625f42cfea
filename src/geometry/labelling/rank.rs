//! The paper's labelling of third bounces by order of arrival (section 4.3), to compare with.
//!
//! In each profile, arrivals that no path over visible patches explains are hidden patches in the order of their times.
//! That is right only where every visible patch has the hidden ones in the same order of distance. Also, no third
//! bounce may be missing or false, or come after a fourth.

use super::problem::{Profile, SensorProfiles, Verdict, Verdicts};

/// Labels the arrivals of one sensor that are left open, in place: as many hidden patches as the campaign counts, or as
/// most profiles have arrivals left.
pub(super) fn label(sensor: &SensorProfiles, verdicts: &mut Verdicts) {
    let open: Vec<Vec<usize>> =
        sensor.profiles.iter().zip(&*verdicts).map(|(profile, verdicts)| left_open(profile, verdicts)).collect();
    let mut counts: Vec<usize> = open.iter().map(Vec::len).collect();
    counts.sort_unstable();
    let count = sensor.hidden_count.map_or_else(|| counts[counts.len() / 2], |count| count as usize);
    for ((profile, verdicts), open) in sensor.profiles.iter().zip(verdicts).zip(open) {
        for (patch, arrival) in (sensor.largest_patch + 1..).zip(open.into_iter().take(count)) {
            let path = Some(vec![profile.lit, patch, profile.seen]);
            let probability = profile.arrivals[arrival].signal_probability();
            verdicts[arrival] = vec![Verdict { path, probability, ..Verdict::open() }];
        }
    }
}

/// Arrivals after the direct light that have no label, in order of time.
fn left_open(profile: &Profile, verdicts: &[Vec<Verdict>]) -> Vec<usize> {
    let time_ps = |arrival: usize| profile.arrivals[arrival].time_ps;
    let is_direct = |verdicts: &Vec<Verdict>| verdicts[0].path.as_ref().is_some_and(|path| path.len() <= 2);
    let direct_ps = verdicts.iter().position(is_direct).map(time_ps);
    let is_open =
        |n: &usize| verdicts[*n][0].path.is_none() && direct_ps.is_none_or(|direct_ps| time_ps(*n) > direct_ps);
    let mut open: Vec<usize> = (0..profile.arrivals.len()).filter(is_open).collect();
    open.sort_by(|&a, &b| time_ps(a).total_cmp(&time_ps(b)));
    open
}
