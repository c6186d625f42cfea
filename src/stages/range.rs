//! `range`: path lengths of labelled onsets become distances (paper sections 4.1 and 4.3: the inverses of the distance
//! transforms T2 and T3).
//!
//! Among visible patches, in closed form: `d_0i = c O_i / 2`, `d_ij = c (O_ij - (O_i + O_j) / 2)`, with the covariances
//! of distances that share onsets. Reciprocal onsets, and those of several sensors and campaigns, are averaged by their
//! variances. See [`crate::geometry::t2`] for the error in the paper's printed matrix. Only onsets of sensors at the
//! laser are used (paper section 3). The path lengths of other sensors are sums that T2 cannot take apart; so are
//! second bounces of a patch without a first bounce. `rejects` lists these, and `refine` uses them as they are. A
//! sensor's latency is common to all `d_0i` and cancels in every `d_ij`. It is taken as exact here; `refine` gives it a
//! prior.
//!
//! With `patches`, `rejects` lists visible patches that have no place there, and that no later light shows either, with
//! the pairs in which no light of theirs was found.
//!
//! An anchor needs no distance. Other patches with fewer distances than coordinates stand in `rejects`, with the pairs
//! that are missing: no later stage can place them.
//!
//! A patch is hidden if third bounces lead over it, while no label has it as lit or seen, nor `patches` as visible.
//! Third bounces less their legs between stations and visible patches are sums of two ranges, which weighted least
//! squares take apart ([`crate::geometry::t3`]). The legs come from `patches`, for sensors apart from the laser too.
//! Without `patches` they come from first bounces (`c O_i / 2`, a latency cancels), of sensors at the laser. Their
//! errors, which many sums share, travel as covariances, also between ranges of different hidden patches. `rejects`
//! lists ranges that the sums leave open, as with disjoint sets of lit and seen patches, and sums that contradict one
//! another.
//!
//! Takes `labels`; writes `distances` and `covariances`. Optional tables: `patches` (of `refine`, with their standard
//! deviations), and for the full error of the legs `covariances` (`patch_covariances` of the same stage) and `delays`;
//! `scenes` of the `label` that took an alternative of `patches`.
//!
//! Not used: third bounces among visible patches, and over a mirror, which they meet in another point each time. Not
//! modelled: errors of stations; footprints; errors that `patches` share with the second bounces of these labels or
//! with `delays`. The last make standard deviations too large where a delay is not well known.
//!
//! ```toml
//! [distances]
//! stage = "range"
//! from = "labels"
//! with = { patches = "visible", covariances = "visible.patch_covariances", delays = "visible.delays" }
//! ```

mod hidden;
mod missing;

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use super::stage::{Apply, Beside, BesideTables, Grain, Outcome, Rejection, Side, Stage, StageError};
use crate::campaign::Campaign;
use crate::campaign::keys::{self, PatchRole};
use crate::geometry::t2::{self, Distances, Length};
use crate::priors::campaign_fields::{ByCampaign, Medium, StationPositions};
use crate::tables::{Covariance, Distance, Label, Name, Row};
use crate::units::PatchId;
use hidden::{Places, Thirds};

/// Parameters of `range`: none.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Range {}

/// What campaign.toml says that lengths depend on.
#[derive(Clone, Debug, Serialize)]
pub struct Fields {
    #[serde(flatten)]
    medium: Medium,
    #[serde(flatten)]
    stations: StationPositions,
    /// Patches that campaign.toml lists as visible, and gives no position.
    visible: Vec<PatchId>,
    /// Patches to which it gives a position.
    anchors: Vec<PatchId>,
    /// Patches to which it gives a ray, which needs fewer distances.
    rays: Vec<PatchId>,
    dimensions: usize,
    /// Patches that it lists as mirrors.
    mirrors: Vec<PatchId>,
}

/// Campaigns, and patches in given places.
#[derive(Debug)]
pub struct Context {
    fields: ByCampaign<Fields>,
    places: Option<Places>,
}

impl Stage for Range {
    const KIND: &'static str = "range";
    const VERSION: u32 = 8;
    const GRAIN: Grain = Grain::All;
    const BESIDE: &'static [Beside] = &[
        Beside { name: "patches", table: "patches", required: false },
        Beside { name: "covariances", table: "patch_covariances", required: false },
        Beside { name: "delays", table: "delays", required: false },
        Beside { name: "scenes", table: "scenes", required: false },
    ];
    const SIDES: &'static [Side] = &[Side { name: Covariance::TABLE, schema: Covariance::schema }];
    type Input = Label;
    type Output = Distance;
    type Fields = ByCampaign<Fields>;
    type Context = Context;

    fn fields(&self, campaigns: &[Campaign]) -> Self::Fields {
        ByCampaign::new(campaigns, |campaign| Fields {
            medium: campaign.into(),
            stations: campaign.into(),
            visible: patches(campaign, |patch| patch.role == PatchRole::Visible && patch.position_m.is_none()),
            anchors: patches(campaign, |patch| patch.position_m.is_some()),
            rays: patches(campaign, |patch| patch.ray.is_some()),
            dimensions: usize::from(campaign.dimensions),
            mirrors: patches(campaign, |patch| patch.role == PatchRole::Mirror),
        })
    }

    fn context(&self, fields: Self::Fields, beside: &BesideTables) -> Result<Self::Context, StageError> {
        let places = Places::new(beside)?;
        let is_any_with_laser = fields.values().any(|fields| fields.stations.is_any_with_laser());
        let first_sensor =
            fields.iter().find_map(|(campaign, fields)| Some((campaign, fields.stations.sensors().next()?)));
        if let Some((campaign, sensor)) = first_sensor.filter(|_| !is_any_with_laser && places.is_none()) {
            return Err(StageError::Refused(format!(
                "sensor `{sensor}` of campaign `{campaign}` does not stand where the laser is, and no other does: path lengths have no closed \
                 form; leave out `range` and `embed`; `refine` finds a start by itself from the labels"
            )));
        }
        Ok(Context { fields, places })
    }
}

