//! The sample character's skin as an implicit surface: rounded parts under a smooth union.
//!
//! Terms: d signed distance, negative inside [m]; k width of a blend [m]. Every function returns d and its gradient.

use glam::{DMat3, DQuat, DVec3};

/// A signed distance and its gradient.
#[derive(Clone, Copy, Debug)]
pub(super) struct Field {
    pub(super) d: f64,
    pub(super) gradient: DVec3,
}

#[derive(Clone, Copy, Debug)]
enum Form {
    /// Hull of two spheres: ends `a`, `b`, radii `ra`, `rb`.
    Cone { a: DVec3, b: DVec3, ra: f64, rb: f64 },
    /// `to_own` turns the world into the ellipsoid's axes.
    Ellipsoid { centre: DVec3, radii: DVec3, to_own: DMat3 },
}

/// One rounded part of the body.
#[derive(Clone, Debug)]
pub(super) struct Part {
    form: Form,
    /// Width of the blend with the parts before it [m].
    blend: f64,
    /// Joint that carries it.
    pub(super) bone: String,
    /// Centre and radius of a ball around it, to skip it from afar.
    ball: (DVec3, f64),
}

impl Part {
    /// Signed distance: exact for cones, first order near the surface for ellipsoids.
    pub(super) fn field(&self, p: DVec3) -> Field {
        match self.form {
            Form::Cone { a, b, ra, rb } => cone(p, a, b, ra, rb),
            Form::Ellipsoid { centre, radii, to_own } => {
                let f = ellipsoid(to_own * (p - centre), radii);
                Field { d: f.d, gradient: to_own.transpose() * f.gradient }
            }
        }
    }
}

/// The envelope of the spheres between the two ends: least over z of |p - c(z)| - r(z).
fn cone(p: DVec3, a: DVec3, b: DVec3, ra: f64, rb: f64) -> Field {
    let length = (b - a).length();
    let axis = (b - a) / length;
    let slope = (ra - rb) / length;
    let along = (p - a).dot(axis);
    let across = (p - a - axis * along).length();
    let z = (along - slope * across / (1.0 - slope * slope).sqrt()).clamp(0.0, length);
    let arm = p - a - axis * z;
    let distance = arm.length().max(1e-12);
    Field { d: distance - ra + z * slope, gradient: arm / distance }
}

fn ellipsoid(p: DVec3, radii: DVec3) -> Field {
    let (u, w) = (p / radii, p / (radii * radii));
    let (k0, k1) = (u.length().max(1e-9), w.length().max(1e-9));
    let (g0, g1) = (w / k0, w / (radii * radii) / k1);
    Field { d: k0 * (k0 - 1.0) / k1, gradient: ((2.0 * k0 - 1.0) * k1 * g0 - k0 * (k0 - 1.0) * g1) / (k1 * k1) }
}

/// Cubic smooth minimum: twice differentiable, so that highlights run over the seam without a kink.
fn smooth_min(a: Field, b: Field, k: f64) -> Field {
    let (low, high) = if a.d < b.d { (a, b) } else { (b, a) };
    let h = ((k - (high.d - low.d)) / k).max(0.0);
    let t = 0.5 * h * h;
    Field { d: low.d - h * h * h * k / 6.0, gradient: low.gradient * (1.0 - t) + high.gradient * t }
}

/// The whole body.
pub(super) struct Body {
    pub(super) parts: Vec<Part>,
}

impl Body {
    /// The implicit skin at `p`: parts joined in order, soles cut flat at the ground, navel pressed in.
    pub(super) fn field(&self, p: DVec3) -> Field {
        let mut sum = Field { d: 1e3, gradient: DVec3::ZERO };
        for part in &self.parts {
            // out of reach of the blend: the minimum does not change
            let (centre, radius) = part.ball;
            let reach = sum.d.max(0.0) + part.blend + radius;
            if sum.d < 900.0 && (p - centre).length_squared() > reach * reach {
                continue;
            }
            sum = smooth_min(sum, part.field(p), part.blend);
        }
        let carve = |sum: Field, tool: Field, k: f64| {
            let flip = |f: Field| Field { d: -f.d, gradient: -f.gradient };
            flip(smooth_min(flip(sum), tool, k))
        };
        let ground = Field { d: p.y, gradient: DVec3::Y };
        let sum = carve(sum, ground, 0.022);
        carve(sum, cone(p, NAVEL, NAVEL + DVec3::Z * 0.1, 0.011, 0.011), 0.03)
    }

    /// Nearest point of the skin by Newton steps along the gradient.
    pub(super) fn project(&self, mut p: DVec3) -> DVec3 {
        for _ in 0..4 {
            let f = self.field(p);
            p -= f.gradient * (f.d / f.gradient.length_squared().max(1e-3));
            if f.d.abs() < 1e-7 {
                break;
            }
        }
        p
    }
}

/// Where the navel is [m].
const NAVEL: DVec3 = DVec3::new(0.0, 0.70, 0.292);

