//! Maximum likelihood for labelled onsets: Gauss and Newton on strips, anchors, delays and tilts.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use super::glint::tangents;
use super::{Bounce, Labels, Point, Problem, Solution};

/// Steps at most, and how often one is halved.
const STEPS: usize = 50;
const HALVINGS: usize = 12;
/// A step that changes chi-square by less is the last.
const SETTLED: f64 = 1e-9;
/// Standard deviation of what stands in the middle between two strips from there, in each coordinate, over their
/// distance.
const CENTRAL: f64 = 0.1;
/// Step of derivatives by a tilt.
const TILT_RAD: f64 = 1e-4;

/// Values of all that is unknown.
#[derive(Clone, Debug)]
pub(super) struct State {
    pub(super) strips: Vec<Point>,
    anchors: Vec<Point>,
    delays_m: Vec<f64>,
    /// Tilt of each strip's normal along two tangents.
    tilts_rad: Vec<[f64; 2]>,
}

impl State {
    /// Strips at these places, all else as it is known.
    pub(super) fn new(problem: &Problem, strips: Vec<Point>) -> Self {
        Self {
            tilts_rad: vec![[0.0; 2]; strips.len()],
            strips,
            anchors: problem.anchors.iter().map(|anchor| anchor.at).collect(),
            delays_m: vec![0.0; problem.delays_sd_m.len()],
        }
    }
}

/// A fit.
pub(super) struct Fit {
    pub(super) state: State,
    pub(super) chi2: f64,
    information: DMatrix<f64>,
    onsets: usize,
}

/// First column of each unknown; `None` for what is exact.
struct Columns {
    strips: Vec<usize>,
    anchors: Vec<Option<usize>>,
    delays: Vec<Option<usize>>,
    tilts: Vec<Option<usize>>,
    count: usize,
}

impl Columns {
    fn new(problem: &Problem) -> Self {
        let (n, mut count) = (problem.dimensions, 0);
        let mut next = |size: usize| {
            count += size;
            count - size
        };
        let strips = problem.strips.iter().map(|_| next(n)).collect();
        let anchors = problem.anchors.iter().map(|anchor| (anchor.sd_m > 0.0).then(|| next(n))).collect();
        let delays = problem.delays_sd_m.iter().map(|sd_m| (*sd_m > 0.0).then(|| next(1))).collect();
        let tilts = problem.strips.iter().map(|strip| strip.surface.tilt_sd_rad().map(|_| next(n - 1))).collect();
        Self { strips, anchors, delays, tilts, count }
    }
}

/// The likeliest state near `start`; `None` where the onsets do not determine it.
pub(super) fn fit(problem: &Problem, labels: &[(usize, Vec<usize>)], start: &State) -> Option<Fit> {
    let model = StripModel { problem, labels, columns: Columns::new(problem) };
    let mut state = start.clone();
    let (mut matrix, mut left) = model.equations(&state)?;
    let mut chi2 = left.norm_squared();
    for _ in 0..STEPS {
        problem.cancel.check();
        let step = matrix.tr_mul(&matrix).cholesky()?.solve(&matrix.tr_mul(&left));
        let shorter = (0..HALVINGS).find_map(|halvings| {
            let next = model.moved(&state, &(&step * 0.5_f64.powi(halvings as i32)));
            let (matrix, left) = model.equations(&next)?;
            let less = chi2 - left.norm_squared();
            (less > 0.0).then_some((next, matrix, left, less))
        });
        let Some((next, next_matrix, next_left, less)) = shorter else { break };
        (state, matrix, left) = (next, next_matrix, next_left);
        chi2 -= less;
        if less < SETTLED {
            break;
        }
    }
    let onsets = left.len() - (model.columns.count - problem.dimensions * problem.strips.len());
    Some(Fit { state, chi2, information: matrix.tr_mul(&matrix), onsets })
}

/// Onsets and priors as equations.
struct StripModel<'a> {
    problem: &'a Problem,
    labels: &'a [(usize, Vec<usize>)],
    columns: Columns,
}

