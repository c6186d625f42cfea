//! Profiles of a result folder as a capture: on one grid of times, latency taken off.

use std::collections::{BTreeMap, BTreeSet};

use super::capture::{Capture, Grid, Histograms, Pair, Spot};
use crate::campaign::Campaign;
use crate::campaign::keys::Role;
use crate::formats::array::Array;
use crate::signal::resample;
use crate::tables::{Calibration, Patch, Profile};
use crate::units::{self, PatchId};

/// Starts nearer to whole bins than this are in place.
const IN_PLACE: f64 = 1e-4;

/// A profile with the time at which its first bin begins.
struct Timed<'a> {
    profile: &'a Profile,
    start_ps: f64,
}

/// The capture of a campaign's scene profiles.
///
/// Positions come from `patches`, else from the anchors of the campaign. Times are those from laser to sensor, or from
/// wall to wall if only these begin in whole bins. Samples between bins are interpolated with limited bandwidth.
///
/// # Errors
/// When the profiles have several sensors, ranges or time steps, a patch has no position, or pairs are missing. The
/// text says how to fix it.
pub fn capture_of(
    profiles: &[Profile],
    patches: &[Patch],
    calibration: &[Calibration],
    campaign: &Campaign,
) -> Result<Capture, String> {
    let profiles = scene_profiles(profiles, campaign)?;
    let first = profiles[0];
    let mut spots = BTreeMap::new();
    for patch in profiles.iter().flat_map(|profile| [profile.lit, profile.seen]) {
        spots.insert(patch, spot(patch, patches, campaign)?);
    }
    let sensor_m = campaign
        .station_of(&first.sensor)
        .ok_or_else(|| format!("campaign.toml has no [sensors.{}]; add it", first.sensor))?;
    let stations = [campaign.source().position_m, sensor_m.position_m];
    let starts_ps =
        profiles.iter().map(|profile| start_ps(profile, calibration)).collect::<Result<Vec<f64>, String>>()?;
    let legs_ps = |profile: &Profile| {
        let legs_m = leg_m(&spots[&profile.lit], stations[0]) + leg_m(&spots[&profile.seen], stations[1]);
        units::time_ps(legs_m, campaign.group_index)
    };
    let without_ps: Vec<f64> =
        profiles.iter().zip(&starts_ps).map(|(profile, start_ps)| start_ps - legs_ps(profile)).collect();
    let with_legs = in_whole_bins(&starts_ps, first.dt_ps) || !in_whole_bins(&without_ps, first.dt_ps);
    let starts_ps = if with_legs { starts_ps } else { without_ps };
    let timed: Vec<Timed> =
        profiles.iter().zip(starts_ps).map(|(profile, start_ps)| Timed { profile, start_ps }).collect();
    let (array, start_ps) = on_one_grid(&timed, first.dt_ps);
    // Lengths in the capture are geometric: time runs as fast as light in the campaign's medium.
    let slower = 1.0 / campaign.group_index;
    let (lit, seen, pairs) = grids(&profiles, &spots, start_ps * slower)?;
    let (bins, stride) = (array.axes[1], 1);
    let pairs = pairs.into_iter().map(|pair| Pair { offset: pair.offset * bins, ..pair }).collect();
    Ok(Capture {
        format: "Periscope",
        lit,
        seen,
        pairs,
        dt_ps: first.dt_ps * slower,
        laser_m: Some(stations[0]),
        sensor_m: Some(stations[1]),
        with_legs,
        histograms: Histograms { array, bins, stride, parts: vec![0] },
    })
}

/// The profiles of the campaign's scene by lit and seen patch: at least one, of one sensor, with equal time bases.
fn scene_profiles<'a>(profiles: &'a [Profile], campaign: &Campaign) -> Result<Vec<&'a Profile>, String> {
    let of_scene = |profile: &&Profile| *profile.role == *Role::Scene.name() && *profile.campaign == *campaign.name;
    let mut profiles: Vec<&Profile> = profiles.iter().filter(of_scene).collect();
    profiles.sort_by_key(|profile| (profile.lit, profile.seen));
    let Some(first) = profiles.first() else {
        return Err(format!(
            "no profile of the scene is of campaign `{}`; give --campaign the one that was run",
            campaign.name
        ));
    };
    let sensors: BTreeSet<&str> = profiles.iter().map(|profile| &*profile.sensor).collect();
    let is_alike = |profile: &&Profile| (profile.dt_ps, profile.samples()) == (first.dt_ps, first.samples());
    if sensors.len() > 1 || !profiles.iter().all(is_alike) {
        return Err(format!(
            "the profiles are of sensors {sensors:?}, with records that must be alike; a capture has one sensor and one time base: run a campaign of such"
        ));
    }
    Ok(profiles)
}

/// Time at which the first bin of a profile begins, without the sensor's latency.
fn start_ps(profile: &Profile, calibration: &[Calibration]) -> Result<f64, String> {
    Ok(profile.t0_ps - latency_ps(calibration, profile)? - 0.5 * profile.dt_ps)
}

