//! Averaging of shots that are moved onto a common time grid, exactly.
//!
//! The time of a shot's sample 0 is rounded to 1/64 sample. Codes are summed as integers, a sum for each of the 64
//! phases that occurs; at the end each phase is delayed once onto the grid, by a band-limited filter
//! ([`super::resample`]), and the phases are added. The sums are therefore the same for any order of shots, and a shot
//! costs one addition a sample. A capture without jitter has one phase and no filter at all. Source: averaging of
//! exposures, paper section 5.

use std::ops::Range;

use super::codes::Codes;
use super::resample;

/// Phases of a sample: the grid to which a shot's time is rounded, so an error of at most 1/128 sample.
pub const PHASES: usize = 64;
/// Number of shots whose sums of 16 bit codes stay within 32 bits.
const SPILL_SHOTS: u32 = 1 << 15;

/// Sums of the shots of one capture.
#[derive(Clone, Debug)]
pub struct PhaseSums {
    samples: usize,
    /// Of the phases that occur, in the order of their first shots.
    bins: Vec<Bin>,
    /// Where in these a phase stands; `NONE` if no shot has it.
    places: [u8; PHASES],
    shots: u64,
}

/// No phase stands here.
const NONE: u8 = u8::MAX;

/// Sums of the shots of one phase. Shots of one phase may still lie whole samples apart.
#[derive(Clone, Debug)]
struct Bin {
    phase: usize,
    /// Place on the grid of the first sum.
    first: i64,
    /// Sums since the last spill, and those before (whole numbers below 2^53 are exact in `f64`): none until the first.
    sums: Vec<i32>,
    spilled: Vec<f64>,
    since_spill: u32,
    shots: u64,
    /// Places that all shots of the phase cover.
    covered: (i64, i64),
}

impl Bin {
    fn new(phase: usize, whole: i64, samples: usize) -> Self {
        Self {
            phase,
            first: whole,
            sums: vec![0; samples],
            spilled: Vec::new(),
            since_spill: 0,
            shots: 0,
            covered: (whole, whole + samples as i64),
        }
    }

    /// Makes room for a shot whose first sample lies at `whole`.
    fn reach(&mut self, whole: i64, samples: usize) {
        let before = (self.first - whole).max(0) as usize;
        if before > 0 {
            self.sums.splice(0..0, std::iter::repeat_n(0, before));
            if !self.spilled.is_empty() {
                self.spilled.splice(0..0, std::iter::repeat_n(0.0, before));
            }
            self.first = whole;
        }
        let needed = (whole - self.first) as usize + samples;
        if needed > self.sums.len() {
            self.sums.resize(needed, 0);
            if !self.spilled.is_empty() {
                self.spilled.resize(needed, 0.0);
            }
        }
    }

    /// Sums before the last spill, with room for them.
    fn spilled(&mut self) -> &mut [f64] {
        self.spilled.resize(self.sums.len(), 0.0);
        &mut self.spilled
    }

    fn add(&mut self, codes: Codes<'_>, whole: i64, samples: usize) {
        if whole < self.first || (whole - self.first) as usize + samples > self.sums.len() {
            self.reach(whole, samples);
        }
        let at = (whole - self.first) as usize;
        match codes {
            Codes::F32(_) | Codes::F64(_) | Codes::I32(_) | Codes::U32(_) => {
                codes.add_to_f64(&mut self.spilled()[at..])
            }
            _ => {
                codes.add_to(&mut self.sums[at..]);
                self.since_spill += 1;
                if self.since_spill == SPILL_SHOTS {
                    self.spill();
                }
            }
        }
        self.shots += 1;
        self.covered = (self.covered.0.max(whole), self.covered.1.min(whole + samples as i64));
    }

    fn absorb(&mut self, mut other: Self) {
        other.spill();
        self.reach(other.first, other.sums.len());
        let at = (other.first - self.first) as usize;
        self.spilled()[at..].iter_mut().zip(other.spilled).for_each(|(sum, other)| *sum += other);
        self.shots += other.shots;
        self.covered = (self.covered.0.max(other.covered.0), self.covered.1.min(other.covered.1));
    }

    fn spill(&mut self) {
        self.spilled();
        for (total, sum) in self.spilled.iter_mut().zip(&mut self.sums) {
            *total += f64::from(std::mem::take(sum));
        }
        self.since_spill = 0;
    }

    /// Sums on the places that all shots cover.
    fn totals(&self) -> Vec<f64> {
        let place = |whole: i64| (whole - self.first) as usize;
        self.totals_of(place(self.covered.0)..place(self.covered.1))
    }

    fn totals_of(&self, places: Range<usize>) -> Vec<f64> {
        let sums = self.sums[places.clone()].iter().map(|sum| f64::from(*sum));
        if self.spilled.is_empty() {
            return sums.collect();
        }
        self.spilled[places].iter().zip(sums).map(|(total, sum)| total + sum).collect()
    }
}

/// The shots of one phase, added up: what is handed over where the shots of a capture are added up in several places.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PhaseSum {
    /// Which of the [`PHASES`].
    pub phase: usize,
    /// Place on the grid of the first sum.
    pub first: i64,
    /// Sums of codes that are whole numbers, below 2^53.
    pub sums: Vec<i64>,
    /// Shots added.
    pub shots: u64,
    /// Places that all shots of the phase cover: from the first to the one behind the last.
    pub covered: (i64, i64),
}

