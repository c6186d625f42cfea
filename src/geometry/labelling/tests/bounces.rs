//! Fourth and fifth bounces over patches in place, and patches that only hidden ones show.

use super::*;

/// Where the records end.
const LAST_PS: f64 = 40_000.0;

/// A room as light sees it: patches 1 to `visible` are lit and seen, the next `first` are shown by these, the rest by
/// those only. The laser is at the origin.
struct Lit {
    points: Vec<Point>,
    visible: usize,
    first: usize,
}

/// Chances that light makes an arrival: third, fourth and fifth bounces over visible patches and those that these show,
/// and fifth ones over others.
#[derive(Clone, Copy)]
struct Seen {
    orders: [f64; 3],
    deep: f64,
}

impl Lit {
    fn new(rng: &mut ChaCha8Rng, visible: usize, first: usize, deep: usize) -> Self {
        let mut points: Vec<Point> = Vec::new();
        while points.len() < visible + first + deep {
            let (u, v, w) = (rng.random_range(0.0..1.0), rng.random_range(0.0..1.0), rng.random_range(-0.5..0.5));
            let point = match points.len() {
                n if n < visible && n % 2 == 0 => Point::new(-1.2 + 2.0 * u, 2.2, 1.6 * w),
                n if n < visible => Point::new(1.1, 0.6 + 1.6 * v, 1.6 * w),
                n if n < visible + first => Point::new(-1.0 + 1.2 * u, 0.7 + 1.0 * v, w),
                _ => Point::new(-2.0 + 1.0 * u, 0.5 + 1.2 * v, w),
            };
            if points.iter().all(|other| (other - point).norm() > 0.2) {
                points.push(point);
            }
        }
        Self { points, visible, first }
    }

    fn is_deep(&self, patch: PatchId) -> bool {
        patch as usize > self.visible + self.first
    }

    fn time_ps(&self, path: &[PatchId]) -> f64 {
        let point = |patch: PatchId| self.points[patch as usize - 1];
        let ends = point(path[0]).coords.norm() + point(path[path.len() - 1]).coords.norm();
        units::time_ps(ends + path.windows(2).map(|leg| (point(leg[0]) - point(leg[1])).norm()).sum::<f64>(), 1.0)
    }

    /// All light of up to five bounces; of a path and its reverse that come back to the lit patch, one.
    fn light(&self, lit: PatchId, seen: PatchId) -> Vec<Vec<PatchId>> {
        let all = 1..=self.points.len() as PatchId;
        let is_open = |a: PatchId, b: PatchId| {
            let is_visible = |patch: PatchId| patch as usize <= self.visible;
            a != b && !(self.is_deep(a) && is_visible(b)) && !(self.is_deep(b) && is_visible(a))
        };
        let mut paths = vec![if lit == seen { vec![lit] } else { vec![lit, seen] }];
        let mut begun = vec![vec![lit]];
        for _ in 3..=5 {
            let longer = |path: &Vec<PatchId>| -> Vec<Vec<PatchId>> {
                let last = path[path.len() - 1];
                all.clone().filter(|next| is_open(last, *next)).map(|next| [&path[..], &[next]].concat()).collect()
            };
            begun = begun.iter().flat_map(longer).collect();
            let ended = begun.iter().filter(|path| is_open(path[path.len() - 1], seen));
            let ended = ended.map(|path| [&path[..], &[seen]].concat());
            paths.extend(ended.filter(|path| lit != seen || path.iter().le(path.iter().rev())));
        }
        paths
    }

    /// Arrivals of all profiles, with errors of `sd_ps`, and `clutter` false ones in each.
    fn made(&self, seen: Seen, sd_ps: f64, clutter: usize, rng: &mut ChaCha8Rng) -> Vec<Made> {
        let visible = 1..=self.visible as PatchId;
        let mut made = Vec::new();
        for (lit, last) in visible.clone().flat_map(|a| visible.clone().map(move |b| (a, b))) {
            let mut arrivals: Vec<(f64, Option<Vec<PatchId>>)> = Vec::new();
            for path in self.light(lit, last) {
                let is_deep = path.iter().any(|patch| self.is_deep(*patch));
                let chance = match path.len() {
                    1 | 2 => 1.0,
                    _ if is_deep => seen.deep,
                    order => seen.orders[order - 3],
                };
                if self.time_ps(&path) < LAST_PS && rng.random_bool(chance) {
                    let noise: f64 = StandardNormal.sample(rng);
                    arrivals.push((self.time_ps(&path) + sd_ps * noise, Some(path)));
                }
            }
            let (first_ps, last_ps) = (arrivals[0].0, LAST_PS);
            arrivals.extend((0..clutter).map(|_| (rng.random_range(first_ps..last_ps), None)));
            arrivals.sort_by(|a, b| a.0.total_cmp(&b.0));
            made.extend(arrivals.into_iter().map(|(time_ps, path)| Made {
                lit,
                seen: last,
                arrival: Arrival::point(time_ps, sd_ps, 20.0),
                path,
                turns: 0,
            }));
        }
        made
    }