/// Length of the leg between a patch and a station.
fn leg_m(spot: &Spot, station_m: [f64; 3]) -> f64 {
    spot.position_m.iter().zip(station_m).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

/// Whether all starts are whole bins apart.
fn in_whole_bins(starts_ps: &[f64], dt_ps: f64) -> bool {
    let bins = |start_ps: &f64| (start_ps - starts_ps[0]) / dt_ps;
    starts_ps.iter().map(bins).all(|bins| (bins - bins.round()).abs() < IN_PLACE)
}

/// Position and normal of a patch.
fn spot(patch: PatchId, patches: &[Patch], campaign: &Campaign) -> Result<Spot, String> {
    let keys = campaign.patches.get(&patch);
    let solution =
        patches.iter().find(|row| row.patch == patch && row.alternative == 0).map(|row| [row.x_m, row.y_m, row.z_m]);
    let position_m = solution.or_else(|| keys?.position_m);
    let normal = keys.and_then(|keys| keys.normal);
    let position_m = position_m.ok_or_else(|| {
        format!("patch {patch} has no place: neither is it in the table of patches, nor has [patches.{patch}] of campaign.toml a `position_m`")
    })?;
    Ok(Spot { position_m, normal })
}

/// Delay of a profile's sensor, at its range.
fn latency_ps(calibration: &[Calibration], profile: &Profile) -> Result<f64, String> {
    let of_sensor =
        || calibration.iter().filter(|row| row.campaign == profile.campaign && row.sensor == profile.sensor);
    let row = of_sensor().find(|row| row.range == profile.range).or_else(|| of_sensor().next());
    row.map(|row| row.latency_ps).ok_or_else(|| {
        format!("sensor `{}` is not in the table of calibrations, so its latency is not known", profile.sensor)
    })
}

/// All profiles on a grid of times that begins with the earliest of them: rows of an array, and its start.
fn on_one_grid(timed: &[Timed], dt_ps: f64) -> (Array, f64) {
    let earliest_ps = timed.iter().map(|timed| timed.start_ps).fold(f64::INFINITY, f64::min);
    let late = |timed: &Timed| {
        let bins = (timed.start_ps - earliest_ps) / dt_ps;
        let near = bins.round();
        if (bins - near).abs() < IN_PLACE { (near as usize, 0.0) } else { (bins.floor() as usize, bins.fract()) }
    };
    let bins = timed.iter().map(|timed| late(timed).0 + timed.profile.samples()).max().unwrap_or(0);
    let mut values = Vec::with_capacity(bins * timed.len());
    for one in timed {
        let samples = match &one.profile.counts {
            Some(counts) => counts.iter().map(|count| f64::from(*count)).collect(),
            None => one.profile.mean_v().to_f64(),
        };
        let (whole, fraction) = late(one);
        let mut delayed = vec![0.0; samples.len()];
        resample::delay(&samples, fraction, &mut delayed);
        let end = values.len() + bins;
        values.resize(values.len() + whole, 0.0);
        values.extend(delayed);
        values.resize(end, 0.0);
    }
    (Array::of(&[timed.len(), bins], &values), earliest_ps)
}

/// Lit and seen points, and the pairs in the order that their histograms need.
fn grids(
    profiles: &[&Profile],
    spots: &BTreeMap<PatchId, Spot>,
    start_ps: f64,
) -> Result<(Grid, Grid, Vec<Pair>), String> {
    let row_of: BTreeMap<(PatchId, PatchId), usize> =
        profiles.iter().enumerate().map(|(row, profile)| ((profile.lit, profile.seen), row)).collect();
    if row_of.len() < profiles.len() {
        return Err("pairs of patches have several profiles, at several vertical ranges; merge them first".to_owned());
    }
    let listed = |patches: &BTreeSet<PatchId>| Grid::listed(patches.iter().map(|patch| spots[patch]).collect());
    let lit: BTreeSet<PatchId> = row_of.keys().map(|(lit, _)| *lit).collect();
    let seen: BTreeSet<PatchId> = row_of.keys().map(|(_, seen)| *seen).collect();
    let place = |patches: &BTreeSet<PatchId>, patch: PatchId| patches.range(..patch).count();
    let pair = |((lit_patch, seen_patch), row): (&(PatchId, PatchId), &usize)| Pair {
        lit: place(&lit, *lit_patch),
        seen: place(&seen, *seen_patch),
        start_ps,
        offset: *row,
    };
    let pairs: Vec<Pair> = row_of.iter().map(pair).collect();
    let is_confocal = row_of.keys().all(|(lit, seen)| lit == seen);
    if !is_confocal && pairs.len() < lit.len() * seen.len() {
        return Err(format!(
            "{} of {} pairs of {} lit and {} seen patches have a profile; y-tal knows all pairs, or each point with itself: export campaigns of such",
            pairs.len(),
            lit.len() * seen.len(),
            lit.len(),
            seen.len()
        ));
    }
    let (mut lit, mut seen) = (listed(&lit), listed(&seen));
    // Both are grids, or both are lists: y-tal has no word for one of each.
    if !is_confocal && lit.spots.len() > 1 && lit.axes.len() != seen.axes.len() {
        for grid in [&mut lit, &mut seen] {
            grid.axes = vec![grid.spots.len()];
        }
    }
    if lit.spots.len() == 1 && seen.axes.len() == 2 {
        lit.axes = vec![1, 1];
    }
    Ok((lit, seen, pairs))
}
