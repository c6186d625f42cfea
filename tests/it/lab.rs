//! A small campaign of our own making, and runs over it: what the tests of whole pipelines share.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use periscope::campaign::Campaign;
use periscope::pipeline::plan::{Decision, Plan};
use periscope::pipeline::progress::{Progress, Style};
use periscope::pipeline::run::{self, Outcome, RunError, Settings};
use periscope::pipeline::spec::Spec;
use periscope::simulate::{self, Format, Laboratory, Scene};
use periscope::store::{Shelf, TableWriter};
use periscope::tables::{Onset, Row};

/// The pipeline that most tests run.
pub const ALL_VISIBLE: &str = include_str!("../../pipelines/all-visible.toml");
/// Averages and no more.
pub const AVERAGES: &str = "[traces]\nstage = 'ingest'\n[profiles]\nstage = 'average'\nfrom = 'traces'\n";
/// Four patches that see one another.
pub const TINY: &str = include_str!("../../pipelines/scenes/tiny.toml");

/// A simulated campaign in a folder of its own.
pub struct Lab {
    folder: tempfile::TempDir,
}

impl Lab {
    /// Four patches that see one another, a dozen shots a capture.
    pub fn tiny() -> Self {
        Self::of(TINY, 1, Format::Trc)
    }

    /// A campaign of this scene.
    pub fn of(scene: &str, seed: u64, format: Format) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let scene = Scene::parse(Path::new("scene.toml"), scene).unwrap();
        simulate::simulate(&scene, seed, &folder.path().join("campaign"), format).unwrap();
        Self { folder }
    }

    /// A campaign of a scene whose light has been followed.
    pub fn recorded(laboratory: &Laboratory, seed: u64, format: Format) -> Self {
        let folder = tempfile::tempdir().unwrap();
        simulate::record(laboratory, seed, &folder.path().join("campaign"), format).unwrap();
        Self { folder }
    }

    /// A number of captures of 16 MiB each, all codes zero but for a pulse: enough for several parts.
    pub fn bulk(captures: i32) -> Self {
        let lab = Self { folder: tempfile::tempdir().unwrap() };
        fs::create_dir_all(lab.campaign().join("raw")).unwrap();
        let rule = "[[captures]]\nrole = 'scene'\nfiles = 'raw/L{lit}_P{seen}.npy'\ndt_ps = 50.0\nt0_ps = 0.0\ngain_v = 0.001\noffset_v = 0.0\n";
        fs::write(lab.campaign().join("campaign.toml"), format!("[campaign]\nname = 'bulk'\n[sensors.s1]\n{rule}"))
            .unwrap();
        // Reciprocal pairs: (1, 2), (2, 1), (3, 4), (4, 3)...
        (0..captures).for_each(|n| lab.add_bulk_capture(n + 1, if n % 2 == 0 { n + 2 } else { n }));
        lab
    }

    /// One capture more of a bulk campaign.
    pub fn add_bulk_capture(&self, lit: i32, seen: i32) {
        let (shots, samples) = (512, 16_384);
        let mut codes = vec![0_i16; shots * samples];
        (0..shots).for_each(|shot| codes[shot * samples + 8000 + lit as usize] = 1000);
        let file = fs::File::create(self.campaign().join(format!("raw/L{lit}_P{seen}.npy"))).unwrap();
        let mut file = std::io::BufWriter::new(file);
        periscope::formats::npy::write(&mut file, &[shots as u64, samples as u64], &codes).unwrap();
    }

    /// Runs the usual pipeline; how many patches it finds.
    pub fn rows_of_patches(&self, out: &str) -> u64 {
        self.run(out, ALL_VISIBLE, &Settings::default()).unwrap().tables["patches"].rows("patches")
    }

    pub fn campaign(&self) -> PathBuf {
        self.folder.path().join("campaign")
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Runs a pipeline into the folder `out`.
    pub fn run(&self, out: &str, pipeline: &str, settings: &Settings) -> Result<Outcome, RunError> {
        self.run_with(out, pipeline, &[], settings)
    }

    /// The same with changed parameters.
    pub fn run_with(
        &self,
        out: &str,
        pipeline: &str,
        set: &[String],
        settings: &Settings,
    ) -> Result<Outcome, RunError> {
        let spec = Spec::parse("test", pipeline, set).unwrap();
        let campaigns = [Campaign::load(&self.campaign()).unwrap()];
        let shelf = Shelf::open(&self.path(out))?;
        let mut plan = Plan::new(&spec, &campaigns, &shelf, None)?;
        run::run(&mut plan, settings, &Progress::new(Style::Silent))
    }

    /// What a run would do.
    pub fn plan(&self, out: &str, pipeline: &str, set: &[String]) -> Vec<Decision> {
        let spec = Spec::parse("test", pipeline, set).unwrap();
        let campaigns = [Campaign::load(&self.campaign()).unwrap()];
        let shelf = Shelf::imagine(&self.path(out));
        let plan = Plan::new(&spec, &campaigns, &shelf, None).unwrap();
        (0..spec.steps.len()).map(|step| plan.decision(step).unwrap()).collect()
    }

    /// Rows of a view.
    pub fn rows<R: Row>(&self, out: &str, view: &str) -> Vec<R> {
        let batches = Shelf::look(&self.path(out)).unwrap().batches(view).unwrap();
        batches.iter().flat_map(|batch| R::rows(batch).unwrap()).collect()
    }

    /// Rows of a table of the truth.
    pub fn truth<R: Row>(&self) -> Vec<R> {
        let path = self.campaign().join("truth").join(R::TABLE).join("truth.parquet");
        periscope::store::parquet::read(&path, 1024)
            .unwrap()
            .flat_map(|batch| R::rows(&batch.unwrap()).unwrap())
            .collect()
    }

    /// Digests of every part of a result folder, by its path there.
    pub fn parts(&self, out: &str) -> BTreeMap<String, blake3::Hash> {
        let mut parts = BTreeMap::new();
        let mut folders = vec![self.path(out).join(".shelf")];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(&folder).unwrap().flatten() {
                let path = entry.path();
                if path.is_dir() {
                    folders.push(path);
                } else if path.extension().is_some_and(|extension| extension == "parquet") {
                    let name = path.strip_prefix(self.path(out)).unwrap().display().to_string();
                    parts.insert(name, blake3::hash(&fs::read(&path).unwrap()));
                }
            }
        }
        parts
    }
}

