//! Table `session`: what changes through a session, and what every shot of it has without light.

use super::cell::{Name, Samples};
use crate::table;

table! {
    /// One sensor (and vertical range): drift of its delay, and the pick-up that comes with the laser's firing.
    "session": Session, SessionColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Vertical range, where captures were taken at several.
        range: Option<Name>,
        /// Fiducial runs that the drift follows from.
        fiducials: i32,
        /// Wall-clock time of the first knot of the drift (ISO 8601, zone of the instrument). Null where drift is not followed.
        drift_from: Option<Name>,
        /// Time between its knots, in seconds.
        drift_step_s: Option<f64>,
        /// Delay beyond the latency at each knot.
        drift_ps: Option<Vec<f64>>,
        /// Standard deviation of each.
        drift_sd_ps: Option<Vec<f64>>,
        /// Time of the first sample of the pick-up. Null where none is known.
        pickup_t0_ps: Option<f64>,
        /// Time between its samples.
        pickup_dt_ps: Option<f64>,
        /// What the laser's firing induces without any light.
        pickup_v: Option<Samples>,
        /// Standard error of each sample of it.
        pickup_se_v: Option<Samples>,
    }
}
