//! The curve that stored pulses draw through a profile: baseline, plus the sum of pulses, each the sensor's response at
//! its time, with its amplitude and width.
//!
//! `stir` keeps pulses and no curve, so that the curve is made here. The baseline is no row of a table either: a line,
//! and the slow noise of the profile where it has some, fitted to what the pulses leave, whitened as the stage whitens.
//!
//! | not in the table | taken |
//! |---|---|
//! | whether the stage stretched the response, and by how much | of the calibration's width and that of `response_width`, whichever fits better; where neither comes near the chi-square of the stage, the width that fits best |
//! | heights of pulses that were fitted to a profile and its reciprocal one together, in the latter | by least squares |
//! | the number of components of a moving baseline (`ground_v`) | as many as the stage tries, with equal variances |

use crate::priors::calibration::{self, Calibrated};
use crate::priors::flight_profile::FlightProfile;
use crate::priors::sensor_range::SensorRange;
use crate::signal::regression::least_squares;
use crate::signal::response::Response;
use crate::signal::slow_noise::component;
use crate::signal::sparse::{Pulse, Unpiled};
use crate::signal::whiten::Whitener;
use crate::tables::{Impulse, Profile, Session};

/// Chi-square over that of the stage from which other widths are tried; logarithms of the least and the largest, and
/// steps between them and within one.
const FAR_OFF: f64 = 1.1;
const WIDTHS: [f64; 2] = [-0.4, 0.2];
const WIDTH_STEP: f64 = 0.02;
const SECTIONS: usize = 14;
const GOLDEN: f64 = 0.618_033_988_75;
/// Components of a moving baseline at most, and samples to each.
const COMPONENTS_MAX: usize = 64;
const SAMPLES_PER_COMPONENT: usize = 8;

/// What `stir` says of a profile.
pub struct Explanation<'a> {
    /// Its pulses.
    pub impulses: &'a [Impulse],
    /// Its chi-square over degrees of freedom.
    pub chi2_dof: f64,
    /// Width of the response over the calibration's, and its standard deviation.
    pub width: Option<[f64; 2]>,
    /// Standard deviation of a baseline that moves.
    pub ground_v: f64,
    /// Whether the pulses stand in the row of the reciprocal profile: this one has their times and widths, and heights
    /// of its own, which no table has.
    pub is_reciprocal: bool,
}

/// A profile in times of flight, with the curve through it.
pub struct Curve {
    /// Time of flight at the first sample.
    pub t0_ps: f64,
    /// Time between samples.
    pub dt_ps: f64,
    /// What was measured, pick-up taken off, with the sign of the record; counts are freed of pile-up.
    pub measured_v: Vec<f64>,
    /// Standard deviation of each sample; infinite for one that says nothing.
    pub sd_v: Vec<f64>,
    /// Baseline and pulses.
    pub fitted_v: Vec<f64>,
    /// The pulses, with the sign of the record.
    pub impulses: Vec<Impulse>,
    /// Chi-square of what the curve leaves, whitened, over its degrees of freedom.
    pub chi2_dof: f64,
}

impl Curve {
    /// Of a profile of a calibrated sensor; `None` where drift, pick-up or pile-up cannot be taken off.
    pub fn of(
        profile: &Profile,
        sensor: (&SensorRange, &Calibrated),
        sessions: &[Session],
        (period_ps, dead_time_ps): (Option<f64>, f64),
        explanation: &Explanation<'_>,
    ) -> Option<Self> {
        let mut flight = FlightProfile::new(profile, sensor, sessions, period_ps, calibration::sd_v(profile)).ok()?;
        let unpiled = match profile.counts.as_ref().zip(profile.cycles) {
            Some((counts, cycles)) => Some(unpiled(counts, cycles, dead_time_ps / profile.dt_ps)?),
            None => None,
        };
        if let Some(unpiled) = &unpiled {
            flight.mean_v.clone_from(&unpiled.counts);
            flight.acf = vec![1.0];
        }
        let (response, polarity) = (sensor.1.averaged(profile), sensor.1.polarity);
        let fit = |factor: f64| Fit::new(&flight, &response.stretched(factor), polarity, explanation, unpiled.as_ref());
        let best = likeliest(fit, explanation, sensor.1.width[1]);
        let signed = |values: Vec<f64>| values.into_iter().map(|value| polarity * value).collect();
        Some(Self {
            t0_ps: flight.t0_ps,
            dt_ps: flight.dt_ps,
            measured_v: signed(flight.mean_v),
            sd_v: best.sd_v,
            fitted_v: signed(best.fitted_v),
            impulses: best.impulses,
            chi2_dof: best.chi2_dof,
        })
    }
}

