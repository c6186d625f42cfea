//! `first_returns`: points of hidden surfaces, with covariances and normals, from the first light at a relay wall.
//!
//! A surface returns light from its nearest point on. When that begins is timed in each histogram
//! ([`crate::signal::edge`]), and neighbouring points of the wall together give place, normal and curvature of the
//! surface ([`crate::geometry::first_return`]). Where the surface ends sets the law of its first light: histograms are
//! timed again under the laws that the geometry shows. Times of first light are not onsets of `detect`: a histogram of
//! a surface rises once and falls slowly, and the law of the rise is known only from its neighbours. So the stage
//! takes all histograms together.
//!
//! Response and gate are those of `locate`: where a confocal scan begins with the light of the wall, that light shows
//! the response with its tail.
//!
//! With `searches` of `locate` beside it, the stage writes points only where the verdict is an extended object: where
//! points explain the light, or nothing is there, there is no surface to be reported.
//!
//! Takes `patches` (of `anchor` or `refine`: points of the wall), `profiles` and `calibration`. Confocal captures are
//! one scan; of the others, each lit point with 16 seen points or more is a scan of its own, and the rest are pairs
//! that move together: one scan where each lit point has one seen point, else one for each way from the lit to the seen
//! point. Writes `surface_points`, and `omissions` beside it: pairs of points of the wall without a point, and why.
//! Captures of other roles than scene, and of patches without a place, are in neither.
//!
//! Where light rises again behind the first, another thing begins to shine, or another part of it. Points of such later
//! returns have ranks above 1.
//!
//! Errors that all points of the wall share (`[wall]` of campaign.toml) enter the covariances.
//!
//! Not modelled: errors of single points of the wall, light that goes from one hidden thing to another, noise of
//! voltages that is correlated from sample to sample (it makes standard deviations too small).
//!
//! ```toml
//! [surface]
//! stage = "first_returns"
//! from = "anchors"
//! with = { profiles = "profiles", calibration = "calibration" }
//! ```

mod timing;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::stage::{Apply, Beside, BesideTables, Grain, Outcome, Rejection, Side, Stage, StageError};
use crate::campaign::Campaign;
use crate::cancel::Cancel;
use crate::geometry::Point;
use crate::geometry::first_return::{self, Kind, LEAST, Lit, wall_normal};
use crate::parameter::{NonNegative, Positive};
use crate::priors::calibration::Sensors;
use crate::priors::campaign_fields::{ByCampaign, Medium, WallErrors};
use crate::priors::covariances::upper;
use crate::priors::relay_histograms::{self, Histogram, Times, Waveforms};
use crate::signal::edge::{Bins, Noise, Rises};
use crate::tables::{JointSearch, Omission, Patch, Row, SurfacePoint};
use crate::units::PatchId;
use timing::{Omitted, Why};
pub use timing::{ShownPoint, Timing};

/// Samples of the response across its width.
const SAMPLES: f64 = 40.0;
/// Widths of the response before its arrival, and behind it, that are sampled: an onset's window ends there.
const REACH: [f64; 2] = [3.0, 5.0];

/// Parameters of `first_returns`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FirstReturns {
    /// Standard deviations by which light rises at its first return.
    threshold_sigma: Positive,
    /// Which response is taken.
    response: Source,
    /// Time over the hidden surface from which on light counts, in place of the gate that the histograms show.
    gate_ps: Option<NonNegative>,
}

/// Where the response comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Source {
    Auto,
    Calibration,
}

impl Default for FirstReturns {
    fn default() -> Self {
        Self { threshold_sigma: Positive::new(5.0), response: Source::Auto, gate_ps: None }
    }
}

/// What campaign.toml says of the wall and its light.
#[derive(Clone, Debug, Serialize)]
pub struct Fields {
    #[serde(flatten)]
    relay: relay_histograms::Fields,
    #[serde(flatten)]
    errors: WallErrors,
}

/// Campaigns, the light of each capture, and what `locate` said.
pub struct Context {
    fields: ByCampaign<Fields>,
    waveforms: Waveforms,
    searches: Option<Vec<JointSearch>>,
    cancel: Cancel,
}

