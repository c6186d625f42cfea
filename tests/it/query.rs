//! `periscope query`, in builds that have it.

use std::process::Command;
use std::sync::LazyLock;

use periscope::pipeline::run::Settings;
use periscope::tables::Trace;

use crate::lab::{ALL_VISIBLE, Lab};

fn ask(lab: &Lab, sql: &str, format: &str) -> (Option<i32>, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_periscope"))
        .args(["query", "out", sql, "--format", format])
        .current_dir(lab.path(""))
        .output()
        .unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code(), text(&output.stdout), text(&output.stderr))
}

static LAB: LazyLock<Lab> = LazyLock::new(|| {
    let lab = Lab::tiny();
    let archived = ["traces.codes='zstd'".to_owned()];
    lab.run_with("out", ALL_VISIBLE, &archived, &Settings::default()).unwrap();
    lab
});

#[test]
fn sql_sees_every_table_under_its_own_name() {
    let (code, text, error) = ask(&LAB, "SELECT COUNT(*) AS n FROM patches", "csv");
    assert_eq!((code, text.trim()), (Some(0), "n\n4"), "{error}");
    // A name with a dot is one name, with quotes and without.
    for name in ["\"patches.residuals\"", "patches.residuals"] {
        let sql =
            format!("SELECT l.lit, r.residual_ps FROM labels l JOIN {name} r ON l.lit = r.lit AND l.seen = r.seen");
        let (_, text, error) = ask(&LAB, &sql, "json");
        assert_eq!(text.lines().count(), 16, "{text}{error}");
    }
    // What nothing in the campaign concerns is an empty table.
    let (code, text, error) = ask(&LAB, "SELECT COUNT(*) AS n FROM session_traces", "csv");
    assert_eq!((code, text.trim()), (Some(0), "n\n0"), "{error}");
    let rejects = ask(&LAB, "SELECT reason FROM rejects", "csv");
    assert_eq!((rejects.0, rejects.1.trim()), (Some(0), "reason"), "{}", rejects.2);
}

#[test]
fn lists_and_bytes_have_a_form_in_every_format() {
    let traces: Vec<Trace> = LAB.rows("out", "traces");
    let hex = traces[0].codes.as_ref().unwrap().iter().fold(String::new(), |hex, byte| hex + &format!("{byte:02x}"));
    let sql = "SELECT codes FROM traces LIMIT 1";
    assert_eq!(ask(&LAB, sql, "csv").1, format!("codes\n{hex}\n"));
    assert_eq!(ask(&LAB, sql, "json").1, format!("{{\"codes\":\"{hex}\"}}\n"));
    assert_eq!(ask(&LAB, sql, "table").1, "codes\n320 bytes\n");
    let sql = "SELECT path FROM labels WHERE lit = 3 AND seen = 4";
    assert_eq!(ask(&LAB, sql, "csv").1, "path\n\"[3, 4]\"\n");
    assert_eq!(ask(&LAB, sql, "json").1, "{\"path\":[3,4]}\n");
    let (_, impulses, error) = ask(&LAB, "SELECT impulses FROM stir LIMIT 1", "csv");
    assert!(impulses.contains("[{\"\"time_ps\"\": "), "{impulses}{error}");
    let (code, _, error) = ask(&LAB, "SELECT * FROM stir", "parquet");
    assert_eq!(code, Some(0), "{error}");
}

#[test]
fn tables_for_the_eye_have_all_rows_and_columns() {
    let (_, text, error) = ask(&LAB, "SELECT lit, seen, time_ps, snr, flags FROM onsets", "table");
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines.len(), 17, "{text}{error}");
    assert_eq!(lines[0].split_whitespace().collect::<Vec<_>>(), ["lit", "seen", "time_ps", "snr", "flags"]);
    let starts: Vec<usize> = lines.iter().map(|line| line.rfind('[').unwrap_or(line.len() - "flags".len())).collect();
    assert!(starts.iter().all(|start| *start == starts[0]), "columns stand below one another:\n{text}");
}

#[test]
fn a_query_that_names_what_is_not_there_lists_what_is() {
    for (sql, words) in [
        ("SELECT * FROM patchs", "no table `patchs`; did you mean `patches`?"),
        ("SELECT time_pss FROM onsets", "no column `time_pss` in onsets; did you mean `time_ps`?"),
        ("SELECT o.time_pss FROM onsets o JOIN labels l ON o.lit = l.lit", "did you mean `time_ps`?"),
        ("SELECT time_ps FRM onsets", "Line: 1"),
    ] {
        let (code, _, error) = ask(&LAB, sql, "table");
        assert!(code == Some(1) && error.contains(words), "{sql}: {error}");
    }
}
