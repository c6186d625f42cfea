//! Names of tables in an SQL query.

/// Whether a query names this table.
#[must_use]
pub fn mentions(sql: &str, table: &str) -> bool {
    places(sql, table).next().is_some()
}

/// Quotes names such as `patches.residuals` in a query. SQL would take them for column `residuals` of `patches`, or for
/// a table of another schema.
#[must_use]
pub fn quoted(sql: &str, tables: &[String]) -> String {
    let is_plain = |table: &str| table.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    let mut sql = sql.to_owned();
    for table in tables.iter().filter(|table| !is_plain(table)) {
        // Text in quotes of either kind is a quoted name already, or a string.
        let bare = |&at: &usize| ['"', '\''].iter().all(|quote| sql[..at].matches(*quote).count() % 2 == 0);
        let bare: Vec<usize> = places(&sql, table).filter(bare).collect();
        for at in bare.into_iter().rev() {
            sql.replace_range(at..at + table.len(), &format!("\"{table}\""));
        }
    }
    sql
}

/// Where a table's name occurs, except inside longer words.
fn places<'a>(sql: &'a str, table: &'a str) -> impl Iterator<Item = usize> + 'a {
    let in_word = |c: char| c.is_alphanumeric() || c == '_';
    sql.match_indices(table).map(|(at, _)| at).filter(move |&at| {
        let after = sql[at + table.len()..].chars().next();
        let before = sql[..at].chars().next_back();
        !before.is_some_and(|c| in_word(c) || c == '.') && !after.is_some_and(in_word)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_are_named_by_whole_words() {
        assert!(mentions("SELECT * FROM patches", "patches") && mentions("SELECT patches.x_m", "patches"));
        assert!(!mentions("SELECT * FROM patches_2, old.patches, xpatches", "patches"));
    }

    #[test]
    fn names_with_a_dot_are_quoted_once() {
        let tables = ["patches", "patches.residuals"].map(str::to_owned);
        let sql = "SELECT r.lit FROM patches p JOIN patches.residuals r JOIN \"patches.residuals\" WHERE p.kind = 'a patches.residuals'";
        let expected = "SELECT r.lit FROM patches p JOIN \"patches.residuals\" r JOIN \"patches.residuals\" WHERE p.kind = 'a patches.residuals'";
        assert_eq!(quoted(sql, &tables), expected);
    }
}
