//! Makes large tables `onsets` and `labels` like those of stages, for benches/large_tables.py, and counts the row
//! groups that a look-up of one capture reads.
//!
//! `cargo bench --bench large_tables -- make OUT ROWS PARTS`, `cargo bench --bench large_tables -- touched OUT LIT
//! SEEN`.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;

use parquet::file::metadata::{ColumnChunkMetaData, PageIndexPolicy, ParquetMetaDataReader, RowGroupMetaData};
use parquet::file::page_index::column_index::ColumnIndexMetaData;
use parquet::file::statistics::Statistics;
use periscope::store::{Digest, PartRecord, Shelf, StageId};
use periscope::tables::{Label, Name, Onset, Row};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::json;

/// Onsets of a capture.
const ONSETS: usize = 4;
const CAMPAIGNS: [&str; 2] = ["monday", "tuesday"];
/// Captures that are written at a time.
const BATCH: usize = 256;
/// Columns that a look-up reads in addition to the key.
const READ: [&str; 3] = ["rank", "time_ps", "time_sd_ps"];

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    let number = |n: usize| arguments[n].parse::<usize>().expect("a whole number");
    match arguments.first().map(String::as_str) {
        Some("make") => make(Path::new(&arguments[1]), number(2), number(3)),
        Some("touched") => touched(Path::new(&arguments[1]), [number(2) as i32, number(3) as i32]),
        // `cargo bench` without arguments has nothing to do here.
        _ => println!("usage: make OUT ROWS PARTS | touched OUT LIT SEEN"),
    }
}

/// Captures in the order in which parts hold them: reciprocal ones side by side.
fn captures(patches: i32) -> impl Iterator<Item = [i32; 2]> {
    let of_pair = |(a, b): (i32, i32)| if a == b { vec![[a, a]] } else { vec![[a, b], [b, a]] };
    (1..=patches).flat_map(move |a| (a..=patches).map(move |b| (a, b))).flat_map(of_pair)
}

fn make(out: &Path, rows: usize, parts: usize) {
    let patches = ((rows / CAMPAIGNS.len() / ONSETS) as f64).sqrt() as i32;
    let shelf = Shelf::open(out).expect("a result folder");
    for table in [Onset::TABLE, Label::TABLE] {
        let stage = StageId {
            kind: table.to_owned(),
            version: 1,
            params: json!({ "rows": rows, "parts": parts }),
            fields: json!(null),
            schemas: Digest::of_bytes(table.as_bytes()),
            arithmetic: String::new(),
            inputs: BTreeMap::new(),
        };
        let mut records: Vec<PartRecord> = Vec::new();
        for campaign in CAMPAIGNS {
            let all: Vec<[i32; 2]> = captures(patches).collect();
            for of_part in all.chunks(all.len().div_ceil(parts / CAMPAIGNS.len())) {
                let schema = if table == Onset::TABLE { Onset::schema() } else { Label::schema() };
                let mut writer = shelf.begin(&stage, &[(table.to_owned(), schema)]).expect("a part");
                for captures in of_part.chunks(BATCH) {
                    let batch = if table == Onset::TABLE {
                        Onset::to_batch(&captures.iter().flat_map(|pair| onsets(campaign, *pair)).collect::<Vec<_>>())
                    } else {
                        Label::to_batch(&captures.iter().flat_map(|pair| labels(campaign, *pair)).collect::<Vec<_>>())
                    };
                    writer.write(0, &batch).expect("rows");
                }
                let lineage = Digest::of_bytes(format!("{campaign} {}", records.len()).as_bytes());
                records.push(writer.commit(lineage).expect("a part"));
            }
        }
        let files: Vec<u64> = records.iter().map(|record| record.files[table].bytes).collect();
        let rows: u64 = records.iter().map(|record| record.files[table].rows).sum();
        shelf.publish(&stage, records, &[(table.to_owned(), table.to_owned())]).expect("a table");
        println!("{table}: {rows} rows, {} parts, {} bytes", files.len(), files.iter().sum::<u64>());
    }
}

fn drawn(campaign: &str, [lit, seen]: [i32; 2]) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64((u64::from(campaign.as_bytes()[0]) << 48) | ((lit as u64) << 24) | seen as u64)
}

fn onsets(campaign: &str, pair: [i32; 2]) -> Vec<Onset> {
    let (mut rng, name, sensor) = (drawn(campaign, pair), Name::from(campaign), Name::from("s1"));
    let onset = |k: usize| {
        let snr = 10_f64.powf(rng.random_range(0.7..3.0));
        Onset {
            campaign: name.clone(),
            sensor: sensor.clone(),
            lit: pair[0],
            seen: pair[1],
            rank: k as i32 + 1,
            time_ps: 10_000.0 + 3000.0 * k as f64 + rng.random_range(0.0..2000.0),
            time_sd_ps: 100.0 / snr,
            amplitude: 0.001 * snr,
            amplitude_sd: Some(0.001),
            snr,
            evidence: Some(snr * snr),
            covariance: (0..ONSETS)
                .map(|other| if other == k { 1e4 / (snr * snr) } else { rng.random_range(0.0..1.0) })
                .collect(),
            jitter_ps: 0.8,
            flags: if rng.random_bool(0.05) { vec!["blended".into()] } else { Vec::new() },
            ..Onset::default()
        }
    };
    (0..ONSETS).map(onset).collect()
}

