//! Lidar files with known content: PulseWaves (0.3) and LAS (1.3).

/// Sampling units (1 ns) from the optical centre to the anchor.
pub const ANCHOR_UNITS: i32 = 4;
/// Way of a place on the beam, straight down, in a picosecond.
pub const VELOCITY_Z_M_PER_PS: f64 = -149.90e-6;
pub const LAS_VELOCITY_Z_M_PER_PS: f64 = -1.5e-4;

/// A shot: its outgoing pulse, and one stretch of returning light from `start` sampling units after the anchor on.
pub struct Shot {
    pub outgoing: Vec<u16>,
    pub start: i32,
    pub returning: Vec<u16>,
}

/// A pulse of a LAS file: its packet, and where in it its return lies.
pub struct LasPulse {
    pub samples: Vec<u16>,
    pub location_ps: f32,
}

/// Place of the anchor of a shot.
pub fn anchor_m(number: usize) -> [f64; 3] {
    [50.0 + 0.01 * (100 * number) as f64, 60.0 + 0.01 * 200.0, 70.0 + 0.01 * 90_000.0]
}

/// Place of the return of each LAS pulse.
pub fn las_place_m() -> [f64; 3] {
    [100.0 + 0.01 * 10.0, 200.0 + 0.01 * 20.0, 300.0 + 0.01 * 3000.0]
}

fn sampling(way: u8, duration_bits: u8) -> Vec<u8> {
    let mut bytes = 104_u32.to_le_bytes().to_vec();
    bytes.extend([0, 0, 0, 0, way, 0, 0, duration_bits]);
    bytes.extend(1_f32.to_le_bytes());
    bytes.extend(0_f32.to_le_bytes());
    // One segment, of as many samples (16 bits) as each pulse says.
    bytes.extend([0, 16]);
    bytes.extend(1_u16.to_le_bytes());
    bytes.extend(0_u32.to_le_bytes());
    bytes.extend(16_u16.to_le_bytes());
    bytes.extend([0; 2]);
    bytes.extend(1_f32.to_le_bytes());
    bytes.resize(104, 0);
    bytes
}

/// NAME.pls and NAME.wvs. Without `anchor_units` the file does not say when its pulses left.
pub fn pulse_waves(shots: &[&Shot], anchor_units: Option<i32>) -> [Vec<u8>; 2] {
    let mut descriptor = 92_u32.to_le_bytes().to_vec();
    descriptor.extend([0; 4]);
    descriptor.extend(anchor_units.unwrap_or(0x8FFF_FFFF_u32.cast_signed()).to_le_bytes());
    descriptor.extend(0_u16.to_le_bytes());
    descriptor.extend(2_u16.to_le_bytes());
    descriptor.extend(1_f32.to_le_bytes());
    descriptor.resize(92, 0);
    let descriptor = [descriptor, sampling(1, 0), sampling(2, 32)].concat();
    let mut record = b"PulseWaves_Spec\0".to_vec();
    record.extend(200_001_u32.to_le_bytes());
    record.extend([0; 4]);
    record.extend((descriptor.len() as u64).to_le_bytes());
    record.resize(96, 0);
    record.extend(descriptor);
    let mut waves = b"PulseWavesWaves\0".to_vec();
    waves.resize(60, 0);
    let mut pulses = Vec::new();
    for (number, shot) in shots.iter().enumerate() {
        pulses.extend((number as i64).to_le_bytes());
        pulses.extend((waves.len() as u64).to_le_bytes());
        let x = 100 * number as i32;
        // The target lies 1000 sampling units behind the anchor: 149.90 m.
        for code in [x, 200, 90_000, x, 200, 90_000 - 14_990] {
            pulses.extend(code.to_le_bytes());
        }
        pulses.extend([0, 0, 0, 0, 1, 0, 0, 0]);
        waves.extend((shot.outgoing.len() as u16).to_le_bytes());
        waves.extend(shot.outgoing.iter().flat_map(|code| code.to_le_bytes()));
        waves.extend(shot.start.to_le_bytes());
        waves.extend((shot.returning.len() as u16).to_le_bytes());
        waves.extend(shot.returning.iter().flat_map(|code| code.to_le_bytes()));
    }
    let mut head = b"PulseWavesPulse\0".to_vec();
    head.resize(174, 0);
    head.extend(352_u16.to_le_bytes());
    head.extend((352 + record.len() as u64).to_le_bytes());
    head.extend((shots.len() as u64).to_le_bytes());
    for number in [0_u32, 0, 48, 0, 0, 0, 1, 0] {
        head.extend(number.to_le_bytes());
    }
    for number in [1e-6, 1000.0, 0.0, 0.0, 0.01, 0.01, 0.01, 50.0, 60.0, 70.0] {
        head.extend(f64::to_le_bytes(number));
    }
    head.resize(352, 0);
    [[head, record, pulses].concat(), waves]
}

/// A LAS 1.3 file of points of format 4 with their packets inside; packets are equally long.
pub fn las(pulses: &[&LasPulse]) -> Vec<u8> {
    let record = |number: u16, payload: &[u8], head: usize| {
        let mut bytes = vec![0, 0];
        bytes.extend(b"LASF_Spec");
        bytes.resize(18, 0);
        bytes.extend(number.to_le_bytes());
        if head == 60 {
            bytes.extend((payload.len() as u64).to_le_bytes());
        } else {
            bytes.extend((payload.len() as u16).to_le_bytes());
        }
        bytes.resize(head, 0);
        bytes.extend(payload);
        bytes
    };
    let samples = pulses[0].samples.len();
    let mut descriptor = vec![16, 0];
    descriptor.extend([samples as u32, 1000].iter().flat_map(|number| number.to_le_bytes()));
    descriptor.extend([1.0, 0.0].iter().flat_map(|number| f64::to_le_bytes(*number)));
    let descriptor = record(100, &descriptor, 54);
    let start = 235 + descriptor.len();
    let end = start + 57 * pulses.len();
    let mut points = Vec::new();
    for (number, pulse) in pulses.iter().enumerate() {
        let mut point: Vec<u8> = [10_i32, 20, 3000].iter().flat_map(|code| code.to_le_bytes()).collect();
        point.resize(20, 0);
        point.extend((number as f64).to_le_bytes());
        point.push(1);
        point.extend((60 + 2 * samples * number).to_le_bytes());
        point.extend((2 * samples as u32).to_le_bytes());
        // Directions of single returns point back to the scanner.
        point.extend([pulse.location_ps, 0.0, 0.0, 1.5e-4].iter().flat_map(|number| number.to_le_bytes()));
        points.extend(point);
    }
    let mut head = b"LASF".to_vec();
    head.resize(6, 0);
    head.extend((1_u16 << 1).to_le_bytes());
    head.resize(24, 0);
    head.extend([1, 3]);
    head.resize(94, 0);
    head.extend(235_u16.to_le_bytes());
    head.extend([start as u32, 1].iter().flat_map(|number| number.to_le_bytes()));
    head.push(4);
    head.extend(57_u16.to_le_bytes());
    head.extend((pulses.len() as u32).to_le_bytes());
    head.resize(131, 0);
    head.extend([0.01, 0.01, 0.01, 100.0, 200.0, 300.0].iter().flat_map(|number| f64::to_le_bytes(*number)));
    head.resize(227, 0);
    head.extend((end as u64).to_le_bytes());
    let packets: Vec<u8> = pulses.iter().flat_map(|pulse| &pulse.samples).flat_map(|code| code.to_le_bytes()).collect();
    [head, descriptor, points, record(u16::MAX, &packets, 60)].concat()
}
