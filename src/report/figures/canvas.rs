//! What all figures share: size, colours, axes.

use std::ops::Range;

use plotters::chart::{ChartBuilder, ChartContext};
use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::drawing::{DrawingArea, DrawingAreaErrorKind, IntoDrawingArea};
use plotters::prelude::{Cartesian2d, IntoFont, RGBColor, SVGBackend};
use plotters::style::{BLACK, WHITE};

/// A figure, or why it could not be drawn.
pub type Drawn = Result<String, Failure>;
/// Why something could not be drawn.
pub type Failure = DrawingAreaErrorKind<std::io::Error>;
/// A part of the figure.
pub type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
/// A part with axes.
pub type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// Patches that laser and sensor see.
pub const VISIBLE: RGBColor = RGBColor(31, 98, 160);
/// Patches that neither sees.
pub const HIDDEN: RGBColor = RGBColor(201, 95, 18);
/// Patches that nothing comes straight back from.
pub const MIRROR: RGBColor = RGBColor(122, 80, 190);
/// Laser and sensors.
pub const STATION: RGBColor = RGBColor(170, 40, 30);
/// For what matters less.
pub const PALE: RGBColor = RGBColor(130, 135, 145);

/// Colour of an arrival of `bounces` (0: unexplained).
pub fn of_bounces(bounces: usize) -> RGBColor {
    [PALE, RGBColor(27, 130, 100), VISIBLE, HIDDEN, RGBColor(190, 40, 95)][bounces.min(4)]
}

const TEXT: &str = "sans-serif";
/// Height of texts in pixels.
pub const TEXT_PX: u32 = 14;

/// A figure of this size in pixels on white.
pub fn canvas(size: (u32, u32), draw: impl FnOnce(&Area<'_>) -> Result<(), Failure>) -> Drawn {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        area.fill(&WHITE)?;
        draw(&area)?;
        area.present()?;
    }
    Ok(svg)
}

/// Axes with titles; `y_text` writes the labels of the ordinate.
pub fn axes<'a, 'b>(
    area: &'a Area<'b>,
    x: Range<f64>,
    y: Range<f64>,
    titles: (&str, &str),
    y_text: impl Fn(&f64) -> String,
) -> Result<Chart<'a, 'b>, Failure> {
    let mut chart =
        ChartBuilder::on(area).margin(10).x_label_area_size(45).y_label_area_size(65).build_cartesian_2d(x, y)?;
    chart
        .configure_mesh()
        .disable_mesh()
        .axis_style(BLACK)
        .x_desc(titles.0)
        .y_desc(titles.1)
        .x_label_formatter(&number)
        .y_label_formatter(&y_text)
        .label_style((TEXT, TEXT_PX).into_font())
        .axis_desc_style((TEXT, TEXT_PX).into_font())
        .draw()?;
    Ok(chart)
}

/// A number at an axis: without the digits that rounding leaves.
#[allow(clippy::trivially_copy_pass_by_ref, reason = "the library asks for it")]
pub fn number(value: &f64) -> String {
    let text = format!("{value:.6}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

/// A font for texts within the axes.
pub fn font() -> plotters::style::TextStyle<'static> {
    (TEXT, TEXT_PX).into_font().into()
}

/// Least and greatest of some values, with a share of their range added on either side.
pub fn range(values: impl Iterator<Item = f64> + Clone, share: f64) -> Range<f64> {
    let (least, most) = (values.clone().fold(f64::INFINITY, f64::min), values.fold(f64::NEG_INFINITY, f64::max));
    let beside = ((most - least) * share).max(f64::MIN_POSITIVE.max(most.abs() * 1e-9));
    least - beside..most + beside
}
