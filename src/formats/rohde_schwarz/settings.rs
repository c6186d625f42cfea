//! The settings in the XML header: `<Prop Name="XStart" Value="-1e-9" UnitName="s" .../>`. Properties of several
//! channels have `I_0="..." I_1="..."` instead of Value.

use std::io::BufReader;

use quick_xml::events::{BytesStart, Event};

use super::super::reader::{FormatError, Input};
use crate::waveform::{CodeType, Kind, Scale};

/// The properties that are read.
const NAMES: [&str; 31] = [
    "BaseUnit",
    "DecimationMode",
    "InterleavedTraceCount",
    "LeadingSettlingSamples",
    "MultiChannelExport",
    "MultiChannelExportState",
    "MultiChannelSource",
    "MultiChannelVerticalOffset",
    "MultiChannelVerticalPosition",
    "MultiChannelVerticalScale",
    "MultiChannelViewUnit",
    "NofQuantisationLevels",
    "NumberOfAcquisitions",
    "RecordLength",
    "SignalFormat",
    "SignalHardwareRecordLength",
    "SignalRecordLength",
    "SignalResolution",
    "Source",
    "SourceType",
    "Timestamp",
    "TimestampState",
    "TraceArithmetics",
    "TraceType",
    "VerticalDivisionCount",
    "VerticalOffset",
    "VerticalPosition",
    "VerticalScale",
    "XAxisMode",
    "XStart",
    "XStop",
];

/// Most channels of one export.
const CHANNELS: usize = 8;

/// Largest depth of elements; real files have three.
const DEPTH: usize = 16;

/// Most bytes of a value.
const VALUE_BYTES: usize = 256;

/// An error at a byte of the file.
pub(super) fn field(byte_offset: u64, problem: impl Into<String>) -> FormatError {
    FormatError::Field { byte_offset, problem: problem.into() }
}

/// An error of the XML syntax. It omits most of the parser's message, which may quote much of the file.
fn unsound(position: u64, error: &quick_xml::Error) -> FormatError {
    let error: String = error.to_string().chars().take(120).collect();
    field(position, format!("is no sound XML ({error}); copy the file from the instrument again"))
}

/// One property.
#[derive(Debug, Default)]
struct Property {
    position: u64,
    value: Option<String>,
    unit: Option<String>,
    items: [Option<String>; CHANNELS],
}

/// The properties that are read.
#[derive(Debug)]
pub(super) struct Settings {
    properties: [Option<Property>; NAMES.len()],
    /// Where the XML ends.
    pub(super) end: u64,
}

/// One channel of an export.
#[derive(Debug)]
pub(super) struct Channel {
    /// C1 for channel 1; the names of other sources are those of the header.
    pub name: String,
    /// Unit of its values.
    pub unit: Option<String>,
    /// VerticalScale: units per division.
    pub scale: f64,
    /// VerticalOffset.
    pub offset: f64,
    /// VerticalPosition, in divisions.
    position: f64,
}

impl Settings {
    pub(super) fn read(input: &mut dyn Input) -> Result<Self, FormatError> {
        let mut settings = Self { properties: [const { None }; NAMES.len()], end: 0 };
        let mut xml = quick_xml::Reader::from_reader(BufReader::new(input.stream()?));
        let (mut buffer, mut depth, mut closed) = (Vec::new(), 0_usize, false);
        while !closed {
            let position = xml.buffer_position();
            buffer.clear();
            match xml.read_event_into(&mut buffer) {
                Ok(Event::Start(element)) => {
                    settings.take(&element, position)?;
                    depth += 1;
                    if depth > DEPTH {
                        return Err(field(position, "the XML is nested deeper than that of any instrument"));
                    }
                }
                Ok(Event::Empty(element)) => settings.take(&element, position)?,
                Ok(Event::End(_)) => {
                    depth = depth.saturating_sub(1);
                    closed = depth == 0;
                    settings.end = xml.buffer_position();
                }
                Ok(Event::Eof) => {
                    return Err(field(
                        position,
                        "the XML ends before </Database>; copy the file from the instrument again",
                    ));
                }
                Ok(_) => {}
                Err(quick_xml::Error::Io(error)) => return Err(std::io::Error::from(error.kind()).into()),
                Err(error) => return Err(unsound(xml.error_position(), &error)),
            }
        }
        Ok(settings)
    }

    /// Keeps a property, if `NAMES` has it.
    fn take(&mut self, element: &BytesStart, position: u64) -> Result<(), FormatError> {
        if element.name().0 != "Prop" {
            return Ok(());
        }
        let mut property = Property { position, ..Property::default() };
        let mut index = None;
        for attribute in element.attributes().with_checks(false) {
            let attribute = attribute.map_err(|error| unsound(position, &error.into()))?;
            let value = || Some(attribute.value.clone().into_owned());
            match attribute.key.0 {
                "Name" => index = NAMES.iter().position(|name| *name == attribute.value),
                "Value" => property.value = value(),
                "UnitName" => property.unit = value(),
                key => {
                    let item = key.strip_prefix("I_").and_then(|number| number.parse::<usize>().ok());
                    if let Some(item) = item.and_then(|item| property.items.get_mut(item)) {
                        *item = value();
                    }
                }
            }
        }
        let Some(index) = index else { return Ok(()) };
        let texts = property.items.iter().chain([&property.value, &property.unit]);
        if texts.flatten().any(|text| text.len() > VALUE_BYTES) {
            return Err(field(
                position,
                format!("{} is longer than any real one; export the record again", NAMES[index]),
            ));
        }
        if self.properties[index].is_some() {
            return Err(field(position, format!("{} stands in the head twice; export the record again", NAMES[index])));
        }
        self.properties[index] = Some(property);
        Ok(())
    }

