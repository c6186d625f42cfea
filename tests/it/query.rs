//! `periscope query`, in builds that have it.

use std::process::Command;

use crate::lab::Lab;

#[test]
fn sql_sees_every_table_under_its_own_name() {
    let lab = Lab::tiny();
    lab.rows_of_patches("out");
    let ask = |sql: &str, format: &str| {
        let output = Command::new(env!("CARGO_BIN_EXE_periscope"))
            .args(["query", "out", sql, "--format", format])
            .current_dir(lab.path(""))
            .output()
            .unwrap();
        (
            output.status.code(),
            String::from_utf8_lossy(&output.stdout).into_owned(),
            String::from_utf8_lossy(&output.stderr).into_owned(),
        )
    };
    let (code, text, error) = ask("SELECT COUNT(*) AS n FROM patches", "csv");
    assert_eq!((code, text.trim()), (Some(0), "n\n4"), "{error}");
    let (_, text, error) = ask(
        "SELECT l.lit, l.seen, r.residual_ps FROM labels l JOIN \"patches.residuals\" r ON l.lit = r.lit AND l.seen = r.seen WHERE r.suspect",
        "json",
    );
    assert!(text.is_empty(), "{text}{error}");
    let (_, text, error) = ask("SELECT lit, seen, codes FROM traces WHERE is_reference LIMIT 2", "csv");
    assert!(text.starts_with("lit,seen"), "{text}{error}");
    let (code, _, error) = ask("SELECT * FROM patchs", "table");
    assert!(code == Some(1) && error.contains("patchs"), "{error}");
}