fn unpiled(counts: &[i32], cycles: i64, dead_bins: f64) -> Option<Unpiled> {
    let counts: Vec<u32> = counts.iter().map(|count| u32::try_from(*count).unwrap_or(0)).collect();
    Unpiled::new(&counts, u64::try_from(cycles).ok()?, dead_bins.round() as usize).ok()
}

/// The fit with the response as calibrated, or as wide as the profile shows it, drawn towards the calibration as by the
/// stage, whose width has the standard deviation `width_sd`; else with that of the width that fits best.
fn likeliest(fit: impl Fn(f64) -> Fit, explanation: &Explanation<'_>, width_sd: f64) -> Fit {
    let better = |one: Fit, other: Fit| if other.chi2_dof < one.chi2_dof { other } else { one };
    let shrunk = |[factor, sd]: [f64; 2]| {
        let (own, prior) = (sd.powi(-2), width_sd.powi(-2));
        (factor.ln() * own / (own + prior)).exp()
    };
    let shown = explanation.width.map(shrunk).filter(|factor| factor.is_finite() && *factor > 0.0);
    let best = shown.map(&fit).into_iter().fold(fit(1.0), better);
    if best.chi2_dof < FAR_OFF * explanation.chi2_dof {
        return best;
    }
    let [least, most] = WIDTHS;
    let chi2_dof = |stretch: f64| fit(stretch.exp()).chi2_dof;
    let step = |n: u32| least + WIDTH_STEP * f64::from(n);
    let steps = ((most - least) / WIDTH_STEP).round() as u32;
    let coarse = (0..=steps).map(|n| (chi2_dof(step(n)), step(n))).min_by(|a, b| a.0.total_cmp(&b.0));
    let middle = coarse.map_or(0.0, |(_, stretch)| stretch);
    // By the golden section: a record of a large signal tells the width to a part of 10,000.
    let (mut low, mut high) = (middle - WIDTH_STEP, middle + WIDTH_STEP);
    for _ in 0..SECTIONS {
        let inner = [high - GOLDEN * (high - low), low + GOLDEN * (high - low)];
        if chi2_dof(inner[0]) < chi2_dof(inner[1]) { high = inner[1] } else { low = inner[0] }
    }
    better(best, fit(f64::midpoint(low, high).exp()))
}

/// The sum of pulses with one response, over the samples of a record.
pub fn pulses_v(impulses: &[Impulse], response: &Response, polarity: f64, flight: (f64, f64, usize)) -> Vec<f64> {
    let (t0_ps, dt_ps, len) = flight;
    let mut sum_v = vec![0.0; len];
    for impulse in impulses {
        for (n, value_v) in pulse(impulse, polarity).samples(response, t0_ps, dt_ps, len) {
            sum_v[n] += value_v;
        }
    }
    sum_v
}

fn pulse(impulse: &Impulse, polarity: f64) -> Pulse {
    let tail_ps = impulse.tail_ps.unwrap_or(0.0);
    Pulse {
        time_ps: impulse.time_ps,
        time_sd_ps: impulse.time_sd_ps,
        own_time_ps: impulse.own_time_ps.unwrap_or(impulse.time_ps),
        // The table has a Gaussian and the tail behind it together.
        width_ps: (impulse.width_ps * impulse.width_ps - tail_ps * tail_ps).max(0.0).sqrt(),
        kurtosis: impulse.width_kurtosis.unwrap_or(0.0),
        tilt: impulse.width_tilt.unwrap_or(0.0),
        width_sd_ps: impulse.width_sd_ps.unwrap_or(0.0),
        own_variance_ps2: impulse.own_variance_ps2.unwrap_or(impulse.width_ps * impulse.width_ps),
        tail_ps,
        tail_sd_ps: 0.0,
        amplitude_v: polarity * impulse.amplitude_v,
        amplitude_sd_v: impulse.amplitude_sd_v,
        evidence: impulse.evidence,
        chi2_per_dof: impulse.misfit_factor,
        misfit_sigma: impulse.misfit_sigma,
        misfit_factor: impulse.misfit_factor,
        pair: None,
    }
}

