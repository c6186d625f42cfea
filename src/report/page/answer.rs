//! The answer: where the surfaces are, how sure that is, and what is left open.

use std::collections::BTreeSet;

use maud::{Markup, html};

use super::words::{count, metres, millimetres, sig};
use super::{image, space};
use crate::report::Report;
use crate::report::scene::{Placed, Scene};
use crate::tables::Ambiguity;

/// Patches that a sentence lists at most.
const LISTED: usize = 12;

/// The section.
pub fn section(report: &Report) -> Markup {
    let Some(scene) = &report.scene else { return html! {} };
    html! {
        section #answer {
            h2 { "Where the surfaces are" }
            (space::figure(scene, report.image.as_ref()))
            @if let Some(whole) = &report.image { (image::image(whole)) }
            (open_questions(scene))
            (positions(scene))
            (planes(scene))
            (shapes(scene))
            (surfaces(scene))
            (gaps(scene))
        }
    }
}

/// One sentence for the head of the page.
pub fn summary(scene: &Scene) -> String {
    // A place that was given is no answer, and its standard deviation no measure of the others.
    let (given, found): (Vec<&Placed>, Vec<&Placed>) =
        scene.patches.iter().partition(|placed| scene.anchors.contains(&placed.patch.patch));
    let of =
        |kind: &str| -> Vec<&Placed> { found.iter().copied().filter(|placed| &*placed.patch.kind == kind).collect() };
    let mut parts = Vec::new();
    for kind in ["visible", "hidden", "mirror"] {
        let of_kind = of(kind);
        let mut sds_m: Vec<f64> = of_kind.iter().filter_map(|placed| placed.patch.sd_m).collect();
        sds_m.sort_by(f64::total_cmp);
        if !of_kind.is_empty() {
            let sd = sds_m
                .get(sds_m.len() / 2)
                .map_or(String::new(), |sd_m| format!(" (median standard deviation {})", millimetres(*sd_m)));
            parts.push(format!("{} {kind}{sd}", of_kind.len()));
        }
    }
    let found = match parts.as_slice() {
        // Of given patches none was to be found.
        [] if !given.is_empty() => String::new(),
        [] => "Patches found: no patch.".to_owned(),
        parts => format!("Patches found: {}.", parts.join(", ")),
    };
    let given = match given.len() {
        0 => String::new(),
        anchors => format!(" {} given by campaign.toml.", count(anchors, "patch is", "patches are")),
    };
    let surface = match scene.surface_points {
        0 => String::new(),
        points => format!(" {} of a hidden surface.", count(points, "point", "points")),
    };
    format!("{found}{given}{surface}").trim_start().to_owned()
}

fn open_questions(scene: &Scene) -> Markup {
    if scene.ambiguities.is_empty() && scene.declined.is_empty() {
        return html! {};
    }
    html! {
        h3 #open { "What is left open" }
        ul.notes {
            @for alike in alike(&scene.ambiguities) {
                @let open = alike[0];
                @let patches: BTreeSet<i32> = alike.iter().flat_map(|open| &open.patches).copied().collect();
                li {
                    strong { (open.kind) }
                    @if !patches.is_empty() { " (" (count_of(&Vec::from_iter(patches))) ")" }
                    @if alike.len() > 1 { ", " (alike.len()) " times" }
                    ": " (open.meaning)
                    @if let Some(sd_m) = open.sd_m { " (off by up to " (millimetres(sd_m)) ", one standard deviation)" }
                }
            }
            @for place in &scene.declined {
                li {
                    strong { "one more patch?" } " At (" (metres(place.x_m)) ", " (metres(place.y_m)) ", " (metres(place.z_m)) ") m; evidence "
                    (sig(place.evidence, 3)) " of the " (sig(place.evidence_needed, 3)) " needed"
                    @if let Some(shots) = place.shots_needed { "; " (sig(shots, 2)) " shots a capture would show it in nine of ten campaigns" }
                    "."
                }
            }
        }
    }
}

/// Ambiguities in groups of one kind, meaning and size, each where its first one is.
fn alike(ambiguities: &[Ambiguity]) -> Vec<Vec<&Ambiguity>> {
    let mut groups: Vec<Vec<&Ambiguity>> = Vec::new();
    for open in ambiguities {
        let is_alike =
            |other: &Ambiguity| (&*open.kind, &*open.meaning, open.sd_m) == (&*other.kind, &*other.meaning, other.sd_m);
        match groups.iter_mut().find(|group| is_alike(group[0])) {
            Some(group) => group.push(open),
            None => groups.push(vec![open]),
        }
    }
    groups
}

/// Patches by their numbers; of many only how many.
fn count_of(patches: &[i32]) -> String {
    if patches.len() > LISTED {
        return count(patches.len(), "patch", "patches");
    }
    let numbers: Vec<String> = patches.iter().map(ToString::to_string).collect();
    format!("{} {}", if patches.len() == 1 { "patch" } else { "patches" }, numbers.join(", "))
}

