//! Fourth and fifth bounces through the stages, from onsets on: they improve positions, and reveal a patch that only
//! hidden patches show.

use std::fs;

use periscope::pipeline::run::Settings;
use periscope::pipeline::spec::Definition;
use periscope::tables::{Hypothesis, Label, Onset, Patch};
use periscope::units::time_ps;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::lab::{Lab, one_look, point_onset, write_table};

/// Group index of the campaign: that of air.
const INDEX: f64 = 1.000_277;
/// Standard deviations of onsets, and probabilities that a path gives one, by number of bounces. Fifth bounces over
/// patch 13 have their own probability.
const SD_PS: [f64; 5] = [5.0, 5.0, 5.0, 10.0, 15.0];
const SEEN: [f64; 5] = [1.0, 1.0, 0.9, 0.06, 0.002];
const DEEP_SEEN: f64 = 0.6;
/// Patches 1 to 8 are on two walls, 9 to 12 in front of them, 13 where only the latter show it. The laser is at the
/// origin.
const SCENE: [[f64; 3]; 13] = [
    [-1.0, 2.2, -0.6],
    [-0.4, 2.2, 0.7],
    [0.1, 2.2, -0.2],
    [0.7, 2.2, 0.5],
    [1.1, 1.9, -0.7],
    [1.1, 1.5, 0.6],
    [1.1, 1.0, -0.1],
    [1.1, 0.7, 0.7],
    [-0.7, 0.9, 0.3],
    [-0.2, 1.3, -0.4],
    [-0.9, 1.5, -0.2],
    [0.1, 0.8, 0.2],
    [-1.7, 1.0, 0.1],
];
const VISIBLE: i32 = 8;
const DEEP: i32 = 13;

fn at(patch: i32) -> [f64; 3] {
    SCENE[patch as usize - 1]
}

