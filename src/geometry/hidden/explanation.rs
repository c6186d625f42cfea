//! Which paths explain which arrivals, and what that leaves for one more hidden patch.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::climb::{Estimate, GATE, View};
use super::search::Domain;
use super::superposition::{self, Pair};
use super::surface::Surface;
use super::{Hidden, Path, Profile, Room, Solution, Way, blend};
use crate::Point;

/// Where arrivals blend, a patch that shows on a smaller share of the ways that are clear is none.
const LEAST_SEEN: f64 = 0.3;
/// A path that is seen with a larger chance is rather seen than not.
const LIKELY: f64 = 0.5;
/// Points along each axis that the volume is counted by.
const VOLUME_POINTS: i32 = 16;

/// Which paths keep an arrival from minimal sets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Claims {
    /// All.
    All,
    /// Those over patches in place that are more likely seen than not, and those over hidden surfaces: many that are
    /// seldom seen may claim each arrival between them.
    Likely,
}

/// Paths over patches in place and over hidden surfaces, and the arrivals that they explain.
pub(super) struct Explanation<'a> {
    given: &'a [Profile],
    /// The same; arrivals that may be blends err by more.
    pub(super) profiles: Vec<Profile>,
    pub(super) room: &'a Room,
    /// Probability that a patch shows in the profiles of a seen patch at all.
    pub(super) shown: f64,
    pub(super) domain: Domain,
    /// Log of the volume (in flatland area) of the places of patches, and of planes.
    log_volumes: [f64; 2],
    /// Usual standard deviation of an arrival.
    pub(super) sd_m: f64,
    pub(super) clutter_per_m: f64,
    /// Hidden surfaces: patches and planes.
    pub(super) surfaces: Vec<Hidden>,
    /// For each profile its paths and arrivals that may belong together.
    pairs: Vec<Vec<Pair>>,
    /// What all paths leave of each arrival of each profile.
    left: Vec<Vec<f64>>,
}

impl<'a> Explanation<'a> {
    /// Without any patch; `None` without arrivals.
    pub(super) fn new(profiles: &'a [Profile], room: &'a Room, shown: f64) -> Option<Self> {
        let mut sds: Vec<f64> =
            profiles.iter().flat_map(|profile| &profile.arrivals).map(|arrival| arrival.sd_m).collect();
        sds.sort_by(f64::total_cmp);
        let sd_m = *sds.get(sds.len() / 2)?;
        let middle = room.foci.iter().map(|focus| focus.point.coords).sum::<Vector3<f64>>() / room.foci.len() as f64;
        // Of a patch further out than that every path would be longer than any record.
        let longest =
            |profile: &Profile| profile.ways.iter().map(|way| profile.span_m[1] - way.offset_m).reduce(f64::max);
        let longest_m = profiles.iter().filter_map(longest).fold(0.0, f64::max);
        let domain = Domain { centre: Point::from(middle), half_m: 0.5 * longest_m, dimensions: room.dimensions };
        let span_m: f64 = profiles.iter().map(|profile| profile.span_m[1] - profile.span_m[0]).sum();
        let arrivals: usize = profiles.iter().map(|profile| profile.arrivals.len()).sum();
        let mut all = Self {
            given: profiles,
            profiles: profiles.to_vec(),
            room,
            shown,
            log_volumes: [0.0; 2],
            domain,
            sd_m,
            clutter_per_m: (arrivals + 1) as f64 / span_m,
            surfaces: Vec::new(),
            pairs: Vec::new(),
            left: Vec::new(),
        };
        all.log_volumes = [Surface::Patch, all.plane()].map(|surface| all.volume(surface).ln());
        // Paths over patches in place leave less clutter than all arrivals would be.
        (0..2).for_each(|_| all.settle());
        Some(all)
    }

    /// Any plane.
    pub(super) const fn plane(&self) -> Surface {
        Surface::Plane { middle: self.domain.centre }
    }

    /// Number of ways of all profiles.
    pub(super) fn ways(&self) -> usize {
        self.profiles.iter().map(|profile| profile.ways.len()).sum()
    }

    /// Whether profiles have several ways, so that many of them repeat the same lengths.
    pub(super) fn is_layered(&self) -> bool {
        self.profiles.iter().any(|profile| profile.ways.len() > 1)
    }

    /// Volume of the places of a surface that enough ways could have recorded.
    fn volume(&self, surface: Surface) -> f64 {
        let n = VOLUME_POINTS;
        let (step_m, flat) = (2.0 * self.domain.half_m / f64::from(n), self.domain.dimensions == 2);
        let at = |k: i32| (f64::from(k) + 0.5) * step_m - self.domain.half_m;
        let least = surface.share() * self.ways() as f64;
        let is_recorded = |point: &Point| {
            self.room.cancel.check();
            let is_in = |(profile, way): &(&Profile, &Way)| {
                let legs = surface.way(way.foci.map(|focus| &self.room.foci[focus]), *point);
                legs.is_some_and(|(length_m, _)| way.offset_m + length_m <= profile.span_m[1])
            };
            let all = self.profiles.iter().flat_map(|profile| profile.ways.iter().map(move |way| (profile, way)));
            self.domain.holds(*point, 0.0) && all.filter(is_in).count() as f64 > least
        };
        let depth = if flat { 1 } else { n };
        let grid = (0..n).flat_map(|i| (0..n).flat_map(move |j| (0..depth).map(move |k| (i, j, k))));
        let points =
            grid.map(|(i, j, k)| self.domain.centre + Vector3::new(at(i), at(j), if flat { 0.0 } else { at(k) }));
        let count = points.filter(is_recorded).count().max(1);
        count as f64 * step_m.powi(self.domain.dimensions as i32)
    }

