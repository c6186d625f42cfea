//! JSON for recipes, in which every number is finite.
//!
//! JSON has no word for infinity or NaN, and `serde_json` writes `null` for both. A recipe must not: `null` is what
//! stands for "not given", so two different recipes would look the same.

use std::fmt;

use serde::ser::{
    self, Serialize, SerializeMap, SerializeSeq, SerializeStruct, SerializeStructVariant, SerializeTuple,
    SerializeTupleStruct, SerializeTupleVariant, Serializer,
};
use serde_json::Value;

/// A value that JSON cannot keep.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}{why}", at(.path))]
pub struct NotJson {
    /// Keys that lead to it, the innermost first.
    path: Vec<String>,
    /// What is wrong with it.
    why: String,
}

/// The value as JSON.
///
/// # Errors
/// When a number in it is infinite or NaN; the text names its key.
pub fn to_json<T: Serialize + ?Sized>(value: &T) -> Result<Value, NotJson> {
    value.serialize(Check::default())?;
    serde_json::to_value(value).map_err(ser::Error::custom)
}

fn at(path: &[String]) -> String {
    let keys: Vec<&str> = path.iter().rev().map(String::as_str).collect();
    if keys.is_empty() { String::new() } else { format!("{} ", keys.join(".")) }
}

impl NotJson {
    /// The same below a key.
    #[must_use]
    pub fn below(mut self, key: impl Into<String>) -> Self {
        self.path.push(key.into());
        self
    }

    fn number(value: f64) -> Self {
        Self { path: Vec::new(), why: format!("= {value}: must be finite") }
    }
}

impl ser::Error for NotJson {
    fn custom<T: fmt::Display>(why: T) -> Self {
        Self { path: Vec::new(), why: why.to_string() }
    }
}

/// Visits all numbers and writes nothing.
#[derive(Default)]
struct Check {
    /// Key of the map's entry whose value comes next.
    key: String,
}

/// Methods for values that JSON writes as they are.
macro_rules! passes {
    ($($method:ident($($type:ty)?),)*) => {
        $(fn $method(self $(, _: $type)?) -> Result<(), NotJson> { Ok(()) })*
    };
}

impl Serializer for Check {
    type Ok = ();
    type Error = NotJson;
    type SerializeSeq = Self;
    type SerializeTuple = Self;
    type SerializeTupleStruct = Self;
    type SerializeTupleVariant = Self;
    type SerializeMap = Self;
    type SerializeStruct = Self;
    type SerializeStructVariant = Self;

    passes! {
        serialize_bool(bool), serialize_i8(i8), serialize_i16(i16), serialize_i32(i32), serialize_i64(i64), serialize_u8(u8),
        serialize_u16(u16), serialize_u32(u32), serialize_u64(u64), serialize_char(char), serialize_str(&str), serialize_bytes(&[u8]),
        serialize_none(), serialize_unit(), serialize_unit_struct(&'static str),
    }

    fn serialize_f32(self, value: f32) -> Result<(), NotJson> {
        self.serialize_f64(f64::from(value))
    }
    fn serialize_f64(self, value: f64) -> Result<(), NotJson> {
        if value.is_finite() { Ok(()) } else { Err(NotJson::number(value)) }
    }
    fn serialize_some<T: Serialize + ?Sized>(self, value: &T) -> Result<(), NotJson> {
        value.serialize(self)
    }
    fn serialize_unit_variant(self, _: &'static str, _: u32, _: &'static str) -> Result<(), NotJson> {
        Ok(())
    }
    fn serialize_newtype_struct<T: Serialize + ?Sized>(self, _: &'static str, value: &T) -> Result<(), NotJson> {
        value.serialize(self)
    }
    fn serialize_newtype_variant<T: Serialize + ?Sized>(
        self,
        _: &'static str,
        _: u32,
        variant: &'static str,
        value: &T,
    ) -> Result<(), NotJson> {
        value.serialize(self).map_err(|fault| fault.below(variant))
    }
    fn serialize_seq(self, _: Option<usize>) -> Result<Self, NotJson> {
        Ok(self)
    }
    fn serialize_tuple(self, _: usize) -> Result<Self, NotJson> {
        Ok(self)
    }
    fn serialize_tuple_struct(self, _: &'static str, _: usize) -> Result<Self, NotJson> {
        Ok(self)
    }
    fn serialize_tuple_variant(self, _: &'static str, _: u32, _: &'static str, _: usize) -> Result<Self, NotJson> {
        Ok(self)
    }
    fn serialize_map(self, _: Option<usize>) -> Result<Self, NotJson> {
        Ok(self)
    }
    fn serialize_struct(self, _: &'static str, _: usize) -> Result<Self, NotJson> {
        Ok(self)
    }
    fn serialize_struct_variant(self, _: &'static str, _: u32, _: &'static str, _: usize) -> Result<Self, NotJson> {
        Ok(self)
    }
}

/// Sequences of values, by the name of the method that takes the next one.
macro_rules! sequences {
    ($($sequence:ident::$method:ident,)*) => {
        $(impl $sequence for Check {
            type Ok = ();
            type Error = NotJson;
            fn $method<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), NotJson> {
                value.serialize(Self::default())
            }
            fn end(self) -> Result<(), NotJson> {
                Ok(())
            }
        })*
    };
}

