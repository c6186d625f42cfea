//! Random parameters of every stage: two sets share a recipe if, and only if, they mean the same.

use std::collections::{BTreeMap, HashMap};

use rand::seq::IndexedRandom;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde_json::Value;

use crate::stages::{self, KINDS};
use crate::store::{Digest, StageId};

/// Accepted sets of parameters a stage. Each is held against each other one: 4.5 million pairs a stage.
const SETS: usize = 3000;
/// Sets that are tried for each accepted one, at most.
const TRIES: usize = 30;

/// Numbers around which a mistake is likely.
const NUMBERS: [f64; 14] = [
    0.0,
    -0.0,
    1.0,
    -1.0,
    0.1,
    0.3,
    1.0 / 3.0,
    0.6,
    5.0,
    100.0,
    1e22,
    9_007_199_254_740_992.0,
    f64::MIN_POSITIVE,
    f64::MAX,
];

/// A parameter of a stage: what it is where it is not given, and the words that it takes.
struct Parameter {
    key: String,
    default: Value,
    words: Vec<String>,
}

/// The parameters of a stage, by what it says of a key and of a value that it does not know.
fn parameters(kind: &str) -> Vec<Parameter> {
    let refused = |key: &str, value: toml::Value| match stages::parse(kind, table(&[(key, value)])) {
        Ok(_) => String::new(),
        Err(why) => why,
    };
    let defaults = stages::parse(kind, needed(kind)).unwrap().params().unwrap();
    let unknown = refused("no parameter has this name", "no word".into());
    let keys = unknown.split_once("known: ").map_or("", |(_, keys)| keys).split(", ");
    keys.filter(|key| !key.is_empty() && *key != "path")
        .map(|key| {
            // A list refuses a single word before it looks at it.
            let why = refused(key, "no word".into()) + &refused(key, vec!["no word"].into());
            let words = why.split_once("must be one of ").map_or("", |(_, words)| words.split(" (").next().unwrap());
            let words = if key == "table" { "onsets, stir" } else { words };
            let words = words.split(", ").filter(|word| !word.is_empty()).map(str::to_owned).collect();
            // What is not written where it is off.
            let default = defaults.get(key).cloned().unwrap_or(Value::Bool(false));
            Parameter { key: key.to_owned(), default, words }
        })
        .collect()
}

fn table(entries: &[(&str, toml::Value)]) -> toml::Table {
    entries.iter().map(|(key, value)| ((*key).to_owned(), value.clone())).collect()
}

/// What a stage cannot do without.
fn needed(kind: &str) -> toml::Table {
    match kind {
        "import" => table(&[("table", "onsets".into()), ("path", "onsets.parquet".into())]),
        _ => toml::Table::new(),
    }
}

fn number(rng: &mut impl Rng) -> toml::Value {
    let chosen = *NUMBERS.choose(rng).unwrap();
    let number = match rng.random_range(0..8) {
        0 => chosen,
        1 => chosen.next_up(),
        2 => chosen.next_down(),
        3 => *[f64::NAN, f64::INFINITY, f64::NEG_INFINITY].choose(rng).unwrap(),
        4 => f64::from_bits(rng.random()),
        5 => rng.random_range(0.0..1.0),
        6 => f64::from(rng.random_range(0..8)),
        _ => rng.random_range(0.0..1000.0),
    };
    // Of 2^63 and more there are no integers in TOML.
    let is_integer = number.fract() == 0.0 && number.abs() < 9e18;
    if is_integer && rng.random() { toml::Value::Integer(number as i64) } else { toml::Value::Float(number) }
}

fn value(parameter: &Parameter, rng: &mut impl Rng) -> toml::Value {
    let word = |rng: &mut _| toml::Value::String(parameter.words.choose(rng).unwrap().clone());
    match parameter.default {
        Value::Bool(_) => rng.random::<bool>().into(),
        Value::String(_) => word(rng),
        Value::Array(_) => (0..rng.random_range(0..4)).map(|_| word(rng)).collect::<Vec<_>>().into(),
        Value::Null if parameter.key == "groups" => {
            let first = rng.random_range(1..4);
            vec![(first..first + rng.random_range(3..5)).collect::<Vec<i64>>()].into()
        }
        Value::Number(_) | Value::Null | Value::Object(_) => number(rng),
    }
}

