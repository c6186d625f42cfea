//! Hidden surfaces of the tests and of `benches/surfaces.rs`: facets, the light that comes back from them, and the
//! nearest points.
//!
//! Light is summed over facets of the surface: no code is shared with what finds it. Facets hide one another only
//! where they face away from the wall.

use std::path::Path;

use nalgebra::{Point3, Rotation3, Vector3};

use crate::relay_scene::{Capture, FWHM_PS, response};

pub type Point = Point3<f64>;

/// Speed of light, m/ps.
pub const LIGHT: f64 = 2.997_924_58e-4;
/// Steps of time in which light is summed, and the end of the response's tail.
const STEP_PS: f64 = 2.0;
const TAIL_PS: f64 = 1500.0;
/// Distance of facets.
pub const PITCH_M: f64 = 0.0015;

/// The nearest point of each thing to a place, and what it is: 0 smooth, 1 edge, 2 corner.
pub type Nearest = Box<dyn Fn(&Point) -> Vec<(Point, usize)>>;

/// A surface: facets (place, normal, area), and its nearest points.
pub struct Thing {
    pub facets: Vec<(Point, Vector3<f64>, f64)>,
    pub nearest: Nearest,
}

/// A box with half axes at right angles; one axis of no length makes a plate.
pub fn cuboid(middle: Point, axes: [Vector3<f64>; 3], pitch_m: f64) -> Thing {
    let mut facets = Vec::new();
    for k in 0..3 {
        let (along, up) = (axes[(k + 1) % 3], axes[(k + 2) % 3]);
        let [columns, rows] = [along, up].map(|axis| (2.0 * axis.norm() / pitch_m).ceil() as usize);
        let area_m2 = 4.0 * along.norm() * up.norm() / (columns * rows).max(1) as f64;
        for side in [-1.0, 1.0] {
            let normal = along.cross(&up).normalize() * side;
            for n in 0..columns * rows {
                let place = |n: usize, count: usize| (2 * n + 1) as f64 / count as f64 - 1.0;
                let offset = along * place(n % columns, columns) + up * place(n / columns, rows);
                facets.push((middle + axes[k] * side + offset, normal, area_m2));
            }
        }
    }
    let nearest = move |seen: &Point| {
        let (mut point, mut beyond, mut thin) = (middle, 0_usize, 0);
        for axis in axes {
            let square = axis.norm_squared();
            let share = if square > 0.0 { axis.dot(&(seen - middle)) / square } else { 0.0 };
            point += axis * share.clamp(-1.0, 1.0);
            beyond += usize::from(share.abs() > 1.0);
            thin += usize::from(square == 0.0);
        }
        vec![(point, (beyond + thin).saturating_sub(1))]
    };
    Thing { facets, nearest: Box::new(nearest) }
}

/// A sphere; facets that face away from the wall are left out.
pub fn sphere(middle: Point, radius_m: f64, pitch_m: f64) -> Thing {
    let rings = (std::f64::consts::PI * radius_m / pitch_m).ceil() as usize;
    let mut facets = Vec::new();
    for ring in 0..rings {
        let angle = |n: f64| std::f64::consts::PI * n / rings as f64;
        let (sine, cosine) = angle(ring as f64 + 0.5).sin_cos();
        let count = (std::f64::consts::TAU * radius_m * sine / pitch_m).ceil().max(1.0) as usize;
        let band = angle(ring as f64).cos() - angle(ring as f64 + 1.0).cos();
        let area_m2 = std::f64::consts::TAU * radius_m * radius_m * band / count as f64;
        for n in 0..count {
            let (up, along) = (std::f64::consts::TAU * (n as f64 + 0.38 * ring as f64) / count as f64).sin_cos();
            let normal = Vector3::new(sine * along, sine * up, cosine);
            if normal.z < 0.3 {
                facets.push((middle + normal * radius_m, normal, area_m2));
            }
        }
    }
    Thing { facets, nearest: Box::new(move |seen| vec![(middle + (seen - middle).normalize() * radius_m, 0)]) }
}

