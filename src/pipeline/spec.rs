//! The pipeline file: one heading per table. Parsing checks names and parameters; nothing is read or run here.

mod built_in;
mod definition;
mod failure;
mod reference;

use std::collections::BTreeMap;
use std::path::Path;

use crate::campaign::suggest;
use crate::stages::stage::Beside;
use crate::stages::{self, Node};
pub use built_in::{BUILT_IN, BuiltIn, DEFAULT};
pub use definition::Definition;
use definition::{Heading, Place};
pub use failure::SpecError;
pub use reference::Reference;

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
    /// Reads a pipeline: a name of those in the program, or a file. `settings` are `TABLE.PARAM=VALUE` from the command
    /// line.
    ///
    /// # Errors
    /// When the file cannot be read, or anything in it is refused.
    pub fn load(pipeline: &Path, settings: &[String]) -> Result<Self, SpecError> {
        let mut definition = Definition::load(&Reference::new(pipeline, Path::new(""))?)?;
        definition.set(settings)?;
        Self::new(&definition)
    }

    /// Parses the text of a pipeline file, called `pipeline` in messages.
    ///
    /// # Errors
    /// When anything in it is refused.
    pub fn parse(pipeline: &str, text: &str, settings: &[String]) -> Result<Self, SpecError> {
        let mut definition = Definition::parse(pipeline, text)?;
        definition.set(settings)?;
        Self::new(&definition)
    }

    /// The pipeline of a definition.
    ///
    /// # Errors
    /// When a stage, a parameter or an input is refused.
    pub fn new(definition: &Definition) -> Result<Self, SpecError> {
        let steps = definition.headings.iter().map(step).collect::<Result<_, _>>()?;
        let spec = Self { steps: in_order(&definition.place, steps)? };
        let place = |step: &Step| definition.headings.iter().find(|heading| heading.name == step.heading);
        spec.steps.iter().try_for_each(|step| spec.check(step, place(step).expect("steps are made of headings")))?;
        Ok(spec)
    }

    /// Position of a heading.
    #[must_use]
    pub fn position(&self, heading: &str) -> Option<usize> {
        self.steps.iter().position(|step| step.heading == heading)
    }

    /// Checks that every input of a step exists, and is the table that the stage needs.
    fn check(&self, step: &Step, heading: &Heading) -> Result<(), SpecError> {
        let place = heading.stage.as_ref().map_or(&heading.place, |stage| &stage.place);
        let operator = match &step.node {
            Node::Source(source) => {
                let Some((_, input)) = heading.inputs().next() else {
                    return Ok(());
                };
                let message = format!("stage `{}` has no input: remove `from` and `with`", source.kind());
                return Err(refused(&input.place, &step.heading, message));
            }
            Node::Operator(operator) => operator,
        };
        let kind = operator.kind();
        let Some(from) = &heading.from else {
            let message = format!("stage `{kind}` needs `from = \"...\"`: a table `{}`", operator.input());
            return Err(refused(place, &step.heading, message));
        };
        self.expect(&from.value, operator.input())
            .map_err(|message| refused(&from.place, &step.heading, format!("from = \"{}\": {message}", from.value)))?;
        for (name, input) in &heading.with {
            let names: Vec<&str> = operator.beside().iter().map(|beside| beside.name).collect();
            let Some(beside) = operator.beside().iter().find(|beside| beside.name == name) else {
                let message = suggest::unknown("name in `with`", name, &names);
                return Err(refused(&input.place, &step.heading, message));
            };
            self.expect(&input.value, beside.table).map_err(|message| {
                refused(&input.place, &step.heading, format!("with {name} = \"{}\": {message}", input.value))
            })?;
        }
        let given = |beside: &&Beside| step.with.contains_key(beside.name);
        if let Some(Beside { name, table, .. }) = operator.beside().iter().find(|b| b.required && !given(b)) {
            let message = format!("stage `{kind}` needs `with = {{ {name} = \"...\" }}`: a table `{table}`");
            return Err(refused(place, &step.heading, message));
        }
        Ok(())
    }

    /// Checks that `heading` or `heading.side` is a table `table`.
    fn expect(&self, heading: &str, table: &str) -> Result<(), String> {
        let (step, kind) = self.table(heading).ok_or_else(|| {
            let names: Vec<&str> = self.steps.iter().map(|step| step.heading.as_str()).collect();
            format!("there is no such table in this pipeline; {}", suggest::hint(heading, names))
        })?;
        if kind == table {
            Ok(())
        } else {
            Err(format!("`{}` makes a table `{kind}`, but a table `{table}` is needed", self.steps[step].heading))
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

fn refused(place: &Place, heading: &str, message: String) -> SpecError {
    SpecError::Heading { pipeline: place.clone(), heading: heading.to_owned(), message }
}

/// The stage of a heading.
fn step(heading: &Heading) -> Result<Step, SpecError> {
    let missing = || refused(&heading.place, &heading.name, "missing field `stage`".to_owned());
    let stage = heading.stage.as_ref().ok_or_else(missing)?;
    let params = heading.params.iter().map(|(name, param)| (name.clone(), param.value.clone())).collect();
    let node = stages::parse(&stage.value, params)
        .map_err(|message| refused(heading.place_of(&message), &heading.name, message))?;
    Ok(Step {
        heading: heading.name.clone(),
        node,
        from: heading.from.as_ref().map(|from| from.value.clone()),
        with: heading.with.iter().map(|(name, table)| (name.clone(), table.value.clone())).collect(),
        keep: heading.keep.as_ref().is_none_or(|keep| keep.value),
    })
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
