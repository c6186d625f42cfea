//! Score of one more pulse, too weak for a fit of its own, in a profile whose other pulses have given times.

use periscope_cancel::Cancel;

use super::column::Column;
use super::model::WhitenedRecord;
use super::nuisance::Nuisance;
use super::place::{Place, spread_response};
use super::{Profile, Response, SparseOptions};

/// A column counts as explained by others if they leave no larger part of its length.
const NEW: f64 = 0.05;
/// Knots in the full width of a spread response.
const SPREAD_STEPS: f64 = 20.0;

/// Light whose place is known and whose amplitude is not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Given {
    /// Arrival, ps.
    pub time_ps: f64,
    /// Standard deviation of the spread of its light, ps.
    pub width_ps: f64,
    /// What is open.
    pub open: Open,
}

/// What of a given pulse is open.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Open {
    /// Its amplitude, which makes a score of this standard deviation about 0.
    Score(f64),
    /// Any amplitude.
    Amplitude,
    /// The time too, to first order: it was fitted.
    Time,
    /// The spread of its light as well, as strong pulses tell it.
    Width,
}

/// What a record says of one more pulse at each of some times.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Matched {
    /// Amplitude over its standard deviation.
    pub scores: Vec<f64>,
    /// One over that standard deviation, 1/V; 0 where nothing can be said.
    pub gains: Vec<f64>,
}

/// The matched filter for a pulse of spread `width_ps` at each of `times_ps`, in whitened samples freed of a line, slow
/// noise and `given` light: what these could explain does not count. Amplitude and standard deviation are those of the
/// joint fit of the pulse with all of them.
///
/// # Panics
/// As [`super::fit`].
#[must_use]
pub fn matched(
    profile: &Profile,
    response: &Response,
    given: &[Given],
    width_ps: f64,
    times_ps: impl Iterator<Item = f64>,
    cancel: &Cancel,
) -> Matched {
    let options = SparseOptions { cancel: cancel.clone(), ..SparseOptions::default() };
    let record = WhitenedRecord::new(profile, response, &options);
    let mut nuisance = record.nuisance.clone();
    for light in given {
        cancel.check();
        add_light(&mut nuisance, &record, light);
    }
    let residual = nuisance.without(&record.whitener.apply(profile.mean_v));
    let spread = spread(response, width_ps);
    let record = WhitenedRecord::new(profile, &spread, &options);
    let mut matched = Matched::default();
    for time_ps in times_ps {
        cancel.check();
        let column = Column::new(&record, &Place::point(time_ps));
        let (norm, left) = left_of(&nuisance, &column);
        let is_determined = record.holds(time_ps) && left > NEW * NEW * norm;
        let gain = if is_determined { left.sqrt() } else { 0.0 };
        matched.scores.push(if is_determined { column.dot_record(&residual)[0] / gain } else { 0.0 });
        matched.gains.push(gain);
    }
    matched
}

/// The response to light that is spread in time.
fn spread(response: &Response, width_ps: f64) -> Response {
    if width_ps == 0.0 {
        return response.clone();
    }
    let (first_ps, last_ps) = response.support_ps();
    let nodes = Place::widened(0.0, width_ps * width_ps).nodes(response.width_ps());
    let reach_ps = nodes.iter().fold(0.0_f64, |most, node| most.max(node.after_ps.abs()));
    let step_ps = response.width_ps() / SPREAD_STEPS;
    let count = ((last_ps - first_ps + 2.0 * reach_ps) / step_ps).ceil() as usize + 1;
    let value = |k: usize| spread_response(response, &nodes, first_ps - reach_ps + k as f64 * step_ps)[0];
    Response::new(first_ps - reach_ps, step_ps, &(0..count).map(value).collect::<Vec<_>>())
}

fn place(time_ps: f64, width_ps: f64) -> Place {
    if width_ps > 0.0 { Place::widened(time_ps, width_ps * width_ps) } else { Place::point(time_ps) }
}

/// Adds what given light may look like to what lies under a pulse.
fn add_light(nuisance: &mut Nuisance, record: &WhitenedRecord, light: &Given) {
    let column = Column::new(record, &place(light.time_ps, light.width_ps));
    let [value, slope] = column.dense(record.len());
    if let Open::Score(sd) = light.open {
        // The score is the amplitude times the column's length.
        return if sd > 0.0 {
            nuisance.add(&value, Some(sd * sd / column.shared(&column)));
        };
    }
    nuisance.add(&value, None);
    if light.open != Open::Amplitude {
        nuisance.add(&slope, None);
    }
    if light.open == Open::Width {
        let [widening, _] = Column::widening(record, light.time_ps).dense(record.len());
        nuisance.add(&widening, None);
    }
}

