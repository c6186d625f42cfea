//! The scene in space, to be turned: patches as disks with their error ellipsoids, planes and walls, surfaces, laser
//! and sensors, paths of light. `labels.js` sees to it that numbers do not collide.

mod meshes;

use std::collections::BTreeMap;

use maud::{Markup, html};
use plotly::common::{
    ColorBar, ColorScale, ColorScalePalette, DashType, Line, Marker, MarkerSymbol, Mode, Position, ThicknessMode,
    Title, Visible,
};
use plotly::layout::{AspectMode, Axis, Camera, Eye, LayoutScene, Legend, Margin};
use plotly::{Layout, Plot, Scatter3D, Trace};

use super::plot::{HIDDEN, MIRROR, PALE, STATION, VISIBLE, short};
use super::words::{count, metres, millimetres, sig};
use crate::report::image::Image;
use crate::report::scene::{Placed, Ray, Scene, norm};
use crate::tables::SurfacePoint;

/// Most patches with numbers next to them.
const NUMBERED: usize = 60;
/// Margin around the scene, as a share of its extent.
const MARGIN: f64 = 0.12;
/// Longest semi-axis of a drawn ellipsoid that its marker hides, as a share of the scene's extent.
const MARKER_SHARE: f64 = 0.002;
/// Length of the bar of colours.
const SURFACE_BAR_PX: usize = 240;
/// Laser beams drawn at most, and lines of sight.
const BEAMS: usize = 100;
/// How faint places are that the data allow beside the best.
const ALTERNATIVE: f64 = 0.5;
/// Where the view is from, in sizes of the scene: so near that the scene fills the figure.
const EYE: (f64, f64, f64) = (0.95, 0.95, 0.7);
/// Digits of drawn coordinates.
const DIGITS: i32 = 6;

/// The figure.
pub fn figure(scene: &Scene, image: Option<&Image>) -> Markup {
    html! {
        (super::plot::figure("scene", 560, &plot(scene, image), &alternative(scene), &caption(scene)))
        div.viewer role="group" aria-label="turn the view" {
            @for (turn, name, sign) in [("left", "turn left", "◀"), ("right", "turn right", "▶"), ("up", "look from higher up", "▲"), ("down", "look from lower down", "▼"), ("nearer", "come nearer", "+"), ("farther", "go farther away", "−")] {
                button type="button" data-turn=(turn) aria-label=(name) { (sign) }
            }
        }
    }
}

fn alternative(scene: &Scene) -> String {
    let of = |kind: &str| scene.patches.iter().filter(|placed| &*placed.patch.kind == kind).count();
    let surface = match scene.surface_points {
        0 => String::new(),
        points => format!(", {} of a hidden surface", count(points, "point", "points")),
    };
    format!(
        "The scene in space: {} visible, {} hidden patches{surface}, {}. The table of positions below has the same numbers.",
        of("visible"),
        of("hidden"),
        count(scene.planes.len() + scene.walls.len(), "plane", "planes")
    )
}

fn caption(scene: &Scene) -> Markup {
    let frame = scene.fit.as_ref().map(|fit| match &*fit.frame {
        "fixed" => "The frame is that of campaign.toml.".to_owned(),
        "stations" => "Path lengths do not determine a rotation about the line of the stations: it is a convention.".to_owned(),
        _ => "Path lengths do not determine rotations about the laser, nor mirror images: first patch on +x, the next in the xy plane, the next at z > 0, by convention.".to_owned(),
    });
    html! {
        "Drag to turn, scroll to come nearer, click a patch for its onsets, click the legend to hide things. "
        @if scene.patches.iter().any(|placed| placed.semi_axes_m.is_some()) {
            "Ellipsoids are two standard deviations"
            @if scene.ellipsoid_factor == 1.0 { ", true to scale. " } @else { ", drawn " strong { (sig(scene.ellipsoid_factor, 3)) " times" } " their size. " }
        }
        @if !scene.footprints.is_empty() { "Disks: " (scene.footprints.len()) " patches whose size and direction are known, true to scale. " }
        @if scene.surface_points > 0 {
            "Surface: " @if scene.surface.len() < scene.surface_points { (scene.surface.len()) " of " } (count(scene.surface_points, "point", "points")) ", coloured by standard deviation"
            @if !scene.meshes.is_empty() { ", and " (count(scene.meshes.len(), "surface", "surfaces")) " between them with " (count(scene.vertices.len(), "node", "nodes")) " in the same colours" }
            ". "
        }
        @if !scene.rays.is_empty() { "Red: laser beam to the lit patches. " }
        @if let Some(frame) = frame { (frame) " " }
        @for reason in &scene.unread { "Its laser, sensors and paths are not drawn: " (reason) ". " }
        "Table " code { (scene.heading) } "."
    }
}

