//! Light transport: when and how strongly light arrives, by integrals over the areas of facets.
//!
//! The laser lights the whole of its patch evenly; the sensor sees the whole of its own. A Lambertian point gives back `reflectance / pi` per
//! solid angle and cosine, a glossy one a lobe beside it, a mirror the image of what is before it. Of the light on point x of facet p, point y of
//! facet q with area dA gets `f(.., x, y) cos cos dA / |x - y|^2`, and the lens of area A at distance r gets `f cos A / r^2`. Over all points of
//! all facets of a path, strength, mean, spread and skewness of the time are sums of products, point by point (`light::Moments`).

mod facet;
mod light;
mod paths;
mod room;

pub use light::Light;
pub use paths::{Captured, PathLights, Paths};
pub use room::Room;

#[cfg(test)]
mod tests;
