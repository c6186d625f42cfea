//! What happens when a disk fails: at every access of a run, of shards and their gathering, of a seal, of a
//! verification and of a repair, one after the other. Each must end with an error, or do without what failed; then, on
//! a sound disk, the same command must leave the bytes of an undisturbed one.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use super::plan::Plan;
use super::progress::{Progress, Style};
use super::run::{self, RunError, Settings};
use super::shards::{self, Dealt, Job, ShardError, Work};
use super::spec::Spec;
use crate::campaign::{Campaign, seal};
use crate::simulate::{self, Format, Scene};
use crate::store::disk::faults::failing;
use crate::store::runs::{Ending, RunRecord};
use crate::store::verify::{repair, verify};
use crate::store::{Digest, Gathered, Shelf};

/// An archive, and an index.
const PIPELINE: &str = "[calibration_traces]\nstage = 'ingest'\nparams = { roles = ['response'], codes = 'zstd' }\n\
    [calibration]\nstage = 'calibrate'\nfrom = 'calibration_traces'\n\
    [traces]\nstage = 'ingest'\n\
    [profiles]\nstage = 'average'\nfrom = 'traces'\nwith = { calibration = 'calibration' }\n";

type Outcome = Result<(), String>;

/// A campaign and what is made of it, in a folder of its own.
struct Bench {
    folder: tempfile::TempDir,
    spec: Spec,
}

impl Bench {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let scene = include_str!("../../pipelines/scenes/tiny.toml");
        let scene = Scene::parse(Path::new("scene.toml"), scene).unwrap();
        simulate::simulate(&scene, 1, &folder.path().join("campaign"), Format::Trc).unwrap();
        let bench = Self { folder, spec: Spec::parse("test", PIPELINE, &[]).unwrap() };
        // Small parts, so that there are several.
        let file = bench.path("campaign/campaign.toml");
        let text = fs::read_to_string(&file).unwrap();
        fs::write(&file, text.replacen("[campaign]\n", "[campaign]\npart_bytes = 40000\n", 1)).unwrap();
        bench
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn campaigns(&self) -> Result<[Campaign; 1], String> {
        Ok([Campaign::load(&self.path("campaign")).map_err(chain)?])
    }

    /// As the command `run`.
    fn run(&self) -> Outcome {
        let campaigns = self.campaigns()?;
        let shelf = Shelf::open(&self.path("out")).map_err(chain)?.durable(true);
        let mut record = RunRecord::start("test".into(), &[], []).map_err(chain)?;
        shelf.write_run(&record).map_err(chain)?;
        let mut plan = Plan::new(&self.spec, &campaigns, &shelf, None).map_err(chain)?;
        run::run(&mut plan, &Settings::default(), &Progress::new(Style::Silent)).map_err(broken)?;
        record.end(Ending::Done);
        record.views = shelf.targets().map_err(chain)?;
        shelf.write_run(&record).map_err(chain)
    }

    /// As the commands `plan --shards` and `run-shard`.
    fn shards(&self) -> Outcome {
        let campaigns = self.campaigns()?;
        let shelf = Shelf::join(&self.path("out")).map_err(chain)?;
        let (settings, progress) = (Settings::default(), Progress::new(Style::Silent));
        let mut plan = Plan::new(&self.spec, &campaigns, &shelf, None).map_err(chain)?;
        shards::prepare(&mut plan, &settings, &progress).map_err(broken)?;
        let work = Work { pipeline: "test".into(), text: PIPELINE.to_owned(), ..Work::default() };
        let work = Work { campaigns: vec![self.path("campaign")], ..work };
        let Dealt { work, shards, cut, .. } = shards::deal(&plan, work, 2).map_err(chain)?;
        assert!(cut.is_empty(), "parts are small");
        let run = RunRecord::start("test".into(), &[], []).map_err(chain)?;
        let keys = shards.iter().map(|(key, _)| key.clone()).collect();
        let job = Job { work, until: None, run, shards: keys, cut: BTreeMap::new() };
        let none: [(&str, &Job); 0] = [];
        let files: Vec<_> = shards.iter().map(|(key, shard)| (key.as_str(), shard)).collect();
        shelf.write_shards(&job, &files, &none).map_err(chain)?;
        for (key, _) in &shards {
            let shard: shards::Shard = shelf.shard(key).map_err(chain)?.ok_or("the shard is gone")?;
            match shard.make(key, &shelf, &settings, &progress) {
                Err(ShardError::Run(error)) => return Err(broken(error)),
                made => made.map_err(chain)?,
            };
        }
        Ok(())
    }

    /// As the command `gather`, also a second time.
    fn gather(&self) -> Outcome {
        let shelf = Shelf::open(&self.path("out")).map_err(chain)?;
        let job: Option<Job> = shelf.job().map_err(chain)?;
        let Some(job) = job else {
            return shelf.gathered().map_err(chain)?.map(drop).ok_or("nothing to gather".to_owned());
        };
        let campaigns = self.campaigns()?;
        let mut plan = Plan::new(&self.spec, &campaigns, &shelf, None).map_err(chain)?;
        job.check(&plan).map_err(chain)?;
        run::run(&mut plan, &Settings::default(), &Progress::new(Style::Silent)).map_err(broken)?;
        let keys = job.shards.into_iter().collect();
        shelf.end_shards(&Gathered { keys, is_incomplete: false }).map_err(chain)
    }

    /// As the command `seal`.
    fn seal(&self) -> Outcome {
        let campaign = Campaign::read(&self.path("campaign")).map_err(chain)?;
        let survey = campaign.survey().map_err(chain)?;
        seal(&campaign, &survey, false).map(drop).map_err(chain)
    }