/// Writes a table as Parquet, for `import`.
pub fn write_table<R: Row>(path: &Path, rows: &[R]) {
    let mut writer = TableWriter::create(path, &R::schema()).unwrap();
    writer.write(&R::to_batch(rows)).unwrap();
    writer.finish(&[]).unwrap();
}

/// A pulse by itself, of amplitude 1 and a signal-to-noise ratio of 10, at a time with a standard deviation.
pub fn point_onset(campaign: &str, [lit, seen]: [i32; 2], rank: i32, [time_ps, time_sd_ps]: [f64; 2]) -> Onset {
    Onset {
        campaign: campaign.into(),
        sensor: "s1".into(),
        lit,
        seen,
        rank,
        time_ps,
        time_sd_ps,
        amplitude: 1.0,
        snr: 10.0,
        ..Onset::default()
    }
}

/// Runs `body` in a pool with this number of threads.
pub fn with_threads<T: Send>(threads: usize, body: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(body)
}

/// An error with its causes, as the command line prints it.
pub fn chain(error: impl Into<anyhow::Error>) -> String {
    format!("{:#}", error.into())
}

/// The pipeline of scenes with one look at the profiles, or at onsets that are given, and without the search in all
/// profiles together.
pub fn one_look(pipeline: &str) -> String {
    let between = |text: &str, from: &str, to: &str| {
        let (before, rest) = text.split_once(from).unwrap_or_else(|| panic!("the pipeline has {from}"));
        let (_, after) = rest.split_once(to).unwrap_or_else(|| panic!("the pipeline has {to} behind {from}"));
        format!("{before}{to}{after}")
    };
    let once = between(&between(pipeline, "[second_predictions]", "[planes]"), "[all_patches]", "[decisions]");
    let renamed = once.replace("[draft]", "[patches]").replace("draft_", "");
    renamed.replace("weak = \"all_patches.hypotheses\", ", "").replace("\"all_patches\"", "\"patches\"")
}
