//! Patches of centimetres whose sizes and normals nobody gives, on no common plane, from scope files to coordinates:
//! what the widths of pulses tell. `benches/accuracy.rs` runs it over many seeds.

use std::fs;
use std::path::Path;

use periscope::bound::{Bound, Use};
use periscope::pipeline::run::Settings;
use periscope::simulate::{Format, Laboratory, Scene};
use periscope::tables::{Fit, Patch, PatchCovariance, PatchFootprint};

use crate::lab::Lab;
use crate::missed;

const PIPELINE: &str = include_str!("../../pipelines/scene.toml");
const SCENE: &str = include_str!("../../pipelines/scenes/all-visible.toml");

/// What came of one campaign.
#[derive(Clone, Copy, Debug)]
pub struct Outcome {
    /// Mean squared error of a patch over that of the Cramer-Rao bound, for which all sizes are known.
    pub over_bound: f64,
    /// Squared error in units of the covariance, per degree of freedom.
    pub normalised: f64,
    /// Chi-square of the onsets per degree of freedom.
    pub chi2_dof: f64,
    /// Root mean square of the sizes' relative errors, and how many patches have one.
    pub size_error: f64,
    pub sizes: usize,
    /// Hidden patches; there are none.
    pub phantoms: usize,
}

/// Campaigns of the patches of `demo all-visible`, all of one size.
pub fn outcomes(size_m: f64, seeds: std::ops::Range<u64>) -> Vec<Outcome> {
    let scene = SCENE.replace("size_m = 0.001", &format!("size_m = {size_m}"));
    let scene = Scene::parse(Path::new("scene.toml"), &scene).unwrap();
    let bound_m = Bound::new(&scene, Use::default()).unwrap().coordinates.rms_m();
    let laboratory = Laboratory::new(&scene, 0).unwrap();
    let of_seed = |seed| {
        let lab = Lab::recorded(&laboratory.reseeded(seed), seed, Format::Trc);
        let path = lab.campaign().join("campaign.toml");
        let keeps = |line: &&str| !line.starts_with("size_m") && !line.starts_with("normal");
        let campaign: Vec<String> =
            fs::read_to_string(&path).unwrap().lines().filter(keeps).map(str::to_owned).collect();
        fs::write(&path, campaign.join("\n")).unwrap();
        lab.run("out", PIPELINE, &Settings::default()).unwrap();
        outcome(&lab, size_m, bound_m)
    };
    seeds.map(of_seed).collect()
}

fn outcome(lab: &Lab, size_m: f64, bound_m: f64) -> Outcome {
    let truth: Vec<Patch> = lab.truth();
    let best = lab.rows::<Patch>("out", "patches").into_iter().filter(|patch| patch.alternative == 0);
    let (patches, phantoms): (Vec<Patch>, Vec<Patch>) = best.partition(|patch| &*patch.kind == "visible");
    let covariances = lab.rows::<PatchCovariance>("out", "patches.patch_covariances").into_iter();
    let is_visible = |id: i32| patches.iter().any(|patch| patch.patch == id);
    let covariances: Vec<PatchCovariance> =
        covariances.filter(|row| row.alternative == 0 && is_visible(row.a) && is_visible(row.b)).collect();
    let missed = missed::missed(&patches, &covariances, &truth);
    let fit = lab.rows::<Fit>("out", "patches.fits").remove(0);
    let sizes: Vec<PatchFootprint> = lab.rows("out", "patches.footprints");
    let squares = sizes.iter().map(|one| (one.size_m / size_m - 1.0).powi(2)).sum::<f64>();
    Outcome {
        over_bound: missed.squares_m2 / truth.len() as f64 / (bound_m * bound_m),
        normalised: missed.normalised / missed::degrees_of_freedom(&truth) as f64,
        chi2_dof: fit.chi2 / f64::from(fit.degrees_of_freedom),
        size_error: (squares / sizes.len().max(1) as f64).sqrt(),
        sizes: sizes.len(),
        phantoms: phantoms.len(),
    }
}

/// Three centimetres: as points, patches are 2.5 times as far off as their bound, and the normalised error is above 3.
#[test]
fn sizes_that_are_not_given_are_estimated_from_widths() {
    let outcomes = outcomes(0.03, 0..3);
    eprintln!("{outcomes:#?}");
    let mean = |value: fn(&Outcome) -> f64| outcomes.iter().map(value).sum::<f64>() / outcomes.len() as f64;
    assert!(outcomes.iter().all(|one| one.sizes == 12 && one.size_error < 0.1 && one.phantoms == 0));
    let (over_bound, normalised) = (mean(|one| one.over_bound).sqrt(), mean(|one| one.normalised));
    let chi2_dof = mean(|one| one.chi2_dof);
    assert!(over_bound < 1.4 && normalised < 1.7 && chi2_dof < 1.4, "{over_bound} {normalised} {chi2_dof}");
}
