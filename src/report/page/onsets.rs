//! Onsets as a table.

use maud::{Markup, html};

use super::profiles;
use super::words::sig;
use crate::history::behind::OnsetBehind;
use crate::report::Report;
use crate::report::arrivals::path_text;
use crate::report::residuals::name;

/// Onsets as a table; each leads to its profile.
pub fn table<'a>(report: &Report, onsets: impl Iterator<Item = &'a OnsetBehind>) -> Markup {
    let is_embedded = |onset: &OnsetBehind| {
        let capture = onset.capture();
        report.waveforms.chosen.binary_search_by(|waveform| waveform.capture.cmp(&capture)).is_ok()
    };
    html! {
        div.scroll tabindex="0" role="region" aria-label="onsets" {
            table.numbers {
                thead { tr { th { "onset" } th.text { "path" } th { "time (ps)" } th { "sd (ps)" } th { "residual (ps)" } th { "in sd" } th { "signal / noise" } th.text { "flags" } } }
                tbody {
                    @for onset in onsets {
                        tr {
                            td.text {
                                @if is_embedded(onset) { a href={ "#" (profiles::anchor(&onset.capture())) } { (name(onset)) } } @else { (name(onset)) }
                            }
                            td.text { (path_text(onset.path.as_deref())) }
                            td { @if let Some(time_ps) = onset.time_ps { (format!("{time_ps:.2}")) } }
                            td { @if let Some(sd_ps) = onset.time_sd_ps { (sig(sd_ps, 2)) } }
                            td { @if let Some(residual_ps) = onset.residual_ps { (sig(residual_ps, 3)) } }
                            td { @if let Some(pull) = onset.pull { (sig(pull, 2)) } @if onset.used == Some(false) { " (left out)" } }
                            td { @if let Some(snr) = onset.snr { (sig(snr, 3)) } }
                            td.text { @for (i, flag) in onset.flags.iter().enumerate() { @if i > 0 { ", " } (flag) } }
                        }
                    }
                }
            }
        }
    }
}
