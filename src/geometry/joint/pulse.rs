//! The light of a point in the bins of a histogram, and how the response may differ from what was measured of it.
//!
//! The response of hidden light is known from other light: that of the wall, whose rise a scan may cut off and whose
//! tail is not only the instrument's, or a calibration at another rate. Six unknowns that all points share stand for
//! the difference ([`SHAPES`]): a common delay, the width of the rise, and four factors on the fall and the tail over
//! the logarithm of time. Their priors ([`Pulse::doubts`]) come with the response.

use std::sync::Arc;

/// Places of the table in a bin.
const PLACES: usize = 8;
/// Share of the largest value below which the ends are cut off.
const NEGLIGIBLE: f64 = 5e-4;
/// Unknowns of the response's shape: common delay in full widths, logarithm of the width of its rise, logarithms of
/// factors on its fall and its tail at [`NODES`].
pub const SHAPES: usize = 6;
/// Places behind the peak at which factors stand, in full widths; between them they go linearly over the logarithm.
const NODES: [f64; SHAPES - 2] = [0.75, 1.6, 3.5, 8.0];
/// Place behind the peak up to which the factor is 1.
const CORE: f64 = 0.35;
/// Standard deviations of the unknowns before there is light, where the whole response was measured: delay in widths,
/// rise, factors.
const DOUBTS: [f64; SHAPES] = [0.005, 0.03, 0.1, 0.3, 0.3, 0.3];
/// Step of the difference by the rise.
const STEP: f64 = 1e-3;

/// Columns of the table: share of the light in a bin, its slopes by the length of the way and by the logarithm of the
/// width, and those by the unknowns of the shape.
pub const COLUMNS: usize = 3 + SHAPES;

/// The response as it was given.
#[derive(Debug)]
struct Given {
    first_m: f64,
    step_m: f64,
    /// Light per metre.
    values: Vec<f64>,
    bin_m: f64,
    peak_m: f64,
    width_m: f64,
}

/// The response, integrated over a bin, by the offset of the bin's middle from the arrival of light; its sum over all
/// bins is 1 where its shape is the given one.
#[derive(Clone, Debug)]
pub struct Pulse {
    first_m: f64,
    step_m: f64,
    count: usize,
    columns: Arc<Vec<Column>>,
    given: Arc<Given>,
    /// Standard deviations of the unknowns of the shape before there is light.
    pub doubts: [f64; SHAPES],
}

/// Entries of a column a bin apart, from each of the places in the first bin on: what a histogram needs is contiguous.
type Column = [Vec<f64>; PLACES];

/// Bins of a histogram that a pulse reaches.
#[derive(Clone, Debug)]
pub struct Bins {
    /// First of them, and their number.
    pub from: usize,
    /// Their number.
    pub count: usize,
    left: [usize; 2],
    right: [usize; 2],
    share: f64,
}

impl Given {
    fn at(&self, at_m: f64) -> f64 {
        let place = (at_m - self.first_m) / self.step_m;
        if place <= -1.0 || place >= self.values.len() as f64 {
            return 0.0;
        }
        let (left, share) = (place.floor(), place - place.floor());
        let value = |n: f64| if n < 0.0 { 0.0 } else { self.values.get(n as usize).copied().unwrap_or(0.0) };
        value(left) * (1.0 - share) + value(left + 1.0) * share
    }

    /// Light per metre with a shape, and its slopes by all unknowns of it but the delay.
    fn shaped(&self, shape: &[f64; SHAPES], at_m: f64) -> [f64; SHAPES] {
        let after_m = at_m - shape[0] * self.width_m - self.peak_m;
        let mut values = [0.0; SHAPES];
        if after_m < 0.0 {
            let rise = |log: f64| self.at(self.peak_m + after_m * (-log).exp());
            values[0] = rise(shape[1]);
            values[1] = (rise(shape[1] + STEP) - rise(shape[1] - STEP)) / (2.0 * STEP);
            return values;
        }
        let hats = hats(after_m / self.width_m);
        let log: f64 = hats.iter().zip(&shape[2..]).map(|(hat, log)| hat * log).sum();
        values[0] = self.at(self.peak_m + after_m) * log.exp();
        (0..hats.len()).for_each(|n| values[2 + n] = values[0] * hats[n]);
        values
    }
}

/// Weights of the factors at a place behind the peak, in widths.
fn hats(place: f64) -> [f64; SHAPES - 2] {
    let mut hats = [0.0; SHAPES - 2];
    if place <= CORE {
        return hats;
    }
    let next = NODES.iter().position(|node| place < *node);
    let Some(next) = next else {
        hats[SHAPES - 3] = 1.0;
        return hats;
    };
    let left = if next == 0 { CORE } else { NODES[next - 1] };
    let share = (place / left).ln() / (NODES[next] / left).ln();
    hats[next] = share;
    if next > 0 {
        hats[next - 1] = 1.0 - share;
    }
    hats
}