/// Pulses of one response, upwards, on the baseline that fits best.
struct Fit {
    impulses: Vec<Impulse>,
    fitted_v: Vec<f64>,
    sd_v: Vec<f64>,
    chi2_dof: f64,
}

impl Fit {
    fn new(
        flight: &FlightProfile,
        response: &Response,
        polarity: f64,
        explanation: &Explanation<'_>,
        unpiled: Option<&Unpiled>,
    ) -> Self {
        let len = flight.mean_v.len();
        let impulses = if explanation.is_reciprocal {
            with_own_heights(flight, response, polarity, explanation)
        } else {
            explanation.impulses.to_vec()
        };
        let pulses_v = pulses_v(&impulses, response, polarity, (flight.t0_ps, flight.dt_ps, len));
        let sd_v = unpiled.map_or_else(|| flight.sd_v.clone(), |unpiled| counted_sd(unpiled, &pulses_v));
        let left_v: Vec<f64> = flight.mean_v.iter().zip(&pulses_v).map(|(mean, pulses)| mean - pulses).collect();
        let whitener = Whitener::new(&sd_v, &flight.acf);
        let under_v =
            Baseline::new(len, unpiled.is_none(), slow_v2(flight, explanation.ground_v)).under(&left_v, &whitener);
        let left_v: Vec<f64> = left_v.iter().zip(&under_v).map(|(left, under)| left - under).collect();
        let chi2: f64 = whitener.apply(&left_v).iter().map(|value| value * value).sum();
        let parameters: usize = explanation.impulses.iter().map(|one| if one.width_ps > 0.0 { 3 } else { 2 }).sum();
        let samples = sd_v.iter().filter(|sd_v| sd_v.is_finite()).count();
        let freedom = samples.saturating_sub(parameters + 2).max(1);
        let fitted_v = pulses_v.iter().zip(&under_v).map(|(pulses, under)| pulses + under).collect();
        Self { impulses, fitted_v, sd_v, chi2_dof: chi2 / freedom as f64 }
    }
}

/// Pulses with the heights that fit this record best, over a line, at their times. Where the record does not determine
/// them they stay.
fn with_own_heights(
    flight: &FlightProfile,
    response: &Response,
    polarity: f64,
    explanation: &Explanation<'_>,
) -> Vec<Impulse> {
    let len = flight.mean_v.len();
    let whitener = Whitener::new(&flight.sd_v, &flight.acf);
    let unit = |impulse: &Impulse| {
        let one = Impulse { amplitude_v: polarity, ..*impulse };
        whitener.apply(&pulses_v(&[one], response, polarity, (flight.t0_ps, flight.dt_ps, len)))
    };
    let under = Baseline::new(len, true, Vec::new());
    let columns: Vec<Vec<f64>> = explanation
        .impulses
        .iter()
        .map(unit)
        .chain(under.columns.iter().map(|column| whitener.apply(column)))
        .collect();
    let fit = least_squares(&columns, &whitener.apply(&flight.mean_v), &vec![1.0; len]);
    let own = |(n, impulse): (usize, &Impulse)| match &fit {
        Some(fit) => {
            Impulse { amplitude_v: polarity * fit.values[n], amplitude_sd_v: fit.covariance[n][n].sqrt(), ..*impulse }
        }
        None => *impulse,
    };
    explanation.impulses.iter().enumerate().map(own).collect()
}

