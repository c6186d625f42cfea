//! Captures that are cut by their shots: pieces made anywhere, in any order, join to the bytes of a single run.

use std::fs;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use periscope::formats;
use periscope::simulate::Format;
use periscope::tables::{Profile, Subtotal};
use serde_json::Value;

use crate::lab::{AVERAGES, Lab};
use crate::many_parts::{PIPELINE, errors};

const CORNER: &str = include_str!("../../pipelines/scenes/around-the-corner.toml");
/// The table of traces is an index, which is made where pieces are joined.
const TRACES: &str = "traces.keep=true";

/// A campaign with captures of very different sizes, and the program in its folder.
struct Large(Lab);

impl Large {
    fn of(lab: Lab, part_bytes: u64, pipeline: &str) -> Self {
        let file = lab.campaign().join("campaign.toml");
        let keys = fs::read_to_string(&file).unwrap();
        let keys = keys.replacen("[campaign]\n", &format!("[campaign]\npart_bytes = {part_bytes}\n"), 1);
        fs::write(file, keys).unwrap();
        fs::write(lab.path("pipeline.toml"), pipeline).unwrap();
        Self(lab)
    }

    /// The scene of `periscope demo` with three patches, up to the onsets. One capture has 1,500 shots, the others 40.
    fn corner() -> Self {
        let scene = |captures: &str| {
            let text = CORNER.replace("response_shots = 2000", "response_shots = 200");
            text.replace("\nshots = 200\n", &format!("\n{captures}\n"))
        };
        let lab = Lab::of(&scene("shots = 40\nlit = [1, 2, 3]\nseen = [1, 2, 3]"), 1, Format::Trc);
        let large = Lab::of(&scene("shots = 1500\nlit = [2]\nseen = [3]"), 2, Format::Trc);
        for channel in ["C1", "C2"] {
            let file = format!("raw/scene/s1_L2_P3_{channel}.trc");
            fs::copy(large.campaign().join(&file), lab.campaign().join(&file)).unwrap();
        }
        Self::of(lab, 100_000, PIPELINE.split_once("[anchors]").unwrap().0)
    }

    /// Arrays of codes without reference, one file a capture: those of these sizes, in shots.
    fn arrays(keys: &str, shots: &[usize]) -> Self {
        let lab = Lab::tiny();
        fs::remove_dir_all(lab.campaign()).unwrap();
        fs::create_dir_all(lab.campaign().join("raw")).unwrap();
        let rule = "[[captures]]\nrole = 'scene'\nsensor = 's1'\nfiles = 'raw/L{lit}_P{seen}.npy'\ndt_ps = 50.0\nt0_ps = 0.0\ngain_v = 0.001\noffset_v = 0.0\n";
        let text = format!("[campaign]\nname = 'arrays'\n[sensors.s1]\n{keys}{rule}");
        fs::write(lab.campaign().join("campaign.toml"), text).unwrap();
        let large = Self::of(lab, 50_000, AVERAGES);
        for (i, shots) in shots.iter().enumerate() {
            let codes = |shot: usize| (0..200).map(move |n| noise(shot * 200 + n) + if n == 120 { 900 } else { 20 });
            large.write(&format!("L{}_P1.npy", i + 1), &(0..*shots).flat_map(codes).collect::<Vec<_>>());
        }
        large
    }

    fn write(&self, name: &str, codes: &[i16]) {
        let file = fs::File::create(self.raw(name)).unwrap();
        formats::npy::write(&mut BufWriter::new(file), &[codes.len() as u64 / 200, 200], codes).unwrap();
    }

    fn raw(&self, name: &str) -> PathBuf {
        self.0.campaign().join("raw").join(name)
    }

