use super::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use std::time::Instant;

/// Visible patches on two walls at right angles, hidden ones in a box before them.
fn scene(visible: usize, hidden: usize, rng: &mut ChaCha8Rng) -> (Vec<Point>, Vec<Point>) {
    let foci = (0..visible)
        .map(|k| {
            let (u, z) = (rng.random_range(0.0..1.6), rng.random_range(-0.8..0.8));
            if k % 2 == 0 { Point::new(u, 0.0, z) } else { Point::new(0.0, u, z) }
        })
        .collect();
    let mut patches: Vec<Point> = Vec::new();
    while patches.len() < hidden {
        let point = Point::new(rng.random_range(0.8..2.0), rng.random_range(0.8..1.8), rng.random_range(-0.4..0.4));
        let apart = if hidden > 16 { 0.05 } else { 0.15 };
        if patches.iter().all(|other: &Point| (other - point).norm() > apart) {
            patches.push(point);
        }
    }
    (foci, patches)
}

struct Cell {
    visible: usize,
    hidden: usize,
    noise_ps: f64,
    missing: f64,
    spurious: usize,
}

fn profiles(foci: &[Point], hidden: &[Point], cell: &Cell, rng: &mut ChaCha8Rng) -> (Vec<Profile>, f64) {
    let sd_m = cell.noise_ps * 1e-12 * 299_792_458.0 * 1.5_f64.sqrt();
    let normal = Normal::new(0.0, sd_m).unwrap();
    let mut profiles = Vec::new();
    let window_m = 2.4;
    let earliest = |a: usize, b: usize| {
        let of = |q: &Point| (q - foci[a]).norm() + (q - foci[b]).norm();
        (hidden.iter().map(of).fold(f64::INFINITY, f64::min), hidden.iter().map(of).fold(0.0, f64::max))
    };
    for a in 0..foci.len() {
        for b in 0..foci.len() {
            let (first, last) = earliest(a, b);
            let low = (0.5 * (first + last) - 0.5 * window_m).max((foci[a] - foci[b]).norm());
            let mut arrivals = Vec::new();
            for q in hidden {
                if rng.random_range(0.0..1.0) >= cell.missing {
                    let length_m = (q - foci[a]).norm() + (q - foci[b]).norm() + normal.sample(rng);
                    arrivals.push(Arrival { length_m, sd_m });
                }
            }
            for _ in 0..cell.spurious {
                arrivals.push(Arrival { length_m: rng.random_range(low..low + window_m), sd_m });
            }
            profiles.push(Profile::new([a, b], arrivals, Vec::new(), [low, low + window_m]));
        }
    }
    (profiles, sd_m)
}

fn bound_m(foci: &[Point], q: Point, sd_m: f64) -> f64 {
    let mut information = Matrix3::zeros();
    for a in foci {
        for b in foci {
            let slope = (q - a).normalize() + (q - b).normalize();
            information += slope * slope.transpose() / (sd_m * sd_m);
        }
    }
    information.try_inverse().unwrap().trace().sqrt()
}

#[test]
fn cells() {
    let seeds: u64 = std::env::var("SEEDS").map_or(10, |s| s.parse().unwrap());
    let only = std::env::var("ONLY").ok();
    let mut cells = Vec::new();
    for hidden in [1, 2, 4, 8] {
        for noise_ps in [5.0, 25.0, 100.0] {
            for (missing, spurious) in [(0.0, 0), (0.1, 1), (0.3, 4)] {
                cells.push(Cell { visible: 8, hidden, noise_ps, missing, spurious });
            }
        }
    }
    cells.push(Cell { visible: 24, hidden: 64, noise_ps: 5.0, missing: 0.1, spurious: 1 });
    for cell in &cells {
        let name =
            format!("V{} H{} {} ps {}/{}", cell.visible, cell.hidden, cell.noise_ps, cell.missing, cell.spurious);
        if only.as_ref().is_some_and(|only| !name.contains(only.as_str())) {
            continue;
        }
        let (mut good, mut missed, mut extra, mut error2, mut bound2, mut count) = (0, 0, 0, 0.0, 0.0, 0);
        let mut seconds = 0.0;
        for seed in 0..seeds {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let (foci, hidden) = scene(cell.visible, cell.hidden, &mut rng);
            let (profiles, sd_m) = profiles(&foci, &hidden, cell, &mut rng);
            let fronts = vec![(Point::origin(), Vector3::x()), (Point::origin(), Vector3::y())];
            let room = Room { foci: foci.clone(), dimensions: 3, fronts, false_alarm: 1e-3, count: None };
            if std::env::var("TRUTH").is_ok() {
                let mut scene = Scene::new(&profiles, &room).unwrap();
                for q in &hidden {
                    scene.patches.push(Hidden {
                        point: *q,
                        covariance: Matrix3::identity(),
                        evidence: 0.0,
                        seen: SEEN,
                        arrivals: 0.0,
                    });
                }
                scene.settle();
                for _ in 0..5 {
                    for n in 0..scene.patches.len() {
                        let left = scene.left_for(n);
                        let place = scene.view(&left, scene.patches[n].seen).climb(scene.patches[n].point);
                        scene.patches[n] = scene.hidden(place, 0.7).unwrap();
                    }
                    scene.settle();
                }
                let list: Vec<String> = scene
                    .patches
                    .iter()
                    .zip(&hidden)
                    .map(|(h, q)| format!("{:.0}:{:.1}", h.evidence, (h.point - q).norm() * 100.0))
                    .collect();
                eprintln!("  truth {}, lambda {:.2}", list.join(" "), scene.clutter_per_m);
                scene.polish();
                eprintln!("  kept {}", scene.patches.len());
            }
            let start = Instant::now();
            let found = find(&profiles, &room).patches;
            seconds += start.elapsed().as_secs_f64();
            let mut lost = 0;
            for q in &hidden {
                let bound = bound_m(&foci, *q, sd_m);
                let nearest = found.iter().map(|f| (f.point - q).norm()).fold(f64::INFINITY, f64::min);
                if nearest > (5.0 * bound).max(0.005) {
                    lost += 1;
                } else {
                    error2 += nearest * nearest;
                    bound2 += bound * bound;
                    count += 1;
                }
            }
            missed += lost;
            extra += (found.len() + lost).saturating_sub(cell.hidden);
            good += usize::from(lost == 0 && found.len() == cell.hidden);
        }
        eprintln!(
            "{name}: good {good}/{seeds}, missed {missed}, extra {extra}, rms/bound {:.2}, bound {:.3} cm, {:.0} ms",
            (error2 / bound2).sqrt(),
            (bound2 / f64::from(count)).sqrt() * 100.0,
            1e3 * seconds / seeds as f64
        );
    }
}
