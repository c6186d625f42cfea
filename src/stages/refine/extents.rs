//! What the extent of patches makes of onsets: footprints that campaign.toml gives or that widths tell, and errors of
//! onsets that are wider than their patches make them.

use std::collections::BTreeMap;

use super::companions::{self, Companions};
use super::model::Model;
use crate::geometry::Point;
use crate::geometry::companion::{self, Excess, Onset, Pull};
use crate::geometry::footprint::{self, Bounce, Footprints, Spread};
use crate::geometry::maximum_likelihood::{Node, Problem, Solution};
use crate::tables::Label;
use crate::units::PatchId;

/// Pulses that are further apart make two onsets, as a share of the response's full width at half maximum: two standard
/// deviations of a Gaussian.
const RESOLVED: f64 = 2.0 / 2.355;
/// A width is worth its parameter beyond some five standard deviations of its variance. Variances that show no width
/// with a chance are as likely as one whose residual is what they are beyond so many (by the normal distribution's
/// tail).
const UNSEEN: f64 = 3.5;
/// Where no width was fitted, the error of the variance over that of the time is up to so many times what it would be
/// for light alone: other light beside it explains some of the width.
const UNFITTED: f64 = 2.0;
/// An onset of first or second bounces that is further than so many times what the response resolves from all others
/// has a width if it shows by two standard deviations of its variance.
const ALONE: f64 = 5.0;
const UNSEEN_ALONE: f64 = 2.0;
/// Disks of one path have unequal shares of its variance, and orders up to the fourth are not all: what that makes of
/// the variance, as a share of it.
const SHAPE_SD: f64 = 0.04;
/// Light in an onset of which no path is known comes later by this share of what the response resolves: nearer light
/// makes it hardly wider, and light further off is an onset of its own. By how much it pulls is known to a share.
const NEARER: f64 = 0.5;
const PULL_SD: f64 = 0.5;
/// A point in the place of light that is spread is off by this share of the variance over the same distance: as far as
/// errors of time and of variance go together.
const NARROWER: f64 = 0.25;
/// No light of a profile comes before that of so few bounces.
const EARLIEST: i32 = 2;

/// Extent of the patches, as far as it is known.
pub struct Extents {
    pub footprints: Footprints,
    /// Of each onset, what other light in it adds to its length.
    pub pulls: Vec<Pull>,
}

impl Extents {
    /// Those `given`, and what the widths of onsets tell of patches without one.
    ///
    /// An onset that is wider than its patches make it has other light in it. Onsets of first and second bounces may
    /// have companions ([`companion`]), of which all places are known. What these do not explain is light of a path
    /// that nothing is known of: one of a share f that comes D later adds f (1 - f) D^2 to the variance, and f D to the
    /// time: about V / D for a variance V. Third bounces it may pull either way.
    pub fn new(model: &Model, problem: &Problem, solution: &Solution, given: &Footprints) -> Self {
        let widths = Widths::new(model, problem, solution);
        let held: Vec<_> = model.patches.iter().map(|patch| given.0.get(patch).copied()).collect();
        let sizes = footprint::from_widths(&widths.spreads, &held, &model.context.cancel);
        let of_patch = |(patch, estimate): (&_, Option<_>)| Some((*patch, estimate?));
        let footprints = Footprints(model.patches.iter().zip(sizes.footprints).filter_map(of_patch).collect());
        let companions = Companions::new(model, &solution.points, widths.resolved_ps);
        let of_widths = || widths.labels.iter().zip(&widths.spreads).zip(&sizes.excess_m2);
        let onset = |((place, spread), variance_m2): ((&usize, &Spread), &f64)| {
            let label = &model.labels[*place];
            let sd_m2 = if spread.is_limit { spread.variance_m2.hypot(spread.sd_m2) } else { spread.sd_m2 };
            let excess = Excess { variance_m2: *variance_m2, sd_m2 };
            let of_label = if is_earliest(label) { companions.of(label) } else { Vec::new() };
            Onset { companions: of_label, least: companions.least(label), excess }
        };
        let of_companions = companion::pulls(&of_widths().map(onset).collect::<Vec<_>>());
        let mut pulls = vec![Pull::default(); model.labels.len()];
        for (((place, spread), variance_m2), of_companions) in of_widths().zip(of_companions) {
            let label = &model.labels[*place];
            let apart_m = model.fields(label).medium.path_m(NEARER * widths.resolved_ps);
            let more_m = f64::max(0.0, variance_m2 - of_companions.variance_m2 - spread.sd_m2) / apart_m;
            // The samples were explained by a point. What its patches spread moves that point.
            let less_m = if spread.is_limit { NARROWER * f64::max(0.0, -variance_m2) / apart_m } else { 0.0 };
            pulls[*place] = if is_earliest(label) {
                let sd_m = of_companions.sd_m.hypot(PULL_SD * more_m).hypot(less_m);
                Pull { mean_m: of_companions.mean_m + more_m, sd_m, ..of_companions }
            } else {
                Pull { sd_m: more_m.hypot(less_m), ..of_companions }
            };
        }
        share(model.labels, &mut pulls);
        Self { footprints, pulls }
    }
}

