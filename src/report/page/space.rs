//! The scene in space, to be turned: patches with their error ellipsoids, laser and sensors, paths of light.

use maud::{Markup, html};
use plotly::common::{ColorScale, ColorScalePalette, DashType, Line, Marker, MarkerSymbol, Mode, Position, Visible};
use plotly::layout::{AspectMode, Axis, LayoutScene, Legend, Margin};
use plotly::{Layout, Mesh3D, Plot, Scatter3D, Trace};

use super::plot::{HIDDEN, MIRROR, PALE, STATION, VISIBLE, short};
use super::words::{metres, millimetres, sig};
use crate::report::image::Image;
use crate::report::scene::{Placed, Ray, Scene};

/// Rings and sectors of a drawn ellipsoid.
const RINGS: usize = 6;
const SECTORS: usize = 10;
/// Ellipsoids that are drawn at most: beyond, points alone.
const ELLIPSOIDS: usize = 600;
/// Most patches with numbers next to them.
const NUMBERED: usize = 60;
/// Margin around the scene, as a share of its extent.
const MARGIN: f64 = 0.12;
/// Digits of drawn coordinates.
const DIGITS: i32 = 6;

/// The figure.
pub fn figure(scene: &Scene, image: Option<&Image>) -> Markup {
    super::plot::figure("scene", 560, &plot(scene, image), &caption(scene))
}

fn caption(scene: &Scene) -> Markup {
    let frame = scene.fit.as_ref().map(|fit| match &*fit.frame {
        "fixed" => "The frame is that of campaign.toml.".to_owned(),
        "stations" => "Nothing tells how the scene is turned about the line of the stations: that is a convention.".to_owned(),
        _ => "Path lengths say nothing of rotations about the laser, nor of mirror images: first patch on +x, the next in the xy plane, the next at z > 0, by convention.".to_owned(),
    });
    html! {
        "Drag to turn, scroll to come nearer, click a patch for its onsets, click the legend to hide things. "
        @if scene.patches.iter().any(|placed| placed.semi_axes_m.is_some()) {
            "Ellipsoids are two standard deviations, drawn " strong { (sig(scene.ellipsoid_factor, 3)) " times" } " their size. "
        }
        @if let Some(frame) = frame { (frame) " " }
        @for reason in &scene.unread { "Its laser, sensors and paths are not drawn: " (reason) ". " }
        "Table " code { (scene.heading) } "."
    }
}

fn coordinates<'a>(places: impl Iterator<Item = [f64; 3]> + Clone + 'a) -> [Vec<f64>; 3] {
    std::array::from_fn(|axis| places.clone().map(|place| short(place[axis], DIGITS)).collect())
}

