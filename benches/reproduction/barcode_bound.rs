//! The Cramer-Rao bound of a barcode's strips: what the profiles' samples say of pulse times (`bound::profile`),
//! carried over to places by numerical derivatives. Shares no code with the estimator. Given is the response's width;
//! unknown are strips, diffuser points, delays, and how the mirrors are turned, which moves the centroid of their
//! light.

use nalgebra::{DMatrix, DVector, Vector2};
use periscope::bound::profile::ProfileBound;
use periscope::bound::{Bound, Use};
use periscope::campaign::Role;
use periscope::simulate::Scene;
use periscope::units;

use crate::barcode::{Barcode, STRIPS, TURNED_RAD};

const STEP_M: f64 = 1e-6;

/// Step of the mirrors' normals.
const STEP_RAD: f64 = 0.01;

/// Times of all pulses, and what each profile says of them.
fn profiles(barcode: &Barcode) -> (Scene, Vec<ProfileBound>) {
    let scene = barcode.parsed();
    let laboratory = barcode.laboratory(&scene, 0);
    let profiles = Bound::of(&laboratory, Use { bounces: 3, threshold_sigma: 5.0 }).profiles;
    (scene, profiles)
}

/// Bounds of both strips' standard deviations (root of the summed variances), m.
pub fn bound_m(barcode: &Barcode) -> [f64; 2] {
    let (scene, here) = profiles(barcode);
    let turned = [0, 1].map(|strip| {
        let mut turned = barcode.clone();
        turned.turned_rad[strip] += STEP_RAD;
        profiles(&turned).1
    });
    // Strips, lit points, exits (two coordinates each), then the delays of both sensors, as lengths, then the mirrors'
    // normals, rad.
    let points: Vec<i32> = STRIPS.into_iter().chain(barcode.lit_numbers()).chain([4, 3]).collect();
    let truth: Vec<f64> =
        points.iter().flat_map(|patch| scene.patches[patch].position_m[..2].to_vec()).chain([0.0; 4]).collect();
    let delays = 2 * points.len();
    let normals = delays + 2;
    let length_m = |path: &[i32], sensor: &str, values: &[f64]| {
        let at = |patch: &i32| {
            let k = points.iter().position(|other| other == patch).expect("a point of the scene");
            [values[2 * k], values[2 * k + 1]]
        };
        let eye = scene.sensor_m(sensor);
        let nodes: Vec<[f64; 2]> =
            std::iter::once([0.0, 0.0]).chain(path.iter().map(at)).chain([[eye[0], eye[1]]]).collect();
        let legs_m: f64 = nodes.windows(2).map(|leg| (leg[1][0] - leg[0][0]).hypot(leg[1][1] - leg[0][1])).sum();
        legs_m + values[delays + usize::from(sensor == "s2")]
    };
    let mut information = DMatrix::zeros(truth.len(), truth.len());
    for (n, profile) in here.iter().enumerate() {
        let times = profile.detected.len();
        let per_m = units::time_ps(1.0, scene.group_index);
        let slope = |row: usize, column: usize| {
            let pulse = &profile.pulses[profile.detected[row]];
            if column >= normals {
                let same = turned[column - normals][n].pulses.iter().find(|other| other.path == pulse.path);
                return same.map_or(0.0, |other| (other.time_ps - pulse.time_ps) / STEP_RAD);
            }
            let at = |step_m: f64| {
                let mut values = truth.clone();
                values[column] += step_m;
                length_m(&pulse.path, &profile.sensor, &values)
            };
            per_m * (at(STEP_M) - at(-STEP_M)) / (2.0 * STEP_M)
        };
        let jacobian = DMatrix::from_fn(times, truth.len(), slope);
        let of_times = profile.information.view((0, 0), (times, times)).into_owned();
        information += jacobian.transpose() * of_times * jacobian;
    }
    let delay_sd_m = scene.captures.path_sd_m;
    let mut kept: Vec<usize> = (0..4).collect();
    for k in 4..truth.len() {
        let sd = if k < delays {
            barcode.anchor_sd_m
        } else if k < normals {
            delay_sd_m
        } else {
            TURNED_RAD
        };
        if sd > 0.0 {
            information[(k, k)] += 1.0 / (sd * sd);
            kept.push(k);
        }
    }
    let covariance = information.select_rows(&kept).select_columns(&kept).try_inverse().expect("two scans tell strips");
    [0, 2].map(|k| (covariance[(k, k)] + covariance[(k + 1, k + 1)]).sqrt())
}

