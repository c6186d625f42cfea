//! What a scene's bound means for a planned measurement. It says which patches can be found and how precisely, which
//! bounces are too weak, which pulses blend, and which ambiguities remain. It also says how long the measurement takes,
//! and the effect of changes.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::{Bound, Use};
use crate::campaign::keys::PatchRole;
use crate::simulate::keys::{Disk, Shape};
use crate::simulate::{Laboratory, Scene, SimulateError};
use crate::units::PatchId;

/// Patches thinner than this fraction of their extent count as a plane, or a line.
const FLAT: f64 = 0.02;
/// Most places that are tried for one more spot.
const PLACES: usize = 12;

/// One patch.
#[derive(Clone, Debug)]
pub struct PatchOutlook {
    /// Patch.
    pub patch: PatchId,
    /// visible, hidden or mirror.
    pub kind: &'static str,
    /// Bound of its position's standard deviation; `None` where it is not determined.
    pub sd_m: Option<f64>,
    /// Bound of its position's covariance, row by row.
    pub covariance_m2: Option<Vec<Vec<f64>>>,
    /// Probability that at least as many of its onsets are detected as it has coordinates.
    pub chance: f64,
    /// Onsets above the threshold whose paths include it.
    pub onsets: usize,
    /// Largest signal-to-noise ratio of a pulse whose path includes it, in the average of all shots.
    pub snr: f64,
    /// Shots per profile that bring that pulse to the threshold, and the hours they take.
    pub shots: f64,
    /// See `shots`.
    pub hours: f64,
}

/// All bounces of one order.
#[derive(Clone, Debug)]
pub struct OrderOutlook {
    /// Bounces.
    pub bounces: usize,
    /// Paths in all captures.
    pub paths: usize,
    /// Those above the threshold.
    pub onsets: usize,
    /// Least, median and largest matched-filter signal-to-noise ratio of the average of all shots.
    pub snr: [f64; 3],
    /// Shots that bring the median path, and the strongest one, to the threshold.
    pub shots: [f64; 2],
    /// Hours of these shots, for one profile.
    pub hours: [f64; 2],
}

/// Two unresolved pulses of one capture.
#[derive(Clone, Debug)]
pub struct Blend {
    /// Sensor.
    pub sensor: String,
    /// Patch or view lit.
    pub lit: PatchId,
    /// Patch or view seen.
    pub seen: PatchId,
    /// The two paths.
    pub paths: [Vec<PatchId>; 2],
    /// Time between them.
    pub apart_ps: f64,
}

/// The effect of a change.
#[derive(Clone, Debug)]
pub struct Change {
    /// The change.
    pub what: String,
    /// Root mean square of the visible patches' standard deviations.
    pub visible_m: Option<f64>,
    /// The same for the hidden patches.
    pub hidden_m: Option<f64>,
    /// Detected onsets.
    pub onsets: usize,
    /// Hours of capture.
    pub hours: f64,
}

/// Everything that `design` reports.
#[derive(Clone, Debug)]
pub struct Outlook {
    /// Patches, in order.
    pub patches: Vec<PatchOutlook>,
    /// Orders of bounces.
    pub orders: Vec<OrderOutlook>,
    /// Unresolved pulses.
    pub blends: Vec<Blend>,
    /// What the data do not determine, in words.
    pub ambiguities: Vec<String>,
    /// The scene as it is, then the changes.
    pub changes: Vec<Change>,
    /// Laser pulses in all captures.
    pub pulses: f64,
    /// Hours of capture.
    pub hours: f64,
}

impl Outlook {
    /// The outlook of a scene.
    ///
    /// # Errors
    /// When the first light of a capture arrives outside the record.
    pub fn new(scene: &Scene, using: Use) -> Result<Self, SimulateError> {
        let laboratory = Laboratory::new(scene, 0)?;
        let bound = Bound::of(&laboratory, using);
        Ok(Self {
            patches: patches(scene, &bound, using),
            orders: orders(scene, &bound, using),
            blends: blends(&bound),
            ambiguities: ambiguities(scene, &bound),
            changes: changes(scene, using)?,
            pulses: laboratory.shootings.iter().map(|shooting| shooting.shots as f64).sum(),
            hours: laboratory.hours(),
        })
    }
}

