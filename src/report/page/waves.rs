//! What was measured: profiles, and the sensors.

use maud::{Markup, html};
use plotly::common::{Fill, Line, Marker, Mode};
use plotly::layout::{Axis, AxisType, Layout, Legend, Margin};
use plotly::{Plot, Scatter};
use serde_json::{Map, Value, json};

use super::plot::{PALE, VISIBLE, bounces_text, data, figure, of_bounces, short};
use super::words::{count, sig};
use crate::history::behind::{CaptureKey, OnsetBehind};
use crate::report::Report;
use crate::report::arrivals::path_text;
use crate::report::responses::Response;
use crate::report::waveforms::Waveform;
use crate::tables::Impulse;

/// From this ratio of the largest to the smallest impulse on, a profile is first shown on a logarithmic axis.
const LOGARITHMIC: f64 = 50.0;
/// Standard errors in an error band, to either side.
const BAND: f64 = 2.0;
/// Digits of drawn times and volts.
const DIGITS: i32 = 5;

/// What an address in the page calls a profile.
pub fn anchor((campaign, sensor, lit, seen): &CaptureKey) -> String {
    let plain = |name: &str| name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect::<String>();
    format!("profile-{}-{}-{lit}-{seen}", plain(campaign), plain(sensor))
}

/// What a profile is called.
pub fn name((campaign, sensor, lit, seen): &CaptureKey, is_with_campaign: bool) -> String {
    let campaign = if is_with_campaign { format!("{campaign}, ") } else { String::new() };
    format!("{campaign}{sensor}: lit {lit}, seen {seen}")
}

/// The chosen profiles, one at a time.
pub fn profiles(report: &Report) -> Markup {
    let waveforms = &report.waveforms;
    let Some(heading) = waveforms.heading.as_ref().filter(|_| !waveforms.chosen.is_empty()) else {
        return html! { section #profiles { h2 { "Profiles" } p { "This result folder keeps no mean profiles of the scene (table " code { "profiles" } ")." } } };
    };
    let several = waveforms.chosen.iter().any(|waveform| waveform.capture.0 != waveforms.chosen[0].capture.0);
    let first = waveforms.telling().unwrap_or(&waveforms.chosen[0]);
    let mut figures = Map::new();
    for waveform in &waveforms.chosen {
        let plot = waveform_plot(waveform);
        let figure: Value = serde_json::from_str(&plot.to_json()).expect("a plot is JSON");
        figures.insert(anchor(&waveform.capture), json!({ "figure": figure, "note": note(waveform) }));
    }
    html! {
        section #profiles {
            h2 { "Profiles, one by one" }
            div.viewer {
                button type="button" id="profile-before" aria-label="profile before" { "<" }
                select id="profile-choice" aria-label="profile" {
                    @for waveform in &waveforms.chosen { option value=(anchor(&waveform.capture)) selected[std::ptr::eq(waveform, first)] { (name(&waveform.capture, several)) } }
                }
                button type="button" id="profile-after" aria-label="profile after" { ">" }
                button type="button" id="profile-scale" { "linear / logarithmic" }
            }
            figure {
                div.plot id="profile" data-viewer="profile-figures" style="height:420px" {}
                (data("profile-figures", &Value::Object(figures).to_string()))
                figcaption {
                    span #profile-note {} " "
                    "Line: mean of all shots, with a band of two standard errors. Stems: the impulses that explain it, named by their paths. "
                    @if waveforms.chosen.len() < waveforms.all {
                        (waveforms.chosen.len()) " of " (waveforms.all) " profiles are embedded: those with the onsets to doubt most, and others evenly spread. The rest: "
                        code { "SELECT * FROM '" (report.folder) "/" (heading) "/*.parquet' WHERE lit = 1 AND seen = 2" } ". "
                    }
                    "Table " code { (heading) } "."
                }
            }
        }
    }
}

fn note(waveform: &Waveform) -> String {
    let when = waveform.acquired_at.as_ref().map_or(String::new(), |when| format!(", captured at {when}"));
    let chi2 =
        waveform.chi2_dof.map_or(String::new(), |chi2| format!(", chi-square a degree of freedom {}", sig(chi2, 3)));
    format!("{}, {} set aside{chi2}{when}.", count(waveform.shots as usize, "shot", "shots"), waveform.rejected)
}

