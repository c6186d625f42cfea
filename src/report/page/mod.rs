//! The page: one HTML file that needs no network, light and dark, readable on a phone and printable.

mod answer;
mod image;
mod patches;
mod plot;
mod provenance;
mod solution;
mod space;
mod stir;
mod waves;
mod words;

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::Report;
use crate::store::Digest;

const STYLE: &str = include_str!("page.css");
const SCRIPT: &str = include_str!("page.js");

/// The page.
#[must_use]
pub fn page(report: &Report) -> String {
    let campaigns: Vec<&str> = report.provenance.campaigns().map(|(name, _)| name).collect();
    let title = if campaigns.is_empty() { report.folder.clone() } else { campaigns.join(", ") };
    let sections = [
        ("answer", "Answer"),
        ("patches", "Patches"),
        ("stir", "Response of the scene"),
        ("profiles", "Profiles"),
        ("response", "Sensors"),
        ("residuals", "Residuals"),
        ("distances", "Distances"),
        ("rejects", "Set aside"),
        ("provenance", "Origin"),
    ];
    let body = html! {
        header {
            h1 { (title) }
            p.lead { (lead(report)) }
            nav { @for (id, name) in sections.iter().filter(|(id, _)| *id != "patches" || report.scene.is_some()) { a href={ "#" (id) } { (name) } } }
        }
        main {
            (answer::section(report))
            (patches::section(report))
            (stir::section(report))
            (waves::profiles(report))
            (waves::responses(report))
            (solution::residuals(report))
            (solution::distances(report))
            (provenance::rejects(report))
            (provenance::section(report))
        }
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
    let rejects = report.provenance.rejects;
    html! {
        @match &report.scene {
            Some(scene) => { (answer::summary(scene)) }
            None => {
                (words::count(report.arrivals.iter().count(), "onset", "onsets")) " in "
                (words::count(report.waveforms.all, "profile", "profiles")) "."
            }
        }
        @if let Some(residuals) = &report.residuals { " Residuals have a root mean square of " (words::sig(residuals.rms, 3)) " standard deviations." }
        @if rejects > 0 { " " a href="#rejects" { (words::count(rejects, "record was", "records were")) " set aside" } "." }
    }
}

/// The plotting library's own script. Formulas, for which it brings a second script of two megabytes, are not used
/// here.
fn library(nonce: &str) -> Markup {
    let scripts = plotly::Plot::offline_js_sources();
    let first = scripts.find("</script>").map_or(scripts.as_str(), |end| &scripts[..end + "</script>".len()]);
    PreEscaped(first.replacen("<script ", &format!("<script nonce=\"{nonce}\" "), 1))
}
