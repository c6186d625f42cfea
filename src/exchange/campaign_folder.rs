//! Writes a capture as a campaign folder: campaign.toml, a table of captures, histograms and the response as NumPy
//! arrays.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write as _};
use std::path::Path;

use super::{Capture, ExchangeError, Grid, Pair, Spot};
use crate::campaign::keys::CAMPAIGN_FILE;
use crate::campaign::keys::LASER;
use crate::formats::npy;
use crate::units::{self, PatchId};

/// Files of the folder.
const TABLE: &str = "captures.csv";
const RESPONSE_TABLE: &str = "response.csv";
const HISTOGRAMS: &str = "raw/histograms.npy";
const RESPONSE: &str = "raw/response.npy";
/// Name of the detector, and of its station if that is not the laser's.
const SENSOR: &str = "sensor";
/// Points nearer than this are one patch.
const SAME_M: f64 = 1e-6;
/// Default number of laser pulses of a histogram: with as many, no photon hides another.
const CYCLES: u64 = 1_000_000_000_000;
/// Distance of laser and sensor from the wall, if neither times nor file depend on it.
const FRONT_M: f64 = 1.0;
/// Length of the known path of the response. The response extends to both sides of the arrival by a number of its
/// standard deviations.
const RESPONSE_PATH_M: f64 = 1.0;
const RESPONSE_SIGMA: f64 = 6.0;
/// Height of the response: in photons, or on an arbitrary scale for a sensor that does not count.
const RESPONSE_COUNTS: f64 = 1e6;
/// Shots of the response of a sensor that does not count; each starts an equal fraction of a bin later.
const RESPONSE_SHOTS: usize = 8;
/// Full width at half maximum of a Gaussian, in standard deviations.
const FWHM: f64 = 2.354_820_045_030_949_3;

/// What the campaign needs and a capture does not contain.
#[derive(Clone, Debug)]
pub struct CampaignOptions {
    /// Name of the campaign.
    pub name: String,
    /// Full width at half maximum of laser pulse and sensor together.
    pub fwhm_ps: f64,
    /// Of each axis of the grids, only every `every`-th point is kept.
    pub every: usize,
    /// Standard deviation of each coordinate of the points; absent: exact.
    pub sd_m: Option<f64>,
    /// Laser pulses per histogram; absent: enough that no photon hides another.
    pub cycles: Option<u64>,
    /// Dead time of the sensor after a detection.
    pub dead_time_ps: Option<f64>,
    /// Time behind the wall's own light from which on light counts; absent: the program finds it.
    pub gate_ps: Option<f64>,
}

/// Size of the campaign.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Summary {
    /// Patches.
    pub patches: usize,
    /// Histograms.
    pub histograms: usize,
    /// Whether they hold photon counts.
    pub counts: bool,
}

/// Writes the campaign into `out`, which must be empty or absent.
///
/// # Errors
/// When the folder is in use or cannot be written, or the capture cannot be a campaign.
pub fn write(capture: &Capture, options: &CampaignOptions, out: &Path) -> Result<Summary, ExchangeError> {
    let unfit = |problem: String| ExchangeError::Unfit { path: out.to_owned(), problem };
    if out.exists() && fs::read_dir(out).is_ok_and(|mut entries| entries.next().is_some()) {
        return Err(unfit("is not empty; choose another folder, or remove it".to_owned()));
    }
    let is_kept =
        |pair: &&Pair| capture.lit.keeps(pair.lit, options.every) && capture.seen.keeps(pair.seen, options.every);
    let pairs: Vec<Pair> = capture.pairs.iter().filter(is_kept).copied().collect();
    let folder = Folder { capture, options, layout: Layout::new(capture, &pairs), pairs };
    let counts = folder.are_counts().map_err(unfit)?;
    let raw = out.join("raw");
    fs::create_dir_all(&raw).map_err(|source| ExchangeError::Write { path: raw, source })?;
    save(&out.join(HISTOGRAMS), |file| folder.write_histograms(file, counts))?;
    save(&out.join(RESPONSE), |file| folder.write_response(file, counts))?;
    save(&out.join(TABLE), |file| file.write_all(folder.table().as_bytes()))?;
    save(&out.join(RESPONSE_TABLE), |file| file.write_all(folder.response_table(counts).as_bytes()))?;
    save(&out.join(CAMPAIGN_FILE), |file| file.write_all(folder.campaign(counts).as_bytes()))?;
    Ok(Summary { patches: folder.layout.patches.len(), histograms: folder.pairs.len(), counts })
}

fn save(path: &Path, write: impl Fn(&mut BufWriter<File>) -> io::Result<()>) -> Result<(), ExchangeError> {
    let saved = File::create(path).map(BufWriter::new).and_then(|mut file| {
        write(&mut file)?;
        file.flush()
    });
    saved.map_err(|source| ExchangeError::Write { path: path.to_owned(), source })
}

/// The patches, their numbers by position, and the stations.
struct Layout {
    patches: BTreeMap<PatchId, Spot>,
    numbers: BTreeMap<[i64; 3], PatchId>,
    laser_m: [f64; 3],
    sensor_m: [f64; 3],
}

