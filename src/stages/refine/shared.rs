//! Errors that labelled onsets of one profile share.

use crate::geometry::{Matrix, maximum_likelihood};
use crate::tables::Label;

/// Of each label the errors that it shares with others, by their numbers, and what one standard deviation of each adds,
/// ps. Labels of one profile follow one another.
pub fn shares_ps(labels: &[Label]) -> Vec<Vec<(usize, f64)>> {
    let is_one_profile = |a: &Label, b: &Label| {
        (&a.campaign, &a.sensor, a.lit, a.seen, &a.range) == (&b.campaign, &b.sensor, b.lit, b.seen, &b.range)
    };
    let (mut all, mut first) = (Vec::with_capacity(labels.len()), 0);
    for profile in labels.chunk_by(is_one_profile) {
        let of_profile = maximum_likelihood::shares(&Matrix::from_fn(profile.len(), profile.len(), |i, j| {
            if i == j { profile[i].time_sd_ps.powi(2) } else { covariance_ps2(&profile[i], &profile[j]) }
        }));
        let numbered = |errors: Vec<(usize, f64)>| errors.into_iter().map(|(error, ps)| (first + error, ps)).collect();
        all.extend(of_profile.into_iter().map(numbered));
        // No more errors than labels.
        first += profile.len();
    }
    all
}

/// Of the times of two labels of one profile; 0 where their table does not have it.
fn covariance_ps2(a: &Label, b: &Label) -> f64 {
    let with = |of: &Label, rank: i32| {
        let place = usize::try_from(rank - 1).ok();
        place.and_then(|place| of.covariance.get(place)).copied().unwrap_or(0.0)
    };
    0.5 * (with(a, b.rank) + with(b, a.rank))
}
