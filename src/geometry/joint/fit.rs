//! The likeliest model from a start: Fisher scoring with Marquardt's damping. Backward elimination by Wald's z.

use nalgebra::{DMatrix, DVector, Matrix3};

use super::Problem;
use super::background::{Level, Tail};
use super::model::{Model, OF_POINT, SHARED, WIDTH};
use super::normal::{Desk, Normal, Shine};

/// Steps at most.
const STEPS: usize = 30;
/// Gain in log-likelihood below which a fit is at its end.
const GAIN: f64 = 0.05;
/// Damping at the start, and where a fit gives up.
const DAMPING: [f64; 2] = [1e-3, 1e7];
/// Largest steps: places in widths of a pulse, logarithms of photons, power, terms over the wall, width.
const LARGEST: [f64; 5] = [0.5, 1.5, 1.0, 0.3, 0.1];

/// Factor on the prior standard deviation of the common delay in error bars: nothing says that it is zero.
const LESS_SURE: f64 = 2.0;
/// Share of the least z below which points are eliminated together.
const HOPELESS: f64 = 0.4;
/// Makes the logarithm of any number of photons negative.
const FAINTER: f64 = 1e3;

/// Which unknowns a fit may change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Free {
    /// Photons of each point.
    Photons,
    /// Places too.
    Places,
    /// The law over the wall too.
    Law,
    /// The width of pulses too.
    Width,
    /// The shape of the response too.
    All,
}

/// A model at its largest likelihood.
#[derive(Clone, Debug)]
pub struct Fit {
    /// The model.
    pub model: Model,
    /// Its sums over histograms.
    pub normal: Normal,
    /// Shape of the wall's own light.
    pub tail: Tail,
    /// The response with the shape of the model.
    pub shine: Shine,
}

impl Fit {
    /// A model as it stands; `levels` are a start.
    pub fn new(problem: &Problem, tail: Tail, model: Model, levels: &[Level]) -> Self {
        Self::with(problem, tail, (model, false), levels)
    }

    fn with(problem: &Problem, tail: Tail, (model, is_free): (Model, bool), levels: &[Level]) -> Self {
        let shine = Shine::new(problem, &model, is_free);
        let normal = Normal::new(problem, &tail, (&model, &shine), levels);
        Self { model, normal, tail, shine }
    }

    /// The likeliest model near by.
    pub fn climb(self, problem: &Problem, free: Free) -> Self {
        let (mut fit, mut damping) = (self, DAMPING[0]);
        if fit.shine.is_free != (free == Free::All) {
            fit = Self::with(problem, fit.tail, (fit.model, free == Free::All), &fit.normal.levels);
        }
        for _ in 0..STEPS {
            let Some(step) = fit.step(problem, free, damping) else { break };
            let model = fit.model.moved(&step);
            let shine = Shine::new(problem, &model, fit.shine.is_free);
            let normal = Normal::new(problem, &fit.tail, (&model, &shine), &fit.normal.levels);
            let gain = normal.log_likelihood - fit.normal.log_likelihood;
            if gain >= 0.0 {
                fit = Self { model, normal, tail: fit.tail, shine };
                damping *= 0.2;
                if gain < GAIN {
                    break;
                }
            } else {
                damping *= 8.0;
                if damping > DAMPING[1] || gain > -0.1 * GAIN {
                    break;
                }
            }
        }
        fit
    }

    fn step(&self, problem: &Problem, free: Free, damping: f64) -> Option<Vec<f64>> {
        let unknowns = self.model.unknowns();
        let (mut system, mut gradient) = (self.normal.fisher.clone(), self.normal.gradient.clone());
        for n in 0..unknowns {
            if kind(n, unknowns).0 > free {
                system.row_mut(n).fill(0.0);
                system.column_mut(n).fill(0.0);
                system[(n, n)] = 1.0;
                gradient[n] = 0.0;
            }
            system[(n, n)] = system[(n, n)] * (1.0 + damping) + f64::MIN_POSITIVE;
        }
        let mut step: DVector<f64> = system.cholesky()?.solve(&gradient);
        let stretch = LARGEST[0] * problem.pulse.width_m();
        for (n, step) in step.iter_mut().enumerate() {
            let class = kind(n, unknowns).1;
            let most = if class == 0 { stretch } else { LARGEST[class] };
            *step = step.clamp(-most, most);
        }
        step.iter().all(|step| step.is_finite()).then(|| step.as_slice().to_vec())
    }