    fn property(&self, name: &str) -> Option<&Property> {
        let index = NAMES.iter().position(|entry| *entry == name).expect("a property that is read");
        self.properties[index].as_ref()
    }

    /// Where a property is in the file; 0 if it is absent.
    pub(super) fn position(&self, name: &str) -> u64 {
        self.property(name).map_or(0, |property| property.position)
    }

    pub(super) fn text(&self, name: &str) -> Option<&str> {
        self.property(name).and_then(|property| property.value.as_deref())
    }

    pub(super) fn unit(&self, name: &str) -> Option<&str> {
        self.property(name).and_then(|property| property.unit.as_deref())
    }

    pub(super) fn is_on(&self, name: &str) -> bool {
        self.text(name) == Some("eRS_ONOFF_ON")
    }

    fn required(&self, name: &str) -> Result<&str, FormatError> {
        self.text(name).ok_or_else(|| {
            field(self.position(name), format!("the head has no {name}; export the record again with current firmware"))
        })
    }

    pub(super) fn number(&self, name: &str) -> Result<f64, FormatError> {
        self.finite(name, self.required(name)?)
    }

    pub(super) fn optional(&self, name: &str) -> Result<Option<f64>, FormatError> {
        self.text(name).map(|text| self.finite(name, text)).transpose()
    }

    fn finite(&self, name: &str, text: &str) -> Result<f64, FormatError> {
        let number = text.parse().ok().filter(|number: &f64| number.is_finite());
        number.ok_or_else(|| field(self.position(name), format!("{name} = {text:?} is no number")))
    }

    pub(super) fn count(&self, name: &str) -> Result<u64, FormatError> {
        let text = self.required(name)?;
        // Instruments may print large numbers with an exponent.
        let count: Option<f64> = text.parse().ok();
        let count = count.filter(|count| count.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(count));
        count
            .map(|count| count as u64)
            .ok_or_else(|| field(self.position(name), format!("{name} = {text:?} is no count")))
    }

    /// Samples of an acquisition, and rows that hold them.
    pub(super) fn rows(&self) -> Result<(usize, u64), FormatError> {
        let (samples, rows) = (self.count("RecordLength")?, self.count("SignalHardwareRecordLength")?);
        let leading = self.count("LeadingSettlingSamples")?;
        if samples == 0 || leading + samples > rows {
            return Err(field(
                self.position("RecordLength"),
                format!(
                    "RecordLength = {samples} after LeadingSettlingSamples = {leading} does not fit into \
                     SignalHardwareRecordLength = {rows}; export the record again"
                ),
            ));
        }
        // The vendor's own reader uses SignalRecordLength. Both were equal in every file available, so a difference is
        // an error.
        if self.text("SignalRecordLength").is_some() && self.count("SignalRecordLength")? != samples {
            return Err(field(
                self.position("SignalRecordLength"),
                format!("SignalRecordLength is not RecordLength = {samples}; export the record without interpolation"),
            ));
        }
        Ok((samples as usize, rows))
    }

    /// Type of the samples, and bytes of x in a row. `code` is the type in the companion's header, at `position`.
    pub(super) fn code_type(&self, code: u32, position: u64) -> Result<(CodeType, u64), FormatError> {
        let (name, code_type, x_bytes) = match code {
            0 => ("INT8BIT", CodeType::I8, 0),
            1 => ("INT16BIT", CodeType::I16, 0),
            4 => ("FLOAT", CodeType::F32, 0),
            6 => ("XYDOUBLEFLOAT", CodeType::F32, 8),
            _ => {
                let problem = format!("samples of type {code} are not read; export raw data, float, or XY");
                return Err(field(position, problem));
            }
        };
        let format = self.required("SignalFormat")?;
        if format.strip_prefix("eRS_SIGNAL_FORMAT_") != Some(name) {
            let problem =
                format!("SignalFormat = {format}, but the .Wfm.bin has {name}; the two files are not of one recording");
            return Err(field(self.position("SignalFormat"), problem));
        }
        Ok((code_type, x_bytes))
    }