    fn periscope(&self, args: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_periscope"));
        command.args(args).current_dir(self.0.path("")).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    fn output(&self, args: &[&str]) -> Output {
        let output = self.periscope(args).output().unwrap();
        assert!(matches!(output.status.code(), Some(0 | 3)), "{args:?}: {}", errors(&output));
        output
    }

    fn refused(&self, args: &[&str]) -> String {
        let output = self.periscope(args).output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{args:?}");
        errors(&output)
    }

    fn job<'a>(&self, command: &'a str, out: &'a str, more: &[&'a str]) -> Output {
        let args = [command, "pipeline.toml", "--campaign", "campaign", "--out", out];
        self.output(&[&args, more].concat())
    }

    /// Plans shards: the lines of pieces, and those of whole parts.
    fn plan(&self, out: &str, count: &str) -> (Vec<Value>, Vec<Value>) {
        let output = self.job("plan", out, &["--set", TRACES, "--shards", count, "--format", "json"]);
        let lines: Vec<Value> = serde_json::from_slice(&output.stdout).unwrap();
        lines.into_iter().partition(|line| line["pieces"].is_u64())
    }

    fn make(&self, line: &Value, out: &str) -> Value {
        serde_json::from_slice(&self.output(&shard(line, out)).stdout).unwrap()
    }

    fn make_all<'a>(&self, lines: impl IntoIterator<Item = &'a Value>, out: &str) {
        lines.into_iter().for_each(|line| drop(self.make(line, out)));
    }

    fn gather(&self, out: &str) -> String {
        errors(&self.output(&["gather", "--out", out, "--progress", "none"]))
    }

    /// What lies in the folder of the shards.
    fn left_of_shards(&self, out: &str) -> Vec<String> {
        let entries = fs::read_dir(self.0.path(out).join(".shelf/shards")).unwrap().flatten();
        entries.map(|entry| entry.file_name().into_string().unwrap()).collect()
    }

    /// Plans, makes and gathers. Every table file must equal that of a single run. Returns the number of pieces, and
    /// the messages.
    fn joins(&self, count: &str) -> (usize, String) {
        let (pieces, whole) = self.plan("out", count);
        self.make_all(pieces.iter().rev().chain(&whole), "out");
        let said = self.gather("out");
        self.job("run", "single", &["--set", TRACES]);
        assert_eq!(self.0.parts("out"), self.0.parts("single"));
        assert_eq!(self.left_of_shards("out"), ["gathered.json"]);
        (pieces.len(), said)
    }

    /// Changes the codes of one shot of a file of codes of 8 or 16 bits.
    fn spoil(file: &Path, shot: usize, change: impl Fn(usize, i16) -> i16) {
        let records = formats::records(&mut formats::Source::open(file).unwrap()).unwrap();
        let (at, length) = (records[shot].contiguous().unwrap().0 as usize, records[shot].code_bytes());
        let width = records[shot].head.code_type.bytes();
        let mut bytes = fs::read(file).unwrap();
        for (n, code) in bytes[at..at + length].chunks_exact_mut(width).enumerate() {
            match code {
                [code] => *code = change(n, i16::from(*code as i8)).clamp(-128, 127) as i8 as u8,
                _ => code.copy_from_slice(&change(n, i16::from_le_bytes([code[0], code[1]])).to_le_bytes()),
            }
        }
        fs::write(file, bytes).unwrap();
    }
}

/// Some noise of a few codes.
fn noise(n: usize) -> i16 {
    (blake3::hash(&n.to_le_bytes()).as_bytes()[0] % 7).into()
}

fn key(line: &Value) -> &str {
    line["key"].as_str().unwrap()
}

fn shard<'a>(line: &'a Value, out: &'a str) -> [&'a str; 8] {
    ["run-shard", key(line), "--out", out, "--threads", "1", "--progress", "none"]
}

