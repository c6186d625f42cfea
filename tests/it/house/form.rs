//! How the code looks: short functions, lines that fit a page, names that are nouns and verbs.

use std::collections::BTreeSet;

use super::sources::{Source, sources};

/// Most lines of a function, from its name to its last brace.
const FUNCTION_LINES: usize = 70;

/// Functions that are longer, each for a reason: (file, function).
const LONG: [(&str, &str); 4] = [
    // One pass over a profile's ways: what each takes of the arrivals is what the next finds, in seven running values.
    ("src/geometry/hidden/climb.rs", "at"),
    // A scene in the order in which its random numbers are drawn: cut apart, that order would be hidden.
    ("src/geometry/hidden/tests/scene.rs", "draw"),
    // The model field by field; its parts are functions already, and what is left is their order.
    ("src/stages/triangulate/model.rs", "new"),
    // The Fisher matrix by differences, as one derivation that shares no code with the bound that it checks.
    ("tests/it/bound.rs", "by_differences"),
];

/// Most columns of a line with a comment, but for rows of Markdown tables, which cannot be cut; the formatter sees to
/// lines of code.
const COLUMNS: usize = 120;

/// Participles say what happened to a thing, not what it is.
const PARTICIPLES: [&str; 5] = ["found", "known", "told", "written", "asked"];

/// Folders that do not yet name things by nouns. Shrinks, never grows.
const PARTICIPLES_NOT_YET: [&str; 0] = [];

/// Lists what is wrong with files outside of the folders given; asserts that those folders still need to be there.
fn check(not_yet: &[&str], wrong: impl Fn(&Source) -> Vec<String>) {
    let is_listed = |source: &Source| not_yet.iter().any(|folder| source.file.starts_with(folder));
    let wrongs: Vec<String> = sources().iter().filter(|source| !is_listed(source)).flat_map(&wrong).collect();
    assert!(wrongs.is_empty(), "{wrongs:#?}");
    let is_clean = |folder: &&&str| {
        let mut files = sources().iter().filter(|source| source.file.starts_with(**folder));
        files.all(|source| wrong(source).is_empty())
    };
    let clean: Vec<&&str> = not_yet.iter().filter(is_clean).collect();
    assert!(clean.is_empty(), "in order, to be taken off the list: {clean:?}");
}

#[test]
fn functions_fit_a_page() {
    let long = |source: &Source| {
        let functions = source.functions.iter().filter(|(_, lines)| *lines > FUNCTION_LINES);
        let functions = functions.filter(|(name, _)| !LONG.contains(&(source.file.as_str(), name.as_str())));
        functions.map(|(name, lines)| format!("{}: {name} has {lines} lines", source.file)).collect()
    };
    check(&[], long);
    for (file, name) in LONG {
        let source = sources().iter().find(|source| source.file == file);
        let is_long = source.is_some_and(|source| source.functions.iter().any(|f| f.0 == name && f.1 > FUNCTION_LINES));
        assert!(is_long, "{file}: {name} is short: take it off the list");
    }
}

#[test]
fn comments_fit_the_page() {
    let wide = |source: &Source| {
        let lines = source.text.lines().enumerate();
        let is_row = |line: &str| line.trim_start().trim_start_matches(['/', '!']).starts_with(" |");
        let is_comment = |line: &str| line.trim_start().starts_with("//") || line.contains(" // ");
        let comments = lines.filter(|(_, line)| is_comment(line) && !is_row(line));
        let wide = comments.filter(|(_, line)| line.chars().count() > COLUMNS);
        wide.map(|(n, line)| format!("{}:{} has {} columns", source.file, n + 1, line.chars().count())).collect()
    };
    check(&[], wide);
}

#[test]
fn no_name_is_a_participle() {
    let participles = |source: &Source| {
        let module = source.file.trim_end_matches(".rs").rsplit('/').next().map(str::to_owned);
        let names: BTreeSet<String> = source.names.iter().cloned().chain(module).collect();
        let names = names.into_iter().filter(|name| PARTICIPLES.contains(&name.to_lowercase().as_str()));
        names.map(|name| format!("{}: {name}", source.file)).collect()
    };
    check(&PARTICIPLES_NOT_YET, participles);
}