/// Mean of the shots, in codes, on the places that all of them cover.
#[derive(Clone, Debug, PartialEq)]
pub struct Mean {
    /// Place on the grid of the first value: its time in samples.
    pub first_position: i64,
    /// Mean codes.
    pub mean: Vec<f64>,
}

impl PhaseSums {
    /// No shots yet, of `samples` samples each.
    ///
    /// # Panics
    /// When there are no samples.
    #[must_use]
    pub fn new(samples: usize) -> Self {
        assert!(samples > 0, "a shot has samples");
        Self { samples, bins: Vec::new(), places: [NONE; PHASES], shots: 0 }
    }

    /// The sums of a phase, if it has shots.
    fn bin(&mut self, phase: usize) -> Option<&mut Bin> {
        self.bins.get_mut(usize::from(self.places[phase]))
    }

    fn put(&mut self, bin: Bin) {
        self.places[bin.phase] = self.bins.len() as u8;
        self.bins.push(bin);
    }

    /// The sums phase by phase.
    fn bins(&self) -> impl Iterator<Item = &Bin> {
        self.places.iter().filter_map(|place| self.bins.get(usize::from(*place)))
    }

    /// Adds a shot whose sample 0 lies at `position` / 64 samples on the grid.
    ///
    /// # Panics
    /// When the shot has another number of samples.
    pub fn add(&mut self, codes: Codes<'_>, position: i64) {
        assert_eq!(codes.len(), self.samples, "samples of a shot");
        let (whole, phase) = (position.div_euclid(PHASES as i64), position.rem_euclid(PHASES as i64));
        let (phase, samples) = (phase as usize, self.samples);
        if self.places[phase] == NONE {
            self.put(Bin::new(phase, whole, samples));
        }
        self.bins[usize::from(self.places[phase])].add(codes, whole, samples);
        self.shots += 1;
    }

    /// Adds all shots of other sums.
    ///
    /// # Panics
    /// When these have another number of samples.
    pub fn absorb(&mut self, other: Self) {
        assert_eq!(self.samples, other.samples, "samples of a shot");
        other.bins.into_iter().for_each(|bin| self.absorb_bin(bin));
    }

    fn absorb_bin(&mut self, bin: Bin) {
        self.shots += bin.shots;
        match self.bin(bin.phase) {
            Some(own) => own.absorb(bin),
            None => self.put(bin),
        }
    }

    /// The sums phase by phase; exact where codes are whole numbers.
    pub fn phases(&self) -> impl Iterator<Item = PhaseSum> {
        self.bins().map(|bin| PhaseSum {
            phase: bin.phase,
            first: bin.first,
            sums: bin.totals_of(0..bin.sums.len()).into_iter().map(|sum| sum as i64).collect(),
            shots: bin.shots,
            covered: bin.covered,
        })
    }

    /// Adds all shots of a phase of other sums.
    ///
    /// # Panics
    /// When there is no such phase, or a shot of it has another number of samples.
    pub fn absorb_phase(&mut self, other: PhaseSum) {
        let PhaseSum { phase, first, sums, shots, covered } = other;
        assert!(sums.len() >= self.samples, "samples of a shot");
        let spilled: Vec<f64> = sums.into_iter().map(|sum| sum as f64).collect();
        assert!(phase < PHASES, "phase {phase} of {PHASES}");
        self.absorb_bin(Bin { phase, first, sums: vec![0; spilled.len()], spilled, since_spill: 0, shots, covered });
    }

    /// Shots added.
    #[must_use]
    pub fn shots(&self) -> u64 {
        self.shots
    }

    /// Shots of each of the [`PHASES`] phases.
    #[must_use]
    pub fn phase_shots(&self) -> Vec<u64> {
        let place = |place: &u8| self.bins.get(usize::from(*place)).map_or(0, |bin| bin.shots);
        self.places.iter().map(place).collect()
    }

    /// The mean; `None` without shots, or when no place is covered by all of them.
    #[must_use]
    pub fn finish(&self) -> Option<Mean> {
        // A shot of phase > 0 begins between two places: the later one is the first that it covers.
        let start = self.bins().map(|bin| bin.covered.0 + i64::from(bin.phase > 0)).max()?;
        let end = self.bins().map(|bin| bin.covered.1).min()?;
        if start >= end || self.bins.iter().any(|bin| bin.covered.0 >= bin.covered.1) {
            return None;
        }
        let mut mean = vec![0.0; (end - start) as usize];
        let mut delayed = Vec::new();
        for bin in self.bins() {
            let totals = bin.totals();
            let skip = (start - bin.covered.0) as usize;
            let on_grid = if bin.phase == 0 {
                &totals
            } else {
                delayed.resize(totals.len(), 0.0);
                resample::delay(&totals, bin.phase as f64 / PHASES as f64, &mut delayed);
                &delayed
            };
            mean.iter_mut().zip(&on_grid[skip..]).for_each(|(sum, value)| *sum += value);
        }
        let shots = self.shots as f64;
        mean.iter_mut().for_each(|sum| *sum /= shots);
        Some(Mean { first_position: start, mean })
    }
}

#[cfg(test)]
mod tests;
