//! What a relay wall shows: the verdict of `locate`, and the image beside it.

use super::decision;
use crate::campaign::count;
use crate::tables::{Decision, Image, JointSearch, Mesh, Omission, Shape, SurfacePoint};

/// Shapes that are named one by one.
const NAMED: usize = 6;

/// Points of a surface, and what stages made of them; `None` where these did not run.
#[derive(Clone, Copy)]
pub(super) struct Surface<'a> {
    pub points: &'a [SurfacePoint],
    pub omissions: &'a [Omission],
    pub shapes: Option<&'a [Shape]>,
    pub meshes: Option<&'a [Mesh]>,
}

/// The verdict, the surface, the image, and what these rest on.
pub(super) fn decisions(searches: &[JointSearch], images: &[Image], surface: Option<Surface<'_>>) -> Vec<Decision> {
    let mut decisions: Vec<Decision> = searches.iter().map(verdict).collect();
    let is_extended = searches.is_empty() || searches.iter().any(|search| &*search.verdict == "extended-object");
    if let Some(Surface { points, omissions, shapes, meshes }) = surface.filter(|_| is_extended) {
        decisions.push(points_of_surface(points, omissions, searches.is_empty()));
        if !points.is_empty() {
            decisions.extend(shapes.map(|shapes| shapes_of_surface(shapes, points.len())));
            decisions.extend(meshes.map(meshes_of_surface));
        }
    }
    decisions.extend(images.iter().map(image));
    decisions.extend(searches.iter().flat_map(|search| [response(search), gate(search)]));
    decisions
}

/// Which reading explains the counts.
fn verdict(search: &JointSearch) -> Decision {
    let points = search.points;
    let (chosen, would_change) = match &*search.verdict {
        "points" => (
            format!("{} with error bars, in `patches`", count(points, "point", "points")),
            "other histograms in which the points do not reappear",
        ),
        "extended-object" => (
            "an extended object: no points; its image is in `voxels`".to_owned(),
            "nothing but other captures; for a small part of it, `samples` or `gate_ps` that keep only its light",
        ),
        "nothing" => ("nothing".to_owned(), "more photons, or a gate that passes the signal that you look for"),
        _ => (
            "undetermined: neither points nor a surface explain the histograms; the image is in `voxels`".to_owned(),
            "more photons, more points of the wall, or the capture of a response",
        ),
    };
    let evidence = format!(
        "{}; {} histograms, largest score {:.1} standard deviations, {:.1} is needed",
        search.reason, search.histograms, search.largest, search.threshold
    );
    decision("hidden things", &chosen, &evidence, would_change)
}

/// What first light says of an extended object. Where nothing else was looked for, nothing says that there is one.
fn points_of_surface(points: &[SurfacePoint], omissions: &[Omission], is_presumed: bool) -> Decision {
    let of_kind = |kind: &str| points.iter().filter(|point| &*point.kind == kind).count();
    let mut sds_mm: Vec<f64> = points.iter().map(|point| 1e3 * point.sd_m).collect();
    sds_mm.sort_by(f64::total_cmp);
    let chosen = match points.len() {
        0 => "no surface: first light of neighbouring points of the wall does not agree".to_owned(),
        number => {
            format!("{} of a surface with error bars and normals, in `surface`", count(number, "point", "points"))
        }
    };
    let kinds = ["smooth", "edge", "corner", "unknown"].map(|kind| format!("{} {kind}", of_kind(kind))).join(", ");
    let evidence = match sds_mm.get(sds_mm.len() / 2) {
        Some(sd_mm) => {
            let why = if is_presumed {
                "the pipeline looks for a surface alone, not for small things"
            } else {
                "small things do not explain the histograms"
            };
            format!("{why}; {kinds}; median sd {sd_mm:.1} mm")
        }
        None => "light rises in too few histograms, or at times that no surface has".to_owned(),
    };
    let later = points.iter().filter(|point| point.rank > 1).count() as i32;
    let behind =
        if later > 0 { format!("; {later} of them by light that rises again behind the first") } else { String::new() };
    let evidence = format!("{evidence}{behind}{}", without_point(omissions));
    decision("surface", &chosen, &evidence, "more photons, or more points of the wall")
}

