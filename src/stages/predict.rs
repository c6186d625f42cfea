//! `predict`: when the light of each path comes in each profile, and how wide it is, as a solution says.
//!
//! For `deconvolve`, which then knows what to look for: blended pulses are told apart by where their light should come
//! and by how wide their patches make it, both of which other profiles tell. What is left shows patches that were not
//! found.
//!
//! The paths of a profile are those that `labels` has for its two patches, of any sensor and either way round, and
//! third bounces over each hidden patch, whether they were seen or not. `width_ps` is what `footprints` make of the
//! light. Where no patch is hidden, nothing is written: light of visible patches alone comes well apart.
//!
//! Takes `patches` (of `refine`) and `labels`; optional `covariances`, `delays` and `footprints` of the same `refine`.
//! Writes `predictions`. Only the likeliest places count, not their alternatives.
//!
//! ```toml
//! [predictions]
//! stage = "predict"
//! from = "patches"
//! with.labels = "labels"
//! with.covariances = "patches.patch_covariances"
//! with.delays = "patches.delays"
//! with.footprints = "patches.footprints"
//! ```

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

use super::stage::{Apply, Beside, BesideTables, Grain, Outcome, Stage, StageError};
use crate::campaign::Campaign;
use crate::geometry::Point;
use crate::geometry::footprint::Footprints;
use crate::geometry::labelling::Scene;
use crate::priors::campaign_fields::{ByCampaign, Medium, StationPositions};
use crate::priors::covariances;
use crate::priors::delays::Delays;
use crate::priors::footprints;
use crate::tables::{Label, Name, Patch, PatchCovariance, Prediction};
use crate::units::PatchId;

/// `predict` has no parameters.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Predict {}

/// What campaign.toml says that paths depend on.
#[derive(Clone, Debug, Serialize)]
pub struct Fields {
    #[serde(flatten)]
    medium: Medium,
    #[serde(flatten)]
    stations: StationPositions,
}

/// Campaigns, and the tables other than the patches.
pub struct Context {
    fields: ByCampaign<Fields>,
    labels: Vec<Label>,
    between: Vec<PatchCovariance>,
    delays: Delays,
    footprints: Footprints,
}

impl Stage for Predict {
    const KIND: &'static str = "predict";
    const VERSION: u32 = 1;
    const GRAIN: Grain = Grain::All;
    const BESIDE: &'static [Beside] = &[
        Beside { name: "labels", table: "labels", required: true },
        Beside { name: "covariances", table: "patch_covariances", required: false },
        Beside { name: "delays", table: "delays", required: false },
        Beside { name: "footprints", table: "footprints", required: false },
    ];
    type Input = Patch;
    type Output = Prediction;
    type Fields = ByCampaign<Fields>;
    type Context = Context;

    fn fields(&self, campaigns: &[Campaign]) -> Self::Fields {
        ByCampaign::new(campaigns, |campaign| Fields { medium: campaign.into(), stations: campaign.into() })
    }

    fn context(&self, fields: Self::Fields, beside: &BesideTables) -> Result<Context, StageError> {
        Ok(Context {
            fields,
            labels: beside.rows("labels")?.unwrap_or_default(),
            between: beside.rows("covariances")?.unwrap_or_default(),
            delays: Delays::new(&beside.rows("delays")?.unwrap_or_default()),
            footprints: footprints::of_table(&beside.rows("footprints")?.unwrap_or_default()),
        })
    }
}

impl Apply for Predict {
    fn apply(&self, context: &Context, group: Vec<Patch>) -> Result<Outcome<Prediction>, StageError> {
        let best = || group.iter().filter(|patch| patch.alternative == 0);
        let place = |row: &Patch| {
            let own_m2 = covariances::of_patch(row).unwrap_or_else(Matrix3::zeros);
            (row.patch, (Point::new(row.x_m, row.y_m, row.z_m), own_m2))
        };
        let places: BTreeMap<PatchId, (Point, Matrix3<f64>)> = best().map(place).collect();
        let between_m2 = context.between.iter().map(|row| ((row.a, row.b), covariances::between(row))).collect();
        let scene = Scene::new(&places, &between_m2, context.footprints.clone(), BTreeMap::new());
        let hidden: Vec<PatchId> = best().filter(|patch| &*patch.kind == "hidden").map(|patch| patch.patch).collect();
        if hidden.is_empty() {
            return Ok(Outcome::rows(Vec::new()));
        }
        let paths = Paths::new(&context.labels, &hidden);
        let profiles = paths.0.iter();
        let rows = profiles.flat_map(|(_, (label, paths))| pulses(context, &scene, label, paths)).collect();
        Ok(Outcome::rows(rows))
    }
}

