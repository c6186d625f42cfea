//! Whether points are what the histograms show.

use std::f64::consts::SQRT_2;

use super::background::PLAIN;
use super::extent::{Extent, extents};
use super::fit::{Fit, Free, place_covariance};
use super::model::{EDGE, Model};
use super::rounds::{FIRST, MANY, MOST, Search, search, settle};
use super::split::split;
use super::volume::Lattice;
use super::{HiddenPoint, Histogram, Outcome, Problem, Verdict};

/// Shares of points that reappear in halves from which on points are accepted, and up to which they are refused.
const REAPPEAR: [f64; 2] = [0.7, 0.5];
/// A point reappears within so many standard deviations of both places, and this distance.
const NEAR_SD: f64 = 4.0;
const NEAR_M: f64 = 1e-3;
/// A point can be found anew in a half where its z is expected to exceed the threshold by this factor.
const BRIGHT: f64 = 1.3;
/// Share of the threshold down to which a half is searched from nothing.
const BLIND: f64 = 0.9;
/// Share of a half's threshold down to which its points count.
const LOOSE: f64 = 0.5;
/// Points whose ways differ by less than a width in this share of the histograms are not resolved; so many of them
/// together may be a surface.
const BLENDED: f64 = 0.5;
const CROWD: usize = 4;
/// A point with less than this share of another's photons that follows it by the same length, within this many widths,
/// is its tail.
const FOLLOWS: [f64; 2] = [0.25, 0.5];
/// Root of the mean square of the distances in a point's light across the wall, in widths of the response, above which
/// it is a surface where it exceeds so many standard deviations, and from which on a surface is not excluded.
const SIZE: f64 = 0.35;
const SIZE_SD: f64 = 4.0;
const LARGE: f64 = 1.0;
/// Light that exceeds the threshold by this factor is of something, though of no point.
const CLEAR: f64 = 2.0;
/// Scatter of arrivals, in widths of the response, above which they are not those of points on this wall.
const SCATTER: f64 = 0.5;

/// Searches for small hidden things, and judges them.
///
/// Of very many histograms a part is searched first: a surface shows there too, and points give the rest its start.
#[must_use]
pub fn joint_search(problem: &Problem) -> Outcome {
    let lattice = Lattice::new(problem);
    let threshold = (2.0 * (lattice.cells() as f64 / problem.false_alarm).ln()).sqrt();
    let mut model = Model::default();
    if problem.histograms.len() >= MANY {
        let part = problem.part(FIRST);
        let first = search(&part, &lattice, [threshold; 2], model);
        let outcome;
        (outcome, model) = judged(&part, &lattice, threshold, first);
        if outcome.verdict == Verdict::ExtendedObject {
            return outcome;
        }
    }
    let whole = search(problem, &lattice, [threshold; 2], model);
    judged(problem, &lattice, threshold, whole).0
}

/// What a search comes to, and the model behind it.
fn judged(problem: &Problem, lattice: &Lattice, threshold: f64, mut whole: Search) -> (Outcome, Model) {
    let mut all = points(&whole.fit, whole.misfit.factor);
    let mut share = None;
    let (verdict, reason) = if whole.too_many {
        (Verdict::ExtendedObject, format!("more than {MOST} points would be needed"))
    } else if all.is_empty() {
        dark(whole.sure, threshold)
    } else {
        let mut least = reappear(problem, lattice, threshold, (&whole, &mut all));
        let mut answer = judge(problem, &whole, least);
        // Points closer together than the response resolves; of very many histograms they are split in the first part.
        // Two that are taken for one do not reappear where halves have their middle elsewhere.
        if problem.histograms.len() < MANY {
            let fit = split(problem, whole.fit.clone(), threshold);
            let settled = (fit.model.dots.len() > all.len()).then(|| settle(problem, fit, threshold));
            // Of a surface nothing may be left.
            if let Some((fit, misfit)) = settled.filter(|(fit, _)| fit.model.dots.len() > all.len()) {
                whole = Search { fit, misfit, ..whole };
                all = points(&whole.fit, whole.misfit.factor);
                least = if least >= REAPPEAR[0] {
                    least.min(remain(problem, threshold, (&whole, &mut all)))
                } else {
                    reappear(problem, lattice, threshold, (&whole, &mut all))
                };
                answer = judge(problem, &whole, least);
            }
        }
        share = Some(least);
        // What only one half shows is no point.
        all.retain(|point| answer.0 != Verdict::Points || point.reappears);
        answer
    };
    let stretch = whole.fit.shine.pulse.stretch();
    let model = whole.fit.model;
    let outcome = Outcome {
        verdict,
        reason,
        points: all,
        reappear: share,
        cells: lattice.cells(),
        threshold,
        largest: whole.largest,
        misfit: whole.misfit.factor,
        scatter_m: whole.misfit.scatter_m,
        own_misfit: whole.misfit.own,
        power: model.shared[0],
        stretch,
    };
    (outcome, model)
}

