//! `range`: path lengths of labelled onsets become distances (paper section 4.1: the inverse of the distance transform T2).
//!
//! In closed form: `d_0i = c O_i / 2`, `d_ij = c (O_ij - (O_i + O_j) / 2)`, with the covariances of distances that share onsets. Reciprocal
//! onsets, and those of several sensors and campaigns, are averaged by their variances. See [`crate::geometry::t2`] for what is wrong in the
//! paper's printed matrix.
//!
//! Takes `labels`; writes `distances` and, beside it, `covariances`. Used are onsets of sensors that stand where the laser is (paper section 3).
//! The path lengths of sensors that stand apart are sums that T2 cannot take apart; so are second bounces of a patch without a first bounce:
//! `rejects` says which, and `refine` takes them as they are. Third and later bounces are not used yet. A sensor's latency is common to all `d_0i`
//! and cancels in every `d_ij`; here it is taken as known, `refine` gives it a prior.
//!
//! ```toml
//! [distances]
//! stage = "range"
//! from = "labels"
//! ```

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use super::stage::{Apply, BesideTables, Grain, Outcome, Rejection, Side, Stage, StageError};
use crate::campaign::Campaign;
use crate::campaign::keys::PatchRole;
use crate::geometry::t2::{self, Distances, Length};
use crate::tables::{Covariance, Distance, Label, Name, Row};
use crate::units::{self, PatchId};

/// Stations closer than this are one.
const ONE_STATION_M: f64 = 1e-6;

/// Parameters of `range`: none.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Range {}

/// What a campaign says that lengths depend on.
#[derive(Clone, Debug, Serialize)]
pub struct Setup {
    group_index: f64,
    /// Whether each sensor stands where the laser is.
    with_laser: BTreeMap<String, bool>,
    /// Patches that campaign.toml lists as visible.
    visible: Vec<PatchId>,
}

impl Stage for Range {
    const KIND: &'static str = "range";
    const VERSION: u32 = 2;
    const GRAIN: Grain = Grain::All;
    const SIDES: &'static [Side] = &[Side { name: Covariance::TABLE, schema: Covariance::schema }];
    type Input = Label;
    type Output = Distance;
    type Fields = BTreeMap<String, Setup>;
    type Context = BTreeMap<String, Setup>;

    fn fields(&self, campaigns: &[Campaign]) -> Self::Fields {
        let gap_m = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
        let setup = |campaign: &Campaign| {
            let source_m = campaign.source().position_m;
            let with_laser = |sensor: &String| {
                campaign.station_of(sensor).is_some_and(|station| gap_m(station.position_m, source_m) <= ONE_STATION_M)
            };
            let visible =
                campaign.patches.iter().filter(|(_, patch)| patch.role == PatchRole::Visible).map(|(id, _)| *id);
            Setup {
                group_index: campaign.group_index,
                with_laser: campaign.sensors.keys().map(|sensor| (sensor.clone(), with_laser(sensor))).collect(),
                visible: visible.collect(),
            }
        };
        campaigns.iter().map(|campaign| (campaign.name.clone(), setup(campaign))).collect()
    }

    fn context(&self, fields: Self::Fields, _: &BesideTables) -> Result<Self::Context, StageError> {
        let mut sensors =
            fields.iter().flat_map(|(campaign, setup)| setup.with_laser.keys().map(move |s| (campaign, s)));
        let is_any_with_laser = fields.values().any(|setup| setup.with_laser.values().any(|with_laser| *with_laser));
        if let Some((campaign, sensor)) = sensors.next().filter(|_| !is_any_with_laser) {
            return Err(StageError::Refused(format!(
                "sensor `{sensor}` of campaign `{campaign}` does not stand where the laser is, and no other does: path lengths have no closed \
                 form; leave out `range` and `embed`; `refine` finds a start by itself from the labels"
            )));
        }
        Ok(fields)
    }
}

