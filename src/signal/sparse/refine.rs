//! Joint refinement of places: Levenberg-Marquardt with the amplitudes eliminated.
//!
//! Source: Golub and Pereyra, SIAM J. Numer. Anal. 10, 413 (1973), variable projection, in Kaufman's simplification. It
//! finds the optimum next to its start; [`super::search`] provides the starts.

use super::model::Model;
use super::place::Place;
use super::projection::Projection;

/// Steps that promise less chi2 than this end the refinement: they move a time by less than a thousandth of its sd.
const PROMISE: f64 = 1e-6;
const STEPS: usize = 60;
/// Largest move of a pulse in one step, in widths of the response.
const STEP_WIDTHS: f64 = 0.32;

/// Pulses that fit whitened `data` best, near `places`. `None` if the start is degenerate (two pulses coincide, or one
/// is outside of a record).
pub(super) fn refine(model: &Model, data: &[Vec<f64>], places: Vec<Place>) -> Option<Projection> {
    let mut best = Projection::new(model, data, places)?;
    let step_max_ps = STEP_WIDTHS * model.width_ps;
    let mut damping = 1e-4;
    for _ in 0..STEPS {
        model.cancel.check();
        let Some((step, promised)) = best.step(damping, model.extent_max_ps) else {
            break;
        };
        if promised < PROMISE {
            break;
        }
        match Projection::new(model, data, best.moved(&step, step_max_ps, model.extent_max_ps)) {
            Some(trial) if trial.energy > best.energy => {
                best = trial;
                damping = (damping * 0.1).max(1e-9);
            }
            _ => damping *= 10.0,
        }
    }
    Some(best)
}
