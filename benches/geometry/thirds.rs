//! Third bounces in addition to first and second ones, source and sensor in one point, the delay free.

use periscope::geometry::{Point, procrustes};
use periscope::units::{path_m, time_ps};
use rand::SeedableRng;
use rand::seq::index;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::estimate::{measured, refined};
use super::room::{self, Information, Way};
use super::score::{Estimate, heading, row};

const NOISE_PS: f64 = 25.0;
const DELAY_SD_PS: f64 = 1000.0;
/// Third bounces that are measured in a scene.
const THIRDS: usize = 2000;
/// Rotations that no length depends on.
const FREE: usize = 3;

/// Paths over patches in every order in which light can meet them.
fn over(patches: usize, bounces: usize) -> Vec<Way> {
    let mut orders: Vec<Vec<usize>> = (0..patches).map(|patch| vec![patch]).collect();
    for _ in 1..bounces {
        let longer = |order: &Vec<usize>| {
            let next = (0..patches).filter(|patch| order.last() != Some(patch));
            next.map(|patch| [order.as_slice(), &[patch]].concat()).collect::<Vec<_>>()
        };
        orders = orders.iter().flat_map(longer).collect();
    }
    orders.into_iter().map(|patches| Way { source: 0, patches, sensor: 0 }).collect()
}

/// What is measured: first and second bounces, then third ones.
struct Bounces<'a> {
    truth: &'a [Point],
    ways: Vec<Way>,
    sds_m: Vec<f64>,
}

impl<'a> Bounces<'a> {
    /// With third bounces that are `weaker` times less certain.
    fn new(truth: &'a [Point], thirds: Vec<Way>, weaker: f64) -> Self {
        let mut ways = over(truth.len(), 1);
        ways.extend(over(truth.len(), 2));
        let mut sds_m = vec![path_m(NOISE_PS, 1.0); ways.len()];
        sds_m.extend(vec![path_m(weaker * NOISE_PS, 1.0); thirds.len()]);
        ways.extend(thirds);
        Self { truth, ways, sds_m }
    }

    fn information(&self, delay_sd_ps: f64) -> Information {
        Information::of_ways(self.truth, &[Point::origin()], &self.ways, &self.sds_m, path_m(delay_sd_ps, 1.0))
    }

    fn bound_m(&self, delay_sd_ps: f64) -> f64 {
        room::bound_of_m(&self.information(delay_sd_ps).of_positions(), FREE)
    }
}

/// Gain of the bound if a length gave the same information for any number of bounces, and only its sd mattered.
fn counted(patches: usize, thirds: usize, weaker: f64) -> f64 {
    (1.0 + thirds as f64 / ((patches * patches) as f64 * weaker * weaker)).sqrt()
}

/// One scene.
struct Draw {
    bound_m: f64,
    exact_delay_bound_m: f64,
    delay_bound_ps: f64,
    /// Errors over these bounds.
    error: f64,
    delay_error: f64,
}

impl Draw {
    fn new(bounces: &Bounces, rng: &mut ChaCha8Rng) -> Self {
        let Bounces { truth, ways, sds_m } = bounces;
        let (problem, delay_m) = measured(truth, &[Point::origin()], ways, sds_m, path_m(DELAY_SD_PS, 1.0), rng);
        let solution = refined(&problem).expect("a scene in which all paths are measured has a solution");
        let information = bounces.information(DELAY_SD_PS);
        let (bound_m, delay_bound_m) =
            (room::bound_of_m(&information.of_positions(), FREE), information.delay_sd_m(FREE));
        Self {
            bound_m,
            exact_delay_bound_m: bounces.bound_m(0.0),
            delay_bound_ps: time_ps(delay_bound_m, 1.0),
            error: procrustes::rotation(&solution.points, truth, Point::origin(), true).rms_m / bound_m,
            delay_error: (solution.delays_m[0] - delay_m) / delay_bound_m,
        }
    }
}

/// Prints the table.
pub fn print(scenes: u64) {
    let truth = room::rectangles();
    let thirds = over(truth.len(), 3);
    let columns = [
        "R",
        "bound (mm)",
        "rms / bound",
        "bound of the delay's sd (ps)",
        "rms / bound of the delay",
        &format!("{THIRDS}: gain"),
        "delay known",
        "counted",
        &format!("all {}: gain", thirds.len()),
        "delay known",
        "counted",
    ];
    heading("## Third bounces", &columns);
    let none = Bounces::new(&truth, Vec::new(), 1.0);
    let without_m = [none.bound_m(DELAY_SD_PS), none.bound_m(0.0)];
    for (name, weaker, some, all) in [
        ("none", 1.0, 0, 0),
        ("100", 100.0, THIRDS, thirds.len()),
        ("30", 30.0, THIRDS, thirds.len()),
        ("10", 10.0, THIRDS, thirds.len()),
        ("1", 1.0, THIRDS, thirds.len()),
    ] {
        let one = |seed: u64| {
            // Random numbers of their own, so that delay and noise of the other bounces are the same in all rows.
            let mut rng = ChaCha8Rng::seed_from_u64(scenes + seed);
            let drawn = index::sample(&mut rng, thirds.len(), some).iter().map(|n| thirds[n].clone()).collect();
            Draw::new(&Bounces::new(&truth, drawn, weaker), &mut ChaCha8Rng::seed_from_u64(seed))
        };
        let drawn: Vec<Draw> = (0..scenes).into_par_iter().map(one).collect();
        let mean = |value: fn(&Draw) -> f64| drawn.iter().map(value).sum::<f64>() / drawn.len() as f64;
        let rms = |error: fn(&Draw) -> f64| {
            Estimate::rms(&drawn.iter().map(|draw| error(draw).powi(2)).collect::<Vec<_>>()).to_string()
        };
        let some_m = [mean(|draw| draw.bound_m), mean(|draw| draw.exact_delay_bound_m)];
        let every = Bounces::new(&truth, thirds[..all].to_vec(), weaker);
        let every_m = [every.bound_m(DELAY_SD_PS), every.bound_m(0.0)];
        let mut cells = vec![
            name.to_owned(),
            format!("{:.2}", 1e3 * some_m[0]),
            rms(|draw| draw.error),
            format!("{:.1}", mean(|draw| draw.delay_bound_ps)),
            rms(|draw| draw.delay_error),
        ];
        for (with_m, count) in [(some_m, some), (every_m, all)] {
            let gains = [without_m[0] / with_m[0], without_m[1] / with_m[1], counted(truth.len(), count, weaker)];
            cells.extend(gains.map(|gain| format!("{gain:.3}")));
        }
        row(&cells);
    }
}