fn labels(campaign: &str, pair: [i32; 2]) -> Vec<Label> {
    let label = |onset: Onset| {
        let bounces = onset.rank + 1;
        let between = (2..bounces).map(|k| pair[0] + k);
        let path = std::iter::once(pair[0]).chain(between).chain([pair[1]]).collect();
        Label {
            campaign: onset.campaign,
            sensor: onset.sensor,
            lit: onset.lit,
            seen: onset.seen,
            range: onset.range,
            acquired_at: onset.acquired_at,
            rank: onset.rank,
            part: 0,
            time_ps: onset.time_ps,
            time_sd_ps: onset.time_sd_ps,
            covariance: onset.covariance,
            width_ps: Some(0.0),
            width_sd_ps: None,
            own_variance_ps2: None,
            width_kurtosis: None,
            snr: onset.snr,
            turns: 0,
            bounces: if bounces <= 3 { bounces } else { 0 },
            path: (bounces <= 3).then_some(path),
            residual_ps: (bounces <= 3).then_some(0.3 * onset.time_sd_ps),
            probability: 0.99,
            alternative: 0,
        }
    };
    onsets(campaign, pair).into_iter().map(label).collect()
}

/// What lies within files, row groups and pages whose least and largest values leave room for a capture.
fn touched(out: &Path, pair: [i32; 2]) {
    let (mut files, mut groups, mut pages) = ([0_u64; 2], [0_u64; 2], [0_u64; 2]);
    let (mut bytes, mut footers) = ([0_u64; 3], 0_u64);
    for path in Shelf::look(out).expect("a result folder").files(Onset::TABLE).expect("files") {
        let file = File::open(&path).expect("a file");
        let mut reader = ParquetMetaDataReader::new().with_page_index_policy(PageIndexPolicy::Required);
        reader.try_parse(&file).expect("a footer");
        let metadata = reader.finish().expect("a footer");
        let mut is_touched = false;
        for (n, group) in metadata.row_groups().iter().enumerate() {
            let index = metadata.page_index_for_row_group(n);
            let keys: [usize; 2] = ["lit", "seen"].map(|name| column(group, name).expect("a key"));
            let read: Vec<usize> = READ.iter().filter_map(|name| column(group, name)).chain(keys).collect();
            let size = |k: &usize| group.column(*k).compressed_size() as u64;
            let all: u64 = read.iter().map(size).sum();
            footers += group.columns().iter().filter_map(ColumnChunkMetaData::column_index_length).sum::<i32>() as u64;
            let has_group = keys.iter().zip(pair).all(|(key, value)| may_hold(group, *key, value));
            // Rows of the pages of both keys that may hold it.
            let ranges: Vec<Vec<[i64; 2]>> = keys
                .iter()
                .zip(pair)
                .map(|(key, value)| {
                    let Some(ColumnIndexMetaData::INT32(values)) = index.column_index(*key) else { panic!("an index") };
                    let locations = index.page_locations(*key).expect("pages");
                    let end = |k: usize| locations.get(k + 1).map_or(group.num_rows(), |next| next.first_row_index);
                    let holds =
                        |k: &usize| values.min_value(*k) <= Some(&value) && values.max_value(*k) >= Some(&value);
                    (0..locations.len()).filter(holds).map(|k| [locations[k].first_row_index, end(k)]).collect()
                })
                .collect();
            let both: Vec<[i64; 2]> = ranges[0]
                .iter()
                .flat_map(|a| ranges[1].iter().map(move |b| [a[0].max(b[0]), a[1].min(b[1])]))
                .filter(|[from, to]| from < to)
                .collect();
            for &k in &read {
                let locations = index.page_locations(k).expect("pages");
                for (at, page) in locations.iter().enumerate() {
                    let end = locations.get(at + 1).map_or(group.num_rows(), |next| next.first_row_index);
                    let is_needed =
                        has_group && both.iter().any(|[from, to]| *from < end && *to > page.first_row_index);
                    pages[1] += 1;
                    pages[0] += u64::from(is_needed);
                    bytes[1] += if is_needed { page.compressed_page_size as u64 } else { 0 };
                }
            }
            groups[1] += 1;
            groups[0] += u64::from(has_group);
            bytes[0] += if has_group { all } else { 0 };
            bytes[2] += all;
            is_touched |= has_group;
        }
        files[1] += 1;
        files[0] += u64::from(is_touched);
    }
    println!(
        "lit {}, seen {}: {} of {} files, {} of {} row groups ({} bytes), {} of {} pages ({} bytes), of {} bytes; page indexes {footers} bytes",
        pair[0], pair[1], files[0], files[1], groups[0], groups[1], bytes[0], pages[0], pages[1], bytes[1], bytes[2]
    );
}

fn column(group: &RowGroupMetaData, name: &str) -> Option<usize> {
    group.columns().iter().position(|column| column.column_path().string() == name)
}

fn may_hold(group: &RowGroupMetaData, column: usize, value: i32) -> bool {
    match group.column(column).statistics() {
        Some(Statistics::Int32(values)) => values.min_opt() <= Some(&value) && values.max_opt() >= Some(&value),
        _ => true,
    }
}
