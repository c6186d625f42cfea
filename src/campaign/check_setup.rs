//! Checks of `[campaign]`, `[stations]`, `[sensors]`, `[patches]` and `[views]`: ranges of numbers, names that must
//! exist, flatland.

use std::collections::BTreeMap;

use super::fault::{At, Fault};
use super::keys::{Campaign, LASER, Patch, PatchRole, Sensor, SensorKind, Station, Wall};
use crate::units::PatchId;

/// Checks all of a campaign except its rules and exclusions.
///
/// # Errors
/// The first fault.
pub fn campaign(campaign: &Campaign) -> Result<(), Fault> {
    let at = At("[campaign]");
    at.name("name", &campaign.name)?;
    let index = campaign.group_index;
    at.check(index.is_finite() && index >= 1.0, || {
        format!("group_index = {index} is not a number from 1 up; air has 1.000277")
    })?;
    at.positive("repetition_ps", campaign.repetition_ps)?;
    at.positive("repetition_sd_ps", campaign.repetition_sd_ps)?;
    at.check(campaign.part_bytes > 0, || {
        "part_bytes = 0; leave it out, or give the bytes of raw files that make a part".into()
    })?;
    for (id, view) in &campaign.views {
        let place = format!("[views.{id}]");
        let at = At(&place);
        at.check(*id > 0 && view.patches.iter().all(|patch| *patch > 0), || {
            "numbers of views and patches are positive integers; number them from 1".into()
        })?;
        at.check(!view.patches.is_empty(), || "patches is empty; list what the view covers".into())?;
    }
    let (at, hidden) = (At("[hidden]"), &campaign.hidden);
    at.positive("apart_max_m", hidden.apart_max_m)?;
    at.point("along", hidden.along, campaign.dimensions == 2)?;
    at.check(hidden.along.is_none_or(|along| length(along) > 0.0), || {
        "along has length 0; give the direction in which hidden patches follow one another".into()
    })?;
    wall(&campaign.wall)?;
    for (id, patch) in &campaign.patches {
        let place = format!("[patches.{id}]");
        At(&place).check(patch.through.is_none_or(|exit| campaign.patches.contains_key(&exit)), || {
            "through names no patch; give the visible patch over which the light reaches the sensor".into()
        })?;
    }
    setup(&campaign.stations, &campaign.sensors, &campaign.patches, campaign.dimensions)
}

fn wall(wall: &Wall) -> Result<(), Fault> {
    let at = At("[wall]");
    at.positive("grid_sd", wall.grid_sd)?;
    at.check(wall.grid_sd.is_none_or(|sd| sd < 1.0), || {
        "grid_sd is a share of the distance from the wall's middle; give a number below 1, such as 0.002".into()
    })?;
    at.positive("relief_sd_m", wall.relief_sd_m)?;
    at.positive("relief_length_m", wall.relief_length_m)?;
    at.positive("delay_sd_ps", wall.delay_sd_ps)?;
    at.positive("walk_sd_ps", wall.walk_sd_ps)?;
    let (is_high, is_long) = (wall.relief_sd_m.is_some(), wall.relief_length_m.is_some());
    at.needs("relief_sd_m", is_high, "relief_length_m", is_long)?;
    at.needs("relief_length_m", is_long, "relief_sd_m", is_high)
}

/// Checks stations, sensors and patches. Scene descriptions have the same headings.
///
/// # Errors
/// The first fault.
pub fn setup(
    stations: &BTreeMap<String, Station>,
    sensors: &BTreeMap<String, Sensor>,
    patches: &BTreeMap<PatchId, Patch>,
    dimensions: u8,
) -> Result<(), Fault> {
    let flat = dimensions == 2;
    At("[campaign]")
        .check(flat || dimensions == 3, || format!("dimensions = {dimensions}; it is 3, or 2 for flatland"))?;
    At("[stations]").check(stations.contains_key(LASER), || {
        format!("no station `{LASER}`; add [stations.{LASER}] with the point where the light leaves")
    })?;
    for (name, station) in stations {
        let place = format!("[stations.{name}]");
        let at = At(&place);
        at.name("the station's name", name)?;
        at.point("position_m", Some(station.position_m), flat)?;
        at.positive("sd_m", station.sd_m)?;
    }
    for (name, sensor) in sensors {
        let place = format!("[sensors.{name}]");
        let at = At(&place);
        at.name("the sensor's name", name)?;
        at.station("station", sensor.station.as_deref(), stations)?;
        sensor_keys(&at, sensor)?;
    }
    for (id, patch) in patches {
        let place = format!("[patches.{id}]");
        let at = At(&place);
        at.check(*id > 0, || "numbers of patches are positive integers; number them from 1".into())?;
        patch_keys(&at, patch, stations, flat)?;
    }
    Ok(())
}

fn sensor_keys(at: &At, sensor: &Sensor) -> Result<(), Fault> {
    let counts = sensor.cycles.is_some() || sensor.dead_time_ps.is_some();
    at.check(!counts || sensor.kind == SensorKind::Counts, || {
        "cycles and dead_time_ps are of photon histograms; add kind = \"counts\", or take them out".into()
    })?;
    at.check(sensor.cycles != Some(0), || "cycles = 0; give the laser pulses behind a histogram".into())?;
    at.positive("dead_time_ps", sensor.dead_time_ps)?;
    at.finite("latency_ps", sensor.latency_ps)?;
    at.positive("latency_sd_ps", sensor.latency_sd_ps)?;
    at.positive("gate_ps", sensor.gate_ps)?;
    at.needs("latency_sd_ps", sensor.latency_sd_ps.is_some(), "latency_ps", sensor.latency_ps.is_some())
}

fn patch_keys(at: &At, patch: &Patch, stations: &BTreeMap<String, Station>, flat: bool) -> Result<(), Fault> {
    at.point("position_m", patch.position_m, flat)?;
    at.positive("sd_m", patch.sd_m)?;
    at.needs("sd_m", patch.sd_m.is_some(), "position_m", patch.position_m.is_some())?;
    at.positive("size_m", patch.size_m)?;
    at.positive("lobe_rad", patch.lobe_rad)?;
    at.needs("lobe_rad", patch.lobe_rad.is_some(), "size_m", patch.size_m.is_some())?;
    at.check(patch.through.is_none() || patch.role == PatchRole::Hidden, || {
        "through is of hidden patches; add role = \"hidden\", or take it out".into()
    })?;
    at.point("normal", patch.normal, flat)?;
    if let Some(normal) = patch.normal {
        let length = length(normal);
        at.check(length > 0.0, || "normal has length 0; give the direction of the lit side".into())?;
        at.check((length - 1.0).abs() < 1e-3, || {
            let unit = normal.map(|x| x / length);
            format!("normal has length {length:.4} and must be a unit vector; write {unit:.6?}")
        })?;
    }
    if let Some(ray) = &patch.ray {
        at.station("ray.from", Some(&ray.from), stations)?;
        at.point("ray.direction", Some(ray.direction), flat)?;
        at.check(length(ray.direction) > 0.0, || {
            "ray.direction has length 0; give the direction from the station to the patch".into()
        })?;
        at.positive("ray.sd_rad", ray.sd_rad)?;
    }
    Ok(())
}

fn length(v: [f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}
