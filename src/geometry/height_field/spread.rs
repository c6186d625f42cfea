//! Errors of heights and normals: of noise and curvatures, of the law of first light, and of a grid.

use nalgebra::Vector2;
use periscope_cancel::Cancel;
use rayon::prelude::*;

use super::fit::{Fit, Problem};
use super::grid::Grid;
use crate::Point;
use crate::axes::Scatter;
use crate::shapes::Sighting;
use crate::waves::waves;

/// Waves whose largest square is below this share of the variance are left out.
const SMALL: f64 = 1e-3;

/// Standard deviations at nodes.
pub struct Spread<'a> {
    grid: &'a Grid,
    /// Of each node: variance, and covariance with the second node behind it along its row and its column.
    independent: Vec<[f64; 3]>,
    /// What a standard deviation of each error that places have in common does to the heights.
    common: Vec<Vec<f64>>,
    /// What lies between nodes.
    facets_m: Vec<f64>,
}

impl<'a> Spread<'a> {
    /// `None` if heights are not determined.
    pub fn new(problem: &Problem<'a>, fit: &Fit, all: &[&Sighting], zone_m: f64, cancel: &Cancel) -> Option<Self> {
        let grid = problem.grid;
        let factor = fit.factor(problem)?;
        let of_node = |node: usize| {
            cancel.check();
            let mut column = vec![0.0; grid.count()];
            column[node] = 1.0;
            factor.solve(&mut column);
            let at = |other: usize| column.get(other).copied().unwrap_or(0.0);
            [column[node], at(node + 2), at(node + 2 * grid.columns)]
        };
        let independent = (0..grid.count()).into_par_iter().map(of_node).collect();
        let of_wave = |wave: &Vec<f64>| {
            let weighted = wave.iter().enumerate().map(|(n, value)| value * fit.weight(problem, n));
            let mut heights = fit.weighted(&weighted.collect::<Vec<f64>>());
            factor.solve(&mut heights);
            heights
        };
        let common = errors(all, zone_m).par_iter().map(of_wave).collect();
        let facets_m = (0..grid.count()).map(|node| grid.facet_m(&fit.heights_m, node)).collect();
        Some(Self { grid, independent, common, facets_m })
    }

    /// Standard deviations of the height at a node and of its slope, the latter the root of the sum of both variances;
    /// `None` at the border.
    pub fn at(&self, node: usize) -> Option<[f64; 2]> {
        let steps = self.grid.steps(node)?;
        let square = |of: &dyn Fn(&[f64]) -> f64| self.common.iter().map(|one| of(one).powi(2)).sum::<f64>();
        let height_m2 = self.independent[node][0] + square(&|one| one[node]) + self.facets_m[node].powi(2);
        let slope = |k: usize| {
            let [before, behind] = [node - steps[k], node + steps[k]];
            let [own, other] = [before, behind].map(|node| self.independent[node][0]);
            let difference = own + other - 2.0 * self.independent[before][1 + k];
            (difference + square(&|one| one[behind] - one[before])) / (2.0 * self.grid.spacing_m).powi(2)
        };
        Some([height_m2.sqrt(), (slope(0) + slope(1)).max(0.0).sqrt()])
    }
}

/// What places have in common: the error of the law, a smooth function over the wall, and the error of all.
fn errors(all: &[&Sighting], zone_m: f64) -> Vec<Vec<f64>> {
    let points: Vec<Point> = all.iter().map(|one| one.seen).collect();
    let Scatter { middle, axes, .. } = Scatter::of(&points);
    let places: Vec<Vector2<f64>> = points
        .iter()
        .map(|point| Vector2::new(axes[0].dot(&(point - middle)), axes[1].dot(&(point - middle))))
        .collect();
    let [x, y] = [0, 1].map(|k| waves(&places.iter().map(|place| place[k]).collect::<Vec<f64>>(), zone_m));
    let mut errors = vec![all.iter().map(|one| one.light.common_m).collect()];
    for along in &x {
        for up in &y {
            let wave = || along.iter().zip(up).map(|(a, b)| a * b);
            if wave().any(|value| value * value > SMALL) {
                errors.push(wave().zip(all).map(|(value, one)| value * one.light.law_m).collect());
            }
        }
    }
    errors
}
