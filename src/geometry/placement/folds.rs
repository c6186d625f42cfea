//! Groups of patches that can fold over together.
//!
//! A group whose neighbours outside of it lie, with the stations, in one plane (in flatland on one line) has the same
//! path lengths mirrored in that plane. With laser and sensor in one point any two neighbours do: they are a hinge. In
//! the graph whose edges are the legs between patches, such a group is what two nodes cut off.

use std::collections::BTreeSet;

use nalgebra::{Matrix3, Vector3};

use super::{Measurements, State};
use crate::Point;
use crate::maximum_likelihood::{Node, Observation};

/// Most patches among which groups are looked for: the time grows as the fourth power of their number.
const MOST: usize = 80;
/// A hinge that spans less than this share of the longest path has no plane.
const FLAT: f64 = 1e-3;

/// A group, and the patches that it hangs on.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Fold {
    pub(super) patches: Vec<usize>,
    hinge: Vec<usize>,
}

impl Measurements<'_> {
    /// All groups, none twice, single patches among them; none where stations span a plane.
    pub(super) fn folds(&self) -> Vec<Fold> {
        let free = self.frame.free_rotations();
        let is_space = self.problem.dimensions == 3;
        // Anchors and rays fix the frame, but need not be on the hinge.
        let one_point = self.problem.stations.iter().all(|one| (one.position - self.frame.centre).norm() < 1e-6);
        let hinges = match (is_space, free, one_point) {
            _ if self.count() > MOST => Vec::new(),
            (true, _, true) => pairs(self.count()),
            (true, 1, false) | (false, _, true) => (0..self.count()).map(|patch| vec![patch]).collect(),
            _ => Vec::new(),
        };
        let next = self.neighbours();
        let folds: BTreeSet<Fold> = hinges.into_iter().flat_map(|hinge| cut_off(&next, &hinge)).collect();
        folds.into_iter().collect()
    }

    /// Places with a group mirrored in its hinge; `None` where that has no plane.
    pub(super) fn folded(&self, places: &[Option<Point>], fold: &Fold) -> Option<Vec<Option<Point>>> {
        let centre = self.frame.centre;
        let stations = self.problem.stations.iter().map(|station| station.position);
        let on_hinge: Option<Vec<Point>> = fold.hinge.iter().map(|&patch| places[patch]).collect();
        let arms: Vec<Vector3<f64>> = stations.chain(on_hinge?).map(|point| point - centre).collect();
        let mut spread: Matrix3<f64> = arms.iter().map(|arm| arm * arm.transpose()).sum();
        if self.problem.dimensions == 2 {
            spread[(2, 2)] = f64::MAX.sqrt();
        }
        let axes = spread.symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| axes.eigenvalues[a].total_cmp(&axes.eigenvalues[b]));
        if axes.eigenvalues[order[1]] < (FLAT * self.frame.longest_m).powi(2) {
            return None;
        }
        let normal = axes.eigenvectors.column(order[0]).into_owned();
        let mut folded = places.to_vec();
        for &patch in &fold.patches {
            folded[patch] = places[patch].map(|point| point - 2.0 * normal.dot(&(point - centre)) * normal);
        }
        Some(folded)
    }

    /// Places with groups folded over, and with one more group inside of these.
    pub(super) fn all_folded(&self, now: &State) -> Vec<Vec<Option<Point>>> {
        let folds = self.folds();
        let mut all = Vec::new();
        // Single patches alone are among the moves.
        for outer in folds.iter().filter(|fold| fold.patches.len() > 1) {
            self.problem.cancel.check();
            let Some(places) = self.folded(&now.places, outer) else { continue };
            let is_inside = |inner: &&Fold| {
                inner.patches.len() < outer.patches.len()
                    && inner.patches.iter().all(|patch| outer.patches.contains(patch))
            };
            all.extend(folds.iter().filter(is_inside).filter_map(|inner| self.folded(&places, inner)));
            all.push(places);
        }
        all
    }

    /// Patches that share a leg with each.
    pub(super) fn neighbours(&self) -> Vec<BTreeSet<usize>> {
        let mut next = vec![BTreeSet::new(); self.count()];
        let legs = |observation: &Observation| observation.nodes.windows(2).map(<[Node]>::to_vec).collect::<Vec<_>>();
        for leg in self.problem.observations.iter().flat_map(legs) {
            if let [Node::Patch(a), Node::Patch(b)] = leg[..] {
                next[a].insert(b);
                next[b].insert(a);
            }
        }
        next
    }
}

fn pairs(count: usize) -> Vec<Vec<usize>> {
    (0..count).flat_map(|b| (0..b).map(move |a| vec![a, b])).collect()
}

/// Groups that a hinge cuts off from the largest one, and that hang on all of it.
fn cut_off(next: &[BTreeSet<usize>], hinge: &[usize]) -> Vec<Fold> {
    let mut left: BTreeSet<usize> = (0..next.len()).filter(|patch| !hinge.contains(patch)).collect();
    let mut groups: Vec<Vec<usize>> = Vec::new();
    while let Some(first) = left.pop_first() {
        let (mut group, mut at) = (vec![first], 0);
        while at < group.len() {
            let more: Vec<usize> = next[group[at]].iter().copied().filter(|patch| left.remove(patch)).collect();
            group.extend(more);
            at += 1;
        }
        group.sort_unstable();
        groups.push(group);
    }
    groups.sort_by_key(|group| std::cmp::Reverse(group.len()));
    let hangs = |group: &&Vec<usize>| hinge.iter().all(|on| group.iter().any(|patch| next[*patch].contains(on)));
    let folds = groups.iter().skip(1).filter(hangs);
    folds.map(|group| Fold { patches: group.clone(), hinge: hinge.to_vec() }).collect()
}
