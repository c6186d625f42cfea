//! Errors that all profiles of a search share: of the visible patches, and of delays.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, Matrix3};

use super::Context;
use super::pair_profile::PairProfile;
use crate::geometry::faint::{Ends, Shared};
use crate::priors::covariances;
use crate::priors::sensor_range::SensorRange;
use crate::tables::Patch;
use crate::units::PatchId;

impl Context {
    /// Of the visible patches, and of the delays of the pairs. Patches without a covariance count as exact, and so do
    /// delays without `delays`.
    pub(super) fn shared_errors(&self, pairs: &[PairProfile], patches: &[Patch], visible: &[PatchId]) -> Shared {
        let best = patches.iter().filter(|patch| patch.alternative == 0);
        let own: BTreeMap<PatchId, Matrix3<f64>> =
            best.filter_map(|row| Some((row.patch, covariances::of_patch(row)?))).collect();
        let mut foci_m2 = DMatrix::zeros(3 * visible.len(), 3 * visible.len());
        for (i, a) in visible.iter().enumerate() {
            for (k, b) in visible.iter().enumerate() {
                let own = || own.get(a).copied().unwrap_or_else(Matrix3::zeros);
                let between_m2 = if a == b { own() } else { self.covariances.between(*a, *b) };
                foci_m2.fixed_view_mut::<3, 3>(3 * i, 3 * k).copy_from(&between_m2);
            }
        }
        let mut delays: Vec<&SensorRange> = Vec::new();
        let mut ends = |pair: &PairProfile| {
            let delay = self.delays.key_of(&pair.sensor).map(|key| {
                let known = delays.iter().position(|other| *other == key);
                let place = known.unwrap_or_else(|| {
                    delays.push(key);
                    delays.len() - 1
                });
                (place, pair.delay_sd_m())
            });
            Ends { source: pair.stations[0], sensor: pair.stations[1], delay }
        };
        let profiles = pairs.iter().map(&mut ends).collect();
        Shared { foci_m2, profiles, delays: delays.len() }
    }
}