/// Of each profile one of its labels, and the paths that are predicted there.
struct Paths<'a>(BTreeMap<Profile<'a>, (&'a Label, BTreeSet<Vec<PatchId>>)>);

/// Campaign, sensor, lit, seen, vertical range.
type Profile<'a> = (&'a Name, &'a Name, PatchId, PatchId, Option<&'a Name>);

impl<'a> Paths<'a> {
    fn new(labels: &'a [Label], hidden: &[PatchId]) -> Self {
        let mut of_profiles = BTreeMap::<Profile, (&Label, BTreeSet<Vec<PatchId>>)>::new();
        let mut of_pairs = BTreeMap::<[PatchId; 2], BTreeSet<&Vec<PatchId>>>::new();
        for label in labels.iter().filter(|label| label.alternative == 0) {
            let Label { campaign, sensor, lit, seen, range, .. } = label;
            let third_bounces = || hidden.iter().map(|patch| vec![*lit, *patch, *seen]).collect();
            let key = (campaign, sensor, *lit, *seen, range.as_ref());
            of_profiles.entry(key).or_insert_with(|| (label, third_bounces()));
            of_pairs.entry([*lit, *seen]).or_default().extend(&label.path);
        }
        for (&(_, _, lit, seen, _), (_, paths)) in &mut of_profiles {
            let seen_there = |pair: [PatchId; 2]| of_pairs.get(&pair).into_iter().flatten();
            paths.extend(seen_there([lit, seen]).map(|path| (*path).clone()));
            paths.extend(seen_there([seen, lit]).map(|path| path.iter().rev().copied().collect::<Vec<_>>()));
            // A path back to the lit patch is as long as its reverse.
            if lit == seen {
                paths.retain(|path| path.iter().le(path.iter().rev()));
            }
        }
        Self(of_profiles)
    }
}