impl Pulse {
    /// From the response at `first_m`, `first_m + step_m`... behind the arrival of light, on any scale, and the width
    /// of a bin. All lengths are those of paths.
    ///
    /// # Panics
    /// If the response has fewer than three values, no positive sum, or `step_m` or `bin_m` is not positive.
    #[must_use]
    pub fn new(first_m: f64, step_m: f64, response: &[f64], bin_m: f64) -> Self {
        let sum: f64 = response.iter().sum();
        assert!(
            response.len() > 2 && sum > 0.0 && step_m > 0.0 && bin_m > 0.0,
            "a response with positive sum and steps"
        );
        let most = response.iter().copied().fold(0.0, f64::max);
        let peak = response.iter().position(|value| *value == most).unwrap_or(0);
        // What is cut off at the far end is too faint to count in any shape.
        let last = response.iter().rposition(|value| value.abs() > 0.2 * NEGLIGIBLE * most).unwrap_or(0);
        let values: Vec<f64> = response[..=last].iter().map(|value| value / (sum * step_m)).collect();
        let peak_m = first_m + peak as f64 * step_m;
        let width_m = full_width(&values, step_m);
        let given = Given { first_m, step_m, values, bin_m, peak_m, width_m };
        Self::of(Arc::new(given), (1.0, &[0.0; SHAPES]), true, DOUBTS)
    }

    /// The same response with other doubts.
    #[must_use]
    pub fn doubted(self, doubts: [f64; SHAPES]) -> Self {
        Self { doubts, ..self }
    }

    /// Standard deviations of the unknowns of a shape that was measured as a whole.
    #[must_use]
    pub fn measured() -> [f64; SHAPES] {
        DOUBTS
    }

    /// The given response, so many times as wide, with a shape; with slopes by its unknowns where it `is_free`.
    #[must_use]
    pub fn shaped(&self, stretch: f64, shape: &[f64; SHAPES], is_free: bool) -> Self {
        if stretch == 1.0 && shape.iter().all(|value| *value == 0.0) {
            return self.clone();
        }
        Self::of(Arc::clone(&self.given), (stretch, shape), is_free, self.doubts)
    }

    fn of(given: Arc<Given>, (stretch, shape): (f64, &[f64; SHAPES]), is_free: bool, doubts: [f64; SHAPES]) -> Self {
        let density = |at_m: f64| given.shaped(shape, at_m / stretch).map(|value| value / stretch);
        let bin_m = given.bin_m;
        let fine_m = bin_m / PLACES as f64;
        let reach_m = [given.first_m - given.step_m, given.first_m + given.values.len() as f64 * given.step_m];
        let shift_m = shape[0].abs() * given.width_m;
        let start_m = stretch * (1.0 + shape[1].abs()) * (reach_m[0] - shift_m).min(0.0) - bin_m;
        let end_m = stretch * (reach_m[1] + shift_m) + bin_m;
        let count = ((end_m - start_m) / fine_m).ceil() as usize + PLACES;
        // Integrals by Simpson's rule over the places of the table.
        let edge_m = |n: f64| start_m - 0.5 * bin_m + n * fine_m;
        let edges: Vec<[f64; SHAPES]> = (0..count + PLACES).map(|n| density(edge_m(n as f64))).collect();
        let mut integral = vec![[0.0; SHAPES]; edges.len()];
        let of = if is_free { SHAPES } else { 1 };
        for n in 1..edges.len() {
            let middle = density(edge_m(n as f64 - 0.5));
            for k in 0..of {
                let mean = (edges[n - 1][k] + 4.0 * middle[k] + edges[n][k]) / 6.0;
                integral[n][k] = integral[n - 1][k] + fine_m * mean;
            }
        }
        let entry = |n: usize| {
            let over = n + PLACES;
            let slope = edges[over][0] - edges[n][0];
            let mut entry = [0.0; COLUMNS];
            entry[0] = integral[over][0] - integral[n][0];
            entry[1] = -slope;
            entry[2] = edge_m(n as f64) * edges[n][0] - edge_m(over as f64) * edges[over][0];
            entry[3] = -stretch * given.width_m * slope;
            (1..of).for_each(|k| entry[3 + k] = integral[over][k] - integral[n][k]);
            entry
        };
        let table: Vec<[f64; COLUMNS]> = (0..count).map(entry).collect();
        let most = table.iter().map(|entry| entry[0]).fold(0.0, f64::max);
        let counts = |entry: &[f64; COLUMNS]| entry[0].abs() > NEGLIGIBLE * most;
        let first = table.iter().position(counts).unwrap_or(0);
        let last = table.iter().rposition(counts).unwrap_or(count - 1);
        let table = &table[first..=last];
        let column = |k: usize| -> Column {
            std::array::from_fn(|place| table.iter().skip(place).step_by(PLACES).map(|entry| entry[k]).collect())
        };
        let columns = (0..if is_free { COLUMNS } else { 3 }).map(column).collect();
        Self {
            first_m: start_m + first as f64 * fine_m,
            step_m: fine_m,
            count: table.len(),
            columns: Arc::new(columns),
            given,
            doubts,
        }
    }

