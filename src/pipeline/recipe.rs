//! What determines the table of each step: the part of its lineage that is known before anything is read.

use std::collections::BTreeMap;

use arrow_schema::{DataType, Field};
use serde_json::{Value, json};

use super::arithmetic;
use super::spec::Spec;
use crate::campaign::Campaign;
use crate::stages::Node;
use crate::stages::operator::WrittenTable;
use crate::store::finite::NotJson;
use crate::store::{Digest, StageId, lineage};

/// The identity of step `i`; `earlier` are those of the steps before it.
///
/// # Errors
/// When a parameter or a campaign field is not finite.
pub(super) fn stage_id(spec: &Spec, i: usize, campaigns: &[Campaign], earlier: &[StageId]) -> Result<StageId, NotJson> {
    let step = &spec.steps[i];
    let recipe = |heading: &str| {
        let (step, table) = spec.table(heading).expect("the pipeline was checked");
        lineage::table_recipe(&table, &earlier[step].recipe())
    };
    let mut inputs: BTreeMap<String, Digest> =
        step.with.iter().map(|(name, heading)| (name.clone(), recipe(heading))).collect();
    inputs.extend(step.from.as_deref().map(|heading| ("from".to_owned(), recipe(heading))));
    let arithmetic = match &step.node {
        Node::Source(_) => arithmetic::COPIED,
        Node::Operator(_) => arithmetic::of_this_cpu(),
    };
    let at = |fault: NotJson| fault.below(format!("[{}]", step.heading));
    let columns = |table: &WrittenTable| {
        json!([table.name, table.schema.fields().iter().map(|field| signature(field)).collect::<Vec<_>>()])
    };
    let schemas: Vec<Value> = step.node.tables().iter().map(columns).collect();
    Ok(StageId {
        kind: step.node.kind().to_owned(),
        version: step.node.version(),
        params: step.node.params().map_err(at)?,
        fields: step.node.fields(campaigns).map_err(at)?,
        schemas: Digest::of(&Value::Array(schemas)),
        arithmetic: arithmetic.to_owned(),
        inputs,
    })
}

/// Name, type and nullability of a column, without its description.
fn signature(field: &Field) -> Value {
    let inner: Vec<Value> = match field.data_type() {
        DataType::List(item) => vec![signature(item)],
        DataType::Struct(fields) => fields.iter().map(|field| signature(field)).collect(),
        plain => vec![plain.to_string().into()],
    };
    json!([field.name(), field.is_nullable(), inner])
}

#[cfg(test)]
mod tests;