/// The light of the paths of one profile, as far as all their patches are in place.
fn pulses(context: &Context, scene: &Scene, label: &Label, paths: &BTreeSet<Vec<PatchId>>) -> Vec<Prediction> {
    let Fields { medium, stations } = context.fields.of(&label.campaign);
    let Some(sensor) = stations.sensor(&label.sensor) else { return Vec::new() };
    let (delay_ps, delay_sd_ps) = context.delays.delay_ps(label, label.acquired_at.as_deref());
    let pulse = |path: &Vec<PatchId>| {
        let light = scene.light(path, stations.source(), sensor);
        Prediction {
            campaign: label.campaign.clone(),
            sensor: label.sensor.clone(),
            lit: label.lit,
            seen: label.seen,
            range: label.range.clone(),
            path: path.clone(),
            time_ps: medium.time_ps(light.length_m) + delay_ps,
            time_sd_ps: medium.time_ps(light.length_sd_m).hypot(delay_sd_ps),
            width_ps: medium.time_ps(light.spread.width_m()),
            width_sd_ps: light.spread.width_sd_m().map(|sd_m| medium.time_ps(sd_m)),
        }
    };
    paths.iter().filter(|path| scene.has(path)).map(pulse).collect()
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::tables::{Delay, PatchFootprint, Row};

    /// Visible 1 and 2, hidden 9; the laser is at the origin.
    const PLACES: [(PatchId, &str, [f64; 3]); 3] =
        [(1, "visible", [-0.4, 1.2, 0.1]), (2, "visible", [0.5, 1.1, -0.3]), (9, "hidden", [0.9, 0.4, 0.2])];
    const DELAY_PS: [f64; 2] = [12.0, 3.0];

    fn patch(patch: PatchId, kind: &str, [x_m, y_m, z_m]: [f64; 3]) -> Patch {
        let variance = Some(1e-8);
        Patch {
            patch,
            kind: kind.into(),
            x_m,
            y_m,
            z_m,
            cov_xx_m2: variance,
            cov_yy_m2: variance,
            cov_zz_m2: variance,
            cov_xy_m2: Some(0.0),
            cov_xz_m2: Some(0.0),
            cov_yz_m2: Some(0.0),
            ..Patch::default()
        }
    }

    fn label(lit: PatchId, seen: PatchId, path: Option<&[PatchId]>) -> Label {
        Label {
            campaign: "c".into(),
            sensor: "s1".into(),
            lit,
            seen,
            path: path.map(<[_]>::to_vec),
            ..Label::default()
        }
    }

    fn predicted(patches: Vec<Patch>, labels: &[Label]) -> Vec<Prediction> {
        let delay = Delay {
            campaign: "c".into(),
            sensor: "s1".into(),
            delay_ps: DELAY_PS[0],
            sd_ps: DELAY_PS[1],
            ..Delay::default()
        };
        let footprint = PatchFootprint {
            patch: 9,
            size_m: 0.04,
            normal_x: -1.0,
            source: "widths".into(),
            ..PatchFootprint::default()
        };
        let beside = BesideTables::from([
            ("labels".to_owned(), vec![Label::to_batch(labels)]),
            ("delays".to_owned(), vec![Delay::to_batch(&[delay])]),
            ("footprints".to_owned(), vec![PatchFootprint::to_batch(&[footprint])]),
        ]);
        let text = "[campaign]\nname = 'c'\ngroup_index = 1.0\n[sensors.s1]\n";
        let campaign = Campaign::parse(Path::new("c"), text).unwrap();
        let stage = Predict {};
        let context = stage.context(stage.fields(&[campaign]), &beside).unwrap();
        stage.apply(&context, patches).unwrap().rows
    }

    fn places() -> Vec<Patch> {
        PLACES.iter().map(|(number, kind, place)| patch(*number, kind, *place)).collect()
    }

    #[test]
    fn light_of_labelled_paths_and_of_hidden_patches_is_predicted() {
        let labels = [
            label(1, 2, Some(&[1, 2])),
            label(1, 2, None),
            label(2, 1, Some(&[2, 9, 1])),
            label(2, 1, Some(&[2, 1, 2, 1])),
            label(1, 1, Some(&[1])),
            Label { alternative: 1, ..label(1, 2, Some(&[1, 2, 1, 2])) },
        ];
        let rows = predicted(places(), &labels);
        let paths = |lit: PatchId, seen: PatchId| -> Vec<Vec<PatchId>> {
            rows.iter().filter(|row| (row.lit, row.seen) == (lit, seen)).map(|row| row.path.clone()).collect()
        };
        // What the reciprocal profile shows comes here too, and the hidden patch whether it was seen or not.
        assert_eq!(paths(1, 2), [vec![1, 2], vec![1, 2, 1, 2], vec![1, 9, 2]]);
        assert_eq!(paths(2, 1), [vec![2, 1], vec![2, 1, 2, 1], vec![2, 9, 1]]);
        assert_eq!(paths(1, 1), [vec![1], vec![1, 9, 1]]);
        let third = rows.iter().find(|row| row.path == [1, 9, 2]).unwrap();
        let [one, two, hidden] = PLACES.map(|(_, _, place)| Point::from(place));
        let length_m = one.coords.norm() + (hidden - one).norm() + (two - hidden).norm() + two.coords.norm();
        let c = 299_792_458.0e-12;
        assert!((third.time_ps - DELAY_PS[0] - length_m / c).abs() < 2.0, "{third:?}");
        // Errors of 0.1 mm to each side, of three patches with two legs each, and the delay's.
        assert!((3.0..4.0).contains(&third.time_sd_ps), "{third:?}");
        assert!(third.width_ps > 5.0 && third.width_sd_ps.is_none(), "only one patch has a footprint: {third:?}");
    }

    #[test]
    fn nothing_is_predicted_where_no_patch_is_hidden() {
        let visible = places().into_iter().filter(|patch| &*patch.kind == "visible").collect();
        assert_eq!(predicted(visible, &[label(1, 2, Some(&[1, 2]))]), []);
        // A place that was not taken is none.
        let alternative = |row: Patch| Patch { alternative: i32::from(&*row.kind == "hidden"), ..row };
        assert_eq!(predicted(places().into_iter().map(alternative).collect(), &[label(1, 2, Some(&[1, 2]))]), []);
    }
}
