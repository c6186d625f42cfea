//! Figures for a paper, as SVG: what the page shows, on white, without what only a screen can do.

mod canvas;
mod matrix;
mod scene;
mod statistics;
mod waves;

use thiserror::Error;

use super::Report;

/// A figure could not be drawn.
#[derive(Debug, Error)]
#[error("figure `{figure}` could not be drawn: {reason}")]
pub struct FigureError {
    figure: &'static str,
    reason: String,
}

/// All figures for which there are tables: name and SVG.
///
/// # Errors
/// When one cannot be drawn.
pub fn all(report: &Report) -> Result<Vec<(&'static str, String)>, FigureError> {
    let mut all = Vec::new();
    let mut add = |figure: &'static str, drawn: Option<canvas::Drawn>| match drawn {
        None => Ok(()),
        Some(Ok(svg)) => {
            all.push((figure, svg));
            Ok(())
        }
        Some(Err(error)) => Err(FigureError { figure, reason: error.to_string() }),
    };
    add("scene", report.scene.as_ref().filter(|scene| !scene.patches.is_empty()).map(scene::figure))?;
    add("stir", report.stir.as_ref().map(matrix::stir))?;
    add("distances", report.distances.as_ref().map(matrix::distances))?;
    add("profile", report.waveforms.telling().map(waves::profile))?;
    add("response", (!report.responses.is_empty()).then(|| waves::responses(&report.responses)))?;
    add("residuals", report.residuals.as_ref().map(statistics::residuals))?;
    Ok(all)
}
