//! The problem and its solution as plain values: points, times and numbers of patches.

use crate::Point;
use crate::association::Time;
use crate::hidden::Hidden;
use crate::units::{self, PatchId};

/// What light goes through, and how often the laser sends it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Medium {
    /// Group index.
    pub group_index: f64,
    /// Period of the laser: times are known modulo it. `None` where a record holds all light of one pulse.
    pub repetition_ps: Option<f64>,
}

impl Medium {
    pub(super) fn path_m(self, time_ps: f64) -> f64 {
        units::path_m(time_ps, self.group_index)
    }

    pub(super) fn time_ps(self, path_m: f64) -> f64 {
        units::time_ps(path_m, self.group_index)
    }

    /// The number of laser periods that is nearest to a time; 0 without a period.
    pub(super) fn nearest_turns(self, time_ps: f64) -> i32 {
        self.repetition_ps.map_or(0, |period_ps| (time_ps / period_ps).round() as i32)
    }

    /// Time of `turns` laser periods; 0 without a period.
    #[must_use]
    pub fn turns_ps(self, turns: i32) -> f64 {
        f64::from(turns) * self.repetition_ps.unwrap_or(0.0)
    }
}

/// An onset of a profile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arrival {
    /// Time, modulo the laser's period.
    pub time_ps: f64,
    /// Its standard deviation, with the part that the profile's arrivals share.
    pub sd_ps: f64,
    /// Amplitude, in any unit.
    pub amplitude: f64,
    /// Signal-to-noise ratio of its amplitude.
    pub snr: f64,
    /// Whether another arrival of its profile overlaps it.
    pub blended: bool,
    /// Standard deviation of the spread of its light; 0 for a point.
    pub width_ps: f64,
    /// Standard deviation of `width_ps`.
    pub width_sd_ps: f64,
    /// Two pulses that may stand in its place.
    pub pair: Option<Pair>,
    /// Probability of the reading that it belongs to; 1 for an onset as it is.
    pub certainty: f64,
}

/// Two pulses that may stand in the place of a wide one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// Times, the earlier first, modulo the laser's period.
    pub times_ps: [f64; 2],
    /// Covariance of the times, with the part that the profile's arrivals share: of the first, of both, of the second.
    pub covariance_ps2: [f64; 3],
    /// Signal-to-noise ratios.
    pub snrs: [f64; 2],
    /// Chi-square of the wide pulse less that of the pair.
    pub gain: f64,
}

impl Arrival {
    /// A pulse by itself, no wider than the response; its amplitude is in standard deviations of the noise.
    #[must_use]
    pub const fn point(time_ps: f64, sd_ps: f64, snr: f64) -> Self {
        Self {
            time_ps,
            sd_ps,
            amplitude: snr,
            snr,
            blended: false,
            width_ps: 0.0,
            width_sd_ps: 0.0,
            pair: None,
            certainty: 1.0,
        }
    }

    pub(super) const fn time(&self) -> Time {
        Time { time_ps: self.time_ps, sd_ps: self.sd_ps }
    }

    /// Probability that it is signal and not noise.
    pub(super) fn signal_probability(&self) -> f64 {
        1.0 - (-self.snr * self.snr / 2.0).exp()
    }
}

/// All arrivals from one lit and one seen patch.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    /// Patch that the laser lights.
    pub lit: PatchId,
    /// Patch that the sensor sees.
    pub seen: PatchId,
    /// Delay that calibration left in the times.
    pub delay_ps: f64,
    /// Its standard deviation.
    pub delay_sd_ps: f64,
    /// Arrivals in any order, one at least.
    pub arrivals: Vec<Arrival>,
}

impl Profile {
    /// The path that meets each of its patches once.
    pub(super) fn direct(&self) -> Vec<PatchId> {
        if self.lit == self.seen { vec![self.lit] } else { vec![self.lit, self.seen] }
    }

    pub(super) const fn pair(&self) -> (PatchId, PatchId) {
        (self.lit, self.seen)
    }

    /// Its two patches, the smaller first.
    pub(super) fn sorted_pair(&self) -> (PatchId, PatchId) {
        (self.lit.min(self.seen), self.lit.max(self.seen))
    }

    /// A path back to the lit patch and its reverse are equally long and make one arrival: the smaller stands for both.
    pub(super) fn is_representative<T: Ord>(&self, path: &[T]) -> bool {
        self.lit != self.seen || path.iter().le(path.iter().rev())
    }
}

/// The profiles of one sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorProfiles {
    /// Medium of its campaign.
    pub medium: Medium,
    /// Position of the laser.
    pub source: Point,
    /// Position of the sensor.
    pub sensor: Point,
    /// 3, or 2 for flatland.
    pub dimensions: usize,
    /// Largest number of a patch in its campaign.
    pub largest_patch: PatchId,
    /// Number of hidden patches, if the campaign gives it.
    pub hidden_count: Option<u32>,
    /// One for each pair of a lit and a seen patch.
    pub profiles: Vec<Profile>,
}

