//! Targets of `explain`: `patch=3`, `distance=3,4`, `onset=s1,3,4,2`, `echo=raw/a.pls,17,1`.

use std::fmt;
use std::str::FromStr;

use crate::campaign::suggest;
use crate::units::PatchId;

const FORMS: &str = "write patch=3, distance=3,4, onset=SENSOR,LIT,SEEN,RANK such as onset=s1,3,4,2, or echo=RUN,PULSE,ECHO \
     such as echo=raw/strip1.pls,17,1";
const KINDS: [&str; 4] = ["patch", "distance", "onset", "echo"];

/// A row, by its key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Target {
    /// A patch.
    Patch(PatchId),
    /// Distance of two patches, the smaller number first.
    Distance(PatchId, PatchId),
    /// An onset.
    Onset {
        /// Campaign, where there are several.
        campaign: Option<String>,
        /// Sensor, where there are several.
        sensor: Option<String>,
        /// Patch that the laser lit.
        lit: PatchId,
        /// Patch that the sensor saw.
        seen: PatchId,
        /// Rank in its profile.
        rank: i32,
    },
    /// An echo of a lidar.
    Echo {
        /// Run of pulses: its raw file.
        run: String,
        /// Pulse of the run.
        pulse: i64,
        /// Number among the echoes of the pulse.
        echo: i32,
    },
}

impl Target {
    /// The table with such rows.
    #[must_use]
    pub fn table(&self) -> &'static str {
        match self {
            Self::Patch(_) => "patches",
            Self::Distance(..) => "distances",
            Self::Onset { .. } => "onsets",
            Self::Echo { .. } => "echoes",
        }
    }
}

impl FromStr for Target {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (what, values) = text.split_once('=').ok_or_else(|| format!("`{text}` names no row; {FORMS}"))?;
        let fields: Vec<&str> = values.split(',').map(str::trim).collect();
        let number = |field: &str| {
            field.parse::<i32>().map_err(|_| format!("`{field}` in `{text}` is not a whole number; {FORMS}"))
        };
        match (what.trim(), fields.as_slice()) {
            ("patch", [patch]) => Ok(Self::Patch(number(patch)?)),
            ("distance", [a, b]) => {
                let (a, b) = (number(a)?, number(b)?);
                Ok(Self::Distance(a.min(b), a.max(b)))
            }
            ("onset", [names @ .., lit, seen, rank]) if names.len() <= 2 => Ok(Self::Onset {
                campaign: (names.len() == 2).then(|| names[0].to_owned()),
                sensor: names.last().map(|sensor| (*sensor).to_owned()),
                lit: number(lit)?,
                seen: number(seen)?,
                rank: number(rank)?,
            }),
            ("echo", [run, pulse, echo]) => {
                Ok(Self::Echo { run: (*run).to_owned(), pulse: i64::from(number(pulse)?), echo: number(echo)? })
            }
            (what, _) if KINDS.contains(&what) => {
                Err(format!("`{text}` has {} values, which is not what names a {what}; {FORMS}", fields.len()))
            }
            (what, _) => Err(format!("{}; {FORMS}", suggest::unknown("kind of row", what, &KINDS))),
        }
    }
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Patch(patch) => write!(f, "patch {patch}"),
            Self::Distance(a, b) => write!(f, "distance of {a} and {b}"),
            Self::Onset { campaign, sensor, lit, seen, rank } => {
                write!(f, "onset {rank} of lit {lit}, seen {seen}")?;
                sensor.iter().try_for_each(|sensor| write!(f, ", sensor {sensor}"))?;
                campaign.iter().try_for_each(|campaign| write!(f, ", campaign {campaign}"))
            }
            Self::Echo { run, pulse, echo } => write!(f, "echo {echo} of pulse {pulse} of {run}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_by_what_names_them() {
        assert_eq!("patch=3".parse(), Ok(Target::Patch(3)));
        assert_eq!("distance=4,3".parse(), Ok(Target::Distance(3, 4)));
        let onset = |text: &str| match text.parse() {
            Ok(Target::Onset { campaign, sensor, lit, seen, rank }) => (campaign, sensor, [lit, seen, rank]),
            other => panic!("{other:?}"),
        };
        let echo = Target::Echo { run: "raw/a.pls".to_owned(), pulse: 17, echo: 1 };
        assert_eq!("echo=raw/a.pls,17,1".parse(), Ok(echo));
        assert_eq!(onset("onset=3,4,2"), (None, None, [3, 4, 2]));
        assert_eq!(onset("onset=s1, 3,4,2"), (None, Some("s1".to_owned()), [3, 4, 2]));
        assert_eq!(onset("onset=day2,s1,3,4,2"), (Some("day2".to_owned()), Some("s1".to_owned()), [3, 4, 2]));
    }

    #[test]
    fn what_is_malformed_is_reported_with_the_fix() {
        for (text, told) in [
            ("3", "write patch=3"),
            ("pach=3", "did you mean `patch`?"),
            ("patch=three", "`three` in `patch=three` is not a whole number"),
            ("distance=3", "1 values"),
            ("onset=1,2", "onset=s1,3,4,2"),
            ("echo=17", "echo=raw/strip1.pls,17,1"),
        ] {
            let error = text.parse::<Target>().unwrap_err();
            assert!(error.contains(told), "{error}");
        }
    }
}
