//! Which neighbours a field is fitted to.

use std::cell::OnceCell;
use std::f64::consts::FRAC_PI_4;
use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};
use periscope_cancel::Cancel;
use rayon::prelude::*;

use super::field::Field;
use super::flat::{Flat, Hint};
use super::local::{Fitted, Likeliest, Local, Sample};
use super::way::Way;
use super::{Lit, Scan};
use crate::Point;
use crate::axes::across;
use crate::neighbours::Cells;

/// Places of a window, and the most that are neighbours: half of a window lies on one side.
pub const SIZES: [usize; 11] = [13, 21, 34, 55, 89, 144, 233, 377, 610, 987, 1600];
/// So many sizes do for curvatures.
pub const FEW: usize = 7;
/// So many are tried where lit and seen point are apart: no field is exact for their lengths.
const APART: usize = 6;
/// Nearest places that are sought of each place, and where a window needs more.
const NEAR: usize = 240;
const MOST: usize = 2000;
/// Windows on one side.
const SIDES: usize = 8;
/// Of so many nearest places, itself with them, one has flat faces of its own; of more where there are many places.
const NEAREST: usize = 9;
const CENTRES: usize = 100;
/// Faces with most members among which the surest is sought.
const SHARED: usize = 16;
/// Chi-square of neighbours by which flat faces may be worse than the best.
const AS_GOOD: f64 = 4.0;
/// Places of a window of flat faces.
const FLAT_SIZES: [usize; 6] = [34, 89, 233, 377, 610, 1600];
/// Most places of a window that are fitted, evenly over it.
const FITTED: usize = 610;
/// Cube-root score of chi-square (nearly a standard normal): beyond it a window has no field, sides are tried, it
/// grows no more.
const NO_FIELD: f64 = 3.0;
const TRY_SIDES: f64 = 1.5;
const NO_GROWTH: f64 = 2.0;
/// By how much a side must be better.
const BETTER: f64 = 0.5;
/// Standard deviations, squared, within which a place follows the field, and a point that of a smaller window.
const FOLLOWS: f64 = 9.0;
const AGREES: f64 = 20.0;
/// Places next to so many that do not follow are left out too, next being within this many distances of neighbours.
const LOST: usize = 3;
const NEXT: f64 = 1.6;
/// Least share of a window that follows.
const ENOUGH: f64 = 0.6;
/// Points of flat faces that are compared with those of bent fields, and the middle chi-square of three coordinates.
const COMPARED: usize = 60;
const MIDDLE: f64 = 2.37;
/// Share of differences between windows that is bias.
const BIAS: f64 = 1.5;
/// Share of places whose smallest windows surely follow one field, and what the chi-square over its degrees of freedom
/// of seven exceeds in all but this share.
const SMOOTH: f64 = 0.1;
const LEAST_MISFIT: f64 = 0.405;
/// The most of an error that a place has for itself, over the standard deviation of the response.
const MOST_OWN: f64 = 0.36;

/// Places of a wall: the nearest ones of each, how light goes to it, and cells in which more are found.
pub struct Wall {
    pub near: Vec<Vec<u32>>,
    ways: Vec<Option<Way>>,
    cells: Cells,
}

impl Wall {
    pub fn new(scan: &Scan, cancel: &Cancel) -> Self {
        let cells = Cells::new(scan.places.iter().map(|place| place.seen).collect());
        let near = cells.all_nearest(NEAR, cancel);
        Self { ways: Way::all(scan, &near), near, cells }
    }
}

/// A field, its members, and what other windows say otherwise of its point and its normal.
pub struct Chosen<F> {
    /// The place about which it was fitted.
    pub centre: u32,
    pub field: F,
    /// Sorted.
    pub members: Arc<[u32]>,
    pub way: Way,
    /// Fields that other windows say, and the share of their difference that is bias.
    others: Vec<(f64, F)>,
}

