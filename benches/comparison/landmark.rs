//! Landmark scaling: coordinates of many points from their distances to a few.
//!
//! Classical scaling of the landmarks alone, then every point by `z = -L# (delta - mean delta) / 2`. `delta` are its
//! squared distances to the landmarks. The rows of L# are the landmarks' eigenvectors over the roots of their
//! eigenvalues. O(L^3 + M L). Source: de Silva and Tenenbaum, Sparse multidimensional scaling using landmark points
//! (2004); it is a Nystrom approximation (Platt, AISTATS 2005). All other distances go unused, so its error does not
//! fall with M: it serves as a start.

use faer::Mat;

use crate::{Point, dense};

/// Landmarks among points 0..count, point 0 first, each as far as can be from those before it.
///
/// # Panics
/// When there are fewer points than landmarks, or none are asked for.
#[must_use]
pub fn spread(count: usize, landmarks: usize, distance_m: impl Fn(usize, usize) -> f64) -> Vec<usize> {
    assert!(0 < landmarks && landmarks <= count, "{landmarks} landmarks of {count} points");
    let mut chosen = vec![0];
    let mut nearest_m = vec![f64::INFINITY; count];
    nearest_m[0] = f64::NEG_INFINITY;
    while chosen.len() < landmarks {
        let last = chosen[chosen.len() - 1];
        let unchosen = (0..count).filter(|&i| nearest_m[i] > f64::NEG_INFINITY).collect::<Vec<_>>();
        unchosen.iter().for_each(|&i| nearest_m[i] = nearest_m[i].min(distance_m(last, i)).max(0.0));
        // Of equals the first.
        let next = unchosen.into_iter().reduce(|best, i| if nearest_m[i] > nearest_m[best] { i } else { best });
        let next = next.expect("there are more points than landmarks");
        nearest_m[next] = f64::NEG_INFINITY;
        chosen.push(next);
    }
    chosen
}

/// Points 1..count, point 0 at the origin, from `distance_m(landmark, point)`; the frame is arbitrary.
///
/// # Panics
/// When `dimensions` is neither 2 nor 3 or there are no more landmarks than dimensions.
#[must_use]
pub fn embed(
    count: usize,
    landmarks: &[usize],
    distance_m: impl Fn(usize, usize) -> f64,
    dimensions: usize,
) -> Vec<Point> {
    assert!(dimensions == 2 || dimensions == 3, "space has 2 or 3 dimensions");
    assert!(landmarks.len() > dimensions, "{} landmarks in {dimensions} dimensions", landmarks.len());
    let size = landmarks.len();
    let square = |landmark: usize, point: usize| distance_m(landmark, point).powi(2);
    let squares = Mat::from_fn(size, size, |i, j| {
        let (a, b) = (landmarks[i], landmarks[j]);
        if i == j { 0.0 } else { 0.5 * (square(a, b) + square(b, a)) }
    });
    let mean: Vec<f64> = (0..size).map(|i| (0..size).map(|j| squares[(i, j)]).sum::<f64>() / size as f64).collect();
    let all = mean.iter().sum::<f64>() / size as f64;
    let gram = Mat::from_fn(size, size, |i, j| -0.5 * (squares[(i, j)] - mean[i] - mean[j] + all));
    let (values, vectors) = dense::symmetric_eigen(&gram);
    let place = |point: usize| {
        let mut z = Point::origin();
        for k in 0..dimensions {
            let column = size - 1 - k;
            if values[column] > 0.0 {
                let projected = |i: usize| vectors[(i, column)] * (square(landmarks[i], point) - mean[i]);
                z[k] = -0.5 * (0..size).map(projected).sum::<f64>() / values[column].sqrt();
            }
        }
        z
    };
    let centre = place(0);
    (1..count).map(|point| place(point) - centre.coords).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::room;
    use periscope_geometry::{classical, procrustes};

    #[test]
    fn exact_distances_to_eight_landmarks_give_all_points_back() {
        let truth = room::rectangles();
        let all: Vec<Point> = std::iter::once(Point::origin()).chain(truth.iter().copied()).collect();
        let distance = |i: usize, j: usize| (all[i] - all[j]).norm();
        let landmarks = spread(all.len(), 8, distance);
        assert_eq!(landmarks[0], 0);
        let closest = landmarks.iter().enumerate().flat_map(|(n, &a)| landmarks[..n].iter().map(move |&b| (a, b)));
        assert!(closest.map(|(a, b)| distance(a, b)).fold(f64::INFINITY, f64::min) > 0.8, "{landmarks:?}");
        let solution = embed(all.len(), &landmarks, distance, 3);
        assert!(procrustes::rotation(&solution, &truth, Point::origin(), true).rms_m < 1e-9);
    }

    #[test]
    fn with_all_points_as_landmarks_it_is_classical_scaling() {
        let truth = room::rectangles();
        let all: Vec<Point> = std::iter::once(Point::origin()).chain(truth.iter().copied()).collect();
        let wrong = |i: usize, j: usize| (all[i] - all[j]).norm() + 0.01 * ((i * j % 5) as f64 - 2.0);
        let distances = Mat::from_fn(all.len(), all.len(), |i, j| if i == j { 0.0 } else { wrong(i, j) });
        let classical = classical::embed(&distances, 3);
        let landmarks: Vec<usize> = (0..all.len()).collect();
        let solution = embed(all.len(), &landmarks, |i, j| distances[(i, j)], 3);
        assert!(procrustes::rotation(&solution, &classical, Point::origin(), true).rms_m < 1e-9);
    }
}
