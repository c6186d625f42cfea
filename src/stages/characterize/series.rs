//! Series of runs: those that differ in one setting alone.

use std::collections::BTreeMap;

use crate::priors::acquisition_time;
use crate::tables::{Measurement, Name};

/// Fewer settings (or runs of one setting) are no series.
pub const SERIES_MIN: usize = 3;

/// A run whose pulse was found.
#[derive(Clone, Copy)]
pub struct Run<'a> {
    /// All that was measured.
    pub row: &'a Measurement,
    pub amplitude_v: f64,
    pub amplitude_sd_v: f64,
    pub time_ps: f64,
    pub time_sd_ps: f64,
}

impl<'a> Run<'a> {
    /// `None` for a run without a pulse.
    pub fn of(row: &'a Measurement) -> Option<Self> {
        Some(Self {
            row,
            amplitude_v: row.amplitude_v?,
            amplitude_sd_v: row.amplitude_sd_v?,
            time_ps: row.time_ps?,
            time_sd_ps: row.time_sd_ps?,
        })
    }

    /// Light that came through, in units of the laser's power.
    pub fn light(&self) -> f64 {
        self.row.power_w.unwrap_or(1.0) * 10_f64.powf(-self.row.attenuation_od.unwrap_or(0.0))
    }
}

/// A setting, as what two runs have in common or not: numbers by their bits.
type Setting = Option<u64>;

fn bits(value: Option<f64>) -> Setting {
    value.map(f64::to_bits)
}

/// What is fixed in a series.
type Fixed = (i32, i32, Name, Vec<Setting>, Option<i32>);

fn fixed(row: &Measurement, settings: Vec<Setting>) -> Fixed {
    (row.lit, row.seen, row.role.clone(), settings, row.bounces)
}

/// Runs that differ in attenuation or power alone.
pub fn attenuation<'a>(runs: &[Run<'a>]) -> Option<Vec<Run<'a>>> {
    // Powers compare with powers only.
    let key = |row: &Measurement| fixed(row, vec![bits(row.path_m), Some(u64::from(row.power_w.is_some()))]);
    longest(runs, key, |run| Some(run.light().to_bits()))
}

/// Runs that differ in the length of the path alone.
pub fn path<'a>(runs: &[Run<'a>]) -> Option<Vec<Run<'a>>> {
    let with_path: Vec<Run<'a>> = runs.iter().copied().filter(|run| run.row.path_m.is_some()).collect();
    let key = |row: &Measurement| fixed(row, vec![bits(row.attenuation_od), bits(row.power_w)]);
    longest(&with_path, key, |run| bits(run.row.path_m))
}

/// The same setting again and again, and when: hours since the first, or the number of the run where the files do not
/// say.
pub struct TimeSeries<'a> {
    pub runs: Vec<Run<'a>>,
    pub at: Vec<f64>,
    /// Unit of `at`.
    pub unit: &'static str,
}

/// Runs that differ in nothing but their time.
pub fn time<'a>(runs: &[Run<'a>]) -> Option<TimeSeries<'a>> {
    let settings = |row: &Measurement| vec![bits(row.path_m), bits(row.attenuation_od), bits(row.power_w)];
    let mut number = 0;
    let runs = longest(
        runs,
        |row| fixed(row, settings(row)),
        |_| {
            number += 1;
            Some(number)
        },
    )?;
    let hours = |run: &Run<'_>| Some(acquisition_time::seconds(run.row.acquired_at.as_deref()?)? / 3600.0);
    let hours: Option<Vec<f64>> = runs.iter().map(hours).collect();
    let hours = hours.filter(|hours| hours.iter().any(|hour| *hour != hours[0]));
    let (at, unit) = match hours {
        Some(hours) => (hours, "h"),
        None => ((0..runs.len()).map(|number| number as f64).collect(), "run"),
    };
    Some(TimeSeries { runs, at, unit })
}

