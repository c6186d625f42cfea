//! The sensors: their responses, as calibration measured them.

use maud::{Markup, html};
use plotly::common::{Line, Mode};
use plotly::layout::{Axis, Layout, Margin};
use plotly::{Plot, Scatter};

use super::plot::{HIDDEN, MIRROR, PALE, VISIBLE, figure, legend_above, short};
use super::words::{count, sig};
use crate::report::Report;
use crate::report::responses::Response;

/// Digits of drawn times.
const DIGITS: i32 = 5;

/// The sensors' responses.
pub fn responses(report: &Report) -> Markup {
    if report.responses.is_empty() {
        return html! {};
    }
    html! {
        section #response {
            h2 { "The sensors' own response" }
            @if let Some(Response { heading, .. }) = report.responses.first() {
                (figure("response-plot", 340, &response_plot(&report.responses), &alternative(&report.responses), &html! {
                    "Impulse response, its extremum at time 0. Table " code { (heading) } "."
                }))
                div.scroll tabindex="0" role="region" aria-label="sensors" {
                    table.numbers {
                        thead { tr { th { "campaign" } th.text { "sensor" } th.text { "range" } th { "latency (ps)" } th { "width (ps)" } th { "shots" } th { "rejected" } } }
                        tbody {
                            @for Response { row, .. } in &report.responses {
                                tr {
                                    td.text { (row.campaign) }
                                    td.text { (row.sensor) }
                                    td.text { (row.range.as_deref().unwrap_or("")) }
                                    td { (format!("{:.2}", row.latency_ps)) " ± " (sig(row.latency_sd_ps, 2)) }
                                    td { (format!("{:.1}", row.width_ps)) @if let Some(sd_ps) = row.width_sd_ps { " ± " (sig(sd_ps, 2)) } }
                                    td { (row.shots) }
                                    td { (row.rejected) }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

fn alternative(responses: &[Response]) -> String {
    let one = |Response { row, .. }: &Response| format!("{} has a width of {} ps", row.sensor, sig(row.width_ps, 3));
    let all: Vec<String> = responses.iter().take(8).map(one).collect();
    format!("Impulse responses of {}: {}.", count(responses.len(), "sensor", "sensors"), all.join(", "))
}

fn response_plot(responses: &[Response]) -> Plot {
    let mut plot = Plot::new();
    for (i, Response { row, curve, .. }) in responses.iter().enumerate() {
        let x: Vec<f64> = curve.iter().map(|(time_ps, _)| short(*time_ps, DIGITS)).collect();
        let y: Vec<f64> = curve.iter().map(|(_, value)| short(f64::from(*value), 4)).collect();
        let range = row.range.as_ref().map_or(String::new(), |range| format!(", {range}"));
        let colour = [VISIBLE, HIDDEN, MIRROR, PALE][i % 4];
        let line = Line::new().width(1.5).color(colour);
        plot.add_trace(
            Scatter::new(x, y).mode(Mode::Lines).name(format!("{} {}{range}", row.campaign, row.sensor)).line(line),
        );
    }
    let layout = Layout::new().x_axis(Axis::new().title("time (ps)")).y_axis(Axis::new().title("response"));
    plot.set_layout(
        layout
            .show_legend(responses.len() > 1)
            .legend(legend_above())
            .margin(Margin::new().left(60).right(10).top(30).bottom(50)),
    );
    plot
}
