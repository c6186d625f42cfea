//! Laws 5 and 10: what is bad, and what becomes of it. Each message must name the place and the fix.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use periscope::campaign::Campaign;
use periscope::pipeline::plan::Plan;
use periscope::pipeline::progress::{Progress, Style};
use periscope::pipeline::run::{self, RunError, Settings};
use periscope::pipeline::spec::{Spec, Step};
use periscope::simulate::Format;
use periscope::stages::Node;
use periscope::stages::stage::{Apply, BesideTables, Grain, Outcome, Stage, StageError};
use periscope::store::Shelf;
use periscope::tables::{Distance, Patch, Profile, Reject, Stir};

use crate::lab::{ALL_VISIBLE, Lab, TINY, chain};

fn rejects(lab: &Lab) -> Vec<String> {
    lab.rows::<Reject>("out", "rejects")
        .into_iter()
        .map(|row| format!("{} {} {}", row.stage, row.file.unwrap_or_default(), row.reason))
        .collect()
}

fn warnings(lab: &Lab) -> String {
    let spec = Spec::parse("test", ALL_VISIBLE, &[]).unwrap();
    let campaigns = [Campaign::load(&lab.campaign()).unwrap()];
    let shelf = Shelf::imagine(&lab.path("out"));
    Plan::new(&spec, &campaigns, &shelf, None)
        .unwrap()
        .left_out()
        .iter()
        .map(ToString::to_string)
        .collect::<Vec<_>>()
        .join("\n")
}

fn edit(path: &Path, from: &str, to: &str) {
    let text = fs::read_to_string(path).unwrap();
    assert!(text.contains(from), "{from} is not in {}", path.display());
    fs::write(path, text.replacen(from, to, 1)).unwrap();
}

#[test]
fn a_pattern_without_files_and_files_without_a_rule_are_listed_and_the_run_goes_on() {
    let lab = Lab::tiny();
    fs::write(lab.campaign().join("raw/notes.txt"), "shutter was slow").unwrap();
    let path = lab.campaign().join("campaign.toml");
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text + "[[captures]]\nrole = \"dark\"\nfiles = \"raw/dark/*.trc\"\nsensor = \"s1\"\n").unwrap();
    let warnings = warnings(&lab);
    assert!(warnings.contains("raw/dark/*.trc") && warnings.contains("matches no file"), "{warnings}");
    assert!(warnings.contains("raw/notes.txt") && warnings.contains("matches no rule"), "{warnings}");
    assert_eq!(lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap().tables["patches"].rows("patches"), 4);
}

#[test]
fn truncated_and_foreign_files_are_rejected_by_name_and_the_rest_goes_on() {
    let lab = Lab::tiny();
    let scene = lab.campaign().join("raw/scene");
    let bytes = fs::read(scene.join("s1_L1_P2_C1.trc")).unwrap();
    fs::write(scene.join("s1_L1_P2_C1.trc"), &bytes[..bytes.len() / 2]).unwrap();
    fs::write(scene.join("s1_L2_P3_C1.trc"), "this is no oscilloscope file").unwrap();
    fs::write(scene.join("s1_L3_P1_C2.trc"), "").unwrap();
    let outcome = lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    assert_eq!(outcome.tables["patches"].rows("patches"), 4);
    assert_eq!(outcome.tables["profiles"].rows("profiles"), 13);
    let rejects = rejects(&lab);
    let about = |file: &str, text: &str| rejects.iter().any(|row| row.contains(file) && row.contains(text));
    assert!(about("s1_L1_P2_C1.trc", "copy it from the instrument again"), "{rejects:#?}");
    assert!(about("s1_L2_P3_C1.trc", "this is no LeCroy waveform"), "{rejects:#?}");
    assert!(about("s1_L3_P1_C2.trc", "is empty"), "{rejects:#?}");
    // The same bad files a second time: nothing is computed, and they are still reported.
    let again = lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    assert!(again.computed.is_empty() && again.rejects == outcome.rejects, "{:?}", again.computed);
    // They are reported also where the traces themselves are not kept, in the first run and in the second.
    for _ in 0..2 {
        let unkept =
            lab.run_with("unkept", ALL_VISIBLE, &["traces.keep=false".to_owned()], &Settings::default()).unwrap();
        assert_eq!(unkept.rejects, outcome.rejects);
    }
}

