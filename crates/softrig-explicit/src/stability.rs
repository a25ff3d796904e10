//! How long a step may be: the largest frequency and damping of the body, found on the force law itself, and what each scheme
//! can follow.

use crate::scheme::Scheme;
use crate::stepper::ForceLaw;
use softrig_linalg::Scalar;

/// Power iterations at most; the start is rough on purpose, and the largest frequencies of a mesh are rough.
const ITERATIONS: usize = 200;
/// Modes between the slowest and the fastest that are looked at.
const MODES: usize = 40;

/// Extremes of the small motions of a body around its rest shape.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spectrum {
    /// Largest angular frequency, undamped [1/s].
    pub frequency: f64,
    /// Largest decay coefficient of `v' = -damping v` [1/s].
    pub damping: f64,
    /// The part of it that is the same for all modes [1/s].
    pub drag: f64,
}

/// Largest frequency and damping of `law` around `rest`, by power iteration on central differences of the force: the operator
/// that is stepped, not a bound. `force` is scratch.
pub(crate) fn spectrum<R: Scalar>(
    law: &mut dyn ForceLaw<R>,
    inverse_mass: &[R],
    rest: &[[R; 3]],
    force: &mut [[R; 3]],
) -> Spectrum {
    // a single point has no extent: any displacement will do
    let size = Some(extent(rest)).filter(|s| *s > 0.0).unwrap_or(1.0);
    let step = R::EPSILON.to_f64().cbrt() * size;
    let zero = vec![[R::zero(); 3]; rest.len()];
    let mut shifted = rest.to_vec();
    let stiffness = power(inverse_mass, force, |p, out, force| {
        let e = R::from_f64(step);
        out.fill([R::zero(); 3]);
        for sign in [R::one(), -R::one()] {
            for i in 0..p.len() {
                shifted[i] = std::array::from_fn(|k| rest[i][k] + sign * e * p[i][k]);
            }
            law.force(&shifted, &zero, force);
            subtract(out, force, sign / (e + e));
        }
    });
    let mut velocity = zero.clone();
    let damping = power(inverse_mass, force, |p, out, force| {
        out.fill([R::zero(); 3]);
        for sign in [R::one(), -R::one()] {
            for i in 0..p.len() {
                velocity[i] = p[i].map(|p| sign * p);
            }
            law.force(rest, &velocity, force);
            subtract(out, force, sign * R::from_f64(0.5));
        }
    });
    // of the directions that are pushed away from rest there is nothing to follow
    Spectrum { frequency: stiffness.max(0.0).sqrt(), damping: damping.max(0.0), drag: 0.0 }
}

fn subtract<R: Scalar>(out: &mut [[R; 3]], force: &[[R; 3]], factor: R) {
    for (o, f) in out.iter_mut().zip(force) {
        (0..3).for_each(|k| o[k] -= factor * f[k]);
    }
}

fn extent<R: Scalar>(points: &[[R; 3]]) -> f64 {
    let mut lo = [f64::INFINITY; 3];
    let mut hi = [f64::NEG_INFINITY; 3];
    for p in points {
        for k in 0..3 {
            lo[k] = lo[k].min(p[k].to_f64());
            hi[k] = hi[k].max(p[k].to_f64());
        }
    }
    (0..3).map(|k| hi[k] - lo[k]).fold(0.0, f64::max)
}

/// Largest eigenvalue of W A, by power iteration; `product` writes A p, the direction p having a largest component of one.
fn power<R: Scalar>(
    w: &[R],
    force: &mut [[R; 3]],
    mut product: impl FnMut(&[[R; 3]], &mut [[R; 3]], &mut [[R; 3]]),
) -> f64 {
    let n = w.len();
    // a fixed sequence of bits: neighbours move against each other
    let mut bits = 0x9E37_79B9_7F4A_7C15u64;
    let mut p: Vec<[R; 3]> = (0..n)
        .map(|i| {
            std::array::from_fn(|_| {
                bits = bits.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                let x = (bits >> 40) as f64 / (1u64 << 24) as f64 - 0.5;
                if w[i] > R::zero() { R::from_f64(2.0 * x) } else { R::zero() }
            })
        })
        .collect();
    let mut q = p.clone();
    let mut value = 0.0;
    for k in 0..ITERATIONS {
        product(&p, &mut q, force);
        // p . q over p . M p, then p = W q
        let (mut upper, mut lower, mut largest) = (0.0, 0.0, 0.0f64);
        for i in 0..n {
            if w[i] <= R::zero() {
                continue;
            }
            for c in 0..3 {
                let (a, b) = (p[i][c].to_f64(), q[i][c].to_f64());
                upper += a * b;
                lower += a * a / w[i].to_f64();
                p[i][c] = q[i][c] * w[i];
                largest = largest.max(p[i][c].to_f64().abs());
            }
        }
        let before = value;
        value = if lower > 0.0 { upper / lower } else { 0.0 };
        if largest == 0.0 || !largest.is_finite() {
            return if largest == 0.0 { 0.0 } else { f64::NAN };
        }
        let scale = R::from_f64(1.0 / largest);
        p.iter_mut().flatten().for_each(|p| *p *= scale);
        if k > 20 && (value - before).abs() <= 1e-5 * value.abs() {
            break;
        }
    }
    value
}

