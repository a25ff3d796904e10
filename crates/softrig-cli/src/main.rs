//! softrig
fn main() {}
