//! Records: small JSON files next to the tables. Each has a checksum of its own bytes, so that even a flipped bit that
//! still parses is noticed.
//!
//! ```text
//! {
//!   "check": "<BLAKE3 of all bytes after this line, 64 hexadecimal digits>",
//!   ...
//! }
//! ```

use std::io;
use std::path::Path;

use serde::Serialize;
use serde::de::{DeserializeOwned, Error};

use super::Digest;
use super::disk as fs;
use super::failure::{At, StoreError};

const BEFORE: &str = "{\n  \"check\": \"";
const AFTER: &str = "\",\n";

/// The text of a record. A record is an object with at least one field.
pub fn text(record: &impl Serialize) -> String {
    let plain = serde_json::to_string_pretty(record).expect("records are plain data");
    let fields = plain.strip_prefix("{\n").expect("a record has fields");
    format!("{BEFORE}{}{AFTER}{fields}", Digest::of_bytes(fields.as_bytes()))
}

/// Reads a record; `None` if there is none.
///
/// # Errors
/// When it is damaged or cannot be read.
pub fn read<T: DeserializeOwned>(path: &Path) -> Result<Option<T>, StoreError> {
    let bytes = match fs::read(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        bytes => bytes.at("read", path)?,
    };
    let record = checked(&bytes).and_then(|text| serde_json::from_str(text));
    record.map(Some).map_err(|source| StoreError::Record { path: path.to_owned(), source })
}

/// The text, if its checksum is right.
fn checked(bytes: &[u8]) -> Result<&str, serde_json::Error> {
    let parts = |text: &str| {
        let (check, fields) = text.strip_prefix(BEFORE)?.split_at_checked(64)?;
        Some(check == Digest::of_bytes(fields.strip_prefix(AFTER)?.as_bytes()).to_string())
    };
    match std::str::from_utf8(bytes) {
        Ok(text) if parts(text) == Some(true) => Ok(text),
        _ => Err(serde_json::Error::custom("its bytes are not those that were written")),
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use serde::Deserialize;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Widths {
        sd_m: f64,
        width_ps: f64,
    }

    #[test]
    fn records_read_back_and_every_flipped_bit_is_found() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("record.json");
        assert_eq!(read::<Widths>(&path).unwrap(), None);
        let record = Widths { sd_m: 2e-3, width_ps: 150.0 };
        let json = text(&record);
        assert!(serde_json::from_str::<serde_json::Value>(&json).unwrap()["check"].is_string());
        fs::write(&path, &json).unwrap();
        assert_eq!(read(&path).unwrap(), Some(record));
        for bit in 0..8 * json.len() {
            let mut flipped = json.clone().into_bytes();
            flipped[bit / 8] ^= 1 << (bit % 8);
            fs::write(&path, flipped).unwrap();
            let error = read::<Widths>(&path).unwrap_err().to_string();
            assert!(error.contains("record.json is damaged; delete it"), "{error}");
        }
    }
}