/// Builds the body, left side mirrored to the right.
pub(super) fn body() -> Body {
    let mut parts = Vec::new();
    let mut add = |bone: &str, blend: f64, form: Form| {
        parts.push(part(form, blend, bone.to_owned()));
        if let Some(base) = bone.strip_suffix(".L") {
            parts.push(part(mirrored(form), blend, format!("{base}.R")));
        } else if centre_of(form).x > 0.05 {
            parts.push(part(mirrored(form), blend, bone.to_owned()));
        }
    };
    let v = DVec3::new;
    let ball = |c: DVec3, r: f64| Form::Ellipsoid { centre: c, radii: DVec3::splat(r), to_own: DMat3::IDENTITY };
    let egg = |c: DVec3, r: DVec3| Form::Ellipsoid { centre: c, radii: r, to_own: DMat3::IDENTITY };
    let tilted =
        |c: DVec3, r: DVec3, q: DQuat| Form::Ellipsoid { centre: c, radii: r, to_own: DMat3::from_quat(q).transpose() };
    let limb = |a: DVec3, b: DVec3, ra: f64, rb: f64| Form::Cone { a, b, ra, rb };

    // trunk
    add("hips", 0.05, egg(v(0.0, 0.575, 0.0), v(0.215, 0.15, 0.185)));
    add("hips", 0.05, ball(v(0.085, 0.56, -0.085), 0.125));
    add("spine", 0.07, egg(v(0.0, 0.735, 0.055), v(0.268, 0.205, 0.242)));
    add("chest", 0.09, egg(v(0.0, 0.96, -0.005), v(0.195, 0.165, 0.155)));
    add("chest", 0.05, egg(v(0.085, 0.945, 0.085), v(0.085, 0.075, 0.08)));
    // legs
    add("thigh.L", 0.06, limb(v(0.125, 0.54, 0.0), v(0.165, 0.325, 0.008), 0.122, 0.09));
    add("shin.L", 0.03, limb(v(0.165, 0.325, 0.008), v(0.19, 0.11, -0.01), 0.088, 0.064));
    add("shin.L", 0.05, ball(v(0.178, 0.245, -0.025), 0.068));
    add("foot.L", 0.035, limb(v(0.19, 0.07, -0.025), v(0.203, 0.05, 0.09), 0.074, 0.066));
    add("toes.L", 0.03, egg(v(0.205, 0.045, 0.12), v(0.075, 0.058, 0.078)));
    // arms
    add("shoulder.L", 0.07, limb(v(0.08, 1.035, -0.015), v(0.19, 1.005, -0.02), 0.085, 0.085));
    add("upper_arm.L", 0.14, limb(v(0.205, 0.995, -0.02), v(0.385, 0.815, -0.025), 0.075, 0.064));
    add("forearm.L", 0.03, limb(v(0.385, 0.815, -0.025), v(0.545, 0.65, -0.01), 0.066, 0.045));
    add("hand.L", 0.03, limb(v(0.568, 0.627, -0.003), v(0.622, 0.57, 0.006), 0.056, 0.05));
    add("hand.L", 0.02, limb(v(0.568, 0.622, 0.035), v(0.584, 0.586, 0.084), 0.028, 0.025));
    // neck and head
    add("neck", 0.06, limb(v(0.0, 1.07, -0.01), v(0.0, 1.17, 0.0), 0.095, 0.09));
    add("head", 0.04, egg(v(0.0, 1.35, -0.005), v(0.192, 0.185, 0.182)));
    add("head", 0.06, egg(v(0.0, 1.275, 0.02), v(0.195, 0.125, 0.165)));
    add("head", 0.06, ball(v(0.1, 1.262, 0.09), 0.078));
    add("head", 0.025, egg(v(0.0, 1.297, 0.20), v(0.038, 0.034, 0.036)));
    let outwards = DQuat::from_rotation_y(-0.35) * DQuat::from_rotation_z(-0.15);
    add("head", 0.02, tilted(v(0.2, 1.305, -0.02), v(0.034, 0.061, 0.047), outwards));
    Body { parts }
}

fn centre_of(form: Form) -> DVec3 {
    match form {
        Form::Cone { a, .. } => a,
        Form::Ellipsoid { centre, .. } => centre,
    }
}

fn mirrored(form: Form) -> Form {
    let flip = DVec3::new(-1.0, 1.0, 1.0);
    match form {
        Form::Cone { a, b, ra, rb } => Form::Cone { a: a * flip, b: b * flip, ra, rb },
        Form::Ellipsoid { centre, radii, to_own } => {
            let m = DMat3::from_diagonal(flip);
            Form::Ellipsoid { centre: centre * flip, radii, to_own: m * to_own * m }
        }
    }
}

fn part(form: Form, blend: f64, bone: String) -> Part {
    let ball = match form {
        Form::Cone { a, b, ra, rb } => ((a + b) * 0.5, (b - a).length() * 0.5 + ra.max(rb)),
        Form::Ellipsoid { centre, radii, .. } => (centre, radii.max_element()),
    };
    Part { form, blend, bone, ball }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The gradient is what Newton steps and relaxation rely on; central differences are the independent route.
    #[test]
    fn gradient_is_the_derivative_of_the_distance() {
        let body = body();
        let e = 1e-5;
        for i in 0..200 {
            let r = |k: usize| ((i * 37 + k * 101) % 199) as f64 / 199.0;
            let p = body.project(DVec3::new(r(0) - 0.5, 1.6 * r(1), 0.6 * r(2) - 0.3)) + DVec3::splat(0.004);
            let g = body.field(p).gradient;
            for k in 0..3 {
                let step = DVec3::AXES[k] * e;
                let fd = (body.field(p + step).d - body.field(p - step).d) / (2.0 * e);
                assert!((fd - g[k]).abs() < 1e-3, "{p} axis {k}: {fd} against {}", g[k]);
            }
        }
    }
}
