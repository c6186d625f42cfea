//! Moments of acquisition, as files write them.

/// Seconds from the year 0 to a moment in ISO 8601 (`2009-03-27T14:05:09.25`, zone left out); `None` when it is none.
pub fn seconds(text: &str) -> Option<f64> {
    let (date, time) = text.trim().split_once(['T', ' '])?;
    let mut date = date.split('-').map(str::parse::<i64>);
    let (year, month, day) = (date.next()?.ok()?, date.next()?.ok()?, date.next()?.ok()?);
    let time = time.trim_end_matches('Z');
    // A zone, if there is one, is the instrument's own and the same for all its files.
    let time = time.split(['+', '-']).next()?;
    let mut time = time.split(':').map(str::parse::<f64>);
    let (hour, minute) = (time.next()?.ok()?, time.next()?.ok()?);
    let second = time.next().unwrap_or(Ok(0.0)).ok()?;
    Some(days(year, month, day) as f64 * 86400.0 + 3600.0 * hour + 60.0 * minute + second)
}

/// Days since 1 March of the year 0 in the Gregorian calendar, counted in years that begin in March.
fn days(year: i64, month: i64, day: i64) -> i64 {
    let year = if month <= 2 { year - 1 } else { year };
    let months = (month + 9) % 12;
    year * 365 + year.div_euclid(4) - year.div_euclid(100) + year.div_euclid(400) + (153 * months + 2) / 5 + day - 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_those_of_a_clock_and_a_calendar() {
        let between = |a: &str, b: &str| (seconds(b).unwrap() - seconds(a).unwrap()) / 3600.0;
        assert!((between("2009-03-27T14:05:09.25", "2009-03-27T15:05:09.25") - 1.0).abs() < 1e-6);
        assert!((between("2008-02-28T23:30:00", "2008-03-01T00:30:00") - 25.0).abs() < 1e-6);
        assert!((between("2009-12-31 23:00:00Z", "2010-01-01 01:00") - 2.0).abs() < 1e-6);
        assert_eq!(seconds("yesterday"), None);
        assert_eq!(seconds("2009-03T14:05"), None);
    }
}
