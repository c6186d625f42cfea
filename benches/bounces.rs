//! Study: what bounces after the third are worth. Prints the tables of docs/accuracy.md, "Later bounces".
//!
//! `cargo bench --bench bounces` for all, `cargo bench --bench bounces -- gain` for one of gain, layers; a number sets
//! the scenes.

use std::collections::BTreeMap;

use periscope::geometry::hidden::{Arrival, Focus, Profile, Room, Way, find_by_minimal_sets};
use periscope::geometry::loss::Loss;
use periscope::geometry::maximum_likelihood::{self, Node, Observation, Problem};
use periscope::geometry::{Matrix, Point, dense};
use periscope::units::path_m;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

#[allow(dead_code, reason = "the tests use more of it")]
#[path = "../src/geometry/hidden/tests/layers.rs"]
mod layers;
#[allow(dead_code, reason = "other studies use more of it")]
#[path = "resolution/score.rs"]
mod score;

use score::{Estimate, Rate};

/// Standard deviation of a third bounce's onset.
const NOISE_PS: f64 = 5.0;
/// Signal-to-noise ratio of third bounces: those whose own falls below `SEEN` are not there.
const SNR: f64 = 1000.0;
const SEEN: f64 = 5.0;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    let scenes: Option<u64> = arguments.iter().find_map(|argument| argument.parse().ok());
    let names: Vec<&String> = arguments.iter().filter(|argument| argument.parse::<u64>().is_err()).collect();
    let is_selected = |name: &str| names.is_empty() || names.iter().any(|given| *given == name);
    if is_selected("gain") {
        gain(scenes.unwrap_or(20));
    }
    if is_selected("layers") {
        second_layer(scenes.unwrap_or(20));
    }
}

/// Hidden patches before two walls of visible ones, which are exactly known.
struct Scene {
    visible: Vec<Point>,
    hidden: Vec<Point>,
}

/// Which fourth bounces there are.
#[derive(Clone, Copy, PartialEq)]
enum Fourth {
    /// Lit, hidden, hidden, seen.
    BetweenHidden,
    /// Over a visible and a hidden patch too, in either order.
    All,
}

impl Scene {
    fn draw(visible: usize, hidden: usize, rng: &mut ChaCha8Rng) -> Self {
        let wall = |k: usize, rng: &mut ChaCha8Rng| {
            let (along, z) = (rng.random_range(0.0..1.6), rng.random_range(-0.8..0.8));
            if k.is_multiple_of(2) { Point::new(along, 0.0, z) } else { Point::new(0.0, along, z) }
        };
        let visible = (0..visible).map(|k| wall(k, rng)).collect();
        let mut points: Vec<Point> = Vec::new();
        while points.len() < hidden {
            let [x, y, z] = [(0.8, 2.0), (0.8, 1.8), (-0.4, 0.4)].map(|(low, high)| rng.random_range(low..high));
            let point = Point::new(x, y, z);
            if points.iter().all(|other| (other - point).norm() > 0.15) {
                points.push(point);
            }
        }
        Self { visible, hidden: points }
    }

    /// Paths, hidden patches by their positions and visible ones as stations. Paths back to the lit patch and their
    /// reverse are one.
    fn paths(&self, fourth: Fourth) -> Vec<Vec<Node>> {
        let (visible, hidden) = (self.visible.len(), self.hidden.len());
        let ends = (0..visible).flat_map(|a| (0..visible).map(move |b| (a, b)));
        let of_profile = |(a, b): (usize, usize)| {
            let third = (0..hidden).map(|q| vec![Node::Patch(q)]);
            let between = (0..hidden).flat_map(|q| (0..hidden).map(move |r| vec![Node::Patch(q), Node::Patch(r)]));
            let between = between.filter(|inner| inner[0] != inner[1]);
            let mixed = (0..hidden).flat_map(|q| {
                (0..visible).flat_map(move |v| {
                    let (hidden, visible) = (Node::Patch(q), Node::Station(v));
                    [(v != b).then(|| vec![hidden, visible]), (v != a).then(|| vec![visible, hidden])]
                })
            });
            let mixed = mixed.flatten().filter(|_| fourth == Fourth::All);
            let whole = third
                .chain(between)
                .chain(mixed)
                .map(|inner| [&[Node::Station(a)], &inner[..], &[Node::Station(b)]].concat());
            let all: Vec<Vec<Node>> = whole.collect();
            let turned = |path: &[Node]| path.iter().rev().copied().collect::<Vec<Node>>();
            let is_first = |n: usize| a != b || !all[..n].contains(&turned(&all[n]));
            (0..all.len()).filter(|n| is_first(*n)).map(|n| all[n].clone()).collect::<Vec<_>>()
        };
        ends.flat_map(of_profile).collect()
    }

    fn at(&self, node: Node) -> Point {
        match node {
            Node::Station(visible) => self.visible[visible],
            Node::Patch(hidden) => self.hidden[hidden],
        }
    }

    /// Lengths with noise; fourth bounces are `weaker` times fainter than third ones.
    fn measured(&self, fourth: Fourth, weaker: f64, rng: &mut ChaCha8Rng) -> Vec<Observation> {
        let is_there = |path: &Vec<Node>| path.len() == 3 || SNR / weaker >= SEEN;
        let observation = |nodes: Vec<Node>| {
            let sd_m = path_m(NOISE_PS, 1.0) * if nodes.len() == 3 { 1.0 } else { weaker };
            let length_m: f64 = nodes.windows(2).map(|leg| (self.at(leg[0]) - self.at(leg[1])).norm()).sum();
            let noise: f64 = StandardNormal.sample(rng);
            Observation::new(nodes, length_m + sd_m * noise, sd_m)
        };
        self.paths(fourth).into_iter().filter(is_there).map(observation).collect()
    }

