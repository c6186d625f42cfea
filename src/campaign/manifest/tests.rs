use std::fs::{self, File};
use std::sync::atomic::{AtomicBool, Ordering};

use super::*;

fn folder_with(text: &str) -> (tempfile::TempDir, Manifest) {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.trc");
    fs::write(&file, text).unwrap();
    let mut manifest = Manifest::default();
    let content = hash_file(&file).unwrap();
    manifest.record(Path::new("a.trc"), content, &metadata(&file).unwrap());
    (folder, manifest)
}

#[test]
fn what_went_down_with_the_machine_is_recorded_again_and_damage_is_reported() {
    let (folder, manifest) = folder_with("light");
    manifest.save_without_waiting(folder.path()).unwrap();
    let text = fs::read_to_string(folder.path().join(MANIFEST_FILE)).unwrap();
    let mut joined = Manifest::default();
    for length in 0..text.trim_end().len() {
        fs::write(folder.path().join(MANIFEST_FILE), &text[..length]).unwrap();
        joined.join(folder.path()).unwrap();
        assert!(Manifest::load(folder.path()).is_err(), "a seal of {length} bytes");
    }
    assert_eq!(joined, Manifest::default());
    fs::write(folder.path().join(MANIFEST_FILE), text.replace("bytes", "bites")).unwrap();
    assert!(joined.join(folder.path()).is_err());
    fs::write(folder.path().join(MANIFEST_FILE), text).unwrap();
    joined.join(folder.path()).unwrap();
    assert_eq!(joined, manifest);
}

#[test]
fn a_manifest_reads_back_and_has_one_file_a_line() {
    let (folder, mut manifest) = folder_with("light");
    let content = blake3::hash(b"light");
    let metadata = metadata(&folder.path().join("a.trc")).unwrap();
    manifest.record(Path::new("raw/\"b\".trc"), content, &metadata);
    assert_eq!(Manifest::load(folder.path()).unwrap(), None);
    manifest.save(folder.path()).unwrap();
    assert_eq!(Manifest::load(folder.path()).unwrap(), Some(manifest));
    let text = fs::read_to_string(folder.path().join(MANIFEST_FILE)).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines.len(), 10);
    assert!(lines[6].starts_with("\"a.trc\": {\"bytes\":5,\"modified_ns\":"));
    assert!(lines[6].contains(&content.to_hex().to_string()));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2, "nothing left over");
}

#[test]
fn halves_of_killed_processes_go_and_those_under_way_stay() {
    let folder = tempfile::tempdir().unwrap();
    let half = |process: u32| folder.path().join(format!("{HALF}{process}"));
    fs::write(half(1), "{").unwrap();
    fs::write(half(2), "{").unwrap();
    let long_ago = std::time::SystemTime::now() - 2 * LEFT_BEHIND;
    File::options().write(true).open(half(1)).unwrap().set_modified(long_ago).unwrap();
    Manifest::default().save(folder.path()).unwrap();
    assert!(!half(1).exists() && half(2).exists());
}

#[test]
fn empty_and_broken_manifests() {
    let folder = tempfile::tempdir().unwrap();
    let empty = Manifest::default();
    empty.save(folder.path()).unwrap();
    assert_eq!(Manifest::load(folder.path()).unwrap(), Some(empty));
    for text in ["", "{}", "{\"version\": 2, \"files\": {}}", "{\"version\": 2, \"settings\": {}, \"files\": {}}"] {
        fs::write(folder.path().join(MANIFEST_FILE), text).unwrap();
        let error = Manifest::load(folder.path()).unwrap_err().to_string();
        assert!(error.contains("seal the folder anew"), "{error}");
    }
}

#[test]
fn every_flipped_bit_is_found_and_its_line_named() {
    let (folder, mut manifest) = folder_with("light");
    manifest.settings.insert("campaign.toml".to_owned(), "[campaign]\nname = 'c'\n".to_owned());
    manifest.save(folder.path()).unwrap();
    let file = folder.path().join(MANIFEST_FILE);
    let bytes = fs::read(&file).unwrap();
    for bit in 0..8 * bytes.len() {
        let mut flipped = bytes.clone();
        flipped[bit / 8] ^= 1 << (bit % 8);
        fs::write(&file, &flipped).unwrap();
        let error = Manifest::load(folder.path()).unwrap_err().to_string();
        assert!(error.contains("damaged"), "bit {bit}: {error}");
    }
    let text = String::from_utf8(bytes).unwrap();
    fs::write(&file, text.replace("\"bytes\":5", "\"bytes\":4")).unwrap();
    let error = Manifest::load(folder.path()).unwrap_err().to_string();
    assert!(error.contains("damaged in the lines of a.trc; restore it"), "{error}");
}

#[test]
fn the_stamp_shows_that_a_file_was_touched() {
    let (folder, manifest) = folder_with("light");
    let (path, file) = (Path::new("a.trc"), folder.path().join("a.trc"));
    let content = blake3::hash(b"light");
    let state = |path| manifest.check(folder.path(), path).unwrap();
    assert_eq!(state(path), FileState::Same(content));
    assert_eq!(state(Path::new("b.trc")), FileState::New);
    let time = fs::metadata(&file).unwrap().modified().unwrap();
    let set_time = |time| File::options().write(true).open(&file).unwrap().set_modified(time);
    set_time(time + Duration::from_secs(1)).unwrap();
    assert_eq!(state(path), FileState::Touched { recorded: content });
    fs::write(&file, "lights").unwrap();
    set_time(time).unwrap();
    assert_eq!(state(path), FileState::Touched { recorded: content });
    fs::remove_file(&file).unwrap();
    assert!(manifest.check(folder.path(), path).is_err());
}

#[test]
fn hashing_in_pieces_is_hashing_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("big");
    for length in [0, 1, BUFFER_BYTES, 2 * BUFFER_BYTES + 17] {
        let bytes: Vec<u8> = (0..length).map(|i| (i * 31 % 251) as u8).collect();
        fs::write(&file, &bytes).unwrap();
        assert_eq!(hash_file(&file).unwrap(), blake3::hash(&bytes));
    }
}

#[test]
fn processes_that_save_the_same_notes_do_not_disturb_each_other() {
    let (folder, manifest) = folder_with("light");
    let other = folder.path().join(format!("{HALF}of-another"));
    let done = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while !done.load(Ordering::Relaxed) {
                fs::write(&other, "{}").unwrap();
                fs::rename(&other, folder.path().join("named")).unwrap();
            }
        });
        let saved: Result<(), _> = (0..2_000).try_for_each(|_| manifest.save_without_waiting(folder.path()));
        done.store(true, Ordering::Relaxed);
        saved.unwrap();
    });
}
