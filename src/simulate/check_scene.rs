//! What the values of a scene file must satisfy.

use super::keys::{Flaws, Shape};
use super::scene::Scene;
use crate::campaign::keys::{self, PatchRole, SensorKind};
use crate::campaign::{Fault, check_setup as check_room};

/// Checks stations, sensors and patches, as in a campaign.
pub fn check_setup(scene: &Scene) -> Result<(), Fault> {
    let sensors = scene.sensors.iter().map(|(name, sensor)| {
        (name.clone(), keys::Sensor { station: sensor.station.clone(), ..keys::Sensor::default() })
    });
    let patches = scene.patches.iter().map(|(id, disk)| {
        let patch = keys::Patch {
            position_m: Some(disk.position_m),
            normal: Some(disk.normal),
            size_m: Some(disk.size_m),
            ..keys::Patch::default()
        };
        (*id, patch)
    });
    check_room::setup(&scene.stations, &sensors.collect(), &patches.collect(), scene.dimensions)
}

/// A key, and its value.
type Entry = (String, f64);

/// Checks everything else.
pub fn check(scene: &Scene) -> Result<(), String> {
    range("must be above 0", positive(scene), |value| value > 0.0)?;
    range("must not be negative", not_negative(scene), |value| value >= 0.0)?;
    range("is not from 0 to 1", shares(scene), |value| (0.0..=1.0).contains(&value))?;
    surfaces(scene)?;
    instrument(scene)?;
    for (name, sensor) in &scene.sensors {
        if let Some(number) = sensor.seen.iter().find(|number| !scene.seen().contains(number)) {
            return Err(format!("[sensors.{name}]: seen names {number}, which [captures] does not list under `seen`"));
        }
    }
    let prior = &scene.prior;
    if let Some((strip, exit)) =
        prior.strips.iter().find(|(strip, exit)| [strip, exit].iter().any(|patch| !scene.patches.contains_key(patch)))
    {
        return Err(format!("[known]: strips: there is no patch {strip} or {exit}; strips are patches of the scene"));
    }
    if let Some(patch) = prior.anchors.iter().chain(&prior.rays).find(|patch| !scene.patches.contains_key(patch)) {
        return Err(format!("[known]: there is no patch {patch}; anchors and rays name patches of the scene"));
    }
    captures(scene)
}

fn range(must: &str, entries: Vec<Entry>, good: impl Fn(f64) -> bool) -> Result<(), String> {
    match entries.into_iter().find(|(_, value)| !(value.is_finite() && good(*value))) {
        Some((place, value)) => Err(format!("{place} = {value} {must}")),
        None => Ok(()),
    }
}

fn positive(scene: &Scene) -> Vec<Entry> {
    let (instrument, captures) = (&scene.instrument, &scene.captures);
    let mut entries =
        vec![("[instrument]: dt_ps", instrument.dt_ps), ("[instrument]: full_scale_v", instrument.full_scale_v)];
    match instrument.response {
        Shape::Gaussian { fwhm_ps } => entries.push(("[instrument]: response.fwhm_ps", fwhm_ps)),
        Shape::Emg { sigma_ps, tau_ps } => {
            entries.extend([("[instrument]: response.sigma_ps", sigma_ps), ("[instrument]: response.tau_ps", tau_ps)]);
        }
    }
    let mut optional = |place, value: Option<f64>| entries.extend(value.map(|value| (place, value)));
    optional("[instrument]: snr", instrument.snr);
    optional("[instrument]: responsivity_a_w", instrument.responsivity_a_w);
    optional("[instrument]: noise_bandwidth_ghz", instrument.noise_bandwidth_ghz);
    optional("[instrument]: rate_hz", instrument.rate_hz);
    optional("[instrument]: reference.fwhm_ps", instrument.reference.map(|reference| reference.fwhm_ps));
    optional("[instrument]: reference.snr", instrument.reference.and_then(|reference| reference.snr));
    optional("[instrument]: reference.height_v", instrument.reference.and_then(|reference| reference.height_v));
    optional("[instrument.flaws]: saturation_v", instrument.flaws.saturation_v);
    optional("[instrument.flaws]: tail.tau_ps", instrument.flaws.tail.map(|tail| tail.tau_ps));
    optional("[instrument.flaws]: recovery.tau_ps", instrument.flaws.recovery.map(|tail| tail.tau_ps));
    optional("[instrument.flaws]: pickup.decay_ps", instrument.flaws.pickup.map(|pickup| pickup.decay_ps));
    optional("[laser]: pulse_j", scene.laser.map(|laser| laser.pulse_j));
    optional("[laser]: wavelength_nm", scene.laser.map(|laser| laser.wavelength_nm));
    optional("[laser]: repetition_hz", scene.laser.map(|laser| laser.repetition_hz));
    optional("[optics]: lens_m", scene.optics.map(|optics| optics.lens_m));
    optional("[optics]: detector_m", scene.optics.and_then(|optics| optics.detector_m));
    optional("[optics]: numerical_aperture", scene.optics.map(|optics| optics.numerical_aperture));
    entries.extend([("[instrument]: load_ohm", instrument.load_ohm), ("[captures]: path_m", captures.path_m)]);
    let mut entries: Vec<Entry> = entries.into_iter().map(|(place, value)| (place.to_owned(), value)).collect();
    for (name, range) in &instrument.ranges {
        entries.push((format!("[instrument.ranges.{name}]: full_scale_v"), range.full_scale_v));
    }
    for (name, surface) in &scene.surfaces {
        entries.extend(surface.cell_m.map(|cell_m| (format!("[surfaces.{name}]: cell_m"), cell_m)));
    }
    for (id, disk) in &scene.patches {
        entries.extend(disk.lobe.map(|lobe| (format!("[patches.{id}]: lobe.width_rad"), lobe.width_rad)));
    }
    for (number, fiducial) in captures.fiducials.iter().enumerate() {
        let place = format!("[[captures.fiducials]] number {}: path_m", number + 1);
        entries.extend(fiducial.path_m.map(|path_m| (place, path_m)));
    }
    entries
}

