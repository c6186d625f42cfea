//! Pixels of an image whose file has markers for its lines alone: each line is cut into equal times.
//!
//! A line begins at an event of the marker that the caller names. It ends at the marker of the tag `ImgHdr_LineStop`,
//! where the file has one, else where the next line begins; the last one then takes as long as the line before it.

use super::events::{Clock, Event};
use super::tags::{Tags, WHOLE};
use super::{Description, Events, FormatError, Input, Key, MARKERS, Survey};

const STOP: &str = "ImgHdr_LineStop";
const BOTH_WAYS: &str = "ImgHdr_BiDirect";

/// From when to when a line takes, in sync pulses (T3 mode) or units of time (T2 mode).
struct Line {
    start: u64,
    end: Option<u64>,
}

/// How lines are marked and cut.
pub(super) struct Pixels {
    /// Bits of the markers at which lines begin, and end.
    start: u32,
    stop: u32,
    of_line: u64,
}

impl Pixels {
    /// As the caller and the file say; `None` where the caller wants no pixels.
    pub(super) fn of(description: &Description, tags: &Tags) -> Result<Option<Self>, FormatError> {
        let Some((pixels, marker)) = description.pixels.zip(description.marker) else {
            return match description.pixels {
                None => Ok(None),
                Some(_) => Err(Key::Pixels.refuse("cuts lines: give the marker of their start as `marker`").into()),
            };
        };
        if tags.is_true(BOTH_WAYS) {
            return Err(tags.refuse(
                BOTH_WAYS,
                WHOLE,
                "= true: every other line runs backwards, which is not read; take `pixels` out, and cut the lines yourself",
            ));
        }
        let stop = tags.integer(STOP, WHOLE)?.and_then(|stop| u32::try_from(stop).ok());
        let stop = stop.filter(|stop| (1..=MARKERS).contains(stop) && *stop != marker);
        let bit = |marker: u32| 1 << (marker.clamp(1, MARKERS) - 1);
        Ok(Some(Self { start: bit(marker), stop: stop.map_or(0, bit), of_line: pixels.max(1).into() }))
    }

    /// What the events are together, cut at the pixels, at `most` so many; into none where no line begins.
    pub(super) fn survey(&self, events: &Events, input: &mut dyn Input, most: usize) -> Result<Survey, FormatError> {
        let lines = self.lines(events, input, most)?;
        let mut survey = Survey::cut_up();
        let (mut before, mut step, mut last) = (Clock::new(events.layout), 0, 0);
        events.start().each(input.file(), |number, clock, event| {
            while self.boundary(&lines, step).is_some_and(|at| at <= clock.now()) {
                self.pass(&mut survey, step, events, number, before);
                step += 1;
            }
            survey.take(event);
            (before, last) = (*clock, number + 1);
            Ok(())
        })?;
        while self.boundary(&lines, step).is_some() {
            self.pass(&mut survey, step, events, last, before);
            step += 1;
        }
        Ok(survey)
    }

    fn lines(&self, events: &Events, input: &mut dyn Input, most: usize) -> Result<Vec<Line>, FormatError> {
        let (mut lines, mut count): (Vec<Line>, u64) = (Vec::new(), 0);
        let most = most as u64 / self.of_line;
        events.start().each(input.file(), |_, clock, event| {
            let Event::Markers(bits) = event else { return Ok(()) };
            if bits & (self.start | self.stop) != 0
                && let Some(line) = lines.last_mut()
            {
                line.end.get_or_insert(clock.now());
            }
            if bits & self.start != 0 {
                count += 1;
                if count <= most {
                    lines.push(Line { start: clock.now(), end: None });
                }
            }
            Ok(())
        })?;
        if count > most {
            let problem = format!(
                "= {} makes {} histograms of {count} lines, too many for the file",
                self.of_line,
                count * self.of_line
            );
            return Err(Key::Pixels.refuse(format!("{problem}; cut the measurement into files, or give fewer")).into());
        }
        let took = match lines.as_slice() {
            [.., line, _] => line.end.map(|end| end.saturating_sub(line.start)),
            _ => None,
        };
        let Some(last) = lines.last_mut() else { return Ok(lines) };
        last.end = last.end.or(took.map(|took| last.start.saturating_add(took)));
        if last.end.is_none() {
            return Err(Key::Pixels.refuse("cuts lines, and the only line of the file has no end; take it out").into());
        }
        Ok(lines)
    }

    /// When step `step` happens: a pixel begins, or after the last of its line the line ends.
    fn boundary(&self, lines: &[Line], step: u64) -> Option<u64> {
        let (line, pixel) = (step / (self.of_line + 1), step % (self.of_line + 1));
        let Line { start, end } = lines.get(usize::try_from(line).ok()?)?;
        let took = end.unwrap_or(*start).saturating_sub(*start);
        let after = u128::from(took) * u128::from(pixel) / u128::from(self.of_line);
        Some(start + u64::try_from(after).expect("a part of what the line takes"))
    }

    /// Makes a step before the event `number`.
    fn pass(&self, survey: &mut Survey, step: u64, events: &Events, number: u64, clock: Clock) {
        if step % (self.of_line + 1) == self.of_line {
            survey.end(events, number);
        } else {
            survey.cut(events, number, clock);
        }
    }
}
