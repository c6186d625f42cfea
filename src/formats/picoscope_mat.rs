//! PicoScope `.mat`: what PicoScope 6 saves for MATLAB, in version 4 of MATLAB's files.
//!
//! A file is a list of variables in any order. Each has a header of five 32 bit words (type of its numbers, rows,
//! columns, 0, length of its name), its name, and its numbers. `Tstart` and `Tinterval` are the time of sample 0 after
//! the trigger and the time between samples, in seconds; `Length` is the number of samples. Each other array of more
//! than one number is a record of the channel of its name: `A`, `B`, or that of a math channel. Text is skipped.
//!
//! Neither the file nor the guide names the unit of the values: `unit` is `None`, and the campaign gives `gain_v`. A
//! file with times one by one (`T`, of equivalent-time sampling) is refused, as are files of version 4 of other
//! programs, which have no `Tinterval`. A waveform buffer is a file of its own, without the time of its trigger.
//!
//! Source: Pico Technology, *PicoScope 6 User's Guide*, "Binary formats". No real file could be had: built from the
//! specification only.

use std::collections::BTreeSet;
use std::sync::Arc;

use super::numbers::Numbers;
use super::reader::{FormatError, Input, Reader};
use crate::waveform::{CodeType, Head, Payload, Record};

/// The reader.
pub struct PicoscopeMat;

/// Bytes of a variable's header.
const HEAD: u64 = 20;
/// Longest name, with the zero at its end.
const NAME_BYTES: u32 = 64;
/// Types of numbers: the digit of the tens. Those of the hundreds and thousands are 0 in little-endian files; that of
/// the ones is 1 for text.
const TYPES: [(u32, CodeType); 6] = [
    (0, CodeType::F64),
    (10, CodeType::F32),
    (20, CodeType::I32),
    (30, CodeType::I16),
    (40, CodeType::U16),
    (50, CodeType::U8),
];
const TEXT: u32 = 1;
/// Most variables that are kept: channels, math channels, and what is said of them.
const VARIABLES: usize = 256;

impl Reader for PicoscopeMat {
    fn format(&self) -> &'static str {
        "picoscope-mat"
    }
    fn extensions(&self) -> &'static [&'static str] {
        &[]
    }
    fn recognises(&self, head: &[u8]) -> bool {
        let Some(start) = head.get(..HEAD as usize) else { return false };
        let numbers = Numbers::little(start.to_vec(), 0);
        let name = head.get(HEAD as usize..).unwrap_or_default();
        let name = name.get(..numbers.u32(16) as usize);
        Variable::layout(&numbers).is_some() && name.is_some_and(|name| variable_name(name).is_some())
    }

    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let variables = variables(input)?;
        let number = |input: &mut dyn Input, name: &str| match variables.iter().find(|v| v.name == name) {
            Some(variable) => variable.number(input).map(Some),
            None => Ok(None),
        };
        if variables.iter().any(|variable| variable.name == "T") {
            let fix = "save it without equivalent-time sampling";
            return Err(FormatError::NotRead { what: "a PicoScope file with a time for every sample", fix });
        }
        let Some(step_s) = number(input, "Tinterval")? else {
            let fix = "save the samples as .npy, or with a variable Tinterval";
            return Err(FormatError::NotRead { what: "a MATLAB file of version 4 without Tinterval", fix });
        };
        let (start_s, length) = (number(input, "Tstart")?, number(input, "Length")?);
        let field = |problem: String| FormatError::Field { byte_offset: 0, problem };
        if !(step_s > 0.0 && step_s.is_finite()) || start_s.is_some_and(|start_s| !start_s.is_finite()) {
            let problem = format!("Tinterval {step_s} s and Tstart {start_s:?} s are no times; save the file again");
            return Err(field(problem));
        }
        let mut records = Vec::new();
        for variable in variables.iter().filter(|variable| variable.count > 1 && !variable.is_text) {
            let Variable { name, code_type, data, count, .. } = variable;
            if length.is_some_and(|length| length != *count as f64) {
                let length = length.unwrap_or_default();
                let problem = format!("{name} has {count} samples, but Length is {length}; save the file again");
                return Err(FormatError::Field { byte_offset: *data, problem });
            }
            let samples = usize::try_from(*count).map_err(|_| field("is too large for this machine".to_owned()))?;
            let head = Head {
                channel: Some(name.clone()),
                dt_s: Some(step_s),
                ..Head::new(self.format(), *code_type, samples)
            };
            let payload = Payload::File { byte_offset: *data, stride: code_type.bytes() as u64, big_endian: false };
            records.push(Record { head: Arc::new(head), segment: None, t0_s: start_s, trigger_s: None, payload });
        }
        if records.is_empty() {
            return Err(field("no channel has samples; save the waveform again".to_owned()));
        }
        Ok(records)
    }
}

