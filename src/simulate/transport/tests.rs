//! Light transport against closed forms. Against random paths of light: `tests/it/monte_carlo.rs`.

use std::f64::consts::PI;
use std::path::Path;

use super::*;
use crate::simulate::Scene;
use crate::units;

/// A scene of patches and surfaces, one unit of light and a lens of unit area.
fn scene(patches: &str, surfaces: &str, bounces: usize) -> Scene {
    let text = format!(
        "[campaign]\nname = 'test'\ngroup_index = 1.0\n[sensors.s1]\n{patches}\n{surfaces}\n\
         [instrument]\nresponse = {{ kind = 'gaussian', fwhm_ps = 100.0 }}\ndt_ps = 50.0\nsamples = 1000\nt0_ps = -1000.0\nfull_scale_v = 1.0\n\
         snr = 20.0\njitter_ps = 0.0\n[captures]\nshots = 1\nresponse_shots = 1\npath_m = 1.0\npath_sd_m = 0.0\nbounces = {bounces}\n"
    );
    Scene::parse(Path::new("test.toml"), &text).unwrap()
}

fn patch(id: i32, position: [f64; 3], normal: [f64; 3], size_m: f64, more: &str) -> String {
    format!(
        "[patches.{id}]\nposition_m = {position:?}\nnormal = {normal:?}\nsize_m = {size_m:?}\nreflectance = 1.0\n{more}\n"
    )
}

fn light(scene: &Scene, lit: i32, seen: i32, path: &[i32]) -> Light {
    let room = Room::new(scene);
    let lights = Paths::new(scene, &room, scene.captures.bounces).lit(&scene.covers(lit));
    let paths = lights.get(&("s1".to_owned(), seen)).cloned().unwrap_or_default();
    paths.get(path).cloned().unwrap_or_default()
}

/// Coaxial parallel disks (Howell's catalogue, C-41): share of the diffuse light from one that reaches the other.
#[test]
fn facing_disks_exchange_what_the_view_factor_says() {
    for (radius_m, apart_m) in [(0.1, 0.3), (0.1, 0.2), (0.02, 0.5)] {
        let scene = scene(
            &[
                patch(1, [0.0, 0.0, 1.0], [0.0, 0.0, 1.0], 2.0 * radius_m, ""),
                patch(2, [0.0, 0.0, 1.0 + apart_m], [0.0, 0.0, -1.0], 2.0 * radius_m, ""),
            ]
            .concat(),
            "",
            2,
        );
        let room = Room::new(&scene);
        let (p, links) = (&room.facets[0], room.links(0, 1));
        let width = room.facets[1].elements.len();
        let exchange: f64 = p
            .elements
            .iter()
            .enumerate()
            .flat_map(|(i, element)| {
                links[i * width..(i + 1) * width].iter().map(|link| element.share * link.factor / PI)
            })
            .sum();
        let squared: f64 = (radius_m / apart_m) * (radius_m / apart_m);
        let x = 1.0 + (1.0 + squared) / squared;
        let expected = 0.5 * (x - (x * x - 4.0).sqrt());
        assert!((exchange / expected - 1.0).abs() < 1e-3, "{radius_m} {apart_m}: {exchange} {expected}");
    }
}

#[test]
fn strength_falls_with_the_square_of_the_distance_and_as_the_cosine() {
    let patches = [
        patch(1, [0.0, 0.0, 1.0], [0.0, 0.0, -1.0], 0.001, ""),
        patch(2, [2.0, 0.0, 0.0], [-1.0, 0.0, 0.0], 0.001, ""),
        patch(3, [0.0, 1.0, 0.0], [0.6, -0.8, 0.0], 0.001, ""),
    ];
    let scene = scene(&patches.concat(), "", 1);
    let total = |patch| light(&scene, patch, patch, &[patch]).total();
    assert!((total(1) / total(2) - 4.0).abs() < 1e-5 && (total(3) / total(1) - 0.8).abs() < 1e-5);
    assert!((total(1) * PI - 1.0).abs() < 1e-5, "a white disk at 1 m, lit and seen head on, gives 1 / pi");
}

