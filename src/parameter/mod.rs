//! Types of stage parameters: each says which values it takes, and refuses all others where it is read.
//!
//! A parameter of a stage is one field with one of these types. [`read`] makes a stage from a pipeline file and words
//! what it refuses.

mod fault;
mod read;

use std::fmt;
use std::marker::PhantomData;

use serde::de::{Unexpected, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

pub use fault::{Condition, Conflict};
pub use read::read;

/// An interval of the real numbers.
pub trait Interval: Copy + Send + Sync + 'static {
    /// Lower end.
    const LEAST: f64;
    /// Upper end; infinite for none.
    const MOST: f64;
    /// Whether the ends belong to it. Infinity never does.
    const IS_CLOSED: bool;
}

/// Above 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AboveZero;
/// 0 or more.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FromZero;
/// Between 0 and 1, without both ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BelowOne;
/// From one whole number to another, with both ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FromTo<const LEAST: i32, const MOST: i32>;

impl Interval for AboveZero {
    const LEAST: f64 = 0.0;
    const MOST: f64 = f64::INFINITY;
    const IS_CLOSED: bool = false;
}

impl Interval for FromZero {
    const LEAST: f64 = 0.0;
    const MOST: f64 = f64::INFINITY;
    const IS_CLOSED: bool = true;
}

impl Interval for BelowOne {
    const LEAST: f64 = 0.0;
    const MOST: f64 = 1.0;
    const IS_CLOSED: bool = false;
}

impl<const LEAST: i32, const MOST: i32> Interval for FromTo<LEAST, MOST> {
    const LEAST: f64 = LEAST as f64;
    const MOST: f64 = MOST as f64;
    const IS_CLOSED: bool = true;
}

/// A finite number of an interval. Negative zero becomes zero: they are equal, so they must look equal in a recipe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Number<I>(f64, PhantomData<I>);

/// A finite number above 0.
pub type Positive = Number<AboveZero>;
/// A finite number of 0 or more.
pub type NonNegative = Number<FromZero>;
/// A share or a probability: above 0 and below 1.
pub type Share = Number<BelowOne>;
/// A number from `LEAST` to `MOST`, both included.
pub type Within<const LEAST: i32, const MOST: i32> = Number<FromTo<LEAST, MOST>>;

impl<I: Interval> Number<I> {
    /// A number that is known to lie in the interval, such as a default.
    ///
    /// # Panics
    /// When it does not; in a constant, when it is compiled.
    #[must_use]
    pub const fn new(value: f64) -> Self {
        match Self::of(value) {
            Some(number) => number,
            None => panic!("the number is outside of the interval of its type"),
        }
    }

    const fn of(value: f64) -> Option<Self> {
        let is_inside =
            if I::IS_CLOSED { value >= I::LEAST && value <= I::MOST } else { value > I::LEAST && value < I::MOST };
        // Adding 0 leaves every number as it is but -0.
        if is_inside && value.is_finite() { Some(Self(value + 0.0, PhantomData)) } else { None }
    }

    /// The number.
    #[must_use]
    pub const fn get(self) -> f64 {
        self.0
    }
}

impl<I> Serialize for Number<I> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_f64(self.0)
    }
}

impl<'de, I: Interval> Deserialize<'de> for Number<I> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_f64(NumberVisitor(PhantomData))
    }
}

struct NumberVisitor<I>(PhantomData<I>);

impl<I: Interval> Visitor<'_> for NumberVisitor<I> {
    type Value = Number<I>;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let (least, most) = (I::LEAST, I::MOST);
        match (I::IS_CLOSED, most.is_finite()) {
            (true, true) => write!(f, "a number from {least} to {most}"),
            (true, false) => write!(f, "{least} or more and finite"),
            (false, true) => write!(f, "above {least} and below {most}"),
            (false, false) => write!(f, "above {least} and finite"),
        }
    }

    fn visit_f64<E: serde::de::Error>(self, value: f64) -> Result<Number<I>, E> {
        Number::of(value).ok_or_else(|| E::invalid_value(Unexpected::Float(value), &self))
    }

    fn visit_i64<E: serde::de::Error>(self, value: i64) -> Result<Number<I>, E> {
        self.visit_f64(value as f64)
    }

    fn visit_u64<E: serde::de::Error>(self, value: u64) -> Result<Number<I>, E> {
        self.visit_f64(value as f64)
    }
}

/// The most that a count may be where nothing narrower is given.
pub const COUNT_MOST: u32 = 1_000_000_000;

/// A whole number from `LEAST` to `MOST`, both included.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Count<const LEAST: u32 = 1, const MOST: u32 = COUNT_MOST>(u32);

impl<const LEAST: u32, const MOST: u32> Count<LEAST, MOST> {
    /// A number that is known to lie in the range, such as a default.
    ///
    /// # Panics
    /// When it does not; in a constant, when it is compiled.
    #[must_use]
    pub const fn new(value: u32) -> Self {
        assert!(LEAST <= value && value <= MOST, "the count is outside of the range of its type");
        Self(value)
    }

    /// The number.
    #[must_use]
    pub const fn get(self) -> u32 {
        self.0
    }
}

impl<const LEAST: u32, const MOST: u32> Serialize for Count<LEAST, MOST> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_u32(self.0)
    }
}

impl<'de, const LEAST: u32, const MOST: u32> Deserialize<'de> for Count<LEAST, MOST> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_u32(CountVisitor)
    }
}

struct CountVisitor<const LEAST: u32, const MOST: u32>;

impl<const LEAST: u32, const MOST: u32> Visitor<'_> for CountVisitor<LEAST, MOST> {
    type Value = Count<LEAST, MOST>;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "a whole number from {LEAST} to {MOST}")
    }

    fn visit_i64<E: serde::de::Error>(self, value: i64) -> Result<Self::Value, E> {
        let count = u32::try_from(value).ok().filter(|count| (LEAST..=MOST).contains(count));
        count.map(Count).ok_or_else(|| E::invalid_value(Unexpected::Signed(value), &self))
    }

    fn visit_u64<E: serde::de::Error>(self, value: u64) -> Result<Self::Value, E> {
        let refused = || E::invalid_value(Unexpected::Unsigned(value), &self);
        i64::try_from(value).map_err(|_| refused()).and_then(|value| self.visit_i64(value))
    }
}

#[cfg(test)]
mod tests;
