//! Units that a caller gives for columns whose headings name none.

use super::super::description::{Description, Key, Misfit};
use super::layout::{Column, Layout, Role};
use super::units::{COUNTS, Unit, of_times, of_values};
use crate::waveform::Kind;

/// Gives the columns of a layout the units of a description; a heading that says otherwise is an error.
pub(super) fn give_units(layout: &mut Layout, description: &Description) -> Result<(), Misfit> {
    if let Some(text) = &description.unit {
        let unit = of_values(text).map_err(|problem| Key::Unit.refuse(problem))?;
        values(layout, &unit).map_err(|problem| Key::Unit.refuse(format!("= {text:?} {problem}")))?;
    }
    if let Some(text) = &description.time_unit {
        let unit = of_times(text).map_err(|problem| Key::TimeUnit.refuse(problem))?;
        times(layout, unit).map_err(|problem| Key::TimeUnit.refuse(format!("= {text:?} {problem}")))?;
    }
    Ok(())
}

fn values(layout: &mut Layout, unit: &Unit) -> Result<(), String> {
    let format = layout.format;
    let is_value = |column: &&mut Column| column.role == Role::Channel && column.kind != Kind::Digital;
    for column in layout.columns.iter_mut().filter(is_value) {
        if column.unit.name.is_none() {
            column.unit = unit.clone();
            column.kind = if unit.is(COUNTS) { Kind::Counts } else { Kind::Waveform };
        } else if column.unit != *unit {
            let (name, of_file) = (column.name.as_deref().unwrap_or("the values"), column.unit.text());
            return Err(format!("contradicts the heading of {name} ({format}), which says {of_file}; take it out"));
        }
    }
    Ok(())
}

fn times(layout: &mut Layout, unit: Unit) -> Result<(), String> {
    if layout.axis.spectrum {
        return Err("contradicts the heading, which says that the first column holds frequencies; take it out".into());
    }
    let Some(column) = layout.columns.iter_mut().find(|column| column.role == Role::Time) else {
        return Err("is for a column of times, and no column increases from row to row; take it out".into());
    };
    if layout.axis.unit.name.is_none() {
        column.unit = unit.clone();
        layout.axis.unit = unit;
    } else if layout.axis.unit != unit || layout.axis.sequence {
        let of_file = layout.axis.unit.text();
        return Err(format!("contradicts the heading of the times, which says {of_file}; take it out"));
    }
    Ok(())
}
