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
        /// Foot on the wall of the voxels of column 0 and row 0, x.
        corner_x_m: f64,
        /// The same, y.
        corner_y_m: f64,
        /// The same, z.
        corner_z_m: f64,
        /// Unit vector along a row, towards larger columns, x.
        along_x: f64,
        /// The same, y.
        along_y: f64,
        /// The same, z.
        along_z: f64,
        /// Unit vector towards larger rows, x.
        up_x: f64,
        /// The same, y.
        up_y: f64,
        /// The same, z.
        up_z: f64,
        /// Unit vector away from the wall, towards what is hidden, x.
        normal_x: f64,
        /// The same, y.
        normal_y: f64,
        /// The same, z.
        normal_z: f64,
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

impl Image {
    /// Depth of a place of the grid: equal steps of the square of the depth in the light-cone transform, equal steps
    /// else.
    #[must_use]
    pub fn depth_m(&self, place: usize) -> f64 {
        let share = place as f64 / f64::from(self.depths - 1).max(1.0);
        let between = |first: f64, last: f64| first + share * (last - first);
        match &*self.method {
            "light-cone" => between(self.depth_min_m.powi(2), self.depth_max_m.powi(2)).sqrt(),
            _ => between(self.depth_min_m, self.depth_max_m),
        }
    }

    /// Middle of the voxel at a column, a row and a depth.
    #[must_use]
    pub fn point_m(&self, [column, row, depth]: [usize; 3]) -> [f64; 3] {
        let [along_m, up_m] = [column, row].map(|place| place as f64 * self.pitch_m);
        let depth_m = self.depth_m(depth);
        let corner_m = [self.corner_x_m, self.corner_y_m, self.corner_z_m];
        let along = [self.along_x, self.along_y, self.along_z];
        let up = [self.up_x, self.up_y, self.up_z];
        let normal = [self.normal_x, self.normal_y, self.normal_z];
        std::array::from_fn(|axis| corner_m[axis] + along_m * along[axis] + up_m * up[axis] + depth_m * normal[axis])
    }
}
