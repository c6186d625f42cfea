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

fn periscope(lab: &Lab, args: &[&str]) -> (Option<i32>, String) {
    let Output { status, stdout, stderr } =
        Command::new(env!("CARGO_BIN_EXE_periscope")).args(args).current_dir(lab.path("")).output().unwrap();
    (status.code(), String::from_utf8([stdout, stderr].concat()).unwrap())
}

fn looked(lab: &Lab) -> Report {
    verify(&Shelf::look(&lab.path("out")).unwrap()).unwrap()
}

fn flip(path: &Path, bit: u64) {
    let modified = fs::metadata(path).unwrap().modified().unwrap();
    let mut bytes = fs::read(path).unwrap();
    bytes[(bit / 8) as usize] ^= 1 << (bit % 8);
    fs::write(path, bytes).unwrap();
    File::options().write(true).open(path).unwrap().set_modified(modified).unwrap();
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
    assert!(
        text.contains("all is as it was written") && text.contains("parts of ingest follow from the raw files"),
        "{text}"
    );
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
    // A bit that flips on the disk changes neither size nor time.
    flip(&raw.join("s1_L2_P3_C1.trc"), 8 * 3000);
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
        about("s1_L2_P3_C1.trc", "has another content than was recorded") && about("s1_L3_P4_C1.trc", "is gone"),
        "{text}"
    );
}

#[test]
fn a_raw_file_that_decays_on_the_disk_is_refused_by_the_run_that_reads_it() {
    let lab = Lab::tiny();
    // Noted by a first run, and read again by a second, which has no traces on the shelf.
    lab.run_with("out", ALL_VISIBLE, &["traces.keep=false".to_owned()], &Settings::default()).unwrap();
    let before = lab.parts("out");
    let file = lab.campaign().join("raw/scene/s1_L2_P3_C1.trc");
    flip(&file, 8 * 3000);
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

/// Copies a folder as `cp -r` does, or with `follow` as `cp -rL`: links become what they lead to.
fn copy(from: &Path, to: &Path, follow: bool) {
    let mut command = Command::new("cp");
    let done = command.arg(if follow { "-rL" } else { "-rP" }).arg(from).arg(to).status().unwrap();
    assert!(done.success());
}

/// A change to what a reader sees.
type Manipulation = (&'static str, fn(&Path, &mut ChaCha8Rng));

/// Links among the views, sorted.
fn links(out: &Path) -> Vec<PathBuf> {
    let mut links: Vec<PathBuf> =
        fs::read_dir(out).unwrap().flatten().map(|entry| entry.path()).filter(|path| path.is_symlink()).collect();
    links.sort();
    links
}

fn some_link(out: &Path, rng: &mut ChaCha8Rng) -> PathBuf {
    let mut links = links(out);
    links.swap_remove(rng.random_range(0..links.len()))
}

/// A table file of a view that has some; the record of the rejects is none.
fn some_file(out: &Path, rng: &mut ChaCha8Rng) -> PathBuf {
    loop {
        let link = some_link(out, rng);
        let mut files: Vec<PathBuf> = fs::read_dir(&link).unwrap().flatten().map(|entry| entry.path()).collect();
        files.sort();
        if !link.ends_with("rejects") && !files.is_empty() {
            return files.swap_remove(rng.random_range(0..files.len()));
        }
    }
}

fn relink(link: &Path, target: &Path) {
    fs::remove_file(link).unwrap();
    std::os::unix::fs::symlink(target, link).unwrap();
}

/// A view becomes a folder with copies of its files.
fn unlink(link: &Path) {
    let real = fs::canonicalize(link).unwrap();
    fs::remove_file(link).unwrap();
    copy(&real, link, true);
}

const MANIPULATIONS: [Manipulation; 10] = [
    ("swapped", |out, rng| {
        loop {
            let (a, b) = (some_link(out, rng), some_link(out, rng));
            let [to_a, to_b] = [&a, &b].map(|link| fs::read_link(link).unwrap());
            if a != b && to_a != to_b {
                relink(&a, &to_b);
                relink(&b, &to_a);
                return;
            }
        }
    }),
    ("another table", |out, rng| {
        loop {
            let (a, b) = (some_link(out, rng), some_link(out, rng));
            let to_b = fs::read_link(b).unwrap();
            if fs::read_link(&a).unwrap() != to_b {
                return relink(&a, &to_b);
            }
        }
    }),
    ("deleted", |out, rng| fs::remove_file(some_link(out, rng)).unwrap()),
    ("outside", |out, rng| {
        let link = some_link(out, rng);
        let elsewhere = out.with_file_name("elsewhere");
        copy(&fs::canonicalize(&link).unwrap(), &elsewhere, true);
        relink(&link, &elsewhere);
    }),
    ("a stray view", |out, rng| {
        let target = fs::read_link(some_link(out, rng)).unwrap();
        std::os::unix::fs::symlink(target, out.join("mine")).unwrap();
    }),
    ("a stray file in a view", |out, rng| {
        let file = some_file(out, rng);
        fs::copy(&file, file.with_file_name("part-99999.parquet")).unwrap();
    }),
    ("a stray folder of tables", |out, rng| {
        let file = some_file(out, rng);
        fs::create_dir(out.join("mine")).unwrap();
        fs::copy(&file, out.join("mine/part-00000.parquet")).unwrap();
    }),
    ("a changed copy", |out, rng| {
        let file = some_file(out, rng);
        let (view, name) = (file.parent().unwrap().to_owned(), file.file_name().unwrap().to_owned());
        unlink(&view);
        let bits = 8 * fs::metadata(view.join(&name)).unwrap().len();
        flip(&view.join(name), rng.random_range(0..bits));
    }),
    ("a copy with a file less", |out, rng| {
        let file = some_file(out, rng);
        let (view, name) = (file.parent().unwrap().to_owned(), file.file_name().unwrap().to_owned());
        unlink(&view);
        fs::remove_file(view.join(name)).unwrap();
    }),
    ("a copy with a file more", |out, rng| {
        let file = some_file(out, rng);
        let (view, name) = (file.parent().unwrap().to_owned(), file.file_name().unwrap().to_owned());
        unlink(&view);
        fs::copy(view.join(name), view.join("more.parquet")).unwrap();
    }),
];

/// Views that show what no run left there: three draws of each kind of change, in the folder and in a copy of it.
#[test]
fn what_a_reader_sees_is_what_a_run_left() {
    let lab = Lab::tiny();
    run_by_command(&lab);
    assert_eq!(looked(&lab).findings, []);
    let mut rng = ChaCha8Rng::seed_from_u64(30);
    for (name, change) in MANIPULATIONS {
        for _ in 0..3 {
            let folder = tempfile::tempdir().unwrap();
            let out = folder.path().join("out");
            copy(&lab.path("out"), &out, false);
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
