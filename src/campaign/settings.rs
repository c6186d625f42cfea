//! The settings of a campaign: campaign.toml and the tables that it names. A seal keeps their text, so that a change is
//! noticed, and named by its key.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use toml::{Table, Value};

use super::keys::{CAMPAIGN_FILE, Campaign};
use super::manifest::{Manifest, ManifestError};
use crate::store::disk as fs;

/// Longest value or line that a message shows, in characters.
const SHOWN: usize = 60;

/// A change of the settings since the campaign was sealed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Change {
    /// The file, relative to the campaign folder.
    pub file: String,
    /// The key, or the line, and what it was and is.
    pub what: String,
}

impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.file, self.what)
    }
}

/// Files of the settings: campaign.toml and its tables, relative to the campaign folder.
#[must_use]
pub fn files(campaign: &Campaign) -> BTreeSet<PathBuf> {
    let tables = campaign.captures.iter().filter_map(|rule| rule.table.clone());
    tables.chain([PathBuf::from(CAMPAIGN_FILE)]).collect()
}

/// Reads the text of the settings, by path.
///
/// # Errors
/// When a file cannot be read, or is no text in UTF-8.
pub fn read(campaign: &Campaign) -> Result<BTreeMap<String, String>, ManifestError> {
    let text = |path: PathBuf| {
        let file = campaign.root.join(&path);
        let text = fs::read_to_string(&file).map_err(|source| ManifestError::File { file, source })?;
        Ok((path.display().to_string(), text))
    };
    files(campaign).into_iter().map(text).collect()
}

