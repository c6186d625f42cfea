//! Rooms of few patches with pairs missing and spurious onsets: whether a patch that is wrong says so. A patch with few
//! pairs has two places; third bounces decide, and where they do not, both have to stand in the result.
//! `benches/accuracy.rs` runs it over many rooms.

use std::collections::BTreeSet;

use nalgebra::{Matrix3, Vector3};
use periscope::pipeline::run::Settings;
use periscope::tables::{Ambiguity, Onset, Patch, PatchCovariance};
use periscope::units::time_ps;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::lab::{Lab, one_look, point_onset, write_table};
use crate::missed;

const SCENE: &str = include_str!("../../pipelines/scene.toml");
/// Group index of the campaign: that of air.
const INDEX: f64 = 1.000_277;
/// Pulses nearer than this are one onset, that of the stronger.
const RESOLVED_PS: f64 = 20.0;
/// Chance that a third bounce is strong enough for an onset.
const THIRD: f64 = 0.3;
/// A patch is wrong if it is off by more than this many of its standard deviations, and by more than `WRONG_M`.
const WRONG: f64 = 5.0;
const WRONG_M: f64 = 1e-3;

/// What rooms of one kind share.
#[derive(Clone, Copy, Debug, Default)]
pub struct Kind {
    /// Share of pairs that were not captured.
    pub missing: f64,
    /// Share of profiles with a spurious onset.
    pub spurious: f64,
}

/// A random room: 5 to 12 patches, and the standard deviation of its onsets.
struct Room {
    points: Vec<Vector3<f64>>,
    sd_ps: f64,
}

/// Light that reaches the sensor, or what looks like it.
#[derive(Clone, Copy)]
struct Pulse {
    time_ps: f64,
    snr: f64,
}

impl Room {
    fn new(rng: &mut ChaCha8Rng) -> Self {
        let (count, sd_ps) = (rng.random_range(5..=12), rng.random_range(1.0..5.0));
        let mut points: Vec<Vector3<f64>> = Vec::new();
        while points.len() < count {
            let mut coordinate = |half: f64| rng.random_range(-half..half);
            let point = Vector3::new(coordinate(1.5), 2.0 + coordinate(1.0), coordinate(1.0));
            if points.iter().all(|other| (other - point).norm() > 0.3) {
                points.push(point);
            }
        }
        Self { points, sd_ps }
    }

    fn time_ps(&self, path: &[usize]) -> f64 {
        let ends_m = self.points[path[0]].norm() + self.points[path[path.len() - 1]].norm();
        let legs_m: f64 = path.windows(2).map(|leg| (self.points[leg[0]] - self.points[leg[1]]).norm()).sum();
        time_ps(ends_m + legs_m, INDEX)
    }

    /// Pulses of one profile in order of time.
    fn pulses(&self, lit: usize, seen: usize, spurious: f64, rng: &mut ChaCha8Rng) -> Vec<Pulse> {
        let first = if lit == seen { (vec![lit], 300.0) } else { (vec![lit, seen], 60.0) };
        let between = (0..self.points.len()).filter(|&over| over != lit && over != seen);
        let mut paths = vec![first];
        paths.extend(between.filter(|_| rng.random_bool(THIRD)).map(|over| (vec![lit, over, seen], 15.0)));
        let mut pulses: Vec<Pulse> = Vec::new();
        for (path, snr) in paths {
            let noise: f64 = StandardNormal.sample(rng);
            pulses.push(Pulse { time_ps: self.time_ps(&path) + self.sd_ps * noise, snr });
        }
        if rng.random_bool(spurious) {
            pulses.push(Pulse { time_ps: rng.random_range(5_000.0..30_000.0), snr: 8.0 });
        }
        // The strongest first: it hides what comes with it.
        pulses.sort_by(|a, b| b.snr.total_cmp(&a.snr));
        let mut kept: Vec<Pulse> = Vec::new();
        for pulse in pulses {
            if kept.iter().all(|other| (other.time_ps - pulse.time_ps).abs() > RESOLVED_PS) {
                kept.push(pulse);
            }
        }
        kept.sort_by(|a, b| a.time_ps.total_cmp(&b.time_ps));
        kept
    }

