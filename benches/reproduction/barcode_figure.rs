//! Figure like the paper's 8(c), bottom: the room, the rays of both scans, true and found strips with their error ellipses.

use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::path::Path;

use nalgebra::{Matrix2, Vector2};
use periscope::tables::Patch;

use crate::barcode::{Barcode, PIPELINE, STRIPS, paper, run};

/// Error ellipses are drawn so many standard deviations large.
const SIGMA: f64 = 3.0;
const SEED: u64 = 1;

/// An SVG picture in metres, y upwards.
struct Picture {
    text: String,
    /// Pixels of a metre, and pixel of the origin.
    scale: f64,
    origin: [f64; 2],
}

impl Picture {
    fn at(&self, x_m: f64, y_m: f64) -> (f64, f64) {
        (self.origin[0] + self.scale * x_m, self.origin[1] - self.scale * y_m)
    }

    fn add(&mut self, element: std::fmt::Arguments) {
        writeln!(self.text, "{element}").expect("a String takes all text");
    }

    fn line(&mut self, points: &[[f64; 2]], style: &str) {
        let points: Vec<String> = points
            .iter()
            .map(|[x_m, y_m]| {
                let (x, y) = self.at(*x_m, *y_m);
                format!("{x:.1},{y:.1}")
            })
            .collect();
        self.add(format_args!("<polyline points=\"{}\" fill=\"none\" {style}/>", points.join(" ")));
    }

    fn dot(&mut self, x_m: f64, y_m: f64, radius: f64, style: &str) {
        let (x, y) = self.at(x_m, y_m);
        self.add(format_args!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius}\" {style}/>"));
    }

    fn text(&mut self, x_m: f64, y_m: f64, text: &str) {
        let (x, y) = self.at(x_m, y_m);
        self.add(format_args!("<text x=\"{x:.1}\" y=\"{y:.1}\">{text}</text>"));
    }
}

/// Writes docs/figures/barcode.svg.
pub fn write() {
    let barcode = Barcode { anchor_sd_m: 5e-4, ..Barcode::new(2).turned(SEED) };
    let seen = run(&barcode, SEED, PIPELINE);
    let of_paper = paper(&barcode, SEED);
    let mut picture = Picture { text: String::new(), scale: 1000.0, origin: [110.0, 570.0] };
    room(&mut picture, &barcode);
    strips(&mut picture, &barcode, &seen.patches, &of_paper);
    // The strips once more, larger.
    picture
        .add(format_args!("<rect x=\"410\" y=\"443\" width=\"290\" height=\"190\" fill=\"white\" stroke=\"#999\"/>"));
    (picture.scale, picture.origin) = (3200.0, [555.0 - 3200.0 * 0.34, 538.0 + 3200.0 * 0.17]);
    strips(&mut picture, &barcode, &seen.patches, &of_paper);
    picture.line(&[[0.312, 0.145], [0.322, 0.145]], "stroke=\"black\" stroke-width=\"2\"");
    picture.text(0.324, 0.144, "1 cm");
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
        picture.add(format_args!("<text x=\"20\" y=\"{}\">{line}</text>", 655 + 18 * k));
    }
    let head = "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 720 705\" font-family=\"sans-serif\" font-size=\"13\">";
    let background = "<rect width=\"720\" height=\"705\" fill=\"white\"/>";
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/figures");
    std::fs::create_dir_all(&folder).expect("docs can be written");
    std::fs::write(folder.join("barcode.svg"), format!("{head}\n{background}\n{}</svg>\n", picture.text))
        .expect("docs can be written");
    println!("\nwrote docs/figures/barcode.svg");
}

/// Diffuser, screen, stations, and the rays of both scans.
fn room(picture: &mut Picture, barcode: &Barcode) {
    let [p4, p3] = barcode.exits;
    picture.line(&[[-0.03, 0.505], [0.52, 0.505]], "stroke=\"#999\" stroke-width=\"4\"");
    picture.text(0.53, 0.5, "diffuser");
    picture.line(&[[0.28, -0.05], [0.28, 0.19]], "stroke=\"black\" stroke-width=\"4\"");
    picture.text(0.22, -0.03, "screen");
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
}

/// True strips, found ones with their ellipses, and the paper's.
fn strips(picture: &mut Picture, barcode: &Barcode, found: &[Patch], of_paper: &[Patch]) {
    for (s, name) in ["P1", "P3"].iter().enumerate() {
        let at = barcode.strips[s];
        picture.dot(at.x, at.y, 6.0, "fill=\"none\" stroke=\"black\" stroke-width=\"1.5\"");
        let aside_m = 12.0 / picture.scale;
        picture.text(at.x + aside_m, at.y - 1.5 * aside_m, name);
        let of = |patches: &[Patch]| patches.iter().find(|row| row.patch == STRIPS[s] && row.alternative == 0).cloned();
        if let Some(row) = of(of_paper) {
            let arm_m = 4.0 / picture.scale;
            for side in [-1.0, 1.0] {
                let from = [row.x_m - arm_m, row.y_m - side * arm_m];
                let to = [row.x_m + arm_m, row.y_m + side * arm_m];
                picture.line(&[from, to], "stroke=\"#ff7f0e\" stroke-width=\"2\"");
            }
        }
        let Some(row) = of(found) else { continue };
        let cov = [row.cov_xx_m2, row.cov_xy_m2, row.cov_xy_m2, row.cov_yy_m2].map(Option::unwrap_or_default);
        let eigen = Matrix2::from_row_slice(&cov).symmetric_eigen();
        let sds = eigen.eigenvalues.map(f64::sqrt);
        let point = |angle: f64| {
            let off = SIGMA * eigen.eigenvectors * Vector2::new(angle.cos() * sds[0], angle.sin() * sds[1]);
            [row.x_m + off.x, row.y_m + off.y]
        };
        let ellipse: Vec<[f64; 2]> = (0..=60).map(|k| point(TAU * f64::from(k) / 60.0)).collect();
        picture.line(&ellipse, "stroke=\"#d62728\" stroke-width=\"1\"");
        picture.dot(row.x_m, row.y_m, 2.0, "fill=\"#d62728\"");
    }
}