    /// The first patches, with errors of `sd_m` in each coordinate.
    fn scene(&self, count: usize, sd_m: f64, rng: &mut ChaCha8Rng) -> Scene {
        let mut error = || Vector3::from_fn(|_, _| StandardNormal.sample(rng)) * sd_m;
        let points: Vec<Point> = self.points.iter().take(count).map(|point| point + error()).collect();
        scene(&points, sd_m)
    }
}

/// A label is wrong as often as its probability says, also where fourth and fifth bounces are most of the light.
#[test]
fn later_bounces_are_labelled_right_as_often_as_stated() {
    for probability_min in [0.95, 0.5] {
        let options = Options { bounces: 5, probability_min, hidden: HiddenPatches::None, ..OPTIONS };
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let (mut right, mut open, mut wrong, mut expected) = ([0; 6], [0; 6], 0.0, 0.0);
        for _ in 0..4 {
            let room = Lit::new(&mut rng, 5, 2, 0);
            let seen = Seen { orders: [0.9, 0.5, 0.2], deep: 0.0 };
            let made = room.made(seen, 5.0, 2, &mut rng);
            let scene = room.scene(7, 5e-4, &mut rng);
            let verdicts = PLAIN.verdicts(&options, Some(&scene), &made);
            for (Made { path, .. }, label) in made.iter().zip(verdicts.iter().map(|verdicts| &verdicts[0])) {
                let order = path.as_ref().map_or(0, Vec::len);
                expected += label.path.as_ref().map_or(0.0, |_| 1.0 - label.probability);
                match &label.path {
                    None => open[order] += 1,
                    named if named == path => right[order] += 1,
                    Some(_) => wrong += 1.0,
                }
            }
        }
        eprintln!(
            "probability_min {probability_min}: right {right:?}, open {open:?}, wrong {wrong}, expected {expected:.1}"
        );
        let labelled = f64::from(right.iter().sum::<i32>()) + wrong;
        assert!((wrong - expected).abs() < 4.0 * expected.sqrt() + 1.0, "{wrong} {expected}");
        assert!(wrong < (1.0 - probability_min) * labelled, "{wrong} of {labelled}");
        assert!(right[4] > open[4] && 2 * right[5] > open[5], "{right:?} {open:?}");
    }
}

/// Orders with too many paths within an arrival's error stand as clutter.
#[test]
fn dense_orders_are_left_open() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let room = Lit::new(&mut rng, 5, 2, 0);
    let options = Options { bounces: 5, hidden: HiddenPatches::None, ..OPTIONS };
    let most = |sd_ps: f64, rng: &mut ChaCha8Rng| {
        let made = room.made(Seen { orders: [0.9, 0.5, 0.2], deep: 0.0 }, sd_ps, 2, rng);
        let verdicts = PLAIN.verdicts(&options, Some(&room.scene(7, 5e-4, rng)), &made);
        verdicts.iter().flatten().map(|verdict| verdict.path.as_ref().map_or(0, Vec::len)).max()
    };
    let orders = [5.0, 100.0, 400.0].map(|sd_ps| most(sd_ps, &mut rng));
    assert!(orders[0] == Some(5) && orders[2] < Some(4), "{orders:?}");
}

/// Verdicts and hidden patches of a room whose visible patches are in place.
fn searched(room: &Lit, seen: Seen, rng: &mut ChaCha8Rng) -> (Vec<Made>, Vec<Vec<Verdict>>, Vec<Hypothesis>) {
    let options = Options { bounces: 5, ..OPTIONS };
    let made = room.made(seen, 2.0, 1, rng);
    let scene = room.scene(room.visible, 1e-4, rng);
    let mut solution = label(&[PLAIN.sensor((0.0, 0.0), &made)], Some(&scene), &options, &Cancel::never());
    let mut patches = std::mem::take(&mut solution.hypotheses);
    patches.retain(|hypothesis| hypothesis.patch.is_some());
    (made, verdicts(solution), patches)
}