/// The bent field of each place that is asked for; `None` where its neighbours do not follow one.
pub fn fields(
    scan: &Scan,
    samples: &[Sample],
    wall: &Wall,
    (sizes, is_asked): (&[usize], &[bool]),
    cancel: &Cancel,
) -> Vec<Option<Chosen<Field>>> {
    let most = if matches!(scan.lit, Lit::Apart(_)) { APART } else { sizes.len() };
    let sizes = &sizes[..most.min(sizes.len())];
    let of_place = |n: usize| {
        cancel.check();
        let way = wall.ways[n].filter(|_| is_asked[n])?;
        let zone_m = scan.zone_m(samples[n].length_m * 0.5 / scan.share());
        let start = |members: &[u32]| Field::new(&samples[n], -scan.inwards).likeliest(samples, members);
        let accepts = |field: &Field, _: &[u32]| field.has_point(&way);
        Growth { scan, samples, wall, more: OnceCell::new(), place: n, way, zone_m, sizes, start, accepts }.chosen()
    };
    (0..samples.len()).into_par_iter().map(of_place).collect()
}

/// Standard deviation of an error that each place has for itself beside its noise, such as jitter of the laser: by how
/// lengths of the smallest windows scatter about fields. Windows across creases scatter more, so that the tenth counts
/// which scatters least.
pub fn own_m(scan: &Scan, samples: &[Sample], near: &[Vec<u32>], is_asked: &[bool]) -> f64 {
    let of_place = |n: usize| {
        let members = near[n].get(..SIZES[0]).filter(|_| is_asked[n])?;
        let misfit = Field::new(&samples[n], -scan.inwards).likeliest(samples, members)?.misfit();
        let noise_m2 = members.iter().map(|n| samples[*n as usize].sd_m.powi(2)).sum::<f64>() / members.len() as f64;
        Some(noise_m2 * (misfit / LEAST_MISFIT - 1.0))
    };
    let mut all_m2: Vec<f64> = (0..samples.len()).into_par_iter().filter_map(of_place).collect();
    if all_m2.is_empty() {
        return 0.0;
    }
    let at = (SMOOTH * all_m2.len() as f64) as usize;
    let own_m2 = *all_m2.select_nth_unstable_by(at, f64::total_cmp).1;
    own_m2.max(0.0).sqrt().min(MOST_OWN * scan.share() * scan.sigma_m)
}

/// The flat faces about some places, from points that are known; `None` elsewhere, and where neighbours follow none.
/// Faces hold only where their points are those of `bent` fields, which know nothing of faces: lengths alone seldom
/// contradict them, since the error of their law is as large as what a slightly curved surface differs by.
pub fn flats(
    scan: &Scan,
    samples: &[Sample],
    wall: &Wall,
    (hints, bent): (&[Option<Hint>], &[Option<Reading>]),
    cancel: &Cancel,
) -> Vec<Option<Chosen<Flat>>> {
    let centres = apart(&wall.near, NEAREST.max(samples.len() / CENTRES));
    let of_place = |n: usize| {
        cancel.check();
        if !centres[n] {
            return None;
        }
        let zone_m = scan.zone_m(samples[n].length_m);
        let start = |members: &[u32]| {
            let hints: Vec<Hint> = members.iter().filter_map(|member| hints[*member as usize]).collect();
            if hints.len() < SIZES[0] {
                return None;
            }
            let starts = Flat::starts(samples[n].at, &hints, samples, members, zone_m);
            let flats = starts.iter().filter_map(|flat| flat.likeliest(samples, members));
            flats.min_by(|a, b| a.square().total_cmp(&b.square()))
        };
        let accepts = |flat: &Flat, members: &[u32]| {
            let step = members.len().div_ceil(COMPARED);
            let off = |member: &u32| {
                let bent = bent[*member as usize].as_ref()?;
                reading(&flat.seen_from(samples[*member as usize].at), &Way::Back).off(bent)
            };
            let mut off: Vec<f64> = members.iter().step_by(step).filter_map(off).collect();
            off.sort_by(f64::total_cmp);
            off.get(off.len() / 2).is_none_or(|middle| *middle < MIDDLE)
        };
        let (way, sizes, more) = (Way::Back, &FLAT_SIZES, OnceCell::new());
        Growth { scan, samples, wall, more, place: n, way, zone_m, sizes, start, accepts }.chosen()
    };
    (0..samples.len()).into_par_iter().map(of_place).collect()
}

/// Places of which none is among the nearest of another.
pub fn apart(near: &[Vec<u32>], nearest: usize) -> Vec<bool> {
    let mut is_centre = vec![false; near.len()];
    for (n, near) in near.iter().enumerate() {
        is_centre[n] = !near[1..nearest.min(near.len())].iter().any(|other| is_centre[*other as usize]);
    }
    is_centre
}