impl Layout {
    fn new(capture: &Capture, pairs: &[Pair]) -> Self {
        let (mut patches, mut numbers) = (BTreeMap::new(), BTreeMap::new());
        let of = |grid: &Grid, place: &dyn Fn(&Pair) -> usize| -> Vec<Spot> {
            pairs.iter().map(|pair| grid.spots[place(pair)]).collect()
        };
        let (lit, seen) = (of(&capture.lit, &|pair| pair.lit), of(&capture.seen, &|pair| pair.seen));
        // The larger grid gets the first numbers, so that the points of both grids are in order.
        let larger_first = if capture.lit.spots.len() > capture.seen.spots.len() { [lit, seen] } else { [seen, lit] };
        for spot in larger_first.into_iter().flatten() {
            let next = numbers.len() as PatchId + 1;
            let number = *numbers.entry(key(&spot)).or_insert(next);
            patches.entry(number).or_insert(spot);
        }
        let front = front_of(&patches);
        let laser_m = capture.laser_m.or(capture.sensor_m).unwrap_or(front);
        Self { laser_m, sensor_m: capture.sensor_m.unwrap_or(laser_m), patches, numbers }
    }

    fn number(&self, spot: &Spot) -> PatchId {
        self.numbers[&key(spot)]
    }

    fn is_together(&self) -> bool {
        gap_m(self.laser_m, self.sensor_m) <= SAME_M
    }
}

/// Rounded position, so that equal ones compare equal.
fn key(spot: &Spot) -> [i64; 3] {
    spot.position_m.map(|coordinate| (coordinate / SAME_M).round() as i64)
}

fn gap_m(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

/// A point in front of the middle of the wall, on its lit side.
fn front_of(patches: &BTreeMap<PatchId, Spot>) -> [f64; 3] {
    let count = patches.len() as f64;
    let mean = |value: &dyn Fn(&Spot) -> [f64; 3]| {
        let sum = patches.values().map(value).fold([0.0; 3], |sum, one| std::array::from_fn(|i| sum[i] + one[i]));
        sum.map(|sum| sum / count)
    };
    let middle = mean(&|spot| spot.position_m);
    let normal = mean(&|spot| spot.normal.unwrap_or([0.0, 0.0, 1.0]));
    std::array::from_fn(|i| middle[i] + FRONT_M * normal[i])
}

/// Number of response shots: photon histograms hold all in one.
fn response_shots(counts: bool) -> usize {
    if counts { 1 } else { RESPONSE_SHOTS }
}

/// A folder while it is written.
struct Folder<'a> {
    capture: &'a Capture,
    options: &'a CampaignOptions,
    pairs: Vec<Pair>,
    layout: Layout,
}

