//! Tables `distances` and `covariances`: distances between patches and what their errors share.

use crate::table;

table! {
    /// Distance between two patches; patch 0 is source and camera.
    "distances": Distance, DistanceColumns {
        /// Smaller patch number.
        a: i32,
        /// Larger patch number.
        b: i32,
        /// Distance.
        distance_m: f64,
        /// Its standard deviation.
        sd_m: f64,
        /// Bounces of the paths that give it.
        bounces: i32,
        /// Onsets that give it.
        onsets: i32,
    }
}

table! {
    /// Covariance of two distances that share onsets, or the positions of prior patches.
    "covariances": Covariance, CovarianceColumns {
        /// First distance: smaller patch number.
        a1: i32,
        /// First distance: larger patch number.
        b1: i32,
        /// Second distance: smaller patch number.
        a2: i32,
        /// Second distance: larger patch number.
        b2: i32,
        /// Their covariance.
        cov_m2: f64,
    }
}