    /// Onsets of all pairs that were captured, patches numbered from 1.
    fn onsets(&self, kind: Kind, rng: &mut ChaCha8Rng) -> Vec<Onset> {
        let count = self.points.len();
        let mut is_captured = vec![vec![true; count]; count];
        for a in 0..count {
            for b in 0..a {
                let is_missing = rng.random_bool(kind.missing);
                (is_captured[a][b], is_captured[b][a]) = (!is_missing, !is_missing);
            }
        }
        let mut onsets = Vec::new();
        let pairs = (0..count).flat_map(|lit| (0..count).map(move |seen| (lit, seen)));
        for (lit, seen) in pairs.filter(|&(lit, seen)| is_captured[lit][seen]) {
            let pulses = self.pulses(lit, seen, kind.spurious, rng);
            let onset = |(rank, pulse): (i32, Pulse)| onset(lit as i32 + 1, seen as i32 + 1, rank, pulse, self.sd_ps);
            onsets.extend((1..).zip(pulses).map(onset));
        }
        onsets
    }

    /// Patches as a solution that nothing missed would have them.
    fn truth(&self, patch: &Patch) -> Patch {
        let point = self.points[patch.patch as usize - 1];
        Patch { x_m: point.x, y_m: point.y, z_m: point.z, ..patch.clone() }
    }
}

fn onset(lit: i32, seen: i32, rank: i32, pulse: Pulse, sd_ps: f64) -> Onset {
    Onset { amplitude: pulse.snr, snr: pulse.snr, ..point_onset("bulk", [lit, seen], rank, [pulse.time_ps, sd_ps]) }
}

/// What the pipeline made of one room.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// Patches of the room.
    pub patches: usize,
    /// Why there is no solution.
    pub refused: Option<String>,
    /// Patches that are wrong and not part of any alternative or ambiguity.
    pub confidently_wrong: Vec<i32>,
    /// Patches that are wrong, and named as ambiguous.
    pub wrong: Vec<i32>,
    /// Patches that are right, and named as doubtful all the same.
    pub doubted: usize,
    /// Visible patches without a covariance.
    pub open: usize,
    /// Hidden patches; the rooms have none.
    pub phantoms: usize,
    /// Chi-square of the solution's residuals, over its degrees of freedom.
    pub chi2_dof: Option<f64>,
    /// Chance of a squared error this large, where no patch is wrong and none open.
    pub p_value: Option<f64>,
}

/// The default pipeline from its first labels on.
fn pipeline(onsets: &std::path::Path) -> String {
    let from_labels = &SCENE[SCENE.find("[anchors]").expect("the pipeline takes anchors")..];
    format!(
        "[onsets]\nstage = 'import'\nparams = {{ table = 'onsets', path = '{}' }}\n{}",
        onsets.display(),
        one_look(from_labels).replace(", calibration = \"scene_calibration\"", "")
    )
}

/// Solves one room.
pub fn solve(kind: Kind, seed: u64) -> Outcome {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let room = Room::new(&mut rng);
    let lab = Lab::bulk(0);
    write_table(&lab.path("onsets.parquet"), &room.onsets(kind, &mut rng));
    if let Err(error) = lab.run("out", &pipeline(&lab.path("onsets.parquet")), &Settings::default()) {
        return refused(&room, crate::lab::chain(error));
    }
    let rows: Vec<Patch> = lab.rows("out", "patches");
    if rows.is_empty() {
        return refused(&room, "no patches".to_owned());
    }
    let ambiguities: Vec<Ambiguity> = lab.rows("out", "patches.ambiguities");
    score(&room, &rows, &ambiguities, &lab.rows("out", "patches.patch_covariances"))
}

/// Solves several rooms side by side, one thread a core. (Not on the threads of `rayon`, which stages wait for.)
pub fn solve_all(kind: Kind, seeds: std::ops::Range<u64>) -> Vec<Outcome> {
    let next = std::sync::atomic::AtomicU64::new(seeds.start);
    let solve_some = || {
        let mut rooms = Vec::new();
        loop {
            let seed = next.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            if seed >= seeds.end {
                return rooms;
            }
            rooms.push((seed, solve(kind, seed)));
        }
    };
    let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let mut rooms: Vec<(u64, Outcome)> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(solve_some)).collect();
        workers.into_iter().flat_map(|worker| worker.join().expect("no room panics")).collect()
    });
    rooms.sort_by_key(|(seed, _)| *seed);
    rooms.into_iter().map(|(_, room)| room).collect()
}

/// A room of which no patch is placed.
fn refused(room: &Room, why: String) -> Outcome {
    let patches = room.points.len();
    Outcome { patches, open: patches, refused: Some(why), ..Outcome::default() }
}

