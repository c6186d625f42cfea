//! A pipeline as its files define it: the headings of its base, with what the file itself adds, changes and drops.
//!
//! `base = "NAME"` at the head of a file names another pipeline; `without = ["heading"]` drops headings of it. Keys
//! that a file gives under a heading of the base replace the base's, `params` and `with` key by key; other headings
//! are added. Each key remembers its file, for messages.

use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::Path;

use serde::Deserialize;

use super::failure::SpecError;
use super::reference::Reference;
use crate::campaign::suggest;

/// Name of a file or of a setting in which a key stands.
pub(super) type Place = String;

/// A value, and where it stands.
#[derive(Clone, Debug)]
pub(super) struct Placed<T> {
    pub(super) value: T,
    pub(super) place: Place,
}

/// Values by their names, in the order in which they appear.
pub(super) type Named<T> = Vec<(String, Placed<T>)>;

/// Most headings of a file: each is a thread of the passes that it takes part in.
const MOST_HEADINGS: usize = 1000;

/// A heading with all that its files say.
#[derive(Clone, Debug)]
pub(super) struct Heading {
    pub(super) name: String,
    /// The file in which it stands first.
    pub(super) place: Place,
    pub(super) stage: Option<Placed<String>>,
    pub(super) from: Option<Placed<String>>,
    pub(super) with: Named<String>,
    pub(super) params: Named<toml::Value>,
    pub(super) keep: Option<Placed<bool>>,
}

/// A heading as one file gives it.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Part {
    stage: Option<String>,
    from: Option<String>,
    #[serde(default)]
    with: toml::Table,
    #[serde(default)]
    params: toml::Table,
    keep: Option<bool>,
}

impl Part {
    /// Names in `with` and their tables.
    fn with(&self) -> Result<Vec<(String, String)>, String> {
        let table = |(name, table): (&String, &toml::Value)| match table.as_str() {
            Some(table) => Ok((name.clone(), table.to_owned())),
            None => Err(format!("with {name} = {table}: must be a table's name in quotes")),
        };
        self.with.iter().map(table).collect()
    }
}

/// One file, parsed.
struct Layer {
    place: Place,
    base: Option<String>,
    without: Vec<String>,
    headings: Vec<(String, Part)>,
}

/// A pipeline with all that its bases give. Names and types of keys are checked, stages and parameters are not.
#[derive(Clone, Debug)]
pub struct Definition {
    /// Name of its file.
    pub(super) place: Place,
    /// In order of first appearance.
    pub(super) headings: Vec<Heading>,
}

impl Definition {
    /// Reads a pipeline and its bases.
    ///
    /// # Errors
    /// When a file cannot be read or is refused, or when bases form a ring.
    pub fn load(reference: &Reference) -> Result<Self, SpecError> {
        Self::with_bases(reference.clone(), &reference.text()?)
    }

    /// The same from a text that is called `pipeline` in messages. It names files as seen from the current folder.
    ///
    /// # Errors
    /// When the text or one of its bases is refused.
    pub fn parse(pipeline: &str, text: &str) -> Result<Self, SpecError> {
        Self::with_bases(Reference::File(pipeline.into()), text)
    }

    fn with_bases(reference: Reference, text: &str) -> Result<Self, SpecError> {
        let mut chain = vec![reference.clone()];
        let mut layers = vec![Layer::parse(reference.name(), text)?];
        while let Some(base) = &layers[layers.len() - 1].base {
            let place = layers[layers.len() - 1].place.clone();
            let refused = |message: String| SpecError::Syntax { pipeline: place.clone(), message };
            let last = &chain[chain.len() - 1];
            let next = Reference::new(Path::new(base), last.folder());
            let next = next.map_err(|error| refused(format!("base = \"{base}\": {error}")))?;
            if let Some(first) = chain.iter().position(|other| other.is_same(&next)) {
                let ring: Vec<String> = chain[first..].iter().chain([&next]).map(Reference::name).collect();
                return Err(refused(format!(
                    "base = \"{base}\": it is its own base: {}; take one `base` of these out",
                    ring.join(" has the base ")
                )));
            }
            let text = next.text().map_err(|error| refused(format!("base = \"{base}\": {error}")))?;
            layers.push(Layer::parse(next.name(), &text)?);
            chain.push(next);
        }
        let mut definition = Self { place: String::new(), headings: Vec::new() };
        layers.into_iter().rev().try_for_each(|layer| definition.add(layer))?;
        Ok(definition)
    }

