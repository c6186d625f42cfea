//! Codes of many records, read in one go.

use std::io::Cursor;

use super::*;

fn record(code_type: CodeType, payload: Payload) -> Record {
    let scale = Some(Scale { gain: 0.5, offset: 1.0 });
    Record {
        head: Arc::new(Head { scale, ..Head::new("test", code_type, 4) }),
        segment: None,
        t0_s: None,
        trigger_s: None,
        payload,
    }
}

/// Records that follow one another, stand apart, lie backwards, are interleaved or decoded: as one by one.
#[test]
fn many_records_are_read_as_one_by_one() {
    let bytes: Vec<u8> = (0..=255).collect();
    for (code_type, big_endian) in [(CodeType::U8, false), (CodeType::I16, false), (CodeType::U16, true)] {
        let width = code_type.bytes() as u64;
        let at = |byte_offset: u64, stride: u64| Payload::File { byte_offset, stride, big_endian };
        let decoded: Arc<[u8]> = (0..4 * width as u8).collect();
        let payloads = [
            at(10, width),
            at(10 + 4 * width, width),
            at(10 + 8 * width, width),
            at(100, width),
            at(60, width),
            at(120, 2 * width),
            Payload::Decoded(decoded),
            at(180, width),
            at(180 + 4 * width, width),
        ];
        let records: Vec<Record> = payloads.map(|payload| record(code_type, payload)).into();
        let mut file = Cursor::new(&bytes);
        for samples in [0..4, 1..3, 2..2] {
            let expected: Vec<u8> =
                records.iter().flat_map(|record| record.read(&mut file, samples.clone()).unwrap()).collect();
            let mut target = vec![0; expected.len()];
            let mut pieces = 0;
            Record::read_into(&records, &mut file, &samples, &mut target, &mut || pieces += 1).unwrap();
            assert_eq!(target, expected);
            // Whole records that follow one another are one piece, parts of them are not.
            assert!(samples != (0..4) || pieces == 6, "{pieces}");
            let mut values = vec![0.0; target.len() / width as usize];
            records[0].values_into(&target, &mut values);
            assert_eq!(values, records[0].values(&expected));
        }
    }
}
