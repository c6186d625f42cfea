//! How the answer grew from run to run.

use maud::{Markup, html};
use plotly::common::{Line, Marker, Mode};
use plotly::layout::{Axis, AxisType, Layout, Margin};
use plotly::{Plot, Scatter};

use super::plot::{HIDDEN, VISIBLE, figure, legend_above, short};
use super::words::{count, millimetres};
use crate::report::Report;
use crate::report::growth::Step;

/// The section; nothing where no run changed the positions of another.
pub fn section(report: &Report) -> Markup {
    let steps = &report.growth.steps;
    html! {
        @if steps.len() > 1 {
            section #growth {
                h2 { "How the answer grew" }
                (figure("growth-plot", 340, &plot(steps), &alternative(steps), &html! {
                    "Median standard deviation of patches against all valid shots, one point for each run that changed the positions. It falls as the inverse root of the shots where noise limits it. Runs that found no standard deviation are in the table alone."
                }))
                div.scroll tabindex="0" role="region" aria-label="runs" {
                    table.numbers {
                        thead { tr { th { "run (UTC)" } th { "parts" } th { "profiles" } th { "shots" } th { "visible" } th { "median sd" } th { "hidden" } th { "median sd" } } }
                        tbody {
                            @for step in steps {
                                tr {
                                    td { (step.started) }
                                    td { (step.parts) }
                                    td { (step.profiles) }
                                    td { (step.shots) }
                                    @for (patches, sd_m) in [step.visible, step.hidden] {
                                        td { (patches) }
                                        td { (sd_m.map_or_else(|| "-".to_owned(), millimetres)) }
                                    }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

fn alternative(steps: &[Step]) -> String {
    let end = |step: &Step| {
        let sd = step.visible.1.or(step.hidden.1).map_or_else(|| "no standard deviation".to_owned(), millimetres);
        format!("{} shots, {sd}", step.shots)
    };
    let ends = [steps.first(), steps.last()].map(|step| step.map_or(String::new(), end));
    format!("How the answer grew over {}: from {} to {}.", count(steps.len(), "run", "runs"), ends[0], ends[1])
}

fn plot(steps: &[Step]) -> Plot {
    let mut plot = Plot::new();
    let of_kind: [(&str, &str, fn(&Step) -> Option<f64>); 2] =
        [("visible", VISIBLE, |step| step.visible.1), ("hidden", HIDDEN, |step| step.hidden.1)];
    for (kind, colour, sd_m) in of_kind {
        let sure: Vec<(&Step, f64)> = steps.iter().filter_map(|step| Some((step, sd_m(step)?))).collect();
        if sure.is_empty() {
            continue;
        }
        let x: Vec<i64> = sure.iter().map(|(step, _)| step.shots).collect();
        let y: Vec<f64> = sure.iter().map(|(_, sd_m)| short(1e3 * sd_m, 4)).collect();
        let text = sure.iter().map(|(step, _)| format!("{}<br>{} profiles", step.started, step.profiles)).collect();
        let (line, marker) = (Line::new().color(colour).width(1.2), Marker::new().color(colour).size(8));
        let scatter = Scatter::new(x, y).mode(Mode::LinesMarkers).name(kind).line(line).marker(marker);
        plot.add_trace(
            scatter.hover_text_array(text).hover_template("%{hovertext}<br>%{x} shots: %{y} mm<extra></extra>"),
        );
    }
    let layout = Layout::new()
        .x_axis(Axis::new().title("valid shots, all profiles"))
        .y_axis(Axis::new().title("median sd (mm)").type_(AxisType::Log))
        .legend(legend_above());
    plot.set_layout(layout.margin(Margin::new().left(65).right(10).top(30).bottom(50)));
    plot
}