/// What a value means, whatever its spelling: `{:?}` differs for any two floats that are not equal.
fn meaning(value: &Value) -> String {
    match value {
        Value::Number(number) => format!("{:?}", number.as_f64().unwrap() + 0.0),
        Value::Array(items) => {
            let mut items: Vec<String> = items.iter().map(meaning).collect();
            items.sort();
            items.dedup();
            items.join(" ")
        }
        other => other.to_string(),
    }
}

/// What a set of parameters means.
fn meanings(parameters: &[Parameter], given: &toml::Table) -> Vec<String> {
    let one = |parameter: &Parameter| match given.get(&parameter.key) {
        None => meaning(&parameter.default),
        Some(toml::Value::Float(float)) => format!("{:?}", float + 0.0),
        Some(other) => meaning(&serde_json::to_value(other).unwrap()),
    };
    parameters.iter().map(one).collect()
}

fn recipe(kind: &str, given: &toml::Table) -> Option<Digest> {
    let node = stages::parse(kind, given.clone()).ok()?;
    let id = StageId {
        kind: kind.to_owned(),
        version: node.version(),
        params: node.params().unwrap(),
        fields: Value::Null,
        schemas: Digest::of_bytes(b"schemas"),
        arithmetic: String::new(),
        inputs: BTreeMap::new(),
    };
    // Whatever order its fields stand in.
    assert_eq!(id.recipe(), Digest::of(&serde_json::to_value(&id).unwrap()));
    Some(id.recipe())
}

/// Random sets of parameters that the stage accepts. Many differ in one parameter alone.
fn sets(kind: &str, parameters: &[Parameter], rng: &mut ChaCha8Rng) -> Vec<(toml::Table, Digest)> {
    let mut sets: Vec<(toml::Table, Digest)> = Vec::new();
    for _ in 0..SETS * TRIES {
        let mut given = match sets.choose(rng) {
            Some((earlier, _)) if rng.random() => earlier.clone(),
            _ => needed(kind),
        };
        for _ in 0..rng.random_range(0..3) {
            let parameter = parameters.choose(rng).unwrap();
            if rng.random_bool(0.2) && !needed(kind).contains_key(&parameter.key) {
                given.remove(&parameter.key);
            } else {
                given.insert(parameter.key.clone(), value(parameter, rng));
            }
        }
        let recipe = recipe(kind, &given);
        let is_finite = given.values().all(|value| value.as_float().is_none_or(f64::is_finite));
        assert!(is_finite || recipe.is_none(), "{kind} accepts {given}");
        sets.extend(recipe.map(|recipe| (given, recipe)));
        if sets.len() == SETS {
            break;
        }
    }
    sets
}

/// Pairs that mean the same, and pairs that do not.
fn check(kind: &str, seed: u64) -> (usize, usize) {
    let parameters = parameters(kind);
    if parameters.is_empty() {
        return (0, 0);
    }
    let sets = sets(kind, &parameters, &mut ChaCha8Rng::seed_from_u64(seed));
    let (mut recipes, mut others) = (HashMap::new(), HashMap::new());
    let mut counts: HashMap<Digest, usize> = HashMap::new();
    for (given, recipe) in &sets {
        let meaning = meanings(&parameters, given);
        let (same, earlier) = recipes.entry(meaning.clone()).or_insert((*recipe, given));
        assert_eq!(same, recipe, "{kind}: two recipes of what means the same:\n{given}\n{earlier}");
        let (other, earlier) = others.entry(*recipe).or_insert((meaning.clone(), given));
        assert_eq!(*other, meaning, "{kind}: one recipe of\n{given}\nand of\n{earlier}");
        *counts.entry(*recipe).or_default() += 1;
    }
    let same = counts.values().map(|count| count * (count - 1) / 2).sum();
    (same, sets.len() * (sets.len() - 1) / 2 - same)
}

#[test]
fn parameters_share_a_recipe_if_and_only_if_they_mean_the_same() {
    let pairs: Vec<(usize, usize)> =
        KINDS.par_iter().enumerate().map(|(seed, kind)| check(kind, seed as u64)).collect();
    let (same, different) = pairs.iter().fold((0, 0), |all, pair| (all.0 + pair.0, all.1 + pair.1));
    assert!(same > 1_000_000 && different > 10_000_000, "{pairs:?}");
}
