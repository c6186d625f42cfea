//! Where true positions lie in what `run` states of them: rooms and instruments at random, from scope files to
//! coordinates, with a response that was captured another day. If standard deviations are right, ranks are uniform.
//! `benches/accuracy.rs` runs it over many rooms, for docs/error-bars.md.

use std::collections::BTreeSet;
use std::f64::consts::{SQRT_2, TAU};
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use nalgebra::{DMatrix, DVector, SymmetricEigen, Vector3};
use periscope::bound::{Bound, Use};
use periscope::pipeline::run::Settings;
use periscope::simulate::{Format, Laboratory, Scene};
use periscope::tables::{Ambiguity, Decision, Patch, PatchCovariance};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::claims::flicker;
use crate::drift::covariance_m2;
use crate::lab::{Lab, chain};
use crate::missed::{self, aligning, position};
use crate::shape::erfc;

const PIPELINE: &str = include_str!("../../pipelines/scene.toml");
/// Around the corner: its instrument, and the door that hides what is behind it.
const SCENE: &str = include_str!("../../pipelines/scenes/around-the-corner.toml");
const VISIBLE: usize = 8;
/// So many patches without a doubt fix the turn onto the truth.
const LEAST: usize = 4;
/// At most so many hidden patches.
const HIDDEN_MAX: usize = 2;
/// Visible patches lie so far about those of the scene, in each direction.
const ABOUT_M: f64 = 0.08;
/// A hidden patch is found within this distance.
const NEAR_M: f64 = 0.06;
const SHOTS: usize = 100;
const SAMPLES: usize = 480;
/// Standard deviation of a sample of one shot, and range of the converter.
const NOISE_V: f64 = 0.000_7;
const FULL_SCALE_V: f64 = 8.0;
/// Codes of a file have so many bits, whatever the converter has.
const STORED: f64 = 65_536.0;
const RESPONSE_PS: [f64; 2] = [33.0, 112.0];

/// What is the matter with an instrument.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flaw {
    Nothing,
    /// Since it was calibrated, it has become wider or narrower by up to 5 %.
    Width,
    /// An echo of up to -40 dB, or a tail of up to 1 % and a nanosecond, that calibration did not see.
    Echo,
    /// Hum, and a slope of up to two standard deviations of a shot's noise.
    Slope,
    /// Slow noise of four standard deviations of white noise, at 1 to 100 MHz.
    Wander,
    /// 1/f noise with a corner of up to 1 GHz.
    Flicker,
    /// A converter whose steps are 0.5 to 3 standard deviations of the noise.
    Steps,
    /// 1 to 6 % bad shots, and a trigger with a jitter of up to 80 ps.
    Shots,
    /// A delay that walks 20 ps within the day of the captures.
    Drift,
    /// A little of everything.
    All,
}

impl Flaw {
    pub const ALL: [Self; 10] = [
        Self::Nothing,
        Self::Width,
        Self::Echo,
        Self::Slope,
        Self::Wander,
        Self::Flicker,
        Self::Steps,
        Self::Shots,
        Self::Drift,
        Self::All,
    ];

    /// For the table.
    pub fn name(self) -> &'static str {
        match self {
            Self::Nothing => "none",
            Self::Width => "response up to 5 % wider or narrower than calibrated",
            Self::Echo => "echo to -40 dB or tail to 1 % since calibration",
            Self::Slope => "slope to 2, hum",
            Self::Wander => "wander of 4, 1 to 100 MHz",
            Self::Flicker => "1/f, corner to 1 GHz",
            Self::Steps => "0.3 to 2 codes of noise",
            Self::Shots => "1 to 6 % bad shots, jitter to 80 ps",
            Self::Drift => "delay that walks 20 ps a day",
            Self::All => "all of these, half as large",
        }
    }
}

/// An instrument, drawn at random.
struct Instrument {
    /// Width over that at calibration.
    width: f64,
    /// Further keys of the simulator's flaws.
    flaws: String,
    slope: f64,
    /// Noise in lines: standard deviation over that of white noise, and frequency, GHz.
    lines: Vec<(f64, f64)>,
    noise_v: f64,
    bits: u32,
    bad_shots: f64,
    jitter_ps: f64,
    /// Time between captures.
    overhead_s: f64,
}

