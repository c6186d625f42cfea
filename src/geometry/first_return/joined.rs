//! Places of a wall that lie closer than first light tells apart, joined to fewer.
//!
//! First light comes from a zone of the surface, and over the wall its law changes as slowly as that zone is wide. A
//! scan with many places in a zone is one of fewer places with more light: each is the mean of those in a square. Over
//! a square a length is nearly a quadratic function of the place. The mean length is that of the mean place, and what
//! the function bends over the square, which neighbours show. Windows then reach as far as those of a scan with fewer
//! places, and noise averages out within each.

use std::collections::BTreeMap;

use nalgebra::{Cholesky, Const, SMatrix, SVector, Vector3};
use periscope_cancel::Cancel;

use super::local::Sample;
use super::{Face, Lit, Place, Return, Scan};
use crate::Point;
use crate::axes::across;
use crate::median::median;
use crate::neighbours::neighbours;

/// Squares along the radius of a zone: so many or more.
const ACROSS: f64 = 2.0;
/// Nearest joined places that show how lengths bend, itself with them.
const BENT: usize = 13;
/// Root of the least pivot of places that determine how a function bends: those of a line do not.
const LEAST_PIVOT: f64 = 1e-3;
/// Places that are left, about: of fewer, windows do not tell creases.
const KEPT: f64 = 400.0;
/// Standard deviations by which lengths in a square may differ beyond what their places do.
const ALIKE: f64 = 4.0;

/// A scan, and which places of another each of its places joins.
pub struct Joined<'a> {
    whole: &'a Scan,
    pub scan: Scan,
    /// Ascending.
    members: Vec<Vec<u32>>,
}

impl<'a> Joined<'a> {
    pub fn of(whole: &'a Scan, cancel: &Cancel) -> Self {
        let members =
            squares(whole, cancel).unwrap_or_else(|| (0..whole.places.len() as u32).map(|n| vec![n]).collect());
        let places = members.iter().map(|members| joined(whole, members)).collect();
        let mut all = Self { whole, scan: Scan { lit: whole.lit.clone(), places, ..*whole }, members };
        if all.members.len() < whole.places.len() {
            all.take_bends_off(cancel);
        }
        all
    }

    /// Makes mean lengths those of mean places.
    fn take_bends_off(&mut self, cancel: &Cancel) {
        let seen: Vec<Point> = self.scan.places.iter().map(|place| place.seen).collect();
        let axes = across(&self.scan.inwards);
        let off = |(place, near): (usize, Vec<u32>)| {
            let here = &self.scan.places[place];
            let farthest_m = near.last().map_or(0.0, |n| (seen[*n as usize] - here.seen).norm());
            let at = |seen: &Point| axes.map(|axis| axis.dot(&(seen - here.seen)) / farthest_m);
            let alike = near.iter().map(|n| &self.scan.places[*n as usize]);
            let known = alike
                .filter(|other| are_alike(&self.scan, here, other))
                .map(|other| (at(&other.seen), other.returns[0].length_m));
            let weighted = self.members[place].iter().map(|n| {
                let Place { seen, returns } = &self.whole.places[*n as usize];
                (at(seen), returns[0].sd_m.powi(-2))
            });
            bend_m(known, weighted)
        };
        let bends_m: Vec<f64> = neighbours(&seen, BENT, cancel).into_iter().enumerate().map(off).collect();
        for (place, bend_m) in self.scan.places.iter_mut().zip(bends_m) {
            place.returns.iter_mut().for_each(|one| one.length_m -= bend_m);
        }
    }

    pub fn members(&self, place: usize) -> &[u32] {
        &self.members[place]
    }