impl Stage for FirstReturns {
    const KIND: &'static str = "first_returns";
    const VERSION: u32 = 17;
    const GRAIN: Grain = Grain::All;
    const BESIDE: &'static [Beside] = &[
        Beside { name: "profiles", table: "profiles", required: true },
        Beside { name: "calibration", table: "calibration", required: true },
        Beside { name: "searches", table: "searches", required: false },
    ];
    const SIDES: &'static [Side] = &[Side { name: Omission::TABLE, schema: Omission::schema }];
    type Input = Patch;
    type Output = SurfacePoint;
    type Fields = ByCampaign<Fields>;
    type Context = Context;

    fn fields(&self, campaigns: &[Campaign]) -> Self::Fields {
        ByCampaign::new(campaigns, |campaign| Fields { relay: campaign.into(), errors: campaign.into() })
    }

    fn context(&self, fields: Self::Fields, beside: &BesideTables) -> Result<Context, StageError> {
        let sensors = Sensors::new(&beside.rows("calibration")?.unwrap_or_default());
        let waveforms = Waveforms::new(beside.batches("profiles"), &sensors)?;
        Ok(Context { fields, waveforms, searches: beside.rows("searches")?, cancel: beside.cancel.clone() })
    }
}

impl Apply for FirstReturns {
    fn apply(&self, context: &Context, group: Vec<Patch>) -> Result<Outcome<SurfacePoint>, StageError> {
        let is_extended = |searches: &Vec<JointSearch>| searches.iter().any(|one| &*one.verdict == "extended-object");
        if !context.searches.as_ref().is_none_or(is_extended) {
            return Ok(outcome((Vec::new(), Vec::new()), Vec::new()));
        }
        let best = group.iter().filter(|patch| patch.alternative == 0);
        let points: BTreeMap<PatchId, Point> =
            best.map(|patch| (patch.patch, Point::new(patch.x_m, patch.y_m, patch.z_m))).collect();
        let histograms: Vec<Histogram<'_>> = context
            .waveforms
            .calibrated
            .iter()
            .filter_map(|waveform| {
                Histogram::new(waveform, &points, |campaign| Some(&context.fields.get(campaign)?.relay))
            })
            .collect();
        Ok(match self.points(context, &histograms) {
            Ok(tables) => outcome(tables, Vec::new()),
            Err(why) => outcome((Vec::new(), Vec::new()), vec![Rejection::new(context.fields.first_name(), why)]),
        })
    }
}

fn outcome((rows, omissions): (Vec<SurfacePoint>, Vec<Omission>), rejections: Vec<Rejection>) -> Outcome<SurfacePoint> {
    Outcome { rows, sides: vec![Omission::to_batch(&omissions)], rejections }
}