/// What it means that no point is left: light that exceeds noise by far, and that no point explains, is no darkness.
fn dark(sure: f64, threshold: f64) -> (Verdict, String) {
    let text = format!("no point has a z of {threshold:.1}");
    if sure < threshold {
        return (Verdict::Nothing, text);
    }
    let text = format!("{text}, but light exceeds noise by {sure:.1} standard deviations");
    (if sure < CLEAR * threshold { Verdict::CannotTell } else { Verdict::ExtendedObject }, text)
}

/// Points with their covariances; those without are left out.
fn points(fit: &Fit, misfit: f64) -> Vec<HiddenPoint> {
    let Some(covariance) = fit.covariance() else { return Vec::new() };
    let z = fit.z();
    let point = |k: usize| HiddenPoint {
        place: fit.model.dots[k].place,
        covariance_m2: place_covariance(&covariance, k) * misfit,
        photons: fit.model.dots[k].log_photons.exp(),
        z: z[k],
        reappears: false,
    };
    (0..z.len()).map(point).collect()
}

/// Share of the points that reappear in halves of the histograms, which are searched by themselves.
///
/// Half of the light has a z that is smaller by the root of 2. Points that would then be near the threshold or below
/// may not be found anew: they reappear where a half that starts from all points keeps them in place. The share is the
/// smaller one of that of all points and that of the points that can be found anew.
fn reappear(
    problem: &Problem,
    lattice: &Lattice,
    threshold: f64,
    (whole, points_of_whole): (&Search, &mut [HiddenPoint]),
) -> f64 {
    let bright = BRIGHT * SQRT_2 * threshold * whole.misfit.factor.sqrt();
    let (mut counts, mut sums) = ([0_usize; 2], [0_usize; 2]);
    // Where the whole has points that are not resolved, a half may find them as one, or as two by its width.
    let is_close = gaps_m(problem, &whole.fit).iter().any(|gap_m| gap_m.is_finite());
    let halves = [0, 1].map(|half| {
        let half = problem.half(half);
        let goals = [BLIND * threshold, threshold];
        // Of many histograms a part is searched from nothing; the rest of the half refines it.
        let model = if half.histograms.len() >= MANY {
            search(&half.part(FIRST), lattice, goals, Model::default()).fit.model
        } else {
            Model::default()
        };
        let blind = search(&half, lattice, goals, model);
        let mut anew = points(&blind.fit, blind.misfit.factor);
        if is_close && half.histograms.len() < MANY {
            let fit = split(&half, blind.fit.clone(), threshold);
            if fit.model.dots.len() > anew.len() {
                let (fit, misfit) = settle(&half, fit, goals[0]);
                anew.extend(points(&fit, misfit.factor));
            }
        }
        let (kept, log_likelihood) = stay(&half, threshold, &whole.fit, blind.misfit.factor);
        // A search from nothing that ends at a clearly worse fit says nothing against the points of a better one.
        if log_likelihood > blind.fit.normal.log_likelihood + threshold * threshold {
            anew.extend(kept.iter().cloned());
        }
        [anew, kept]
    });
    for point in points_of_whole {
        let is_bright = point.z > bright;
        let is_in = halves.each_ref().map(|[blind, kept]| {
            let others = if is_bright { blind } else { kept };
            others.iter().any(|other| is_near(point, other))
        });
        let count = is_in.iter().filter(|is| **is).count();
        point.reappears = count == 2;
        counts[0] += 2;
        sums[0] += count;
        if is_bright {
            counts[1] += 2;
            sums[1] += count;
        }
    }
    let share = |n: usize| if counts[n] > 0 { sums[n] as f64 / counts[n] as f64 } else { 1.0 };
    share(0).min(share(1))
}

