use super::*;
use crate::geometry::{procrustes, room};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const SD_M: f64 = 0.0075;

struct Measured {
    pairs: Vec<(usize, usize)>,
    first: Vec<Length>,
    second: Vec<(usize, usize, Length)>,
}

impl Measured {
    fn new(truth: &[Point], missing: f64, sd_m: f64, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut pairs = room::all_pairs(truth.len());
        pairs.retain(|_| !rng.random_bool(missing));
        let mut noisy = |length_m: f64| {
            let noise: f64 = StandardNormal.sample(&mut rng);
            Length { length_m: length_m + sd_m * noise, variance_m2: sd_m * sd_m }
        };
        let first = (0..truth.len()).map(|patch| noisy(room::first_m(truth, patch))).collect();
        let second = pairs.iter().map(|&(a, b)| (a, b, noisy(room::second_m(truth, a, b)))).collect();
        Self { pairs, first, second }
    }

    fn place(&self, dimensions: usize) -> Placed {
        place(&Lengths { first: &self.first, second: &self.second, dimensions })
    }
}

fn rms_m(found: &[Point], truth: &[Point]) -> f64 {
    procrustes::rotation(found, truth, Point::origin(), true).rms_m
}

#[test]
fn four_pairs_of_five_may_be_missing() {
    let truth = room::rectangles();
    let mut within = 0;
    for seed in 0..20 {
        let measured = Measured::new(&truth, 0.8, SD_M, seed);
        let placed = measured.place(3);
        let bound_m = room::bound_m(&truth, &measured.pairs, [SD_M, SD_M], 0.0);
        within += usize::from(bound_m.is_finite() && rms_m(&placed.points, &truth) < 2.0 * bound_m);
        assert_eq!(placed.degrees_of_freedom, 49 + measured.pairs.len() as i64 - 144);
    }
    assert!(within >= 18, "{within} of 20");
}

#[test]
fn a_patch_with_two_neighbours_has_a_twin_and_its_mirror_image_is_one_of_the_two() {
    let truth = room::rectangles();
    let mut measured = Measured::new(&truth, 0.5, 1e-4, 3);
    let mut kept = 0;
    measured.second.retain(|(a, b, _)| {
        let of_ten = *a == 10 || *b == 10;
        kept += usize::from(of_ten);
        !of_ten || kept <= 2
    });
    let placed = measured.place(3);
    assert_eq!(placed.twins.len(), 1, "{:?}", placed.twins);
    let twin = placed.twins[0];
    assert!(twin.patch == 10 && twin.more.abs() < 1e-3);
    let mut swapped = placed.points.clone();
    swapped[10] = twin.point;
    assert!(rms_m(&placed.points, &truth).min(rms_m(&swapped, &truth)) < 0.001);
}

#[test]
fn complete_lengths_need_one_start_and_permuting_patches_permutes_the_answer() {
    let truth = room::rectangles();
    let measured = Measured::new(&truth, 0.3, 0.002, 4);
    let placed = measured.place(3);
    assert!(placed.starts == 1 && placed.twins.is_empty());
    let last = truth.len() - 1;
    let mut first = measured.first.clone();
    first.reverse();
    let second: Vec<_> = measured.second.iter().map(|&(a, b, length)| (last - a, last - b, length)).collect();
    let mut flipped = place(&Lengths { first: &first, second: &second, dimensions: 3 }).points;
    flipped.reverse();
    assert!(rms_m(&flipped, &placed.points) < 1e-5);
}

#[test]
fn growth_alone_finds_the_room_and_a_patch_that_sees_none_stays_on_its_sphere() {
    let truth = room::rectangles();
    let mut measured = Measured::new(&truth, 0.6, 1e-4, 5);
    measured.second.retain(|(a, b, _)| *a != 7 && *b != 7);
    let lengths = Lengths { first: &measured.first, second: &measured.second, dimensions: 3 };
    let scene = Scene::new(&lengths);
    let mut grown = scene.grow(&scene.seeds()[0]);
    assert!((2.0 * grown[7].coords.norm() - measured.first[7].length_m).abs() < 1e-9);
    let mut others = truth.clone();
    grown.remove(7);
    others.remove(7);
    assert!(rms_m(&grown, &others) < 0.01, "{}", rms_m(&grown, &others));
}

#[test]
fn a_patch_at_its_mirror_image_is_moved_back() {
    let truth = room::rectangles();
    let measured = Measured::new(&truth, 0.7, 0.001, 6);
    let lengths = Lengths { first: &measured.first, second: &measured.second, dimensions: 3 };
    let scene = Scene::new(&lengths);
    let right = scene.settle(truth.clone());
    let mut start = right.points.clone();
    // Through the plane of p0 and the vertical edge of the wall.
    let normal = truth[0].coords.cross(&Vector3::z()).normalize();
    let height = normal.dot(&start[30].coords);
    start[30] -= 2.0 * normal * height;
    let wrong = scene.settle(start);
    assert!(scene.mend(wrong).loss < right.loss + 1e-3);
}

#[test]
fn flatland_is_placed_in_its_plane() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let truth: Vec<Point> =
        (0..12).map(|_| Point::new(rng.random_range(-2.0..2.0), rng.random_range(1.0..3.0), 0.0)).collect();
    let placed = Measured::new(&truth, 0.5, 1e-4, 8).place(2);
    assert!(placed.points.iter().all(|p| p.z == 0.0));
    assert!(rms_m(&placed.points, &truth) < 0.001, "{}", rms_m(&placed.points, &truth));
}
