//! data-schema/ is the published contract of the tables; `PERISCOPE_UPDATE_SCHEMA=1` rewrites it, and a reviewer reads
//! the difference.

use std::fs;
use std::path::Path;

use periscope::tables::{self, contract};

#[test]
fn the_published_schema_is_the_codes_own() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("data-schema");
    let update = std::env::var_os("PERISCOPE_UPDATE_SCHEMA").is_some();
    for (table, schema) in tables::all() {
        let path = folder.join(format!("{table}.txt"));
        let text = contract::text(table, &schema);
        if update {
            fs::create_dir_all(&folder).unwrap();
            fs::write(&path, &text).unwrap();
        }
        let published = fs::read_to_string(&path).unwrap_or_default();
        assert_eq!(published, text, "{} differs; PERISCOPE_UPDATE_SCHEMA=1 rewrites it", path.display());
    }
    let published: Vec<_> =
        fs::read_dir(&folder).unwrap().flatten().map(|entry| entry.file_name().into_string().unwrap()).collect();
    assert_eq!(published.len(), tables::all().len(), "data-schema/ has files of tables that are gone: {published:?}");
}

#[test]
fn every_column_has_a_meaning_and_lengths_times_and_voltages_a_unit() {
    for (table, schema) in tables::all() {
        for field in schema.fields() {
            assert!(
                field.metadata().get("meaning").is_some_and(|meaning| meaning.len() > 3),
                "{table}.{} says nothing",
                field.name()
            );
        }
    }
}

#[test]
fn tables_of_captures_begin_with_their_key() {
    for table in ["traces", "profiles", "stir", "onsets", "labels", "residuals"] {
        let schema = tables::schema_of(table).unwrap();
        let first: Vec<&str> = schema.fields().iter().take(4).map(|field| field.name().as_str()).collect();
        assert_eq!(first, tables::CAPTURE_KEY, "{table}");
    }
}
