//! The reference pulses of a capture: when they came, and how strong they were.

use crate::signal::reference::{fit_pulse, integral};
use crate::signal::response::Response;

/// The reference pulse of one shot.
#[derive(Clone, Copy, Debug)]
#[expect(clippy::struct_field_names, reason = "picoseconds are a unit, not part of the names")]
pub struct ReferencePulse {
    /// Its time after the trigger.
    pub time_ps: f64,
    /// Standard deviation of the fitted time.
    pub time_sd_ps: f64,
    /// Its integral over the template's reach, baseline removed.
    pub v_ps: f64,
}

impl ReferencePulse {
    /// Fits the pulse of a record, V, whose sample 0 lies at `t0_ps`.
    pub fn of(samples_v: &[f64], t0_ps: f64, dt_ps: f64, template: &Response) -> Option<Self> {
        let fit = fit_pulse(samples_v, dt_ps, template)?;
        let v_ps = integral(samples_v, dt_ps, template, &fit);
        Some(Self { time_ps: t0_ps + fit.time_ps, time_sd_ps: fit.time_sd_ps, v_ps })
    }

    /// The same pulse, of a train with this period the one next to `near_ps`.
    pub fn of_train(self, period_ps: f64, near_ps: f64) -> Self {
        let turns = ((self.time_ps - near_ps) / period_ps).round();
        Self { time_ps: self.time_ps - turns * period_ps, ..self }
    }
}

/// Sums over the reference pulses of the shots averaged.
#[derive(Clone, Debug, Default)]
pub struct References {
    time_ps: Moments,
    v_ps: Moments,
    /// Sum of the squared standard deviations of the times.
    variance_ps2: f64,
    /// The pulses themselves, for pieces: rounded sums depend on the order, so the run that joins pieces adds one by
    /// one.
    kept: Option<Vec<ReferencePulse>>,
}

impl References {
    /// None yet; keeps them as they come.
    pub fn keeping() -> Self {
        Self { kept: Some(Vec::new()), ..Self::default() }
    }

    /// The pulses, in the order of their shots, if they were kept.
    pub fn kept(&self) -> &[ReferencePulse] {
        self.kept.as_deref().unwrap_or_default()
    }

    /// Takes one more.
    pub fn add(&mut self, pulse: ReferencePulse) {
        if let Some(kept) = &mut self.kept {
            kept.push(pulse);
        }
        self.time_ps.add(pulse.time_ps);
        self.v_ps.add(pulse.v_ps);
        self.variance_ps2 += pulse.time_sd_ps * pulse.time_sd_ps;
    }

    /// Takes all of `other`.
    pub fn absorb(&mut self, other: Self) {
        self.time_ps.absorb(other.time_ps);
        self.v_ps.absorb(other.v_ps);
        self.variance_ps2 += other.variance_ps2;
    }

    /// Mean squared standard deviation of the fitted times; `None` without any.
    pub fn alignment_ps2(&self) -> Option<f64> {
        (self.time_ps.count > 0.0).then(|| self.variance_ps2 / self.time_ps.count)
    }

    /// Mean time after the trigger and its standard error.
    pub fn time_ps(&self) -> (Option<f64>, Option<f64>) {
        self.time_ps.mean_and_error()
    }

    /// Mean integral and its standard error.
    pub fn v_ps(&self) -> (Option<f64>, Option<f64>) {
        self.v_ps.mean_and_error()
    }
}

/// Mean and spread of numbers that come one by one (Welford, Technometrics 4, 419 (1962)).
#[derive(Clone, Debug, Default)]
struct Moments {
    count: f64,
    mean: f64,
    squares: f64,
}

impl Moments {
    fn add(&mut self, value: f64) {
        self.count += 1.0;
        let before = value - self.mean;
        self.mean += before / self.count;
        self.squares += before * (value - self.mean);
    }

    fn absorb(&mut self, other: Self) {
        let count = self.count + other.count;
        if count > 0.0 {
            let apart = other.mean - self.mean;
            self.mean += apart * other.count / count;
            self.squares += other.squares + apart * apart * self.count * other.count / count;
            self.count = count;
        }
    }

    fn mean_and_error(&self) -> (Option<f64>, Option<f64>) {
        let error = || (self.squares / (self.count - 1.0) / self.count).sqrt();
        ((self.count > 0.0).then_some(self.mean), (self.count > 1.0).then(error))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn pulses_that_pieces_hand_over_add_up_to_the_bits_of_one_pass() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut pulse = |_| ReferencePulse {
            time_ps: rng.random_range(-900.0..1100.0),
            time_sd_ps: rng.random_range(0.1..7.0),
            v_ps: rng.random_range(1.0..3.0),
        };
        let pulses: Vec<ReferencePulse> = (0..1000).map(&mut pulse).collect();
        let values = |references: &References| (references.time_ps(), references.v_ps(), references.alignment_ps2());
        let mut whole = References::default();
        pulses.iter().for_each(|pulse| whole.add(*pulse));
        for _ in 0..20 {
            let (mut joined, mut rest) = (References::default(), &pulses[..]);
            while !rest.is_empty() {
                let (piece, after) = rest.split_at(rng.random_range(0..=rest.len()));
                let mut handed = References::keeping();
                piece.iter().for_each(|pulse| handed.add(*pulse));
                handed.kept().iter().for_each(|pulse| joined.add(*pulse));
                rest = after;
            }
            assert_eq!(values(&joined), values(&whole));
        }
    }
}
