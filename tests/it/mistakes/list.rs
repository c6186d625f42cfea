//! The mistakes.

/// What is done to the folder before the command.
#[derive(Debug)]
pub enum Edit {
    /// In this file, this text becomes that.
    Replace(&'static str, &'static str, &'static str),
    /// This text comes at the end of this file.
    Append(&'static str, &'static str),
    /// The files of this folder go.
    Empty(&'static str),
    /// This file holds these bytes.
    Write(&'static str, &'static [u8]),
    /// This file ends after this number of bytes.
    Cut(&'static str, u64),
    /// This folder comes a second time, as that.
    Copy(&'static str, &'static str),
    /// All arrays of this folder are written the other way round: samples, shots.
    Transpose(&'static str),
    /// In this array, one sample of every shot is no number.
    Spoil(&'static str),
}
use Edit::{Append, Copy, Cut, Empty, Replace, Spoil, Transpose};

/// A mistake, the command that meets it, and words of the answer: the place, and the fix.
pub struct Mistake(pub &'static [Edit], pub &'static str, pub &'static str, pub &'static str);

const CAMPAIGN: &str = "campaign/campaign.toml";
const ARRAYS: &str = "arrays/campaign.toml";
const RUN: &str = "run pipeline.toml --campaign campaign --out new";
const RUN_ARRAYS: &str = "run pipeline.toml --campaign arrays --out new";
const SCENE_REFERENCE: &str = "reference = { files = \"raw/scene/{sensor}_L{lit}_P{seen}_C2.trc\" }\n";

/// In the order in which a newcomer goes: files and folders, campaign.toml, raw files, pipeline, results, scene.
pub const MISTAKES: &[Mistake] = &[
    // What stands on the command line.
    Mistake(&[], "run pipelin.toml --campaign campaign --out new", "pipelin.toml", "did you mean `pipeline.toml`?"),
    Mistake(&[], "run campaign", "campaign is a campaign", "`periscope run --campaign campaign`"),
    Mistake(&[], "run arrays --campaign campaign", "arrays is a campaign", "`periscope run --campaign arrays`"),
    Mistake(&[], "run ./campaign/raw --campaign campaign --out new", "pipeline ./campaign/raw", "it is a folder"),
    Mistake(&[], "run mirorr --campaign campaign", "unknown pipeline `mirorr`", "did you mean `mirror`?"),
    Mistake(&[], "run pipelines/mirror.toml --campaign campaign", "pipelines/mirror.toml", "write `mirror`"),
    Mistake(&[], "run visible --campaign campaign", "`visible` is now part of `scene`", "write `scene`"),
    Mistake(&[], "run pipelines/visible.toml --campaign campaign", "pipelines/visible.toml", "write `scene`"),
    Mistake(&[], "pipelines mirrors", "unknown pipeline `mirrors`", "did you mean `mirror`?"),
    Mistake(&[], "run --campaign campaign --campaign arrays", "2 campaigns", "--out DIR"),
    Mistake(
        &[],
        "run campaign/campaign.toml --campaign campaign --out new",
        "campaign.toml",
        "give its folder with --campaign",
    ),
    Mistake(&[], "run scene.toml --campaign campaign --out new", "scene.toml", "for `simulate` and `design`"),
    Mistake(&[], "run pipeline.toml --campaign campain --out new", "campain/campaign.toml", "a campaign folder holds"),
    Mistake(
        &[],
        "run pipeline.toml --campaign campaign/campaign.toml --out new",
        "campaign/campaign.toml",
        "give the folder, campaign",
    ),
    Mistake(
        &[],
        "run pipeline.toml --campaign pipeline.toml --out new",
        "pipeline.toml",
        "is a file, and a campaign is a folder",
    ),
    Mistake(&[], "run pipeline.toml --campaign campaign --campaign ./campaign --out new", "./campaign", "take one out"),
    Mistake(
        &[Copy("campaign", "day2")],
        "run pipeline.toml --campaign campaign --campaign day2 --out new",
        "day2",
        "change `name`",
    ),
    Mistake(
        &[],
        "run pipeline.toml --campaign campaign --out campaign",
        "campaign holds other files",
        "choose another --out",
    ),
    Mistake(
        &[],
        "run pipeline.toml --campaign campaign --out new --until patchs",
        "--until",
        "did you mean `patches`?",
    ),
    Mistake(
        &[],
        "run pipeline.toml --campaign campaign --out new --set onset.threshold_sigma=6",
        "--set onset.threshold_sigma=6",
        "did you mean `onsets`?",
    ),
    Mistake(
        &[],
        "run pipeline.toml --campaign campaign --out new --set onsets.threshold=6",
        "[onsets]",
        "did you mean `threshold_sigma`?",
    ),
    Mistake(
        &[],
        "run pipeline.toml --campaign campaign --out new --set onsets.threshold_sigma=high",
        "[onsets]: params.threshold_sigma = \"high\"",
        "must be 0 or more and finite (default 5)",
    ),
    Mistake(
        &[],
        "run pipeline.toml --campaign campaign --out new --set profiles.outlier_sigma=-6",
        "[profiles]: params.outlier_sigma = -6",
        "must be above 0 and finite (default 6)",
    ),
    Mistake(
        &[],
        "run pipeline.toml --campaign campaign --out new --set stir.evidence=inf",
        "[stir]: params.evidence = inf",
        "must be above 0 and finite (default absent)",
    ),
    Mistake(
        &[],
        "run pipeline.toml --campaign campaign --out new --set stir.lowpass_ghz=2",
        "[stir]: params.lowpass_ghz = 2",
        "only while it is `wiener`",
    ),
    Mistake(
        &[],
        "run pipeline.toml --campaign campaign --out new --set stir.method=nnls",
        "[stir]: params.method = \"nnls\": `nnls` is no longer in the program",
        "use `sparse`",
    ),
    Mistake(
        &[],
        "run pipeline.toml --campaign campaign --out new --set start.method=smacof",
        "`smacof` is no longer in the program",
        "use `incremental`",
    ),
    Mistake(&[], "inspect campaign", "campaign", "name the files in it, such as campaign/*"),
    Mistake(&[], "inspect scene.toml", "scene.toml", "see docs/formats.md"),
    // campaign.toml
    Mistake(&[Replace(CAMPAIGN, "path_sd_m", "path_sd")], RUN, "line 28", "did you mean `path_sd_m`?"),
    Mistake(&[Replace(ARRAYS, "dt_ps", "dt_ns")], RUN_ARRAYS, "[[captures]] number 1", "did you mean `dt_ps`?"),
    Mistake(&[Replace(CAMPAIGN, "\"tiny\"", "tiny")], RUN, "line 3", "put text in quotes"),
    Mistake(
        &[Replace(CAMPAIGN, "sensor = \"s1\"", "sensor = \"S1\"")],
        RUN,
        "[[captures]] number 1",
        "did you mean `s1`?",
    ),
    Mistake(
        &[
            Replace(CAMPAIGN, "{sensor}_L", "s1_L"),
            Replace(CAMPAIGN, "{sensor}_L", "s1_L"),
            Append(CAMPAIGN, "[sensors.s2]\n"),
        ],
        RUN,
        "[[captures]] number 2",
        "put {sensor} into the pattern",
    ),
    Mistake(&[Replace(CAMPAIGN, "_P{seen}_C1", "_C1")], RUN, "[[captures]] number 2", "put {seen} into the pattern"),
    Mistake(
        &[Replace(CAMPAIGN, "path_m = 1.0", "path_m = -1.0")],
        RUN,
        "[[captures]] number 1",
        "give a positive number",
    ),
    Mistake(
        &[Replace(CAMPAIGN, "\"raw/response/s1_C1.trc\"", "'raw\\response\\s1_C1.trc'")],
        RUN,
        "[[captures]] number 1",
        "separate folders by `/`",
    ),
    Mistake(
        &[Append(CAMPAIGN, "[[captures]]\nrole = \"scene\"\nfiles = \"raw/scene/{sensor}_L{lit}_P{seen}_C1.trc\"\n")],
        RUN,
        "[[captures]] number 2 and by [[captures]] number 3",
        "narrow one of them",
    ),
    Mistake(
        &[Append(CAMPAIGN, "[[captures]]\ntable = \"captures.csv\"\n")],
        RUN,
        "captures.csv",
        "seen from the campaign folder",
    ),
    Mistake(
        &[Replace(CAMPAIGN, "raw/response/s1_C1.trc", "raw/response/s1_C2.trc")],
        RUN,
        "[[captures]] number 1",
        "as signal and as reference",
    ),
    Mistake(
        &[Replace(CAMPAIGN, "raw/scene/{sensor}_L{lit}_P{seen}_C1", "raw/scenes/{sensor}_L{lit}_P{seen}_C1")],
        RUN,
        "[[captures]] number 2",
        "`patches`, `paper` are empty",
    ),
    Mistake(
        &[Append(CAMPAIGN, "[[exclude]]\nmatch = { role = \"scene\" }\nreason = \"try\"\n")],
        RUN,
        "`traces` has no rows",
        "none of the captures that it takes",
    ),
    // Captures that do not fit together.
    Mistake(
        &[Empty("campaign/raw/response")],
        RUN,
        "campaign/campaign.toml: no file shows the impulse response of sensor `s1`",
        "match no file of it: copy the files",
    ),
    Mistake(
        &[
            Replace(CAMPAIGN, "role = \"response\"", "role = \"dark\""),
            Replace(CAMPAIGN, "path_m = 1.0\npath_sd_m = 0.0001\n", ""),
        ],
        RUN,
        "campaign/campaign.toml: no file shows the impulse response of sensor `s1`, which [stir]",
        "add { role = \"response\", sensor = \"s1\"",
    ),
    Mistake(
        &[Replace(CAMPAIGN, "path_m = 1.0\npath_sd_m = 0.0001\n", "")],
        RUN,
        "sensor s1 is not calibrated: its latency is unknown",
        "`path_m` in campaign.toml",
    ),
    Mistake(
        &[Replace(CAMPAIGN, "path_m = 1.0", "path_m = 1000.0")],
        RUN,
        "raw/response/s1_C1.trc",
        "path_m = 1000: is it in m?",
    ),
    Mistake(
        &[Replace(CAMPAIGN, "reference = { files = \"raw/response/s1_C2.trc\" }\n", "")],
        RUN,
        "response captures of sensor `s1`",
        "the `reference` too",
    ),
    Mistake(
        &[Replace(CAMPAIGN, SCENE_REFERENCE, "")],
        RUN,
        "raw/scene/s1_L1_P1_C1.trc",
        "give its [[captures]] rule the `reference` too",
    ),
    Mistake(
        &[Replace(CAMPAIGN, SCENE_REFERENCE, "reference = { channel = \"C2\" }\n")],
        RUN,
        "raw/scene/s1_L1_P1_C1.trc: has no channel `C2`; it has C1",
        "correct `channel` or `reference`",
    ),
    Mistake(
        &[Replace(
            CAMPAIGN,
            "[sensors.s1]",
            "[sensors.s1]\nstation = \"aside\"\n[stations.aside]\nposition_m = [0.3, 0.0, 0.0]",
        )],
        RUN,
        "[distances]",
        "leave out `range` and `embed`",
    ),
    Mistake(&[], "run barcode.toml --campaign campaign --out new", "[patches.1] in campaign.toml", "add `position_m`"),
    // Raw files.
    Mistake(
        &[Edit::Write("campaign/raw/scene/s1_L1_P2_C1.trc", b"")],
        RUN,
        "raw/scene/s1_L1_P2_C1.trc",
        "may have been interrupted",
    ),
    Mistake(
        &[Cut("campaign/raw/scene/s1_L1_P2_C1.trc", 3000)],
        RUN,
        "raw/scene/s1_L1_P2_C1.trc",
        "copy it from the instrument again",
    ),
    Mistake(
        &[Edit::Write("campaign/raw/scene/s1_L1_P2_C1.trc", b"\x89PNG\r\n\x1a\n, a screenshot")],
        RUN,
        "raw/scene/s1_L1_P2_C1.trc",
        "this is no LeCroy waveform",
    ),
    Mistake(
        &[Edit::Write("campaign/raw/scene/s1_L1_P2_C1 (1).trc", b"a copy")],
        RUN,
        "s1_L1_P2_C1 (1).trc",
        "matches no rule of campaign.toml",
    ),
    Mistake(
        &[Replace(CAMPAIGN, "path_m = 1.0", "samples = [0, 5000]\npath_m = 1.0")],
        RUN,
        "raw/response/s1_C1.trc: has 320 samples",
        "end it at 320",
    ),
    Mistake(&[Replace(ARRAYS, "dt_ps = 50.0\n", "")], RUN_ARRAYS, "raw/response/s1_C2.npy", "give dt_ps"),
    Mistake(
        &[Replace(ARRAYS, "dt_ps = 50.0", "dt_ps = 0.05")],
        RUN_ARRAYS,
        "raw/response/s1_C1.npy",
        "is `dt_ps` in ps?",
    ),
    Mistake(
        &[Transpose("arrays/raw/scene")],
        RUN_ARRAYS,
        "raw/scene/s1_L1_P1_C1.npy",
        "are the axes of the array in the order shots, samples?",
    ),
    Mistake(
        &[Replace(ARRAYS, "segments = \"shot\"", "segments = [\"range\", \"shot\"]")],
        RUN_ARRAYS,
        "arrays/raw/response/s1_C1.npy",
        "such as segments = \"shot\"",
    ),
    Mistake(&[Spoil("arrays/raw/scene/s1_L1_P2_C1.npy")], RUN_ARRAYS, "raw/scene/s1_L1_P2_C1.npy", "no number"),
    // The pipeline.
    Mistake(
        &[Replace("pipeline.toml", "stage = \"detect\"", "stage = \"detct\"")],
        RUN,
        "[onsets]",
        "did you mean `detect`?",
    ),
    Mistake(
        &[Replace("pipeline.toml", "from = \"stir\"", "from = \"stirs\"")],
        RUN,
        "[onsets]: from",
        "did you mean `stir`?",
    ),
    Mistake(
        &[Replace("pipeline.toml", "from = \"stir\"", "from = \"profiles\"")],
        RUN,
        "[onsets]: from",
        "a table `stir` is needed",
    ),
    Mistake(
        &[Replace("pipeline.toml", "from = \"calibration_traces\"", "from = \"stir\"")],
        RUN,
        "[calibration]",
        "take one `from` or `with`",
    ),
    Mistake(
        &[Replace("pipeline.toml", "params = { shots_min = 16 }", "shots_min = 16")],
        RUN,
        "[profiles]",
        "stands in `params = { ... }`",
    ),
    Mistake(
        &[Replace("pipeline.toml", "roles = [\"scene\"]", "roles = [\"scenes\"]")],
        RUN,
        "[traces]: params",
        "did you mean `scene`?",
    ),
    Mistake(
        &[],
        "run pipeline.toml --campaign campaign --out new --set profiles.shots_min=100",
        "raw/scene/s1_L1_P1_C1.trc",
        "24 valid shots of the 100",
    ),
    // Results.
    Mistake(&[], "tables reslts", "reslts does not exist", "next to it are results in results"),
    Mistake(&[], "tables campaign", "campaign is no result folder", "`periscope run ... --out DIR`"),
    Mistake(&[], "diff results reslts", "reslts does not exist", "next to it are results in results"),
    Mistake(&[], "explain results patch=99", "`patches` has no patch 99", "it has 1, 2, 3, 4"),
    Mistake(&[], "explain results pach=3", "pach=3", "did you mean `patch`?"),
    Mistake(&[], "explain results patch=3 --table patchs", "--table", "did you mean `patches`?"),
    Mistake(&[], "schema onset", "onset", "did you mean `onsets`?"),
    // The scene.
    Mistake(
        &[Replace("scene.toml", "jitter_ps", "jitter_ns")],
        "simulate scene.toml --out new",
        "line 37",
        "did you mean `jitter_ps`?",
    ),
    Mistake(
        &[Replace("scene.toml", "[0.866921447, 0.472866244, -0.157622081]", "[1.0, 1.0, 0.0]")],
        "simulate scene.toml --out new",
        "[patches.1]",
        "write [0.707107, 0.707107, 0.000000]",
    ),
    Mistake(&[], "simulate scene.toml --out campaign", "campaign is not empty", "choose another folder"),
];
