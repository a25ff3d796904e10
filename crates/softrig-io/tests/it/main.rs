//! Tests of the public face of softrig-io, on real files where `shared/data` is present.

mod shared;
