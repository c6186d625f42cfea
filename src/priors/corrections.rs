//! What a session says of one profile: drift of its delay, and pick-up.

use super::acquisition_time;
use super::sensor_range::{OfSensorRange, SensorRange};
use crate::tables::{Profile, Session};

/// Places of profile and pick-up agree to this part of a sample.
const OFF_GRID: f64 = 1e-3;

/// Drift at the time of a profile, and the pick-up in it.
#[derive(Debug, Default)]
pub struct Correction<'a> {
    /// Drift of the delay, ps.
    pub drift_ps: f64,
    /// Its standard deviation, ps.
    pub drift_sd_ps: f64,
    pickup: Option<&'a Session>,
}

impl<'a> Correction<'a> {
    /// For a profile of the sensor and range `key`; none where the session says nothing.
    ///
    /// # Errors
    /// When the sensor drifts and the profile has no acquisition time; the text names the fix.
    pub fn of(sessions: &'a [Session], key: &SensorRange, profile: &Profile) -> Result<Self, String> {
        let Some(row) = sessions.iter().find(|row| row.ids() == key.ids()) else {
            return Ok(Self::default());
        };
        let pickup = row.pickup_v.is_some().then_some(row);
        let Some(((from, step_s), (drift_ps, sd_ps))) =
            row.drift_from.as_ref().zip(row.drift_step_s).zip(row.drift_ps.as_ref().zip(row.drift_sd_ps.as_ref()))
        else {
            return Ok(Self { pickup, ..Self::default() });
        };
        let time_s = profile.acquired_at.as_deref().and_then(acquisition_time::seconds);
        let Some((time_s, from_s)) = time_s.zip(acquisition_time::seconds(from)) else {
            return Err(
                "does not say when it was taken, but its sensor drifts; leave `session` out of the stage's `with`"
                    .to_owned(),
            );
        };
        let (drift_ps, drift_sd_ps) = at(drift_ps, sd_ps, (time_s - from_s) / step_s);
        Ok(Self { drift_ps, drift_sd_ps, pickup })
    }

    /// Takes the pick-up off the samples of a profile and adds its variance to theirs; of a circular profile around
    /// its end.
    ///
    /// # Errors
    /// When the pick-up has other sample times than the profile; the text names the fix.
    pub fn take_pickup_off(
        &self,
        profile: &Profile,
        period_ps: Option<f64>,
        samples: &mut [f64],
        sd_v: &mut [f64],
    ) -> Result<(), String> {
        let Some(Session {
            pickup_t0_ps: Some(t0_ps),
            pickup_dt_ps: Some(dt_ps),
            pickup_v: Some(values),
            pickup_se_v: Some(errors),
            ..
        }) = self.pickup
        else {
            return Ok(());
        };
        let offset = (profile.t0_ps - t0_ps) / profile.dt_ps;
        if (profile.dt_ps - dt_ps).abs() > OFF_GRID * dt_ps / samples.len() as f64
            || (offset - offset.round()).abs() > OFF_GRID
        {
            return Err("has other sample times than the blocked captures, whose pick-up cannot be taken off; capture them alike, or leave `session` out of the stage's `with`".to_owned());
        }
        let (offset, count) = (offset.round() as i64, values.len() as i64);
        let is_circular = period_ps.is_some_and(|period_ps| (count as f64 * dt_ps / period_ps - 1.0).abs() < 1e-9);
        for (n, (sample, sd_v)) in samples.iter_mut().zip(sd_v).enumerate() {
            let place = n as i64 + offset;
            let place = if is_circular { place.rem_euclid(count) } else { place };
            // Where blocked captures have no sample, nothing is known and nothing taken off.
            if let Some(place) = usize::try_from(place).ok().filter(|place| *place < values.len()) {
                *sample -= f64::from(values[place]);
                *sd_v = sd_v.hypot(f64::from(errors[place]));
            }
        }
        Ok(())
    }
}

/// Drift and its standard deviation `position` knots after the first. Beyond the knots the line goes on, and its error
/// is as large as its change.
pub(super) fn at(drift_ps: &[f64], sd_ps: &[f64], position: f64) -> (f64, f64) {
    let last = drift_ps.len() - 1;
    let knot = (position.max(0.0) as usize).min(last.saturating_sub(1));
    let next = (knot + 1).min(last);
    let part = position - knot as f64;
    let line = |values: &[f64], part: f64| values[knot] + part * (values[next] - values[knot]);
    let inside = part.clamp(0.0, 1.0);
    let beyond_ps = line(drift_ps, part) - line(drift_ps, inside);
    (line(drift_ps, part), line(sd_ps, inside).hypot(beyond_ps))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drift_is_a_line_between_knots_and_uncertain_beyond() {
        let (drift_ps, sd_ps) = ([0.0, 2.0, 2.0, 5.0], [0.1, 0.2, 0.2, 0.3]);
        let (half_ps, sd) = at(&drift_ps, &sd_ps, 0.5);
        assert!((half_ps - 1.0).abs() < 1e-12 && (sd - 0.15).abs() < 1e-12);
        assert_eq!(at(&drift_ps, &sd_ps, 2.0), (2.0, 0.2));
        let (ahead_ps, sd) = at(&drift_ps, &sd_ps, 4.0);
        assert!((ahead_ps - 8.0).abs() < 1e-12 && (sd - 3.0_f64.hypot(0.3)).abs() < 1e-12);
        let (before_ps, sd) = at(&drift_ps, &sd_ps, -1.0);
        assert!((before_ps + 2.0).abs() < 1e-12 && (sd - 2.0_f64.hypot(0.1)).abs() < 1e-12);
        assert_eq!(at(&[1.5], &[0.5], 7.0), (1.5, 0.5));
    }
}
