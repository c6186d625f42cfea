//! Images of the space-time impulse response: for one lit patch, what each seen patch sends back over time.

use std::collections::BTreeSet;

use super::arrivals::Arrivals;
use super::sources::Sources;
use super::spread;
use crate::history::HistoryError;
use crate::history::behind::OnsetBehind;
use crate::table;
use crate::tables::{Name, Samples};
use crate::units::PatchId;

/// Columns of an image at most.
const COLUMNS: usize = 260;
/// Pixels of all images together at most.
const PIXELS: usize = 350_000;
/// Images at most.
const IMAGES: usize = 60;
/// Signal over noise that is black.
const FLOOR: f64 = 1.0;
/// Margin before the first and after the last onset, as a share of the time between them.
const MARGIN: f64 = 0.08;

table! {
    /// Which profiles there are.
    "stir": Key, KeyColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Patch lit.
        lit: i32,
        /// Patch seen.
        seen: i32,
    }
}

table! {
    /// A deconvolved profile.
    "stir": Deconvolved, DeconvolvedColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Patch lit.
        lit: i32,
        /// Patch seen.
        seen: i32,
        /// Time of sample 0.
        t0_ps: f64,
        /// Time between samples.
        dt_ps: f64,
        /// Deconvolved profile.
        profile: Samples,
        /// Noise in it.
        profile_noise: f64,
    }
}

/// Campaign, sensor and lit patch.
pub type Lit = (Name, Name, PatchId);

/// What one lit patch lights.
pub struct Image {
    /// Which.
    pub lit: Lit,
    /// Seen patches, a row each.
    pub seen: Vec<PatchId>,
    /// Decimal logarithm of signal over noise, row by row; the loudest sample that a pixel covers; 0 for what is below
    /// the noise.
    pub levels: Vec<Vec<f64>>,
    /// Onsets in it: time, place of the seen patch in `seen`, bounces (0: unexplained), path in words.
    pub onsets: Vec<OnsetBehind>,
}

/// The images.
pub struct Stir {
    /// Heading of their table.
    pub heading: String,
    /// Middle of each column.
    pub times_ps: Vec<f64>,
    /// An image a lit patch.
    pub images: Vec<Image>,
    /// Lit patches that there are, of all sensors and campaigns.
    pub lit: usize,
}

impl Stir {
    /// Reads them; `None` where there are none.
    ///
    /// # Errors
    /// When the table cannot be read.
    pub fn of(sources: &Sources<'_>, arrivals: &Arrivals) -> Result<Option<Self>, HistoryError> {
        let keys = sources.rows(|_: &Key| true)?;
        let lit_of = |campaign: &Name, sensor: &Name, lit: PatchId| (campaign.clone(), sensor.clone(), lit);
        let all: BTreeSet<Lit> = keys.iter().map(|key| lit_of(&key.campaign, &key.sensor, key.lit)).collect();
        let (Some(heading), false) = (sources.heading("stir"), all.is_empty()) else { return Ok(None) };
        let rows_a_lit = keys.len().div_ceil(all.len());
        let images = (PIXELS / (rows_a_lit * COLUMNS)).clamp(1, IMAGES);
        let chosen: BTreeSet<Lit> = spread(&all.iter().cloned().collect::<Vec<_>>(), images).into_iter().collect();
        let numbers: BTreeSet<i32> = chosen.iter().map(|lit| lit.2).collect();
        let mut rows = sources.rows_near(&[("lit", &numbers)], |row: &Deconvolved| {
            chosen.contains(&lit_of(&row.campaign, &row.sensor, row.lit))
        })?;
        rows.sort_by(|a, b| (&a.campaign, &a.sensor, a.lit, a.seen).cmp(&(&b.campaign, &b.sensor, b.lit, b.seen)));
        let (from_ps, to_ps) = window(&rows, arrivals);
        let step_ps = (to_ps - from_ps) / COLUMNS as f64;
        let times_ps = (0..COLUMNS).map(|column| from_ps + (column as f64 + 0.5) * step_ps).collect();
        let mut images: Vec<Image> = Vec::new();
        for row in &rows {
            let lit = lit_of(&row.campaign, &row.sensor, row.lit);
            if images.last().is_none_or(|image| image.lit != lit) {
                images.push(Image { lit, seen: Vec::new(), levels: Vec::new(), onsets: Vec::new() });
            }
            let image = images.last_mut().expect("one was begun");
            image.seen.push(row.seen);
            image.levels.push(levels(row, from_ps, step_ps));
            let capture = (row.campaign.clone(), row.sensor.clone(), row.lit, row.seen);
            image.onsets.extend(arrivals.by_capture.get(&capture).into_iter().flatten().cloned());
        }
        Ok(Some(Self { heading, times_ps, images, lit: all.len() }))
    }
}

