//! Damage: `verify` finds every flipped bit and locates it. A run or a reader that meets one stops with the same
//! message. What is deleted is made again.
//!
//! The study with many more flips is `cargo bench --bench reliability -- flips`.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use periscope::campaign::{Campaign, Manifest, seal};
use periscope::pipeline::run::Settings;
use periscope::store::damage::{Place, find};
use periscope::store::verify::{Finding, Report, verify};
use periscope::store::{Shelf, parquet};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::lab::{ALL_VISIBLE, Lab, chain};
use crate::manipulations::{MANIPULATIONS, copy, flip, links};

fn periscope(lab: &Lab, args: &[&str]) -> (Option<i32>, String) {
    let Output { status, stdout, stderr } =
        Command::new(env!("CARGO_BIN_EXE_periscope")).args(args).current_dir(lab.path("")).output().unwrap();
    (status.code(), String::from_utf8([stdout, stderr].concat()).unwrap())
}

fn looked(lab: &Lab) -> Report {
    verify(&Shelf::look(&lab.path("out")).unwrap()).unwrap()
}

/// Flips a bit of a raw file as a disk does that decays: what is on record in `notes` still has the file's stamp.
fn decay(campaign: &Path, file: &str, notes: &Path) {
    flip(&campaign.join(file), 8 * 3000);
    let mut manifest = Manifest::load(notes).unwrap().unwrap();
    let recorded = manifest.get(Path::new(file)).unwrap().blake3;
    manifest.record(Path::new(file), recorded, &fs::metadata(campaign.join(file)).unwrap());
    manifest.save(notes).unwrap();
}

/// Files of the shelf whose path contains this; what is linked twice, once.
fn shelf_files(lab: &Lab, part_of_path: &str) -> Vec<PathBuf> {
    let mut folders = vec![lab.path("out/.shelf")];
    let mut files = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap().flatten() {
            let path = entry.path();
            let shown = path.display().to_string();
            if path.is_dir() {
                folders.push(path);
            } else if shown.contains(part_of_path)
                && !shown.ends_with("lock")
                && !(shown.contains("/table-") && shown.ends_with(".parquet"))
            {
                files.push(path);
            }
        }
    }
    files.sort();
    files
}

fn one(lab: &Lab, part_of_path: &str) -> PathBuf {
    shelf_files(lab, part_of_path).swap_remove(0)
}

/// First byte and length of a page of a column of the table `onsets`, whose file this is.
fn page_of(lab: &Lab, file: &Path, column: &str) -> (u64, u64) {
    let (_, record) = Shelf::look(&lab.path("out")).unwrap().recorded("onsets").unwrap().swap_remove(0);
    // Where pages lie is found out by damage: no page is shorter than this.
    for byte in (4..record.bytes).step_by(16) {
        flip(file, 8 * byte);
        let place = find(file, &record).unwrap().unwrap().place;
        flip(file, 8 * byte);
        match place {
            Place::Page(page) if page.column == column => return (page.byte, page.bytes),
            _ => {}
        }
    }
    panic!("no page of {column}");
}

#[test]
fn a_whole_folder_is_found_whole_and_its_lineages_followed() {
    let lab = Lab::tiny();
    lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    let report = looked(&lab);
    assert_eq!(report.findings, []);
    let ingested: usize = report.sources.iter().map(|(_, parts)| parts.len()).sum();
    assert!(report.counts.followed > 8 && report.counts.followed + ingested == report.counts.parts, "{report:?}");
    let (code, text) = periscope(&lab, &["verify", "out", "--campaign", "campaign", "--rehash"]);
    assert_eq!(code, Some(0), "{text}");
    assert!(text.contains("no damage") && text.contains("parts of ingest follow from the raw files"), "{text}");
    assert!(text.contains("raw files of campaign tiny by content"), "{text}");
    // A campaign that is elsewhere is not passed over in silence.
    fs::rename(lab.campaign(), lab.path("moved")).unwrap();
    let (code, text) = periscope(&lab, &["verify", "out", "--campaign", "campaign"]);
    assert!(code == Some(0) && text.contains("RAW FILES WERE NOT CHECKED"), "{text}");
}