/// Points of a half that starts from all points of the whole, and their log-likelihood.
fn stay(half: &Problem, threshold: f64, whole: &Fit, misfit: f64) -> (Vec<HiddenPoint>, f64) {
    let levels = vec![PLAIN; half.histograms.len()];
    let fit = Fit::new(half, whole.tail.clone(), whole.model.clone(), &levels).climb(half, Free::All).eliminate(
        half,
        LOOSE * threshold / SQRT_2,
        Free::All,
    );
    (points(&fit, misfit), fit.normal.log_likelihood)
}

/// Share of the points that stay in halves that start from all of them.
fn remain(problem: &Problem, threshold: f64, (whole, points_of_whole): (&Search, &mut [HiddenPoint])) -> f64 {
    let halves = [0, 1].map(|half| stay(&problem.half(half), threshold, &whole.fit, whole.misfit.factor).0);
    let mut count = 0;
    for point in &mut *points_of_whole {
        let is_in = halves.each_ref().map(|half| half.iter().any(|other| is_near(point, other)));
        point.reappears = is_in[0] && is_in[1];
        count += is_in.iter().filter(|is| **is).count();
    }
    count as f64 / (2 * points_of_whole.len()).max(1) as f64
}

/// Whether a point of a half lies where a point of the whole does.
fn is_near(point: &HiddenPoint, other: &HiddenPoint) -> bool {
    let off = other.place - point.place;
    let sd_m = off
        .try_normalize(f64::MIN_POSITIVE)
        .map_or(0.0, |along| (along.transpose() * other.covariance_m2 * along)[(0, 0)].max(0.0).sqrt());
    off.norm() < (NEAR_SD * sd_m).max(NEAR_M)
}

fn judge(problem: &Problem, whole: &Search, share: f64) -> (Verdict, String) {
    let percent = 100.0 * share;
    let stretch = whole.fit.shine.pulse.stretch();
    let strain = whole.fit.model.strain(stretch);
    if share <= REAPPEAR[1] {
        return (Verdict::ExtendedObject, format!("{percent:.0} % of the points reappear in halves of the histograms"));
    }
    if strain[1] > EDGE {
        return (Verdict::ExtendedObject, format!("pulses are {stretch:.2} times as wide as the response"));
    }
    if share < REAPPEAR[0] {
        let text = format!("only {percent:.0} % of the points reappear in halves of the histograms");
        return (Verdict::CannotTell, text);
    }
    if strain[0] > EDGE {
        let power = whole.fit.model.shared[0];
        return (Verdict::CannotTell, format!("light would fall off with the power {power:.1} of the distance"));
    }
    if let Some(answer) = sized(problem, &whole.fit) {
        return answer;
    }
    if let Some([weak, strong]) = follower(problem, &whole.fit) {
        let text = format!("point {} follows point {} as a tail of the response would", weak + 1, strong + 1);
        return (Verdict::CannotTell, text);
    }
    let crowd = crowd(problem, &whole.fit);
    if crowd >= CROWD {
        let text = format!("{crowd} points lie closer together than the response resolves, as on a surface");
        return (Verdict::CannotTell, text);
    }
    let scatter = whole.misfit.scatter_m / problem.pulse.width_m();
    if scatter > SCATTER {
        let text = format!("arrivals scatter by {:.0} % of the response's width", 100.0 * scatter);
        return (Verdict::CannotTell, text);
    }
    (Verdict::Points, format!("{percent:.0} % of the points reappear in halves of the histograms"))
}

