//! Whether the answer is to be believed: what `decisions` say of it, else what its fit says, in one word with reasons.

use super::arrivals::Arrivals;
use super::provenance::Provenance;
use super::scene::Scene;
use crate::campaign::count;
use crate::geometry::maximum_likelihood::by_chance;
use crate::history::behind::OnsetBehind;
use crate::signal::tails::chi_square;
use crate::stages::conclude::is_by_chance;
use crate::store::runs::Ending;
use crate::tables::{Decision, Fit};

/// Share of the onsets without a path from which the answer explains the light in part only.
const PATHLESS: f64 = 0.15;
/// Flag of an onset whose profile pulses and noise do not explain.
const MISFIT: &str = "misfit";

/// The word.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Word {
    /// The model explains the data.
    Explained,
    /// All but for what is named.
    ExplainedInPart,
    /// Nothing checks the answer.
    Unchecked,
    /// The pipeline asks for no positions.
    NotAsked,
    /// The data show nothing, or do not decide.
    NothingFound,
    /// The model does not explain the data.
    NotExplained,
    /// The last run did not end.
    Unfinished,
    /// The last run failed.
    Failed,
}

impl Word {
    /// As it is read.
    pub fn text(self) -> &'static str {
        match self {
            Self::Explained => "Explained",
            Self::ExplainedInPart => "Explained in part",
            Self::Unchecked => "Not checked",
            Self::NotAsked => "No positions asked for",
            Self::NothingFound => "Nothing found",
            Self::NotExplained => "Not explained",
            Self::Unfinished => "Not finished",
            Self::Failed => "The run failed",
        }
    }
}

/// How well the solution fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goodness {
    /// Chi-square of the solution.
    pub chi2: f64,
    /// Its degrees of freedom.
    pub freedom: usize,
    /// Whether standard deviations were made larger before, because the model did not explain the onsets.
    pub is_widened: bool,
}

impl Goodness {
    fn of(fit: &Fit) -> Option<Self> {
        let freedom = usize::try_from(fit.degrees_of_freedom).ok().filter(|freedom| *freedom > 0)?;
        Some(Self { chi2: fit.chi2, freedom, is_widened: is_widened(fit) })
    }

    /// Chance that a right model leaves as much.
    pub fn p_value(&self) -> f64 {
        chi_square(self.chi2, self.freedom)
    }
}

/// The verdict.
#[derive(Clone, Debug, PartialEq)]
pub struct Verdict {
    /// In a word.
    pub word: Word,
    /// Why, a sentence each.
    pub reasons: Vec<String>,
    /// The fit; `None` where a pipeline keeps none, or no onset checks it.
    pub goodness: Option<Goodness>,
}

impl Verdict {
    /// The worst of what run, decisions and fit say.
    pub fn of(provenance: &Provenance, scene: Option<&Scene>, arrivals: &Arrivals) -> Self {
        let mut remarks: Vec<(Word, String)> = ending(provenance).into_iter().collect();
        if !scene.is_some_and(|scene| scene.decisions.iter().any(|row| &*row.what == "waveforms")) {
            remarks.extend(of_waveforms(arrivals));
        }
        match scene {
            // A run that did not end may have had one.
            None if !provenance.is_done() => {}
            None => remarks.push((Word::NotAsked, "no stage of this pipeline solves for positions".to_owned())),
            Some(scene) => {
                remarks.extend(of_scene(scene, arrivals.iter().filter(|onset| onset.path.is_some()).count()));
                let paths: Vec<bool> = arrivals.iter().map(|onset| onset.path.is_some()).collect();
                remarks.extend(pathless(paths.iter().filter(|has_path| !**has_path).count(), paths.len()));
            }
        }
        remarks.sort_by_key(|(word, _)| std::cmp::Reverse(*word));
        let word = remarks.first().map_or(Word::Unchecked, |(word, _)| *word);
        // What is well is reported only where all is.
        let remarks = remarks.into_iter().filter(|(of, _)| *of > Word::Explained || word == Word::Explained);
        let goodness = scene.and_then(|scene| scene.fit.as_ref()).and_then(Goodness::of);
        Self { word, reasons: remarks.map(|(_, reason)| reason).collect(), goodness }
    }
}

/// What is wrong with the last run.
fn ending(provenance: &Provenance) -> Option<(Word, String)> {
    let run = provenance.last_run.as_ref()?;
    match run.ending {
        Some(Ending::Done) => None,
        Some(Ending::Failed) => {
            let why = run.failure.as_deref().unwrap_or("its record does not say why");
            let rest = if provenance.tables.is_empty() { "" } else { "; what stands below is of earlier work" };
            Some((Word::Failed, format!("{why}{rest}")))
        }
        Some(Ending::Interrupted) => {
            Some((Word::Unfinished, "the last run was interrupted; the same command goes on from there".to_owned()))
        }
        None => Some((Word::Unfinished, "the last run still works, or was killed".to_owned())),
    }
}