#[test]
fn forty_flipped_bits_are_found_and_none_is_read() {
    let lab = Lab::tiny();
    lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    let shelf = Shelf::look(&lab.path("out")).unwrap();
    let views: Vec<String> = shelf.tables().unwrap().into_iter().map(|(view, _)| view).collect();
    let read = || -> Result<Vec<_>, String> { views.iter().map(|view| shelf.batches(view).map_err(chain)).collect() };
    let before = read().unwrap();
    let mut files = shelf_files(&lab, "");
    files.retain(|file| fs::metadata(file).unwrap().len() > 0);
    let mut draws = ChaCha8Rng::seed_from_u64(1);
    for _ in 0..40 {
        let file = &files[draws.random_range(0..files.len())];
        let bit = draws.random_range(0..8 * fs::metadata(file).unwrap().len());
        flip(file, bit);
        let notes = Manifest::load(&lab.path("out/.shelf/notes/tiny"));
        assert!(!looked(&lab).findings.is_empty() || notes.is_err(), "{} bit {bit}", file.display());
        // A reader gets an error, or what was written.
        match read() {
            Ok(after) => assert!(after == before, "{} bit {bit}", file.display()),
            Err(error) => assert!(error.contains("damaged"), "{error}"),
        }
        flip(file, bit);
    }
    assert_eq!(looked(&lab).findings, []);
}

#[test]
fn a_damaged_page_is_named_by_all_who_meet_it_and_only_its_part_is_made_again() {
    let lab = Lab::tiny();
    lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    let before = lab.parts("out");
    let file = one(&lab, ".onsets.parquet");
    let (byte, bytes) = page_of(&lab, &file, "time_ps");
    flip(&file, 8 * (byte + bytes - 1));
    let Finding { file: named, tables, what, fix, .. } = looked(&lab).findings.swap_remove(0);
    assert_eq!((lab.path("out").join(named), tables), (file.clone(), vec!["onsets".to_owned()]));
    let place = format!("row group 0, column time_ps, page at byte {byte}: rows 0 to ");
    assert!(what.contains(&place) && what.contains("lit 1, seen 1") && what.contains("lit 4, seen 4"), "{what}");
    assert!(fix.contains("the next `run` makes it again"), "{fix}");
    // The same words where it is read, and in a run that needs it.
    let read = chain(Shelf::look(&lab.path("out")).unwrap().batches("onsets").unwrap_err());
    let set = ["labels.false_alarm=0.002".to_owned()];
    let run = chain(lab.run_with("out", ALL_VISIBLE, &set, &Settings::default()).unwrap_err());
    for error in [read, run] {
        assert!(error.contains(&place) && error.contains("is damaged") && error.contains("delete it"), "{error}");
    }
    // Deleted, it is made again, and nothing else is.
    let (code, text) = periscope(&lab, &["verify", "out", "--repair"]);
    assert!(code == Some(1) && text.contains("onsets") && text.contains(&place), "{text}");
    let again = lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    assert_eq!(again.computed, ["onsets"]);
    assert_eq!(looked(&lab).findings, []);
    assert_eq!(lab.parts("out"), before);
}

