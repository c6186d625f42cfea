//! The pipeline file: one heading per table. Parsing checks names and parameters; nothing is read or run here.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use thiserror::Error;

use crate::campaign::suggest;
use crate::stages::stage::Beside;
use crate::stages::{self, Node};

/// What is wrong with a pipeline file or with `--set`.
#[derive(Debug, Error)]
pub enum SpecError {
    /// The file cannot be read.
    #[error("cannot read pipeline {}{}", path.display(), neighbours(path))]
    Read {
        /// File.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// Not TOML, or not of this form.
    #[error("{pipeline}: {message}")]
    Syntax {
        /// Pipeline.
        pipeline: String,
        /// What is wrong, and where.
        message: String,
    },
    /// A heading's content is refused.
    #[error("{pipeline}: [{heading}]: {message}")]
    Heading {
        /// Pipeline.
        pipeline: String,
        /// Heading.
        heading: String,
        /// What is wrong, and how to fix it.
        message: String,
    },
}

/// Suggestions for a wrong path: a folder is no pipeline, and another name may be near.
fn neighbours(path: &Path) -> String {
    if path.is_dir() {
        return "; it is a folder, and a pipeline is a file such as pipelines/all-visible.toml".to_owned();
    }
    let folder = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .flatten()
        .filter(|entry| entry.path().extension().is_some_and(|extension| extension == "toml"))
        .filter_map(|entry| entry.file_name().into_string().ok())
        .collect();
    names.sort();
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    suggest::nearest(name, names.iter().map(String::as_str))
        .map_or(String::new(), |near| format!("; did you mean `{}`?", path.with_file_name(near).display()))
}

/// The kind of a file without headings of a pipeline, by the headings that it has.
fn other_kind(table: &toml::Table) -> Option<&'static str> {
    let has = |key: &str| table.get(key).and_then(toml::Value::as_table).is_some_and(|of| !of.contains_key("stage"));
    match (has("instrument"), has("campaign")) {
        (true, _) => Some(
            "this is a scene, for `simulate` and `design`; a pipeline is a file such as pipelines/all-visible.toml",
        ),
        (_, true) => Some(
            "this is a campaign; give its folder with --campaign, and as pipeline a file such as pipelines/all-visible.toml",
        ),
        _ => None,
    }
}

/// One heading as the file gives it.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Heading {
    stage: String,
    from: Option<String>,
    #[serde(default)]
    with: BTreeMap<String, String>,
    #[serde(default)]
    params: toml::Table,
    #[serde(default = "keep_by_default")]
    keep: bool,
}

fn keep_by_default() -> bool {
    true
}

/// One heading, parsed: the stage that makes its table.
pub struct Step {
    /// Heading: the table's name.
    pub heading: String,
    /// The stage with its parameters.
    pub node: Node,
    /// Heading of the streamed input.
    pub from: Option<String>,
    /// Whole tables that it needs: the stage's name for each, and its heading (or `heading.side`).
    pub with: BTreeMap<String, String>,
    /// Whether the table stays on disk.
    pub keep: bool,
}

/// A parsed pipeline. Every input precedes its consumer in the order of the steps.
pub struct Spec {
    /// Steps.
    pub steps: Vec<Step>,
}

impl Spec {
    /// Reads a pipeline file; `settings` are `TABLE.PARAM=VALUE` from the command line.
    ///
    /// # Errors
    /// When the file cannot be read, or anything in it is refused.
    pub fn load(path: &Path, settings: &[String]) -> Result<Self, SpecError> {
        let text = std::fs::read_to_string(path).map_err(|source| SpecError::Read { path: path.to_owned(), source })?;
        Self::parse(&path.display().to_string(), &text, settings)
    }

