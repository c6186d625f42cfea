//! The wall, the grid of a confocal scan on it, and the voxels in front of it.

use nalgebra::Vector3;

use crate::geometry::{Point, planes};
use crate::priors::relay_histograms::Histogram;
use crate::tables::{Name, VolumeRow, Voxel};

/// Largest distance of a point from its place in a grid, in pitches.
const OFF: f64 = 0.05;
/// Least points along a side of a grid.
const SIDE: usize = 4;
/// Points closer than this share of the wall's size to a line span no plane.
const IN_LINE: f64 = 1e-3;

/// The plane nearest to all points that are lit or seen.
pub struct Wall {
    /// Their middle.
    middle: Point,
    /// Two directions in the plane, at right angles.
    across: [Vector3<f64>; 2],
    /// Unit normal, towards the laser: there everything hidden is.
    normal: Vector3<f64>,
    /// Least and largest coordinates of the points along both directions.
    ends_m: [[f64; 2]; 2],
}

impl Wall {
    /// The wall of the histograms' points; or why there is none.
    pub fn new(histograms: &[Histogram<'_>], source: Point) -> Result<Self, String> {
        let points: Vec<Point> = histograms.iter().flat_map(|one| [one.lit, one.seen]).collect();
        let (middle, normal) = planes::nearest(&points, 3);
        let normal = if normal.dot(&(source - middle)) < 0.0 { -normal } else { normal };
        // The axis of the frame that lies best in the plane, so that voxels of walls along the axes are in order.
        let axis = Vector3::ith(normal.iamin(), 1.0);
        let first = (axis - normal * normal.dot(&axis)).normalize();
        let wall = Self { middle, across: [first, upwards(normal.cross(&first))], normal, ends_m: [[0.0; 2]; 2] };
        let ends_m = wall.across.map(|across| {
            let along = || points.iter().map(|point| across.dot(&(point - middle)));
            [along().fold(f64::INFINITY, f64::min), along().fold(f64::NEG_INFINITY, f64::max)]
        });
        let [width_m, height_m] = ends_m.map(|[least, most]| most - least);
        if width_m.min(height_m) <= IN_LINE * width_m.max(height_m) {
            return Err("the points of the wall lie in one line, or in one place: what is hidden may turn about it; light and see points off that line".to_owned());
        }
        Ok(Self { ends_m, ..wall })
    }

    /// Voxels in front of the whole wall, still without depths.
    pub fn lattice(&self, pitch_m: f64) -> Lattice {
        let count = |[least, most]: [f64; 2]| ((most - least) / pitch_m).floor() as usize + 1;
        let [columns, rows] = self.ends_m.map(count);
        let corner = self.middle + self.across[0] * self.ends_m[0][0] + self.across[1] * self.ends_m[1][0];
        Lattice { corner, across: self.across, normal: self.normal, columns, rows, pitch_m, depths_m: Vec::new() }
    }
}

/// The direction or its opposite: the one whose largest component is positive.
fn upwards(direction: Vector3<f64>) -> Vector3<f64> {
    if direction[direction.iamax()] < 0.0 { -direction } else { direction }
}

/// A confocal scan of a grid of equal pitch.
pub struct Grid {
    /// Voxels in front of the grid's points, still without depths.
    pub lattice: Lattice,
    /// The histogram of each point, row by row; `None` for a point without one.
    pub places: Vec<Option<usize>>,
}

impl Grid {
    /// `None` where points are lit and seen apart, or form no grid on the wall, or are missing by the half.
    pub fn new(histograms: &[Histogram<'_>], wall: &Wall) -> Option<Self> {
        let origin = histograms.iter().all(Histogram::is_confocal).then(|| histograms[0].lit)?;
        let steps = || histograms.iter().map(|one| one.lit - origin).filter(|step| step.norm() > 0.0);
        let step = steps().min_by(|a, b| a.norm().total_cmp(&b.norm()))?;
        let pitch_m = step.norm();
        let first = upwards((step - wall.normal * wall.normal.dot(&step)).normalize());
        let across = [first, upwards(wall.normal.cross(&first))];
        let mut cells = Vec::with_capacity(histograms.len());
        for histogram in histograms {
            let arm = histogram.lit - origin;
            let place = across.map(|across| across.dot(&arm) / pitch_m);
            let out = wall.normal.dot(&(histogram.lit - wall.middle)) / pitch_m;
            let is_off = place.iter().any(|place| (place - place.round()).abs() > OFF) || out.abs() > OFF;
            cells.push((!is_off).then(|| place.map(|place| place.round() as i64))?);
        }
        let [[left, right], [low, high]] = [0, 1].map(|axis| {
            let along = || cells.iter().map(|cell: &[i64; 2]| cell[axis]);
            [along().min().unwrap_or(0), along().max().unwrap_or(0)]
        });
        let (columns, rows) = ((right - left + 1) as usize, (high - low + 1) as usize);
        if columns.min(rows) < SIDE || 2 * histograms.len() < columns.checked_mul(rows)? {
            return None;
        }
        let mut places = vec![None; columns * rows];
        for (n, [x, y]) in cells.iter().enumerate() {
            let place = &mut places[(y - low) as usize * columns + (x - left) as usize];
            if place.replace(n).is_some() {
                return None;
            }
        }
        let corner = origin + (across[0] * left as f64 + across[1] * low as f64) * pitch_m;
        let lattice = Lattice { corner, across, normal: wall.normal, columns, rows, pitch_m, depths_m: Vec::new() };
        Some(Self { lattice, places })
    }
}

/// Voxels: rows and columns over the wall, at some depths.
#[derive(Clone, Debug)]
pub struct Lattice {
    /// Foot on the wall of the voxels of column 0 and row 0.
    pub corner: Point,
    /// Unit vectors along a row, and towards larger rows.
    pub across: [Vector3<f64>; 2],
    /// Unit normal of the wall, towards what is hidden.
    pub normal: Vector3<f64>,
    /// Voxels along a row.
    pub columns: usize,
    /// Rows.
    pub rows: usize,
    /// Distance of neighbours in a row and in a column.
    pub pitch_m: f64,
    /// Depths, ascending.
    pub depths_m: Vec<f64>,
}

impl Lattice {
    /// The same rows and columns at other depths.
    pub fn at(&self, depths_m: Vec<f64>) -> Self {
        Self { depths_m, ..self.clone() }
    }