/// A square with a height, towards the wall; its nearest points are searched for.
fn relief(middle: Point, half_m: f64, height_m: fn(f64, f64) -> f64, pitch_m: f64) -> Thing {
    let place = move |x: f64, y: f64| middle + Vector3::new(x, y, -height_m(x, y));
    let count = (2.0 * half_m / pitch_m).ceil() as usize;
    let mut facets = Vec::new();
    for n in 0..count * count {
        let at = |n: usize| ((n as f64 + 0.5) / count as f64 * 2.0 - 1.0) * half_m;
        let (x, y) = (at(n % count), at(n / count));
        let slope = |dx: f64, dy: f64| (place(x + dx, y + dy) - place(x - dx, y - dy)) / 2e-5;
        let area = slope(0.0, 1e-5).cross(&slope(1e-5, 0.0));
        facets.push((place(x, y), area.normalize(), area.norm() * (2.0 * half_m / count as f64).powi(2)));
    }
    let nearest = move |seen: &Point| {
        let square = |[x, y]: [f64; 2]| (place(x, y) - seen).norm_squared();
        let along = |n: i32| half_m * f64::from(n) / 20.0;
        let grid = (-20..=20).flat_map(|row| (-20..=20).map(move |column| [along(column), along(row)]));
        let mut best = grid.min_by(|a, b| square(*a).total_cmp(&square(*b))).expect("a grid");
        let mut step_m = half_m / 20.0;
        while step_m > 1e-7 {
            let moved = |x: f64, sign: i32| (x + f64::from(sign) * step_m).clamp(-half_m, half_m);
            let tries = (0..9).map(|n| [moved(best[0], n % 3 - 1), moved(best[1], n / 3 - 1)]);
            let next = tries.min_by(|a, b| square(*a).total_cmp(&square(*b))).expect("nine");
            if square(next) < square(best) {
                best = next;
            } else {
                step_m *= 0.5;
            }
        }
        let beyond = best.iter().filter(|x| x.abs() > half_m - 1e-6).count();
        vec![(place(best[0], best[1]), beyond)]
    };
    Thing { facets, nearest: Box::new(nearest) }
}

/// Two things.
pub fn both(first: Thing, second: Thing) -> Thing {
    let mut facets = first.facets;
    facets.extend(second.facets);
    let nearest = move |seen: &Point| [(first.nearest)(seen), (second.nearest)(seen)].concat();
    Thing { facets, nearest: Box::new(nearest) }
}

/// A letter T of two plates: its bar and its stem. Where they meet is no border of the letter.
fn letter(middle: Point, [right, up]: [Vector3<f64>; 2], pitch_m: f64) -> Thing {
    let none = Vector3::zeros();
    let plate =
        |up_m: f64, half_m: [f64; 2]| cuboid(middle + up * up_m, [right * half_m[0], up * half_m[1], none], pitch_m);
    let (bar, stem) = (plate(0.15, [0.2, 0.05]), plate(-0.05, [0.05, 0.15]));
    let facets = bar.facets.iter().chain(&stem.facets).copied().collect();
    let nearest = move |seen: &Point| {
        let [of_bar, of_stem] = [&bar, &stem].map(|plate| (plate.nearest)(seen)[0]);
        let [far_m, near_m] = [of_bar, of_stem].map(|(place, _)| (place - seen).norm());
        let meets = |other: &Thing, place: Point| ((other.nearest)(&place)[0].0 - place).norm() < 1e-9;
        let is_border = [far_m <= near_m || !meets(&stem, of_bar.0), near_m <= far_m || !meets(&bar, of_stem.0)];
        [of_bar, of_stem].into_iter().zip(is_border).filter(|(_, is)| *is).map(|(point, _)| point).collect()
    };
    Thing { facets, nearest: Box::new(nearest) }
}

/// Five steps: fronts that face the wall, and treads behind their upper edges. Half a step's height and depth.
fn stairs(middle: Point, [right, up, away]: [Vector3<f64>; 3], [high_m, deep_m]: [f64; 2], pitch_m: f64) -> Thing {
    let plate = |steps: f64, beyond: Vector3<f64>, [along, facing]: [Vector3<f64>; 2]| {
        let at = middle + (up * high_m + away * deep_m) * (2.0 * steps) + beyond;
        let mut plate = cuboid(at, [right * 0.25, along, Vector3::zeros()], pitch_m);
        plate.facets.retain(|(_, normal, _)| normal.dot(&facing) > 0.0);
        plate
    };
    let of_step = |n: i32| {
        let front = plate(f64::from(n), Vector3::zeros(), [up * high_m, -away]);
        [front, plate(f64::from(n), up * high_m + away * deep_m, [away * deep_m, up])]
    };
    let plates: Vec<Thing> = (-2..=2).flat_map(of_step).collect();
    let facets = plates.iter().flat_map(|plate| plate.facets.iter().copied()).collect();
    let nearest = move |seen: &Point| {
        let of_all = plates.iter().flat_map(|plate| (plate.nearest)(seen));
        let far_m = |(place, _): &(Point, usize)| (place - seen).norm();
        of_all.min_by(|a, b| far_m(a).total_cmp(&far_m(b))).into_iter().collect()
    };
    Thing { facets, nearest: Box::new(nearest) }
}

