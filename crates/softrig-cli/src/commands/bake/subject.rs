//! What a bake advances: the flesh of a character, or objects by themselves.

use super::measure::Measures;
use super::objects::{self, Layout};
use super::session::{Job, journal_failure};
use crate::args::MethodName;
use crate::failure::Failure;
use crate::scene::Scene;
use softrig::body::Body;
use softrig::force::ElasticModel;
use softrig::frame::{Frame, FrameSink};
use softrig::integrate::{Linked, State, StepError};
use softrig::material::MaterialMap;
use softrig::rig::{JointId, Pose};
use softrig::simulation::{Checkpoint, FrameReport, Motion, Simulation, SimulationSettings, SolverKind};
use softrig_explicit::clustered::Clustered;
use softrig_explicit::elastic::ElasticLaw;
use softrig_explicit::element::{ElementWise, Warping};
use softrig_explicit::mass_point::{Energies, MassPoints};
use softrig_explicit::objects::{Implicit, Law, ObjectSettings, Objects};
use softrig_io::journal::JournalWriter;
use softrig_linalg::solver::{Direct, Pcg};
use softrig_linalg::{DofConstraints, LinearSolver, Scalar};

/// Something with frames.
pub trait Subject {
    /// Puts it into its first frame.
    ///
    /// # Errors
    /// In words, why it cannot be.
    fn start(&mut self, motion: &dyn Motion) -> Result<FrameReport, String>;

    /// Advances it to `time` [s].
    ///
    /// # Errors
    /// In words, why it cannot be.
    fn advance(&mut self, motion: &dyn Motion, time: f64) -> Result<FrameReport, String>;

    /// Measures the current frame and puts it into the journal. `start` is when the first frame is in the clip's own time [s].
    ///
    /// # Errors
    /// [`Failure`] of the journal.
    fn record(
        &mut self,
        job: &Job<'_>,
        index: usize,
        start: f64,
        measures: &mut Measures,
        journal: &mut JournalWriter,
    ) -> Result<(), Failure>;

    /// All that the next step reads.
    fn checkpoint(&mut self) -> Vec<u8>;

    /// Puts a checkpoint back.
    ///
    /// # Errors
    /// In words, why it is not of this subject.
    fn restore(&mut self, state: Vec<u8>, motion: &dyn Motion) -> Result<(), String>;

    /// Unknowns of the skeleton.
    fn joint_unknowns(&self) -> usize;

    /// Mass that projects to no bone [kg].
    fn unassigned_mass(&self) -> f64;
}

/// The flesh of a character.
pub struct Flesh<R>(pub Simulation<R>);

impl<R: Scalar> Subject for Flesh<R> {
    fn start(&mut self, motion: &dyn Motion) -> Result<FrameReport, String> {
        self.0.start(motion).map_err(|e: StepError| e.to_string())
    }

    fn advance(&mut self, motion: &dyn Motion, time: f64) -> Result<FrameReport, String> {
        self.0.advance(motion, time).map_err(|e| e.to_string())
    }

    fn record(
        &mut self,
        job: &Job<'_>,
        index: usize,
        start: f64,
        measures: &mut Measures,
        journal: &mut JournalWriter,
    ) -> Result<(), Failure> {
        let (scene, prepared) = (job.scene, job.prepared);
        let skeleton = &prepared.character.skeleton;
        let gap = self.0.attachment_gap();
        let violation = self.0.limit_violation();
        let free: Vec<JointId> = self.0.free_roots().to_vec();
        // kept in any case: a resumed bake may want them
        let wanted = scene.coupling.two_way.then(|| self.0.joint_reaction().to_vec());
        let frame = self.0.frame(index);
        measures.add_shape(skeleton, prepared.binding.as_ref(), &prepared.volume, frame.nodes, gap);
        let locals = job.clip.sample(skeleton, start + frame.time * scene.motion.speed);
        let height = prepared.character.height();
        measures.add_pose(skeleton, prepared.bones(), frame.pose, &locals, height, &free);
        measures.add_joints(violation, wanted.as_deref());
        journal.frame(&frame).map_err(|e| journal_failure(&e))
    }

    fn checkpoint(&mut self) -> Vec<u8> {
        self.0.checkpoint().as_bytes().to_vec()
    }

    fn restore(&mut self, state: Vec<u8>, motion: &dyn Motion) -> Result<(), String> {
        self.0.restore(&Checkpoint::from_bytes(state), motion).map_err(|e| e.to_string())
    }

    fn joint_unknowns(&self) -> usize {
        self.0.joint_unknowns()
    }

    fn unassigned_mass(&self) -> f64 {
        self.0.unassigned_mass()
    }
}

/// Why energies of points are refused for finite elements.
const ENERGIES: &str = "`energies` are those of the method `mass-points`; leave one of them out";

/// Objects, and what of them is seen.
pub struct Things {
    objects: Objects,
    /// Nodes of the vertices of each mesh.
    surface: Vec<Vec<u32>>,
    skin: Vec<Vec<[f64; 3]>>,
    pose: Pose,
    /// Its steps are none of explicit methods.
    implicit: bool,
}

impl Things {
    /// The objects of a scene with their constraints.
    ///
    /// # Errors
    /// [`Failure::Input`] says what does not fit.
    pub fn new(scene: &Scene, materials: &MaterialMap, settings: &SimulationSettings) -> Result<Self, Failure> {
        let layout = Layout::new(scene);
        let implicit = scene.simulation.method == MethodName::Implicit;
        let mut objects = if implicit {
            Self::implicit(scene, &layout, materials, settings)?
        } else {
            Self::local(scene, &layout, materials)?
        };
        objects::constrain(scene, &layout, &mut objects)?;
        let surface = objects::surface_nodes(scene, &layout);
        let skin = surface.iter().map(|list| vec![[0.0; 3]; list.len()]).collect();
        Ok(Self { objects, surface, skin, pose: Pose::default(), implicit })
    }