fn positions(scene: &Scene) -> Markup {
    html! {
        details open[scene.patches.len() <= 30] {
            summary { "Positions of " (count(scene.patches.len(), "patch", "patches")) }
            div.scroll tabindex="0" role="region" aria-label="positions" {
                table.numbers {
                    thead { tr { th { "patch" } th.text { "kind" } th { "x (m)" } th { "y (m)" } th { "z (m)" } th { "sd (mm)" } th { "onsets" } } }
                    tbody {
                        @for Placed { patch, .. } in &scene.patches {
                            tr {
                                td { a href={ "#patch-" (patch.patch) } { (patch.patch) } }
                                td.text.(patch.kind) { (patch.kind) }
                                @for value in [patch.x_m, patch.y_m, patch.z_m] { td { (metres(value)) } }
                                td { @match patch.sd_m { Some(sd_m) => (sig(1e3 * sd_m, 3)), None => "start value" } }
                                td { (patch.onsets) }
                            }
                        }
                    }
                }
            }
            @if let Some(fit) = &scene.fit {
                p.note {
                    "Chi-square " (sig(fit.chi2, 4)) " for " (fit.degrees_of_freedom) " degrees of freedom; "
                    (fit.onsets) " onsets, " (fit.unknowns) " unknowns. Covariances: " (fit.covariance) "."
                }
            }
        }
    }
}

fn planes(scene: &Scene) -> Markup {
    html! {
        @if !scene.planes.is_empty() {
            h3 { "Planes through patches" }
            div.scroll tabindex="0" role="region" aria-label="planes" {
                table.numbers {
                    thead { tr { th { "plane" } th.text { "patches" } th { "normal" } th { "offset (m)" } th { "sd of the normal (mrad)" } th { "rms (mm)" } } }
                    tbody {
                        @for plane in &scene.planes {
                            tr {
                                td { (plane.plane) }
                                td.text { @for (i, patch) in plane.patches.iter().enumerate() { @if i > 0 { ", " } (patch) } }
                                td { (format!("({:.4}, {:.4}, {:.4})", plane.normal_x, plane.normal_y, plane.normal_z)) }
                                td { (metres(plane.offset_m)) }
                                td { (sig(1e3 * plane.normal_sd_rad, 3)) }
                                td { (sig(1e3 * plane.rms_m, 3)) }
                            }
                        }
                    }
                }
            }
        }
    }
}

fn shapes(scene: &Scene) -> Markup {
    html! {
        @if !scene.shapes.is_empty() {
            h3 { "What points of the surface lie on" }
            div.scroll tabindex="0" role="region" aria-label="shapes" {
                table.numbers {
                    thead { tr { th { "shape" } th.text { "kind" } th { "at (m)" } th { "sd (mm)" } th { "normal or direction" } th { "its sd (mrad)" } th { "radius (mm)" } th { "points of the wall" } th { "chi-square / dof" } } }
                    tbody {
                        @for shape in &scene.shapes {
                            tr {
                                td { (shape.shape) }
                                td.text { (shape.kind) }
                                td { (format!("({:.4}, {:.4}, {:.4})", shape.x_m, shape.y_m, shape.z_m)) }
                                td { (sig(1e3 * shape.sd_m, 3)) }
                                td { @if let (Some(x), Some(y), Some(z)) = (shape.axis_x, shape.axis_y, shape.axis_z) { (format!("({x:.4}, {y:.4}, {z:.4})")) } }
                                td { @if let Some(sd_rad) = shape.axis_sd_rad { (sig(1e3 * sd_rad, 3)) } }
                                td { @if let (Some(radius_m), Some(sd_m)) = (shape.radius_m, shape.radius_sd_m) { (format!("{:.2} ± {:.2}", 1e3 * radius_m, 1e3 * sd_m)) } }
                                td { (shape.wall_points) }
                                td { (sig(shape.misfit, 2)) }
                            }
                        }
                    }
                }
            }
        }
    }
}

fn surfaces(scene: &Scene) -> Markup {
    html! {
        @if !scene.meshes.is_empty() {
            h3 { "The surface between these points" }
            p { "Fitted to first light at all points of the wall. The fit does not determine where it ends. As a file: " code { "periscope export RESULTS FILE.ply --mesh" } "." }
            div.scroll tabindex="0" role="region" aria-label="surfaces" {
                table.numbers {
                    thead { tr { th { "surface" } th { "nodes" } th { "distance of nodes (mm)" } th { "median sd (mm)" } th { "curvatures of the order of (1/m)" } th { "points of the wall" } th { "chi-square / number" } } }
                    tbody {
                        @for mesh in &scene.meshes {
                            tr {
                                td { (mesh.mesh) }
                                td { (mesh.nodes) }
                                td { (sig(1e3 * mesh.spacing_m, 3)) }
                                td { (sig(1e3 * mesh.median_sd_m, 2)) }
                                td { (format!("{:.1}", mesh.bend_per_m)) }
                                td { (mesh.wall_points) }
                                td { (sig(mesh.misfit, 2)) }
                            }
                        }
                    }
                }
            }
        }
    }
}

fn gaps(scene: &Scene) -> Markup {
    html! {
        @if !scene.gaps.is_empty() {
            h3 { "Between hidden strips" }
            ul.notes {
                @for gap in &scene.gaps {
                    li {
                        "Between " (gap.a) " and " (gap.b) ": " strong { (gap.verdict) }
                        " (probability of nothing there " (sig(gap.free_probability, 3)) ", " (count(gap.profiles as usize, "profile", "profiles")) ")."
                    }
                }
            }
        }
    }
}
