//! Missing direct reflection (figure 8, top).

use std::f64::consts::PI;
use std::path::Path;

use nalgebra::{DMatrix, Vector2};
use periscope::bound::{Bound, Use};
use periscope::geometry::Point;
use periscope::simulate::Scene;
use periscope::units;

use super::svg::{Panel, Picture};
use super::{draws, quantile};
use crate::mirror::{Geometry, RESPONSES, SCANS, Solution, run, square, worst};
use crate::score::{Estimate, heading, row};

/// Standard deviations of diffuser points in the random geometries.
const DIFFUSER_SDS_M: [f64; 3] = [0.0, 0.0005, 0.002];
/// What the campaign calls exact is known to this much.
const EXACT_M: f64 = 1e-6;
/// Step of finite differences, in metres and radians.
const STEP: f64 = 1e-6;

/// One campaign: what was found, where things are, and the bound of each mirror point's error.
struct Draw {
    outcome: Solution,
    truth: [Point; SCANS],
    bound_m: [f64; SCANS],
}

impl Draw {
    fn new(geometry: &Geometry, response: &str, diffuser_sd_m: f64, seed: u64) -> Self {
        let scene = geometry.scene(response, diffuser_sd_m);
        let outcome = run(&scene, seed);
        Self { outcome, truth: geometry.points(), bound_m: bound_m(geometry, &scene, diffuser_sd_m) }
    }

    /// Position error of the worst point, and relative distance error, of a method by its place.
    fn worst(&self, method: usize) -> (f64, f64) {
        worst(&self.outcome.methods[method].1, &self.truth)
    }

    /// Squared errors of the joint fit, in the mean over the points: over the squared bound, and over the claimed
    /// covariance.
    fn squares(&self) -> (f64, f64) {
        let points = || self.outcome.joint.iter().zip(&self.outcome.methods[0].1).zip(&self.truth);
        let to_bound = points()
            .zip(self.bound_m)
            .map(|(((_, point), truth), bound_m)| (point - truth).norm_squared() / bound_m.powi(2));
        let to_claim = points().map(|((row, _), truth)| square(row, truth));
        (to_bound.sum::<f64>() / SCANS as f64, to_claim.sum::<f64>() / SCANS as f64)
    }
}

pub fn print(campaigns: u64) {
    for (number, (name, response)) in RESPONSES.into_iter().enumerate() {
        let errors = 100_000 * number as u64;
        let all = draws(campaigns, |seed| Draw::new(&Geometry::matched(), response, 0.0005, errors + seed));
        heading(
            &format!("Matched geometry, {campaigns} campaigns, response {name}: worst of three mirror points"),
            &[
                "method",
                "cm, median",
                "90 %",
                "% of distance, median",
                "90 %",
                "paper's error over it, median",
                "rms error over bound [95 %]",
                "squared error over covariance (2) [95 %]",
            ],
        );
        for method in 0..4 {
            let label = all[0].outcome.methods[method].0;
            let claims = if method == 0 { claims(&all) } else { [const { String::new() }; 2] };
            row(&[&[label.to_owned()], &cells(&all, method)[..], &claims].concat());
        }
        print_bounds(response);
    }
    heading(
        &format!("{campaigns} random geometries, joint"),
        &[
            "response",
            "sd of diffuser points (mm)",
            "cm, median",
            "90 %",
            "% of distance, median",
            "90 %",
            "paper's error over it, median",
            "rms error over bound [95 %]",
            "squared error over covariance (2) [95 %]",
            "paper's cm, median",
        ],
    );
    for (number, (name, response)) in RESPONSES.into_iter().enumerate() {
        for (row_number, sd_m) in DIFFUSER_SDS_M.into_iter().enumerate() {
            // The same geometries, with other errors.
            let errors = 1000 * (1 + number * DIFFUSER_SDS_M.len() + row_number) as u64;
            let all = draws(campaigns, |seed| Draw::new(&Geometry::random(seed), response, sd_m, errors + seed));
            let papers_cm: Vec<f64> = all.iter().map(|draw| 1e2 * draw.worst(3).0).collect();
            let papers = [format!("{:.2}", quantile(&papers_cm, 0.5))];
            row(&[&[name.to_owned(), format!("{}", 1e3 * sd_m)], &cells(&all, 0)[..], &claims(&all), &papers].concat());
        }
    }
    draw_figure();
}

