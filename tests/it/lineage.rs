//! Law 2: what enters a table's lineage, and what does not; and that `plan` says so in words.

use std::fs;

use periscope::pipeline::plan::Action;
use periscope::pipeline::run::Settings;
use periscope::tables::{Patch, Profile};

use crate::lab::{ALL_VISIBLE, Lab, chain};

fn action(lab: &Lab, heading: &str, pipeline: &str, set: &[String]) -> (Action, String) {
    let decisions = lab.plan("out", pipeline, set);
    let decision = decisions.into_iter().find(|decision| decision.heading == heading).unwrap();
    (decision.action, decision.why)
}

#[test]
fn a_run_with_nothing_to_do_computes_nothing() {
    let lab = Lab::tiny();
    let first = lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    assert!(first.computed.len() >= 10, "{:?}", first.computed);
    let before = lab.parts("out");
    let second = lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    assert!(second.computed.is_empty(), "{:?}", second.computed);
    assert_eq!(second.tables.keys().collect::<Vec<_>>(), first.tables.keys().collect::<Vec<_>>());
    assert_eq!(lab.parts("out"), before);
}

#[test]
fn a_cosmetic_edit_changes_nothing_and_a_parameter_is_named() {
    let lab = Lab::tiny();
    lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    let cosmetic = format!("# another comment\n{}", ALL_VISIBLE.replace(" = ", "  =  "));
    assert_eq!(action(&lab, "onsets", &cosmetic, &[]).0, Action::Reuse);
    let set = ["onsets.threshold_sigma=6.0".to_owned()];
    let (what, why) = action(&lab, "onsets", ALL_VISIBLE, &set);
    assert_eq!((what, why.as_str()), (Action::Compute, "threshold_sigma 5.0 -> 6.0"));
    assert_eq!(action(&lab, "profiles", ALL_VISIBLE, &set).0, Action::Reuse);
    let (what, why) = action(&lab, "labels", ALL_VISIBLE, &set);
    assert_eq!((what, why.as_str()), (Action::Compute, "input changed: onsets"));
    let outcome = lab.run_with("out", ALL_VISIBLE, &set, &Settings::default()).unwrap();
    assert!(!outcome.computed.contains(&"profiles".to_owned()) && outcome.computed.contains(&"onsets".to_owned()));
}

#[test]
fn only_campaign_fields_that_a_stage_reads_matter_to_it() {
    let lab = Lab::tiny();
    lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    let path = lab.campaign().join("campaign.toml");
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.replace("[patches.1]\n", "[patches.1]\nposition_m = [-0.6, -0.3, 0.8]\n")).unwrap();
    // `range` reads which patches are anchors, and with it all behind it.
    for reused in ["calibration", "profiles", "onsets", "labels"] {
        assert_eq!(action(&lab, reused, ALL_VISIBLE, &[]).0, Action::Reuse, "{reused}");
    }
    for computed in ["distances", "start"] {
        assert_eq!(action(&lab, computed, ALL_VISIBLE, &[]).0, Action::Compute, "{computed}");
    }
    fs::write(&path, text.replace("group_index = 1.000277", "group_index = 1.33")).unwrap();
    assert_eq!(action(&lab, "traces", ALL_VISIBLE, &[]).0, Action::Reuse);
    let (what, why) = action(&lab, "calibration", ALL_VISIBLE, &[]);
    assert_eq!(what, Action::Compute);
    assert!(why.contains("group_index") && why.contains("1.33"), "{why}");
}

#[test]
fn a_changed_raw_file_is_refused_by_name() {
    let lab = Lab::tiny();
    lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    let raw = lab.campaign().join("raw/scene");
    let file = fs::read_dir(raw).unwrap().flatten().map(|entry| entry.path()).min().unwrap();
    let mut bytes = fs::read(&file).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    fs::write(&file, bytes).unwrap();
    let error = chain(lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap_err());
    assert!(error.contains(file.file_name().unwrap().to_str().unwrap()) && error.contains("changed"), "{error}");
}

#[test]
fn a_touched_file_with_the_same_content_changes_nothing() {
    let lab = Lab::tiny();
    lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    let raw = lab.campaign().join("raw/scene");
    for entry in fs::read_dir(raw).unwrap().flatten() {
        let bytes = fs::read(entry.path()).unwrap();
        fs::write(entry.path(), bytes).unwrap();
    }
    let again = lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    assert!(again.computed.is_empty(), "{:?}", again.computed);
}

#[test]
fn keeping_or_not_keeping_a_table_changes_no_other() {
    let lab = Lab::tiny();
    let kept = lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    let set = ["traces.keep=false".to_owned(), "stir.keep=false".to_owned()];
    let lean = lab.run_with("lean", ALL_VISIBLE, &set, &Settings::default()).unwrap();
    assert!(!lean.tables.contains_key("traces") && !lab.path("lean/traces").exists());
    for heading in ["profiles", "onsets", "patches"] {
        assert_eq!(lean.tables[heading], kept.tables[heading], "{heading}");
    }
    assert_eq!(lab.rows::<Patch>("out", "patches"), lab.rows::<Patch>("lean", "patches"));
    assert_eq!(lab.rows::<Profile>("out", "profiles"), lab.rows::<Profile>("lean", "profiles"));
    let again = lab.run_with("lean", ALL_VISIBLE, &set, &Settings::default()).unwrap();
    assert!(again.computed.is_empty(), "{:?}", again.computed);
}

#[test]
fn until_stops_after_a_table() {
    use periscope::campaign::Campaign;
    use periscope::pipeline::plan::Plan;
    use periscope::pipeline::spec::Spec;
    use periscope::store::Shelf;
    let lab = Lab::tiny();
    let spec = Spec::parse("test", ALL_VISIBLE, &[]).unwrap();
    let campaigns = [Campaign::load(&lab.campaign()).unwrap()];
    let shelf = Shelf::imagine(&lab.path("out"));
    let plan = Plan::new(&spec, &campaigns, &shelf, Some("profiles")).unwrap();
    let wanted: Vec<&str> =
        (0..spec.steps.len()).filter(|&i| plan.tables[i].wanted).map(|i| spec.steps[i].heading.as_str()).collect();
    assert_eq!(wanted, ["calibration_traces", "calibration", "traces", "profiles"]);
    let error = Plan::new(&spec, &campaigns, &shelf, Some("profile")).err().unwrap().to_string();
    assert!(error.contains("profiles"), "{error}");
}
