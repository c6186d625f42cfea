//! The volume of an image as a file that y-tal reads.
//!
//! y-tal 0.20 has no file of its own for a reconstruction: its functions return arrays, and take the places of voxels
//! as an array `volume_xyz` of axes (x, y, z, 3). `tal.io.capture_data.read_hdf5` returns whatever arrays an HDF5 file
//! has. So the file holds `reconstruction` (x, y, z), `volume_xyz`, and `volume_format`.

use std::io::{self, Write};

use super::y_tal_file::enumerator;
use crate::formats::array::{Array, Arrays};
use crate::formats::hdf5;
use crate::tables::{Image, VolumeRow};
use crate::waveform::CodeType;

/// Number of y-tal's enumeration for axes (x, y, z, 3).
const X_Y_Z_3: i32 = 2;

/// Writes all values of an image and the middles of its voxels in metres: columns, rows, depths. `rows` are in order.
///
/// # Errors
/// When `out` cannot be written, or the volume has another size than the image.
pub fn write(out: &mut impl Write, image: &Image, rows: &[VolumeRow]) -> io::Result<()> {
    let [columns, depths] = [image.columns, image.depths].map(|count| count as usize);
    let has_size = |row: &VolumeRow| row.columns == image.columns && row.depths == image.depths;
    if rows.len() != image.rows as usize || !rows.iter().all(has_size) {
        return Err(io::Error::other("the volume has another size than its image; run again"));
    }
    let axes = [columns, rows.len(), depths];
    let floats = |axes: &[usize], codes: Vec<u8>| Array { axes: axes.to_vec(), code_type: CodeType::F32, codes };
    let (mut values, mut places) = (Vec::new(), Vec::new());
    for (column, (y, row)) in (0..columns).flat_map(|column| rows.iter().enumerate().map(move |row| (column, row))) {
        for (depth, value) in row.values[column * depths..][..depths].iter().enumerate() {
            values.extend(value.to_le_bytes());
            let point_m = image.point_m([column, y, depth]);
            places.extend(point_m.into_iter().flat_map(|along_m| (along_m as f32).to_le_bytes()));
        }
    }
    let arrays = Arrays::from([
        ("reconstruction".to_owned(), floats(&axes, values)),
        ("volume_xyz".to_owned(), floats(&[axes.as_slice(), &[3]].concat(), places)),
        ("volume_format".to_owned(), enumerator(X_Y_Z_3)),
    ]);
    hdf5::write(out, &arrays)
}