fn nearest_m(room: &Lit, hypothesis: &Hypothesis) -> (usize, f64) {
    let off = |point: &Point| (point - hypothesis.surface.point).norm();
    let offs = room.points.iter().map(off).enumerate();
    offs.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap()
}

const BRIGHT: Seen = Seen { orders: [0.9, 0.06, 0.002], deep: 0.6 };

#[test]
fn a_patch_that_only_hidden_ones_show_is_found_and_its_bounces_labelled() {
    for seed in 0..4 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let room = Lit::new(&mut rng, 8, 4, 1);
        let (made, verdicts, patches) = searched(&room, BRIGHT, &mut rng);
        let places: Vec<(usize, f64)> = patches.iter().map(|one| nearest_m(&room, one)).collect();
        assert_eq!(patches.iter().map(|one| one.layer).collect::<Vec<_>>(), [1, 1, 1, 1, 2], "{seed}: {patches:?}");
        assert!(places[4].0 == 12 && places.iter().all(|(_, off_m)| *off_m < 0.01), "{seed}: {places:?}");
        // Hidden patches by their numbers in the room.
        let number = |patch: &PatchId| {
            let place = patches.iter().position(|one| one.patch == Some(*patch));
            place.map_or(*patch, |place| places[place].0 as PatchId + 1)
        };
        let best = verdicts.iter().map(|verdicts| &verdicts[0]);
        let (mut right, mut wrong, mut of) = (0, 0, 0);
        for (Made { lit, seen, path, .. }, label) in made.iter().zip(best) {
            let is_deep = path.as_ref().is_some_and(|path| path.contains(&13));
            let named = label.path.as_ref().map(|path| path.iter().map(number).collect::<Vec<PatchId>>());
            let turned = named.as_ref().filter(|_| lit == seen).map(|path| path.iter().rev().copied().collect());
            let is_right = named == *path || turned.is_some() && turned == *path;
            of += usize::from(is_deep);
            right += usize::from(is_deep && is_right);
            wrong += usize::from(named.is_some() && !is_right);
        }
        eprintln!("seed {seed}: {right} of {of}, {wrong} wrong of {}", made.len());
        assert!(2 * right > of && 50 * wrong < made.len(), "{seed}: {right} of {of}, {wrong} wrong");
    }
}

/// Fourth and fifth bounces over what is in place are not taken for further patches.
#[test]
fn no_ghosts_are_made_of_later_bounces() {
    for seed in 0..20 {
        let mut rng = ChaCha8Rng::seed_from_u64(100 + seed);
        let room = Lit::new(&mut rng, 8, 4, 0);
        let (_, _, patches) = searched(&room, BRIGHT, &mut rng);
        let layers: Vec<i32> = patches.iter().map(|one| one.layer).collect();
        assert_eq!(layers, [1; 4], "{seed}: {patches:?}");
        assert!(patches.iter().all(|one| nearest_m(&room, one).1 < 0.01), "{seed}: {patches:?}");
    }
}

/// False arrivals and third bounces do not pass for fourth ones, and few of these suffice.
#[test]
fn a_room_is_bright_where_fourth_bounces_are_seen() {
    let is_bright = |fourth: f64, seed: u64| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let room = Lit::new(&mut rng, 8, 2, 0);
        let made = room.made(Seen { orders: [0.7, fourth, 0.0], deep: 0.0 }, 5.0, 8, &mut rng);
        let scene = room.scene(10, 5e-4, &mut rng);
        let sensors = [PLAIN.sensor((0.0, 0.0), &made)];
        shows_fourths(&[], &scene, &sensors, &Options { bounces: 5, ..OPTIONS }, &Cancel::never())
    };
    let dark = (0..200).filter(|seed| is_bright(0.0, *seed)).count();
    let bright = (0..20).filter(|seed| is_bright(0.1, *seed)).count();
    assert!(dark <= 1 && bright >= 19, "{dark} of 200 dark rooms, {bright} of 20 bright ones");
}
