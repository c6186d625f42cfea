//! The published form of a table's schema, for `periscope schema` and `data-schema/`.

use std::fmt::Write;

use arrow_schema::{DataType, Field, Schema};

/// A column as it is published.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Column {
    /// Name; of a field of a list's items `list.field`.
    pub name: String,
    /// Type.
    pub type_name: String,
    /// Whether a row may have none.
    pub may_be_null: bool,
    /// Unit, if it has one.
    pub unit: Option<String>,
    /// Meaning.
    pub meaning: String,
}

/// A table's columns; those of a list's items follow the list.
#[must_use]
pub fn columns(schema: &Schema) -> Vec<Column> {
    let mut columns = Vec::new();
    schema.fields().iter().for_each(|field| add("", field, &mut columns));
    columns
}

fn add(prefix: &str, field: &Field, columns: &mut Vec<Column>) {
    let metadata = |key: &str| field.metadata().get(key).filter(|text| !text.is_empty()).cloned();
    let name = format!("{prefix}{}", field.name());
    columns.push(Column {
        name: name.clone(),
        type_name: type_name(field.data_type()),
        may_be_null: field.is_nullable(),
        unit: metadata("unit"),
        meaning: metadata("meaning").unwrap_or_default(),
    });
    if let DataType::List(item) = field.data_type()
        && let DataType::Struct(fields) = item.data_type()
    {
        fields.iter().for_each(|field| add(&format!("{name}."), field, columns));
    }
}

/// A table's columns with types, units and meanings, as text.
#[must_use]
pub fn text(table: &str, schema: &Schema) -> String {
    let mut text = format!("# {table}\n# {}\n", schema.metadata().get("meaning").map_or("", String::as_str));
    for Column { name, type_name, may_be_null, unit, meaning } in columns(schema) {
        let (depth, name) =
            name.rsplit_once('.').map_or((0, &*name), |(list, name)| (1 + list.matches('.').count(), name));
        let null = if may_be_null { ", may be null" } else { "" };
        let unit = unit.map_or(String::new(), |unit| format!(" [{unit}]"));
        let meaning = if meaning.is_empty() { meaning } else { format!(": {meaning}") };
        writeln!(text, "{}{name} {type_name}{null}{unit}{meaning}", "    ".repeat(depth))
            .expect("a String takes all text");
    }
    text
}

fn type_name(data_type: &DataType) -> String {
    match data_type {
        DataType::Utf8 => "text".to_owned(),
        DataType::BinaryView => "bytes".to_owned(),
        DataType::Boolean => "bool".to_owned(),
        DataType::Float32 => "f32".to_owned(),
        DataType::Float64 => "f64".to_owned(),
        DataType::Int32 => "i32".to_owned(),
        DataType::Int64 => "i64".to_owned(),
        DataType::List(item) => format!("list<{}>", type_name(item.data_type())),
        DataType::Struct(_) => "struct".to_owned(),
        other => other.to_string(),
    }
}