impl Apply for Range {
    fn apply(&self, context: &Context, group: Vec<Label>) -> Result<Outcome<Distance>, StageError> {
        let (fields, places) = (&context.fields, context.places.as_ref());
        let over_hidden = hidden::over_hidden(fields, places, &group);
        let (mut first, mut second, mut thirds) = (Vec::new(), Vec::new(), Thirds::new());
        let mut apart: BTreeMap<(Name, Name), usize> = BTreeMap::new();
        for label in group.iter().filter(|label| label.alternative == 0 && label.path.is_some()) {
            let Fields { medium, stations, .. } = fields.of(&label.campaign);
            let sd_m = medium.path_m(label.time_sd_ps);
            let length = Length { length_m: medium.path_m(label.time_ps), variance_m2: sd_m * sd_m };
            let over_hidden = over_hidden(label);
            match stations.is_with_laser(&label.sensor) {
                Some(true) => {}
                Some(false) if over_hidden.is_some() && places.is_some() => {}
                // Patches that are given need no direct distance, and `refine` takes sums as they are.
                Some(false) if places.is_some() => continue,
                Some(false) => {
                    *apart.entry((label.campaign.clone(), label.sensor.clone())).or_default() += 1;
                    continue;
                }
                None => return Err(unknown_sensor(label)),
            }
            match label.path.as_deref() {
                Some([patch]) => first.push((*patch, length)),
                Some([lit, seen]) => second.push(((*lit, *seen), length)),
                _ => {
                    if let Some(path) = over_hidden {
                        thirds.add(path, fields.of(&label.campaign), places, label, length);
                    }
                }
            }
        }
        let direct = t2::invert(&first, &second);
        let rows = direct.distances.iter().map(|distance| Distance {
            a: distance.a,
            b: distance.b,
            distance_m: distance.distance_m,
            sd_m: distance.variance_m2.sqrt(),
            bounces: distance.bounces,
            onsets: distance.onsets,
        });
        let hidden = thirds.solve(fields, places, &direct);
        let campaign = group.first().map_or_else(|| "".into(), |label| label.campaign.clone());
        // Third bounces over hidden patches tell of their legs too.
        let is_alone = apart.is_empty() && places.is_none() && thirds.is_empty();
        let too_few = if is_alone { missing::too_few(fields, &direct) } else { Vec::new() };
        let open = places.map(|places| missing::open(fields, places, &group)).unwrap_or_default();
        let too_few = too_few.into_iter().chain(open).map(|reason| Rejection::new(&campaign, reason));
        let doubts = rejections(&campaign, fields, &direct)
            .into_iter()
            .chain(too_few)
            .chain(hidden.rejections(&campaign, places.is_some()));
        Ok(Outcome {
            rejections: left_out(apart).chain(doubts).collect(),
            rows: rows.chain(hidden.distances).collect(),
            sides: vec![Covariance::to_batch(&[covariances(&direct), hidden.covariances].concat())],
        })
    }
}

/// Patches of campaign.toml of which this is true.
fn patches(campaign: &Campaign, is_meant: impl Fn(&keys::Patch) -> bool) -> Vec<PatchId> {
    campaign.patches.iter().filter(|(_, patch)| is_meant(patch)).map(|(id, _)| *id).collect()
}

fn covariances(direct: &Distances) -> Vec<Covariance> {
    let row = |&(first, second, cov_m2): &(usize, usize, f64)| {
        let (first, second) = (&direct.distances[first], &direct.distances[second]);
        Covariance { a1: first.a, b1: first.b, a2: second.a, b2: second.b, cov_m2 }
    };
    direct.covariances.iter().map(row).collect()
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
        Rejection::new(&campaign, format!(
            "sensor {sensor} stands apart from the laser: the path lengths of its {onsets} onsets are sums that T2 cannot take apart, so they are \
             left out here; `refine` takes them as they are"
        ))
    })
}

/// What a user should know: distances that could not be had, or that contradict themselves.
fn rejections(campaign: &Name, fields: &ByCampaign<Fields>, direct: &Distances) -> Vec<Rejection> {
    let has_first: BTreeSet<PatchId> = direct.distances.iter().map(|distance| distance.b).collect();
    // Where no sensor stands at the laser, no patch can have a first bounce there.
    let with_laser = fields.values().filter(|fields| fields.stations.is_any_with_laser());
    let listed = with_laser.flat_map(|fields| fields.visible.iter().copied());
    let mut lost: BTreeMap<PatchId, usize> = listed.map(|patch| (patch, 0)).collect();
    for patch in direct.skipped.iter().flat_map(|(a, b)| [*a, *b]) {
        *lost.entry(patch).or_default() += 1;
    }
    // Where an anchor is, needs no distance: its own light may be gated away.
    let is_anchor = |patch: &PatchId| fields.values().any(|fields| fields.anchors.contains(patch));
    lost.retain(|patch, _| !has_first.contains(patch) && !is_anchor(patch));
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
    let disagreeing = direct.disagreeing.iter().map(|(a, b, sigma)| {
        format!(
            "reciprocal onsets of patches {a} and {b} differ by {sigma:.1} standard deviations; their distance is kept with a variance that \
             covers it: look at both profiles"
        )
    });
    lost.chain(disagreeing).map(|reason| Rejection::new(campaign, reason)).collect()
}

#[cfg(test)]
mod tests;