/// A thing of the study, turned and moved a little by the seed.
pub fn thing(kind: &str, seed: u64) -> Thing {
    let step = |n: u64| (0.618_034 * (seed * 7 + n) as f64).fract() - 0.5;
    let middle = Point::new(0.1 * step(1), 0.1 * step(2), 0.68 + 0.1 * step(3));
    let turn = |x: f64, y: f64| Rotation3::from_euler_angles(x + 0.3 * step(4), y + 0.3 * step(5), 0.3 * step(6));
    let axes = |turn: Rotation3<f64>, half_m: [f64; 3]| [0, 1, 2].map(|k| turn * Vector3::ith(k, half_m[k]));
    match kind {
        "sphere" => sphere(middle + Vector3::z() * 0.12, 0.2, PITCH_M),
        "plate" => cuboid(middle, axes(turn(0.2, 0.4), [0.2, 0.15, 0.0]), PITCH_M),
        "box" => cuboid(middle, axes(turn(0.5, 0.6), [0.15, 0.12, 0.1]), PITCH_M),
        "sphere and plate" => both(
            sphere(middle - Vector3::x() * 0.22, 0.12, PITCH_M),
            cuboid(middle + Vector3::x() * 0.22, axes(turn(0.0, 0.3), [0.12, 0.12, 0.0]), PITCH_M),
        ),
        "letter" => letter(middle, [turn(0.2, 0.2) * Vector3::x(), turn(0.2, 0.2) * Vector3::y()], PITCH_M),
        "stairs" => stairs(middle, axes(turn(0.0, 0.0), [1.0; 3]), [0.05, 0.03], PITCH_M),
        "wavy" => relief(middle, 0.25, |x, y| 0.015 * (14.0 * x).sin() * (11.0 * y).cos(), PITCH_M),
        "saddle" => relief(middle, 0.25, |x, y| 0.6 * (x * x - y * y), PITCH_M),
        kind => panic!("no surface is called {kind}"),
    }
}

impl Thing {
    /// Places and normals of facets that face the wall.
    pub fn facing(&self) -> impl Iterator<Item = (Point, Vector3<f64>)> {
        self.facets.iter().map(|(place, normal, _)| (*place, *normal)).filter(|(_, normal)| normal.z < 0.0)
    }

    /// Writes a confocal scan with so many photons of the surface in a mean histogram.
    pub fn write(&self, path: &Path, capture: &Capture, photons: f64) {
        self.write_apart(path, capture, photons, Vector3::zeros());
    }

    /// The same with lit and seen points apart by so much to both sides of the points of the wall.
    pub fn write_apart(&self, path: &Path, capture: &Capture, photons: f64, half: Vector3<f64>) {
        let pairs = capture.wall().into_iter().map(Point::from).map(|place| [place - half, place + half]);
        let light: Vec<Vec<f64>> = pairs.map(|pair| self.light(capture, pair)).collect();
        let mean = light.iter().flatten().sum::<f64>() / light.len() as f64;
        capture.write_light(path, |n, _, rates| {
            rates.iter_mut().zip(&light[n]).for_each(|(rate, light)| *rate += photons / mean * light);
        });
    }

    /// Light of diffuse facets from a lit point in the bins of a seen one, on any scale.
    fn light(&self, capture: &Capture, pair: [Point; 2]) -> Vec<f64> {
        let steps = (capture.bins as f64 * capture.dt_ps / STEP_PS) as usize;
        let mut sums = vec![0.0; steps + 1];
        for (facet, normal, area_m2) in &self.facets {
            let (to, from) = (pair[0] - facet, pair[1] - facet);
            let (there, back) = (normal.dot(&to), normal.dot(&from));
            if there <= 0.0 || back <= 0.0 {
                continue;
            }
            let (to_m2, from_m2) = (to.norm_squared(), from.norm_squared());
            let at = (to_m2.sqrt() + from_m2.sqrt()) / (LIGHT * STEP_PS);
            let step = at as usize;
            if step < steps {
                let value = area_m2 * there * to.z * back * from.z / (to_m2 * from_m2).powi(2);
                let later = value * (at - step as f64);
                sums[step] += value - later;
                sums[step + 1] += later;
            }
        }
        // Middles of bins lie on steps, so the response is needed at whole steps alone.
        let of_bin = (0.5 * capture.dt_ps / STEP_PS) as usize;
        assert_eq!(of_bin as f64 * STEP_PS, 0.5 * capture.dt_ps, "half a bin is no whole number of steps");
        let before = (6.0 * FWHM_PS / 2.355 / STEP_PS) as usize;
        let after = (TAIL_PS / STEP_PS) as usize;
        let responses: Vec<f64> = (0..before + after).map(|n| response((n as f64 - before as f64) * STEP_PS)).collect();
        let mut light = vec![0.0; capture.bins];
        for (n, sum) in sums.iter().enumerate().filter(|(_, sum)| **sum > 0.0) {
            let first = n.saturating_sub(before + of_bin).div_ceil(2 * of_bin);
            let at = (2 * first + 1) * of_bin + before - n;
            let of_bins = responses[at..].iter().step_by(2 * of_bin);
            light[first.min(capture.bins)..]
                .iter_mut()
                .zip(of_bins)
                .for_each(|(light, response)| *light += sum * response);
        }
        light
    }
}
