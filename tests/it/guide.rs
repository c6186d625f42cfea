//! The guide against the program: stages with all their parameters and defaults, links that lead somewhere.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use periscope::campaign::Campaign;
use periscope::stages::{self, KINDS, Node};
use serde_json::Value;

fn guide() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/guide")
}

/// Pages of the guide, and the README.
fn pages() -> Vec<PathBuf> {
    let mut pages = vec![Path::new(env!("CARGO_MANIFEST_DIR")).join("README.md")];
    for folder in [guide(), guide().join("stages")] {
        pages.extend(fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()));
    }
    pages.retain(|page| page.extension().is_some_and(|extension| extension == "md"));
    pages.sort();
    pages
}

/// The rows below the heading of the table whose first heading this is, cell by cell.
fn table(page: &str, first: &str) -> Vec<Vec<String>> {
    let rows = page.lines().skip_while(|line| !line.starts_with(&format!("| {first} |"))).skip(2);
    let cells = |line: &str| line.trim_matches('|').split(" | ").map(|cell| cell.trim().to_owned()).collect();
    rows.take_while(|line| line.starts_with('|')).map(cells).collect()
}

/// Values that parameters without a default are given here.
const NEEDED: [(&str, &str, &str); 2] = [("import", "table", "\"onsets\""), ("import", "path", "\"onsets.parquet\"")];

fn value(text: &str) -> toml::Value {
    format!("value = {text}").parse::<toml::Table>().unwrap().remove("value").unwrap()
}

/// A stage with the parameters that it needs, and these.
fn stage(kind: &str, params: &[(&str, toml::Value)]) -> Result<Node, String> {
    let needed = NEEDED.iter().filter(|(of, ..)| *of == kind).map(|(_, name, text)| ((*name).to_owned(), value(text)));
    stages::parse(kind, needed.chain(params.iter().map(|(name, value)| ((*name).to_owned(), value.clone()))).collect())
}

fn params(node: &Node) -> Value {
    node.params().unwrap()
}

/// The range of a parameter that is a number.
fn range(kind: &str, name: &str) -> Option<String> {
    let refused = stage(kind, &[(name, value("\"no number\""))]).err()?;
    let range = refused.split_once(": must be ")?.1.split(" (default").next()?.to_owned();
    ["above", "or more", "number"].iter().any(|word| range.contains(word)).then_some(range)
}

/// What a stage takes and writes, as its page is to have it.
fn facts(node: &Node) -> String {
    let names = |names: Vec<String>| if names.is_empty() { "-".to_owned() } else { names.join(", ") };
    let tables = names(node.tables().iter().map(|table| format!("`{}`", table.name)).collect());
    match node {
        Node::Source(_) => format!("| - | - | {tables} | - |"),
        Node::Operator(operator) => {
            let beside = operator.beside().iter().map(|beside| {
                let of = if beside.name == beside.table { String::new() } else { format!(" (a `{}`)", beside.table) };
                format!("`{}`{of}{}", beside.name, if beside.required { " needed" } else { "" })
            });
            let grain = format!("{:?}", operator.grain()).to_lowercase();
            format!("| `{}` | {} | {tables} | {grain} |", operator.input(), names(beside.collect()))
        }
    }
}

