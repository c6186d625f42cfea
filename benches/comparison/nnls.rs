//! Non-negative least squares on a grid of arrivals: a method of comparison for [`periscope_signal::sparse`].
//!
//! Minimises `|| (y - H x) / sd ||^2` over `x >= 0`, by the active set of Lawson and Hanson, *Solving Least Squares
//! Problems*, chapter 23. Pulses farther apart than the response is long do not meet in the normal matrix, so one round
//! frees many arrivals, one in each neighbourhood. The Cholesky factor of the free arrivals, in order of time, keeps
//! the band of the matrix; rows before the first change stay. A pulse between two grid points becomes two neighbouring
//! atoms: atoms are merged to their centroid, and weak ones dropped.
//!
//! Needs neither a start nor a number of pulses. What it does worse than `sparse`: pulses closer than a few grid steps
//! merge, and noise splits a strong pulse where `sparse` asks for evidence ([`Pulses::pruned`] makes up for the
//! second). A grid finer than a quarter of a Gaussian response's sd is rank deficient to working precision. Not
//! modelled: a baseline, correlated noise, an inexact response.

use periscope_signal::response::Response;
use periscope_signal::sparse::Profile;

use crate::dictionary::Dictionary;
use crate::pulses::Pulses;

/// Grid step in widths of the response where none is given: a quarter of a Gaussian's sd.
const STEP_WIDTHS: f64 = 0.1;
/// An arrival is freed when its residual in the matched filter exceeds this many of its standard deviations: less is
/// not worth a round.
const RESIDUAL_MIN: f64 = 1e-3;
/// Pivots below this part of their diagonal element count as singular.
const SINGULAR: f64 = 1e-12;
/// Rounds of freeing after which the solution is taken as it is; only rounding can need this many.
const ROUNDS: usize = 1000;

/// What is asked of a fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NnlsOptions {
    /// Grid step, ps; `None` for a tenth of the response's width.
    pub step_ps: Option<f64>,
    /// Atoms at most this many grid steps apart are one pulse. 1.5 leaves closer pairs to [`Pulses::pruned`], which
    /// joins a pulse that was split.
    pub merge_steps: f64,
    /// Pulses with a smaller amplitude over `sd / ||h||` are dropped.
    pub snr_min: f64,
}

impl Default for NnlsOptions {
    fn default() -> Self {
        Self { step_ps: None, merge_steps: 2.5, snr_min: 5.0 }
    }
}

/// Pulses of `profile`, whose baseline is removed. The covariance is that of a least-squares fit at these pulses.
///
/// # Panics
/// If the profile is empty, its slices differ in length, an sd is not positive, or a step is not positive.
#[must_use]
pub fn fit(profile: &Profile, response: &Response, options: &NnlsOptions) -> Pulses {
    assert!(profile.sd_v.iter().all(|sd| *sd > 0.0), "the sds must be positive");
    let weights: Vec<f64> = profile.sd_v.iter().map(|sd| 1.0 / sd).collect();
    let data: Vec<f64> = profile.mean_v.iter().zip(&weights).map(|(y, w)| y * w).collect();
    let step_ps = options.step_ps.unwrap_or(STEP_WIDTHS * response.width_ps());
    let dictionary = Dictionary::new(profile, response, step_ps, &weights);
    let atoms = solve(&dictionary, &data);
    let (times_ps, amplitudes_v): (Vec<f64>, Vec<f64>) = merge(&atoms, options.merge_steps)
        .into_iter()
        .filter(|(place, amplitude)| amplitude * dictionary.norm(place.round() as usize) >= options.snr_min)
        .map(|(place, amplitude)| (dictionary.time_ps(place), amplitude))
        .unzip();
    Pulses::with_amplitudes(profile, response, &times_ps, &amplitudes_v).with_covariance(profile, response)
}

/// Place on the grid and amplitude of each run of atoms with gaps of at most `merge_steps`.
fn merge(atoms: &[f64], merge_steps: f64) -> Vec<(f64, f64)> {
    let mut pulses: Vec<(f64, f64)> = Vec::new(); // first moment and sum
    let mut last = f64::NEG_INFINITY;
    for (j, a) in atoms.iter().enumerate().filter(|(_, a)| **a > 0.0) {
        let place = j as f64;
        match pulses.last_mut().filter(|_| place - last <= merge_steps) {
            Some((moment, sum)) => {
                *moment += a * place;
                *sum += a;
            }
            None => pulses.push((a * place, *a)),
        }
        last = place;
    }
    pulses.iter().map(|(moment, sum)| (moment / sum, *sum)).collect()
}