impl Instrument {
    fn draw(flaw: Flaw, rng: &mut ChaCha8Rng) -> Self {
        let size = if flaw == Flaw::All { 0.5 } else { 1.0 };
        let has = |of: Flaw| flaw == Flaw::All || flaw == of;
        // Drawn in any case, so that the rooms of a seed are the same.
        let mut drawn = |low: f64, high: f64| -> f64 { rng.random_range(low..high) };
        let (width, echo, later_ps) = (drawn(-0.05, 0.05), drawn(-0.01, 0.01), drawn(400.0, 1000.0));
        let (slope, wander_log_ghz, corner_log_ghz) = (drawn(-2.0, 2.0), drawn(-3.0, -1.0), drawn(-1.0, 0.0));
        let (codes, bad_shots, jitter_ps) = (drawn(0.3, 2.0), drawn(0.01, 0.06), drawn(5.0, 80.0));
        let mut flaws = String::new();
        if has(Flaw::Echo) {
            let ratio = size * echo.abs();
            let (key, time) = if echo > 0.0 { ("echo", "delay_ps") } else { ("tail", "tau_ps") };
            writeln!(flaws, "{key} = {{ ratio = {ratio:?}, {time} = {later_ps:?} }}").unwrap();
        }
        if has(Flaw::Drift) {
            writeln!(flaws, "delay_walk_ps = {:?}", size * 20.0 / 24_f64.sqrt()).unwrap();
        }
        let mut lines = Vec::new();
        if has(Flaw::Slope) {
            lines.push((100.0, 60e-9));
        }
        if has(Flaw::Wander) {
            lines.push((size * 4.0, 10_f64.powf(wander_log_ghz)));
        }
        if has(Flaw::Flicker) {
            lines.extend(flicker(size * 10_f64.powf(corner_log_ghz)));
        }
        Self {
            width: if has(Flaw::Width) { 1.0 + size * width } else { 1.0 },
            flaws,
            slope: if has(Flaw::Slope) { size * slope } else { 0.0 },
            lines,
            noise_v: if has(Flaw::Steps) { codes * FULL_SCALE_V / 4096.0 } else { NOISE_V },
            bits: if has(Flaw::Steps) { 12 } else { 14 },
            bad_shots: if has(Flaw::Shots) { size * bad_shots } else { 0.0 },
            jitter_ps: if has(Flaw::Shots) { jitter_ps } else { 20.0 },
            overhead_s: if has(Flaw::Drift) { 1200.0 } else { 1.0 },
        }
    }

    /// The scene with it; as it was at calibration, scene captures are short, since nobody reads them.
    fn scene(&self, patches: &str, is_calibrated: bool) -> String {
        let (width, shots, flaws) = if is_calibrated { (1.0, 2, "") } else { (self.width, SHOTS, &*self.flaws) };
        let [sigma_ps, tau_ps] = RESPONSE_PS.map(|of| of * width);
        let from = SCENE.find("[patches.1]").expect("the first patch");
        let door = SCENE.find("[surfaces.door]").expect("what hides some");
        let to = SCENE.find("[instrument]").expect("its instrument");
        format!(
            "{}{patches}{}[instrument]\nresponse = {{ kind = 'emg', sigma_ps = {sigma_ps:?}, tau_ps = {tau_ps:?} }}\n\
             responsivity_a_w = 0.45\nload_ohm = 50.0\ndt_ps = 50.0\nsamples = {SAMPLES}\nt0_ps = -1000.0\n\
             full_scale_v = {FULL_SCALE_V:?}\nnoise_v = {:?}\nbits = {}\njitter_ps = {:?}\nrate_hz = 1000.0\n\
             reference = {{ fwhm_ps = 200.0, height_v = 0.1 }}\n[instrument.flaws]\n{flaws}[captures]\nshots = {shots}\n\
             bounces = 4\nresponse_shots = 2000\nfirst_bounce_od = 5.2\npath_m = 1.0\npath_sd_m = 0.0001\n\
             bad_shots = {:?}\noverhead_s = {:?}\n",
            &SCENE[..from],
            &SCENE[door..to],
            self.noise_v,
            self.bits,
            self.jitter_ps,
            self.bad_shots,
            self.overhead_s
        )
    }

