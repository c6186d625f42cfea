//! Residuals against the normal distribution.

use plotters::element::{PathElement, Rectangle};
use plotters::style::Color;

use super::canvas::{Drawn, HIDDEN, VISIBLE, axes, canvas, number};
use crate::report::residuals::{BINS, RANGE, Residuals};

/// The histogram, and what a normal distribution would give.
pub fn residuals(residuals: &Residuals) -> Drawn {
    let width = 2.0 * RANGE / BINS as f64;
    let density = |x: f64| (-x * x / 2.0).exp() / std::f64::consts::TAU.sqrt() * width * residuals.count as f64;
    let highest = residuals.histogram.iter().map(|count| *count as f64).fold(density(0.0), f64::max);
    canvas((560, 400), |area| {
        let titles = ("residual (standard deviations)", "onsets");
        let mut chart = axes(area, -RANGE..RANGE, 0.0..highest * 1.05, titles, number)?;
        for (bin, count) in residuals.histogram.iter().enumerate() {
            let from = -RANGE + bin as f64 * width;
            chart.draw_series([Rectangle::new(
                [(from, 0.0), (from + width, *count as f64)],
                VISIBLE.mix(0.7).filled(),
            )])?;
        }
        let curve: Vec<(f64, f64)> =
            (0..=200).map(|i| -RANGE + 2.0 * RANGE * f64::from(i) / 200.0).map(|x| (x, density(x))).collect();
        chart.draw_series([PathElement::new(curve, HIDDEN.stroke_width(2))])?;
        Ok(())
    })
}
