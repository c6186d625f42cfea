//! Tables written and read.

use arrow_array::{ArrayRef, BinaryViewArray};
use arrow_schema::Schema;
use arrow_select::concat::concat_batches;

use super::*;
use crate::tables::{Name, Profile, Row};

fn profiles(count: i32, samples: usize) -> Vec<Profile> {
    let name: Name = "a".into();
    (0..count)
        .map(|lit| Profile {
            campaign: name.clone(),
            sensor: name.clone(),
            lit,
            seen: 1,
            role: name.clone(),
            shots: 10,
            t0_ps: 0.5,
            dt_ps: 50.0,
            mean_v: Some((0..samples).map(|i| (i as f64 * 0.1 + f64::from(lit)).sin()).collect()),
            se_v: Some((0..samples).map(|_| 0.01).collect()),
            noise_v: 0.1,
            noise_acf: vec![1.0, 0.2].into(),
            noise_samples: Some(640),
            gain_v: 0.001,
            ..Profile::default()
        })
        .collect()
}

#[test]
fn bytes_do_not_depend_on_batches_and_rows_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let rows = profiles(900, 700);
    let mut records = Vec::new();
    for chunk in [1, 7, 900] {
        let path = folder.path().join(format!("{chunk}.parquet"));
        let mut writer = TableWriter::create(&path, &Profile::schema()).unwrap();
        for rows in rows.chunks(chunk) {
            writer.write(&Profile::to_batch(rows)).unwrap();
        }
        records.push(writer.finish(&[("lineage", "abc".to_owned())]).unwrap());
        let read: Vec<Profile> =
            read(&path, 64).unwrap().flat_map(|batch| Profile::rows(&batch.unwrap()).unwrap()).collect();
        assert_eq!(read, rows);
        let (count, entries) = footer(&path).unwrap();
        assert_eq!(count, 900);
        assert!(entries.contains(&("lineage".to_owned(), "abc".to_owned())));
    }
    assert!(records.windows(2).all(|pair| pair[0] == pair[1]), "{records:?}");
    assert!(records[0].bytes > 2 * ROW_GROUP_BYTES as u64 / 2, "several row groups were meant: {records:?}");
}

#[test]
fn a_column_that_is_marked_is_as_large_as_its_bytes_and_reads_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let codes: ArrayRef = Arc::new(BinaryViewArray::from_iter_values((0..300_u32).map(|row| vec![row as u8; 40_000])));
    let field = Field::new("codes", DataType::BinaryView, false);
    let write = |name: &str, field: Field| {
        let schema = Arc::new(Schema::new(vec![field]));
        let batch = RecordBatch::try_new(schema.clone(), vec![codes.clone()]).unwrap();
        let path = folder.path().join(name);
        let mut writer = TableWriter::create(&path, &schema).unwrap();
        writer.write(&batch).unwrap();
        let record = writer.finish(&[]).unwrap();
        assert_eq!(record.bytes, std::fs::metadata(&path).unwrap().len());
        assert_eq!(record.digest, Digest::of_bytes(&std::fs::read(&path).unwrap()));
        let read: Vec<RecordBatch> = read(&path, 16).unwrap().map(Result::unwrap).collect();
        (record.bytes, concat_batches(&read[0].schema(), &read).unwrap())
    };
    let (small, compressed) = write("small", field.clone());
    let (large, plain) = write("large", uncompressed(&field));
    assert!(small < 100_000 && large > 300 * 40_000, "{small} {large}");
    assert_eq!(compressed.column(0), plain.column(0));
    assert_eq!(plain.column(0), &codes, "several row groups, in order");
}
