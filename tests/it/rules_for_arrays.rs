//! What a rule says about files that do not say it: units of a text, the array of a file and its axes.

use std::fs;
use std::path::Path;
use std::process::Command;

use periscope::campaign::Campaign;
use periscope::formats::array::{Array, Arrays};
use periscope::formats::hdf5;
use periscope::pipeline::plan::Plan;
use periscope::pipeline::progress::{Progress, Style};
use periscope::pipeline::run::{self, Settings};
use periscope::pipeline::spec::Spec;
use periscope::store::Shelf;
use periscope::tables::{Reject, Row, Trace};

/// Codes in the table, so that they can be looked at.
const TRACES: &str = "[traces]\nstage = 'ingest'\nparams = { codes = 'none' }\n";

/// A campaign of one sensor with these rules, and the rows of `traces` and `rejects` that it gives.
fn ingest(folder: &Path, kind: &str, rules: &str) -> (Vec<Trace>, Vec<Reject>) {
    let text = format!("[campaign]\nname = 'c'\n[sensors.s1]\nkind = '{kind}'\n{rules}");
    fs::write(folder.join("campaign.toml"), text).unwrap();
    let campaigns = [Campaign::load(folder).unwrap()];
    let spec = Spec::parse("test", TRACES, &[]).unwrap();
    let out = tempfile::tempdir().unwrap();
    let shelf = Shelf::open(out.path()).unwrap();
    let mut plan = Plan::new(&spec, &campaigns, &shelf, None).unwrap();
    run::run(&mut plan, &Settings::default(), &Progress::new(Style::Silent)).unwrap();
    (rows(out.path(), "traces"), rows(out.path(), "rejects"))
}

fn rows<R: Row>(out: &Path, view: &str) -> Vec<R> {
    let batches = Shelf::look(out).unwrap().batches(view).unwrap();
    batches.iter().flat_map(|batch| R::rows(batch).unwrap()).collect()
}

fn numbers(row: &Trace) -> Vec<f64> {
    row.codes.as_ref().unwrap().chunks_exact(8).map(|code| f64::from_le_bytes(code.try_into().unwrap())).collect()
}

fn load(folder: &Path, rule: &str) -> String {
    let text = format!("[campaign]\nname = 'c'\n[sensors.s1]\n[[captures]]\nrole = 'dark'\nfiles = 'a.csv'\n{rule}\n");
    fs::write(folder.join("campaign.toml"), text).unwrap();
    Campaign::load(folder).unwrap_err().to_string()
}

#[test]
fn a_rule_gives_the_units_that_headings_lack() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("L1_P2.csv"), "time,level\n0,3\n0.5,4\n1,5\n").unwrap();
    let rule = "[[captures]]\nrole = 'scene'\nfiles = 'L{lit}_P{seen}.csv'\n";
    let (traces, rejects) = ingest(folder.path(), "analog", rule);
    assert!(traces.is_empty() && rejects[0].reason.contains("give time_unit, such as \"ns\""), "{rejects:?}");
    let (traces, rejects) = ingest(folder.path(), "analog", &format!("{rule}unit = 'mV'\ntime_unit = 'ns'\n"));
    assert!(rejects.is_empty(), "{rejects:?}");
    assert!((traces[0].dt_ps - 500.0).abs() < 1e-9 && (traces[0].t0_ps, traces[0].gain_v) == (0.0, 1.0));
    assert_eq!(numbers(&traces[0]), [0.003, 0.004, 0.005]);
    let (traces, rejects) = ingest(folder.path(), "counts", &format!("{rule}unit = 'photons'\ntime_unit = 'ns'\n"));
    assert!(rejects.is_empty() && numbers(&traces[0]) == [3.0, 4.0, 5.0], "{rejects:?}");
    // A heading that says otherwise.
    fs::write(folder.path().join("L1_P2.csv"), "time_ns,level (V)\n0,3\n0.5,4\n1,5\n").unwrap();
    let (_, rejects) = ingest(folder.path(), "analog", &format!("{rule}unit = 'mV'\n"));
    assert!(rejects[0].reason.contains("`unit` = \"mV\" contradicts the heading of level"), "{rejects:?}");
}