/// Squared norm of a column c, and `c^T Q c`.
fn left_of(nuisance: &Nuisance, column: &Column) -> (f64, f64) {
    let norm = column.shared(column);
    let along = |axis: &Vec<f64>| column.dot_record(axis)[0].powi(2);
    (norm, norm - nuisance.axes().iter().map(along).sum::<f64>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::regression::least_squares;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    fn gaussian(sigma_ps: f64) -> Response {
        let values: Vec<f64> = (-100..=100).map(|i| (-0.5 * (f64::from(i) * 6.0 / sigma_ps).powi(2)).exp()).collect();
        Response::new(-600.0, 6.0, &values)
    }

    const SD_V: f64 = 0.3;
    const COUNT: usize = 80;

    fn record(seed: u64) -> Vec<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let noise = |rng: &mut ChaCha8Rng| -> f64 { StandardNormal.sample(rng) };
        let response = gaussian(100.0);
        let light = |time_ps: f64| 5.0 * response.value(time_ps - 1500.0) + 0.4 * response.value(time_ps - 2100.0);
        (0..COUNT).map(|n| 0.7 + light(50.0 * n as f64) + SD_V * noise(&mut rng)).collect()
    }

    fn profile<'a>(mean_v: &'a [f64], sd_v: &'a [f64]) -> Profile<'a> {
        Profile { mean_v, sd_v, acf: &[1.0], slow_v2: &[], jitter: None, t0_ps: 0.0, dt_ps: 50.0 }
    }

    /// Score and gain are those of least squares with a line, the given pulse and its slope, whatever the given
    /// pulse's amplitude.
    #[test]
    fn scores_are_those_of_least_squares_beside_given_light() {
        let response = gaussian(100.0);
        let (mean_v, sd_v) = (record(1), vec![SD_V; COUNT]);
        let given = [Given { time_ps: 1500.0, width_ps: 0.0, open: Open::Time }];
        let times_ps = [1700.0, 2100.0, 3000.0];
        let filtered =
            matched(&profile(&mean_v, &sd_v), &response, &given, 0.0, times_ps.into_iter(), &Cancel::never());
        for (k, time_ps) in times_ps.into_iter().enumerate() {
            let column = |at_ps: f64| (0..COUNT).map(|n| response.value(50.0 * n as f64 - at_ps)).collect::<Vec<f64>>();
            let slope = (0..COUNT).map(|n| response.value_and_slope(50.0 * n as f64 - 1500.0).1).collect();
            let line = (0..COUNT).map(|n| n as f64).collect();
            let columns = [column(time_ps), vec![1.0; COUNT], line, column(1500.0), slope];
            let fit = least_squares(&columns, &mean_v, &sd_v).unwrap();
            let sd = fit.covariance[0][0].sqrt();
            assert!((filtered.gains[k] * sd - 1.0).abs() < 1e-9, "{} {sd}", filtered.gains[k]);
            assert!(
                (filtered.scores[k] - fit.values[0] / sd).abs() < 1e-8,
                "{} {}",
                filtered.scores[k],
                fit.values[0] / sd
            );
        }
    }

    /// A given amplitude that is not quite open costs less than an open one, and none that is 0.
    #[test]
    fn an_amplitude_that_is_known_better_hides_less() {
        let response = gaussian(100.0);
        let (mean_v, sd_v) = (record(2), vec![SD_V; COUNT]);
        let gain = |given: &[Given]| {
            matched(&profile(&mean_v, &sd_v), &response, given, 0.0, std::iter::once(2150.0), &Cancel::never()).gains[0]
        };
        let given = |open: Open| gain(&[Given { time_ps: 2100.0, width_ps: 0.0, open }]);
        let gains =
            [Open::Score(0.0), Open::Score(0.5), Open::Score(2.0), Open::Score(1e4), Open::Amplitude].map(given);
        assert!(gains.windows(2).all(|pair| pair[0] > pair[1] - 1e-6), "{gains:?}");
        assert!((gains[0] / gain(&[]) - 1.0).abs() < 1e-12 && (gains[3] / gains[4] - 1.0).abs() < 1e-6);
    }

    /// Light that is spread is looked for with a response as wide: a Gaussian of both variances.
    #[test]
    fn spread_light_is_matched_as_wide_as_it_is() {
        let wide = spread(&gaussian(80.0), 60.0);
        for time_ps in [-210.0, -90.0, 0.0, 40.0, 155.0] {
            let expected = 0.8 * (-0.5_f64 * (time_ps / 100.0_f64).powi(2)).exp();
            assert!((wide.value(time_ps) - expected).abs() < 1e-4, "{time_ps}: {} {expected}", wide.value(time_ps));
        }
    }
}
