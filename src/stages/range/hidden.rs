//! Third bounces over hidden patches: sums of ranges by their known legs, and ranges from sums ([`crate::geometry::t3`]).

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Matrix3, Vector3};

use super::{ONE_STATION_M, Setup, about};
use crate::geometry::t2::{self, Length};
use crate::geometry::t3::{self, Ranges, Sum};
use crate::geometry::{Matrix, Point, dense};
use crate::priors::covariances;
use crate::stages::stage::{BesideTables, Rejection, StageError};
use crate::tables::{Covariance, Delay, Distance, Label, Name, Patch, PatchCovariance};
use crate::units::{self, PatchId};

/// Bounces of the paths.
const BOUNCES: i32 = 3;
/// Squared residuals this many standard deviations above their mean are not those of right labels.
const UNLIKELY: f64 = 6.0;

/// Campaign, sensor and vertical range whose delay is known.
type DelayKey = (Name, Name, Option<Name>);

/// Patches in known places, and delays.
#[derive(Debug)]
pub struct Places {
    points: BTreeMap<PatchId, Point>,
    covariances_m2: BTreeMap<(PatchId, PatchId), Matrix3<f64>>,
    visible: BTreeSet<PatchId>,
    /// Delay that calibration left, and its standard deviation.
    delays_ps: BTreeMap<DelayKey, (f64, f64)>,
}

impl Places {
    /// From the tables beside the stage; `None` without `patches`.
    pub fn new(beside: &BesideTables) -> Result<Option<Self>, StageError> {
        let Some(patches) = beside.rows::<Patch>("patches")? else { return Ok(None) };
        let (mut points, mut covariances_m2, mut visible) = (BTreeMap::new(), BTreeMap::new(), BTreeSet::new());
        for row in patches.iter().filter(|patch| patch.alternative == 0) {
            if &*row.kind == "visible" {
                visible.insert(row.patch);
            }
            if let Some(own) = covariances::of_patch(row) {
                points.insert(row.patch, Point::new(row.x_m, row.y_m, row.z_m));
                covariances_m2.insert((row.patch, row.patch), own);
            }
        }
        if points.is_empty() {
            let text = "with patches: no patch has a covariance, so nobody knows how far off its legs may be; give patches from `refine`";
            return Err(StageError::Refused(text.to_owned()));
        }
        for row in beside.rows::<PatchCovariance>("covariances")?.unwrap_or_default() {
            let block = covariances::between(&row);
            covariances_m2.insert((row.a, row.b), block);
            covariances_m2.insert((row.b, row.a), block.transpose());
        }
        let delays = beside.rows::<Delay>("delays")?.unwrap_or_default();
        let delay = |row: Delay| ((row.campaign, row.sensor, row.range), (row.delay_ps, row.sd_ps));
        Ok(Some(Self { points, covariances_m2, visible, delays_ps: delays.into_iter().map(delay).collect() }))
    }

    /// Delay of an onset: that of its range, or the only one of its sensor.
    fn delay_of(&self, label: &Label) -> Option<DelayKey> {
        let key = (label.campaign.clone(), label.sensor.clone(), label.range.clone());
        if self.delays_ps.contains_key(&key) {
            return Some(key);
        }
        let mut of_sensor = self.delays_ps.keys().filter(|of| (&of.0, &of.1) == (&key.0, &key.1));
        of_sensor.next().filter(|_| of_sensor.next().is_none()).cloned()
    }

    fn covariance_m2(&self, a: PatchId, b: PatchId) -> Matrix3<f64> {
        self.covariances_m2.get(&(a, b)).copied().unwrap_or_else(Matrix3::zeros)
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
    delay: Option<DelayKey>,
}

/// Third bounces over hidden patches, with the stations that they begin and end at.
pub struct Thirds {
    thirds: Vec<Third>,
    stations: Vec<Point>,
}

/// The path of a label whose light comes from a lit patch, meets one that laser and sensor do not reach, and goes on to a seen one.
pub fn over_hidden<'a>(
    setups: &'a BTreeMap<String, Setup>,
    places: Option<&'a Places>,
    labels: &[Label],
) -> impl Fn(&Label) -> Option<[PatchId; 3]> + use<'a> {
    let reached: BTreeSet<PatchId> = labels.iter().flat_map(|label| [label.lit, label.seen]).collect();
    let is_hidden = move |patch: PatchId| {
        let is_visible = places.is_some_and(|places| places.visible.contains(&patch));
        let is_mirror = setups.values().any(|setup| setup.mirrors.contains(&patch));
        !reached.contains(&patch) && !is_visible && !is_mirror
    };
    move |label| <[PatchId; 3]>::try_from(label.path.as_deref()?).ok().filter(|path| is_hidden(path[1]))
}