#[test]
fn a_missing_reference_file_is_reported_and_its_capture_left_out() {
    let lab = Lab::tiny();
    fs::remove_file(lab.campaign().join("raw/scene/s1_L1_P2_C2.trc")).unwrap();
    let warnings = warnings(&lab);
    assert!(warnings.contains("s1_L1_P2_C1.trc") && warnings.contains("reference is missing"), "{warnings}");
    let outcome = lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    assert_eq!(outcome.tables["profiles"].rows("profiles"), 15);
}

#[test]
fn a_capture_with_no_valid_shot_is_rejected() {
    let lab = Lab::tiny();
    // The reference channel of one capture holds no pulse: codes of a constant.
    let path = lab.campaign().join("raw/scene/s1_L2_P2_C2.trc");
    let mut bytes = fs::read(&path).unwrap();
    let data = bytes.len() - 24 * 320;
    bytes[data..].fill(7);
    fs::write(&path, bytes).unwrap();
    lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    let rejects = rejects(&lab);
    assert!(
        rejects.iter().any(|row| row.contains("lit 2, seen 2") && row.contains("0 valid shots of the 16")),
        "{rejects:#?}"
    );
}

/// What a sample of the captures sets aside is told by the work that has them all.
#[test]
fn a_fault_in_a_sample_is_reported_once() {
    let lab = Lab::tiny();
    let path = lab.campaign().join("raw/scene/s1_L1_P2_C1.trc");
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    let sample = "[sample]\nstage = 'ingest'\nparams = { captures_max = 3 }\n\
        [sampled]\nstage = 'average'\nfrom = 'sample'\nwith = { calibration = 'calibration' }\n";
    let outcome = lab.run("out", &format!("{ALL_VISIBLE}{sample}"), &Settings::default()).unwrap();
    let told = rejects(&lab);
    let by_whole = told.iter().filter(|row| row.starts_with("traces ") || row.starts_with("profiles "));
    assert!(by_whole.count() == told.len() && outcome.rejects == told.len() as u64 && told.len() == 2, "{told:#?}");
    assert_eq!(outcome.tables["sampled"].rows("profiles"), 3);
    // Alone, it tells.
    let (calibration, _) = ALL_VISIBLE.split_once("[session_traces]").unwrap();
    let outcome = lab.run("alone", &format!("{calibration}{sample}"), &Settings::default()).unwrap();
    assert_eq!(outcome.rejects, 1);
}

/// The one sensor, 30 cm from the laser.
const ASIDE: &str = "[stations.aside]\nposition_m = [0.3, 0.0, 0.0]\n[sensors.s1]\nstation = 'aside'\n";

/// With a second sensor 30 cm away, distances come only from the first, and the table of rejects says so. With the
/// second alone there are none.
#[test]
fn distances_are_those_of_sensors_at_the_laser() {
    let aside = |sensors: &str| {
        let stations = format!("[stations.aside]\nposition_m = [0.3, 0.0, 0.0]\n{sensors}");
        Lab::of(&TINY.replace("[sensors.s1]\n", &stations), 1, Format::Trc)
    };
    let (pipeline, _) = ALL_VISIBLE.split_once("[patches]").unwrap();
    let lab = aside("[sensors.s2]\nstation = 'aside'\nlatency_ps = 900.0\n[sensors.s1]\n");
    let outcome = lab.run("out", pipeline, &Settings::default()).unwrap();
    assert_eq!((outcome.tables["labels"].rows("labels"), outcome.tables["start"].rows("patches")), (32, 4));
    let distances: Vec<Distance> = lab.rows("out", "distances");
    assert_eq!(distances.iter().map(|row| row.onsets).sum::<i32>(), 4 + 6 * 4);
    let rejects = rejects(&lab);
    let of_range: Vec<&String> = rejects.iter().filter(|row| row.starts_with("distances ")).collect();
    assert!(of_range.len() == 1 && of_range[0].contains("sensor s2 stands apart from the laser"), "{rejects:#?}");
    let refused =
        chain(aside("[sensors.s1]\nstation = 'aside'\n").run("out", pipeline, &Settings::default()).unwrap_err());
    assert!(refused.contains("`s1`") && refused.contains("leave out `range` and `embed`"), "{refused}");
}