/// Of the series whose runs have equal `key`, the one with most different values of `varied`, then most runs, then the
/// first.
fn longest<'a>(
    runs: &[Run<'a>],
    key: impl Fn(&Measurement) -> Fixed,
    mut varied: impl FnMut(&Run<'a>) -> Setting,
) -> Option<Vec<Run<'a>>> {
    let mut series: BTreeMap<Fixed, Vec<(Setting, Run<'a>)>> = BTreeMap::new();
    for run in runs {
        series.entry(key(run.row)).or_default().push((varied(run), *run));
    }
    let different = |runs: &[(Setting, Run<'a>)]| {
        let mut values: Vec<Setting> = runs.iter().map(|(value, _)| *value).collect();
        values.sort_unstable();
        values.dedup();
        values.len()
    };
    let mut best: Option<(usize, Vec<(Setting, Run<'a>)>)> = None;
    for runs in series.into_values() {
        let count = different(&runs);
        let longer = |(most, best): &(usize, Vec<_>)| (count, runs.len()) > (*most, best.len());
        if count >= SERIES_MIN && best.as_ref().is_none_or(longer) {
            best = Some((count, runs));
        }
    }
    best.map(|(_, runs)| runs.into_iter().map(|(_, run)| run).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(path_m: f64, attenuation_od: f64, acquired_at: Option<&str>) -> Measurement {
        Measurement {
            campaign: "c".into(),
            sensor: "s1".into(),
            lit: 0,
            seen: 0,
            role: "fiducial".into(),
            run: Some("f".into()),
            shots: 64,
            rejected: 0,
            clipped: 0,
            path_m: Some(path_m),
            path_sd_m: None,
            attenuation_od: Some(attenuation_od),
            power_w: None,
            bounces: None,
            acquired_at: acquired_at.map(Into::into),
            snr: Some(100.0),
            amplitude_v: Some(1.0),
            amplitude_sd_v: Some(0.01),
            time_ps: Some(1000.0),
            time_sd_ps: Some(0.5),
            width_ratio: None,
            width_ratio_sd: None,
            width_ps: None,
            baseline_v: 0.0,
            noise_v: 0.02,
            noise_acf: None,
            signal_noise_v: None,
            gain_v: 1e-4,
            echo_ratio: None,
            echo_ratio_sd: None,
            echo_delay_ps: None,
            echo_trials: None,
            pickup_v: None,
            pickup_sd_v: None,
            pickup_trials: None,
        }
    }

    #[test]
    fn a_series_differs_in_one_setting_alone() {
        let settings = [(1.0, 0.0), (1.0, 0.5), (1.0, 1.0), (1.2, 0.0), (1.4, 0.0), (1.4, 0.2), (1.6, 0.0), (1.0, 0.0)];
        let rows: Vec<Measurement> = settings.iter().map(|(path_m, od)| row(*path_m, *od, None)).collect();
        let runs: Vec<Run<'_>> = rows.iter().filter_map(Run::of).collect();
        let attenuated = attenuation(&runs).unwrap();
        assert!(attenuated.len() == 4 && attenuated.iter().all(|run| run.row.path_m == Some(1.0)));
        let moved = path(&runs).unwrap();
        assert!(moved.len() == 5 && moved.iter().all(|run| run.row.attenuation_od == Some(0.0)));
        assert!(time(&runs).is_none(), "two runs of one setting are no series");
    }

    #[test]
    fn times_are_hours_where_files_say_them_and_numbers_where_not() {
        let clock = ["2009-03-27T14:00:00", "2009-03-27T14:30:00", "2009-03-27T16:00:00"];
        let rows: Vec<Measurement> = clock.iter().map(|at| row(1.0, 0.0, Some(at))).collect();
        let runs: Vec<Run<'_>> = rows.iter().filter_map(Run::of).collect();
        let series = time(&runs).unwrap();
        let since: Vec<f64> = series.at.iter().map(|at| at - series.at[0]).collect();
        assert!(series.unit == "h" && (since[1] - 0.5).abs() < 1e-6 && (since[2] - 2.0).abs() < 1e-6, "{since:?}");
        let rows = vec![row(1.0, 0.0, None); 3];
        let runs: Vec<Run<'_>> = rows.iter().filter_map(Run::of).collect();
        let series = time(&runs).unwrap();
        assert_eq!((series.unit, series.at), ("run", vec![0.0, 1.0, 2.0]));
    }
}