/// The `x >= 0` that minimises `|| data - H x ||^2`, one value for each arrival of the dictionary.
///
/// # Panics
/// If `data` has not the dictionary's number of samples.
#[must_use]
pub fn solve(dictionary: &Dictionary, data: &[f64]) -> Vec<f64> {
    let mut active = ActiveSet {
        dictionary,
        with_data: (0..dictionary.len()).map(|j| dictionary.dot_record(j, data)).collect(),
        x: vec![0.0; dictionary.len()],
        free: Vec::new(),
        refused: vec![false; dictionary.len()],
    };
    let mut descent = active.with_data.clone();
    let mut fitted = vec![0.0; data.len()];
    for _ in 0..ROUNDS {
        let added = active.wanted(&descent);
        if added.is_empty() {
            break;
        }
        active.release(&added);
        dictionary.apply(&active.x, &mut fitted);
        let residual: Vec<f64> = data.iter().zip(&fitted).map(|(y, f)| y - f).collect();
        dictionary.apply_transposed(&residual, &mut descent);
    }
    active.x
}

/// A feasible point and its free arrivals.
struct ActiveSet<'a> {
    dictionary: &'a Dictionary,
    with_data: Vec<f64>,
    x: Vec<f64>,
    /// Arrivals that may differ from 0, rising.
    free: Vec<usize>,
    /// Arrivals whose columns depend linearly on those of free ones.
    refused: Vec<bool>,
}

impl ActiveSet<'_> {
    /// Bound arrivals that want to grow, the strongest first, none within the reach of a stronger one.
    fn wanted(&self, descent: &[f64]) -> Vec<usize> {
        let strength = |j: usize| descent[j] / self.dictionary.norm(j);
        let mut candidates: Vec<usize> = (0..descent.len())
            .filter(|&j| self.x[j] == 0.0 && !self.refused[j] && self.dictionary.norm(j) > 0.0)
            .filter(|&j| strength(j) > RESIDUAL_MIN)
            .collect();
        candidates.sort_by(|i, j| strength(*j).total_cmp(&strength(*i)));
        // Samples that a chosen arrival reaches already.
        let mut taken: Vec<bool> = Vec::new();
        candidates.retain(|&j| {
            let range = self.dictionary.range(j);
            taken.resize(taken.len().max(range.end), false);
            let clear = !taken[range.start] && !taken[range.end - 1];
            if clear {
                taken[range].fill(true);
            }
            clear
        });
        candidates
    }

    /// Frees the arrivals `added` and moves to the least squares on the free ones, binding again those that would turn
    /// negative. The objective falls: on the way to the trial it does, and at least one new arrival has a positive
    /// trial (its descent is).
    fn release(&mut self, added: &[usize]) {
        self.free.extend(added);
        self.free.sort_unstable();
        let mut factor = Band::default();
        let mut kept = 0;
        loop {
            if let Err(singular) = factor.update(self.dictionary, &self.free, kept) {
                kept = self.refuse(singular, added);
                continue;
            }
            let mut trial: Vec<f64> = self.free.iter().map(|j| self.with_data[*j]).collect();
            factor.solve(&mut trial);
            let ratio = |j: usize, t: f64| if self.x[j] == 0.0 { 0.0 } else { self.x[j] / (self.x[j] - t) };
            let blocked = self.free.iter().zip(&trial).enumerate().filter(|(_, (_, t))| **t <= 0.0);
            let blocked = blocked.map(|(i, (j, t))| (i, ratio(*j, *t))).min_by(|p, q| p.1.total_cmp(&q.1));
            let length = blocked.map_or(1.0, |(_, length)| length);
            for (&j, t) in self.free.iter().zip(&trial) {
                self.x[j] += length * (t - self.x[j]);
            }
            let Some((out, _)) = blocked else { return };
            self.x[self.free[out]] = 0.0;
            self.free.remove(out);
            kept = out;
        }
    }

    /// Binds the new arrival next to the singular place for good; the place from which the factor changes.
    fn refuse(&mut self, singular: usize, added: &[usize]) -> usize {
        let new = (0..self.free.len()).filter(|i| added.contains(&self.free[*i]));
        let out = new.min_by_key(|i| i.abs_diff(singular)).unwrap_or(singular);
        self.refused[self.free[out]] = true;
        self.x[self.free[out]] = 0.0;
        self.free.remove(out);
        out.min(singular)
    }
}

/// Cholesky factor of the products of the free arrivals; row `i` begins at the first arrival that meets arrival `i`.
#[derive(Default)]
struct Band {
    rows: Vec<(usize, Vec<f64>)>,
}

impl Band {
    /// Computes the rows from `kept` on. The place of the first row that depends on those before it, if one does.
    fn update(&mut self, dictionary: &Dictionary, free: &[usize], kept: usize) -> Result<(), usize> {
        self.rows.truncate(kept);
        for i in self.rows.len()..free.len() {
            // Later arrivals begin later, so what does not reach this one reaches none after it.
            let meets = |j: &usize| dictionary.range(*j).end > dictionary.range(free[i]).start;
            let first = free[..i].iter().position(meets).unwrap_or(i);
            let mut row: Vec<f64> = free[first..=i].iter().map(|j| dictionary.dot(*j, free[i])).collect();
            for j in first..i {
                let (other_first, other) = &self.rows[j];
                let from = first.max(*other_first);
                let shared = &row[from - first..j - first];
                let done: f64 = shared.iter().zip(&other[from - other_first..]).map(|(a, b)| a * b).sum();
                row[j - first] = (row[j - first] - done) / other[j - other_first];
            }
            let diagonal = row[i - first];
            let rest = diagonal - row[..i - first].iter().map(|l| l * l).sum::<f64>();
            if rest <= SINGULAR * diagonal {
                return Err(i);
            }
            row[i - first] = rest.sqrt();
            self.rows.push((first, row));
        }
        Ok(())
    }

