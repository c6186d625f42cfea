//! Light transport against random paths of light: photons leave the laser, fly straight, bounce by chance, and at each
//! bounce the lens gets what it would. Written from the scene file alone; it shares no code with the simulator's
//! integrals.

use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::{PI, TAU};
use std::path::Path;

use nalgebra::Vector3;
use periscope::campaign::keys::PatchRole;
use periscope::simulate::{Laboratory, Scene};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

type Vector = Vector3<f64>;

const LIGHT_M_PER_PS: f64 = 2.997_924_58e-4;

/// Something flat.
struct Piece {
    id: i32,
    corner: Vector,
    edges: [Vector; 2],
    round: bool,
    normal: Vector,
    reflectance: f64,
    lobe: Option<(f64, f64)>,
    mirror: bool,
}

impl Piece {
    fn hit(&self, from: Vector, along: Vector) -> Option<f64> {
        let slope = self.normal.dot(&along);
        let distance = self.normal.dot(&(self.corner - from)) / slope;
        if !(distance > 1e-9 && distance.is_finite()) {
            return None;
        }
        let [a, b] = self.edges.map(|edge| (from + distance * along - self.corner).dot(&edge) / edge.norm_squared());
        let inside = if self.round {
            (a - 0.5).powi(2) + (b - 0.5).powi(2) <= 0.25
        } else {
            (0.0..=1.0).contains(&a) && (0.0..=1.0).contains(&b)
        };
        inside.then_some(distance)
    }

    /// Reflection per solid angle (1/sr).
    fn reflects(&self, incoming: Vector, outgoing: Vector) -> f64 {
        let diffuse = self.reflectance / PI;
        self.lobe.map_or(diffuse, |(share, width)| {
            let mirrored = incoming - 2.0 * self.normal.dot(&incoming) * self.normal;
            let angle = mirrored.dot(&outgoing).clamp(-1.0, 1.0).acos();
            let cosines = (-self.normal.dot(&incoming)).max(0.0) * self.normal.dot(&outgoing).max(0.0);
            let lobe = (-0.5 * (angle / width).powi(2)).exp() / (TAU * width * width * cosines.sqrt());
            (1.0 - share) * diffuse + share * self.reflectance * lobe
        })
    }
}

fn pieces(scene: &Scene) -> Vec<Piece> {
    let disks = scene.patches.iter().map(|(id, disk)| {
        let normal = Vector::from(disk.normal);
        let u = normal.cross(&if normal.x.abs() < 0.9 { Vector::x() } else { Vector::y() }).normalize() * disk.size_m;
        let v = normal.cross(&u);
        Piece {
            id: *id,
            corner: Vector::from(disk.position_m) - 0.5 * (u + v),
            edges: [u, v],
            round: true,
            normal,
            reflectance: disk.reflectance,
            lobe: disk.lobe.map(|lobe| (lobe.share, lobe.width_rad)),
            mirror: disk.role == PatchRole::Mirror,
        }
    });
    let rectangles = scene.surfaces.values().map(|surface| {
        let edges = surface.edges_m.map(Vector::from);
        Piece {
            id: 0,
            corner: Vector::from(surface.corner_m),
            edges,
            round: false,
            normal: edges[0].cross(&edges[1]).normalize(),
            reflectance: surface.reflectance,
            lobe: None,
            mirror: false,
        }
    });
    disks.chain(rectangles).collect()
}

fn nearest(pieces: &[Piece], from: Vector, along: Vector) -> Option<(usize, f64)> {
    let hits = pieces.iter().enumerate().filter_map(|(k, piece)| Some((k, piece.hit(from, along)?)));
    hits.min_by(|a, b| a.1.total_cmp(&b.1))
}

fn sees(pieces: &[Piece], from: Vector, to: Vector) -> bool {
    let arm = to - from;
    let length = arm.norm();
    nearest(pieces, from, arm / length).is_none_or(|(_, distance)| distance > length - 1e-7)
}

