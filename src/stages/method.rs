//! Methods of a stage, by their names in pipeline files.

use serde::de::value::Error as NameError;
use serde::de::{DeserializeOwned, Error, IntoDeserializer};
use serde::{Deserialize, Deserializer};

/// The method of a name. `former` are names of methods that left the program; `instead` says what to use in their
/// place.
///
/// # Errors
/// When the stage has no method of this name.
pub(super) fn named<'de, M: DeserializeOwned, D: Deserializer<'de>>(
    name: D,
    former: &[&str],
    instead: &str,
) -> Result<M, D::Error> {
    let name = String::deserialize(name)?;
    if former.contains(&name.as_str()) {
        let text = format!("`{name}` is no longer in the program, only in its studies (benches/); {instead}");
        return Err(D::Error::custom(text));
    }
    M::deserialize(name.into_deserializer()).map_err(|unknown: NameError| D::Error::custom(unknown))
}