#[test]
fn a_capture_of_many_shots_is_made_in_pieces_with_the_bytes_of_a_single_run() {
    let large = Large::corner();
    let (pieces, whole) = large.plan("out", "8");
    assert!(pieces.len() >= 5 && !whole.is_empty() && pieces.len() + whole.len() == 8, "{pieces:?}");
    let shots = |line: &Value| line["shots"]["raw/scene/s1_L2_P3_C1.trc"].as_array().unwrap().clone();
    assert!(pieces.windows(2).all(|pair| shots(&pair[0])[1] == shots(&pair[1])[0]), "{pieces:?}");
    let bytes = |line: &Value| line["bytes"].as_u64().unwrap();
    let (least, most) = (pieces.iter().map(bytes).min().unwrap(), pieces.iter().map(bytes).max().unwrap());
    assert!(most < 2 * least, "{least} {most}");
    // One is killed, another made twice.
    let mut killed = large.periscope(&shard(&pieces[2], "out")).spawn().unwrap();
    std::thread::sleep(Duration::from_millis(15));
    killed.kill().unwrap();
    killed.wait().unwrap();
    let first = large.make(&pieces[3], "out");
    let mut again = large.make(&pieces[3], "out");
    assert_eq!((first["computed"].as_u64(), again["computed"].as_u64()), (Some(1), Some(0)));
    again["computed"] = 1.into();
    assert_eq!(again, first);
    let text = large.refused(&["gather", "--out", "out"]);
    assert!(text.contains("shards are not finished") && text.contains(key(&pieces[0])), "{text}");
    large.make_all(pieces.iter().rev().chain(&whole), "out");
    assert!(!large.0.path("out/profiles").exists(), "nothing is shown before it is gathered");
    large.gather("out");
    large.job("run", "single", &["--set", TRACES]);
    assert_eq!(large.0.parts("out"), large.0.parts("single"));
    let profile: Vec<Profile> = large.0.rows("out", "profiles");
    let profile = profile.iter().find(|profile| (profile.lit, profile.seen) == (2, 3)).unwrap();
    assert!(profile.shots > 1400 && profile.reference_ps.is_some());
    assert_eq!(large.left_of_shards("out"), ["gathered.json"]);
    // An engine that asks again for what is done is not refused, and nothing is done.
    assert!(large.gather("out").contains("nothing to do"));
    assert!(errors(&large.output(&shard(&pieces[0], "out"))).contains("nothing to do"));
    assert!(errors(&large.output(&shard(&whole[0], "out"))).contains("nothing to do"));
    large.output(&["verify", "out"]);
    assert_eq!(large.plan("out", "8"), (Vec::new(), Vec::new()));
}

/// Two vertical ranges, each with its own first shots; clipped and outlying shots far behind these.
#[test]
fn pieces_of_several_ranges_judge_their_shots_as_a_single_run_does() {
    let scene = crate::vertical_ranges::TWO_RANGES.replace("shots = 400\n", "shots = 900\n");
    let lab = Lab::of(&scene, 1, Format::Trc);
    let pipeline = crate::lab::ALL_VISIBLE.split_once("[onsets]").unwrap().0;
    let large = Large::of(lab, 50_000, pipeline);
    for range in ["fine", "coarse"] {
        let file = large.raw(&format!("scene/{range}/od2.5/s1_L7_P7_C1.trc"));
        (500..520).for_each(|shot| Large::spoil(&file, shot, |n, code| if n == 200 { code + 60 } else { code }));
        (700..710).for_each(|shot| Large::spoil(&file, shot, |n, code| if n > 300 { i16::MAX } else { code }));
    }
    let toml = large.0.campaign().join("campaign.toml");
    let keys = fs::read_to_string(&toml).unwrap();
    // The reference pulses repeat, as for a pulsed laser, so each might be taken for the one next to the first.
    for (count, more) in [("7", ""), ("23", "repetition_ps = 900.0\n")] {
        fs::write(&toml, keys.replacen("part_bytes", &format!("{more}part_bytes"), 1)).unwrap();
        let (pieces, said) = large.joins(count);
        assert!(pieces >= 5 && !said.contains("computed whole"), "{pieces} {said}");
    }
    let profile = large.0.rows::<Profile>("out", "profiles").into_iter().find(|row| &*row.role == "scene").unwrap();
    assert!(profile.rejected >= 40, "{} {}", profile.rejected, profile.clipped);
}

#[test]
fn arrays_without_jitter_and_photon_histograms_are_cut_too() {
    for keys in ["", "kind = 'counts'\ncycles = 1000\n"] {
        let (pieces, said) = Large::arrays(keys, &[30, 2000, 10]).joins("9");
        assert!(pieces >= 7 && !said.contains("computed whole"), "{pieces} {said}");
    }
}

