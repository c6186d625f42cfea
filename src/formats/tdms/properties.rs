//! Properties of objects, as far as records need them.

use crate::picoquant::iso;
use crate::waveform::{Kind, Scale};

/// Most scales of a channel, and coefficients of a polynomial.
const SCALES: usize = 16;
/// Input of a scale that takes the values in the file.
const RAW_INPUT: u32 = u32::MAX;
/// Days from 1899-12-30 to 1904-01-01, from which times count.
const EPOCH_DAYS: f64 = 1462.0;
const DAY_S: f64 = 86_400.0;
/// Units as programs write them: text, name, and how many of the named unit one of the text is.
const UNITS: [(&str, &str, f64); 8] = [
    ("V", "V", 1.0),
    ("v", "V", 1.0),
    ("Volt", "V", 1.0),
    ("Volts", "V", 1.0),
    ("volts", "V", 1.0),
    ("mV", "V", 1e-3),
    ("A", "A", 1.0),
    ("mA", "A", 1e-3),
];

/// A value of a property.
#[derive(Debug)]
pub(super) enum Value {
    Number(f64),
    Text(String),
    /// Seconds after the beginning of 1904, universal time.
    Time(f64),
    Other,
}

/// A scale: its type, and `slope * x + intercept` as far as it is linear.
#[derive(Clone, Debug)]
struct Step {
    kind: Option<String>,
    linear: [f64; 2],
    /// Coefficients of a polynomial; those beyond are 0.
    powers: [f64; SCALES],
    input: u32,
}

impl Default for Step {
    fn default() -> Self {
        Self { kind: None, linear: [0.0, 1.0], powers: [0.0; SCALES], input: RAW_INPUT }
    }
}

/// The time base of a channel, in seconds.
pub(super) struct Time {
    pub step_s: Option<f64>,
    pub start_s: Option<f64>,
}

/// Those properties of an object that are used.
#[derive(Clone, Debug, Default)]
pub(super) struct Properties {
    increment: Option<f64>,
    start_offset: Option<f64>,
    /// Values of a waveform.
    pub samples: Option<u64>,
    /// Unit of a value, without its prefix.
    pub unit: Option<String>,
    /// How many units a value in the file's unit is.
    factor: Option<f64>,
    /// Time of the first waveform in ISO 8601, universal time.
    pub acquired_at: Option<String>,
    is_spectrum: bool,
    is_digital: bool,
    is_scaled: bool,
    scales: Vec<Step>,
}

impl Properties {
    /// Takes over a property, if it is one that is used.
    pub(super) fn set(&mut self, name: &str, value: Value) {
        match (name, value) {
            ("wf_increment", Value::Number(number)) => self.increment = Some(number),
            ("wf_start_offset", Value::Number(number)) => self.start_offset = Some(number),
            ("wf_samples", Value::Number(number)) => self.samples = Some(number as u64),
            ("wf_xunit_string", Value::Text(text)) => self.is_spectrum = text == "Hz",
            ("wf_start_time", Value::Time(time_s)) => self.acquired_at = iso(EPOCH_DAYS + time_s / DAY_S),
            ("unit_string" | "NI_UnitDescription", Value::Text(text)) if !text.is_empty() => {
                let known = UNITS.iter().find(|(word, ..)| *word == text);
                self.unit = Some(known.map_or(text, |(_, name, _)| (*name).to_owned()));
                self.factor = known.map(|(.., factor)| *factor);
            }
            ("NI_LineNames", _) => self.is_digital = true,
            ("NI_Scaling_Status", Value::Text(text)) => self.is_scaled = text == "scaled",
            ("NI_Number_Of_Scales", Value::Number(number)) if number >= 0.0 => {
                self.scales.resize(SCALES.min(number as usize), Step::default());
            }
            (_, value) => self.set_scale(name, value),
        }
    }