/// Bound of the matched geometry's mirror points, as it is and without each of the errors.
fn print_bounds(response: &str) {
    let geometry = Geometry::matched();
    let scene = geometry.scene(response, 0.0005);
    let cases = [
        ("all errors", scene.clone(), 0.0005),
        ("diffuser points known", scene.clone(), 0.0),
        ("beams known", scene.replace("ray_sd_rad = 0.001", "ray_sd_rad = 1e-6"), 0.0005),
        ("response's path known", scene.replace("path_sd_m = 0.0005", "path_sd_m = 1e-6"), 0.0005),
    ];
    println!();
    for (name, scene, diffuser_sd_m) in cases {
        let bound_cm = bound_m(&geometry, &scene, diffuser_sd_m).map(|bound_m| format!("{:.3}", 1e2 * bound_m));
        println!("Bound of the mirror points, {name}: {} cm.", bound_cm.join(", "));
    }
    let scene = Scene::parse(Path::new("scene.toml"), &scene).expect("the scene was simulated");
    let times_ps = time_sds_ps(&scene).map(|sd_ps| format!("{sd_ps:.3}"));
    println!("Bound of the onsets: {} ps.", times_ps.join(", "));
}

/// How far errors of the joint fit are from the bound, and from what it claims.
fn claims(all: &[Draw]) -> [String; 2] {
    let (to_bound, to_claim): (Vec<f64>, Vec<f64>) = all.iter().map(Draw::squares).unzip();
    [Estimate::rms(&to_bound).to_string(), Estimate::mean(&to_claim).to_string()]
}

/// Median and 90 % of position and distance errors, and how many times worse the paper's method is.
fn cells(all: &[Draw], method: usize) -> Vec<String> {
    let cm: Vec<f64> = all.iter().map(|draw| 1e2 * draw.worst(method).0).collect();
    let percent: Vec<f64> = all.iter().map(|draw| 1e2 * draw.worst(method).1).collect();
    let ratio: Vec<f64> = all.iter().map(|draw| draw.worst(3).0 / draw.worst(method).0).collect();
    vec![
        format!("{:.3}", quantile(&cm, 0.5)),
        format!("{:.3}", quantile(&cm, 0.9)),
        format!("{:.2}", quantile(&percent, 0.5)),
        format!("{:.2}", quantile(&percent, 0.9)),
        format!("{:.1}", quantile(&ratio, 0.5)),
    ]
}

/// Bound of each scan's onset, from the instrument's.
fn time_sds_ps(scene: &Scene) -> [f64; SCANS] {
    let bound = Bound::new(scene, Use::default()).expect("the scene was simulated");
    let pulses = || bound.profiles.iter().flat_map(|profile| &profile.pulses);
    [0, 1, 2].map(|scan| {
        let path = [scan + 1, scan + 11];
        let sd_ps = pulses().find(|pulse| pulse.path == path).and_then(|pulse| pulse.time_sd_ps);
        sd_ps.expect("the beam's light is an onset")
    })
}

/// Cramer-Rao bound of each mirror point's position, in flatland, by finite differences of the paths leg by leg.
/// Measured are each path's time, diffuser points, and directions of beams. A time has the instrument's bound of its
/// onset (`periscope::bound`), and an error common to all: that of the response captures' known path.
fn bound_m(geometry: &Geometry, scene: &str, diffuser_sd_m: f64) -> [f64; SCANS] {
    let scene = Scene::parse(Path::new("scene.toml"), scene).expect("the scene was simulated");
    let time_sds_m = time_sds_ps(&scene).map(|sd_ps| units::path_m(sd_ps, scene.group_index));
    let diffuser_sd_m = diffuser_sd_m.max(EXACT_M);
    // Unknown: tilt and offset of the mirror, angle and onward way of each beam, the common error.
    let count = 3 + 2 * SCANS;
    let at = |unknown: usize, by: f64| -> (Vec<f64>, Vec<f64>) {
        let mut unknowns = vec![0.0; count];
        unknowns[unknown] = by;
        let (normal_rad, offset_m) = (geometry.normal_rad + unknowns[0], geometry.offset_m + unknowns[1]);
        let unit = |angle_rad: f64| Vector2::new(angle_rad.cos(), angle_rad.sin());
        let (mut measured, mut points) = (vec![unknowns[2] / scene.captures.path_sd_m], Vec::new());
        for (n, time_sd_m) in time_sds_m.iter().enumerate() {
            let beam_rad = geometry.beams_rad[n] + unknowns[3 + 2 * n];
            let onward_m = geometry.onward_m[n] + unknowns[4 + 2 * n];
            let point = unit(beam_rad) * (offset_m / (normal_rad - beam_rad).cos());
            let diffuser = point + unit(2.0 * normal_rad - beam_rad + PI) * onward_m;
            let path_m = point.norm() + onward_m + diffuser.norm() + unknowns[2];
            measured.extend([path_m / time_sd_m, diffuser.x / diffuser_sd_m, diffuser.y / diffuser_sd_m]);
            measured.push(beam_rad / scene.prior.ray_sd_rad);
            points.extend([point.x, point.y]);
        }
        (measured, points)
    };
    let slopes = |pick: fn((Vec<f64>, Vec<f64>)) -> Vec<f64>| {
        let column = |unknown: usize| {
            let (ahead, behind) = (pick(at(unknown, STEP)), pick(at(unknown, -STEP)));
            ahead.iter().zip(&behind).map(|(a, b)| (a - b) / (2.0 * STEP)).collect::<Vec<f64>>()
        };
        let columns: Vec<Vec<f64>> = (0..count).map(column).collect();
        DMatrix::from_fn(columns[0].len(), count, |i, k| columns[k][i])
    };
    let (measured, points) = (slopes(|both| both.0), slopes(|both| both.1));
    let inverse = (measured.transpose() * measured).try_inverse().expect("scans determine the mirror");
    let covariance = &points * inverse * points.transpose();
    [0, 1, 2].map(|n| (covariance[(2 * n, 2 * n)] + covariance[(2 * n + 1, 2 * n + 1)]).sqrt())
}