    /// The first return of a place under each of some laws, near lengths that are told for each seen point, by those of
    /// its members that have one under all of them.
    pub fn timed(
        &self,
        place: usize,
        laws: &[Vec<Face>],
        length_m: impl Fn(&Point) -> f64,
        timed: impl Fn(usize, &[Vec<Face>], f64) -> Vec<Option<Return>>,
    ) -> Vec<Option<Return>> {
        let told_m = |n: u32| length_m(&self.whole.places[n as usize].seen);
        let members = &self.members[place];
        if let [one] = members.as_slice() {
            return timed(*one as usize, laws, told_m(*one));
        }
        let all = members.iter().filter_map(|n| {
            let returns: Option<Vec<Return>> = timed(*n as usize, laws, told_m(*n)).into_iter().collect();
            Some((told_m(*n), returns?))
        });
        let all: Vec<(f64, Vec<Return>)> = all.collect();
        let here_m = length_m(&self.scan.places[place].seen);
        let of_law = |law: usize| {
            let off = all.iter().map(|(told_m, returns)| {
                let one = returns[law];
                (one.sd_m.powi(-2), Return { length_m: one.length_m - told_m, ..one })
            });
            let mean = mean(off)?;
            Some(Return { length_m: mean.length_m + here_m, ..mean })
        };
        (0..laws.len()).map(of_law).collect()
    }

    /// The length of a member, from that of the place: the law takes the same of both.
    pub fn of_member(&self, place: usize, member: u32, sample: &Sample) -> Sample {
        if self.members[place].len() == 1 {
            return *sample;
        }
        let [member, place] = [&self.whole.places[member as usize], &self.scan.places[place]];
        let [own, mean] = [member.returns[0], place.returns[0]];
        Sample {
            at: member.seen,
            length_m: sample.length_m + self.whole.share() * (own.length_m - mean.length_m),
            sd_m: sample.sd_m * own.sd_m / mean.sd_m,
            ..*sample
        }
    }

    /// So many places of the whole scan are these.
    pub fn count(&self, places: usize) -> usize {
        places * self.whole.places.len() / self.members.len()
    }
}

/// Places of each square, those apart whose lengths differ by more than their places do; `None` where squares hold one.
fn squares(scan: &Scan, cancel: &Cancel) -> Option<Vec<Vec<u32>>> {
    if matches!(scan.lit, Lit::Apart(_)) {
        return None;
    }
    let seen: Vec<Point> = scan.places.iter().map(|place| place.seen).collect();
    let gap_m = |near: &Vec<u32>| (seen[near[1] as usize] - seen[near[0] as usize]).norm();
    let spacing_m = median(neighbours(&seen, 2, cancel).iter().map(gap_m).collect());
    let zone_m = scan.zone_m(median(scan.places.iter().map(|place| 0.5 * place.returns[0].length_m).collect()));
    let kept = (seen.len() as f64 / KEPT).sqrt();
    let spacings = (zone_m / ACROSS / spacing_m).min(kept).floor();
    if spacings < 2.0 {
        return None;
    }
    let side_m = spacings * spacing_m;
    // Squares begin half a spacing before the first place: of a regular grid all hold as many.
    let axes = across(&scan.inwards);
    let along = |axis: &Vector3<f64>, seen: &Point| axis.dot(&seen.coords);
    let first = axes.map(|axis| seen.iter().map(|seen| along(&axis, seen)).fold(f64::INFINITY, f64::min));
    let square = |place: &Place| {
        [0, 1].map(|k| ((along(&axes[k], &place.seen) - first[k] + 0.5 * spacing_m) / side_m).floor() as u32)
    };
    let mut squares: BTreeMap<[u32; 2], Vec<Vec<u32>>> = BTreeMap::new();
    for (n, place) in scan.places.iter().enumerate() {
        let groups = squares.entry(square(place)).or_default();
        match groups.iter_mut().find(|group| are_alike(scan, &scan.places[group[0] as usize], place)) {
            Some(group) => group.push(n as u32),
            None => groups.push(vec![n as u32]),
        }
    }
    Some(squares.into_values().flatten().collect())
}

fn are_alike(scan: &Scan, a: &Place, b: &Place) -> bool {
    let [one, other] = [a.returns[0], b.returns[0]];
    let most_m = (a.seen - b.seen).norm() + ALIKE * scan.share() * one.sd_m.hypot(other.sd_m);
    scan.share() * (one.length_m - other.length_m).abs() <= most_m
}