/// Third bounce over small patches: product of three reflections and two transfers; time of the path through the
/// centres.
#[test]
fn small_patches_hand_light_on_as_points_do() {
    let places = [[0.0, 0.0, 1.0], [0.5, 0.2, 0.6], [-0.3, 0.4, 0.7]];
    let towards = |at: [f64; 3]| {
        let arm = [0.05 - at[0], 0.15 - at[1], 0.3 - at[2]];
        let length = arm.iter().map(|x| x * x).sum::<f64>().sqrt();
        arm.map(|x| x / length)
    };
    let size_m = 0.002;
    let patches: Vec<String> = (0..3).map(|k| patch(k as i32 + 1, places[k], towards(places[k]), size_m, "")).collect();
    let scene = scene(&patches.concat(), "", 3);
    let minus = |a: [f64; 3], b: [f64; 3]| std::array::from_fn::<f64, 3, _>(|k| a[k] - b[k]);
    let dot = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let length = |a: [f64; 3]| dot(a, a).sqrt();
    let cosine = |at: usize, to: [f64; 3]| {
        let arm = minus(to, places[at]);
        dot(towards(places[at]), arm) / length(arm)
    };
    let path = [1, 2, 3];
    let light = light(&scene, 1, 3, &path);
    let area_m2 = PI * (0.5 * size_m).powi(2);
    let mut strength = 1.0;
    let mut length_m = length(places[0]) + length(places[2]);
    for (a, b) in [(0, 1), (1, 2)] {
        let apart_m = length(minus(places[a], places[b]));
        strength *= cosine(a, places[b]) * cosine(b, places[a]) * area_m2 / (PI * apart_m * apart_m);
        length_m += apart_m;
    }
    strength *= cosine(2, [0.0; 3]) / (PI * dot(places[2], places[2]));
    assert!((light.total() / strength - 1.0).abs() < 1e-3, "{} {strength}", light.total());
    assert!((light.centroid_ps() - units::time_ps(length_m, 1.0)).abs() < 0.01);
}

/// A mirror shows the image of the objects in front of it: first bounce off a patch seen in a mirror, at the image's
/// distance.
#[test]
fn a_mirror_shows_the_image() {
    let patches = [
        patch(1, [0.0, 0.3, 1.0], [0.0, -0.6, -0.8], 0.01, ""),
        patch(2, [0.5, 0.0, 0.4], [-1.0, 0.0, 0.0], 0.8, "role = 'mirror'"),
    ];
    let mut scene = scene(&patches.concat(), "", 2);
    scene.captures.seen = vec![1, 2];
    let seen = light(&scene, 1, 2, &[1, 2]);
    // The eye's image is at (1, 0, 0).
    let way_m = |to: [f64; 3]| ((to[0]).powi(2) + 0.3 * 0.3 + 1.0).sqrt();
    let expected_m = way_m([0.0; 3]) + way_m([1.0, 0.0, 0.0]);
    assert!((seen.centroid_ps() - units::time_ps(expected_m, 1.0)).abs() < 0.2);
    let squared = 1.0 + 0.09 + 1.0;
    let cosine = (0.6 * 0.3 + 0.8) / f64::sqrt(squared);
    assert!((seen.total() * PI * squared / cosine - 1.0).abs() < 2e-3, "{}", seen.total());
    // The beam that the mirror turns onto a patch, and back the same way, is the same light.
    scene.captures.lit = vec![1, 2];
    let lit = light(&scene, 2, 1, &[2, 1]);
    assert!(lit.0.is_empty(), "the mirror turns the beam past patch 1");
}

