//! Hidden patches through the stages, from labels of third bounces on: distances by T3, positions by multilateration,
//! then maximum likelihood.

use std::fs;

use periscope::pipeline::run::Settings;
use periscope::tables::{Distance, Label, Patch, PatchCovariance};
use periscope::units::time_ps;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::lab::{Lab, write_table};
use crate::missed;

/// Group index of the campaign: that of air.
const INDEX: f64 = 1.000_277;
const SD_PS: f64 = 5.0;
/// Share of third bounces, and of pairs, that were not captured or not labelled.
const MISSING: f64 = 0.3;
/// Patches 1 to 8 are on the walls y = 2 m and x = 1.1 m; patches 9 to 11 are in front of them, hidden from laser and
/// sensor. The laser is at the origin.
const SCENE: [[f64; 3]; 11] = [
    [-0.8, 2.0, -0.5],
    [-0.3, 2.0, 0.6],
    [0.2, 2.0, -0.2],
    [0.7, 2.0, 0.4],
    [1.1, 1.7, -0.6],
    [1.1, 1.3, 0.5],
    [1.1, 0.9, -0.1],
    [1.1, 0.6, 0.7],
    [-0.6, 0.9, 0.2],
    [-0.1, 1.2, -0.4],
    [0.3, 0.8, 0.5],
];
const VISIBLE: i32 = 8;

fn apart_m(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

/// Labels of first and second bounces, and of third bounces over the hidden patches; the sensor is `sensor_m` from the
/// laser.
fn labels(sensor_m: [f64; 3], rng: &mut ChaCha8Rng) -> Vec<Label> {
    let at = |patch: i32| SCENE[patch as usize - 1];
    let mut labels = Vec::new();
    for (lit, seen) in (1..=VISIBLE).flat_map(|lit| (1..=VISIBLE).map(move |seen| (lit, seen))) {
        let direct = if lit == seen { vec![lit] } else { vec![lit, seen] };
        let thirds = (VISIBLE + 1..=SCENE.len() as i32).map(|hidden| vec![lit, hidden, seen]);
        for (rank, path) in std::iter::once(direct).chain(thirds).enumerate() {
            if path.len() > 1 && rng.random_bool(MISSING) {
                continue;
            }
            let inner: f64 = path.windows(2).map(|pair| apart_m(at(pair[0]), at(pair[1]))).sum();
            let way_m = apart_m([0.0; 3], at(lit)) + inner + apart_m(at(seen), sensor_m);
            let noise: f64 = StandardNormal.sample(rng);
            labels.push(Label {
                campaign: "corner".into(),
                sensor: "s1".into(),
                lit,
                seen,
                rank: rank as i32 + 1,
                time_ps: time_ps(way_m, INDEX) + SD_PS * noise,
                time_sd_ps: SD_PS,
                width_ps: Some(0.0),
                bounces: path.len() as i32,
                path: Some(path),
                probability: 1.0,
                ..Label::default()
            });
        }
    }
    labels
}

fn import(lab: &Lab, heading: &str, rows: &[Label]) -> String {
    let path = lab.path(&format!("{heading}.parquet"));
    write_table(&path, rows);
    format!("[{heading}]\nstage = 'import'\nparams = {{ table = 'labels', path = '{}' }}\n", path.display())
}

/// A campaign with this sensor, its labels, and the pipeline's headings for labels of up to two bounces, and of all.
fn lab(sensor_m: [f64; 3], seed: u64) -> (Lab, String) {
    let lab = Lab::bulk(0);
    let [x, y, z] = sensor_m;
    let campaign = format!(
        "[campaign]\nname = 'corner'\n[stations.laser]\nposition_m = [0.0, 0.0, 0.0]\n[stations.eye]\nposition_m = [{x:?}, {y:?}, {z:?}]\n[sensors.s1]\nstation = 'eye'\n"
    );
    fs::write(lab.campaign().join("campaign.toml"), campaign).unwrap();
    let all = labels(sensor_m, &mut ChaCha8Rng::seed_from_u64(seed));
    let direct: Vec<Label> = all.iter().filter(|label| label.bounces <= 2).cloned().collect();
    let pipeline = import(&lab, "visible_labels", &direct) + &import(&lab, "labels", &all);
    (lab, pipeline)
}

const SOLVED: &str = "[visible]\nstage = 'refine'\nfrom = 'visible_labels'\n\
    [distances]\nstage = 'range'\nfrom = 'labels'\n\
    with = { patches = 'visible', covariances = 'visible.patch_covariances', delays = 'visible.delays' }\n\
    [start]\nstage = 'embed'\nfrom = 'distances'\nwith = { patches = 'visible' }\n\
    [patches]\nstage = 'refine'\nfrom = 'labels'\nwith = { patches = 'start' }\n";

fn truth(like: &[Patch]) -> Vec<Patch> {
    let there = |(row, at): (&Patch, &[f64; 3])| Patch { x_m: at[0], y_m: at[1], z_m: at[2], ..row.clone() };
    like.iter().zip(&SCENE).map(there).collect()
}

fn best(lab: &Lab, view: &str) -> Vec<Patch> {
    lab.rows::<Patch>("out", view).into_iter().filter(|patch| patch.alternative == 0).collect()
}

fn kinds(patches: &[Patch]) -> Vec<&str> {
    patches.iter().map(|patch| &*patch.kind).collect()
}

fn expected_kinds() -> Vec<&'static str> {
    [["visible"; 8].as_slice(), ["hidden"; 3].as_slice()].concat()
}

