//! Units and ids: the one place where a time becomes a length.
//!
//! Times are `f64` picoseconds, lengths `f64` metres, voltages `f64` volts; a name carries its unit (`time_ps`,
//! `distance_m`).

/// Speed of light in vacuum, metres per picosecond.
pub const SPEED_OF_LIGHT_M_PER_PS: f64 = 2.997_924_58e-4;

/// Number of a patch. Positive for patches; 0 stands for the source and camera (`p0` of the paper).
pub type PatchId = i32;

/// Path length in metres that light covers in `time_ps` in a medium of refractive (group) index `group_index`.
#[must_use]
pub fn path_m(time_ps: f64, group_index: f64) -> f64 {
    time_ps * SPEED_OF_LIGHT_M_PER_PS / group_index
}

/// Time in picoseconds that light needs for `path_m` metres in a medium of group index `group_index`.
#[must_use]
pub fn time_ps(path_m: f64, group_index: f64) -> f64 {
    path_m * group_index / SPEED_OF_LIGHT_M_PER_PS
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_nanosecond_is_thirty_centimetres_and_back() {
        assert!((path_m(1000.0, 1.0) - 0.299_792_458).abs() < 1e-12);
        assert!((time_ps(path_m(123.4, 1.000_277), 1.000_277) - 123.4).abs() < 1e-9);
    }
}
