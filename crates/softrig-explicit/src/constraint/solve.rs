//! The forces of [Gissler2006 §4], one function per formula.
//!
//! Terms: x^ unconstrained position at the end of the step [m]; c its gain [m/N]; F constraint force [N]; a_i weights [-].
//! Deviation: eq. 27 is read with -a_i F_0 as in the text above it, not -a_i F_i.

/// F = (goal - x^) / c [Gissler2006 eq. 14].
#[inline]
#[must_use]
pub fn nail_force(goal: [f64; 3], predicted: [f64; 3], gain: f64) -> [f64; 3] {
    std::array::from_fn(|k| (goal[k] - predicted[k]) / gain)
}

/// F = (goal - v^) / d, with v^ and the gain d of the velocity [Gissler2006 eq. 11].
#[inline]
#[must_use]
pub fn velocity_force(goal: [f64; 3], predicted: [f64; 3], gain: f64) -> [f64; 3] {
    nail_force(goal, predicted, gain)
}

/// Writes F_i = (y - x^_i) / c_i and returns the common place y = (Σ x^_i / c_i) / (Σ 1 / c_i), for Verlet the centre of mass.
/// Equal to [Gissler2006 eq. 22]; the forces sum to zero.
///
/// # Panics
/// When the lists differ in length.
pub fn points_to_point_forces(predicted: &[[f64; 3]], gain: &[f64], force: &mut [[f64; 3]]) -> [f64; 3] {
    assert!(predicted.len() == gain.len() && gain.len() == force.len(), "one gain and one force per point");
    // from the first point, so that a far origin costs no digits
    let origin = predicted[0];
    let (mut sum, mut weight) = ([0.0; 3], 0.0);
    for (x, c) in predicted.iter().zip(gain) {
        weight += 1.0 / c;
        (0..3).for_each(|k| sum[k] += (x[k] - origin[k]) / c);
    }
    let goal = std::array::from_fn(|k| origin[k] + sum[k] / weight);
    for ((f, x), c) in force.iter_mut().zip(predicted).zip(gain) {
        *f = nail_force(goal, *x, *c);
    }
    goal
}

/// F_0 = (Σ a_i x^_i - x^_0) / (c_0 + Σ c_i a_i²), the force on the point; carrier i gets -a_i F_0 [Gissler2006 eq. 28].
///
/// # Panics
/// When the lists differ in length.
#[inline]
#[must_use]
pub fn carried_force(
    point: [f64; 3],
    point_gain: f64,
    carriers: &[[f64; 3]],
    gains: &[f64],
    weights: &[f64],
) -> [f64; 3] {
    assert!(carriers.len() == gains.len() && gains.len() == weights.len(), "one gain and one weight per carrier");
    let (mut gap, mut gain) = ([0.0; 3], point_gain);
    for ((x, c), a) in carriers.iter().zip(gains).zip(weights) {
        gain += c * a * a;
        // the weights sum to one: differences keep their digits far from the origin
        (0..3).for_each(|k| gap[k] += a * (x[k] - point[k]));
    }
    gap.map(|g| g / gain)
}