/// Whether no light of a profile comes before an onset's.
fn is_earliest(label: &Label) -> bool {
    label.bounces <= EARLIEST
}

/// Whether light of an onset of first or second bounces lies apart from all other light of its profile. An onset
/// without a path, which is among no labels, leaves a gap in the ranks.
fn is_alone(label: &Label, profile: &[&Label], apart_ps: f64) -> bool {
    let is_far = |other: &&Label| other.rank == label.rank || (other.time_ps - label.time_ps).abs() > apart_ps;
    let has = |rank: i32| profile.iter().any(|other| other.rank == rank);
    let is_last = profile.iter().all(|other| other.rank <= label.rank);
    is_earliest(label)
        && profile.iter().all(is_far)
        && (label.rank == 1 || has(label.rank - 1))
        && (is_last || has(label.rank + 1))
}

/// Light that goes a path both ways, or is recorded in several ranges, has the same other light in it. So onsets of one
/// path share the error of their pull: each has the variance of all together.
fn share(labels: &[Label], pulls: &mut [Pull]) {
    let one_way = |label: &Label| {
        let there = label.path.clone().unwrap_or_default();
        let back: Vec<PatchId> = there.iter().rev().copied().collect();
        there.min(back)
    };
    let mut counts: BTreeMap<Vec<PatchId>, f64> = BTreeMap::new();
    labels.iter().for_each(|label| *counts.entry(one_way(label)).or_default() += 1.0);
    for (label, pull) in labels.iter().zip(pulls) {
        pull.sd_m *= counts[&one_way(label)].sqrt();
    }
}

/// Widths of onsets.
#[derive(Default)]
struct Widths {
    /// Places of the onsets that may have a width among the labels.
    labels: Vec<usize>,
    /// Their spreads.
    spreads: Vec<Spread>,
    /// How far apart pulses are that make two onsets, about: twice the response's standard deviation. It is also the
    /// error of an onset's variance over that of its time.
    resolved_ps: f64,
}

impl Widths {
    /// None where no onset has a width.
    fn new(model: &Model, problem: &Problem, solution: &Solution) -> Self {
        let variance_sd_ps2 =
            |label: &Label| Some(2.0 * label.width_ps? * label.width_sd_ps?).filter(|sd_ps2| *sd_ps2 > 0.0);
        if model.labels.iter().all(|label| variance_sd_ps2(label).is_none()) {
            return Self::default();
        }
        // Without a calibration the errors tell. Those of strong onsets are not of this kind.
        let of_errors_ps = |label: &Label| Some(variance_sd_ps2(label)? / label.time_sd_ps);
        let of_response_ps = |label: &Label| Some(RESOLVED * model.context.response_width_ps(label)?);
        let largest_ps = |of: &dyn Fn(&Label) -> Option<f64>| model.labels.iter().filter_map(of).reduce(f64::max);
        let resolved_ps = largest_ps(&of_response_ps).or_else(|| largest_ps(&of_errors_ps)).unwrap_or_default();
        let profiles = companions::profiles(model.labels);
        let is_alone = |label: &Label| is_alone(label, &profiles[&companions::key(label)], ALONE * resolved_ps);
        let spread = |(n, label): (usize, &Label)| {
            let width_ps = label.width_ps?;
            let own_sd_ps2 = variance_sd_ps2(label);
            let [unfitted, unseen] = if is_alone(label) { [1.0, UNSEEN_ALONE] } else { [UNFITTED, UNSEEN] };
            let sd_ps2 = own_sd_ps2.unwrap_or(unfitted * resolved_ps * label.time_sd_ps);
            let fitted_ps2 = label.own_variance_ps2.unwrap_or(width_ps * width_ps);
            let variance_ps2 = if own_sd_ps2.is_some() { fitted_ps2 } else { unseen * sd_ps2 };
            let squared_m2 = model.fields(label).medium.path_m(1.0).powi(2);
            let bounces = bounces(&problem.observations[n].nodes, solution);
            let kurtosis = label.width_kurtosis.unwrap_or_default();
            let of_disks = of_disks(variance_ps2, kurtosis, bounces.len(), (0.5 * resolved_ps).powi(2));
            let spread = Spread {
                bounces,
                variance_m2: squared_m2 * variance_ps2 * of_disks,
                sd_m2: squared_m2 * (sd_ps2 * of_disks).hypot(SHAPE_SD * variance_ps2),
                is_limit: own_sd_ps2.is_none(),
            };
            Some((n, spread))
        };
        let (labels, spreads) = model.labels.iter().enumerate().filter_map(spread).unzip();
        Self { labels, spreads, resolved_ps }
    }
}

