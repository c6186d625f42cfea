//! The shots of a capture at one vertical range, under way to their mean.

mod piece;

use std::iter::empty;

use super::clipping::Clipping;
use super::noise::Noise;
use super::piece::Extent;
use super::record::Record;
use super::reference::{ReferencePulse, References};
use super::{Average, Context};
use crate::signal::average::{Mean, PHASES, PhaseSums};
use crate::signal::codes::Codes as Samples;
use crate::signal::noise;
use crate::signal::shot_spread::{HEAD_SHOTS, OutlierTest};
use crate::tables::{Codes, Profile, Trace};

/// Records of fewer samples are hardly ever meant.
const SAMPLES_FEW: i32 = 100;

/// A record with its place on the grid.
struct Shot {
    codes: Codes,
    position: i64,
    reference: Option<ReferencePulse>,
    /// Samples at the rails.
    clipped: usize,
}

/// Sums of shots.
struct Tally {
    sums: PhaseSums,
    references: References,
}

impl Tally {
    fn new(samples: usize, extent: Extent) -> Self {
        let references = match extent {
            Extent::Whole => References::default(),
            Extent::Piece => References::keeping(),
        };
        Self { sums: PhaseSums::new(samples), references }
    }

    fn add(&mut self, codes: Samples<'_>, shot: &Shot) {
        self.sums.add(codes, shot.position);
        if let Some(pulse) = shot.reference {
            self.references.add(pulse);
        }
    }

    fn absorb(&mut self, other: Self) {
        self.sums.absorb(other.sums);
        self.references.absorb(other.references);
    }
}

/// Shots of one range.
pub struct Shots {
    /// First signal row: scale and time base that all others must have.
    pub first: Trace,
    /// Samples of the stretch without light.
    baseline: usize,
    /// Place where that stretch begins; absent: at the start of each record.
    quiet: Option<i64>,
    /// Whether light may lie anywhere in a record.
    circular: bool,
    /// Variance of a record's time, ps^2, that no reference pulse takes off.
    trigger_ps2: f64,
    /// Shots that were kept until enough are there to judge outliers by.
    head: Vec<Shot>,
    test: Option<OutlierTest>,
    /// Known once the head is closed.
    noise: Option<Noise>,
    /// Mean of the whole shots of the head, and how many these are.
    head_mean: Option<(u64, Mean)>,
    /// Shots that are whole, and those with clipped samples: these count where another range has what they lack.
    whole: Tally,
    cut: Tally,
    extent: Extent,
    clipping: Clipping,
    pub rejected: i32,
    /// Of these, clipped.
    pub clipped: i32,
    pub other_scale: i32,
}

impl Shots {
    /// None yet; those of a piece can be saved.
    pub fn new(average: &Average, context: &Context, first: Trace, extent: Extent) -> Self {
        let samples = first.samples as usize;
        Self {
            baseline: average.baseline_samples(&first),
            quiet: None,
            circular: context.period_ps(&first).is_some(),
            trigger_ps2: context.trigger_ps2(&first) / f64::from(first.averaged_shots),
            head: Vec::new(),
            test: None,
            noise: None,
            head_mean: None,
            whole: Tally::new(samples, extent),
            cut: Tally::new(samples, extent),
            extent,
            clipping: Clipping::new(average, first.dt_ps),
            rejected: 0,
            clipped: 0,
            other_scale: 0,
            first,
        }
    }

    /// Takes a shot whose sample 0 lies at `t0_ps` after the trigger.
    pub fn take(
        &mut self,
        average: &Average,
        codes: Codes,
        t0_ps: f64,
        reference: Option<ReferencePulse>,
        clipped: usize,
    ) {
        let zero_ps = reference.map_or(0.0, |pulse| pulse.time_ps);
        let position = ((t0_ps - zero_ps) / self.first.dt_ps * PHASES as f64).round() as i64;
        let shot = Shot { codes, position, reference, clipped };
        if self.noise.is_some() {
            self.add(&shot);
            return;
        }
        self.head.push(shot);
        if self.head.len() == HEAD_SHOTS {
            self.close_head(average);
        }
    }