    /// Adds to the shots of a file what the simulator does not know: noise that is not white, and a slope. What the
    /// converter clipped stays at its rails.
    fn spoil(&self, file: &Path, rng: &mut ChaCha8Rng) {
        let mut bytes = fs::read(file).unwrap();
        // A sequence ends with its shots.
        let first = bytes.len() - 2 * SHOTS * SAMPLES;
        let unit = self.noise_v * STORED / FULL_SCALE_V;
        let step = STORED / f64::from(1 << self.bits);
        let rails = [-0.5 * STORED, 0.5 * STORED - step];
        let turns = |ghz: f64| (0..SAMPLES).map(move |n| (TAU * ghz * 0.05 * n as f64).sin_cos());
        let waves: Vec<Vec<(f64, f64)>> = self.lines.iter().map(|(_, ghz)| turns(*ghz).collect()).collect();
        for shot in bytes[first..].chunks_exact_mut(2 * SAMPLES) {
            let mut added: Vec<f64> = (0..SAMPLES).map(|n| self.slope * n as f64 / SAMPLES as f64).collect();
            for ((sd, _), wave) in self.lines.iter().zip(&waves) {
                let [sine, cosine] = [(); 2].map(|()| sd * normal(rng));
                added.iter_mut().zip(wave).for_each(|(sum, (sin, cos))| *sum += sine * sin + cosine * cos);
            }
            for (code, added) in shot.chunks_exact_mut(2).zip(added) {
                let value = f64::from(i16::from_le_bytes([code[0], code[1]]));
                if (rails[0] + step..rails[1]).contains(&value) {
                    let moved = ((value + unit * added) / step).round() * step;
                    code.copy_from_slice(&(moved.clamp(rails[0], rails[1]) as i16).to_le_bytes());
                }
            }
        }
        fs::write(file, bytes).unwrap();
    }
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// Visible patches about those of the scene, 2 to 20 mm wide, that face the middle of the room more or less; and hidden
/// ones behind the door.
fn patches(rng: &mut ChaCha8Rng) -> String {
    let scene = Scene::parse(Path::new("scene.toml"), SCENE).unwrap();
    let mut text = String::new();
    let mut write = |n: usize, at: Vector3<f64>, facing: Vector3<f64>, size_m: f64, role: &str| {
        let normal = (facing - at).normalize();
        writeln!(
            text,
            "[patches.{n}]\nposition_m = [{:.6}, {:.6}, {:.6}]\nnormal = [{:.7}, {:.7}, {:.7}]\nsize_m = {size_m:?}\n\
             role = '{role}'",
            at.x, at.y, at.z, normal.x, normal.y, normal.z
        )
        .unwrap();
    };
    let about = |rng: &mut ChaCha8Rng, half: f64| Vector3::from_fn(|_, _| rng.random_range(-half..half));
    for (n, patch) in (1..).zip(scene.patches.values().take(VISIBLE)) {
        let at = Vector3::from(patch.position_m) + about(rng, ABOUT_M);
        let facing = Vector3::new(-0.1, 0.5, 0.0) + about(rng, 0.2);
        write(n, at, facing, 10_f64.powf(rng.random_range(-2.7..-1.7)), "visible");
    }
    let mut hidden: Vec<Vector3<f64>> = Vec::new();
    let count = rng.random_range(0..=HIDDEN_MAX);
    while hidden.len() < count {
        let at = Vector3::from_fn(|axis, _| rng.random_range([0.6, 0.55, -0.3][axis]..[0.9, 0.85, 0.3][axis]));
        if hidden.iter().all(|other| (other - at).norm() > 2.0 * NEAR_M) {
            hidden.push(at);
        }
    }
    for (n, at) in (VISIBLE + 1..).zip(hidden) {
        write(n, at, Vector3::new(-0.2, 0.95, -0.02), 0.04, "hidden");
    }
    text
}

/// What became of one room.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// Why there is no solution.
    pub refused: Option<String>,
    /// Errors of visible patches along the directions in which they are independent, over their standard deviations;
    /// and those of hidden ones.
    pub visible: Vec<f64>,
    pub hidden: Vec<f64>,
    /// Squared errors of visible patches, and their Cramer-Rao bound, for white noise and a known response, where the
    /// expected signal has one.
    pub squares_m2: f64,
    pub bounds_m2: f64,
    /// Patches named as doubtful, or with another place.
    pub doubtful: usize,
    /// True hidden patches, those that were found, and those that are none.
    pub hidden_true: usize,
    pub hits: usize,
    pub phantoms: usize,
    /// Whether the program reports what it cannot explain: `fit`, `waveforms` or the response, in `decisions`.
    pub is_reported: bool,
}

