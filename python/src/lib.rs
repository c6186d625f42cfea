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
//! | `runs` | [`periscope::pipeline`], [`periscope::simulate`] |
//! | `results` | [`periscope::store`], [`periscope::history`], [`periscope::report`] |
//! | `arrays`, `failure`, `interrupt` | arguments, exceptions, Ctrl-C |

// An owned array, reference or interpreter token is how PyO3 passes each argument.
#![allow(clippy::needless_pass_by_value)]
#![allow(clippy::too_many_arguments, reason = "keywords of Python functions")]

mod arrays;
mod distances;
mod failure;
mod interrupt;
mod positions;
mod profiles;
mod pulses;
mod results;
mod runs;
mod waveforms;

use pyo3::prelude::*;

#[pymodule]
mod _periscope {
    #[pymodule_export]
    use crate::distances::{
        Distances, Ranges, classical_scaling, complete_distances, iso_embed, smacof, t2_distances, t3_ranges,
    };
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
    use crate::runs::{run, simulate};
    #[pymodule_export]
    use crate::waveforms::{Waveform, Waveforms, read};

    #[pymodule_export]
    const VERSION: &str = env!("CARGO_PKG_VERSION");
}
