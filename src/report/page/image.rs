//! The volume image: what the wall shows, from three sides.

use maud::{Markup, html};
use plotly::common::{ColorBar, ColorScale, ColorScalePalette, Title};
use plotly::layout::{Axis, AxisConstrain, Layout, Margin};
use plotly::{HeatMap, Plot};

use super::plot::{PALE, figure, short};
use super::words::{count, metres, sig};
use crate::report::image::{Image, Projection};

/// Digits of drawn coordinates.
const DIGITS: i32 = 5;

/// The image, with what is said of it as a whole.
pub fn image(image: &Image) -> Markup {
    let whole = &image.whole;
    html! {
        h3 { "What the wall shows" }
        @if image.projections.is_empty() {
            p { "No voxel is brighter than noise." }
        }
        div.pair {
            @for (n, (view, projection)) in image.projections.iter().enumerate() {
                (figure(&format!("image-{n}"), 360, &plot(projection), &format!("The image {view}. {}", alternative(image)), &html! { "The image " (view) ": largest significance along the line of sight." }))
            }
        }
        p.note {
            (count(whole.voxels as usize, "voxel", "voxels")) " of " (whole.cells) " by " (whole.method) ", brighter than noise by "
            (sig(whole.threshold, 3)) " standard deviations or more. "
            @if let (Some(largest), Some(x_m), Some(y_m), Some(z_m)) = (whole.largest, whole.largest_x_m, whole.largest_y_m, whole.largest_z_m) {
                "The brightest, at (" (metres(x_m)) ", " (metres(y_m)) ", " (metres(z_m)) ") m, by " (sig(largest, 3)) ". "
            }
            "Light counts from " (sig(whole.gate_ps, 4)) " ps behind that of the wall. Near a bright surface, voxels may be artefacts of the method. Table " code { (image.heading) } "."
        }
    }
}

fn alternative(image: &Image) -> String {
    let whole = &image.whole;
    let largest = whole
        .largest
        .map_or(String::new(), |largest| format!(", the brightest by {} standard deviations", sig(largest, 3)));
    format!("{} brighter than noise{largest}.", count(whole.voxels as usize, "voxel", "voxels"))
}

fn plot(projection: &Projection) -> Plot {
    let places =
        |middles_m: &[f64]| -> Vec<f64> { middles_m.iter().map(|middle_m| short(*middle_m, DIGITS)).collect() };
    let levels: Vec<Vec<Option<f64>>> = projection
        .levels
        .iter()
        .map(|row| row.iter().map(|level| level.map(|level| short(level, 3))).collect())
        .collect();
    let heat = HeatMap::new(places(&projection.across.middles_m), places(&projection.up.middles_m), levels)
        .color_scale(ColorScale::Palette(ColorScalePalette::Viridis))
        .color_bar(ColorBar::new().title(Title::with_text("value / sd")).thickness(12))
        .hover_on_gaps(false)
        .hover_template("(%{x}, %{y}) m: %{z}<extra></extra>");
    let axis = |title: &str| Axis::new().title(title.to_owned()).show_grid(false).zero_line(false);
    let up = axis(&projection.up.title).scale_anchor("x").constrain(AxisConstrain::Domain);
    let across = axis(&projection.across.title).constrain(AxisConstrain::Domain);
    let mut plot = Plot::new();
    plot.add_trace(heat);
    let layout = Layout::new().x_axis(across).y_axis(up).plot_background_color(PALE);
    plot.set_layout(layout.margin(Margin::new().left(55).right(10).top(10).bottom(50)));
    plot
}
