//! The truth of a scene, as rows of the pipeline's own tables and of those that only a simulation can fill.

use std::collections::BTreeMap;

use super::SimulateError;
use super::chain::Chain;
use super::scene::Scene;
use super::session::Shooting;
use super::transport::{CaptureLights, Light};
use crate::campaign::Role;
use crate::campaign::keys::{LASER, PatchRole};
use crate::tables::{Calibration, Onset, Patch, TrueCapture, TrueCentroid, TruePath};
use crate::units::{self, PatchId};

/// Least height, over the averaged noise, at which a path makes an onset.
const ONSET_SNR: f64 = 1.0;

impl Scene {
    /// Checks that the earliest light of a capture is within the record.
    pub(super) fn check_record(&self, shooting: &Shooting) -> Result<(), SimulateError> {
        let first = shooting.paths.iter().min_by_key(|(path, _)| path.len());
        let Some(time_ps) = first.map(|(_, light)| light.centroid_ps() + shooting.latency_ps) else {
            return Ok(());
        };
        if self.records(time_ps) {
            Ok(())
        } else {
            Err(SimulateError::Outside { lit: shooting.lit, seen: shooting.seen, time_ps })
        }
    }

    /// Whether a time is within the record, modulo the laser's period.
    fn records(&self, time_ps: f64) -> bool {
        let instrument = &self.instrument;
        let length_ps = instrument.samples as f64 * instrument.dt_ps;
        let after_ps = time_ps - instrument.t0_ps;
        let after_ps = self.repetition_ps().map_or(after_ps, |period_ps| after_ps.rem_euclid(period_ps));
        after_ps > 0.0 && after_ps < length_ps
    }

    /// Positions of the patches.
    pub(super) fn true_patches(&self) -> Vec<Patch> {
        let onsets = (self.lit().len() + self.seen().len()) as i32 - 1;
        let row = |(&patch, disk): (&PatchId, &super::keys::Disk)| {
            let [x_m, y_m, z_m] = disk.position_m;
            Patch {
                patch,
                kind: disk.role.name().into(),
                x_m,
                y_m,
                z_m,
                cov_xx_m2: Some(0.0),
                cov_xy_m2: Some(0.0),
                cov_xz_m2: Some(0.0),
                cov_yy_m2: Some(0.0),
                cov_yz_m2: Some(0.0),
                cov_zz_m2: Some(0.0),
                sd_m: Some(0.0),
                onsets: if disk.role == PatchRole::Visible { onsets } else { 0 },
                alternative: 0,
                ..Patch::default()
            }
        };
        self.patches.iter().map(row).collect()
    }

    /// Responses and latencies, one row per sensor and range.
    pub(super) fn true_calibration(&self, chain: &Chain) -> Vec<Calibration> {
        let row = |sensor: &str, latency_ps: f64, setting: &super::chain::Setting| Calibration {
            campaign: self.name.as_str().into(),
            sensor: sensor.into(),
            range: setting.name.as_deref().map(Into::into),
            shots: 0,
            rejected: 0,
            step_ps: super::pulse::Pulse::STEP_PS,
            response_t0_ps: chain.pulse.start_ps(),
            response: chain.pulse.values().iter().copied().collect(),
            latency_ps: latency_ps + setting.latency_ps,
            latency_sd_ps: 0.0,
            width_ps: chain.pulse.width_ps(),
            ..Calibration::default()
        };
        let rows = |(name, sensor): (&String, &super::keys::Sensor)| {
            chain.settings.iter().map(|setting| row(name, sensor.latency_ps, setting)).collect::<Vec<_>>()
        };
        self.sensors.iter().flat_map(rows).collect()
    }

    /// Centroids of the first bounces.
    pub(super) fn true_centroids(&self, lights: &BTreeMap<PatchId, CaptureLights>) -> Vec<TrueCentroid> {
        let mut rows = Vec::new();
        for (patch, disk) in &self.patches {
            for sensor in self.sensors.keys() {
                let light = lights.get(patch).and_then(|lights| lights.get(&(sensor.clone(), *patch)));
                let Some(light) = light.and_then(|paths| paths.get(&vec![*patch])) else {
                    continue;
                };
                let [x_m, y_m, z_m] = disk.position_m;
                let way_m =
                    |from: [f64; 3]| from.iter().zip(disk.position_m).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
                rows.push(TrueCentroid {
                    campaign: self.name.as_str().into(),
                    sensor: sensor.as_str().into(),
                    patch: *patch,
                    x_m,
                    y_m,
                    z_m,
                    centre_path_m: way_m(self.stations[LASER].position_m) + way_m(self.sensor_m(sensor)),
                    centroid_path_m: units::path_m(light.centroid_ps(), self.group_index),
                });
            }
        }
        rows
    }