/// `scene` places patches from path lengths, so that no sensor has to stand at the laser.
#[test]
fn scene_solves_for_sensors_apart_from_the_laser() {
    let lab = Lab::of(&TINY.replace("[sensors.s1]\n", ASIDE), 1, Format::Trc);
    let scene = include_str!("../../pipelines/scene.toml");
    let outcome = lab.run("out", scene, &Settings::default()).unwrap();
    assert_eq!(outcome.tables["patches"].rows("patches"), 4);
    assert!(rejects(&lab).is_empty(), "{:#?}", rejects(&lab));
}

#[test]
fn a_campaign_without_response_captures_is_refused() {
    let lab = Lab::tiny();
    fs::remove_dir_all(lab.campaign().join("raw/response")).unwrap();
    let error = chain(lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap_err());
    assert!(error.contains("campaign.toml: no file shows the impulse response of sensor `s1`"), "{error}");
    assert!(error.contains("[stir]") && !lab.path("out").join("profiles").exists(), "{error}");
}

#[test]
fn a_patch_seen_by_no_capture_is_reported_with_its_fix() {
    let lab = Lab::tiny();
    edit(&lab.campaign().join("campaign.toml"), "[patches.4]\n", "[patches.9]\nrole = \"visible\"\n[patches.4]\n");
    lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    let rejects = rejects(&lab);
    assert!(
        rejects.iter().any(|row| row.contains("patch 9") && row.contains("capture lit 9, seen 9, or take it out")),
        "{rejects:#?}"
    );
}

#[test]
fn unknown_keys_are_refused_with_the_nearest_known_one() {
    let lab = Lab::tiny();
    let refused = |text: &str, set: &[&str]| {
        let set: Vec<String> = set.iter().map(|set| (*set).to_owned()).collect();
        chain(Spec::parse("all-visible.toml", text, &set).err().expect("is refused"))
    };
    let pipeline = |from: &str, to: &str| {
        assert!(ALL_VISIBLE.contains(from));
        refused(&ALL_VISIBLE.replacen(from, to, 1), &[])
    };
    let error = pipeline("threshold_sigma", "threshold_sigmas");
    assert!(error.contains("[onsets]") && error.contains("did you mean `threshold_sigma`?"), "{error}");
    let error = pipeline("stage = \"detect\"", "stage = \"detct\"");
    assert!(error.contains("did you mean `detect`?"), "{error}");
    let error = pipeline("from = \"stir\"", "form = \"stir\"");
    assert!(error.contains("[onsets]") && error.contains("did you mean `from`?"), "{error}");
    let error = pipeline("from = \"stir\"", "from = \"profiles\"");
    assert!(error.contains("makes a table `profiles`, but a table `stir` is needed"), "{error}");
    let error = refused(ALL_VISIBLE, &["onset.threshold_sigma=6"]);
    assert!(error.contains("did you mean `onsets`?"), "{error}");
    edit(&lab.campaign().join("campaign.toml"), "role = \"scene\"", "rolle = \"scene\"");
    let error = chain(Campaign::load(&lab.campaign()).unwrap_err());
    assert!(error.contains("campaign.toml, line") && error.contains("did you mean `role`?"), "{error}");
}

#[test]
fn a_stage_that_cannot_go_on_names_itself_and_what_stood_stays() {
    let lab = Lab::tiny();
    let set = ["labels.bounces=4".to_owned()];
    let error = chain(lab.run_with("out", ALL_VISIBLE, &set, &Settings::default()).unwrap_err());
    assert!(error.contains("[labels]") && error.contains("must be at most 3 without `patches`"), "{error}");
    assert!(lab.path("out/onsets").exists() && !lab.path("out/labels").exists() && !lab.path("out/patches").exists());
    let before = lab.parts("out");
    let outcome = lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    // The period enters the profiles, and what was read from files does not depend on it.
    assert!(!outcome.computed.contains(&"traces".to_owned()), "{:?}", outcome.computed);
    let after = lab.parts("out");
    assert!(before.iter().all(|(file, digest)| after[file] == *digest));
}

/// A stage that breaks on one capture.
#[derive(serde::Serialize)]
struct Breaks;

