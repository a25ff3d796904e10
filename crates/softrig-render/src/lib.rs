//! softrig-render
