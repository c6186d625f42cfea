//! A key that takes one axis or a list of them.

use std::fmt;

use serde::Deserialize;
use serde::de::{self, Deserializer, SeqAccess, Visitor};

use super::Axis;

/// One axis (`"shot"`) or a list of them (`["lit", "seen", "shot"]`).
pub(super) fn axes<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<Axis>, D::Error> {
    struct OneOrMore;

    impl<'de> Visitor<'de> for OneOrMore {
        type Value = Vec<Axis>;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("an axis such as \"shot\", or a list such as [\"lit\", \"seen\", \"shot\"]")
        }

        fn visit_str<E: de::Error>(self, text: &str) -> Result<Vec<Axis>, E> {
            let name = de::value::StrDeserializer::<E>::new(text);
            Ok(vec![Axis::deserialize(name)?])
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Vec<Axis>, A::Error> {
            let mut axes = Vec::new();
            while let Some(axis) = items.next_element()? {
                axes.push(axis);
            }
            Ok(axes)
        }
    }

    deserializer.deserialize_any(OneOrMore)
}