    /// Solves `L L^T x = b` in place.
    fn solve(&self, b: &mut [f64]) {
        for (i, (first, row)) in self.rows.iter().enumerate() {
            let done: f64 = row.iter().zip(&b[*first..i]).map(|(l, x)| l * x).sum();
            b[i] = (b[i] - done) / row[i - first];
        }
        for (i, (first, row)) in self.rows.iter().enumerate().rev() {
            b[i] /= row[i - first];
            let x = b[i];
            b[*first..i].iter_mut().zip(row).for_each(|(b, l)| *b -= l * x);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    fn gaussian() -> Response {
        let values: Vec<f64> =
            (-65..=65).map(|i| (-0.5 * (10.0 * f64::from(i) / 106.165_225_f64).powi(2)).exp()).collect();
        Response::new(-650.0, 10.0, &values)
    }

    fn noisy(response: &Response, pulses: &[(f64, f64)], sd: f64, len: usize, rng: &mut ChaCha8Rng) -> Vec<f64> {
        let light = |t: f64| pulses.iter().map(|(at, a)| a * response.value(t - at)).sum::<f64>();
        let normal = |rng: &mut ChaCha8Rng| -> f64 { StandardNormal.sample(rng) };
        (0..len).map(|n| light(50.0 * n as f64) + sd * normal(rng)).collect()
    }

    #[test]
    fn the_solution_is_the_optimum() {
        let (response, mut rng) = (gaussian(), ChaCha8Rng::seed_from_u64(1));
        for _ in 0..20 {
            let sd_v: Vec<f64> = (0..300).map(|_| rng.random_range(0.01..0.03)).collect();
            let pulses: Vec<(f64, f64)> =
                (0..12).map(|_| (rng.random_range(100.0..14_000.0), rng.random_range(0.1..1.0))).collect();
            let y = noisy(&response, &pulses, 0.02, 300, &mut rng);
            let weights: Vec<f64> = sd_v.iter().map(|sd| 1.0 / sd).collect();
            let data: Vec<f64> = y.iter().zip(&weights).map(|(y, w)| y * w).collect();
            let profile =
                Profile { mean_v: &y, sd_v: &sd_v, acf: &[1.0], slow_v2: &[], jitter: None, t0_ps: 0.0, dt_ps: 50.0 };
            let dictionary = Dictionary::new(&profile, &response, 25.0, &weights);
            let x = solve(&dictionary, &data);
            // Karush, Kuhn and Tucker: no arrival wants to grow, and those that are there want nothing.
            let mut fitted = vec![0.0; 300];
            dictionary.apply(&x, &mut fitted);
            let residual: Vec<f64> = data.iter().zip(&fitted).map(|(y, f)| y - f).collect();
            for (j, x) in x.iter().enumerate() {
                let strength = dictionary.dot_record(j, &residual) / dictionary.norm(j);
                assert!(*x >= 0.0 && strength < 1e-3, "arrival {j}: {x}, {strength}");
                assert!(*x == 0.0 || strength > -1e-6, "arrival {j}: {x}, {strength}");
            }
        }
    }

    #[test]
    fn pulses_are_found_whatever_the_steps_and_ignored_samples_do_not_count() {
        let (response, mut rng) = (gaussian(), ChaCha8Rng::seed_from_u64(2));
        let truth = [(3011.0, 1.0), (3407.0, 0.5), (9120.0, 0.8)];
        let mut y = noisy(&response, &truth, 0.005, 300, &mut rng);
        let mut sd_v = vec![0.005; 300];
        (y[183], sd_v[183]) = (55.0, f64::INFINITY);
        let profile =
            Profile { mean_v: &y, sd_v: &sd_v, acf: &[1.0], slow_v2: &[], jitter: None, t0_ps: 0.0, dt_ps: 50.0 };
        for step_ps in [20.0, 25.0, 37.0] {
            let options = NnlsOptions { step_ps: Some(step_ps), ..NnlsOptions::default() };
            let solution = fit(&profile, &response, &options).pruned(&profile, &response, 20.0);
            assert_eq!(solution.times_ps.len(), 3, "{step_ps}: {solution:?}");
            for (k, (at_ps, a)) in truth.iter().enumerate() {
                let sd_ps = solution.time_sd_ps(k).expect("apart");
                assert!(
                    (solution.times_ps[k] - at_ps).abs() < 4.0 * sd_ps && (solution.amplitudes_v[k] - a).abs() < 0.02
                );
            }
        }
        let nothing = Profile { sd_v: &[f64::INFINITY; 300], ..profile };
        assert!(fit(&nothing, &response, &NnlsOptions::default()).times_ps.is_empty());
    }
}
