//! The page: one HTML file that needs no network, light and dark, readable on a phone and printable.

mod answer;
mod distances;
mod growth;
mod image;
mod onsets;
mod patches;
mod plot;
mod profiles;
mod provenance;
mod residuals;
mod sensors;
mod space;
mod stir;
mod verdict;
mod words;

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::Report;
use crate::store::Digest;

const STYLE: &str = include_str!("page.css");
/// One file a figure that the page draws itself; the last one calls the others.
const SCRIPT: &str =
    concat!("\"use strict\";\n", include_str!("profile.js"), include_str!("labels.js"), include_str!("page.js"));

/// The page.
#[must_use]
pub fn page(report: &Report) -> String {
    let campaigns: Vec<&str> = report.provenance.campaigns().map(|(name, _)| name).collect();
    let title = if campaigns.is_empty() { report.folder.clone() } else { campaigns.join(", ") };
    let present = sections(report);
    let body = html! {
        a.skip href="#main" { "Skip to the answer" }
        header {
            h1 { (title) }
            p.lead { (lead(report)) }
            (verdict::verdict(report))
            nav aria-label="sections" { @for section in &present { a href={ "#" (section.id) } { (section.name) } } }
        }
        main #main { @for section in &present { (section.content) } }
        footer { "Made by Periscope " (env!("CARGO_PKG_VERSION")) " from " code { (report.folder) } ". Every number stands in its tables." }
    };
    let nonce = nonce(&body);
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                meta http-equiv="Content-Security-Policy" content=(policy(&nonce));
                title { (title) " - Periscope" }
                style { (PreEscaped(STYLE)) }
            }
            body {
                (body)
                (library(&nonce))
                script nonce=(nonce) { (PreEscaped(SCRIPT)) }
            }
        }
    };
    page.into_string()
}

/// A part of the page.
struct Section {
    id: &'static str,
    name: &'static str,
    content: Markup,
}

/// The sections that have something to show. What is missing from a folder of results is named in the last one.
fn sections(report: &Report) -> Vec<Section> {
    let section = |id, name, content| Section { id, name, content };
    let mut sections = vec![
        section("decisions", "Decisions", verdict::decisions(report)),
        section("answer", "Answer", answer::section(report)),
        section("profiles", "Profiles", profiles::section(report)),
        section("residuals", "Residuals", residuals::section(report)),
        section("patches", "Patches", patches::section(report)),
        section("stir", "STIR", stir::section(report)),
        section("response", "Sensors", sensors::responses(report)),
        section("distances", "Distances", distances::section(report)),
        section("growth", "Growth", growth::section(report)),
        section("rejects", "Rejected", provenance::rejects(report)),
    ];
    let is_empty = |section: &Section| section.content.0.is_empty();
    // The answer grows only where there are several runs.
    let missing = sections.iter().filter(|section| is_empty(section) && section.id != "growth");
    let absent: Vec<&str> = missing.map(|section| section.name).collect();
    let origin = provenance::section(report, &absent);
    sections.retain(|section| !is_empty(section));
    sections.push(section("provenance", "Origin", origin));
    sections
}

/// The word by which the page's own scripts are known: a digest of all else, so that nothing in a table can hold it.
fn nonce(body: &Markup) -> String {
    Digest::of_bytes(body.0.as_bytes()).to_string()
}

/// What the page may do: run its own two scripts, and draw. It loads nothing and sends nothing.
fn policy(nonce: &str) -> String {
    format!(
        "default-src 'none'; script-src 'nonce-{nonce}'; style-src 'unsafe-inline'; img-src data: blob:; base-uri 'none'; form-action 'none'"
    )
}

fn lead(report: &Report) -> Markup {
    html! {
        @match &report.scene {
            Some(scene) => { (answer::summary(scene)) }
            None if report.provenance.tables.is_empty() => "This result folder has no tables."
            None => {
                (words::count(report.arrivals.iter().count(), "onset", "onsets")) " in "
                (words::count(report.waveforms.all, "profile", "profiles")) "."
            }
        }
        @if let Some(residuals) = &report.residuals { " Residuals have a root mean square of " (words::sig(residuals.rms, 3)) " standard deviations." }
    }
}

/// The plotting library's own script. Formulas, for which it brings a second script of two megabytes, are not used
/// here.
fn library(nonce: &str) -> Markup {
    let scripts = plotly::Plot::offline_js_sources();
    let first = scripts.find("</script>").map_or(scripts.as_str(), |end| &scripts[..end + "</script>".len()]);
    PreEscaped(first.replacen("<script ", &format!("<script nonce=\"{nonce}\" "), 1))
}