/// Standard deviations of counts freed of pile-up, whose means are pulses over a level background.
fn counted_sd(unpiled: &Unpiled, pulses: &[f64]) -> Vec<f64> {
    let left: f64 = unpiled.counts.iter().zip(pulses).map(|(count, pulses)| count - pulses).sum();
    let background = (left / pulses.len() as f64).max(1.0 / pulses.len() as f64);
    let variance = |(pulses, ready): (&f64, &f64)| {
        unpiled.cycles * unpiled.cycles * ((background + pulses.max(0.0)) / unpiled.cycles).exp_m1() / ready
    };
    pulses.iter().zip(&unpiled.ready).map(variance).map(f64::sqrt).collect()
}

/// Variances of the components of slow noise and of a baseline that moves.
fn slow_v2(flight: &FlightProfile, ground_v: f64) -> Vec<f64> {
    let mut slow_v2 = flight.slow_v2.clone();
    if ground_v > 0.0 {
        let components = (flight.mean_v.len() / SAMPLES_PER_COMPONENT).clamp(1, COMPONENTS_MAX);
        slow_v2.resize(slow_v2.len().max(components), 0.0);
        slow_v2[..components].iter_mut().for_each(|v2| *v2 += ground_v * ground_v / components as f64);
    }
    slow_v2
}

/// What may lie under pulses: a constant, a slope, components of known variances.
struct Baseline {
    columns: Vec<Vec<f64>>,
    /// Variance of each component; none for constant and slope.
    variances_v2: Vec<Option<f64>>,
}

impl Baseline {
    fn new(len: usize, has_slope: bool, slow_v2: Vec<f64>) -> Self {
        let middle = 0.5 * (len as f64 - 1.0);
        let mut columns = vec![vec![1.0; len]];
        if has_slope {
            columns.push((0..len).map(|n| n as f64 - middle).collect());
        }
        let mut variances_v2 = vec![None; columns.len()];
        for (k, variance_v2) in slow_v2.into_iter().enumerate().filter(|(_, variance_v2)| *variance_v2 > 0.0) {
            columns.push((0..len).map(|n| component(k, n as f64, len)).collect());
            variances_v2.push(Some(variance_v2));
        }
        Self { columns, variances_v2 }
    }

