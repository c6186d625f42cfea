//! Images: the space-time impulse response of one lit patch, and the matrix of distances.

use plotters::element::{Circle, Rectangle, Text};
use plotters::prelude::{ColorMap, ViridisRGB};
use plotters::style::{Color, ShapeStyle};

use super::canvas::{Drawn, axes, canvas, font, number, of_bounces};
use crate::report::distances::Distances;
use crate::report::stir::{Image, Stir};

/// Shades of an image.
const SHADES: f64 = 24.0;

/// The image with the most onsets.
pub fn stir(stir: &Stir) -> Drawn {
    let image = stir.images.iter().max_by_key(|image| image.onsets.len()).expect("there is an image");
    let top = image.levels.iter().flatten().copied().fold(1.0, f64::max);
    let step_ps = stir.times_ps[1] - stir.times_ps[0];
    let x = stir.times_ps[0] - step_ps / 2.0..stir.times_ps[stir.times_ps.len() - 1] + step_ps / 2.0;
    canvas((760, 440), |area| {
        let (head, rest) = area.split_vertically(26);
        let title = format!("lit patch {}; brightness: signal / noise from 1 to 10^{top:.1}", image.lit.2);
        head.draw(&Text::new(title, (15, 8), font()))?;
        let names = |row: &f64| row_name(image, *row);
        let mut chart =
            axes(&rest, x, -0.5..image.seen.len() as f64 - 0.5, ("time of flight (ps)", "seen patch"), names)?;
        let dark = ViridisRGB.get_color(0.0).filled();
        let all = [
            (stir.times_ps[0] - step_ps / 2.0, -0.5),
            (stir.times_ps[stir.times_ps.len() - 1] + step_ps / 2.0, image.seen.len() as f64 - 0.5),
        ];
        chart.draw_series([Rectangle::new(all, dark)])?;
        for (row, levels) in image.levels.iter().enumerate() {
            for (from, to, shade) in runs(levels, top) {
                let corners = [
                    (stir.times_ps[from] - step_ps / 2.0, row as f64 - 0.5),
                    (stir.times_ps[to - 1] + step_ps / 2.0, row as f64 + 0.5),
                ];
                chart.draw_series([Rectangle::new(corners, shade)])?;
            }
        }
        for onset in &image.onsets {
            let (Some(time_ps), Ok(row)) = (onset.time_ps, image.seen.binary_search(&onset.seen)) else { continue };
            let colour = of_bounces(onset.path.as_ref().map_or(0, Vec::len));
            chart.draw_series([Circle::new((time_ps, row as f64), 5, colour.stroke_width(2))])?;
        }
        Ok(())
    })
}

fn row_name(image: &Image, row: f64) -> String {
    let is_whole = (row - row.round()).abs() < 1e-6;
    let seen = is_whole.then(|| image.seen.get(row.round().max(0.0) as usize)).flatten();
    seen.map_or(String::new(), ToString::to_string)
}

/// Stretches of one shade above the darkest: from, to, shade.
fn runs(levels: &[f64], top: f64) -> Vec<(usize, usize, ShapeStyle)> {
    let shade = |level: f64| (SHADES * level / top).round() as i64;
    let mut runs = Vec::new();
    let mut from = 0;
    for to in 1..=levels.len() {
        if to == levels.len() || shade(levels[to]) != shade(levels[from]) {
            if shade(levels[from]) > 0 {
                runs.push((from, to, ViridisRGB.get_color(shade(levels[from]) as f64 / SHADES).filled()));
            }
            from = to;
        }
    }
    runs
}

/// Distances, with gaps left white.
pub fn distances(distances: &Distances) -> Drawn {
    let longest_m = distances.of_pair.values().map(|(distance_m, _)| *distance_m).fold(f64::MIN_POSITIVE, f64::max);
    let size = distances.patches.len() as f64;
    canvas((560, 560), |area| {
        let (head, rest) = area.split_vertically(26);
        let title = format!(
            "distances from 0 (dark) to {} m (bright); white: no distance",
            number(&((longest_m * 1000.0).round() / 1000.0))
        );
        head.draw(&Text::new(title, (15, 8), font()))?;
        let name = |place: &f64| {
            let is_whole = (place - place.round()).abs() < 1e-6;
            let patch = is_whole.then(|| distances.patches.get(place.round().max(0.0) as usize)).flatten();
            patch.map_or(String::new(), ToString::to_string)
        };
        let mut chart =
            axes(&rest, -0.5..size - 0.5, -0.5..size - 0.5, ("place of patch, in order of numbers", "patch"), name)?;
        for ((a, b), (distance_m, _)) in &distances.of_pair {
            let shade = ViridisRGB.get_color(distance_m / longest_m).filled();
            for (x, y) in [(*a as f64, *b as f64), (*b as f64, *a as f64)] {
                chart.draw_series([Rectangle::new([(x - 0.5, y - 0.5), (x + 0.5, y + 0.5)], shade)])?;
            }
        }
        Ok(())
    })
}
