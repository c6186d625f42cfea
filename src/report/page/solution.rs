//! How well the solution holds: residuals, and distances.

use maud::{Markup, html};
use plotly::common::{ColorBar, ColorScale, ColorScalePalette, Line, Marker, Mode, Title};
use plotly::layout::{Axis, AxisType, BarMode, Layout, Legend, Margin};
use plotly::{Bar, HeatMap, Plot, Scatter};

use super::plot::{HIDDEN, PALE, VISIBLE, bounces_text, figure, of_bounces, short};
use super::waves;
use super::words::{count, sig};
use crate::history::behind::OnsetBehind;
use crate::report::Report;
use crate::report::arrivals::path_text;
use crate::report::distances::Distances;
use crate::report::residuals::{BINS, Point, RANGE, Residuals, name};

/// What the solution leaves over.
pub fn residuals(report: &Report) -> Markup {
    html! {
        section #residuals {
            h2 { "What the solution leaves over" }
            @match &report.residuals {
                None => p { "No onset has a residual: nothing predicted when it should come." },
                Some(residuals) => {
                    div.pair {
                        (figure("residual-histogram", 340, &histogram(residuals), &html! {
                            (count(residuals.count, "residual", "residuals")) " in standard deviations; their root mean square is "
                            strong { (sig(residuals.rms, 3)) } " where error bars of the right size make it near 1. The line is the normal distribution."
                        }))
                        (figure("residual-course", 340, &course(&residuals.points), &html! {
                            "The same against " @if dated(&residuals.points) { "the time of capture: drift shows here." } @else { "time of flight." }
                            @if residuals.points.len() < residuals.count { " " (residuals.points.len()) " of them, evenly spread." }
                        }))
                    }
                    (worst(report, residuals))
                }
            }
        }
    }
}

fn dated(points: &[Point]) -> bool {
    !points.is_empty() && points.iter().all(|point| point.acquired_at.is_some())
}

fn histogram(residuals: &Residuals) -> Plot {
    let width = 2.0 * RANGE / BINS as f64;
    let middles: Vec<f64> = (0..BINS).map(|bin| -RANGE + (bin as f64 + 0.5) * width).collect();
    let bars = Bar::new(middles, residuals.histogram.clone()).name("residuals").marker(Marker::new().color(VISIBLE));
    let fine: Vec<f64> = (0..=200).map(|i| short(-RANGE + 2.0 * RANGE * f64::from(i) / 200.0, 4)).collect();
    let density = |x: &f64| (-x * x / 2.0).exp() / std::f64::consts::TAU.sqrt();
    let expected = fine.iter().map(|x| short(density(x) * width * residuals.count as f64, 4)).collect();
    let normal =
        Scatter::new(fine, expected).mode(Mode::Lines).name("normal").line(Line::new().color(HIDDEN).width(2.0));
    let mut plot = Plot::new();
    plot.add_trace(bars);
    plot.add_trace(normal);
    let layout = Layout::new().bar_mode(BarMode::Overlay).bar_gap(0.05).show_legend(false);
    let layout = layout.x_axis(Axis::new().title("residual (standard deviations)")).y_axis(Axis::new().title("onsets"));
    plot.set_layout(layout.margin(Margin::new().left(55).right(10).top(10).bottom(50)));
    plot
}

