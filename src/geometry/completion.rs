//! Missing distances, by shortest paths: an upper bound of each, good enough to start a fit from.
//!
//! Source: Floyd-Warshall, as in Isomap (Tenenbaum et al., Science 290, 2319 (2000)).

use faer::Mat;
use periscope_cancel::Cancel;

use crate::Error;

/// Completes a symmetric distance matrix over p0 and all patches: an entry that was not measured (`None`) becomes the
/// length of the shortest path over measured ones.
///
/// # Errors
/// [`Error::Unconnected`] with the points that no path joins to point 0.
///
/// # Panics
/// When `distance_m(i, j)` is negative.
pub fn complete(
    count: usize,
    distance_m: impl Fn(usize, usize) -> Option<f64>,
    cancel: &Cancel,
) -> Result<Mat<f64>, Error> {
    let mut lengths =
        Mat::from_fn(count, count, |i, j| if i == j { 0.0 } else { distance_m(i, j).unwrap_or(f64::INFINITY) });
    for via in 0..count {
        cancel.check();
        for i in 0..count {
            for j in 0..count {
                // Only what is missing is filled: a measured distance stays, though a detour may be shorter by noise.
                if i != j && distance_m(i, j).is_none() && lengths[(i, via)] + lengths[(via, j)] < lengths[(i, j)] {
                    lengths[(i, j)] = lengths[(i, via)] + lengths[(via, j)];
                }
            }
        }
    }
    let lost: Vec<usize> = (0..count).filter(|&i| lengths[(0, i)].is_infinite()).collect();
    if lost.is_empty() { Ok(lengths) } else { Err(Error::Unconnected(lost)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_distances_are_shortest_paths_and_lost_points_are_named() {
        let measured = |i: usize, j: usize| match (i.min(j), i.max(j)) {
            (0, 1) => Some(1.0),
            (1, 2) => Some(2.0),
            (0, 3) => Some(1.5),
            (2, 3) => Some(0.4),
            _ => None,
        };
        let complete = complete(4, measured, &Cancel::never()).unwrap();
        assert_eq!((complete[(0, 2)], complete[(1, 3)], complete[(0, 1)]), (1.9, 2.4, 1.0));
        assert_eq!(
            super::complete(3, |i, j| (i + j == 1).then_some(1.0), &Cancel::never()),
            Err(Error::Unconnected(vec![2]))
        );
    }
}