/// Light in a closed box is neither lost nor gained: after each bounce all walls together have the reflectance to that
/// power.
#[test]
fn a_closed_box_keeps_its_light() {
    let walls = [
        ([0.0, 0.0, 0.0], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
        ([0.0, 0.0, 1.0], [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
        ([0.0, 0.0, 0.0], [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
        ([0.0, 1.0, 0.0], [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
        ([0.0, 0.0, 0.0], [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
        ([1.0, 0.0, 0.0], [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]),
    ];
    let surfaces: Vec<String> = walls
        .iter()
        .enumerate()
        .map(|(k, (corner, edges))| {
            format!("[surfaces.w{k}]\ncorner_m = {corner:?}\nedges_m = {edges:?}\nreflectance = 0.5\ncell_m = 0.1\n")
        })
        .collect();
    let text = "[stations.laser]\nposition_m = [0.5, 0.5, 0.5]\n";
    let lit = patch(1, [0.5, 0.5, 0.0], [0.0, 0.0, 1.0], 0.02, "");
    let scene = scene(&lit, &[text, &surfaces.concat()].concat(), 3);
    let room = Room::new(&scene);
    let facets = &room.facets;
    let start = facets.iter().position(|facet| facet.id == 1).unwrap();
    // Strength of the light on each element of each facet.
    let mut on: Vec<Vec<f64>> = facets.iter().map(|facet| vec![0.0; facet.elements.len()]).collect();
    on[start] = facets[start].elements.iter().map(|element| element.share).collect();
    for bounce in 1..=3 {
        let mut next: Vec<Vec<f64>> = facets.iter().map(|facet| vec![0.0; facet.elements.len()]).collect();
        let before: f64 = (0..facets.len()).map(|f| on[f].iter().sum::<f64>() * facets[f].reflectance).sum();
        for from in (0..facets.len()).filter(|&from| on[from].iter().any(|light| *light > 0.0)) {
            for to in (0..facets.len()).filter(|&to| to != from && facets[to].id == 0) {
                for (k, link) in room.links(from, to).iter().enumerate() {
                    let width = facets[to].elements.len();
                    next[to][k % width] += on[from][k / width] * facets[from].reflectance / PI * link.factor;
                }
            }
        }
        on = next;
        let after: f64 = on.iter().flatten().sum();
        // The lit patch covers four cells of its wall, which returning light misses: 4 % of one wall.
        let lost = if bounce == 1 { 1e-3 } else { 0.012 };
        assert!(after / before < 1.0 + 1e-3 && after / before > 1.0 - lost, "bounce {bounce}: {after} of {before}");
    }
}

/// A screen between two patches blocks their light; half a screen blocks half.
#[test]
fn a_screen_hides_what_is_behind_it() {
    let patches = [
        patch(1, [-0.5, 0.0, 1.0], [0.8, 0.0, -0.6], 0.02, ""),
        patch(2, [0.5, 0.0, 1.0], [-0.8, 0.0, -0.6], 0.02, ""),
    ];
    let screen =
        |z: f64| format!("[surfaces.s]\ncorner_m = [0.0, -1.0, {z}]\nedges_m = [[0.0, 2.0, 0.0], [0.0, 0.0, 1.0]]\n");
    let total = |surfaces: &str| light(&scene(&patches.concat(), surfaces, 2), 1, 2, &[1, 2]).total();
    let open = total(&screen(1.5));
    assert!((open / total("") - 1.0).abs() < 1e-6 && total(&screen(0.9)) == 0.0 && total(&screen(1.02)) == open);
    let half = total(&screen(1.0));
    assert!((half / open - 0.5).abs() < 0.05, "{}", half / open);
}

/// A glossy patch with a narrow lobe sends light where a mirror would.
#[test]
fn a_narrow_lobe_points_where_the_mirror_does() {
    let glossy = "lobe = { share = 1.0, width_rad = 0.02 }";
    let mut patches = vec![
        patch(1, [0.0, 0.0, 1.0], [0.6, 0.0, -0.8], 0.01, ""),
        patch(2, [0.5, 0.0, 0.5], [-1.0, 0.0, 0.0], 0.03, glossy),
    ];
    // Light from (0, 0, 1) to (0.5, 0, 0.5) goes on to (0, 0, 0), which is outside the third patch.
    patches.push(patch(3, [0.0, 0.02, 0.02], [0.6, 0.0, 0.8], 0.01, ""));
    patches.push(patch(4, [0.0, 0.02, 0.3], [1.0, 0.0, 0.0], 0.01, ""));
    let stations = "[stations.laser]\nposition_m = [0.3, 0.0, 0.0]\n";
    let scene = scene(&patches.concat(), stations, 3);
    let towards = light(&scene, 1, 3, &[1, 2, 3]).total();
    let beside = light(&scene, 1, 4, &[1, 2, 4]).total();
    assert!(towards > 20.0 * beside, "{towards} {beside}");
}

/// A pixel gets no more light than its detector accepts.
#[test]
fn a_small_detector_limits_what_a_large_lens_gathers() {
    let text = |size_m: f64, detector: &str| {
        let patch = patch(1, [0.0, 0.0, 1.0], [0.0, 0.0, -1.0], size_m, "");
        format!(
            "[campaign]\nname = 'test'\n[sensors.s1]\n{patch}[laser]\npulse_j = 1e-9\nwavelength_nm = 800.0\nrepetition_hz = 1e6\n[optics]\n\
             lens_m = 0.025\n{detector}[instrument]\nresponse = {{ kind = 'gaussian', fwhm_ps = 100.0 }}\nresponsivity_a_w = 0.5\ndt_ps = 50.0\n\
             samples = 1000\nt0_ps = -1000.0\nfull_scale_v = 1.0\nnoise_v = 0.001\njitter_ps = 0.0\n[captures]\nshots = 1\nresponse_shots = 1\n\
             path_m = 1.0\npath_sd_m = 0.0\nbounces = 1\n"
        )
    };
    let total = |size_m: f64, detector: &str| {
        light(&Scene::parse(Path::new("test.toml"), &text(size_m, detector)).unwrap(), 1, 1, &[1]).total()
    };
    let diode = "detector_m = 0.00025\nnumerical_aperture = 0.5\n";
    assert!((total(0.005, diode) / total(0.005, "") - 1.0).abs() < 1e-9);
    // Etendue of the diode over that of a disk of 5 cm and the lens at 1 m.
    let share = (PI * 0.000_125_f64.powi(2) * PI * 0.25) / (PI * 0.025_f64.powi(2) * PI * 0.0125_f64.powi(2));
    assert!((total(0.05, diode) / total(0.05, "") / share - 1.0).abs() < 2e-3);
}