fn not_negative(scene: &Scene) -> Vec<Entry> {
    let (instrument, captures) = (&scene.instrument, &scene.captures);
    let Flaws { slew_ps, delay_sd_ps, delay_walk_ps, .. } = instrument.flaws;
    let mut entries = vec![
        ("[instrument]: jitter_ps", instrument.jitter_ps),
        ("[instrument]: noise_v", instrument.noise_v.unwrap_or(0.0)),
        ("[instrument]: dark_a", instrument.dark_a),
        ("[instrument.flaws]: slew_ps", slew_ps),
        ("[instrument.flaws]: delay_sd_ps", delay_sd_ps),
        ("[instrument.flaws]: delay_walk_ps", delay_walk_ps),
        ("[captures]: path_sd_m", captures.path_sd_m),
        ("[captures]: response_od", captures.response_od),
        ("[captures]: first_bounce_od", captures.first_bounce_od),
        ("[captures]: overhead_s", captures.overhead_s),
        ("[known]: anchor_sd_m", scene.prior.anchor_sd_m),
        ("[known]: ray_sd_rad", scene.prior.ray_sd_rad),
        ("[known]: station_sd_m", scene.prior.station_sd_m),
    ];
    entries.extend(scene.laser.map(|laser| ("[laser]: power_sd", laser.power_sd)));
    entries.extend(scene.optics.map(|optics| ("[optics]: ambient_w", optics.ambient_w)));
    if let Some(interleave) = instrument.flaws.interleave {
        entries.extend([
            ("[instrument.flaws]: interleave.offset_v", interleave.offset_v),
            ("[instrument.flaws]: interleave.gain", interleave.gain),
        ]);
    }
    if let Some(counts) = instrument.counts {
        entries.extend([
            ("[instrument.counts]: dark_hz", counts.dark_hz),
            ("[instrument.counts]: dead_time_ps", counts.dead_time_ps),
        ]);
    }
    let mut entries: Vec<Entry> = entries.into_iter().map(|(place, value)| (place.to_owned(), value)).collect();
    for (number, fiducial) in captures.fiducials.iter().enumerate() {
        let place = |key: &str| format!("[[captures.fiducials]] number {}: {key}", number + 1);
        entries.push((place("attenuation_od"), fiducial.attenuation_od));
        entries.push((place("every_s"), fiducial.every_s));
    }
    entries
}

fn shares(scene: &Scene) -> Vec<Entry> {
    let mut entries = Vec::new();
    for (id, disk) in &scene.patches {
        entries.push((format!("[patches.{id}]: reflectance"), disk.reflectance));
        entries.extend(disk.lobe.map(|lobe| (format!("[patches.{id}]: lobe.share"), lobe.share)));
    }
    for (name, surface) in &scene.surfaces {
        entries.push((format!("[surfaces.{name}]: reflectance"), surface.reflectance));
    }
    entries.extend(scene.optics.map(|optics| ("[optics]: transmission".to_owned(), optics.transmission)));
    entries.extend(
        scene.instrument.counts.map(|counts| ("[instrument.counts]: efficiency".to_owned(), counts.efficiency)),
    );
    entries.push(("[captures]: bad_shots".to_owned(), scene.captures.bad_shots));
    entries.push(("[captures]: lost_shots".to_owned(), scene.captures.lost_shots));
    entries
}

fn surfaces(scene: &Scene) -> Result<(), String> {
    for (name, surface) in &scene.surfaces {
        let place = format!("[surfaces.{name}]");
        let [u, v] = surface.edges_m.map(nalgebra::Vector3::from);
        if u.norm() == 0.0 || v.norm() == 0.0 || u.dot(&v).abs() > 1e-9 * u.norm() * v.norm() {
            return Err(format!("{place}: edges_m must be two edges at right angles, neither of length 0"));
        }
        if surface.reflectance > 0.0 && surface.cell_m.is_none() {
            return Err(format!("{place}: gives light back; say by `cell_m` how fine it is cut, for instance 0.05"));
        }
    }
    for (id, view) in &scene.views {
        if let Some(patch) = view.patches.iter().find(|patch| !scene.patches.contains_key(patch)) {
            return Err(format!("[views.{id}]: patches names {patch}, which is no patch of the scene"));
        }
        if scene.patches.contains_key(id) {
            return Err(format!("[views.{id}]: {id} is a patch already; number views apart from patches"));
        }
    }
    Ok(())
}

