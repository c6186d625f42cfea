//! The chain of lineages: a part's lineage joins its recipe with the lineages of its inputs.

use std::collections::{BTreeMap, BTreeSet};

use super::Report;
use super::stage_folder::StageFolder;
use crate::store::shelf::{Shelf, TableRecord};
use crate::store::{Digest, lineage};

/// Most combinations of inputs that are tried.
const MOST: usize = 1 << 20;

/// Derives every part's lineage from its inputs, where these are on the shelf.
pub fn follow(shelf: &Shelf, stages: &[StageFolder], report: &mut Report) {
    // Recipes of tables, by which stages name their inputs.
    let mut recipes: BTreeMap<Digest, &StageFolder> = BTreeMap::new();
    for stage in stages {
        let Some(id) = &stage.id else { continue };
        for (table, _) in crate::tables::all() {
            recipes.insert(lineage::table_recipe(table, &id.recipe()), stage);
        }
    }
    let mut missing: BTreeSet<String> = BTreeSet::new();
    for stage in stages {
        let Some(id) = stage.id.as_ref().filter(|id| !id.inputs.is_empty()) else { continue };
        let inputs: Option<Vec<(&String, &StageFolder)>> =
            id.inputs.iter().map(|(name, recipe)| Some((name, *recipes.get(recipe)?))).collect();
        let whole = |input: &StageFolder| {
            let parts = || input.tables.values().flat_map(|table| &table.parts);
            !input.tables.is_empty() && parts().all(|part| input.parts.contains_key(&part.lineage))
        };
        let Some(inputs) = inputs.filter(|inputs| inputs.iter().all(|(_, input)| whole(input))) else {
            missing.insert(id.kind.clone());
            continue;
        };
        let Some(possible) = possible(&id.recipe(), &inputs) else {
            missing.insert(id.kind.clone());
            continue;
        };
        for lineage in stage.parts.keys() {
            if possible.contains(lineage) {
                report.counts.followed += 1;
            } else {
                let path = stage.path.join(format!("part-{lineage}.json"));
                let remove = vec![path.clone()];
                report.add(
                    shelf,
                    &path,
                    "does not follow from what is on the shelf: its lineage is none that its inputs give",
                    remove,
                );
            }
        }
    }
    if !missing.is_empty() {
        let kinds: Vec<String> = missing.into_iter().collect();
        report.notes.push(format!(
            "lineages of {} cannot be followed: tables that they are made from are not kept, or not whole",
            kinds.join(", ")
        ));
    }
}

/// Possible lineages of parts with these inputs; the streamed input enters by its parts or whole. `None` if there are
/// too many.
fn possible(recipe: &Digest, inputs: &[(&String, &StageFolder)]) -> Option<BTreeSet<Digest>> {
    let streamed = |(name, _): &&(&String, &StageFolder)| *name == "from";
    let (_, from) = inputs.iter().find(streamed)?;
    let mut chains: Vec<Vec<Digest>> = from.parts.keys().chain(from.tables.keys()).map(|input| vec![*input]).collect();
    for (_, input) in inputs.iter().filter(|input| !streamed(input)) {
        let single = input.parts.keys().map(|part| TableRecord::lineage_of([part]));
        let tables: BTreeSet<Digest> = input.tables.keys().copied().chain(single).collect();
        if chains.len() * tables.len() > MOST {
            return None;
        }
        let longer = |chain: &Vec<Digest>| -> Vec<Vec<Digest>> {
            tables.iter().map(|table| chain.iter().copied().chain([*table]).collect()).collect()
        };
        chains = chains.iter().flat_map(longer).collect();
    }
    let lineage = |chain: Vec<Digest>| lineage::part(recipe, &chain[0], &chain[1..]);
    Some(chains.into_iter().map(lineage).collect())
}
