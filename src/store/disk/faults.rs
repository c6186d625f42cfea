//! The switch that lets an access to the disk fail, in tests.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Folders whose accesses are counted. Tests run side by side, so each has its own folder.
static WATCHED: Mutex<Vec<Watched>> = Mutex::new(Vec::new());

struct Watched {
    folder: PathBuf,
    /// Number of the access that fails, from 1.
    fails_at: usize,
    accesses: usize,
    /// What failed.
    failed: Option<String>,
}

fn watched() -> MutexGuard<'static, Vec<Watched>> {
    WATCHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Calls `action` while the access number `fails_at` (from 1) below `folder` fails. Returns what it gives, and which
/// access failed, if there were as many.
pub(crate) fn failing<T>(folder: &Path, fails_at: usize, action: impl FnOnce() -> T) -> (T, Option<String>) {
    watched().push(Watched { folder: folder.to_owned(), fails_at, accesses: 0, failed: None });
    let given = action();
    let mut all = watched();
    let at = all.iter().position(|watched| watched.folder == folder).expect("it was pushed above");
    (given, all.swap_remove(at).failed)
}

/// Counts an access.
fn access(what: &str, path: &Path) -> io::Result<()> {
    let mut all = watched();
    let Some(watched) = all.iter_mut().find(|watched| path.starts_with(&watched.folder)) else { return Ok(()) };
    watched.accesses += 1;
    if watched.accesses != watched.fails_at {
        return Ok(());
    }
    watched.failed = Some(format!("{what} {}", path.display()));
    Err(io::Error::other("injected fault"))
}

/// The functions of [`super`] with the switch.
pub(crate) mod disk {
    use std::fs::{File, Metadata, ReadDir};
    use std::io::{self, Write};
    use std::path::{Path, PathBuf};

    use super::access;

    /// Functions of one path.
    macro_rules! of_a_path {
        ($($name:ident -> $given:ty;)*) => { $(
            pub(crate) fn $name(path: impl AsRef<Path>) -> io::Result<$given> {
                access(stringify!($name), path.as_ref())?;
                std::fs::$name(path)
            }
        )* };
    }

    of_a_path! {
        canonicalize -> PathBuf;
        create_dir_all -> ();
        metadata -> Metadata;
        read -> Vec<u8>;
        read_dir -> ReadDir;
        read_link -> PathBuf;
        read_to_string -> String;
        remove_dir -> ();
        remove_dir_all -> ();
        remove_file -> ();
        symlink_metadata -> Metadata;
    }

    pub(crate) fn copy(from: impl AsRef<Path>, to: impl AsRef<Path>) -> io::Result<u64> {
        access("copy", to.as_ref())?;
        std::fs::copy(from, to)
    }

    pub(crate) fn hard_link(original: impl AsRef<Path>, link: impl AsRef<Path>) -> io::Result<()> {
        access("hard_link", link.as_ref())?;
        std::fs::hard_link(original, link)
    }

    pub(crate) fn rename(from: impl AsRef<Path>, to: impl AsRef<Path>) -> io::Result<()> {
        access("rename", to.as_ref())?;
        std::fs::rename(from, to)
    }

    pub(crate) fn symlink(original: impl AsRef<Path>, link: impl AsRef<Path>) -> io::Result<()> {
        access("symlink", link.as_ref())?;
        std::os::unix::fs::symlink(original, link)
    }

    /// A write that fails leaves half of the content, as a full disk does.
    pub(crate) fn write(path: impl AsRef<Path>, content: impl AsRef<[u8]>) -> io::Result<()> {
        let mut file = create(path.as_ref())?;
        file.write_all(content.as_ref())
    }

    /// A file that is written.
    pub(crate) struct Output {
        file: File,
        path: PathBuf,
    }

    impl Output {
        pub(crate) fn sync_all(&self) -> io::Result<()> {
            access("sync", &self.path)?;
            self.file.sync_all()
        }
    }

    impl Write for Output {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            if let Err(error) = access("write", &self.path) {
                self.file.write_all(&bytes[..bytes.len() / 2])?;
                return Err(error);
            }
            self.file.write(bytes)
        }

        fn flush(&mut self) -> io::Result<()> {
            self.file.flush()
        }
    }

    pub(crate) fn create(path: &Path) -> io::Result<Output> {
        access("create", path)?;
        Ok(Output { file: File::create(path)?, path: path.to_owned() })
    }

    pub(crate) fn sync(path: &Path) -> io::Result<()> {
        access("sync", path)?;
        File::open(path)?.sync_all()
    }

    pub(crate) fn open(path: &Path) -> io::Result<File> {
        access("open", path)?;
        File::open(path)
    }
}
