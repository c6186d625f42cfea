//! The volume image of what a wall shows: its projections, and its brightest voxels as points.

use super::sources::Sources;
use super::spread;
use crate::history::HistoryError;
use crate::tables::{self, Voxel};

/// Voxels drawn as points at most.
const POINTS: usize = 4000;
/// A coordinate that grows with a place in the grid to this is named after its axis.
const SAME_M: f64 = 1e-6;

/// An axis of the grid, cut to where voxels exceed the threshold.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// x, y or z of the frame where it runs along one, else what it is.
    pub title: String,
    /// Middles of the voxels.
    pub middles_m: Vec<f64>,
    /// Place of the first in the grid.
    first: usize,
}

/// The largest significance along the third axis; `None` where no voxel exceeds the threshold.
pub struct Projection {
    /// Horizontal axis.
    pub across: Axis,
    /// Vertical axis.
    pub up: Axis,
    /// Row by row, the lowest first.
    pub levels: Vec<Vec<Option<f64>>>,
}

/// An image.
pub struct Image {
    /// Heading of the table of voxels.
    pub heading: String,
    /// Its row.
    pub whole: tables::Image,
    /// As seen from the wall, from above and from the side; none where no voxel exceeds the threshold.
    pub projections: Vec<(&'static str, Projection)>,
    /// Middles and significance of voxels, a choice.
    pub points: Vec<([f64; 3], f64)>,
}

impl Image {
    /// The image; `None` where no stage made one.
    ///
    /// # Errors
    /// When a table cannot be read.
    pub fn of(sources: &Sources<'_>) -> Result<Option<Self>, HistoryError> {
        let (Some(heading), Some(whole)) = (sources.heading("voxels"), sources.rows(|_: &tables::Image| true)?.pop())
        else {
            return Ok(None);
        };
        let voxels: Vec<Voxel> = sources.rows(|_: &Voxel| true)?;
        let projections = if voxels.is_empty() { Vec::new() } else { projections(&whole, &voxels) };
        let points =
            spread(&voxels, POINTS).iter().map(|one| ([one.x_m, one.y_m, one.z_m], one.significance)).collect();
        Ok(Some(Self { heading, whole, projections, points }))
    }
}

/// Column, row and depth of a voxel.
fn place(voxel: &Voxel) -> [usize; 3] {
    [voxel.grid_column, voxel.grid_row, voxel.grid_depth].map(|place| place as usize)
}

fn projections(whole: &tables::Image, voxels: &[Voxel]) -> Vec<(&'static str, Projection)> {
    let axes: [Axis; 3] = std::array::from_fn(|axis| {
        if axis == 2 {
            cut(voxels, 2, "depth (m)".to_owned(), |place| whole.depth_m(place))
        } else {
            let (title, start_m) = along(voxels, axis, whole.pitch_m);
            cut(voxels, axis, title, |place| start_m + place as f64 * whole.pitch_m)
        }
    });
    let view = |across: usize, up: usize| {
        let (across_axis, up_axis) = (&axes[across], &axes[up]);
        let mut levels = vec![vec![None; across_axis.middles_m.len()]; up_axis.middles_m.len()];
        for voxel in voxels {
            let at = place(voxel);
            let level: &mut Option<f64> = &mut levels[at[up] - up_axis.first][at[across] - across_axis.first];
            *level = Some(level.map_or(voxel.significance, |level| level.max(voxel.significance)));
        }
        Projection { across: across_axis.clone(), up: up_axis.clone(), levels }
    };
    vec![("seen from the wall", view(0, 1)), ("along the rows", view(0, 2)), ("along the columns", view(1, 2))]
}

/// The stretch of an axis that voxels reach.
fn cut(voxels: &[Voxel], axis: usize, title: String, middle_m: impl Fn(usize) -> f64) -> Axis {
    let places = || voxels.iter().map(|voxel| place(voxel)[axis]);
    let (first, last) = (places().min().unwrap_or(0), places().max().unwrap_or(0));
    Axis { title, middles_m: (first..=last).map(middle_m).collect(), first }
}

/// Title of an axis of the wall, and the coordinate of its first voxel: those of x, y or z where it runs along one.
fn along(voxels: &[Voxel], axis: usize, pitch_m: f64) -> (String, f64) {
    let start_m = |voxel: &Voxel, at_m: f64| at_m - place(voxel)[axis] as f64 * pitch_m;
    let coordinates: [(&str, fn(&Voxel) -> f64); 3] =
        [("x (m)", |voxel| voxel.x_m), ("y (m)", |voxel| voxel.y_m), ("z (m)", |voxel| voxel.z_m)];
    let is_along = |at: &fn(&Voxel) -> f64| {
        let first_m = start_m(&voxels[0], at(&voxels[0]));
        voxels.iter().all(|voxel| (start_m(voxel, at(voxel)) - first_m).abs() < SAME_M)
    };
    match coordinates.iter().find(|(_, at)| is_along(at)) {
        Some((title, at)) => ((*title).to_owned(), start_m(&voxels[0], at(&voxels[0]))),
        None => (["across the wall (m)", "up the wall (m)"][axis].to_owned(), 0.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn voxel([grid_column, grid_row, grid_depth]: [i32; 3], significance: f64) -> Voxel {
        let [x_m, y_m] = [grid_column, grid_row].map(|place| 0.1 * f64::from(place) - 0.5);
        Voxel { grid_column, grid_row, grid_depth, x_m, y_m, significance, ..Voxel::default() }
    }

    #[test]
    fn each_view_has_the_most_significant_voxel_along_its_line() {
        let whole = tables::Image {
            method: "light-cone".into(),
            pitch_m: 0.1,
            depths: 17,
            depth_min_m: 0.0,
            depth_max_m: 2.0,
            ..tables::Image::default()
        };
        let views = projections(&whole, &[voxel([2, 3, 4], 7.0), voxel([2, 3, 16], 9.0), voxel([4, 3, 4], 8.0)]);
        let [front, top, side] = [0, 1, 2].map(|view| &views[view].1);
        assert_eq!((front.across.title.as_str(), front.up.title.as_str()), ("x (m)", "y (m)"));
        assert_eq!(front.levels, [vec![Some(9.0), None, Some(8.0)]]);
        assert!((front.across.middles_m[0] + 0.3).abs() < 1e-12 && front.across.middles_m.len() == 3);
        // Equal steps of the square: a fourth of the way is half the depth.
        assert_eq!((top.up.middles_m[0], top.up.middles_m[12]), (1.0, 2.0));
        assert_eq!((top.levels[0].as_slice(), top.levels[12][0]), (&[Some(7.0), None, Some(8.0)][..], Some(9.0)));
        assert_eq!((side.levels[0][0], side.levels[12][0]), (Some(8.0), Some(9.0)));
    }
}