fn kind(scene: &Scene, patch: PatchId) -> &'static str {
    match scene.patches[&patch].role {
        PatchRole::Visible => "visible",
        PatchRole::Hidden => "hidden",
        PatchRole::Mirror => "mirror",
    }
}

fn patches(scene: &Scene, bound: &Bound, using: Use) -> Vec<PatchOutlook> {
    let row = |patch: &PatchId| {
        let pulses =
            || bound.profiles.iter().flat_map(|profile| &profile.pulses).filter(|pulse| pulse.path.contains(patch));
        let used = pulses().filter(|pulse| pulse.path.len() <= using.bounces);
        let chances: Vec<f64> = used.map(|pulse| normal_cdf(pulse.snr - using.threshold_sigma)).collect();
        let snr = pulses().map(|pulse| pulse.snr).fold(0.0, f64::max);
        let shots = scene.captures.shots as f64 * (using.threshold_sigma / snr).powi(2);
        let place = bound.coordinates.patches.iter().position(|other| other == patch);
        PatchOutlook {
            patch: *patch,
            kind: kind(scene, *patch),
            sd_m: bound.coordinates.sd_m(*patch),
            covariance_m2: bound.coordinates.covariance_m2(*patch),
            chance: at_least(usize::from(scene.dimensions), &chances),
            onsets: place.map_or(0, |place| bound.coordinates.onsets[place]),
            snr,
            shots,
            hours: shots / scene.rate_hz() / 3600.0,
        }
    };
    scene.patches.keys().map(row).collect()
}

/// Probability that at least `need` of independent events happen.
fn at_least(need: usize, chances: &[f64]) -> f64 {
    // Probabilities of 0, 1, .. need - 1 events so far.
    let mut fewer = vec![0.0; need];
    fewer[0] = 1.0;
    for chance in chances {
        for k in (0..need).rev() {
            fewer[k] = fewer[k] * (1.0 - chance) + if k > 0 { fewer[k - 1] * chance } else { 0.0 };
        }
    }
    (1.0 - fewer.iter().sum::<f64>()).clamp(0.0, 1.0)
}

/// Fraction of a normal distribution below `z` (Abramowitz and Stegun, formula 26.2.17; error below 1e-7).
fn normal_cdf(z: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.231_641_9 * z.abs());
    let series =
        t * (0.319_381_530 + t * (-0.356_563_782 + t * (1.781_477_937 + t * (-1.821_255_978 + t * 1.330_274_429))));
    let tail = (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt() * series;
    if z >= 0.0 { 1.0 - tail } else { tail }
}

fn orders(scene: &Scene, bound: &Bound, using: Use) -> Vec<OrderOutlook> {
    let mut snrs: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
    for pulse in bound.profiles.iter().flat_map(|profile| &profile.pulses) {
        snrs.entry(pulse.path.len()).or_default().push(pulse.snr);
    }
    let order = |(bounces, mut snrs): (usize, Vec<f64>)| {
        snrs.sort_by(f64::total_cmp);
        let (median, most) = (snrs[snrs.len() / 2], snrs[snrs.len() - 1]);
        let shots = [median, most].map(|snr| scene.captures.shots as f64 * (using.threshold_sigma / snr).powi(2));
        OrderOutlook {
            bounces,
            paths: snrs.len(),
            onsets: snrs.iter().filter(|snr| **snr >= using.threshold_sigma).count(),
            snr: [snrs[0], median, most],
            shots,
            hours: shots.map(|shots| shots / scene.rate_hz() / 3600.0),
        }
    };
    snrs.into_iter().map(order).collect()
}

fn blends(bound: &Bound) -> Vec<Blend> {
    let mut blends = Vec::new();
    for profile in &bound.profiles {
        for pair in profile.detected.windows(2) {
            let [a, b] = [&profile.pulses[pair[0]], &profile.pulses[pair[1]]];
            if profile.blends.contains(&pair[0]) {
                blends.push(Blend {
                    sensor: profile.sensor.clone(),
                    lit: profile.lit,
                    seen: profile.seen,
                    paths: [a.path.clone(), b.path.clone()],
                    apart_ps: b.time_ps - a.time_ps,
                });
            }
        }
    }
    blends
}

