//! Where the surfaces are, the paths of light that say so, and what is left open.

use std::collections::{BTreeMap, BTreeSet};

use super::arrivals::Arrivals;
use super::campaigns::Campaigns;
use super::sources::Sources;
use super::spread;
use crate::campaign::Campaign;
use crate::campaign::keys::LASER;
use crate::geometry::ellipsoid::semi_axes_m;
use crate::history::HistoryError;
use crate::tables::{
    Ambiguity, Decision, Fit, Gap, Hypothesis, JointSearch, Mesh, Patch, PatchFootprint, Plane, Shape, SurfacePoint,
    Suspect, Vertex,
};

/// Paths drawn at most.
const RAYS: usize = 120;
/// Points of a surface drawn at most.
const SURFACE_POINTS: usize = 5000;
/// Ellipsoids are drawn so much larger that the longest semi-axes, but for a tenth of the patches, are about this share
/// of the scene.
const ELLIPSOID_SHARE: f64 = 0.04;

/// A patch with its ellipsoid.
pub struct Placed {
    /// Its row.
    pub patch: Patch,
    /// Semi-axes of one standard deviation, longest first; `None` for a start value.
    pub semi_axes_m: Option<[[f64; 3]; 3]>,
}

impl Placed {
    fn new(patch: Patch) -> Self {
        let covariance = || {
            let [xx, xy, xz] = [patch.cov_xx_m2?, patch.cov_xy_m2?, patch.cov_xz_m2?];
            let [yy, yz, zz] = [patch.cov_yy_m2?, patch.cov_yz_m2?, patch.cov_zz_m2?];
            Some([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        };
        Self { semi_axes_m: covariance().map(|covariance| semi_axes_m(&covariance)), patch }
    }

    /// Its place.
    pub fn at(&self) -> [f64; 3] {
        [self.patch.x_m, self.patch.y_m, self.patch.z_m]
    }
}

/// A path of light over patches that were found.
pub struct Ray {
    /// Bounces.
    pub bounces: usize,
    /// Whether it meets a patch that neither laser nor sensor sees.
    pub is_hidden: bool,
    /// Its corners: laser, patches, sensor.
    pub corners_m: Vec<[f64; 3]>,
}

/// The answer.
pub struct Scene {
    /// Heading of the table of positions.
    pub heading: String,
    /// The best solution.
    pub patches: Vec<Placed>,
    /// Patches whose places campaign.toml gives.
    pub anchors: BTreeSet<i32>,
    /// Other places that the data leave.
    pub alternatives: Vec<Patch>,
    /// Where laser and sensors stand, by name, in campaigns whose folders can still be read.
    pub stations: BTreeMap<String, [f64; 3]>,
    /// Why that of a campaign cannot.
    pub unread: Vec<String>,
    /// Paths of light, a choice.
    pub rays: Vec<Ray>,
    /// The solution as a whole.
    pub fit: Option<Fit>,
    /// What the onsets leave undetermined.
    pub ambiguities: Vec<Ambiguity>,
    /// Labelled onsets to look at, worst first.
    pub suspects: Vec<Suspect>,
    /// Likeliest places of patches that were not sure enough.
    pub declined: Vec<Hypothesis>,
    /// Planes through patches.
    pub planes: Vec<Plane>,
    /// Middles between hidden strips.
    pub gaps: Vec<Gap>,
    /// What the solution rests on.
    pub decisions: Vec<Decision>,
    /// What a joint search of a wall's histograms came to.
    pub searches: Vec<JointSearch>,
    /// Disks of the patches whose size and direction are known.
    pub footprints: Vec<PatchFootprint>,
    /// Planes that reflect light and are no patches.
    pub walls: Vec<Hypothesis>,
    /// Points of hidden surfaces, a choice.
    pub surface: Vec<SurfacePoint>,
    /// How many of these there are.
    pub surface_points: usize,
    /// What they lie on.
    pub shapes: Vec<Shape>,
    /// Surfaces between them, and the nodes of these.
    pub meshes: Vec<Mesh>,
    pub vertices: Vec<Vertex>,
    /// Factor by which ellipsoids are drawn larger.
    pub ellipsoid_factor: f64,
}

impl Scene {
    /// The answer; `None` where no stage solved for positions.
    ///
    /// # Errors
    /// When a table cannot be read.
    pub fn of(sources: &Sources<'_>, campaigns: &Campaigns, arrivals: &Arrivals) -> Result<Option<Self>, HistoryError> {
        let Some(heading) = sources.heading("patches") else { return Ok(None) };
        let (best, alternatives): (Vec<Patch>, Vec<Patch>) =
            sources.rows(|_: &Patch| true)?.into_iter().partition(|patch| patch.alternative == 0);
        let patches: Vec<Placed> = best.into_iter().map(Placed::new).collect();
        let places: BTreeMap<i32, &Placed> = patches.iter().map(|placed| (placed.patch.patch, placed)).collect();
        let (campaigns, unread) = (&campaigns.by_name, campaigns.unread.clone());
        let stations = campaigns.values().flat_map(stations).collect();
        let given = |campaign: &Campaign| -> Vec<i32> {
            campaign.patches.iter().filter(|(_, patch)| patch.position_m.is_some()).map(|(id, _)| *id).collect()
        };
        let anchors: BTreeSet<i32> = campaigns.values().flat_map(given).collect();
        let ray = |onset: &crate::history::behind::OnsetBehind| {
            let (campaign, path) = (campaigns.get(&*onset.campaign)?, onset.path.as_ref()?);
            let on_path: Vec<&Placed> = path.iter().map(|patch| places.get(patch).copied()).collect::<Option<_>>()?;
            let sensor = campaign.station_of(&onset.sensor)?;
            let mut corners_m = vec![campaign.stations[LASER].position_m];
            corners_m.extend(on_path.iter().map(|placed| placed.at()));
            corners_m.push(sensor.position_m);
            let is_hidden = on_path.iter().any(|placed| &*placed.patch.kind == "hidden");
            Some(Ray { bounces: path.len(), is_hidden, corners_m })
        };
        let all: Vec<Ray> = arrivals.offered().filter(|onset| onset.used != Some(false)).filter_map(ray).collect();
        let (hidden, seen): (Vec<Ray>, Vec<Ray>) = all.into_iter().partition(|ray| ray.is_hidden);
        let mut rays = chosen(hidden);
        rays.extend(chosen(seen));
        let surface: Vec<SurfacePoint> = sources.last_rows(|_: &SurfacePoint| true)?;
        Ok(Some(Self {
            heading,
            ellipsoid_factor: ellipsoid_factor(&patches, &anchors),
            anchors,
            alternatives,
            stations,
            unread,
            rays,
            fit: sources.rows(|fit: &Fit| fit.alternative == 0)?.pop(),
            ambiguities: sources.rows(|_: &Ambiguity| true)?,
            suspects: sources.rows(|_: &Suspect| true)?,
            declined: sources.rows(|found: &Hypothesis| &*found.kind == "patch" && found.patch.is_none())?,
            planes: sources.rows(|_: &Plane| true)?,
            gaps: sources.rows(|_: &Gap| true)?,
            decisions: sources.rows(|_: &Decision| true)?,
            searches: sources.rows(|_: &JointSearch| true)?,
            footprints: sources.rows(|_: &PatchFootprint| true)?,
            walls: sources.last_rows(|place: &Hypothesis| &*place.kind == "plane" && place.alternative == 0)?,
            surface_points: surface.len(),
            shapes: sources.rows(|_: &Shape| true)?,
            meshes: sources.rows(|_: &Mesh| true)?,
            vertices: sources.rows(|_: &Vertex| true)?,
            surface: spread(&surface, SURFACE_POINTS),
            patches,
        }))
    }
}

/// Where laser and sensors of a campaign stand.
fn stations(campaign: &Campaign) -> Vec<(String, [f64; 3])> {
    let of_sensor = |name: &String| Some((name.clone(), campaign.station_of(name)?.position_m));
    let own = campaign.stations.iter().map(|(name, station)| (name.clone(), station.position_m));
    own.chain(campaign.sensors.keys().filter_map(of_sensor)).collect()
}

fn chosen(rays: Vec<Ray>) -> Vec<Ray> {
    let places: Vec<usize> = (0..rays.len()).collect();
    let kept = spread(&places, RAYS);
    let mut kept = kept.into_iter().peekable();
    rays.into_iter().enumerate().filter(|(place, _)| kept.next_if_eq(place).is_some()).map(|(_, ray)| ray).collect()
}

/// Factor of 1, 2 or 5 times a power of ten, by the patches whose places are no `anchors`.
fn ellipsoid_factor(patches: &[Placed], anchors: &BTreeSet<i32>) -> f64 {
    let solved = patches.iter().filter(|placed| !anchors.contains(&placed.patch.patch));
    let mut longest_m: Vec<f64> =
        solved.filter_map(|placed| placed.semi_axes_m).map(|axes| norm(axes[0])).filter(|m| *m > 0.0).collect();
    if longest_m.is_empty() {
        return 1.0;
    }
    longest_m.sort_by(f64::total_cmp);
    let extent_m = (0..3)
        .map(|axis| {
            let along = patches.iter().map(|placed| placed.at()[axis]);
            along.clone().fold(f64::NEG_INFINITY, f64::max) - along.fold(f64::INFINITY, f64::min)
        })
        .fold(0.0, f64::max);
    let factor = ELLIPSOID_SHARE * extent_m / longest_m[longest_m.len() * 9 / 10];
    if factor <= 1.0 {
        return 1.0;
    }
    let power = 10f64.powi(factor.log10().floor() as i32);
    [5.0, 2.0, 1.0].into_iter().map(|step| step * power).find(|round| *round <= factor).unwrap_or(power)
}

/// Length of a vector.
pub fn norm(vector: [f64; 3]) -> f64 {
    vector.iter().map(|value| value * value).sum::<f64>().sqrt()
}
