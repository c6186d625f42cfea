//! Recordings in two files: a head, and next to it a companion with the samples.

use std::path::{Path, PathBuf};

/// Lidars: the ending of the head, and that of its samples. Names that are in capitals stay so.
const LIDAR: [(&str, &str); 4] = [(".pls", ".wvs"), (".PLS", ".WVS"), (".las", ".wdp"), (".LAS", ".WDP")];

/// Returns the name of the companion that a file may have.
///
/// Rohde & Schwarz scopes write the samples of `NAME.bin` into `NAME.Wfm.bin`. A `.bin` of another make has no
/// companion. Lidars write them into `NAME.wvs` (of `NAME.pls`) and `NAME.wdp` (of `NAME.las`).
#[must_use]
pub fn companion(file: &Path) -> Option<PathBuf> {
    let name = file.file_name()?.to_str()?;
    for (head, samples) in LIDAR {
        if let Some(stem) = name.strip_suffix(head) {
            return Some(file.with_file_name(format!("{stem}{samples}")));
        }
    }
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
        assert_eq!(companion(Path::new("raw/a.b.pls")), Some("raw/a.b.wvs".into()));
        assert_eq!(companion(Path::new("FLIGHT.LAS")), Some("FLIGHT.WDP".into()));
    }
}