/// Sums over random paths: count, strength, its square, strength times way, and its square.
#[derive(Clone, Copy, Default)]
struct Sum {
    strength: f64,
    squares: f64,
    way: f64,
    way_squares: f64,
}

/// Light on a lens of unit area by each path from one unit of light on patch `lit`, in the piece `seen`: strength and
/// mean path, each with its error.
fn random_light(scene: &Scene, lit: i32, seen: i32, bounces: usize, photons: usize) -> BTreeMap<Vec<i32>, [f64; 4]> {
    let pieces = pieces(scene);
    let source = Vector::from(scene.stations["laser"].position_m);
    let eye = Vector::from(scene.sensor_m("s1"));
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut sums: BTreeMap<Vec<i32>, Sum> = BTreeMap::new();
    let target = pieces.iter().find(|piece| piece.id == lit).unwrap();
    for _ in 0..photons {
        let (radius, turn) = (0.5 * rng.random_range(0.0_f64..1.0).sqrt(), rng.random_range(0.0..TAU));
        let [u, v] = target.edges;
        let aim = target.corner + u * (0.5 + radius * turn.cos()) + v * (0.5 + radius * turn.sin());
        let mut at = source;
        let mut along = (aim - source).normalize();
        let (mut strength, mut way, mut path) = (1.0, 0.0, Vec::new());
        while path.len() < bounces {
            let Some((k, distance)) = nearest(&pieces, at, along) else {
                break;
            };
            let piece = &pieces[k];
            if piece.normal.dot(&along) >= 0.0 || piece.reflectance == 0.0 {
                break;
            }
            (at, way) = (at + distance * along, way + distance);
            path.push(piece.id);
            let incoming = along;
            if piece.mirror {
                along -= 2.0 * piece.normal.dot(&along) * piece.normal;
                strength *= piece.reflectance;
                continue;
            }
            let out = eye - at;
            let cosine = piece.normal.dot(&out) / out.norm();
            if piece.id == seen && cosine > 0.0 && sees(&pieces, at, eye) {
                let seen = strength * piece.reflects(incoming, out / out.norm()) * cosine / out.norm_squared();
                let (sum, way) = (sums.entry(path.clone()).or_default(), way + out.norm());
                sum.strength += seen;
                sum.squares += seen * seen;
                sum.way += seen * way;
                sum.way_squares += seen * way * way;
            }
            // On by Lambert's law; what a lobe gives more or less is a weight.
            let (sine, turn) = (rng.random_range(0.0_f64..1.0).sqrt(), rng.random_range(0.0..TAU));
            let u = piece.edges[0].normalize();
            let v = piece.normal.cross(&u);
            along = (u * turn.cos() + v * turn.sin()) * sine + piece.normal * (1.0 - sine * sine).sqrt();
            strength *= piece.reflects(incoming, along) * PI;
        }
    }
    let count = photons as f64;
    let figure = |sum: Sum| {
        let mean = sum.strength / count;
        let error = ((sum.squares / count - mean * mean) / count).sqrt();
        let way = sum.way / sum.strength;
        let spread = (sum.way_squares / sum.strength - way * way).max(0.0).sqrt();
        // As many independent ways as strengths of equal size would be.
        let independent = sum.strength * sum.strength / sum.squares;
        [mean, error, way, spread / independent.sqrt()]
    };
    sums.into_iter().map(|(path, sum)| (path, figure(sum))).collect()
}

const INSTRUMENT: &str = "[instrument]\nresponse = { kind = 'gaussian', fwhm_ps = 100.0 }\ndt_ps = 50.0\nsamples = 2000\nt0_ps = -1000.0\n\
    full_scale_v = 1.0\nsnr = 20.0\njitter_ps = 0.0\n[captures]\nshots = 1\nresponse_shots = 1\npath_m = 1.0\npath_sd_m = 0.0\n";

