//! Dates and times as instruments write them in text.

/// Names of the months; instruments write their first three letters.
const MONTHS: [&str; 12] = ["jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"];

/// Converts a date like `12 MAY 2026` or `2026-5-12` and a time like `8:49:9` or `08:49:09:25` (with hundredths) to ISO
/// 8601. Returns `None` for anything else, and for the placeholder that an Infiniium writes without a date.
pub(super) fn acquired_at(date: &str, time: &str) -> Option<String> {
    let date: Vec<&str> = date.split(|c: char| !c.is_ascii_alphanumeric()).filter(|part| !part.is_empty()).collect();
    let month = |name: &str| MONTHS.iter().position(|month| name.to_lowercase().starts_with(month));
    let (year, month, day) = match date[..] {
        [year, month, day] if year.len() == 4 => (number(year)?, number(month)?, number(day)?),
        [day, name, year] if month(name).is_some() => (number(year)?, month(name)? as u32 + 1, number(day)?),
        [name, day, year] => (number(year)?, month(name)? as u32 + 1, number(day)?),
        _ => return None,
    };
    let time: Vec<&str> = time.split([':', '.']).collect();
    let (hour, minute, second, fraction) = match time[..] {
        [hour, minute, second] => (hour, minute, second, None),
        [hour, minute, second, fraction] => (hour, minute, second, Some(fraction)),
        _ => return None,
    };
    let (hour, minute, second) = (number(hour)?, number(minute)?, number(second)?);
    let fraction = match fraction {
        Some(digits) if digits.bytes().all(|digit| digit.is_ascii_digit()) => format!(".{digits}"),
        Some(_) => return None,
        None => String::new(),
    };
    let plausible = (1980..10_000).contains(&year) && (1..=12).contains(&month) && (1..=31).contains(&day);
    let default = (year, month, day, hour, minute, second) == (1996, 12, 27, 1, 0, 0);
    if !plausible || hour > 23 || minute > 59 || second > 60 || default {
        return None;
    }
    Some(format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}{fraction}"))
}

/// A number of digits only.
fn number(digits: &str) -> Option<u32> {
    digits.bytes().all(|digit| digit.is_ascii_digit()).then(|| digits.parse().ok()).flatten()
}

#[cfg(test)]
mod tests {
    use super::acquired_at;

    #[test]
    fn dates_of_several_makers_are_iso() {
        for (date, time, iso) in [
            ("2025-8-26", "8:49:9", Some("2025-08-26T08:49:09")),
            ("2020-11-22", "19:02:34", Some("2020-11-22T19:02:34")),
            ("12 MAY 2026", "13:05:10", Some("2026-05-12T13:05:10")),
            ("MAY 12, 2026", "13:05:10:07", Some("2026-05-12T13:05:10.07")),
            ("2-September-2026", "0:0:0.125", Some("2026-09-02T00:00:00.125")),
            ("27 DEC 1996", "01:00:00:00", None),
            ("5/6/2026", "8:49:9", None),
            ("2025-13-26", "8:49:9", None),
            ("2025-8-26", "24:49:9", None),
            ("2025-8-26", "8:49", None),
            ("2025-8-x6", "8:49:9", None),
            ("2025-8-26", "8:49:9.x", None),
            ("ÄÖÜ", "ÄÖÜ", None),
        ] {
            assert_eq!(acquired_at(date, time).as_deref(), iso, "{date} {time}");
        }
    }
}
