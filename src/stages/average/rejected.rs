//! Shots that do not count: how many, for which cause, and what to do about the most common one.

use super::Average;
use crate::tables::Trace;

/// Records of fewer samples are hardly ever meant.
const SAMPLES_FEW: i32 = 100;
/// A capture that loses more than this share of its shots is reported: the laser's fluctuations and single
/// disturbances, which rejection is for, take a few percent.
const SHARE_MAX: f64 = 0.25;

/// Numbers of shots that do not count. A shot has one cause.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rejected {
    /// A sample lies at the rails.
    pub clipped: i32,
    /// A sample lies far from the median of the first shots.
    pub outlying: i32,
    /// The reference pulse is cut off at the rails, which makes its time wrong.
    pub reference_clipped: i32,
    /// No reference pulse was found, or that of another shot.
    pub without_reference: i32,
    /// A sample is no number.
    pub not_a_number: i32,
    /// Scale, length or setting are not those of the first shot.
    pub other_scale: i32,
    /// Of all, those with a sample at the rails, of the signal or of the reference.
    pub at_rails: i32,
}

/// Where the reference pulse of a capture was sought: file and channel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sought(pub String);

impl Rejected {
    /// All of them.
    pub fn total(&self) -> i32 {
        let Self { clipped, outlying, reference_clipped, without_reference, not_a_number, other_scale, at_rails: _ } =
            *self;
        clipped + outlying + reference_clipped + without_reference + not_a_number + other_scale
    }

    /// Adds those of another piece.
    pub fn absorb(&mut self, other: Self) {
        self.clipped += other.clipped;
        self.outlying += other.outlying;
        self.reference_clipped += other.reference_clipped;
        self.without_reference += other.without_reference;
        self.not_a_number += other.not_a_number;
        self.other_scale += other.other_scale;
        self.at_rails += other.at_rails;
    }
}

/// What a message about rejected shots needs to know.
pub struct Account<'a> {
    pub average: &'a Average,
    /// First signal row of the range.
    pub first: &'a Trace,
    pub sought: Option<&'a Sought>,
    pub rejected: Rejected,
    /// Shots that count.
    pub valid: u64,
}

impl Account<'_> {
    /// Why a capture with too few valid shots has no profile.
    pub fn too_few(&self) -> String {
        let (valid, needed) = (self.valid, self.average.shots_needed());
        let has = format!("has {valid} valid shots of the {needed} that it needs");
        if self.recorded() < u64::from(needed) {
            return format!("{has}; only {} were captured: capture more, or lower `shots_min`", self.recorded());
        }
        format!("{has}; {}", self.causes())
    }

    /// Why a profile rests on fewer shots than were captured, if it has lost many.
    pub fn lost_many(&self) -> Option<String> {
        let (lost, recorded) = (f64::from(self.rejected.total()), self.recorded());
        (lost > SHARE_MAX * recorded as f64)
            .then(|| format!("is averaged from {} shots only; {}", self.valid, self.causes()))
    }

    fn recorded(&self) -> u64 {
        self.valid + self.rejected.total() as u64
    }

    /// Each cause with its number of shots, and what to do about the most common one.
    fn causes(&self) -> String {
        let Rejected { clipped, outlying, reference_clipped, without_reference, not_a_number, other_scale, .. } =
            self.rejected;
        let sought = self.sought.map_or(String::new(), |Sought(place)| format!(" in {place}"));
        let mut causes = [
            (clipped, "clipped".to_owned(), Cause::Clipped),
            (outlying, "outlying".to_owned(), Cause::Outlying),
            (reference_clipped, "with a clipped reference pulse".to_owned(), Cause::ReferenceClipped),
            (without_reference, format!("without a reference pulse{sought}"), Cause::WithoutReference),
            (not_a_number, "with a sample that is no number".to_owned(), Cause::NotANumber),
            (other_scale, "of another scale, length or setting than the first".to_owned(), Cause::OtherScale),
        ];
        // The sort is stable: equally common causes stay in this order.
        causes.sort_by_key(|(count, ..)| std::cmp::Reverse(*count));
        let listed = causes.iter().filter(|(count, ..)| *count > 0);
        let listed: Vec<String> = listed.map(|(count, words, _)| format!("{count} {words}")).collect();
        let (_, _, largest) = &causes[0];
        format!("of {} shots: {}. {}", self.recorded(), listed.join(", "), self.fix(*largest))
    }

    fn fix(&self, cause: Cause) -> String {
        let Trace { samples, dt_ps, .. } = *self.first;
        if samples < SAMPLES_FEW && self.recorded() > samples as u64 {
            return format!(
                "There are more shots than the {samples} samples of each: are the axes of the array in the order shots, samples?"
            );
        }
        if matches!(cause, Cause::Outlying | Cause::WithoutReference)
            && let Some(doubt) = self.first.time_base_doubt()
        {
            return doubt;
        }
        match cause {
            Cause::Clipped => "Open the vertical range, attenuate, or add a capture at a second range".to_owned(),
            Cause::Outlying => {
                let jitters = if self.sought.is_none() {
                    "if the trigger jitters, name the channel that sees the laser as `reference` in the [[captures]] rule; "
                } else {
                    ""
                };
                format!(
                    "A sample of each lies more than `outlier_sigma` = {} robust standard deviations from the median of the first shots: \
                     {jitters}look for disturbances, or set `reject_outliers = false` if these shots are good",
                    self.average.outlier_sigma.get()
                )
            }
            Cause::ReferenceClipped => "Open the vertical range of the reference channel".to_owned(),
            Cause::WithoutReference => format!(
                "Does that channel show the pulse of the response captures? Correct `reference` in the [[captures]] rule, or the time \
                 between samples, which is {dt_ps} ps"
            ),
            Cause::NotANumber => "Export the file again, or exclude these shots with [[exclude]]".to_owned(),
            Cause::OtherScale => {
                "Give captures of another setting a [[captures]] rule or a `range` of their own".to_owned()
            }
        }
    }
}

/// Causes, in words of their fix.
#[derive(Clone, Copy)]
enum Cause {
    Clipped,
    Outlying,
    ReferenceClipped,
    WithoutReference,
    NotANumber,
    OtherScale,
}
