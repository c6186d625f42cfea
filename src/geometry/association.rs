//! Which predicted path made which arrival, and how sure that is.
//!
//! An arrival at `t` of standard deviation s may be any path whose predicted time lies within the gate, or something
//! that was not predicted. With a path seen with chance p and `clutter` unpredicted arrivals a picosecond about the
//! arrival, arrival and path belong together with the weight `p / (1 - p) N(t; t_p, s^2 + s_p^2) / clutter`. A path
//! makes at most one arrival, and an arrival comes from at most one path. An association of all of them is as likely as
//! the product of its weights. The probability of a pair is the share of those associations that hold it. Source: joint
//! probabilistic data association (Fortmann, Bar-Shalom and Scheffe, IEEE J. Oceanic Eng. 8, 173 (1983)).
//!
//! The sums run over arrivals in order of time, forwards and backwards. What is behind matters only by the paths that
//! it took from those ahead, which are few; of more than 200 such sets the most likely are kept.

use std::collections::BTreeMap;

/// Predictions further off than this many standard deviations are another path: less than one in a million of a path's
/// own arrivals lies beyond.
pub const GATE: f64 = 5.0;
/// Most sets of taken paths that are followed.
const STATES: usize = 200;

/// An expected time with its standard deviation, ps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Time {
    /// Time.
    pub time_ps: f64,
    /// Standard deviation.
    pub sd_ps: f64,
}

/// A path that may make an arrival.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Expected {
    /// When.
    pub time: Time,
    /// Chance that it does, below 1.
    pub seen: f64,
}

/// A path that may have made an arrival.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Its place among the predictions.
    pub path: usize,
    /// Arrival less prediction, ps.
    pub residual_ps: f64,
    /// Probability that it made the arrival.
    pub probability: f64,
}

/// For each arrival its candidates, the most probable first. A path that is the most probable one of several arrivals
/// stays with that of the highest probability and is taken from the others.
///
/// # Panics
/// If not every arrival has a positive `clutter_per_ps`.
#[must_use]
pub fn associate(arrivals: &[Time], predictions: &[Expected], clutter_per_ps: &[f64]) -> Vec<Vec<Candidate>> {
    assert_eq!(arrivals.len(), clutter_per_ps.len(), "an arrival has a density of clutter");
    assert!(clutter_per_ps.iter().all(|clutter| *clutter > 0.0), "something else is always possible");
    let edges = edges(arrivals, predictions, clutter_per_ps);
    let mut order: Vec<usize> = (0..arrivals.len()).collect();
    order.sort_by(|&a, &b| arrivals[a].time_ps.total_cmp(&arrivals[b].time_ps));
    let mut candidates: Vec<Vec<Candidate>> = vec![Vec::new(); arrivals.len()];
    for (&arrival, probabilities) in order.iter().zip(probabilities(&choices(&edges, &order))) {
        let candidate = |(edge, probability): (&Edge, f64)| Candidate {
            path: edge.path,
            residual_ps: edge.residual_ps,
            probability,
        };
        // The first choice is none of them.
        candidates[arrival] = edges[arrival].iter().zip(probabilities.into_iter().skip(1)).map(candidate).collect();
        candidates[arrival].sort_by(|a, b| b.probability.total_cmp(&a.probability).then(a.path.cmp(&b.path)));
    }
    // The surest arrival chooses first; what it takes is gone for the others.
    let mut open: Vec<usize> = (0..arrivals.len()).collect();
    let sureness = |candidates: &[Candidate]| candidates.first().map_or(0.0, |best| best.probability);
    while let Some(surest) =
        open.iter().copied().reduce(|a, b| if sureness(&candidates[b]) > sureness(&candidates[a]) { b } else { a })
    {
        open.retain(|&arrival| arrival != surest);
        if let Some(best) = candidates[surest].first().copied() {
            open.iter().for_each(|&arrival| candidates[arrival].retain(|candidate| candidate.path != best.path));
        }
    }
    candidates
}

/// Natural logarithm of the sum of all associations' weights: by how much the predictions explain the arrivals better
/// than clutter alone. 0 where no prediction is near an arrival.
///
/// # Panics
/// As [`associate`].
#[must_use]
pub fn log_total(arrivals: &[Time], predictions: &[Expected], clutter_per_ps: &[f64]) -> f64 {
    assert_eq!(arrivals.len(), clutter_per_ps.len(), "an arrival has a density of clutter");
    assert!(clutter_per_ps.iter().all(|clutter| *clutter > 0.0), "something else is always possible");
    let edges = edges(arrivals, predictions, clutter_per_ps);
    let mut order: Vec<usize> = (0..arrivals.len()).collect();
    order.sort_by(|&a, &b| arrivals[a].time_ps.total_cmp(&arrivals[b].time_ps));
    let items = choices(&edges, &order);
    forwards(&items, &Lasts::new(&items)).1
}

