//! Positions from three sides, with the ellipses of two standard deviations.

use std::ops::Range;

use plotters::element::{Circle, EmptyElement, PathElement, Polygon, Text, TriangleMarker};
use plotters::style::{Color, RGBColor};

use super::canvas::{Area, Drawn, Failure, HIDDEN, MIRROR, PALE, STATION, VISIBLE, axes, canvas, font, number, range};
use crate::report::scene::{Placed, Scene};

/// Size of each of the three views in pixels.
const VIEW_PX: (u32, u32) = (430, 430);
/// Corners of a drawn ellipse.
const CORNERS: usize = 48;
/// Most patches with numbers next to them.
const NUMBERED: usize = 40;
/// Titles of the axes.
const TITLES: [&str; 3] = ["x (m)", "y (m)", "z (m)"];
/// What axes and margins take of a view.
const AXES_PX: (u32, u32) = (85, 65);

/// The three views.
pub fn figure(scene: &Scene) -> Drawn {
    canvas((3 * VIEW_PX.0, VIEW_PX.1 + 30), |area| {
        let (head, rest) = area.split_vertically(30);
        let factor = number(&scene.ellipsoid_factor);
        head.draw(&Text::new(format!("ellipses: 2 sd, drawn {factor} times larger"), (15, 8), font()))?;
        let views = rest.split_evenly((1, 3));
        view(&views[0], scene, [0, 1])?;
        view(&views[1], scene, [0, 2])?;
        view(&views[2], scene, [1, 2])
    })
}

fn view(area: &Area<'_>, scene: &Scene, [across, up]: [usize; 2]) -> Result<(), Failure> {
    let places: Vec<[f64; 3]> = scene.patches.iter().map(Placed::at).chain(scene.stations.values().copied()).collect();
    let along = |axis: usize| range(places.iter().map(move |place| place[axis]), 0.08);
    let (x, y) = equal_scales(along(across), along(up));
    let mut chart = axes(area, x, y, (TITLES[across], TITLES[up]), number)?;
    let at = |place: [f64; 3]| (place[across], place[up]);
    for ray in scene.rays.iter().filter(|ray| ray.is_hidden) {
        let corners: Vec<(f64, f64)> = ray.corners_m.iter().map(|corner| at(*corner)).collect();
        chart.draw_series([PathElement::new(corners, HIDDEN.mix(0.15))])?;
    }
    for placed in &scene.patches {
        let colour = of_kind(&placed.patch.kind);
        if let Some(axes_m) = placed.semi_axes_m {
            let corners = ellipse(axes_m.map(&at), at(placed.at()), 2.0 * scene.ellipsoid_factor);
            chart.draw_series([Polygon::new(corners, colour.mix(0.25))])?;
        }
        chart.draw_series([Circle::new(at(placed.at()), 3, colour.filled())])?;
    }
    for alternative in &scene.alternatives {
        let place = at([alternative.x_m, alternative.y_m, alternative.z_m]);
        chart.draw_series([Circle::new(place, 4, PALE.stroke_width(1))])?;
    }
    chart.draw_series(scene.stations.values().map(|place| TriangleMarker::new(at(*place), 6, STATION.filled())))?;
    if scene.patches.len() <= NUMBERED {
        let name = |placed: &Placed| {
            let style = font().color(of_kind(&placed.patch.kind));
            EmptyElement::at(at(placed.at())) + Text::new(placed.patch.patch.to_string(), (5, -14), style)
        };
        chart.draw_series(scene.patches.iter().map(name))?;
    }
    Ok(())
}

fn of_kind(kind: &str) -> &'static RGBColor {
    match kind {
        "hidden" => &HIDDEN,
        "mirror" => &MIRROR,
        _ => &VISIBLE,
    }
}

/// The shorter of two ranges widened, so that a metre is as long on both axes.
fn equal_scales(x: Range<f64>, y: Range<f64>) -> (Range<f64>, Range<f64>) {
    let pixels = (f64::from(VIEW_PX.0 - AXES_PX.0), f64::from(VIEW_PX.1 - AXES_PX.1));
    let metres_a_pixel = ((x.end - x.start) / pixels.0).max((y.end - y.start) / pixels.1);
    let widened = |range: Range<f64>, pixels: f64| {
        let (middle, half) = (f64::midpoint(range.start, range.end), metres_a_pixel * pixels / 2.0);
        middle - half..middle + half
    };
    (widened(x, pixels.0), widened(y, pixels.1))
}

/// Outline of an ellipsoid's shadow, from the shadows of its semi-axes.
fn ellipse(axes_m: [(f64, f64); 3], (x, y): (f64, f64), factor: f64) -> Vec<(f64, f64)> {
    let sum = |f: fn((f64, f64)) -> f64| axes_m.into_iter().map(f).sum::<f64>();
    let (xx, xy, yy) = (sum(|a| a.0 * a.0), sum(|a| a.0 * a.1), sum(|a| a.1 * a.1));
    // The Cholesky factor of the shadow's covariance turns a circle into the outline.
    let a = xx.sqrt();
    let b = if a > 0.0 { xy / a } else { 0.0 };
    let c = (yy - b * b).max(0.0).sqrt();
    let corner = |i: usize| {
        let (sin, cos) = (std::f64::consts::TAU * i as f64 / CORNERS as f64).sin_cos();
        (x + factor * a * cos, y + factor * (b * cos + c * sin))
    };
    (0..CORNERS).map(corner).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_ellipsoid_of_two_lengths_casts_its_ellipse() {
        let outline = ellipse([(3.0, 0.0), (0.0, 2.0), (0.0, 0.0)], (10.0, 20.0), 2.0);
        for (x, y) in outline {
            assert!((((x - 10.0) / 6.0).powi(2) + ((y - 20.0) / 4.0).powi(2) - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn a_metre_is_as_long_on_both_axes() {
        let (x, y) = equal_scales(0.0..2.0, 0.0..1.0);
        let pixels = (f64::from(VIEW_PX.0 - AXES_PX.0), f64::from(VIEW_PX.1 - AXES_PX.1));
        assert!(((x.end - x.start) / pixels.0 - (y.end - y.start) / pixels.1).abs() < 1e-12);
        assert!(y.start < 0.0 && y.end > 1.0 && x == (0.0..2.0));
    }
}
