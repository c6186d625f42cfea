//! Cancels reach the kernels that compute longest.

use periscope_cancel::ends_soon;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::hidden::{self, Arrival, Focus};
use crate::maximum_likelihood::{self, Node, Observation, Problem};
use crate::{Point, faint, placement};

const SD_M: f64 = 0.001;

fn drawn(count: usize, rng: &mut ChaCha8Rng) -> Vec<Point> {
    let mut coordinate = || rng.random_range(-1.0..1.0);
    (0..count).map(|_| Point::new(coordinate(), coordinate(), coordinate() + 2.0)).collect()
}

fn focus(point: Point) -> Focus {
    Focus { point, normal: None }
}

/// Paths over each patch, and over pairs of patches that are near in number.
fn problem(points: &[Point], partners: usize, rng: &mut ChaCha8Rng) -> Problem {
    let origin = Node::Station(0);
    let mut observation = |way: &[usize]| {
        let at = |k: usize| points[way[k]];
        let between: f64 = (1..way.len()).map(|k| (at(k) - at(k - 1)).norm()).sum();
        let length_m = at(0).coords.norm() + between + at(way.len() - 1).coords.norm();
        let nodes = [origin].into_iter().chain(way.iter().map(|&patch| Node::Patch(patch))).chain([origin]).collect();
        Observation::new(nodes, length_m + rng.random_range(-SD_M..SD_M), SD_M)
    };
    let mut observations = Vec::new();
    for patch in 0..points.len() {
        observations.push(observation(&[patch]));
        (1..=partners.min(patch)).for_each(|back| observations.push(observation(&[patch, patch - back])));
    }
    let off = |point: &Point| point + nalgebra::Vector3::repeat(0.02);
    Problem::new(points.iter().map(off).collect(), 3, &[Point::origin()], observations)
}

#[test]
fn maximum_likelihood_ends_with_and_without_its_matrix() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for (count, partners) in [(600, 20), (20_000, 6)] {
        let problem = problem(&drawn(count, &mut rng), partners, &mut rng);
        ends_soon(|cancel| maximum_likelihood::solve(&Problem { cancel: cancel.clone(), ..problem.clone() }));
    }
}

#[test]
fn placement_ends_between_its_starts() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let problem = problem(&drawn(120, &mut rng), 8, &mut rng);
    ends_soon(|cancel| placement::place(&Problem { cancel: cancel.clone(), ..problem.clone() }));
}

/// Arrivals without any order lead to many places, none of them sure.
#[test]
fn the_search_for_hidden_patches_ends() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let foci: Vec<Focus> = drawn(24, &mut rng).into_iter().map(focus).collect();
    let mut profile = |foci: [usize; 2]| {
        let arrivals = (0..60).map(|_| Arrival { length_m: rng.random_range(1.0..8.0), sd_m: SD_M }).collect();
        hidden::Profile::new(foci, arrivals, Vec::new(), [0.0, 9.0])
    };
    let profiles: Vec<hidden::Profile> = (0..24).flat_map(|a| (0..24).map(move |b| [a, b])).map(&mut profile).collect();
    ends_soon(|cancel| {
        let (foci, cancel) = (foci.clone(), cancel.clone());
        let room = hidden::Room { foci, dimensions: 3, false_alarm: 1e-3, count: None, blend_m: 0.0, cancel };
        hidden::find(&profiles, &room)
    });
}

#[test]
fn the_search_for_a_faint_patch_ends() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let foci: Vec<Focus> = drawn(8, &mut rng).into_iter().map(focus).collect();
    let mut profile = |foci: [usize; 2]| {
        let scores: Vec<f64> = (0..4000).map(|_| rng.random_range(-1.7..1.7)).collect();
        faint::Profile { foci, low_m: 0.0, step_m: 0.005, gains: vec![1.0; scores.len()], scores }
    };
    let profiles: Vec<faint::Profile> = (0..8).flat_map(|a| (0..8).map(move |b| [a, b])).map(&mut profile).collect();
    ends_soon(|cancel| {
        let room = faint::Room { foci: foci.clone(), dimensions: 3, width_m: 0.05, cancel: cancel.clone() };
        faint::likeliest(&profiles, &room)
    });
}