/// A way to explain an item, an arrival or several that stand for one another: by up to two paths, or by none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    /// The paths that it takes, by their places among the predictions; two are different ones.
    pub paths: [Option<usize>; 2],
    /// Its weight against those of the item's other choices.
    pub weight: f64,
}

/// For each item, in order of time, the probability of each of its choices. Every item has a first choice that takes no
/// path; no path is taken twice.
#[must_use]
pub fn choose(items: &[Vec<Choice>]) -> Vec<Vec<f64>> {
    probabilities(items)
}

/// A path that may have made an arrival.
pub(crate) struct Edge {
    pub(crate) path: usize,
    pub(crate) residual_ps: f64,
    pub(crate) weight: f64,
}

impl Edge {
    fn choice(&self) -> Choice {
        Choice { paths: [Some(self.path), None], weight: self.weight }
    }
}

/// Nothing that was predicted.
const NONE: Choice = Choice { paths: [None, None], weight: 1.0 };

/// For each arrival the paths within the gate.
pub(crate) fn edges(arrivals: &[Time], predictions: &[Expected], clutter_per_ps: &[f64]) -> Vec<Vec<Edge>> {
    let mut order: Vec<usize> = (0..predictions.len()).collect();
    order.sort_by(|&a, &b| predictions[a].time.time_ps.total_cmp(&predictions[b].time.time_ps));
    let widest_ps = predictions.iter().map(|prediction| prediction.time.sd_ps).fold(0.0, f64::max);
    let of_arrival = |(Time { time_ps, sd_ps }, clutter_per_ps): (&Time, &f64)| {
        let reach_ps = GATE * sd_ps.hypot(widest_ps);
        let from = order.partition_point(|&path| predictions[path].time.time_ps < time_ps - reach_ps);
        let near = order[from..].iter().take_while(|path| predictions[**path].time.time_ps <= time_ps + reach_ps);
        let edge = |&path: &usize| {
            let Expected { time, seen } = predictions[path];
            let residual_ps = time_ps - time.time_ps;
            let sd_ps = sd_ps.hypot(time.sd_ps);
            let off = residual_ps / sd_ps;
            let density = (-0.5 * off * off).exp() / ((2.0 * std::f64::consts::PI).sqrt() * sd_ps);
            let weight = seen / (1.0 - seen) * density / clutter_per_ps;
            (off.abs() <= GATE).then_some(Edge { path, residual_ps, weight })
        };
        near.filter_map(edge).collect()
    };
    arrivals.iter().zip(clutter_per_ps).map(of_arrival).collect()
}

/// The choices of arrivals in this order.
fn choices(edges: &[Vec<Edge>], order: &[usize]) -> Vec<Vec<Choice>> {
    let of_arrival = |&n: &usize| std::iter::once(NONE).chain(edges[n].iter().map(Edge::choice)).collect();
    order.iter().map(of_arrival).collect()
}

/// Paths taken by arrivals behind that those ahead could take too, ascending, each set with a weight.
type Taken = BTreeMap<Vec<usize>, f64>;

/// Last item that each path may belong to: after it, whether the path is taken no longer matters.
struct Lasts(BTreeMap<usize, usize>);

impl Lasts {
    fn new(items: &[Vec<Choice>]) -> Self {
        let mut last = BTreeMap::new();
        for (n, choices) in items.iter().enumerate() {
            last.extend(choices.iter().flat_map(|choice| choice.paths.into_iter().flatten()).map(|path| (path, n)));
        }
        Self(last)
    }

    /// Paths that matter after item `n`, if it makes this choice and those behind took `taken`.
    fn after(&self, n: usize, taken: &[usize], choice: &Choice) -> Vec<usize> {
        let more = choice.paths.into_iter().flatten();
        let mut taken: Vec<usize> = taken.iter().copied().chain(more).filter(|path| self.0[path] > n).collect();
        taken.sort_unstable();
        taken
    }
}

fn is_free(choice: &Choice, taken: &[usize]) -> bool {
    choice.paths.iter().flatten().all(|path| !taken.contains(path))
}

/// The sets of taken paths before each item and behind the last, and the logarithm of the sum of all weights.
fn forwards(items: &[Vec<Choice>], lasts: &Lasts) -> (Vec<Taken>, f64) {
    let mut forwards: Vec<Taken> = vec![Taken::from([(Vec::new(), 1.0)])];
    let mut log_total = 0.0;
    for (n, choices) in items.iter().enumerate() {
        let mut next = Taken::new();
        for (taken, weight) in &forwards[n] {
            for choice in choices.iter().filter(|choice| is_free(choice, taken)) {
                *next.entry(lasts.after(n, taken, choice)).or_default() += weight * choice.weight;
            }
        }
        let (kept, largest) = likeliest(next);
        forwards.push(kept);
        // Behind the last item no path matters: one set is left, and its weight is the sum.
        log_total += largest.ln();
    }
    (forwards, log_total)
}