    fn set_scale(&mut self, name: &str, value: Value) {
        let Some((number, name)) = indexed(name, "NI_Scale[") else { return };
        if self.scales.len() <= number {
            self.scales.resize(number + 1, Step::default());
        }
        let step = &mut self.scales[number];
        match (name, value) {
            ("_Scale_Type", Value::Text(text)) => step.kind = Some(text),
            ("_Linear_Y_Intercept", Value::Number(number)) => step.linear[0] = number,
            ("_Linear_Slope", Value::Number(number)) => step.linear[1] = number,
            (name, Value::Number(number)) if name.ends_with("_Input_Source") => step.input = number as u32,
            (name, Value::Number(number)) => {
                if let Some((power, "")) = indexed(name, "_Polynomial_Coefficients[") {
                    step.powers[power] = number;
                }
            }
            _ => {}
        }
    }

    /// Whether it says how to scale values.
    pub(super) fn has_scales(&self) -> bool {
        !self.scales.is_empty()
    }

    /// Takes over the scales of the object that holds this one.
    pub(super) fn inherit(&mut self, other: &Self) {
        self.scales.clone_from(&other.scales);
        self.is_scaled = other.is_scaled;
    }

    pub(super) fn kind(&self) -> Kind {
        match (self.is_digital, self.is_spectrum) {
            (true, _) => Kind::Digital,
            (_, true) => Kind::Spectrum,
            _ => Kind::Waveform,
        }
    }

    /// The time base. An increment of 0 is none.
    pub(super) fn time(&self) -> Result<Time, String> {
        let step_s = self.increment.filter(|step| *step != 0.0);
        match (step_s, self.start_offset) {
            (Some(step), _) if !(step > 0.0 && step.is_finite()) => {
                Err(format!("wf_increment = {step} is no time between samples; save the channel again"))
            }
            (_, Some(start)) if !start.is_finite() => {
                Err(format!("wf_start_offset = {start} is no time; save the channel again"))
            }
            (step_s, start_s) => Ok(Time { step_s, start_s }),
        }
    }

    /// The type of a scale that is not read.
    pub(super) fn unread_scale(&self) -> Option<String> {
        self.steps().err()
    }

    /// Intercept and slope of all scales together; `None` where there are none or the data are scaled already. Else
    /// the type of one that is not linear.
    fn steps(&self) -> Result<Option<[f64; 2]>, String> {
        let Some(mut input) = self.scales.len().checked_sub(1).filter(|_| !self.is_scaled) else { return Ok(None) };
        let (mut slope, mut intercept) = (1.0, 0.0);
        for _ in 0..SCALES {
            let step = self.scales.get(input).ok_or("unknown")?;
            let [b, m] = match step.kind.as_deref() {
                Some("Linear") => step.linear,
                Some("Polynomial") if step.powers[2..].iter().all(|power| *power == 0.0) => {
                    [step.powers[0], step.powers[1]]
                }
                Some("AdvancedAPI") => [0.0, 1.0],
                kind => return Err(kind.unwrap_or("of the driver").to_owned()),
            };
            (intercept, slope) = (slope * b + intercept, slope * m);
            if step.input == RAW_INPUT {
                return Ok(Some([intercept, slope]));
            }
            input = step.input as usize;
        }
        Err("that takes itself as input".to_owned())
    }

    /// How values become units; `None` where the file does not say.
    pub(super) fn scale(&self) -> Result<Option<Scale>, String> {
        let Ok(steps) = self.steps() else { return Ok(None) };
        let factor = self.factor.unwrap_or(1.0);
        let Some([intercept, slope]) = steps.or(self.factor.map(|_| [0.0, 1.0])) else { return Ok(None) };
        let (gain, offset) = (slope * factor, intercept * factor);
        if gain == 0.0 || !gain.is_finite() || !offset.is_finite() {
            return Err(format!("scale {gain} x + {offset} is none; save the channel again"));
        }
        Ok(Some(Scale { gain, offset }))
    }
}

/// The index behind `prefix` and the rest of a name like `NI_Scale[1]_Scale_Type`.
fn indexed<'a>(name: &'a str, prefix: &str) -> Option<(usize, &'a str)> {
    let (index, rest) = name.strip_prefix(prefix)?.split_once(']')?;
    Some((index.parse().ok().filter(|index| *index < SCALES)?, rest))
}