    /// Which path made which arrival, and how much clutter that leaves.
    pub(super) fn settle(&mut self) {
        let mut profiles = std::mem::take(&mut self.profiles);
        let settle = |(profile, given): (&mut Profile, &Profile)| {
            let paths = self.paths(given);
            let pairs = self.pairs_of(given, &paths);
            if self.room.blend_m == 0.0 {
                return pairs;
            }
            profile.set_sds(&blend::widened(&given.arrivals, &paths, &pairs, self.room.blend_m));
            self.pairs_of(profile, &paths)
        };
        let pairs = profiles.par_iter_mut().zip(self.given).map(settle).collect();
        (self.profiles, self.pairs) = (profiles, pairs);
        self.left = self.left_by(|_, _| true);
        self.count_clutter();
    }

    /// Takes what one more surface claims off what is left, without settling all messages again.
    pub(super) fn claim(&mut self, hidden: &Hidden) {
        let mut left = std::mem::take(&mut self.left);
        for (profile, left) in self.profiles.iter().zip(&mut left) {
            for path in self.ways_over(hidden, profile) {
                let odds: Vec<(usize, f64)> = self.odds(profile, &path).collect();
                let whole: f64 = 1.0 + odds.iter().map(|(arrival, odds)| odds * left[*arrival]).sum::<f64>();
                for (arrival, odds) in odds {
                    let left = &mut left[arrival];
                    *left /= 1.0 + *left * odds / (whole - odds * *left);
                }
            }
        }
        self.left = left;
        self.count_clutter();
    }

    fn count_clutter(&mut self) {
        let span_m: f64 = self.profiles.iter().map(|profile| profile.span_m[1] - profile.span_m[0]).sum();
        let unexplained: f64 = self.left.iter().flatten().sum();
        self.clutter_per_m = (unexplained + 1.0) / span_m;
    }

    /// The paths of a profile: those over patches in place, then the ways over each hidden surface.
    fn paths(&self, profile: &Profile) -> Vec<Path> {
        let hidden = self.surfaces.iter().flat_map(|hidden| self.ways_over(hidden, profile));
        profile.paths.iter().copied().chain(hidden).collect()
    }

