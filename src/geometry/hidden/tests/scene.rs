//! Scenes with hidden patches, for tests and studies: lengths over them with noise, missing and false ones. Shares no
//! code with the search.

use nalgebra::{Matrix3, Vector3};
use periscope_cancel::Cancel;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::{Arrival, Focus, Point, Profile, Room};

/// Least range of lengths that a record holds: 8 ns. It holds all hidden patches, and this much before and after.
const WINDOW_M: f64 = 2.4;
const MARGIN_M: f64 = 0.1;
/// The search assumes that pulses blend up to this many times the distance where they do.
const REACH: f64 = 1.35;
/// Delay of a cable's echo, as a length.
const ECHO_M: f64 = 1.9;

/// Where visible patches are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Walls {
    /// On two walls at right angles.
    Two,
    /// On one wall: the search knows its front only.
    One,
    /// On one wall with so much relief to either side; the search does not know which way it faces.
    Rough(f64),
    /// On two walls of flatland.
    Flatland,
}

/// Which profiles are there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pattern {
    /// All.
    All,
    /// None with one patch lit and seen.
    NoneOwn,
    /// The first patches are lit, the others seen.
    Disjoint(usize),
}

/// False arrivals that are not random.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Clutter {
    /// None.
    None,
    /// Six more patches, undeclared, each seen in a third of the profiles.
    Furniture,
    /// The light that comes straight from one visible patch to the other, again after a cable's length.
    Echo,
    /// A continuous floor: the shortest way over it.
    Floor,
}

/// What a scene is drawn from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setting {
    /// Visible patches.
    pub visible: usize,
    /// Hidden patches.
    pub hidden: usize,
    /// Standard deviation of every onset, as a length.
    pub onset_sd_m: f64,
    /// Share of arrivals that are missing.
    pub missing: f64,
    /// False arrivals of a profile.
    pub spurious: usize,
    /// Where visible patches are.
    pub walls: Walls,
    /// Which profiles are there.
    pub pattern: Pattern,
    /// False arrivals that are not random.
    pub clutter: Clutter,
    /// Least distance of two hidden patches.
    pub apart_m: f64,
    /// Arrivals nearer than this are one, at their mean.
    pub merged_m: f64,
    /// So many of the first patches throw too little light to the sensor: where they are seen, no hidden patch shows.
    pub dark: usize,
}

impl Setting {
    /// Two walls, all profiles, hidden patches 15 cm apart.
    #[must_use]
    pub const fn new(visible: usize, hidden: usize, onset_sd_m: f64, missing: f64, spurious: usize) -> Self {
        let (walls, pattern, clutter) = (Walls::Two, Pattern::All, Clutter::None);
        Self {
            visible,
            hidden,
            onset_sd_m,
            missing,
            spurious,
            walls,
            pattern,
            clutter,
            apart_m: 0.15,
            merged_m: 0.0,
            dark: 0,
        }
    }
}

/// A scene and its profiles.
pub struct Drawn {
    /// What the search is given.
    pub room: Room,
    /// What the search is given.
    pub profiles: Vec<Profile>,
    /// Hidden patches.
    pub hidden: Vec<Point>,
    /// Undeclared patches.
    pub furniture: Vec<Point>,
    /// Bound of each hidden patch from the arrivals that are there, their paths known: root of the sum of variances.
    pub bounds_m: Vec<f64>,
    /// For each profile the hidden patch of each arrival in order of length; `None`: false.
    pub sources: Vec<Vec<Option<usize>>>,
}