/// Whether many onsets have no path, where some have: the model then has no word for much of the light.
fn pathless(count: usize, all: usize) -> Option<(Word, String)> {
    let is_many = count < all && count as f64 > PATHLESS * all as f64;
    is_many.then(|| (Word::ExplainedInPart, format!("labels: {count} of {all} onsets have no path over the patches")))
}

/// Whether pulses and noise explain the profiles, by the flags of their onsets: as the stage `conclude` judges them.
fn of_waveforms(arrivals: &Arrivals) -> Option<(Word, String)> {
    let profiles = arrivals.by_capture.values().filter(|onsets| !onsets.is_empty());
    let is_misfit =
        |onsets: &&Vec<OnsetBehind>| onsets.iter().any(|onset| onset.flags.iter().any(|flag| &**flag == MISFIT));
    let (all, misfits) = (profiles.clone().count(), profiles.filter(is_misfit).count());
    let word = if is_by_chance(misfits, all) { Word::Explained } else { Word::NotExplained };
    (all > 0).then(|| {
        (word, format!("waveforms: chi-square of {misfits} of {} exceeds noise", count(all, "profile", "profiles")))
    })
}

/// What the scene says; `labelled` is the number of onsets with a path.
fn of_scene(scene: &Scene, labelled: usize) -> Vec<(Word, String)> {
    let mut remarks: Vec<(Word, String)> = scene.decisions.iter().filter_map(of_decision).collect();
    let is_searched = !scene.searches.is_empty();
    if !remarks.iter().any(|(_, reason)| reason.starts_with("fit: ")) && !is_searched {
        remarks.extend(scene.fit.as_ref().map(of_fit));
    }
    if scene.patches.iter().all(|placed| scene.anchors.contains(&placed.patch.patch))
        && scene.surface.is_empty()
        && !is_searched
    {
        remarks.push((Word::NothingFound, "no patch has a position".to_owned()));
    }
    if remarks.is_empty() && !scene.surface.is_empty() && !scene.decisions.is_empty() {
        let text = "surface: neither a shape nor a mesh explains first light, so that nothing checks its points";
        remarks.push((Word::Unchecked, text.to_owned()));
    }
    if remarks.is_empty() {
        let chi2_dof = scene.patches.iter().find_map(|placed| placed.patch.chi2_dof);
        remarks.push(chi2_dof.map_or_else(
            || (Word::Unchecked, "no table of this pipeline has a chi-square of the positions".to_owned()),
            |chi2_dof| of_patches(chi2_dof, labelled),
        ));
    }
    remarks
}

/// What a row of `decisions` says of the whole; `None` of one that is no verdict.
fn of_decision(row: &Decision) -> Option<(Word, String)> {
    let begins = |text: &str| row.chosen.starts_with(text);
    let word = match &*row.what {
        "fit" | "waveforms" if begins("not explained") => Word::NotExplained,
        "fit" if begins("explained but") => Word::ExplainedInPart,
        "fit" if begins("unchecked") || begins("anchors as given") => Word::Unchecked,
        "surface" if begins("no surface") => Word::NothingFound,
        "shapes" | "meshes" if !begins("none") => Word::Explained,
        "hidden things" if begins("nothing") || begins("undetermined") => Word::NothingFound,
        "fit" | "waveforms" | "hidden things" => Word::Explained,
        what if what.starts_with("response of ") && !begins("as wide as calibrated") => Word::ExplainedInPart,
        what if what.starts_with("echoes of ") && !begins("corrected") => Word::ExplainedInPart,
        _ => return None,
    };
    Some((word, format!("{}: {} ({})", row.what, row.chosen, row.evidence)))
}

/// The same of a solution without decisions.
fn of_fit(fit: &Fit) -> (Word, String) {
    let evidence = format!("chi-square {:.1} of {} degrees of freedom", fit.chi2, fit.degrees_of_freedom);
    if fit.degrees_of_freedom < 1 {
        (Word::Unchecked, format!("fit: as many unknowns as onsets ({evidence})"))
    } else if is_widened(fit) {
        (Word::NotExplained, format!("fit: standard deviations were made larger than noise makes them ({evidence})"))
    } else if fit.chi2 <= by_chance(fit.degrees_of_freedom.into()) {
        (Word::Explained, format!("fit: {evidence}"))
    } else {
        (Word::ExplainedInPart, format!("fit: a few onsets contradict the others ({evidence})"))
    }
}

/// The same of a table of patches, which has chi-square over its degrees of freedom without their number: that is at
/// most the number of onsets with a path.
fn of_patches(chi2_dof: f64, labelled: usize) -> (Word, String) {
    let numbers = 1..=labelled.max(1);
    let within = numbers.clone().filter(|freedom| chi2_dof * *freedom as f64 <= by_chance(*freedom as f64)).count();
    let evidence =
        format!("chi-square per degree of freedom {chi2_dof:.2}, of 1 to {} degrees of freedom", labelled.max(1));
    match within {
        0 => (Word::NotExplained, format!("fit: more than noise makes ({evidence})")),
        within if within == numbers.count() => (Word::Explained, format!("fit: {evidence}")),
        _ => (
            Word::Unchecked,
            format!("fit: no table has the number of degrees of freedom, which would decide ({evidence})"),
        ),
    }
}