fn ambiguities(scene: &Scene, bound: &Bound) -> Vec<String> {
    let coordinates = &bound.coordinates;
    let mut ambiguities = Vec::new();
    if coordinates.turns > 0 {
        let about = if coordinates.turns == 1 && scene.dimensions == 3 {
            "the line through laser and sensors"
        } else {
            "laser and sensor"
        };
        ambiguities.push(format!(
            "path lengths do not determine rotations about {about}, nor the mirror image; anchors or ray directions would"
        ));
    }
    let seen = |role: PatchRole| coordinates.patches.iter().filter(move |patch| scene.patches[patch].role == role);
    let visible: Vec<Vector3<f64>> =
        seen(PatchRole::Visible).map(|patch| Vector3::from(scene.patches[patch].position_m)).collect();
    let extents = extents(&visible);
    let hidden: Vec<PatchId> = seen(PatchRole::Hidden).copied().collect();
    if !hidden.is_empty() && scene.dimensions == 3 {
        if extents[1] < FLAT * extents[0] {
            ambiguities.push(format!(
                "the visible patches lie on a line: hidden patches {hidden:?} are known up to a circle about it"
            ));
        } else if extents[2] < FLAT * extents[0] {
            ambiguities.push(format!(
                "the visible patches lie in a plane: hidden patches {hidden:?} and their mirror images give the same times; the side of laser and sensor decides"
            ));
        }
    }
    let loose: Vec<PatchId> = coordinates
        .patches
        .iter()
        .zip(&coordinates.loose)
        .filter(|(_, loose)| **loose)
        .map(|(patch, _)| *patch)
        .collect();
    if !loose.is_empty() {
        ambiguities.push(format!("patches {loose:?} rest on too few onsets to be placed; more shots, larger patches or one more spot that they see"));
    }
    let absent: Vec<PatchId> = scene
        .patches
        .iter()
        .filter(|(patch, disk)| disk.role != PatchRole::Mirror && !coordinates.patches.contains(patch))
        .map(|(patch, _)| *patch)
        .collect();
    if !absent.is_empty() {
        ambiguities.push(format!("patches {absent:?} make no onset above the threshold that the geometry uses (paths over mirrors it does not)"));
    }
    ambiguities
}

/// Standard deviations of points along their principal axes, the largest first.
fn extents(points: &[Vector3<f64>]) -> [f64; 3] {
    let count = points.len().max(1) as f64;
    let mean = points.iter().sum::<Vector3<f64>>() / count;
    let scatter: Matrix3<f64> = points.iter().map(|point| (point - mean) * (point - mean).transpose()).sum();
    let mut values: Vec<f64> =
        (scatter / count).symmetric_eigenvalues().iter().map(|value| value.max(0.0).sqrt()).collect();
    values.sort_by(|a, b| b.total_cmp(a));
    [values[0], values[1], values[2]]
}

fn changes(scene: &Scene, using: Use) -> Result<Vec<Change>, SimulateError> {
    let mut changes = vec![change("as it is".to_owned(), scene, scene, using)?];
    let mut try_it = |what: &str, edit: &dyn Fn(&mut Scene)| {
        let mut changed = scene.clone();
        edit(&mut changed);
        // A change that moves light out of the record is not an option.
        changes.extend(change(what.to_owned(), &changed, scene, using));
    };
    try_it("four times the shots", &|scene| scene.captures.shots *= 4);
    try_it("a sensor twice as fast", &|scene| {
        scene.instrument.response = match scene.instrument.response {
            Shape::Gaussian { fwhm_ps } => Shape::Gaussian { fwhm_ps: 0.5 * fwhm_ps },
            Shape::Emg { sigma_ps, tau_ps } => Shape::Emg { sigma_ps: 0.5 * sigma_ps, tau_ps: 0.5 * tau_ps },
        };
    });
    try_it("patches twice as wide", &|scene| scene.patches.values_mut().for_each(|disk| disk.size_m *= 2.0));
    try_it("the known path ten times as precise", &|scene| scene.captures.path_sd_m *= 0.1);
    if let Some((place, changed)) = best_spot(scene, using) {
        let [x, y, z] = place;
        changes.extend(change(format!("one more spot, at ({x:.2}, {y:.2}, {z:.2})"), &changed, scene, using));
    }
    Ok(changes)
}

