//! softrig-io
