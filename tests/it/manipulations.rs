//! Changes to what a reader of a result folder sees, which `verify` must find.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Flips a bit of a file, whose time of modification stays.
pub fn flip(path: &Path, bit: u64) {
    let modified = fs::metadata(path).unwrap().modified().unwrap();
    let mut bytes = fs::read(path).unwrap();
    bytes[(bit / 8) as usize] ^= 1 << (bit % 8);
    fs::write(path, bytes).unwrap();
    File::options().write(true).open(path).unwrap().set_modified(modified).unwrap();
}

/// Copies a folder as `cp -r` does, or with `follow` as `cp -rL`: links become what they lead to.
pub fn copy(from: &Path, to: &Path, follow: bool) {
    let mut command = Command::new("cp");
    let done = command.arg(if follow { "-rL" } else { "-rP" }).arg(from).arg(to).status().unwrap();
    assert!(done.success());
}

/// A change to what a reader sees: its name, whether it is made to a copy without links, and the change.
type Manipulation = (&'static str, bool, fn(&Path, &mut ChaCha8Rng));

/// Links among the views, sorted.
pub fn links(out: &Path) -> Vec<PathBuf> {
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

/// Views of a copy without links, sorted: folders with tables.
fn folders(out: &Path) -> Vec<PathBuf> {
    let mut folders: Vec<PathBuf> = fs::read_dir(out).unwrap().flatten().map(|entry| entry.path()).collect();
    folders.retain(|path| path.is_dir() && !path.ends_with(".shelf"));
    folders.sort();
    folders
}

/// A table file in a copy without links.
fn some_copied_file(out: &Path, rng: &mut ChaCha8Rng) -> PathBuf {
    loop {
        let mut folders = folders(out);
        let folder = folders.swap_remove(rng.random_range(0..folders.len()));
        let mut files: Vec<PathBuf> = fs::read_dir(&folder).unwrap().flatten().map(|entry| entry.path()).collect();
        files.sort();
        if !folder.ends_with("rejects") && !files.is_empty() {
            return files.swap_remove(rng.random_range(0..files.len()));
        }
    }
}

pub const MANIPULATIONS: [Manipulation; 16] = [
    ("swapped", false, |out, rng| {
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
    ("another table", false, |out, rng| {
        loop {
            let (a, b) = (some_link(out, rng), some_link(out, rng));
            let to_b = fs::read_link(b).unwrap();
            if fs::read_link(&a).unwrap() != to_b {
                return relink(&a, &to_b);
            }
        }
    }),
    ("deleted", false, |out, rng| fs::remove_file(some_link(out, rng)).unwrap()),
    ("outside", false, |out, rng| {
        let link = some_link(out, rng);
        let elsewhere = out.with_file_name("elsewhere");
        copy(&fs::canonicalize(&link).unwrap(), &elsewhere, true);
        relink(&link, &elsewhere);
    }),
    ("a stray view", false, |out, rng| {
        let target = fs::read_link(some_link(out, rng)).unwrap();
        std::os::unix::fs::symlink(target, out.join("mine")).unwrap();
    }),
    ("a stray file in a view", false, |out, rng| {
        let file = some_file(out, rng);
        fs::copy(&file, file.with_file_name("part-99999.parquet")).unwrap();
    }),
    ("a stray folder of tables", false, |out, rng| {
        let file = some_file(out, rng);
        fs::create_dir(out.join("mine")).unwrap();
        fs::copy(&file, out.join("mine/part-00000.parquet")).unwrap();
    }),
    ("a changed copy", false, |out, rng| {
        let file = some_file(out, rng);
        let (view, name) = (file.parent().unwrap().to_owned(), file.file_name().unwrap().to_owned());
        unlink(&view);
        let bits = 8 * fs::metadata(view.join(&name)).unwrap().len();
        flip(&view.join(name), rng.random_range(0..bits));
    }),
    ("a copy with a file less", false, |out, rng| {
        let file = some_file(out, rng);
        let (view, name) = (file.parent().unwrap().to_owned(), file.file_name().unwrap().to_owned());
        unlink(&view);
        fs::remove_file(view.join(name)).unwrap();
    }),
    ("a copy with a file more", false, |out, rng| {
        let file = some_file(out, rng);
        let (view, name) = (file.parent().unwrap().to_owned(), file.file_name().unwrap().to_owned());
        unlink(&view);
        fs::copy(view.join(name), view.join("more.parquet")).unwrap();
    }),
    ("renamed", false, |out, rng| {
        let link = some_link(out, rng);
        fs::rename(&link, link.with_file_name("mine")).unwrap();
    }),
    ("an archive: a bit flipped", true, |out, rng| {
        let file = some_copied_file(out, rng);
        let bits = 8 * fs::metadata(&file).unwrap().len();
        flip(&file, rng.random_range(0..bits));
    }),
    ("an archive: cut off", true, |out, rng| {
        let file = some_copied_file(out, rng);
        let length = fs::metadata(&file).unwrap().len();
        File::options().write(true).open(&file).unwrap().set_len(rng.random_range(0..length)).unwrap();
    }),
    ("an archive: views exchanged", true, |out, rng| {
        let mut views = folders(out);
        let a = views.swap_remove(rng.random_range(0..views.len()));
        let b = views.swap_remove(rng.random_range(0..views.len()));
        let aside = out.with_file_name("aside");
        fs::rename(&a, &aside).unwrap();
        fs::rename(&b, &a).unwrap();
        fs::rename(&aside, &b).unwrap();
    }),
    ("an archive: a file of another table", true, |out, rng| {
        loop {
            let (a, b) = (some_copied_file(out, rng), some_copied_file(out, rng));
            if fs::read(&a).unwrap() != fs::read(&b).unwrap() {
                fs::copy(&b, &a).unwrap();
                return;
            }
        }
    }),
    ("an archive: a view deleted", true, |out, rng| {
        let mut views = folders(out);
        fs::remove_dir_all(views.swap_remove(rng.random_range(0..views.len()))).unwrap();
    }),
];
