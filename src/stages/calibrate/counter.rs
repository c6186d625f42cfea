//! Response and arrival from histograms of photons.

use super::{Counter, Estimate};
use crate::cancel::Cancel;
use crate::signal::oversample::{self, Shot};
use crate::signal::sparse::{self, SparseOptions, Unpiled};

/// What the histograms of a range say.
pub(super) fn estimate(histograms: &[Shot], dt_ps: f64, counter: Counter, cancel: &Cancel) -> Result<Estimate, String> {
    let cycles = counter
        .cycles
        .ok_or("the laser pulses behind a histogram are unknown; give its [sensors] entry in campaign.toml `cycles`")?;
    let t0_ps = histograms[0].t0_ps;
    // Histograms of another start cannot be added bin by bin.
    let alike: Vec<&Shot> = histograms.iter().filter(|histogram| histogram.t0_ps == t0_ps).collect();
    let counts: Vec<u32> = (0..histograms[0].samples.len())
        .map(|bin| alike.iter().map(|histogram| histogram.samples[bin].max(0.0)).sum::<f64>() as u32)
        .collect();
    let dead_bins = (counter.dead_time_ps / dt_ps).round() as usize;
    let unpiled = Unpiled::new(&counts, cycles * alike.len() as u64, dead_bins)
        .map_err(|error| format!("its response has {error}; check `cycles` and `dead_time_ps`"))?;
    let no_pulse = || "its response shows no pulse; check `samples` and the time window of the histogram".to_owned();
    let shape = oversample::shape(&[Shot { samples: unpiled.counts.clone(), t0_ps }], dt_ps).ok_or_else(no_pulse)?;
    let one = SparseOptions { pulses_max: 1, cancel: cancel.clone(), ..SparseOptions::default() };
    let fit = sparse::fit_counts(&unpiled, t0_ps, dt_ps, &shape.response(), &one);
    let pulse = fit.pulses.first().ok_or_else(no_pulse)?;
    Ok(Estimate {
        arrival_ps: (pulse.time_ps, fit.time_sd_ps(0)),
        width_sd_ps: None,
        noise_model: None,
        noise_acf: None,
        shots: alike.len(),
        shape,
    })
}
