//! The 1-0-1 barcode around the corner from scope files; `benches/reproduction/barcode.rs` runs the same over hundreds
//! of seeds for docs/reproduction.md.

use std::fmt::Write as _;
use std::path::Path;

use nalgebra::Vector2;
use periscope::campaign::Role;
use periscope::pipeline::run::Settings;
use periscope::simulate::{Format, Laboratory, Scene};
use periscope::tables::{Gap, Patch, Reject};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::lab::Lab;

pub const SCENE: &str = include_str!("../../pipelines/scenes/barcode.toml");
pub const PIPELINE: &str = include_str!("../../pipelines/barcode.toml");
pub const BLOCKED: &str = include_str!("../../pipelines/barcode-blocked.toml");
/// A fast edge, then the tail of a photodiode.
pub const FAST: &str = "{ kind = \"emg\", sigma_ps = 33.0, tau_ps = 112.0 }";
/// The paper's 250 ps as the full width of a Gaussian.
pub const SLOW: &str = "{ kind = \"gaussian\", fwhm_ps = 250.0 }";
/// Numbers of the strips and the middle between them, and of the exits of the strips.
pub const STRIPS: [i32; 2] = [21, 23];
const MIDDLE: i32 = 22;
const EXITS: [i32; 2] = [4, 3];
/// Standard deviation of how far off somebody turns a mirror to the most light: a quarter of its lobe of 0.15 rad.
pub const TURNED_RAD: f64 = 0.0375;
/// The weakest pulse over the noise of a sample of the mean.
const SNR: f64 = 100.0;
/// The screen stands so far left of the strips.
const SCREEN_M: f64 = 0.03;

type Place = Vector2<f64>;

/// A barcode in the room of the demo, which may be moved.
#[derive(Clone, Debug)]
pub struct Barcode {
    pub lit: Vec<Place>,
    pub exits: [Place; 2],
    pub strips: [Place; 2],
    /// Errors of the mirrors' normals, rad.
    pub turned_rad: [f64; 2],
    /// What sensors are late: where in the sampling a pulse lies.
    pub latencies_ps: [f64; 2],
    /// Strips that are blocked, and whether a third one stands in the middle.
    pub blocked: Vec<i32>,
    pub occupied: bool,
    pub anchor_sd_m: f64,
    pub response: &'static str,
    /// The weakest pulse over the noise of a sample of the mean.
    pub snr: f64,
}

impl Barcode {
    /// The demo's, with this number of scans between the same ends.
    pub fn new(scans: usize) -> Self {
        let lit = |k: usize| Place::new(0.28 + 0.11 * k as f64 / (scans - 1) as f64, 0.43);
        Self {
            lit: (0..scans).map(lit).collect(),
            exits: [Place::new(0.075, 0.43), Place::new(0.49, 0.43)],
            strips: [Place::new(0.396, 0.192), Place::new(0.434, 0.168)],
            turned_rad: [0.0; 2],
            latencies_ps: [1250.0, 1260.0],
            blocked: Vec::new(),
            occupied: false,
            anchor_sd_m: 0.0,
            response: SLOW,
            snr: SNR,
        }
    }

    /// The mirrors as somebody turned them, and pulses anywhere between samples.
    pub fn turned(mut self, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        // As good as any within some angle: who looks at the signal does not stop far from its maximum.
        let within_rad = 3.0_f64.sqrt() * TURNED_RAD;
        self.turned_rad = [0; 2].map(|_| rng.random_range(-within_rad..within_rad));
        self.latencies_ps = [1250.0 + rng.random_range(0.0..50.0), 1250.0 + rng.random_range(0.0..50.0)];
        self
    }

