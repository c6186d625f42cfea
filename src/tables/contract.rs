//! The published form of a table's schema, for `periscope schema` and `data-schema/`.

use std::fmt::Write;

use arrow_schema::{DataType, Field, Schema};

/// A table's columns with types, units and meanings, as text.
#[must_use]
pub fn text(table: &str, schema: &Schema) -> String {
    let mut text = format!("# {table}\n# {}\n", schema.metadata().get("meaning").map_or("", String::as_str));
    for field in schema.fields() {
        column(&mut text, "", field);
    }
    text
}

fn column(text: &mut String, indent: &str, field: &Field) {
    let metadata = |key: &str| field.metadata().get(key).map_or("", String::as_str);
    let null = if field.is_nullable() { ", may be null" } else { "" };
    let unit = if metadata("unit").is_empty() { String::new() } else { format!(" [{}]", metadata("unit")) };
    let meaning = if metadata("meaning").is_empty() { String::new() } else { format!(": {}", metadata("meaning")) };
    writeln!(text, "{indent}{} {}{null}{unit}{meaning}", field.name(), type_name(field.data_type()))
        .expect("a String takes all text");
    if let DataType::List(item) = field.data_type()
        && let DataType::Struct(fields) = item.data_type()
    {
        fields.iter().for_each(|field| column(text, "    ", field));
    }
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
