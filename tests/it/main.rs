//! One integration binary, a file a concern.

mod formats;
mod house;
mod schema;
