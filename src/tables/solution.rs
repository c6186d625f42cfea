//! Tables `delays`, `stations`, `residuals`, `suspects`, `fits` and `ambiguities`: what a solver found beside the patches.

use super::cell::Name;
use crate::table;

table! {
    /// Delay of one sensor (at one vertical range) that is left after calibration, as the solver found it.
    "delays": Delay, DelayColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Vertical range, where the sensor was calibrated at several.
        range: Option<Name>,
        /// Delay found.
        delay_ps: f64,
        /// Its standard deviation.
        sd_ps: f64,
        /// Standard deviation that calibration allowed it.
        prior_sd_ps: f64,
    }
}

table! {
    /// Position of one station that campaign.toml gives with a standard deviation, as the solver found it; in the frame of `patches`.
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
        /// Distance from where campaign.toml has it.
        moved_m: f64,
        /// Standard deviation of each coordinate that campaign.toml gives.
        prior_sd_m: f64,
    }
}

table! {
    /// What one labelled onset has left over after the solution.
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
        /// Path of the label.
        path: Vec<i32>,
        /// Measured minus predicted time, the footprints' shift taken off.
        residual_ps: f64,
        /// Standard deviation of the measured time.
        sd_ps: f64,
        /// Residual in standard deviations of the measured time.
        standardised: f64,
        /// Residual in its own standard deviations, which are smaller as the solution follows the onset; null where no other onset checks it, and in large
        /// campaigns, whose full covariance is not computed.
        studentised: Option<f64>,
        /// What the light of the path arrives later than over the centres of its patches, as predicted from their footprints.
        footprint_ps: f64,
        /// Whether the solution rests on it; not if it contradicts the others.
        used: bool,
        /// Beyond four standard deviations: a label to doubt.
        suspect: bool,
    }
}

table! {
    /// A labelled onset to look at, the worst first: it contradicts the others, lies far off, or nothing checks it.
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
        /// Path of the label.
        path: Vec<i32>,
        /// left-out (the solution does not rest on it), far-off or unchecked.
        reason: Name,
        /// Measured minus predicted time.
        residual_ps: f64,
        /// Residual in its own standard deviations (in those of the measured time where that is not known); null for an unchecked onset.
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
        /// What fixes the frame of `patches`: canonical (a convention: laser at its station, first patch on +x from there, the next in the xy plane, the next at
        /// z > 0), stations (turned about their line by convention), or fixed.
        frame: Name,
        /// Rotations that nothing determines, of the largest part.
        free_rotations: i32,
        /// exact: of the whole Fisher matrix; blocks: of each patch with all others held, plus what delays and stations share, which is too small where many pairs
        /// are missing, and `patch_covariances` is empty.
        covariance: Name,
        /// Labelled onsets.
        onsets: i32,
        /// Coordinates, delays, stations, period.
        unknowns: i32,
        /// Sum of squared standardised residuals, priors included.
        chi2: f64,
        /// Degrees of freedom.
        degrees_of_freedom: i32,
        /// Log-likelihood, large residuals counted linearly, up to a constant.
        log_likelihood: f64,
        /// The laser's period, where onsets lie in several.
        repetition_ps: Option<f64>,
        /// Its standard deviation.
        repetition_sd_ps: Option<f64>,
    }
}

table! {
    /// Something that the onsets leave undetermined.
    "ambiguities": Ambiguity, AmbiguityColumns {
        /// rotation, mirror, flip, part, open or weak.
        kind: Name,
        /// Patches that it concerns; empty: all.
        patches: Vec<i32>,
        /// The other solution, where it is one, as in `patches`.
        alternative: Option<i32>,
        /// Log-likelihood of that less the best one's.
        log_likelihood: Option<f64>,
        /// How far the patches may be off in the weakest direction (largest principal standard deviation), where that is known.
        sd_m: Option<f64>,
        /// The same in words, and what would decide it.
        meaning: Name,
    }
}
