//! What a residual costs.

/// Standard deviations beyond which Huber's loss grows linearly: of normal residuals 1 in 370, so that data without
/// outliers lose little.
pub(super) const HUBER: f64 = 3.0;
/// Standard deviations at which Geman and McClure's loss has reached half its height.
const REDESCENDS: f64 = 6.0;

/// The loss of a residual.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Loss {
    /// Its square.
    Squared,
    /// Its square, from 3 standard deviations on linear: bears a few gross errors, and has no minima of its own.
    Huber,
    /// Geman and McClure's, which ends at a height of 36: bears many gross errors, with as many wrong minima.
    Redescending,
}

impl Loss {
    /// Loss of a residual in standard deviations, and the weight of its square in the next step.
    #[must_use]
    pub fn of(self, residual: f64) -> (f64, f64) {
        let size = residual.abs();
        match self {
            Self::Huber if size > HUBER => (HUBER * (2.0 * size - HUBER), HUBER / size),
            Self::Redescending => {
                let kept = REDESCENDS * REDESCENDS / (REDESCENDS * REDESCENDS + size * size);
                (kept * size * size, kept * kept)
            }
            Self::Squared | Self::Huber => (size * size, 1.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_slopes_over_residuals() {
        for loss in [Loss::Squared, Loss::Huber, Loss::Redescending] {
            for residual in [-30.0, -2.0, 0.5, 3.5, 12.0] {
                let slope = (loss.of(residual + 1e-6).0 - loss.of(residual - 1e-6).0) / 2e-6;
                assert!((slope - 2.0 * residual * loss.of(residual).1).abs() < 1e-6, "{loss:?} {residual}");
            }
        }
    }
}
