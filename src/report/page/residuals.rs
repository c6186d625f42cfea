//! What the solution leaves over, by lit and seen patch, by time of flight and of day, and against the normal
//! distribution.

use maud::{Markup, html};
use plotly::common::{DashType, Line, Marker, Mode};
use plotly::layout::{Axis, AxisType, BarMode, Layout, Margin};
use plotly::{Bar, Plot, Scatter};

use super::onsets;
use super::plot::{HIDDEN, PALE, VISIBLE, bounces_text, figure, legend_above, of_bounces, short};
use super::words::{count, sig};
use crate::report::Report;
use crate::report::arrivals::path_text;
use crate::report::residuals::{BINS, Point, RANGE, Residuals, normal_quantile};

/// Height of each figure.
const HEIGHT_PX: u32 = 340;
/// Standard errors of a quantile, to either side, in the band of the quantile plot.
const BAND: f64 = 2.0;

/// The section.
pub fn section(report: &Report) -> Markup {
    let Some(residuals) = &report.residuals else { return html! {} };
    html! {
        section #residuals {
            h2 { "Residuals: what the solution leaves over" }
            div.pair {
                (figure("residual-histogram", HEIGHT_PX, &histogram(residuals), &alternative(residuals), &html! {
                    (count(residuals.count, "residual", "residuals")) " in standard deviations; their root mean square is "
                    strong { (sig(residuals.rms, 3)) } ". Error bars of the right size make it near 1. The line is the normal distribution."
                }))
                (figure("residual-quantiles", HEIGHT_PX, &quantiles(residuals), &quantile_alternative(residuals), &html! {
                    "Normal quantile plot: residuals by rank against what a normal distribution gives. On the line error bars are right; steeper they are too small; ends that leave the dashed band are outliers."
                }))
                @for (id, by) in [("residual-lit", By::Lit), ("residual-seen", By::Seen), ("residual-flight", By::Flight), ("residual-day", By::Day)] {
                    @if by != By::Day || dated(&residuals.points) {
                        (figure(id, HEIGHT_PX, &course(&residuals.points, by), &course_alternative(&residuals.points, by), &html! {
                            (by.caption())
                            @if residuals.points.len() < residuals.count { " " (residuals.points.len()) " of them, evenly spread." }
                        }))
                    }
                }
            }
            @if !dated(&residuals.points) { p.note { "The records do not say when they were taken, so that there is no plot by time of day." } }
            (worst(report, residuals))
        }
    }
}

/// What residuals are plotted against.
#[derive(Clone, Copy, PartialEq, Eq)]
enum By {
    Lit,
    Seen,
    Flight,
    Day,
}

impl By {
    fn title(self) -> &'static str {
        match self {
            Self::Lit => "lit patch",
            Self::Seen => "seen patch",
            Self::Flight => "time of flight (ps)",
            Self::Day => "time of capture",
        }
    }

    fn caption(self) -> &'static str {
        match self {
            Self::Lit => {
                "Residuals by lit patch. A column off zero: the laser met this patch elsewhere, or its labels are wrong."
            }
            Self::Seen => {
                "Residuals by seen patch. A column off zero: the sensor saw elsewhere, or its labels are wrong."
            }
            Self::Flight => {
                "Residuals by time of flight. A slope: a wrong time base, or a wrong path among the late ones."
            }
            Self::Day => "Residuals by time of capture. A trend: the delay drifted; capture fiducials.",
        }
    }

    fn of(self, point: &Point) -> String {
        match self {
            Self::Lit => point.lit.to_string(),
            Self::Seen => point.seen.to_string(),
            Self::Flight => format!("{:.0}", point.time_ps),
            Self::Day => point.acquired_at.as_deref().unwrap_or_default().to_owned(),
        }
    }

    fn axis(self) -> Axis {
        let axis = Axis::new().title(self.title());
        match self {
            Self::Day => axis.type_(AxisType::Date),
            _ => axis.type_(AxisType::Linear).tick_format(",~f"),
        }
    }
}

fn dated(points: &[Point]) -> bool {
    !points.is_empty() && points.iter().all(|point| point.acquired_at.is_some())
}

fn alternative(residuals: &Residuals) -> String {
    let beyond: usize = residuals.quantiles.iter().filter(|(_, pull)| pull.abs() > 4.0).count();
    format!(
        "Histogram of {} residuals; root mean square {} standard deviations; {beyond} beyond four.",
        residuals.count,
        sig(residuals.rms, 3)
    )
}