impl StripModel<'_> {
    /// Derivatives and what is left over, in standard deviations.
    fn equations(&self, state: &State) -> Option<(DMatrix<f64>, DVector<f64>)> {
        let (problem, columns) = (self.problem, &self.columns);
        let firsts = problem.records.iter().filter(|record| record.bounce == Bounce::First);
        let mut rows: Vec<(DVector<f64>, f64)> = Vec::new();
        for record in firsts {
            let mut row = DVector::zeros(columns.count);
            let nodes = [(problem.source, None), self.anchor(state, record.lit), self.anchor(state, record.station)];
            let length_m =
                add_path(&mut row, &nodes, problem.dimensions) + self.add_delay(&mut row, state, record.delay);
            let sd_m = record.covariance_m2[(0, 0)].sqrt();
            rows.push((row / sd_m, (record.lengths_m[0] - length_m) / sd_m));
        }
        let normals = self.normals(state);
        for (record, onsets) in self.labels {
            let record = &problem.records[*record];
            let mut covariance = record.covariance_m2.select_rows(onsets).select_columns(onsets);
            let mut block = DMatrix::zeros(onsets.len(), columns.count);
            let mut left = DVector::zeros(onsets.len());
            for (s, onset) in onsets.iter().enumerate() {
                let mut row = DVector::zeros(columns.count);
                let exit = problem.strips[s].exit;
                let nodes = [
                    (problem.source, None),
                    self.anchor(state, record.lit),
                    (state.strips[s], Some(columns.strips[s])),
                    self.anchor(state, exit),
                    self.anchor(state, record.station),
                ];
                let mut length_m = add_path(&mut row, &nodes, problem.dimensions);
                length_m += self.add_delay(&mut row, state, record.delay);
                let (lit, exit) = (state.anchors[record.lit], state.anchors[exit]);
                length_m += self.add_glint(&mut row, state, s, normals[s], lit, exit);
                covariance[(s, s)] += problem.strips[s].surface.variance_m2(state.strips[s], normals[s], lit, exit);
                left[s] = record.lengths_m[*onset] - length_m;
                block.set_row(s, &row.transpose());
            }
            let whiten = covariance.cholesky()?.unpack();
            let block = whiten.solve_lower_triangular(&block)?;
            let left = whiten.solve_lower_triangular(&left)?;
            rows.extend((0..onsets.len()).map(|s| (block.row(s).transpose(), left[s])));
        }
        self.add_priors(&mut rows, state);
        let matrix = DMatrix::from_fn(rows.len(), columns.count, |r, c| rows[r].0[c]);
        Some((matrix, DVector::from_iterator(rows.len(), rows.iter().map(|(_, left)| *left))))
    }

    fn anchor(&self, state: &State, anchor: usize) -> (Point, Option<usize>) {
        (state.anchors[anchor], self.columns.anchors[anchor])
    }

    fn add_delay(&self, row: &mut DVector<f64>, state: &State, delay: usize) -> f64 {
        if let Some(column) = self.columns.delays[delay] {
            row[column] += 1.0;
        }
        state.delays_m[delay]
    }

    /// Normals of the strips before their tilts.
    fn normals(&self, state: &State) -> Vec<Vector3<f64>> {
        let lit: Vec<Point> =
            self.labels.iter().map(|(record, _)| state.anchors[self.problem.records[*record].lit]).collect();
        let strips = self.problem.strips.iter().zip(&state.strips);
        strips.map(|(strip, point)| strip.surface.normal(*point, &lit, state.anchors[strip.exit])).collect()
    }

    /// The shift of a strip's light, and its derivatives by the tilt. Those by places are small against the legs' own.
    fn add_glint(
        &self,
        row: &mut DVector<f64>,
        state: &State,
        strip: usize,
        normal: Vector3<f64>,
        lit: Point,
        exit: Point,
    ) -> f64 {
        let along = tangents(normal);
        let shift_m = |tilt: [f64; 2]| {
            let tilted = (normal + tilt[0] * along[0] + tilt[1] * along[1]).normalize();
            self.problem.strips[strip].surface.shift_m(state.strips[strip], tilted, lit, exit)
        };
        let tilt = state.tilts_rad[strip];
        let here_m = shift_m(tilt);
        if let Some(column) = self.columns.tilts[strip] {
            for k in 0..self.problem.dimensions - 1 {
                let mut next = tilt;
                next[k] += TILT_RAD;
                row[column + k] += (shift_m(next) - here_m) / TILT_RAD;
            }
        }
        here_m
    }

    fn add_priors(&self, rows: &mut Vec<(DVector<f64>, f64)>, state: &State) {
        let (problem, columns, n) = (self.problem, &self.columns, self.problem.dimensions);
        for s in (0..problem.strips.len()).filter(|s| problem.strips[*s].is_central) {
            let (before, behind) = (state.strips[s - 1], state.strips[s + 1]);
            let off = state.strips[s] - nalgebra::center(&before, &behind);
            let sd_m = CENTRAL * (behind - before).norm();
            for k in 0..n {
                let mut row = DVector::zeros(columns.count);
                row[columns.strips[s] + k] = 1.0 / sd_m;
                [s - 1, s + 1].into_iter().for_each(|other| row[columns.strips[other] + k] = -0.5 / sd_m);
                rows.push((row, -off[k] / sd_m));
            }
        }
        let mut add = |column: usize, off: f64, sd: f64| {
            let mut row = DVector::zeros(columns.count);
            row[column] = 1.0 / sd;
            rows.push((row, -off / sd));
        };
        for ((anchor, column), point) in problem.anchors.iter().zip(&columns.anchors).zip(&state.anchors) {
            let Some(column) = column else { continue };
            (0..n).for_each(|k| add(column + k, point[k] - anchor.at[k], anchor.sd_m));
        }
        for ((sd_m, column), delay_m) in problem.delays_sd_m.iter().zip(&columns.delays).zip(&state.delays_m) {
            column.iter().for_each(|column| add(*column, *delay_m, *sd_m));
        }
        for ((strip, column), tilt) in problem.strips.iter().zip(&columns.tilts).zip(&state.tilts_rad) {
            let Some((column, sd_rad)) = column.zip(strip.surface.tilt_sd_rad()) else { continue };
            (0..n - 1).for_each(|k| add(column + k, tilt[k], sd_rad));
        }
    }

    fn moved(&self, state: &State, step: &DVector<f64>) -> State {
        let (columns, n) = (&self.columns, self.problem.dimensions);
        let part = |column: usize| Vector3::from_fn(|k, _| if k < n { step[column + k] } else { 0.0 });
        let mut next = state.clone();
        next.strips.iter_mut().zip(&columns.strips).for_each(|(point, column)| *point += part(*column));
        for (point, column) in next.anchors.iter_mut().zip(&columns.anchors) {
            column.iter().for_each(|column| *point += part(*column));
        }
        for (delay_m, column) in next.delays_m.iter_mut().zip(&columns.delays) {
            column.iter().for_each(|column| *delay_m += step[*column]);
        }
        for (tilt, column) in next.tilts_rad.iter_mut().zip(&columns.tilts) {
            column.iter().for_each(|column| (0..n - 1).for_each(|k| tilt[k] += step[column + k]));
        }
        next
    }
}

