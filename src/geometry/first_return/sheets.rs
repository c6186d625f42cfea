//! Light that is seen at many places, in sheets: lengths that go on from place to place.

use std::collections::BTreeSet;

use periscope_cancel::Cancel;

use crate::Point;
use crate::neighbours::neighbours;

/// Nearest places whose light may go on, itself among them.
const NEAREST: usize = 9;
/// Light goes on beyond a place in directions whose cosine with that from where it comes is this one or more.
const STRAIGHT: f64 = 0.9;
/// Change of the slope that counts where nothing shows how light goes on, over the steepest slope.
const UNKNOWN: f64 = 0.25;

/// Layers of light, the largest first: each has light of a place once at most, and holds whole sheets. Of each light
/// are given the number of its place, that place, and its length. Two of neighbouring places may be of one sheet where
/// lengths differ by no more than places may make them, `steepest` times their distance. Those that go on to both sides
/// with the same slope are joined first, and sheets of which both have light of one place are not: where the lengths of
/// two things cross, slopes tell them apart.
#[must_use]
pub fn layers(light: &[(usize, Point, f64)], steepest: f64, cancel: &Cancel) -> Vec<Vec<usize>> {
    let mut sheets = Sheets::new(light);
    for [one, other] in Links::new(light, steepest, cancel).by_bend() {
        sheets.join(one, other);
    }
    let mut layers: Vec<(BTreeSet<usize>, Vec<usize>)> = Vec::new();
    for (places, members) in sheets.by_size() {
        match layers.iter_mut().find(|(taken, _)| taken.is_disjoint(&places)) {
            Some((taken, all)) => {
                taken.extend(places);
                all.extend(members);
            }
            None => layers.push((places, members)),
        }
    }
    let sorted = layers.into_iter().map(|(_, mut members)| {
        members.sort_unstable();
        members
    });
    sorted.collect()
}

/// Which light may be of one sheet.
struct Links<'a> {
    light: &'a [(usize, Point, f64)],
    steepest: f64,
    /// Light of each place, the places, and the neighbours of each.
    places: Vec<Vec<usize>>,
    points: Vec<Point>,
    near: Vec<Vec<u32>>,
}

impl<'a> Links<'a> {
    fn new(light: &'a [(usize, Point, f64)], steepest: f64, cancel: &Cancel) -> Self {
        let mut order: Vec<usize> = (0..light.len()).collect();
        order.sort_by_key(|one| light[*one].0);
        let places: Vec<Vec<usize>> =
            order.chunk_by(|one, other| light[*one].0 == light[*other].0).map(<[usize]>::to_vec).collect();
        let points: Vec<Point> = places.iter().map(|of_place| light[of_place[0]].1).collect();
        let near = neighbours(&points, NEAREST, cancel);
        Self { light, steepest, places, points, near }
    }

    /// Pairs of light that may be of one sheet, those first whose slopes change least on both sides.
    fn by_bend(&self) -> Vec<[usize; 2]> {
        let mut links: Vec<(f64, [usize; 2])> = Vec::new();
        for here in 0..self.places.len() {
            for there in self.neighbours_of(here) {
                for (one, other) in
                    self.places[here].iter().flat_map(|one| self.places[there].iter().map(move |other| (*one, *other)))
                {
                    if self.slope([here, there], [one, other]).abs() <= self.steepest {
                        let bend = self.bend([here, there], [one, other]) + self.bend([there, here], [other, one]);
                        links.push((bend, [one, other]));
                    }
                }
            }
        }
        links.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        links.into_iter().map(|(_, both)| both).collect()
    }

    fn neighbours_of(&self, here: usize) -> impl Iterator<Item = usize> {
        self.near[here].iter().map(|there| *there as usize).filter(move |there| *there != here)
    }

    fn slope(&self, [here, there]: [usize; 2], [one, other]: [usize; 2]) -> f64 {
        (self.light[other].2 - self.light[one].2) / (self.points[there] - self.points[here]).norm()
    }

