//! What was rejected, and where the tables come from.

use maud::{Markup, html};

use super::words::{bytes, count, seconds};
use crate::report::Report;
use crate::store::runs::{Ending, RunRecord};

/// What was rejected.
pub fn rejects(report: &Report) -> Markup {
    let provenance = &report.provenance;
    html! {
        section #rejects {
            h2 { "What was rejected" }
            @let left_out = provenance.last_run.as_ref().map_or(&[][..], |run| &run.left_out);
            @if provenance.rejects == 0 && left_out.is_empty() {
                p { @if provenance.is_done() { "Nothing: every record of the campaign went in." } @else { "Nothing, until the last run ended." } }
            }
            @for line in left_out { p { (line) "." } }
            @if provenance.rejects > 0 {
                p { (count(provenance.rejects, "record was", "records were")) " rejected, for " (count(provenance.reasons, "reason", "reasons")) "; the rest went on without them." }
                div.scroll tabindex="0" role="region" aria-label="rejected records" {
                    table.numbers {
                        thead { tr { th { "records" } th.text { "stage" } th.text { "reason, and the fix" } th.text { "the first" } } }
                        tbody {
                            @for rejected in &provenance.rejected {
                                @let first = &rejected.first;
                                tr {
                                    td { (rejected.count) }
                                    td.text { (first.stage) }
                                    td.text { (first.reason) }
                                    td.text {
                                        (first.file.as_deref().unwrap_or(""))
                                        @if let Some(segment) = first.segment { ", segment " (segment) }
                                    }
                                }
                            }
                        }
                    }
                }
                p.note { "All: " code { "SELECT * FROM '" (report.folder) "/rejects/*.parquet'" } }
            }
        }
    }
}

/// Runs, tables and their lineage, and the sections that are `absent` for want of a table.
pub fn section(report: &Report, absent: &[&str]) -> Markup {
    let provenance = &report.provenance;
    html! {
        section #provenance {
            h2 { "Where it comes from" }
            @if let Some(run) = &provenance.last_run { (last_run(run, provenance.runs)) }
            @if let Some(run) = &provenance.last_work { (times(run)) }
            @if !absent.is_empty() { p { "This result folder has no table for: " (absent.join(", ")) "." } }
            @if !provenance.tables.is_empty() { (tables(report)) }
        }
    }
}

fn tables(report: &Report) -> Markup {
    html! {
        div.scroll tabindex="0" role="region" aria-label="tables" {
            table.numbers {
                thead { tr { th { "table" } th.text { "stage" } th.text { "from" } th.text.params { "parameters" } th { "rows" } th { "size" } th { "parts" } th { "lineage" } } }
                tbody {
                    @for table in &report.provenance.tables {
                        tr {
                            td.text { (table.view) }
                            td.text { (table.stage) }
                            td.text { @for (i, (name, heading)) in table.inputs.iter().enumerate() { @if i > 0 { br; } @if name != "from" && name != heading { (name) " = " } (heading) } }
                            td.text.params {
                                @let params = changed(&table.params);
                                @if !params.is_empty() { details { summary { (count(params.len(), "value", "values")) } @for (name, value) in &params { div { (name) " = " (value) } } } }
                            }
                            td { (table.rows) }
                            td { (bytes(table.bytes)) }
                            td { (table.parts) }
                            td { code { (table.lineage) } }
                        }
                    }
                }
            }
        }
        p.note { "Which change made which difference: " code { "periscope diff " (report.folder) " OTHER" } "; whether every byte is as it was written: " code { "periscope verify " (report.folder) } "." }
    }
}

/// Parameters by name.
fn changed(params: &serde_json::Value) -> Vec<(String, String)> {
    let values = params.as_object().into_iter().flatten();
    values.map(|(name, value)| (name.clone(), value.to_string())).collect()
}

fn last_run(run: &RunRecord, runs: usize) -> Markup {
    let how = match (&run.ending, &run.failure) {
        (Some(Ending::Done), _) => "done".to_owned(),
        (Some(Ending::Interrupted), _) => "interrupted: the same command goes on from there".to_owned(),
        (Some(Ending::Failed), failure) => format!("failed: {}", failure.as_deref().unwrap_or_default()),
        (None, _) => "under way, or killed".to_owned(),
    };
    html! {
        dl {
            dt { "last run" } dd { (run.started) ", " (how) @if runs > 1 { " (" (runs) " runs into this folder)" } }
            dt { "pipeline" } dd { code { (run.pipeline.display()) } }
            @if !run.set.is_empty() { dt { "changed" } dd { @for set in &run.set { code { (set) } " " } } }
            dt { (if run.campaigns.len() == 1 { "campaign" } else { "campaigns" }) }
            dd { @for (name, folder) in &run.campaigns { (name) " (" code { (folder.display()) } ") " } }
            dt { "by" } dd { "periscope " (run.periscope) " on " (run.host) }
        }
    }
}

/// What took how long, a bar a pass.
fn times(run: &RunRecord) -> Markup {
    let most_s = run.passes.iter().map(|pass| pass.seconds).fold(f64::MIN_POSITIVE, f64::max);
    html! {
        h3 { "Time that it took (" (run.started) ")" }
        div.bars {
            @for pass in &run.passes {
                span { (pass.tables.join(", ")) }
                span.bar { span style={ "width:" (format!("{:.1}", 100.0 * pass.seconds / most_s)) "%" } {} }
                span.value {
                    (seconds(pass.seconds))
                    @if pass.raw_bytes > 0 { ", " (bytes(pass.raw_bytes)) " of raw files, " (bytes((pass.raw_bytes as f64 / pass.seconds.max(1e-9)) as u64)) "/s" }
                }
            }
        }
    }
}
