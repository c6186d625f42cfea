//! Which columns identify a row of each table.

/// The columns that identify a row; `None` for a table that Periscope does not declare.
#[must_use]
pub fn key_of(table: &str) -> Option<&'static [&'static str]> {
    Some(match table {
        "traces" => &["campaign", "sensor", "lit", "seen", "role", "run", "range", "shot", "is_reference"],
        "pulses" => &["campaign", "sensor", "run", "pulse", "channel"],
        "echoes" => &["campaign", "sensor", "run", "pulse", "channel", "echo"],
        "subtotals" => &["campaign", "sensor", "lit", "seen", "role", "run", "range", "is_cut", "phase"],
        "calibration" | "session" | "delays" => &["campaign", "sensor", "range"],
        "profiles" | "measurements" => &["campaign", "sensor", "lit", "seen", "role", "run"],
        "checks" => &["campaign", "sensor", "check"],
        "stir" => &["campaign", "sensor", "lit", "seen"],
        "onsets" => &["campaign", "sensor", "lit", "seen", "rank"],
        "labels" => &["campaign", "sensor", "lit", "seen", "rank", "part", "alternative"],
        "residuals" | "suspects" => &["campaign", "sensor", "lit", "seen", "rank", "part", "path"],
        "hypotheses" => &["hypothesis", "alternative"],
        "gaps" | "distances" => &["a", "b"],
        "patch_covariances" => &["a", "b", "alternative"],
        "covariances" => &["a1", "b1", "a2", "b2"],
        "patches" => &["patch", "alternative"],
        "planes" => &["plane"],
        "footprints" => &["patch"],
        "voxels" => &["method", "x_m", "y_m", "z_m"],
        "images" => &["method"],
        "volumes" => &["grid_row"],
        "searches" => &["verdict"],
        "surface_points" => &["lit", "seen", "rank"],
        "omissions" => &["lit", "seen"],
        "shapes" => &["shape"],
        "meshes" => &["mesh"],
        "vertices" => &["mesh", "grid_row", "grid_column"],
        "decisions" => &["decision"],
        "stations" => &["campaign", "station"],
        "fits" | "scenes" => &["alternative"],
        "ambiguities" => &["kind", "patches", "alternative"],
        "rejects" => &["stage", "campaign", "file", "segment", "byte_offset"],
        "predictions" => &["campaign", "sensor", "lit", "seen", "range", "path"],
        "true_paths" => &["campaign", "sensor", "lit", "seen", "path"],
        "true_centroids" => &["campaign", "sensor", "patch"],
        "true_captures" => &["campaign", "sensor", "lit", "seen", "role", "range", "file"],
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tables;

    #[test]
    fn every_table_has_a_key_of_its_own_columns() {
        for (table, schema) in tables::all() {
            let key = key_of(table).unwrap_or_default();
            assert!(!key.is_empty(), "{table}");
            assert!(key.iter().all(|column| schema.column_with_name(column).is_some()), "{table}: {key:?}");
        }
    }
}