impl Outcome {
    /// Squared error in units of the covariance, per degree of freedom.
    pub fn normalised(&self) -> Option<f64> {
        let squares = self.visible.iter().map(|z| z * z).sum::<f64>();
        (!self.visible.is_empty()).then(|| squares / self.visible.len() as f64)
    }
}

/// Simulates a room with an instrument of this kind and solves it.
pub fn outcome(flaw: Flaw, seed: u64) -> Outcome {
    let (lab, scene) = campaign(flaw, seed);
    if let Err(error) = lab.run("out", PIPELINE, &Settings::default()) {
        return Outcome { refused: Some(chain(error)), ..Outcome::default() };
    }
    let laboratory = Laboratory::new(&scene, 0).unwrap();
    let bound = Bound::of(&laboratory, Use { bounces: 3, ..Use::default() });
    compare(&lab, |patch| bound.coordinates.sd_m(patch))
}

/// The campaign: scene captures of today, response captures of another day.
fn campaign(flaw: Flaw, seed: u64) -> (Lab, Scene) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let patches = patches(&mut rng);
    let instrument = Instrument::draw(flaw, &mut rng);
    let scene = |is_calibrated| {
        Scene::parse(Path::new("scene.toml"), &instrument.scene(&patches, is_calibrated)).expect("a scene of ours")
    };
    let record = |scene: &Scene, seed| Lab::recorded(&Laboratory::new(scene, 0).unwrap(), seed, Format::Trc);
    let today = scene(false);
    let (lab, calibrated) = (record(&today, seed), record(&scene(true), seed + 1_000_000));
    let folder = |lab: &Lab, name: &str| -> Vec<PathBuf> {
        let folder = lab.campaign().join(name);
        let mut files: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
        files.sort();
        files.into_iter().filter(|file| file.is_file()).collect()
    };
    for file in folder(&calibrated, "raw/response") {
        fs::copy(&file, lab.campaign().join("raw/response").join(file.file_name().unwrap())).unwrap();
    }
    if instrument.slope != 0.0 || !instrument.lines.is_empty() {
        let signals = [folder(&lab, "raw/scene"), folder(&lab, "raw/scene/od5.2")].concat();
        signals
            .iter()
            .filter(|file| file.to_string_lossy().ends_with("_C1.trc"))
            .for_each(|file| instrument.spoil(file, &mut rng));
    }
    (lab, today)
}

fn compare(lab: &Lab, bound_m: impl Fn(i32) -> Option<f64>) -> Outcome {
    let truth: Vec<Patch> = lab.truth();
    let rows: Vec<Patch> = lab.rows("out", "all_patches");
    let ambiguities: Vec<Ambiguity> = lab.rows("out", "patches.ambiguities");
    let named = ambiguities.iter().filter(|row| &*row.kind == "doubtful").flat_map(|row| row.patches.clone());
    let others = rows.iter().filter(|row| row.alternative > 0).map(|row| row.patch);
    let doubtful: BTreeSet<i32> = named.chain(others).collect();
    let is_visible = |patch: &Patch| patch.patch <= VISIBLE as i32;
    let best: Vec<&Patch> = rows.iter().filter(|row| row.alternative == 0).collect();
    let sure = |patch: &&Patch| is_visible(patch) && !doubtful.contains(&patch.patch) && covariance_m2(patch).is_some();
    let visible: Vec<&Patch> = best.iter().copied().filter(sure).collect();
    let place = |number: i32| position(truth.iter().find(|row| row.patch == number).expect("visible patches are true"));
    let points: Vec<Vector3<f64>> = visible.iter().map(|patch| position(patch)).collect();
    let targets: Vec<Vector3<f64>> = visible.iter().map(|patch| place(patch.patch)).collect();
    let turn = aligning(&points, &targets);
    let errors: Vec<Vector3<f64>> =
        points.iter().zip(&targets).map(|(point, target)| point - turn.transpose() * target).collect();
    let covariances: Vec<PatchCovariance> = lab
        .rows("out", "patches.patch_covariances")
        .into_iter()
        .filter(|row: &PatchCovariance| row.alternative == 0)
        .collect();
    let with_bounds: Vec<(&Vector3<f64>, f64)> =
        errors.iter().zip(&visible).filter_map(|(error, patch)| Some((error, bound_m(patch.patch)?))).collect();
    let mut open: Vec<Vector3<f64>> =
        truth.iter().filter(|patch| !is_visible(patch)).map(|patch| turn.transpose() * position(patch)).collect();
    let mut outcome = Outcome {
        visible: whitened(&missed::covariance_m2(&visible, &covariances), &points, &errors),
        squares_m2: with_bounds.iter().map(|(error, _)| error.norm_squared()).sum(),
        bounds_m2: with_bounds.iter().map(|(_, bound_m)| bound_m * bound_m).sum(),
        doubtful: doubtful.len(),
        hidden_true: open.len(),
        is_reported: is_reported(&lab.rows("out", "decisions")),
        ..Outcome::default()
    };
    for patch in best.iter().filter(|patch| !is_visible(patch)) {
        let at = position(patch);
        let Some(n) = open.iter().position(|place| (place - at).norm() < NEAR_M) else {
            outcome.phantoms += 1;
            continue;
        };
        outcome.hits += 1;
        let error = at - open.remove(n);
        if let Some(covariance) = covariance_m2(patch).filter(|_| !doubtful.contains(&patch.patch)) {
            let whitened = covariance.cholesky().expect("a covariance").l().solve_lower_triangular(&error);
            outcome.hidden.extend(whitened.expect("a covariance").iter());
        }
    }
    outcome
}