fn waveform_plot(waveform: &Waveform) -> Plot {
    let finite = || waveform.points.iter().filter(|(_, _, se_v)| se_v.is_finite());
    let x: Vec<f64> = finite().map(|(time_ps, ..)| short(*time_ps, DIGITS)).collect();
    let edge =
        |side: f64| -> Vec<f64> { finite().map(|(_, mean_v, se_v)| short(mean_v + side * BAND * se_v, 4)).collect() };
    let none = || Line::new().width(0.0);
    let mut plot = Plot::new();
    plot.add_trace(
        Scatter::new(x.clone(), edge(-1.0))
            .mode(Mode::Lines)
            .line(none())
            .show_legend(false)
            .hover_info(plotly::common::HoverInfo::Skip),
    );
    let band = Scatter::new(x, edge(1.0))
        .mode(Mode::Lines)
        .line(none())
        .fill(Fill::ToNextY)
        .fill_color("rgba(47,127,193,0.3)");
    plot.add_trace(band.name("two standard errors").hover_info(plotly::common::HoverInfo::Skip));
    let x: Vec<f64> = waveform.points.iter().map(|(time_ps, ..)| short(*time_ps, DIGITS)).collect();
    let mean: Vec<f64> = waveform.points.iter().map(|(_, mean_v, _)| short(*mean_v, 4)).collect();
    plot.add_trace(Scatter::new(x, mean).mode(Mode::Lines).name("mean").line(Line::new().color(VISIBLE).width(1.2)));
    let heights = waveform.impulses.iter().map(|impulse| impulse.amplitude_v.abs());
    let (most, least) = (heights.clone().fold(0.0, f64::max), heights.fold(f64::INFINITY, f64::min));
    let floor = floor_v(waveform).min(least / 2.0);
    for bounces in 0..=4 {
        let of_these: Vec<_> = waveform
            .impulses
            .iter()
            .map(|impulse| (impulse, onset_at(waveform, impulse.time_ps)))
            .filter(|(_, onset)| bounces_of(*onset) == bounces)
            .collect();
        if of_these.is_empty() {
            continue;
        }
        let x: Vec<Option<f64>> =
            of_these.iter().flat_map(|(impulse, _)| [Some(short(impulse.time_ps, 7)); 3]).collect();
        let y: Vec<Option<f64>> = of_these.iter().flat_map(|(impulse, _)| stem(floor, impulse.amplitude_v)).collect();
        let text: Vec<String> = of_these.iter().flat_map(|of| [String::new(), words(*of), String::new()]).collect();
        let colour = of_bounces(bounces);
        let stems = Scatter::new(x, y).mode(Mode::LinesMarkers).name(bounces_text(bounces)).hover_text_array(text);
        let stems = stems.line(Line::new().color(colour).width(1.5)).marker(Marker::new().color(colour).size(6));
        plot.add_trace(stems.hover_template("%{hovertext}<extra></extra>"));
    }
    let is_positive = waveform.impulses.iter().all(|impulse| impulse.amplitude_v > 0.0);
    let scale = if is_positive && most > LOGARITHMIC * least { AxisType::Log } else { AxisType::Linear };
    plot.set_layout(layout(scale));
    plot
}

/// Volts of a stem. A logarithmic axis shows none that begins at 0: it begins at the `floor`, well below the noise.
fn stem(floor: f64, height: f64) -> [Option<f64>; 3] {
    [Some(short(floor.min(height.abs()).copysign(height), 3)), Some(short(height, 4)), None]
}

/// What stands over a stem under the pointer.
fn words((impulse, onset): (&Impulse, Option<&OnsetBehind>)) -> String {
    let path = onset.map_or_else(|| "below the threshold".to_owned(), |onset| path_text(onset.path.as_deref()));
    format!(
        "{path}<br>{:.2} +- {} ps<br>{} V, {} times its sd",
        impulse.time_ps,
        sig(impulse.time_sd_ps, 2),
        sig(impulse.amplitude_v, 3),
        sig(impulse.amplitude_v / impulse.amplitude_sd_v, 3)
    )
}

/// Axes and legend; `scale` is that of the volts.
fn layout(scale: AxisType) -> Layout {
    let x_axis = Axis::new().title("time of flight (ps)").tick_format(",~f");
    let y_axis = Axis::new().title("signal (V)").type_(scale);
    let legend = Legend::new().orientation(plotly::common::Orientation::Horizontal).y(1.1);
    let margin = Margin::new().left(70).right(10).top(30).bottom(50);
    Layout::new().x_axis(x_axis).y_axis(y_axis).legend(legend).margin(margin)
}

/// A tenth of the median standard error.
fn floor_v(waveform: &Waveform) -> f64 {
    let mut errors_v: Vec<f64> = waveform.points.iter().map(|(.., se_v)| *se_v).collect();
    errors_v.sort_by(f64::total_cmp);
    errors_v.get(errors_v.len() / 2).map_or(0.0, |median_v| median_v / 10.0)
}

fn bounces_of(onset: Option<&OnsetBehind>) -> usize {
    onset.and_then(|onset| onset.path.as_ref()).map_or(0, Vec::len).min(4)
}

/// The onset that an impulse became.
fn onset_at(waveform: &Waveform, time_ps: f64) -> Option<&OnsetBehind> {
    waveform.onsets.iter().find(|onset| onset.time_ps == Some(time_ps))
}

/// The sensors' responses.
pub fn responses(report: &Report) -> Markup {
    html! {
        section #response {
            h2 { "The sensors' own response" }
            @if report.responses.is_empty() { p { "This result folder keeps no calibration." } }
            @if let Some(Response { heading, .. }) = report.responses.first() {
                (figure("response-plot", 340, &response_plot(&report.responses), &html! {
                    "Impulse response, its extremum at time 0. Table " code { (heading) } "."
                }))
                div.scroll {
                    table.numbers {
                        thead { tr { th { "campaign" } th.text { "sensor" } th.text { "range" } th { "latency (ps)" } th { "width (ps)" } th { "shots" } th { "set aside" } } }
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

fn response_plot(responses: &[Response]) -> Plot {
    let mut plot = Plot::new();
    for (i, Response { row, curve, .. }) in responses.iter().enumerate() {
        let x: Vec<f64> = curve.iter().map(|(time_ps, _)| short(*time_ps, DIGITS)).collect();
        let y: Vec<f64> = curve.iter().map(|(_, value)| short(f64::from(*value), 4)).collect();
        let range = row.range.as_ref().map_or(String::new(), |range| format!(", {range}"));
        let colour = [VISIBLE, super::plot::HIDDEN, super::plot::MIRROR, PALE][i % 4];
        let line = Line::new().width(1.5).color(colour);
        plot.add_trace(
            Scatter::new(x, y).mode(Mode::Lines).name(format!("{} {}{range}", row.campaign, row.sensor)).line(line),
        );
    }
    let layout = Layout::new().x_axis(Axis::new().title("time (ps)")).y_axis(Axis::new().title("response"));
    plot.set_layout(
        layout.show_legend(responses.len() > 1).margin(Margin::new().left(60).right(10).top(10).bottom(50)),
    );
    plot
}