/// The effect of a changed scene on the patches of the original one.
fn change(what: String, changed: &Scene, scene: &Scene, using: Use) -> Result<Change, SimulateError> {
    // Unused bounces need not be computed.
    let mut changed = changed.clone();
    changed.captures.bounces = using.bounces;
    let laboratory = Laboratory::new(&changed, 0)?;
    let bound = Bound::of(&laboratory, using);
    let rms_m = |role: PatchRole| {
        let sds =
            scene.patches.iter().filter(|(_, disk)| disk.role == role).map(|(patch, _)| bound.coordinates.sd_m(*patch));
        let sds: Vec<f64> = sds.collect::<Option<_>>()?;
        (!sds.is_empty()).then(|| (sds.iter().map(|sd| sd * sd).sum::<f64>() / sds.len() as f64).sqrt())
    };
    Ok(Change {
        what,
        visible_m: rms_m(PatchRole::Visible),
        hidden_m: rms_m(PatchRole::Hidden),
        onsets: bound.profiles.iter().map(|profile| profile.detected.len()).sum(),
        hours: laboratory.hours(),
    })
}

/// The best place for one more visible patch. Candidates are the middles between pairs of visible patches, with the
/// larger of their sizes, and their orientation.
fn best_spot(scene: &Scene, using: Use) -> Option<([f64; 3], Scene)> {
    let visible = scene.visible();
    let number = scene.patches.keys().chain(scene.views.keys()).max()? + 1;
    let pairs: Vec<(PatchId, PatchId)> =
        visible.iter().enumerate().flat_map(|(i, a)| visible[i + 1..].iter().map(|b| (*a, *b))).collect();
    let step = pairs.len().div_ceil(PLACES).max(1);
    let candidate = |&(a, b): &(PatchId, PatchId)| {
        let [a, b] = [&scene.patches[&a], &scene.patches[&b]];
        let normal = (Vector3::from(a.normal) + Vector3::from(b.normal)).try_normalize(1e-3)?;
        let position = 0.5 * (Vector3::from(a.position_m) + Vector3::from(b.position_m));
        let mut changed = scene.clone();
        let disk =
            Disk { position_m: position.into(), normal: normal.into(), size_m: a.size_m.max(b.size_m), ..a.clone() };
        changed.patches.insert(number, disk);
        for list in [&mut changed.captures.lit, &mut changed.captures.seen] {
            if !list.is_empty() {
                list.push(number);
            }
        }
        let brought = change(String::new(), &changed, scene, using).ok()?;
        let worth = brought.hidden_m.or(brought.visible_m)?;
        Some((worth, position.into(), changed))
    };
    let tried: Vec<_> = pairs.par_iter().step_by(step).filter_map(candidate).collect();
    tried.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, place, changed)| (place, changed))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chances_add_up_as_in_all_outcomes() {
        let chances = [0.3, 0.9, 0.5, 0.1, 0.75];
        for need in 1..5 {
            let mut expected = 0.0;
            for outcome in 0..32_u32 {
                let chance: f64 =
                    chances.iter().enumerate().map(|(k, p)| if outcome >> k & 1 == 1 { *p } else { 1.0 - p }).product();
                expected += if outcome.count_ones() as usize >= need { chance } else { 0.0 };
            }
            assert!((at_least(need, &chances) - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn the_normal_distribution_has_its_table() {
        for (z, share) in [(0.0, 0.5), (1.0, 0.841_344_75), (-1.959_963_98, 0.025), (3.0, 0.998_650_1)] {
            assert!((normal_cdf(z) - share).abs() < 2e-7);
        }
    }
}