impl Scheme {
    /// Longest step [s] with which no mode of the spectrum grows a thousandfold within a million steps. Modes between are taken
    /// to be damped in proportion to their stiffness. Infinite for implicit Euler and for bodies without forces.
    #[must_use]
    pub fn stable_step(self, spectrum: &Spectrum) -> f64 {
        let unit = spectrum.frequency.max(spectrum.damping);
        if self == Self::ImplicitEuler || unit <= 0.0 {
            return f64::INFINITY;
        }
        let drag = spectrum.drag.min(spectrum.damping);
        let stable = |h: f64| {
            (0..MODES).all(|k| {
                let s = 10f64.powf(-2.5 * k as f64 / MODES as f64);
                let (frequency, damping) = (s * spectrum.frequency, drag + s * s * (spectrum.damping - drag));
                // in the mode's own unit of time
                let own = if frequency > 0.0 { frequency } else { damping };
                bounded(amplification(self, h / unit * own, (frequency / own).powi(2), damping / own))
            })
        };
        let (mut lo, mut hi) = (1e-7f64, 10.0f64);
        if !stable(lo) {
            return 0.0;
        }
        for _ in 0..50 {
            let middle = (lo * hi).sqrt();
            if stable(middle) { lo = middle } else { hi = middle }
        }
        lo / unit
    }
}

/// What a step does to (x, v, a before) of the oscillator a = -stiffness x - damping v.
fn amplification(scheme: Scheme, h: f64, stiffness: f64, damping: f64) -> [[f64; 3]; 3] {
    let a = |x: f64, v: f64| -stiffness * x - damping * v;
    let step = |s: [f64; 3]| {
        let [x, v, b] = s;
        let now = a(x, v);
        match scheme {
            Scheme::ExplicitEuler => [x + h * v, v + h * now, now],
            Scheme::EulerCromer | Scheme::ImplicitEuler => [x + h * (v + h * now), v + h * now, now],
            Scheme::Midpoint => {
                let mid = a(x + 0.5 * h * v, v + 0.5 * h * now);
                [x + h * (v + 0.5 * h * now), v + h * mid, now]
            }
            Scheme::RungeKutta2 => {
                let end = a(x + h * v, v + h * now);
                [x + h * v + 0.5 * h * h * now, v + 0.5 * h * (now + end), now]
            }
            Scheme::Verlet => [x + h * (v + h * now - 0.5 * h * b), v + 1.5 * h * now - 0.5 * h * b, now],
        }
    };
    let columns = [step([1.0, 0.0, 0.0]), step([0.0, 1.0, 0.0]), step([0.0, 0.0, 1.0])];
    std::array::from_fn(|i| std::array::from_fn(|j| columns[j][i]))
}

/// Are the powers of a matrix bounded, for a million steps and a thousand times?
fn bounded(mut m: [[f64; 3]; 3]) -> bool {
    for _ in 0..20 {
        let s = m;
        m = std::array::from_fn(|i| std::array::from_fn(|j| (0..3).map(|k| s[i][k] * s[k][j]).sum()));
        if m.iter().flatten().any(|x| !x.is_finite()) {
            return false;
        }
    }
    m.iter().flatten().all(|x| x.abs() < 1e3)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Textbook limits: 2/ω for the two symplectic schemes, 2/δ for explicit Euler on pure damping, nearly nothing for it on a
    /// pure spring.
    #[test]
    fn limits_are_those_of_the_oscillator() {
        let spring = Spectrum { frequency: 50.0, damping: 0.0, drag: 0.0 };
        for scheme in [Scheme::Verlet, Scheme::EulerCromer] {
            let h = scheme.stable_step(&spring);
            assert!((h * 50.0 - 2.0).abs() < 1e-3, "{scheme:?} {h}");
        }
        let drag = Spectrum { frequency: 0.0, damping: 8.0, drag: 8.0 };
        assert!((Scheme::ExplicitEuler.stable_step(&drag) * 8.0 - 2.0).abs() < 1e-3);
        assert!(Scheme::ExplicitEuler.stable_step(&spring) * 50.0 < 5e-3);
        assert!(Scheme::RungeKutta2.stable_step(&spring) * 50.0 < 0.12);
        assert_eq!(Scheme::ImplicitEuler.stable_step(&spring), f64::INFINITY);
        // stiffness damping: h (-b ω² + sqrt(b² ω⁴ + 4 ω²)) / ω²
        let (w, b) = (100.0, 0.003);
        let damped = Spectrum { frequency: w, damping: b * w * w, drag: 0.0 };
        let h = Scheme::EulerCromer.stable_step(&damped);
        let exact = (-b * w * w + (b * b * w.powi(4) + 4.0 * w * w).sqrt()) / (w * w);
        assert!((h - exact).abs() < 1e-3 * exact, "{h} {exact}");
    }
}
