//! The shots of a capture at one vertical range, under way to their mean.

mod piece;

use super::clipping::Clipping;
use super::noise::{Judges, Noise};
use super::piece::Extent;
use super::record::Record;
use super::reference::{ReferencePulse, References};
use super::rejected::{Account, Rejected, Sought};
use super::{Average, Context};
use crate::signal::average::{Mean, PHASES, PhaseSums};
use crate::signal::codes::Codes as Samples;
use crate::signal::dark::{self, Dark, Scale};
use crate::signal::noise;
use crate::signal::outlying::OutlierTest;
use crate::signal::shot_spread::{HEAD_SHOTS, Spread};
use crate::tables::{Codes, Profile, Trace};

/// What a record without a dark stretch has to do with its profile.
const LIT: &str = "has no stretch without light as long as its baseline: the baseline is taken where the record varies least, which may be \
     too high, and the noise from differences between shots; record more before the first light, or give `baseline_ps` for a shorter one";

/// A record with its place on the grid.
struct Shot {
    codes: Codes,
    position: i64,
    reference: Option<ReferencePulse>,
    /// Samples at the rails.
    clipped: usize,
}

/// How the stretch without light is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Darkness {
    /// It is the start of each record: the pipeline says so.
    Given,
    /// The start of each record, unless light is found there.
    Sought,
    /// Light may lie anywhere in a record, since it repeats.
    Anywhere,
}