    /// The ways of a profile over a hidden surface; never seen, where no light goes there.
    fn ways_over<'b>(&'b self, hidden: &'b Hidden, profile: &'b Profile) -> impl Iterator<Item = Path> + 'b {
        profile.ways.iter().map(|way| {
            let foci = way.foci.map(|focus| &self.room.foci[focus]);
            match hidden.surface.way(foci, hidden.point) {
                Some((legs_m, _)) => Path { length_m: way.offset_m + legs_m, sd_m: way.sd_m, seen: hidden.seen },
                None => Path { length_m: 0.0, sd_m: 0.0, seen: 0.0 },
            }
        })
    }

    fn pairs_of(&self, profile: &Profile, paths: &[Path]) -> Vec<Pair> {
        self.room.cancel.check();
        let mut pairs = Vec::new();
        for (n, path) in paths.iter().enumerate() {
            pairs.extend(self.odds(profile, path).map(|(arrival, odds)| Pair::new(n, arrival, odds)));
        }
        superposition::settle(&mut pairs, paths.len(), profile.arrivals.len());
        pairs
    }

    /// Arrivals that a path may have made, each with the odds that it did.
    fn odds<'b>(&self, profile: &'b Profile, path: &Path) -> impl Iterator<Item = (usize, f64)> + 'b {
        let Path { length_m, sd_m, seen } = *path;
        let scale = seen / (1.0 - seen);
        let clutter_per_m = self.clutter_per_m;
        let reach_m = GATE * (profile.widest_m * profile.widest_m + sd_m * sd_m).sqrt();
        let from = profile.arrivals.partition_point(|arrival| arrival.length_m < length_m - reach_m);
        let near = profile.arrivals.iter().enumerate().skip(from);
        near.take_while(move |(_, at)| at.length_m - length_m <= reach_m).map(move |(arrival, at)| {
            let (off_m, sd_m) = (at.length_m - length_m, at.sd_m.hypot(sd_m));
            let density = (-0.5 * (off_m / sd_m).powi(2)).exp() / ((2.0 * std::f64::consts::PI).sqrt() * sd_m);
            (arrival, scale * density / clutter_per_m)
        })
    }

    /// What all paths leave of each arrival.
    pub(super) fn left(&self) -> &[Vec<f64>] {
        &self.left
    }

    /// What all paths but those over one surface leave of each arrival.
    pub(super) fn left_for(&self, surface: usize) -> Vec<Vec<f64>> {
        let mut left = self.left.clone();
        for (profile, (pairs, left)) in self.profiles.iter().zip(self.pairs.iter().zip(&mut left)) {
            let (first, ways) = (profile.paths.len() + surface * profile.ways.len(), profile.ways.len());
            superposition::give_back(pairs, [first, first + ways], left);
        }
        left
    }

    /// What is left for minimal sets.
    pub(super) fn left_of(&self, claims: Claims) -> Vec<Vec<f64>> {
        match claims {
            Claims::All => self.left.clone(),
            Claims::Likely => {
                self.left_by(|profile, path| profile.paths.get(path).is_none_or(|path| path.seen > LIKELY))
            }
        }
    }

    fn left_by(&self, counts: impl Fn(&Profile, usize) -> bool) -> Vec<Vec<f64>> {
        let of_profile = |(profile, pairs): (&Profile, &Vec<Pair>)| {
            superposition::left_over(pairs, profile.arrivals.len(), |path| counts(profile, path))
        };
        self.profiles.iter().zip(&self.pairs).map(of_profile).collect()
    }

    pub(super) fn view<'b>(&'b self, surface: Surface, left: &'b [Vec<f64>], seen: f64) -> View<'b> {
        View {
            foci: &self.room.foci,
            profiles: &self.profiles,
            left,
            clutter_per_m: self.clutter_per_m,
            seen,
            shown: self.shown,
            dimensions: self.room.dimensions,
            surface,
            blend_m: self.room.blend_m,
            cancel: &self.room.cancel,
        }
    }

    /// Bayes factor of a place over none, as its log; `None` outside the volume, where arrivals leave it open, and
    /// where too few show it.
    pub(super) fn hidden(&self, place: Estimate, seen: f64) -> Option<Hidden> {
        if place.ways as f64 <= place.surface.share() * self.ways() as f64 {
            return None;
        }
        // What blends leave unexplained is no chance: it gathers where ways are not clear and so cost nothing.
        if self.room.blend_m > 0.0 && place.arrivals < LEAST_SEEN * place.clear {
            return None;
        }
        let mut information = place.information;
        if self.room.dimensions == 2 {
            for k in 0..2 {
                information[(2, k)] = 0.0;
                information[(k, 2)] = 0.0;
            }
            information[(2, 2)] = 1.0;
        }
        let mut covariance = information.try_inverse()?;
        let determinant = covariance.determinant();
        if determinant.is_nan() || determinant <= 0.0 {
            return None;
        }
        if self.room.dimensions == 2 {
            covariance[(2, 2)] = 0.0;
        }
        // Where visible patches are nearly in line, the arrivals leave a long arc: no more of it than there is room.
        let width = 0.5 * (determinant.ln() + self.room.dimensions as f64 * (2.0 * std::f64::consts::PI).ln());
        let evidence = place.likelihood + (width - self.log_volume(place.surface)).min(0.0);
        Some(Hidden {
            surface: place.surface,
            point: place.point,
            covariance,
            evidence,
            seen,
            arrivals: place.arrivals,
        })
    }

    const fn log_volume(&self, surface: Surface) -> f64 {
        match surface {
            Surface::Patch => self.log_volumes[0],
            Surface::Plane { .. } => self.log_volumes[1],
        }
    }

    /// No patch is sure below this likelihood, however well its arrivals determine it.
    pub(super) fn least_likelihood(&self) -> f64 {
        let stiffest = 4.0 * self.ways() as f64 / (self.sd_m * self.sd_m);
        let width = 0.5 * self.room.dimensions as f64 * (2.0 * std::f64::consts::PI / stiffest).ln();
        self.log_volume(Surface::Patch) - width - self.room.false_alarm.ln()
    }

    /// All patches, the surest first, each with its rival, and all planes.
    pub(super) fn solution(&self) -> Solution {
        let (patches, planes): (Vec<usize>, Vec<usize>) =
            (0..self.surfaces.len()).partition(|&n| self.surfaces[n].surface == Surface::Patch);
        let mut patches: Vec<(Hidden, Option<Hidden>)> =
            patches.into_iter().map(|n| (self.surfaces[n], self.rival(n))).collect();
        patches.sort_by(|a, b| b.0.evidence.total_cmp(&a.0.evidence));
        patches.truncate(self.room.count.unwrap_or(usize::MAX));
        let (patches, rivals) = patches.into_iter().unzip();
        Solution { patches, rivals, planes: planes.into_iter().map(|n| self.surfaces[n]).collect(), declined: None }
    }

    pub(super) fn is_sure(&self, hidden: &Hidden) -> bool {
        hidden.evidence > -self.room.false_alarm.ln() && self.domain.holds(hidden.point, 0.0)
    }
}
