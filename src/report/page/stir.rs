//! Images of the space-time impulse response, one lit patch at a time.

use maud::{Markup, html};
use plotly::common::{ColorBar, ColorScale, ColorScalePalette, Line, Marker, Mode, Pad, Title, Visible};
use plotly::layout::{
    Axis, AxisType, Layout, Margin, Slider, SliderCurrentValue, SliderCurrentValueXAnchor, SliderMethod, SliderStep,
};
use plotly::{HeatMap, Plot, Scatter};
use serde_json::json;

use super::plot::{bounces_text, figure, legend_above, of_bounces, short};
use super::words::count;
use crate::history::behind::OnsetBehind;
use crate::report::Report;
use crate::report::arrivals::path_text;
use crate::report::stir::{Image, Stir};
use crate::tables::Name;

/// Digits of drawn times.
const DIGITS: i32 = 5;

/// Images of the space-time impulse response.
pub fn section(report: &Report) -> Markup {
    let Some(stir) = &report.stir else { return html! {} };
    html! {
        section #stir {
            h2 { "The space-time impulse response (STIR)" }
            (figure("stir-plot", stir_height(stir), &stir_plot(stir), &alternative(stir), &html! {
                "The space-time impulse response, the sensor's own response undone: each row is a seen patch, the slider is the lit one. "
                "Brightness is signal over noise, as a power of ten; circles are onsets, coloured by their bounces. "
                @if stir.images.len() < stir.lit {
                    (stir.images.len()) " of " (count(stir.lit, "lit patch", "lit patches")) " are embedded; the others: "
                    code { "SELECT * FROM '" (report.folder) "/" (stir.heading) "/*.parquet' WHERE lit = 1" } ". "
                }
                "Table " code { (stir.heading) } "."
            }))
        }
    }
}

fn alternative(stir: &Stir) -> String {
    let onsets: usize = stir.images.iter().map(|image| image.onsets.len()).sum();
    let unlabelled = stir.images.iter().flat_map(|image| &image.onsets).filter(|onset| onset.path.is_none()).count();
    format!(
        "Images of the signal over time of flight and seen patch, for {}: {}, {unlabelled} of them without a path.",
        count(stir.images.len(), "lit patch", "lit patches"),
        count(onsets, "onset", "onsets")
    )
}

fn stir_height(stir: &Stir) -> u32 {
    let rows = stir.images.iter().map(|image| image.seen.len()).max().unwrap_or(0) as u32;
    (280 + 14 * rows).clamp(380, 780)
}

fn stir_plot(stir: &Stir) -> Plot {
    let mut plot = Plot::new();
    let differ = |of: fn(&Image) -> &Name| stir.images.iter().any(|image| of(image) != of(&stir.images[0]));
    let named = (differ(|image| &image.lit.0), differ(|image| &image.lit.1));
    let times_ps: Vec<f64> = stir.times_ps.iter().map(|time| short(*time, DIGITS)).collect();
    let top = stir.images.iter().flat_map(|image| image.levels.iter().flatten()).copied().fold(1.0, f64::max);
    // Four traces an image: the image, and its onsets by bounces 0 to 2, 3 and more.
    let mut traces = Vec::new();
    for (shown, image) in stir.images.iter().enumerate() {
        let visible = || if shown == 0 { Visible::True } else { Visible::False };
        let seen: Vec<String> = image.seen.iter().map(ToString::to_string).collect();
        let levels: Vec<Vec<f64>> =
            image.levels.iter().map(|row| row.iter().map(|level| (level * 10.0).round() / 10.0).collect()).collect();
        let bar = ColorBar::new().title(Title::with_text("log10 S/N")).thickness(12);
        let heat = HeatMap::new(times_ps.clone(), seen, levels)
            .color_scale(ColorScale::Palette(ColorScalePalette::Viridis))
            .zmin(0.0)
            .zmax(top)
            .color_bar(bar)
            .visible(visible())
            .hover_template("%{x:.0f} ps, seen %{y}<br>signal / noise 10^%{z:.1f}<extra></extra>");
        plot.add_trace(heat);
        traces.push(shown);
        for bounces in 0..4 {
            if let Some(onsets) = onsets_of(image, bounces) {
                plot.add_trace(onsets.visible(visible()));
                traces.push(shown);
            }
        }
    }
    let steps: Vec<SliderStep> =
        stir.images.iter().enumerate().map(|(shown, image)| step(shown, image, &traces, named)).collect();
    let slider = Slider::new()
        .active(0)
        .current_value(SliderCurrentValue::new().prefix("lit ").x_anchor(SliderCurrentValueXAnchor::Right))
        .pad(Pad::new(70, 10, 0))
        .steps(steps);
    let x_axis = Axis::new().title("time of flight (ps)").tick_format(",~f");
    let y_axis = Axis::new().title("seen patch").type_(AxisType::Category);
    let layout = Layout::new()
        .x_axis(x_axis)
        .y_axis(y_axis)
        .legend(legend_above())
        .margin(Margin::new().left(60).right(10).top(30).bottom(50));
    plot.set_layout(if stir.images.len() > 1 { layout.sliders(vec![slider]) } else { layout });
    plot
}

/// Onsets of `bounces`; of three and more together.
fn onsets_of(image: &Image, bounces: usize) -> Option<Box<Scatter<f64, String>>> {
    let is_of =
        |onset: &&OnsetBehind| onset.path.as_ref().map_or(0, Vec::len).min(3) == bounces && onset.time_ps.is_some();
    let of_these: Vec<&OnsetBehind> = image.onsets.iter().filter(is_of).collect();
    if of_these.is_empty() {
        return None;
    }
    let x = of_these.iter().filter_map(|onset| onset.time_ps.map(|time_ps| short(time_ps, DIGITS))).collect();
    let y = of_these.iter().map(|onset| onset.seen.to_string()).collect();
    let text = of_these.iter().map(|onset| path_text(onset.path.as_deref())).collect();
    let name = if bounces == 3 { "3rd bounce and later" } else { bounces_text(bounces) };
    let marker = Marker::new().size(9).color("rgba(0,0,0,0)").line(Line::new().width(2.0).color(of_bounces(bounces)));
    let scatter = Scatter::new(x, y).mode(Mode::Markers).name(name).marker(marker).hover_text_array(text);
    Some(scatter.hover_template("%{hovertext}<br>%{x:.0f} ps<extra></extra>"))
}

/// The slider's step that shows one image alone.
fn step(shown: usize, image: &Image, traces: &[usize], (campaign, sensor): (bool, bool)) -> SliderStep {
    let visible: Vec<bool> = traces.iter().map(|of| *of == shown).collect();
    let mut label = image.lit.2.to_string();
    for (name, is_named) in [(&image.lit.1, sensor), (&image.lit.0, campaign)] {
        if is_named {
            label = format!("{label}, {name}");
        }
    }
    SliderStep::new().label(label).method(SliderMethod::Restyle).args(json!([{ "visible": visible }]))
}
