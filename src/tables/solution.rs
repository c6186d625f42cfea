//! Tables `delays`, `stations`, `residuals`, `suspects`, `fits` and `ambiguities`: the further results of a solver.

use super::cell::Name;
use crate::table;

/// Kinds of onsets, in the order of `fits.widened`.
pub const ONSET_KINDS: [&str; 4] = ["first bounces", "second bounces", "later bounces", "onsets read as two"];

table! {
    /// Residual delay of one sensor (at one vertical range) after calibration, as estimated by the solver.
    "delays": Delay, DelayColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Vertical range, where the sensor was calibrated at several.
        range: Option<Name>,
        /// Estimated delay.
        delay_ps: f64,
        /// Its standard deviation.
        sd_ps: f64,
        /// Standard deviation that calibration allows for it.
        prior_sd_ps: f64,
        /// Wall-clock time of the first knot of the drift (ISO 8601, time zone of the instrument): that of the sensor's
        /// first capture. Null where the onsets show no drift.
        drift_from: Option<Name>,
        /// Time of each knot since then, in seconds, ascending.
        drift_knots_s: Option<Vec<f64>>,
        /// What the drift adds to the delay at each knot.
        drift_ps: Option<Vec<f64>>,
        /// Standard deviation of delay and drift together at each knot.
        drift_sd_ps: Option<Vec<f64>>,
    }
}

table! {
    /// Estimated position of a station to which campaign.toml gives a standard deviation; in the frame of `patches`.
    "stations": Station, StationColumns {
        /// Campaign.
        campaign: Name,
        /// Station.
        station: Name,
        /// Position, x.
        x_m: f64,
        /// Position, y.
        y_m: f64,
        /// Position, z.
        z_m: f64,
        /// Root of the sum of the three variances.
        sd_m: f64,
        /// Distance from its position in campaign.toml.
        moved_m: f64,
        /// Standard deviation of each coordinate in campaign.toml.
        prior_sd_m: f64,
    }
}

table! {
    /// Residual of one labelled onset.
    "residuals": Residual, ResidualColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Patch that the laser lit.
        lit: i32,
        /// Patch that the sensor saw.
        seen: i32,
        /// Rank of the onset in its profile.
        rank: i32,
        /// 0 for the onset as a whole, 1 and 2 for the two pulses that it is read as.
        part: i32,
        /// Path of the label.
        path: Vec<i32>,
        /// Measured minus predicted time, corrected for the shift of the footprints and for other light in the onset.
        residual_ps: f64,
        /// Standard deviation of the measured time, with what other light in the onset adds to it where the onset is
        /// wider than its patches make it.
        sd_ps: f64,
        /// Residual in standard deviations of the measured time.
        standardised: f64,
        /// Residual over its own standard deviation, which is smaller than that of the measured time since the solution
        /// follows the onset. Null where no other onset checks it, and in large campaigns, for which the full
        /// covariance is not computed.
        studentised: Option<f64>,
        /// Predicted delay due to the extent of the footprints, relative to the path over the centres of its patches.
        footprint_ps: f64,
        /// Estimated delay due to other light in the onset, which makes it wider than its patches do.
        blend_ps: f64,
        /// Whether the solution uses it; false if it contradicts the others.
        used: bool,
        /// Whether it exceeds four standard deviations: its label is doubtful.
        suspect: bool,
    }
}

table! {
    /// A labelled onset to examine, the worst first: it contradicts the others, has a large residual, or no other onset
    /// checks it.
    "suspects": Suspect, SuspectColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Patch that the laser lit.
        lit: i32,
        /// Patch that the sensor saw.
        seen: i32,
        /// Rank of the onset in its profile.
        rank: i32,
        /// 0 for the onset as a whole, 1 and 2 for the two pulses that it is read as.
        part: i32,
        /// Path of the label.
        path: Vec<i32>,
        /// left-out (the solution does not use it), far-off or unchecked.
        reason: Name,
        /// Measured minus predicted time.
        residual_ps: f64,
        /// Residual over its own standard deviation (over that of the measured time where the former is unknown); null
        /// for an unchecked onset.
        studentised: Option<f64>,
        /// Share of the onset's information that other onsets check (0: none, 1: all); null in large campaigns.
        redundancy: Option<f64>,
    }
}

table! {
    /// One solution as a whole.
    "fits": Fit, FitColumns {
        /// 0 for the best, others as in `patches`.
        alternative: i32,
        /// What fixes the frame of `patches`: canonical (a convention: laser at its station, first patch on +x from
        /// there, the next in the xy plane, the next at z > 0), stations (rotation about their line is a convention),
        /// or fixed.
        frame: Name,
        /// Undetermined rotations of the largest connected group of patches.
        free_rotations: i32,
        /// exact: from the whole Fisher matrix. blocks: of each patch with all others held fixed, plus the errors that
        /// delays and stations share; this is too small where many pairs are missing, and `patch_covariances` is empty.
        covariance: Name,
        /// Labelled onsets.
        onsets: i32,
        /// Estimated parameters: coordinates, delays, stations, period.
        unknowns: i32,
        /// Sum of squared standardised residuals, priors included.
        chi2: f64,
        /// Degrees of freedom.
        degrees_of_freedom: i32,
        /// Factor by which all variances are larger than noise makes them, where the model does not explain the onsets:
        /// chi-square, residuals cut at three standard deviations, over its degrees of freedom and the squared share of
        /// residuals that are not cut; 1 where that chi-square is not beyond its 99.9 % point.
        misfit: f64,
        /// Factors on the variances of first, second and later bounces, and of onsets read as two, where the median
        /// residual of these is larger than chance allows; else 1.
        widened: Vec<f64>,
        /// Largest change of a sensor's delay between two of its captures, where the onsets show that delays drift;
        /// else null.
        drift_ps: Option<f64>,
        /// Longest time between the first and the last capture of a sensor whose delay drifts, in seconds.
        drift_span_s: Option<f64>,
        /// Log-likelihood ratio of the drift against errors of all onsets that are as much larger as residuals make
        /// them.
        drift_log_likelihood: Option<f64>,
        /// Log-likelihood up to a constant; large residuals count linearly.
        log_likelihood: f64,
        /// The laser's period, where onsets spread over several.
        repetition_ps: Option<f64>,
        /// Its standard deviation.
        repetition_sd_ps: Option<f64>,
    }
}

table! {
    /// Something that the onsets do not determine.
    "ambiguities": Ambiguity, AmbiguityColumns {
        /// rotation, mirror, flip, label, part, open, weak or doubtful.
        kind: Name,
        /// Patches concerned; empty: all.
        patches: Vec<i32>,
        /// Number of the other solution in `patches`, if there is one.
        alternative: Option<i32>,
        /// Log-likelihood of the other solution minus that of the best one.
        log_likelihood: Option<f64>,
        /// Possible error of the patches in the weakest direction (largest principal standard deviation), where it is
        /// known.
        sd_m: Option<f64>,
        /// The same in words, and what would resolve it.
        meaning: Name,
    }
}