    fn body(layout: &Layout, materials: &MaterialMap, model: ElasticModel) -> Result<Body<f64>, Failure> {
        let free = DofConstraints::none(layout.mesh.node_count());
        Body::new(layout.mesh.clone(), materials, model, free).map_err(|e| Failure::Input(e.to_string()))
    }

    /// Finite elements in implicit steps, constraints eliminated.
    fn implicit(
        scene: &Scene,
        layout: &Layout,
        materials: &MaterialMap,
        settings: &SimulationSettings,
    ) -> Result<Objects, Failure> {
        if scene.energies.is_some() {
            return Err(Failure::Input(ENERGIES.into()));
        }
        let body = Self::body(layout, materials, ElasticModel::Corotated)?;
        let solver: Box<dyn LinearSolver<f64>> =
            if settings.solver == SolverKind::Direct { Box::new(Direct::new()) } else { Box::new(Pcg::new()) };
        let implicit = Implicit {
            external: body.weight(settings.gravity),
            body,
            method: Linked::new(settings.dynamics.method()),
            solver,
            tolerance: settings.tolerance,
        };
        Ok(Objects::implicit(implicit, settings.longest_step))
    }

    /// Steps with constraint forces after them.
    fn local(scene: &Scene, layout: &Layout, materials: &MaterialMap) -> Result<Objects, Failure> {
        let failed = |e: &dyn std::fmt::Display| Failure::Input(e.to_string());
        let s = &scene.simulation;
        let material = scene.material.material();
        let mut body = Self::body(layout, materials, ElasticModel::Linear)?;
        let (weight, drag) = (body.weight(s.gravity), body.drag.clone());
        let scheme = s.scheme.into();
        let law = match s.method {
            MethodName::MassPoints => {
                let mut energies = Energies::of_material(&material, &layout.mesh);
                if let Some(e) = scene.energies {
                    energies = Energies {
                        distance: e.distance,
                        area: e.area,
                        volume: e.volume,
                        damping: e.damping,
                        ..energies
                    };
                }
                let mut points = MassPoints::new(&layout.mesh, &energies).map_err(|e| failed(&e))?;
                (points.gravity, points.drag) = (s.gravity, material.mass_damping);
                Law::MassPoints(points)
            }
            MethodName::Elements | MethodName::Implicit => {
                let internal = ElementWise::new(&layout.mesh, materials, Warping::Stiffness).map_err(|e| failed(&e))?;
                Law::Cells(ElasticLaw { internal, external: weight, drag })
            }
            MethodName::Clustered => {
                Law::Rows(ElasticLaw { internal: Clustered::new(&mut body), external: weight, drag })
            }
            MethodName::Modal => {
                return Err(Failure::Input(
                    "unsupported: modes of objects, which nothing holds; use another method".into(),
                ));
            }
        };
        if scene.energies.is_some() && s.method != MethodName::MassPoints {
            return Err(Failure::Input(ENERGIES.into()));
        }
        let settings = ObjectSettings {
            scheme,
            too_long: s.too_long.into(),
            longest_step: s.step.unwrap_or(1.0 / 60.0),
            drag: material.mass_damping,
        };
        Objects::new(layout.mesh.nodes.clone(), &body.mass, law, settings).map_err(|e| failed(&e))
    }

    fn state(&self) -> &State<f64> {
        &self.objects.state
    }
}

impl Subject for Things {
    fn start(&mut self, _: &dyn Motion) -> Result<FrameReport, String> {
        Ok(FrameReport::default())
    }

    fn advance(&mut self, _: &dyn Motion, time: f64) -> Result<FrameReport, String> {
        let steps = self.objects.advance(time).map_err(|e| e.to_string())?;
        Ok(FrameReport {
            substeps: steps,
            explicit_steps: if self.implicit { 0 } else { steps },
            ..FrameReport::default()
        })
    }

    fn record(
        &mut self,
        job: &Job<'_>,
        index: usize,
        _: f64,
        measures: &mut Measures,
        journal: &mut JournalWriter,
    ) -> Result<(), Failure> {
        let at = &self.objects.state.position;
        for (list, skin) in self.surface.iter().zip(&mut self.skin) {
            skin.iter_mut().zip(list).for_each(|(p, n)| *p = at[*n as usize]);
        }
        let prepared = job.prepared;
        measures.add_shape(&prepared.character.skeleton, None, &prepared.volume, at, 0.0);
        let time = self.state().time;
        let frame = Frame { index, time, skin: &self.skin, pose: &self.pose, nodes: at, joint_force: &[] };
        journal.frame(&frame).map_err(|e| journal_failure(&e))
    }

    fn checkpoint(&mut self) -> Vec<u8> {
        self.objects.snapshot().iter().flat_map(|v| v.to_le_bytes()).collect()
    }

    fn restore(&mut self, state: Vec<u8>, _: &dyn Motion) -> Result<(), String> {
        let (numbers, rest) = state.as_chunks::<8>();
        let numbers: Vec<f64> = numbers.iter().map(|b| f64::from_le_bytes(*b)).collect();
        let fits = rest.is_empty() && self.objects.restore(&numbers);
        if fits { Ok(()) } else { Err("the checkpoint is of other objects; bake from the start with --force".into()) }
    }

    fn joint_unknowns(&self) -> usize {
        0
    }

    fn unassigned_mass(&self) -> f64 {
        0.0
    }
}
