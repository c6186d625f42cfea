//! Finds the nearest valid word to a mistyped one, for error messages.
//!
//! Distance: optimal string alignment, ignoring case (insert, delete, replace, or swap two neighbours: cost 1 each). A
//! word that lacks only the unit at its end (`dt` for `dt_ps`) costs 1. Not modelled: meaning, and the layout of the
//! keyboard.

/// The candidate nearest to `word`, if it is near enough: at most a third of the longer word (rounded up) may differ.
/// Among equally near ones, the first.
///
/// ```text
/// nearest("postion_m", ["sd_m", "position_m"]) == Some("position_m")
/// ```
pub fn nearest<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    candidates
        .into_iter()
        .map(|candidate| (distance(word, candidate), candidate))
        .filter(|(cost, candidate)| {
            let length = word.chars().count().max(candidate.chars().count());
            *cost <= length.div_ceil(3)
        })
        .min_by_key(|(cost, _)| *cost)
        .map(|(_, candidate)| candidate)
}

/// The end of a message about an unknown word: the nearest candidate, or all of them.
pub fn hint<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> String {
    let candidates: Vec<&str> = candidates.into_iter().collect();
    match nearest(word, candidates.iter().copied()) {
        Some(near) => format!("did you mean `{near}`?"),
        None if candidates.is_empty() => "none is known here".to_owned(),
        None => format!("known: {}", candidates.join(", ")),
    }
}

/// A whole message about an unknown word: its kind, and the likely correction.
pub fn unknown(what: &str, word: &str, candidates: &[&str]) -> String {
    format!("unknown {what} `{word}`; {}", hint(word, candidates.iter().copied()))
}

/// Serde's message about an unknown field or variant, with the nearest candidate in place of the list. Other messages
/// stay.
pub fn explain(message: &str) -> String {
    let quoted: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
    match (message.strip_prefix("unknown field "), message.strip_prefix("unknown variant "), quoted.split_first()) {
        (Some(_), _, Some((word, candidates))) => unknown("key", word, candidates),
        (_, Some(_), Some((word, candidates))) => unknown("value", word, candidates),
        _ => message.trim_end().to_owned(),
    }
}

fn distance(word: &str, candidate: &str) -> usize {
    let a: Vec<char> = word.to_lowercase().chars().collect();
    let b: Vec<char> = candidate.to_lowercase().chars().collect();
    if !a.is_empty() && b.len() > a.len() && b.starts_with(&a) && b[a.len()] == '_' {
        return 1;
    }
    // Three rows of the table of distances between prefixes: two back, one back, this one.
    let mut back2 = vec![0; b.len() + 1];
    let mut back1: Vec<usize> = (0..=b.len()).collect();
    for i in 1..=a.len() {
        let mut row = vec![i; b.len() + 1];
        for j in 1..=b.len() {
            let replace = back1[j - 1] + usize::from(a[i - 1] != b[j - 1]);
            row[j] = replace.min(back1[j] + 1).min(row[j - 1] + 1);
            if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                row[j] = row[j].min(back2[j - 2] + 1);
            }
        }
        back2 = std::mem::replace(&mut back1, row);
    }
    back1[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The definition, by recursion over the ends of both words.
    fn naive(a: &[char], b: &[char]) -> usize {
        let (Some((x, a1)), Some((y, b1))) = (a.split_last(), b.split_last()) else {
            return a.len().max(b.len());
        };
        let mut cost = (naive(a1, b1) + usize::from(x != y)).min(naive(a1, b) + 1).min(naive(a, b1) + 1);
        if let (Some((x2, a2)), Some((y2, b2))) = (a1.split_last(), b1.split_last())
            && x == y2
            && y == x2
        {
            cost = cost.min(naive(a2, b2) + 1);
        }
        cost
    }

    #[test]
    fn distances_are_those_of_the_definition() {
        let words = ["", "lit", "lti", "seen", "sene", "shot", "shto", "s", "rnage", "range"];
        for a in words {
            for b in words {
                let (x, y): (Vec<char>, Vec<char>) = (a.chars().collect(), b.chars().collect());
                assert_eq!(distance(a, b), naive(&x, &y), "{a} {b}");
            }
        }
    }

    #[test]
    fn the_nearest_key_is_found_and_a_far_one_is_not() {
        let keys = ["sd_m", "position_m", "dt_ps", "gain_v"];
        assert_eq!(nearest("postion_m", keys), Some("position_m"));
        assert_eq!(nearest("dt", keys), Some("dt_ps"));
        assert_eq!(nearest("Gain_V", keys), Some("gain_v"));
        assert_eq!(nearest("colour", keys), None);
        assert_eq!(hint("colour", ["a", "b"]), "known: a, b");
    }
}
