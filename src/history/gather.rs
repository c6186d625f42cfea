//! Finds the requested row, and the onsets that contribute to it.

use std::collections::BTreeSet;
use std::path::PathBuf;

use serde::Deserialize;
use serde_json::{Map, Value};

use super::HistoryError;
use super::ancestry::{Ancestry, Table};
use super::behind::OnsetBehind;
use super::sql::{Selection, quoted};
use super::target::Target;
use super::values;
use crate::campaign::{count, suggest};
use crate::priors::campaign_fields::{ByCampaign, StationPositions};
use crate::store::{Shelf, scan};
use crate::tables::{Distance, Echo, Label, Onset, Patch, Pulse, Residual, Row};
use crate::units::PatchId;

/// Most numbers in a message.
const MOST_NUMBERS: usize = 20;

/// A row and its origins.
pub struct Evidence {
    /// The row by its columns.
    pub row: Map<String, Value>,
    pub onsets: Vec<OnsetBehind>,
    /// Where the onsets are listed; `None` if all captures contribute.
    pub selection: Option<Selection>,
    /// The SQL condition that selects the row in its own table.
    pub condition: String,
    /// The recording that it is of, where that has a table of its own: the table, and a condition in SQL.
    pub recording: Option<(Table, String)>,
}

/// Finds rows in one result folder.
pub struct Explainer<'a> {
    pub shelf: &'a Shelf,
    pub ancestry: &'a Ancestry,
    pub campaigns: &'a [PathBuf],
}