/// Large near patches, a hidden one behind a screen, a floor, a screen, a glossy patch, a sensor that stands elsewhere.
const ROOM: &str = "
[campaign]
name = 'room'
group_index = 1.0
[stations.laser]
position_m = [0.0, 0.0, 0.0]
[stations.side]
position_m = [0.2, 0.1, 0.0]
[sensors.s1]
station = 'side'
[patches.1]
position_m = [-0.3, 0.0, 0.8]
normal = [0.6, 0.0, -0.8]
size_m = 0.30
[patches.2]
position_m = [0.3, 0.1, 0.7]
normal = [-0.8, 0.0, -0.6]
size_m = 0.24
lobe = { share = 0.4, width_rad = 0.35 }
[patches.3]
position_m = [0.0, 0.45, 0.4]
normal = [0.0, -0.8, 0.6]
size_m = 0.36
role = 'hidden'
[surfaces.screen]
corner_m = [-0.3, 0.25, 0.1]
edges_m = [[0.6, 0.0, 0.0], [0.0, 0.02, 0.15]]
[surfaces.floor]
corner_m = [-0.6, -0.4, 0.1]
edges_m = [[0.0, 0.0, 0.9], [1.2, 0.0, 0.0]]
reflectance = 0.6
cell_m = 0.1
";

/// Every path whose strength random paths know to this part is compared.
const RELATIVE_ERROR: f64 = 0.1;

fn compare(text: &str, bounces: usize, photons: usize, among: &[&[i32]]) {
    let scene = Scene::parse(Path::new("room.toml"), &format!("{text}{INSTRUMENT}bounces = {bounces}\n")).unwrap();
    let laboratory = Laboratory::new(&scene, 1).unwrap();
    let mut compared = BTreeSet::new();
    let mut worst = 0.0_f64;
    for shooting in laboratory.shootings.iter().filter(|shooting| shooting.lit > 0) {
        let reference = random_light(&scene, shooting.lit, shooting.seen, bounces, photons);
        let total: f64 = reference.values().map(|[strength, ..]| strength).sum();
        for (path, [strength, error, way, way_error]) in
            reference.iter().filter(|(_, [strength, error, ..])| *error < RELATIVE_ERROR * strength)
        {
            let light = shooting.paths.get(path).unwrap_or_else(|| panic!("path {path:?} is missing"));
            // The integrals' own error: half a per cent, and 2 mm of way where shadows and lobes have edges.
            let off = (light.total() - strength) / error.hypot(5e-3 * strength);
            let way_off = (light.centroid_ps() * LIGHT_M_PER_PS - way) / way_error.hypot(2e-3);
            assert!(
                off.abs() < 4.5 && way_off.abs() < 4.5,
                "{path:?}: {} {strength} ({error}), {off} {way_off}",
                light.total()
            );
            compared.insert(path.clone());
            worst = worst.max(off.abs()).max(way_off.abs());
        }
        for (path, light) in shooting.paths.iter().filter(|(_, light)| light.total() > 0.01 * total) {
            assert!(reference.contains_key(path), "path {path:?} ({}) is none of the random ones", light.total());
        }
    }
    eprintln!("{compared:?} agree with {photons} random paths a capture; worst {worst:.1} standard deviations");
    assert!(among.iter().all(|path| compared.contains(*path)));
}

#[test]
fn integrals_agree_with_random_paths_over_three_bounces() {
    compare(ROOM, 3, 1_000_000, &[&[1, 2], &[2, 1], &[1, 3, 2], &[1, 0, 1]]);
}

#[test]
fn integrals_agree_with_random_paths_in_mirrors() {
    let mirror = "[patches.4]\nposition_m = [0.1, -0.35, 0.7]\nnormal = [0.0, 1.0, 0.0]\nsize_m = 0.6\nrole = 'mirror'\nreflectance = 0.9\n";
    compare(
        &ROOM.replace("[surfaces.screen]", &format!("{mirror}[surfaces.screen]")),
        4,
        1_000_000,
        &[&[1, 4, 2], &[1, 3, 2]],
    );
}