#[test]
fn the_page_of_each_stage_has_its_tables_and_all_its_parameters_with_their_defaults() {
    let mut wrong = Vec::new();
    for kind in KINDS {
        let page = fs::read_to_string(guide().join(format!("stages/{kind}.md"))).unwrap_or_default();
        let default = stage(kind, &[]).unwrap_or_else(|error| panic!("{kind}: {error}"));
        // `import` writes any table, so that its page cannot name one.
        let facts = facts(&default);
        if kind != "import" && !page.contains(&format!("\n{facts}\n")) {
            wrong.push(format!("{kind}.md lacks the line {facts}"));
        }
        let Err(refused) = stage(kind, &[("no parameter has this name", value("1"))]) else {
            panic!("{kind} takes anything")
        };
        let accepted = refused.split_once("known: ").map_or("", |(_, accepted)| accepted);
        let accepted: BTreeSet<&str> = accepted.split(", ").filter(|name| !name.is_empty()).collect();
        let rows = table(&page, "parameter");
        let stated: BTreeMap<&str, &str> =
            rows.iter().map(|row| (row[0].trim_matches('`'), row[1].trim_matches('`'))).collect();
        let names: BTreeSet<&str> = stated.keys().copied().collect();
        if names != accepted {
            wrong.push(format!("{kind}.md has the parameters {names:?}, the stage has {accepted:?}"));
            continue;
        }
        for row in &rows {
            if let Some(range) = range(kind, row[0].trim_matches('`'))
                && range != row[2]
            {
                wrong.push(format!("{kind}.md has the range {} of {}, the stage: {range}", row[2], row[0]));
            }
        }
        for (name, stated) in stated {
            let real = params(&default);
            let is_right = match stated {
                "absent" => real.get(name).is_none_or(Value::is_null),
                "needed" => NEEDED.iter().any(|(of, needed, _)| (*of, *needed) == (kind, name)),
                stated => params(&stage(kind, &[(name, value(stated))]).unwrap()) == real,
            };
            if !is_right {
                wrong.push(format!("{kind}.md says {name} = {stated}, by default it is {}", real[name]));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn the_page_on_files_has_all_keys_of_campaign_toml() {
    let page = fs::read_to_string(guide().join("files.md")).unwrap();
    let headings = [
        "[campaign]",
        "[stations.laser]",
        "[sensors.s1]",
        "[patches.1]",
        "[views.1]",
        "[hidden]",
        "[wall]",
        "[[captures]]",
        "[[exclude]]",
    ];
    for heading in headings {
        let error =
            Campaign::parse(Path::new("."), &format!("{heading}\nno_key_has_this_name = 1\n")).unwrap_err().to_string();
        let accepted = error.split_once("known: ").unwrap_or_else(|| panic!("{error}")).1;
        for key in accepted.split(", ") {
            assert!(page.contains(&format!("`{key}`")), "files.md lacks {key} of {heading}");
        }
    }
}

/// Links of a page: (text, target) of those in place, and those that name a definition.
fn links(page: &str) -> Vec<(String, String)> {
    let without_blocks: String = page.split("```").step_by(2).collect();
    let text: String = without_blocks.split('`').step_by(2).collect();
    let definition = regex_lite::Regex::new(r"(?m)^\[([^\]]+)\]: (\S+)$").unwrap();
    let defined: BTreeMap<String, String> =
        definition.captures_iter(&text).map(|capture| (capture[1].to_lowercase(), capture[2].to_owned())).collect();
    let text = definition.replace_all(&text, "");
    let link = regex_lite::Regex::new(r"\[([^\]]+)\](?:\(([^)\s]+)\))?").unwrap();
    link.captures_iter(&text)
        .map(|capture| {
            let name = capture[1].replace('\n', " ");
            let target = capture.get(2).map(|target| target.as_str().to_owned());
            let target = target.or_else(|| defined.get(&name.to_lowercase()).cloned());
            (name, target.unwrap_or_default())
        })
        .collect()
}

#[test]
fn pages_are_in_the_library_too_and_links_lead_to_files_that_are_there() {
    let mut wrong = Vec::new();
    let module = include_str!("../../src/guide/mod.rs");
    for page in pages() {
        if let Ok(name) = page.strip_prefix(guide())
            && !module.contains(&format!("\"{}\"", name.display()))
        {
            wrong.push(format!("{} is not in src/guide/mod.rs", page.display()));
        }
        for (name, target) in links(&fs::read_to_string(&page).unwrap()) {
            let file = target.split('#').next().unwrap();
            let is_there =
                target.starts_with("https://") || (!file.is_empty() && page.parent().unwrap().join(file).exists());
            if !is_there {
                wrong.push(format!("{}: [{name}] leads to `{target}`", page.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}
