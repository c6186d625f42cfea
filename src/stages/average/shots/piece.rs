//! Shots of a piece of a capture: judged by first shots that lie before it, saved, and joined to others.

use super::super::Average;
use super::super::piece::{exact, nothing};
use super::super::reference::ReferencePulse;
use super::super::rejected::Rejected;
use super::{Shots, Tally};
use crate::signal::average::PhaseSum;
use crate::tables::Subtotal;

impl Shots {
    /// Whether the first shots are there, by which others are judged.
    pub fn is_primed(&self) -> bool {
        self.noise.is_some()
    }

    /// Forgets what was added up, but not what others are judged by. Where the first shots are fewer than it takes,
    /// there are no others.
    pub fn forget(&mut self, average: &Average) {
        if !self.head.is_empty() {
            self.close_head(average);
        }
        let samples = self.first.samples as usize;
        (self.whole, self.cut) = (Tally::new(samples, self.extent), Tally::new(samples, self.extent));
        self.head_mean = None;
        self.clipping.forget();
        self.rejected = Rejected::default();
    }

    /// What a piece adds up to: for shots of either kind a row of counts, and one a phase.
    pub fn save(mut self, average: &Average) -> Result<Vec<Subtotal>, String> {
        if !self.head.is_empty() {
            self.close_head(average);
        }
        exact(&self.first, self.whole.sums.shots() + self.cut.sums.shots())?;
        let mut subtotals = Vec::new();
        for (is_cut, Tally { sums, references }) in [(false, &self.whole), (true, &self.cut)] {
            let pulses = |value: fn(&ReferencePulse) -> f64| references.kept().iter().map(value).collect();
            let counts = Subtotal {
                is_cut,
                reference_ps: pulses(|pulse| pulse.time_ps),
                reference_sd_ps: pulses(|pulse| pulse.time_sd_ps),
                reference_v_ps: pulses(|pulse| pulse.v_ps),
                ..nothing(&self.first)
            };
            subtotals.push(counts);
            subtotals.extend(sums.phases().map(|sum| Subtotal {
                is_cut,
                phase: Some(sum.phase as i32),
                shots: sum.shots as i64,
                first: sum.first,
                covered_from: sum.covered.0,
                covered_to: sum.covered.1,
                sums: sum.sums,
                ..nothing(&self.first)
            }));
        }
        // What is counted for both kinds together stands in the first row.
        subtotals[0].clipped_places = self.clipping.places().collect();
        let Rejected { clipped, outlying, reference_clipped, without_reference, not_a_number, other_scale, at_rails } =
            self.rejected;
        subtotals[0].clipped = i64::from(clipped);
        subtotals[0].outlying = i64::from(outlying);
        subtotals[0].reference_clipped = i64::from(reference_clipped);
        subtotals[0].without_reference = i64::from(without_reference);
        subtotals[0].not_a_number = i64::from(not_a_number);
        subtotals[0].other_scale = i64::from(other_scale);
        subtotals[0].at_rails = i64::from(at_rails);
        Ok(subtotals)
    }

    /// Adds a row of what the next piece adds up to.
    pub fn absorb(&mut self, subtotal: Subtotal) -> Result<(), String> {
        self.rejected.absorb(Rejected {
            clipped: subtotal.clipped as i32,
            outlying: subtotal.outlying as i32,
            reference_clipped: subtotal.reference_clipped as i32,
            without_reference: subtotal.without_reference as i32,
            not_a_number: subtotal.not_a_number as i32,
            other_scale: subtotal.other_scale as i32,
            at_rails: subtotal.at_rails as i32,
        });
        self.clipping.absorb(subtotal.clipped_places);
        let tally = if subtotal.is_cut { &mut self.cut } else { &mut self.whole };
        let pulses = subtotal.reference_ps.iter().zip(&subtotal.reference_sd_ps).zip(&subtotal.reference_v_ps);
        for ((&time_ps, &time_sd_ps), &v_ps) in pulses {
            tally.references.add(ReferencePulse { time_ps, time_sd_ps, v_ps });
        }
        if let Some(phase) = subtotal.phase {
            tally.sums.absorb_phase(PhaseSum {
                phase: phase as usize,
                first: subtotal.first,
                sums: subtotal.sums,
                shots: subtotal.shots as u64,
                covered: (subtotal.covered_from, subtotal.covered_to),
            });
        }
        exact(&self.first, self.whole.sums.shots() + self.cut.sums.shots())
    }
}
