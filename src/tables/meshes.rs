//! Tables `meshes` and `vertices`: hidden surfaces between the points that first light shows.

use crate::table;

table! {
    /// A hidden surface as a height over a grid, fitted to first light at all points of a wall. Its nodes are in
    /// `vertices`.
    "meshes": Mesh, MeshColumns {
        /// Number, from 1, in order of decreasing number of points of the wall.
        mesh: i32,
        /// Unit vector along which heights are measured, towards the wall. x, in the frame of the patches.
        axis_x: f64,
        /// The same, y.
        axis_y: f64,
        /// The same, z.
        axis_z: f64,
        /// Distance of nodes across it.
        spacing_m: f64,
        /// Nodes that first light shows.
        nodes: i32,
        /// Median of their standard deviations along the normal.
        median_sd_m: f64,
        /// Size of curvatures that first light makes likeliest.
        bend_per_m: f64,
        /// Points of the wall that it was fitted to.
        wall_points: i32,
        /// Chi-square of their first light over their number.
        misfit: f64,
    }
}

table! {
    /// A node of a hidden surface. Nodes of a mesh whose rows and columns differ by 1 are neighbours. The edge of
    /// the surface is not estimated: no node lies within about two nodes of it.
    "vertices": Vertex, VertexColumns {
        /// Mesh of `meshes`.
        mesh: i32,
        /// Row in its grid, from 0.
        grid_row: i32,
        /// Column in its grid, from 0.
        grid_column: i32,
        /// Position, x, in the frame of the patches.
        x_m: f64,
        /// The same, y.
        y_m: f64,
        /// The same, z.
        z_m: f64,
        /// Standard deviation along the normal. Errors of neighbours are alike.
        sd_m: f64,
        /// Unit normal, towards the wall. x.
        normal_x: f64,
        /// The same, y.
        normal_y: f64,
        /// The same, z.
        normal_z: f64,
        /// Root of the sum of the variances of the normal's two angles.
        normal_sd_rad: f64,
    }
}