fn score(room: &Room, rows: &[Patch], ambiguities: &[Ambiguity], covariances: &[PatchCovariance]) -> Outcome {
    let best = || rows.iter().filter(|row| row.alternative == 0);
    let is_visible = |row: &&Patch| row.patch as usize <= room.points.len();
    let placed: Vec<Patch> = best().filter(is_visible).filter(|row| row.sd_m.is_some()).cloned().collect();
    let truth: Vec<Patch> = placed.iter().map(|row| room.truth(row)).collect();
    let is_named = |patch: &i32| {
        let in_alternative = rows.iter().any(|row| row.patch == *patch && row.alternative > 0);
        in_alternative || ambiguities.iter().any(|one| one.patches.contains(patch))
    };
    let off = wrong(&placed, &truth, |patch| !is_named(&patch));
    let (wrong, confidently_wrong): (Vec<i32>, Vec<i32>) = off.into_iter().partition(is_named);
    let doubtful = ambiguities.iter().filter(|one| &*one.kind == "doubtful");
    let doubtful: BTreeSet<i32> = doubtful.flat_map(|one| one.patches.iter().copied()).collect();
    let is_doubted = |row: &&Patch| doubtful.contains(&row.patch) && !wrong.contains(&row.patch);
    let doubted = placed.iter().filter(is_doubted).count();
    let open = room.points.len() - placed.len();
    let is_right = wrong.is_empty() && confidently_wrong.is_empty() && open == 0;
    let has = |patch: i32| patch as usize <= room.points.len();
    let among: Vec<PatchCovariance> =
        covariances.iter().filter(|row| row.alternative == 0 && has(row.a) && has(row.b)).cloned().collect();
    let p_value = || {
        let squared = missed::missed(&placed, &among, &truth).normalised;
        chi_square_beyond(squared, missed::degrees_of_freedom(&truth) as f64)
    };
    Outcome {
        patches: room.points.len(),
        refused: None,
        confidently_wrong,
        wrong,
        doubted,
        open,
        phantoms: best().filter(|row| !is_visible(row)).count(),
        chi2_dof: best().next().and_then(|row| row.chi2_dof),
        p_value: is_right.then(p_value),
    }
}

/// Patches that are off, after a turn or reflection that most of those agree on that are certain. (A group that folds
/// over may be the larger part.) The frame is a convention: where fewer than three are certain, those that most of all
/// agree on are none of them off either.
fn wrong(placed: &[Patch], truth: &[Patch], is_certain: impl Fn(i32) -> bool) -> Vec<i32> {
    let certain = placed.iter().filter(|row| is_certain(row.patch)).count();
    let of_certain = off(placed, truth, &is_certain);
    let of_all = off(placed, truth, |_| true);
    match certain {
        0 => of_all,
        1 | 2 => of_certain.into_iter().filter(|patch| of_all.contains(patch)).collect(),
        _ => of_certain,
    }
}

/// Patches that are off, after the turn that most of those that count agree on.
fn off(placed: &[Patch], truth: &[Patch], counts: impl Fn(i32) -> bool) -> Vec<i32> {
    let sds_m: Vec<f64> = placed.iter().map(|row| row.sd_m.expect("placed patches have one")).collect();
    let (points, targets): (Vec<_>, Vec<_>) =
        (placed.iter().map(missed::position).collect(), truth.iter().map(missed::position).collect());
    let mut errors_m = vec![0.0; placed.len()];
    // Patches that are far off weigh little, so that they do not turn the others.
    for _ in 0..30 {
        let weight = |(row, (sd_m, error_m)): (&Patch, (&f64, &f64))| {
            if counts(row.patch) { 1.0 / sd_m.hypot(*error_m) } else { 0.0 }
        };
        let weights: Vec<f64> = placed.iter().zip(sds_m.iter().zip(&errors_m)).map(weight).collect();
        let weighted = |all: &[Vector3<f64>]| -> Vec<Vector3<f64>> {
            all.iter().zip(&weights).map(|(point, weight)| point * *weight).collect()
        };
        let turn: Matrix3<f64> = missed::aligning(&weighted(&points), &weighted(&targets));
        errors_m = points.iter().zip(&targets).map(|(point, target)| (turn * point - target).norm()).collect();
    }
    let of_patch = placed.iter().zip(errors_m.iter().zip(&sds_m));
    let is_off = |(error_m, sd_m): (&f64, &f64)| *error_m > WRONG_M && *error_m > WRONG * sd_m;
    of_patch.filter(|(_, of_patch)| is_off(*of_patch)).map(|(row, _)| row.patch).collect()
}

