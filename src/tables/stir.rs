//! Table `stir`: the space-time impulse response (paper section 3), one time profile per row, without the sensor's
//! response.

use std::collections::HashMap;
use std::sync::{Arc, LazyLock};

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
    /// Time of flight after the reference pulse, without the sensor's latency; with what was predicted of it.
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
    /// Factor of its variances: chi-square per degree of freedom over those samples where it exceeds what noise
    /// explains, else 1.
    pub misfit_factor: f64,
    /// Standard deviation of the width, where it is above 0.
    pub width_sd_ps: Option<f64>,
    /// Excess kurtosis of the spread that makes it wide: 0 for a Gaussian, -1 for the chords of a disk, between them
    /// for light over more disks.
    pub width_kurtosis: Option<f64>,
    /// Relative change of its light over a standard deviation of that spread.
    pub width_tilt: Option<f64>,
    /// Constant of the exponential tail of its light, which `width_ps` has in it; null for light without a tail.
    pub tail_ps: Option<f64>,
    /// Time of flight as the profile alone has it, to which `impulse_cov` belongs; null where none was predicted.
    pub own_time_ps: Option<f64>,
    /// Variance of its light beyond the sensor's response as the profile alone has it; below 0 where noise makes it so,
    /// null where none was predicted. Its standard deviation is `2 width_ps width_sd_ps`.
    pub own_variance_ps2: Option<f64>,
    /// The best two points in the place of an impulse that is wider than 0.
    pub pair: Option<ImpulsePair>,
}

/// Two points that may stand in the place of one wide impulse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImpulsePair {
    /// Time of the earlier one.
    pub first_ps: f64,
    /// Time of the later one.
    pub second_ps: f64,
    /// Standard deviation of the earlier time.
    pub first_sd_ps: f64,
    /// Standard deviation of the later time.
    pub second_sd_ps: f64,
    /// Correlation of both times.
    pub correlation: f64,
    /// Amplitude of the earlier one.
    pub first_amplitude_v: f64,
    /// Amplitude of the later one.
    pub second_amplitude_v: f64,
    /// Chi-square of the wide impulse less that of the pair, over the chi-square per degree of freedom of the better
    /// one where noise does not explain it.
    pub gain: f64,
}

const REQUIRED: usize = 8;
const CELLS: usize = 22;
/// The first are never null.
const IMPULSE_FIELDS: [&str; CELLS] = [
    "time_ps",
    "time_sd_ps",
    "amplitude_v",
    "amplitude_sd_v",
    "width_ps",
    "evidence",
    "misfit_sigma",
    "misfit_factor",
    "width_sd_ps",
    "width_kurtosis",
    "width_tilt",
    "tail_ps",
    "own_time_ps",
    "own_variance_ps2",
    "pair_first_ps",
    "pair_second_ps",
    "pair_first_sd_ps",
    "pair_second_sd_ps",
    "pair_correlation",
    "pair_first_amplitude_v",
    "pair_second_amplitude_v",
    "pair_gain",
];

impl Impulse {
    fn cells(&self) -> [Option<f64>; CELLS] {
        let of_pair = |value: fn(&ImpulsePair) -> f64| self.pair.as_ref().map(value);
        [
            Some(self.time_ps),
            Some(self.time_sd_ps),
            Some(self.amplitude_v),
            Some(self.amplitude_sd_v),
            Some(self.width_ps),
            Some(self.evidence),
            Some(self.misfit_sigma),
            Some(self.misfit_factor),
            self.width_sd_ps,
            self.width_kurtosis,
            self.width_tilt,
            self.tail_ps,
            self.own_time_ps,
            self.own_variance_ps2,
            of_pair(|pair| pair.first_ps),
            of_pair(|pair| pair.second_ps),
            of_pair(|pair| pair.first_sd_ps),
            of_pair(|pair| pair.second_sd_ps),
            of_pair(|pair| pair.correlation),
            of_pair(|pair| pair.first_amplitude_v),
            of_pair(|pair| pair.second_amplitude_v),
            of_pair(|pair| pair.gain),
        ]
    }