/// A variable, and where its numbers are.
struct Variable {
    name: String,
    code_type: CodeType,
    data: u64,
    count: u64,
    is_text: bool,
}

impl Variable {
    /// Type and number of numbers by a header.
    fn layout(head: &Numbers) -> Option<(CodeType, u64)> {
        let [kind, rows, columns, imaginary, name] = [0, 4, 8, 12, 16].map(|at| head.u32(at));
        let code_type = TYPES
            .iter()
            .find(|(number, _)| [0, TEXT].contains(&kind.wrapping_sub(*number)))
            .map(|(_, code_type)| *code_type)?;
        let is_vector = rows == 1 || columns == 1;
        let count = u64::from(rows) * u64::from(columns);
        (is_vector && count > 0 && imaginary == 0 && (2..=NAME_BYTES).contains(&name)).then_some((code_type, count))
    }

    /// The variable of a header, and where its numbers end, which may be behind the file.
    fn read(input: &mut dyn Input, head: &Numbers) -> Result<(Self, u64), FormatError> {
        let refuse = || head.refuse(0, "a variable that is none of PicoScope's; save the file again");
        let (code_type, count) = Self::layout(head).ok_or_else(refuse)?;
        let (name_at, name_bytes) = (head.origin + HEAD, u64::from(head.u32(16)));
        let data = name_at + name_bytes;
        let end = count.checked_mul(code_type.bytes() as u64).and_then(|bytes| bytes.checked_add(data));
        let end = end.ok_or_else(refuse)?;
        let is_text = head.u32(0) % 10 == TEXT;
        if end > input.length() {
            return Ok((Self { name: String::new(), code_type, data, count, is_text }, end));
        }
        let name = input.peek("the name of a variable", name_at, name_bytes)?;
        let name = variable_name(&name).ok_or_else(refuse)?.to_owned();
        Ok((Self { name, code_type, data, count, is_text }, end))
    }

    /// The first number.
    fn number(&self, input: &mut dyn Input) -> Result<f64, FormatError> {
        let bytes = input.peek("a number", self.data, self.code_type.bytes() as u64)?;
        Ok(self.code_type.decode(&bytes)[0])
    }
}

/// A name with a zero at its end, if that is what these bytes are.
fn variable_name(bytes: &[u8]) -> Option<&str> {
    let (zero, name) = bytes.split_last()?;
    let is_word = |byte: &u8| byte.is_ascii_alphanumeric() || *byte == b'_';
    let is_name = *zero == 0 && name.first().is_some_and(u8::is_ascii_alphabetic) && name.iter().all(is_word);
    str::from_utf8(name).ok().filter(|_| is_name)
}

