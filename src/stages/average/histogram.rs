//! Photon histograms of a capture, added up. No shot is outlying, none is moved: detections are counted from the
//! trigger on.

use super::piece::{exact, nothing};
use super::{Average, is_alike, rejection};
use crate::signal::codes::Codes;
use crate::stages::stage::Outcome;
use crate::tables::traces::TraceColumns;
use crate::tables::{Profile, Row, Subtotal, Trace};

/// Histograms under way to their sum.
pub struct Histogram {
    first: Trace,
    /// Laser pulses behind each record.
    cycles: u64,
    counts: Vec<f64>,
    records: i32,
    other: i32,
}

impl Histogram {
    /// None yet.
    pub fn new(first: Trace, cycles: u64) -> Self {
        Self { counts: vec![0.0; first.samples as usize], first, cycles, records: 0, other: 0 }
    }

    /// Takes a row. Reference channels say nothing here.
    pub fn take(&mut self, columns: &TraceColumns, i: usize) {
        if columns.is_reference.value(i) {
            return;
        }
        if self.first.is_reference {
            self.first = Trace::read(columns, i);
            self.counts = vec![0.0; self.first.samples as usize];
        }
        if !is_alike(&self.first, columns, i) || columns.t0_ps.value(i) != self.first.t0_ps {
            self.other += 1;
            return;
        }
        let codes = Codes::of(columns.code_type.value(i), columns.codes.value(i));
        codes.expect("ingest writes known code types only").add_to_f64(&mut self.counts);
        self.records += 1;
    }

    /// Whether the record is known that all others must be like.
    pub fn is_primed(&self) -> bool {
        !self.first.is_reference
    }

    /// Forgets what was added up.
    pub fn forget(&mut self) {
        self.counts.fill(0.0);
        (self.records, self.other) = (0, 0);
    }

    /// What a piece adds up to.
    pub fn save(self) -> Result<Vec<Subtotal>, String> {
        exact(&self.first, self.records as u64)?;
        let sums: Vec<i64> = self.counts.iter().map(|&count| count as i64).collect();
        let (shots, other_scale, covered_to) = (i64::from(self.records), i64::from(self.other), sums.len() as i64);
        Ok(vec![Subtotal { phase: Some(0), shots, covered_to, sums, other_scale, ..nothing(&self.first) }])
    }

    /// Adds what the next piece adds up to.
    pub fn absorb(&mut self, subtotal: &Subtotal) -> Result<(), String> {
        self.records += subtotal.shots as i32;
        self.other += subtotal.other_scale as i32;
        self.counts.iter_mut().zip(&subtotal.sums).for_each(|(sum, count)| *sum += *count as f64);
        exact(&self.first, self.records as u64)
    }

    /// The sum as a profile.
    pub fn finish(self, average: &Average) -> Outcome<Profile> {
        let first = &self.first;
        if self.records == 0 {
            return Outcome::rejected(rejection(first, "has no histogram"));
        }
        let counts: Option<Vec<i32>> = self.counts.iter().map(|&count| whole(count)).collect();
        let Some(counts) = counts else {
            return Outcome::rejected(rejection(first, "holds counts that are negative, not whole or above 2^31"));
        };
        let quiet = &self.counts[..average.baseline_samples(first)];
        let baseline = quiet.iter().sum::<f64>() / quiet.len() as f64;
        Outcome::rows(vec![Profile {
            campaign: first.campaign.clone(),
            sensor: first.sensor.clone(),
            lit: first.lit,
            seen: first.seen,
            role: first.role.clone(),
            run: first.run.clone(),
            range: first.range.clone(),
            shots: self.records,
            rejected: self.other,
            clipped: 0,
            t0_ps: first.t0_ps,
            dt_ps: first.dt_ps,
            mean_v: None, // as `counts` says
            se_v: None,
            // So that the noise of the profile is, as for other sensors, that of a shot over the root of the shots.
            noise_v: (baseline.max(1.0) * f64::from(self.records)).sqrt(),
            noise_acf: [1.0_f64].into_iter().collect(),
            noise_model: None,
            slow_noise: None,
            noise_samples: i32::try_from(quiet.len()).ok(),
            baseline_v: baseline,
            phase_shots: None,
            jitter_ps: 0.0,
            gain_sd: 0.0,
            reference_ps: None,
            reference_sd_ps: None,
            reference_v_ps: None,
            reference_sd_v_ps: None,
            counts: Some(counts),
            cycles: i64::try_from(self.cycles).ok().and_then(|cycles| cycles.checked_mul(i64::from(self.records))),
            gain_v: first.gain_v,
            path_m: first.path_m,
            path_sd_m: first.path_sd_m,
            attenuation_od: first.attenuation_od,
            power_w: first.power_w,
            bounces: first.bounces,
            acquired_at: first.acquired_at.clone(),
        }])
    }
}

/// A count as the whole number that it is.
fn whole(count: f64) -> Option<i32> {
    (count.fract() == 0.0 && (0.0..=f64::from(i32::MAX)).contains(&count)).then_some(count as i32)
}