    /// Number of voxels.
    pub fn cells(&self) -> usize {
        self.columns * self.rows * self.depths_m.len()
    }

    /// Middle of the voxel at a column, a row and a depth.
    pub fn point(&self, [column, row, depth]: [usize; 3]) -> Point {
        let [x_m, y_m] = [column, row].map(|place| place as f64 * self.pitch_m);
        self.corner + self.across[0] * x_m + self.across[1] * y_m + self.normal * self.depths_m[depth]
    }
}

/// A voxel above the threshold. There may be millions.
pub struct Bright {
    /// Column, row and depth.
    place: [u32; 3],
    value: f64,
    sd: f64,
}

/// What is kept of a row of voxels, or of all.
#[derive(Default)]
pub struct Row {
    /// Voxels above the threshold, in the order of the lattice.
    pub bright: Vec<Bright>,
    /// The most significant voxel, and its significance.
    pub largest: Option<([usize; 3], f64)>,
    /// All values, where the whole volume is kept.
    pub values: Vec<f32>,
}

impl Row {
    /// Keeps the voxel as the most significant one, if it is; of equal ones, the first.
    fn offer(&mut self, place: [usize; 3], significance: f64) {
        if self.largest.is_none_or(|(_, largest)| significance > largest) {
            self.largest = Some((place, significance));
        }
    }
}

/// What is kept of an image.
pub struct Summary {
    /// Its voxels.
    pub lattice: Lattice,
    /// Significance from which on voxels are kept.
    pub threshold: f64,
    /// Whether the whole volume is kept.
    pub is_whole: bool,
    /// Of all its rows.
    pub kept: Row,
}

impl Summary {
    /// Nothing yet.
    pub fn new(lattice: Lattice, threshold: f64, is_whole: bool) -> Self {
        Self { lattice, threshold, is_whole, kept: Row::default() }
    }

    /// What is kept of a row, from value and variance of its voxels: columns, and depths within them.
    pub fn row(&self, row: usize, voxels: impl Iterator<Item = (f64, f64)>) -> Row {
        let depths = self.lattice.depths_m.len();
        let mut kept = Row::default();
        for (n, (value, variance)) in voxels.enumerate() {
            let has_data = variance > 0.0;
            if self.is_whole {
                kept.values.push(if has_data { value as f32 } else { 0.0 });
            }
            if !has_data {
                continue;
            }
            let (place, sd) = ([n / depths, row, n % depths], variance.sqrt());
            kept.offer(place, value / sd);
            if value / sd > self.threshold {
                kept.bright.push(Bright { place: place.map(|n| n as u32), value, sd });
            }
        }
        kept
    }

    /// The image of all rows, in their order.
    pub fn join(mut self, rows: Vec<Row>) -> Self {
        self.kept.bright.reserve_exact(rows.iter().map(|row| row.bright.len()).sum());
        for row in rows {
            self.kept.bright.extend(row.bright);
            self.kept.values.extend(row.values);
            if let Some((place, significance)) = row.largest {
                self.kept.offer(place, significance);
            }
        }
        self
    }

    /// Rows of the table. What is kept of its voxels is given up for them.
    pub fn rows(&mut self, method: &str) -> Vec<Voxel> {
        let method = Name::from(method);
        let bright = std::mem::take(&mut self.kept.bright);
        let row = |Bright { place, value, sd }: Bright| {
            let at = place.map(|n| n as usize);
            let point = self.lattice.point(at);
            Voxel {
                method: Name::clone(&method),
                grid_column: place[0] as i32,
                grid_row: place[1] as i32,
                grid_depth: place[2] as i32,
                x_m: point.x,
                y_m: point.y,
                z_m: point.z,
                depth_m: self.lattice.depths_m[at[2]],
                value,
                sd,
                significance: value / sd,
            }
        };
        bright.into_iter().map(row).collect()
    }

    /// Rows of the whole volume; none unless it is kept.
    pub fn volume(&self) -> Vec<VolumeRow> {
        let Lattice { columns, depths_m, .. } = &self.lattice;
        let row = |(row, values): (usize, &[f32])| VolumeRow {
            grid_row: row as i32,
            columns: *columns as i32,
            depths: depths_m.len() as i32,
            values: values.to_vec().into(),
        };
        self.kept.values.chunks((columns * depths_m.len()).max(1)).enumerate().map(row).collect()
    }
}