/// Windows about one place, with the nearest places of all, the field that a smallest one starts with, and what else
/// speaks for or against a field of some members.
struct Growth<'a, S, A> {
    scan: &'a Scan,
    samples: &'a [Sample],
    wall: &'a Wall,
    more: OnceCell<Vec<u32>>,
    place: usize,
    way: Way,
    zone_m: f64,
    sizes: &'a [usize],
    start: S,
    accepts: A,
}

impl<F: Local, S: Fn(&[u32]) -> Option<Likeliest<F>>, A: Fn(&F, &[u32]) -> bool> Growth<'_, S, A> {
    fn at(&self, n: u32) -> &Sample {
        &self.samples[n as usize]
    }

    fn near(&self) -> &[u32] {
        &self.wall.near[self.place]
    }

    /// The nearest on a side; side 0 is all around.
    fn nearest(&self, side: usize, size: usize) -> Vec<u32> {
        let here = self.at(self.near()[0]).at;
        let [x, y] = across(&self.scan.inwards);
        let angle = (side as f64 - 1.0) * FRAC_PI_4;
        let towards = x * angle.cos() + y * angle.sin();
        let is_there = |n: &u32| side == 0 || towards.dot(&(self.at(*n).at - here)) > -1e-9;
        let of = |near: &[u32]| -> Vec<u32> { near.iter().copied().filter(is_there).take(size).collect() };
        let nearest = of(self.near());
        if nearest.len() == size || self.near().len() < NEAR {
            return nearest;
        }
        of(self.more.get_or_init(|| self.wall.cells.nearest(self.place, MOST)))
    }

    fn begin(&self, side: usize) -> Option<(Likeliest<F>, Vec<u32>)> {
        let members = self.nearest(side, self.sizes[0]);
        if members.len() < self.sizes[0] {
            return None;
        }
        Some(((self.start)(&members)?, members))
    }

    /// The smallest window, all around or on the side where one field explains it best.
    fn smallest(&self) -> Option<(usize, F, Vec<u32>)> {
        let mut best = self.begin(0).map(|(field, members)| (0, field, members));
        if best.as_ref().is_none_or(|(_, field, _)| field.score() > TRY_SIDES) {
            for side in 1..=SIDES {
                let Some((field, members)) = self.begin(side) else { continue };
                if best.as_ref().is_none_or(|(_, best, _)| field.score() < best.score() - BETTER) {
                    best = Some((side, field, members));
                }
            }
        }
        let (side, field, members) = best.filter(|(_, field, _)| field.score() <= NO_FIELD)?;
        let field = field.with_spread(self.samples, &members, self.zone_m)?;
        (self.accepts)(&field, &members).then_some((side, field, members))
    }

    /// Those of a larger window that follow the field, and do not lie among others that do not.
    fn followers(&self, field: &F, window: &[u32]) -> Vec<u32> {
        let covariance = field.fitted().noise + field.fitted().law;
        let follows = |n: &u32| {
            let sample = self.at(*n);
            let off_m2 = (sample.length_m - field.length_m(&sample.at)).powi(2);
            let variance = sample.sd_m.powi(2) + sample.law_m.powi(2);
            let of_field = || {
                let (_, slopes) = field.length(&sample.at);
                slopes.dot(&(covariance * slopes))
            };
            off_m2 < FOLLOWS * variance || off_m2 < FOLLOWS * (variance + of_field())
        };
        let (mut followers, mut lost): (Vec<u32>, Vec<u32>) = window.iter().partition(|n| follows(n));
        lost.sort_unstable();
        let near = self.near();
        let next_m2 = NEXT * NEXT * (self.at(near[1]).at - self.at(near[0]).at).norm_squared();
        let is_inside = |n: &u32| {
            let is_next = |other: &&u32| (self.at(**other).at - self.at(*n).at).norm_squared() < next_m2;
            let next = self.wall.near[*n as usize][1..].iter().take_while(is_next);
            next.filter(|other| lost.binary_search(other).is_ok()).take(LOST).count() < LOST
        };
        if lost.len() >= LOST {
            followers.retain(is_inside);
        }
        followers
    }

    fn window(&self, field: F, members: Vec<u32>) -> Window<F> {
        let [slopes, _] = field.reading_slopes(&self.way);
        let [noise_m2, law_m2] =
            [field.fitted().noise, field.fitted().law].map(|part| slopes * part * slopes.transpose());
        Window { point: field.reading(&self.way).0, noise_m2, law_m2, field, members }
    }

    /// The field, or that of the other kind, that explains more of a larger window.
    fn grown(&self, last: &F, window: &[u32]) -> Option<(F, Vec<u32>)> {
        let fitted = |start: F| {
            let members = self.followers(&start, window);
            let is_enough = members.len() as f64 >= ENOUGH * window.len() as f64;
            let field = is_enough.then(|| start.likeliest(self.samples, &members))??;
            let unexplained = field.square() + FOLLOWS * (window.len() - members.len()) as f64;
            Some((unexplained, field, members))
        };
        let starts = [Some(last.clone()), last.other().map(|other| other.with(last.fitted().clone()))];
        let fields = starts.into_iter().flatten().filter_map(fitted);
        let (_, field, members) = fields.min_by(|a, b| a.0.total_cmp(&b.0))?;
        Some((field.with_spread(self.samples, &members, self.zone_m)?, members))
    }

    fn chosen(&self) -> Option<Chosen<F>> {
        let (side, smallest, members) = self.smallest()?;
        let mut windows = vec![self.window(smallest, members)];
        let (mut sizes, mut refused) = (vec![self.sizes[0]], None);
        for size in &self.sizes[1..] {
            let last = &windows[windows.len() - 1];
            let mut window = self.nearest(side, *size);
            if window.len() < *size {
                break;
            }
            window = window.into_iter().step_by(size.div_ceil(FITTED)).collect();
            let Some((field, members)) = self.grown(&last.field, &window) else { break };
            if *size <= FITTED && members.len() < last.members.len() + 3 {
                continue;
            }
            let grown = self.window(field, members);
            let is_borne_out =
                windows.iter().all(|smaller| grown.agrees(smaller)) && (self.accepts)(&grown.field, &grown.members);
            if grown.field.fitted().score() > NO_GROWTH || !is_borne_out {
                refused = Some(grown.field);
                break;
            }
            windows.push(grown);
            sizes.push(*size);
        }
        // One window less than would do: its bias is a fraction of its noise.
        let at = windows.len().saturating_sub(1 + usize::from(refused.is_some()));
        let larger = windows.get(at + 1).map(|window| &window.field).or(refused.as_ref());
        let smaller = at.checked_sub(1).map(|smaller| &windows[smaller].field);
        let reads = |other: &F| (BIAS, other.clone().with(Fitted::none()));
        let others = smaller.into_iter().chain(larger).map(reads).collect();
        let Window { field, mut members, .. } = windows.swap_remove(at);
        if sizes[at] > FITTED {
            members = self.followers(&field, &self.nearest(side, sizes[at]));
        }
        members.sort_unstable();
        Some(Chosen { centre: self.place as u32, field, members: members.into(), way: self.way, others })
    }
}

