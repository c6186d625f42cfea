//! Text that cannot steer a terminal: names of files, headings and instruments come from others.

use std::borrow::Cow;

/// Whether a character does more to a terminal than stand there: control characters, and those that turn the direction
/// of text or that no one sees.
fn is_active(c: char) -> bool {
    let is_hidden =
        matches!(c, '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{2069}' | '\u{feff}');
    c.is_control() || is_hidden
}

fn escaped(text: &str, is_kept: impl Fn(char) -> bool) -> Cow<'_, str> {
    let is_inert = |c: char| !is_active(c) || is_kept(c);
    if text.chars().all(is_inert) {
        return Cow::Borrowed(text);
    }
    let escape = |c: char| if is_inert(c) { c.to_string() } else { c.escape_unicode().to_string() };
    text.chars().map(escape).collect::<String>().into()
}

/// Lines of text, in which only line ends and tabs remain of the active characters: `\u{1b}` stands for the others.
pub fn lines(text: &str) -> Cow<'_, str> {
    escaped(text, |c| matches!(c, '\n' | '\t'))
}

/// A piece of a line, in which nothing active remains.
pub fn line(text: &str) -> Cow<'_, str> {
    escaped(text, |_| false)
}

/// The same of JSON, with the escapes of JSON: outside of its texts it has no other characters than line ends.
pub fn json(text: &str) -> Cow<'_, str> {
    let is_inert = |c: char| !is_active(c) || c == '\n';
    if text.chars().all(is_inert) {
        return Cow::Borrowed(text);
    }
    let escape = |c: char| if is_inert(c) { c.to_string() } else { format!("\\u{:04x}", c as u32) };
    text.chars().map(escape).collect::<String>().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    const NAME: &str = "a\u{1b}]0;x\u{7}\u{9b}2J\u{202e}cod.trc\nb\tµ";

    #[test]
    fn nothing_active_remains() {
        assert_eq!(lines(NAME), "a\\u{1b}]0;x\\u{7}\\u{9b}2J\\u{202e}cod.trc\nb\tµ");
        assert_eq!(line(NAME), "a\\u{1b}]0;x\\u{7}\\u{9b}2J\\u{202e}cod.trc\\u{a}b\\u{9}µ");
        assert_eq!(line("Messung-µ (1).trc"), "Messung-µ (1).trc");
    }

    #[test]
    fn json_stays_what_it_is() {
        let value = serde_json::json!({ "file": NAME });
        let text = serde_json::to_string_pretty(&value).unwrap();
        let inert = json(&text);
        assert!(inert.chars().all(|c| !is_active(c) || c == '\n'), "{inert}");
        assert_eq!(serde_json::from_str::<serde_json::Value>(&inert).unwrap(), value);
    }
}
