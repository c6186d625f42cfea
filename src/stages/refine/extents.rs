//! What the extent of patches makes of onsets: footprints that campaign.toml gives or that widths tell, and errors of
//! onsets that are wider than their patches make them.

use super::model::Model;
use crate::geometry::Point;
use crate::geometry::footprint::{self, Bounce, Footprints, Spread};
use crate::geometry::maximum_likelihood::{Node, Problem, Solution};
use crate::tables::Label;

/// An onset without a width may have one that is not worth its parameter: the standard deviation of its variance is so
/// many times that of a width.
const UNSEEN: f64 = 3.0;
/// Pulses that `deconvolve` takes for one wide pulse are about so far apart: nearer ones make it hardly wider, and
/// those further apart are two. By how much a wide pulse is pulled is therefore known to about so large a share.
const BLEND_PS: f64 = 60.0;
const PULL_SD: f64 = 0.5;
/// No light of a profile comes before that of so few bounces.
const EARLIEST: i32 = 2;

/// Extent of the patches, as far as it is known.
pub struct Extents {
    pub footprints: Footprints,
    /// Of each onset, what other light in it adds to its length.
    pub pulls: Vec<Pull>,
}

/// What other light in an onset adds to its length, and the standard deviation of that.
#[derive(Clone, Copy, Debug, Default)]
pub struct Pull {
    pub mean_m: f64,
    pub sd_m: f64,
}

impl Extents {
    /// Those `given`, and what the widths of onsets tell of patches without one.
    ///
    /// An onset wider than its patches make it by a variance V has other light in it. Light of a share f that comes D
    /// later adds f (1 - f) D^2 to the variance, and f D to the time: about V / D. Other light comes later than first
    /// and second bounces; third ones it may pull either way.
    pub fn new(model: &Model, problem: &Problem, solution: &Solution, given: &Footprints) -> Self {
        let (labels, spreads) = spreads(model, problem, solution);
        let held: Vec<_> = model.patches.iter().map(|patch| given.0.get(patch).copied()).collect();
        let sizes = footprint::from_widths(&spreads, &held, &model.context.cancel);
        let of_patch = |(patch, estimate): (&_, Option<_>)| Some((*patch, estimate?));
        let footprints = Footprints(model.patches.iter().zip(sizes.footprints).filter_map(of_patch).collect());
        let mut pulls = vec![Pull::default(); model.labels.len()];
        for ((label, spread), excess_m2) in labels.into_iter().zip(&spreads).zip(sizes.excess_m2) {
            let apart_m = model.fields(&model.labels[label]).medium.path_m(BLEND_PS);
            let pull_m = f64::max(0.0, excess_m2 - spread.sd_m2) / apart_m;
            let is_earliest = model.labels[label].bounces <= EARLIEST;
            pulls[label] = if is_earliest {
                Pull { mean_m: pull_m, sd_m: PULL_SD * pull_m }
            } else {
                Pull { mean_m: 0.0, sd_m: pull_m }
            };
        }
        Self { footprints, pulls }
    }
}

/// Spreads of all onsets that may have a width, with their places among the labels; none where no onset has one.
fn spreads(model: &Model, problem: &Problem, solution: &Solution) -> (Vec<usize>, Vec<Spread>) {
    let variance_sd_ps2 =
        |label: &Label| Some(2.0 * label.width_ps? * label.width_sd_ps?).filter(|sd_ps2| *sd_ps2 > 0.0);
    // How exactly the variance of an onset is known, by how exactly its time is.
    let mut ratios_ps: Vec<f64> =
        model.labels.iter().filter_map(|label| Some(variance_sd_ps2(label)? / label.time_sd_ps)).collect();
    ratios_ps.sort_by(f64::total_cmp);
    let Some(usual_ps) = ratios_ps.get(ratios_ps.len() / 2) else { return (Vec::new(), Vec::new()) };
    let spread = |(n, label): (usize, &Label)| {
        let width_ps = label.width_ps?;
        let sd_ps2 = variance_sd_ps2(label).unwrap_or(UNSEEN * usual_ps * label.time_sd_ps);
        let squared_m2 = model.fields(label).medium.path_m(1.0).powi(2);
        let bounces = bounces(&problem.observations[n].nodes, solution);
        Some((n, Spread { bounces, variance_m2: squared_m2 * width_ps * width_ps, sd_m2: squared_m2 * sd_ps2 }))
    };
    model.labels.iter().enumerate().filter_map(spread).unzip()
}

/// Bounces of a path.
fn bounces(nodes: &[Node], solution: &Solution) -> Vec<Bounce> {
    let at = |node: Node| -> Point {
        match node {
            Node::Patch(patch) => solution.points[patch],
            Node::Station(station) => solution.stations[station],
        }
    };
    let of_patch = |legs: &[Node]| {
        let Node::Patch(patch) = legs[1] else { unreachable!("paths end at stations alone") };
        let [before, own, after] = [legs[0], legs[1], legs[2]].map(at);
        let towards = |other: Point| (other - own).try_normalize(f64::MIN_POSITIVE).unwrap_or_default();
        Bounce { patch, legs: [towards(before), towards(after)] }
    };
    nodes.windows(3).map(of_patch).collect()
}