/// A field of some members, and the point that it says, with its covariances of noise and of the law.
struct Window<F> {
    field: F,
    members: Vec<u32>,
    point: Point,
    noise_m2: Matrix3<f64>,
    law_m2: Matrix3<f64>,
}

impl<F> Window<F> {
    /// Whether it says what a smaller window said.
    fn agrees(&self, smaller: &Self) -> bool {
        // Windows share places: the smaller one is off the larger one by what it has more of noise.
        let covariance = smaller.noise_m2 * 1.1 - self.noise_m2 + smaller.law_m2 * 1.1;
        let off = self.point - smaller.point;
        covariance.cholesky().is_none_or(|root| off.dot(&root.solve(&off)) < AGREES)
    }
}

/// A point and a unit vector away from the surface, with their covariances.
#[derive(Clone, Copy, Debug)]
pub struct Reading {
    pub point: Point,
    pub covariance_m2: Matrix3<f64>,
    pub away: Vector3<f64>,
    pub away_covariance: Matrix3<f64>,
}

impl Reading {
    /// Chi-square of the difference of two points whose errors are independent; `None` where one has none.
    pub fn off(&self, other: &Self) -> Option<f64> {
        let off = self.point - other.point;
        Some(off.dot(&(self.covariance_m2 + other.covariance_m2).cholesky()?.solve(&off)))
    }

