//! Which of several paths made which arrival of a profile, by belief propagation.
//!
//! A path is seen with probability p and then makes one arrival; an arrival comes from one path or from none (clutter
//! of density `lambda`). With `psi = p / (1 - p) N(arrival - path) / lambda`, the messages
//!
//! ```text
//! to_arrival = psi / (1 + sum of psi to_path over the path's other arrivals)
//! to_path    = 1 / (1 + sum of to_arrival over the arrival's other paths)
//! ```
//!
//! settle where each says how much the rest leaves of the pair; exact where pairs form a tree. Source: Williams and
//! Lau, IEEE Trans. AES-50, 2942 (2014). Where [`crate::association`] sums over all associations of a few arrivals,
//! this serves hundreds of profiles again and again.

/// Rounds of messages at most.
const ROUNDS: usize = 30;
/// Messages that change by less have settled.
const SETTLED: f64 = 1e-4;

/// A path that may have made an arrival.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// Path.
    pub path: usize,
    /// Arrival.
    pub arrival: usize,
    /// `psi`.
    pub odds: f64,
    /// What other paths leave of the arrival for this one: 1 all, 0 nothing.
    pub left: f64,
    /// What the path says to the arrival.
    message: f64,
}

impl Pair {
    /// Before any message.
    #[must_use]
    pub const fn new(path: usize, arrival: usize, odds: f64) -> Self {
        Self { path, arrival, odds, left: 1.0, message: 0.0 }
    }
}

/// Lets messages settle.
///
/// # Panics
/// When a pair names a path or an arrival beyond their counts.
pub fn settle(pairs: &mut [Pair], paths: usize, arrivals: usize) {
    let (mut of_path, mut of_arrival) = (vec![0.0; paths], vec![0.0; arrivals]);
    for _ in 0..ROUNDS {
        of_path.fill(0.0);
        for pair in &*pairs {
            of_path[pair.path] += pair.odds * pair.left;
        }
        of_arrival.fill(0.0);
        for pair in &mut *pairs {
            pair.message = pair.odds / (1.0 + of_path[pair.path] - pair.odds * pair.left);
            of_arrival[pair.arrival] += pair.message;
        }
        let mut change = 0.0_f64;
        for pair in &mut *pairs {
            let left = 1.0 / (1.0 + of_arrival[pair.arrival] - pair.message);
            change = change.max((left - pair.left).abs());
            pair.left = left;
        }
        if change < SETTLED {
            break;
        }
    }
}

/// What the paths that count leave of each arrival.
#[must_use]
pub fn left_over(pairs: &[Pair], arrivals: usize, counts: impl Fn(usize) -> bool) -> Vec<f64> {
    let mut whole = vec![1.0; arrivals];
    pairs.iter().filter(|pair| counts(pair.path)).for_each(|pair| whole[pair.arrival] += pair.message);
    whole.into_iter().map(|whole| 1.0 / whole).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Weight of all associations, each path and arrival used once at most; of those only that hold the pair `with`.
    fn sum(pairs: &[Pair], from: usize, used: &mut Vec<(usize, usize)>, with: Option<usize>) -> f64 {
        let Some(pair) = pairs.get(from) else { return 1.0 };
        let is_free = used.iter().all(|(path, arrival)| *path != pair.path && *arrival != pair.arrival);
        let mut total = if with == Some(from) { 0.0 } else { sum(pairs, from + 1, used, with) };
        if is_free {
            used.push((pair.path, pair.arrival));
            total += pair.odds * sum(pairs, from + 1, used, with);
            used.pop();
        }
        total
    }

    /// Probability of each pair, from the messages.
    fn probabilities(pairs: &[Pair], paths: usize) -> Vec<f64> {
        let mut all = vec![1.0; paths];
        pairs.iter().for_each(|pair| all[pair.path] += pair.odds * pair.left);
        pairs.iter().map(|pair| pair.odds * pair.left / all[pair.path]).collect()
    }

    #[test]
    fn a_chain_of_rivals_is_exact() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for _ in 0..50 {
            // Path n may have made arrivals n and n + 1.
            let pair = |n: usize, k: usize, rng: &mut ChaCha8Rng| Pair::new(n, n + k, rng.random_range(0.1_f64..20.0));
            let mut pairs: Vec<Pair> =
                (0..4).flat_map(|n| [(n, 0), (n, 1)]).map(|(n, k)| pair(n, k, &mut rng)).collect();
            let all = sum(&pairs, 0, &mut Vec::new(), None);
            let exact: Vec<f64> = (0..pairs.len()).map(|n| sum(&pairs, 0, &mut Vec::new(), Some(n)) / all).collect();
            settle(&mut pairs, 4, 5);
            for (estimate, exact) in probabilities(&pairs, 4).iter().zip(&exact) {
                assert!((estimate - exact).abs() < 1e-3, "{estimate} {exact}");
            }
        }
    }

    #[test]
    fn what_one_path_explains_is_gone_for_others() {
        let mut pairs = vec![Pair::new(0, 0, 1e6)];
        settle(&mut pairs, 1, 2);
        let left = left_over(&pairs, 2, |_| true);
        assert!(left[0] < 1e-5 && (left[1] - 1.0).abs() < 1e-12);
        assert_eq!(left_over(&pairs, 2, |path| path > 0), [1.0, 1.0]);
    }
}
