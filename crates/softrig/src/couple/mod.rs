//! Where flesh meets bone.