fn apart_m(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

fn is_open(a: i32, b: i32) -> bool {
    a != b && !(a == DEEP && b <= VISIBLE) && !(b == DEEP && a <= VISIBLE)
}

/// All light of a profile over up to five patches; of a path and its reverse that come back to the lit patch, one.
fn light(lit: i32, seen: i32) -> Vec<Vec<i32>> {
    let mut paths = vec![if lit == seen { vec![lit] } else { vec![lit, seen] }];
    let mut begun = vec![vec![lit]];
    for _ in 3..=5 {
        let longer = |path: &Vec<i32>| -> Vec<Vec<i32>> {
            let next = (1..=DEEP).filter(|next| is_open(path[path.len() - 1], *next));
            next.map(|next| [&path[..], &[next]].concat()).collect()
        };
        begun = begun.iter().flat_map(longer).collect();
        let ended = begun.iter().filter(|path| is_open(path[path.len() - 1], seen));
        let ended = ended.map(|path| [&path[..], &[seen]].concat());
        paths.extend(ended.filter(|path| lit != seen || path.iter().le(path.iter().rev())));
    }
    paths
}

fn onsets(rng: &mut ChaCha8Rng) -> Vec<Onset> {
    let mut onsets = Vec::new();
    for (lit, seen) in (1..=VISIBLE).flat_map(|lit| (1..=VISIBLE).map(move |seen| (lit, seen))) {
        let mut arrivals: Vec<(f64, f64)> = Vec::new();
        for path in light(lit, seen) {
            let chance = if path.contains(&DEEP) { DEEP_SEEN } else { SEEN[path.len() - 1] };
            if rng.random_bool(chance) {
                let inner: f64 = path.windows(2).map(|leg| apart_m(at(leg[0]), at(leg[1]))).sum();
                let way_m = apart_m([0.0; 3], at(lit)) + inner + apart_m(at(seen), [0.0; 3]);
                let (sd_ps, noise): (f64, f64) = (SD_PS[path.len() - 1], StandardNormal.sample(rng));
                arrivals.push((time_ps(way_m, INDEX) + sd_ps * noise, sd_ps));
            }
        }
        arrivals.sort_by(|a, b| a.0.total_cmp(&b.0));
        onsets.extend(arrivals.into_iter().zip(1..).map(|((time_ps, time_sd_ps), rank)| Onset {
            snr: 50.0 / time_sd_ps,
            ..point_onset("bright", [lit, seen], rank, [time_ps, time_sd_ps])
        }));
    }
    onsets
}

/// The main pipeline from its labels on, over onsets that are given.
fn pipeline(lab: &Lab) -> String {
    let text = include_str!("../../pipelines/scene.toml");
    let text = Definition::parse("scene", text).unwrap().to_toml();
    let from = text.find("[anchors]").expect("anchors come before labels");
    // Onsets that are given have no latency.
    let solved = one_look(&text[from..]).replace(", calibration = \"scene_calibration\"", "");
    let path = lab.path("onsets.parquet");
    format!("[onsets]\nstage = 'import'\nparams = {{ table = 'onsets', path = '{}' }}\n{solved}", path.display())
}

/// Positions from labels of up to three bounces alone, from the same start.
fn thirds_alone(lab: &Lab, labels: &[Label]) -> String {
    let labels: Vec<Label> = labels.iter().filter(|label| label.bounces <= 3).cloned().collect();
    write_table(&lab.path("labels.parquet"), &labels);
    write_table(&lab.path("start.parquet"), &lab.rows::<Patch>("out", "start"));
    let import = |table: &str, name: &str| {
        let path = lab.path(&format!("{name}.parquet"));
        format!("[{name}]\nstage = 'import'\nparams = {{ table = '{table}', path = '{}' }}\n", path.display())
    };
    import("labels", "labels")
        + &import("patches", "start")
        + "[patches]\nstage = 'refine'\nfrom = 'labels'\nwith = { patches = 'start' }\n"
}

fn best(lab: &Lab, out: &str) -> Vec<Patch> {
    lab.rows::<Patch>(out, "patches").into_iter().filter(|patch| patch.alternative == 0).collect()
}

/// Distance to the nearest patch of the scene, and its number.
fn nearest(patch: &Patch) -> (f64, i32) {
    let off = |number: i32| (apart_m(at(number), [patch.x_m, patch.y_m, patch.z_m]), number);
    (1..=DEEP).map(off).min_by(|a, b| a.0.total_cmp(&b.0)).unwrap()
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let squares: Vec<f64> = values.map(|value| value * value).collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

#[test]
fn later_bounces_make_positions_better_and_show_a_second_layer() {
    let lab = Lab::bulk(0);
    // Three anchors fix the frame.
    let anchor = |patch: i32| format!("[patches.{patch}]\nposition_m = {:?}\n", at(patch));
    let anchors: String = [1, 4, 6].map(anchor).concat();
    let campaign = format!("[campaign]\nname = 'bright'\n[sensors.s1]\n{anchors}");
    fs::write(lab.campaign().join("campaign.toml"), campaign).unwrap();
    write_table(&lab.path("onsets.parquet"), &onsets(&mut ChaCha8Rng::seed_from_u64(1)));
    lab.run("out", &pipeline(&lab), &Settings::default()).unwrap();
    let labels: Vec<Label> = lab.rows("out", "labels");
    lab.run("thirds", &thirds_alone(&lab, &labels), &Settings::default()).unwrap();

    let (thirds, fifths) = (best(&lab, "thirds"), best(&lab, "out"));
    let layers: Vec<i32> = lab.rows::<Hypothesis>("out", "labels.hypotheses").iter().map(|row| row.layer).collect();
    assert_eq!(layers, [1, 1, 1, 1, 2]);
    let mut numbers: Vec<i32> = fifths.iter().map(|patch| nearest(patch).1).collect();
    assert!(nearest(fifths.last().unwrap()).1 == DEEP);
    numbers.sort_unstable();
    assert_eq!(numbers, (1..=DEEP).collect::<Vec<i32>>());
    for patch in fifths.iter().filter(|patch| patch.sd_m.is_some_and(|sd_m| sd_m > 1e-5)) {
        assert!(nearest(patch).0 < 4.0 * patch.sd_m.unwrap(), "{patch:?}");
    }
    let hidden = |patches: &[Patch]| -> Vec<Patch> {
        patches.iter().filter(|patch| (VISIBLE + 1..DEEP).contains(&nearest(patch).1)).cloned().collect()
    };
    let sd_m = |patches: &[Patch]| rms(hidden(patches).iter().map(|patch| patch.sd_m.unwrap()));
    let off_m = |patches: &[Patch]| rms(hidden(patches).iter().map(|patch| nearest(patch).0));
    let mut counts = [0; 6];
    labels.iter().filter(|label| label.alternative == 0).for_each(|label| counts[label.bounces as usize] += 1);
    eprintln!(
        "labels by bounces {counts:?}; hidden patches: sd {:.3} mm, rms {:.3} mm with third bounces, {:.3} and {:.3} mm with all",
        1e3 * sd_m(&thirds),
        1e3 * off_m(&thirds),
        1e3 * sd_m(&fifths),
        1e3 * off_m(&fifths)
    );
    assert!(sd_m(&fifths) < 0.97 * sd_m(&thirds));
}