    /// Everything moved at random by centimetres; strips stay 3 to 5 cm apart, their pulses 100 to 260 ps, and light
    /// still passes screen and strips.
    pub fn moved(scans: usize, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        loop {
            let mut drawn = Self::new(scans);
            let mut within = |half_m: f64| rng.random_range(-half_m..half_m);
            let (from, to) = (within(0.02), within(0.02));
            for (k, lit) in drawn.lit.iter_mut().enumerate() {
                lit.x += from + (to - from) * k as f64 / (scans - 1) as f64;
            }
            drawn.exits.iter_mut().for_each(|exit| exit.x += within(0.02));
            let shift = Place::new(within(0.02), within(0.02));
            drawn.strips.iter_mut().for_each(|strip| *strip += shift + Place::new(within(0.006), within(0.006)));
            let apart_m = (drawn.strips[1] - drawn.strips[0]).norm();
            let gaps_ps: Vec<f64> = (0..scans).map(|k| drawn.time_ps(k, 1) - drawn.time_ps(k, 0)).collect();
            let are_told = gaps_ps.iter().all(|gap_ps| (100.0..260.0).contains(gap_ps));
            if (0.03..0.05).contains(&apart_m) && are_told && drawn.top_m().is_some() && !drawn.is_shadowed() {
                return drawn.turned(seed);
            }
        }
    }

    fn time_ps(&self, scan: usize, strip: usize) -> f64 {
        let (lit, at, exit) = (self.lit[scan], self.strips[strip], self.exits[strip]);
        let way_m = lit.norm() + (at - lit).norm() + (exit - at).norm() + (exit - Place::new(0.1, 0.0)).norm();
        periscope::units::time_ps(way_m, 1.000_277)
    }

    /// Upper end of the screen, halfway between what it must hide and what it must not; `None` if these are closer than
    /// 3 cm.
    fn top_m(&self) -> Option<f64> {
        let x = self.strips[0].x.min(self.strips[1].x) - SCREEN_M;
        // Where a line crosses the screen.
        let height_m =
            |a: Place, b: Place| ((a.x - x) * (b.x - x) < 0.0).then(|| a.y + (x - a.x) / (b.x - a.x) * (b.y - a.y));
        let stations = [Place::zeros(), Place::new(0.1, 0.0)];
        let hidden = stations.iter().flat_map(|eye| self.strips.map(|strip| height_m(*eye, strip)));
        let lowest = hidden.flatten().fold(f64::NEG_INFINITY, f64::max);
        let wall: Vec<Place> = self.lit.iter().chain(&self.exits).copied().collect();
        let seen = stations.iter().flat_map(|eye| wall.iter().map(|at| height_m(*eye, *at)));
        let ways = self.ways().map(|(strip, at)| height_m(self.strips[strip], at));
        let highest = seen.chain(ways).flatten().fold(f64::INFINITY, f64::min);
        (highest - lowest > 0.03).then_some(0.5 * (lowest + highest))
    }

    /// Strips, and the points of the wall that they exchange light with.
    fn ways(&self) -> impl Iterator<Item = (usize, Place)> {
        [0, 1].into_iter().flat_map(|s| self.lit.iter().copied().chain([self.exits[s]]).map(move |at| (s, at)))
    }

    /// Whether a strip stands in another's light.
    fn is_shadowed(&self) -> bool {
        self.ways().any(|(s, at)| {
            let (way, other) = (at - self.strips[s], self.strips[1 - s] - self.strips[s]);
            way.angle(&other) < 0.4
        })
    }

    /// Unit normal of a mirror that throws light from the lit points to an exit.
    fn normal(&self, at: Place, exit: Place, turned_rad: f64) -> Place {
        let bisector = |lit: &Place| ((lit - at).normalize() + (exit - at).normalize()).normalize();
        let ends = [self.lit[0], self.lit[self.lit.len() - 1]];
        nalgebra::Rotation2::new(turned_rad) * ends.iter().map(bisector).sum::<Place>().normalize()
    }

    /// Numbers of the lit points.
    pub fn lit_numbers(&self) -> Vec<i32> {
        [1, 2].into_iter().chain(5..).take(self.lit.len()).collect()
    }

