//! A plot in the page: its data as JSON, drawn by `page.js` when it comes into view.

use maud::{Markup, PreEscaped, html};
use plotly::Plot;
use plotly::common::{Anchor, Orientation};
use plotly::layout::Legend;

/// Patches that laser and sensor see.
pub const VISIBLE: &str = "#256fae";
/// Patches that neither sees.
pub const HIDDEN: &str = "#e2711d";
/// Patches that nothing comes straight back from.
pub const MIRROR: &str = "#8453c8";
/// For what matters less.
pub const PALE: &str = "#8a8f98";
/// Laser and sensors.
pub const STATION: &str = "#c0392b";
/// Paths by their bounces: 0 (unexplained), 1, 2, 3, 4 and more.
pub const BOUNCES: [&str; 5] = [PALE, "#1b9e77", VISIBLE, HIDDEN, "#d6336c"];

/// Colour of an arrival.
pub fn of_bounces(bounces: usize) -> &'static str {
    BOUNCES[bounces.min(BOUNCES.len() - 1)]
}

/// Name of the arrivals of `bounces`.
pub fn bounces_text(bounces: usize) -> &'static str {
    ["no path known", "1st bounce", "2nd bounce", "3rd bounce", "4th bounce and later"][bounces.min(4)]
}

/// A plot of some height with a caption; `alternative` says what it shows to whom cannot see it.
pub fn figure(id: &str, height_px: u32, plot: &Plot, alternative: &str, caption: &Markup) -> Markup {
    html! {
        figure {
            div.plot id=(id) role="img" aria-label=(alternative) style={ "height:" (height_px) "px" } {}
            (data(&format!("{id}-data"), &plot.to_json()))
            figcaption { (caption) }
        }
    }
}

/// A legend above the plot. On a phone it has several lines, which grow away from the plot.
pub fn legend_above() -> Legend {
    Legend::new().orientation(Orientation::Horizontal).y(1.02).y_anchor(Anchor::Bottom)
}

/// JSON for the page's script; texts in it cannot end the element.
pub fn data(id: &str, json: &str) -> Markup {
    html! { script type="application/json" id=(id) { (PreEscaped(without_zeros(json).replace('<', "\\u003c"))) } }
}

/// JSON whose whole numbers have no `.0`, which is a quarter of a page of images.
fn without_zeros(json: &str) -> String {
    let mut short = String::with_capacity(json.len());
    let (mut is_text, mut is_escaped, mut rest) = (false, false, json.chars());
    while let Some(c) = rest.next() {
        is_text ^= c == '"' && !is_escaped;
        is_escaped = is_text && c == '\\' && !is_escaped;
        let after = rest.as_str();
        let is_whole = |after: &str| !after.starts_with(|next: char| next.is_ascii_digit());
        if c == '.' && !is_text && after.strip_prefix('0').is_some_and(is_whole) {
            rest.next();
        } else {
            short.push(c);
        }
    }
    short
}

/// A value with `digits` significant digits, so that its text is short.
pub fn short(value: f64, digits: i32) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    let scale = 10f64.powi(digits - 1 - value.abs().log10().floor() as i32);
    let rounded = (value * scale).round() / scale;
    if rounded.is_finite() { rounded } else { value }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_cut_to_their_digits() {
        assert_eq!(short(123.456, 4), 123.5);
        assert_eq!(short(-0.000_123_456, 2), -0.000_12);
        assert_eq!(short(0.0, 3), 0.0);
        assert!(short(f64::NAN, 3).is_nan());
    }

    #[test]
    fn whole_numbers_are_short_and_texts_stay() {
        let json = r#"{"a \"1.0\\":[0.0,-12.0,1.05,2.0e5,10.10],"b":"3.0"}"#;
        assert_eq!(without_zeros(json), r#"{"a \"1.0\\":[0,-12,1.05,2e5,10.10],"b":"3.0"}"#);
    }

    #[test]
    fn texts_in_data_cannot_end_their_element() {
        let markup = data("x", r#"{"name":"</script><b>"}"#).into_string();
        assert_eq!(markup.matches('<').count(), 2, "{markup}");
    }
}
