//! Which predicted path made which arrival, and how sure that is.
//!
//! An arrival at `t` of standard deviation s may be any path whose predicted time lies within the gate, or something that was not predicted. With
//! paths equally likely beforehand and `clutter` unpredicted arrivals a picosecond, path p has the probability
//! `N(t; t_p, s^2 + s_p^2) / (sum over paths + clutter)`. A path makes at most one arrival: it goes to the one that is most probable. Source: gated
//! nearest-neighbour association with clutter (Bar-Shalom, Daum and Huang, IEEE Control Syst. Mag. 29, 82 (2009)).

/// Predictions further off than this many standard deviations are another path.
pub const GATE: f64 = 5.0;

/// An expected time with its standard deviation, ps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Time {
    /// Time.
    pub time_ps: f64,
    /// Standard deviation.
    pub sd_ps: f64,
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

/// For each arrival its candidates, the most probable first. A path that is the most probable one of several arrivals stays with that of the highest
/// probability and is taken from the others, whose other candidates share its probability.
///
/// # Panics
/// If `clutter_per_ps` is not positive.
#[must_use]
pub fn associate(arrivals: &[Time], predictions: &[Time], clutter_per_ps: f64) -> Vec<Vec<Candidate>> {
    assert!(clutter_per_ps > 0.0, "something else is always possible");
    let mut order: Vec<usize> = (0..predictions.len()).collect();
    order.sort_by(|&a, &b| predictions[a].time_ps.total_cmp(&predictions[b].time_ps));
    let widest_ps = predictions.iter().map(|prediction| prediction.sd_ps).fold(0.0, f64::max);
    let mut taken: Vec<Option<usize>> = vec![None; predictions.len()];
    let weigh = |arrival: &Time, is_free: &dyn Fn(usize) -> bool| -> Vec<Candidate> {
        let reach_ps = GATE * arrival.sd_ps.hypot(widest_ps);
        let from = order.partition_point(|&p| predictions[p].time_ps < arrival.time_ps - reach_ps);
        let near = order[from..].iter().take_while(|p| predictions[**p].time_ps <= arrival.time_ps + reach_ps);
        let candidate = |&path: &usize| {
            let residual_ps = arrival.time_ps - predictions[path].time_ps;
            let sd_ps = arrival.sd_ps.hypot(predictions[path].sd_ps);
            let off = residual_ps / sd_ps;
            let density = (-0.5 * off * off).exp() / ((2.0 * std::f64::consts::PI).sqrt() * sd_ps);
            (off.abs() <= GATE && is_free(path)).then_some(Candidate { path, residual_ps, probability: density })
        };
        let mut candidates: Vec<Candidate> = near.filter_map(candidate).collect();
        let total = clutter_per_ps + candidates.iter().map(|candidate| candidate.probability).sum::<f64>();
        candidates.iter_mut().for_each(|candidate| candidate.probability /= total);
        candidates.sort_by(|a, b| b.probability.total_cmp(&a.probability).then(a.path.cmp(&b.path)));
        candidates
    };
    // The surest arrival chooses first; what it takes is gone for the others.
    let mut open: Vec<usize> = (0..arrivals.len()).collect();
    let mut found = vec![Vec::new(); arrivals.len()];
    while !open.is_empty() {
        let weighed: Vec<(usize, Vec<Candidate>)> =
            open.iter().map(|&a| (a, weigh(&arrivals[a], &|path| taken[path].is_none()))).collect();
        let sureness = |candidates: &[Candidate]| candidates.first().map_or(0.0, |best| best.probability);
        let (arrival, candidates) = weighed
            .into_iter()
            .reduce(|a, b| if sureness(&b.1) > sureness(&a.1) { b } else { a })
            .expect("there are open arrivals");
        if let Some(best) = candidates.first() {
            taken[best.path] = Some(arrival);
        }
        found[arrival] = candidates;
        open.retain(|&a| a != arrival);
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn at(time_ps: f64, sd_ps: f64) -> Time {
        Time { time_ps, sd_ps }
    }

    #[test]
    fn the_nearest_path_is_sure_where_no_other_is_near() {
        let found = associate(&[at(100.0, 1.0), at(500.0, 1.0)], &[at(101.0, 0.5), at(300.0, 0.5)], 1e-4);
        assert!(
            found[0][0].path == 0 && found[0][0].probability > 0.999 && (found[0][0].residual_ps + 1.0).abs() < 1e-12
        );
        assert!(found[1].is_empty());
    }

    /// Two paths of equal time share the probability; by Bayes' rule at unequal distances.
    #[test]
    fn paths_that_coincide_share_the_probability() {
        let found = associate(&[at(0.0, 1.0)], &[at(0.0, 0.0), at(0.0, 0.0), at(2.0, 0.0)], 1e-9);
        let expected = 1.0 / (2.0 + (-2.0_f64).exp());
        assert!((found[0][0].probability - expected).abs() < 1e-6, "{found:?}");
        assert_eq!(found[0].len(), 3);
    }

    #[test]
    fn a_path_makes_one_arrival_only() {
        let found = associate(&[at(0.5, 1.0), at(0.0, 1.0)], &[at(0.0, 0.1), at(3.0, 0.1)], 1e-4);
        assert_eq!((found[1][0].path, found[0][0].path), (0, 1));
    }

    /// What is no predicted path is told by a low probability, the lower the more clutter there is.
    #[test]
    fn clutter_takes_its_share() {
        let p = |clutter| associate(&[at(4.0, 1.0)], &[at(0.0, 0.0)], clutter)[0][0].probability;
        let density = (-8.0_f64).exp() / (2.0 * std::f64::consts::PI).sqrt();
        assert!((p(1e-3) - density / (density + 1e-3)).abs() < 1e-12 && p(1e-2) < p(1e-3));
    }
}