/// Segments count the records of the rule's channel, whatever else the file holds.
#[test]
fn segments_of_another_channel_do_not_count() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("a.csv"), "time_ns,a (V),b (V)\n0,1,5\n1,2,6\n").unwrap();
    let rule = "[[captures]]\nrole = 'scene'\nfiles = 'a.csv'\nlit = 3\nchannel = 'b'\nsegments = 'seen'\n";
    let (traces, rejects) = ingest(folder.path(), "analog", rule);
    assert!(rejects.is_empty(), "{rejects:?}");
    let rows: Vec<_> = traces.iter().map(|row| (row.seen, row.channel.as_deref(), numbers(row))).collect();
    assert_eq!(rows, [(1, Some("b"), vec![5.0, 6.0])]);
}

#[test]
fn inspect_names_the_keys_that_a_text_without_units_needs() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("a.csv"), "time,level\n0,3\n0.5,4\n1,5\n").unwrap();
    let inspect = |args: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_periscope"))
            .args(["inspect", "a.csv"])
            .args(args)
            .current_dir(folder.path())
            .output();
        String::from_utf8(output.unwrap().stdout).unwrap()
    };
    let printed = inspect(&[]);
    assert!(printed.contains("no unit of values: give `unit`") && printed.contains("`time_unit`"), "{printed}");
    let printed = inspect(&["--unit", "mV", "--time-unit", "ns"]);
    assert!(!printed.contains("no unit") && printed.contains("dt 500 ps") && printed.contains("5 mV"), "{printed}");
}

#[test]
fn units_and_axes_are_checked_before_any_file_is_read() {
    let folder = tempfile::tempdir().unwrap();
    for (rule, says) in [
        ("unit = 'ns'", "`unit` = \"ns\" is no unit of values"),
        ("time_unit = 'V'", "`time_unit` = \"V\" is no unit of times"),
        ("unit = 'V'\ngain_v = 1.0", "give one of them"),
        ("variable = 'x'\nchannel = 'C1'", "give one of them"),
        ("marker = 5", "inputs 1 to 4"),
        ("pixels = 8", "give the marker"),
        ("marker = 1\npixels = 0", "one or more"),
        ("bin_ps = 0", "bin_ps"),
        ("axes = ['time', 'shots']", "did you mean `shot`?"),
        ("axes = ['shot', 'lit']", "has no \"time\""),
        ("axes = ['time', 'shot']\nsegments = ['lit', 'shot']", "give one of them"),
    ] {
        let error = load(folder.path(), rule);
        assert!(error.contains("[[captures]] number 1") && error.contains(says), "{rule}: {error}");
    }
}

/// Two arrays of one file, each with a rule of its own; the samples of one lie on its first axis.
#[test]
fn rules_name_arrays_and_axes() {
    let folder = tempfile::tempdir().unwrap();
    let number = |lit: usize, shot: usize, sample: usize| (100 * lit + 10 * shot + sample) as f64;
    let samples_first: Vec<f64> = (0..24).map(|n| number(n % 2, n / 2 % 3, n / 6)).collect();
    let samples_last: Vec<f64> = (0..8).map(f64::from).collect();
    let arrays = [("waves", Array::of(&[4, 3, 2], &samples_first)), ("dark", Array::of(&[2, 4], &samples_last))];
    let arrays: Arrays = arrays.into_iter().map(|(name, array)| (name.to_owned(), array)).collect();
    hdf5::write(&mut fs::File::create(folder.path().join("a.h5")).unwrap(), &arrays).unwrap();
    let scale = "dt_ps = 50\nt0_ps = 0\ngain_v = 1\n";
    let scene = format!(
        "[[captures]]\nrole = 'scene'\nfiles = 'a.h5'\nseen = 7\nvariable = 'waves'\naxes = ['time', 'shot', 'lit']\n{scale}"
    );
    let dark = format!("[[captures]]\nrole = 'dark'\nfiles = 'a.h5'\nvariable = 'dark'\n{scale}");
    let (traces, rejects) = ingest(folder.path(), "analog", &format!("{scene}{dark}"));
    assert!(rejects.is_empty(), "{rejects:?}");
    let key = |row: &Trace| (row.lit, row.seen, row.shot);
    let keys: Vec<_> = traces.iter().map(key).collect();
    assert_eq!(keys, [(1, 7, 0), (1, 7, 1), (1, 7, 2), (2, 7, 0), (2, 7, 1), (2, 7, 2)]);
    for row in &traces {
        let expected: Vec<f64> = (0..4).map(|sample| number(row.lit as usize - 1, row.shot as usize, sample)).collect();
        assert_eq!(numbers(row), expected);
    }
    let (_, rejects) = ingest(folder.path(), "analog", &scene.replace("'waves'", "'wave'"));
    assert!(rejects[0].reason.contains("`variable` = \"wave\" is not in this file; it has dark, waves"), "{rejects:?}");
}