fn is_widened(fit: &Fit) -> bool {
    fit.misfit > 1.0 || fit.widened.iter().any(|factor| *factor > 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::history::behind::CaptureKey;
    use crate::tables::Onset;

    fn fit(chi2: f64, misfit: f64) -> Fit {
        Fit { chi2, degrees_of_freedom: 10, misfit, widened: vec![1.0; 4], ..Fit::default() }
    }

    #[test]
    fn a_fit_is_judged_as_chance_has_it() {
        assert_eq!(of_fit(&fit(9.0, 1.0)).0, Word::Explained);
        // The 99.9 % point of ten degrees of freedom is 29.6.
        assert_eq!((of_fit(&fit(29.0, 1.0)).0, of_fit(&fit(31.0, 1.0)).0), (Word::Explained, Word::ExplainedInPart));
        assert_eq!(of_fit(&fit(9.0, 4.0)).0, Word::NotExplained);
        // A table of chi-square: 18.307 is its 95 % point.
        let goodness = Goodness::of(&fit(18.307, 1.0)).unwrap();
        assert!((goodness.p_value() - 0.05).abs() < 1e-5, "{}", goodness.p_value());
    }

    /// The 99.9 % points of one, four and five degrees of freedom are 10.8 (11.2 by its approximation), 18.5 and 20.5.
    #[test]
    fn a_chi_square_of_unknown_freedom_is_judged_where_no_freedom_would_change_the_word() {
        assert_eq!(of_patches(3.84, 4).0, Word::Explained);
        assert_eq!((of_patches(4.5, 4).0, of_patches(4.5, 5).0), (Word::Explained, Word::Unchecked));
        assert_eq!(
            (of_patches(10.7, 1).0, of_patches(11.5, 1).0, of_patches(11.5, 40).0),
            (Word::Explained, Word::NotExplained, Word::NotExplained)
        );
    }

    #[test]
    fn profiles_are_judged_by_the_flags_of_their_onsets() {
        let arrivals = |misfits: usize| {
            let onset = |n: usize| {
                let flags = if n < misfits { vec![MISFIT.into()] } else { Vec::new() };
                let capture: CaptureKey = ("c".into(), "s1".into(), 1, n as i32);
                (capture, vec![OnsetBehind::of_onset(&Onset { flags, ..Onset::default() })])
            };
            let mut arrivals = Arrivals::default();
            arrivals.by_capture.extend((0..100).map(onset));
            arrivals
        };
        let word = |misfits: usize| of_waveforms(&arrivals(misfits)).map(|(word, _)| word);
        assert_eq!((word(2), word(3)), (Some(Word::Explained), Some(Word::NotExplained)));
        assert_eq!(of_waveforms(&Arrivals::default()), None);
    }

    #[test]
    fn light_without_a_path_is_no_explanation() {
        assert_eq!(pathless(11, 196), None);
        assert_eq!(pathless(79, 251).map(|(word, _)| word), Some(Word::ExplainedInPart));
        // Without any label there is nothing to judge.
        assert_eq!(pathless(40, 40), None);
    }

    #[test]
    fn decisions_are_judged_by_what_they_chose() {
        let row =
            |what: &str, chosen: &str| Decision { what: what.into(), chosen: chosen.into(), ..Decision::default() };
        let word = |what: &str, chosen: &str| of_decision(&row(what, chosen)).map(|(word, _)| word);
        assert_eq!(word("fit", "not explained: standard deviations are larger"), Some(Word::NotExplained));
        assert_eq!(word("fit", "explained but for the onsets that `suspects` lists"), Some(Word::ExplainedInPart));
        assert_eq!(word("waveforms", "not explained in 3 of 5 profiles"), Some(Word::NotExplained));
        assert_eq!(word("hidden things", "nothing"), Some(Word::NothingFound));
        assert_eq!(word("response of s1", "pulses are 9.0 % wider"), Some(Word::ExplainedInPart));
        assert_eq!(word("response of s1", "as wide as calibrated"), None);
        assert_eq!(word("echoes of s1", "the calibration contradicts the scene"), Some(Word::ExplainedInPart));
        assert_eq!(word("echoes of s1", "corrected: 0.40 % more light"), None);
        assert_eq!(word("labels", "3 of 4 pulses have a path"), None);
        assert_eq!(word("surface", "no surface: first light does not agree"), Some(Word::NothingFound));
        assert_eq!(word("meshes", "1 surface in `meshes`"), Some(Word::Explained));
        assert_eq!((word("meshes", "none"), word("surface", "90 points of a surface")), (None, None));
    }
}
