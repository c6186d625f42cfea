//! Patches as a point cloud: PLY, the format of MeshLab, CloudCompare and Open3D.
//!
//! One vertex for each patch of the best solution: place in metres, a colour for the eye (visible grey, hidden orange,
//! mirror blue), number, kind (0, 1, 2). Then the standard deviation and the six numbers of the covariance; these are
//! NaN for start values, which have none.

use std::io::{self, Write};

use crate::tables::Patch;

/// Kinds of patches by their numbers, with the colour of each.
const KINDS: [(&str, [u8; 3]); 3] =
    [("visible", [160, 160, 160]), ("hidden", [230, 120, 20]), ("mirror", [40, 110, 220])];

/// Writes the best alternative of the patches; says how many.
///
/// # Errors
/// When `out` cannot be written.
pub fn write(out: &mut impl Write, patches: &[Patch]) -> io::Result<usize> {
    let best: Vec<&Patch> = patches.iter().filter(|patch| patch.alternative == 0).collect();
    writeln!(out, "ply\nformat ascii 1.0\ncomment kind: 0 visible, 1 hidden, 2 mirror; lengths in metres")?;
    writeln!(out, "element vertex {}", best.len())?;
    ["x", "y", "z"].iter().try_for_each(|name| writeln!(out, "property double {name}"))?;
    ["red", "green", "blue"].iter().try_for_each(|name| writeln!(out, "property uchar {name}"))?;
    writeln!(out, "property int patch\nproperty uchar kind")?;
    let cov = ["xx", "xy", "xz", "yy", "yz", "zz"].map(|pair| format!("cov_{pair}_m2"));
    std::iter::once("sd_m")
        .chain(cov.iter().map(String::as_str))
        .try_for_each(|name| writeln!(out, "property double {name}"))?;
    writeln!(out, "end_header")?;
    for patch in &best {
        let kind = KINDS.iter().position(|(kind, _)| **kind == *patch.kind).unwrap_or(0);
        let [red, green, blue] = KINDS[kind].1;
        write!(out, "{} {} {} {red} {green} {blue} {} {kind}", patch.x_m, patch.y_m, patch.z_m, patch.patch)?;
        let of_cov =
            [patch.cov_xx_m2, patch.cov_xy_m2, patch.cov_xz_m2, patch.cov_yy_m2, patch.cov_yz_m2, patch.cov_zz_m2];
        for value in std::iter::once(patch.sd_m).chain(of_cov) {
            match value {
                Some(value) => write!(out, " {value:e}")?,
                None => write!(out, " nan")?,
            }
        }
        writeln!(out)?;
    }
    Ok(best.len())
}
