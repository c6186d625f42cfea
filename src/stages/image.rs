//! `image`: a volume image of what a wall shows, without patches or labels: which voxels are brighter than noise.
//!
//! Where laser and sensor look at the same points, on a square grid in one plane, the image is the light-cone transform
//! ([`crate::signal::image::light_cone`]) or f-k migration ([`crate::signal::image::migration`]), else filtered
//! back-projection ([`crate::signal::image::back_projection`]). All give each voxel the standard deviation that its
//! value has where nothing is hidden, so that the table holds voxels above a stated probability of false alarm, and
//! nothing else.
//!
//! The wall's own light is cut off at a gate: the first time over the hidden surface from which on a smooth tail
//! explains the sum of all histograms ([`crate::signal::image::gate`]).
//!
//! Takes `patches` (of `anchor` or `refine`: points of the wall), `profiles` and `calibration`. Writes `voxels`, one
//! row of `images`, and with `volume` all values. Captures of other roles than scene, and of patches without a place,
//! are left out.
//!
//! Not modelled: occlusion, normals, more than three bounces, errors of the wall's places, noise of voltages that is
//! correlated from sample to sample (it makes standard deviations too small).
//!
//! ```toml
//! [voxels]
//! stage = "image"
//! from = "anchors"
//! with = { profiles = "profiles", calibration = "calibration" }
//! ```

mod back_projection;
mod lattice;
mod light_cone;
mod migration;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::stage::{Apply, Beside, BesideTables, Grain, Outcome, Rejection, Side, Stage, StageError};
use crate::campaign::Campaign;
use crate::cancel::Cancel;
use crate::geometry::Point;
use crate::parameter::{Condition, NonNegative, Positive, Share, Within};
use crate::priors::calibration::Sensors;
use crate::priors::campaign_fields::{ByCampaign, Medium};
use crate::priors::relay_histograms::{Fields, Histogram, Times, Waveforms};
use crate::signal::image::back_projection::Stabiliser;
use crate::signal::image::light_cone::Scan;
use crate::tables::{Image, Patch, Row, VolumeRow, Voxel};
use crate::units::PatchId;
use lattice::{Grid, Summary, Wall};

/// Full width at half maximum of a Gaussian, in standard deviations.
const FWHM: f64 = 2.354_820_045_030_949_3;
/// Bins of a grid's scan across the response, at the far end.
const STEPS: f64 = 8.0;
/// Widths of the response to either side over which light counts as smooth.
const SMOOTH: f64 = 5.0;

/// Parameters of `image`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MakeImage {
    /// How voxels come from histograms.
    method: Method,
    /// Probability that noise alone exceeds the threshold in any voxel.
    false_alarm: Share,
    /// Time over the hidden surface from which on light counts, in place of the gate that is found.
    gate_ps: Option<NonNegative>,
    /// Largest depth.
    depth_max_m: Option<Positive>,
    /// Distance of voxels.
    pitch_m: Option<Positive>,
    /// Power of the distance with which light falls off.
    falloff: Within<0, 8>,
    /// Power of the signal over that of the noise.
    signal_to_noise: Positive,
    /// Whether the whole volume is kept.
    volume: bool,
}

/// How voxels come from histograms.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Method {
    Auto,
    LightCone,
    #[serde(rename = "f-k")]
    Migration,
    BackProjection,
}

impl Default for MakeImage {
    fn default() -> Self {
        Self {
            method: Method::Auto,
            false_alarm: Share::new(0.01),
            gate_ps: None,
            depth_max_m: None,
            pitch_m: None,
            falloff: Within::new(4.0),
            signal_to_noise: Positive::new(0.8),
            volume: false,
        }
    }
}

/// Campaigns, and the light of each capture.
pub struct Context {
    fields: ByCampaign<Fields>,
    waveforms: Waveforms,
    cancel: Cancel,
}