fn coordinates<'a>(places: impl Iterator<Item = [f64; 3]> + Clone + 'a) -> [Vec<f64>; 3] {
    std::array::from_fn(|axis| places.clone().map(|place| short(place[axis], DIGITS)).collect())
}

/// Whether the ellipsoid of a patch is larger than its marker. Those of the given points of a wall are not, and would
/// be a third of the page.
fn is_to_see(placed: &Placed, scene: &Scene) -> bool {
    let drawn_m = placed.semi_axes_m.map_or(0.0, |axes| 2.0 * scene.ellipsoid_factor * norm(axes[0]));
    drawn_m > MARKER_SHARE * extent_m(scene)
}

fn plot(scene: &Scene, image: Option<&Image>) -> Plot {
    let mut plot = Plot::new();
    for (kind, colour) in [("visible", VISIBLE), ("hidden", HIDDEN), ("mirror", MIRROR)] {
        let of_kind: Vec<&Placed> = scene.patches.iter().filter(|placed| &*placed.patch.kind == kind).collect();
        if !of_kind.is_empty() {
            plot.add_trace(points(&of_kind, kind, colour));
            let to_see: Vec<&Placed> = of_kind.iter().copied().filter(|placed| is_to_see(placed, scene)).collect();
            plot.add_traces(meshes::ellipsoids(&to_see, scene.ellipsoid_factor, kind, colour));
            plot.add_traces(meshes::disks(&of_kind, &scene.footprints, kind, colour));
        }
    }
    plot.add_traces(meshes::planes(&scene.planes, &scene.patches));
    plot.add_traces(meshes::walls(&scene.walls, extent_m(scene)));
    if !scene.surface.is_empty() {
        let ends_mm = shades(&scene.surface);
        plot.add_traces(meshes::surfaces(&scene.vertices, ends_mm));
        plot.add_trace(surface(&scene.surface, ends_mm));
    }
    if !scene.alternatives.is_empty() {
        let [x, y, z] = coordinates(scene.alternatives.iter().map(|patch| [patch.x_m, patch.y_m, patch.z_m]));
        let names =
            scene.alternatives.iter().map(|patch| format!("patch {}, alternative {}", patch.patch, patch.alternative));
        let marker = Marker::new().size(5).color(PALE).symbol(MarkerSymbol::CircleOpen);
        let trace =
            Scatter3D::new(x, y, z).name("alternatives").mode(Mode::Markers).marker(marker).opacity(ALTERNATIVE);
        plot.add_trace(trace.hover_text_array(names.collect()).hover_template("%{hovertext}<extra></extra>"));
    }
    if !scene.declined.is_empty() {
        let [x, y, z] = coordinates(scene.declined.iter().map(|place| [place.x_m, place.y_m, place.z_m]));
        let marker = Marker::new().size(6).color(HIDDEN).symbol(MarkerSymbol::DiamondOpen);
        let trace = Scatter3D::new(x, y, z).name("not sure enough").mode(Mode::Markers).marker(marker);
        plot.add_trace(trace.hover_template("likeliest place of one more patch<extra></extra>"));
    }
    plot.add_traces(stations(&scene.stations));
    plot.add_traces(beams(&scene.rays));
    let voxels = image.map_or(&[][..], |image| &image.points);
    if !voxels.is_empty() {
        plot.add_trace(bright(voxels));
    }
    for (is_hidden, name, colour) in
        [(true, "paths over hidden patches", HIDDEN), (false, "paths over visible patches", VISIBLE)]
    {
        let rays: Vec<&Ray> = scene.rays.iter().filter(|ray| ray.is_hidden == is_hidden && ray.bounces > 1).collect();
        plot.add_traces(paths(&rays, name, colour, is_hidden));
    }
    let legend = Legend::new()
        .orientation(plotly::common::Orientation::Horizontal)
        .y(-0.02)
        .item_sizing(plotly::layout::ItemSizing::Constant);
    let layout = Layout::new().scene(room(scene, voxels)).legend(legend);
    plot.set_layout(layout.margin(Margin::new().left(0).right(0).top(0).bottom(0)));
    plot
}

