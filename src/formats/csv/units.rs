//! Units in the headers of columns: `Time (ns)`, `[us]`, `ch1_mv`, `Volt`.

/// A unit, and how to convert the numbers in the text to it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Unit {
    /// Its name without a prefix; `None` for logic levels.
    pub name: Option<String>,
    /// Factor of the numbers ...
    times: f64,
    /// ... and their divisor. One of both is 1: dividing by a power of ten is exact, multiplying by its inverse is not.
    per: f64,
}

/// Prefixes: name, factor, divisor.
const PREFIXES: [(&str, f64, f64); 10] = [
    ("", 1.0, 1.0),
    ("f", 1.0, 1e15),
    ("p", 1.0, 1e12),
    ("n", 1.0, 1e9),
    ("u", 1.0, 1e6),
    ("µ", 1.0, 1e6),
    ("m", 1.0, 1e3),
    ("k", 1e3, 1.0),
    ("M", 1e6, 1.0),
    ("G", 1e9, 1.0),
];

/// The unit of photon counts.
pub(super) const COUNTS: &str = "counts";

/// Words for units, in lower case.
const WORDS: [(&str, &str); 20] = [
    ("counts", COUNTS),
    ("count", COUNTS),
    ("cts", COUNTS),
    ("photons", COUNTS),
    ("events", COUNTS),
    ("hits", COUNTS),
    ("voltage", "V"),
    ("v", "V"),
    ("second", "s"),
    ("seconds", "s"),
    ("sec", "s"),
    ("volt", "V"),
    ("volts", "V"),
    ("ampere", "A"),
    ("amperes", "A"),
    ("amp", "A"),
    ("amps", "A"),
    ("watt", "W"),
    ("watts", "W"),
    ("hertz", "Hz"),
];

impl Unit {
    /// This unit without a prefix.
    pub(super) fn plain(name: &str) -> Self {
        Self { name: Some(name.to_owned()), times: 1.0, per: 1.0 }
    }

    /// No unit.
    pub(super) fn none() -> Self {
        Self { name: None, times: 1.0, per: 1.0 }
    }

    /// The unit that the name of a column is, or ends in: `counts`, `Voltage`, `photon counts`.
    pub(super) fn of_name(name: &str) -> Option<Self> {
        let last = name.rsplit([' ', '_']).next()?.to_lowercase();
        if last == "s" {
            return Some(Self::plain("s"));
        }
        WORDS.iter().find(|(word, _)| *word == last).map(|(_, unit)| Self::plain(unit))
    }

    /// Parses a unit; `None` if the text is ambiguous or no unit.
    pub(super) fn parse(text: &str) -> Option<Self> {
        let lower = text.to_lowercase().replace('μ', "µ");
        if let Some((_, name)) = WORDS.iter().find(|(word, _)| *word == lower) {
            return Some(Self::plain(name));
        }
        if ["dB", "dBm", "dBV"].contains(&text) {
            return Some(Self::plain(text));
        }
        // Upper case does not change units of time, but MV is not mV.
        let text = match &lower[..] {
            "s" | "ms" | "us" | "µs" | "ns" | "ps" | "fs" => &lower,
            "v" | "mv" | "uv" | "µv" | "nv" | "kv" if text != "MV" => &lower.replace('v', "V"),
            _ => &text.replace('μ', "µ"),
        };
        let base = ["Hz", "s", "V", "A", "W"].into_iter().find(|base| text.ends_with(base))?;
        let prefix = text.strip_suffix(base)?;
        let (_, times, per) = PREFIXES.into_iter().find(|(name, ..)| *name == prefix)?;
        (text != "MV").then(|| Self { name: Some(base.to_owned()), times, per })
    }

    /// As a heading has it: `mV`.
    pub(super) fn text(&self) -> String {
        let prefix = PREFIXES.iter().find(|(_, times, per)| (*times, *per) == (self.times, self.per));
        let prefix = prefix.map_or("", |(prefix, ..)| prefix);
        format!("{prefix}{}", self.name.as_deref().unwrap_or_default())
    }

    /// Converts a number of the text to this unit.
    pub(super) fn scale(&self, number: f64) -> f64 {
        number * self.times / self.per
    }

    /// Converts a value back to the number in the text.
    pub(super) fn unscale(&self, value: f64) -> f64 {
        value * self.per / self.times
    }

    pub(super) fn is(&self, name: &str) -> bool {
        self.name.as_deref() == Some(name)
    }
}

/// The unit of values that a caller gives.
///
/// # Errors
/// When a heading could not have it: what to give instead.
pub(super) fn of_values(text: &str) -> Result<Unit, String> {
    let unit = Unit::parse(text).filter(|unit| !unit.is("s") && !unit.is("Hz"));
    unit.ok_or_else(|| format!("= {text:?} is no unit of values; write counts, photons, V, mV, uV, A or W"))
}

/// The unit of times that a caller gives.
///
/// # Errors
/// As [`of_values`].
pub(super) fn of_times(text: &str) -> Result<Unit, String> {
    let unit = Unit::parse(text).filter(|unit| unit.is("s"));
    unit.ok_or_else(|| format!("= {text:?} is no unit of times; write s, ms, us, ns, ps or fs"))
}

/// Whether a column of this name holds times.
pub(super) fn is_time(name: &str) -> bool {
    let name = name.to_lowercase();
    name.starts_with("time") || ["t", "s", "sec", "second", "seconds", "x-axis"].contains(&&name[..])
}

/// Splits `Time (ns)`, `Ampl [mV]`, `time_ps` into name and unit. After an underscore, only units of time and voltage
/// are certain: `ch_a` is channel a.
pub(super) fn split(text: &str) -> (&str, Option<&str>) {
    for (open, close) in [('(', ')'), ('[', ']')] {
        if let Some((name, unit)) = text.strip_suffix(close).and_then(|text| text.rsplit_once(open)) {
            return (name.trim(), Some(unit.trim()));
        }
    }
    let certain = |name: &str, text: &str| {
        text == "MV" || Unit::parse(text).is_some_and(|unit| unit.is("V") || unit.is("s") && is_time(name))
    };
    match text.rsplit_once('_') {
        Some((name, unit)) if certain(name, unit) => (name, Some(unit)),
        _ => (text, None),
    }
}