/// The length of a path over nodes, and its derivatives by those that have columns.
fn add_path(row: &mut DVector<f64>, nodes: &[(Point, Option<usize>)], dimensions: usize) -> f64 {
    let mut length_m = 0.0;
    for pair in nodes.windows(2) {
        let leg = pair[1].0 - pair[0].0;
        let leg_m = leg.norm();
        length_m += leg_m;
        // Source and sensor may be at one place, a path's nodes not.
        let towards = leg / leg_m;
        for (column, sign) in [(pair[0].1, -1.0), (pair[1].1, 1.0)] {
            column.iter().for_each(|column| (0..dimensions).for_each(|k| row[column + k] += sign * towards[k]));
        }
    }
    length_m
}

impl Fit {
    pub(super) fn solution(&self, problem: &Problem, labels: Labels, cost: f64) -> Solution {
        let (n, strips) = (problem.dimensions, problem.strips.len());
        let columns = Columns::new(problem);
        let whole = self.information.clone().cholesky().expect("its fit had one").inverse();
        let place = |strip: usize, k: usize| columns.strips[strip] + k;
        let covariance_m2 = DMatrix::from_fn(3 * strips, 3 * strips, |r, c| {
            if r % 3 < n && c % 3 < n { whole[(place(r / 3, r % 3), place(c / 3, c % 3))] } else { 0.0 }
        });
        let anchor = |(at, column): (&Point, &Option<usize>)| {
            let entry = |r: usize, c: usize| column.filter(|_| r.max(c) < n).map_or(0.0, |at| whole[(at + r, at + c)]);
            (*at, Matrix3::from_fn(entry))
        };
        Solution {
            points: self.state.strips.clone(),
            covariance_m2,
            chi2: self.chi2,
            cost,
            degrees_of_freedom: self.onsets.saturating_sub(n * strips),
            labels,
            anchors: self.state.anchors.iter().zip(&columns.anchors).map(anchor).collect(),
            delays_m: self.state.delays_m.clone(),
        }
    }
}
