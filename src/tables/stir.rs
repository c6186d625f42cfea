//! Table `stir`: the space-time impulse response (paper section 3), one time profile per row, without the sensor's
//! response.

use std::collections::HashMap;
use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::Float64Type;
use arrow_array::{Array, ArrayRef, Float64Array, ListArray, StructArray};
use arrow_schema::{DataType, Field, Fields};

use super::cell::{Cell, Name, Samples, list};
use super::row::unit_of;
use crate::table;

/// One impulse that explains part of a profile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Impulse {
    /// Time of flight after the reference pulse, without the sensor's latency.
    pub time_ps: f64,
    /// Standard deviation of the time.
    pub time_sd_ps: f64,
    /// Height of the sensor's response to it in the profile.
    pub amplitude_v: f64,
    /// Standard deviation of the amplitude.
    pub amplitude_sd_v: f64,
    /// Width of the impulse beyond the sensor's response (0: none modelled).
    pub width_ps: f64,
    /// Increase of chi-square without this impulse.
    pub evidence: f64,
    /// Excess of chi-square, over the samples that the impulse reaches, above its expectation, in standard deviations.
    pub misfit_sigma: f64,
}

const IMPULSE_FIELDS: [&str; 7] =
    ["time_ps", "time_sd_ps", "amplitude_v", "amplitude_sd_v", "width_ps", "evidence", "misfit_sigma"];

impl Impulse {
    fn cells(&self) -> [f64; 7] {
        [
            self.time_ps,
            self.time_sd_ps,
            self.amplitude_v,
            self.amplitude_sd_v,
            self.width_ps,
            self.evidence,
            self.misfit_sigma,
        ]
    }

    fn fields() -> Fields {
        let field = |name: &&str| {
            let unit = unit_of(name).map(|unit| HashMap::from([("unit".to_owned(), unit.to_owned())]));
            Field::new(*name, DataType::Float64, false).with_metadata(unit.unwrap_or_default())
        };
        IMPULSE_FIELDS.iter().map(field).collect()
    }
}

impl Cell for Vec<Impulse> {
    type Array = ListArray;
    const NULLABLE: bool = false;

    fn data_type() -> DataType {
        DataType::List(Arc::new(Field::new_list_field(DataType::Struct(Impulse::fields()), false)))
    }

    fn build<'a>(cells: impl Iterator<Item = &'a Self>) -> ArrayRef {
        let mut columns: [Vec<f64>; 7] = Default::default();
        let lengths: Vec<_> = cells
            .map(|impulses| {
                for impulse in impulses {
                    for (column, value) in columns.iter_mut().zip(impulse.cells()) {
                        column.push(value);
                    }
                }
                Some(impulses.len())
            })
            .collect();
        let arrays = columns.into_iter().map(|column| Arc::new(Float64Array::from(column)) as ArrayRef).collect();
        list(Arc::new(StructArray::new(Impulse::fields(), arrays, None)), &lengths)
    }

    fn get(array: &Self::Array, i: usize) -> Self {
        // Most methods find no impulses, and then the columns need no look-up.
        if array.value_length(i) == 0 {
            return Vec::new();
        }
        let items = array.value(i);
        let columns = items.as_struct().columns();
        let column = |c: usize| columns[c].as_primitive::<Float64Type>().values().clone();
        let columns: [_; 7] = std::array::from_fn(column);
        (0..items.len())
            .map(|k| Impulse {
                time_ps: columns[0][k],
                time_sd_ps: columns[1][k],
                amplitude_v: columns[2][k],
                amplitude_sd_v: columns[3][k],
                width_ps: columns[4][k],
                evidence: columns[5][k],
                misfit_sigma: columns[6][k],
            })
            .collect()
    }
}

table! {
    /// One time profile of the space-time impulse response: the deconvolved signal, without the sensor's response.
    "stir": Stir, StirColumns {
        /// Campaign.
        campaign: Name,
        /// Sensor.
        sensor: Name,
        /// Patch that the laser lit.
        lit: i32,
        /// Patch that the sensor saw.
        seen: i32,
        /// Vertical range whose delay applies to the times, where captures were recorded at several.
        range: Option<Name>,
        /// Time of sample 0 after the reference pulse, without the sensor's latency.
        t0_ps: f64,
        /// Time between samples.
        dt_ps: f64,
        /// Deconvolved profile, for plots and for the edge methods of detect.
        profile: Samples,
        /// Standard deviation of the noise in the deconvolved profile, in its unit.
        profile_noise: f64,
        /// Impulses that explain the measured profile, in order of time; empty for methods that find none.
        impulses: Vec<Impulse>,
        /// Covariance of the impulses' times in ps^2, row by row.
        impulse_cov: Vec<f64>,
        /// Chi-square of the fit over its degrees of freedom; null for methods without a fit.
        chi2_dof: Option<f64>,
        /// Standard deviation of the time error that all arrivals of the profile share.
        jitter_ps: f64,
        /// Relative standard deviation that all amplitudes of the profile share.
        gain_sd: f64,
        /// Laser energy relative to the response captures, from the integral of the reference pulse. Null without
        /// reference channel.
        power_ratio: Option<f64>,
    }
}