/// All variables of a file. It may end within one, or in zeros.
fn variables(input: &mut dyn Input) -> Result<Vec<Variable>, FormatError> {
    let (mut variables, mut names) = (Vec::new(), BTreeSet::new());
    let (mut at, length) = (0, input.length());
    while at < length {
        let start = Numbers::little(input.peek("a variable", at, HEAD.min(length - at))?, at);
        if start.bytes.iter().all(|byte| *byte == 0) && at > 0 {
            break; // reported as surplus
        }
        let (variable, end) = match length - at {
            left if left < HEAD => (None, at + HEAD),
            _ => Variable::read(input, &start).map(|(variable, end)| (Some(variable), end))?,
        };
        let Some(variable) = variable.filter(|_| end <= length) else {
            if variables.is_empty() {
                let needed = end - at;
                return Err(FormatError::Truncated { what: "a variable", byte_offset: at, needed, length });
            }
            input.cut_short(at, "variable", variables.len() as u64);
            break;
        };
        if variables.len() == VARIABLES || !names.insert(variable.name.clone()) {
            let name = &variable.name;
            let problem = format!("variable {name} comes twice, or after {VARIABLES} others; save the file again");
            return Err(start.refuse(0, problem));
        }
        input.uses(at..end);
        variables.push(variable);
        at = end;
    }
    Ok(variables)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hostile::{change_anywhere, cut_everywhere, decode, refusal, source};

    fn variable(kind: u32, name: &str, numbers: &[u8], width: usize) -> Vec<u8> {
        let count = (numbers.len() / width) as u32;
        let words = [kind, count, 1, 0, name.len() as u32 + 1];
        let head: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        [&head, name.as_bytes(), &[0], numbers].concat()
    }

    fn number(name: &str, number: f64) -> Vec<u8> {
        variable(0, name, &number.to_le_bytes(), 8)
    }

    fn floats(name: &str, values: &[f32]) -> Vec<u8> {
        variable(10, name, &values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>(), 4)
    }

    /// Variables in the order of PicoScope 6, and two channels of three samples.
    fn built() -> Vec<Vec<u8>> {
        let length = variable(20, "Length", &3_i32.to_le_bytes(), 4);
        let codes: Vec<u8> = [5_i16, -6, 7].iter().flat_map(|code| code.to_le_bytes()).collect();
        let channels = [floats("A", &[0.5, -1.0, 2.0]), variable(51, "Note", b"dark", 1), variable(30, "B", &codes, 2)];
        [vec![number("Tstart", -1e-9), number("Tinterval", 4e-10), length], channels.to_vec()].concat()
    }

    #[test]
    fn arrays_are_channels() {
        let bytes = built().concat();
        assert!(PicoscopeMat.recognises(&bytes));
        let records = decode(&PicoscopeMat, &bytes);
        let (record, values) = &records[0];
        assert_eq!((record.head.channel.as_deref(), &values[..]), (Some("A"), &[0.5, -1.0, 2.0][..]));
        assert_eq!((record.head.dt_s, record.t0_s, record.head.unit.as_deref()), (Some(4e-10), Some(-1e-9), None));
        assert_eq!((records[1].0.head.code_type, &records[1].1[..]), (CodeType::I16, &[5.0, -6.0, 7.0][..]));
        let mut turned = built();
        turned.reverse();
        assert_eq!(decode(&PicoscopeMat, &turned.concat()).len(), 2);
    }

    #[test]
    fn what_is_wrong_is_said() {
        let with = |more: Vec<u8>| refusal(&PicoscopeMat, &[built().concat(), more].concat());
        assert!(with(floats("T", &[0.0, 1.0, 3.0])).contains("a time for every sample"));
        assert!(with(floats("C", &[0.0, 1.0])).contains("C has 2 samples, but Length is 3"));
        assert!(with(floats("A", &[0.0, 1.0, 2.0])).contains("variable A comes twice"));
        assert!(with(vec![1; 40]).contains("is none of PicoScope"));
        assert!(refusal(&PicoscopeMat, &floats("A", &[1.0, 2.0])).contains("without Tinterval"));
        let bad = [number("Tinterval", -1.0), floats("A", &[1.0, 2.0])].concat();
        assert!(refusal(&PicoscopeMat, &bad).contains("Tinterval -1 s"));
        assert!(refusal(&PicoscopeMat, &number("Tinterval", 1.0)).contains("no channel has samples"));
        let bytes = built().concat();
        let contents = crate::contents(&mut source(&bytes[..bytes.len() - 1])).unwrap();
        assert_eq!((contents.records.len(), contents.remarks.len(), contents.remarks[0].is_cut), (1, 1, true));
        for other in [&[0; 64][..], b"MATLAB 5.0 MAT-file, Platform: PCWIN", b"1.0,2.0,3.0,4.0,5.0,6.0"] {
            assert!(!PicoscopeMat.recognises(other));
        }
    }

    #[test]
    fn hostile_files_are_refused_or_decoded_whole() {
        cut_everywhere(&PicoscopeMat, &built().concat());
        change_anywhere(&PicoscopeMat, &built().concat(), 5000);
    }
}
