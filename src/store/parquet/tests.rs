//! Tables written and read.

use arrow_array::{ArrayRef, BinaryViewArray};
use arrow_schema::Schema;
use arrow_select::concat::concat_batches;

use super::*;
use crate::store::damage;
use crate::store::failure::StoreError;
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
        assert_eq!(damage::find(&path, &record).unwrap(), None);
        let read: Vec<RecordBatch> = read(&path, 16).unwrap().map(Result::unwrap).collect();
        (record.bytes, concat_batches(&read[0].schema(), &read).unwrap())
    };
    let (small, compressed) = write("small", field.clone());
    let (large, plain) = write("large", uncompressed(&field));
    assert!(small < 100_000 && large > 300 * 40_000, "{small} {large}");
    assert_eq!(compressed.column(0), plain.column(0));
    assert_eq!(plain.column(0), &codes, "several row groups, in order");
}

/// A file of several row groups, and its record.
fn several_groups(folder: &Path) -> (PathBuf, FileRecord, Vec<Profile>) {
    let (path, rows) = (folder.join("file.parquet"), profiles(900, 1400));
    let mut writer = TableWriter::create(&path, &Profile::schema()).unwrap();
    writer.write(&Profile::to_batch(&rows)).unwrap();
    (path, writer.finish(&[]).unwrap(), rows)
}

fn read_back(path: &Path, record: &FileRecord) -> Result<Vec<Profile>, StoreError> {
    let mut rows = Vec::new();
    for batch in read_recorded(path, record, 64)? {
        rows.extend(Profile::rows(&batch?).unwrap());
    }
    Ok(rows)
}

#[test]
fn records_of_earlier_versions_have_one_digest_of_the_whole_file() {
    let folder = tempfile::tempdir().unwrap();
    let (path, record, rows) = several_groups(folder.path());
    let bytes = std::fs::read(&path).unwrap();
    let earlier = FileRecord { digest: Digest::of_bytes(&bytes), groups: None, ..record.clone() };
    let text = serde_json::to_string(&earlier).unwrap();
    assert!(!text.contains("groups"), "{text}");
    let earlier: FileRecord = serde_json::from_str(&text).unwrap();
    for record in [&earlier, &record] {
        assert_eq!(damage::find(&path, record).unwrap(), None);
        assert_eq!(read_back(&path, record).unwrap(), rows);
    }
}

/// The first and the last byte of each row group, and bytes of the footer.
#[test]
fn what_differs_from_its_digest_is_not_decoded() {
    let folder = tempfile::tempdir().unwrap();
    let (path, record, _) = several_groups(folder.path());
    let sound = std::fs::read(&path).unwrap();
    let groups = record.groups.clone().unwrap();
    assert!(groups.len() > 1 && groups.last().unwrap().end == record.pages_end);
    let places = groups.iter().flat_map(|group| [group.end - 1, group.end]).chain([4, record.bytes - 9]);
    for place in places {
        let mut bytes = sound.clone();
        bytes[place as usize] ^= 1;
        std::fs::write(&path, bytes).unwrap();
        let error = read_back(&path, &record).unwrap_err();
        assert!(matches!(error, StoreError::Damaged(_)), "byte {place}: {error}");
        assert!(damage::find(&path, &record).unwrap().is_some(), "byte {place}");
    }
    std::fs::write(&path, &sound[..sound.len() - 1]).unwrap();
    assert!(matches!(read_back(&path, &record), Err(StoreError::Damaged(_))));
    std::fs::write(&path, &sound).unwrap();
    let beyond = FileRecord { pages_end: record.bytes + 1, ..record };
    assert!(matches!(read_back(&path, &beyond), Err(StoreError::Damaged(_))), "a footer that begins behind the end");
}

#[test]
fn a_file_without_rows_is_compared_with_its_record_too() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("none");
    let record = TableWriter::create(&path, &Profile::schema()).unwrap().finish(&[]).unwrap();
    assert_eq!(damage::find(&path, &record).unwrap(), None);
    assert_eq!(read_back(&path, &record).unwrap(), []);
    let mut bytes = std::fs::read(&path).unwrap();
    bytes[1] ^= 1;
    std::fs::write(&path, bytes).unwrap();
    assert!(damage::find(&path, &record).unwrap().is_some());
}