/// A shot a file: pieces of whole files. The last but one is cut short, which shows only when it is read.
#[test]
fn a_capture_of_many_files_is_cut_between_them_and_computed_whole_where_one_is_bad() {
    let large = Large::arrays("", &[20, 30]);
    let file = large.0.campaign().join("campaign.toml");
    let keys = fs::read_to_string(&file).unwrap();
    fs::write(
        &file,
        format!("{keys}{}", &keys[keys.find("[[captures]]").unwrap()..]).replacen(
            "P{seen}.npy",
            "P{seen}-{shot}.npy",
            1,
        ),
    )
    .unwrap();
    for shot in 0..300 {
        large.write(&format!("L5_P1-{shot}.npy"), &(0..200).map(|n| noise(shot * 200 + n)).collect::<Vec<_>>());
    }
    let (pieces, said) = large.joins("6");
    assert!(pieces >= 2 && !said.contains("computed whole"), "{pieces} {said}");
    fs::write(large.raw("L5_P1-298.npy"), b"\x93NUMPY").unwrap();
    ["out", "single"].iter().for_each(|out| fs::remove_dir_all(large.0.path(out)).unwrap());
    let (pieces, said) = large.joins("6");
    assert!(pieces >= 2 && said.contains("is computed whole: raw/L5_P1-298.npy"), "{pieces} {said}");
}

#[test]
fn changed_files_and_damaged_pieces_are_refused_by_name() {
    let large = Large::arrays("", &[2000, 10]);
    let file = large.raw("L1_P1.npy");
    let (pieces, whole) = large.plan("out", "6");
    large.make_all(pieces.iter().skip(1).chain(&whole), "out");
    // Changed after it was planned: by size and time, before anything of it is read.
    let content = fs::read(&file).unwrap();
    let time = fs::metadata(&file).unwrap().modified().unwrap();
    // Also with the same size and time of modification.
    let spoil = || {
        Large::spoil(&file, 1500, |_, code| code + 1);
        fs::File::options().append(true).open(&file).unwrap().set_modified(time).unwrap();
    };
    let plan_anew = || {
        fs::write(&file, &content).unwrap();
        let (pieces, whole) = large.plan("out", "6");
        large.make_all(pieces.iter().chain(&whole), "out");
        pieces
    };
    spoil();
    let text = large.refused(&shard(&pieces[0], "out"));
    assert!(text.contains("L1_P1.npy has changed since it was planned; plan anew"), "{text}");
    plan_anew();
    // Changed after its pieces were read.
    spoil();
    let text = large.refused(&["gather", "--out", "out"]);
    assert!(text.contains("L1_P1.npy has changed since a piece of it was read"), "{text}");
    let pieces = plan_anew();
    // A flipped bit in what a piece has left.
    let left = large.0.path(&format!("out/.shelf/shards/{}.subtotals.parquet", key(&pieces[2])));
    let mut bytes = fs::read(&left).unwrap();
    bytes[40] ^= 4;
    fs::write(&left, bytes).unwrap();
    let text = large.refused(&["gather", "--out", "out"]);
    let fix = format!("`periscope run-shard {} --out out` makes it again", key(&pieces[2]));
    assert!(text.contains(&fix) && text.contains("subtotals.parquet is damaged"), "{text}");
    assert_eq!(large.make(&pieces[2], "out")["computed"], 1);
    // One that is gone.
    fs::remove_file(&left).unwrap();
    let text = large.refused(&["gather", "--out", "out"]);
    assert!(text.contains(&format!("run-shard {} --out", key(&pieces[2]))), "{text}");
    large.make(&pieces[2], "out");
    // As anybody reads it.
    let rows: Vec<Subtotal> = periscope::store::parquet::read(&left, 100)
        .unwrap()
        .flat_map(|batch| periscope::tables::Row::rows(&batch.unwrap()).unwrap())
        .collect();
    assert!(rows.iter().filter(|row| row.phase.is_some()).map(|row| row.shots).sum::<i64>() > 200, "{rows:?}");
    large.gather("out");
    large.job("run", "single", &["--set", TRACES]);
    assert_eq!(large.0.parts("out"), large.0.parts("single"));
}

