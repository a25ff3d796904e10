//! Files in and out of softrig: characters, surfaces, motion capture, volume meshes, caches.
//!
//! Everything read here ends in metres with Y up; what was assumed on the way is said in notes. Every reader survives any
//! bytes: it ends in a value or in an [`ImportError`] that names the file, the place, and what to change.

pub mod bvh;
pub mod export;
pub mod gltf;
pub mod journal;
pub mod surface;
pub mod units;
pub mod volume;

mod error;
mod import;
mod names;
mod source;
mod text;

pub use error::{ImportError, Place, in_words};
pub use import::{ImportOptions, import};
pub use source::open_regular;
pub use units::UpAxis;