impl FirstReturns {
    /// Points of all scans, and pairs without one; or why there are no points.
    fn points(
        &self,
        context: &Context,
        histograms: &[Histogram<'_>],
    ) -> Result<(Vec<SurfacePoint>, Vec<Omission>), String> {
        let Some((first, fields)) = histograms.first().zip(context.fields.first()) else {
            return Err("no capture of the scene has a calibration and places of its patches".to_owned());
        };
        let Fields { relay: scene, errors } = fields;
        let medium = scene.medium;
        let mut times = Times::new(histograms, self.gate_ps.map(NonNegative::get))?;
        let rises = self.rises(first, relay(histograms, &mut times, (medium, first.dt_ps()), &context.cancel));
        let walls: Vec<Point> = histograms.iter().flat_map(|one| [one.lit, one.seen]).collect();
        let Some(inwards) = wall_normal(&walls, &scene.stations.source()) else {
            return Err("the points of the wall lie in one line; a surface needs points that span a plane".to_owned());
        };
        let systematic = errors.systematic(medium);
        let groups = scans(histograms, 0.1 * medium.path_m(rises.sigma_ps()));
        if groups.is_empty() {
            return Err(format!(
                "a scan needs {LEAST} seen points or more: lit themselves, with one lit point, or with one lit point \
                 each that moves with them; there is none"
            ));
        }
        let mut rows = Vec::new();
        let mut omissions: BTreeMap<[PatchId; 2], Omission> =
            histograms.iter().map(|one| (one.pair(), omission(one.pair(), "no-scan", None))).collect();
        for scan in groups {
            let (members, quiet): (Vec<&Histogram<'_>>, Vec<_>) =
                scan.members.iter().copied().partition(|one| has_noise(one));
            let lit = scan.lit(members.iter().copied());
            let record = |n: usize| Record::new(scan.place(members[n]), members[n], &times);
            let threshold_sigma = self.threshold_sigma.get();
            let timing = Timing { lit: &lit, inwards, medium, rises: &rises, threshold_sigma, systematic };
            let shown = timing.shown(members.len(), record, &context.cancel);
            omissions.extend(quiet.iter().map(|one| (one.pair(), omission(one.pair(), "no-noise", None))));
            let of_omitted = |Omitted { number, why, light }: &Omitted| {
                let pair = members[*number].pair();
                let light_m = light.map(|light| [light.length_m, light.sd_m].map(|length_m| lit.share() * length_m));
                (pair, omission(pair, reason(*why), light_m))
            };
            omissions.extend(shown.omitted.iter().map(of_omitted));
            rows.extend(shown.points.iter().map(|shown| row(&shown.point, members[shown.number].pair(), shown.rank)));
        }
        let first = rows.iter().filter(|row| row.rank == 1);
        first.for_each(|row| drop(omissions.remove(&[row.lit, row.seen])));
        Ok((rows, omissions.into_values().collect()))
    }

    /// The beginnings of light behind the response: that of the wall's own light, else that of the calibration.
    fn rises(&self, first: &Histogram<'_>, wall: Option<Vec<f64>>) -> Rises {
        let width_ps = first.width_ps();
        let [first_ps, step_ps] = grid(width_ps);
        if let Some(values) = wall.filter(|_| self.response == Source::Auto) {
            // The wall's light is already averaged over bins.
            return Rises::new([first_ps, step_ps], &values, [width_ps, step_ps]);
        }
        Rises::behind(first.response(), [width_ps, first.dt_ps()])
    }
}

/// The light of a histogram behind the gate.
struct Record {
    place: Point,
    first_ps: f64,
    dt_ps: f64,
    values: Vec<f64>,
    noise: Noise,
}

impl Record {
    fn new(place: Point, histogram: &Histogram<'_>, times: &Times) -> Self {
        let (first_ps, values) = histogram.behind(times);
        let noise = match histogram.noise() {
            None => Noise::Counts,
            Some((variance, _)) => Noise::Gauss { sd: variance.sqrt() },
        };
        Self { place, first_ps, dt_ps: histogram.dt_ps(), values, noise }
    }
}

impl timing::Histogram for Record {
    fn seen(&self) -> Point {
        self.place
    }

    fn bins(&self) -> Bins<'_> {
        Bins { first_ps: self.first_ps, dt_ps: self.dt_ps, values: &self.values, noise: self.noise }
    }
}

/// Whether levels vary; counts always do.
fn has_noise(histogram: &Histogram<'_>) -> bool {
    histogram.noise().is_none_or(|(variance, _)| variance > 0.0)
}

/// First time and step at which a response is sampled.
fn grid(width_ps: f64) -> [f64; 2] {
    [-REACH[0] * width_ps, width_ps / SAMPLES]
}

/// The response of the wall's own light, sampled, where the histograms begin with it; the gate moves on behind it.
fn relay(
    histograms: &[Histogram<'_>],
    times: &mut Times,
    (medium, dt_ps): (Medium, f64),
    cancel: &Cancel,
) -> Option<Vec<f64>> {
    let pulse = relay_histograms::first_bounce(histograms, times, (medium, medium.path_m(dt_ps)), cancel)?;
    let width_ps = histograms.first()?.width_ps();
    let [first_ps, step_ps] = grid(width_ps);
    let count = ((REACH[0] + REACH[1]) * width_ps / step_ps) as usize;
    Some((0..count).map(|n| pulse.at(medium.path_m(first_ps + n as f64 * step_ps)).max(0.0)).collect())
}

/// Captures of a scan.
struct Group<'h, 'a> {
    way: Way,
    members: Vec<&'h Histogram<'a>>,
}

/// Which points of a scan are lit.
#[derive(Clone, Copy)]
enum Way {
    /// The seen ones.
    Back,
    /// One for all.
    From,
    /// One for each, which moves with the seen one.
    Apart,
}

impl Group<'_, '_> {
    /// The place of a histogram: the seen point, or the one midway between both that move.
    fn place(&self, one: &Histogram<'_>) -> Point {
        match self.way {
            Way::Back | Way::From => one.seen,
            Way::Apart => nalgebra::center(&one.lit, &one.seen),
        }
    }

    fn lit<'b>(&self, members: impl Iterator<Item = &'b Histogram<'b>>) -> Lit {
        match self.way {
            Way::Back => Lit::Same,
            Way::From => Lit::One(self.members[0].lit),
            Way::Apart => Lit::Apart(members.map(|one| (one.seen - one.lit) * 0.5).collect()),
        }
    }
}

/// Confocal captures, those of each lit point with enough of them, then pairs that move together.
fn scans<'h, 'a>(histograms: &'h [Histogram<'a>], alike_m: f64) -> Vec<Group<'h, 'a>> {
    let confocal: Vec<&Histogram<'a>> = histograms.iter().filter(|one| one.is_confocal()).collect();
    let mut apart: BTreeMap<PatchId, Vec<&Histogram<'a>>> = BTreeMap::new();
    for one in histograms.iter().filter(|one| !one.is_confocal()) {
        apart.entry(one.pair()[0]).or_default().push(one);
    }
    let (of_one, rest): (Vec<_>, Vec<_>) = apart.into_values().partition(|group| group.len() >= LEAST);
    let mut scans = vec![Group { way: Way::Back, members: confocal }];
    scans.extend(of_one.into_iter().map(|members| Group { way: Way::From, members }));
    scans.extend(moves(rest, alike_m).into_iter().map(|members| Group { way: Way::Apart, members }));
    scans.retain(|group| group.members.len() >= LEAST);
    scans
}

