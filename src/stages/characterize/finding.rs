//! What a check found, before the verdict: how likely a good instrument is to go as far, and what it would mean.

use crate::signal::tails;
use crate::tables::{Check, Name};

/// How a value is judged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Test {
    /// Not at all: for information.
    Info,
    /// By a limit that is no matter of chance: whether it is kept.
    Limit(bool),
    /// By its known standard deviation.
    Normal,
    /// By a standard deviation that was estimated with this number of degrees of freedom.
    Student(usize),
    /// As a chi-square over its degrees of freedom.
    ChiSquare(usize),
    /// There is nothing to judge.
    Missing,
}

/// What a check found.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    pub check: String,
    pub value: Option<f64>,
    pub unit: String,
    pub sd: Option<f64>,
    pub expected: Option<f64>,
    pub tolerance: Option<f64>,
    /// Number of independent values among which this one is the most extreme.
    pub trials: f64,
    pub test: Test,
    /// What a fail means, or what is missing.
    pub cause: String,
    pub runs: usize,
}

impl Finding {
    /// A value for information.
    pub fn info(check: &str, value: f64, unit: &str, runs: usize) -> Self {
        Self {
            check: check.to_owned(),
            value: Some(value),
            unit: unit.to_owned(),
            sd: None,
            expected: None,
            tolerance: None,
            trials: 1.0,
            test: Test::Info,
            cause: String::new(),
            runs,
        }
    }

    /// A value that is tested: (estimate, its standard deviation), (expected, tolerance).
    pub fn tested(check: &str, estimate: (f64, f64), good: (f64, f64), unit: &str, test: Test, runs: usize) -> Self {
        Self {
            sd: Some(estimate.1),
            expected: Some(good.0),
            tolerance: Some(good.1),
            test,
            ..Self::info(check, estimate.0, unit, runs)
        }
    }

    /// A value with a least one.
    pub fn limited(check: &str, value: f64, least: f64, unit: &str, runs: usize) -> Self {
        Self { expected: Some(least), test: Test::Limit(value >= least), ..Self::info(check, value, unit, runs) }
    }

    /// A check without captures.
    pub fn missing(check: &str, cause: &str) -> Self {
        Self { value: None, test: Test::Missing, cause: cause.to_owned(), ..Self::info(check, 0.0, "", 0) }
    }

    /// The same with what a fail would mean.
    pub fn because(self, cause: impl Into<String>) -> Self {
        Self { cause: cause.into(), ..self }
    }

    /// How many standard deviations the value lies beyond the tolerance.
    pub fn z(&self) -> Option<f64> {
        let beyond = (self.value? - self.expected?).abs() - self.tolerance?;
        Some(if beyond > 0.0 { beyond / self.sd? } else { 0.0 })
    }

    /// Chance that a good instrument goes as far; `None` where that is no matter of chance.
    pub fn chance(&self) -> Option<f64> {
        let single = match self.test {
            Test::Info | Test::Limit(_) | Test::Missing => return None,
            Test::Normal => tails::normal(self.z()?),
            Test::Student(dof) => tails::student(self.z()?, dof),
            Test::ChiSquare(dof) => tails::chi_square(self.value? * dof as f64, dof),
        };
        Some((single * self.trials).min(1.0))
    }

    /// As a row; it fails where the chance is below `least`.
    pub fn row(self, campaign: &Name, sensor: &Name, least: f64) -> Check {
        let chance = self.chance();
        let verdict =
            match self.test {
                Test::Info => "info",
                Test::Missing => "missing",
                Test::Limit(true) => "pass",
                Test::Limit(false) => "fail",
                Test::Normal | Test::Student(_) | Test::ChiSquare(_) => {
                    if chance.is_some_and(|chance| chance >= least) { "pass" } else { "fail" }
                }
            };
        let needs_cause = ["fail", "missing"].contains(&verdict);
        Check {
            campaign: campaign.clone(),
            sensor: sensor.clone(),
            check: self.check.as_str().into(),
            value: self.value,
            unit: self.unit.as_str().into(),
            sd: self.sd,
            expected: self.expected,
            tolerance: self.tolerance,
            z: self.z(),
            trials: chance.map(|_| self.trials),
            chance,
            verdict: verdict.into(),
            cause: if needs_cause { self.cause.as_str().into() } else { "".into() },
            runs: self.runs as i32,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_within_its_tolerance_is_no_surprise_and_trials_count() {
        let finding = |value: f64, trials: f64| Finding {
            trials,
            ..Finding::tested("c", (value, 0.1), (1.0, 0.5), "", Test::Normal, 1)
        };
        assert_eq!((finding(1.4, 1.0).z(), finding(1.4, 1.0).chance()), (Some(0.0), Some(1.0)));
        assert!((finding(1.9, 1.0).z().unwrap() - 4.0).abs() < 1e-12);
        let (one, ten) = (finding(1.9, 1.0).chance().unwrap(), finding(1.9, 10.0).chance().unwrap());
        assert!((ten / one - 10.0).abs() < 1e-9);
        let row = |finding: Finding| finding.because("why").row(&"a".into(), &"s".into(), 5e-4).verdict;
        assert_eq!((&*row(finding(1.9, 1.0)), &*row(finding(1.9, 10.0))), ("fail", "pass"));
    }
}