    /// With an error along the line of sight.
    pub fn and_along(self, sd_m: f64) -> Self {
        Self { covariance_m2: self.covariance_m2 + self.away * self.away.transpose() * sd_m.powi(2), ..self }
    }
}

/// What a field alone says.
fn reading(field: &impl Local, way: &Way) -> Reading {
    let (point, away) = field.reading(way);
    let covariance = field.fitted().noise + field.fitted().law;
    let [covariance_m2, away_covariance] =
        field.reading_slopes(way).map(|slopes| slopes * covariance * slopes.transpose());
    Reading { point, covariance_m2, away, away_covariance }
}

impl<F: Local> Chosen<F> {
    pub fn reading(&self) -> Reading {
        let Reading { point, mut covariance_m2, away, mut away_covariance } = reading(&self.field, &self.way);
        for (share, (other_point, other_away)) in
            self.others.iter().map(|(share, other)| (share, other.reading(&self.way)))
        {
            let [off, off_away] = [other_point - point, other_away - away];
            covariance_m2 += off * off.transpose() * *share;
            away_covariance += off_away * off_away.transpose() * *share;
        }
        Reading { point, covariance_m2, away, away_covariance }
    }
}

impl Chosen<Field> {
    /// The same field, read from another place.
    pub fn seen_from(&self, seen: Point) -> Self {
        let others = self.others.iter().map(|(share, other)| (*share, other.seen_from(seen))).collect();
        Self { field: self.field.seen_from(seen), members: self.members.clone(), others, ..*self }
    }
}

impl Chosen<Flat> {
    /// The same faces as another place sees them.
    pub fn seen_from(&self, at: Point) -> Self {
        let others = self.others.iter().map(|(share, other)| (*share, other.seen_from(at))).collect();
        Self { field: self.field.seen_from(at), members: self.members.clone(), others, ..*self }
    }
}

/// The surest faces of each place among those that it is a member of, and that explain its neighbours about as well as
/// the best.
pub fn shared(flats: &[Option<Chosen<Flat>>], samples: &[Sample], near: &[Vec<u32>]) -> Vec<Option<Chosen<Flat>>> {
    let mut holders: Vec<Vec<u32>> = vec![Vec::new(); samples.len()];
    for (n, flat) in flats.iter().enumerate() {
        for member in flat.iter().flat_map(|flat| &*flat.members) {
            holders[*member as usize].push(n as u32);
        }
    }
    let of_place = |(n, mut holders): (usize, Vec<u32>)| {
        let of = |holder: &u32| flats[*holder as usize].as_ref();
        holders.sort_by_key(|holder| std::cmp::Reverse(of(holder).map_or(0, |flat| flat.members.len())));
        let about = &near[n][..SIZES[0].min(near[n].len())];
        let seen = holders.iter().take(SHARED).filter_map(of);
        let seen: Vec<(f64, &Chosen<Flat>)> = seen.map(|flat| (flat.field.square(samples, about), flat)).collect();
        let best = seen.iter().map(|(square, _)| *square).fold(f64::INFINITY, f64::min);
        let good = seen.into_iter().filter(|(square, _)| *square <= best + AS_GOOD);
        let mut good: Vec<(f64, f64, Chosen<Flat>)> = good
            .map(|(square, flat)| (square, flat.seen_from(samples[n].at)))
            .map(|(square, flat)| (flat.reading().covariance_m2.trace(), square, flat))
            .collect();
        good.sort_by(|a, b| a.0.total_cmp(&b.0));
        // What the others say otherwise counts by how likely and how sure they are.
        let least = good.first()?.0;
        let weight = |trace: f64, square: f64| (0.5 * (best - square)).exp() * least / trace;
        let sum: f64 = good.iter().map(|(trace, square, _)| weight(*trace, *square)).sum();
        let others: Vec<(f64, Flat)> =
            good.iter().map(|(trace, square, flat)| (weight(*trace, *square) / sum, flat.field.clone())).collect();
        let (_, _, mut flat) = good.swap_remove(0);
        flat.others.extend(others);
        Some(flat)
    };
    holders.into_par_iter().enumerate().map(of_place).collect()
}