fn plot(scene: &Scene, image: Option<&Image>) -> Plot {
    let mut plot = Plot::new();
    for (kind, colour) in [("visible", VISIBLE), ("hidden", HIDDEN), ("mirror", MIRROR)] {
        let of_kind: Vec<&Placed> = scene.patches.iter().filter(|placed| &*placed.patch.kind == kind).collect();
        if !of_kind.is_empty() {
            plot.add_trace(points(&of_kind, kind, colour));
            plot.add_traces(ellipsoids(&of_kind, scene.ellipsoid_factor, kind, colour));
        }
    }
    if !scene.alternatives.is_empty() {
        let [x, y, z] = coordinates(scene.alternatives.iter().map(|patch| [patch.x_m, patch.y_m, patch.z_m]));
        let names =
            scene.alternatives.iter().map(|patch| format!("patch {}, alternative {}", patch.patch, patch.alternative));
        let marker = Marker::new().size(5).color(PALE).symbol(MarkerSymbol::CircleOpen);
        let trace = Scatter3D::new(x, y, z).name("alternatives").mode(Mode::Markers).marker(marker);
        plot.add_trace(trace.hover_text_array(names.collect()).hover_template("%{hovertext}<extra></extra>"));
    }
    if !scene.declined.is_empty() {
        let [x, y, z] = coordinates(scene.declined.iter().map(|place| [place.x_m, place.y_m, place.z_m]));
        let marker = Marker::new().size(6).color(HIDDEN).symbol(MarkerSymbol::DiamondOpen);
        let trace = Scatter3D::new(x, y, z).name("not sure enough").mode(Mode::Markers).marker(marker);
        plot.add_trace(trace.hover_template("likeliest place of one more patch<extra></extra>"));
    }
    let [x, y, z] = coordinates(scene.stations.values().copied());
    if !x.is_empty() {
        let marker = Marker::new().size(6).color(STATION).symbol(MarkerSymbol::Diamond);
        let trace = Scatter3D::new(x, y, z).name("laser and sensors").mode(Mode::MarkersText).marker(marker);
        let names = scene.stations.keys().cloned().collect();
        plot.add_trace(
            trace.text_array(names).text_position(Position::BottomCenter).hover_template("%{text}<extra></extra>"),
        );
    }
    let voxels = image.map_or(&[][..], |image| &image.points);
    if !voxels.is_empty() {
        plot.add_trace(bright(voxels));
    }
    for (is_hidden, name, colour) in
        [(true, "paths over hidden patches", HIDDEN), (false, "paths over visible patches", VISIBLE)]
    {
        let rays: Vec<&Ray> = scene.rays.iter().filter(|ray| ray.is_hidden == is_hidden && ray.bounces > 1).collect();
        if !rays.is_empty() {
            plot.add_trace(paths(&rays, name, colour, is_hidden));
        }
    }
    // Bounded by what was found, so that one wide ellipsoid does not make all else small.
    let places = scene.patches.iter().map(Placed::at).chain(scene.stations.values().copied());
    let places: Vec<[f64; 3]> = places.chain(voxels.iter().map(|(middle_m, _)| *middle_m)).collect();
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
    let room = LayoutScene::new().aspect_mode(AspectMode::Data).x_axis(axis(0)).y_axis(axis(1)).z_axis(axis(2));
    let legend = Legend::new()
        .orientation(plotly::common::Orientation::Horizontal)
        .y(-0.02)
        .item_sizing(plotly::layout::ItemSizing::Constant);
    plot.set_layout(Layout::new().scene(room).legend(legend).margin(Margin::new().left(0).right(0).top(0).bottom(0)));
    plot
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

/// All ellipsoids of one kind as one mesh: a sphere's corners, stretched by each covariance.
fn ellipsoids(patches: &[&Placed], factor: f64, kind: &str, colour: &str) -> Vec<Box<dyn Trace>> {
    let (mut corners, mut faces): (Vec<[f64; 3]>, Vec<[usize; 3]>) = (Vec::new(), Vec::new());
    for placed in patches.iter().take(ELLIPSOIDS) {
        let Some(axes) = placed.semi_axes_m else { continue };
        let first = corners.len();
        for ring in 0..=RINGS {
            let polar = std::f64::consts::PI * ring as f64 / RINGS as f64;
            for sector in 0..SECTORS {
                let azimuth = std::f64::consts::TAU * sector as f64 / SECTORS as f64;
                let unit = [polar.sin() * azimuth.cos(), polar.sin() * azimuth.sin(), polar.cos()];
                let along = |axis: usize| (0..3).map(|k| unit[k] * axes[k][axis]).sum::<f64>();
                corners.push(std::array::from_fn(|axis| placed.at()[axis] + 2.0 * factor * along(axis)));
            }
        }
        for (ring, sector) in (0..RINGS).flat_map(|ring| (0..SECTORS).map(move |sector| (ring, sector))) {
            let corner = |ring: usize, sector: usize| first + ring * SECTORS + sector % SECTORS;
            let [a, b] = [corner(ring, sector), corner(ring, sector + 1)];
            let [c, d] = [corner(ring + 1, sector), corner(ring + 1, sector + 1)];
            faces.extend([[a, b, c], [b, d, c]]);
        }
    }
    if faces.is_empty() {
        return Vec::new();
    }
    let [x, y, z] = coordinates(corners.iter().copied());
    let corner = |k: usize| -> Vec<usize> { faces.iter().map(|face| face[k]).collect() };
    let mesh = Mesh3D::new(x, y, z, Some(corner(0)), Some(corner(1)), Some(corner(2)));
    let mesh = mesh.color(colour.to_owned()).opacity(0.35).hover_info(plotly::common::HoverInfo::Skip);
    vec![mesh.name(format!("{kind}: 2 sd")).legend_group(kind).show_legend(true)]
}

fn paths(rays: &[&Ray], name: &str, colour: &str, is_shown: bool) -> Box<dyn Trace> {
    let along = |axis: usize| -> Vec<Option<f64>> {
        let ray = |ray: &&Ray| {
            let corners = ray.corners_m.iter().map(|corner| Some(short(corner[axis], DIGITS)));
            corners.chain([None]).collect::<Vec<_>>()
        };
        rays.iter().flat_map(ray).collect()
    };
    Scatter3D::new(along(0), along(1), along(2))
        .name(name)
        .mode(Mode::Lines)
        .line(Line::new().color(colour.to_owned()).width(1.0).dash(DashType::Solid))
        .opacity(0.35)
        .hover_info(plotly::common::HoverInfo::Skip)
        .visible(if is_shown { Visible::True } else { Visible::LegendOnly })
}