#[test]
fn each_kind_of_damage_has_its_words() {
    let lab = Lab::tiny();
    lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    let text = |file: &Path| fs::read_to_string(file).unwrap();
    let cases: [(&str, &dyn Fn(&Path), &str); 9] = [
        (".labels.parquet", &|file| fs::remove_file(file).unwrap(), "it is gone"),
        (".labels.parquet", &|file| fs::write(file, &fs::read(file).unwrap()[1..]).unwrap(), "instead of"),
        (
            ".labels.parquet",
            &|file| flip(file, 8 * (fs::metadata(file).unwrap().len() - 20)),
            "in its footer, after byte",
        ),
        (".labels.parquet", &|file| flip(file, 8), "in the header of a page"),
        ("table.json", &|file| flip(file, 8 * 150), "not those that were written"),
        ("stage.json", &|file| flip(file, 8 * 200), "not those that were written"),
        ("stage.json", &|file| fs::remove_file(file).unwrap(), "is gone"),
        ("none.parquet", &|file| flip(file, 8 * 40), "is damaged"),
        ("rejects.json", &|file| flip(file, 8 * 120), "not those that were written"),
    ];
    for (file, damage, words) in cases {
        let file = one(&lab, file);
        damage(&file);
        let findings = looked(&lab).findings;
        assert!(findings.iter().any(|finding| finding.what.contains(words)), "{words}: {findings:?}");
        periscope::store::verify::repair(&findings).unwrap();
        lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
        assert_eq!(looked(&lab).findings, [], "after {words}");
    }
    // What runs noted of raw files decides on lineages: a digit of a hash is not believed.
    let notes = one(&lab, "notes/tiny/manifest.json");
    let line = text(&notes).find("\"blake3\":\"").unwrap() as u64 + 12;
    flip(&notes, 8 * line);
    let run = chain(lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap_err());
    let (code, said) = periscope(&lab, &["verify", "out", "--campaign", "campaign"]);
    assert_eq!(code, Some(1));
    for said in [run, said] {
        assert!(said.contains("damaged in the lines of raw/") && said.contains("hashed anew"), "{said}");
    }
}

#[test]
fn page_checksums_are_those_of_the_format() {
    let lab = Lab::tiny();
    lab.run("out", ALL_VISIBLE, &Settings::default()).unwrap();
    let file = one(&lab, ".onsets.parquet");
    let (byte, bytes) = page_of(&lab, &file, "time_ps");
    flip(&file, 8 * (byte + bytes - 1));
    // A reader that knows no record of ours.
    let error = parquet::read(&file, 1024).unwrap().find_map(Result::err).unwrap();
    assert!(error.to_string().contains("CRC"), "{error}");
}

#[test]
fn a_campaign_is_held_to_its_seal() {
    let lab = Lab::tiny();
    let (code, text) = periscope(&lab, &["verify", "campaign"]);
    assert!(
        code == Some(1) && text.contains("the campaign is not sealed") && text.contains("periscope seal"),
        "{text}"
    );
    let campaign = Campaign::load(&lab.campaign()).unwrap();
    seal(&campaign, &campaign.survey().unwrap(), false).unwrap();
    let (code, text) = periscope(&lab, &["verify", "campaign", "--rehash"]);
    assert!(code == Some(0) && text.contains("by content"), "{text}");
    let raw = lab.campaign().join("raw/scene");
    fs::copy(raw.join("s1_L1_P2_C1.trc"), raw.join("s1_L1_P5_C1.trc")).unwrap();
    fs::copy(raw.join("s1_L1_P2_C2.trc"), raw.join("s1_L1_P5_C2.trc")).unwrap();
    let (code, text) = periscope(&lab, &["verify", "campaign"]);
    assert!(code == Some(0) && text.contains("s1_L1_P5_C1.trc") && text.contains("seal --update"), "{text}");
    // A bit that flips on the disk changes neither size nor times.
    decay(&lab.campaign(), "raw/scene/s1_L2_P3_C1.trc", &lab.campaign());
    assert_eq!(periscope(&lab, &["verify", "campaign"]).0, Some(0));
    fs::remove_file(raw.join("s1_L3_P4_C1.trc")).unwrap();
    let (code, text) = periscope(&lab, &["verify", "campaign", "--rehash", "--format", "json"]);
    let said: serde_json::Value = serde_json::from_str(&text).unwrap();
    let about = |file: &str, what: &str| {
        let findings = said["findings"].as_array().unwrap().iter();
        findings
            .filter(|finding| finding["file"].as_str().unwrap().ends_with(file))
            .any(|finding| finding["what"] == what)
    };
    assert!(code == Some(1) && said["ok"] == false);
    assert!(
        about("s1_L2_P3_C1.trc", "differs from the recorded content") && about("s1_L3_P4_C1.trc", "is gone"),
        "{text}"
    );
}

