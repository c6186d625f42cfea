//! The light of a point in the bins of a histogram.

/// Places of the table in a bin.
const PLACES: f64 = 8.0;
/// Share of the largest value below which the ends are cut off.
const NEGLIGIBLE: f64 = 5e-4;

/// The response, integrated over a bin, by the offset of the bin's middle from the arrival of light; its sum over all
/// bins is 1.
#[derive(Clone, Debug)]
pub struct Pulse {
    first_m: f64,
    step_m: f64,
    /// Share of the light, and its slope per metre.
    table: Vec<[f64; 2]>,
    width_m: f64,
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
        let density = |at_m: f64| {
            let place = (at_m - first_m) / step_m;
            if place <= -1.0 || place >= response.len() as f64 {
                return 0.0;
            }
            let (left, share) = (place.floor(), place - place.floor());
            let value = |n: f64| if n < 0.0 { 0.0 } else { response.get(n as usize).copied().unwrap_or(0.0) };
            (value(left) * (1.0 - share) + value(left + 1.0) * share) / (sum * step_m)
        };
        let fine_m = bin_m / PLACES;
        let start_m = first_m - step_m - 0.5 * bin_m;
        let count = ((response.len() as f64 + 1.0) * step_m / fine_m + PLACES).ceil() as usize + 1;
        // Integrals by Simpson's rule over the places of the table.
        let mut integral = vec![0.0; count + PLACES as usize];
        for n in 1..integral.len() {
            let from_m = start_m - 0.5 * bin_m + (n - 1) as f64 * fine_m;
            let values = [0.0, 0.5, 1.0].map(|share| density(from_m + share * fine_m));
            integral[n] = integral[n - 1] + fine_m * (values[0] + 4.0 * values[1] + values[2]) / 6.0;
        }
        let entry = |n: usize| {
            let middle_m = start_m + n as f64 * fine_m;
            let slope = density(middle_m + 0.5 * bin_m) - density(middle_m - 0.5 * bin_m);
            [integral[n + PLACES as usize] - integral[n], slope]
        };
        let table: Vec<[f64; 2]> = (0..count).map(entry).collect();
        let most = table.iter().map(|entry| entry[0]).fold(0.0, f64::max);
        let counts = |entry: &[f64; 2]| entry[0].abs() > NEGLIGIBLE * most;
        let first = table.iter().position(counts).unwrap_or(0);
        let last = table.iter().rposition(counts).unwrap_or(count - 1);
        let above = |entry: &[f64; 2]| entry[0] > 0.5 * most;
        let rise = table.iter().position(above).unwrap_or(0);
        let fall = table[rise..].iter().position(|entry| !above(entry)).unwrap_or(1);
        Self {
            first_m: start_m + first as f64 * fine_m,
            step_m: fine_m,
            table: table[first..=last].to_vec(),
            width_m: fall as f64 * fine_m,
        }
    }

    /// Full width at half maximum.
    #[must_use]
    pub fn width_m(&self) -> f64 {
        self.width_m
    }

    /// Offsets between which there is light.
    #[must_use]
    pub fn reach_m(&self) -> [f64; 2] {
        [self.first_m, self.first_m + (self.table.len() - 1) as f64 * self.step_m]
    }

    /// Share of the light in the bin at an offset, and its slope.
    #[must_use]
    #[inline]
    pub fn at(&self, offset_m: f64) -> [f64; 2] {
        let place = (offset_m - self.first_m) / self.step_m;
        if place < 0.0 {
            return [0.0; 2];
        }
        let left = place as usize;
        let Some([here, next]) = self.table.get(left..left + 2).and_then(|pair| pair.first_chunk()) else {
            return [0.0; 2];
        };
        let share = place - left as f64;
        [here[0] + share * (next[0] - here[0]), here[1] + share * (next[1] - here[1])]
    }
}