impl Thirds {
    /// No third bounce yet.
    pub fn new() -> Self {
        Self { thirds: Vec::new(), stations: Vec::new() }
    }

    /// Adds a label with such a path.
    pub fn add(&mut self, path: [PatchId; 3], setup: &Setup, places: Option<&Places>, label: &Label, length: Length) {
        let [lit, hidden, seen] = path;
        let stations = [setup.source_m, setup.sensors_m[&*label.sensor]].map(|station_m| self.station(station_m));
        let delay = places.and_then(|places| places.delay_of(label));
        let delay_ps = delay.as_ref().zip(places).map_or(0.0, |(key, places)| places.delays_ps[key].0);
        let length = Length { length_m: length.length_m - units::path_m(delay_ps, setup.group_index), ..length };
        self.thirds.push(Third { lit, hidden, seen, stations, length, delay });
    }

    fn station(&mut self, station_m: [f64; 3]) -> usize {
        let station = Point::from(station_m);
        let known = self.stations.iter().position(|other| (other - station).norm() <= ONE_STATION_M);
        known.unwrap_or_else(|| {
            self.stations.push(station);
            self.stations.len() - 1
        })
    }

    /// Ranges of all hidden patches, as rows. Legs come from `places`, else from the first bounces among `direct`.
    pub fn solve(&self, setups: &BTreeMap<String, Setup>, places: Option<&Places>, direct: &t2::Distances) -> Solved {
        let legs = Legs::new(self, places, direct);
        let delays: BTreeSet<&DelayKey> = self.thirds.iter().filter_map(|third| third.delay.as_ref()).collect();
        let delays: Vec<&DelayKey> = delays.into_iter().collect();
        let delay_sd_m = |key: &DelayKey| {
            places.map_or(0.0, |places| units::path_m(places.delays_ps[key].1, setups[&*key.0].group_index))
        };
        let mut sums: BTreeMap<PatchId, Vec<Sum>> = BTreeMap::new();
        let mut solved = Solved::default();
        for third in &self.thirds {
            let ends = [(third.stations[0], third.lit), (third.stations[1], third.seen)];
            let known = ends.map(|end| legs.place_of.get(&end).copied());
            let [Some(lit), Some(seen)] = known else {
                let unknown = ends.iter().zip(known).filter(|(_, known)| known.is_none());
                let unknown: BTreeSet<PatchId> = unknown.map(|((_, patch), _)| *patch).collect();
                unknown.into_iter().for_each(|patch| *solved.lost.entry(patch).or_default() += 1);
                continue;
            };
            let of_legs = (0..legs.places.len()).map(|k| -legs.errors_m[(lit, k)] - legs.errors_m[(seen, k)]);
            let of_delay = |key: &&DelayKey| if third.delay.as_ref() == Some(key) { -delay_sd_m(key) } else { 0.0 };
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
    /// Those of all third bounces that are known.
    fn new(thirds: &Thirds, known: Option<&Places>, direct: &t2::Distances) -> Self {
        let first: BTreeMap<PatchId, &t2::Distance> =
            direct.distances.iter().filter(|distance| distance.a == 0).map(|distance| (distance.b, distance)).collect();
        let is_known = |patch: &PatchId| match known {
            Some(known) => known.points.contains_key(patch),
            None => first.contains_key(patch),
        };
        let ends = thirds.thirds.iter().flat_map(|third| third.stations.into_iter().zip([third.lit, third.seen]));
        let places: BTreeSet<(usize, PatchId)> = ends.filter(|(_, patch)| is_known(patch)).collect();
        let places: Vec<(usize, PatchId)> = places.into_iter().collect();
        let arm = |known: &Places, n: usize| known.points[&places[n].1] - thirds.stations[places[n].0];
        let length_m = |n: usize| known.map_or_else(|| first[&places[n].1].distance_m, |known| arm(known, n).norm());
        let covariance_m2 = |a: usize, b: usize| match known {
            Some(known) => {
                let slope = |n: usize| arm(known, n).try_normalize(f64::MIN_POSITIVE).unwrap_or_else(Vector3::zeros);
                slope(a).dot(&(known.covariance_m2(places[a].1, places[b].1) * slope(b)))
            }
            None if places[a].1 == places[b].1 => first[&places[a].1].variance_m2,
            None => 0.0,
        };
        let count = places.len();
        let (values, vectors) = dense::symmetric_eigen(&Matrix::from_fn(count, count, covariance_m2));
        Self {
            lengths_m: (0..count).map(length_m).collect(),
            errors_m: Matrix::from_fn(count, count, |n, k| vectors[(n, k)] * values[k].max(0.0).sqrt()),
            place_of: places.iter().enumerate().map(|(n, place)| (*place, n)).collect(),
            places,
        }
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
        let row = |first: (PatchId, PatchId), second: (PatchId, PatchId), cov_m2: f64| Covariance {
            a1: first.0,
            b1: first.1,
            a2: second.0,
            b2: second.1,
            cov_m2,
        };
        let pair = |hidden: PatchId, patch: PatchId| (patch.min(hidden), patch.max(hidden));
        let mut rows = Vec::new();
        if by_first_bounces {
            for distance in &direct.distances {
                // d_0i is the leg; of d_ij both legs were taken off.
                let ends: &[(PatchId, f64)] =
                    if distance.a == 0 { &[(distance.b, 1.0)] } else { &[(distance.a, -1.0), (distance.b, -1.0)] };
                let leg = |patch: PatchId| legs.places.iter().position(|place| place.1 == patch);
                let adds_m = |k: usize| -> f64 {
                    let share =
                        |(patch, sign): &(PatchId, f64)| leg(*patch).map_or(0.0, |n| sign * legs.errors_m[(n, k)]);
                    ends.iter().map(share).sum()
                };
                let adds_m: Vec<f64> = (0..legs.places.len()).map(adds_m).collect();
                for (hidden, ranges) in &self.ranges {
                    for (n, &patch) in ranges.patches.iter().enumerate() {
                        let cov_m2 = adds_m.iter().enumerate().map(|(k, add_m)| add_m * ranges.common_m[(n, k)]).sum();
                        rows.push(row((distance.a, distance.b), pair(*hidden, patch), cov_m2));
                    }
                }
            }
        }
        for (n, (hidden, ranges)) in self.ranges.iter().enumerate() {
            for (i, &a) in ranges.patches.iter().enumerate() {
                for (k, &b) in ranges.patches.iter().enumerate().skip(i + 1) {
                    rows.push(row(pair(*hidden, a), pair(*hidden, b), ranges.covariance_m2[(i, k)]));
                }
            }
            for (other_hidden, other) in &self.ranges[n + 1..] {
                let cov_m2 = dense::product(ranges.common_m.as_ref(), other.common_m.transpose());
                for (i, &a) in ranges.patches.iter().enumerate() {
                    for (k, &b) in other.patches.iter().enumerate() {
                        rows.push(row(pair(*hidden, a), pair(*other_hidden, b), cov_m2[(i, k)]));
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
            let (lacks, mend) = if with_places {
                ("has no position with a covariance in the patches given beside", "capture more pairs with it")
            } else {
                ("has no first bounce where the laser is", "capture lit and seen there, or give `patches` beside")
            };
            format!(
                "patch {patch} {lacks}, so {onsets} third bounces over it and hidden patches are left out here: {mend}; `refine` takes them as \
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
        lost.chain(open).chain(unlikely).map(|reason| about(campaign.clone(), reason)).collect()
    }
}

#[cfg(test)]
mod tests;
