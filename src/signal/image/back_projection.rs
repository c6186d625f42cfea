//! Filtered back-projection: an image from histograms of any pairs of lit and seen points.
//!
//! Light over a hidden point `x` arrives at `|l - x| + |x - s|`, as times of flight. Each histogram is turned into
//! scores of unit variance, by a filter that shows pulses and is blind to straight lines: the negative second
//! derivative of a Gaussian as wide as the response. A voxel is the sum of the scores at its arrival times, one of each
//! histogram. So it is a sum of independent terms, nearly Gaussian, and its variance is their number. Source of the
//! principle: Velten et al., Nature Communications 3:745 (2012).
//!
//! Counts are first stabilised, `sqrt(n + 3/8)` (Anscombe, Biometrika 35:246, 1948), and divided by the standard
//! deviation that this has at their rate: 1/2 for many photons, less for few. Not modelled: what light loses on its
//! way.

/// Rates from which on stabilised counts have a standard deviation of 1/2, to a part in a thousand.
const MANY: f64 = 25.0;
/// Places of the table of standard deviations, over the root of the rate.
const PLACES: usize = 200;
/// Reach of the filter, in standard deviations of its Gaussian.
const REACH: f64 = 4.0;

/// Standard deviations of stabilised counts, by their rate.
#[derive(Clone, Debug)]
pub struct Stabiliser(Vec<f64>);

impl Default for Stabiliser {
    fn default() -> Self {
        Self::new()
    }
}

impl Stabiliser {
    /// The table.
    #[must_use]
    pub fn new() -> Self {
        let rate = |place: usize| MANY * (place as f64 / PLACES as f64).powi(2);
        Self((0..=PLACES).map(|place| stabilised_sd(rate(place))).collect())
    }

    /// Stabilised counts and their standard deviations; `rates` are smoothed counts.
    #[must_use]
    pub fn apply(&self, counts: &[f64], rates: &[f64]) -> (Vec<f64>, Vec<f64>) {
        (counts.iter().map(|count| stabilise(*count)).collect(), rates.iter().map(|rate| self.sd(*rate)).collect())
    }

    fn sd(&self, rate: f64) -> f64 {
        let place = (rate.max(0.0) / MANY).sqrt() * PLACES as f64;
        let left = place as usize;
        if left >= PLACES {
            return 0.5;
        }
        let share = place - left as f64;
        self.0[left] * (1.0 - share) + self.0[left + 1] * share
    }
}

fn stabilise(count: f64) -> f64 {
    (count + 0.375).sqrt()
}

/// Standard deviation of stabilised counts of this rate: the sum over all counts.
fn stabilised_sd(rate: f64) -> f64 {
    let most = (rate + 12.0 * rate.sqrt() + 12.0) as usize;
    let mut probability = (-rate).exp();
    let (mut mean, mut total) = (0.0, 0.0);
    for count in 0..most {
        mean += probability * stabilise(count as f64);
        total += probability;
        probability *= rate / (count + 1) as f64;
    }
    (rate + 0.375 - (mean / total).powi(2)).max(0.0).sqrt()
}

/// A histogram as an image takes it. Points are in ps.
#[derive(Clone, Debug)]
pub struct Trace {
    /// Point that is lit.
    pub lit: [f64; 3],
    /// Point that is seen.
    pub seen: [f64; 3],
    /// Time of the first score.
    pub first_ps: f64,
    /// Time between scores.
    pub dt_ps: f64,
    /// Scores of unit variance; not a number where there is none.
    pub scores: Vec<f32>,
}

/// Scores of a histogram: its values convolved with the negative second derivative of a Gaussian of `width` bins, over
/// their standard deviation. Not a number within the filter's reach of both ends, and where nothing varies.
///
/// # Panics
/// If values and standard deviations differ in number.
#[must_use]
pub fn scores(values: &[f64], sd: &[f64], width: f64) -> Vec<f32> {
    assert_eq!(values.len(), sd.len(), "values and standard deviations differ in number");
    let filter = pulses(width);
    let reach = filter.len() / 2;
    let mut scores = vec![f32::NAN; values.len()];
    for (n, (values, sd)) in values.windows(filter.len()).zip(sd.windows(filter.len())).enumerate() {
        let sum: f64 = filter.iter().zip(values).map(|(weight, value)| weight * value).sum();
        let variance: f64 = filter.iter().zip(sd).map(|(weight, sd)| (weight * sd).powi(2)).sum();
        if variance > 0.0 {
            scores[n + reach] = (sum / variance.sqrt()) as f32;
        }
    }
    scores
}

/// Negative second derivative of a Gaussian, without what a straight line leaves in it.
fn pulses(width: f64) -> Vec<f64> {
    let reach = (REACH * width).ceil().max(2.0) as i32;
    let at = |n: i32| f64::from(n) / width;
    let filter: Vec<f64> = (-reach..=reach).map(|n| (1.0 - at(n).powi(2)) * (-0.5 * at(n).powi(2)).exp()).collect();
    // It is even, so only its mean is left over.
    let mean = filter.iter().sum::<f64>() / filter.len() as f64;
    filter.into_iter().map(|weight| weight - mean).collect()
}

/// Sum of the scores at a point (ps), and its standard deviation: 0 where no histogram covers the point.
#[must_use]
pub fn voxel(traces: &[Trace], point: [f64; 3]) -> (f64, f64) {
    let (mut sum, mut terms) = (0.0, 0_u32);
    for trace in traces {
        let time_ps = gap(trace.lit, point) + gap(point, trace.seen);
        let place = (time_ps - trace.first_ps) / trace.dt_ps + 0.5;
        // A negative place becomes 0, where the filter's reach leaves no score.
        let Some(score) = trace.scores.get(place as usize).filter(|score| !score.is_nan()) else { continue };
        sum += f64::from(*score);
        terms += 1;
    }
    (sum, f64::from(terms).sqrt())
}

fn gap(a: [f64; 3], b: [f64; 3]) -> f64 {
    ((a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2) + (a[2] - b[2]).powi(2)).sqrt()
}