    /// Puts a file upon its base.
    fn add(&mut self, layer: Layer) -> Result<(), SpecError> {
        let Layer { place, base, without, headings } = layer;
        let refused = |message: String| SpecError::Syntax { pipeline: place.clone(), message };
        if base.is_none() && !without.is_empty() {
            return Err(refused("`without` drops headings of a base, and this file names no `base`".to_owned()));
        }
        for name in &without {
            let of_base: Vec<&str> = self.headings.iter().map(|heading| heading.name.as_str()).collect();
            let at = of_base.iter().position(|heading| heading == name).ok_or_else(|| {
                refused(format!(
                    "without = [\"{name}\"]: its base has no such heading; {}",
                    suggest::hint(name, of_base)
                ))
            })?;
            self.headings.remove(at);
        }
        for (name, part) in headings {
            let at = self.headings.iter().position(|heading| heading.name == name);
            if at.is_none() && base.is_some() && part.stage.is_none() {
                let of_base = self.headings.iter().map(|heading| heading.name.as_str());
                let message =
                    format!("it has no `stage`, and its base has no such heading; {}", suggest::hint(&name, of_base));
                return Err(SpecError::Heading { pipeline: place.clone(), heading: name, message });
            }
            let at = at.unwrap_or_else(|| {
                self.headings.push(Heading::new(name, place.clone()));
                self.headings.len() - 1
            });
            self.headings[at].change(part, &place)?;
        }
        self.check_dropped(&without, &place)?;
        self.place = place;
        Ok(())
    }

    /// Checks that nothing needs a dropped heading.
    fn check_dropped(&self, without: &[String], place: &str) -> Result<(), SpecError> {
        let names: BTreeSet<&str> = self.headings.iter().map(|heading| heading.name.as_str()).collect();
        for heading in &self.headings {
            for (key, input) in heading.inputs() {
                let main = input.value.split('.').next().unwrap_or(&input.value);
                if without.iter().any(|name| name == main) && !names.contains(main) {
                    return Err(SpecError::Syntax {
                        pipeline: place.to_owned(),
                        message: format!(
                            "without = [\"{main}\"]: [{}] needs it ({key} = \"{}\" in {}); drop [{0}] too, or give it another {key}",
                            heading.name, input.value, input.place
                        ),
                    });
                }
            }
        }
        Ok(())
    }

    /// Applies `TABLE.PARAM=VALUE` or `TABLE.keep=VALUE` from the command line.
    ///
    /// # Errors
    /// When a setting has another form, or there is no such heading.
    pub fn set(&mut self, settings: &[String]) -> Result<(), SpecError> {
        for setting in settings {
            let place = format!("{}: --set {setting}", self.place);
            apply(&mut self.headings, setting, &place)
                .map_err(|message| SpecError::Syntax { pipeline: place.clone(), message })?;
        }
        Ok(())
    }

    /// The whole pipeline as the text of a file.
    #[must_use]
    pub fn to_toml(&self) -> String {
        let mut text = String::new();
        for heading in &self.headings {
            heading.write(&mut text).expect("a String takes all text");
        }
        text
    }
}

impl Layer {
    fn parse(place: Place, text: &str) -> Result<Self, SpecError> {
        let syntax = |message: String| SpecError::Syntax { pipeline: place.clone(), message };
        let table: toml::Table =
            text.parse().map_err(|error: toml::de::Error| syntax(error.to_string().trim_end().to_owned()))?;
        let (mut base, mut without, mut headings) = (None, Vec::new(), Vec::new());
        let is_based = table.get("base").is_some_and(toml::Value::is_str);
        if table.len() > MOST_HEADINGS {
            let count = table.len();
            return Err(syntax(format!("has {count} headings, and a pipeline has at most {MOST_HEADINGS}; divide it")));
        }
        if let Some(kind) = other_kind(&table).filter(|_| !is_based) {
            return Err(syntax(kind.to_owned()));
        }
        for (name, value) in table {
            match (name.as_str(), value) {
                ("base", toml::Value::String(name)) => base = Some(name),
                ("without", toml::Value::Array(names)) => {
                    let text = |name: toml::Value| name.as_str().map(str::to_owned);
                    without = names.into_iter().map(text).collect::<Option<Vec<_>>>().ok_or_else(|| {
                        syntax("without: must be a list of headings in quotes: without = [\"paper\"]".to_owned())
                    })?;
                }
                ("base", value) if !value.is_table() => {
                    return Err(syntax(format!("base = {value}: must be a name or a file in quotes")));
                }
                ("without", value) if !value.is_table() => {
                    return Err(syntax(format!("without = {value}: must be a list: without = [\"paper\"]")));
                }
                (_, value) => {
                    let refused = |message: String| SpecError::Heading {
                        pipeline: place.clone(),
                        heading: name.clone(),
                        message,
                    };
                    check_name(&name).map_err(refused)?;
                    let part = value.try_into();
                    let part = part.map_err(|error: toml::de::Error| refused(heading_fault(error.message())))?;
                    headings.push((name, part));
                }
            }
        }
        Ok(Self { place, base, without, headings })
    }
}

impl Heading {
    fn new(name: String, place: Place) -> Self {
        let (stage, from, keep) = (None, None, None);
        Self { name, place, stage, from, with: Vec::new(), params: Vec::new(), keep }
    }

