//! `decompose`: the laser pulses of a lidar become echoes, with ranges and places.
//!
//! Each stretch of returning light is a level and a sum of echoes. Each echo is the outgoing pulse of its own shot,
//! moved and widened by a Gaussian of free width ([`crate::signal::echoes`] says how many there are, and what errors
//! have). Files without outgoing pulses need the width of one, `pulse_fwhm_ps`; it is then a Gaussian.
//!
//! The arrival is that of the outgoing pulse's maximum. The place of an echo is the anchor of its pulse, moved along
//! the beam with the arrival. Errors of anchor and direction are not in the standard deviations: files do not have
//! them.
//!
//! Takes `pulses`; writes `echoes`. A pulse without an echo has no row.
//!
//! ```toml
//! [echoes]
//! stage = "decompose"
//! from = "pulses"
//! ```

use std::collections::BTreeMap;
use std::ops::Range;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::stage::{BesideTables, Fold, Grain, Outcome, Rejection, Stage, StageError};
use crate::campaign::Campaign;
use crate::cancel::Cancel;
use crate::parameter::{Positive, Share};
use crate::signal::codes::Codes;
use crate::signal::echoes::{self, EchoOptions, Outgoing, Stretch};
use crate::signal::fft::RealFft;
use crate::tables::pulses::PulseColumns;
use crate::tables::{Echo, Name, Pulse, Row};
use crate::waveform::CodeType;

/// Steps of outgoing and returning light may differ by this share: files round them.
const SAME_STEP: f64 = 1e-6;

/// Parameters of `decompose`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Decompose {
    /// An echo is this many standard deviations high.
    threshold_sigma: Positive,
    /// The maximum of an echo rises out of its surroundings by this share of the strongest echo's height: receivers
    /// ring, and targets are rough.
    share_min: Share,
    /// Full width at half maximum of the outgoing pulse, for files without it.
    pulse_fwhm_ps: Option<Positive>,
    /// Codes from this one on are at the converter's rail; absent: the largest code of their type alone.
    rail_code: Option<Positive>,
}

impl Default for Decompose {
    fn default() -> Self {
        Self { threshold_sigma: Positive::new(5.0), share_min: Share::new(0.01), pulse_fwhm_ps: None, rail_code: None }
    }
}

/// A run under way.
pub struct State {
    campaign: Name,
    run: Name,
    pulses: usize,
    echoes: Vec<Echo>,
    /// Pulses that were rejected, by the reason.
    rejected: BTreeMap<String, usize>,
}

impl Stage for Decompose {
    const KIND: &'static str = "decompose";
    const VERSION: u32 = 1;
    const GRAIN: Grain = Grain::Capture;
    type Input = Pulse;
    type Output = Echo;
    type Fields = ();
    type Context = Cancel;

    fn fields(&self, _: &[Campaign]) {}

    fn context(&self, (): (), beside: &BesideTables) -> Result<Cancel, StageError> {
        Ok(beside.cancel.clone())
    }
}

impl Fold for Decompose {
    type State = State;

    fn begin(&self, _: &Cancel, first: Pulse) -> State {
        let Pulse { campaign, run, .. } = first;
        State { campaign, run, pulses: 0, echoes: Vec::new(), rejected: BTreeMap::new() }
    }

    fn step(
        &self,
        cancel: &Cancel,
        state: &mut State,
        columns: &PulseColumns,
        rows: Range<usize>,
    ) -> Result<(), StageError> {
        state.pulses += rows.len();
        let of_row = |fft: &mut RealFft, i: usize| {
            cancel.check();
            self.echoes(&Pulse::read(columns, i), fft)
        };
        let of_rows: Vec<Result<Vec<Echo>, String>> = rows.into_par_iter().map_init(RealFft::new, of_row).collect();
        for of_row in of_rows {
            match of_row {
                Ok(echoes) => state.echoes.extend(echoes),
                Err(reason) => *state.rejected.entry(reason).or_insert(0) += 1,
            }
        }
        Ok(())
    }

    fn finish(&self, _: &Cancel, state: State) -> Result<Outcome<Echo>, StageError> {
        let rejection = |(reason, count): (String, usize)| Rejection {
            file: Some(state.run.clone()),
            ..Rejection::new(&state.campaign, format!("{count} of {} pulses rejected: {reason}", state.pulses))
        };
        let rejections = state.rejected.into_iter().map(rejection).collect();
        Ok(Outcome { rows: state.echoes, sides: Vec::new(), rejections })
    }
}