#[test]
fn no_flip_in_the_settings_of_a_sealed_campaign_passes() {
    let lab = Lab::tiny();
    let campaign = Campaign::load(&lab.campaign()).unwrap();
    seal(&campaign, &campaign.survey().unwrap(), false).unwrap();
    run_by_command(&lab);
    let file = lab.campaign().join("campaign.toml");
    let bits = 8 * fs::metadata(&file).unwrap().len();
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for _ in 0..12 {
        let bit = rng.random_range(0..bits);
        flip(&file, bit);
        let run = ["run", "pipeline.toml", "--campaign", "campaign", "--out", "out"];
        let plan = ["plan", "pipeline.toml", "--campaign", "campaign", "--out", "out"];
        for command in [&run[..], &plan, &["verify", "campaign"], &["verify", "out"], &["seal", "campaign"]] {
            let (code, text) = periscope(&lab, command);
            assert!(code == Some(1) && text.contains("campaign.toml"), "bit {bit}, {command:?}: {text}");
        }
        flip(&file, bit);
    }
    assert_eq!(periscope(&lab, &["verify", "out"]).0, Some(0));
    // A change that is meant is named by its key, and joins on request.
    let text = fs::read_to_string(&file).unwrap();
    fs::write(&file, text.replace("[campaign]\n", "[campaign]\npart_bytes = 1000000\n")).unwrap();
    let (code, said) = periscope(&lab, &["verify", "campaign"]);
    assert!(code == Some(1) && said.contains("`campaign.part_bytes`") && said.contains("seal --update"), "{said}");
    let (code, said) = periscope(&lab, &["seal", "--update", "campaign"]);
    assert!(code == Some(0) && said.contains("`campaign.part_bytes`"), "{said}");
    assert_eq!(periscope(&lab, &["verify", "campaign"]).0, Some(0));
}

#[test]
fn other_content_of_the_same_size_and_time_is_seen() {
    let lab = Lab::tiny();
    run_by_command(&lab);
    let raw = lab.campaign().join("raw/scene");
    let file = raw.join("s1_L2_P3_C1.trc");
    let run = ["run", "pipeline.toml", "--campaign", "campaign", "--out", "out"];
    let seen_by_all = |what: &str| {
        for command in [&run[..], &["verify", "out"]] {
            let (code, text) = periscope(&lab, command);
            assert!(code == Some(1) && text.contains("s1_L2_P3_C1.trc"), "{what}: {text}");
        }
    };
    // Written over: the system's time of change is another.
    flip(&file, 8 * 3000);
    seen_by_all("written over");
    flip(&file, 8 * 3000);
    assert_eq!(periscope(&lab, &run).0, Some(0));
    // Another file in its place: the inode is another.
    let other = lab.path("other");
    copy(&file, &other, true);
    flip(&other, 8 * 3000);
    let modified = fs::metadata(&file).unwrap().modified().unwrap();
    File::options().write(true).open(&other).unwrap().set_modified(modified).unwrap();
    fs::rename(&other, &file).unwrap();
    seen_by_all("another file");
}

#[test]
fn a_raw_file_that_decays_on_the_disk_is_refused_by_the_run_that_reads_it() {
    let lab = Lab::tiny();
    // Noted by a first run, and read again by a second, which has no traces on the shelf.
    lab.run_with("out", ALL_VISIBLE, &["traces.keep=false".to_owned()], &Settings::default()).unwrap();
    let before = lab.parts("out");
    decay(&lab.campaign(), "raw/scene/s1_L2_P3_C1.trc", &lab.path("out/.shelf/notes/tiny"));
    let set = ["traces.keep=false".to_owned(), "profiles.shots_min=3".to_owned()];
    let error = chain(lab.run_with("out", ALL_VISIBLE, &set, &Settings::default()).unwrap_err());
    assert!(error.contains("s1_L2_P3_C1.trc") && error.contains("changed since they were first read"), "{error}");
    assert_eq!(lab.parts("out"), before, "nothing of it counts");
    // Nothing is to be read, and so nothing is seen, unless it is asked for.
    fs::write(lab.path("p.toml"), ALL_VISIBLE).unwrap();
    let run = ["run", "p.toml", "--campaign", "campaign", "--out", "out", "--set", "traces.keep=false", "--rehash"];
    assert_eq!(periscope(&lab, &run[..run.len() - 1]).0, Some(0));
    let (code, text) = periscope(&lab, &run);
    assert!(code == Some(1) && text.contains("s1_L2_P3_C1.trc") && text.contains("restore"), "{text}");
}