impl Folder<'_> {
    fn spots(&self, pair: &Pair) -> [Spot; 2] {
        [self.capture.lit.spots[pair.lit], self.capture.seen.spots[pair.seen]]
    }

    /// Whether all histograms hold whole counts.
    fn are_counts(&self) -> Result<bool, String> {
        let (mut whole, mut most) = (true, 0.0_f64);
        for pair in &self.pairs {
            for value in self.capture.histogram(pair) {
                if !value.is_finite() {
                    return Err(
                        "was made of a capture that holds values which are no finite numbers; fix it first".to_owned()
                    );
                }
                whole &= value.fract() == 0.0 && (0.0..=f64::from(i32::MAX)).contains(&value);
                most = most.max(value.abs());
            }
        }
        if most == 0.0 { Err("was made of a capture without any light".to_owned()) } else { Ok(whole) }
    }

    fn write_histograms(&self, file: &mut BufWriter<File>, counts: bool) -> io::Result<()> {
        let shape = [self.pairs.len() as u64, self.capture.bins() as u64];
        let values = self.pairs.iter().flat_map(|pair| self.capture.histogram(pair));
        if counts {
            npy::write(file, &shape, &values.map(|value| value as i32).collect::<Vec<i32>>())
        } else {
            npy::write(file, &shape, &values.map(|value| value as f32).collect::<Vec<f32>>())
        }
    }

    /// Bins of the response before the arrival.
    fn response_bins(&self) -> usize {
        (RESPONSE_SIGMA * self.options.fwhm_ps / FWHM / self.capture.dt_ps).ceil() as usize + 1
    }

    /// A Gaussian, integrated over each bin. Shots of a sensor that does not count start a fraction of a bin earlier
    /// each.
    fn write_response(&self, file: &mut BufWriter<File>, counts: bool) -> io::Result<()> {
        let (dt_ps, sigma_ps, bins) = (self.capture.dt_ps, self.options.fwhm_ps / FWHM, self.response_bins());
        let shots = response_shots(counts);
        let inside = 16;
        let height = |centre_ps: f64| {
            let at = |n: usize| centre_ps + dt_ps * ((n as f64 + 0.5) / f64::from(inside) - 0.5);
            (0..inside as usize).map(|n| (-0.5 * (at(n) / sigma_ps).powi(2)).exp()).sum::<f64>() / f64::from(inside)
        };
        let shot = |shot: usize| {
            let early = shot as f64 / shots as f64;
            (0..=2 * bins).map(move |bin| RESPONSE_COUNTS * height((bin as f64 - bins as f64 - early) * dt_ps))
        };
        let shape = [shots as u64, 2 * bins as u64 + 1];
        let values = (0..shots).flat_map(shot);
        if counts {
            npy::write(file, &shape, &values.map(|value| value.round() as i32).collect::<Vec<i32>>())
        } else {
            npy::write(file, &shape, &values.map(|value| value as f32).collect::<Vec<f32>>())
        }
    }

    /// Time of the middle of the first bin, on the path from laser to sensor.
    fn t0_ps(&self, pair: &Pair) -> f64 {
        let [lit, seen] = self.spots(pair);
        let legs_m = if self.capture.with_legs {
            0.0
        } else {
            gap_m(self.layout.laser_m, lit.position_m) + gap_m(seen.position_m, self.layout.sensor_m)
        };
        pair.start_ps + 0.5 * self.capture.dt_ps + units::time_ps(legs_m, 1.0)
    }

    fn table(&self) -> String {
        let mut text = "file,segment,lit,seen,t0_ps\n".to_owned();
        for (segment, pair) in self.pairs.iter().enumerate() {
            let [lit, seen] = self.spots(pair).map(|spot| self.layout.number(&spot));
            // A file with a single record has no segments.
            let segment = if self.pairs.len() > 1 { segment.to_string() } else { String::new() };
            writeln!(text, "{HISTOGRAMS},{segment},{lit},{seen},{:?}", self.t0_ps(pair))
                .expect("a String takes all text");
        }
        text
    }

    fn response_table(&self, counts: bool) -> String {
        let shots = response_shots(counts);
        let first_ps = units::time_ps(RESPONSE_PATH_M, 1.0) - self.response_bins() as f64 * self.capture.dt_ps;
        let mut text = "file,segment,shot,t0_ps\n".to_owned();
        for shot in 0..shots {
            let segment = if shots > 1 { shot.to_string() } else { String::new() };
            let t0_ps = first_ps - shot as f64 / shots as f64 * self.capture.dt_ps;
            writeln!(text, "{RESPONSE},{segment},{shot},{t0_ps:?}").expect("a String takes all text");
        }
        text
    }

    fn campaign(&self, counts: bool) -> String {
        let Self { capture, options, layout, .. } = self;
        let mut text =
            format!("# Converted from a capture of format {}. The points on the wall are anchors.\n", capture.format);
        let mut line = |line: String| writeln!(text, "{line}").expect("a String takes all text");
        line(format!(
            "[campaign]\nname = {:?}\ngroup_index = 1.0   # lengths in the capture are times in vacuum",
            options.name
        ));
        if capture.laser_m.is_none() {
            line("\n# The capture does not say where laser and sensor are, nor do its times depend on it: any place in front of the wall will do.".to_owned());
        }
        line(format!("[stations.{LASER}]\nposition_m = {:?}", layout.laser_m));
        if !layout.is_together() {
            line(format!("[stations.{SENSOR}]\nposition_m = {:?}", layout.sensor_m));
        }
        line(format!("\n[sensors.{SENSOR}]"));
        if !layout.is_together() {
            line(format!("station = \"{SENSOR}\""));
        }
        if counts {
            let cycles = options.cycles.unwrap_or(CYCLES);
            let unknown =
                if options.cycles.is_none() { "   # not known: so many that no photon hides another" } else { "" };
            line(format!("kind = \"counts\"\ncycles = {cycles}{unknown}"));
            options.dead_time_ps.iter().for_each(|dead_time_ps| line(format!("dead_time_ps = {dead_time_ps:?}")));
        }
        options.gate_ps.iter().for_each(|gate_ps| line(format!("gate_ps = {gate_ps:?}")));
        let scale = format!("dt_ps = {:?}\ngain_v = 1.0\noffset_v = 0.0", capture.dt_ps);
        line(format!("\n[[captures]]\nrole = \"scene\"\ntable = \"{TABLE}\"\n{scale}"));
        let fwhm_ps = options.fwhm_ps;
        line(format!(
            "\n# The response is not of the capture: a Gaussian of {fwhm_ps} ps full width at half maximum, as given."
        ));
        line(format!(
            "[[captures]]\nrole = \"response\"\ntable = \"{RESPONSE_TABLE}\"\npath_m = {RESPONSE_PATH_M:?}\n{scale}"
        ));
        for (patch, spot) in &layout.patches {
            line(format!("\n[patches.{patch}]\nposition_m = {:?}", spot.position_m));
            options.sd_m.iter().for_each(|sd_m| line(format!("sd_m = {sd_m:?}")));
            spot.normal.iter().for_each(|normal| line(format!("normal = {normal:?}")));
        }
        text
    }
}
