//! Third bounces over hidden patches: sums of ranges by their known legs, and ranges from sums
//! ([`crate::geometry::t3`]).

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Matrix3, Vector3};

use super::Fields;
use crate::geometry::t2::{self, Length};
use crate::geometry::t3::{self, Ranges, Sum};
use crate::geometry::{Matrix, Point, dense};
use crate::priors::campaign_fields::{ByCampaign, ONE_STATION_M};
use crate::priors::covariances::{self, PatchCovariances};
use crate::priors::delays::Delays;
use crate::priors::scenes;
use crate::priors::sensor_range::SensorRange;
use crate::stages::stage::{BesideTables, Rejection, StageError};
use crate::tables::{Covariance, Distance, Label, Name, Patch};
use crate::units::PatchId;

/// Bounces of the paths.
const BOUNCES: i32 = 3;
/// Squared residuals this many standard deviations above their mean are not those of right labels.
const UNLIKELY: f64 = 6.0;

/// Patches in given places, and delays.
#[derive(Debug)]
pub struct Places {
    /// With their covariances, m^2.
    points: BTreeMap<PatchId, (Point, Matrix3<f64>)>,
    covariances: PatchCovariances,
    visible: BTreeSet<PatchId>,
    delays: Delays,
}

impl Places {
    /// From the optional tables of the stage; `None` without `patches`.
    pub fn new(beside: &BesideTables) -> Result<Option<Self>, StageError> {
        let Some(patches) = beside.rows::<Patch>("patches")? else { return Ok(None) };
        let patches = scenes::taken(patches, &beside.rows("scenes")?.unwrap_or_default());
        let (mut points, mut visible) = (BTreeMap::new(), BTreeSet::new());
        for row in patches.iter().filter(|patch| patch.alternative == 0) {
            if &*row.kind == "visible" {
                visible.insert(row.patch);
            }
            if let Some(own) = covariances::of_patch(row) {
                points.insert(row.patch, (Point::new(row.x_m, row.y_m, row.z_m), own));
            }
        }
        if points.is_empty() {
            let text = "with patches: no patch has a covariance, so its legs cannot be weighted: these are start values (give patches from `refine`), or too few pairs determine them (`rejects` has the missing ones)";
            return Err(StageError::Refused(text.to_owned()));
        }
        let covariances = PatchCovariances::new(&beside.rows("covariances")?.unwrap_or_default());
        let delays = Delays::new(&beside.rows("delays")?.unwrap_or_default());
        Ok(Some(Self { points, covariances, visible, delays }))
    }

    /// Whether a patch has a place.
    pub fn has(&self, patch: PatchId) -> bool {
        self.points.contains_key(&patch)
    }

    fn covariance_m2(&self, a: PatchId, b: PatchId) -> Matrix3<f64> {
        if a == b { self.points[&a].1 } else { self.covariances.between(a, b) }
    }

    /// The leg from a station to a patch.
    fn leg(&self, (station, patch): (Point, PatchId)) -> Vector3<f64> {
        self.points[&patch].0 - station
    }

    /// Covariance of the lengths of two legs.
    fn leg_covariance_m2(&self, a: (Point, PatchId), b: (Point, PatchId)) -> f64 {
        let slope = |leg| self.leg(leg).try_normalize(f64::MIN_POSITIVE).unwrap_or_else(Vector3::zeros);
        slope(a).dot(&(self.covariance_m2(a.1, b.1) * slope(b)))
    }
}

/// A third bounce over a hidden patch.
struct Third {
    lit: PatchId,
    hidden: PatchId,
    seen: PatchId,
    /// Stations where the light comes from and goes to.
    stations: [usize; 2],
    length: Length,
    delay: Option<SensorRange>,
}

/// Third bounces over hidden patches, with the stations that they begin and end at.
pub struct Thirds {
    thirds: Vec<Third>,
    stations: Vec<Point>,
}

