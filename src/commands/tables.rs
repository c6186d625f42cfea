//! `periscope tables`.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use clap::Args;
use periscope::store::{Shelf, TableRecord};

/// Arguments of `tables`.
#[derive(Args)]
pub struct Tables {
    /// Result folder
    out: PathBuf,
}

/// The command.
pub fn tables(args: &Tables) -> Result<ExitCode> {
    let shelf = Shelf::look(&args.out)?;
    println!("{:28} {:12} {:>10} {:>12} {:>6}  {:16}  made", "table", "stage", "rows", "bytes", "parts", "lineage");
    for (view, record) in shelf.tables()? {
        let TableRecord { lineage, stage, parts } = &record;
        let Some(table) = shelf.table_of(&view) else {
            continue;
        };
        let made = shelf.made(&view).map(date).unwrap_or_default();
        let (rows, bytes) = (record.rows(&table), record.bytes(&table));
        println!(
            "{view:28} {:12} {rows:>10} {bytes:>12} {:>6}  {:16}  {made}",
            stage.kind,
            parts.len(),
            lineage.short()
        );
    }
    Ok(ExitCode::SUCCESS)
}

/// Date and time of day (UTC) of a moment, as in ISO 8601.
fn date(moment: std::time::SystemTime) -> String {
    let seconds = moment.duration_since(std::time::UNIX_EPOCH).map_or(0, |since| since.as_secs() as i64);
    let (days, rest) = (seconds.div_euclid(86_400), seconds.rem_euclid(86_400));
    // Civil date from days since 1970 in the proleptic Gregorian calendar, counted in years that begin in March.
    let shifted = days + 719_468;
    let era = shifted.div_euclid(146_097);
    let day_of_era = shifted.rem_euclid(146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_shifted = (5 * day_of_year + 2) / 153;
    let (day, month) = (
        day_of_year - (153 * month_shifted + 2) / 5 + 1,
        if month_shifted < 10 { month_shifted + 3 } else { month_shifted - 9 },
    );
    let year = year_of_era + era * 400 + i64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}T{:02}:{:02}:{:02}Z", rest / 3600, rest % 3600 / 60, rest % 60)
}
