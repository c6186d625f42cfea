//! Error bars of edges on photon counts, through files and `run`: Poisson resamples of one measured pulse scatter as
//! they state. `cargo test --release --test it counted_edges -- --nocapture` prints the ratios.

use std::fs;
use std::path::Path;

use periscope::formats::description::TIME;
use periscope::formats::{Description, Source, contents, npy};
use periscope::store::Shelf;
use periscope::tables::{Onset, Row};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Poisson};

use crate::relay_scene::periscope;

const DRAWS: usize = 4000;
const CAMPAIGN: &str = "[campaign]\nname = 'edges'\ngroup_index = 1.0\n[sensors.s1]\nkind = 'counts'\ncycles = 100000000000\n\
    [[captures]]\nrole = 'response'\nfiles = 'raw/response.npy'\nsensor = 's1'\npath_m = 1.0\ndt_ps = 4.0\nt0_ps = 0.0\ngain_v = 1.0\n\
    offset_v = 0.0\n[[captures]]\nrole = 'scene'\nfiles = 'raw/L{lit}.npy'\nsensor = 's1'\nsegments = 'seen'\ndt_ps = 4.0\nt0_ps = 0.0\n\
    gain_v = 1.0\noffset_v = 0.0\n";
const PIPELINE: &str = "[response]\nstage = 'ingest'\nparams = { roles = ['response'] }\n[calibration]\nstage = 'calibrate'\n\
    from = 'response'\n[traces]\nstage = 'ingest'\nparams = { roles = ['scene'] }\n[profiles]\nstage = 'average'\nfrom = 'traces'\n\
    [stir]\nstage = 'deconvolve'\nfrom = 'profiles'\nwith = { calibration = 'calibration' }\nparams = { method = 'none' }\n\
    [onsets]\nstage = 'detect'\nfrom = 'stir'\nparams = { method = 'leading-edge' }\n";

/// A pulse as a counter has it: the front of a Gaussian, a fast and a slow tail; bins of 4 ps.
fn pulse() -> Vec<f64> {
    let bin = |n: usize| {
        let late = n as f64 - 300.3;
        let tail = 0.8 * (-late / 4.0).exp() + 0.2 * (-late / 30.0).exp();
        if late < 0.0 { (-0.5 * (late / 2.2_f64).powi(2)).exp() } else { tail }
    };
    (0..1000).map(bin).collect()
}

/// The response of a photon counter, where it lies beside the project.
fn measured() -> Option<Vec<f64>> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/real-light/cdt/capture_direct.mat");
    if !path.exists() {
        eprintln!("\n!!! no capture of a photon counter here ({}): NOT tested\n", path.display());
        return None;
    }
    let description = Description {
        variable: Some("out".to_owned()),
        axes: Some(vec!["shot".to_owned(), TIME.to_owned()]),
        ..Description::default()
    };
    let mut source = Source::open(&path).unwrap().described(description);
    let records = contents(&mut source).unwrap().records;
    let counts = source.values(&records[0]).unwrap();
    let peak = (0..counts.len()).max_by(|a, b| counts[*a].total_cmp(&counts[*b])).unwrap();
    Some(counts[peak - 300..peak + 700].to_vec())
}

/// For each number of photons: stated over seen standard deviation of the edges at a fraction, by a method.
fn ratios(shape: &[f64], photons: &[u32], settings: &[&str]) -> Vec<f64> {
    let folder = tempfile::tempdir().unwrap();
    let raw = folder.path().join("campaign/raw");
    fs::create_dir_all(&raw).unwrap();
    fs::write(folder.path().join("campaign/campaign.toml"), CAMPAIGN).unwrap();
    fs::write(folder.path().join("edges.toml"), PIPELINE).unwrap();
    let total: f64 = shape.iter().sum();
    let save = |name: &str, shape: &[u64], counts: &[f32]| {
        npy::write(&mut fs::File::create(raw.join(name)).unwrap(), shape, counts).unwrap();
    };
    save(
        "response.npy",
        &[shape.len() as u64],
        &shape.iter().map(|share| (1e7 * share / total) as f32).collect::<Vec<_>>(),
    );
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    for count in photons {
        let draw =
            |share: &f64| Poisson::new(f64::from(*count) * share / total + 1e-9).unwrap().sample(&mut rng) as f32;
        let all = shape.iter().cycle().take(DRAWS * shape.len());
        save(&format!("L{count}.npy"), &[DRAWS as u64, shape.len() as u64], &all.map(draw).collect::<Vec<_>>());
    }
    let set: Vec<&str> = settings.iter().flat_map(|setting| ["--set", setting]).collect();
    periscope(folder.path(), &[&["run", "edges.toml", "--campaign", "campaign", "--out", "out"], &set[..]].concat());
    let shelf = Shelf::look(&folder.path().join("out")).unwrap();
    let onsets: Vec<Onset> =
        shelf.batches("onsets").unwrap().iter().flat_map(|rows| Onset::rows(rows).unwrap()).collect();
    let ratio = |count: &u32| {
        let of_count: Vec<&Onset> = onsets.iter().filter(|onset| onset.lit == count.cast_signed()).collect();
        assert_eq!(of_count.len(), DRAWS, "{count} photons: each draw has one edge");
        let mean = of_count.iter().map(|onset| onset.time_ps).sum::<f64>() / DRAWS as f64;
        let seen = of_count.iter().map(|onset| (onset.time_ps - mean).powi(2)).sum::<f64>() / (DRAWS - 1) as f64;
        let stated = of_count.iter().map(|onset| onset.time_sd_ps.powi(2)).sum::<f64>() / DRAWS as f64;
        println!("{settings:?}, {count} photons: stated {:.3} ps, seen {:.3} ps", stated.sqrt(), seen.sqrt());
        (stated / seen).sqrt()
    };
    photons.iter().map(ratio).collect()
}

/// Of 4,000 draws a ratio is known to 1.1 %.
#[test]
fn edges_of_resampled_counts_scatter_as_they_state() {
    let methods: [&[&str]; 3] = [
        &["onsets.method=leading-edge", "onsets.fraction=0.5"],
        &["onsets.method=leading-edge", "onsets.fraction=0.2"],
        // Late by what the pulse takes to rise.
        &["onsets.method=constant-fraction", "onsets.fraction=0.4", "onsets.delay_ps=30"],
    ];
    for shape in std::iter::once(pulse()).chain(measured()) {
        for settings in methods {
            for ratio in ratios(&shape, &[3_000, 30_000, 300_000], settings) {
                assert!((0.9..1.1).contains(&ratio), "{settings:?}: {ratio}");
            }
        }
    }
}
