//! Tables `voxels`, `images` and `volumes`: a volume image of what is hidden.

use super::cell::{Name, Samples};
use crate::table;

table! {
    /// One voxel of an image, of those whose significance exceeds the image's threshold, in order of the grid: rows,
    /// columns, depths. Table `images` describes the grid.
    "voxels": Voxel, VoxelColumns {
        /// light-cone, f-k or back-projection.
        method: Name,
        /// Column of the grid, from 0.
        grid_column: i32,
        /// Row of the grid, from 0.
        grid_row: i32,
        /// Depth of the grid, from 0.
        grid_depth: i32,
        /// Middle of the voxel, x, in the frame of the patches.
        x_m: f64,
        /// Middle of the voxel, y.
        y_m: f64,
        /// Middle of the voxel, z.
        z_m: f64,
        /// Distance of the voxel from the wall.
        depth_m: f64,
        /// Brightness, on the scale of the method.
        value: f64,
        /// Standard deviation of the value where nothing is hidden.
        sd: f64,
        /// Value over standard deviation.
        significance: f64,
    }
}

table! {
    /// An image as a whole: one row, also where no voxel exceeds the threshold.
    "images": Image, ImageColumns {
        /// light-cone, f-k or back-projection.
        method: Name,
        /// Histograms that entered.
        histograms: i32,
        /// Time over the hidden surface from which on light counts.
        gate_ps: f64,
        /// End of the histograms, as time over the hidden surface.
        end_ps: f64,
        /// Voxels along a row.
        columns: i32,
        /// Rows of voxels.
        rows: i32,
        /// Voxels in depth.
        depths: i32,
        /// Distance of neighbours in a row.
        pitch_m: f64,
        /// Depth of the nearest voxels.
        depth_min_m: f64,
        /// Depth of the farthest voxels.
        depth_max_m: f64,
        /// Voxels with data: the cells among which noise may exceed the threshold.
        cells: i64,
        /// Probability that noise exceeds the threshold in any cell.
        false_alarm: f64,
        /// Least significance of the voxels in the table.
        threshold: f64,
        /// Number of voxels in the table.
        voxels: i64,
        /// Largest significance of all voxels; null without cells.
        largest: Option<f64>,
        /// Place of that voxel, x.
        largest_x_m: Option<f64>,
        /// Place of that voxel, y.
        largest_y_m: Option<f64>,
        /// Place of that voxel, z.
        largest_z_m: Option<f64>,
    }
}

table! {
    /// One row of an image's grid, with all its voxels. Empty unless the whole volume was asked for.
    "volumes": VolumeRow, VolumeRowColumns {
        /// Row of the grid, from 0.
        grid_row: i32,
        /// Columns of the grid.
        columns: i32,
        /// Depths of the grid.
        depths: i32,
        /// Brightness of the voxels, on the scale of the method: depths of the first column, then those of the next;
        /// 0 where there is no data.
        values: Samples,
    }
}
