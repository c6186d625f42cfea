//! A bounce path: the patches that light met, in order, between source and sensor (paper section 4).
//!
//! The path of a first bounce is `[i]`, of a second bounce `[j, i]` (lit `j`, seen `i`), of a third `[k, j, i]`.
//! The paper writes the receiver first (`O_ij` is received at `i`, lit at `j`); here light's own order holds everywhere.

use crate::units::PatchId;

/// Number of bounces of a path.
#[must_use]
pub fn bounces(path: &[PatchId]) -> i32 {
    path.len() as i32
}

/// The same path walked backwards: reciprocity says that it takes the same time when source and sensor coincide.
#[must_use]
pub fn reversed(path: &[PatchId]) -> Vec<PatchId> {
    path.iter().rev().copied().collect()
}

/// Text such as `0-4-1-0`: source, patches, sensor.
#[must_use]
pub fn text(path: &[PatchId]) -> String {
    let mut text = String::from("0");
    for patch in path {
        text.push('-');
        text.push_str(&patch.to_string());
    }
    text.push_str("-0");
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_reads_as_light_goes() {
        assert_eq!(text(&[4, 1]), "0-4-1-0");
        assert_eq!(reversed(&[4, 2, 1]), vec![1, 2, 4]);
        assert_eq!(bounces(&[4, 2, 1]), 3);
    }
}