impl Stage for MakeImage {
    const KIND: &'static str = "image";
    const VERSION: u32 = 3;
    const GRAIN: Grain = Grain::All;
    const BESIDE: &'static [Beside] = &[
        Beside { name: "profiles", table: "profiles", required: true },
        Beside { name: "calibration", table: "calibration", required: true },
    ];
    const SIDES: &'static [Side] = &[
        Side { name: Image::TABLE, schema: Image::schema },
        Side { name: VolumeRow::TABLE, schema: VolumeRow::schema },
    ];
    const CONDITIONS: &'static [Condition] = &[
        Condition("pitch_m", "method", &["auto", "back-projection"]),
        Condition("falloff", "method", &["auto", "light-cone", "f-k"]),
        Condition("signal_to_noise", "method", &["auto", "light-cone"]),
    ];
    type Input = Patch;
    type Output = Voxel;
    type Fields = ByCampaign<Fields>;
    type Context = Context;

    fn fields(&self, campaigns: &[Campaign]) -> Self::Fields {
        ByCampaign::new(campaigns, |campaign| Fields::from(campaign))
    }

    fn context(&self, fields: Self::Fields, beside: &BesideTables) -> Result<Context, StageError> {
        let sensors = Sensors::new(&beside.rows("calibration")?.unwrap_or_default());
        let waveforms = Waveforms::new(beside.batches("profiles"), &sensors)?;
        Ok(Context { fields, waveforms, cancel: beside.cancel.clone() })
    }
}

impl Apply for MakeImage {
    fn apply(&self, context: &Context, group: Vec<Patch>) -> Result<Outcome<Voxel>, StageError> {
        let best = group.iter().filter(|patch| patch.alternative == 0);
        let points: BTreeMap<PatchId, Point> =
            best.map(|patch| (patch.patch, Point::new(patch.x_m, patch.y_m, patch.z_m))).collect();
        let histograms: Vec<Histogram<'_>> = context
            .waveforms
            .calibrated
            .iter()
            .filter_map(|waveform| Histogram::new(waveform, &points, |campaign| context.fields.get(campaign)))
            .collect();
        let mut rejections = left_out(context, histograms.len());
        let (rows, images, volume) = match self.image(context, &histograms)? {
            Ok((method, times, mut summary)) => {
                let image = self.row(method, histograms.len(), times, &summary);
                (summary.rows(method), vec![image], summary.volume())
            }
            Err(why) => {
                rejections.push(Rejection::new(context.fields.first_name(), why));
                (Vec::new(), Vec::new(), Vec::new())
            }
        };
        Ok(Outcome { rows, sides: vec![Image::to_batch(&images), VolumeRow::to_batch(&volume)], rejections })
    }
}