fn instrument(scene: &Scene) -> Result<(), String> {
    let instrument = &scene.instrument;
    if !(8..=16).contains(&instrument.bits) {
        return Err(format!("[instrument]: bits = {}; converters of 8 to 16 bits are simulated", instrument.bits));
    }
    if !(16..=10_000_000).contains(&instrument.samples) {
        return Err(format!("[instrument]: samples = {} is not from 16 to 10,000,000", instrument.samples));
    }
    if instrument.flaws.interleave.is_some_and(|interleave| interleave.cores == 0) {
        return Err("[instrument.flaws]: interleave.cores must be at least 1".to_owned());
    }
    if let Some(reference) = instrument.reference
        && reference.snr.is_some() == reference.height_v.is_some()
    {
        return Err("[instrument]: reference: give either `snr` or `height_v`".to_owned());
    }
    let physical = [
        ("[laser]", scene.laser.is_some()),
        ("[optics]", scene.optics.is_some()),
        ("noise_v in [instrument]", instrument.noise_v.is_some()),
        ("responsivity_a_w in [instrument]", instrument.responsivity_a_w.is_some() || instrument.counts.is_some()),
    ];
    if instrument.snr.is_some() {
        let (noise, ranges) = (instrument.noise_v.is_some(), !instrument.ranges.is_empty());
        let counts = scene.sensors.values().any(|sensor| sensor.kind == SensorKind::Counts);
        return if physical[0].1 || physical[1].1 || noise || ranges || counts {
            Err("[instrument]: `snr` sets the signal-to-noise ratio, and so takes neither [laser], [optics], noise_v, ranges nor photon counters; take it out to have it derived".to_owned())
        } else {
            Ok(())
        };
    }
    if let Some((missing, _)) = physical.into_iter().find(|(_, given)| !given) {
        return Err(format!("{missing} is missing; without it signals have no height (or set `snr` in [instrument])"));
    }
    for (name, sensor) in &scene.sensors {
        if sensor.kind == SensorKind::Counts && instrument.counts.is_none() {
            return Err(format!("[sensors.{name}]: counts photons; add [instrument.counts]"));
        }
        if sensor.kind == SensorKind::Analog && instrument.responsivity_a_w.is_none() {
            return Err("responsivity_a_w in [instrument] is missing".to_owned());
        }
    }
    Ok(())
}

fn captures(scene: &Scene) -> Result<(), String> {
    let captures = &scene.captures;
    if captures.shots == 0 || captures.response_shots == 0 {
        return Err("[captures]: shots and response_shots must be at least 1".to_owned());
    }
    if !(1..=5).contains(&captures.bounces) {
        return Err(format!("[captures]: bounces = {}; light is followed over 1 to 5", captures.bounces));
    }
    if scene.instrument.snr.is_some() && (captures.response_od > 0.0 || captures.first_bounce_od > 0.0) {
        return Err(
            "[captures]: with `snr` set, all signals have one height; take response_od and first_bounce_od out"
                .to_owned(),
        );
    }
    for (key, numbers) in [("lit", scene.lit()), ("seen", scene.seen())] {
        if numbers.is_empty() {
            return Err(format!("[captures]: nothing is {key}: no patch is visible"));
        }
        for number in numbers {
            let Some(patches) = scene
                .views
                .get(&number)
                .map(|view| view.patches.clone())
                .or_else(|| scene.patches.contains_key(&number).then(|| vec![number]))
            else {
                return Err(format!("[captures]: {key} names {number}, which is neither patch nor view"));
            };
            if let Some(hidden) = patches.iter().find(|patch| scene.patches[patch].role == PatchRole::Hidden) {
                return Err(format!("[captures]: {key} names patch {hidden}, which is hidden"));
            }
        }
    }
    for (number, fiducial) in captures.fiducials.iter().enumerate() {
        let place = format!("[[captures.fiducials]] number {}", number + 1);
        if fiducial.path_m.is_some() != fiducial.through.is_empty() {
            return Err(format!("{place}: give either `path_m` or `through`"));
        }
        if let Some(patch) = fiducial.through.iter().find(|patch| !scene.patches.contains_key(patch)) {
            return Err(format!("{place}: through names {patch}, which is no patch of the scene"));
        }
        if fiducial.shots == 0 || fiducial.runs == 0 {
            return Err(format!("{place}: shots and runs must be at least 1"));
        }
        if scene.instrument.snr.is_some() && (!fiducial.through.is_empty() || fiducial.attenuation_od > 0.0) {
            return Err(format!(
                "{place}: with `snr` set, all signals have one height; attenuation and paths through patches need the physical instrument"
            ));
        }
    }
    Ok(())
}