/// Compares sealed texts with the files in the campaign folder `root`.
///
/// # Errors
/// When a file exists and cannot be read.
pub fn changes(root: &Path, sealed: &BTreeMap<String, String>) -> Result<Vec<Change>, ManifestError> {
    let mut changes = Vec::new();
    for (path, sealed) in sealed {
        let file = root.join(path);
        let what = match fs::read(&file) {
            Ok(now) if now == sealed.as_bytes() => continue,
            Ok(now) => {
                let now = String::from_utf8_lossy(&now);
                if path == CAMPAIGN_FILE { keys(sealed, &now) } else { vec![line(sealed, &now)] }
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => vec!["is gone".to_owned()],
            Err(source) => return Err(ManifestError::File { file, source }),
        };
        changes.extend(what.into_iter().map(|what| Change { file: path.clone(), what }));
    }
    Ok(changes)
}

/// Holds the settings of a campaign folder to its seal; without a seal, anything goes.
///
/// # Errors
/// When they differ from it, or the seal cannot be read.
pub fn hold(root: &Path) -> Result<(), ManifestError> {
    let Some(sealed) = Manifest::sealed_texts(root)? else {
        return Ok(());
    };
    let changes = changes(root, &sealed)?;
    if changes.is_empty() { Ok(()) } else { Err(refused(root, &changes)) }
}

/// The error of changed settings.
pub(super) fn refused(root: &Path, changes: &[Change]) -> ManifestError {
    ManifestError::Settings { root: root.to_owned(), changes: changes.iter().map(ToString::to_string).collect() }
}

/// Keys of campaign.toml with another value; lines if the values are the same, or one of the texts is not TOML.
fn keys(sealed: &str, now: &str) -> Vec<String> {
    let (Ok(sealed_keys), Ok(now_keys)) = (sealed.parse::<Table>(), now.parse::<Table>()) else {
        return vec![line(sealed, now)];
    };
    let mut changes = Vec::new();
    compare("", &Value::Table(sealed_keys), &Value::Table(now_keys), &mut changes);
    if changes.is_empty() { vec![line(sealed, now)] } else { changes }
}

/// Adds the differences between two values; `place` is the key of both.
fn compare(place: &str, sealed: &Value, now: &Value, changes: &mut Vec<String>) {
    match (sealed, now) {
        (Value::Table(sealed), Value::Table(now)) => {
            for key in sealed.keys().chain(now.keys().filter(|key| !sealed.contains_key(*key))) {
                let place = if place.is_empty() { key.clone() } else { format!("{place}.{key}") };
                match (sealed.get(key), now.get(key)) {
                    (Some(sealed), Some(now)) => compare(&place, sealed, now, changes),
                    (sealed, now) => changes.push(format!("`{place}` was {} and is {}", shown(sealed), shown(now))),
                }
            }
        }
        (Value::Array(sealed), Value::Array(now)) if sealed.len() == now.len() => {
            for (i, (sealed, now)) in sealed.iter().zip(now).enumerate() {
                compare(&format!("{place}[{}]", i + 1), sealed, now, changes);
            }
        }
        // As text, so that signed zeros differ and a number that is none equals itself.
        _ if sealed.to_string() == now.to_string() => {}
        _ => changes.push(format!("`{place}` was {} and is {}", shown(Some(sealed)), shown(Some(now)))),
    }
}

fn shown(value: Option<&Value>) -> String {
    value.map_or("not given".to_owned(), |value| short(&value.to_string()))
}

/// The first line that differs.
fn line(sealed: &str, now: &str) -> String {
    let shown = |line: Option<&str>| line.map_or("not there".to_owned(), |line| format!("`{}`", short(line)));
    let (mut of_sealed, mut of_now) = (sealed.lines(), now.lines());
    for number in 1.. {
        match (of_sealed.next(), of_now.next()) {
            (None, None) => break,
            (was, is) if was != is => return format!("line {number} was {} and is {}", shown(was), shown(is)),
            _ => {}
        }
    }
    "has other line ends".to_owned()
}

/// A text that is cut where it is long.
fn short(text: &str) -> String {
    let mut short: String = text.chars().take(SHOWN).collect();
    if short.len() < text.len() {
        short.push_str("...");
    }
    short
}

#[cfg(test)]
mod tests {
    use super::*;

    const SEALED: &str = "# a day\n[campaign]\nname = 'c'\n[sensors.s1]\nlatency_ps = 0.0\n[[captures]]\nfiles = 'a'\n[[captures]]\nfiles = 'b'\npath_m = [1.0, 2.0]\n";

    #[test]
    fn a_change_is_named_by_its_key() {
        let change = |from: &str, to: &str| {
            assert!(SEALED.contains(from));
            keys(SEALED, &SEALED.replacen(from, to, 1)).join("; ")
        };
        assert_eq!(change("latency_ps = 0.0", "latency_ps = -0.0"), "`sensors.s1.latency_ps` was 0.0 and is -0.0");
        assert_eq!(change("latency_ps = 0.0", "latency_ps = 0"), "`sensors.s1.latency_ps` was 0.0 and is 0");
        assert_eq!(change("2.0]", "nan]"), "`captures[2].path_m[2]` was 2.0 and is nan");
        assert_eq!(change("latency_ps = 0.0\n", ""), "`sensors.s1.latency_ps` was 0.0 and is not given");
        assert_eq!(change("latency_ps", "latency_qs").split("; ").count(), 2);
        assert_eq!(change("name", "naem = 1\nname"), "`campaign.naem` was not given and is 1");
        assert_eq!(change("# a day", "# a dax"), "line 1 was `# a day` and is `# a dax`");
        assert_eq!(change("[campaign]", "[campaign"), "line 2 was `[campaign]` and is `[campaign`");
        assert_eq!(keys(SEALED, &SEALED.replace('\n', "\r\n")), ["has other line ends"]);
    }

    #[test]
    fn a_line_of_a_table_is_named() {
        assert_eq!(line("file,lit\na,1\nb,2\n", "file,lit\na,1\nb,3\n"), "line 3 was `b,2` and is `b,3`");
        assert_eq!(line("file\na\n", "file\n"), "line 2 was `a` and is not there");
    }
}