/// Draws a scene. A sum over a hidden patch has the error of a third onset and of half the sum of two first ones.
#[must_use]
pub fn draw(setting: &Setting, seed: u64) -> Drawn {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let sd_m = setting.onset_sd_m * 1.5_f64.sqrt();
    let flat = setting.walls == Walls::Flatland;
    let is_on_first = |k: usize| k.is_multiple_of(2) || matches!(setting.walls, Walls::One | Walls::Rough(_));
    let foci: Vec<Point> = (0..setting.visible)
        .map(|k| {
            let (along, z) = (rng.random_range(0.0..1.6), if flat { 0.0 } else { rng.random_range(-0.8..0.8) });
            let off_m =
                if let Walls::Rough(relief_m) = setting.walls { rng.random_range(-1.0..1.0) * relief_m } else { 0.0 };
            if is_on_first(k) { Point::new(along, off_m, z) } else { Point::new(0.0, along, z) }
        })
        .collect();
    let mut place = || {
        let z = if flat { 0.0 } else { rng.random_range(-0.4..0.4) };
        Point::new(rng.random_range(0.8..2.0), rng.random_range(0.8..1.8), z)
    };
    let mut hidden: Vec<Point> = Vec::new();
    while hidden.len() < setting.hidden {
        let point = place();
        if hidden.iter().all(|other| (other - point).norm() > setting.apart_m) {
            hidden.push(point);
        }
    }
    let furniture: Vec<Point> =
        if setting.clutter == Clutter::Furniture { (0..6).map(|_| place()).collect() } else { Vec::new() };
    let (lit, seen) = match setting.pattern {
        Pattern::Disjoint(lit) => (0..lit, lit..setting.visible),
        Pattern::All | Pattern::NoneOwn => (0..setting.visible, 0..setting.visible),
    };
    let pairs = lit.flat_map(|a| seen.clone().map(move |b| (a, b)));
    let pairs: Vec<(usize, usize)> = pairs.filter(|(a, b)| a != b || setting.pattern == Pattern::All).collect();
    let mut information = vec![Matrix3::zeros(); hidden.len()];
    let (mut profiles, mut sources) = (Vec::new(), Vec::new());
    for (a, b) in pairs {
        let length_m = |q: &Point| (q - foci[a]).norm() + (q - foci[b]).norm();
        let ends = hidden.iter().map(length_m).fold((f64::INFINITY, 0.0_f64), |ends, s| (ends.0.min(s), ends.1.max(s)));
        let middle_m = if hidden.is_empty() { 2.8 } else { 0.5 * (ends.0 + ends.1) };
        let half_m = (0.5 * (ends.1 - ends.0) + MARGIN_M).max(0.5 * WINDOW_M);
        let low_m = (middle_m - half_m).max((foci[a] - foci[b]).norm());
        let high_m = middle_m + half_m;
        let mut lengths_m: Vec<(f64, Option<usize>)> = Vec::new();
        let mut add = |length_m: f64, source: Option<usize>, rng: &mut ChaCha8Rng| {
            let error: f64 = StandardNormal.sample(rng);
            lengths_m.push((length_m + sd_m * error, source));
        };
        for (n, q) in hidden.iter().enumerate() {
            if b >= setting.dark && !rng.random_bool(setting.missing) {
                add(length_m(q), Some(n), &mut rng);
                let slope = (q - foci[a]).normalize() + (q - foci[b]).normalize();
                information[n] += slope * slope.transpose() / (sd_m * sd_m);
            }
        }
        for q in &furniture {
            if rng.random_bool(1.0 / 3.0) {
                add(length_m(q), None, &mut rng);
            }
        }
        if setting.clutter == Clutter::Echo {
            add((foci[a] - foci[b]).norm() + ECHO_M, None, &mut rng);
        }
        if setting.clutter == Clutter::Floor {
            let mirrored = Point::new(foci[a].x, foci[a].y, -2.4 - foci[a].z);
            add((mirrored - foci[b]).norm(), None, &mut rng);
        }
        for _ in 0..setting.spurious {
            lengths_m.push((rng.random_range(low_m..high_m), None));
        }
        lengths_m.retain(|(length_m, _)| (low_m..=high_m).contains(length_m));
        lengths_m.sort_by(|a, b| a.0.total_cmp(&b.0));
        let lengths_m = merged(lengths_m, setting.merged_m);
        sources.push(lengths_m.iter().map(|(_, source)| *source).collect());
        let arrivals = lengths_m.iter().map(|(length_m, _)| Arrival { length_m: *length_m, sd_m }).collect();
        profiles.push(Profile::new([a, b], arrivals, Vec::new(), [low_m, high_m]));
    }
    let bound_m = |information: &Matrix3<f64>| {
        let mut information = *information;
        if flat {
            information[(2, 2)] = f64::MAX.sqrt();
        }
        information.try_inverse().map_or(f64::INFINITY, |covariance| covariance.trace().sqrt())
    };
    let focus = |(k, point): (usize, &Point)| {
        let normal = if is_on_first(k) { Vector3::y() } else { Vector3::x() };
        Focus { point: *point, normal: (!matches!(setting.walls, Walls::Rough(_))).then_some(normal) }
    };
    Drawn {
        room: Room {
            foci: foci.iter().enumerate().map(focus).collect(),
            dimensions: if flat { 2 } else { 3 },
            false_alarm: 1e-2,
            count: None,
            blend_m: REACH * setting.merged_m,
            cancel: Cancel::never(),
        },
        profiles,
        bounds_m: information.iter().map(bound_m).collect(),
        hidden,
        furniture,
        sources,
    }
}

/// Unresolved pulses, as strong as one another: each run of neighbours nearer than `merged_m` makes one arrival.
fn merged(lengths_m: Vec<(f64, Option<usize>)>, merged_m: f64) -> Vec<(f64, Option<usize>)> {
    let runs = lengths_m.chunk_by(|a, b| b.0 - a.0 < merged_m);
    runs.map(|run| (run.iter().map(|(length_m, _)| length_m).sum::<f64>() / run.len() as f64, run[0].1)).collect()
}

/// How a search went.
#[derive(Clone, Copy, Debug, Default)]
pub struct Score {
    /// Hidden patches with no found one within five bounds or 5 mm.
    pub missed: usize,
    /// Found patches that are none.
    pub extra: usize,
    /// Sums over the hidden patches that were found: squared errors, squared bounds.
    pub squares_m2: [f64; 2],
}

impl Score {
    /// Whether all were found and nothing else.
    #[must_use]
    pub const fn is_right(&self) -> bool {
        self.missed == 0 && self.extra == 0
    }
}

/// Holds what was found against the truth.
#[must_use]
pub fn score(drawn: &Drawn, solution: &[Point]) -> Score {
    let mut score = Score::default();
    let mut rest: Vec<Point> = solution.to_vec();
    for (q, bound_m) in drawn.hidden.iter().zip(&drawn.bounds_m) {
        let nearest = (0..rest.len()).min_by(|&a, &b| (rest[a] - q).norm().total_cmp(&(rest[b] - q).norm()));
        match nearest.map(|n| (n, (rest[n] - q).norm())).filter(|(_, error_m)| *error_m < (5.0 * bound_m).max(0.005)) {
            Some((n, error_m)) => {
                rest.remove(n);
                score.squares_m2[0] += error_m * error_m;
                score.squares_m2[1] += bound_m * bound_m;
            }
            None => score.missed += 1,
        }
    }
    rest.retain(|point| drawn.furniture.iter().all(|other| (other - point).norm() > 0.05));
    score.extra = rest.len();
    score
}