impl Apply for Range {
    fn apply(&self, setups: &Self::Context, group: Vec<Label>) -> Result<Outcome<Distance>, StageError> {
        let (mut first, mut second) = (Vec::new(), Vec::new());
        let mut apart: BTreeMap<(Name, Name), usize> = BTreeMap::new();
        for label in group.iter().filter(|label| label.alternative == 0 && label.path.is_some()) {
            let setup = &setups[&*label.campaign];
            match setup.with_laser.get(&*label.sensor) {
                Some(true) => {}
                Some(false) => {
                    *apart.entry((label.campaign.clone(), label.sensor.clone())).or_default() += 1;
                    continue;
                }
                None => return Err(unknown_sensor(label)),
            }
            let sd_m = units::path_m(label.time_sd_ps, setup.group_index);
            let length = Length { length_m: units::path_m(label.time_ps, setup.group_index), variance_m2: sd_m * sd_m };
            match label.path.as_deref() {
                Some([patch]) => first.push((*patch, length)),
                Some([lit, seen]) => second.push(((*lit, *seen), length)),
                _ => {}
            }
        }
        let found = t2::invert(&first, &second);
        let rows = found.distances.iter().map(|distance| Distance {
            a: distance.a,
            b: distance.b,
            distance_m: distance.distance_m,
            sd_m: distance.variance_m2.sqrt(),
            bounces: distance.bounces,
            onsets: distance.onsets,
        });
        Ok(Outcome {
            rows: rows.collect(),
            sides: vec![covariances(&found)],
            rejections: left_out(apart).chain(rejections(setups, &group, &found)).collect(),
        })
    }
}

fn covariances(found: &Distances) -> arrow::array::RecordBatch {
    let row = |&(first, second, cov_m2): &(usize, usize, f64)| {
        let (first, second) = (&found.distances[first], &found.distances[second]);
        Covariance { a1: first.a, b1: first.b, a2: second.a, b2: second.b, cov_m2 }
    };
    Covariance::to_batch(&found.covariances.iter().map(row).collect::<Vec<_>>())
}

fn unknown_sensor(label: &Label) -> StageError {
    let Label { campaign, sensor, .. } = label;
    StageError::Refused(format!(
        "the labels speak of sensor `{sensor}`, which campaign `{campaign}` does not have: add [sensors.{sensor}] to its campaign.toml"
    ))
}

/// Sensors that stand apart from the laser, with the onsets that are left out.
fn left_out(apart: BTreeMap<(Name, Name), usize>) -> impl Iterator<Item = Rejection> {
    apart.into_iter().map(|((campaign, sensor), onsets)| {
        about(campaign, format!(
            "sensor {sensor} stands apart from the laser: the path lengths of its {onsets} onsets are sums that T2 cannot take apart, so they are \
             left out here; `refine` takes them as they are"
        ))
    })
}

fn about(campaign: Name, reason: String) -> Rejection {
    Rejection { campaign, file: None, segment: None, byte_offset: None, reason }
}

/// What a user should know: distances that could not be had, or that contradict themselves.
fn rejections(setups: &BTreeMap<String, Setup>, labels: &[Label], found: &Distances) -> Vec<Rejection> {
    let campaign = labels.first().map_or_else(|| "".into(), |label| label.campaign.clone());
    let has_first: BTreeSet<PatchId> = found.distances.iter().map(|distance| distance.b).collect();
    let listed = setups.values().flat_map(|setup| setup.visible.iter().copied());
    let mut lost: BTreeMap<PatchId, usize> = listed.map(|patch| (patch, 0)).collect();
    for patch in found.skipped.iter().flat_map(|(a, b)| [*a, *b]) {
        *lost.entry(patch).or_default() += 1;
    }
    lost.retain(|patch, _| !has_first.contains(patch));
    let lost = lost.into_iter().map(|(patch, pairs)| match pairs {
        0 => format!(
            "patch {patch} stands in campaign.toml, but no bounce of it was found where the laser is, so it has no distance: capture lit {patch}, \
             seen {patch}, or take it out"
        ),
        _ => format!(
            "patch {patch} has no first bounce, so it has no distance, nor do its second bounces give any (pairs lost: {pairs}); `refine` still uses \
             them; for distances, capture lit {patch}, seen {patch}"
        ),
    });
    let disagreeing = found.disagreeing.iter().map(|(a, b, sigma)| {
        format!(
            "reciprocal onsets of patches {a} and {b} differ by {sigma:.1} standard deviations; their distance is kept with a variance that \
             covers it: look at both profiles"
        )
    });
    lost.chain(disagreeing).map(|reason| about(campaign.clone(), reason)).collect()
}

#[cfg(test)]
mod tests;