/// A result folder that a command made, so that a record of its run is there.
fn run_by_command(lab: &Lab) {
    fs::write(lab.path("pipeline.toml"), ALL_VISIBLE).unwrap();
    let (code, text) = periscope(lab, &["run", "pipeline.toml", "--campaign", "campaign", "--out", "out"]);
    assert_eq!(code, Some(0), "{text}");
}

/// Views that show what no run left there: three draws of each kind of change, in the folder and in a copy of it.
#[test]
fn what_a_reader_sees_is_what_a_run_left() {
    let lab = Lab::tiny();
    run_by_command(&lab);
    assert_eq!(looked(&lab).findings, []);
    let mut rng = ChaCha8Rng::seed_from_u64(30);
    for (name, is_followed, change) in MANIPULATIONS {
        for _ in 0..3 {
            let folder = tempfile::tempdir().unwrap();
            let out = folder.path().join("out");
            copy(&lab.path("out"), &out, is_followed);
            change(&out, &mut rng);
            let report = verify(&Shelf::look(&out).unwrap()).unwrap();
            assert!(!report.findings.is_empty(), "{name}: {:?}", links(&out));
        }
    }
}

/// A copy in which links became folders (`cp -rL`, zip, a synced folder) is verified, read and run on.
#[test]
fn a_copy_without_links_is_a_result_folder() {
    let lab = Lab::tiny();
    run_by_command(&lab);
    fs::rename(lab.path("out"), lab.path("original")).unwrap();
    copy(&lab.path("original"), &lab.path("out"), true);
    assert_eq!(links(&lab.path("out")), Vec::<PathBuf>::new());
    assert_eq!(looked(&lab).findings, []);
    let [copied, original] = ["out", "original"].map(|out| Shelf::look(&lab.path(out)).unwrap());
    assert_eq!(copied.targets().unwrap(), original.targets().unwrap());
    for view in original.names().unwrap() {
        assert!(copied.batches(&view).unwrap() == original.batches(&view).unwrap(), "{view}");
    }
    // Nothing is computed again, also where other parameters switch views.
    let run = ["run", "pipeline.toml", "--campaign", "campaign", "--out", "out"];
    for set in [&[][..], &["--set", "onsets.threshold_sigma=6"], &[]] {
        let (code, text) = periscope(&lab, &[&run[..], set].concat());
        assert_eq!(code, Some(0), "{text}");
        assert_eq!(looked(&lab).findings, []);
    }
    assert!(!links(&lab.path("out")).is_empty());
}

#[test]
fn a_shelf_that_is_a_link_is_refused_and_nothing_in_it_changes() {
    let lab = Lab::tiny();
    let home = lab.path("home");
    fs::create_dir_all(home.join(".git")).unwrap();
    fs::write(home.join(".bashrc"), "alias").unwrap();
    fs::write(home.join(".git/HEAD"), "ref").unwrap();
    fs::create_dir(lab.path("out")).unwrap();
    std::os::unix::fs::symlink(&home, lab.path("out/.shelf")).unwrap();
    fs::write(lab.path("pipeline.toml"), ALL_VISIBLE).unwrap();
    let run = ["run", "pipeline.toml", "--campaign", "campaign", "--out", "out"];
    for command in [&run[..], &["verify", "out", "--repair"], &["tables", "out", "--prune"]] {
        let (code, text) = periscope(&lab, command);
        assert!(code == Some(1) && text.contains("is a link"), "{text}");
    }
    assert_eq!(fs::read_dir(&home).unwrap().count(), 2);
    assert!(home.join(".bashrc").exists() && home.join(".git/HEAD").exists());
}
