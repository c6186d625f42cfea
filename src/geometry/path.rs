//! A bounce path: the patches that light met, in order, between source and sensor (paper section 4).
//!
//! The path of a first bounce is `[i]`, of a second bounce `[j, i]` (lit `j`, seen `i`), of a third `[k, j, i]`. The
//! paper writes the receiver first (`O_ij` is received at `i`, lit at `j`); here light's own order holds everywhere.

use crate::units::PatchId;

/// Number of bounces of a path.
#[must_use]
pub fn bounces(path: &[PatchId]) -> i32 {
    path.len() as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_has_as_many_bounces_as_patches() {
        assert_eq!(bounces(&[4, 2, 1]), 3);
    }
}