/// The mean place: all its lengths have the same weights as the seen points, so that they belong to the mean point.
fn joined(scan: &Scan, members: &[u32]) -> Place {
    let of = |n: &u32| scan.places[*n as usize];
    if let [one] = members {
        return of(one);
    }
    let weight = |n: &u32| of(n).returns[0].sd_m.powi(-2);
    let sum: f64 = members.iter().map(weight).sum();
    let seen: Vector3<f64> = members.iter().map(|n| of(n).seen.coords * weight(n)).sum();
    let law = |k: usize| mean(members.iter().map(|n| (weight(n), of(n).returns[k]))).expect("a place has members");
    Place { seen: Point::from(seen / sum), returns: std::array::from_fn(law) }
}

/// By how much the mean of a function over weighted places exceeds its value in their middle: half its second
/// derivatives by their mean squares. It is a quadratic one through known values, by least squares; 0 where these do
/// not determine it. Places are in units that make the farthest known one about 1.
fn bend_m(known: impl Iterator<Item = ([f64; 2], f64)>, weighted: impl Iterator<Item = ([f64; 2], f64)>) -> f64 {
    let bends = |[x, y]: [f64; 2]| Vector3::new(0.5 * x * x, x * y, 0.5 * y * y);
    let (mut square, mut right) = (SMatrix::<f64, 6, 6>::zeros(), SVector::<f64, 6>::zeros());
    for (at, value) in known {
        let [a, b, c] = bends(at).into();
        let terms = SVector::from([1.0, at[0], at[1], a, b, c]);
        square += terms * terms.transpose();
        right += terms * value;
    }
    let determined = |root: &Cholesky<f64, Const<6>>| root.l_dirty().diagonal().min() > LEAST_PIVOT;
    let Some(root) = square.cholesky().filter(determined) else { return 0.0 };
    let (mean, sum) =
        weighted.fold((Vector3::zeros(), 0.0), |(mean, sum), (at, weight)| (mean + bends(at) * weight, sum + weight));
    root.solve(&right).fixed_rows::<3>(3).dot(&mean) / sum
}

