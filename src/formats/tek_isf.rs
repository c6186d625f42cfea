//! Tektronix .isf: a header of `KEY value;` pairs in long or short spelling, then `:CURVE #`, the block's length, and
//! codes.
//!
//! volts = YMULT * (code - YOFF) + YZERO; sample i is at XZERO + (i - PT_OFF) * XINCR after the trigger. The file has
//! no date. Records of minima and maxima (peak detect, envelope: PT_FMT ENV) and of spectra (x axis not in seconds) get
//! their kind.

use std::sync::Arc;

use super::reader::{FormatError, Input, Reader};
use crate::waveform::{CodeType, Head, Kind, Payload, Record, Scale};

/// The reader.
pub struct TekIsf;

/// Longest header that is read.
const HEAD_BYTES: u64 = 1 << 16;
/// Bytes that may end the line of the curve.
const LINE_END: u64 = 2;

impl Reader for TekIsf {
    fn format(&self) -> &'static str {
        "tek-isf"
    }
    fn extensions(&self) -> &'static [&'static str] {
        &["isf"]
    }
    fn recognises(&self, head: &[u8]) -> bool {
        head.starts_with(b":WFMP") || head.starts_with(b"WFMP")
    }

    fn records(&self, input: &mut dyn Input) -> Result<Vec<Record>, FormatError> {
        let length = input.length();
        let bytes = input.peek("the head", 0, length.min(HEAD_BYTES))?;
        let keys = Keys::read(&bytes)?;
        let (start, block) = curve(&bytes, keys.curve)?;
        if start.checked_add(block).is_none_or(|end| end > length) {
            return Err(FormatError::Truncated { what: "the curve", byte_offset: start, needed: block, length });
        }
        input.uses(0..start);
        let end = start + block;
        let after = input.peek("the end", end, length.min(end + LINE_END) - end)?;
        if after.iter().all(|byte| b"\r\n;".contains(byte)) {
            input.uses(end..end + after.len() as u64);
        }
        let kind = keys.kind()?;
        let code_type = keys.code_type()?;
        let samples = block / code_type.bytes() as u64;
        let points = keys.number("NR_P", "NR_PT")?;
        if samples == 0 || samples * code_type.bytes() as u64 != block || points != samples as f64 {
            let width = code_type.bytes();
            return Err(field(
                keys.curve,
                format!(
                    "NR_PT says {points} points of {width} bytes, the curve has {block} bytes; save the record again"
                ),
            ));
        }
        let (gain, code_zero) = (keys.number("YMU", "YMULT")?, keys.number("YOF", "YOFF")?);
        let (dt_s, x_zero_s) = (keys.number("XIN", "XINCR")?, keys.number("XZE", "XZERO")?);
        let offset = keys.number("YZE", "YZERO")? - gain * code_zero;
        let t0_s = x_zero_s - keys.number("PT_O", "PT_OFF")? * dt_s;
        if !(dt_s > 0.0 && t0_s.is_finite() && gain != 0.0 && offset.is_finite()) {
            return Err(field(0, format!("XINCR = {dt_s}, XZERO = {x_zero_s}, YMULT = {gain} give no scale")));
        }
        let title = keys.text("WFI", "WFID");
        let head = Head {
            kind,
            channel: title.and_then(|title| title.split(',').next()).map(|name| name.trim().to_owned()),
            unit: keys.text("YUN", "YUNIT").map(str::to_owned),
            dt_s: Some(dt_s),
            scale: Some(Scale { gain, offset }),
            header_gain: Some(gain),
            header_offset: Some(code_zero),
            // In 16 bit words an 8 bit converter fills the upper byte, and high-resolution mode more: only bytes
            // determine the rails.
            rails: (code_type == CodeType::I8 || code_type == CodeType::U8).then(|| code_type.limits()).flatten(),
            ..Head::new(self.format(), code_type, samples as usize)
        };
        let big_endian = keys.text("BYT_O", "BYT_OR") != Some("LSB");
        let payload = Payload::File { byte_offset: start, stride: code_type.bytes() as u64, big_endian };
        Ok(vec![Record { head: Arc::new(head), segment: None, t0_s: Some(t0_s), trigger_s: None, payload }])
    }
}