    /// The shape of the wall's own light anew, from what the points leave of the sum of all histograms.
    pub fn reshape(self, problem: &Problem) -> Self {
        let tail = tail(problem, (&self.model, &self.shine));
        Self::new(problem, tail, self.model, &self.normal.levels)
    }

    /// Covariance of all unknowns; `None` where the information is singular.
    pub fn covariance(&self) -> Option<DMatrix<f64>> {
        let mut fisher = self.normal.fisher.clone();
        if self.shine.is_free {
            // Places are those of a delay near zero; error bars are those of one that is less sure.
            let delay = self.model.unknowns() - SHARED + WIDTH + 1;
            let precision = (self.model.unsure * self.shine.pulse.doubts[0]).powi(-2);
            fisher[(delay, delay)] -= precision * (1.0 - LESS_SURE.powi(-2));
        }
        Some(fisher.cholesky()?.inverse())
    }

    /// Wald's z of each point: one over the relative standard deviation of its photons.
    pub fn z(&self) -> Vec<f64> {
        let covariance = self.covariance();
        let of = |k: usize| match &covariance {
            Some(covariance) => {
                let variance = covariance[(OF_POINT * k + 3, OF_POINT * k + 3)];
                1.0 / variance.max(f64::MIN_POSITIVE).sqrt()
            }
            None => 0.0,
        };
        (0..self.model.dots.len()).map(of).collect()
    }

    /// Takes out points, the least sure first, until the z of each is `least` or more.
    pub fn eliminate(self, problem: &Problem, least: f64, free: Free) -> Self {
        let mut fit = self;
        loop {
            let mut z = fit.z();
            let is_singular = fit.covariance().is_none();
            if is_singular {
                // Singular: of points that no histogram tells apart the faintest goes.
                z = fit.model.dots.iter().map(|dot| dot.log_photons - FAINTER).collect();
            }
            let worst = (0..z.len()).min_by(|a, b| z[*a].total_cmp(&z[*b]));
            let Some(worst) = worst.filter(|worst| z[*worst] < least) else { return fit };
            let mut model = fit.model;
            // Those far below go together with the worst.
            let mut n = 0;
            model.dots.retain(|_| {
                n += 1;
                n - 1 != worst && (is_singular || z[n - 1] > HOPELESS * least)
            });
            fit = Self::new(problem, fit.tail, model, &fit.normal.levels).climb(problem, free);
        }
    }
}

/// Covariance of a point's place, from that of all unknowns.
pub fn place_covariance(covariance: &DMatrix<f64>, point: usize) -> Matrix3<f64> {
    covariance.fixed_view::<3, 3>(OF_POINT * point, OF_POINT * point).into_owned()
}

/// Which fits change an unknown, and the class of its steps.
fn kind(n: usize, unknowns: usize) -> (Free, usize) {
    let first = unknowns - SHARED;
    match n {
        n if n < first && n % OF_POINT < 3 => (Free::Places, 0),
        n if n < first && n % OF_POINT == 3 => (Free::Photons, 1),
        n if n < first => (Free::Law, 3),
        n if n == first => (Free::Law, 2),
        n if n < first + WIDTH => (Free::Law, 3),
        n if n == first + WIDTH => (Free::Width, 4),
        _ => (Free::All, 4),
    }
}

/// The shape of the wall's own light from the sum of all histograms, less the light of points.
pub fn tail(problem: &Problem, (model, shine): (&Model, &Shine)) -> Tail {
    let histograms = &problem.histograms;
    let step_m = problem.step_m;
    let first_m = histograms.iter().map(|one| one.first_m).fold(f64::INFINITY, f64::min);
    let last_m = histograms.iter().map(|one| one.first_m + step_m * one.values.len() as f64).fold(0.0, f64::max);
    let bins = ((last_m - first_m) / step_m).ceil() as usize + 1;
    let (mut sum, mut light) = (vec![0.0; bins], vec![0.0; bins]);
    let mut desk = Desk::default();
    for histogram in histograms {
        problem.cancel.check();
        desk.light(problem, (model, shine), (histogram, 0.0));
        let first = ((histogram.first_m - first_m) / step_m).round() as usize;
        sum[first..].iter_mut().zip(&histogram.values).for_each(|(sum, value)| *sum += f64::from(*value));
        light[first..].iter_mut().zip(&desk.all).for_each(|(sum, value)| *sum += value);
    }
    let count = histograms.len();
    Tail::new([first_m, step_m, problem.pulse.width_m()], (&sum, &light), (count, problem.noise.of_sum(count)))
}
