//! Figure like the paper's 8(c), bottom: the room, the rays of both scans, true and found strips with their error ellipses.

use std::fmt::Write as _;
use std::path::Path;

use nalgebra::Matrix2;

use crate::barcode::{Barcode, PIPELINE, STRIPS, paper, run};

/// Pixels of a metre, and of the room's edges.
const SCALE: f64 = 1000.0;
const EDGE: f64 = 60.0;
const HEIGHT_M: f64 = 0.5;
/// Error ellipses are drawn so many standard deviations large.
const SIGMA: f64 = 3.0;
const SEED: u64 = 1;

/// An SVG picture in metres, y upwards.
struct Picture(String);

impl Picture {
    fn at(x_m: f64, y_m: f64) -> (f64, f64) {
        (EDGE + SCALE * (x_m + 0.05), EDGE + SCALE * (HEIGHT_M - y_m))
    }

    fn add(&mut self, element: std::fmt::Arguments) {
        writeln!(self.0, "{element}").expect("a String takes all text");
    }

    fn line(&mut self, points: &[[f64; 2]], style: &str) {
        let points: Vec<String> = points
            .iter()
            .map(|[x_m, y_m]| {
                let (x, y) = Self::at(*x_m, *y_m);
                format!("{x:.1},{y:.1}")
            })
            .collect();
        self.add(format_args!("<polyline points=\"{}\" fill=\"none\" {style}/>", points.join(" ")));
    }

    fn dot(&mut self, x_m: f64, y_m: f64, radius: f64, style: &str) {
        let (x, y) = Self::at(x_m, y_m);
        self.add(format_args!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius}\" {style}/>"));
    }

    fn text(&mut self, x_m: f64, y_m: f64, text: &str) {
        let (x, y) = Self::at(x_m, y_m);
        self.add(format_args!("<text x=\"{x:.1}\" y=\"{y:.1}\">{text}</text>"));
    }
}

/// Writes docs/figures/barcode.svg.
pub fn write() {
    let barcode = Barcode { anchor_sd_m: 5e-4, ..Barcode::new(2) };
    let seen = run(&barcode, SEED, PIPELINE);
    let paper_cm: Vec<f64> = paper(&barcode, SEED).iter().map(|error_m| 1e2 * error_m).collect();
    let mut picture = Picture(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 680 660\" font-family=\"sans-serif\" font-size=\"13\">\n<rect width=\"680\" height=\"660\" fill=\"white\"/>\n"
            .to_owned(),
    );
    let [p4, p3] = barcode.exits;
    picture.line(&[[-0.03, 0.505], [0.52, 0.505]], "stroke=\"#999\" stroke-width=\"4\"");
    picture.text(0.47, 0.525, "diffuser");
    picture.line(&[[0.28, -0.05], [0.28, 0.19]], "stroke=\"black\" stroke-width=\"4\"");
    picture.text(0.29, -0.03, "screen");
    for (k, lit) in barcode.lit.iter().enumerate() {
        let style = format!("stroke=\"{}\" stroke-width=\"1\"", ["#1f77b4", "#2ca02c"][k]);
        for (strip, exit) in barcode.strips.iter().zip([p4, p3]) {
            picture.line(&[[0.0, 0.0], [lit.x, lit.y], [strip.x, strip.y], [exit.x, exit.y], [0.1, 0.0]], &style);
        }
        picture.dot(lit.x, lit.y, 4.0, "fill=\"#333\"");
        picture.text(lit.x - 0.01, lit.y + 0.02, &format!("D{}", k + 1));
    }
    for (exit, name) in [(p4, "D4"), (p3, "D3")] {
        picture.dot(exit.x, exit.y, 4.0, "fill=\"#333\"");
        picture.text(exit.x - 0.01, exit.y + 0.02, name);
    }
    picture.dot(0.0, 0.0, 5.0, "fill=\"#d62728\"");
    picture.text(-0.035, -0.03, "laser, S1");
    picture.dot(0.1, 0.0, 5.0, "fill=\"#9467bd\"");
    picture.text(0.09, -0.03, "S2");
    for (s, name) in ["P1", "P3"].iter().enumerate() {
        let at = barcode.strips[s];
        picture.dot(at.x, at.y, 7.0, "fill=\"none\" stroke=\"black\" stroke-width=\"1.5\"");
        picture.text(at.x + 0.012, at.y - 0.02, name);
        let Some(row) = seen.patches.iter().find(|row| row.patch == STRIPS[s] && row.alternative == 0) else {
            continue;
        };
        let cov = [row.cov_xx_m2, row.cov_xy_m2, row.cov_xy_m2, row.cov_yy_m2].map(Option::unwrap_or_default);
        let eigen = Matrix2::from_row_slice(&cov).symmetric_eigen();
        let turn = |angle: f64| {
            let off = eigen.eigenvectors
                * nalgebra::Vector2::new(
                    angle.cos() * eigen.eigenvalues[0].sqrt(),
                    angle.sin() * eigen.eigenvalues[1].sqrt(),
                )
                * SIGMA;
            [row.x_m + off.x, row.y_m + off.y]
        };
        let ellipse: Vec<[f64; 2]> = (0..=60).map(|k| turn(std::f64::consts::TAU * f64::from(k) / 60.0)).collect();
        picture.line(&ellipse, "stroke=\"#d62728\" stroke-width=\"1\"");
        picture.dot(row.x_m, row.y_m, 2.5, "fill=\"#d62728\"");
    }
    let errors: Vec<String> =
        barcode.errors_m(&seen.patches, 0).iter().map(|error_m| format!("{:.2}", 1e2 * error_m)).collect();
    let of_paper: Vec<String> = paper_cm.iter().map(|error_cm| format!("{error_cm:.2}")).collect();
    let lines = [
        "circles: true strips; red: found from the sum of their pulses, with 3 sd".to_owned(),
        format!(
            "errors {} cm; the paper's protocol, one strip blocked at a time: {} cm",
            errors.join(", "),
            of_paper.join(", ")
        ),
    ];
    for (k, line) in lines.iter().enumerate() {
        picture.add(format_args!("<text x=\"20\" y=\"{}\">{line}</text>", 632 + 18 * k));
    }
    picture.0.push_str("</svg>\n");
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/figures");
    std::fs::create_dir_all(&folder).expect("docs can be written");
    std::fs::write(folder.join("barcode.svg"), picture.0).expect("docs can be written");
    println!("\nwrote docs/figures/barcode.svg");
}
