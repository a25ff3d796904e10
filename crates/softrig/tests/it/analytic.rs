//! Closed forms and conservation laws.