    /// By how much the slope from one place to another differs from that with which light goes on beyond the first.
    fn bend(&self, [here, there]: [usize; 2], both: [usize; 2]) -> f64 {
        let slope = self.slope([here, there], both);
        let way = (self.points[there] - self.points[here]).normalize();
        let beyond = self
            .neighbours_of(here)
            .filter(|beyond| way.dot(&(self.points[here] - self.points[*beyond]).normalize()) >= STRAIGHT);
        let bends = beyond.flat_map(|beyond| {
            self.places[beyond].iter().map(move |third| (self.slope([beyond, here], [*third, both[0]]) - slope).abs())
        });
        bends.fold(UNKNOWN * self.steepest, f64::min)
    }
}

/// Light in disjoint sets, each with the places of its members.
struct Sheets {
    /// A member of the same set, itself for the one that stands for the set.
    above: Vec<usize>,
    places: Vec<BTreeSet<usize>>,
}

impl Sheets {
    fn new(light: &[(usize, Point, f64)]) -> Self {
        let places = light.iter().map(|(place, ..)| BTreeSet::from([*place])).collect();
        Self { above: (0..light.len()).collect(), places }
    }

    fn top(&mut self, mut one: usize) -> usize {
        while self.above[one] != one {
            self.above[one] = self.above[self.above[one]];
            one = self.above[one];
        }
        one
    }

    /// Makes one set of two, unless both have light of one place.
    fn join(&mut self, one: usize, other: usize) {
        let [one, other] = [self.top(one), self.top(other)];
        if one == other || !self.places[one].is_disjoint(&self.places[other]) {
            return;
        }
        let (small, large) =
            if self.places[one].len() < self.places[other].len() { (one, other) } else { (other, one) };
        let moved = std::mem::take(&mut self.places[small]);
        self.places[large].extend(moved);
        self.above[small] = large;
    }

    /// Places and members of the sets, those with most members first, then in the order of their first members.
    fn by_size(mut self) -> Vec<(BTreeSet<usize>, Vec<usize>)> {
        let mut members: Vec<Vec<usize>> = vec![Vec::new(); self.above.len()];
        for one in 0..self.above.len() {
            let top = self.top(one);
            members[top].push(one);
        }
        let mut sheets: Vec<(BTreeSet<usize>, Vec<usize>)> =
            self.places.into_iter().zip(members).filter(|(_, members)| !members.is_empty()).collect();
        sheets.sort_by(|a, b| b.1.len().cmp(&a.1.len()).then(a.1[0].cmp(&b.1[0])));
        sheets
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two planes behind one another, each missed at some places, so that ranks change from place to place, and a
    /// length that no other is next to.
    #[test]
    fn light_of_two_planes_lies_in_two_layers() {
        let mut light = Vec::new();
        for place in 0..400_usize {
            let seen = Point::new((place % 20) as f64 * 0.03, (place / 20) as f64 * 0.03, 0.0);
            let near_m = 1.2 + 0.9 * seen.x - 0.3 * seen.y;
            let far_m = 1.5 - 0.8 * seen.x + 0.5 * seen.y;
            if !place.is_multiple_of(7) {
                light.push((place, seen, near_m));
            }
            if !place.is_multiple_of(5) {
                light.push((place, seen, far_m));
            }
            if place == 211 {
                light.push((place, seen, 5.0));
            }
        }
        let far = |one: &usize| (light[*one].2 - 1.5 + 0.8 * light[*one].1.x - 0.5 * light[*one].1.y).abs() < 1e-9;
        let layers = layers(&light, 2.0, &Cancel::never());
        let counts: Vec<[usize; 2]> = layers
            .iter()
            .map(|layer| {
                let far = layer.iter().filter(|one| far(one)).count();
                [layer.len(), far]
            })
            .collect();
        assert_eq!(layers.iter().map(Vec::len).sum::<usize>(), light.len());
        for layer in &layers {
            let places: BTreeSet<usize> = layer.iter().map(|one| light[*one].0).collect();
            assert_eq!(places.len(), layer.len());
        }
        // The planes cross, where which is which does not matter: nearly all light of a layer is of one plane.
        println!("{counts:?}");
        for [all, far] in &counts[..2] {
            assert!(*all > 280 && (*far * 10 > 9 * all || *far * 10 < *all), "{counts:?}");
        }
    }
}