impl Decompose {
    /// The echoes of a pulse, or why it is rejected.
    fn echoes(&self, pulse: &Pulse, fft: &mut RealFft) -> Result<Vec<Echo>, String> {
        let outgoing = self.outgoing(pulse)?;
        // Of the outgoing pulse's maximum, on the clock of the record.
        let left_ps = pulse.outgoing_t0_ps.map_or(0.0, |t0_ps| t0_ps + outgoing.peak * pulse.dt_ps);
        let options = EchoOptions { threshold_sigma: self.threshold_sigma.get(), share_min: self.share_min.get() };
        let code_type = CodeType::parse(&pulse.code_type).expect("ingest_pulses writes known code types only");
        let codes = Codes::of(&pulse.code_type, &pulse.codes).expect("ingest_pulses writes known code types only");
        let step = if codes.is_whole() { pulse.gain.abs() } else { 0.0 };
        let rail = self.rail_code.map(Positive::get).or(code_type.limits().map(|(_, high)| high));
        let is_clipped = |code: &f64| rail.is_some_and(|rail| *code >= rail);
        let (values, mut first, mut rows) = (codes.to_f64(), 0, Vec::new());
        for (start_ps, length) in pulse.starts_ps.iter().zip(&pulse.lengths) {
            let codes = &values[first..first + *length as usize];
            first += codes.len();
            let value = |code: &f64| if is_clipped(code) { f64::NAN } else { pulse.gain * code + pulse.offset };
            let samples: Vec<f64> = codes.iter().map(value).collect();
            let stretch = Stretch { samples: &samples, step };
            // A stretch of a few samples has no room for an echo.
            let Some(of_stretch) = echoes::decompose(&stretch, &outgoing, &options, fft) else { continue };
            let clipped = codes.iter().filter(|code| is_clipped(code)).count() as i32;
            for echo in &of_stretch.echoes {
                let mut row = row(pulse, echo, *start_ps, left_ps);
                (row.clipped, row.noise, row.independent) = (clipped, of_stretch.noise, of_stretch.independent);
                rows.push(row);
            }
        }
        let count = rows.len() as i32;
        for (number, row) in (1..).zip(&mut rows) {
            (row.echo, row.echoes) = (number, count);
        }
        Ok(rows)
    }

    /// The outgoing pulse in samples of the returning light.
    fn outgoing(&self, pulse: &Pulse) -> Result<Outgoing, String> {
        let Some(code_type) = &pulse.outgoing_type else {
            let fwhm_ps = self.pulse_fwhm_ps.ok_or(
                "the file has no outgoing pulse; give the full width at half maximum of the scanner's pulse as \
                 `pulse_fwhm_ps`",
            )?;
            return Ok(Outgoing::gaussian(fwhm_ps.get() / pulse.dt_ps));
        };
        let dt_ps = pulse.outgoing_dt_ps.ok_or("the outgoing pulse has no step of time")?;
        if (dt_ps - pulse.dt_ps).abs() > SAME_STEP * pulse.dt_ps {
            return Err(format!(
                "the outgoing pulse is sampled every {dt_ps} ps, the returning light every {} ps; equal steps are \
                 needed",
                pulse.dt_ps
            ));
        }
        let codes = Codes::of(code_type, &pulse.outgoing).expect("ingest_pulses writes known code types only");
        Outgoing::of(&codes.to_f64()).ok_or_else(|| {
            "the record of the outgoing pulse shows no whole pulse: a maximum with both flanks is needed".to_owned()
        })
    }
}

fn row(pulse: &Pulse, echo: &echoes::Echo, start_ps: f64, left_ps: f64) -> Echo {
    let time_ps = start_ps + echo.time * pulse.dt_ps - left_ps;
    let velocity = [pulse.velocity_x_m_per_ps, pulse.velocity_y_m_per_ps, pulse.velocity_z_m_per_ps];
    let speed_m_per_ps = velocity.iter().map(|v| v * v).sum::<f64>().sqrt();
    let time_sd_ps = echo.time_sd * pulse.dt_ps;
    Echo {
        campaign: pulse.campaign.clone(),
        sensor: pulse.sensor.clone(),
        run: pulse.run.clone(),
        pulse: pulse.pulse,
        channel: pulse.channel.clone(),
        gps_time_s: pulse.gps_time_s,
        echo: 0,
        echoes: 0,
        time_ps,
        time_sd_ps,
        edge_ps: echo.edge.map(|(edge, _)| start_ps + edge * pulse.dt_ps),
        edge_sd_ps: echo.edge.map(|(_, sd)| sd * pulse.dt_ps),
        height: echo.height,
        height_sd: echo.height_sd,
        width_ps: echo.width * pulse.dt_ps,
        width_sd_ps: echo.width_sd * pulse.dt_ps,
        range_m: speed_m_per_ps * time_ps,
        range_sd_m: speed_m_per_ps * time_sd_ps,
        x_m: pulse.anchor_x_m + pulse.velocity_x_m_per_ps * time_ps,
        y_m: pulse.anchor_y_m + pulse.velocity_y_m_per_ps * time_ps,
        z_m: pulse.anchor_z_m + pulse.velocity_z_m_per_ps * time_ps,
        clipped: 0,
        noise: 0.0,
        independent: 0.0,
    }
}
