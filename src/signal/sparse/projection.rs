//! The projection of whitened records on a set of pulses: best amplitudes for given places, and the next step of the
//! places.
//!
//! What lies under the pulses ([`super::nuisance`]) is eliminated from every product in closed form (Schur complement).
//! So all fits, also those of a few pulses in a long record, are joint fits with it. Data come freed of it already.

use super::column::Column;
use super::linear::{Cholesky, least_squares, non_negative};
use super::model::{Model, WhitenedRecord};
use super::place::Place;

/// Best amplitudes for given places, and the products that the next step needs.
pub(super) struct Projection {
    pub(super) places: Vec<Place>,
    pub(super) groups: Vec<Group>,
    /// Drop of chi2 against no pulse, less the chi2 of priors.
    pub(super) energy: f64,
    layout: Layout,
}

/// Records that share their amplitudes.
pub(super) struct Group {
    /// Of each record, of each pulse.
    pub(super) columns: Vec<Vec<Column>>,
    pub(super) amplitudes: Vec<f64>,
    /// Products of all values and derivatives (value_0, by time_0, .., value_1, ..) with one another.
    products: Vec<f64>,
    /// Their products with the data.
    with_data: Vec<f64>,
}

/// Where values and derivatives stand among the products.
struct Layout {
    /// Number of values and derivatives.
    n: usize,
    /// Of each pulse: the value.
    values: Vec<usize>,
    /// Of each parameter of a place: its pulse, its number there, and the derivative.
    slopes: Vec<(usize, usize, usize)>,
}

impl Layout {
    fn new(places: &[Place]) -> Self {
        let mut layout =
            Self { n: 0, values: Vec::with_capacity(places.len()), slopes: Vec::with_capacity(places.len()) };
        for (k, place) in places.iter().enumerate() {
            layout.values.push(layout.n);
            layout.slopes.extend((0..place.parameters()).map(|p| (k, p, layout.n + 1 + p)));
            layout.n += 1 + place.parameters();
        }
        layout
    }
}

impl Projection {
    /// Amplitudes (>= 0, or signed) that fit whitened `data` (of each record) best with pulses at `places`. `None` if
    /// two pulses coincide, or the maximum of one is outside of a record.
    pub(super) fn new(model: &Model, data: &[Vec<f64>], places: Vec<Place>) -> Option<Self> {
        if !model.admits(&places) {
            return None;
        }
        let layout = Layout::new(&places);
        let groups: Option<Vec<Group>> = model
            .groups
            .iter()
            .map(|group| {
                Group::new(&model.records[group.clone()], &data[group.clone()], &places, &layout, model.signed)
            })
            .collect();
        let groups = groups?;
        let explained: f64 = groups.iter().map(|group| group.energy(&layout)).sum();
        let energy = explained - places.iter().map(Place::penalty).sum::<f64>();
        Some(Self { places, groups, energy, layout })
    }

    /// Gauss-Newton step of the places with the amplitudes eliminated (variable projection after Kaufman, BIT 15, 49
    /// (1975)), damped by Levenberg-Marquardt; with the drop of chi2 that it promises. A pulse of amplitude 0 has no
    /// slope and stays, and so does a parameter at its limit.
    pub(super) fn step(&self, damping: f64, extent_max_ps: f64) -> Option<(Vec<f64>, f64)> {
        let q = self.layout.slopes.len();
        let mut normal = vec![0.0; q * q];
        let mut gradient = vec![0.0; q];
        for group in &self.groups {
            group.add_to_normal(&self.layout, &mut normal, &mut gradient)?;
        }
        for i in 0..q {
            for j in 0..i {
                normal[j * q + i] = normal[i * q + j];
            }
        }
        for (i, [off, prior]) in self.pulls() {
            normal[i * q + i] += prior;
            gradient[i] -= prior * off;
        }
        for (i, &(k, p, _)) in self.layout.slopes.iter().enumerate() {
            if normal[i * q + i] <= 0.0 || self.places[k].is_held(p, gradient[i], extent_max_ps) {
                gradient[i] = 0.0;
                for j in 0..q {
                    normal[i * q + j] = 0.0;
                    normal[j * q + i] = 0.0;
                }
                normal[i * q + i] = 1.0;
            } else {
                normal[i * q + i] *= 1.0 + damping;
            }
        }
        let mut step = gradient.clone();
        Cholesky::new(normal, q)?.solve(&mut step);
        let promised = step.iter().zip(&gradient).map(|(d, g)| d * g).sum();
        Some((step, promised))
    }

