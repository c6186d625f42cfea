//! Light transport: when and how strongly light arrives, by integrals over the areas of facets.
//!
//! The laser lights its whole patch evenly; the sensor sees its whole patch. A Lambertian point reflects
//! `reflectance / pi` per solid angle and cosine, a glossy one also a lobe. A mirror shows the image of the objects in
//! front of it. Point y of facet q with area dA gets `f(.., x, y) cos cos dA / |x - y|^2` of the light on point x of
//! facet p. The lens of area A at distance r gets `f cos A / r^2`. Strength, mean, spread and skewness of the time are
//! sums of products over all points of all facets of a path (`light::Moments`).

mod facet;
mod light;
mod paths;
mod room;

pub use light::Light;
pub use paths::{CaptureLights, PathLights, Paths};
pub use room::Room;

#[cfg(test)]
mod tests;