    /// Its inputs: the key that names each, and the table.
    pub(super) fn inputs(&self) -> impl Iterator<Item = (String, &Placed<String>)> {
        let from = self.from.iter().map(|from| ("from".to_owned(), from));
        from.chain(self.with.iter().map(|(name, table)| (format!("with {name}"), table)))
    }

    fn change(&mut self, part: Part, place: &Place) -> Result<(), SpecError> {
        let refused = |message| SpecError::Heading { pipeline: place.clone(), heading: self.name.clone(), message };
        let with = part.with().map_err(refused)?;
        let Part { stage, from, params, keep, .. } = part;
        self.stage = stage.map(|value| Placed::new(value, place)).or(self.stage.take());
        self.from = from.map(|value| Placed::new(value, place)).or(self.from.take());
        self.keep = keep.map(|value| Placed::new(value, place)).or(self.keep.take());
        with.into_iter().for_each(|(name, table)| set(&mut self.with, name, table, place));
        params.into_iter().for_each(|(name, value)| set(&mut self.params, name, value, place));
        Ok(())
    }

    /// Where the key stands that a refusal of its stage is about: `params.KEY = ...`, or the stage itself.
    pub(super) fn place_of(&self, refusal: &str) -> &Place {
        let is_about =
            |key: &str| refusal.strip_prefix("params.").is_some_and(|rest| rest.starts_with(&format!("{key} ")));
        let param = self.params.iter().find(|(name, _)| is_about(name)).map(|(_, value)| &value.place);
        param.or(self.stage.as_ref().map(|stage| &stage.place)).unwrap_or(&self.place)
    }

    fn write(&self, text: &mut String) -> std::fmt::Result {
        let quoted = |value: &str| toml::Value::String(value.to_owned());
        if !text.is_empty() {
            writeln!(text)?;
        }
        writeln!(text, "[{}]", self.name)?;
        for (key, value) in [("stage", &self.stage), ("from", &self.from)] {
            if let Some(value) = value {
                writeln!(text, "{key} = {}", quoted(&value.value))?;
            }
        }
        let with: toml::Table = self.with.iter().map(|(name, table)| (name.clone(), quoted(&table.value))).collect();
        let params: toml::Table = self.params.iter().map(|(name, value)| (name.clone(), value.value.clone())).collect();
        for (key, table) in [("with", with), ("params", params)] {
            if !table.is_empty() {
                writeln!(text, "{key} = {}", toml::Value::Table(table))?;
            }
        }
        if let Some(keep) = &self.keep {
            writeln!(text, "keep = {}", keep.value)?;
        }
        Ok(())
    }
}

impl<T> Placed<T> {
    fn new(value: T, place: &Place) -> Self {
        Self { value, place: place.clone() }
    }
}

/// Gives a name another value, or adds it.
fn set<T>(named: &mut Named<T>, name: String, value: T, place: &Place) {
    let value = Placed::new(value, place);
    match named.iter_mut().find(|(other, _)| *other == name) {
        Some((_, old)) => *old = value,
        None => named.push((name, value)),
    }
}

/// The kind of a file without headings of a pipeline, by the headings that it has.
fn other_kind(table: &toml::Table) -> Option<&'static str> {
    let has = |key: &str| table.get(key).and_then(toml::Value::as_table).is_some_and(|of| !of.contains_key("stage"));
    match (has("instrument"), has("campaign")) {
        (true, _) => Some(
            "this is a scene, for `simulate` and `design`; a pipeline is a file of stages, or a name that `periscope pipelines` lists",
        ),
        (_, true) => Some(
            "this is a campaign; give its folder with --campaign, and as pipeline a name that `periscope pipelines` lists, or nothing",
        ),
        _ => None,
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

/// Applies one setting.
fn apply(headings: &mut [Heading], setting: &str, place: &Place) -> Result<(), String> {
    let form = "write TABLE.PARAM=VALUE";
    let (key, value) = setting.split_once('=').ok_or(form)?;
    let (name, param) = key.trim().split_once('.').ok_or(form)?;
    let names: Vec<String> = headings.iter().map(|heading| heading.name.clone()).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let heading = headings.iter_mut().find(|heading| heading.name == name);
    let heading = heading.ok_or_else(|| suggest::unknown("table", name, &names))?;
    // Anything but a number, a boolean, a list or a quoted text counts as text: --set onsets.method=impulses.
    let value = format!("value = {value}")
        .parse::<toml::Table>()
        .ok()
        .and_then(|mut parsed| parsed.remove("value"))
        .unwrap_or_else(|| toml::Value::String(value.trim().to_owned()));
    if param == "keep" {
        let keep = value.as_bool().ok_or_else(|| format!("keep = {value}: must be true or false"))?;
        heading.keep = Some(Placed::new(keep, place));
    } else {
        set(&mut heading.params, param.to_owned(), value, place);
    }
    Ok(())
}