/// For each item, in order of time, the probability of each of its choices, of which the first takes no path.
fn probabilities(items: &[Vec<Choice>]) -> Vec<Vec<f64>> {
    let lasts = Lasts::new(items);
    let (forwards, _) = forwards(items, &lasts);
    let mut shares = vec![Vec::new(); items.len()];
    let mut ahead = Taken::from([(Vec::new(), 1.0)]);
    for (n, choices) in items.iter().enumerate().rev() {
        let rest = |taken: &[usize], choice| ahead.get(&lasts.after(n, taken, choice)).copied().unwrap_or(0.0);
        let mut sums = vec![0.0; choices.len()];
        let mut here = Taken::new();
        for (taken, weight) in &forwards[n] {
            let mut total = 0.0;
            for (choice, sum) in choices.iter().zip(&mut sums).filter(|(choice, _)| is_free(choice, taken)) {
                let share = choice.weight * rest(taken, choice);
                *sum += weight * share;
                total += share;
            }
            here.insert(taken.clone(), total);
        }
        let all = sums[0] + sums[1..].iter().sum::<f64>();
        shares[n] = sums.iter().map(|sum| sum / all).collect();
        ahead = likeliest(here).0;
    }
    shares
}

/// The most likely sets, weights over that of the largest, and the latter.
fn likeliest(taken: Taken) -> (Taken, f64) {
    let largest = taken.values().copied().fold(f64::MIN_POSITIVE, f64::max);
    let mut sets: Vec<(Vec<usize>, f64)> = taken.into_iter().map(|(paths, weight)| (paths, weight / largest)).collect();
    sets.sort_by(|a, b| b.1.total_cmp(&a.1).then_with(|| a.0.cmp(&b.0)));
    sets.truncate(STATES);
    (sets.into_iter().collect(), largest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    const fn at(time_ps: f64, sd_ps: f64) -> Time {
        Time { time_ps, sd_ps }
    }

    /// Seen or not with equal chance.
    const fn path(time_ps: f64, sd_ps: f64) -> Expected {
        Expected { time: at(time_ps, sd_ps), seen: 0.5 }
    }

    #[test]
    fn the_nearest_path_is_sure_where_no_other_is_near() {
        let candidates =
            associate(&[at(100.0, 1.0), at(500.0, 1.0)], &[path(101.0, 0.5), path(300.0, 0.5)], &[1e-4; 2]);
        assert!(
            candidates[0][0].path == 0
                && candidates[0][0].probability > 0.999
                && (candidates[0][0].residual_ps + 1.0).abs() < 1e-12
        );
        assert!(candidates[1].is_empty());
    }

    /// Two paths of equal time share the probability; by Bayes' rule at unequal distances.
    #[test]
    fn paths_that_coincide_share_the_probability() {
        let candidates = associate(&[at(0.0, 1.0)], &[path(0.0, 0.0), path(0.0, 0.0), path(2.0, 0.0)], &[1e-9]);
        let expected = 1.0 / (2.0 + (-2.0_f64).exp());
        assert!((candidates[0][0].probability - expected).abs() < 1e-6, "{candidates:?}");
        assert_eq!(candidates[0].len(), 3);
    }

    #[test]
    fn a_path_makes_one_arrival_only() {
        let candidates = associate(&[at(0.5, 1.0), at(0.0, 1.0)], &[path(0.0, 0.1), path(3.0, 0.1)], &[1e-4; 2]);
        assert_eq!((candidates[1][0].path, candidates[0][0].path), (0, 1));
    }

    /// Two arrivals between two paths: the surer one does not make the other surer than it is itself.
    #[test]
    fn rivals_share_their_doubt() {
        let candidates = associate(&[at(0.0, 20.0), at(10.0, 20.0)], &[path(-30.0, 0.0), path(40.0, 0.0)], &[1e-6; 2]);
        let [first, second] = [candidates[0][0], candidates[1][0]];
        assert_eq!((first.path, second.path), (0, 1));
        let likelihood = |a: f64, b: f64| (-0.5 * (a * a + b * b) / 400.0).exp();
        let right = likelihood(30.0, 30.0);
        let expected = right / (right + likelihood(40.0, 40.0));
        for candidate in [first, second] {
            assert!((candidate.probability - expected).abs() < 1e-3, "{candidates:?} {expected}");
        }
    }

    /// Compared with the sum over all associations, for a few arrivals and paths near one another.
    #[test]
    fn probabilities_are_those_of_all_associations() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut count = 0;
        for _ in 0..200 {
            let arrivals: Vec<Time> = (0..4).map(|_| at(rng.random_range(0.0..20.0), 1.0)).collect();
            let paths: Vec<Expected> = (0..5).map(|_| path(rng.random_range(0.0..20.0), 0.5)).collect();
            let edges = edges(&arrivals, &paths, &[0.01; 4]);
            let all = sum(&edges, &mut Vec::new(), 0, None);
            assert!((log_total(&arrivals, &paths, &[0.01; 4]) - all.ln()).abs() < 1e-9);
            for (arrival, shares) in probabilities(&choices(&edges, &[0, 1, 2, 3])).iter().enumerate() {
                for (edge, probability) in edges[arrival].iter().zip(&shares[1..]) {
                    let exact = sum(&edges, &mut Vec::new(), 0, Some((arrival, edge.path))) / all;
                    assert!((probability - exact).abs() < 1e-12, "{probability} {exact}");
                    count += 1;
                }
            }
        }
        assert!(count > 1000, "{count}");
    }

    /// Sum of the products of weights over all associations of arrivals from `arrival` on; of those only that hold the
    /// pair `with`.
    fn sum(edges: &[Vec<Edge>], used: &mut Vec<usize>, arrival: usize, with: Option<(usize, usize)>) -> f64 {
        if arrival == edges.len() {
            return 1.0;
        }
        let must = with.filter(|with| with.0 == arrival).map(|with| with.1);
        let mut total = if must.is_some() { 0.0 } else { sum(edges, used, arrival + 1, with) };
        for edge in edges[arrival].iter().filter(|edge| must.is_none_or(|path| path == edge.path)) {
            if !used.contains(&edge.path) {
                used.push(edge.path);
                total += edge.weight * sum(edges, used, arrival + 1, with);
                used.pop();
            }
        }
        total
    }

    /// Of two paths at one time the one that is seen more often has the larger share, by its odds.
    #[test]
    fn chances_weigh_paths() {
        let seen = |seen: f64| Expected { seen, ..path(0.0, 0.0) };
        let candidates = associate(&[at(0.0, 1.0)], &[seen(0.2), seen(0.8)], &[1e-9]);
        let share = |chance: f64| chance / (1.0 - chance) / (0.25 + 4.0);
        assert!(
            candidates[0][0].path == 1 && (candidates[0][0].probability - share(0.8)).abs() < 1e-6,
            "{candidates:?}"
        );
        assert!((candidates[0][1].probability - share(0.2)).abs() < 1e-6, "{candidates:?}");
    }

    /// An arrival that no predicted path made gets a low probability, the lower the more clutter there is.
    #[test]
    fn clutter_takes_its_share() {
        let p = |clutter| associate(&[at(4.0, 1.0)], &[path(0.0, 0.0)], &[clutter])[0][0].probability;
        let density = (-8.0_f64).exp() / (2.0 * std::f64::consts::PI).sqrt();
        assert!((p(1e-3) - density / (density + 1e-3)).abs() < 1e-12 && p(1e-2) < p(1e-3));
    }

    /// Items of choices with up to two paths, compared with the sum over all ways to choose.
    #[test]
    fn choices_of_two_paths_are_weighed_like_all_ways_to_choose() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for _ in 0..100 {
            let choice = |n: usize, rng: &mut ChaCha8Rng| {
                let first = rng.random_range(0..4);
                let second = n.is_multiple_of(2).then(|| (first + rng.random_range(1..4)) % 4);
                Choice { paths: [Some(first), second], weight: rng.random_range(0.0..3.0) }
            };
            let items: Vec<Vec<Choice>> =
                (0..4).map(|_| std::iter::once(NONE).chain((0..5).map(|n| choice(n, &mut rng))).collect()).collect();
            let mut sums = vec![vec![0.0; 6]; 4];
            for code in 0..6_usize.pow(4) {
                let way: Vec<usize> = (0..4_u32).map(|n| code / 6_usize.pow(n) % 6).collect();
                let choices: Vec<Choice> = way.iter().zip(&items).map(|(k, choices)| choices[*k]).collect();
                let mut paths: Vec<usize> = choices.iter().flat_map(|c| c.paths.into_iter().flatten()).collect();
                let count = paths.len();
                paths.sort_unstable();
                paths.dedup();
                if paths.len() == count {
                    let weight: f64 = choices.iter().map(|choice| choice.weight).product();
                    way.iter().enumerate().for_each(|(n, k)| sums[n][*k] += weight);
                }
            }
            for (shares, sums) in choose(&items).iter().zip(&sums) {
                let all: f64 = sums.iter().sum();
                assert!(shares.iter().zip(sums).all(|(share, sum)| (share - sum / all).abs() < 1e-12));
            }
        }
    }
}