/// How much later than a strip's own light that of the middle comes over the strip's exit, from a lit point.
fn middle_later_ps(barcode: &Barcode, lit: i32, strip: usize, group_index: f64) -> f64 {
    let scan = barcode.lit_numbers().iter().position(|number| *number == lit).expect("a lit point");
    let middle = 0.5 * (barcode.strips[0] + barcode.strips[1]);
    let way_m = |at: Vector2<f64>| (at - barcode.lit[scan]).norm() + (barcode.exits[strip] - at).norm();
    units::time_ps(way_m(middle) - way_m(barcode.strips[strip]), group_index)
}

/// Bound of the standard deviation of what stands in the middle, over the weaker strip's light, in all profiles
/// together: that of the exit over which it shows less. Unknown are times and amplitudes of both strips' pulses and a
/// constant. That the times follow from four coordinates does not help: coordinates can follow the times.
pub fn share_bound(barcode: &Barcode) -> f64 {
    let scene = barcode.parsed();
    let laboratory = barcode.laboratory(&scene, 0);
    let (acf, dt_ps) = (laboratory.noise_acf(), scene.instrument.dt_ps);
    let mut information = [0.0, 0.0];
    for shooting in laboratory.shootings.iter().filter(|shooting| shooting.role == Role::Scene && shooting.seen == 34) {
        let lights = STRIPS.map(|strip| {
            let own = shooting.paths.iter().filter(|(path, _)| path.len() == 3 && path[1] == strip);
            own.map(|(_, light)| light).max_by(|a, b| a.total().total_cmp(&b.total())).expect("it throws light back")
        });
        let weaker = lights[0].total().min(lights[1].total());
        let [first, second] = lights.map(|light| laboratory.signal(shooting, light));
        let samples = scene.instrument.samples;
        let time_ps = |n: usize| scene.instrument.t0_ps + dt_ps * n as f64;
        let column = |value: &dyn Fn(f64) -> f64| DVector::from_fn(samples, |n, _| value(time_ps(n)));
        let variance = shooting.setting.recorded_noise_v().powi(2) / shooting.shots as f64;
        let noise = DMatrix::from_fn(samples, samples, |r, c| {
            // What rounding adds is white.
            let rounding = if r == c { 1e-3 } else { 0.0 };
            variance * (acf.get(r.abs_diff(c)).copied().unwrap_or(0.0) + rounding)
        });
        let noise = noise.cholesky().expect("a covariance");
        for (through, information) in information.iter_mut().enumerate() {
            let light = lights[through];
            let later_ps = middle_later_ps(barcode, shooting.lit, through, scene.group_index);
            let middle = laboratory.signal(shooting, &light.moved(later_ps, weaker / light.total()));
            let columns = DMatrix::from_columns(&[
                column(&|t| middle.value(t)),
                column(&|t| first.value(t)),
                column(&|t| second.value(t)),
                column(&|t| first.value(t + 1.0) - first.value(t - 1.0)),
                column(&|t| second.value(t + 1.0) - second.value(t - 1.0)),
                column(&|_| 1.0),
            ]);
            let whole = columns.transpose() * noise.solve(&columns);
            // Scaled, as volts and volts a picosecond differ by orders.
            let scale = DVector::from_fn(6, |k, _| whole[(k, k)].sqrt());
            let scaled = DMatrix::from_fn(6, 6, |r, c| whole[(r, c)] / (scale[r] * scale[c]));
            let covariance = scaled.try_inverse().expect("columns differ");
            *information += scale[0].powi(2) / covariance[(0, 0)];
        }
    }
    information[0].min(information[1]).sqrt().recip()
}
