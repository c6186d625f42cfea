//! The head: whether the answer is to be believed, what was left out, what is ambiguous, and what was chosen.

use maud::{Markup, html};

use super::words::{count, marked, sig};
use crate::report::Report;
use crate::report::scene::Scene;
use crate::report::verdict::{Goodness, Word};
use crate::stages::conclude::are_alike;

/// Reasons that are listed at most.
const REASONS: usize = 6;
/// Smaller and larger chances are not distinguished.
const LEAST_CHANCE: f64 = 1e-6;
const MOST_CHANCE: f64 = 0.99;

/// The verdict, in a box whose colour and mark say the same as its word.
pub fn verdict(report: &Report) -> Markup {
    let verdict = &report.verdict;
    let (class, mark) = match verdict.word {
        Word::Explained => ("well", "✓"),
        Word::ExplainedInPart | Word::Unchecked | Word::NotAsked => ("doubt", "?"),
        Word::NothingFound | Word::NotExplained | Word::Unfinished | Word::Failed => ("bad", "✗"),
    };
    html! {
        div #verdict class={ "verdict " (class) } role="group" aria-labelledby="verdict-word" {
            p #verdict-word.word { span aria-hidden="true" { (mark) } " " (verdict.word.text()) }
            @if verdict.word == Word::NotExplained { p { strong { "The model does not explain the data: do not trust the positions below before you know why." } } }
            ul.notes {
                @for reason in verdict.reasons.iter().take(REASONS) { li { (marked(reason)) } }
                @if verdict.reasons.len() > REASONS { li { (verdict.reasons.len() - REASONS) " more: see the decisions below" } }
            }
            dl {
                @if let Some(goodness) = &verdict.goodness { dt { "chi-square per degree of freedom" } dd { (fit(goodness)) } }
                @if let Some(left_out) = left_out(report) { dt { "left out" } dd { (left_out) } }
                @if let Some(scene) = &report.scene { dt { "ambiguous" } dd { (ambiguous(scene)) } }
            }
        }
    }
}

fn fit(goodness: &Goodness) -> Markup {
    let p_value = goodness.p_value();
    html! {
        strong { (sig(goodness.chi2 / goodness.freedom as f64, 3)) }
        " (chi-square " (sig(goodness.chi2, 4)) ", " (count(goodness.freedom, "degree", "degrees")) " of freedom), p-value "
        @if p_value < LEAST_CHANCE { "below 1e-6" } @else if p_value > MOST_CHANCE { "above 0.99" } @else { (sig(p_value, 2)) }
        @if goodness.is_widened { "; only after standard deviations were made larger for what the model does not explain" }
        @else if p_value < 1e-3 { ": a right model leaves as much in fewer than one campaign of 1,000" }
    }
}

/// `None` where that is not known: the last run ended before it had left out anything.
fn left_out(report: &Report) -> Option<Markup> {
    let onsets = || report.arrivals.offered();
    let contradicting = onsets().filter(|onset| onset.used == Some(false)).count();
    let pathless = report.arrivals.iter().filter(|onset| onset.path.is_none()).count();
    let rejects = report.provenance.rejects;
    let files = report.provenance.last_run.as_ref().map_or(0, |run| run.left_out.len());
    let mut parts = Vec::new();
    if contradicting > 0 {
        parts.push(format!("{} that the other onsets contradict", count(contradicting, "onset", "onsets")));
    }
    if pathless > 0 && report.scene.is_some() {
        parts.push(format!("{} without a path", count(pathless, "onset", "onsets")));
    }
    if rejects > 0 {
        parts.push(count(rejects, "rejected record", "rejected records"));
    }
    if files > 0 {
        parts.push(format!("{} for files that no table is made from", count(files, "reason", "reasons")));
    }
    let is_known = !parts.is_empty() || report.provenance.is_done();
    is_known.then(|| {
        html! {
            @if parts.is_empty() { "nothing" } @else { (parts.join(", ")) }
            @if rejects + files > 0 { " (" a href="#rejects" { "list" } ")" }
        }
    })
}

fn ambiguous(scene: &Scene) -> Markup {
    let alternatives = scene.ambiguities.iter().filter(|open| open.alternative.is_some()).count();
    html! {
        @match scene.ambiguities.len() {
            0 => "nothing",
            open => {
                a href="#open" { (count(open, "question", "questions")) }
                @if alternatives > 0 { ", " (count(alternatives, "other solution", "other solutions")) " that the data allow" }
                @let frames = scene.ambiguities.iter().filter(|open| &*open.kind == "rotation").count();
                @if frames == open { " (the frame alone: how the scene is turned)" }
            }
        }
    }
}

/// What the run chose, each choice with its evidence; first of all, since all below depends on it.
pub fn decisions(report: &Report) -> Markup {
    let rows = report.scene.as_ref().map_or(&[][..], |scene| &scene.decisions);
    html! {
        @if !rows.is_empty() {
            section #decisions {
                h2 { "Decisions that the run took" }
                div.scroll.whole tabindex="0" role="region" aria-label="decisions" {
                    table.words {
                        thead { tr { th.text { "choice" } th.text { "chosen" } th.text { "evidence" } th.text { "next best" } th.text { "what would change it" } } }
                        tbody {
                            @for row in rows {
                                tr {
                                    td.text { (marked(&row.what)) }
                                    td.text { strong { (marked(&row.chosen)) } }
                                    td.text { (marked(&row.evidence)) }
                                    td.text {
                                        (marked(row.runner_up.as_deref().unwrap_or("-")))
                                        @if let Some(ratio) = row.log_likelihood_ratio.filter(|ratio| !are_alike(*ratio)) { ", log-likelihood less by " (sig(ratio, 3)) }
                                    }
                                    td.text { (marked(&row.would_change)) }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}