fn quantile_alternative(residuals: &Residuals) -> String {
    let end = |at: Option<&(f64, f64)>| {
        at.map_or(String::new(), |(normal, pull)| format!("{} where {} is expected", sig(*pull, 3), sig(*normal, 3)))
    };
    let (first, last) = (end(residuals.quantiles.first()), end(residuals.quantiles.last()));
    format!("Normal quantile plot of residuals. Lowest: {first}. Highest: {last}.")
}

fn course_alternative(points: &[Point], by: By) -> String {
    let worst = points.iter().max_by(|a, b| a.pull.abs().total_cmp(&b.pull.abs()));
    let worst =
        worst.map_or(String::new(), |worst| format!(" The largest, {}, is {}.", sig(worst.pull, 3), worst.name));
    format!("Residuals in standard deviations by {}.{worst}", by.title())
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

/// Residuals by rank against the normal distribution, with the band in which chance leaves them.
fn quantiles(residuals: &Residuals) -> Plot {
    let (x, y): (Vec<f64>, Vec<f64>) =
        residuals.quantiles.iter().map(|(normal, pull)| (short(*normal, 4), short(*pull, 4))).unzip();
    let most = x.iter().copied().fold(1.0, |most: f64, value| most.max(value.abs()));
    let line = |name: &str, x: Vec<f64>, y: Vec<f64>, dash: DashType| {
        let look = Line::new().color(PALE).width(1.2).dash(dash);
        Scatter::new(x, y).mode(Mode::Lines).name(name).line(look).hover_info(plotly::common::HoverInfo::Skip)
    };
    let mut plot = Plot::new();
    plot.add_trace(line("normal", vec![-most, most], vec![-most, most], DashType::Solid));
    for side in [-1.0, 1.0] {
        let (x, y) = band(residuals.count, side);
        plot.add_trace(line("two standard errors", x, y, DashType::Dash));
    }
    let marker = Marker::new().size(5).color(VISIBLE);
    let points = Scatter::new(x, y).mode(Mode::Markers).name("residuals").marker(marker);
    plot.add_trace(points.hover_template("%{y:.2f} where %{x:.2f} is expected<extra></extra>"));
    let layout = Layout::new()
        .show_legend(false)
        .x_axis(Axis::new().title("normal quantile"))
        .y_axis(Axis::new().title("residual (standard deviations)"));
    plot.set_layout(layout.margin(Margin::new().left(55).right(10).top(10).bottom(50)));
    plot
}

/// Quantiles of the normal distribution, moved by standard errors of a sample's quantiles: `sqrt(p (1 - p) / n)` over
/// the density.
fn band(count: usize, side: f64) -> (Vec<f64>, Vec<f64>) {
    let least = 0.5 / count as f64;
    let quantile = |i: u32| {
        let probability =
            least + (1.0 - 2.0 * least) * (1.0 - (std::f64::consts::PI * f64::from(i) / 60.0).cos()) / 2.0;
        let normal = normal_quantile(probability);
        let density = (-normal * normal / 2.0).exp() / std::f64::consts::TAU.sqrt();
        let error = (probability * (1.0 - probability) / count as f64).sqrt() / density;
        (short(normal, 4), short(normal + side * BAND * error, 4))
    };
    (0..=60).map(quantile).unzip()
}

fn course(points: &[Point], by: By) -> Plot {
    let mut plot = Plot::new();
    for bounces in 0..=4 {
        let of_these: Vec<&Point> = points.iter().filter(|point| point.bounces.min(4) == bounces).collect();
        if of_these.is_empty() {
            continue;
        }
        let y: Vec<f64> = of_these.iter().map(|point| short(point.pull, 3)).collect();
        let text: Vec<String> = of_these.iter().map(|point| point.name.clone()).collect();
        let x: Vec<String> = of_these.iter().map(|point| by.of(point)).collect();
        let marker = Marker::new().size(5).color(of_bounces(bounces)).opacity(0.7);
        let scatter =
            Scatter::new(x, y).mode(Mode::Markers).name(bounces_text(bounces)).marker(marker).hover_text_array(text);
        plot.add_trace(scatter.hover_template("%{hovertext}<br>%{y:.2f} sd<extra></extra>"));
    }
    let y_axis = Axis::new().title("residual (standard deviations)");
    let layout = Layout::new().x_axis(by.axis()).y_axis(y_axis).legend(legend_above()).show_legend(by == By::Lit);
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
            (onsets::table(report, residuals.worst.iter()))
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
