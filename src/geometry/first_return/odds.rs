//! Probabilities from odds.

/// By so much a standard deviation changes the logarithm of the odds, nearly: those of a standard normal that lies
/// below some of them.
pub const OF_SD: f64 = 1.702;

/// Of what has odds of this logarithm.
pub fn probability(log_odds: f64) -> f64 {
    1.0 / (1.0 + (-log_odds).exp())
}