fn is_reported(decisions: &[Decision]) -> bool {
    decisions.iter().any(|row| match &*row.what {
        "fit" | "waveforms" => row.chosen.starts_with("not explained"),
        response if response.starts_with("response of") => !row.chosen.starts_with("as wide as calibrated"),
        echoes if echoes.starts_with("echoes of") => true,
        _ => false,
    })
}

/// Errors along the directions in which they are independent, over their standard deviations; turns about the laser
/// apart.
fn whitened(covariance: &DMatrix<f64>, points: &[Vector3<f64>], errors: &[Vector3<f64>]) -> Vec<f64> {
    if points.len() < LEAST {
        return Vec::new();
    }
    let size = 3 * points.len();
    let turns = DMatrix::from_fn(size, 3, |row, axis| {
        let mut about = Vector3::zeros();
        about[axis] = 1.0;
        about.cross(&points[row / 3])[row % 3]
    });
    let inverse = (turns.transpose() * &turns).try_inverse().expect("not all on one line");
    let project = DMatrix::identity(size, size) - &turns * inverse * turns.transpose();
    let eigen = SymmetricEigen::new(&project * covariance * &project);
    let error = DVector::from_iterator(size, errors.iter().flat_map(|error| [error.x, error.y, error.z]));
    let outwards = DVector::from_fn(size, |row, _| points[row / 3].normalize()[row % 3]);
    let mut order: Vec<usize> = (0..size).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    let of_direction = |n: &usize| {
        let direction = eigen.eigenvectors.column(*n);
        // Away from the laser is positive, so that a common delay shows.
        let sign = direction.dot(&outwards).signum();
        sign * direction.dot(&error) / eigen.eigenvalues[*n].sqrt()
    };
    order[3..].iter().map(of_direction).collect()
}

/// Share of a standard normal distribution below a number: the rank of the truth in what is stated of it.
pub fn rank(z: f64) -> f64 {
    0.5 * erfc(-z / SQRT_2)
}

/// Rooms whose squared errors were 31 and 336 times their covariance while the response of another day counted as it
/// was, and onsets that a drift had moved counted as wrong; and one with slow noise.
#[test]
fn true_positions_lie_where_they_are_stated() {
    for (flaw, seed) in [(Flaw::Width, 1001), (Flaw::Drift, 1000), (Flaw::Wander, 1002), (Flaw::Echo, 1005)] {
        let room = outcome(flaw, seed);
        let normalised = room.normalised();
        eprintln!("{}: {normalised:.2?}, {room:.2?}", flaw.name());
        assert!(room.refused.is_none() && room.phantoms == 0 && room.visible.len() >= 12, "{flaw:?}: {room:?}");
        assert!(normalised.is_some_and(|squares| squares < 4.0), "{flaw:?}: {normalised:?}");
        let outside = room.visible.iter().filter(|z| !(0.005..0.995).contains(&rank(**z))).count();
        assert!(outside <= 2, "{flaw:?}: {outside} of {}", room.visible.len());
    }
}