#[test]
fn finished_pieces_are_kept_by_the_next_plan_and_a_run_does_without_them() {
    let large = Large::arrays("", &[300, 2000, 200, 400]);
    let (pieces, whole) = large.plan("out", "8");
    large.make_all(pieces.iter().take(2).chain(&whole), "out");
    let (left, none) = large.plan("out", "8");
    assert_eq!((left.as_slice(), none.len()), (&pieces[2..], 0), "the same pieces, though less is missing");
    // Not of a file that has changed by then: what the first pieces have read is unknown.
    let file = fs::File::options().append(true).open(large.raw("L2_P1.npy")).unwrap();
    let time = file.metadata().unwrap().modified().unwrap();
    file.set_modified(time + Duration::from_secs(1)).unwrap();
    assert!(large.plan("touched", "8").0.len() == pieces.len() && large.plan("out", "8").0.len() > left.len());
    file.set_modified(time).unwrap();
    let (again, _) = large.plan("out", "8");
    large.make_all(&again[..2], "out");
    // A run follows instead.
    large.job("run", "out", &["--set", TRACES]);
    large.job("run", "single", &["--set", TRACES]);
    assert_eq!(large.0.rows::<Profile>("out", "profiles"), large.0.rows::<Profile>("single", "profiles"));
    let pruned = String::from_utf8(large.output(&["tables", "out", "--prune"]).stdout).unwrap();
    assert!(pruned.contains("removed  some   shards      2 "), "{pruned}");
    assert_eq!(large.0.parts("out"), large.0.parts("single"));
}

#[test]
fn what_cannot_be_cut_is_said_with_its_reason() {
    let large = Large::arrays("", &[2000, 10]);
    let kept = errors(&large.job("plan", "kept", &["--set", "traces.codes='zstd'", "--shards", "6"]));
    assert!(kept.contains("is not cut") && kept.contains("--set traces.keep=false"), "{kept}");
    let floats: Vec<f32> = (0..2000 * 200).map(|n| f32::from(noise(n))).collect();
    let mut file = BufWriter::new(fs::File::create(large.raw("L1_P1.npy")).unwrap());
    formats::npy::write(&mut file, &[2000, 200], &floats).unwrap();
    drop(file);
    let output = large.job("plan", "out", &["--set", TRACES, "--shards", "6"]);
    assert!(errors(&output).contains("L1_P1.npy has codes in floating point"), "{}", errors(&output));
    let listed = String::from_utf8(output.stdout).unwrap();
    let pieces = |row: &str| row.split_whitespace().count() > 5;
    assert!(!listed.lines().skip(1).any(pieces), "{listed}");
    // A history of 2,000 acquisitions of an RTO: settings in one file, samples in another.
    let file = large.0.campaign().join("campaign.toml");
    fs::write(&file, fs::read_to_string(&file).unwrap().replace("{seen}.npy", "{seen}.bin")).unwrap();
    let property = |(name, value): (&str, &str)| format!("<Prop Name=\"{name}\" Value=\"{value}\" UnitName=\"s\"/>");
    let head: String = HISTORY.map(property).concat();
    fs::write(large.raw("L1_P1.bin"), format!("<Database>{head}</Database>")).unwrap();
    let codes = (0..2000 * 200).map(|n| noise(n) as u8);
    let samples: Vec<u8> = [0_u32, 200].into_iter().flat_map(u32::to_le_bytes).chain(codes).collect();
    fs::write(large.raw("L1_P1.Wfm.bin"), samples).unwrap();
    let output = large.job("plan", "out", &["--set", TRACES, "--shards", "6"]);
    assert!(errors(&output).contains("L1_P1.bin has its samples in a second file"), "{}", errors(&output));
    let (pieces, said) = large.joins("6");
    assert!(pieces == 0 && large.0.rows::<Profile>("out", "profiles")[0].shots == 2000, "{pieces} {said}");
}

/// What the head of a Rohde & Schwarz recording says.
const HISTORY: [(&str, &str); 18] = [
    ("SourceType", "eRS_SIGNAL_SOURCE_TYPE_SOURCE"),
    ("TraceType", "eRS_TRACE_TYPE_NORMAL"),
    ("BaseUnit", "eRS_UNIT_LEVEL_V"),
    ("XStart", "0"),
    ("XStop", "1e-8"),
    ("NofQuantisationLevels", "250"),
    ("VerticalDivisionCount", "10"),
    ("VerticalScale", "0.5"),
    ("VerticalOffset", "0"),
    ("VerticalPosition", "0"),
    ("Source", "eRS_SIGNAL_SOURCE_CH1_TR1"),
    ("MultiChannelExport", "eRS_ONOFF_OFF"),
    ("NumberOfAcquisitions", "2000"),
    ("TimestampState", "eRS_ONOFF_OFF"),
    ("SignalFormat", "eRS_SIGNAL_FORMAT_INT8BIT"),
    ("RecordLength", "200"),
    ("SignalHardwareRecordLength", "200"),
    ("LeadingSettlingSamples", "0"),
];
