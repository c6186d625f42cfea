//! Files that are not read, but known by their first bytes or their name: a refusal says what they are and what to do.

use crate::reader::FormatError;

/// A format: its first bytes, extensions of which one is needed (none where the bytes suffice), what it is, what to do.
type Entry = (&'static [u8], &'static [&'static str], &'static str, &'static str);

const PTU: &str = "convert it to .ptu or .phu with the maker's software";
const NPY: &str = "save the samples as .npy, with the last axis over time";

const FORMATS: [Entry; 18] = [
    (b"PicoHarp 300", &["pt2", "pt3"], "PicoQuant PicoHarp events of before 2014 (.pt2, .pt3)", PTU),
    (b"PicoHarp 300", &[], "PicoQuant PicoHarp histograms of before 2014 (.phd)", PTU),
    (b"HydraHarp 400", &["ht2", "ht3"], "PicoQuant HydraHarp events of before 2014 (.ht2, .ht3)", PTU),
    (b"HydraHarp 400", &[], "PicoQuant HydraHarp histograms of before 2014 (.hhd)", PTU),
    (b"TimeHarp", &["t3r"], "PicoQuant TimeHarp events of before 2014 (.t3r)", PTU),
    (b"TimeHarp", &[], "PicoQuant TimeHarp histograms of before 2014 (.thd)", PTU),
    (b"", &["spc"], "Becker & Hickl photon events (.spc)", "save the histograms as .sdt in SPCM"),
    (b"TDSh", &[], "the index of a National Instruments TDMS file", "name the .tdms of the same name"),
    (b"root", &[], "a ROOT file", NPY),
    (b"PulseWavesWave", &[], "the second file of a PulseWaves lidar file", "name the .pls of the same name"),
    (b"", &["wdp"], "the second file of a LAS lidar file", "name the .las of the same name"),
    (b"DRS4", &[], "events of a DRS4 evaluation board in another version", "save them with DRSOsc, or as .npy"),
    (b"DRS8", &[], "events of a WaveDREAM board", NPY),
    (b"TIME", &["dat"], "events of a DRS4 evaluation board of before 2014", NPY),
    (b"\x05\0\0\0", &["bin"], "a Siglent waveform of version 5", "save it as CSV"),
    (b"\x06\0\0\0", &["bin"], "a Siglent waveform of version 6", "save it as CSV"),
    (b"", &["psdata", "psd"], "a PicoScope recording", "save it as .mat or CSV"),
    (b"", &["wdf", "wvf"], "a Yokogawa recording", "export it as CSV"),
];

/// Why a file of these first bytes and this extension is not read, if that is known.
pub(super) fn refusal(head: &[u8], extension: &str) -> Option<FormatError> {
    let is_it = |(bytes, extensions, ..): &&Entry| {
        let named = extensions.contains(&extension) || extensions.is_empty() && !bytes.is_empty();
        head.starts_with(bytes) && named
    };
    let (_, _, what, fix) = *FORMATS.iter().find(is_it)?;
    Some(FormatError::NotRead { what, fix })
}

#[cfg(test)]
mod tests {
    use crate::hostile::source;
    use crate::{FormatError, Source, contents};

    #[test]
    fn what_is_not_read_is_named() {
        for (bytes, name, says) in [
            (&b"PicoHarp 300\0\0\0\x002.0"[..], "a.pt3", "PicoHarp events"),
            (b"PicoHarp 300\0\0\0\x002.0", "a.phd", "PicoHarp histograms"),
            (b"HydraHarp 400\0\0\x001.0", "a.ht3", "HydraHarp events"),
            (b"HydraHarp 400\0\0\x001.0", "a.hhd", "HydraHarp histograms"),
            (b"TimeHarp 200", "a.t3r", "TimeHarp events"),
            (b"TimeHarp 200", "a.thd", "TimeHarp histograms"),
            (&[0x5F, 0, 0, 0x80], "a.spc", "Becker & Hickl photon events"),
            (b"TDSh\x0e\0\0\0", "a.tdms_index", "TDMS"),
            (b"root\0\0\xf7\x48", "a.root", "ROOT"),
            (b"PulseWavesWaves\0", "a.wvs", "PulseWaves"),
            (b"\0\0LASF_Spec", "a.wdp", "LAS"),
            (b"TIMEB#", "a.dat", "DRS4 evaluation board of before 2014"),
            (b"DRS8TIMEB#", "a.dat", "WaveDREAM"),
            (b"\x06\0\0\0\x80\0", "a.bin", "Siglent waveform of version 6"),
            (&[0xE1, 0xCA, 3, 0], "a.BIN", "CoMPASS list"),
        ] {
            let mut source = Source::new(std::io::Cursor::new(bytes.to_vec()), name.as_ref()).unwrap();
            let error = contents(&mut source).unwrap_err();
            assert!(matches!(error, FormatError::NotRead { .. }), "{name}: {error}");
            assert!(error.to_string().contains(says), "{name}: {error}");
        }
        assert!(matches!(contents(&mut source(b"what is this")), Err(FormatError::Unknown)));
    }
}