impl Explainer<'_> {
    /// The table that has the row, and the row's origins.
    pub fn find(
        &self,
        target: &Target,
        heading: Option<&str>,
        remarks: &mut Vec<String>,
    ) -> Result<(Table, Evidence), HistoryError> {
        let out = self.shelf.out().display();
        let mut tables = self.ancestry.views();
        tables.retain(|(_, table)| table.name == target.table());
        tables.reverse(); // the last of the dataflow first
        let names: Vec<&str> = tables.iter().map(|(view, _)| view.as_str()).collect();
        let candidates: Vec<&(String, Table)> = match heading {
            None => tables.iter().collect(),
            Some(heading) => tables.iter().filter(|(view, _)| view == heading).collect(),
        };
        if candidates.is_empty() {
            let what = format!("table of `{}`", target.table());
            return Err(HistoryError::Refused(match heading {
                Some(heading) if !names.is_empty() => format!("--table: {}", suggest::unknown(&what, heading, &names)),
                _ => format!("{out} has no {what}; `periscope tables {out}` lists what there is"),
            }));
        }
        let mut failure = None;
        for (_, table) in candidates {
            match self.gather(target, table, remarks) {
                Ok(gathered) => {
                    let others: Vec<&str> =
                        names.iter().copied().filter(|name| *name != self.ancestry.label(table)).collect();
                    if heading.is_none() && !others.is_empty() {
                        remarks.push(format!("the same in other tables: --table {}", others.join(", --table ")));
                    }
                    remarks.extend(failure.map(|failure: HistoryError| failure.to_string()));
                    return Ok((table.clone(), gathered));
                }
                // An earlier table may have it.
                Err(error @ HistoryError::Refused(_)) => failure = failure.or(Some(error)),
                Err(error) => return Err(error),
            }
        }
        Err(failure.expect("there is a candidate"))
    }

    fn gather(&self, target: &Target, table: &Table, remarks: &mut Vec<String>) -> Result<Evidence, HistoryError> {
        match target {
            Target::Patch(patch) => self.patch(table, *patch, remarks),
            Target::Distance(a, b) => self.distance(table, [*a, *b], remarks),
            Target::Onset { .. } => self.onset(table, target),
            Target::Echo { run, pulse, echo } => self.echo(table, run, (*pulse, *echo), remarks),
        }
    }

    /// Rows of a table that `wanted` accepts: typed, and by their columns.
    fn rows<R: Row>(
        &self,
        table: &Table,
        wanted: impl Fn(&R) -> bool,
    ) -> Result<Vec<(R, Map<String, Value>)>, HistoryError> {
        let mut rows = Vec::new();
        for path in self.ancestry.files(table)? {
            for batch in scan::scan(&path, |_| true)? {
                let batch = batch?;
                let wanted_rows = R::rows(&batch)?.into_iter().enumerate().filter(|(_, row)| wanted(row));
                rows.extend(wanted_rows.map(|(i, row)| (row, values::row(&batch, i))));
            }
        }
        Ok(rows)
    }

    fn patch(&self, table: &Table, patch: PatchId, remarks: &mut Vec<String>) -> Result<Evidence, HistoryError> {
        let all = self.rows(table, |_: &Patch| true)?;
        let Some((best, row)) = all.iter().find(|(row, _)| row.patch == patch && row.alternative == 0) else {
            let numbers: BTreeSet<PatchId> = all.iter().map(|(row, _)| row.patch).collect();
            return Err(self.unknown(table, &format!("patch {patch}"), &format!("it has {}", list_text(&numbers))));
        };
        for (other, _) in all.iter().filter(|(row, _)| row.patch == patch && row.alternative != 0) {
            remarks.push(format!(
                "the data leave another place: ({:.5}, {:.5}, {:.5}) m, alternative {}",
                other.x_m, other.y_m, other.z_m, other.alternative
            ));
        }
        let over = |path: Option<&Vec<PatchId>>| path.is_some_and(|path| path.contains(&patch));
        let condition = format!("array_contains(path, {patch})");
        let labelled = format!("{condition} AND alternative = 0");
        let (onsets, selection) = if let Some(residuals) = self.ancestry.beside(table, Residual::TABLE) {
            let rows = self.ancestry.rows(&residuals, |row: &Residual| over(Some(&row.path)))?;
            (rows.iter().map(OnsetBehind::of_residual).collect(), Some(Selection { table: residuals, condition }))
        } else if self.ancestry.stage(table).kind == "search" {
            if let Some(before) = self.passed_on(table, best)? {
                return self.patch(&before, patch, remarks);
            }
            remarks.push("found in the light of all profiles together: it has no onset of its own".to_owned());
            (Vec::new(), None)
        } else if let Some(labels) = self.labels_of(table) {
            let rows = self.ancestry.rows(&labels, |row: &Label| row.alternative == 0 && over(row.path.as_ref()))?;
            let condition = labelled;
            (rows.iter().map(OnsetBehind::of_label).collect(), Some(Selection { table: labels, condition }))
        } else if let Some(onsets) = self.ancestry.nearest(table, Onset::TABLE) {
            let rows = self.ancestry.rows(&onsets, |row: &Onset| row.lit == patch || row.seen == patch)?;
            let condition = format!("(lit = {patch} OR seen = {patch})");
            (rows.iter().map(OnsetBehind::of_onset).collect(), Some(Selection { table: onsets, condition }))
        } else {
            (Vec::new(), None)
        };
        Ok(Evidence { row: row.clone(), onsets, selection, condition: format!("patch = {patch}"), recording: None })
    }

    /// The table that the stage streams, if it has the same row.
    fn passed_on(&self, table: &Table, row: &Patch) -> Result<Option<Table>, HistoryError> {
        let Some(before) = self.ancestry.nearest(table, Patch::TABLE) else { return Ok(None) };
        let has = !self.ancestry.rows(&before, |other: &Patch| other == row)?.is_empty();
        Ok(has.then_some(before))
    }

    /// Labels that a table was made from, or that its own stage made.
    pub fn labels_of(&self, table: &Table) -> Option<Table> {
        self.ancestry.beside(table, Label::TABLE).or_else(|| self.ancestry.nearest(table, Label::TABLE))
    }

    fn distance(
        &self,
        table: &Table,
        [a, b]: [PatchId; 2],
        remarks: &mut Vec<String>,
    ) -> Result<Evidence, HistoryError> {
        let mut all = self.rows(table, |_: &Distance| true)?;
        let Some(place) = all.iter().position(|(row, _)| (row.a, row.b) == (a, b)) else {
            let partners = |of: PatchId| -> BTreeSet<PatchId> {
                all.iter()
                    .filter_map(|(row, _)| [(row.a, row.b), (row.b, row.a)].into_iter().find(|pair| pair.0 == of))
                    .map(|pair| pair.1)
                    .collect()
            };
            let partners_text = |of: PatchId| format!("of {of} it has those to {}", list_text(&partners(of)));
            return Err(self.unknown(
                table,
                &format!("distance of {a} and {b}"),
                &format!("{}; {}", partners_text(a), partners_text(b)),
            ));
        };
        let (distance, row) = all.swap_remove(place);
        let (mut onsets, mut selection) = (Vec::new(), None);
        if let Some(labels) = self.ancestry.nearest(table, Label::TABLE) {
            // A table that was made elsewhere has no campaign fields.
            let stations = ByCampaign::<StationPositions>::deserialize(&self.ancestry.stage(table).fields).ok();
            // T2 excludes path lengths of sensors that are not at the laser.
            let counts = |row: &Label| distance.bounces > 2 || is_with_laser(stations.as_ref(), row);
            let is_between = |path: &[PatchId]| match distance.bounces {
                1 => path == [b],
                2 => path == [a] || path == [b] || path == [a, b] || path == [b, a],
                bounces => path.len() == bounces as usize && path.contains(&a) && path.contains(&b),
            };
            let is_behind =
                |row: &Label| row.alternative == 0 && counts(row) && row.path.as_deref().is_some_and(is_between);
            let rows = self.ancestry.rows(&labels, is_behind)?;
            let both =
                format!("(bounces = {} AND array_contains(path, {a}) AND array_contains(path, {b}))", distance.bounces);
            let path = match distance.bounces {
                1 => format!("bounces = 1 AND array_contains(path, {b})"),
                2 => format!("(bounces = 1 AND (array_contains(path, {a}) OR array_contains(path, {b})) OR {both})"),
                _ => both,
            };
            let sensors: BTreeSet<String> = rows.iter().map(|row| quoted(&row.sensor)).collect();
            let sensors: Vec<String> = sensors.into_iter().collect();
            let some_are_left_out = !self.ancestry.rows(&labels, |row: &Label| !counts(row))?.is_empty();
            let of_sensors =
                if some_are_left_out { format!(" AND sensor IN ({})", sensors.join(", ")) } else { String::new() };
            let condition = format!("alternative = 0 AND {path}{of_sensors}");
            if distance.bounces > 2 {
                remarks.push("ranges of a hidden patch follow from all third bounces over it together; listed are those of this leg".to_owned());
            }
            onsets = rows.iter().map(OnsetBehind::of_label).collect();
            selection = Some(Selection { table: labels, condition });
        }
        Ok(Evidence { row, onsets, selection, condition: format!("a = {a} AND b = {b}"), recording: None })
    }

    fn onset(&self, table: &Table, target: &Target) -> Result<Evidence, HistoryError> {
        let Target::Onset { campaign, sensor, lit, seen, rank } = target else { unreachable!("only onsets come here") };
        let is_named = |row: &Onset| {
            campaign.as_deref().is_none_or(|name| name == &*row.campaign)
                && sensor.as_deref().is_none_or(|name| name == &*row.sensor)
        };
        let mut all = self.rows(table, is_named)?;
        all.retain(|(row, _)| (row.lit, row.seen) == (*lit, *seen));
        let ranks: BTreeSet<i32> = all.iter().map(|(row, _)| row.rank).collect();
        all.retain(|(row, _)| row.rank == *rank);
        if all.len() > 1 {
            let names: Vec<String> =
                all.iter().map(|(row, _)| format!("onset={},{}", row.campaign, name(row))).collect();
            return Err(HistoryError::Refused(format!("there are several: {}", names.join(", "))));
        }
        let Some((onset, row)) = all.pop() else {
            let sensors = self.rows(table, |_: &Onset| true)?;
            let sensors: BTreeSet<String> = sensors.iter().map(|(row, _)| row.sensor.to_string()).collect();
            if let Some(sensor) = sensor.as_ref().filter(|sensor| !sensors.contains(*sensor)) {
                let hint = suggest::hint(sensor, sensors.iter().map(String::as_str));
                return Err(self.unknown(table, &format!("sensor {sensor}"), &hint));
            }
            return Err(self.unknown(
                table,
                &target.to_string(),
                &format!("that profile has ranks {}", list_text(&ranks)),
            ));
        };
        let condition = format!(
            "campaign = {} AND sensor = {} AND lit = {lit} AND seen = {seen} AND rank = {rank}",
            quoted(&onset.campaign),
            quoted(&onset.sensor)
        );
        let mut behind = vec![OnsetBehind::of_onset(&onset)];
        if let Some(residuals) = self.last_made_from(table, Residual::TABLE) {
            let of = |row: &Residual| OnsetBehind::of_residual(row);
            let whole = behind[0].whole();
            let rows = self.ancestry.rows(&residuals, |row: &Residual| of(row).whole() == whole)?;
            if !rows.is_empty() {
                behind = rows.iter().map(of).collect();
            }
        }
        let selection = Some(Selection { table: table.clone(), condition: condition.clone() });
        Ok(Evidence { row, onsets: behind, selection, condition, recording: None })
    }

    fn echo(
        &self,
        table: &Table,
        run: &str,
        (pulse, number): (i64, i32),
        remarks: &mut Vec<String>,
    ) -> Result<Evidence, HistoryError> {
        let mut of_pulse = self.rows(table, |row: &Echo| &*row.run == run && row.pulse == pulse)?;
        let Some(at) = of_pulse.iter().position(|(row, _)| row.echo == number) else {
            let numbers: BTreeSet<i32> = of_pulse.iter().map(|(row, _)| row.echo).collect();
            if !numbers.is_empty() {
                let what = format!("echo {number} of pulse {pulse}");
                return Err(self.unknown(table, &what, &format!("that pulse has {}", list_text(&numbers))));
            }
            let runs: BTreeSet<String> =
                self.rows(table, |_: &Echo| true)?.into_iter().map(|(row, _)| row.run.to_string()).collect();
            let (what, hint) = if runs.contains(run) {
                (format!("echo of pulse {pulse} of {run}"), "pulses without echoes have no rows".to_owned())
            } else {
                (format!("run {run}"), suggest::hint(run, runs.iter().map(String::as_str)))
            };
            return Err(self.unknown(table, &what, &hint));
        };
        let (echo, row) = of_pulse.swap_remove(at);
        let of_file = format!("campaign = {} AND run = {} AND pulse = {pulse}", quoted(&echo.campaign), quoted(run));
        remarks.push(format!(
            "recorded by channel {} in {run}, pulse {pulse} of those with returning light; {}",
            echo.channel,
            count(echo.echoes as usize, "echo", "echoes")
        ));
        let recording = self.ancestry.nearest(table, Pulse::TABLE).map(|pulses| (pulses, of_file.clone()));
        let condition = format!("{of_file} AND echo = {number}");
        Ok(Evidence { row, onsets: Vec::new(), selection: None, condition, recording })
    }

    /// The last table of this name in the dataflow that derives from a table.
    pub fn last_made_from(&self, table: &Table, name: &str) -> Option<Table> {
        let views = self.ancestry.views();
        let tables = views.into_iter().rev().map(|(_, other)| other).filter(|other| other.name == name);
        tables.into_iter().find(|other| self.ancestry.upstream(other).contains(table))
    }

    fn unknown(&self, table: &Table, what: &str, hint: &str) -> HistoryError {
        HistoryError::Refused(format!("`{}` has no {what}; {hint}", self.ancestry.label(table)))
    }
}

/// Whether the sensor of a label stands where the laser is.
fn is_with_laser(stations: Option<&ByCampaign<StationPositions>>, label: &Label) -> bool {
    let of_campaign = stations.and_then(|stations| stations.get(&label.campaign));
    of_campaign.and_then(|stations| stations.is_with_laser(&label.sensor)).unwrap_or(false)
}

/// Numbers for a message; of many, the first ones.
fn list_text(numbers: &BTreeSet<i32>) -> String {
    let texts: Vec<String> = numbers.iter().take(MOST_NUMBERS).map(ToString::to_string).collect();
    let more = if numbers.len() > MOST_NUMBERS { ", ..." } else { "" };
    if texts.is_empty() { "none".to_owned() } else { texts.join(", ") + more }
}

/// The name of an onset on the command line.
fn name(row: &Onset) -> String {
    format!("{},{},{},{}", row.sensor, row.lit, row.seen, row.rank)
}
