//! Hidden patches on a plane (figures 5 and 6).

use std::path::Path;

use nalgebra::Vector3;

use super::svg::{Panel, Picture};
use super::{draws, quantile};
use crate::corner::Place;
use crate::hidden_plane::{Drawn, Noisy, drawn, noisy, noisy_bound_m};
use crate::score::Rate;

/// Onset noise of the second table: the paper's, and a quarter of it.
const NOISES_PS: [f64; 2] = [25.0, 100.0];

/// Quantile of 95 % of chi-square with three degrees of freedom.
const CHI2_95: f64 = 7.815;

/// Tables and figure.
pub fn print(seeds: u64) {
    from_files(seeds);
    from_onsets(seeds);
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt()
}

fn from_files(seeds: u64) {
    let all: Vec<Drawn> = draws(seeds, drawn);
    let places: Vec<&Place> = all.iter().flat_map(|drawn| &drawn.scored.places).collect();
    let placed: Vec<(f64, f64, f64)> =
        places.iter().filter_map(|place| place.found_m.map(|(error, sd)| (error, sd, place.bound_m))).collect();
    let errors_mm: Vec<f64> = placed.iter().map(|(error_m, ..)| 1e3 * error_m).collect();
    let sds_mm: Vec<f64> = placed.iter().map(|(_, sd_m, _)| 1e3 * sd_m).collect();
    let bounds_mm: Vec<f64> = placed.iter().map(|(.., bound_m)| 1e3 * bound_m).collect();
    let squared: Vec<f64> = places.iter().filter_map(|place| place.squared).collect();
    let within = Rate::of(squared.iter().map(|squared| 3.0 * squared < CHI2_95));
    let planes: Vec<f64> = all.iter().filter_map(|drawn| drawn.plane.map(|(_, rms_m)| 1e3 * rms_m)).collect();
    let on_plane: usize = all.iter().filter_map(|drawn| drawn.plane.map(|(patches, _)| patches)).sum();
    println!(
        "| scenes | patches found | false patches | median error (mm) | 90 % (mm) | rms (mm) | rms of the standard deviations (mm) | squared error / covariance, a coordinate | within the ellipsoid of 95 % | rms bound (mm) | assigned to the plane | off the plane, rms (mm) |\n|---|---|---|---|---|---|---|---|---|---|---|---|"
    );
    println!(
        "| {seeds} | {} of {} | {} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} | {within} | {:.2} | {on_plane} | {:.2} |",
        placed.len(),
        places.len(),
        all.iter().map(|drawn| drawn.scored.extra).sum::<usize>(),
        quantile(&errors_mm, 0.5),
        quantile(&errors_mm, 0.9),
        rms(&errors_mm),
        rms(&sds_mm),
        squared.iter().sum::<f64>() / squared.len() as f64,
        rms(&bounds_mm),
        rms(&planes),
    );
    draw_figure(&all[0]);
}

fn from_onsets(seeds: u64) {
    println!(
        "\n| onset noise (ps) | labels | scenes | without solution | patches found | false patches | rms error (mm) | bound (mm) | off the plane, rms (mm) |\n|---|---|---|---|---|---|---|---|---|"
    );
    for noise_ps in NOISES_PS {
        for (labels, rank) in [("by likelihood", false), ("by order of arrival", true)] {
            let all: Vec<Noisy> = draws(seeds, |seed| noisy(seed, noise_ps, rank));
            let errors_mm: Vec<f64> =
                all.iter().flat_map(|noisy| noisy.errors_m.iter().flatten()).map(|error_m| 1e3 * error_m).collect();
            let off_mm: Vec<f64> = all.iter().filter_map(|noisy| noisy.off_plane_m).map(|off_m| 1e3 * off_m).collect();
            println!(
                "| {noise_ps} | {labels} | {seeds} | {} | {} of {} | {} | {:.1} | {:.1} | {} |",
                all.iter().filter(|noisy| noisy.refused).count(),
                errors_mm.len(),
                all.iter().map(|noisy| noisy.errors_m.len()).sum::<usize>(),
                all.iter().map(|noisy| noisy.extra).sum::<usize>(),
                rms(&errors_mm),
                1e3 * noisy_bound_m(noise_ps),
                if off_mm.is_empty() { "-".to_owned() } else { format!("{:.1}", rms(&off_mm)) },
            );
        }
    }
}

/// The room from above and from the side, and what was found, like figure 6.
fn draw_figure(drawn: &Drawn) {
    let mut picture = Picture::new(1040.0, 560.0);
    let above = Panel { left: 20.0, bottom: 500.0, x0: -0.9, y0: -0.15, scale: 240.0 };
    let aside = Panel { left: 640.0, bottom: 500.0, x0: 0.4, y0: -0.65, scale: 330.0 };
    let from_above = |point: &Vector3<f64>| [point.x, point.y];
    let from_aside = |point: &Vector3<f64>| [point.y, point.z];
    for (point, estimate) in &drawn.scored.points {
        let is_hidden = point.x > 0.5;
        for (panel, at) in [(&above, from_above as fn(&Vector3<f64>) -> [f64; 2]), (&aside, from_aside)] {
            if is_hidden || panel.scale < 300.0 {
                picture.ring(panel, at(point), 6.0, "black");
            }
            if let Some(estimate) = estimate.filter(|_| is_hidden || panel.scale < 300.0) {
                picture.dot(panel, at(&estimate), 3.0, "#2f5fbf");
            }
        }
    }
    picture.line(&above, [0.4, -0.2], [0.4, 0.55], "gray", 4.0);
    picture.label(&above, [0.2, 0.1], "door");
    picture.ring(&above, [0.0, 0.0], 5.0, "#3f7f3f");
    picture.label(&above, [-0.25, -0.1], "laser, sensor");
    picture.label(&above, [-0.85, 1.35], "from above");
    picture.label(&aside, [0.45, 0.65], "hidden patches from the side");
    for panel in [&above, &aside] {
        let [x, y] = [panel.x0 + 0.1, panel.y0 - 0.04];
        picture.line(panel, [x, y], [x + 0.2, y], "black", 2.0);
        picture.label(panel, [x + 0.22, y - 0.01], "20 cm");
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/figures/hidden-plane.svg");
    picture.write(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
}
