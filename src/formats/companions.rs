//! Recordings in two files: a head, and next to it a companion with the samples.

use std::path::{Path, PathBuf};

/// Returns the name of the companion that a file may have.
///
/// Rohde & Schwarz scopes write the samples of `NAME.bin` into `NAME.Wfm.bin`. A `.bin` of another make has no
/// companion.
#[must_use]
pub fn companion(file: &Path) -> Option<PathBuf> {
    let name = file.file_name()?.to_str()?;
    let stem = name.strip_suffix(".bin").filter(|stem| !stem.ends_with(".Wfm"))?;
    Some(file.with_file_name(format!("{stem}.Wfm.bin")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_heads_have_companions() {
        assert_eq!(companion(Path::new("raw/L1.bin")), Some("raw/L1.Wfm.bin".into()));
        assert_eq!(companion(Path::new("raw/L1.Wfm.bin")), None);
        assert_eq!(companion(Path::new("raw/L1.trc")), None);
    }
}