fn field(byte_offset: usize, problem: String) -> FormatError {
    FormatError::Field { byte_offset: byte_offset as u64, problem }
}

/// The header: keys in upper case with their values, without quotes.
struct Keys {
    entries: Vec<(String, String)>,
    /// Where `CURVE` begins.
    curve: usize,
}

impl Keys {
    fn read(bytes: &[u8]) -> Result<Self, FormatError> {
        let mut entries = Vec::new();
        let mut start = 0;
        let mut quoted = false;
        for (at, byte) in bytes.iter().enumerate() {
            quoted ^= *byte == b'"';
            if quoted || *byte != b';' {
                continue;
            }
            entries.extend(entry(&bytes[start..at]));
            start = at + 1;
            let rest = &bytes[start..];
            let rest = rest.strip_prefix(b":").unwrap_or(rest);
            if rest.len() >= 4 && rest[..4].eq_ignore_ascii_case(b"CURV") {
                return Ok(Self { entries, curve: start });
            }
        }
        Err(field(0, "the head has no :CURVE; was the file saved as a waveform, with its data?".to_owned()))
    }

    /// Value of a key, which may be spelt short, long, or anything between.
    fn text(&self, short: &str, long: &str) -> Option<&str> {
        let is = |key: &str| key.starts_with(short) && long.starts_with(key);
        self.entries.iter().rev().find(|(key, _)| is(key)).map(|(_, value)| value.as_str())
    }

    fn number(&self, short: &str, long: &str) -> Result<f64, FormatError> {
        let text =
            self.text(short, long).ok_or_else(|| field(0, format!("the head has no {long}; save the record again")))?;
        let number: Option<f64> = text.parse().ok().filter(|number: &f64| number.is_finite());
        number.ok_or_else(|| field(0, format!("{long} = {text:?} is no number")))
    }

    fn kind(&self) -> Result<Kind, FormatError> {
        match self.text("ENC", "ENCDG") {
            Some(encoding) if !encoding.starts_with("BIN") => {
                return Err(field(0, format!("has its curve as {encoding}; save it as binary (DATA:ENCDG RIBINARY)")));
            }
            _ => {}
        }
        let (form, unit) = (self.text("PT_F", "PT_FMT").unwrap_or("Y"), self.text("XUN", "XUNIT").unwrap_or("s"));
        Ok(match unit {
            _ if form.starts_with("ENV") => Kind::Envelope,
            "s" | "S" => Kind::Waveform,
            "Hz" => Kind::Spectrum,
            _ => return Err(field(0, format!("is over {unit}, neither over seconds nor over Hz"))),
        })
    }

    fn code_type(&self) -> Result<CodeType, FormatError> {
        let (form, bytes) = (self.text("BN_F", "BN_FMT").unwrap_or("RI"), self.number("BYT_N", "BYT_NR")?);
        match (form, bytes as i64) {
            ("RI", 1) => Ok(CodeType::I8),
            ("RI", 2) => Ok(CodeType::I16),
            ("RI", 4) => Ok(CodeType::I32),
            ("RP", 1) => Ok(CodeType::U8),
            ("RP", 2) => Ok(CodeType::U16),
            ("FP", 4) => Ok(CodeType::F32),
            _ => {
                Err(field(0, format!("codes of BN_FMT {form} and BYT_NR {bytes} are not read; save with 1 or 2 bytes")))
            }
        }
    }
}

/// `:WFMPRE:NR_PT 1000` is key NR_PT, value 1000.
fn entry(bytes: &[u8]) -> Option<(String, String)> {
    let text = String::from_utf8_lossy(bytes);
    let (key, value) = text.trim().split_once(' ')?;
    let key = key.rsplit(':').next().unwrap_or(key).to_uppercase();
    Some((key, value.trim().trim_matches('"').to_owned()))
}

