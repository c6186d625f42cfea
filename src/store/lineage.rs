//! Lineage: a BLAKE3 digest of everything that determines a table.
//!
//! A *recipe* covers a stage's kind, version, parameters, campaign fields and schema, and the recipes of its inputs; it
//! is computed before anything is read. A part's *lineage* joins its recipe with the lineages of its inputs' parts; at
//! the root stand the content hashes of the raw files.

use std::fmt;

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::Value;

/// A BLAKE3 digest of 256 bits; its text is 64 hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Digest([u8; 32]);

impl Digest {
    /// Digest of bytes.
    #[must_use]
    pub fn of_bytes(bytes: &[u8]) -> Self {
        Self(*blake3::hash(bytes).as_bytes())
    }

    /// Digest of a JSON value in canonical form: keys sorted, no white space, shortest numbers that read back the same.
    #[must_use]
    pub fn of(value: &Value) -> Self {
        Self::of_sorted(value)
    }

    /// The same of what has its keys sorted when it becomes JSON.
    ///
    /// # Panics
    /// When it cannot become JSON.
    pub(super) fn of_sorted(value: &impl Serialize) -> Self {
        Self::of_bytes(&serde_json::to_vec(value).expect("plain data"))
    }

    /// Digest of a sequence of digests. `what` names what is joined.
    pub fn join<'a>(what: &str, digests: impl IntoIterator<Item = &'a Digest>) -> Self {
        let mut hasher = blake3::Hasher::new();
        hasher.update(what.as_bytes());
        for digest in digests {
            hasher.update(&digest.0);
        }
        hasher.finalize().into()
    }

    /// Parses the text of a digest; `None` for any other text.
    #[must_use]
    pub fn from_hex(text: &str) -> Option<Self> {
        blake3::Hash::from_hex(text).ok().map(Self::from)
    }

    /// The first 16 hexadecimal digits: enough for a folder's name, never for identity.
    #[must_use]
    pub fn short(&self) -> String {
        self.to_string()[..16].to_owned()
    }
}

/// Recipe of one table (main or side) of a stage with this recipe; other stages name it as their input.
#[must_use]
pub fn table_recipe(table: &str, recipe: &Digest) -> Digest {
    Digest::join(table, [recipe])
}

/// Lineage of a part with this recipe. `input` is its part, whole table or raw content; `beside` are its whole tables.
#[must_use]
pub fn part(recipe: &Digest, input: &Digest, beside: &[Digest]) -> Digest {
    Digest::join("part", [recipe, input].into_iter().chain(beside))
}

impl From<blake3::Hash> for Digest {
    fn from(hash: blake3::Hash) -> Self {
        Self(*hash.as_bytes())
    }
}

impl From<Digest> for blake3::Hash {
    fn from(digest: Digest) -> Self {
        Self::from_bytes(digest.0)
    }
}

impl fmt::Display for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl Serialize for Digest {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Digest {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        blake3::Hash::from_hex(text).map(Self::from).map_err(serde::de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn order_of_keys_does_not_matter_and_order_of_inputs_does() {
        assert_eq!(Digest::of(&json!({"a": 1, "b": 2.5})), Digest::of(&json!({"b": 2.5, "a": 1})));
        let (a, b) = (Digest::of_bytes(b"a"), Digest::of_bytes(b"b"));
        assert_ne!(Digest::join("x", [&a, &b]), Digest::join("x", [&b, &a]));
        assert_ne!(Digest::join("x", [&a]), Digest::join("y", [&a]));
    }

    #[test]
    fn digests_read_back() {
        let digest = Digest::of_bytes(b"light");
        let text = serde_json::to_string(&digest).unwrap();
        assert_eq!(serde_json::from_str::<Digest>(&text).unwrap(), digest);
    }
}