/// Method, times and image; or why there is none.
type Picture = Result<(&'static str, Times, Summary), String>;

impl MakeImage {
    fn image(&self, context: &Context, histograms: &[Histogram<'_>]) -> Result<Picture, StageError> {
        let Some((first, fields)) = histograms.first().zip(context.fields.first()) else {
            return Ok(Err("no capture of the scene has a calibration and places of its patches".to_owned()));
        };
        let medium = fields.medium;
        let times = match Times::new(histograms, self.gate_ps.map(NonNegative::get)) {
            Ok(times) => times,
            Err(why) => return Ok(Err(why)),
        };
        let wall = match Wall::new(histograms, fields.stations.source()) {
            Ok(wall) => wall,
            Err(why) => return Ok(Err(why)),
        };
        let grid = if self.method == Method::BackProjection { None } else { Grid::new(histograms, &wall) };
        if matches!(self.method, Method::LightCone | Method::Migration) && grid.is_none() {
            let method = if self.method == Method::LightCone { "light-cone" } else { "f-k" };
            return Err(StageError::Refused(format!(
                "method = \"{method}\" needs captures of a plane wall, lit and seen at the same point, on a grid of equal pitch; take out `method`"
            )));
        }
        let task =
            Task { params: self, histograms, times, medium, cancel: &context.cancel, width_ps: first.width_ps() };
        Ok(Ok(match grid {
            Some(grid) if self.method == Method::Migration => ("f-k", times, migration::image(&task, &grid)),
            Some(grid) => ("light-cone", times, light_cone::image(&task, &grid)),
            None => ("back-projection", times, back_projection::image(&task, &wall)?),
        }))
    }

    fn row(&self, method: &str, histograms: usize, times: Times, summary: &Summary) -> Image {
        let lattice = &summary.lattice;
        let ([along, up], normal) = (lattice.across, lattice.normal);
        let largest = summary.kept.largest.map(|(place, significance)| (lattice.point(place), significance));
        Image {
            method: method.into(),
            histograms: histograms as i32,
            gate_ps: times.gate_ps,
            end_ps: times.end_ps,
            columns: lattice.columns as i32,
            rows: lattice.rows as i32,
            depths: lattice.depths_m.len() as i32,
            pitch_m: lattice.pitch_m,
            corner_x_m: lattice.corner.x,
            corner_y_m: lattice.corner.y,
            corner_z_m: lattice.corner.z,
            along_x: along.x,
            along_y: along.y,
            along_z: along.z,
            up_x: up.x,
            up_y: up.y,
            up_z: up.z,
            normal_x: normal.x,
            normal_y: normal.y,
            normal_z: normal.z,
            depth_min_m: lattice.depths_m.first().copied().unwrap_or(0.0),
            depth_max_m: lattice.depths_m.last().copied().unwrap_or(0.0),
            cells: lattice.cells() as i64,
            false_alarm: self.false_alarm.get(),
            threshold: summary.threshold,
            voxels: summary.kept.bright.len() as i64,
            largest: largest.map(|(_, significance)| significance),
            largest_x_m: largest.map(|(point, _)| point.x),
            largest_y_m: largest.map(|(point, _)| point.y),
            largest_z_m: largest.map(|(point, _)| point.z),
        }
    }
}

/// Why captures of the scene are left out.
fn left_out(context: &Context, histograms: usize) -> Vec<Rejection> {
    let reject = |reason: String| Rejection::new(context.fields.first_name(), reason);
    let unplaced = context.waveforms.calibrated.len() - histograms;
    let mut rejections = Vec::new();
    if context.waveforms.uncalibrated > 0 {
        let count = context.waveforms.uncalibrated;
        rejections.push(reject(format!(
            "{count} profiles are of sensors without calibration, so that the time of their light is not known; capture a response for each sensor"
        )));
    }
    if unplaced > 0 {
        rejections.push(reject(format!(
            "{unplaced} profiles are of patches without a place; give `position_m` for both patches of each capture, or patches from `refine`"
        )));
    }
    rejections
}

/// What all methods take.
struct Task<'a> {
    params: &'a MakeImage,
    histograms: &'a [Histogram<'a>],
    times: Times,
    medium: Medium,
    cancel: &'a Cancel,
    /// Full width at half maximum of the response.
    width_ps: f64,
}

impl Task<'_> {
    /// Time of the first bin behind the gate; values, of counts stabilised, and their standard deviations.
    fn stabilised(&self, stabiliser: &Stabiliser, histogram: &Histogram<'_>) -> (f64, Vec<f64>, Vec<f64>) {
        self.cancel.check();
        let (first_ps, values) = histogram.behind(&self.times);
        let variances = histogram.variances(&self.times, &values);
        let (values, sd) = if histogram.is_counts() {
            stabiliser.apply(&values, &variances)
        } else {
            (values, variances.into_iter().map(f64::sqrt).collect())
        };
        (first_ps, values, sd)
    }

    /// Depths up to the largest one.
    fn depths_m(&self, depths_ps: impl Iterator<Item = f64>) -> Vec<f64> {
        let depth_max_m = self.params.depth_max_m.map_or(f64::INFINITY, Positive::get);
        depths_ps.map(|depth_ps| self.medium.path_m(depth_ps)).take_while(|depth_m| *depth_m <= depth_max_m).collect()
    }

    /// The scan of a grid, in steps of time of this width, or of a bin if that is wider.
    fn scan(&self, grid: &Grid, step_ps: f64) -> Scan {
        let (times, lattice) = (self.times, &grid.lattice);
        let dt_ps = self.histograms[0].dt_ps();
        // Beyond the farthest voxel light still comes from aside.
        let end_ps = self.params.depth_max_m.map_or(f64::INFINITY, |depth_m| {
            let [width_m, height_m] = [lattice.columns, lattice.rows].map(|count| count as f64 * lattice.pitch_m);
            self.medium.time_ps(2.0 * (depth_m.get().powi(2) + width_m.powi(2) + height_m.powi(2)).sqrt())
        });
        Scan {
            columns: lattice.columns,
            rows: lattice.rows,
            pitch_ps: self.medium.time_ps(lattice.pitch_m),
            times_ps: [times.gate_ps, times.end_ps.min(end_ps).max(times.gate_ps + dt_ps)],
            step_ps: step_ps.max(dt_ps),
        }
    }
}
