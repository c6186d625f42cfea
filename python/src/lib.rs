//! The native half of the Python package `periscope`. Each file wraps one room of the Rust crates: it checks arguments,
//! hands arrays over, and turns errors into exceptions. No method has code of its own here.
//!
//! | file | wraps |
//! |---|---|
//! | `waveforms` | [`periscope::formats`] |
//! | `profiles` | [`periscope::signal`]: shots to means, noise, responses |
//! | `pulses` | [`periscope::signal::sparse`] |
//! | `distances` | [`periscope::geometry`]: lengths to distances to a first embedding |
//! | `positions` | [`periscope::geometry::maximum_likelihood`] |
//! | `onsets` | [`periscope::signal::onset`]: classical timing |
//! | `hidden` | [`periscope::geometry::hidden`], [`periscope::geometry::faint`] |
//! | `surfaces` | [`periscope::signal::edge`], [`periscope::geometry::first_return`], shapes and height fields |
//! | `designs` | [`periscope::bound`], [`periscope::wall_outlook`] |
//! | `runs` | [`periscope::pipeline`], [`periscope::simulate`] |
//! | `results` | [`periscope::store`], [`periscope::history`], [`periscope::report`] |
//! | `arrays`, `failure`, `interrupt`, `plots` | arguments, exceptions, Ctrl-C, pictures |

// An owned array, reference or interpreter token is how PyO3 passes each argument.
#![allow(clippy::needless_pass_by_value)]
#![allow(clippy::too_many_arguments, reason = "keywords of Python functions")]

mod arrays;
mod designs;
mod distances;
mod failure;
mod hidden;
mod interrupt;
mod onsets;
mod plots;
mod positions;
mod profiles;
mod pulses;
mod results;
mod runs;
mod surfaces;
mod waveforms;

use pyo3::prelude::*;

#[pymodule]
mod _periscope {
    #[pymodule_export]
    use crate::designs::{Bounds, PulseBound, TimeBound, bounds, design_json, time_bound};
    #[pymodule_export]
    use crate::distances::{
        Distances, Ranges, classical_scaling, complete_distances, iso_embed, smacof, t2_distances, t3_ranges,
    };
    #[pymodule_export]
    use crate::hidden::{HiddenPatch, find_hidden, matched_filter, search_hidden};
    #[pymodule_export]
    use crate::onsets::{Onsets, constant_fraction, leading_edge, threshold_crossing};
    #[pymodule_export]
    use crate::positions::{Positions, solve_positions};
    #[pymodule_export]
    use crate::profiles::{
        Mean, Noise, Response, ResponseEstimate, autoregressive_acf, average, correct_pile_up, estimate_noise,
        estimate_response, quietest,
    };
    #[pymodule_export]
    use crate::pulses::{Pulses, deconvolve, deconvolve_counts};
    #[pymodule_export]
    use crate::results::{Results, Table};
    #[pymodule_export]
    use crate::runs::{load_campaign, run, simulate};
    #[pymodule_export]
    use crate::surfaces::{FirstReturns, HeightField, Shape, SurfacePoints, first_returns, surface_points};
    #[pymodule_export]
    use crate::waveforms::{Waveform, Waveforms, read};

    #[pymodule_export]
    const VERSION: &str = env!("CARGO_PKG_VERSION");
}
