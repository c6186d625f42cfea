//! Echoes of a lidar as LAS 1.4: points of format 6, and what the format has no field for as extra bytes.
//!
//! Places are whole multiples of a scale around the middle of the cloud: 0.1 mm, or more where the cloud is larger than
//! 400 km. Intensity is the height of an echo, 65,535 for the highest. Extra bytes: `range_sd_m` (standard deviation
//! along the beam), `height`, `width_ps`, `width_sd_ps`. The frame is that of the lidar's own file, which is not
//! described. Source: ASPRS LAS specification 1.4 revision 15.

use std::io::{self, Write};

use crate::tables::Echo;

/// Bytes of the head, of the head of a variable length record, and of a point of format 6.
const HEAD: usize = 375;
const VARIABLE: usize = 54;
const POINT: usize = 30;
/// What stands in extra bytes, 32 bit floats: name and meaning.
const EXTRA: [(&str, &str); 4] = [
    ("range_sd_m", "sd along the beam, m"),
    ("height", "height of the echo"),
    ("width_ps", "width of the echo, ps"),
    ("width_sd_ps", "sd of the width, ps"),
];
/// Bytes of the description of one of them, and the number of a 32 bit float among its types.
const EXTRA_BYTES: usize = 192;
const FLOAT: u8 = 9;
/// Finest scale.
const SCALE_M: f64 = 1e-4;
/// Most returns that a point can count.
const RETURNS: i32 = 15;
/// Bits of the head: the coordinate system would be WKT, which format 6 demands; times are not those of a GPS week.
const WKT: u16 = 1 << 4;
const NOT_OF_WEEK: u16 = 1;
const WEEK_S: f64 = 604_800.0;

/// Writes the echoes.
///
/// # Errors
/// When `out` cannot be written, or an echo has no finite place.
pub fn write(out: &mut impl Write, echoes: &[Echo]) -> io::Result<()> {
    if echoes.iter().flat_map(place_m).any(|coordinate| !coordinate.is_finite()) {
        return Err(io::Error::new(io::ErrorKind::InvalidData, "an echo has no finite place; write them as .ply"));
    }
    let frame = Frame::of(echoes);
    out.write_all(&head(echoes, &frame))?;
    out.write_all(&descriptions())?;
    let highest = echoes.iter().map(|echo| echo.height).fold(0.0, f64::max);
    echoes.iter().try_for_each(|echo| out.write_all(&point(echo, &frame, highest)))
}

fn place_m(echo: &Echo) -> [f64; 3] {
    [echo.x_m, echo.y_m, echo.z_m]
}

/// How places become whole numbers, and the box of all.
#[expect(clippy::struct_field_names, reason = "lengths have their unit")]
struct Frame {
    scale_m: f64,
    offset_m: [f64; 3],
    low_m: [f64; 3],
    high_m: [f64; 3],
}

impl Frame {
    fn of(echoes: &[Echo]) -> Self {
        let along = |axis: usize, start: f64, fold: fn(f64, f64) -> f64| {
            let end = echoes.iter().map(|echo| place_m(echo)[axis]).fold(start, fold);
            if end.is_finite() { end } else { 0.0 }
        };
        let low_m = [0, 1, 2].map(|axis| along(axis, f64::INFINITY, f64::min));
        let high_m = [0, 1, 2].map(|axis| along(axis, f64::NEG_INFINITY, f64::max));
        let offset_m = [0, 1, 2].map(|axis| (0.5 * (low_m[axis] + high_m[axis])).round());
        let reach_m = (0..3).map(|axis| high_m[axis] - low_m[axis]).fold(1.0, f64::max);
        // Half of the box, and what rounding the offset adds, must fit 31 bits.
        let scale_m = SCALE_M.max((0.5 * reach_m + 1.0) / f64::from(i32::MAX));
        Self { scale_m, offset_m, low_m, high_m }
    }

    fn codes(&self, place_m: [f64; 3]) -> [i32; 3] {
        [0, 1, 2].map(|axis| ((place_m[axis] - self.offset_m[axis]) / self.scale_m).round() as i32)
    }
}

fn head(echoes: &[Echo], frame: &Frame) -> Vec<u8> {
    let is_of_week = echoes.iter().all(|echo| (0.0..=WEEK_S).contains(&echo.gps_time_s));
    let mut head = b"LASF".to_vec();
    head.extend([0, 0]);
    head.extend((WKT | if is_of_week { 0 } else { NOT_OF_WEEK }).to_le_bytes());
    head.resize(24, 0);
    head.extend([1, 4]);
    head.extend(b"EXTRACTION");
    head.resize(58, 0);
    head.extend(b"Periscope");
    head.resize(94, 0);
    head.extend((HEAD as u16).to_le_bytes());
    head.extend(((HEAD + VARIABLE + EXTRA.len() * EXTRA_BYTES) as u32).to_le_bytes());
    head.extend(1_u32.to_le_bytes());
    head.push(6);
    head.extend(((POINT + 4 * EXTRA.len()) as u16).to_le_bytes());
    // Numbers of points of older versions are 0 for this format.
    head.resize(131, 0);
    let mut put = |numbers: &[f64]| numbers.iter().for_each(|number| head.extend(number.to_le_bytes()));
    put(&[frame.scale_m; 3]);
    put(&frame.offset_m);
    (0..3).for_each(|axis| put(&[frame.high_m[axis], frame.low_m[axis]]));
    head.resize(247, 0);
    head.extend((echoes.len() as u64).to_le_bytes());
    for number in 1..=RETURNS {
        let count = echoes.iter().filter(|echo| echo.echo.clamp(1, RETURNS) == number).count();
        head.extend((count as u64).to_le_bytes());
    }
    head
}

/// The variable length record that describes the extra bytes.
fn descriptions() -> Vec<u8> {
    let mut record = vec![0, 0];
    record.extend(b"LASF_Spec");
    record.resize(18, 0);
    record.extend(4_u16.to_le_bytes());
    record.extend(((EXTRA.len() * EXTRA_BYTES) as u16).to_le_bytes());
    record.resize(VARIABLE, 0);
    for (name, meaning) in EXTRA {
        let start = record.len();
        record.extend([0, 0, FLOAT, 0]);
        record.extend(name.as_bytes());
        record.resize(start + EXTRA_BYTES - 32, 0);
        record.extend(meaning.as_bytes());
        record.resize(start + EXTRA_BYTES, 0);
    }
    record
}

fn point(echo: &Echo, frame: &Frame, highest: f64) -> Vec<u8> {
    let mut point: Vec<u8> = frame.codes(place_m(echo)).iter().flat_map(|code| code.to_le_bytes()).collect();
    let share = if highest > 0.0 { (echo.height / highest).clamp(0.0, 1.0) } else { 0.0 };
    point.extend(((share * f64::from(u16::MAX)).round() as u16).to_le_bytes());
    let (number, count) = (echo.echo.clamp(1, RETURNS) as u8, echo.echoes.clamp(1, RETURNS) as u8);
    point.push(number | count << 4);
    point.resize(22, 0);
    point.extend(echo.gps_time_s.to_le_bytes());
    for value in [echo.range_sd_m, echo.height, echo.width_ps, echo.width_sd_ps] {
        point.extend((value as f32).to_le_bytes());
    }
    point
}
