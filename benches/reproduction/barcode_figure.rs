//! Figure like the paper's 8(c), bottom: the room, the rays of both scans, true and found strips with their error
//! ellipses.

use std::f64::consts::TAU;
use std::path::Path;

use nalgebra::{Matrix2, Vector2};
use periscope::tables::Patch;

use super::svg::{Panel, Picture};
use crate::barcode::{Barcode, PIPELINE, STRIPS, paper, run};

/// Error ellipses are drawn this many standard deviations large.
const SIGMA: f64 = 3.0;
const SEED: u64 = 1;

/// Writes docs/figures/barcode.svg.
pub fn write() {
    let barcode = Barcode { anchor_sd_m: 5e-4, ..Barcode::new(2).turned(SEED) };
    let seen = run(&barcode, SEED, PIPELINE);
    let of_paper = paper(&barcode, SEED);
    let mut picture = Picture::new(830.0, 705.0);
    let whole = Panel { left: 110.0, bottom: 570.0, x0: 0.0, y0: 0.0, scale: 1000.0 };
    room(&mut picture, &whole, &barcode);
    strips(&mut picture, &whole, &barcode, &seen.patches, &of_paper);
    // The strips once more, larger.
    let close = Panel { left: 660.0, bottom: 538.0, x0: 0.415, y0: 0.18, scale: 3200.0 };
    let frame = [[0.371, 0.151], [0.46, 0.151], [0.46, 0.209], [0.371, 0.209], [0.371, 0.151]];
    picture.curve(&close, &frame, "#999999", 1.0);
    strips(&mut picture, &close, &barcode, &seen.patches, &of_paper);
    picture.line(&close, [0.387, 0.155], [0.397, 0.155], "black", 2.0);
    picture.label(&close, [0.399, 0.154], "1 cm");
    let in_cm = |patches: &[Patch]| {
        let errors: Vec<String> =
            barcode.errors_m(patches, 0).iter().map(|error_m| format!("{:.2}", 1e2 * error_m)).collect();
        errors.join(" and ")
    };
    let verdict = seen.gaps.first().map_or_else(String::new, |gap| format!("gap between: {}", gap.verdict));
    let lines = [
        format!(
            "circles: true strips; red: found from the sum of their pulses, with 3 sd: off by {} cm",
            in_cm(&seen.patches)
        ),
        format!("crosses: the paper's protocol, one strip blocked at a time: off by {} cm", in_cm(&of_paper)),
        verdict,
    ];
    for (k, line) in lines.iter().enumerate() {
        picture.label(&whole, [-0.09, -0.085 - 0.018 * k as f64], line);
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/figures/barcode.svg");
    picture.write(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
}

/// Diffuser, screen, stations, and the rays of both scans.
fn room(picture: &mut Picture, panel: &Panel, barcode: &Barcode) {
    let [p4, p3] = barcode.exits;
    picture.line(panel, [0.03, 0.435], [0.53, 0.435], "#999999", 4.0);
    picture.label(panel, [0.54, 0.43], "diffuser");
    picture.line(panel, [0.366, -0.05], [0.366, 0.196], "black", 4.0);
    picture.label(panel, [0.306, -0.03], "screen");
    for (k, lit) in barcode.lit.iter().enumerate() {
        let colour = ["#1f77b4", "#2ca02c"][k];
        for (strip, exit) in barcode.strips.iter().zip([p4, p3]) {
            let ray = [[0.0, 0.0], [lit.x, lit.y], [strip.x, strip.y], [exit.x, exit.y], [0.1, 0.0]];
            picture.curve(panel, &ray, colour, 1.0);
        }
        picture.dot(panel, [lit.x, lit.y], 4.0, "#333333");
        picture.label(panel, [lit.x - 0.01, lit.y + 0.02], &format!("D{}", k + 1));
    }
    for (exit, name) in [(p4, "D4"), (p3, "D3")] {
        picture.dot(panel, [exit.x, exit.y], 4.0, "#333333");
        picture.label(panel, [exit.x - 0.01, exit.y + 0.02], name);
    }
    picture.dot(panel, [0.0, 0.0], 5.0, "#d62728");
    picture.label(panel, [-0.035, -0.03], "laser, S1");
    picture.dot(panel, [0.1, 0.0], 5.0, "#9467bd");
    picture.label(panel, [0.09, -0.03], "S2");
}

/// True strips, found ones with their ellipses, and the paper's.
fn strips(picture: &mut Picture, panel: &Panel, barcode: &Barcode, of_stage: &[Patch], of_paper: &[Patch]) {
    for (s, name) in ["P1", "P3"].iter().enumerate() {
        let at = barcode.strips[s];
        picture.ring(panel, [at.x, at.y], 6.0, "black");
        let aside_m = 12.0 / panel.scale;
        picture.label(panel, [at.x + aside_m, at.y - 1.5 * aside_m], name);
        let of = |patches: &[Patch]| patches.iter().find(|row| row.patch == STRIPS[s] && row.alternative == 0).cloned();
        if let Some(row) = of(of_paper) {
            picture.cross(panel, [row.x_m, row.y_m], 4.0, "#ff7f0e");
        }
        let Some(row) = of(of_stage) else { continue };
        let cov = [row.cov_xx_m2, row.cov_xy_m2, row.cov_xy_m2, row.cov_yy_m2].map(Option::unwrap_or_default);
        let eigen = Matrix2::from_row_slice(&cov).symmetric_eigen();
        let sds = eigen.eigenvalues.map(f64::sqrt);
        let point = |angle: f64| {
            let off = SIGMA * eigen.eigenvectors * Vector2::new(angle.cos() * sds[0], angle.sin() * sds[1]);
            [row.x_m + off.x, row.y_m + off.y]
        };
        let ellipse: Vec<[f64; 2]> = (0..=60).map(|k| point(TAU * f64::from(k) / 60.0)).collect();
        picture.curve(panel, &ellipse, "#d62728", 1.0);
        picture.dot(panel, [row.x_m, row.y_m], 2.0, "#d62728");
    }
}