/// What the sizes of the points say against points.
fn sized(problem: &Problem, fit: &Fit) -> Option<(Verdict, String)> {
    let extents = extents(problem, fit);
    let width_m = problem.pulse.width_m();
    let [size, large] = [SIZE, LARGE].map(|size| (size * width_m).powi(2));
    let precision: f64 = extents.iter().map(|one| one.sd_m2.powi(-2)).sum();
    let mean = extents.iter().map(|one| one.square_m2 * one.sd_m2.powi(-2)).sum::<f64>() / precision;
    let all = Extent { square_m2: mean, sd_m2: precision.sqrt().recip() };
    let is_wide = |one: &Extent| one.square_m2 > size && one.square_m2 > SIZE_SD * one.sd_m2;
    let across_mm = |one: &Extent| 1e3 * one.square_m2.sqrt();
    if is_wide(&all) {
        return Some((Verdict::ExtendedObject, format!("points are {:.0} mm across (rms)", across_mm(&all))));
    }
    if let Some(n) = extents.iter().position(is_wide) {
        let text = format!("point {} is {:.0} mm across (rms)", n + 1, across_mm(&extents[n]));
        return Some((Verdict::ExtendedObject, text));
    }
    let is_open = |one: &Extent| one.square_m2 + 2.0 * one.sd_m2 > large;
    if let Some(n) = extents.iter().position(is_open) {
        let most_mm = 1e3 * (extents[n].square_m2 + 2.0 * extents[n].sd_m2).sqrt();
        let text =
            format!("point {} is too faint to be told from a surface: up to {most_mm:.0} mm across (rms)", n + 1);
        return Some((Verdict::CannotTell, text));
    }
    // Unresolved points whose sizes may fill the gaps between them: a square of this side has a sixth of its square.
    let gaps_m = gaps_m(problem, fit);
    let fills = |n: &usize| extents[*n].square_m2 + 2.0 * extents[*n].sd_m2 > gaps_m[*n].powi(2) / 6.0;
    if let Some(n) = (0..extents.len()).find(fills) {
        let gap_mm = 1e3 * gaps_m[n];
        let text = format!("points {gap_mm:.0} mm apart near point {} may be one surface: too faint to tell", n + 1);
        return Some((Verdict::CannotTell, text));
    }
    let is_narrow = |one: &Extent| -one.square_m2 > size.max(SIZE_SD * one.sd_m2);
    let narrow = extents.iter().position(is_narrow)?;
    Some((Verdict::CannotTell, format!("pulses differ in width: those of point {} are narrower than most", narrow + 1)))
}

/// Whether the response does not resolve two points in most histograms.
fn is_blended(problem: &Problem, fit: &Fit, [a, b]: [usize; 2]) -> bool {
    let dots = &fit.model.dots;
    let lengths_m = problem.histograms.iter().map(|one| [a, b].map(|k| fit.model.way(&dots[k], one).length_m));
    let close = lengths_m.filter(|[a_m, b_m]| (a_m - b_m).abs() < problem.pulse.width_m()).count();
    close as f64 > BLENDED * problem.histograms.len() as f64
}

/// Distance of each point from the nearest one that is not resolved from it; infinite where there is none.
fn gaps_m(problem: &Problem, fit: &Fit) -> Vec<f64> {
    let dots = &fit.model.dots;
    let mut gaps_m = vec![f64::INFINITY; dots.len()];
    for (a, b) in (0..dots.len()).flat_map(|a| (0..a).map(move |b| (a, b))) {
        let gap_m = (dots[a].place - dots[b].place).norm();
        if gap_m < gaps_m[a].max(gaps_m[b]) && is_blended(problem, fit, [a, b]) {
            gaps_m[a] = gaps_m[a].min(gap_m);
            gaps_m[b] = gaps_m[b].min(gap_m);
        }
    }
    gaps_m
}

/// Size of the largest group of points, each closer to another one than the response resolves.
fn crowd(problem: &Problem, fit: &Fit) -> usize {
    let count = fit.model.dots.len();
    let mut groups: Vec<usize> = (0..count).collect();
    for (a, b) in (0..count).flat_map(|a| (0..a).map(move |b| (a, b))) {
        if is_blended(problem, fit, [a, b]) {
            let (from, to) = (groups[a], groups[b]);
            groups.iter_mut().filter(|group| **group == from).for_each(|group| *group = to);
        }
    }
    let size = |group: usize| groups.iter().filter(|other| **other == group).count();
    (0..count).map(size).max().unwrap_or(0)
}

/// A faint point whose light follows that of a bright one by the same time in all histograms: the response may have a
/// tail that the model lacks.
fn follower(problem: &Problem, fit: &Fit) -> Option<[usize; 2]> {
    let dots = &fit.model.dots;
    let pairs = (0..dots.len()).flat_map(|weak| (0..dots.len()).map(move |strong| [weak, strong]));
    let mut faint =
        pairs.filter(|[weak, strong]| dots[*weak].log_photons < dots[*strong].log_photons + FOLLOWS[0].ln());
    faint.find(|pair| {
        let later = |one: &Histogram| {
            let [weak, strong] = pair.map(|k| fit.model.way(&dots[k], one).length_m);
            weak - strong
        };
        let count = problem.histograms.len() as f64;
        let mean = problem.histograms.iter().map(later).sum::<f64>() / count;
        let square = problem.histograms.iter().map(|one| (later(one) - mean).powi(2)).sum::<f64>() / count;
        mean > 0.0 && square.sqrt() < FOLLOWS[1] * problem.pulse.width_m()
    })
}
