//! With patches in place, their covariances, and the sensor's delay.

use super::*;

/// Standard deviation of each coordinate of a patch: its own part, and the part that it shares with all others.
const OWN_M: f64 = 0.0005;
const SHARED_M: f64 = 0.003;
const DELAY_PS: f64 = 30.0;
const DELAY_SD_PS: f64 = 2.0;

/// Patches of a room with errors as large as their covariances say.
fn scene(room: &Room, rng: &mut ChaCha8Rng) -> Scene {
    let mut normals = || Vector3::from_fn(|_, _| StandardNormal.sample(rng));
    let shared: Vector3<f64> = normals() * SHARED_M;
    let (own_m2, shared_m2) = (Matrix3::identity() * (OWN_M * OWN_M), Matrix3::identity() * (SHARED_M * SHARED_M));
    let patches: BTreeMap<PatchId, (Point, Matrix3<f64>)> = room
        .patches()
        .zip(&room.points)
        .map(|(patch, point)| (patch, (point + shared + normals() * OWN_M, own_m2 + shared_m2)))
        .collect();
    let pairs = room.patches().flat_map(|a| (a + 1..=room.points.len() as PatchId).map(move |b| (a, b)));
    Scene::new(&patches, &pairs.map(|pair| (pair, shared_m2)).collect(), Footprints::default(), BTreeMap::new())
}

/// Arrivals by what is true of them and what their labels say.
#[derive(Debug, Default)]
struct Count {
    /// Direct light labelled right.
    direct: usize,
    /// Third bounces labelled right, and left open.
    thirds: usize,
    thirds_open: usize,
    /// Arrivals labelled with a path that did not make them, and how many the stated probabilities let expect.
    wrong: usize,
    expected: f64,
}

impl Count {
    /// Of ten rooms of 16 patches, seven of ten third bounces seen.
    fn of(flat: bool, capture: Capture, probability_min: f64) -> Self {
        let options = Options { bounces: 3, probability_min, ..OPTIONS };
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut count = Self::default();
        for _ in 0..10 {
            let room = Room::new(&mut rng, [7, 5, 4], flat);
            let mut made = capture.of(&room, &mut rng);
            let normal: f64 = StandardNormal.sample(&mut rng);
            let delay_ps = DELAY_PS + DELAY_SD_PS * normal;
            made.iter_mut().for_each(|made| made.arrival.time_ps += delay_ps);
            let sensor = capture.sensor((DELAY_PS, DELAY_SD_PS), &made);
            count.add(&made, &verdicts(label(&[sensor], Some(&scene(&room, &mut rng)), &options, &Cancel::never())));
        }
        eprintln!("probability_min {probability_min}, flat {flat}, period {:?}: {count:?}", capture.period_ps);
        count
    }

    fn add(&mut self, made: &[Made], verdicts: &[Vec<Verdict>]) {
        assert_eq!(verdicts.len(), made.len());
        for (Made { path, turns, .. }, verdicts) in made.iter().zip(verdicts) {
            let best = &verdicts[0];
            assert!(verdicts.iter().map(|verdict| verdict.probability).sum::<f64>() < 1.0 + 1e-9, "{verdicts:?}");
            let is_third = path.as_ref().is_some_and(|path| path.len() == 3);
            self.expected += best.path.as_ref().map_or(0.0, |_| 1.0 - best.probability);
            match &best.path {
                None => self.thirds_open += usize::from(is_third),
                named if named == path => {
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
fn patches_in_place_decide_the_periods_too() {
    let count = Count::of(true, Capture { period_ps: Some(10_674.64), ..DENSE }, 0.95);
    assert!((count.wrong as f64) < count.expected + 4.0 * count.expected.sqrt() + 1.0, "{count:?}");
    assert!(count.thirds > count.thirds_open, "{count:?}");
}