impl Darkness {
    fn of(average: &Average, repeats: bool) -> Self {
        match (repeats, average.baseline_ps.is_some()) {
            (true, _) => Self::Anywhere,
            (false, true) => Self::Given,
            (false, false) => Self::Sought,
        }
    }
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

/// Shots of the head that are not outlying: their mean, and how they differ from it.
struct Judged<'a> {
    passed: Vec<(Samples<'a>, i64)>,
    mean: Mean,
    spread: Spread,
}

/// Shots of one range.
pub struct Shots {
    /// First signal row: scale and time base that all others must have.
    pub first: Trace,
    /// The stretch without light.
    dark: Dark,
    /// How it is found.
    darkness: Darkness,
    /// No stretch was found without light.
    is_lit: bool,
    /// What noise leaves in the mean of so many first shots, where light is sought in that of all.
    scale: Option<(usize, Scale)>,
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
    /// Shots that do not count.
    pub rejected: Rejected,
}

impl Shots {
    /// None yet; those of a piece can be saved.
    pub fn new(average: &Average, context: &Context, first: Trace, extent: Extent) -> Self {
        let samples = first.samples as usize;
        Self {
            dark: Dark::at_start(average.baseline_samples(&first)),
            darkness: Darkness::of(average, context.period_ps(&first).is_some()),
            is_lit: false,
            scale: None,
            trigger_ps2: context.trigger_ps2(&first) / f64::from(first.averaged_shots),
            head: Vec::new(),
            test: None,
            noise: None,
            head_mean: None,
            whole: Tally::new(samples, extent),
            cut: Tally::new(samples, extent),
            extent,
            clipping: Clipping::new(average, first.dt_ps),
            rejected: Rejected::default(),
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

    /// Adds a shot, unless it is outlying; returns whether it is not.
    fn add(&mut self, shot: &Shot) -> bool {
        let codes = view(&self.first.code_type, &shot.codes);
        if self.test.as_ref().is_some_and(|test| test.is_outlier(codes, shot.position)) {
            let is_clipped = i32::from(shot.clipped > 0);
            self.rejected.clipped += is_clipped;
            self.rejected.outlying += 1 - is_clipped;
            self.rejected.at_rails += is_clipped;
            return false;
        }
        if shot.clipped > 0 {
            self.clipping.mark(codes, shot.position, shot.clipped);
            self.cut.add(codes, shot);
        } else {
            self.whole.add(codes, shot);
        }
        true
    }

    /// Judges the first shots by one another, adds those that pass, and takes the noise from them: from whole ones,
    /// unless most are clipped.
    fn close_head(&mut self, average: &Average) {
        let head = std::mem::take(&mut self.head);
        let clipping = 2 * head.iter().filter(|shot| shot.clipped > 0).count() > head.len();
        let before = self.rejected;
        let Some(mut judged) = self.judge(average, &head, clipping) else { return };
        if self.darkness == Darkness::Sought && self.seek_dark(&judged) {
            // By light in their baselines shots were judged wrongly.
            (self.rejected, self.whole, self.cut) = (before, self.tally(), self.tally());
            self.clipping.forget();
            match self.judge(average, &head, clipping) {
                Some(again) => judged = again,
                None => return,
            }
        }
        let Judged { passed, mean, spread } = judged;
        if self.darkness == Darkness::Anywhere {
            self.dark.place = Some(mean.first_position + noise::quietest(&mean.mean, self.dark.samples) as i64);
        }
        let clear = self.clipping.clear_of(mean.first_position, mean.mean.len());
        let (level, dark) = (self.level(&mean), self.baseline());
        let judges = Judges {
            shots: &passed,
            mean: &mean,
            spread: &spread,
            level,
            dark: &dark,
            clear: &clear,
            first: &self.first,
        };
        // Of light that repeats, a record is cut and folded: its slow noise is not that of the profile.
        let slow = if self.darkness == Darkness::Anywhere { None } else { judges.slow() };
        self.noise = Some(Noise::of(&judges, || self.stretches(&passed, &mean), slow));
        self.head_mean = (!clipping).then(|| (self.whole.sums.shots(), mean));
    }

    /// Adds the shots of the head that are not outlying.
    fn judge<'a>(&mut self, average: &Average, head: &'a [Shot], clipping: bool) -> Option<Judged<'a>> {
        let code_type = self.first.code_type.clone();
        let is_judge = |shot: &&Shot| clipping || shot.clipped == 0;
        let of_shot = |shot: &'a Shot| (view(&code_type, &shot.codes), shot.position);
        if average.reject_outliers {
            let judges: Vec<(Samples<'_>, i64)> = head.iter().filter(is_judge).map(of_shot).collect();
            self.test = OutlierTest::new(&judges, self.baseline(), average.outlier_sigma.get());
        }
        let good: Vec<&Shot> = head.iter().filter(|shot| self.add(shot)).collect();
        let passed: Vec<(Samples<'_>, i64)> = good.into_iter().filter(is_judge).map(of_shot).collect();
        // Those that passed, and no others, have been added up.
        let mean = if clipping {
            let mut sums = self.whole.sums.clone();
            sums.absorb(self.cut.sums.clone());
            sums.finish()
        } else {
            self.whole.sums.finish()
        };
        let mean = mean?;
        let spread = Spread::of(&passed, &mean, &self.baseline());
        Some(Judged { passed, mean, spread })
    }

    /// Looks for light where the records are taken as dark, and for a stretch without. Returns whether there is a
    /// better one than the start of each record.
    fn seek_dark(&mut self, judged: &Judged<'_>) -> bool {
        let Judged { passed, mean, spread } = judged;
        let samples = self.dark.samples.min(mean.mean.len());
        let scale = Scale::of(passed, mean, &spread.variances);
        self.scale = Some((passed.len(), scale));
        let clear = self.clipping.clear_of(mean.first_position, mean.mean.len());
        let place = match dark::find(&mean.mean, &clear, samples, &scale) {
            dark::Place::AtStart => return false,
            dark::Place::At(place) => place,
            dark::Place::Nowhere(place) => {
                self.is_lit = true;
                place
            }
        };
        self.dark.place = Some(mean.first_position + place as i64);
        true
    }

    /// The stretch by which shots are compared: light that repeats fills the start of all alike.
    fn baseline(&self) -> Dark {
        match self.darkness {
            Darkness::Anywhere => Dark::at_start(self.dark.samples),
            _ => self.dark,
        }
    }

    fn tally(&self) -> Tally {
        Tally::new(self.first.samples as usize, self.extent)
    }

    /// Samples of noise alone: of the shots where they are dark. Where they are dark nowhere, their differences from
    /// the mean there.
    fn stretches(&self, passed: &[(Samples<'_>, i64)], mean: &Mean) -> Vec<Vec<f64>> {
        if !self.is_lit || passed.len() < 2 {
            let stretch =
                |(codes, position): &(Samples<'_>, i64)| codes.slice(self.dark.range(codes.len(), *position)).to_f64();
            return passed.iter().map(stretch).collect();
        }
        let shots = passed.len() as f64;
        // The mean has its share of each shot.
        let scale = (shots / (shots - 1.0)).sqrt();
        let stretch = |(difference, (_, position)): (&Vec<f64>, &(Samples<'_>, i64))| {
            // Differences begin where both shot and mean do.
            let first = (*position).max(mean.first_position * PHASES as i64);
            let range = self.dark.range(difference.len(), first);
            difference[range].iter().map(|value| value * scale).collect()
        };
        dark::differences(passed, mean).iter().zip(passed).map(stretch).collect()
    }

    /// Mean code without light.
    fn level(&self, mean: &Mean) -> f64 {
        let dark = &mean.mean[self.dark.of_mean(mean)];
        dark.iter().sum::<f64>() / dark.len() as f64
    }

    /// The mean of all shots, and what is doubtful about it; of those with clipped samples only where there are
    /// `several` ranges. `sought`: where the reference pulse was sought.
    pub fn finish(
        mut self,
        average: &Average,
        several: bool,
        sought: Option<&Sought>,
    ) -> Result<(Record, Vec<String>), String> {
        if self.noise.is_none() {
            self.close_head(average);
        }
        let cut = std::mem::replace(&mut self.cut, Tally::new(self.first.samples as usize, Extent::Whole));
        if several {
            self.whole.absorb(cut);
        } else {
            let cut = cut.sums.shots() as i32;
            self.rejected.clipped += cut;
            self.rejected.at_rails += cut;
        }
        let (shots, rejected) = (self.whole.sums.shots(), self.rejected);
        let account = |first, valid| Account { average, first, sought, rejected, valid };
        if shots < u64::from(average.shots_needed()) {
            return Err(account(&self.first, shots).too_few());
        }
        // Where no other shots came, the mean is there already.
        let of_head = self.head_mean.take().filter(|(of, _)| *of == shots).map(|(_, mean)| mean);
        let mean = of_head.or_else(|| self.whole.sums.finish()).zip(self.noise.take());
        if let Some((mean, _)) = &mean {
            self.seek_darker(mean, shots);
        }
        let Some((mean, noise)) = mean else {
            return Err(
                "has shots so far apart in time that none overlaps all others; check its reference channel and trigger"
                    .to_owned(),
            );
        };
        let mut doubts = Vec::from_iter(account(&self.first, shots).lost_many());
        doubts.extend(self.is_lit.then(|| LIT.to_owned()));
        doubts.extend(sought.is_none().then(|| self.late(&noise)).flatten());
        Ok((self.record(&mean, &noise), doubts))
    }

    /// Shots without a reference pulse that come early and late by more than a sample: a pulse that marks time zero
    /// would take that off.
    fn late(&self, noise: &Noise) -> Option<String> {
        let jitter_ps = self.jitter_ps2(noise).sqrt();
        (jitter_ps > self.first.dt_ps).then(|| {
            format!(
                "has shots that come early and late by {jitter_ps:.0} ps: if a channel sees the laser, name it as `reference` in the \
                 [[captures]] rule"
            )
        })
    }

    /// In the mean of all shots light shows that the first ones did not: the level is then taken elsewhere.
    fn seek_darker(&mut self, mean: &Mean, shots: u64) {
        let Some((of, scale)) = self.scale.filter(|(of, _)| shots > *of as u64 && !self.is_lit) else { return };
        let samples = self.dark.samples.min(mean.mean.len());
        let clear = self.clipping.clear_of(mean.first_position, mean.mean.len());
        if let dark::Place::At(place) = dark::find(&mean.mean, &clear, samples, &scale.of_more(of, shots)) {
            self.dark.place = Some(mean.first_position + place as i64);
        }
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
            rejected: self.rejected.total(),
            clipped: self.rejected.at_rails,
            t0_ps: 0.0,
            dt_ps: first.dt_ps,
            mean_v: None,
            se_v: None,
            noise_v: noise.total_sd_v(records) * averaged.sqrt(),
            noise_acf: noise.acf.iter().copied().collect(),
            noise_model: noise.model.as_ref().map(|model| model.values.map(|value| value * averaged).to_vec()),
            slow_noise: noise.slow_v2.as_ref().map(|slow_v2| slow_v2.iter().map(|value| value * averaged).collect()),
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
        let se_v = noise.mean_sd_v(&mean_v, records);
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