    /// Sum of the variances of all hidden patches that no estimator goes below.
    fn bound_m2(&self, observations: &[Observation]) -> f64 {
        let size = 3 * self.hidden.len();
        let mut fisher: Matrix = Matrix::zeros(size, size);
        for Observation { nodes, sd_m, .. } in observations {
            let mut slope: BTreeMap<usize, f64> = BTreeMap::new();
            for leg in nodes.windows(2) {
                let along = (self.at(leg[1]) - self.at(leg[0])).normalize();
                for (node, sign) in [(leg[0], -1.0), (leg[1], 1.0)] {
                    if let Node::Patch(hidden) = node {
                        (0..3).for_each(|k| *slope.entry(3 * hidden + k).or_default() += sign * along[k]);
                    }
                }
            }
            for (i, u) in &slope {
                slope.iter().for_each(|(k, v)| fisher[(*i, *k)] += u * v / (sd_m * sd_m));
            }
        }
        dense::symmetric_eigen(&fisher).0.iter().map(|value| 1.0 / value).sum()
    }

    /// Squared error of all hidden patches, fitted to lengths whose paths are known.
    fn error_m2(&self, observations: Vec<Observation>) -> f64 {
        let problem =
            Problem { loss: Loss::Squared, ..Problem::new(self.hidden.clone(), 3, &self.visible, observations) };
        let solution = maximum_likelihood::solve(&problem).expect("visible patches on two walls place the hidden ones");
        solution.points.iter().zip(&self.hidden).map(|(point, hidden)| (point - hidden).norm_squared()).sum()
    }
}

/// Rms and bound of hidden patches from third bounces over those with fourth ones too.
fn gain(scenes: u64) {
    println!(
        "\n| visible, hidden | fourth bounces | weaker by | scenes | bound, thirds alone (mm) | gain of the bound | rms / bound | gain of the rms |\n|---|---|---|---|---|---|---|---|"
    );
    for (visible, hidden) in [(6, 2), (8, 4), (8, 8)] {
        for (name, fourth) in [("between hidden ones", Fourth::BetweenHidden), ("all", Fourth::All)] {
            for weaker in [1.0, 10.0, 30.0, 100.0] {
                let (mut thirds, mut with, mut bounds) = (Vec::new(), Vec::new(), [0.0; 2]);
                for seed in 0..scenes {
                    let mut rng = ChaCha8Rng::seed_from_u64(seed);
                    let scene = Scene::draw(visible, hidden, &mut rng);
                    let all = scene.measured(fourth, weaker, &mut rng);
                    let alone: Vec<Observation> = all.iter().filter(|path| path.nodes.len() == 3).cloned().collect();
                    let of = [scene.bound_m2(&alone), scene.bound_m2(&all)];
                    (0..2).for_each(|k| bounds[k] += of[k]);
                    thirds.push(scene.error_m2(alone) / of[0]);
                    with.push(scene.error_m2(all) / of[1]);
                }
                let (alone, all) = (Estimate::rms(&thirds), Estimate::rms(&with));
                let of_bound = (bounds[0] / bounds[1]).sqrt();
                let share = (alone.half / alone.value).hypot(all.half / all.value);
                let of_rms = Estimate {
                    value: of_bound * alone.value / all.value,
                    half: of_bound * alone.value / all.value * share,
                };
                let bound_mm = 1e3 * (bounds[0] / (scenes as f64 * hidden as f64)).sqrt();
                println!(
                    "| {visible}, {hidden} | {name} | {weaker} | {scenes} | {bound_mm:.3} | {of_bound:.2} | {all} | {of_rms} |"
                );
            }
        }
    }
}

/// Patches that only hidden ones show, two in each scene.
fn second_layer(scenes: u64) {
    println!(
        "\n| first layer | noise (ps) | fifth bounces seen | scenes | found [95 %] | extra | bound (mm) | rms / bound |\n|---|---|---|---|---|---|---|---|"
    );
    for first in [4, 6, 8] {
        for (noise_ps, seen) in [(5.0, 0.6), (5.0, 0.3), (25.0, 0.6)] {
            let setting =
                layers::Setting { visible: 6, first, second: 2, sd_m: path_m(noise_ps, 1.0), seen, spurious: 10 };
            let (mut missed, mut extra, mut sums_m2) = (0, 0, [0.0; 2]);
            for seed in 0..scenes {
                let drawn = layers::draw(&setting, seed);
                let places = find_by_minimal_sets(&drawn.profiles, &drawn.room).patches;
                let points: Vec<Point> = places.iter().map(|hidden| hidden.point).collect();
                let (of_missed, of_extra, squares_m2) = layers::score(&drawn, &points);
                missed += of_missed;
                extra += of_extra;
                squares_m2.iter().for_each(|(error, bound)| {
                    sums_m2[0] += error;
                    sums_m2[1] += bound;
                });
            }
            let of = 2 * scenes as usize;
            let rate = Rate { hits: of - missed, of };
            let bound_mm = 1e3 * (sums_m2[1] / rate.hits.max(1) as f64).sqrt();
            let ratio = (sums_m2[0] / sums_m2[1]).sqrt();
            println!("| {first} | {noise_ps} | {seen} | {scenes} | {rate} | {extra} | {bound_mm:.2} | {ratio:.2} |");
        }
    }
}
