//! Curves: one profile, and the sensors' responses.

use plotters::element::{Circle, PathElement, Polygon};
use plotters::style::Color;

use super::canvas::{Drawn, HIDDEN, MIRROR, PALE, VISIBLE, axes, canvas, font, number, of_bounces, range};
use crate::report::responses::Response;
use crate::report::waveforms::Waveform;

/// From this ratio of the largest to the smallest impulse on, the ordinate is logarithmic.
const LOGARITHMIC: f64 = 50.0;
/// Standard errors in the band, to either side.
const BAND: f64 = 2.0;

/// Mean, error band, fitted curve and impulses.
pub fn profile(waveform: &Waveform) -> Drawn {
    let heights = waveform.impulses.iter().map(|impulse| impulse.amplitude_v);
    let (most, least) = (heights.clone().fold(0.0, f64::max), heights.clone().fold(f64::INFINITY, f64::min));
    let is_logarithmic = least > 0.0 && least.is_finite() && most > LOGARITHMIC * least;
    let floor_v = least / 10.0;
    let scaled = |value_v: f64| if is_logarithmic { value_v.max(floor_v).log10() } else { value_v };
    let x = range(waveform.points.iter().map(|point| point.time_ps), 0.0);
    let y = range(waveform.points.iter().map(|point| scaled(point.mean_v)).chain(heights.map(scaled)), 0.06);
    let text = |value: &f64| if is_logarithmic { power(*value) } else { number(value) };
    canvas((760, 420), |area| {
        let mut chart = axes(area, x, y, ("time of flight (ps)", "signal (V)"), text)?;
        let edge = |side: f64| {
            let finite = waveform.points.iter().filter(|point| point.se_v.is_finite());
            finite.map(move |point| (point.time_ps, scaled(point.mean_v + side * BAND * point.se_v)))
        };
        let band: Vec<(f64, f64)> = edge(1.0).chain(edge(-1.0).collect::<Vec<_>>().into_iter().rev()).collect();
        chart.draw_series([Polygon::new(band, VISIBLE.mix(0.25))])?;
        let mean = waveform.points.iter().map(|point| (point.time_ps, scaled(point.mean_v)));
        chart.draw_series([PathElement::new(mean.collect::<Vec<_>>(), VISIBLE.stroke_width(1))])?;
        let fitted = waveform.points.iter().filter_map(|point| Some((point.time_ps, scaled(point.fitted_v?))));
        chart.draw_series([PathElement::new(fitted.collect::<Vec<_>>(), HIDDEN.stroke_width(1))])?;
        for impulse in &waveform.impulses {
            let onset = waveform.onsets.iter().find(|onset| onset.time_ps == Some(impulse.time_ps));
            let colour = of_bounces(onset.and_then(|onset| onset.path.as_ref()).map_or(0, Vec::len));
            let top = (impulse.time_ps, scaled(impulse.amplitude_v));
            let foot = (impulse.time_ps, if is_logarithmic { floor_v.log10() } else { 0.0 });
            chart.draw_series([PathElement::new(vec![foot, top], colour.stroke_width(2))])?;
            chart.draw_series([Circle::new(top, 3, colour.filled())])?;
        }
        Ok(())
    })
}

/// A power of ten at an axis.
fn power(value: f64) -> String {
    if (value - value.round()).abs() < 1e-6 { format!("1e{}", value.round()) } else { String::new() }
}

/// All sensors' responses.
pub fn responses(responses: &[Response]) -> Drawn {
    let all = || responses.iter().flat_map(|response| &response.curve);
    let (x, y) = (range(all().map(|point| point.0), 0.0), range(all().map(|point| f64::from(point.1)), 0.06));
    canvas((760, 360), |area| {
        let mut chart = axes(area, x, y, ("time (ps)", "response"), number)?;
        for (i, Response { row, curve, .. }) in responses.iter().enumerate() {
            let colour = [VISIBLE, HIDDEN, MIRROR, PALE][i % 4];
            let points: Vec<(f64, f64)> = curve.iter().map(|(time_ps, value)| (*time_ps, f64::from(*value))).collect();
            let drawn = chart.draw_series([PathElement::new(points, colour.stroke_width(2))])?;
            if responses.len() > 1 {
                drawn
                    .label(format!("{} {}", row.campaign, row.sensor))
                    .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 18, y)], colour.stroke_width(2)));
            }
        }
        if responses.len() > 1 {
            chart.configure_series_labels().border_style(PALE).label_font(font()).draw()?;
        }
        Ok(())
    })
}