/// The path of a label whose light comes from a lit patch, meets a hidden one, and goes on to a seen one. Laser and
/// sensor do not reach the one in the middle.
pub fn over_hidden<'a>(
    fields: &'a ByCampaign<Fields>,
    places: Option<&'a Places>,
    labels: &[Label],
) -> impl Fn(&Label) -> Option<[PatchId; 3]> + use<'a> {
    let reached: BTreeSet<PatchId> = labels.iter().flat_map(|label| [label.lit, label.seen]).collect();
    let is_hidden = move |patch: PatchId| {
        let is_visible = places.is_some_and(|places| places.visible.contains(&patch));
        let is_mirror = fields.values().any(|fields| fields.mirrors.contains(&patch));
        !reached.contains(&patch) && !is_visible && !is_mirror
    };
    move |label| <[PatchId; 3]>::try_from(label.path.as_deref()?).ok().filter(|path| is_hidden(path[1]))
}

impl Thirds {
    /// No third bounce yet.
    pub fn new() -> Self {
        Self { thirds: Vec::new(), stations: Vec::new() }
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.thirds.is_empty()
    }

    /// Adds a label with such a path.
    pub fn add(&mut self, path: [PatchId; 3], fields: &Fields, places: Option<&Places>, label: &Label, length: Length) {
        let [lit, hidden, seen] = path;
        let sensor = fields.stations.sensor(&label.sensor).expect("only labels of a sensor with a station come here");
        let stations = [fields.stations.source(), sensor].map(|station| self.station(station));
        let delay = places.and_then(|places| places.delays.key_of(label)).cloned();
        let delay_ps = places.map_or(0.0, |places| places.delays.delay_ps(label, label.acquired_at.as_deref()).0);
        let length = Length { length_m: length.length_m - fields.medium.path_m(delay_ps), ..length };
        self.thirds.push(Third { lit, hidden, seen, stations, length, delay });
    }

    fn station(&mut self, station: Point) -> usize {
        let place = self.stations.iter().position(|other| (other - station).norm() <= ONE_STATION_M);
        place.unwrap_or_else(|| {
            self.stations.push(station);
            self.stations.len() - 1
        })
    }

    /// Ranges of all hidden patches, as rows. Legs come from `places`, else from the first bounces among `direct`.
    pub fn solve(&self, fields: &ByCampaign<Fields>, places: Option<&Places>, direct: &t2::Distances) -> Solved {
        let legs = Legs::new(self, places, direct);
        let delays: BTreeSet<&SensorRange> = self.thirds.iter().filter_map(|third| third.delay.as_ref()).collect();
        let delays: Vec<&SensorRange> = delays.into_iter().collect();
        let delay_sd_m = |key: &SensorRange| {
            places.map_or(0.0, |places| fields.of(&key.campaign).medium.path_m(places.delays.sd_ps(key)))
        };
        let mut sums: BTreeMap<PatchId, Vec<Sum>> = BTreeMap::new();
        let mut solved = Solved::default();
        for third in &self.thirds {
            let ends = [(third.stations[0], third.lit), (third.stations[1], third.seen)];
            let legs_at = ends.map(|end| legs.place_of.get(&end).copied());
            let [Some(lit), Some(seen)] = legs_at else {
                let without_leg = ends.iter().zip(legs_at).filter(|(_, leg)| leg.is_none());
                let without_leg: BTreeSet<PatchId> = without_leg.map(|((_, patch), _)| *patch).collect();
                without_leg.into_iter().for_each(|patch| *solved.lost.entry(patch).or_default() += 1);
                continue;
            };
            let of_legs = (0..legs.places.len()).map(|k| -legs.errors_m[(lit, k)] - legs.errors_m[(seen, k)]);
            let of_delay = |key: &&SensorRange| if third.delay.as_ref() == Some(key) { -delay_sd_m(key) } else { 0.0 };
            let length_m = third.length.length_m - legs.lengths_m[lit] - legs.lengths_m[seen];
            sums.entry(third.hidden).or_default().push(Sum {
                lit: third.lit,
                seen: third.seen,
                length: Length { length_m, ..third.length },
                common_m: of_legs.chain(delays.iter().map(of_delay)).collect(),
            });
        }
        for (hidden, sums) in sums {
            let ranges = t3::invert(&sums);
            let onsets = |patch: PatchId| sums.iter().filter(|sum| sum.lit == patch || sum.seen == patch).count();
            for (n, &patch) in ranges.patches.iter().enumerate() {
                solved.distances.push(Distance {
                    a: patch.min(hidden),
                    b: patch.max(hidden),
                    distance_m: ranges.ranges_m[n],
                    sd_m: ranges.covariance_m2[(n, n)].sqrt(),
                    bounces: BOUNCES,
                    onsets: onsets(patch) as i32,
                });
            }
            solved.ranges.push((hidden, ranges));
        }
        solved.covariances = solved.between(&legs, places.is_none(), direct);
        solved
    }
}