    /// A campaign with as many shots of the scene as bring the weakest pulse to the signal-to-noise ratio.
    pub fn laboratory<'a>(&self, scene: &'a Scene, seed: u64) -> Laboratory<'a> {
        let mut laboratory = Laboratory::new(scene, seed).unwrap();
        let is_own =
            |path: &[i32]| path.len() == 3 && STRIPS.iter().zip(EXITS).any(|(s, exit)| path[1..] == [*s, exit]);
        let scenes = laboratory.shootings.iter().filter(|shooting| shooting.role == Role::Scene);
        let ratios = scenes.flat_map(|shooting| {
            let noise_v = shooting.setting.recorded_noise_v();
            let own = shooting.paths.iter().filter(|(path, _)| is_own(path));
            own.map(|(_, light)| laboratory.signal(shooting, light).height() / noise_v).collect::<Vec<_>>()
        });
        let shots = (self.snr / ratios.fold(f64::INFINITY, f64::min)).powi(2).ceil() as usize;
        let scenes = laboratory.shootings.iter_mut().filter(|shooting| shooting.role == Role::Scene);
        scenes.for_each(|shooting| shooting.shots = shots);
        laboratory
    }

    pub fn parsed(&self) -> Scene {
        Scene::parse(Path::new("barcode.toml"), &self.scene()).unwrap()
    }

    pub fn scene(&self) -> String {
        let (head, rest) = SCENE.split_once("[patches.1]").unwrap();
        let (_, hardware) = rest.split_once("[surfaces.screen]").unwrap();
        let mut text = head.to_owned();
        let mut patch = |number: i32, at: Place, normal: Place, size_m: f64, more: &str| {
            let (x, y, n) = (at.x, at.y, normal);
            writeln!(
                text,
                "[patches.{number}]\nposition_m = [{x:?}, {y:?}, 0.0]\nnormal = [{:?}, {:?}, 0.0]\nsize_m = {size_m:?}\n{more}",
                n.x, n.y
            )
            .unwrap();
        };
        let down = Place::new(0.0, -1.0);
        let numbers = self.lit_numbers();
        self.lit.iter().zip(&numbers).for_each(|(at, number)| patch(*number, *at, down, 0.003, ""));
        self.exits.iter().zip(EXITS).for_each(|(at, number)| patch(number, *at, down, 0.006, ""));
        let mirror = "role = \"hidden\"\nlobe = { share = 0.95, width_rad = 0.15 }\n";
        let there: Vec<usize> = (0..2).filter(|s| !self.blocked.contains(&STRIPS[*s])).collect();
        for &s in &there {
            let normal = self.normal(self.strips[s], self.exits[s], self.turned_rad[s]);
            patch(STRIPS[s], self.strips[s], normal, 0.014, mirror);
        }
        if self.occupied {
            let at = 0.5 * (self.strips[0] + self.strips[1]);
            // Small enough not to stand in the light of the others, and so turned that it shows over the second exit.
            patch(MIDDLE, at, self.normal(at, self.exits[1], 0.0), 0.01, mirror);
        }
        let strips: Vec<String> = there.iter().map(|&s| format!("{} = {}", STRIPS[s], EXITS[s])).collect();
        writeln!(
            text,
            "[views.10]\npatches = {numbers:?}\n[views.34]\npatches = [3, 4]\n\n[surfaces.screen]{hardware}"
        )
        .unwrap();
        let anchors: Vec<i32> = numbers.iter().copied().chain(EXITS).collect();
        let screen_x = self.strips[0].x.min(self.strips[1].x) - SCREEN_M;
        let height_m = self.top_m().expect("a screen fits in") + 0.05;
        text.replace("corner_m = [0.366,", &format!("corner_m = [{screen_x:?},"))
            .replace("[0.0, 0.246, 0.0]", &format!("[0.0, {height_m:?}, 0.0]"))
            .replace("lit = [1, 2]", &format!("lit = {numbers:?}"))
            .replace("anchors = [1, 2, 3, 4]", &format!("anchors = {anchors:?}"))
            .replace("anchor_sd_m = 0.0005", &format!("anchor_sd_m = {:?}", self.anchor_sd_m))
            .replace("strips = { 21 = 4, 23 = 3 }", &format!("strips = {{ {} }}", strips.join(", ")))
            .replace("latency_ps = 1250.0", &format!("latency_ps = {:?}", self.latencies_ps[0]))
            .replace("latency_ps = 1260.0", &format!("latency_ps = {:?}", self.latencies_ps[1]))
            .replace(SLOW, self.response)
    }

    /// Distance of each strip of a solution from its true place.
    pub fn errors_m(&self, patches: &[Patch], alternative: i32) -> Vec<f64> {
        let of = |(s, number): (usize, &i32)| {
            let row = patches.iter().find(|row| row.patch == *number && row.alternative == alternative)?;
            Some((Place::new(row.x_m, row.y_m) - self.strips[s]).norm())
        };
        STRIPS.iter().enumerate().filter_map(of).collect()
    }

    /// Largest error of a coordinate of both strips, as the paper prints it; `None` where one is missing.
    pub fn largest_m(&self, patches: &[Patch]) -> Option<f64> {
        let of = |s: usize| {
            let row = patches.iter().find(|row| row.patch == STRIPS[s] && row.alternative == 0)?;
            Some((Place::new(row.x_m, row.y_m) - self.strips[s]).amax())
        };
        Some(of(0)?.max(of(1)?))
    }
}