/// Variance of light from so many disks over that of the spread of excess kurtosis `kurtosis` which fits their pulse
/// best, behind a response of this variance.
///
/// Arrivals from a disk of variance V have the fourth cumulant `-V^2`, from n disks that have equal shares of V an n-th
/// of that. By the Fourier transform of a pulse to that order, least squares with a Gaussian make of it a variance that
/// is larger by `V^2 / (4 n (V + response))`, by higher orders 0.3 in the place of the quarter; with another spread by
/// what their fourth cumulants differ.
fn of_disks(fitted_ps2: f64, kurtosis: f64, disks: usize, response_ps2: f64) -> f64 {
    if fitted_ps2 <= 0.0 {
        return 1.0;
    }
    let squared = 1.0 + 0.3 * (1.0 / disks.max(1) as f64 + kurtosis);
    let half_ps2 = 0.5 * (fitted_ps2 - response_ps2);
    let root_ps2 = (half_ps2 * half_ps2 + squared * fitted_ps2 * response_ps2).sqrt();
    (half_ps2 + root_ps2) / (squared * fitted_ps2)
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Least squares of a Gaussian on a pulse of light from a disk, both behind a Gaussian response of variance 1.
    #[test]
    fn variances_of_disks_are_told_from_those_of_gaussians() {
        let gauss = |t: f64, variance: f64| (-0.5 * t * t / variance).exp() / variance.sqrt();
        let times: Vec<f64> = (-600..=600).map(|n| 0.02 * f64::from(n)).collect();
        for variance in [0.1, 0.3, 1.0_f64] {
            // Chords of a disk of radius `2 sd`.
            let radius = 2.0 * variance.sqrt();
            let chords = (1..200).map(|n| radius * (f64::from(n) / 100.0 - 1.0));
            let chords: Vec<(f64, f64)> = chords.map(|at| (at, (radius * radius - at * at).sqrt())).collect();
            let pulse = |t: &f64| chords.iter().map(|(at, light)| light * gauss(t - at, 1.0)).sum::<f64>();
            let pulse: Vec<f64> = times.iter().map(pulse).collect();
            // What of the pulse a Gaussian of this variance explains at its best height.
            let explained = |fitted: f64| {
                let model = || times.iter().map(|t| gauss(*t, 1.0 + fitted));
                let product: f64 = model().zip(&pulse).map(|(a, b)| a * b).sum();
                product * product / model().map(|a| a * a).sum::<f64>()
            };
            let fitted = (1..400).map(|n| variance * (0.8 + 0.002 * f64::from(n)));
            let fitted = fitted.max_by(|a, b| explained(*a).total_cmp(&explained(*b))).unwrap();
            let told = fitted * of_disks(fitted, 0.0, 1, 1.0);
            eprintln!("variance {variance}: fitted {fitted:.3}, told {told:.3}");
            assert!(fitted > 1.01 * variance && (told / variance - 1.0).abs() < 0.03, "{variance} {fitted} {told}");
        }
    }
}