    /// The places after a step.
    pub(super) fn moved(&self, step: &[f64], step_max_ps: f64, extent_max_ps: f64) -> Vec<Place> {
        let mut rest = step;
        self.places
            .iter()
            .map(|place| {
                let (own, others) = rest.split_at(place.parameters());
                rest = others;
                place.moved(own, step_max_ps, extent_max_ps)
            })
            .collect()
    }

    /// Of each parameter of a place that has a prior: its number, how far it is off, and the prior's information.
    fn pulls(&self) -> impl Iterator<Item = (usize, [f64; 2])> {
        let slopes = self.layout.slopes.iter().enumerate();
        slopes.filter_map(|(i, (k, p, _))| Some((i, self.places[*k].pull(*p)?)))
    }

    /// Factor of the information matrix of all unknowns, with their priors. `None` if two pulses cannot be resolved.
    pub(super) fn factor(&self) -> Option<Cholesky> {
        let unknowns = self.unknowns();
        let mut information = vec![0.0; unknowns * unknowns];
        for (g, group) in self.groups.iter().enumerate() {
            let basis = self.basis(g);
            for &(i, p, a) in &basis {
                for &(j, q, b) in &basis {
                    information[i * unknowns + j] += a * b * group.products[p * self.layout.n + q];
                }
            }
        }
        let first = self.groups.len() * self.places.len();
        for (i, [_, prior]) in self.pulls() {
            information[(first + i) * (unknowns + 1)] += prior;
        }
        Cholesky::new(information, unknowns)
    }

    /// Products of all unknowns' derivatives with a direction, given as a column of each record.
    pub(super) fn products_with(&self, model: &Model, direction: &[(f64, Column)]) -> Vec<f64> {
        let mut products = vec![0.0; self.unknowns()];
        for (g, (group, range)) in self.groups.iter().zip(&model.groups).enumerate() {
            let mut with_direction = vec![0.0; self.layout.n];
            let records = model.records[range.clone()].iter().zip(&direction[range.clone()]);
            for (columns, (record, (scale, column))) in group.columns.iter().zip(records) {
                let met = |own: &&Column| own.overlaps(column);
                for (k, own) in columns.iter().enumerate().filter(|(_, own)| met(own)) {
                    let mut block = [0.0; 5];
                    own.add_products(column, (5, 1), &mut block, 1, (0, 0));
                    let count = 1 + self.places[k].parameters();
                    for (p, value) in block[..count].iter().enumerate() {
                        with_direction[self.layout.values[k] + p] += scale * value;
                    }
                }
                for axis in record.nuisance.axes() {
                    let along = scale * column.dot_record(axis)[0];
                    for (k, own) in columns.iter().enumerate() {
                        let count = 1 + self.places[k].parameters();
                        for (p, value) in own.dot_record(axis)[..count].iter().enumerate() {
                            with_direction[self.layout.values[k] + p] -= along * value;
                        }
                    }
                }
            }
            for (i, p, a) in self.basis(g) {
                products[i] += a * with_direction[p];
            }
        }
        products
    }

    /// Whether pulse `k` has an amplitude.
    pub(super) fn has_amplitude(&self, k: usize) -> bool {
        self.groups.iter().any(|group| group.amplitudes[k] != 0.0)
    }

    /// Number of unknowns: amplitudes of each group, then the parameters of the places.
    pub(super) fn unknowns(&self) -> usize {
        self.groups.len() * self.places.len() + self.layout.slopes.len()
    }

    /// Place of parameter 0, the time, of pulse `k` among the unknowns.
    pub(super) fn time_unknown(&self, k: usize) -> usize {
        let before: usize = self.places[..k].iter().map(Place::parameters).sum();
        self.groups.len() * self.places.len() + before
    }

    /// Columns of group `g` in the information matrix: unknown, value or derivative, and its factor. The derivative by
    /// a parameter is the amplitude times that of a pulse of amplitude 1; of a pulse without any amplitude that
    /// no prior holds, as if it were 1.
    fn basis(&self, g: usize) -> Vec<(usize, usize, f64)> {
        let k = self.places.len();
        let amplitude = |pulse: usize| {
            let is_lit = self.has_amplitude(pulse) || self.places[pulse].prior.is_some();
            if is_lit { self.groups[g].amplitudes[pulse] } else { 1.0 }
        };
        let values = self.layout.values.iter().enumerate().map(|(i, value)| (g * k + i, *value, 1.0));
        let slopes = self.layout.slopes.iter().enumerate();
        let slopes = slopes.map(|(i, (pulse, _, slope))| (self.groups.len() * k + i, *slope, amplitude(*pulse)));
        values.chain(slopes).collect()
    }
}

