//! What is true of a scene, as rows of the pipeline's own tables.

use super::SimulateError;
use super::instrument::Pulse;
use super::scene::{Disk, Scene};
use super::transport::Light;
use crate::tables::{Calibration, Onset, Patch};
use crate::units::PatchId;

impl Scene {
    /// That the response to all of a capture's light lies in the record.
    pub(super) fn check_record(
        &self,
        lit: PatchId,
        seen: PatchId,
        light: &Light,
        latency_ps: f64,
    ) -> Result<(), SimulateError> {
        let instrument = &self.instrument;
        let end_ps = instrument.t0_ps + instrument.samples as f64 * instrument.dt_ps;
        let time_ps = light.centroid_ps() + latency_ps;
        if time_ps > instrument.t0_ps && time_ps < end_ps {
            Ok(())
        } else {
            Err(SimulateError::Outside { lit, seen, time_ps })
        }
    }

    pub(super) fn true_patches(&self) -> Vec<Patch> {
        let row = |(&patch, disk): (&PatchId, &Disk)| {
            let [x_m, y_m, z_m] = disk.position_m;
            Patch {
                patch,
                kind: "visible".into(),
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
                onsets: 2 * self.patches.len() as i32 - 1,
                chi2_dof: None,
                alternative: 0,
                log_likelihood: None,
            }
        };
        self.patches.iter().map(row).collect()
    }

    pub(super) fn true_calibration(&self, sensor: &str, latency_ps: f64, pulse: &Pulse) -> Calibration {
        Calibration {
            campaign: self.name.as_str().into(),
            sensor: sensor.into(),
            range: None,
            shots: 0,
            rejected: 0,
            step_ps: Pulse::STEP_PS,
            response_t0_ps: pulse.start_ps(),
            response: pulse.values().iter().copied().collect(),
            reference_t0_ps: None,
            reference: None,
            latency_ps,
            latency_sd_ps: 0.0,
            width_ps: pulse.width_ps(),
            width_sd_ps: None,
        }
    }

    pub(super) fn true_onset(&self, sensor: &str, lit: PatchId, seen: PatchId, light: &Light) -> Onset {
        let shortcut = self.instrument.snr.is_some();
        Onset {
            campaign: self.name.as_str().into(),
            sensor: sensor.into(),
            lit,
            seen,
            rank: 1,
            time_ps: light.centroid_ps(),
            time_sd_ps: 0.0,
            earliest_ps: Some(light.earliest_ps()),
            amplitude: self.instrument.height_v(light.total()),
            amplitude_sd: None,
            width_ps: light.width_ps(),
            snr: self.instrument.height_v(light.total()) / self.instrument.sample_noise_v(),
            evidence: None,
            covariance: vec![0.0],
            jitter_ps: 0.0,
            flags: if shortcut { vec!["snr-was-set".into()] } else { Vec::new() },
        }
    }
}
