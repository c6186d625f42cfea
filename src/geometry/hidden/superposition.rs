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
const SETTLED: f64 = 1e-6;

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

/// Lets messages settle, in each group of arrivals that paths link by itself: most are small and settle at once.
///
/// # Panics
/// When a pair names a path or an arrival beyond their counts.
pub fn settle(pairs: &mut [Pair], paths: usize, arrivals: usize) {
    let groups = groups(pairs, paths, arrivals);
    let count = groups.last().map_or(0, |last| last + 1);
    let mut ends = vec![0; count + 1];
    pairs.iter().for_each(|pair| ends[groups[pair.arrival] + 1] += 1);
    (0..count).for_each(|group| ends[group + 1] += ends[group]);
    let (mut at, mut sorted) = (ends.clone(), pairs.to_vec());
    for pair in &*pairs {
        let place = &mut at[groups[pair.arrival]];
        sorted[*place] = *pair;
        *place += 1;
    }
    let (mut of_path, mut of_arrival) = (vec![0.0; paths], vec![0.0; arrivals]);
    ends.windows(2).for_each(|ends| settle_group(&mut sorted[ends[0]..ends[1]], &mut of_path, &mut of_arrival));
    at.copy_from_slice(&ends);
    for pair in pairs {
        let place = &mut at[groups[pair.arrival]];
        *pair = sorted[*place];
        *place += 1;
    }
}

/// For each arrival its group, from 0 ascending: arrivals between the first and the last of a path are in one.
fn groups(pairs: &[Pair], paths: usize, arrivals: usize) -> Vec<usize> {
    let mut ends = vec![(usize::MAX, 0); paths];
    for pair in pairs {
        let (first, last) = &mut ends[pair.path];
        (*first, *last) = ((*first).min(pair.arrival), (*last).max(pair.arrival));
    }
    // How many paths reach from before an arrival to it or beyond.
    let mut begun = vec![0_i32; arrivals + 1];
    for (first, last) in ends.into_iter().filter(|(first, last)| first < last) {
        begun[first + 1] += 1;
        begun[last + 1] -= 1;
    }
    let (mut open, mut group) = (0, 0);
    let of_arrival = |n: usize| {
        open += begun[n];
        group += usize::from(n > 0 && open == 0);
        group
    };
    (0..arrivals).map(of_arrival).collect()
}

/// Lets the messages of a group settle. Sums of its paths and arrivals go where `of_path` and `of_arrival` have room.
fn settle_group(pairs: &mut [Pair], of_path: &mut [f64], of_arrival: &mut [f64]) {
    for _ in 0..ROUNDS {
        pairs.iter().for_each(|pair| of_path[pair.path] = 0.0);
        pairs.iter().for_each(|pair| of_path[pair.path] += pair.odds * pair.left);
        pairs.iter().for_each(|pair| of_arrival[pair.arrival] = 0.0);
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

/// Gives back what the paths from `first` to before `end` take, to what all paths leave of each arrival. Pairs are in
/// order of their paths.
pub fn give_back(pairs: &[Pair], [first, end]: [usize; 2], left: &mut [f64]) {
    let from = pairs.partition_point(|pair| pair.path < first);
    for pair in pairs[from..].iter().take_while(|pair| pair.path < end) {
        let left = &mut left[pair.arrival];
        *left = 1.0 / (1.0 / *left - pair.message).max(1.0);
    }
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