/// What a run found.
pub struct Seen {
    pub patches: Vec<Patch>,
    pub gaps: Vec<Gap>,
    pub rejects: Vec<Reject>,
}

pub fn run(barcode: &Barcode, seed: u64, pipeline: &str) -> Seen {
    let scene = barcode.parsed();
    let lab = Lab::recorded(&barcode.laboratory(&scene, seed), seed, Format::Trc);
    lab.run("out", pipeline, &Settings::default()).unwrap();
    Seen {
        patches: lab.rows("out", "patches"),
        gaps: lab.rows("out", "patches.gaps"),
        rejects: lab.rows("out", "rejects"),
    }
}

/// The paper's protocol: each strip from files in which the other is blocked.
pub fn paper(barcode: &Barcode, seed: u64) -> Vec<Patch> {
    let alone = |other: i32| run(&Barcode { blocked: vec![other], ..barcode.clone() }, seed, BLOCKED).patches;
    STRIPS.into_iter().rev().flat_map(alone).collect()
}

#[test]
fn two_strips_come_out_of_the_sum_of_their_pulses() {
    for (scans, response) in [(2, SLOW), (5, FAST)] {
        let barcode = Barcode { anchor_sd_m: 5e-4, response, ..Barcode::new(scans) };
        let seen = run(&barcode, 1, PIPELINE);
        let errors_m = barcode.errors_m(&seen.patches, 0);
        assert_eq!(errors_m.len(), 2, "{:?}", seen.rejects);
        for (row, error_m) in seen.patches.iter().filter(|row| &*row.kind == "hidden").zip(&errors_m) {
            let sd_m = row.sd_m.unwrap();
            assert!(*error_m < 4.0 * sd_m && sd_m < 0.004, "{scans} scans: off by {error_m}, sd {sd_m}");
        }
        // A response much wider than the gap between two pulses carries no information about the gap.
        let verdict = if response == FAST { "free" } else { "open" };
        assert_eq!(&*seen.gaps[0].verdict, verdict, "{:?}", seen.gaps);
    }
}

/// In a room drawn at random, mirrors turned by hand.
#[test]
fn the_sum_shows_more_than_one_strip_at_a_time_read_off_a_screen() {
    let barcode = Barcode::moved(2, 5);
    let ours_m = barcode.largest_m(&run(&barcode, 5, PIPELINE).patches).unwrap();
    let paper_m = barcode.largest_m(&paper(&barcode, 5)).unwrap();
    assert!(2.0 * ours_m < paper_m && paper_m < 0.1, "{ours_m} {paper_m}");
}