/// Distances of hidden patches and positions of all are right to their standard deviations, over several campaigns.
#[test]
fn hidden_patches_are_found_by_range_embed_and_refine_to_their_standard_deviations() {
    let (mut normalised, mut freedom) = (0.0, 0);
    let (mut squares, mut count) = (0.0, 0);
    for seed in 0..12 {
        let (lab, pipeline) = lab([0.0; 3], seed);
        lab.run("out", &(pipeline + SOLVED), &Settings::default()).unwrap();
        for row in lab.rows::<Distance>("out", "distances").iter().filter(|row| row.bounces == 3) {
            let true_m = apart_m(SCENE[row.a as usize - 1], SCENE[row.b as usize - 1]);
            squares += ((row.distance_m - true_m) / row.sd_m).powi(2);
            count += 1;
        }
        let (start, patches) = (best(&lab, "start"), best(&lab, "patches"));
        assert_eq!((kinds(&start), kinds(&patches)), (expected_kinds(), expected_kinds()));
        let start_off_m = (missed::squares_m2(&start, &truth(&start)) / start.len() as f64).sqrt();
        assert!(start_off_m < 0.01, "{start_off_m}");
        let covariances: Vec<PatchCovariance> = lab.rows("out", "patches.patch_covariances");
        let of_all = missed::missed(&patches, &covariances, &truth(&patches));
        let off_m = (of_all.squares_m2 / patches.len() as f64).sqrt();
        assert!(off_m < 0.003, "{off_m}");
        normalised += of_all.normalised;
        freedom += missed::degrees_of_freedom(&truth(&patches));
    }
    eprintln!("distances {:.3} of {count}, positions {normalised:.1} of {freedom}", squares / f64::from(count));
    // Distances of one campaign share errors, hence the wide margin.
    assert!(count > 250 && (0.75..1.3).contains(&(squares / f64::from(count))), "{squares} {count}");
    let freedom = freedom as f64;
    assert!((normalised - freedom).abs() < 4.0 * (2.0 * freedom).sqrt(), "{normalised} {freedom}");
}

/// With a sensor away from the laser, first and second bounces give no distances. Third bounces do, given the patches
/// from `refine`.
#[test]
fn with_the_sensor_apart_hidden_patches_are_found_as_well() {
    let (lab, pipeline) = lab([0.5, -0.1, 0.3], 3);
    lab.run("out", &(pipeline + SOLVED), &Settings::default()).unwrap();
    let distances: Vec<Distance> = lab.rows("out", "distances");
    assert_eq!((distances.len(), distances.iter().all(|row| row.bounces == 3)), (24, true));
    for row in &distances {
        let true_m = apart_m(SCENE[row.a as usize - 1], SCENE[row.b as usize - 1]);
        assert!((row.distance_m - true_m).abs() < 4.0 * row.sd_m && row.sd_m < 0.02, "{row:?}");
    }
    let patches = best(&lab, "patches");
    assert_eq!(kinds(&patches), expected_kinds());
    assert!((missed::squares_m2(&patches, &truth(&patches)) / 11.0).sqrt() < 0.03);
}

/// `refine` needs no start: it places hidden patches too.
#[test]
fn without_a_start_hidden_patches_are_found_as_well() {
    let (lab, pipeline) = lab([0.0; 3], 5);
    lab.run("out", &(pipeline + "[patches]\nstage = 'refine'\nfrom = 'labels'\n"), &Settings::default()).unwrap();
    let patches = best(&lab, "patches");
    assert_eq!(kinds(&patches), expected_kinds());
    assert!((missed::squares_m2(&patches, &truth(&patches)) / 11.0).sqrt() < 0.003);
}
