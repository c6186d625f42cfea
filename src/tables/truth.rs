//! Tables of a simulation's ground truth, which no stage writes: paths, centroids, captures.

use super::cell::Name;
use crate::table;

table! {
    /// The signal of one path in one simulated capture.
    "true_paths": TruePath, TruePathColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Patch or view that the laser lit.
        lit: i32,
        /// Patch or view that the sensor saw.
        seen: i32,
        /// Patches in the order in which the light meets them; 0 for objects that are no patch.
        path: Vec<i32>,
        /// Bounces.
        bounces: i32,
        /// Centroid of its time of flight.
        time_ps: f64,
        /// Earliest time of flight.
        earliest_ps: f64,
        /// Standard deviation of the times of flight over the areas of the patches.
        width_ps: f64,
        /// Energy at the detector per laser pulse; null where the signal-to-noise ratio is set.
        energy_j: Option<f64>,
        /// Height of the response if all energy arrived at once; null for photon counters.
        height_v: Option<f64>,
        /// That height over the noise of the average of all shots; for photon counters, expected detections over their
        /// root.
        snr: f64,
        /// Whether its centroid is within the record (modulo the laser's period).
        recorded: bool,
    }
}

table! {
    /// Position of a patch by its directly returned light: the mean over its area, weighted by strength.
    "true_centroids": TrueCentroid, TrueCentroidColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Patch.
        patch: i32,
        /// Position of its centre, x.
        x_m: f64,
        /// Position of its centre, y.
        y_m: f64,
        /// Position of its centre, z.
        z_m: f64,
        /// Path length of the first bounce by way of the centre.
        centre_path_m: f64,
        /// Path length that corresponds to the temporal centroid of the first bounce.
        centroid_path_m: f64,
    }
}

table! {
    /// Properties of one simulated capture.
    "true_captures": TrueCapture, TrueCaptureColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Lit patch or view (0: none).
        lit: i32,
        /// Seen patch or view (0: none).
        seen: i32,
        /// What was captured.
        role: Name,
        /// Vertical range, where the instrument has several.
        range: Option<Name>,
        /// Raw file of the signal.
        file: Name,
        /// Shots (laser pulses, for photon counters).
        shots: i32,
        /// Start of the capture after that of the campaign.
        start_s: f64,
        /// Duration of its shots.
        duration_s: f64,
        /// Optical density in the beam.
        attenuation_od: f64,
        /// Noise of one sample of one shot without light; null for photon counters.
        noise_v: Option<f64>,
        /// Full-scale range of the converter; null for photon counters.
        full_scale_v: Option<f64>,
        /// Height of the whole signal; null for photon counters.
        height_v: Option<f64>,
        /// Standard deviation of the shot noise at that height; null for photon counters.
        shot_noise_v: Option<f64>,
        /// Height over the noise of one shot.
        snr: f64,
        /// Whether the signal-to-noise ratio was set, not derived.
        snr_was_set: bool,
        /// Latency of its signal, drift included.
        latency_ps: f64,
    }
}