/// From before the first to after the last onset; without onsets the whole records.
fn window(rows: &[Deconvolved], arrivals: &Arrivals) -> (f64, f64) {
    let end_ps = |row: &Deconvolved| row.t0_ps + row.profile.len() as f64 * row.dt_ps;
    let first_ps = rows.iter().map(|row| row.t0_ps).fold(f64::INFINITY, f64::min);
    let last_ps = rows.iter().map(end_ps).fold(f64::NEG_INFINITY, f64::max);
    let captures = rows.iter().map(|row| (row.campaign.clone(), row.sensor.clone(), row.lit, row.seen));
    let onsets = captures.filter_map(|capture| arrivals.by_capture.get(&capture)).flatten();
    let times_ps: Vec<f64> = onsets.filter_map(|onset| onset.time_ps).collect();
    if times_ps.is_empty() {
        return (first_ps, last_ps);
    }
    let from_ps = times_ps.iter().copied().fold(f64::INFINITY, f64::min);
    let to_ps = times_ps.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let margin_ps = (MARGIN * (to_ps - from_ps)).max(10.0 * rows.first().map_or(1.0, |row| row.dt_ps));
    ((from_ps - margin_ps).max(first_ps), (to_ps + margin_ps).min(last_ps))
}

/// Loudest sample in each column, as decimal logarithm of signal over noise.
fn levels(row: &Deconvolved, from_ps: f64, step_ps: f64) -> Vec<f64> {
    let mut loudest = vec![0.0_f64; COLUMNS];
    let sample_of = |time_ps: f64| (time_ps - row.t0_ps) / row.dt_ps;
    for (column, loudest) in loudest.iter_mut().enumerate() {
        let from = sample_of(from_ps + column as f64 * step_ps);
        let to = sample_of(from_ps + (column + 1) as f64 * step_ps);
        // A column narrower than a sample shows the nearest one.
        let (first, last) = (from.round(), to.round().max(from.round() + 1.0));
        for i in (first.max(0.0) as usize)..(last.max(0.0) as usize).min(row.profile.len()) {
            *loudest = loudest.max(f64::from(row.profile[i]).abs());
        }
    }
    loudest.iter().map(|value| (value / row.profile_noise).max(FLOOR).log10()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(profile: Vec<f32>) -> Deconvolved {
        let name = Name::from("s1");
        Deconvolved {
            campaign: name.clone(),
            sensor: name,
            lit: 1,
            seen: 2,
            t0_ps: 100.0,
            dt_ps: 10.0,
            profile: profile.into(),
            profile_noise: 0.1,
        }
    }

    #[test]
    fn a_pixel_shows_the_loudest_sample_that_it_covers() {
        let mut profile = vec![0.0; 2 * COLUMNS];
        (profile[6], profile[7], profile[9]) = (-100.0, 10.0, 0.01);
        let found = levels(&row(profile), 100.0, 20.0);
        assert!((found[3] - 3.0).abs() < 1e-6, "100 over a noise of 0.1");
        assert_eq!((found[2], found[4], found.len()), (0.0, 0.0, COLUMNS), "below the noise");
    }

    #[test]
    fn narrow_pixels_show_the_nearest_sample() {
        let found = levels(&row(vec![0.05, 1.0, 10.0]), 100.0, 2.0);
        assert!(found[..2].iter().all(|level| *level == 0.0));
        assert!((found[5] - 1.0).abs() < 1e-6 && (found[10] - 2.0).abs() < 1e-6);
        assert_eq!(found[COLUMNS - 1], 0.0, "after the record");
    }
}
