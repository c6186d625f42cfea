//! Units in the heads of columns: `Time (ns)`, `[us]`, `ch1_mv`, `Volt`.

/// A unit, and what makes it of the numbers in the text.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Unit {
    /// Its name without a prefix; `None` for logic levels.
    pub name: Option<String>,
    /// Numbers are multiplied with this ...
    times: f64,
    /// ... and divided by this. One of both is 1: powers of ten divide exactly, but do not multiply so with negative exponents.
    per: f64,
}

/// Prefixes: what multiplies, what divides.
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

/// Words for units, in lower case.
const WORDS: [(&str, &str); 12] = [
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

    /// The unit that a text is, if it is certain.
    pub(super) fn parse(text: &str) -> Option<Self> {
        let lower = text.to_lowercase().replace('μ', "µ");
        if let Some((_, name)) = WORDS.iter().find(|(word, _)| *word == lower) {
            return Some(Self::plain(name));
        }
        if ["dB", "dBm", "dBV"].contains(&text) {
            return Some(Self::plain(text));
        }
        // Letters of times are the same in upper case, but MV is not mV.
        let text = match &lower[..] {
            "s" | "ms" | "us" | "µs" | "ns" | "ps" | "fs" => &lower,
            "v" | "mv" | "uv" | "µv" | "nv" | "kv" if text != "MV" => &lower.replace('v', "V"),
            _ => &text.replace('μ', "µ"),
        };
        let base = ["Hz", "s", "V", "A", "W"].into_iter().find(|base| text.ends_with(base))?;
        let prefix = text.strip_suffix(base)?;
        let (_, times, per) = PREFIXES.into_iter().find(|(known, ..)| *known == prefix)?;
        (text != "MV").then(|| Self { name: Some(base.to_owned()), times, per })
    }

    /// A number of the text in this unit.
    pub(super) fn scale(&self, number: f64) -> f64 {
        number * self.times / self.per
    }

    /// What number of the text this is.
    pub(super) fn unscale(&self, value: f64) -> f64 {
        value * self.per / self.times
    }

    pub(super) fn is(&self, name: &str) -> bool {
        self.name.as_deref() == Some(name)
    }
}

/// Whether a column of this name is one of times.
pub(super) fn is_time(name: &str) -> bool {
    let name = name.to_lowercase();
    name.starts_with("time") || ["t", "s", "sec", "second", "seconds", "x-axis"].contains(&&name[..])
}

/// Name and unit of `Time (ns)`, `Ampl [mV]`, `time_ps`. After an underscore only units of time and voltage are certain: `ch_a` is channel a.
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