fn course(points: &[Point]) -> Plot {
    let mut plot = Plot::new();
    let is_dated = dated(points);
    for bounces in 0..=4 {
        let of_these: Vec<&Point> = points.iter().filter(|point| point.bounces.min(4) == bounces).collect();
        if of_these.is_empty() {
            continue;
        }
        let y: Vec<f64> = of_these.iter().map(|point| short(point.pull, 3)).collect();
        let text: Vec<String> = of_these.iter().map(|point| point.name.clone()).collect();
        let x: Vec<String> = of_these
            .iter()
            .map(|point| match &point.acquired_at {
                Some(when) if is_dated => when.to_string(),
                _ => format!("{:.0}", point.time_ps),
            })
            .collect();
        let marker = Marker::new().size(5).color(of_bounces(bounces)).opacity(0.7);
        let scatter =
            Scatter::new(x, y).mode(Mode::Markers).name(bounces_text(bounces)).marker(marker).hover_text_array(text);
        plot.add_trace(scatter.hover_template("%{hovertext}<br>%{y:.2f} sd<extra></extra>"));
    }
    let x_axis = if is_dated {
        Axis::new().title("time of capture").type_(AxisType::Date)
    } else {
        Axis::new().title("time of flight (ps)").tick_format(",~f").type_(AxisType::Linear)
    };
    let legend = Legend::new().orientation(plotly::common::Orientation::Horizontal).y(1.12);
    let layout =
        Layout::new().x_axis(x_axis).y_axis(Axis::new().title("residual (standard deviations)")).legend(legend);
    plot.set_layout(layout.margin(Margin::new().left(55).right(10).top(30).bottom(50)));
    plot
}

fn worst(report: &Report, residuals: &Residuals) -> Markup {
    let suspects = report.scene.as_ref().map_or(0, |scene| scene.suspects.len());
    html! {
        details open[suspects > 0] {
            summary {
                "The " (residuals.worst.len()) " farthest off"
                @if suspects > 0 { ", with " (count(suspects, "suspect", "suspects")) }
            }
            (onsets(report, residuals.worst.iter()))
            @if suspects > 0 {
                ul.notes {
                    @for suspect in report.scene.iter().flat_map(|scene| &scene.suspects).take(40) {
                        li {
                            (suspect.sensor) ", lit " (suspect.lit) ", seen " (suspect.seen) ", rank " (suspect.rank) ", as "
                            (path_text(Some(&suspect.path))) ": " strong { (suspect.reason) }
                            @if let Some(off) = suspect.studentised { ", " (sig(off, 3)) " standard deviations off" }
                        }
                    }
                }
            }
            p.note { "All: " code { "periscope explain " (report.folder) " onset=SENSOR,LIT,SEEN,RANK" } ", table " code { (residuals.heading) } "." }
        }
    }
}

/// Onsets as a table; each leads to its profile.
pub fn onsets<'a>(report: &Report, onsets: impl Iterator<Item = &'a OnsetBehind>) -> Markup {
    let is_embedded = |onset: &OnsetBehind| {
        let capture = onset.capture();
        report.waveforms.chosen.binary_search_by(|waveform| waveform.capture.cmp(&capture)).is_ok()
    };
    html! {
        div.scroll {
            table.numbers {
                thead { tr { th { "onset" } th.text { "path" } th { "time (ps)" } th { "sd (ps)" } th { "residual (ps)" } th { "in sd" } th { "signal / noise" } th.text { "flags" } } }
                tbody {
                    @for onset in onsets {
                        tr {
                            td.text {
                                @if is_embedded(onset) { a href={ "#" (waves::anchor(&onset.capture())) } { (name(onset)) } } @else { (name(onset)) }
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

/// The matrix of distances.
pub fn distances(report: &Report) -> Markup {
    html! {
        section #distances {
            h2 { "Distances between patches" }
            @match &report.distances {
                None => p { "This pipeline makes no table of distances: it solves for positions from path lengths." },
                Some(distances) => {
                    div.pair {
                        (figure("distance-matrix", 420, &matrix(distances, "m", |(distance_m, _)| short(distance_m, 5)), &html! {
                            "Distances in metres; 0 is source and camera. "
                            @match distances.gaps() {
                                0 => "No pair is missing.",
                                gaps => { (count(gaps, "pair is", "pairs are")) " missing (blank)." },
                            }
                        }))
                        (figure("distance-errors", 420, &matrix(distances, "mm", |(_, sd_m)| short(1e3 * sd_m, 3)), &html! {
                            "Their standard deviations in millimetres. "
                            @if distances.patches.len() < distances.all { "The first " (distances.patches.len()) " of " (distances.all) " patches. " }
                            "Table " code { (distances.heading) } "."
                        }))
                    }
                }
            }
        }
    }
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