/// Where the codes begin, and how many bytes they are. The block starts with `#`, one digit, and as many digits of
/// length.
fn curve(bytes: &[u8], at: usize) -> Result<(u64, u64), FormatError> {
    let refuse =
        || field(at, ":CURVE is not followed by # and the length of its block; save the record again".to_owned());
    let hash = at + bytes[at..].iter().take(16).position(|byte| *byte == b'#').ok_or_else(refuse)?;
    let digits = bytes.get(hash + 1).filter(|byte| byte.is_ascii_digit() && **byte != b'0').ok_or_else(refuse)?;
    let digits = usize::from(digits - b'0');
    let length = bytes.get(hash + 2..hash + 2 + digits).and_then(|length| std::str::from_utf8(length).ok());
    let length = length.and_then(|length| length.parse().ok()).ok_or_else(refuse)?;
    Ok(((hash + 2 + digits) as u64, length))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Source;
    use std::io::Cursor;
    use std::path::Path;

    fn file(keys: &str, codes: &[u8]) -> Vec<u8> {
        let mut bytes = format!(":WFMPRE:{keys};:CURVE #2{:02}", codes.len()).into_bytes();
        bytes.extend_from_slice(codes);
        bytes
    }

    fn values(bytes: Vec<u8>) -> Result<(Vec<f64>, Record), String> {
        let mut source = Source::new(Cursor::new(bytes), Path::new("a.isf")).map_err(|error| error.to_string())?;
        let record = TekIsf.records(&mut source).map_err(|error| error.to_string())?.remove(0);
        let codes = record.read(source.file(), 0..record.head.samples).map_err(|error| error.to_string())?;
        Ok((record.values(&codes), record))
    }

    const LONG: &str = "NR_PT 3;BYT_NR 2;ENCDG BINARY;BN_FMT RI;BYT_OR MSB;WFID \"Ch2; DC, 3 points\";PT_FMT Y;XUNIT \"s\";XINCR 1.0E-9;XZERO -2.0E-9;\
        PT_OFF 1;YUNIT \"V\";YMULT 0.5;YOFF 10.0;YZERO 1.0";
    const SHORT: &str = "NR_P 3;BYT_N 1;ENC BIN;BN_F RP;BYT_O LSB;PT_F Y;XUN \"s\";XIN 1.0E-9;XZE 0.0;PT_O 0;YUN \"V\";YMU 2.0;YOF 0.0;YZE 0.0";

    #[test]
    fn long_and_short_heads_are_read() {
        let (volts, record) = values(file(LONG, &[0, 10, 0, 12, 255, 254])).unwrap();
        assert_eq!(volts, [1.0, 2.0, -5.0]);
        assert!((record.t0_s.unwrap() + 3e-9).abs() < 1e-20 && record.head.channel.as_deref() == Some("Ch2; DC"));
        let (volts, _) = values(file(SHORT, &[0, 1, 255])).unwrap();
        assert_eq!(volts, [0.0, 2.0, 510.0]);
    }

    #[test]
    fn what_follows_the_curve_is_reported_but_for_the_end_of_its_line() {
        let bytes = file(LONG, &[0, 10, 0, 12, 255, 254]);
        crate::hostile::appended_is_reported(&TekIsf, &bytes);
        crate::hostile::appended_is_reported(&TekIsf, &[&bytes[..], b"\r\n"].concat());
    }

    #[test]
    fn other_records_and_broken_heads_are_named() {
        for (from, to, says) in [
            ("XUNIT \"s\"", "XUNIT \"m\"", "over m"),
            ("YMULT 0.5;", "", "no YMULT"),
            ("XINCR 1.0E-9", "XINCR soon", "is no number"),
            ("NR_PT 3", "NR_PT 4", "NR_PT says 4"),
            ("BYT_NR 2", "BYT_NR 8", "BYT_NR 8"),
            ("ENCDG BINARY", "ENCDG ASCII", "RIBINARY"),
        ] {
            let error = values(file(&LONG.replace(from, to), &[0; 6])).unwrap_err();
            assert!(error.contains(says), "{error}");
        }
        for (from, to, kind) in
            [("PT_FMT Y", "PT_FMT ENV", Kind::Envelope), ("XUNIT \"s\"", "XUNIT \"Hz\"", Kind::Spectrum)]
        {
            assert_eq!(values(file(&LONG.replace(from, to), &[0; 6])).unwrap().1.head.kind, kind);
        }
        let mut cut = file(LONG, &[0; 6]);
        cut.truncate(cut.len() - 1);
        assert!(values(cut).unwrap_err().contains("cut short"));
    }
}