    /// As the command `verify --repair`. It finds damage in spite of a fault, or says that it could not look.
    fn repair(&self) -> Outcome {
        let shelf = Shelf::open(&self.path("out")).map_err(chain)?;
        let report = verify(&shelf).map_err(chain)?;
        assert!(!report.findings.is_empty(), "damage was passed");
        repair(&report.findings).map_err(chain)
    }

    /// Copies a folder, links as links; replaces one that is there.
    fn copy(&self, from: &str, to: &str) {
        if self.path(to).exists() {
            fs::remove_dir_all(self.path(to)).unwrap();
        }
        let copied = std::process::Command::new("cp").arg("-a").args([self.path(from), self.path(to)]).status();
        assert!(copied.unwrap().success());
    }

    /// Digests of all that a reader sees in the result folder, and of all parts.
    fn results(&self) -> BTreeMap<PathBuf, Digest> {
        let mut results = BTreeMap::new();
        let mut folders = vec![self.path("out")];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(&folder).unwrap().flatten() {
                let path = entry.path();
                if path.is_dir() {
                    folders.push(path);
                } else if path.extension().is_some_and(|extension| extension == "parquet") {
                    let name = path.strip_prefix(self.folder.path()).unwrap().to_owned();
                    results.insert(name, Digest::of_bytes(&fs::read(&path).unwrap()));
                }
            }
        }
        results
    }

    /// Lets every `step`-th access of `action` fail, each time from the state in `before` (folders `out` and
    /// `campaign`), and holds what `again` leaves then against `expected`. Returns the number of faults.
    fn faults(
        &self,
        before: &str,
        step: usize,
        action: impl Fn() -> Outcome,
        again: impl Fn() -> Outcome,
        expected: &BTreeMap<PathBuf, Digest>,
    ) -> usize {
        let (mut faults, mut passed) = (0, 0);
        for at in (1..).step_by(step) {
            for folder in ["out", "campaign"] {
                self.copy(&format!("{before}/{folder}"), folder);
            }
            let (outcome, failed) = failing(self.folder.path(), at, &action);
            let Some(failed) = failed else {
                assert_eq!(outcome, Ok(()), "without a fault");
                break;
            };
            faults += 1;
            match outcome {
                // What names no file helps nobody.
                Err(error) => assert!(error.contains('/'), "access {at}, {failed}: {error}"),
                Ok(()) => passed += 1,
            }
            again().unwrap_or_else(|error| panic!("access {at}, {failed}: then {error}"));
            assert_eq!(self.results(), *expected, "access {at}, {failed}");
        }
        println!("{before}: {faults} faults, {passed} of them without harm");
        faults
    }

    fn keep(&self, state: &str) {
        fs::create_dir(self.path(state)).unwrap();
        for folder in ["out", "campaign"] {
            fs::create_dir_all(self.path(folder)).unwrap();
            self.copy(folder, &format!("{state}/{folder}"));
        }
    }
}

fn chain(error: impl Into<anyhow::Error>) -> String {
    format!("{:#}", error.into())
}

/// A run's error; a panic is a defect, whatever the disk does.
fn broken(error: RunError) -> String {
    assert!(!matches!(error, RunError::Panic { .. }), "{error}");
    chain(error)
}

/// Every so many accesses one fails; each of them where the study of docs/reliability.md asks for all.
fn step() -> usize {
    if std::env::var_os("PERISCOPE_EVERY_FAULT").is_some() { 1 } else { 17 }
}

#[test]
fn faults_of_a_run_and_of_a_seal_end_with_an_error_and_the_next_run_has_the_same_bytes() {
    let bench = Bench::new();
    bench.keep("nothing");
    bench.run().unwrap();
    let expected = bench.results();
    assert!(expected.len() > 10, "{}", expected.len());
    let of_run = bench.faults("nothing", step(), || bench.run(), || bench.run(), &expected);
    // A seal: the run after it checks it.
    let again = || bench.seal().and_then(|()| bench.run());
    let of_seal = bench.faults("nothing", step(), || bench.seal(), again, &expected);
    assert!(of_run >= 3 && of_seal >= 3, "{of_run} {of_seal}");
}

#[test]
fn faults_of_shards_and_their_gathering_end_with_an_error_and_the_next_ones_have_the_same_bytes() {
    let bench = Bench::new();
    bench.keep("nothing");
    bench.shards().unwrap();
    bench.keep("shards");
    bench.gather().unwrap();
    let gathered = bench.results();
    let again = || bench.shards().and_then(|()| bench.gather());
    let of_shards = bench.faults("nothing", step(), || bench.shards(), again, &gathered);
    let of_gather = bench.faults("shards", step(), || bench.gather(), || bench.gather(), &gathered);
    assert!(of_shards >= 3 && of_gather >= 3, "{of_shards} {of_gather}");
}

/// A damaged part: whatever becomes of the repair, the next repair and run fix it.
#[test]
fn faults_of_a_repair_end_with_an_error_and_the_next_one_repairs_the_damage() {
    let bench = Bench::new();
    bench.run().unwrap();
    let expected = bench.results();
    let part = expected.keys().find(|path| path.to_string_lossy().contains("profiles.parquet")).unwrap();
    let mut bytes = fs::read(bench.path("").join(part)).unwrap();
    bytes[100] ^= 1;
    fs::write(bench.path("").join(part), bytes).unwrap();
    bench.keep("damaged");
    let again = || {
        let shelf = Shelf::open(&bench.path("out")).map_err(chain)?;
        repair(&verify(&shelf).map_err(chain)?.findings).map_err(chain)?;
        drop(shelf);
        bench.run()
    };
    let of_repair = bench.faults("damaged", step(), || bench.repair(), again, &expected);
    assert!(of_repair >= 3, "{of_repair}");
}
