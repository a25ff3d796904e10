//! The methods of this crate as choices of a simulation: each is an integrator in the place of the implicit ones.

use crate::clustered::Clustered;
use crate::explicit::Explicit;
use crate::mass_point::{Energies, MassPointError, MassPoints};
use crate::modal::{CarriedModes, ModalError};
use crate::scheme::Scheme;
use crate::stepper::TooLong;
use softrig::body::Body;
use softrig::integrate::Integrator;
use softrig::material::{Material, MaterialMap};
use softrig::mesh::VolumeMesh;
use softrig_linalg::Scalar;

/// How a body is computed without a linear system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Cell by cell, each turned with its material: the body's own model in explicit steps.
    Elements,
    /// Linear, by block rows, carried by skinning [Tang2009].
    Clustered,
    /// In so many of the lowest modes, carried by skinning. Any step is stable.
    Modal(usize),
    /// Masses with distance and volume energies [Gissler2006], about as stiff as the material.
    MassPoints,
}

/// How explicit methods step; modes take no part in it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stepping {
    /// How a step is taken.
    pub scheme: Scheme,
    /// What happens to steps beyond the stability limit.
    pub too_long: TooLong,
}

/// Why a method cannot take a body.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MethodError {
    /// The cells of mass points are all alike.
    #[error(
        "unsupported: mass points have one stiffness everywhere; leave out regions, stiffer bones and stiffening, or use another method"
    )]
    SeveralMaterials,
    /// No mass points on this mesh.
    #[error(transparent)]
    MassPoint(#[from] MassPointError),
    /// No modes of this body.
    #[error(transparent)]
    Modal(#[from] ModalError),
    /// The scheme is none of explicit steps.
    #[error("unsupported: `{0}` needs a solve; characters have the method `implicit` for that")]
    NotExplicit(&'static str),
}

impl Method {
    /// Name in files and on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Elements => "elements",
            Self::Clustered => "clustered",
            Self::Modal(_) => "modal",
            Self::MassPoints => "mass-points",
        }
    }

    /// The integrator that computes `body`, made of `materials`, in this way.
    ///
    /// # Errors
    /// [`MethodError`] when the method cannot take the body.
    pub fn integrator<R: Scalar>(
        self,
        body: &mut Body<R>,
        materials: &MaterialMap,
        stepping: Stepping,
    ) -> Result<Box<dyn Integrator<R>>, MethodError> {
        let Stepping { scheme, too_long } = stepping;
        if scheme == Scheme::ImplicitEuler && !matches!(self, Self::Modal(_)) {
            return Err(MethodError::NotExplicit(scheme.name()));
        }
        let mut explicit = match self {
            Self::Modal(count) => {
                let first = materials.get(0);
                let damping = (first.mass_damping, first.stiffness_damping);
                return Ok(Box::new(CarriedModes::new(body, count, damping)?));
            }
            Self::Elements => Explicit::new(scheme),
            Self::Clustered => Explicit::with_force(scheme, Box::new(Clustered::new(body))).carried(),
            Self::MassPoints => {
                if materials.materials.len() > 1 || materials.stiffness_factor.iter().any(|f| *f != 1.0) {
                    return Err(MethodError::SeveralMaterials);
                }
                let energies = Energies::of_material(&materials.get(0), &body.mesh);
                let internal = MassPoints::new(&body.mesh, &energies)?;
                Explicit::with_force(scheme, Box::new(internal))
            }
        };
        explicit.too_long = too_long;
        Ok(Box::new(explicit))
    }
}

impl Energies {
    /// About as stiff as a material. A tetrahedron has some 1.2 edges of its own, and the square of a strain along one axis is on average
    /// a fifth along a random edge: edges of k = 4 E V hold the energy E V ε²/2 of a tetrahedron of volume V. Volumes are held by λ V.
    #[must_use]
    pub fn of_material(material: &Material, mesh: &VolumeMesh) -> Self {
        let volumes = mesh.tets.iter().map(|t| softrig::force::tet_gradients(t.map(|n| mesh.nodes[n as usize])).1);
        let volume = volumes.sum::<f64>() / mesh.tets.len().max(1) as f64;
        Self {
            distance: 4.0 * material.young_modulus * volume,
            area: 0.0,
            volume: material.lambda() * volume,
            damping: material.stiffness_damping,
            density: material.density,
        }
    }
}
