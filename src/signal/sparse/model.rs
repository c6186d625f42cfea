//! Whitened records that show the same pulses.
//!
//! All products are taken after whitening, over the response's support (and the whitening filter's order) only. The
//! cost of a fit therefore follows its pulses and not the record's length.

use periscope_cancel::Cancel;

use super::column::Column;
use super::nuisance::{self, Direction, Nuisance};
use super::place::Place;
use super::{Profile, Response, SparseOptions, Whitener};

/// One record's noise and response.
pub(super) struct WhitenedRecord<'a> {
    pub(super) response: &'a Response,
    pub(super) width_ps: f64,
    pub(super) t0_ps: f64,
    pub(super) dt_ps: f64,
    pub(super) whitener: Whitener,
    /// What lies under the pulses.
    pub(super) nuisance: Nuisance,
    /// First and last arrival, ps, whose maximum lies inside the record.
    arrivals_ps: (f64, f64),
}

/// Everything that stays fixed during a fit.
pub(super) struct Model<'a> {
    pub(super) records: Vec<WhitenedRecord<'a>>,
    /// Records that share the amplitudes of their pulses: all, or each on its own.
    pub(super) groups: Vec<std::ops::Range<usize>>,
    /// Whether amplitudes may be negative.
    pub(super) signed: bool,
    /// Largest width, and constant of a tail, of a pulse's light; 0 for points only.
    pub(super) extent_max_ps: f64,
    /// Width of the narrowest response.
    pub(super) width_ps: f64,
    /// Ends the fit.
    pub(super) cancel: Cancel,
}

impl<'a> WhitenedRecord<'a> {
    pub(super) fn new(profile: &Profile, response: &'a Response, options: &SparseOptions) -> Self {
        let whitener = Whitener::new(profile.sd_v, profile.acf).ended_by(&options.cancel);
        let last = (profile.sd_v.len() - 1) as f64;
        let first_ps = profile.t0_ps - response.peak_ps();
        Self {
            response,
            width_ps: response.width_ps(),
            t0_ps: profile.t0_ps,
            dt_ps: profile.dt_ps,
            nuisance: Nuisance::new(&whitener, options.baseline, profile.slow_v2),
            whitener,
            arrivals_ps: (first_ps, first_ps + last * profile.dt_ps),
        }
    }

    /// Whether a pulse's maximum lies inside.
    pub(super) fn holds(&self, time_ps: f64) -> bool {
        (self.arrivals_ps.0..=self.arrivals_ps.1).contains(&time_ps)
    }

    /// Number of samples.
    pub(super) fn len(&self) -> usize {
        self.whitener.weights().len()
    }
}

impl WhitenedRecord<'_> {
    /// Adds pulses, each with its amplitude, to samples that are freed of what lies under them.
    pub(super) fn add_pulses<'c>(&self, samples: &mut [f64], pulses: impl Iterator<Item = (&'c Column, f64)> + Clone) {
        for axis in self.nuisance.axes() {
            let along: f64 = pulses.clone().map(|(column, a)| a * column.dot_record(axis)[0]).sum();
            nuisance::subtract(samples, axis, along);
        }
        pulses.for_each(|(column, a)| column.add_to(samples, a));
    }
}

impl<'a> Model<'a> {
    pub(super) fn new(records: &[(Profile, &'a Response)], options: &SparseOptions, shared_amplitudes: bool) -> Self {
        let count = records.len();
        let records: Vec<WhitenedRecord> =
            records.iter().map(|(profile, response)| WhitenedRecord::new(profile, response, options)).collect();
        Self {
            groups: if shared_amplitudes {
                std::iter::once(0..count).collect()
            } else {
                (0..count).map(|r| r..r + 1).collect()
            },
            signed: options.signed,
            extent_max_ps: options.extent_max_ps,
            width_ps: records.iter().map(|record| record.width_ps).fold(f64::INFINITY, f64::min),
            records,
            cancel: options.cancel.clone(),
        }
    }

    /// With more under the pulses: directions of record `r`.
    pub(super) fn add_under<'d>(&mut self, r: usize, directions: impl IntoIterator<Item = &'d Direction>) {
        for (direction, variance) in directions {
            self.records[r].nuisance.add(direction, Some(*variance));
        }
    }

    /// Whether a pulse's maximum lies inside of every record.
    pub(super) fn is_inside(&self, time_ps: f64) -> bool {
        self.records.iter().all(|record| record.holds(time_ps))
    }

    /// Whether all places have their maximum inside of every record.
    pub(super) fn admits(&self, places: &[Place]) -> bool {
        places.iter().all(|place| self.is_inside(place.time_ps))
    }
}