    /// Paths of a capture, in order of time.
    pub(super) fn true_paths(&self, chain: &Chain, shooting: &Shooting) -> Vec<TruePath> {
        let row = |(path, light): (&Vec<PatchId>, &Light)| {
            let strength = light.total();
            let volts = chain.volts_per_strength(shooting.light.total()) * shooting.factor;
            TruePath {
                campaign: self.name.as_str().into(),
                sensor: shooting.sensor.as_str().into(),
                lit: shooting.lit,
                seen: shooting.seen,
                path: path.clone(),
                bounces: path.len() as i32,
                time_ps: light.centroid_ps(),
                earliest_ps: light.earliest_ps(),
                width_ps: light.width_ps(),
                energy_j: self.instrument.snr.is_none().then_some(strength * shooting.factor),
                height_v: (!shooting.counts).then_some(volts * strength),
                snr: shooting.shot_snr(self, chain, strength) * (shooting.shots as f64).sqrt(),
                recorded: self.records(light.centroid_ps() + shooting.latency_ps),
            }
        };
        let mut rows: Vec<TruePath> = shooting.paths.iter().map(row).collect();
        rows.sort_by(|a, b| a.time_ps.total_cmp(&b.time_ps));
        rows
    }

    /// Properties of a capture.
    pub(super) fn true_capture(&self, chain: &Chain, shooting: &Shooting, file: &str) -> TrueCapture {
        let strength = shooting.light.total();
        let height_v = chain.volts_per_strength(strength) * strength * shooting.factor;
        let shot_v2 = chain.shot_v2_per_strength() * strength * shooting.factor;
        let analog = |value: f64| (!shooting.counts).then_some(value);
        TrueCapture {
            campaign: self.name.as_str().into(),
            sensor: shooting.sensor.as_str().into(),
            lit: shooting.lit,
            seen: shooting.seen,
            role: shooting.role.name().into(),
            range: shooting.setting.name.as_deref().map(Into::into),
            file: file.into(),
            shots: shooting.shots as i32,
            start_s: shooting.start_s,
            duration_s: shooting.duration_s(self),
            attenuation_od: shooting.attenuation_od,
            noise_v: analog(shooting.setting.noise_v),
            full_scale_v: analog(shooting.setting.full_scale_v),
            height_v: analog(height_v),
            shot_noise_v: analog(shot_v2.sqrt()),
            snr: shooting.shot_snr(self, chain, strength),
            snr_was_set: self.instrument.snr.is_some(),
            latency_ps: shooting.latency_ps,
        }
    }
}

/// Arrivals of a capture above its averaged noise.
pub(super) fn true_onsets(paths: &[TruePath], shooting: &Shooting, snr_was_set: bool) -> Vec<Onset> {
    let is_scene = shooting.role == Role::Scene;
    let strong = paths.iter().filter(|path| is_scene && path.recorded && path.snr >= ONSET_SNR);
    let onset = |(rank, path): (usize, &TruePath)| Onset {
        campaign: path.campaign.clone(),
        sensor: path.sensor.clone(),
        lit: path.lit,
        seen: path.seen,
        range: shooting.setting.name.as_deref().map(Into::into),
        rank: rank as i32 + 1,
        time_ps: path.time_ps,
        time_sd_ps: 0.0,
        earliest_ps: Some(path.earliest_ps),
        amplitude: path.height_v.unwrap_or(0.0),
        width_ps: path.width_ps,
        snr: path.snr,
        covariance: vec![0.0],
        jitter_ps: 0.0,
        flags: if snr_was_set { vec!["snr-was-set".into()] } else { Vec::new() },
        ..Onset::default()
    };
    strong.enumerate().map(onset).collect()
}
