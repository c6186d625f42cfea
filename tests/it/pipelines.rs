//! Pipelines by name, pipelines with a base, and the one command that needs neither.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use periscope::campaign::Campaign;
use periscope::pipeline::plan::Plan;
use periscope::pipeline::run::Settings;
use periscope::pipeline::spec::{BUILT_IN, Definition, Reference, Spec};
use periscope::store::{Digest, Shelf};

use crate::lab::Lab;

fn periscope(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_periscope")).args(args).current_dir(folder).output().unwrap()
}

/// What was printed. The tiny campaign is too small for some stages of `scene`: their rejects make exit code 3.
fn out(output: &Output) -> String {
    assert!(matches!(output.status.code(), Some(0 | 3)), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout.clone()).unwrap()
}

#[test]
fn the_campaign_alone_is_enough() {
    let lab = Lab::tiny();
    let here = lab.path("");
    let planned = out(&periscope(&here, &["plan", "--campaign", "campaign"]));
    assert!(planned.contains("compute"), "{planned}");
    assert!(!here.join("campaign-results").exists(), "plan makes nothing");
    let run = out(&periscope(&here, &["run", "--campaign", "campaign/"]));
    assert!(run.contains("results: campaign-results") && here.join("campaign-results/patches").exists(), "{run}");
    // From within the campaign the results are the same, and nothing is left to do.
    let again = out(&periscope(&lab.campaign(), &["run", "--campaign", "."]));
    assert!(again.contains("results: ../campaign-results") && !again.contains("computed"), "{again}");
    let named = out(&periscope(&here, &["run", "scene", "--campaign", "campaign"]));
    assert!(!named.contains("computed"), "{named}");
}

#[test]
fn the_programs_pipelines_are_listed_and_printed() {
    let folder = tempfile::tempdir().unwrap();
    let listed = out(&periscope(folder.path(), &["pipelines"]));
    for pipeline in BUILT_IN {
        assert!(listed.lines().any(|line| line.starts_with(pipeline.name) && line.ends_with(pipeline.purpose())));
        assert_eq!(out(&periscope(folder.path(), &["pipelines", pipeline.name])), pipeline.text);
    }
}

/// What `plan --resolved` prints is a pipeline with the same stages, and prints itself.
#[test]
fn a_resolved_pipeline_is_the_same_pipeline() {
    let lab = Lab::tiny();
    let (here, file) = (lab.path(""), lab.path("whole.toml"));
    for pipeline in BUILT_IN {
        let whole = out(&periscope(&here, &["plan", pipeline.name, "--resolved"]));
        fs::write(&file, &whole).unwrap();
        assert!(!whole.contains("base ="), "{whole}");
        assert_eq!(out(&periscope(&here, &["plan", "whole.toml", "--resolved"])), whole);
        let (a, b) = (Spec::load(Path::new(pipeline.name), &[]).unwrap(), Spec::load(&file, &[]).unwrap());
        let stages = |spec: &Spec| -> Vec<_> {
            let facts = spec.steps.iter().map(|step| {
                let params = step.node.params().unwrap();
                (step.heading.clone(), step.node.kind(), params, step.from.clone(), step.with.clone(), step.keep)
            });
            facts.collect()
        };
        assert_eq!(stages(&a), stages(&b), "{}", pipeline.name);
    }
    let changed =
        ["plan", "all-visible", "--resolved", "--set", "onsets.threshold_sigma=6", "--set", "paper.keep=false"];
    let changed = out(&periscope(&here, &changed));
    assert!(changed.contains("threshold_sigma = 6 }") && changed.contains("keep = false"), "{changed}");
}