    /// The likeliest baseline under a record: least squares of whitened samples, where the prior of a component is one
    /// sample more.
    fn under(&self, left_v: &[f64], whitener: &Whitener) -> Vec<f64> {
        let priors: Vec<usize> = (0..self.columns.len()).filter(|k| self.variances_v2[*k].is_some()).collect();
        let with_priors = |samples: Vec<f64>, of: Option<usize>| -> Vec<f64> {
            let prior = |k: &usize| f64::from(u8::from(of == Some(*k)));
            samples.into_iter().chain(priors.iter().map(prior)).collect()
        };
        let columns: Vec<Vec<f64>> =
            self.columns.iter().enumerate().map(|(k, column)| with_priors(whitener.apply(column), Some(k))).collect();
        let right = with_priors(whitener.apply(left_v), None);
        let sds: Vec<f64> = std::iter::repeat_n(1.0, left_v.len())
            .chain(priors.iter().filter_map(|k| self.variances_v2[*k]).map(f64::sqrt))
            .collect();
        let values = least_squares(&columns, &right, &sds).map_or(vec![0.0; columns.len()], |fit| fit.values);
        let under = |n: usize| values.iter().zip(&self.columns).map(|(value, column)| value * column[n]).sum();
        (0..left_v.len()).map(under).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const T0_PS: f64 = 1000.0;
    const DT_PS: f64 = 25.0;
    const LEN: usize = 400;

    fn response() -> Response {
        let values: Vec<f64> = (0..81).map(|i| bell(10.0 * f64::from(i) - 400.0)).collect();
        Response::new(-400.0, 10.0, &values)
    }

    fn bell(time_ps: f64) -> f64 {
        (-0.5 * (time_ps / 80.0).powi(2)).exp()
    }

    fn impulse(time_ps: f64, amplitude_v: f64, width_ps: f64) -> Impulse {
        Impulse {
            time_ps,
            time_sd_ps: 1.0,
            amplitude_v,
            amplitude_sd_v: 0.01,
            width_ps,
            evidence: 100.0,
            misfit_sigma: 0.0,
            misfit_factor: 1.0,
            width_sd_ps: None,
            width_kurtosis: (width_ps > 0.0).then_some(0.0),
            width_tilt: None,
            tail_ps: None,
            own_time_ps: None,
            own_variance_ps2: None,
            pair: None,
        }
    }

    /// Against a sum of bells written down here; a Gaussian widens a bell by the root of the sum of squares.
    #[test]
    fn the_sum_of_pulses_is_the_naive_one() {
        let impulses = [impulse(3000.0, -1.0, 0.0), impulse(3111.3, -0.4, 0.0), impulse(7012.5, -0.2, 60.0)];
        let sum_v = pulses_v(&impulses, &response(), -1.0, (T0_PS, DT_PS, LEN));
        for (n, sum_v) in sum_v.iter().enumerate() {
            let time_ps = T0_PS + n as f64 * DT_PS;
            let wide = 80.0 / 100.0 * (-0.5 * ((time_ps - 7012.5) / 100.0).powi(2)).exp();
            let naive_v = bell(time_ps - 3000.0) + 0.4 * bell(time_ps - 3111.3) + 0.2 * wide;
            assert!((sum_v - naive_v).abs() < 2e-4, "{sum_v} at {time_ps}, {naive_v} by hand");
        }
    }

    /// Against the integral of bells that decay, by small steps; the centroid stays.
    #[test]
    fn a_tail_is_the_integral_of_later_pulses() {
        let (width_ps, tail_ps) = (50.0, 40.0);
        let impulses = [Impulse { tail_ps: Some(tail_ps), ..impulse(3000.0, -1.0, width_ps) }];
        let sum_v = pulses_v(&impulses, &response(), -1.0, (T0_PS, DT_PS, LEN));
        let sigma_ps = 80.0_f64.hypot(30.0);
        let bell = |time_ps: f64| 80.0 / sigma_ps * (-0.5 * (time_ps / sigma_ps).powi(2)).exp();
        let decay = |after_ps: f64| (-after_ps / tail_ps).exp() / tail_ps;
        for (n, sum_v) in sum_v.iter().enumerate() {
            let time_ps = T0_PS + n as f64 * DT_PS - 3000.0;
            let later = |k: i32| 0.5 * (f64::from(k) + 0.5);
            let naive_v: f64 = (0..1600).map(|k| 0.5 * decay(later(k)) * bell(time_ps + tail_ps - later(k))).sum();
            assert!((sum_v - naive_v).abs() < 1e-3, "{sum_v} at {time_ps}, {naive_v} by hand");
        }
    }

    fn profile(mean_v: &[f64], se_v: f64) -> Profile {
        Profile {
            campaign: "c".into(),
            sensor: "s1".into(),
            role: "scene".into(),
            shots: 100,
            t0_ps: T0_PS,
            dt_ps: DT_PS,
            mean_v: Some(mean_v.iter().copied().collect()),
            se_v: Some(vec![se_v; mean_v.len()].into_iter().collect()),
            noise_v: 10.0 * se_v,
            noise_acf: [1.0_f64].into_iter().collect(),
            ..Profile::default()
        }
    }

    /// A sensor whose pulses go down, 500 ps late.
    fn sensor() -> Calibrated {
        Calibrated { response: response(), polarity: -1.0, latency_ps: 500.0, reference_v_ps: None, width: [1.0, 0.03] }
    }

    fn key() -> SensorRange {
        use crate::priors::sensor_range::OfSensorRange;
        profile(&[0.0; 4], 1.0).sensor_range()
    }

    #[test]
    fn a_curve_has_baseline_sign_and_latency_of_its_record() {
        let impulses = [impulse(3000.0, -1.0, 0.0), impulse(3111.3, -0.4, 0.0)];
        let naive_v = |n: usize| {
            let time_ps = T0_PS - 500.0 + n as f64 * DT_PS;
            0.05 + 1e-4 * n as f64 - bell(time_ps - 3000.0) - 0.4 * bell(time_ps - 3111.3)
        };
        let record_v: Vec<f64> = (0..LEN).map(naive_v).collect();
        let explanation = Explanation {
            impulses: &impulses,
            chi2_dof: 1.0,
            width: Some([1.2, 0.001]),
            ground_v: 0.0,
            is_reciprocal: false,
        };
        let curve = Curve::of(&profile(&record_v, 0.001), (&key(), &sensor()), &[], (None, 0.0), &explanation).unwrap();
        assert_eq!(curve.t0_ps, T0_PS - 500.0);
        for (n, fitted_v) in curve.fitted_v.iter().enumerate() {
            assert!((fitted_v - naive_v(n)).abs() < 1e-5, "{fitted_v} at {n}, {} by hand", naive_v(n));
        }
        // Nothing is left, and the response as calibrated was taken, not the wider one.
        assert!(curve.chi2_dof < 1e-3, "{}", curve.chi2_dof);
    }

    /// The pulses of the reciprocal profile, which is ten times brighter, at a second pulse of another ratio.
    #[test]
    fn a_reciprocal_profile_has_heights_of_its_own() {
        let impulses = [impulse(3000.0, -10.0, 0.0), impulse(3111.3, -4.0, 0.0)];
        let record_v: Vec<f64> = (0..LEN)
            .map(|n| {
                let time_ps = T0_PS - 500.0 + n as f64 * DT_PS;
                0.05 - 1.1 * bell(time_ps - 3000.0) - 0.3 * bell(time_ps - 3111.3)
            })
            .collect();
        let explanation =
            Explanation { impulses: &impulses, chi2_dof: 1.0, width: None, ground_v: 0.0, is_reciprocal: true };
        let curve = Curve::of(&profile(&record_v, 0.001), (&key(), &sensor()), &[], (None, 0.0), &explanation).unwrap();
        let heights_v: Vec<f64> = curve.impulses.iter().map(|impulse| impulse.amplitude_v).collect();
        assert!((heights_v[0] + 1.1).abs() < 1e-3 && (heights_v[1] + 0.3).abs() < 1e-3, "{heights_v:?}");
        assert!(curve.impulses.iter().all(|impulse| (1e-5..1e-2).contains(&impulse.amplitude_sd_v)));
        assert!(curve.chi2_dof < 1e-2, "{}", curve.chi2_dof);
    }

    /// A record of a response of 0.9 of the calibration's width, of which the table says nothing.
    #[test]
    fn a_width_that_the_table_lacks_is_looked_for() {
        let impulses = [impulse(3000.0, -1.0, 0.0)];
        let narrow_v = |n: usize| -bell((T0_PS - 500.0 + n as f64 * DT_PS - 3000.0) / 0.9);
        let record_v: Vec<f64> = (0..LEN).map(narrow_v).collect();
        let explanation =
            Explanation { impulses: &impulses, chi2_dof: 1.0, width: None, ground_v: 0.0, is_reciprocal: false };
        let curve =
            Curve::of(&profile(&record_v, 0.000_5), (&key(), &sensor()), &[], (None, 0.0), &explanation).unwrap();
        assert!(curve.chi2_dof < 0.1, "{}", curve.chi2_dof);
    }

    #[test]
    fn slow_noise_is_no_residual() {
        let wave_v = |n: usize| 0.02 * component(3, n as f64, LEN);
        let record_v: Vec<f64> = (0..LEN).map(wave_v).collect();
        let mut profile = profile(&record_v, 0.001);
        let explanation =
            Explanation { impulses: &[], chi2_dof: 1.0, width: None, ground_v: 0.0, is_reciprocal: false };
        let curve = |profile: &Profile| {
            Curve::of(profile, (&key(), &sensor()), &[], (None, 0.0), &explanation).unwrap().chi2_dof
        };
        let without = curve(&profile);
        profile.slow_noise = Some(vec![0.0, 0.0, 0.0, 100.0 * 0.02 * 0.02]);
        let with = curve(&profile);
        assert!(without > 300.0 && with < 0.01, "{without} without, {with} with");
    }
}