    /// Adds a shot, unless it is outlying.
    fn add(&mut self, shot: &Shot) {
        let codes = view(&self.first.code_type, &shot.codes);
        if self.test.as_ref().is_some_and(|test| test.is_outlier(codes, shot.position)) {
            self.rejected += 1;
            self.clipped += i32::from(shot.clipped > 0);
        } else if shot.clipped > 0 {
            self.clipping.mark(codes, shot.position, shot.clipped);
            self.cut.add(codes, shot);
        } else {
            self.whole.add(codes, shot);
        }
    }

    /// Judges the first shots by one another, adds those that pass, and takes the noise from them: from whole ones,
    /// unless most are clipped.
    fn close_head(&mut self, average: &Average) {
        let head = std::mem::take(&mut self.head);
        let code_type = self.first.code_type.clone();
        let clipping = 2 * head.iter().filter(|shot| shot.clipped > 0).count() > head.len();
        let judges = head.iter().filter(|shot| clipping || shot.clipped == 0);
        let views: Vec<(Samples<'_>, i64)> =
            judges.map(|shot| (view(&code_type, &shot.codes), shot.position)).collect();
        if average.reject_outliers {
            self.test = OutlierTest::new(&views, self.baseline, average.outlier_sigma.get());
        }
        let is_good = |(codes, position): &(Samples<'_>, i64)| {
            !self.test.as_ref().is_some_and(|test| test.is_outlier(*codes, *position))
        };
        let passed: Vec<(Samples<'_>, i64)> = views.into_iter().filter(is_good).collect();
        head.iter().for_each(|shot| self.add(shot));
        // Those that passed, and no others, have been added up.
        let mean = if clipping {
            let mut sums = self.whole.sums.clone();
            sums.absorb(self.cut.sums.clone());
            sums.finish()
        } else {
            self.whole.sums.finish()
        };
        let Some(mean) = mean else {
            return;
        };
        if self.circular {
            self.quiet = Some(mean.first_position + noise::quietest(&mean.mean, self.baseline) as i64);
        }
        let stretches: Vec<Vec<f64>> = passed.iter().map(|(codes, position)| self.stretch(*codes, *position)).collect();
        let clear = self.clipping.clear_of(mean.first_position, mean.mean.len());
        self.noise = Some(Noise::of(&passed, &stretches, &mean, self.level(&mean), &clear, &self.first));
        self.head_mean = (!clipping).then(|| (self.whole.sums.shots(), mean));
    }

    /// Samples of a shot without light.
    fn stretch(&self, codes: Samples<'_>, position: i64) -> Vec<f64> {
        let latest = (codes.len() - self.baseline) as i64;
        let start =
            self.quiet.map_or(0, |quiet| (quiet - position.div_euclid(PHASES as i64)).clamp(0, latest) as usize);
        codes.slice(start..start + self.baseline).to_f64()
    }

    /// Mean code without light.
    fn level(&self, mean: &Mean) -> f64 {
        let count = self.baseline.min(mean.mean.len());
        let latest = (mean.mean.len() - count) as i64;
        let start = self.quiet.map_or(0, |quiet| (quiet - mean.first_position).clamp(0, latest) as usize);
        mean.mean[start..start + count].iter().sum::<f64>() / count as f64
    }

    /// The mean of all shots; of those with clipped samples only where there are `several` ranges.
    pub fn finish(mut self, average: &Average, several: bool) -> Result<Record, String> {
        if self.noise.is_none() {
            self.close_head(average);
        }
        let cut = std::mem::replace(&mut self.cut, Tally::new(self.first.samples as usize, Extent::Whole));
        if several {
            self.whole.absorb(cut);
        } else {
            let cut = cut.sums.shots() as i32;
            self.rejected += cut;
            self.clipped += cut;
        }
        let (shots, needed) = (self.whole.sums.shots(), average.shots_needed());
        if shots < u64::from(needed) {
            return Err(self.too_few(shots, needed));
        }
        // Where no other shots came, the mean is there already.
        let of_head = self.head_mean.take().filter(|(of, _)| *of == shots).map(|(_, mean)| mean);
        let mean = of_head.or_else(|| self.whole.sums.finish()).zip(self.noise.take());
        let Some((mean, noise)) = mean else {
            return Err(
                "has shots so far apart in time that none overlaps all others; check its reference channel and trigger"
                    .to_owned(),
            );
        };
        Ok(self.record(&mean, &noise))
    }

    /// Where the others went.
    fn too_few(&self, shots: u64, needed: u32) -> String {
        let Self { rejected, clipped, other_scale, .. } = *self;
        let kinds = [
            (clipped, "were clipped"),
            (rejected - clipped, "were outlying, without reference pulse or not a number"),
            (other_scale, "were of another scale, length or setting"),
        ];
        let gone: Vec<String> =
            kinds.iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}")).collect();
        let gone = if gone.is_empty() { "no others were captured".to_owned() } else { gone.join(", ") };
        let samples = self.first.samples;
        let axes = if samples < SAMPLES_FEW && rejected + other_scale > samples {
            format!(
                " (more shots than the {samples} samples of each: are the axes of the array in the order shots, samples?)"
            )
        } else {
            String::new()
        };
        format!("has {shots} valid shots of the {needed} that it needs; {gone}{axes}")
    }

    fn record(self, mean: &Mean, noise: &Noise) -> Record {
        let records = self.whole.sums.shots() as f64;
        let baseline = self.level(mean);
        let (jitter_ps2, references) = (self.jitter_ps2(noise), self.whole.references);
        let Trace { gain_v, offset_v, averaged_shots, .. } = self.first;
        let mean_v: Vec<f64> = mean.mean.iter().map(|code| (code - baseline) * gain_v).collect();
        // The noise is that of records; the oscilloscope may have averaged each.
        let averaged = f64::from(averaged_shots);
        let (reference_ps, reference_sd_ps) = references.time_ps();
        let (reference_v_ps, reference_sd_v_ps) = references.v_ps();
        let first = self.first;
        let profile = Profile {
            campaign: first.campaign,
            sensor: first.sensor,
            lit: first.lit,
            seen: first.seen,
            role: first.role,
            run: first.run,
            range: first.range,
            shots: records as i32 * averaged_shots,
            rejected: self.rejected + self.other_scale,
            clipped: self.clipped,
            t0_ps: 0.0,
            dt_ps: first.dt_ps,
            mean_v: empty::<f64>().collect(),
            se_v: empty::<f64>().collect(),
            noise_v: noise.sd_v * averaged.sqrt(),
            noise_acf: noise.acf.iter().copied().collect(),
            noise_model: noise.model.as_ref().map(|model| model.values.map(|value| value * averaged).to_vec()),
            noise_samples: i32::try_from(noise.samples).ok(),
            baseline_v: baseline * gain_v + offset_v,
            phase_shots: Some(self.whole.sums.phase_shots().into_iter().map(|shots| shots as i32).collect()),
            jitter_ps: (jitter_ps2 / records).sqrt(),
            gain_sd: (noise.energy() / records).sqrt(),
            reference_ps,
            reference_sd_ps,
            reference_v_ps,
            reference_sd_v_ps,
            counts: None,
            cycles: None,
            gain_v,
            path_m: first.path_m,
            path_sd_m: first.path_sd_m,
            attenuation_od: first.attenuation_od,
            power_w: first.power_w,
            bounces: first.bounces,
            acquired_at: first.acquired_at,
        };
        let se_v = mean_v.iter().map(|v| (noise.own_v2(*v) / records).sqrt()).collect();
        Record { first: mean.first_position, mean_v, se_v, clipping: self.clipping, profile }
    }

    /// Variance of a record's time in the mean: what the fits of the reference pulses and the rounding to a phase
    /// leave, or without reference pulses the trigger; or what the noise shows if that is significantly more.
    fn jitter_ps2(&self, noise: &Noise) -> f64 {
        let step_ps = self.first.dt_ps / PHASES as f64;
        let fitted_ps2 = self.whole.references.alignment_ps2().map(|fits_ps2| fits_ps2 + step_ps * step_ps / 12.0);
        let known_ps2 = fitted_ps2.unwrap_or(self.trigger_ps2);
        noise.jitter_ps2(known_ps2).unwrap_or(known_ps2)
    }
}

/// Bytes as samples.
pub fn view<'a>(code_type: &str, bytes: &'a [u8]) -> Samples<'a> {
    Samples::of(code_type, bytes).expect("ingest writes known code types only")
}