    /// Parses the text of a pipeline file, called `pipeline` in messages.
    ///
    /// # Errors
    /// When anything in it is refused.
    pub fn parse(pipeline: &str, text: &str, settings: &[String]) -> Result<Self, SpecError> {
        let syntax = |message: String| SpecError::Syntax { pipeline: pipeline.to_owned(), message };
        let mut table: toml::Table =
            text.parse().map_err(|error: toml::de::Error| syntax(error.to_string().trim_end().to_owned()))?;
        if let Some(kind) = other_kind(&table) {
            return Err(syntax(kind.to_owned()));
        }
        for setting in settings {
            apply(&mut table, setting).map_err(|message| syntax(format!("--set {setting}: {message}")))?;
        }
        let mut steps = Vec::new();
        for (name, value) in table {
            let refused =
                |message: String| SpecError::Heading { pipeline: pipeline.to_owned(), heading: name.clone(), message };
            check_name(&name).map_err(refused)?;
            let heading: Heading =
                value.try_into().map_err(|error: toml::de::Error| refused(heading_fault(error.message())))?;
            let node = stages::parse(&heading.stage, heading.params).map_err(refused)?;
            steps.push(Step { heading: name, node, from: heading.from, with: heading.with, keep: heading.keep });
        }
        let spec = Self { steps: in_order(pipeline, steps)? };
        spec.check(pipeline)?;
        Ok(spec)
    }

    /// Position of a heading.
    #[must_use]
    pub fn position(&self, heading: &str) -> Option<usize> {
        self.steps.iter().position(|step| step.heading == heading)
    }

    /// Checks that every input exists, and is the table that the stage needs.
    fn check(&self, pipeline: &str) -> Result<(), SpecError> {
        for step in &self.steps {
            let refused = |message: String| SpecError::Heading {
                pipeline: pipeline.to_owned(),
                heading: step.heading.clone(),
                message,
            };
            match &step.node {
                Node::Source(source) => {
                    if step.from.is_some() || !step.with.is_empty() {
                        return Err(refused(format!(
                            "stage `{}` has no input: remove `from` and `with`",
                            source.kind()
                        )));
                    }
                }
                Node::Operator(operator) => {
                    let kind = operator.kind();
                    let from = step.from.as_deref();
                    let from = from.ok_or_else(|| {
                        refused(format!("stage `{kind}` needs `from = \"...\"`: a table `{}`", operator.input()))
                    })?;
                    self.expect(from, operator.input())
                        .map_err(|message| refused(format!("from = \"{from}\": {message}")))?;
                    for (name, heading) in &step.with {
                        let known: Vec<&str> = operator.beside().iter().map(|beside| beside.name).collect();
                        let Some(beside) = operator.beside().iter().find(|beside| beside.name == name) else {
                            return Err(refused(suggest::unknown("name in `with`", name, &known)));
                        };
                        self.expect(heading, beside.table)
                            .map_err(|message| refused(format!("with {name} = \"{heading}\": {message}")))?;
                    }
                    let given = |beside: &&Beside| step.with.contains_key(beside.name);
                    if let Some(Beside { name, table, .. }) = operator.beside().iter().find(|b| b.required && !given(b))
                    {
                        return Err(refused(format!(
                            "stage `{kind}` needs `with = {{ {name} = \"...\" }}`: a table `{table}`"
                        )));
                    }
                }
            }
        }
        Ok(())
    }

    /// Checks that `heading` or `heading.side` is a table `table`.
    fn expect(&self, heading: &str, table: &str) -> Result<(), String> {
        let (step, found) = self.table(heading).ok_or_else(|| {
            let known: Vec<&str> = self.steps.iter().map(|step| step.heading.as_str()).collect();
            format!("there is no such table in this pipeline; {}", suggest::hint(heading, known))
        })?;
        if found == table {
            Ok(())
        } else {
            Err(format!("`{}` makes a table `{found}`, but a table `{table}` is needed", self.steps[step].heading))
        }
    }

