//! Numbers with their 95 % intervals.

use std::fmt;

/// Two-sided 95 % of a normal number.
const Z_95: f64 = 1.959_964;

/// Hits among draws, Wilson's interval.
#[derive(Clone, Copy, Debug)]
pub struct Rate {
    /// Hits.
    pub hits: usize,
    /// Draws.
    pub of: usize,
}

impl Rate {
    /// Of what holds.
    pub fn of(held: impl IntoIterator<Item = bool>) -> Self {
        held.into_iter()
            .fold(Self { hits: 0, of: 0 }, |rate, held| Self { hits: rate.hits + usize::from(held), of: rate.of + 1 })
    }

    /// Share of hits.
    pub fn share(&self) -> f64 {
        self.hits as f64 / self.of as f64
    }

    /// Wilson's interval.
    pub fn interval(&self) -> [f64; 2] {
        let (hits, of) = (self.hits as f64, self.of as f64);
        let centre = (hits + 0.5 * Z_95 * Z_95) / (of + Z_95 * Z_95);
        let half = Z_95 / (of + Z_95 * Z_95) * (hits * (of - hits) / of + 0.25 * Z_95 * Z_95).sqrt();
        [(centre - half).max(0.0), (centre + half).min(1.0)]
    }
}

impl fmt::Display for Rate {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        if self.of == 0 {
            return f.write_str("-");
        }
        let digits = f.precision().unwrap_or(3);
        let [low, high] = self.interval();
        write!(f, "{:.digits$} [{low:.digits$}, {high:.digits$}]", self.share())
    }
}

/// A value and half its interval.
#[derive(Clone, Copy, Debug)]
pub struct Estimate {
    /// Value.
    pub value: f64,
    /// Half the 95 % interval.
    pub half: f64,
}

impl Estimate {
    /// Mean of independent values.
    pub fn mean(values: &[f64]) -> Self {
        let n = values.len() as f64;
        let value = values.iter().sum::<f64>() / n;
        let variance = values.iter().map(|v| (v - value).powi(2)).sum::<f64>() / (n - 1.0);
        Self { value, half: Z_95 * (variance / n).sqrt() }
    }

    /// Root of the mean of independent squares.
    pub fn rms(squares: &[f64]) -> Self {
        let mean = Self::mean(squares);
        let value = mean.value.sqrt();
        Self { value, half: mean.half / (2.0 * value) }
    }

    /// Standard deviation of independent values.
    pub fn spread(values: &[f64]) -> Self {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        Self::rms(&values.iter().map(|v| (v - mean).powi(2)).collect::<Vec<_>>())
    }

    /// Slope of the points `(x, y)`; its interval allows for a spread of y that depends on x (White, Econometrica 48,
    /// 817 (1980)).
    pub fn slope(points: &[(f64, f64)]) -> Self {
        let n = points.len() as f64;
        let (x0, y0) = points.iter().fold((0.0, 0.0), |(x0, y0), (x, y)| (x0 + x / n, y0 + y / n));
        let xx: f64 = points.iter().map(|(x, _)| (x - x0).powi(2)).sum();
        let value = points.iter().map(|(x, y)| (x - x0) * (y - y0)).sum::<f64>() / xx;
        let residual = |(x, y): &(f64, f64)| (x - x0) * (y - y0 - value * (x - x0));
        let variance = points.iter().map(|point| residual(point).powi(2)).sum::<f64>() / (xx * xx);
        Self { value, half: Z_95 * variance.sqrt() }
    }
}

impl fmt::Display for Estimate {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        if !self.half.is_finite() {
            return f.write_str("-");
        }
        let digits = f.precision().unwrap_or(2);
        write!(f, "{:.digits$} [{:.digits$}, {:.digits$}]", self.value, self.value - self.half, self.value + self.half)
    }
}

/// Mean of squares.
pub fn mean_square(values: impl IntoIterator<Item = f64>) -> f64 {
    let (sum, count) = values.into_iter().fold((0.0, 0.0), |(sum, count), v| (sum + v * v, count + 1.0));
    sum / count
}

/// Whether a target is met, for a table.
pub fn met(held: bool) -> &'static str {
    if held { "met" } else { "**missed**" }
}

/// A row of a table.
pub fn row<S: AsRef<str>>(cells: &[S]) {
    let cells: Vec<&str> = cells.iter().map(AsRef::as_ref).collect();
    println!("| {} |", cells.join(" | "));
}

/// Heading of a table.
pub fn heading(title: &str, columns: &[&str]) {
    println!("\n{title}\n");
    row(columns);
    row(&vec!["---"; columns.len()]);
}
