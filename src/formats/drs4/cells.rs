//! Cells of unequal width, and codes at equal steps.

use std::io::{self, SeekFrom};
use std::ops::ControlFlow;
use std::sync::Arc;

use crate::waveform::{ReadSeek, Unpack};

/// Sampling cells of a channel.
pub(super) const CELLS: usize = 1024;
/// Widest cell that is accepted, in ns: the slowest sampling has cells of 2 ns.
const WIDEST_NS: f32 = 10.0;
/// Highest code.
const TOP: f64 = 65_535.0;

/// The cells of a channel.
#[derive(Debug)]
pub(super) struct Channel {
    /// Where each cell begins after cell 0, and the end of the last one, in ns.
    starts_ns: Vec<f64>,
}

impl Channel {
    /// From the widths in a file.
    pub(super) fn new(widths: &[u8]) -> Result<Self, String> {
        let mut starts_ns = Vec::with_capacity(CELLS + 1);
        let mut at_ns = 0.0;
        starts_ns.push(at_ns);
        for (cell, width) in widths.as_chunks::<4>().0.iter().enumerate() {
            let width_ns = f32::from_le_bytes(*width);
            if !(width_ns > 0.0 && width_ns <= WIDEST_NS) {
                return Err(format!(
                    "cell {cell} is {width_ns} ns wide: the widths are not those of 1024 cells; calibrate the board's \
                     times, and save records of 1024 samples"
                ));
            }
            at_ns += f64::from(width_ns);
            starts_ns.push(at_ns);
        }
        Ok(Self { starts_ns })
    }

    /// Mean width of a cell, in seconds.
    pub(super) fn mean_s(&self) -> f64 {
        self.starts_ns[CELLS] / CELLS as f64 * 1e-9
    }

    /// Time from the first sample to the next sampling of cell 0, where sampling stopped in cell `stop`.
    fn to_cell_0_ns(&self, stop: usize) -> f64 {
        if stop == 0 { 0.0 } else { self.starts_ns[CELLS] - self.starts_ns[stop] }
    }

    /// Time of sample `i` after the first one.
    fn time_ns(&self, stop: usize, i: usize) -> f64 {
        let cell = stop + i;
        let round_ns = if cell < CELLS { 0.0 } else { self.starts_ns[CELLS] };
        round_ns + self.starts_ns[cell % CELLS] - self.starts_ns[stop]
    }
}

/// The codes of a channel in an event.
#[derive(Debug)]
pub(super) struct Cells {
    /// Where they are.
    pub at: u64,
    /// The cell of the first code.
    pub stop: usize,
    pub own: Arc<Channel>,
    /// The board's first channel, whose first sample all times count from.
    pub first: Arc<Channel>,
}

impl Unpack for Cells {
    fn unpack(
        &self,
        file: &mut dyn ReadSeek,
        take: &mut dyn FnMut(&[u8]) -> io::Result<ControlFlow<()>>,
    ) -> io::Result<()> {
        let mut bytes = vec![0; 2 * CELLS];
        file.seek(SeekFrom::Start(self.at))?;
        file.read_exact(&mut bytes)?;
        let codes: Vec<f64> = bytes.as_chunks().0.iter().map(|code| u16::from_le_bytes(*code).into()).collect();
        let even = self.at_equal_steps(&codes);
        take(&even.iter().flat_map(|code| (*code as f32).to_le_bytes()).collect::<Vec<u8>>()).map(|_| ())
    }
}

impl Cells {
    fn at_equal_steps(&self, codes: &[f64]) -> Vec<f64> {
        let shift_ns = self.first.to_cell_0_ns(self.stop) - self.own.to_cell_0_ns(self.stop);
        let times_ns: Vec<f64> = (0..CELLS).map(|i| shift_ns + self.own.time_ns(self.stop, i)).collect();
        let step_ns = self.first.starts_ns[CELLS] / CELLS as f64;
        let mut before = 0;
        let at = |i: usize| {
            let time_ns = i as f64 * step_ns;
            while before + 1 < CELLS && times_ns[before + 1] <= time_ns {
                before += 1;
            }
            if time_ns <= times_ns[0] {
                codes[0]
            } else if before + 1 == CELLS {
                codes[before]
            } else {
                let first = before.saturating_sub(1).min(CELLS - 4);
                cubic(&times_ns[first..first + 4], &codes[first..first + 4], time_ns).clamp(0.0, TOP)
            }
        };
        (0..CELLS).map(at).collect()
    }
}

/// The cubic through four points, at a time (Lagrange).
fn cubic(times: &[f64], values: &[f64], time: f64) -> f64 {
    let term = |i: usize| {
        let others = (0..4).filter(|k| *k != i);
        values[i] * others.map(|k| (time - times[k]) / (times[i] - times[k])).product::<f64>()
    };
    (0..4).map(term).sum()
}