/// Pairs that move together, from those of each lit point: one scan where each lit point has one seen point; else a
/// scan for each way from the lit to the seen point, up to a difference.
fn moves<'h, 'a>(pairs: Vec<Vec<&'h Histogram<'a>>>, alike_m: f64) -> Vec<Vec<&'h Histogram<'a>>> {
    if pairs.iter().all(|of_lit| of_lit.len() == 1) {
        return vec![pairs.concat()];
    }
    let mut scans: Vec<Vec<&Histogram<'a>>> = Vec::new();
    let way = |one: &Histogram<'_>| one.seen - one.lit;
    for one in pairs.into_iter().flatten() {
        match scans.iter_mut().find(|scan| (way(scan[0]) - way(one)).norm() < alike_m) {
            Some(scan) => scan.push(one),
            None => scans.push(vec![one]),
        }
    }
    scans
}

fn reason(why: Why) -> &'static str {
    match why {
        Why::NoRise => "no-rise",
        Why::Untimed => "untimed",
        Why::EarlierLight => "earlier-light",
        Why::NoField => "no-field",
    }
}

fn omission([lit, seen]: [PatchId; 2], reason: &str, light_m: Option<[f64; 2]>) -> Omission {
    let [light_m, light_sd_m] = [0, 1].map(|k| light_m.map(|light_m| light_m[k]));
    Omission { lit, seen, reason: reason.into(), light_m, light_sd_m }
}

fn row(point: &first_return::SurfacePoint, [lit, seen]: [PatchId; 2], rank: usize) -> SurfacePoint {
    let [cov_xx_m2, cov_xy_m2, cov_xz_m2, cov_yy_m2, cov_yz_m2, cov_zz_m2] = upper(&point.covariance_m2);
    let [normal_cov_xx, normal_cov_xy, normal_cov_xz, normal_cov_yy, normal_cov_yz, normal_cov_zz] =
        upper(&point.normal_covariance);
    let kind = match point.kind {
        Kind::Smooth => "smooth",
        Kind::Edge => "edge",
        Kind::Corner => "corner",
        Kind::Unknown => "unknown",
    };
    SurfacePoint {
        lit,
        seen,
        rank: rank as i32,
        x_m: point.point.x,
        y_m: point.point.y,
        z_m: point.point.z,
        cov_xx_m2,
        cov_xy_m2,
        cov_xz_m2,
        cov_yy_m2,
        cov_yz_m2,
        cov_zz_m2,
        sd_m: point.covariance_m2.trace().sqrt(),
        normal_x: point.normal.x,
        normal_y: point.normal.y,
        normal_z: point.normal.z,
        normal_cov_xx,
        normal_cov_xy,
        normal_cov_xz,
        normal_cov_yy,
        normal_cov_yz,
        normal_cov_zz,
        kind: kind.into(),
        curvature_max_per_m: point.curvatures_per_m.map(|[most, _]| most),
        curvature_min_per_m: point.curvatures_per_m.map(|[_, least]| least),
        wall_points: point.places as i32,
        misfit: point.misfit,
        light_m: point.light.length_m,
        light_sd_m: point.light.sd_m,
        light_law_sd_m: point.light.law_m,
        light_zone_m: point.light.zone_m,
        light_common_sd_m: point.light.common_m,
        edges: point.edges,
        shape: None,
    }
}
