//! A vertical range of a sensor: what a calibration, a delay and a session belong to.

use crate::tables::{Calibration, Delay, Label, Name, Onset, Profile, Session, Stir};

/// Campaign, sensor and vertical range. A sensor without vertical ranges has the range `None`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct SensorRange {
    /// Campaign.
    pub campaign: Name,
    /// Sensor.
    pub sensor: Name,
    /// Vertical range of the oscilloscope.
    pub range: Option<Name>,
}

/// A row, or a key, that belongs to one vertical range of one sensor.
pub trait OfSensorRange {
    /// Campaign, sensor and vertical range.
    fn ids(&self) -> (&Name, &Name, Option<&Name>);

    /// The same as a key.
    fn sensor_range(&self) -> SensorRange {
        let (campaign, sensor, range) = self.ids();
        SensorRange { campaign: campaign.clone(), sensor: sensor.clone(), range: range.cloned() }
    }
}

macro_rules! of_sensor_range {
    ($($row:ty),*) => {
        $(impl OfSensorRange for $row {
            fn ids(&self) -> (&Name, &Name, Option<&Name>) {
                (&self.campaign, &self.sensor, self.range.as_ref())
            }
        })*
    };
}

of_sensor_range!(SensorRange, Calibration, Delay, Label, Onset, Profile, Session, Stir);

/// The entry for what `of` belongs to: that of its own range, else the only one of its sensor.
///
/// One entry for a sensor holds for all its ranges. Of several, only that of the own range does.
pub fn own_or_only<'a, T: OfSensorRange>(
    entries: impl IntoIterator<Item = &'a T>,
    of: &impl OfSensorRange,
) -> Option<&'a T> {
    let (campaign, sensor, range) = of.ids();
    let (mut only, mut count) = (None, 0);
    for entry in entries {
        let ids = entry.ids();
        if ids == (campaign, sensor, range) {
            return Some(entry);
        }
        if (ids.0, ids.1) == (campaign, sensor) {
            (only, count) = (Some(entry), count + 1);
        }
    }
    only.filter(|_| count == 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(sensor: &str, range: Option<&str>) -> SensorRange {
        SensorRange { campaign: "c".into(), sensor: sensor.into(), range: range.map(Name::from) }
    }

    #[test]
    fn the_own_range_comes_before_the_only_one_and_several_others_are_none() {
        let one = [key("a", None), key("b", Some("fine"))];
        assert_eq!(own_or_only(&one, &key("a", Some("fine"))), Some(&one[0]));
        assert_eq!(own_or_only(&one, &key("b", None)), Some(&one[1]));
        assert_eq!(own_or_only(&one, &key("d", None)), None);
        let several = [key("a", Some("coarse")), key("a", Some("fine")), key("a", None)];
        for own in &several {
            assert_eq!(own_or_only(&several, own), Some(own));
        }
        assert_eq!(own_or_only(&several, &key("a", Some("middle"))), None);
        let elsewhere = SensorRange { campaign: "d".into(), ..key("a", None) };
        assert_eq!(own_or_only(&one, &elsewhere), None);
    }
}