/// Axes bounded by what was placed, so that one wide ellipsoid does not make all else small.
fn room(scene: &Scene, voxels: &[([f64; 3], f64)]) -> LayoutScene {
    let places = scene.patches.iter().map(Placed::at).chain(scene.stations.values().copied());
    let surface = scene.surface.iter().map(|point| [point.x_m, point.y_m, point.z_m]);
    let places: Vec<[f64; 3]> = places.chain(surface).chain(voxels.iter().map(|(middle_m, _)| *middle_m)).collect();
    let bounds: [[f64; 2]; 3] = std::array::from_fn(|axis| {
        let along = || places.iter().map(|place| place[axis]);
        [along().fold(f64::INFINITY, f64::min), along().fold(f64::NEG_INFINITY, f64::max)]
    });
    let beside_m = MARGIN * bounds.iter().map(|[from, to]| to - from).fold(0.0, f64::max);
    let axis = |axis: usize| {
        let [from, to] = bounds[axis];
        let title = ["x (m)", "y (m)", "z (m)"][axis];
        let shown = Axis::new().title(title);
        if beside_m > 0.0 { shown.range(vec![short(from - beside_m, 4), short(to + beside_m, 4)]) } else { shown }
    };
    let camera = Camera::new().eye(Eye::from(EYE));
    LayoutScene::new().camera(camera).aspect_mode(AspectMode::Data).x_axis(axis(0)).y_axis(axis(1)).z_axis(axis(2))
}

/// The longest side of the box around all patches.
fn extent_m(scene: &Scene) -> f64 {
    let side = |axis: usize| {
        let along = || scene.patches.iter().map(|placed| placed.at()[axis]);
        along().fold(f64::NEG_INFINITY, f64::max) - along().fold(f64::INFINITY, f64::min)
    };
    (0..3).map(side).fold(0.0, f64::max)
}

/// Laser and sensors; those that stand in one place share a name.
fn stations(stations: &BTreeMap<String, [f64; 3]>) -> Vec<Box<dyn Trace>> {
    let mut by_place: Vec<([f64; 3], Vec<&str>)> = Vec::new();
    for (name, place) in stations {
        match by_place.iter_mut().find(|(at, _)| at == place) {
            Some((_, names)) => names.push(name),
            None => by_place.push((*place, vec![name])),
        }
    }
    if by_place.is_empty() {
        return Vec::new();
    }
    let [x, y, z] = coordinates(by_place.iter().map(|(place, _)| *place));
    let marker = Marker::new().size(6).color(STATION).symbol(MarkerSymbol::Diamond);
    let trace = Scatter3D::new(x, y, z).name("laser and sensors").mode(Mode::MarkersText).marker(marker);
    let names = by_place.iter().map(|(_, names)| names.join(", ")).collect();
    vec![trace.text_array(names).text_position(Position::BottomCenter).hover_template("%{text}<extra></extra>")]
}

/// The laser's beam to the patches that it lights, and the line of sight of the sensors to those that they see.
fn beams(rays: &[Ray]) -> Vec<Box<dyn Trace>> {
    let leg = |of: fn(&[[f64; 3]]) -> &[[f64; 3]]| -> Vec<&[[f64; 3]]> {
        let mut legs: Vec<&[[f64; 3]]> = Vec::new();
        for leg in rays.iter().map(|ray| of(&ray.corners_m)) {
            if !legs.contains(&leg) && legs.len() < BEAMS {
                legs.push(leg);
            }
        }
        legs
    };
    let first = leg(|corners| &corners[..2]);
    let last = leg(|corners| &corners[corners.len() - 2..]);
    let beam = lines(&first, "laser beam", STATION, 2.5, true);
    beam.into_iter().chain(lines(&last, "sensors' lines of sight", PALE, 1.0, false)).collect()
}

/// Standard deviations (mm) at which colours begin and end: few points with large errors would leave one colour to all
/// others.
fn shades(points: &[SurfacePoint]) -> [f64; 2] {
    let mut sds_mm: Vec<f64> = points.iter().map(|point| short(1e3 * point.sd_m, 3)).collect();
    sds_mm.sort_by(f64::total_cmp);
    [sds_mm[0], sds_mm[sds_mm.len() * 9 / 10]]
}

