//! Which nodes of a surface first light shows.

use std::collections::BTreeSet;
use std::f64::consts::TAU;

use super::grid::{Foot, Grid};
use super::root;

/// A node is shown among so many of the nearest points that the wall sees, if none of the gaps between their directions
/// is larger than this, and the nearest lies within so many zones.
const AMONG: usize = 12;
const GAP: f64 = 150.0 / 360.0 * TAU;
const REACH: f64 = 0.7;
/// Where a surface ends, points lie up to so many nodes beyond.
const BORDER: usize = 2;
/// Parts of fewer squares of a zone are no surface: places far from one another show a few nodes by chance.
const LEAST_PART: f64 = 0.3;

/// Of each node.
pub fn nodes(grid: &Grid, feet: &[Foot], zone_m: f64) -> Vec<bool> {
    // Corners and edges are seen from many places: the points of one cell count once.
    let cells: BTreeSet<u32> = feet.iter().map(largest).collect();
    let is_shown = |node: usize| {
        let here = grid.place(node);
        let mut arms: Vec<_> = cells.iter().map(|cell| grid.place(*cell as usize) - here).collect();
        if arms.len() < AMONG {
            return false;
        }
        arms.select_nth_unstable_by(AMONG - 1, |a, b| a.norm_squared().total_cmp(&b.norm_squared()));
        arms.truncate(AMONG);
        let is_near = arms.iter().any(|arm| arm.norm() < REACH * zone_m);
        let mut angles: Vec<f64> =
            arms.iter().filter(|arm| arm.norm() > 0.5 * grid.spacing_m).map(|arm| arm.y.atan2(arm.x)).collect();
        angles.sort_by(f64::total_cmp);
        let Some([first, last]) = angles.first().copied().zip(angles.last().copied()).map(|(a, b)| [a, b]) else {
            return false;
        };
        let widest = angles.windows(2).map(|pair| pair[1] - pair[0]).fold(first + TAU - last, f64::max);
        is_near && widest < GAP
    };
    let mut is_shown: Vec<bool> = (0..grid.count()).map(is_shown).collect();
    for _ in 0..BORDER {
        let is_within = |steps: [usize; 2], node: usize| {
            steps.into_iter().all(|step| is_shown[node - step] && is_shown[node + step])
        };
        let within = |node: usize| is_shown[node] && grid.steps(node).is_some_and(|steps| is_within(steps, node));
        is_shown = (0..grid.count()).map(within).collect();
    }
    without_small_parts(is_shown, grid, LEAST_PART * (zone_m / grid.spacing_m).powi(2))
}

/// Without nodes that hang together with fewer than so many.
fn without_small_parts(mut is_shown: Vec<bool>, grid: &Grid, least: f64) -> Vec<bool> {
    let mut part: Vec<usize> = (0..is_shown.len()).collect();
    for node in (0..is_shown.len()).filter(|node| is_shown[*node]) {
        for step in grid.steps(node).into_iter().flatten().filter(|step| is_shown[node - step]) {
            let [a, b] = [root(&part, node), root(&part, node - step)];
            part[a.max(b)] = a.min(b);
        }
    }
    let mut counts = vec![0.0; is_shown.len()];
    (0..is_shown.len()).filter(|node| is_shown[*node]).for_each(|node| counts[root(&part, node)] += 1.0);
    is_shown.iter_mut().enumerate().for_each(|(node, is_shown)| *is_shown &= counts[root(&part, node)] >= least);
    is_shown
}

/// The node with the largest share.
fn largest(foot: &Foot) -> u32 {
    let most = (0..3).max_by(|a, b| foot.shares[*a].total_cmp(&foot.shares[*b])).unwrap_or(0);
    foot.nodes[most]
}
