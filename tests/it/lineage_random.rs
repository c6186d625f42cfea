//! Law 2 over random pipelines: a change affects the lineage of exactly the tables below it; a cosmetic edit affects
//! none.
//!
//! What lies below is followed here in the pipeline as it was drawn, not by the plan. The study that counts collisions
//! among a million pipelines is `cargo bench --bench reliability -- lineage`.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fs;
use std::path::Path;

use periscope::campaign::Campaign;
use periscope::pipeline::plan::Plan;
use periscope::pipeline::spec::Spec;
use periscope::store::{Digest, Shelf};
use rand::seq::{IndexedRandom, SliceRandom};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Draws.
const DRAWS: u64 = 1000;

/// A parameter: its name, and values of it, the default first.
type Param = (&'static str, &'static [&'static str]);

/// A stage as the generator sees it: verb, streamed table, written table, whole tables (name, table, required),
/// parameters.
struct Kind {
    stage: &'static str,
    from: &'static str,
    table: &'static str,
    beside: &'static [(&'static str, &'static str, bool)],
    params: &'static [Param],
}

const KINDS: &[Kind] = &[
    Kind {
        stage: "ingest",
        from: "",
        table: "traces",
        beside: &[],
        params: &[("roles", &["['scene']", "['response']", "['response', 'scene']"])],
    },
    Kind { stage: "calibrate", from: "traces", table: "calibration", beside: &[], params: &[] },
    Kind {
        stage: "average",
        from: "traces",
        table: "profiles",
        beside: &[("calibration", "calibration", false)],
        params: &[("reject_outliers", &["true", "false"]), ("shots_min", &["1", "16", "17"])],
    },
    Kind {
        stage: "track",
        from: "profiles",
        table: "session",
        beside: &[("calibration", "calibration", true)],
        params: &[],
    },
    Kind {
        stage: "recalibrate",
        from: "profiles",
        table: "calibration",
        beside: &[("calibration", "calibration", true), ("session", "session", false)],
        params: &[("extent_max_ps", &["0.0", "200.0"])],
    },
    Kind {
        stage: "deconvolve",
        from: "profiles",
        table: "stir",
        beside: &[("calibration", "calibration", true), ("session", "session", false)],
        params: &[
            ("correlated", &["true", "false"]),
            ("joint", &["false", "true"]),
            ("extent_max_ps", &["0.0", "200.0", "200.5", "5e-324", "2.2250738585072014e-308"]),
        ],
    },
    Kind {
        stage: "detect",
        from: "stir",
        table: "onsets",
        beside: &[],
        params: &[
            ("method", &["'impulses'", "'leading-edge'", "'aic'"]),
            ("threshold_sigma", &["5.0", "6.0", "5.000000000000001", "4.999999999999999", "2.3", "2.3000000000000003"]),
        ],
    },
    Kind {
        stage: "label",
        from: "onsets",
        table: "labels",
        beside: &[("patches", "patches", false)],
        params: &[("bounces", &["2", "3"]), ("probability_min", &["0.95", "0.9"])],
    },
    Kind { stage: "range", from: "labels", table: "distances", beside: &[("patches", "patches", false)], params: &[] },
    Kind {
        stage: "embed",
        from: "distances",
        table: "patches",
        beside: &[("patches", "patches", false)],
        params: &[("method", &["'classical'", "'incremental'", "'iso-embed'"])],
    },
    Kind {
        stage: "refine",
        from: "labels",
        table: "patches",
        beside: &[("patches", "patches", false), ("calibration", "calibration", false)],
        params: &[("robust", &["true", "false"])],
    },
    Kind { stage: "surface", from: "patches", table: "planes", beside: &[], params: &[("least", &["4", "5"])] },
];

/// A heading of a random pipeline.
#[derive(Clone)]
struct Heading {
    kind: usize,
    from: Option<usize>,
    with: BTreeMap<&'static str, usize>,
    /// For each parameter of the stage which of its values; `None`: not written.
    params: Vec<Option<usize>>,
    keep: bool,
}

impl Heading {
    fn inputs(&self) -> impl Iterator<Item = usize> {
        self.from.into_iter().chain(self.with.values().copied())
    }
}

/// A pipeline in which every table comes before those that it goes into.
fn draw(rng: &mut ChaCha8Rng) -> Vec<Heading> {
    let mut headings: Vec<Heading> = Vec::new();
    let count = rng.random_range(4..24);
    while headings.len() < count {
        let kind = rng.random_range(0..KINDS.len());
        let of = |table: &str, rng: &mut ChaCha8Rng| {
            let made: Vec<usize> = (0..headings.len()).filter(|&n| KINDS[headings[n].kind].table == table).collect();
            made.choose(rng).copied()
        };
        let from = of(KINDS[kind].from, rng);
        if from.is_none() && !KINDS[kind].from.is_empty() {
            continue;
        }
        let mut with = BTreeMap::new();
        let mut is_possible = true;
        for (name, table, is_needed) in KINDS[kind].beside {
            let chosen = of(table, rng).filter(|_| *is_needed || rng.random_bool(0.6));
            is_possible &= !is_needed || chosen.is_some();
            with.extend(chosen.map(|input| (*name, input)));
        }
        if is_possible {
            let params = KINDS[kind].params.iter();
            let params =
                params.map(|(_, values)| rng.random_bool(0.5).then(|| rng.random_range(0..values.len()))).collect();
            headings.push(Heading { kind, from, with, params, keep: rng.random_bool(0.8) });
        }
    }
    headings
}

/// The pipeline as someone would write it, who likes it this way or another.
fn text(headings: &[Heading], rng: &mut ChaCha8Rng) -> String {
    let mut order: Vec<usize> = (0..headings.len()).collect();
    order.shuffle(rng);
    let mut text = String::new();
    for n in order {
        let Heading { kind, from, with, params, keep } = &headings[n];
        let equals = ["=", " = ", "  =  "].choose(rng).expect("there are some");
        let mut lines = vec![format!("stage{equals}\"{}\"", KINDS[*kind].stage)];
        lines.extend(from.map(|from| format!("from{equals}'t{from}'")));
        if !with.is_empty() {
            let mut with: Vec<String> = with.iter().map(|(name, input)| format!("{name}{equals}'t{input}'")).collect();
            with.shuffle(rng);
            lines.push(format!("with = {{ {} }}", with.join(", ")));
        }
        let names = KINDS[*kind].params.iter().zip(params);
        let mut params = Vec::new();
        for ((name, values), value) in names {
            // A default may be written or not, and zero with a sign is zero.
            if value.is_some_and(|value| value > 0) || rng.random_bool(0.5) {
                let value = values[value.unwrap_or(0)];
                let sign = if value == "0.0" && rng.random_bool(0.5) { "-" } else { "" };
                params.push(format!("{name}{equals}{sign}{value}"));
            }
        }
        params.shuffle(rng);
        if !params.is_empty() {
            lines.push(format!("params = {{ {} }}", params.join(", ")));
        }
        if !keep || rng.random_bool(0.2) {
            lines.push(format!("keep = {keep}"));
        }
        lines.shuffle(rng);
        let comment = if rng.random_bool(0.3) { " # as we like it" } else { "" };
        text.extend([format!("[t{n}]{comment}"), lines.join("\n"), String::new()].map(|line| line + "\n"));
    }
    text
}

/// Lineage of each table, by its number, with these contents of the raw files of each source.
fn lineages<'a>(text: &str, campaigns: &[Campaign], shelf: &Shelf, raw: impl Fn(usize) -> &'a str) -> Vec<Digest> {
    let spec = Spec::parse("random", text, &[]).unwrap_or_else(|error| panic!("{error}\n{text}"));
    let mut plan = Plan::new(&spec, campaigns, shelf, None).unwrap();
    let number = |step: usize| spec.steps[step].heading[1..].parse::<usize>().unwrap();
    let parts = plan.sources.iter().flat_map(|(step, source)| (0..source.parts().len()).map(move |part| (*step, part)));
    let content = parts.map(|(step, part)| ((step, part), Digest::of_bytes(raw(number(step)).as_bytes()))).collect();
    plan.refresh(&content).unwrap();
    let mut lineages: Vec<(usize, Digest)> =
        (0..spec.steps.len()).map(|step| (number(step), plan.tables[step].lineage().unwrap())).collect();
    lineages.sort_by_key(|(number, _)| *number);
    lineages.into_iter().map(|(_, lineage)| lineage).collect()
}

/// A table and all that are made from it.
fn below(headings: &[Heading], changed: usize) -> BTreeSet<usize> {
    let mut below = BTreeSet::from([changed]);
    for (n, heading) in headings.iter().enumerate() {
        if heading.inputs().any(|input| below.contains(&input)) {
            below.insert(n);
        }
    }
    below
}

/// A kind of change.
enum Change {
    /// A whole table in `with` that was not there.
    Input(&'static str, usize),
    /// Other raw files.
    Raw,
    /// Another value of a parameter.
    Param,
}

/// The first optional table that heading `n` could name in `with` and does not.
fn new_input(headings: &[Heading], n: usize) -> Option<Change> {
    let made = |table: &str| (0..n).find(|&input| KINDS[headings[input].kind].table == table);
    let mut missing = KINDS[headings[n].kind].beside.iter().filter(|(name, ..)| !headings[n].with.contains_key(name));
    missing.find_map(|(name, table, _)| Some(Change::Input(name, made(table)?)))
}

/// Where a pipeline is changed, and how; each kind of change as likely, where there is a place for it.
fn change(headings: &[Heading], rng: &mut ChaCha8Rng) -> (usize, Change) {
    let kind = |n: usize| &KINDS[headings[n].kind];
    loop {
        let which = rng.random_range(0..3);
        let of = |n: usize| match which {
            0 => new_input(headings, n),
            1 => kind(n).from.is_empty().then_some(Change::Raw),
            _ => (!kind(n).params.is_empty()).then_some(Change::Param),
        };
        let possible: Vec<usize> = (0..headings.len()).filter(|&n| of(n).is_some()).collect();
        if let Some(&n) = possible.choose(rng) {
            return (n, of(n).expect("it is possible"));
        }
    }
}

/// A campaign of one exposure of a scene and one of the response.
fn campaign(folder: &Path) -> Campaign {
    let rule = |role: &str, files: &str| format!("[[captures]]\nrole = '{role}'\nfiles = '{files}'\ndt_ps = 50.0\n");
    let rules = rule("scene", "L{lit}_P{seen}.npy") + &rule("response", "response.npy");
    fs::write(folder.join("campaign.toml"), format!("[campaign]\nname = 'c'\n[sensors.s1]\n{rules}")).unwrap();
    for file in ["L1_P2.npy", "response.npy"] {
        fs::write(folder.join(file), file).unwrap();
    }
    Campaign::load(folder).unwrap()
}

#[test]
fn a_change_reaches_exactly_the_tables_below_it() {
    let folder = tempfile::tempdir().unwrap();
    let campaigns = [campaign(folder.path())];
    let shelf = Shelf::imagine(&folder.path().join("out"));
    let as_they_are = |_: usize| "as it is";
    let (mut reached, mut spared, mut of_kind) = (0, 0, [0; 3]);
    for seed in 0..DRAWS {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let headings = draw(&mut rng);
        let before = lineages(&text(&headings, &mut rng), &campaigns, &shelf, as_they_are);

        let mut kept_otherwise = headings.clone();
        kept_otherwise.iter_mut().for_each(|heading| heading.keep = rng.random_bool(0.5));
        let cosmetic = text(&kept_otherwise, &mut rng);
        assert_eq!(lineages(&cosmetic, &campaigns, &shelf, as_they_are), before, "seed {seed}\n{cosmetic}");

        let mut changed = headings.clone();
        let (n, change) = change(&headings, &mut rng);
        let mut raw_of = None;
        match change {
            Change::Input(name, input) => {
                of_kind[0] += 1;
                changed[n].with.insert(name, input);
            }
            Change::Raw => {
                of_kind[1] += 1;
                raw_of = Some(n);
            }
            Change::Param => {
                of_kind[2] += 1;
                let params = KINDS[headings[n].kind].params;
                let param = rng.random_range(0..params.len());
                let now = headings[n].params[param].unwrap_or(0);
                let others: Vec<usize> = (0..params[param].1.len()).filter(|&value| value != now).collect();
                changed[n].params[param] = others.choose(&mut rng).copied();
            }
        }
        let raw = |number: usize| if raw_of == Some(number) { "another" } else { "as it is" };
        let after = lineages(&text(&changed, &mut rng), &campaigns, &shelf, raw);
        let differing: BTreeSet<usize> = (0..before.len()).filter(|&n| before[n] != after[n]).collect();
        let expected = below(&changed, n);
        assert_eq!(differing, expected, "seed {seed}");
        reached += expected.len();
        spared += headings.len() - expected.len();
    }
    assert!(of_kind.iter().all(|&count| count > 200), "draws of each kind of change: {of_kind:?}");
    assert!(reached > 1000 && spared > 1000, "{reached} tables reached, {spared} spared");
}

/// Everything that determines each table, by its number: found in the pipeline as it was drawn.
fn descriptions(headings: &[Heading], raw: &str) -> Vec<blake3::Hash> {
    let mut all: Vec<blake3::Hash> = Vec::new();
    for Heading { kind, from, with, params, .. } in headings {
        let Kind { stage, params: names, .. } = &KINDS[*kind];
        let mut text = format!("{stage};");
        for ((name, values), value) in names.iter().zip(params) {
            text.extend([name, "=", values[value.unwrap_or(0)], ";"]);
        }
        text += &from.map_or(format!("raw={raw};"), |input| format!("from={};", all[input]));
        for (name, input) in with {
            text.extend([name, "=", all[*input].to_hex().as_str(), ";"]);
        }
        all.push(blake3::hash(text.as_bytes()));
    }
    all
}

/// Numbers that are none; each must be refused.
const NOT_FINITE: [&str; 4] = ["nan", "inf", "-inf", "-nan"];

/// What became of random pipelines.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Counts {
    pub tables: u64,
    /// Tables with different inputs.
    pub different: usize,
    /// Tables with the lineage of one with other inputs.
    pub collisions: u64,
    /// Tables with another lineage than one with the same inputs.
    pub splits: u64,
    /// Parameters that are no finite number.
    pub refused: u64,
    pub taken: u64,
}

/// Draws pipelines, and compares lineages with descriptions.
pub fn count(draws: u64) -> Counts {
    let folder = tempfile::tempdir().unwrap();
    let campaigns = [campaign(folder.path())];
    let shelf = Shelf::imagine(&folder.path().join("out"));
    // Of digests 128 bits are kept: among 10^7 of these two collide by chance with a probability of 10^-25.
    let short = |hash: blake3::Hash| u128::from_le_bytes(hash.as_bytes()[..16].try_into().unwrap());
    let (mut of_lineage, mut of_description) = (HashMap::new(), HashMap::new());
    let mut counts = Counts::default();
    for seed in 0..draws {
        let mut rng = ChaCha8Rng::seed_from_u64(1 << 32 | seed);
        let headings = draw(&mut rng);
        let text = text(&headings, &mut rng);
        let raw = ["one", "another", "a third"][rng.random_range(0..3)];
        let found = lineages(&text, &campaigns, &shelf, |_| raw);
        for (lineage, description) in found.into_iter().zip(descriptions(&headings, raw)) {
            let (lineage, description) = (short(lineage.into()), short(description));
            counts.tables += 1;
            counts.collisions += u64::from(*of_lineage.entry(lineage).or_insert(description) != description);
            counts.splits += u64::from(*of_description.entry(description).or_insert(lineage) != lineage);
        }
        if let Some(at) = text.find("threshold_sigma").or_else(|| text.find("extent_max_ps")) {
            let (before, rest) = text.split_at(at);
            let name = rest.split(['=', ' ']).next().unwrap();
            let end = rest.find([',', '}']).unwrap();
            let value = NOT_FINITE[rng.random_range(0..NOT_FINITE.len())];
            let is_refused = Spec::parse("random", &format!("{before}{name} = {value} {}", &rest[end..]), &[]).is_err();
            *(if is_refused { &mut counts.refused } else { &mut counts.taken }) += 1;
        }
    }
    counts.different = of_description.len();
    counts
}

#[test]
fn different_inputs_have_different_lineages_and_no_number_is_not_finite() {
    let counts = count(1000);
    assert!(counts.different > 2000 && counts.refused > 200, "{counts:?}");
    assert_eq!((counts.collisions, counts.splits, counts.taken), (0, 0, 0), "{counts:?}");
}
