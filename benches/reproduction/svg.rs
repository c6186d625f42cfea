//! Drawings as SVG.

use std::fmt::Write;
use std::path::Path;
use std::{fs, io};

/// A part of a picture with a scale of its own, y upwards.
pub struct Panel {
    /// Left edge in the picture.
    pub left: f64,
    /// Lower edge in the picture, from its top.
    pub bottom: f64,
    /// What lies at the left edge.
    pub x0: f64,
    /// What lies at the lower edge.
    pub y0: f64,
    /// Pixels a unit.
    pub scale: f64,
}

impl Panel {
    fn at(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [self.left + (x - self.x0) * self.scale, self.bottom - (y - self.y0) * self.scale]
    }
}

/// A drawing.
pub struct Picture {
    text: String,
}

impl Picture {
    /// An empty one; width and height in pixels.
    pub fn new(width: f64, height: f64) -> Self {
        let text = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" font-size=\"14\">\n\
             <rect width=\"{width}\" height=\"{height}\" fill=\"white\"/>\n"
        );
        Self { text }
    }

    fn add(&mut self, element: &str) {
        writeln!(self.text, "{element}").expect("a String takes all text");
    }

    /// A straight line.
    pub fn line(&mut self, panel: &Panel, from: [f64; 2], to: [f64; 2], colour: &str, width: f64) {
        let ([x1, y1], [x2, y2]) = (panel.at(from), panel.at(to));
        self.add(&format!(
            "<line x1=\"{x1:.2}\" y1=\"{y1:.2}\" x2=\"{x2:.2}\" y2=\"{y2:.2}\" stroke=\"{colour}\" stroke-width=\"{width}\"/>"
        ));
    }

    /// A dashed line through points.
    pub fn path(&mut self, panel: &Panel, points: &[[f64; 2]], colour: &str) {
        self.through(panel, points, &format!("stroke=\"{colour}\" stroke-dasharray=\"5 4\""));
    }

    /// A line through points.
    pub fn curve(&mut self, panel: &Panel, points: &[[f64; 2]], colour: &str, width: f64) {
        self.through(panel, points, &format!("stroke=\"{colour}\" stroke-width=\"{width}\""));
    }

    fn through(&mut self, panel: &Panel, points: &[[f64; 2]], style: &str) {
        let points: Vec<String> =
            points.iter().map(|point| panel.at(*point)).map(|[x, y]| format!("{x:.2},{y:.2}")).collect();
        self.add(&format!("<polyline points=\"{}\" fill=\"none\" {style}/>", points.join(" ")));
    }

    /// A filled circle.
    pub fn dot(&mut self, panel: &Panel, at: [f64; 2], radius: f64, colour: &str) {
        let [x, y] = panel.at(at);
        self.add(&format!("<circle cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"{radius}\" fill=\"{colour}\"/>"));
    }

    /// A circle.
    pub fn ring(&mut self, panel: &Panel, at: [f64; 2], radius: f64, colour: &str) {
        let [x, y] = panel.at(at);
        self.add(&format!("<circle cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"{radius}\" fill=\"none\" stroke=\"{colour}\"/>"));
    }

    /// A diagonal cross.
    pub fn cross(&mut self, panel: &Panel, at: [f64; 2], radius: f64, colour: &str) {
        let ([x, y], r) = (panel.at(at), radius);
        let (l, t, r, b) = (x - r, y - r, x + r, y + r);
        self.add(&format!(
            "<path d=\"M{l:.2} {t:.2} L{r:.2} {b:.2} M{l:.2} {b:.2} L{r:.2} {t:.2}\" stroke=\"{colour}\" stroke-width=\"2\"/>"
        ));
    }

    /// Text that begins there.
    pub fn label(&mut self, panel: &Panel, at: [f64; 2], text: &str) {
        let [x, y] = panel.at(at);
        self.add(&format!("<text x=\"{x:.2}\" y=\"{y:.2}\">{text}</text>"));
    }

    /// Ends the drawing and writes it.
    pub fn write(mut self, path: &Path) -> io::Result<()> {
        self.add("</svg>");
        fs::create_dir_all(path.parent().expect("a file lies in a folder"))?;
        fs::write(path, self.text)
    }
}
