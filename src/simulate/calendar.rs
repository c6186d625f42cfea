//! Acquisition times of simulated files.

use crate::formats::lecroy_trc::Acquired;

/// Lengths of the months of a common year.
const MONTHS: [u32; 12] = [31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];

/// The date `seconds` after midnight of 1 January 2026 (in a calendar without leap years).
pub fn acquired(seconds: f64) -> Acquired {
    let mut day = (seconds / 86_400.0).floor() as u32;
    let of_day = seconds - f64::from(day) * 86_400.0;
    let year = 2026 + day / 365;
    day %= 365;
    let mut month = 0;
    while day >= MONTHS[month] {
        day -= MONTHS[month];
        month += 1;
    }
    let minutes = (of_day / 60.0).floor();
    Acquired {
        year: year as i16,
        month: month as u8 + 1,
        day: day as u8 + 1,
        hour: (minutes / 60.0) as u8,
        minute: (minutes % 60.0) as u8,
        second: (of_day - 60.0 * minutes).clamp(0.0, 59.999_999_999),
    }
}

/// The same in seconds since 1970: whole seconds, and fraction.
pub fn unix(seconds: f64) -> (i64, f64) {
    /// Midnight of 1 January 2026.
    const START: i64 = 1_767_225_600;
    (START + seconds.floor() as i64, seconds - seconds.floor())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_roll_over_months_and_years() {
        let at = |seconds: f64| {
            let at = acquired(seconds);
            (at.year, at.month, at.day, at.hour, at.minute, at.second)
        };
        assert_eq!(at(0.0), (2026, 1, 1, 0, 0, 0.0));
        assert_eq!(at(3661.5), (2026, 1, 1, 1, 1, 1.5));
        assert_eq!(at(86_400.0 * 59.0), (2026, 3, 1, 0, 0, 0.0));
        assert_eq!(at(86_400.0 * 365.0 - 60.0), (2026, 12, 31, 23, 59, 0.0));
    }
}