    /// Step and table name behind `heading` or `heading.side`.
    #[must_use]
    pub fn table(&self, heading: &str) -> Option<(usize, String)> {
        let (main, side) = heading.split_once('.').map_or((heading, None), |(main, side)| (main, Some(side)));
        let step = self.position(main)?;
        let tables = self.steps[step].node.tables();
        let table = match side {
            None => tables.into_iter().next(),
            Some(side) => tables.into_iter().skip(1).find(|table| table.name == side),
        };
        table.map(|table| (step, table.name))
    }
}

/// What is wrong with a heading's own keys.
fn heading_fault(message: &str) -> String {
    let explained = suggest::explain(message);
    if explained.contains("; known: ") {
        explained + " (a parameter of the stage stands in `params = { ... }`)"
    } else {
        explained
    }
}

/// Checks a heading's name, since headings become folders in the result folder.
fn check_name(name: &str) -> Result<(), String> {
    let plain = name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-');
    match name {
        "rejects" => Err("`rejects` is the table of what every stage rejected; choose another heading".to_owned()),
        _ if plain && !name.is_empty() => Ok(()),
        _ => Err("a heading becomes a folder: letters, digits, `_` and `-` only".to_owned()),
    }
}

/// Applies `TABLE.PARAM=VALUE`, or `TABLE.keep=VALUE`.
fn apply(table: &mut toml::Table, setting: &str) -> Result<(), String> {
    let form = "write TABLE.PARAM=VALUE";
    let (key, value) = setting.split_once('=').ok_or(form)?;
    let (heading, param) = key.trim().split_once('.').ok_or(form)?;
    let known: Vec<String> = table.keys().cloned().collect();
    let known: Vec<&str> = known.iter().map(String::as_str).collect();
    let step = table
        .get_mut(heading)
        .and_then(toml::Value::as_table_mut)
        .ok_or_else(|| suggest::unknown("table", heading, &known))?;
    // Anything but a number, a boolean, a list or a quoted text counts as text: --set onsets.method=impulses.
    let value = format!("value = {value}")
        .parse::<toml::Table>()
        .ok()
        .and_then(|mut parsed| parsed.remove("value"))
        .unwrap_or_else(|| toml::Value::String(value.trim().to_owned()));
    if param == "keep" {
        step.insert("keep".to_owned(), value);
        return Ok(());
    }
    let params = step.entry("params").or_insert_with(|| toml::Value::Table(toml::Table::new()));
    params.as_table_mut().ok_or("`params` is not a table")?.insert(param.to_owned(), value);
    Ok(())
}

/// Sorts steps so that inputs come first, and otherwise keeps the file's order.
fn in_order(pipeline: &str, mut steps: Vec<Step>) -> Result<Vec<Step>, SpecError> {
    let mut sorted: Vec<Step> = Vec::new();
    while !steps.is_empty() {
        let waits = |step: &Step, steps: &[Step]| {
            let inputs = step.from.iter().chain(step.with.values());
            inputs
                .map(|input| input.split('.').next().unwrap_or(input))
                .find(|input| steps.iter().any(|other| other.heading == *input))
                .map(str::to_owned)
        };
        let Some(next) = (0..steps.len()).find(|&i| waits(&steps[i], &steps).is_none()) else {
            // Every remaining step waits for another remaining one, so following them must lead back to one already
            // visited.
            let mut ring = vec![steps[0].heading.clone()];
            while let Some(next) =
                steps.iter().find(|step| step.heading == ring[ring.len() - 1]).and_then(|step| waits(step, &steps))
            {
                let passed = ring.iter().position(|heading| *heading == next);
                ring.push(next);
                if let Some(first) = passed {
                    ring.drain(..first);
                    break;
                }
            }
            let message = format!("waits for itself: {}; take one `from` or `with` of these out", ring.join(" needs "));
            return Err(SpecError::Heading { pipeline: pipeline.to_owned(), heading: ring.swap_remove(0), message });
        };
        sorted.push(steps.remove(next));
    }
    Ok(sorted)
}