/// Distances between stations and visible patches.
struct Legs {
    /// Stations and patches.
    places: Vec<(usize, PatchId)>,
    place_of: BTreeMap<(usize, PatchId), usize>,
    lengths_m: Vec<f64>,
    /// What independent errors of variance 1 (columns) add to each leg (rows).
    errors_m: Matrix,
}

impl Legs {
    /// Those that the third bounces have, from `given` places, else from the first bounces among `direct`.
    fn new(thirds: &Thirds, given: Option<&Places>, direct: &t2::Distances) -> Self {
        let first: BTreeMap<PatchId, &t2::Distance> =
            direct.distances.iter().filter(|distance| distance.a == 0).map(|distance| (distance.b, distance)).collect();
        let has_place = |patch: &PatchId| match given {
            Some(given) => given.points.contains_key(patch),
            None => first.contains_key(patch),
        };
        let ends = thirds.thirds.iter().flat_map(|third| third.stations.into_iter().zip([third.lit, third.seen]));
        let places: BTreeSet<(usize, PatchId)> = ends.filter(|(_, patch)| has_place(patch)).collect();
        let places: Vec<(usize, PatchId)> = places.into_iter().collect();
        let legs: Vec<(Point, PatchId)> =
            places.iter().map(|(station, patch)| (thirds.stations[*station], *patch)).collect();
        let length_m =
            |leg: &(Point, PatchId)| given.map_or_else(|| first[&leg.1].distance_m, |given| given.leg(*leg).norm());
        let covariance_m2 = |a: usize, b: usize| match given {
            Some(given) => given.leg_covariance_m2(legs[a], legs[b]),
            None if places[a].1 == places[b].1 => first[&places[a].1].variance_m2,
            None => 0.0,
        };
        let count = places.len();
        let (values, vectors) = dense::symmetric_eigen(&Matrix::from_fn(count, count, covariance_m2));
        Self {
            lengths_m: legs.iter().map(length_m).collect(),
            errors_m: Matrix::from_fn(count, count, |n, k| vectors[(n, k)] * values[k].max(0.0).sqrt()),
            place_of: places.iter().enumerate().map(|(n, place)| (*place, n)).collect(),
            places,
        }
    }

    /// What the errors add to a distance of T2: d_0i is a leg, and of d_ij both legs were taken off.
    fn adds_m(&self, distance: &t2::Distance) -> Vec<f64> {
        let ends: &[(PatchId, f64)] =
            if distance.a == 0 { &[(distance.b, 1.0)] } else { &[(distance.a, -1.0), (distance.b, -1.0)] };
        let leg = |patch: PatchId| self.places.iter().position(|place| place.1 == patch);
        let add_m = |k, (patch, sign): &(PatchId, f64)| leg(*patch).map_or(0.0, |n| sign * self.errors_m[(n, k)]);
        (0..self.places.len()).map(|k| ends.iter().map(|end| add_m(k, end)).sum()).collect()
    }
}

/// Ranges of hidden patches, as rows, and what came between.
#[derive(Default)]
pub struct Solved {
    pub distances: Vec<Distance>,
    pub covariances: Vec<Covariance>,
    /// By hidden patch.
    ranges: Vec<(PatchId, Ranges)>,
    /// Onsets left out, by the patch whose leg is unknown.
    lost: BTreeMap<PatchId, usize>,
}

