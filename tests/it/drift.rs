//! Delays that drift through a day of captures without fiducials; `benches/accuracy.rs` runs it over more seeds for
//! docs/error-bars.md.

use nalgebra::Matrix3;
use periscope::pipeline::run::Settings;
use periscope::simulate::Format;
use periscope::tables::{Fit, Patch};

use crate::lab::{ALL_VISIBLE, Lab};
use crate::missed::{aligning, position};

/// The demo's scene.
const SCENE: &str = include_str!("../../pipelines/scenes/all-visible.toml");
/// 95 % point of chi-square with three degrees of freedom.
const WITHIN_95: f64 = 7.815;
const DAY_H: f64 = 24.0;

/// How far delays drift within a day, as a random walk (standard deviation) and as a line.
#[derive(Clone, Copy, Debug)]
pub struct Drift {
    pub walk_ps: f64,
    pub line_ps: f64,
}

/// What a campaign says of its patches, and of its drift.
pub struct Outcome {
    /// Sums over the patches of squared errors, and of stated variances.
    pub squares_m2: f64,
    pub stated_m2: f64,
    pub patches: usize,
    /// Patches within their ellipsoids of 95 %.
    pub inside: usize,
    pub fit: Fit,
}

impl Outcome {
    /// Rms error over rms standard deviation.
    pub fn ratio(&self) -> f64 {
        (self.squares_m2 / self.stated_m2).sqrt()
    }
}

/// A scene whose captures take a day, so many of them, while delays drift.
pub fn scene(text: &str, captures: usize, drift: Drift) -> String {
    let (line_ps, walk_ps) = (drift.line_ps / DAY_H, drift.walk_ps / DAY_H.sqrt());
    let flaws = format!("[instrument.flaws]\ndelay_ps_per_h = {line_ps:?}\ndelay_walk_ps = {walk_ps:?}");
    let overhead_s = 3600.0 * DAY_H / captures as f64;
    text.replace("\n[captures]", &format!("\n{flaws}\n[captures]\noverhead_s = {overhead_s:?}"))
}

/// A campaign whose files say when they were taken, or do not; `None` if it is refused.
pub fn outcome(scene: &str, pipeline: &str, seed: u64, has_times: bool) -> Option<Outcome> {
    Some(measured(&lab(scene, pipeline, seed, has_times)?))
}

fn lab(scene: &str, pipeline: &str, seed: u64, has_times: bool) -> Option<Lab> {
    // The simulator writes no date into this format.
    let lab = Lab::of(scene, seed, if has_times { Format::Trc } else { Format::Bin });
    lab.run("out", pipeline, &Settings::default()).ok()?;
    Some(lab)
}

fn measured(lab: &Lab) -> Outcome {
    let patches: Vec<Patch> = lab.rows("out", "patches");
    let truth: Vec<Patch> = lab.truth();
    // Visible patches have their numbers, and fix the turn; hidden ones are numbered as they are found.
    let best = || patches.iter().filter(|patch| patch.alternative == 0);
    let own = |patch: &Patch| truth.iter().find(|row| row.patch == patch.patch && &*patch.kind == "visible");
    let visible: Vec<(&Patch, &Patch)> = best().filter_map(|patch| Some((patch, own(patch)?))).collect();
    let points: Vec<_> = visible.iter().map(|(patch, _)| position(patch)).collect();
    let targets: Vec<_> = visible.iter().map(|(_, truth)| position(truth)).collect();
    let turn = aligning(&points, &targets);
    let error = |patch: &Patch, truth: &Patch| position(patch) - turn.transpose() * position(truth);
    let nearest = |patch: &Patch| {
        let hidden = truth.iter().filter(|row| &*row.kind == "hidden");
        hidden.min_by(|a, b| error(patch, a).norm().total_cmp(&error(patch, b).norm()))
    };
    let found = best().filter(|patch| &*patch.kind == "hidden").filter_map(|patch| Some((patch, nearest(patch)?)));
    let pairs: Vec<(&Patch, &Patch)> = visible.iter().copied().chain(found).collect();
    let (mut squares_m2, mut stated_m2, mut inside) = (0.0, 0.0, 0);
    for (patch, truth) in &pairs {
        let Some(covariance) = covariance_m2(patch) else { continue };
        let error = error(patch, truth);
        squares_m2 += error.norm_squared();
        stated_m2 += covariance.trace();
        let within = covariance.try_inverse().map(|inverse| (error.transpose() * inverse * error)[0]);
        inside += usize::from(within.is_some_and(|within| within < WITHIN_95));
    }
    let fit = lab.rows::<Fit>("out", "patches.fits").into_iter().next().unwrap();
    Outcome { squares_m2, stated_m2, patches: pairs.len(), inside, fit }
}

pub fn covariance_m2(patch: &Patch) -> Option<Matrix3<f64>> {
    let [xx, xy, xz] = [patch.cov_xx_m2?, patch.cov_xy_m2?, patch.cov_xz_m2?];
    let [yy, yz, zz] = [patch.cov_yy_m2?, patch.cov_yz_m2?, patch.cov_zz_m2?];
    Some(Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz))
}

/// The middle of some numbers.
pub fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    if values.len() % 2 == 1 { values[middle] } else { 0.5 * (values[middle - 1] + values[middle]) }
}

/// A walk of 20 ps a day: patches have the errors that are stated, and these are smaller than where files have no
/// times.
#[test]
fn a_drift_without_fiducials_is_followed() {
    let scene = scene(SCENE, 144, Drift { walk_ps: 20.0, line_ps: 0.0 });
    let labs: Vec<Lab> = (0..8).filter_map(|seed| lab(&scene, ALL_VISIBLE, seed, true)).collect();
    let outcomes: Vec<Outcome> = labs.iter().map(measured).collect();
    let timeless: Vec<Outcome> = (0..8).filter_map(|seed| outcome(&scene, ALL_VISIBLE, seed, false)).collect();
    assert!(labs.len() == 8);
    assert!(timeless.iter().all(|one| one.fit.drift_ps.is_none()));
    assert!(outcomes.iter().all(|one| one.fit.drift_ps.is_some()));
    let ratio = median(outcomes.iter().map(Outcome::ratio).collect());
    let rms_m = |outcomes: &[Outcome]| {
        (outcomes.iter().map(|one| one.squares_m2).sum::<f64>() / (12.0 * outcomes.len() as f64)).sqrt()
    };
    let (with_m, without_m) = (rms_m(&outcomes), rms_m(&timeless));
    eprintln!(
        "rms {:.3} mm, {ratio:.2} of stated; without times {:.3} mm, {} of 8 solved",
        1e3 * with_m,
        1e3 * without_m,
        timeless.len()
    );
    assert!((1.0 / 1.3..1.3).contains(&ratio), "{ratio}");
    let inside: usize = outcomes.iter().map(|one| one.inside).sum();
    let patches: usize = outcomes.iter().map(|one| one.patches).sum();
    assert!(patches == 96 && inside > 86, "{inside} of {patches}");
    assert!(with_m < 0.7 * without_m, "{with_m} {without_m}");
}

/// Where nothing drifts, times change nothing.
#[test]
fn without_a_drift_nothing_is_said_of_one() {
    for seed in 0..4 {
        let steady = outcome(&scene(SCENE, 144, Drift { walk_ps: 0.0, line_ps: 0.0 }), ALL_VISIBLE, seed, true);
        assert!(steady.expect("nothing contradicts").fit.drift_ps.is_none(), "seed {seed}");
    }
}