/// The matched geometry as it is and as it is found, like figure 8 (c) of the paper.
fn draw_figure() {
    let geometry = Geometry::matched();
    let outcome = run(&geometry.scene(RESPONSES[0].1, 0.0005), 1);
    let (points, diffuser) = (geometry.points(), geometry.diffuser());
    let [(_, joint), .., (_, papers)] = &outcome.methods;
    let (first, last) = (points[0], points[SCANS - 1]);
    let along = last - first;
    let mut picture = Picture::new(1040.0, 620.0);
    // Left the whole scene, right the mirror, in centimetres.
    let whole = Panel { left: 20.0, bottom: 590.0, x0: -37.0, y0: -31.0, scale: 11.0 };
    let close = Panel { left: 600.0, bottom: 590.0, x0: -1.0, y0: 11.5, scale: 72.0 };
    for (panel, radius) in [(&whole, 3.0), (&close, 5.0)] {
        let cm = |point: Point| [1e2 * point.x, 1e2 * point.y];
        picture.line(panel, cm(first - along * 0.15), cm(last + along * 0.15), "black", 2.0);
        for n in 0..SCANS {
            let onto = if radius < 4.0 { diffuser[n] } else { points[n] + (diffuser[n] - points[n]) * 0.05 };
            let from = if radius < 4.0 { Point::origin() } else { Point::from(points[n].coords * 0.9) };
            picture.line(panel, cm(from), cm(points[n]), "#d08770", 1.0);
            picture.line(panel, cm(points[n]), cm(onto), "#d08770", 1.0);
            picture.ring(panel, cm(points[n]), radius + 2.0, "black");
            picture.cross(panel, cm(papers[n]), radius + 1.0, "#bf2f2f");
            picture.dot(panel, cm(joint[n]), radius - 1.0, "#2f5fbf");
        }
        picture.path(panel, &papers.iter().map(|point| cm(*point)).collect::<Vec<_>>(), "#bf2f2f");
    }
    let [[x, top], [_, foot]] = [diffuser[0], diffuser[SCANS - 1]].map(|point| [1e2 * point.x, 1e2 * point.y]);
    picture.line(&whole, [x, top + 1.0], [x, foot - 1.0], "gray", 4.0);
    picture.ring(&whole, [0.0, 0.0], 5.0, "#3f7f3f");
    picture.label(&whole, [1.0, -1.0], "laser, sensor");
    picture.label(&whole, [-34.0, -8.0], "diffuser");
    picture.label(&whole, [5.5, 14.0], "mirror");
    for (panel, length) in [(&whole, 10.0), (&close, 1.0)] {
        let [x, y] = [panel.x0 + 0.5 * length, panel.y0 + 0.15 * length];
        picture.line(panel, [x, y], [x + length, y], "black", 2.0);
        picture.label(panel, [x, y + 0.1 * length], &format!("{length} cm"));
    }
    let legend = |n: f64| [1.2, 17.4 - 0.35 * n];
    picture.ring(&close, legend(0.0), 7.0, "black");
    picture.dot(&close, legend(1.0), 4.0, "#2f5fbf");
    picture.cross(&close, legend(2.0), 6.0, "#bf2f2f");
    for (n, text) in
        ["where the beams meet the mirror", "found, joint fit", "found, z1 = z2 = z3"].into_iter().enumerate()
    {
        let [x, y] = legend(n as f64);
        picture.label(&close, [x + 0.2, y - 0.06], text);
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/figures/mirror.svg");
    picture.write(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
}