    /// Kind of the traces, and the number of traces per channel.
    pub(super) fn kind(&self) -> Result<(Kind, usize), FormatError> {
        if let Some(source) = self.text("SourceType").filter(|source| *source != "eRS_SIGNAL_SOURCE_TYPE_SOURCE") {
            let problem = format!("SourceType = {source} is not read; export analog channels, or as CSV");
            return Err(field(self.position("SourceType"), problem));
        }
        let says = |name: &str, word: &str| self.text(name).is_some_and(|text| text.contains(word));
        if says("TraceType", "ENVELOPE") {
            return Ok((Kind::Envelope, 2));
        }
        match self.optional("InterleavedTraceCount")?.unwrap_or(1.0) {
            2.0 => Ok((Kind::Envelope, 2)),
            1.0 if says("DecimationMode", "PEAK") => Ok((Kind::Envelope, 1)),
            1.0 if says("TraceType", "AVERAGE") || says("TraceArithmetics", "AVERAGE") => Ok((Kind::Average, 1)),
            1.0 => Ok((Kind::Waveform, 1)),
            count => Err(field(
                self.position("InterleavedTraceCount"),
                format!("InterleavedTraceCount = {count} traces of a channel are not read; export a plain waveform"),
            )),
        }
    }

    /// The channels of the export, in the order of a row.
    pub(super) fn channels(&self) -> Result<Vec<Channel>, FormatError> {
        if !self.is_on("MultiChannelExport") {
            return Ok(vec![Channel {
                name: source(self.required("Source")?),
                unit: self.text("BaseUnit").and_then(unit),
                scale: self.number("VerticalScale")?,
                offset: self.number("VerticalOffset")?,
                position: self.number("VerticalPosition")?,
            }]);
        }
        let mut channels = Vec::new();
        for index in (0..CHANNELS).filter(|index| self.item("MultiChannelExportState", *index) == Some("eRS_ONOFF_ON"))
        {
            let number = |name| self.finite(name, self.required_item(name, index)?);
            channels.push(Channel {
                name: source(self.required_item("MultiChannelSource", index)?),
                unit: self.item("MultiChannelViewUnit", index).and_then(unit),
                scale: number("MultiChannelVerticalScale")?,
                offset: number("MultiChannelVerticalOffset")?,
                position: number("MultiChannelVerticalPosition")?,
            });
        }
        if channels.is_empty() {
            let problem = "MultiChannelExportState has no channel on; export the record again";
            return Err(field(self.position("MultiChannelExportState"), problem));
        }
        Ok(channels)
    }

    /// Value of a property for channel `index` of an export of several.
    fn item(&self, name: &str, index: usize) -> Option<&str> {
        self.property(name)?.items[index].as_deref()
    }

    fn required_item(&self, name: &str, index: usize) -> Result<&str, FormatError> {
        self.item(name, index).ok_or_else(|| {
            field(self.position(name), format!("the head has no {name} I_{index}; export the record again"))
        })
    }

    /// Scale from raw codes to values.
    pub(super) fn raw_scale(&self, channel: &Channel) -> Result<Scale, FormatError> {
        let (levels, divisions) = (self.number("NofQuantisationLevels")?, self.number("VerticalDivisionCount")?);
        let gain = channel.scale * divisions / levels;
        let offset = channel.offset - channel.position * channel.scale;
        if gain == 0.0 || !gain.is_finite() || !offset.is_finite() {
            return Err(field(
                self.position("NofQuantisationLevels"),
                format!(
                    "VerticalScale = {}, VerticalDivisionCount = {divisions}, NofQuantisationLevels = {levels} give {} no scale; \
                     export the record again",
                    channel.scale, channel.name
                ),
            ));
        }
        Ok(Scale { gain, offset })
    }

    /// `2021:09:09 10:29 14,017.925.386 s` in ISO 8601.
    pub(super) fn acquired_at(&self) -> Option<String> {
        let text = self.text("Timestamp")?.strip_suffix('s')?.trim_end();
        let [date, time, seconds] = text.split(' ').collect::<Vec<_>>()[..] else { return None };
        let (second, fraction) = seconds.split_once(',')?;
        let digits: String = fraction.split('.').collect();
        let digits_only =
            |text: &str, count: usize| text.len() == count && text.bytes().all(|byte| byte.is_ascii_digit());
        let parts: Vec<&str> = date.split(':').chain(time.split(':')).chain([second]).collect();
        let [year, month, day, hour, minute, second] = parts[..] else { return None };
        let sound = digits_only(year, 4)
            && [month, day, hour, minute, second].iter().all(|part| digits_only(part, 2))
            && digits_only(&digits, 9);
        sound.then(|| format!("{year}-{month}-{day}T{hour}:{minute}:{second}.{digits}"))
    }
}

/// `eRS_SIGNAL_SOURCE_CH1_TR1` is C1; other sources keep their names.
fn source(text: &str) -> String {
    let name = text.strip_prefix("eRS_SIGNAL_SOURCE_").unwrap_or(text);
    match name.strip_prefix("CH").and_then(|name| name.strip_suffix("_TR1")) {
        Some(number) => format!("C{number}"),
        None => name.to_owned(),
    }
}

/// `eRS_UNIT_LEVEL_V` is V.
fn unit(text: &str) -> Option<String> {
    let name = text.strip_prefix("eRS_UNIT_").unwrap_or(text);
    let name = name.strip_prefix("LEVEL_").unwrap_or(name);
    (name != "NONE").then(|| name.to_owned())
}