/// A third strip that the campaign does not declare: it is reported, and the other two are placed.
#[test]
fn something_in_the_gap_is_seen() {
    let barcode = Barcode { occupied: true, response: FAST, ..Barcode::new(2) };
    let seen = run(&barcode, 2, PIPELINE);
    assert_eq!(seen.gaps.len(), 1, "{:?}", seen.rejects);
    assert_eq!(&*seen.gaps[0].verdict, "occupied", "{:?}", seen.gaps);
    assert!(barcode.largest_m(&seen.patches).is_some_and(|error_m| error_m < 0.005), "{:?}", seen.patches);
}

/// The paper's "sum of two third bounces": profiles with one strip blocked at a time add up to the profile with both.
#[test]
fn profiles_superpose() {
    let profiles = |blocked: Vec<i32>, seed: u64| -> Vec<periscope::tables::Profile> {
        let lab = Lab::of(&Barcode { blocked, ..Barcode::new(2) }.scene(), seed, Format::Trc);
        let settings = Settings::default();
        lab.run("out", PIPELINE, &settings).unwrap();
        let mut rows: Vec<periscope::tables::Profile> = lab.rows("out", "profiles");
        rows.retain(|row| row.seen == 34);
        rows
    };
    let (both, first, second) = (profiles(vec![], 1), profiles(vec![23], 2), profiles(vec![21], 3));
    assert_eq!([both.len(), first.len(), second.len()], [2; 3]);
    for ((both, first), second) in both.iter().zip(&first).zip(&second) {
        let at = |row: &periscope::tables::Profile, time_ps: f64| {
            let n = ((time_ps - row.t0_ps) / row.dt_ps).round();
            (n >= 0.0 && n < row.samples() as f64)
                .then(|| (f64::from(row.mean_v()[n as usize]), f64::from(row.se_v()[n as usize])))
        };
        let (mut squares, mut count) = (0.0, 0);
        for n in 0..both.samples() {
            let time_ps = both.t0_ps + n as f64 * both.dt_ps;
            let parts: Option<Vec<(f64, f64)>> = [both, first, second].iter().map(|row| at(row, time_ps)).collect();
            let Some(parts) = parts else { continue };
            let variance: f64 = parts.iter().map(|(_, se)| se * se).sum();
            squares += (parts[0].0 - parts[1].0 - parts[2].0).powi(2) / variance;
            count += 1;
        }
        // Correlated over about two samples.
        let (mean, bound) = (squares / f64::from(count), 5.0 * (4.0 / f64::from(count)).sqrt());
        assert!(count > 150 && (mean - 1.0).abs() < bound, "{mean} of {count}");
    }
}

/// What campaign.toml should tell and does not is named.
#[test]
fn what_is_missing_is_named() {
    let rejected = |from: &str, to: &str| {
        let scene = Barcode::new(2).scene().replace(from, to);
        assert_ne!(scene, Barcode::new(2).scene());
        let lab = Lab::of(&scene, 1, Format::Trc);
        lab.run("out", PIPELINE, &Settings::default()).unwrap();
        let rejects: Vec<Reject> = lab.rows("out", "rejects");
        assert!(lab.rows::<Patch>("out", "patches").iter().all(|row| &*row.kind != "hidden"));
        rejects.iter().map(|reject| reject.reason.to_string()).collect::<Vec<_>>().join("\n")
    };
    let why = rejected("anchors = [1, 2, 4, 3]", "anchors = [1, 2, 4]");
    assert!(why.contains("diffuser point 3 has no position") && why.contains("position_m"), "{why}");
    let why = rejected("lit = [1, 2]", "lit = [1]");
    assert!(why.contains("1 scans") && why.contains("light more diffuser points"), "{why}");
    let why = rejected("apart_max_m = 0.06", "apart_max_m = 0.002");
    assert!(why.contains("apart_max_m"), "{why}");
}
