//! Lengths of any paths with noise, and where they put the patches.

use std::iter;

use periscope::geometry::Point;
use periscope::geometry::maximum_likelihood::{self, Node, Observation, Problem, Solution, Unsolved};
use periscope::geometry::placement;
use rand_chacha::ChaCha8Rng;

use super::measured::normal;
use super::room::Way;

/// Lengths of `ways` with noise of standard deviations `sds_m` and a common delay from a prior of `delay_sd_m`; and
/// that delay.
pub fn measured(
    truth: &[Point],
    stations: &[Point],
    ways: &[Way],
    sds_m: &[f64],
    delay_sd_m: f64,
    rng: &mut ChaCha8Rng,
) -> (Problem, f64) {
    let delay_m = delay_sd_m * normal(rng);
    let observation = |(way, &sd_m): (&Way, &f64)| {
        let inner = way.patches.iter().map(|&patch| Node::Patch(patch));
        Observation::new(
            iter::once(Node::Station(way.source)).chain(inner).chain([Node::Station(way.sensor)]).collect(),
            way.length_m(truth, stations) + delay_m + sd_m * normal(rng),
            sd_m,
        )
    };
    let observations = ways.iter().zip(sds_m).map(observation).collect();
    let nowhere = vec![Point::origin(); truth.len()];
    (Problem::new(nowhere, 3, stations, observations).with_common_delay(delay_sd_m), delay_m)
}

/// Patches placed from nothing and refined, as the stage `refine` does; the likeliest alternative where it is likelier.
///
/// # Errors
/// As [`maximum_likelihood::solve`] from where they are placed.
pub fn refined(problem: &Problem) -> Result<Solution, Unsolved> {
    let from = |start: Vec<Point>| maximum_likelihood::solve(&Problem { start, ..problem.clone() });
    let solution = from(placement::place(problem).points)?;
    let other = placement::alternatives(problem, &solution.points, &[]).into_iter().next();
    // An alternative that is no minimum is none.
    let other = other.and_then(|other| from(other.points).ok());
    Ok(other.filter(|other| other.loss < solution.loss).unwrap_or(solution))
}