/// Chance that chi-square of an odd or even number of degrees of freedom exceeds a value.
fn chi_square_beyond(value: f64, freedom: f64) -> f64 {
    let (shape, x) = (0.5 * freedom, 0.5 * value);
    // The series of the lower incomplete gamma function: x^a e^-x / Gamma(a + 1) (1 + x / (a + 1) + ...).
    let log_first = shape * x.ln() - x - log_gamma(shape + 1.0);
    let (mut term, mut sum, mut n) = (1.0, 1.0, shape);
    while term > 1e-15 * sum {
        n += 1.0;
        term *= x / n;
        sum += term;
    }
    (1.0 - (log_first + f64::ln(sum)).exp()).clamp(0.0, 1.0)
}

/// Natural logarithm of the gamma function of a positive multiple of one half.
fn log_gamma(value: f64) -> f64 {
    let (mut at, mut log) = if value.fract() == 0.0 { (1.0, 0.0) } else { (0.5, 0.5 * std::f64::consts::PI.ln()) };
    while at < value {
        log += f64::ln(at);
        at += 1.0;
    }
    log
}

/// Chance that values from 0 to 1 that are all alike lie as unevenly as these (Kolmogorov); `None` without values.
pub fn kolmogorov(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let count = values.len() as f64;
    let apart =
        |(n, value): (usize, &f64)| (value - n as f64 / count).abs().max((value - (n as f64 + 1.0) / count).abs());
    let most = values.iter().enumerate().map(apart).fold(0.0, f64::max);
    // Stephens' correction for few values.
    let scaled = most * (count.sqrt() + 0.12 + 0.11 / count.sqrt());
    let term = |k: i32| (if k % 2 == 0 { -2.0 } else { 2.0 }) * (-2.0 * f64::from(k * k) * scaled * scaled).exp();
    let chance: f64 = (1..=100).map(term).sum();
    (!values.is_empty()).then(|| if scaled < 0.2 { 1.0 } else { chance.clamp(0.0, 1.0) })
}

#[test]
fn chances_are_those_of_tables() {
    assert!((chi_square_beyond(18.307, 10.0) - 0.05).abs() < 1e-4);
    assert!((chi_square_beyond(19.675, 11.0) - 0.05).abs() < 1e-4);
    assert!(kolmogorov((0..100).map(|n| (f64::from(n) + 0.5) / 100.0).collect()).is_some_and(|chance| chance > 0.99));
    assert!(kolmogorov((0..100).map(|n| f64::from(n) / 200.0).collect()).is_some_and(|chance| chance < 1e-6));
}

/// A few rooms of the study: none is wrong without saying so. Some have too few pairs for a solution, or for all of it.
#[test]
fn a_patch_that_is_wrong_is_said_to_be_ambiguous() {
    let kind = Kind { missing: 0.3, spurious: 0.2 };
    let rooms: Vec<Outcome> = (1000..1008).map(|seed| solve(kind, seed)).collect();
    assert!(rooms.iter().all(|room| room.confidently_wrong.is_empty()), "{rooms:?}");
    let is_right = |room: &&Outcome| {
        let is_whole = room.refused.is_none() && room.open == 0 && room.phantoms == 0;
        is_whole && room.wrong.is_empty()
    };
    let right: Vec<&Outcome> = rooms.iter().filter(is_right).collect();
    assert!(right.len() >= 5, "{rooms:?}");
    let (doubted, placed) =
        (rooms.iter().map(|room| room.doubted).sum::<usize>(), rooms.iter().map(|room| room.patches - room.open));
    assert!(10 * doubted <= placed.sum::<usize>(), "{rooms:?}");
    assert!(right.iter().all(|room| room.chi2_dof.is_some_and(|ratio| ratio < 2.0)), "{right:?}");
    let chance = kolmogorov(right.iter().filter_map(|room| room.p_value).collect());
    assert!(chance.is_some_and(|chance| chance > 1e-3), "{right:?}");
}

/// With most pairs missing, few rooms are determined as a whole. What is, is placed, the rest is open, and none fails.
#[test]
fn rooms_that_pairs_do_not_determine_are_placed_in_part() {
    let kind = Kind { missing: 0.6, spurious: 0.2 };
    let rooms = solve_all(kind, 1000..1010);
    assert!(rooms.iter().all(|room| room.refused.is_none()), "{rooms:?}");
    assert!(rooms.iter().all(|room| room.confidently_wrong.is_empty()), "{rooms:?}");
    let (patches, open): (usize, usize) =
        rooms.iter().fold((0, 0), |(patches, open), room| (patches + room.patches, open + room.open));
    assert!(2 * open < patches, "{open} of {patches} are open: {rooms:?}");
}
