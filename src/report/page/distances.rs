//! The matrix of distances.

use maud::{Markup, html};
use plotly::common::{ColorBar, ColorScale, ColorScalePalette, Title};
use plotly::layout::{Axis, AxisType, Layout, Margin};
use plotly::{HeatMap, Plot};

use super::plot::{PALE, figure, short};
use super::words::{count, sig};
use crate::report::Report;
use crate::report::distances::Distances;

/// The matrix of distances.
pub fn section(report: &Report) -> Markup {
    let Some(distances) = &report.distances else { return html! {} };
    html! {
        section #distances {
            h2 { "Distances between patches" }
            div.pair {
                (figure("distance-matrix", 420, &matrix(distances, "m", |(distance_m, _)| short(distance_m, 5)), &alternative(distances, "Distances", |pair| pair.0), &html! {
                    "Distances in metres; 0 is source and camera. "
                    @match distances.gaps() {
                        0 => "No pair is missing.",
                        gaps => { (count(gaps, "pair is", "pairs are")) " missing (blank)." },
                    }
                }))
                (figure("distance-errors", 420, &matrix(distances, "mm", |(_, sd_m)| short(1e3 * sd_m, 3)), &alternative(distances, "Standard deviations of distances", |pair| pair.1), &html! {
                    "Their standard deviations in millimetres. "
                    @if distances.patches.len() < distances.all { "The first " (distances.patches.len()) " of " (distances.all) " patches. " }
                    "Table " code { (distances.heading) } "."
                }))
            }
        }
    }
}

fn alternative(distances: &Distances, what: &str, value: impl Fn((f64, f64)) -> f64) -> String {
    let values_m = || distances.of_pair.values().map(|pair| value(*pair));
    let (least_m, most_m) = (values_m().fold(f64::INFINITY, f64::min), values_m().fold(0.0, f64::max));
    format!("{what} of {} pairs of patches, from {} to {} m.", distances.of_pair.len(), sig(least_m, 3), sig(most_m, 3))
}

fn matrix(distances: &Distances, unit: &str, value: impl Fn((f64, f64)) -> f64) -> Plot {
    let names: Vec<String> = distances.patches.iter().map(ToString::to_string).collect();
    let places = 0..names.len();
    let cell = |a: usize, b: usize| distances.of_pair.get(&(a.min(b), a.max(b))).map(|pair| value(*pair));
    let rows: Vec<Vec<Option<f64>>> = places.clone().map(|a| places.clone().map(|b| cell(a, b)).collect()).collect();
    let heat = HeatMap::new(names.clone(), names, rows)
        .color_scale(ColorScale::Palette(ColorScalePalette::Viridis))
        .color_bar(ColorBar::new().title(Title::with_text(unit)).thickness(12))
        .hover_on_gaps(false)
        .hover_template(format!("%{{y}} to %{{x}}: %{{z}} {unit}<extra></extra>"));
    let axis = || Axis::new().title("patch").type_(AxisType::Category).show_grid(false);
    let mut plot = Plot::new();
    plot.add_trace(heat);
    let layout = Layout::new()
        .x_axis(axis())
        .y_axis(axis().auto_range(false).range(vec![distances.patches.len() as f64 - 0.5, -0.5]));
    plot.set_layout(layout.plot_background_color(PALE).margin(Margin::new().left(50).right(10).top(10).bottom(50)));
    plot
}
