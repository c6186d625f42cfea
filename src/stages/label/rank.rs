//! The paper's labelling of third bounces by order of arrival (section 4.3), to compare with.
//!
//! In each profile, onsets that no path over visible patches explains are hidden patches in the order of their times. That is right only where every visible patch has
//! the hidden ones in the same order of distance, no third bounce is missing or false, and none comes after a fourth.

use super::{OfSensor, Verdict, Verdicts};
use crate::tables::Onset;

/// Labels the onsets of one sensor that are left open, in place: as many hidden patches as campaign.toml counts, or as most profiles have onsets left.
pub(super) fn label(sensor: &OfSensor, verdicts: &mut Verdicts) {
    let mut open: Vec<Vec<usize>> =
        sensor.profiles.iter().zip(&*verdicts).map(|(profile, verdicts)| left_open(profile, verdicts)).collect();
    let mut counts: Vec<usize> = open.iter().map(Vec::len).collect();
    counts.sort_unstable();
    let count = sensor.setup.hidden_count.map_or_else(|| counts[counts.len() / 2], |count| count as usize);
    for ((profile, verdicts), open) in sensor.profiles.iter().zip(verdicts).zip(&mut open) {
        let (lit, seen) = (profile[0].lit, profile[0].seen);
        open.sort_by(|&a, &b| profile[a].time_ps.total_cmp(&profile[b].time_ps));
        for (patch, &onset) in (sensor.setup.largest_patch + 1..).zip(open.iter().take(count)) {
            let path = Some(vec![lit, patch, seen]);
            verdicts[onset] = vec![Verdict { path, probability: super::light(&profile[onset]), ..Verdict::open() }];
        }
    }
}

/// Onsets after the direct light that have no label.
fn left_open(profile: &[Onset], verdicts: &[Vec<Verdict>]) -> Vec<usize> {
    let is_direct = |verdicts: &Vec<Verdict>| verdicts[0].path.as_ref().is_some_and(|path| path.len() <= 2);
    let direct_ps =
        profile.iter().zip(verdicts).find(|(_, verdicts)| is_direct(verdicts)).map(|(onset, _)| onset.time_ps);
    let is_open =
        |&n: &usize| verdicts[n][0].path.is_none() && direct_ps.is_none_or(|direct_ps| profile[n].time_ps > direct_ps);
    (0..profile.len()).filter(is_open).collect()
}
