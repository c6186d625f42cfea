//! Several campaigns of one scene in one analysis: sessions of different days.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use periscope::campaign::Campaign;
use periscope::pipeline::plan::Plan;
use periscope::pipeline::progress::{Progress, Style};
use periscope::pipeline::run::{self, Settings};
use periscope::pipeline::spec::Spec;
use periscope::simulate::{self, Format, Scene};
use periscope::store::Shelf;
use periscope::tables::{Onset, Patch, Profile, Row};

use crate::lab::{ALL_VISIBLE, TINY};

/// A session of the tiny scene, on a day with its own noise.
fn session(folder: &Path, name: &str, seed: u64) -> PathBuf {
    let text = TINY.replacen("name = \"tiny\"", &format!("name = \"{name}\""), 1);
    let scene = Scene::parse(Path::new("scene.toml"), &text).unwrap();
    let root = folder.join(name);
    simulate::simulate(&scene, seed, &root, Format::Trc).unwrap();
    root
}

/// Parts of `traces` that stood before, of how many; then runs what is missing.
fn run(out: &Path, roots: &[PathBuf]) -> (usize, usize) {
    let spec = Spec::parse("test", ALL_VISIBLE, &[]).unwrap();
    let campaigns: Vec<Campaign> = roots.iter().map(|root| Campaign::load(root).unwrap()).collect();
    let shelf = Shelf::open(out).unwrap();
    let mut plan = Plan::new(&spec, &campaigns, &shelf, None).unwrap();
    let traces = plan.decision(spec.position("traces").unwrap()).unwrap();
    run::run(&mut plan, &Settings::default(), &Progress::new(Style::Silent)).unwrap();
    (traces.finished, traces.parts)
}

fn rows<R: Row>(out: &Path, view: &str) -> Vec<R> {
    let batches = Shelf::look(out).unwrap().batches(view).unwrap();
    batches.iter().flat_map(|batch| R::rows(batch).unwrap()).collect()
}

#[test]
fn two_days_make_one_set_of_tables_and_one_set_of_patches() {
    let folder = tempfile::tempdir().unwrap();
    let (one, two) = (folder.path().join("one"), folder.path().join("two"));
    let monday = session(folder.path(), "monday", 1);
    let tuesday = session(folder.path(), "tuesday", 2);
    assert_eq!(run(&one, std::slice::from_ref(&monday)), (0, 1));
    assert_eq!(run(&two, std::slice::from_ref(&monday)), (0, 1));
    assert_eq!(run(&two, &[monday, tuesday]), (1, 2), "raw files of the first day are not read again");

    let days = BTreeSet::from(["monday", "tuesday"]);
    let profiles: Vec<Profile> = rows(&two, "profiles");
    assert_eq!(profiles.iter().map(|row| &*row.campaign).collect::<BTreeSet<&str>>(), days);
    let onsets: Vec<Onset> = rows(&two, "onsets");
    assert_eq!(onsets.iter().map(|row| &*row.campaign).collect::<BTreeSet<&str>>(), days);

    let (alone, together): (Vec<Patch>, Vec<Patch>) = (rows(&one, "patches"), rows(&two, "patches"));
    assert_eq!(alone.len(), 4);
    assert_eq!(together.iter().map(|row| row.patch).collect::<Vec<_>>(), [1, 2, 3, 4]);
    for (alone, together) in alone.iter().zip(&together) {
        let (alone_m, together_m) = (alone.sd_m.unwrap(), together.sd_m.unwrap());
        // Twice the onsets; what days have in common, such as the response's path, does not average out.
        assert!(together_m < 0.95 * alone_m && together_m > 0.6 * alone_m, "{alone_m} {together_m}");
        let apart_m = (alone.x_m - together.x_m).hypot(alone.y_m - together.y_m).hypot(alone.z_m - together.z_m);
        assert!(apart_m < 4.0 * alone_m, "{apart_m} {alone_m}");
    }
}
