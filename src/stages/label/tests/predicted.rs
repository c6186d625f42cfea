//! With known patches, their covariances and the sensor's delay beside.

use super::*;
use crate::tables::Row;
use nalgebra::Vector3;

/// Standard deviation of each coordinate of a patch: its own part, and the part that it shares with all others.
const OWN_M: f64 = 0.0005;
const SHARED_M: f64 = 0.003;
const DELAY_PS: f64 = 30.0;
const DELAY_SD_PS: f64 = 2.0;

/// Patches of a room as `refine` would give them, with errors as large as their covariances say.
fn beside(room: &Room, delay_ps: f64, rng: &mut ChaCha8Rng) -> BesideTables {
    let mut normals = || Vector3::from_fn(|_, _| StandardNormal.sample(rng));
    let shared: Vector3<f64> = normals() * SHARED_M;
    let variance_m2 = OWN_M * OWN_M + SHARED_M * SHARED_M;
    let mut patch = |(n, point): (usize, &Point)| {
        let at = point + shared + normals() * OWN_M;
        Patch {
            patch: n as i32 + 1,
            kind: "visible".into(),
            x_m: at.x,
            y_m: at.y,
            z_m: at.z,
            cov_xx_m2: Some(variance_m2),
            cov_xy_m2: Some(0.0),
            cov_xz_m2: Some(0.0),
            cov_yy_m2: Some(variance_m2),
            cov_yz_m2: Some(0.0),
            cov_zz_m2: Some(variance_m2),
            sd_m: Some((3.0 * variance_m2).sqrt()),
            onsets: 1,
            chi2_dof: None,
            alternative: 0,
            log_likelihood: None,
        }
    };
    let patches: Vec<Patch> = room.points.iter().enumerate().map(&mut patch).collect();
    let count = patches.len() as i32;
    let shared_m2 = SHARED_M * SHARED_M;
    let between = |(a, b): (i32, i32)| PatchCovariance {
        a,
        b,
        cov_xx_m2: shared_m2,
        cov_xy_m2: 0.0,
        cov_xz_m2: 0.0,
        cov_yx_m2: 0.0,
        cov_yy_m2: shared_m2,
        cov_yz_m2: 0.0,
        cov_zx_m2: 0.0,
        cov_zy_m2: 0.0,
        cov_zz_m2: shared_m2,
    };
    let pairs = (1..=count).flat_map(|a| (a + 1..=count).map(move |b| (a, b)));
    let covariances: Vec<PatchCovariance> = pairs.map(between).collect();
    let delay = Delay {
        campaign: "c".into(),
        sensor: "s1".into(),
        range: None,
        delay_ps,
        sd_ps: DELAY_SD_PS,
        prior_sd_ps: 100.0,
    };
    BesideTables::from([
        ("patches".to_owned(), vec![Patch::to_batch(&patches)]),
        ("covariances".to_owned(), vec![PatchCovariance::to_batch(&covariances)]),
        ("delays".to_owned(), vec![Delay::to_batch(&[delay])]),
    ])
}

/// Onsets by what is true of them and what was said.
#[derive(Debug, Default)]
struct Count {
    /// Direct light labelled right.
    direct: usize,
    /// Third bounces labelled right, and left open.
    thirds: usize,
    thirds_open: usize,
    /// Onsets labelled with a path that did not make them, and how many the stated probabilities let expect.
    wrong: usize,
    expected: f64,
}

impl Count {
    /// Of ten rooms of 16 patches, seven of ten third bounces seen.
    fn of(flat: bool, capture: Capture, probability_min: f64) -> Self {
        let stage = LabelOnsets { bounces: 3, probability_min, ..LabelOnsets::default() };
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut count = Self::default();
        for _ in 0..10 {
            let room = Room::new(&mut rng, [7, 5, 4], flat);
            let mut made = capture.of(&room, &mut rng);
            let normal: f64 = StandardNormal.sample(&mut rng);
            let delay_ps = DELAY_PS + DELAY_SD_PS * normal;
            made.iter_mut().for_each(|made| made.onset.time_ps += delay_ps);
            count.add(&made, &capture.labels(&stage, &beside(&room, DELAY_PS, &mut rng), &made));
        }
        eprintln!("probability_min {probability_min}, flat {flat}, period {:?}: {count:?}", capture.period_ps);
        count
    }

    fn add(&mut self, made: &[Made], labels: &[Label]) {
        let key = |label: &Label| (label.lit, label.seen, label.rank);
        let of_onsets: Vec<&[Label]> = labels.chunk_by(|a, b| key(a) == key(b)).collect();
        assert_eq!(of_onsets.len(), made.len());
        for (Made { onset, path, turns }, labels) in made.iter().zip(of_onsets) {
            let best = &labels[0];
            assert_eq!((onset.lit, onset.seen, onset.rank, 0), (best.lit, best.seen, best.rank, best.alternative));
            assert!(labels.iter().map(|label| label.probability).sum::<f64>() < 1.0 + 1e-9, "{labels:?}");
            let is_third = path.as_ref().is_some_and(|path| path.len() == 3);
            self.expected += best.path.as_ref().map_or(0.0, |_| 1.0 - best.probability);
            match &best.path {
                None => self.thirds_open += usize::from(is_third),
                found if found == path => {
                    assert_eq!(best.turns, *turns);
                    *(if is_third { &mut self.thirds } else { &mut self.direct }) += 1;
                }
                Some(_) => self.wrong += 1,
            }
        }
    }
}

const DENSE: Capture = Capture { later: 0.7, clutter_per_ns: 0.05, ..PLAIN };

/// A label is wrong as often as its probability says, and never more often than `probability_min` allows.
#[test]
fn third_bounces_are_labelled_right_as_often_as_stated() {
    for (flat, probability_min) in [(true, 0.95), (true, 0.5), (false, 0.95), (false, 0.5)] {
        let count = Count::of(flat, DENSE, probability_min);
        let labelled = (count.direct + count.thirds + count.wrong) as f64;
        assert!((count.wrong as f64) < count.expected + 4.0 * count.expected.sqrt() + 1.0, "{count:?}");
        assert!((count.wrong as f64) < (1.0 - probability_min) * labelled, "{count:?}");
        assert!(count.thirds > count.thirds_open, "{count:?}");
    }
}

#[test]
fn known_patches_tell_the_periods_too() {
    let count = Count::of(true, Capture { period_ps: Some(10_674.64), ..DENSE }, 0.95);
    assert!((count.wrong as f64) < count.expected + 4.0 * count.expected.sqrt() + 1.0, "{count:?}");
    assert!(count.thirds > count.thirds_open, "{count:?}");
}
