//! Numbers of things in words: "1 file", "2 files".

use std::fmt::Display;

/// A number of things, with the noun for one or for many.
pub fn count<N: Display + PartialEq + From<u8>>(number: N, one: &str, many: &str) -> String {
    let noun = if number == N::from(1) { one } else { many };
    format!("{number} {noun}")
}

#[cfg(test)]
mod tests {
    use super::count;

    #[test]
    fn one_is_singular_and_none_plural() {
        assert_eq!([0_usize, 1, 2].map(|number| count(number, "row", "rows")), ["0 rows", "1 row", "2 rows"]);
    }
}
