//! softrig-cli