impl SensorProfiles {
    pub(super) fn views(&self) -> impl Iterator<Item = View<'_>> {
        self.profiles.iter().map(|profile| View { sensor: self, profile })
    }

    /// Distance between laser and sensor.
    pub(super) fn baseline_m(&self) -> f64 {
        (self.source - self.sensor).norm()
    }
}

/// A profile with the sensor that recorded it.
#[derive(Clone, Copy)]
pub(super) struct View<'a> {
    pub(super) sensor: &'a SensorProfiles,
    pub(super) profile: &'a Profile,
}

impl View<'_> {
    pub(super) const fn medium(&self) -> Medium {
        self.sensor.medium
    }

    /// How far apart two times are, modulo the laser's period.
    pub(super) fn off_ps(&self, a_ps: f64, b_ps: f64) -> f64 {
        let late_ps = a_ps - b_ps;
        (late_ps - self.medium().turns_ps(self.medium().nearest_turns(late_ps))).abs()
    }
}

/// Which hidden patches [`label`](super::label) looks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HiddenPatches {
    /// None.
    None,
    /// Those whose likelihood over all profiles is high enough, their number open ([`crate::hidden`]).
    Search,
    /// Those that the order of arrival in each profile suggests, as in the paper.
    Rank,
}

/// How to label.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Largest order of bounces: to 3 without a scene, to 5 with one.
    pub bounces: usize,
    /// Least probability of a label, with a scene.
    pub probability_min: f64,
    /// Arrivals that no path explains, per nanosecond of a profile; positive.
    pub clutter_per_ns: f64,
    /// No patch is nearer to laser and sensor; matters without a scene where the laser repeats.
    pub near_m: f64,
    /// Hidden patches to look for, with a scene and three or more bounces.
    pub hidden: HiddenPatches,
    /// Probability, at most, of a hidden patch where there is none; and of a plane.
    pub false_alarm: f64,
    /// Pulses of two paths that are nearer than this may make one arrival; 0: none do.
    pub blend_ps: f64,
}

/// One possible origin of an arrival.
#[derive(Clone, Debug, PartialEq)]
pub struct Verdict {
    /// Laser periods to add to its time.
    pub turns: i32,
    /// Patches in the order light meets them; `None`: no path is probable enough.
    pub path: Option<Vec<PatchId>>,
    /// Arrival less prediction; `None` without a prediction.
    pub residual_ps: Option<f64>,
    /// Standard deviation that the light of other paths may add to the arrival's time.
    pub blend_sd_ps: f64,
    /// Probability.
    pub probability: f64,
}

impl Verdict {
    /// The arrival stays without a path.
    pub(super) const fn open() -> Self {
        Self { turns: 0, path: None, residual_ps: None, blend_sd_ps: 0.0, probability: 1.0 }
    }
}

/// What an arrival is of an onset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Origin {
    /// Place of the onset in its profile.
    pub onset: usize,
    /// 0 for all of it, 1 and 2 for the pulses that it is read as.
    pub part: i32,
    /// Of a part, the covariance of its time with that of the other one, ps^2.
    pub with_other_ps2: f64,
}

/// An onset, or a part of it, in the reading that is less likely.
#[derive(Clone, Debug, PartialEq)]
pub struct Loser {
    /// What it is of the onset.
    pub origin: Origin,
    /// Time, modulo the laser's period.
    pub time_ps: f64,
    /// Its standard deviation.
    pub sd_ps: f64,
    /// Its likeliest path; the probability is that of the reading.
    pub verdict: Verdict,
}

/// For each profile of a sensor, for each arrival, its verdicts: the label first, then alternatives.
pub type Verdicts = Vec<Vec<Vec<Verdict>>>;

/// A hidden surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hypothesis {
    /// 1: visible patches show it. 2: only hidden patches do.
    pub layer: i32,
    /// Number of the patch; `None` for a plane and for a place that is not sure enough.
    pub patch: Option<PatchId>,
    /// Where it is.
    pub surface: Hidden,
    /// Its mirror image in the wall that shows it, where the arrivals do not rule it out.
    pub rival: Option<Hidden>,
}

/// What [`label`](super::label) returns.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Solution {
    /// For each sensor. Arrivals are those of `arrivals`.
    pub verdicts: Vec<Verdicts>,
    /// For each sensor, for each profile, the arrivals that its onsets are read as, in order of onsets.
    pub arrivals: Vec<Vec<Vec<(Origin, Arrival)>>>,
    /// For each sensor, for each profile, readings of its onsets that are less likely.
    pub losers: Vec<Vec<Vec<Loser>>>,
    /// Hidden patches, then planes, then the likeliest place that is not sure enough.
    pub hypotheses: Vec<Hypothesis>,
    /// Visible patches that light over them shows in another place than the scene's, or that have none there.
    pub places: Vec<(PatchId, Hidden)>,
    /// Visible patches that light over them shows beside their place in the scene, and where.
    pub(super) twins: Vec<(PatchId, Hidden)>,
    /// Number of visible patches where these lie in one line (in flatland in one point), so that nothing is searched.
    pub visible_in_line: Option<usize>,
}