impl Group {
    fn new(
        records: &[WhitenedRecord],
        data: &[Vec<f64>],
        places: &[Place],
        layout: &Layout,
        signed: bool,
    ) -> Option<Self> {
        let mut products = vec![0.0; layout.n * layout.n];
        let mut with_data = vec![0.0; layout.n];
        let mut all = Vec::with_capacity(records.len());
        for (record, data) in records.iter().zip(data) {
            let columns: Vec<Column> = places.iter().map(|place| Column::new(record, place)).collect();
            add_record(record, data, places, &columns, layout, &mut products, &mut with_data);
            all.push(columns);
        }
        let gram = minor(&products, layout.n, &layout.values);
        let right: Vec<f64> = layout.values.iter().map(|v| with_data[*v]).collect();
        let amplitudes = if signed { least_squares(&gram, &right)? } else { non_negative(&gram, &right)? };
        Some(Self { columns: all, amplitudes, products, with_data })
    }

    fn energy(&self, layout: &Layout) -> f64 {
        self.amplitudes.iter().zip(&layout.values).map(|(a, v)| a * self.with_data[*v]).sum()
    }

    /// Adds the group's part to the normal equations of the places, up to the diagonal.
    fn add_to_normal(&self, layout: &Layout, normal: &mut [f64], gradient: &mut [f64]) -> Option<()> {
        let (n, q) = (layout.n, layout.slopes.len());
        let gram = Cholesky::new(minor(&self.products, n, &layout.values), layout.values.len())?;
        // Half[i] = L^-1 (values . derivative_i): its products are what the amplitudes can imitate.
        let half: Vec<Vec<f64>> = layout
            .slopes
            .iter()
            .map(|(_, _, slope)| {
                let mut row: Vec<f64> = layout.values.iter().map(|v| self.products[slope * n + v]).collect();
                gram.solve_lower(&mut row);
                row
            })
            .collect();
        for (i, (k, _, slope)) in layout.slopes.iter().enumerate() {
            let a = self.amplitudes[*k];
            if a == 0.0 {
                continue;
            }
            let imitated: f64 =
                layout.values.iter().zip(&self.amplitudes).map(|(v, a)| self.products[slope * n + v] * a).sum();
            gradient[i] += a * (self.with_data[*slope] - imitated);
            for (j, (l, _, other)) in layout.slopes.iter().enumerate().take(i + 1) {
                let shared: f64 = half[i].iter().zip(&half[j]).map(|(p, q)| p * q).sum();
                normal[i * q + j] += a * self.amplitudes[*l] * (self.products[slope * n + other] - shared);
            }
        }
        Some(())
    }
}

/// Adds the products of one record's columns, with one another and with its data, less what the ground under them can
/// imitate.
fn add_record(
    record: &WhitenedRecord,
    data: &[f64],
    places: &[Place],
    columns: &[Column],
    layout: &Layout,
    products: &mut [f64],
    with_data: &mut [f64],
) {
    let n = layout.n;
    let count = |k: usize| 1 + places[k].parameters();
    for i in 0..columns.len() {
        for j in (0..=i).filter(|j| columns[i].overlaps(&columns[*j])) {
            let corner = (layout.values[i], layout.values[j]);
            columns[i].add_products(&columns[j], (count(i), count(j)), products, n, corner);
        }
    }
    let write = |of: &[f64], into: &mut [f64]| {
        for (k, column) in columns.iter().enumerate() {
            for (p, value) in column.dot_record(of)[..count(k)].iter().enumerate() {
                into[layout.values[k] + p] += value;
            }
        }
    };
    write(data, with_data);
    let mut along = vec![0.0; n];
    for axis in record.nuisance.axes() {
        along.fill(0.0);
        write(axis, &mut along);
        for i in 0..n {
            for j in 0..=i {
                products[i * n + j] -= along[i] * along[j];
            }
        }
    }
    for i in 0..n {
        for j in 0..i {
            products[j * n + i] = products[i * n + j];
        }
    }
}

/// The given rows and columns of an `n * n` matrix.
fn minor(matrix: &[f64], n: usize, kept: &[usize]) -> Vec<f64> {
    kept.iter().flat_map(|i| kept.iter().map(move |j| matrix[i * n + j])).collect()
}
