//! Events of 32 bits, one after the other: photons, sync pulses, overflows of the counter and markers.

use std::io;

/// Counts after which the time of an event begins anew in T2 mode: PicoHarp, first version of the HydraHarp, others.
const WRAP_PICO_HARP: u64 = 210_698_240;
const WRAP_HYDRA_HARP_1: u64 = 33_552_000;
const WRAP: u64 = 1 << 25;

/// The same of the sync counter in T3 mode: PicoHarp, others.
const SYNCS_PICO_HARP: u64 = 1 << 16;
const SYNCS: u64 = 1 << 10;

/// How an event is laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Layout {
    /// 4 bits channel, 12 bits time after the sync, 16 bits sync counter.
    PicoHarpT3,
    /// Special, 6 bits channel, 15 bits time after the sync, 10 bits sync counter; whether an overflow of that counts
    /// how often.
    HydraHarpT3 { is_counted: bool },
    /// 4 bits channel (0: sync), 28 bits time.
    PicoHarpT2,
    /// Special, 6 bits channel (0 of the special ones: sync), 25 bits time, which wraps after so many; whether an
    /// overflow counts how often.
    HydraHarpT2 { wrap: u64, is_counted: bool },
}

impl Layout {
    /// Of a record type of the file's head.
    pub(super) fn of(record_type: u64) -> Option<Self> {
        match record_type {
            0x0001_0303 => Some(Self::PicoHarpT3),
            // HydraHarp, its version 2, TimeHarp 260 N and P, MultiHarp and PicoHarp 330.
            0x0001_0304 => Some(Self::HydraHarpT3 { is_counted: false }),
            0x0001_0305..=0x0001_0307 | 0x0101_0304..=0x0101_0307 => Some(Self::HydraHarpT3 { is_counted: true }),
            0x0001_0203 => Some(Self::PicoHarpT2),
            0x0001_0204 => Some(Self::HydraHarpT2 { wrap: WRAP_HYDRA_HARP_1, is_counted: false }),
            0x0001_0205..=0x0001_0207 | 0x0101_0204..=0x0101_0207 => {
                Some(Self::HydraHarpT2 { wrap: WRAP, is_counted: true })
            }
            _ => None,
        }
    }

    /// Whether times count from the start of the measurement.
    pub(super) const fn is_t2(self) -> bool {
        matches!(self, Self::PicoHarpT2 | Self::HydraHarpT2 { .. })
    }
}

/// Most markers: each is a bit.
pub(super) const MARKERS: u32 = 4;

/// What an event is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Event {
    /// A photon: its channel, and its time after the sync pulse in units of the time base.
    Photon(usize, u64),
    /// Markers, a bit each.
    Markers(u32),
    /// A sync pulse, an overflow, a photon before any sync pulse.
    Other,
}

/// The time of events in a file, as they are passed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Clock {
    layout: Layout,
    /// Time at which the counter last began anew, of the last event, and of the last sync pulse: in T3 mode the first
    /// two count sync pulses.
    wrapped: u64,
    now: u64,
    sync: Option<u64>,
}

impl Clock {
    pub(super) const fn new(layout: Layout) -> Self {
        Self { layout, wrapped: 0, now: 0, sync: None }
    }

    /// When the last event was: sync pulses since the start in T3 mode, units of time in T2 mode.
    pub(super) const fn now(&self) -> u64 {
        self.now
    }

    /// Passes an event.
    #[inline]
    pub(super) fn event(&mut self, event: u32) -> io::Result<Event> {
        let field = |from: u32, bits: u32| event >> from & ((1 << bits) - 1);
        match self.layout {
            Layout::PicoHarpT3 => {
                let (channel, time, syncs) = (field(28, 4), field(16, 12), field(0, 16));
                if (channel, time) == (15, 0) {
                    return Ok(self.wrap(SYNCS_PICO_HARP));
                }
                self.pass(syncs);
                match channel {
                    15 => Ok(markers(time)),
                    1..=4 => Ok(Event::Photon(channel as usize, time.into())),
                    _ => Err(no_channel(channel)),
                }
            }
            Layout::HydraHarpT3 { is_counted } => {
                let (channel, time, syncs) = (field(25, 6), field(10, 15), field(0, 10));
                match (field(31, 1), channel) {
                    (1, 63) if is_counted => return Ok(self.wrap(SYNCS * u64::from(syncs.max(1)))),
                    (1, 63) => return Ok(self.wrap(SYNCS)),
                    _ => self.pass(syncs),
                }
                Ok(if field(31, 1) == 1 { markers(channel) } else { Event::Photon(channel as usize, time.into()) })
            }
            Layout::PicoHarpT2 => match (field(28, 4), field(0, 28)) {
                // The lowest bits of a special event are markers.
                (15, time) if time.trailing_zeros() >= 4 => Ok(self.wrap(WRAP_PICO_HARP)),
                (15, time) => {
                    self.pass(time & !15);
                    Ok(markers(time & 15))
                }
                (0, time) => Ok(self.sync(time)),
                (channel @ 1..=4, time) => Ok(self.after_sync(channel, time)),
                (channel, _) => Err(no_channel(channel)),
            },
            Layout::HydraHarpT2 { wrap, is_counted } => {
                let (channel, time) = (field(25, 6), field(0, 25));
                Ok(match (field(31, 1), channel) {
                    (0, _) => self.after_sync(channel, time),
                    (_, 0) => self.sync(time),
                    (_, 63) if is_counted => self.wrap(wrap * u64::from(time.max(1))),
                    (_, 63) => self.wrap(wrap),
                    (_, bits) => {
                        self.pass(time);
                        markers(bits)
                    }
                })
            }
        }
    }

    fn wrap(&mut self, by: u64) -> Event {
        // A file of so many overflows that this ends is larger than any disk.
        self.wrapped = self.wrapped.saturating_add(by);
        self.now = self.wrapped;
        Event::Other
    }

    /// An event at this count.
    fn pass(&mut self, count: u32) {
        self.now = self.wrapped.saturating_add(count.into());
    }

    fn sync(&mut self, time: u32) -> Event {
        self.pass(time);
        self.sync = Some(self.now);
        Event::Other
    }

    /// A photon, if a sync pulse came before it.
    fn after_sync(&mut self, channel: u32, time: u32) -> Event {
        self.pass(time);
        let after = self.sync.and_then(|sync| self.now.checked_sub(sync));
        after.map_or(Event::Other, |after| Event::Photon(channel as usize, after))
    }
}

/// Markers, if these are their bits.
fn markers(bits: u32) -> Event {
    if (1..1 << MARKERS).contains(&bits) { Event::Markers(bits) } else { Event::Other }
}

fn no_channel(channel: u32) -> io::Error {
    let problem = format!("an event on channel {channel}, but a PicoHarp has 1 to 4: the file is damaged");
    io::Error::new(io::ErrorKind::InvalidData, problem)
}