/// Structures, whose fields have names.
macro_rules! structures {
    ($($structure:ident,)*) => {
        $(impl $structure for Check {
            type Ok = ();
            type Error = NotJson;
            fn serialize_field<T: Serialize + ?Sized>(&mut self, key: &'static str, value: &T) -> Result<(), NotJson> {
                value.serialize(Self::default()).map_err(|fault| fault.below(key))
            }
            fn end(self) -> Result<(), NotJson> {
                Ok(())
            }
        })*
    };
}

sequences! {
    SerializeSeq::serialize_element,
    SerializeTuple::serialize_element,
    SerializeTupleStruct::serialize_field,
    SerializeTupleVariant::serialize_field,
}
structures! { SerializeStruct, SerializeStructVariant, }

impl SerializeMap for Check {
    type Ok = ();
    type Error = NotJson;
    fn serialize_key<T: Serialize + ?Sized>(&mut self, key: &T) -> Result<(), NotJson> {
        let key: String = serde_json::to_string(key).map_err(ser::Error::custom)?;
        key.trim_matches('"').clone_into(&mut self.key);
        Ok(())
    }
    fn serialize_value<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), NotJson> {
        value.serialize(Self::default()).map_err(|fault| fault.below(std::mem::take(&mut self.key)))
    }
    fn end(self) -> Result<(), NotJson> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use serde::Serialize;
    use serde_json::json;

    use super::to_json;

    #[derive(Serialize)]
    struct Sensor {
        latency_ps: Option<f64>,
        at_m: [f64; 3],
    }

    #[test]
    fn finite_values_are_written_as_serde_json_writes_them() {
        let sensor = Sensor { latency_ps: None, at_m: [0.0, -0.5, 1e300] };
        let all = BTreeMap::from([("s1", sensor)]);
        assert_eq!(to_json(&all).unwrap(), json!({"s1": {"latency_ps": null, "at_m": [0.0, -0.5, 1e300]}}));
        assert_eq!(to_json(&(1u8, "x", BTreeMap::from([(7, 0.25)]))).unwrap(), json!([1, "x", {"7": 0.25}]));
    }

    #[test]
    fn a_number_that_json_has_no_word_for_is_refused_by_its_key() {
        for (latency_ps, y_m, place) in
            [(Some(f64::NAN), 0.0, "s1.latency_ps = NaN"), (None, f64::INFINITY, "s1.at_m = inf")]
        {
            let all = BTreeMap::from([("s1", Sensor { latency_ps, at_m: [0.0, y_m, 0.0] })]);
            let text = to_json(&all).unwrap_err().below("fields").to_string();
            assert!(text.contains(&format!("fields.{place}: must be finite")), "{text}");
        }
    }
}