    /// Full width at half maximum of the given response.
    #[must_use]
    pub fn width_m(&self) -> f64 {
        self.given.width_m
    }

    /// Full width at half maximum with width and shape as they are, over that of the given response.
    #[must_use]
    pub fn stretch(&self) -> f64 {
        let values =
            |given: &Self| -> Vec<f64> { (0..given.count).map(|n| given.columns[0][n % PLACES][n / PLACES]).collect() };
        let given = Self::of(Arc::clone(&self.given), (1.0, &[0.0; SHAPES]), false, self.doubts);
        full_width(&values(self), self.step_m) / full_width(&values(&given), given.step_m)
    }

    /// The bins that have light, of `count` bins whose first one has its middle at an offset from the arrival.
    #[must_use]
    pub fn bins(&self, offset_m: f64, count: usize) -> Bins {
        let place = (offset_m - self.first_m) / self.step_m;
        let from = if place < 0.0 { (-place / PLACES as f64).ceil() as usize } else { 0 };
        let place = place + (from * PLACES) as f64;
        let left = place.max(0.0) as usize;
        // Both neighbours of each place are in the table.
        let room = (self.count.saturating_sub(left + 1)).div_ceil(PLACES);
        let count_here = room.min(count.saturating_sub(from));
        let split = |n: usize| if count_here > 0 { [n % PLACES, n / PLACES] } else { [0; 2] };
        Bins {
            from: from.min(count),
            count: count_here,
            left: split(left),
            right: split(left + 1),
            share: place - left as f64,
        }
    }

    /// A column of the table in these bins, times a scale.
    #[inline]
    pub fn fill(&self, column: usize, bins: &Bins, scale: f64, into: &mut Vec<f64>) {
        into.clear();
        let column = &self.columns[column];
        let part = |[place, first]: [usize; 2]| &column[place][first..first + bins.count];
        let shares = [scale * (1.0 - bins.share), scale * bins.share];
        into.extend(part(bins.left).iter().zip(part(bins.right)).map(|(a, b)| shares[0] * a + shares[1] * b));
    }

    /// The same, added.
    #[inline]
    pub fn add(&self, column: usize, bins: &Bins, scale: f64, into: &mut [f64]) {
        let column = &self.columns[column];
        let part = |[place, first]: [usize; 2]| &column[place][first..first + bins.count];
        let shares = [scale * (1.0 - bins.share), scale * bins.share];
        let into = &mut into[bins.from..bins.from + bins.count];
        for ((sum, a), b) in into.iter_mut().zip(part(bins.left)).zip(part(bins.right)) {
            *sum += shares[0] * a + shares[1] * b;
        }
    }

    /// Share of the light in the bin at an offset.
    #[must_use]
    pub fn at(&self, offset_m: f64) -> f64 {
        let bins = self.bins(offset_m, 1);
        let mut share = [0.0];
        if bins.count > 0 {
            self.add(0, &bins, 1.0, &mut share);
        }
        share[0]
    }
}

/// Full width at half maximum about the largest value.
fn full_width(values: &[f64], step_m: f64) -> f64 {
    let most = values.iter().copied().fold(0.0, f64::max);
    let rise = values.iter().position(|value| *value > 0.5 * most).unwrap_or(0);
    let fall = values[rise..].iter().position(|value| *value <= 0.5 * most).map_or(values.len(), |n| rise + n);
    // Between the two values about the half.
    let between = |outer: usize, inner: usize| {
        let [low, high] = [outer, inner].map(|n| values.get(n).copied().unwrap_or(0.0));
        inner as f64 + (outer as f64 - inner as f64) * (high - 0.5 * most) / (high - low)
    };
    let first = if rise > 0 { between(rise - 1, rise) } else { -0.5 };
    let last = if fall < values.len() { between(fall, fall - 1) } else { values.len() as f64 - 0.5 };
    (last - first) * step_m
}