/// Points of a hidden surface, coloured by their standard deviation.
fn surface(points: &[SurfacePoint], [least_mm, most_mm]: [f64; 2]) -> Box<dyn Trace> {
    let [x, y, z] = coordinates(points.iter().map(|point| [point.x_m, point.y_m, point.z_m]));
    let sds_mm: Vec<f64> = points.iter().map(|point| short(1e3 * point.sd_m, 3)).collect();
    let text = |point: &SurfacePoint| {
        let shape = point.shape.map_or(String::new(), |shape| format!(" on shape {shape}"));
        format!(
            "{} point of a surface{shape}<br>sd {}<br>chi-square / dof {}",
            point.kind,
            millimetres(point.sd_m),
            sig(point.misfit, 2)
        )
    };
    let marker = Marker::new()
        .size(3)
        .color_array(sds_mm)
        .cmin(least_mm)
        .cmax(most_mm)
        .color_scale(ColorScale::Palette(ColorScalePalette::Viridis))
        .color_bar(
            ColorBar::new()
                .title(Title::with_text("sd (mm)"))
                .thickness(12)
                .x(0.0)
                .len_mode(ThicknessMode::Pixels)
                .len(SURFACE_BAR_PX),
        );
    let trace = Scatter3D::new(x, y, z).name("surface").mode(Mode::Markers).marker(marker);
    trace.hover_text_array(points.iter().map(text).collect()).hover_template("%{hovertext}<extra></extra>")
}

/// Voxels of an image, coloured by their significance.
fn bright(voxels: &[([f64; 3], f64)]) -> Box<dyn Trace> {
    let [x, y, z] = coordinates(voxels.iter().map(|(middle_m, _)| *middle_m));
    let levels: Vec<f64> = voxels.iter().map(|(_, significance)| short(*significance, 3)).collect();
    let marker = Marker::new()
        .size(2)
        .opacity(0.5)
        .color_array(levels)
        .color_scale(ColorScale::Palette(ColorScalePalette::Viridis));
    let trace = Scatter3D::new(x, y, z).name("voxels brighter than noise").mode(Mode::Markers).marker(marker);
    trace.hover_template("(%{x}, %{y}, %{z}) m<extra></extra>")
}

fn points(patches: &[&Placed], kind: &str, colour: &str) -> Box<dyn Trace> {
    let [x, y, z] = coordinates(patches.iter().map(|placed| placed.at()));
    let ids: Vec<String> = patches.iter().map(|placed| placed.patch.patch.to_string()).collect();
    let text = |placed: &&Placed| {
        let Placed { patch, .. } = placed;
        let sd = patch.sd_m.map_or(String::new(), |sd_m| format!("<br>sd {}", millimetres(sd_m)));
        format!(
            "patch {} ({kind})<br>({}, {}, {}) m{sd}<br>{} onsets",
            patch.patch,
            metres(patch.x_m),
            metres(patch.y_m),
            metres(patch.z_m),
            patch.onsets
        )
    };
    let mode = if patches.len() <= NUMBERED { Mode::MarkersText } else { Mode::Markers };
    Scatter3D::new(x, y, z)
        .name(kind)
        .legend_group(kind)
        .mode(mode)
        .marker(Marker::new().size(4).color(colour.to_owned()))
        .text_array(ids.clone())
        .text_position(Position::TopCenter)
        .ids(ids)
        .hover_text_array(patches.iter().map(text).collect())
        .hover_template("%{hovertext}<extra></extra>")
}

fn paths(rays: &[&Ray], name: &str, colour: &str, is_shown: bool) -> Vec<Box<dyn Trace>> {
    let corners: Vec<&[[f64; 3]]> = rays.iter().map(|ray| &ray.corners_m[..]).collect();
    lines(&corners, name, colour, 1.0, is_shown)
}

/// Lines through corners, all as one trace.
fn lines(all: &[&[[f64; 3]]], name: &str, colour: &str, width: f64, is_shown: bool) -> Vec<Box<dyn Trace>> {
    if all.is_empty() {
        return Vec::new();
    }
    let along = |axis: usize| -> Vec<Option<f64>> {
        let one = |corners: &&[[f64; 3]]| {
            let corners = corners.iter().map(|corner| Some(short(corner[axis], DIGITS)));
            corners.chain([None]).collect::<Vec<_>>()
        };
        all.iter().flat_map(one).collect()
    };
    let trace = Scatter3D::new(along(0), along(1), along(2))
        .name(name)
        .mode(Mode::Lines)
        .line(Line::new().color(colour.to_owned()).width(width).dash(DashType::Solid))
        .opacity(0.35)
        .hover_info(plotly::common::HoverInfo::Skip)
        .visible(if is_shown { Visible::True } else { Visible::LegendOnly });
    vec![trace]
}
