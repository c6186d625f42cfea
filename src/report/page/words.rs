//! Numbers in words, and words of tables.

use maud::{Markup, html};

pub use crate::campaign::count;

/// A value with `digits` significant digits, without trailing zeros after the point; powers of ten where it is very
/// large or small.
pub fn sig(value: f64, digits: usize) -> String {
    if value == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    let power = value.abs().log10().floor() as i32;
    if !(-4..=6).contains(&power) {
        return format!("{value:.*e}", digits - 1);
    }
    let decimals = (digits as i32 - 1 - power).max(0) as usize;
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// A coordinate in metres, to a hundredth of a millimetre.
pub fn metres(value_m: f64) -> String {
    let text = format!("{value_m:.5}");
    if text.trim_start_matches(['-', '0', '.']).is_empty() { "0.00000".to_owned() } else { text }
}

/// A small length.
pub fn millimetres(value_m: f64) -> String {
    format!("{} mm", sig(1e3 * value_m, 3))
}

/// Bytes.
pub fn bytes(number: u64) -> String {
    let (mut value, mut unit) = (number as f64, "B");
    for larger in ["kB", "MB", "GB", "TB"] {
        if value >= 1000.0 {
            (value, unit) = (value / 1000.0, larger);
        }
    }
    format!("{} {unit}", sig(value, 3))
}

/// A duration.
pub fn seconds(value_s: f64) -> String {
    if value_s < 60.0 {
        return format!("{} s", sig(value_s, 3));
    }
    let whole = value_s.round() as u64;
    if whole < 3600 {
        format!("{} min {} s", whole / 60, whole % 60)
    } else {
        format!("{} h {} min", whole / 3600, whole % 3600 / 60)
    }
}

/// Words of a table, with what stands between backticks as code.
pub fn marked(text: &str) -> Markup {
    html! {
        @for (n, part) in text.split('`').enumerate() {
            @if n % 2 == 1 { code { (part) } } @else { (part) }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_between_backticks_are_code() {
        assert_eq!(marked("`a<b>` in c").into_string(), "<code>a&lt;b&gt;</code> in c");
    }

    #[test]
    fn numbers_read_well() {
        assert_eq!(sig(0.012_345, 3), "0.0123");
        assert_eq!(sig(1234.5, 3), "1234");
        assert_eq!(sig(50.0, 3), "50");
        assert_eq!(sig(1.5e-9, 3), "1.50e-9");
        assert_eq!(millimetres(0.000_081), "0.081 mm");
        assert_eq!(bytes(1_537_748), "1.54 MB");
        assert_eq!((metres(-1e-9), metres(-0.1)), ("0.00000".to_owned(), "-0.10000".to_owned()));
        assert_eq!(seconds(0.25), "0.25 s");
        assert_eq!(seconds(3725.0), "1 h 2 min");
        assert_eq!(count(1, "patch", "patches"), "1 patch");
    }
}
