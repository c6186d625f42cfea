//! Table `session`: changes of the instrument during a session, and the pick-up in every shot.

use super::cell::{Name, Samples};
use crate::table;

table! {
    /// One sensor (and vertical range): drift of its delay, and the electrical pick-up when the laser fires.
    "session": Session, SessionColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Vertical range, where captures were recorded at several.
        range: Option<Name>,
        /// Fiducial runs that determine the drift.
        fiducials: i32,
        /// Wall-clock time of the first knot of the drift (ISO 8601, time zone of the instrument). Null where drift is
        /// not tracked.
        drift_from: Option<Name>,
        /// Time between its knots, in seconds.
        drift_step_s: Option<f64>,
        /// Delay beyond the latency at each knot.
        drift_ps: Option<Vec<f64>>,
        /// Standard deviation of each.
        drift_sd_ps: Option<Vec<f64>>,
        /// Time of the first sample of the pick-up. Null where it was not measured.
        pickup_t0_ps: Option<f64>,
        /// Time between its samples.
        pickup_dt_ps: Option<f64>,
        /// Voltage that the firing laser induces without any light.
        pickup_v: Option<Samples>,
        /// Standard error of each of its samples.
        pickup_se_v: Option<Samples>,
    }
}