impl Stage for Breaks {
    const KIND: &'static str = "deconvolve";
    const VERSION: u32 = 99;
    const GRAIN: Grain = Grain::Capture;
    type Input = Profile;
    type Output = Stir;
    type Fields = ();
    type Context = ();
    fn fields(&self, _: &[Campaign]) {}
    fn context(&self, (): (), _: &BesideTables) -> Result<(), StageError> {
        Ok(())
    }
}

impl Apply for Breaks {
    fn apply(&self, (): &(), group: Vec<Profile>) -> Result<Outcome<Stir>, StageError> {
        assert!(group[0].lit != 3, "a kernel was called with lengths that do not match");
        Ok(Outcome::rows(Vec::new()))
    }
}

#[test]
fn a_panic_in_a_stage_is_that_stages_error_and_not_a_hang() {
    let lab = Lab::tiny();
    let mut spec = Spec::parse("test", ALL_VISIBLE, &[]).unwrap();
    let at = spec.position("stir").unwrap();
    let step = &spec.steps[at];
    spec.steps[at] = Step {
        node: Node::Operator(Box::new(Breaks)),
        heading: step.heading.clone(),
        from: step.from.clone(),
        with: BTreeMap::new(),
        keep: true,
    };
    let campaigns = [Campaign::load(&lab.campaign()).unwrap()];
    let shelf = Shelf::open(&lab.path("out")).unwrap();
    let mut plan = Plan::new(&spec, &campaigns, &shelf, None).unwrap();
    let error = run::run(&mut plan, &Settings::default(), &Progress::new(Style::Silent)).unwrap_err();
    assert!(
        matches!(&error, RunError::Panic { heading, message } if heading == "stir" && message.contains("lengths that do not match")),
        "{error}"
    );
    assert!(!lab.path("out/stir").exists() && !lab.path("out/onsets").exists());
    drop(plan);
    drop(shelf);
    // The folder is as good as before: the right pipeline runs into it.
    assert_eq!(lab.rows_of_patches("out"), 4);
}

#[test]
fn a_second_run_at_the_same_time_is_refused_and_a_foreign_folder_too() {
    let lab = Lab::tiny();
    let held = Shelf::open(&lab.path("out")).unwrap();
    let error = chain(lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap_err());
    assert!(error.contains("another run is writing to") && error.contains("choose another --out"), "{error}");
    drop(held);
    assert_eq!(lab.rows_of_patches("out"), 4);
    fs::create_dir_all(lab.path("photos")).unwrap();
    fs::write(lab.path("photos/cat.jpg"), "meow").unwrap();
    let error = chain(lab.run("photos", ALL_VISIBLE, &Settings::default()).unwrap_err());
    assert!(error.contains("no result folder") && error.contains("choose another --out"), "{error}");
}

fn periscope(lab: &Lab, limit_blocks: Option<u32>, args: &[&str]) -> Output {
    let binary = env!("CARGO_BIN_EXE_periscope");
    let mut command = match limit_blocks {
        None => Command::new(binary),
        // A limit on the size of a file makes a write fail like a full disk, if the signal that comes with it is
        // ignored.
        Some(blocks) => {
            let mut shell = Command::new("sh");
            shell.arg("-c").arg(format!("trap '' XFSZ; ulimit -f {blocks}; exec \"$0\" \"$@\"")).arg(binary);
            shell
        }
    };
    command.args(args).current_dir(lab.path("")).output().unwrap()
}

#[test]
fn a_full_disk_stops_the_run_with_its_fix_and_the_next_run_goes_on_from_there() {
    let lab = Lab::tiny();
    fs::write(lab.path("p.toml"), ALL_VISIBLE).unwrap();
    // An archive, which is the largest file.
    let set = ["--set", "calibration_traces.codes='none'"];
    let args = [&["run", "p.toml", "--campaign", "campaign", "--out", "out"][..], &set].concat();
    let failed = periscope(&lab, Some(200), &args);
    let text = String::from_utf8_lossy(&failed.stderr);
    assert_eq!(failed.status.code(), Some(1), "{text}");
    assert!(text.contains("free some space and run again: finished parts are kept"), "{text}");
    assert!(!lab.path("out/traces").exists() && !lab.path("out/patches").exists());
    let whole = periscope(&lab, None, &args);
    assert_eq!(whole.status.code(), Some(0), "{}", String::from_utf8_lossy(&whole.stderr));
    assert_eq!(lab.rows::<Patch>("out", "patches").len(), 4);
}