/// A file with a base and the same file written out share all results; so does a name with its file.
#[test]
fn lineages_do_not_know_of_bases() {
    let lab = Lab::tiny();
    let file = |name: &str, text: &str| fs::write(lab.path(name), text).unwrap();
    fs::create_dir(lab.path("more")).unwrap();
    file("first.toml", "base = 'all-visible'\nwithout = ['paper']\n[onsets]\nparams = { threshold_sigma = 6.0 }\n");
    file(
        "more/second.toml",
        "base = '../first.toml'\n[profiles]\nparams = { shots_min = 12 }\n[traces]\nkeep = false\n",
    );
    file("whole.toml", &out(&periscope(&lab.path(""), &["plan", "more/second.toml", "--resolved"])));
    let campaigns = [Campaign::load(&lab.campaign()).unwrap()];
    let recipes = |name: &str| -> Vec<(String, Digest)> {
        let spec = Spec::load(&lab.path(name), &[]).unwrap();
        let shelf = Shelf::imagine(&lab.path("out"));
        let plan = Plan::new(&spec, &campaigns, &shelf, None).unwrap();
        let recipes = plan.tables.iter().map(|table| table.id.recipe());
        spec.steps.iter().map(|step| step.heading.clone()).zip(recipes).collect()
    };
    assert_eq!(recipes("more/second.toml"), recipes("whole.toml"));
    assert!(recipes("whole.toml").iter().all(|(heading, _)| heading != "paper"));
    assert_ne!(recipes("first.toml"), recipes("more/second.toml"));
    let definition = Definition::load(&Reference::new(&lab.path("more/second.toml"), Path::new("")).unwrap()).unwrap();
    lab.run("out", &definition.to_toml(), &Settings::default()).unwrap();
    let planned =
        out(&periscope(&lab.path(""), &["plan", "more/second.toml", "--campaign", "campaign", "--out", "out"]));
    assert!(!planned.contains("compute"), "{planned}");
}

/// What is wrong with a base, and where: (files, words of the answer).
#[test]
fn faults_name_the_file_of_their_key() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |files: &[(&str, &str)]| {
        files.iter().for_each(|(name, text)| fs::write(folder.path().join(name), text).unwrap());
        let output = periscope(folder.path(), &["plan", files[0].0, "--resolved"]);
        assert_eq!(output.status.code(), Some(1));
        String::from_utf8(output.stderr).unwrap()
    };
    let base = "base = 'all-visible'\n";
    for (files, words) in [
        (&[("a.toml", "base = 'b.toml'"), ("b.toml", "base = 'a.toml'")][..], &["a.toml has the base b.toml has"][..]),
        (&[("a.toml", "base = './a.toml'")], &["it is its own base"]),
        (&[("a.toml", "base = 'mirorr'")], &["a.toml: base = \"mirorr\"", "did you mean `mirror`?"]),
        (&[("a.toml", "base = 'visible'")], &["a.toml: base = \"visible\"", "`visible` is now part of `scene`"]),
        (&[("a.toml", "base = 'gone.toml'")], &["a.toml: base = \"gone.toml\"", "cannot read"]),
        (&[("a.toml", "base = 3")], &["a.toml: base = 3", "in quotes"]),
        (&[("a.toml", "without = ['x']\n[x]\nstage = 'ingest'")], &["a.toml: `without`", "no `base`"]),
        (&[("a.toml", &format!("{base}without = ['papers']"))], &["a.toml", "did you mean `paper`?"]),
        (&[("a.toml", &format!("{base}without = ['session']"))], &["without = [\"session\"]", "[stir] needs it"]),
        (&[("a.toml", &format!("{base}[onset]\nfrom = 'x'"))], &["a.toml: [onset]", "did you mean `onsets`?"]),
        (
            &[
                ("a.toml", "base = 'b.toml'\n[stir]\nkeep = false"),
                ("b.toml", &format!("{base}[onsets]\nparams = {{ fraction = 7 }}")),
            ],
            &["b.toml: [onsets]: params.fraction = 7"],
        ),
        (
            &[("a.toml", "base = 'b.toml'\n[onsets]\nfrom = 'profiles'"), ("b.toml", base)],
            &["a.toml: [onsets]: from = \"profiles\"", "a table `stir` is needed"],
        ),
        (
            &[("a.toml", "base = 'b.toml'"), ("b.toml", &format!("{base}[stir]\nwith = {{ sesion = 'session' }}"))],
            &["b.toml: [stir]", "did you mean `session`?"],
        ),
        (&[("a.toml", "base = 'b.toml'"), ("b.toml", "[x")], &["b.toml: TOML parse error"]),
    ] {
        let answer = refused(files);
        assert!(words.iter().all(|word| answer.contains(word)), "{files:?}: {words:?} in\n{answer}");
    }
}

/// Headings that are dropped may be given anew, without the base's parameters.
#[test]
fn a_dropped_heading_may_begin_anew() {
    let text = "base = 'barcode'\nwithout = ['stir']\n[stir]\nstage = 'deconvolve'\nfrom = 'profiles'\nwith = { calibration = 'calibration' }\n";
    let whole = Definition::parse("p", text).unwrap().to_toml();
    assert!(!whole.contains("extent_max_ps") && whole.matches("[stir]").count() == 1, "{whole}");
    assert!(Spec::parse("p", text, &[]).is_ok());
}
