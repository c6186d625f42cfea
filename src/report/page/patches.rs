//! The onsets behind each patch.

use maud::{Markup, html};

use super::onsets;
use super::words::count;
use crate::report::Report;
use crate::report::arrivals::doubt;
use crate::report::scene::Placed;

/// Patches with a list of their own at most.
const PATCHES: usize = 500;
/// Onsets in all lists together at most.
const ROWS: usize = 6000;
/// Onsets in one list at most.
const LONGEST: usize = 60;

/// A list a patch, closed until it is asked for.
pub fn section(report: &Report) -> Markup {
    let Some(scene) = &report.scene else { return html! {} };
    // Onsets say nothing of where a patch is that campaign.toml places and none goes over.
    let is_listed = |placed: &&Placed| {
        let patch = placed.patch.patch;
        !scene.anchors.contains(&patch) || report.arrivals.over(patch).next().is_some()
    };
    let listed: Vec<&Placed> = scene.patches.iter().filter(is_listed).collect();
    let shown = listed.len().min(PATCHES);
    let longest = (ROWS / shown.max(1)).clamp(4, LONGEST);
    html! {
        section #patches {
            h2 { "Why each patch is where it is" }
            @for placed in listed.iter().take(PATCHES) {
                @let patch = placed.patch.patch;
                @let over = by_doubt(report, patch);
                details.patch id={ "patch-" (patch) } {
                    summary { "Patch " (patch) " (" (placed.patch.kind) "): " (count(over.len(), "onset", "onsets")) }
                    (onsets::table(report, over.iter().take(longest).copied()))
                    p.note {
                        @if over.len() > longest { "The " (longest) " farthest off of " (over.len()) ". " }
                        "All, back to the raw exposures: " code { "periscope explain " (report.folder) " patch=" (patch) }
                    }
                }
            }
            @if listed.is_empty() {
                p { "campaign.toml gives the place of every patch, and no onset has a path." }
            }
            @if listed.len() > shown {
                p.note { "The first " (shown) " of " (listed.len()) " patches; any other: " code { "periscope explain " (report.folder) " patch=NUMBER" } }
            }
        }
    }
}

fn by_doubt(report: &Report, patch: crate::units::PatchId) -> Vec<&crate::history::behind::OnsetBehind> {
    let mut over: Vec<_> = report.arrivals.over(patch).collect();
    over.sort_by(|a, b| doubt(b).total_cmp(&doubt(a)));
    over
}
