//! `range`: path lengths of labelled onsets become distances (paper section 4.1: the inverse of the distance transform T2).
//!
//! In closed form: `d_0i = c O_i / 2`, `d_ij = c (O_ij - (O_i + O_j) / 2)`, with the covariances of distances that share onsets. Reciprocal
//! onsets, and those of several sensors and campaigns, are averaged by their variances. See [`crate::geometry::t2`] for what is wrong in the
//! paper's printed matrix.
//!
//! Takes `labels`; writes `distances` and, beside it, `covariances`. Sensors must stand where the laser is (paper section 3); for separate
//! stations there is no closed form: `refine` takes them as they are. Third and later bounces are not used yet. A sensor's latency is common to all
//! `d_0i` and cancels in every `d_ij`; here it is taken as known, `refine` gives it a prior.
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
use crate::tables::{Covariance, Distance, Label, Row};
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
    /// Sensors that do not stand where the laser is.
    apart: Vec<String>,
    /// Patches that campaign.toml lists as visible.
    visible: Vec<PatchId>,
}

impl Stage for Range {
    const KIND: &'static str = "range";
    const VERSION: u32 = 1;
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
            let apart = |sensor: &&String| {
                campaign.station_of(sensor).is_none_or(|station| gap_m(station.position_m, source_m) > ONE_STATION_M)
            };
            let visible =
                campaign.patches.iter().filter(|(_, patch)| patch.role == PatchRole::Visible).map(|(id, _)| *id);
            Setup {
                group_index: campaign.group_index,
                apart: campaign.sensors.keys().filter(apart).cloned().collect(),
                visible: visible.collect(),
            }
        };
        campaigns.iter().map(|campaign| (campaign.name.clone(), setup(campaign))).collect()
    }

    fn context(&self, fields: Self::Fields, _: &BesideTables) -> Result<Self::Context, StageError> {
        for (campaign, setup) in &fields {
            if let Some(sensor) = setup.apart.first() {
                return Err(StageError::Refused(format!(
                    "sensor `{sensor}` of campaign `{campaign}` does not stand where the laser is: its path lengths have no closed form; \
                     leave out `range` and `embed`, and start `refine` from known patches (stage `import`)"
                )));
            }
        }
        Ok(fields)
    }
}

impl Apply for Range {
    fn apply(&self, setups: &Self::Context, group: Vec<Label>) -> Result<Outcome<Distance>, StageError> {
        let (mut first, mut second) = (Vec::new(), Vec::new());
        for label in group.iter().filter(|label| label.alternative == 0) {
            let index = setups[&*label.campaign].group_index;
            let sd_m = units::path_m(label.time_sd_ps, index);
            let length = Length { length_m: units::path_m(label.time_ps, index), variance_m2: sd_m * sd_m };
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
            rejections: rejections(setups, &group, &found),
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

/// What a user should know: distances that could not be had, or that contradict themselves.
fn rejections(setups: &BTreeMap<String, Setup>, labels: &[Label], found: &Distances) -> Vec<Rejection> {
    let campaign = || labels.first().map_or_else(|| "".into(), |label| label.campaign.clone());
    let about =
        |reason: String| Rejection { campaign: campaign(), file: None, segment: None, byte_offset: None, reason };
    let seen: BTreeSet<PatchId> = found.distances.iter().map(|distance| distance.b).collect();
    let listed: BTreeSet<PatchId> = setups.values().flat_map(|setup| setup.visible.iter().copied()).collect();
    let unseen = listed.difference(&seen).map(|patch| {
        about(format!(
            "patch {patch} stands in campaign.toml, but no first bounce of it was found, so it has no distance: capture lit {patch}, seen {patch}, or take it out"
        ))
    });
    let skipped = found.skipped.iter().map(|(a, b)| {
        about(format!("the second bounce between patches {a} and {b} has no first bounces to go with it: capture ({a}, {a}) and ({b}, {b})"))
    });
    let disagreeing = found.disagreeing.iter().map(|(a, b, sigma)| {
        about(format!(
            "reciprocal onsets of patches {a} and {b} differ by {sigma:.1} standard deviations; their distance is kept with a variance that covers it: look at both profiles"
        ))
    });
    unseen.chain(skipped).chain(disagreeing).collect()
}