/// The weighted mean of returns whose noise is independent; `None` of none.
fn mean(all: impl Iterator<Item = (f64, Return)>) -> Option<Return> {
    let [mut sum, mut length_m, mut noise_m2, mut common_m, mut log_likelihood] = [0.0; 5];
    for (weight, one) in all {
        sum += weight;
        length_m += weight * one.length_m;
        noise_m2 += (weight * one.sd_m).powi(2);
        common_m += weight * one.common_m;
        log_likelihood += one.log_likelihood;
    }
    let of = |value: f64| value / sum;
    (sum > 0.0).then(|| Return {
        length_m: of(length_m),
        sd_m: of(noise_m2.sqrt()),
        common_m: of(common_m),
        log_likelihood,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lengths of a plane over a wall of 40 x 40 places, 5 mm apart, in no order, with more noise at some; a corner of
    /// the wall shows something 0.1 m behind.
    fn dense() -> Scan {
        let places = (0..1600).map(|n| {
            let k: u32 = (n * 607) % 1600;
            let seen = Point::new(f64::from(k % 40) * 5e-3, f64::from(k / 40) * 5e-3, 0.0);
            let behind = if seen.x + seen.y < 0.083 { 0.2 } else { 0.0 };
            let sd_m = if k.is_multiple_of(3) { 2e-3 } else { 1e-3 };
            let length_m = 1.2 + 0.8 * seen.x - 0.3 * seen.y + behind;
            Place { seen, returns: [Return { length_m, sd_m, common_m: 1e-4, log_likelihood: -1.0 }; 3] }
        });
        Scan { lit: Lit::Same, inwards: Vector3::z(), sigma_m: 7.5e-3, places: places.collect(), least: 0 }
    }

    #[test]
    fn a_joined_place_has_the_length_of_its_mean_place() {
        let whole = dense();
        let joined = Joined::of(&whole, &Cancel::never());
        // The radius of a zone is 67 mm; as many places as are kept lie in squares of 10 mm.
        assert!((400..440).contains(&joined.members.len()), "{} places", joined.members.len());
        let mut all: Vec<u32> = joined.members.concat();
        all.sort_unstable();
        assert_eq!(all, (0..1600).collect::<Vec<u32>>());
        for (place, members) in joined.scan.places.iter().zip(&joined.members) {
            let behind = [0.0, 0.2].map(|behind| 1.2 + 0.8 * place.seen.x - 0.3 * place.seen.y + behind);
            let own = place.returns[1];
            assert!(behind.iter().any(|length_m| (own.length_m - length_m).abs() < 1e-12), "{place:?}");
            let precision: f64 = members.iter().map(|n| whole.places[*n as usize].returns[0].sd_m.powi(-2)).sum();
            assert!((own.sd_m - precision.powf(-0.5)).abs() < 1e-12 && (own.common_m - 1e-4).abs() < 1e-12);
            assert!((own.log_likelihood + members.len() as f64).abs() < 1e-9);
        }
    }

    /// Timed again, members that have no first return are left out, and no slope over the square comes of it.
    #[test]
    fn a_joined_place_is_timed_by_the_members_that_can_be() {
        let whole = dense();
        let joined = Joined::of(&whole, &Cancel::never());
        let told_m = |seen: &Point| 1.2 + 0.8 * seen.x - 0.3 * seen.y;
        let timed = |n: usize, laws: &[Vec<Face>], near_m: f64| {
            let one = Return { length_m: near_m + 1e-3, ..whole.places[n].returns[0] };
            vec![(!n.is_multiple_of(4)).then_some(one); laws.len()]
        };
        let number = joined
            .members
            .iter()
            .position(|members| members.len() == 4 && members.iter().any(|n| n.is_multiple_of(4)))
            .unwrap();
        let [one, other] = joined.timed(number, &[vec![], vec![]], told_m, timed)[..] else { panic!("two laws") };
        let count = joined.members[number].iter().filter(|n| !n.is_multiple_of(4)).count();
        for one in [one, other].map(Option::unwrap) {
            assert!((one.length_m - told_m(&joined.scan.places[number].seen) - 1e-3).abs() < 1e-12);
            assert!((one.log_likelihood + count as f64).abs() < 1e-9 && count < 4);
        }
        let never = joined.timed(number, &[vec![]], told_m, |_, laws, _| vec![None; laws.len()]);
        assert_eq!(never, [None]);
    }

    /// Distances from a sphere, and from a point: a mean over squares would exceed them by up to 0.03 mm.
    #[test]
    fn a_joined_place_has_the_length_of_its_mean_place_where_lengths_bend() {
        for radius_m in [0.2, 0.0] {
            let mut whole = dense();
            let middle = Point::new(0.08, 0.11, 0.5 + radius_m);
            let length_m = |seen: &Point| 2.0 * ((seen - middle).norm() - radius_m);
            for place in &mut whole.places {
                let length_m = length_m(&place.seen);
                place.returns.iter_mut().for_each(|one| one.length_m = length_m);
            }
            let joined = Joined::of(&whole, &Cancel::never());
            let off_mm = |place: &Place| 1e3 * (place.returns[2].length_m - length_m(&place.seen)).abs();
            let worst_mm = joined.scan.places.iter().map(off_mm).fold(0.0, f64::max);
            assert!(joined.members.len() < 440 && worst_mm < 2e-3, "{radius_m}: {worst_mm} mm");
        }
    }

    #[test]
    fn places_that_lie_far_apart_stay_as_they_are() {
        let mut whole = dense();
        whole.places.iter_mut().for_each(|place| place.seen *= 5.0);
        assert_eq!(Joined::of(&whole, &Cancel::never()).scan.places, whole.places);
    }
}