/// How many points of the wall have no point of a surface, by reason; nothing where all have one.
fn without_point(omissions: &[Omission]) -> String {
    if omissions.is_empty() {
        return String::new();
    }
    let reasons = [
        ("no-rise", "no light that rises"),
        ("untimed", "light that cannot be timed"),
        ("earlier-light", "light before it that is too weak to be timed"),
        ("no-field", "neighbours that do not agree on one surface"),
        ("no-scan", "a pair that is in no scan"),
        ("no-noise", "levels that do not vary"),
    ];
    let parts = reasons.iter().filter_map(|(reason, words)| {
        let number = omissions.iter().filter(|omission| &*omission.reason == *reason).count();
        (number > 0).then(|| format!("{number} with {words}"))
    });
    let parts = parts.collect::<Vec<_>>().join(", ");
    format!("; without a point of first light, in `surface.omissions`: {parts}")
}

/// What these points lie on.
fn shapes_of_surface(shapes: &[Shape], points: usize) -> Decision {
    let named = shapes.iter().take(NAMED).map(|shape| match (shape.radius_m, shape.radius_sd_m) {
        (Some(radius_m), Some(sd_m)) => {
            format!("{} of radius {:.1} ± {:.1} mm", shape.kind, 1e3 * radius_m, 1e3 * sd_m)
        }
        _ => shape.kind.to_string(),
    });
    let more = shapes.len().saturating_sub(NAMED);
    let named = named.chain((more > 0).then(|| format!("{more} more"))).collect::<Vec<_>>().join(", ");
    let on_shapes: i32 = shapes.iter().map(|shape| shape.wall_points).sum();
    if shapes.is_empty() {
        let evidence = "no plane, sphere or cylinder is certain: other kinds or bent surfaces are as likely";
        return decision(
            "shapes",
            "none; the points stay as they are",
            evidence,
            "more photons, or more points of the wall",
        );
    }
    decision(
        "shapes",
        &format!("{named}, in `shapes`"),
        &format!("{on_shapes} of {points} points lie on them; each kind is 20 times likelier than any other, or more"),
        "a bent surface that differs from these by less than errors of first light",
    )
}

/// The surface between these points.
fn meshes_of_surface(meshes: &[Mesh]) -> Decision {
    let one =
        |mesh: &Mesh| format!("{}, median sd {:.1} mm", count(mesh.nodes, "node", "nodes"), 1e3 * mesh.median_sd_m);
    let would_change = "more photons, or more points of the wall";
    if meshes.is_empty() {
        let evidence = "no smooth surface explains first light, or too few points lie on all sides of its parts";
        return decision("meshes", "none; the points stay as they are", evidence, would_change);
    }
    let chosen = format!(
        "{} in `meshes`: {}",
        count(meshes.len() as i32, "surface", "surfaces"),
        meshes.iter().take(NAMED).map(one).collect::<Vec<_>>().join("; ")
    );
    let misfits = meshes.iter().take(NAMED).map(|mesh| format!("{:.2}", mesh.misfit)).collect::<Vec<_>>().join(", ");
    let evidence =
        format!("chi-square of first light per histogram: {misfits}; the fit does not determine where a surface ends");
    decision("meshes", &chosen, &evidence, would_change)
}

/// How far the image exceeds noise.
fn image(image: &Image) -> Decision {
    let evidence = match (image.largest, image.largest_x_m, image.largest_y_m, image.largest_z_m) {
        (Some(largest), Some(x_m), Some(y_m), Some(z_m)) => format!(
            "the brightest, at ({x_m:.3}, {y_m:.3}, {z_m:.3}) m, has {largest:.1} standard deviations, {:.1} is needed in {} cells",
            image.threshold, image.cells
        ),
        _ => "no voxel has data".to_owned(),
    };
    let chosen = match image.voxels {
        0 => "no voxel is brighter than noise".to_owned(),
        voxels => format!("{} brighter than noise, by {}", count(voxels, "voxel", "voxels"), image.method),
    };
    decision("image", &chosen, &evidence, "for retroreflective things `voxels.falloff = 2`, which no capture says")
}

/// Whose response the points were fitted with.
fn response(search: &JointSearch) -> Decision {
    let (chosen, evidence) = match &*search.response {
        "wall" => ("that of the wall's own light, with its tail", "the histograms begin with the light of the wall"),
        _ => ("that of the calibration", "the histograms do not begin with the light of the wall"),
    };
    decision("response", chosen, evidence, "`patches.response` in the pipeline")
}

/// From when on light counts.
fn gate(search: &JointSearch) -> Decision {
    decision(
        "gate",
        &format!("light counts from {:.0} ps behind that of the wall", search.gate_ps),
        &format!("the histograms end at {:.0} ps", search.end_ps),
        "`gate_ps` of the sensor in campaign.toml",
    )
}