impl Solved {
    /// Covariances of the ranges with one another, and with the distances of T2 whose first bounces their legs are.
    fn between(&self, legs: &Legs, by_first_bounces: bool, direct: &t2::Distances) -> Vec<Covariance> {
        let mut rows = Vec::new();
        if by_first_bounces {
            for distance in &direct.distances {
                let adds_m = legs.adds_m(distance);
                for (hidden, ranges) in &self.ranges {
                    for (n, &patch) in ranges.patches.iter().enumerate() {
                        let cov_m2 = adds_m.iter().enumerate().map(|(k, add_m)| add_m * ranges.common_m[(n, k)]).sum();
                        rows.push(covariance((distance.a, distance.b), pair(*hidden, patch), cov_m2));
                    }
                }
            }
        }
        for (n, (hidden, ranges)) in self.ranges.iter().enumerate() {
            for (i, &a) in ranges.patches.iter().enumerate() {
                for (k, &b) in ranges.patches.iter().enumerate().skip(i + 1) {
                    rows.push(covariance(pair(*hidden, a), pair(*hidden, b), ranges.covariance_m2[(i, k)]));
                }
            }
            for (other_hidden, other) in &self.ranges[n + 1..] {
                let cov_m2 = dense::product(ranges.common_m.as_ref(), other.common_m.transpose());
                for (i, &a) in ranges.patches.iter().enumerate() {
                    for (k, &b) in other.patches.iter().enumerate() {
                        rows.push(covariance(pair(*hidden, a), pair(*other_hidden, b), cov_m2[(i, k)]));
                    }
                }
            }
        }
        rows.retain(|row| row.cov_m2 != 0.0);
        rows
    }

    /// What a user should know: ranges that could not be had, or sums that contradict one another.
    pub fn rejections(&self, campaign: &Name, with_places: bool) -> Vec<Rejection> {
        let lost = self.lost.iter().map(|(patch, onsets)| {
            let (lacks, fix) = if with_places {
                ("has no position with a covariance in the given `patches`", "capture more pairs with it")
            } else {
                ("has no first bounce where the laser is", "capture lit and seen there, or give `patches` (`with`)")
            };
            format!(
                "patch {patch} {lacks}, so {onsets} third bounces over it and hidden patches are left out here: {fix}; `refine` takes them as \
                 they are"
            )
        });
        let open = self.ranges.iter().flat_map(|(hidden, ranges)| ranges.open.iter().map(move |part| {
            let list: Vec<String> = part.iter().map(ToString::to_string).collect();
            format!(
                "hidden patch {hidden}: its third bounces leave the distances to patches {} open, since they join two sets of them without a pair \
                 inside one; `refine` takes the sums as they are; for distances, capture one of these lit and seen, or a pair inside a set",
                list.join(", ")
            )
        }));
        let unlikely = self.ranges.iter().filter(|(_, ranges)| {
            let freedom = ranges.degrees_of_freedom as f64;
            // Without any freedom what is left is rounding.
            freedom > 0.0 && ranges.chi2 > freedom + UNLIKELY * (2.0 * freedom).sqrt()
        });
        let unlikely = unlikely.map(|(hidden, ranges)| {
            format!(
                "hidden patch {hidden}: its third bounces contradict one another (chi-square {:.0} with {} degrees of freedom), so an onset has a \
                 wrong label or is less certain than it says; its distances are kept: look at `labels`; `refine` lists such onsets in `suspects`",
                ranges.chi2, ranges.degrees_of_freedom
            )
        });
        lost.chain(open).chain(unlikely).map(|reason| Rejection::new(campaign, reason)).collect()
    }
}

fn covariance(first: (PatchId, PatchId), second: (PatchId, PatchId), cov_m2: f64) -> Covariance {
    Covariance { a1: first.0, b1: first.1, a2: second.0, b2: second.1, cov_m2 }
}

/// The patches of a range, the smaller first.
fn pair(hidden: PatchId, patch: PatchId) -> (PatchId, PatchId) {
    (patch.min(hidden), patch.max(hidden))
}

#[cfg(test)]
mod tests;