    /// From its cells; `None` where one that is never null is.
    fn of_cells(cells: &[Option<f64>; CELLS]) -> Option<Self> {
        let [
            time,
            time_sd,
            amplitude,
            amplitude_sd,
            width,
            evidence,
            misfit,
            factor,
            width_sd_ps,
            width_kurtosis,
            width_tilt,
            tail_ps,
            own_time_ps,
            own_variance_ps2,
            pair @ ..,
        ] = *cells;
        let pair_of = |[first, second, first_sd, second_sd, correlation, one, other, gain]: [Option<f64>; 8]| {
            Some(ImpulsePair {
                first_ps: first?,
                second_ps: second?,
                first_sd_ps: first_sd?,
                second_sd_ps: second_sd?,
                correlation: correlation?,
                first_amplitude_v: one?,
                second_amplitude_v: other?,
                gain: gain?,
            })
        };
        Some(Self {
            time_ps: time?,
            time_sd_ps: time_sd?,
            amplitude_v: amplitude?,
            amplitude_sd_v: amplitude_sd?,
            width_ps: width?,
            evidence: evidence?,
            misfit_sigma: misfit?,
            misfit_factor: factor?,
            width_sd_ps,
            width_kurtosis,
            width_tilt,
            tail_ps,
            own_time_ps,
            own_variance_ps2,
            pair: pair_of(pair),
        })
    }

    fn fields() -> Fields {
        // Made once, since every batch of rows needs them.
        static FIELDS: LazyLock<Fields> = LazyLock::new(|| {
            let field = |(n, name): (usize, &&str)| {
                let unit = unit_of(name).map(|unit| HashMap::from([("unit".to_owned(), unit.to_owned())]));
                Field::new(*name, DataType::Float64, n >= REQUIRED).with_metadata(unit.unwrap_or_default())
            };
            IMPULSE_FIELDS.iter().enumerate().map(field).collect()
        });
        FIELDS.clone()
    }
}

impl Cell for Vec<Impulse> {
    type Array = ListArray;
    const NULLABLE: bool = false;

    fn data_type() -> DataType {
        DataType::List(Arc::new(Field::new_list_field(DataType::Struct(Impulse::fields()), false)))
    }

    fn build<'a>(cells: impl Iterator<Item = &'a Self>) -> ArrayRef {
        let mut columns: [Vec<Option<f64>>; CELLS] = Default::default();
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
        let columns: [&Float64Array; CELLS] = std::array::from_fn(|c| columns[c].as_primitive::<Float64Type>());
        let impulse = |k: usize| Impulse::of_cells(&columns.map(|column| column.is_valid(k).then(|| column.value(k))));
        (0..items.len()).map(|k| impulse(k).expect("the schema says which fields are never null")).collect()
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
        /// Wall-clock time of the capture's first shot (ISO 8601, time zone of the instrument), where its file has it.
        acquired_at: Option<Name>,
        /// Time of sample 0 after the reference pulse, without the sensor's latency.
        t0_ps: f64,
        /// Time between samples.
        dt_ps: f64,
        /// Deconvolved profile, for plots and for the edge methods of detect.
        profile: Samples,
        /// Standard deviation of the noise in the deconvolved profile, in its unit.
        profile_noise: f64,
        /// Counts a bin without signal, whose noise that is, at least 1; null for voltages.
        background: Option<f64>,
        /// Impulses that explain the measured profile, in order of time; empty for methods that find none.
        impulses: Vec<Impulse>,
        /// Covariance of the impulses' times in ps^2, row by row; of their own times where impulses were predicted.
        impulse_cov: Vec<f64>,
        /// Chi-square of the fit over its degrees of freedom; null for methods without a fit.
        chi2_dof: Option<f64>,
        /// Standard deviation of a baseline that moves the same way in every shot, which the impulses were explained
        /// with, in the unit of the profile as it was measured; 0 where the profile shows none.
        ground_v: f64,
        /// Width of the response over that of the response captures, as the profile shows it; null where it
        /// does not determine the width. Where it is significant, the impulses are those of a response of this width.
        response_width: Option<f64>,
        /// Standard deviation of that.
        response_width_sd: Option<f64>,
        /// Standard deviation of the time error that all arrivals of the profile share.
        jitter_ps: f64,
        /// Relative standard deviation that all amplitudes of the profile share.
        gain_sd: f64,
        /// Laser energy relative to the response captures, from the integral of the reference pulse. Null without
        /// reference channel.
        power_ratio: Option<f64>,
    }
}
